"""A bump shows in the background; new light, noise, bags and a covering hand do not pass for one."""

import math
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from baggie.errors import BaggieError
from baggie.geometry import FloatArray
from baggie.types import Image
from baggie.vision.drift import Landmarks, Shift, Template, local_contrast
from baggie.workcell.simulated import SimulatedWorkcell

SIZE = (1280, 720)
few = settings(deadline=None, max_examples=12)
ALARM_PX = 0.3


def table() -> Image:
    """Wood with long grain, scratches and stains, up to its edge; 100 pixels larger than a picture on every side."""
    rng = np.random.default_rng(0)
    width, height = SIZE[0] + 200, SIZE[1] + 200
    grain = cv2.resize(
        rng.normal(0, 6, (height // 60, width // 4)), (width, height), interpolation=cv2.INTER_CUBIC
    )
    wood = 130 + grain + cv2.GaussianBlur(rng.normal(0, 12, (height, width)), (0, 0), 2)
    wood += 60 * cv2.GaussianBlur(rng.normal(0, 12, (height, width)), (0, 0), 25)
    cv2.fillPoly(wood, [np.array([[0, 0], [190, 0], [230, height], [0, height]])], 60.0)
    for u, v, angle in rng.uniform([0, 0, 0], [width, height, np.pi], (40, 3)):
        end = (int(u + 60 * math.cos(angle)), int(v + 60 * math.sin(angle)))
        cv2.line(wood, (int(u), int(v)), end, 90.0, 2, cv2.LINE_AA)
    return np.clip(wood[..., None] * [1.0, 0.93, 0.8], 0, 255).astype(np.uint8)


TABLE = table()


def picture(
    seed: int, motion: FloatArray | None = None, gain: float = 1.0, bag: tuple[int, int] | None = None
) -> Image:
    """What the camera sees, with the background moved by a `motion` `(3, 3)` of pixels."""
    crop = np.array([[1.0, 0, 100], [0, 1, 100], [0, 0, 1]])
    matrix = crop @ np.linalg.inv(np.eye(3) if motion is None else motion)
    seen = cv2.warpPerspective(TABLE, matrix, SIZE, flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP).astype(
        float
    )
    if bag:
        cv2.rectangle(seen, bag, (bag[0] + 130, bag[1] + 130), (190, 40, 40), -1)
    rng = np.random.default_rng(seed)
    seen = seen * gain * rng.normal(1, 0.025, 3) + rng.normal(0, 2.3, seen.shape)
    return np.clip(seen, 0, 255).astype(np.uint8)


def shifted(du: float, dv: float) -> FloatArray:
    return np.array([[1.0, 0, du], [0, 1, dv], [0, 0, 1]])


REFERENCE = picture(0, bag=(300, 200))
LANDMARKS = Landmarks.find(REFERENCE)


@given(du=st.floats(-8, 8), dv=st.floats(-8, 8), gain=st.floats(0.85, 1.15), seed=st.integers(1, 10**6))
@few
def test_a_shift_is_measured_whatever_the_light_and_wherever_the_bag(
    du: float, dv: float, gain: float, seed: int
) -> None:
    shift = LANDMARKS.shift(picture(seed, shifted(du, dv), gain, bag=(200 + seed % 900, 100 + seed % 450)))
    assert shift.trusted
    # Fractions of a pixel at a third of the size are drawn towards the nearest half: up to 0.2 of the picture's own.
    assert shift.px == pytest.approx(math.hypot(du, dv), abs=0.25, rel=0.12)
    assert np.allclose(shift.corners_px, [du, dv], atol=0.5)


@given(gain=st.floats(0.85, 1.15), seed=st.integers(1, 10**6), bags=st.integers(0, 8))
@few
def test_nothing_moved_but_bags_and_light(gain: float, seed: int, bags: int) -> None:
    seen = picture(seed, gain=gain, bag=(200 + seed % 900, 100 + seed % 450))
    for corner in np.random.default_rng(seed).uniform([0, 0], [1150, 590], (bags, 2)).astype(int):
        cv2.rectangle(seen, corner.tolist(), (corner + 120).tolist(), (40, 60, 160), -1)
    shift = LANDMARKS.shift(seen)
    assert shift.trusted
    assert shift.px < 0.15


@pytest.mark.parametrize("turn_deg", [0.1, 1.0, 6.0])
def test_a_roll_moves_the_corners_most(turn_deg: float) -> None:
    matrix = np.vstack([cv2.getRotationMatrix2D((639.5, 359.5), turn_deg, 1.0), [0, 0, 1]])
    shift = LANDMARKS.shift(picture(1, matrix))
    corner_px = 2 * math.sin(math.radians(turn_deg) / 2) * math.hypot(640, 360)
    assert shift.trusted
    assert np.linalg.norm(shift.corners_px, axis=1) == pytest.approx(corner_px, abs=0.3 + 0.01 * corner_px)
    assert ALARM_PX < shift.px < corner_px


def test_a_far_move_is_found_from_coarse_to_fine() -> None:
    shift = LANDMARKS.shift(picture(1, shifted(55, -40)))
    assert shift.trusted
    assert shift.px == pytest.approx(math.hypot(55, 40), abs=0.2)


def test_what_is_covered_or_dark_or_elsewhere_is_not_trusted() -> None:
    covered = picture(1)
    covered[:, :800] = (120, 90, 70)
    elsewhere = np.ascontiguousarray(picture(1)[::-1])
    for unknown in (covered, np.zeros_like(covered), elsewhere):
        shift = LANDMARKS.shift(unknown)
        assert not shift.trusted
        assert shift.inliers < shift.total / 2
        assert shift.px == math.inf


def test_a_third_covered_is_trusted() -> None:
    covered = picture(1, shifted(2, 1))
    covered[:, :420] = (120, 90, 70)
    shift = LANDMARKS.shift(covered)
    assert shift.trusted
    assert shift.px == pytest.approx(math.hypot(2, 1), abs=0.2)


def test_a_picture_against_itself_and_from_its_file(tmp_path: Path) -> None:
    """Nothing but the reference picture needs to be kept."""
    assert LANDMARKS.shift(REFERENCE).px < 1e-6
    cv2.imwrite(str(tmp_path / "reference.png"), REFERENCE[..., ::-1])
    again = Landmarks.find(np.asarray(cv2.imread(str(tmp_path / "reference.png"))[..., ::-1], np.uint8))
    seen = picture(3, shifted(1, 1))
    assert again.shift(seen).px == LANDMARKS.shift(seen).px
    assert np.array_equal(again.points, LANDMARKS.points)


def test_landmarks_are_all_over_the_picture_but_not_where_nothing_is() -> None:
    half = picture(0)
    half[:, 640:] = 128
    points = Landmarks.find(half).points
    assert ((points > 0) & (points < SIZE)).all()
    assert points[:, 0].max() < 680
    assert (np.histogram(LANDMARKS.points[:, 0], 8, (0, SIZE[0]))[0] > 20).all()


def test_bad_input_is_refused_in_one_line() -> None:
    for plain in (np.full((720, 1280, 3), 128, np.uint8), np.zeros((20, 20, 3), np.uint8)):
        with pytest.raises(BaggieError, match="something to see") as caught:
            Landmarks.find(plain)
        assert "\n" not in str(caught.value)
    with pytest.raises(BaggieError, match="640 x 360"):
        LANDMARKS.shift(np.zeros((360, 640, 3), np.uint8))


@given(du=st.floats(-3, 3), dv=st.floats(-3, 3))
@few
def test_aligning_undoes_a_motion(du: float, dv: float) -> None:
    """Without noise, to less than a tenth of a pixel where there is something to see."""
    still = local_contrast(cv2.GaussianBlur(TABLE, (0, 0), 4), 400)
    moved = cv2.warpPerspective(still, shifted(du, dv), still.shape[::-1], flags=cv2.INTER_CUBIC)
    template = Template(still)
    found = template.align(moved)
    assert np.median(found.correlation) > 0.99
    assert np.median(template.moved_px(np.linalg.inv(shifted(du, dv)) @ found.motion)) < 0.1


@pytest.mark.parametrize("number", [0, pytest.param(9, marks=pytest.mark.slow)])
def test_the_simulated_camera_is_bumped(number: int) -> None:
    """Ordinary pictures are below the alarm, a turn of a tenth of a degree is above; 9 has the plainest grain."""
    cell = SimulatedWorkcell(number)
    try:
        landmarks = Landmarks.find(cell.look().color)

        def look(seed: int) -> Shift:
            cell.reset((seed,))
            return landmarks.shift(cell.look().color)

        assert max(look(seed).px for seed in range(3)) < ALARM_PX
        cell.bump_camera((0.0, 0.0, 0.0), (0.0, math.radians(0.1), 0.0))
        assert look(3).px > 2 * ALARM_PX
        cell.bump_camera((0.0, 0.0, 0.0), (0.0, -math.radians(0.1), 0.0))
        assert look(4).px < ALARM_PX
    finally:
        cell.close()
