#!/usr/bin/env bash
# A scale in MuJoCo weighs what is rigid, and does not notice what is soft.
#
# A platform rests on a force sensor. A rigid cube on it adds its weight to the reading, a soft one (a flex) of the same
# mass adds nothing, although it lies there: the contact forces themselves bear its weight. The recursion behind force
# and torque sensors goes by the bodies of contacts' geoms, and a flex has none. So a gripper whose wrist has such a
# sensor presses on cloth, cushions and bags without feeling them.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check mujoco==4.0.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
import mujoco
import numpy as np

print(f"mujoco {mujoco.__version__}, numpy {np.__version__}")
MASS_KG, WEIGHT_N = 0.5, 0.5 * 9.81
SCALE = """
<mujoco>
  <option timestep="0.002" integrator="discrete"/>
  <worldbody>
    <body name="platform" pos="0 0 0.1">
      <geom name="platform" type="box" size="0.2 0.2 0.01" mass="1"/>
      <site name="scale"/>
    </body>
    {load}
  </worldbody>
  <sensor><force name="scale" site="scale"/></sensor>
</mujoco>"""
RIGID = f'<body pos="0 0 0.16"><freejoint/><geom type="box" size="0.05 0.05 0.05" mass="{MASS_KG}"/></body>'
SOFT = f"""
    <flexcomp name="cube" type="grid" dim="3" dof="trilinear" count="4 4 4" spacing="0.033 0.033 0.033" pos="0 0 0.165"
        mass="{MASS_KG}" radius="0.002">
      <contact selfcollide="none"/>
      <elasticity young="20000" poisson="0.2" damping="0.05"/>
    </flexcomp>"""


def weigh(load):
    """Newtons that the scale shows at rest, and that the contacts bear."""
    model = mujoco.MjModel.from_xml_string(SCALE.format(load=load))
    data = mujoco.MjData(model)
    shown, borne, wrench = [], [], np.zeros(6)
    for step in range(4000):
        mujoco.mj_step(model, data)
        if step < 3000:
            continue
        shown.append(abs(data.sensordata[2]))
        total = 0.0
        for number in range(data.ncon):
            mujoco.mj_contactForce(model, data, number, wrench)
            total += wrench[0]
        borne.append(total)
    return float(np.mean(shown)), float(np.mean(borne))


empty, _ = weigh("")
for name, load, noticed in (("rigid", RIGID, True), ("soft", SOFT, False)):
    shown, borne = weigh(load)
    print(f"{name} cube of {WEIGHT_N:.2f} N: the scale shows {shown - empty:+.2f} N, contacts bear {borne:.2f} N")
    assert abs(borne - WEIGHT_N) < 0.1 * WEIGHT_N
    assert abs(shown - empty - (WEIGHT_N if noticed else 0.0)) < 0.1 * WEIGHT_N
print("seen: what is soft weighs nothing on a force sensor")
PYTHON
