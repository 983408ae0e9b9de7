from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from baggie.errors import BaggieError, ReachError
from baggie.geometry import (
    FloatArray,
    PlanarPose,
    ToolPose,
    difference,
    from_vector,
    hand_matrix,
    rigid,
    transform_points,
)
from baggie.robot.arm import LedArm, hand_pose
from baggie.robot.franka.models import HOME
from baggie.robot.kinematics import Kinematics
from baggie.robot.limits import GuardedArm
from baggie.sim.printed import SHEET_SIZE_M, SHEET_TEXTURE, T_sheet_target, texture
from baggie.sim.renderer import CameraRenderer
from baggie.sim.scene import arm_spec
from baggie.sim.sensor import Exposure
from baggie.vision.targets import ArucoMarker, Charuco, Chessboard, Target, parse_target, pattern
from baggie.workcell.simulated import SimulatedWorkcell
from baggie.workcell.workcell import WorkcellSettings
from helpers.recording_arm import RecordingArm

CHESSBOARD = Chessboard(7, 4, 0.035)
CHARUCO = Charuco(7, 5, 0.03, 0.021, "DICT_4X4_50")
MARKER = ArucoMarker("DICT_4X4_50", 7, 0.06)
FACING_UP = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])  # x to the right in the picture


@pytest.fixture(scope="module")
def cell() -> Iterator[SimulatedWorkcell]:
    cell = SimulatedWorkcell(0)
    yield cell
    cell.close()


@pytest.fixture
def clear(cell: SimulatedWorkcell) -> SimulatedWorkcell:
    """The cell with arm and bag out of the way."""
    cell.reset((1,))
    cell.world.put("bag", PlanarPose(0.5, 0.8), undented=True)
    return cell


def around(middle: tuple[float, float, float], turn: FloatArray, target: Target) -> FloatArray:
    """`T_base_target` that has the middle of the print there."""
    rotation = turn @ FACING_UP
    return rigid(rotation, middle - rotation @ [*pattern(target).middle, 0.0])


def off_px(cell: SimulatedWorkcell, target: Target, T_base_target: FloatArray) -> FloatArray:
    """`(N, 2)`: how far from the truth its points are detected."""
    seen = target.detect(cell.camera.look().color)
    assert seen is not None
    assert len(seen.ids) > 0.7 * len(target.points)
    return seen.pixels - cell.world.cell.project(transform_points(T_base_target, seen.points))


def rms(error: FloatArray) -> float:
    return float(np.sqrt((error**2).sum(axis=1).mean()))


# -- the picture on the sheet ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("target", "scale"), [(CHARUCO, 1.0), (CHARUCO, 1.013), (CHESSBOARD, 0.99)])
def test_a_texture_has_the_targets_points_where_they_should_be(target: Target, scale: float) -> None:
    seen = target.detect(texture(target, SHEET_SIZE_M, SHEET_TEXTURE, scale))
    assert seen is not None
    assert len(seen.ids) == len(target.points)
    in_sheet = transform_points(T_sheet_target(target, scale), scale * seen.points)[:, :2]
    pixels = (in_sheet / SHEET_SIZE_M + 0.5) * SHEET_TEXTURE[::-1] - 0.5
    np.testing.assert_allclose(seen.pixels, pixels, atol=0.1)


@given(st.floats(0.3, 1.3), st.integers(0, 49))
@settings(deadline=None, max_examples=10)
def test_a_texture_has_as_much_ink_as_the_drawing(scale: float, number: int) -> None:
    marker = ArucoMarker("DICT_4X4_50", number, 0.07)
    left, top, right, bottom = pattern(marker).black.T
    area = scale**2 * ((right - left) * (bottom - top)).sum() / (0.12 * 0.09)
    picture = texture(marker, (0.12, 0.1), (200, 300), scale).astype(float)
    ink = ((255 - picture) / (255 - picture.min())).mean() * (0.1 / 0.09)
    assert ink == pytest.approx(area, rel=0.005)


# -- in the camera's pictures ---------------------------------------------------------------------------------------


def test_printed_points_are_seen_where_the_truth_projects_them(clear: SimulatedWorkcell) -> None:
    rng = np.random.default_rng(0)
    errors = []
    for _ in range(4):
        tilt = rng.uniform(0, 0.5) * np.array([np.cos(a := rng.uniform(0, 2 * np.pi)), np.sin(a), 0.0])
        turn = Rotation.from_rotvec(tilt) * Rotation.from_euler("z", rng.uniform(-0.8, 0.8))
        middle = (rng.uniform(0.45, 0.6), rng.uniform(-0.2, 0.2), rng.uniform(0.1, 0.2))
        T_base_target = around(middle, turn.as_matrix(), CHESSBOARD)
        clear.show_target(CHESSBOARD, T_base_target)
        errors.append(off_px(clear, CHESSBOARD, T_base_target))
    error = np.concatenate(errors)
    assert rms(error) < 0.07
    assert np.abs(error).max() < 0.25
    assert np.linalg.norm(error.mean(axis=0)) < 0.03  # no bias


def test_a_board_flat_on_the_table_is_found_to_a_tenth_of_a_pixel(clear: SimulatedWorkcell) -> None:
    T_base_target = around((0.5, 0.05, 0.0), np.eye(3), CHARUCO)
    clear.show_target(CHARUCO, T_base_target)
    assert rms(off_px(clear, CHARUCO, T_base_target)) < 0.12


def test_a_wrongly_printed_target_keeps_its_origin_and_is_too_large(clear: SimulatedWorkcell) -> None:
    T_base_target = around((0.5, 0.0, 0.0), np.eye(3), CHARUCO)
    clear.show_target(CHARUCO, T_base_target, scale=1.02)
    enlarged = T_base_target @ np.diag([1.02, 1.02, 1.02, 1.0])
    assert rms(off_px(clear, CHARUCO, enlarged)) < 0.12
    assert rms(off_px(clear, CHARUCO, T_base_target)) > 1.0


def test_the_plate_is_where_the_hand_holds_it(clear: SimulatedWorkcell) -> None:
    T_hand_target = clear.hold_target(MARKER)
    seen = []
    for pose in (ToolPose(0.45, 0.1, 0.15, 0.2), ToolPose(0.36, -0.25, 0.03), ToolPose(0.55, 0.25, 0.25)):
        clear.lead_hand(hand_matrix(pose))
        seen.append(off_px(clear, MARKER, clear.arm.hand_pose() @ T_hand_target))
    assert rms(np.concatenate(seen)) < 0.4  # OpenCV finds a marker's corners a quarter pixel too far out
    assert np.linalg.norm(np.concatenate(seen).mean(axis=0)) < 0.05


def test_a_hand_that_moves_is_seen_where_its_joints_say(clear: SimulatedWorkcell) -> None:
    clear.lead_hand(rigid(hand_matrix(ToolPose(0.45, -0.1, 0.2, 0.0))[:3, :3], [0.45, -0.1, 0.2]))
    T_hand_target = clear.hold_target(MARKER)
    turned = clear.world.joints + 0.4 * np.eye(7)[0]
    clear.world.set_joints(turned, np.zeros(7))
    clear.world.advance(0.1)
    speed_m_s = 0.58 * clear.world.joint_velocities[0]
    assert speed_m_s > 0.5  # four millimetres a step
    assert off_px(clear, MARKER, hand_pose(clear.arm) @ T_hand_target).max() < 0.3
    clear.hold_target(None)


def test_what_was_hidden_leaves_no_trace(cell: SimulatedWorkcell) -> None:
    cell.reset((2,))
    before = cell.look().color
    cell.show_target(CHARUCO, around((0.5, 0.0, 0.0), np.eye(3), CHARUCO))
    cell.hold_target(MARKER)
    assert not np.array_equal(cell.look().color, before)
    cell.reset((2,))
    np.testing.assert_array_equal(cell.look().color, before)
    cell.show_target(CHARUCO, around((0.5, 0.0, 0.0), np.eye(3), CHARUCO))
    cell.hide_target()
    cell.hold_target(MARKER)
    cell.hold_target(None)
    assert CHARUCO.detect(cell.look().color) is None
    cell.lead_hand(hand_matrix(ToolPose(0.45, 0.1, 0.15)))
    assert MARKER.detect(cell.camera.look().color) is None


def test_every_renderer_sees_what_is_printed_now(clear: SimulatedWorkcell) -> None:
    def sees(renderer: CameraRenderer, target: Target) -> bool:
        picture = renderer.look(Exposure(), np.random.default_rng(0)).color
        return target.detect(picture) is not None

    older = CameraRenderer(clear.world)
    for target in (CHARUCO, ArucoMarker("DICT_4X4_50", 20, 0.1)):
        clear.show_target(target, around((0.5, 0.0, 0.0), np.eye(3), target))
        assert sees(older, target)
    newer = CameraRenderer(clear.world)
    assert sees(newer, target)
    older.close()
    newer.close()


def test_a_target_that_does_not_fit_is_refused_and_nothing_is_shown(clear: SimulatedWorkcell) -> None:
    with pytest.raises(BaggieError, match="420 x 300 mm, and the sheet it is to be shown on 420 x 297 mm"):
        clear.show_target(parse_target("charuco:7x5:0.060:0.042:DICT_4X4_50"), np.eye(4))
    with pytest.raises(BaggieError, match="smaller squares"):
        clear.hold_target(CHARUCO)
    with pytest.raises(BaggieError, match="124 x 93 mm"):
        clear.hold_target(Charuco(4, 3, 0.03, 0.02, "DICT_4X4_50"), scale=1.033)
    assert CHARUCO.detect(clear.look().color) is None


# -- a led arm ------------------------------------------------------------------------------------------------------

tilts = st.tuples(*[st.floats(-0.4, 0.4)] * 3)


@given(st.floats(0.35, 0.55), st.floats(-0.25, 0.25), st.floats(0.1, 0.4), tilts)
@settings(deadline=None, max_examples=15)
def test_reaching_inverts_forward_kinematics_at_any_tilt(
    x: float, y: float, z: float, tilt: tuple[float, float, float]
) -> None:
    pose = rigid(Rotation.from_rotvec(tilt).as_matrix(), np.zeros(3)) @ hand_matrix(ToolPose(0, 0, 0, 0.2))
    pose[:3, 3] = x, y, z
    off_m, off_rad = difference(KINEMATICS.hand_pose(KINEMATICS.reach(HOME, pose)), pose)
    assert off_m < 0.0005
    assert off_rad < 0.002


KINEMATICS = Kinematics(arm_spec().compile(), HOME)


def test_the_hands_frame_points_down_and_agrees_with_the_tools_pose() -> None:
    tool = KINEMATICS.tool_pose(HOME)
    off_m, off_rad = difference(KINEMATICS.hand_pose(HOME), hand_matrix(tool))
    assert off_m < 1e-9
    assert off_rad < 0.01  # at home the tool points down but for half a degree
    np.testing.assert_allclose(hand_matrix(tool)[:3, 2], [0, 0, -1])
    np.testing.assert_allclose(hand_matrix(ToolPose(0, 0, 0, np.pi / 2))[:3, 0], [0, 1, 0], atol=1e-12)


def test_a_led_arm_is_where_it_was_led_and_then_works_as_ever(clear: SimulatedWorkcell) -> None:
    wanted = hand_matrix(ToolPose(0.45, 0.1, 0.25, 0.3)) @ from_vector([0.3, -0.25, 0.1, 0, 0, 0])
    reached = clear.lead_hand(wanted)
    assert isinstance(clear.arm, LedArm)
    np.testing.assert_allclose(clear.arm.hand_pose(), reached)
    assert difference(reached, wanted) < (0.0005, 0.002)
    clear.world.advance(0.5)
    assert difference(clear.arm.hand_pose(), reached)[0] < 0.001  # it stays there
    target = ToolPose(0.5, -0.1, 0.2, -0.3)
    clear.arm.move_to(target, 0.3)
    off_m, off_rad = difference(clear.arm.hand_pose(), hand_matrix(target))
    assert off_m < 0.002
    assert off_rad < 0.01
    parked = clear.arm.park()
    clear.lead_hand(wanted)
    assert np.linalg.norm(clear.arm.park().xyz - parked.xyz) < 0.002


def test_where_the_arm_cannot_be_led_it_is_left_alone(clear: SimulatedWorkcell) -> None:
    before = clear.arm.hand_pose()
    with pytest.raises(ReachError, match=r"x 1\.100, .* choose a place nearer"):
        clear.lead_hand(hand_matrix(ToolPose(1.1, 0.0, 0.2)))
    np.testing.assert_array_equal(clear.arm.hand_pose(), before)


def test_an_arm_that_cannot_be_led_points_straight_down() -> None:
    arm = RecordingArm()
    led = GuardedArm(arm, WorkcellSettings().limits)
    np.testing.assert_array_equal(led.hand_pose(), hand_matrix(arm.pose()))


# -- bumps ----------------------------------------------------------------------------------------------------------


def test_after_a_bump_the_camera_sees_from_where_the_cell_says_it_is(clear: SimulatedWorkcell) -> None:
    T_base_target = around((0.5, 0.0, 0.0), np.eye(3), CHARUCO)
    clear.show_target(CHARUCO, T_base_target)
    untouched = clear.world.cell
    shift, turn = np.array([0.01, -0.02, 0.005]), np.array([0.02, -0.01, 0.03])
    clear.bump_camera(shift, turn)
    bumped = clear.world.cell
    np.testing.assert_allclose(bumped.camera_position, untouched.camera_position + shift)
    seen_turn = untouched.camera_rotation.T @ bumped.camera_rotation
    np.testing.assert_allclose(Rotation.from_matrix(seen_turn).as_rotvec(), turn, atol=1e-9)
    moved = np.abs(bumped.project(T_base_target[None, :3, 3]) - untouched.project(T_base_target[None, :3, 3]))
    assert moved.max() > 5.0
    assert rms(off_px(clear, CHARUCO, T_base_target)) < 0.12
    clear.reset((1,))
    clear.show_target(CHARUCO, T_base_target)
    assert rms(off_px(clear, CHARUCO, T_base_target)) < 0.12  # for good
    clear.bump_camera(-shift, -turn)
    np.testing.assert_allclose(clear.world.cell.T_camera_base, untouched.T_camera_base, atol=1e-12)
    assert rms(off_px(clear, CHARUCO, T_base_target)) < 0.12


def test_after_a_bump_everything_on_the_table_has_moved_along_and_the_arm_has_not(
    cell: SimulatedWorkcell,
) -> None:
    cell.reset((3,))
    motion = PlanarPose(0.02, -0.03, 0.1)
    bag, hand = cell.truth(), cell.arm.hand_pose()
    top = cell.world.model.geom("table_top").pos.copy()
    aside = (0.5, -0.15 if bag.y > 0 else 0.15, 0.0)
    T_base_target = around(aside, np.eye(3), MARKER)
    cell.show_target(MARKER, T_base_target)
    cell.bump_table(motion.x, motion.y, motion.yaw)
    expected = motion @ bag
    assert cell.truth().distance(expected) < 1e-6
    assert cell.truth().yaw == pytest.approx(expected.yaw, abs=1e-6)
    T_motion = rigid(Rotation.from_euler("z", motion.yaw).as_matrix(), [motion.x, motion.y, 0.0])
    error = off_px(cell, MARKER, T_motion @ T_base_target)
    assert np.linalg.norm(error.mean(axis=0)) < 0.1
    np.testing.assert_allclose(cell.world.model.geom("table_top").pos[:2], (motion @ PlanarPose(*top[:2])).xy)
    np.testing.assert_array_equal(cell.arm.hand_pose(), hand)
    cell.world.advance(0.5)
    assert cell.truth().distance(expected) < 0.002  # the bag rests as it did
    back = motion.inverse()
    cell.bump_table(back.x, back.y, back.yaw)
    np.testing.assert_allclose(cell.world.model.geom("table_top").pos, top, atol=1e-9)
