"""The same small arm as MJCF and as URDF."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from baggie.errors import BaggieError, ReachError
from baggie.geometry import ToolPose, hand_matrix
from baggie.robot.kinematics import Kinematics, load_arm_model

JOINTS = ["pan", "lift", "elbow", "wrist"]
HOME = np.deg2rad([0.0, -10.0, 100.0, 90.0])  # bent, the tool pointing down; no joint turns it about itself
CHAIN = (("pan", "0 0 1", 0.1), ("lift", "0 1 0", 0.2), ("elbow", "0 1 0", 0.2), ("wrist", "0 1 0", 0.1))


def mjcf() -> str:
    body = '<body name="grip" pos="0 0 0.1"><joint name="jaw" axis="1 0 0"/><site name="tip" pos="0 0 0.05"/></body>'
    for (name, axis, _), height in zip(reversed(CHAIN), (0.2, 0.2, 0.1, 0.0), strict=True):
        body = (
            f'<body name="{name}_link" pos="0 0 {height}"><joint name="{name}" axis="{axis}" range="-170 170"/>'
            f'<geom type="mesh" mesh="lost"/>{body}</body>'
        )
    actuator = '<actuator><position joint="jaw"/></actuator>'
    assets = '<asset><mesh name="lost" file="lost.stl"/></asset>'
    return f"<mujoco><compiler autolimits='true'/>{assets}<worldbody>{body}</worldbody>{actuator}</mujoco>"


def urdf() -> str:
    text, parent = '<robot name="small"><link name="base"/>', "base"
    for (name, axis, _), height in zip(CHAIN, (0.0, 0.1, 0.2, 0.2), strict=True):
        text += (
            f'<link name="{name}_link"/><joint name="{name}" type="revolute"><parent link="{parent}"/>'
            f'<child link="{name}_link"/><origin xyz="0 0 {height}"/><axis xyz="{axis}"/>'
            '<limit lower="-2.967" upper="2.967" effort="1" velocity="1"/></joint>'
        )
        parent = f"{name}_link"
    return (
        f'{text}<link name="tip"/><joint name="tip" type="fixed"><parent link="{parent}"/><child link="tip"/>'
        '<origin xyz="0 0 0.15"/></joint></robot>'
    )


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("models")
    for name, text in (("small.xml", mjcf()), ("small.urdf", urdf())):
        (folder / name).write_text(text)
    return {path.suffix: path for path in folder.iterdir()}


def kinematics(path: Path, base_z_m: float = 0.0) -> Kinematics:
    return Kinematics(load_arm_model(path, JOINTS, tool="tip", base_z_m=base_z_m), HOME, JOINTS)


@given(st.lists(st.floats(-2.9, 2.9), min_size=4, max_size=4))
def test_either_file_says_the_same_and_needs_no_meshes(files: dict[str, Path], q: list[float]) -> None:
    poses = [kinematics(path).hand_pose(np.array(q)) for path in files.values()]
    np.testing.assert_allclose(poses[0], poses[1], atol=1e-9)


def test_joints_are_in_the_order_they_were_named(files: dict[str, Path]) -> None:
    backwards = Kinematics(load_arm_model(files[".xml"], JOINTS, tool="tip"), HOME[::-1], JOINTS[::-1])
    forwards = kinematics(files[".xml"])
    np.testing.assert_allclose(backwards.hand_pose(HOME[::-1]), forwards.hand_pose(HOME), atol=1e-12)
    target = ToolPose(0.2, 0.0, 0.12, forwards.tool_pose(HOME).yaw)
    np.testing.assert_allclose(
        backwards.line(HOME[::-1], target)[:, ::-1], forwards.line(HOME, target), atol=1e-6
    )


def test_the_tool_sits_in_its_frame_as_in_urdf(files: dict[str, Path]) -> None:
    plain = load_arm_model(files[".urdf"], JOINTS, tool="tip")
    moved = load_arm_model(
        files[".urdf"], JOINTS, tool="tip", tool_xyz_m=(0.01, 0.02, 0.03), tool_rpy_rad=(0.1, 0.2, 0.3)
    )
    tip, tool = (Kinematics(model, HOME, JOINTS).hand_pose(HOME) for model in (plain, moved))
    np.testing.assert_allclose(tool[:3, 3] - tip[:3, 3], tip[:3, :3] @ [0.01, 0.02, 0.03], atol=1e-9)
    turn = tip[:3, :3].T @ tool[:3, :3]
    np.testing.assert_allclose(
        turn[2], [-np.sin(0.2), np.cos(0.2) * np.sin(0.1), np.cos(0.2) * np.cos(0.1)], atol=1e-9
    )


def test_a_pedestal_raises_everything(files: dict[str, Path]) -> None:
    for path in files.values():
        low, high = (kinematics(path, base_z_m).hand_pose(HOME) for base_z_m in (0.0, 0.3))
        np.testing.assert_allclose(high[:3, 3] - low[:3, 3], [0, 0, 0.3], atol=1e-12)


def test_an_arm_that_cannot_turn_its_tool_says_so(files: dict[str, Path]) -> None:
    arm = kinematics(files[".urdf"])
    here = arm.tool_pose(HOME)
    np.testing.assert_allclose(arm.hand_pose(HOME), hand_matrix(here), atol=1e-9)
    nearer = ToolPose(here.x - 0.03, here.y, here.z - 0.03, here.yaw)
    np.testing.assert_allclose(arm.tool_pose(arm.line(HOME, nearer)[-1]).xyz, nearer.xyz, atol=5e-4)
    with pytest.raises(ReachError, match="pointing down at yaw"):
        arm.line(HOME, ToolPose(nearer.x, nearer.y, nearer.z, here.yaw + 0.5))


def test_a_joint_that_is_not_there_is_named_with_those_that_are(files: dict[str, Path]) -> None:
    with pytest.raises(BaggieError, match="no joint 'elbow2'; it has pan, lift, elbow, wrist"):
        load_arm_model(files[".urdf"], ["pan", "elbow2"], tool="tip")


def test_a_file_that_is_no_model_is_refused(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text("<html/>")
    with pytest.raises(BaggieError, match=r"arm\.xml is no model of an arm") as raised:
        load_arm_model(tmp_path / "arm.xml", ["pan"], tool="tip")
    assert "\n" not in str(raised.value)
