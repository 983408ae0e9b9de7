#!/usr/bin/env bash
# A camera that MuJoCo carries on an arm is drawn where the arm was, one step before the joints that are read beside it.
#
# A step computes where everything is, then moves the joints: afterwards `qpos` is new, and poses of bodies, cameras and
# what a scene draws are those of before. So who stores, after each step, the joints and a picture stores two moments:
# forward kinematics of the joints says where the camera will be in the next picture. With an arm that turns at 1 rad/s,
# 0.6 m long, and steps of 8 ms that is 5 mm, and a calibration by such pairs is off by as much as what was recorded
# still moved. Kinematics before drawing makes one moment of them; that a step was taken, or that time passes, does not.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check mujoco==4.0.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
import mujoco
import numpy as np

print(f"mujoco {mujoco.__version__}, numpy {np.__version__}")
STEP_S, LENGTH_M, SPEED_RAD_S = 0.008, 0.6, 1.0
model = mujoco.MjModel.from_xml_string(f"""
<mujoco>
  <option timestep="{STEP_S}" gravity="0 0 0"/>
  <worldbody>
    <body>
      <joint name="shoulder" type="hinge" axis="0 0 1"/>
      <geom type="capsule" fromto="0 0 0 {LENGTH_M} 0 0" size="0.02"/>
      <camera name="wrist" pos="{LENGTH_M} 0 0"/>
    </body>
  </worldbody>
</mujoco>""")
data = mujoco.MjData(model)
data.qvel[0] = SPEED_RAD_S
scene, shown, eye = mujoco.MjvScene(model, maxgeom=10), mujoco.MjvOption(), mujoco.MjvCamera()
eye.type, eye.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, model.camera("wrist").id


def drawn_from():
    """Where the camera is that a picture is drawn from: what a renderer is given, no screen needed."""
    mujoco.mjv_updateScene(model, data, shown, None, eye, mujoco.mjtCatBit.mjCAT_ALL, scene)
    return np.mean([np.array(each.pos) for each in scene.camera], axis=0)  # of both eyes


def by_joints():
    """Where forward kinematics of the joints has it."""
    return LENGTH_M * np.array([np.cos(data.qpos[0]), np.sin(data.qpos[0]), 0.0])


for _ in range(50):
    mujoco.mj_step(model, data)
off_m = float(np.linalg.norm(drawn_from() - by_joints()))
step_m = LENGTH_M * SPEED_RAD_S * STEP_S
print(f"after a step the picture is drawn {1000 * off_m:.2f} mm from where the joints have the camera")
print(f"in one step it moves {1000 * step_m:.2f} mm")
assert abs(off_m - step_m) < 0.02 * step_m
mujoco.mj_kinematics(model, data)
mujoco.mj_camlight(model, data)
now_m = float(np.linalg.norm(drawn_from() - by_joints()))
print(f"after mj_kinematics and mj_camlight, {1000 * now_m:.4f} mm")
assert now_m < 1e-6
print("seen: joints and picture after a step are of two moments")
PYTHON
