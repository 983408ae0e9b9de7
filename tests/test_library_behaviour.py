"""What our code takes for granted about libraries, where no other test would notice a change.

`docs/library-behaviour.md` has the list, with versions.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import huggingface_hub.constants
import imageio_ffmpeg
import mujoco
import numpy as np
import pyarrow as pa
import pytest
import torch
from torch.utils.tensorboard import SummaryWriter

from baggie.data.dataset import _numeric
from baggie.errors import DataError
from baggie.evaluation.marked_pictures import save_mp4
from baggie.policies import checkpoint
from baggie.policies import learned as weights
from baggie.report.report import _scalars
from baggie.sim.arm_world import upward_touch
from baggie.types import Intrinsics

SOFT = """
<mujoco>
  <option timestep="0.002" integrator="discrete" solver="CG"/>
  <worldbody>
    <geom name="table" type="box" size="1 1 0.1" pos="0 0 -0.1"/>
    <flexcomp name="bag" type="grid" dim="3" count="3 3 2" spacing="0.04 0.04 0.03" pos="0 0 0.02" mass="0.2"
              dof="trilinear">
      <elasticity young="3000" poisson="0.2" damping="0.02" yield="0.02"/>
      <contact selfcollide="none" condim="3" solref="0.01 1"/>
    </flexcomp>
    <body name="plate" pos="0 0 0.09">
      <freejoint/>
      <geom type="box" size="0.03 0.03 0.005" mass="0.5"/>
      <site name="under"/>
    </body>
  </worldbody>
  <sensor><force site="under"/></sensor>
</mujoco>
"""


@pytest.fixture
def pressed() -> tuple[mujoco.MjModel, mujoco.MjData]:
    """A soft thing with a plate on top, two seconds later."""
    model = mujoco.MjModel.from_xml_string(SOFT)
    data = mujoco.MjData(model)
    for _ in range(1000):
        mujoco.mj_step(model, data)
    return model, data


def test_a_state_to_go_on_from_has_the_dents(pressed: tuple[mujoco.MjModel, mujoco.MjData]) -> None:
    model, data = pressed
    assert np.abs(data.plastic).max() > 0
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    state = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, state, kind)
    other = mujoco.MjData(model)
    mujoco.mj_setState(model, other, state, kind)
    for each in (data, other):
        for _ in range(20):
            mujoco.mj_step(model, each)
    np.testing.assert_array_equal(other.flexvert_xpos, data.flexvert_xpos)
    np.testing.assert_array_equal(other.plastic, data.plastic)


def test_contacts_with_a_soft_thing_have_no_geom_on_its_side_and_bear_the_weight(
    pressed: tuple[mujoco.MjModel, mujoco.MjData],
) -> None:
    model, data = pressed
    assert data.ncon
    assert {tuple(sorted(pair)) for pair in data.contact.geom[: data.ncon].tolist()} == {(-1, 0), (-1, 1)}
    plate, everything = model.body("plate").id, {0}
    assert upward_touch(model, data, {plate}) == pytest.approx(0.5 * 9.81, rel=0.05)
    assert upward_touch(model, data, everything) == pytest.approx(-0.7 * 9.81, rel=0.05)


@pytest.mark.parametrize("turned", [0, 10, 45, 80])
def test_a_rectangle_of_least_area_is_turned_modulo_a_quarter_and_measured_between_pixels(
    turned: float,
) -> None:
    points = cv2.boxPoints(((200.0, 150.0), (80.0, 40.0), turned))
    (u, v), sides, angle = cv2.minAreaRect(points)
    assert (u, v, *sorted(sides)) == pytest.approx((200, 150, 40, 80), abs=1e-3)
    assert (angle - turned + 45) % 90 - 45 == pytest.approx(0, abs=1e-3)
    square = np.zeros((50, 50), np.uint8)
    square[10:20, 10:20] = 1
    outline, _ = cv2.findContours(square, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    assert cv2.minAreaRect(outline[0])[1] == pytest.approx((9, 9), abs=1e-3)


def test_a_strong_lens_is_undone_up_to_the_corners() -> None:
    matrix = np.array([[720.0, 0, 639.5], [0, 720, 359.5], [0, 0, 1]])
    lens = Intrinsics(1280, 720, matrix, np.array([-0.35, 0.1, 0, 0, 0]))
    u, v = np.meshgrid(np.linspace(0, 1279, 9), np.linspace(0, 719, 7))
    pixels = np.c_[u.ravel(), v.ravel()]
    rays = lens.rays(pixels)
    np.testing.assert_allclose(lens.project(np.c_[rays, np.ones(len(rays))]), pixels, atol=1e-3)


def test_what_is_not_quite_flat_has_no_planar_pose() -> None:
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(-0.1, 0.1, 5), np.linspace(-0.1, 0.1, 4)))
    bent = np.column_stack([x, y, 3e-3 * (1 - (x / 0.1) ** 2)])
    lens = Intrinsics(640, 480, np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]]), np.zeros(5))
    pixels = lens.project(bent + np.array([0.02, 0.01, 0.5]))
    found = [
        cv2.solvePnPGeneric(points, pixels, lens.matrix, lens.distortion, flags=cv2.SOLVEPNP_IPPE)[0]
        for points in (bent, bent * [1.0, 1.0, 0.0])
    ]
    assert found == [0, 2]


def test_all_points_of_a_long_curve_are_read(tmp_path: Path) -> None:
    with SummaryWriter(str(tmp_path)) as board:
        for step in range(10_500):
            board.add_scalar("loss", step / 4, step)
    steps, values = _scalars(tmp_path)["loss"]
    np.testing.assert_array_equal(steps, np.arange(10_500))
    np.testing.assert_array_equal(values, steps / 4)


def test_lists_of_a_fixed_size_keep_their_place_beside_nulls_and_in_slices() -> None:
    column = pa.array([[1.0, 2.0], None, [3.0, 4.0], None, [5.0, 6.0]], pa.list_(pa.float64(), 2))
    nothing = [np.nan, np.nan]
    np.testing.assert_array_equal(_numeric(column), [[1, 2], nothing, [3, 4], nothing, [5, 6]])
    np.testing.assert_array_equal(_numeric(column.slice(1, 3)), [nothing, [3, 4], nothing])


def test_weights_are_kept_however_they_lie_in_memory(tmp_path: Path) -> None:
    turned = torch.arange(24.0).reshape(1, 2, 3, 4).to(memory_format=torch.channels_last)
    weights.write_tensors(tmp_path, {"policy": "p"}, {"turned": turned, "part": turned[..., 1:]})
    read = weights.read_tensors(tmp_path, "p")
    assert torch.equal(read["turned"], turned)
    assert torch.equal(read["part"], turned[..., 1:])


def test_a_hub_that_cannot_be_asked_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(huggingface_hub.constants, "HF_HUB_OFFLINE", True)
    monkeypatch.setattr(huggingface_hub.constants, "HF_HUB_CACHE", str(tmp_path))
    with pytest.raises(DataError, match="could not be downloaded from the Hub") as refused:
        checkpoint.fetch("nobody/nothing")
    assert "\n" not in str(refused.value)


def test_a_film_keeps_its_size_and_colours(tmp_path: Path) -> None:
    picture = np.full((142, 250, 3), (196, 40, 44), np.uint8)
    save_mp4(tmp_path / "film.mp4", [picture] * 5)
    frames = imageio_ffmpeg.read_frames(str(tmp_path / "film.mp4"))
    assert next(frames)["size"] == (250, 142)
    seen = np.frombuffer(next(frames), np.uint8).reshape(142, 250, 3)
    np.testing.assert_allclose(seen.mean(axis=(0, 1)), (196, 40, 44), atol=3)
