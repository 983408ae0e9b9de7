#!/usr/bin/env bash
# One URDF, two libraries, two meanings of a configuration's numbers: MuJoCo and Pinocchio.
#
# MuJoCo keeps the joints in the order of the file. Pinocchio goes through the children of a link by the alphabet, so
# the left arm comes before the right one wherever the file has it. A continuous joint is an angle for MuJoCo and cosine
# and sine for Pinocchio. Vectors of the right length pass from one to the other and move the other arm.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check mujoco==4.0.0 pin==4.1.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
import mujoco
import numpy as np
import pinocchio

print(f"mujoco {mujoco.__version__}, pinocchio {pinocchio.__version__}, numpy {np.__version__}")
INERTIA = '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/>'


def link(name):
    return f'<link name="{name}"><inertial><mass value="1"/>{INERTIA}</inertial></link>'


def joint(name, parent, child, kind="revolute"):
    ends = f'<parent link="{parent}"/><child link="{child}"/><origin xyz="0.3 0 0"/><axis xyz="0 0 1"/>'
    limit = "" if kind == "continuous" else '<limit lower="-2" upper="2" effort="10" velocity="1"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{limit}</joint>'


def robot(*parts):
    return f'<robot name="robot">{"".join(parts)}</robot>'


two_arms = robot(
    *map(link, ("torso", "right_upper", "right_lower", "left_upper", "left_lower")),
    joint("right_shoulder", "torso", "right_upper"),
    joint("right_elbow", "right_upper", "right_lower"),
    joint("left_shoulder", "torso", "left_upper"),
    joint("left_elbow", "left_upper", "left_lower"),
)
model = mujoco.MjModel.from_xml_string(two_arms)
other = pinocchio.buildModelFromXML(two_arms)
in_mujoco = [model.joint(number).name for number in range(model.njnt)]
in_pinocchio = list(other.names)[1:]
print("MuJoCo:   ", in_mujoco)
print("Pinocchio:", in_pinocchio)
assert in_mujoco == ["right_shoulder", "right_elbow", "left_shoulder", "left_elbow"]
assert in_pinocchio == ["left_shoulder", "left_elbow", "right_shoulder", "right_elbow"]
assert model.nq == other.nq == 4

wheel = robot(link("base"), link("wheel"), joint("axle", "base", "wheel", "continuous"))
sizes = (mujoco.MjModel.from_xml_string(wheel).nq, pinocchio.buildModelFromXML(wheel).nq)
print("numbers of a continuous joint:", sizes)
assert sizes == (1, 2)
print("seen: the same file, other joints under the same numbers")
PYTHON
