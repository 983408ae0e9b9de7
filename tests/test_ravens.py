"""Ravens' folders: what is written is read, broken files are named, and cameras and poses mean what they should."""

from __future__ import annotations

import dataclasses
import errno
import math
import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from baggie.errors import BaggieWarning, DataError
from baggie.geometry import PlanarPose, transform_points
from baggie.ravens.format import (
    RAVENS_CAMERAS,
    RavensAction,
    RavensEpisode,
    RavensFolder,
    RavensPose,
    planar_to_pose,
    pose_to_planar,
    write_episode,
)
from helpers.ravens_folder import FIELDS, NAME, make_episode
from helpers.ravens_scene import STILL


def assert_same(a: RavensEpisode, b: RavensEpisode) -> None:
    for name, value in vars(a).items():
        other = getattr(b, name)
        assert type(other) is type(value)
        if isinstance(value, np.ndarray):
            assert other.dtype == value.dtype
            np.testing.assert_array_equal(other, value)
        else:
            assert other == value


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with one good episode; not to be changed."""
    folder = tmp_path_factory.mktemp("good")
    write_episode(folder, make_episode())
    return folder


@pytest.fixture
def copy(good: Path, tmp_path: Path) -> Path:
    """The same in links, to put other files in the place of."""
    for field in FIELDS:
        (tmp_path / field).mkdir()
        (tmp_path / field / NAME).symlink_to(good / field / NAME)
    return tmp_path


def replace(path: Path, value: object) -> None:
    path.unlink()
    path.write_bytes(pickle.dumps(value))


def refusal(act: Callable[[], object]) -> str:
    with pytest.raises(DataError) as caught:
        act()
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("steps", [0, 2])
def test_what_is_written_is_read(tmp_path: Path, steps: int) -> None:
    episode = make_episode(steps=steps)
    write_episode(tmp_path, episode)
    folder = RavensFolder(tmp_path)
    assert folder.episode_ids == ((3, 9007),)
    assert_same(folder[0], episode)
    assert sorted(path.name for path in tmp_path.iterdir()) == FIELDS


def test_what_is_written_is_what_ravens_stores(good: Path) -> None:
    raw = {field: pickle.loads((good / field / NAME).read_bytes()) for field in FIELDS}
    episode = make_episode()
    action, last = raw["action"]
    assert last is None
    xyz, xyzw = action["pose1"]
    np.testing.assert_array_equal(xyz, episode.actions[0].pose1.xyz)
    np.testing.assert_array_equal(xyzw, episode.actions[0].pose1.xyzw)
    assert raw["reward"] == [0.0, 1.0]
    block = ((0.45, -0.12, 0.019), (0.0, 0.0, 0.0, 1.0), (0.04, 0.04, 0.04))
    assert raw["info"] == [None, {5: block, 6: block}]
    assert type(raw["info"][1][5]) is tuple
    np.testing.assert_array_equal(raw["color"], episode.color)
    np.testing.assert_array_equal(raw["depth"], episode.depth)


def test_files_as_ravens_writes_them_are_read(copy: Path) -> None:
    still, turned = np.array([0, 0, 0, 1]), np.array([0.0, 0.0, 1.0, 0.0])
    xyz = np.array([0.5, 0.3, 0.04])
    replace(copy / "action" / NAME, [{"pose0": (xyz, still), "pose1": (xyz, turned)}, None])
    replace(copy / "reward" / NAME, [0, np.float64(0.25)])
    episode = RavensFolder(copy)[0]
    assert episode.actions == (
        RavensAction(RavensPose((0.5, 0.3, 0.04), STILL), RavensPose((0.5, 0.3, 0.04), (0.0, 0.0, 1.0, 0.0))),
    )
    assert episode.rewards.tolist() == [0, 0.25]
    write_episode(copy / "again", episode)
    assert_same(RavensFolder(copy / "again")[0], episode)


GOOD_POSE = ((0.5, 0.3, 0.04), STILL)
BLOCK = ((0.45, -0.12, 0.019), STILL, (0.04, 0.04, 0.04))


def action_with(**poses: Any) -> list[Any]:
    return [{"pose0": GOOD_POSE, "pose1": GOOD_POSE, **poses}, None]


ENDLESS: Any = 1.0
for _ in range(14):
    ENDLESS = [ENDLESS] * 50  # small as a pickle, and 50¹⁴ numbers to print

WRONG: dict[str, tuple[str, object, str]] = {
    "no list": ("action", 3, "ends in None"),
    "no last None": ("action", action_with()[:1], "ends in None"),
    "None between": ("action", [None, None], "action 0 must be a dict"),
    "one pose": ("action", [{"pose0": GOOD_POSE}, None], "pose0 and pose1"),
    "short pose": ("action", action_with(pose0=((0.5, 0.3, 0.04),)), "pose0 of action 0"),
    "two numbers": ("action", action_with(pose0=((0.5, 0.3), STILL)), "3 finite numbers"),
    "no numbers": ("action", action_with(pose0=(("a", "b", "c"), STILL)), "3 finite numbers"),
    "nan": ("action", action_with(pose1=((0.5, 0.3, math.nan), STILL)), "3 finite numbers"),
    "too big": ("action", action_with(pose1=((0.5, 0.3, 10**400), STILL)), "3 finite numbers"),
    "norm": ("action", action_with(pose1=((0.5, 0.3, 0.04), (0, 0, 1, 1))), "norm 1.414"),
    "text": ("reward", "abc", "finite numbers"),
    "endless": ("reward", ENDLESS, "finite numbers, got a list of 50"),
    "short": ("reward", [0.0], "2 moments are expected"),
    "infinite": ("reward", [0.0, math.inf], "finite numbers"),
    "rows": ("reward", np.zeros((2, 2)), "finite numbers"),
    "a dict": ("info", {}, "expected a list"),
    "long": ("info", [None] * 3, "2 moments are expected"),
    "keys": ("info", [None, {"a": BLOCK}], "whole numbers"),
    "two parts": ("info", [None, {5: BLOCK[:2]}], "object 5 at moment 1"),
    "rotation": ("info", [None, {5: (BLOCK[0], (0, 0, 0, 0), BLOCK[2])}], "norm 0.000"),
    "floats": ("color", np.zeros((2, 3, 480, 640, 3), np.float32), "expected uint8"),
    "small": ("color", np.zeros((2, 3, 48, 64, 3), np.uint8), "(moments, 3, 480, 640, 3)"),
    "flat": ("color", np.zeros(2, np.uint8), "(moments, 3, 480, 640, 3)"),
    "one": ("color", np.zeros((1, 3, 480, 640, 3), np.uint8), "2 moments are expected"),
    "pictures in a list": ("color", [1, 2], "expected an array"),
    "doubles": ("depth", np.zeros((2, 3, 480, 640)), "expected float32"),
    "swapped": ("depth", np.zeros((2, 3, 480, 640), ">f4"), "expected float32"),
    "three": ("depth", np.zeros((3, 3, 480, 640), np.float32), "2 moments are expected"),
    "nan depth": ("depth", np.full((2, 3, 480, 640), np.nan, np.float32), "finite and not negative"),
    "behind": ("depth", np.full((2, 3, 480, 640), -0.1, np.float32), "finite and not negative"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_file_is_named(copy: Path, name: str) -> None:
    field, value, expected = WRONG[name]
    replace(copy / field / NAME, value)
    message = refusal(lambda: RavensFolder(copy)[0])
    assert message.startswith(str(copy / field / NAME))
    assert expected in message
    assert "get the file again, or leave this episode out" in message


@pytest.mark.parametrize("field", FIELDS)
def test_a_file_cut_off_is_named(copy: Path, field: str) -> None:
    path = copy / field / NAME
    content = path.read_bytes()
    path.unlink()
    path.write_bytes(content[:-100])
    message = refusal(lambda: RavensFolder(copy)[0])
    assert message.startswith(f"{path} is cut off or damaged")


@pytest.mark.parametrize("field", FIELDS)
def test_a_hostile_file_runs_nothing(copy: Path, field: str) -> None:
    class Hostile:
        def __reduce__(self) -> tuple[object, ...]:
            return os.mkdir, (str(copy / "canary"),)

    replace(copy / field / NAME, [Hostile()])
    assert f"{os.mkdir.__module__}.mkdir" in refusal(lambda: RavensFolder(copy)[0])
    assert not (copy / "canary").exists()


def test_episodes_are_read_when_asked_for(copy: Path) -> None:
    for field in FIELDS:
        (copy / field / "000010-1.pkl").write_bytes(b"no pickle")
        (copy / field / "000002-99.pkl").symlink_to(copy / field / NAME)
        (copy / field / "notes.txt").touch()
    with pytest.warns(BaggieWarning, match="notes.txt and 4 more"):
        folder = RavensFolder(copy)
    assert folder.episode_ids == ((2, 99), (3, 9007), (10, 1))
    assert len(folder) == 3
    assert (folder[-2].number, folder[-2].seed) == (3, 9007)
    episodes = iter(folder)
    assert [next(episodes).number, next(episodes).number] == [2, 3]
    assert "000010-1.pkl" in refusal(lambda: next(episodes))
    with pytest.raises(IndexError):
        folder[3]


def test_what_is_no_such_folder_is_named(copy: Path) -> None:
    assert str(copy / "action" / "action") in refusal(lambda: RavensFolder(copy / "action"))
    (copy / "color" / NAME).rename(copy / "color" / "3-9007.pkl")
    with pytest.warns(BaggieWarning, match="color/3-9007.pkl"):
        assert f"{copy / 'color' / NAME} is missing" in refusal(lambda: RavensFolder(copy))


def test_nothing_wrong_is_written_and_nothing_overwritten(good: Path, tmp_path: Path) -> None:
    episode = make_episode()
    for wrong in (
        dataclasses.replace(episode, depth=episode.depth - 2),
        dataclasses.replace(episode, rewards=episode.rewards[1:]),
        dataclasses.replace(episode, color=episode.color[..., :2]),
    ):
        refusal(lambda wrong=wrong: write_episode(tmp_path / "new", wrong))
    assert not (tmp_path / "new").exists()
    before = (good / "color" / NAME).stat()
    assert "is there already" in refusal(lambda: write_episode(good, episode))
    assert (good / "color" / NAME).stat() == before


def test_a_full_disk_leaves_no_part_of_an_episode(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    assert "free some space" in refusal(lambda: write_episode(tmp_path, make_episode()))
    assert list(tmp_path.rglob("*")) == []


lengths, angles = st.floats(-1, 1), st.floats(-math.pi, math.pi)


@given(st.builds(PlanarPose, lengths, lengths, angles), lengths)
def test_planar_poses_come_back(pose: PlanarPose, z: float) -> None:
    there = planar_to_pose(pose, z)
    assert there.xyz == (pose.x, pose.y, z)
    np.testing.assert_allclose(
        Rotation.from_quat(there.xyzw).as_matrix()[:2, :2], pose.matrix()[:2, :2], atol=1e-12
    )
    for sign in (1, -1):  # a quaternion and its negative are the same rotation
        x, y, z_, w = (sign * part for part in there.xyzw)
        back = pose_to_planar(RavensPose(there.xyz, (x, y, z_, w)))
        np.testing.assert_allclose(back.matrix(), pose.matrix(), atol=1e-12)


@given(angles, angles, st.floats(0, math.pi))
def test_tilted_poses_are_refused(yaw: float, about: float, tilt: float) -> None:
    axis = [math.cos(about), math.sin(about), 0]
    tilted = Rotation.from_rotvec(np.multiply(tilt, axis)) * Rotation.from_euler("z", yaw)
    x, y, z, w = tilted.as_quat().tolist()
    pose = RavensPose((0.5, 0.1, 0.02), (x, y, z, w))
    if tilt > 0.021:
        assert f"{math.degrees(tilt):.1f} degrees" in refusal(lambda: pose_to_planar(pose))
    elif tilt < 0.019:
        back = pose_to_planar(pose)
        assert math.cos(back.yaw - yaw) > 1 - 1e-9


BLOCK_POSITION = (0.6999997961315929, -0.12500232404015965, 0.018989499086073777)
BLOCK_ROTATION = (8.57870071536204e-06, 4.888538552598764e-06, 0.9979278309282269, 0.06434317494025579)
SEEN = [  # camera, pixel, depth, which of the block's axes and which of its two ends
    (0, (239, 440), 0.7149, 0, -1),
    (0, (254, 430), 0.7244, 1, -1),
    (0, (241, 422), 0.7157, 2, 1),
    (1, (304, 147), 1.1517, 0, 1),
    (1, (293, 147), 1.1537, 1, -1),
    (1, (299, 137), 1.1477, 2, 1),
    (2, (412, 195), 1.0403, 0, 1),
    (2, (424, 196), 1.0370, 1, 1),
    (2, (420, 185), 1.0337, 2, 1),
]
"""Nine points of the faces of one block that lies free, out of pictures that Ravens made, with the pose it tells."""


def test_all_cameras_see_the_block_where_it_is() -> None:
    errors = []
    for camera, pixel, depth, axis, end in SEEN:
        intrinsics, T_base_camera = RAVENS_CAMERAS[camera]
        ray = np.append(intrinsics.rays(np.array([pixel], float))[0], 1.0)
        point = transform_points(T_base_camera, depth * ray) - np.array(BLOCK_POSITION)
        on_block = Rotation.from_quat(BLOCK_ROTATION).inv().apply(point)[0]
        errors.append(end * on_block[axis] - 0.02)
        assert (np.abs(np.delete(on_block, axis)) < 0.02).all()
    # A principal point of (320, 240) gives 0.8 mm.
    assert np.sqrt(np.mean(np.square(errors))) < 0.3e-3
