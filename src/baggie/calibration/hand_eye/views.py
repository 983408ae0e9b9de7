"""What hand-eye calibration starts from: where the hand was, and where the camera saw the board."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from baggie.calibration.files import CameraIdentity, read_views_file
from baggie.calibration.pose import fit_pose
from baggie.errors import CalibrationError, DataError
from baggie.geometry import FloatArray, invert_transform
from baggie.pictures import read_picture
from baggie.types import Image, Intrinsics
from baggie.vision.corners import FLAT, Sag
from baggie.vision.targets import Target, TargetDetection, parse_target, with_sag

Mount = Literal["hand", "fixed"]
"""Where the camera is: on the hand, with the board fixed in the world, or fixed, with the board on the hand."""

_METRES = {"m": 1.0, "mm": 1e-3}
_FAR_M = 10.0
_NEAR_M = 0.01
_ORTHONORMAL = 1e-2


@dataclass(frozen=True)
class HandEyeViews:
    """N views of one board, camera or board on the hand. Raises `CalibrationError` for poses that are none."""

    mount: Mount
    T_base_hand: FloatArray
    """`(N, 4, 4)`, metres."""
    T_camera_board: FloatArray
    """`(N, 4, 4)`, metres."""
    names: tuple[str, ...]
    """N of them: the picture, or the view's number."""
    seen: tuple[TargetDetection, ...] | None = None
    """The board's corners in each picture; None where only its poses are known."""
    intrinsics: Intrinsics | None = None
    intrinsics_covariance: FloatArray | None = None
    """`(4 + D, 4 + D)` of fx, fy, cx, cy and the distortion, where it is known."""
    camera: CameraIdentity | None = None
    dropped: tuple[tuple[str, str], ...] = ()
    """Views without a pose of the board: name and why."""

    def __post_init__(self) -> None:
        for words in ("T_base_hand", "T_camera_board"):
            poses = [
                checked_pose(pose, words, name)
                for pose, name in zip(getattr(self, words), self.names, strict=True)
            ]
            object.__setattr__(self, words, np.array(poses).reshape(-1, 4, 4))

    @classmethod
    def from_seen(
        cls,
        mount: Mount,
        T_base_hand: Sequence[ArrayLike],
        seen: Sequence[TargetDetection | FloatArray | str | None],
        intrinsics: Intrinsics,
        *,
        intrinsics_covariance: FloatArray | None = None,
        names: Sequence[str] | None = None,
        camera: CameraIdentity | None = None,
    ) -> HandEyeViews:
        """From N poses of the hand `(4, 4)` and what was seen of the board from there.

        That is its corners; or its pose `(4, 4)`, where only that is known; or why it was not found, in words or None.
        """
        names = [f"view {i}" for i in range(len(seen))] if names is None else names
        kept: list[tuple[str, FloatArray, FloatArray, TargetDetection | None]] = []
        dropped = []
        for name, hand, found in zip(names, T_base_hand, seen, strict=True):
            if found is None or isinstance(found, str):
                dropped.append((name, found or "the board is not seen"))
            elif isinstance(found, TargetDetection):
                try:
                    board = fit_pose(found.points, found.pixels, intrinsics).pose.transform
                    kept.append((name, np.asarray(hand, float), board, found))
                except CalibrationError as error:
                    dropped.append((name, str(error)))
            else:
                kept.append((name, np.asarray(hand, float), found, None))
        corners = tuple(found for *_, found in kept if found is not None)
        return cls(
            mount,
            np.array([hand for _, hand, _, _ in kept]).reshape(-1, 4, 4),
            np.array([board for _, _, board, _ in kept]).reshape(-1, 4, 4),
            tuple(name for name, *_ in kept),
            corners if len(corners) == len(kept) else None,
            intrinsics,
            intrinsics_covariance,
            camera,
            tuple(dropped),
        )

    def __len__(self) -> int:
        return len(self.names)

    @property
    def T_stand_mount(self) -> FloatArray:
        """`(N, 4, 4)`: the mount carries the camera, the stand the board. `T_base_hand`, or its inverse."""
        if self.mount == "hand":
            return self.T_base_hand
        return np.array([invert_transform(pose) for pose in self.T_base_hand]).reshape(-1, 4, 4)

    def select(self, which: NDArray[np.bool_]) -> HandEyeViews:
        """Keep only the views of a mask `(N,)`."""
        index = np.flatnonzero(which)
        return replace(
            self,
            T_base_hand=self.T_base_hand[index],
            T_camera_board=self.T_camera_board[index],
            names=tuple(self.names[i] for i in index),
            seen=None if self.seen is None else tuple(self.seen[i] for i in index),
        )


def read_views(folder: Path) -> HandEyeViews:
    """The recording in a folder with `views.json` and, where it names them, pictures.

    Matrices are in the recording's `units`, sizes of the board always in metres. A picture without the board is left
    out and listed in `dropped`. Raises `DataError` for what is missing or damaged, `CalibrationError` for matrices
    that are no poses, `BaggieError` for a board that cannot be read.
    """
    content = read_views_file(folder)
    units, mount = content.get("units"), content.get("mount")
    if units not in _METRES:
        _fail(folder, f'expected "units": "m" or "mm", got {units!r}; say what the translations are in')
    if mount not in ("hand", "fixed"):
        _fail(folder, f'expected "mount": "hand" or "fixed", got {mount!r}; say what carries the camera')
    entries = [
        _Entry.read(folder, content, number, _METRES[units]) for number in range(len(content["views"]))
    ]
    names = tuple(entry.name for entry in entries)
    hands = np.array([entry.T_base_hand for entry in entries]).reshape(-1, 4, 4)
    boards = [entry.T_camera_board for entry in entries if entry.T_camera_board is not None]
    if len(boards) == len(entries):
        views = HandEyeViews(mount, hands, np.array(boards).reshape(-1, 4, 4), names)
    else:
        first = next(entry.name for entry in entries if entry.T_camera_board is None)
        setting = _Setting.read(folder, content, _read_picture(folder, first))
        views = HandEyeViews.from_seen(
            mount,
            list(hands),
            [
                setting.detect(folder, entry.name) if entry.T_camera_board is None else entry.T_camera_board
                for entry in entries
            ],
            setting.intrinsics,
            intrinsics_covariance=setting.covariance,
            names=names,
            camera=setting.camera,
        )
    _check_units(views, units)
    return views


def checked_pose(matrix: Any, words: str, view: str) -> FloatArray:
    """A rigid transform `(4, 4)`, its rotation made exact. Raises `CalibrationError` with these words in it."""
    try:
        pose = np.array(matrix, float)
    except (TypeError, ValueError):
        pose = np.zeros(0)
    if pose.shape != (4, 4) or not np.isfinite(pose).all():
        raise CalibrationError(
            f"expected 4 x 4 finite numbers, got something else ({words}, {view}); write it row by row"
        )
    if not np.allclose(pose[3], [0, 0, 0, 1], atol=1e-6):
        turned = np.allclose(pose[:, 3], [0, 0, 0, 1], atol=1e-6)
        hint = "it looks transposed" if turned else "write it row by row, the translation last in each"
        raise CalibrationError(
            f"expected a last row of 0 0 0 1, got {pose[3].tolist()} ({words}, {view}); {hint}"
        )
    rotation = pose[:3, :3]
    off = float(np.abs(rotation.T @ rotation - np.eye(3)).max())
    if off < 2 * _ORTHONORMAL and np.linalg.det(rotation) < 0:
        raise CalibrationError(
            f"axes swapped or mirrored, {view}: the rotation in {words} has "
            "determinant -1; use right-handed frames on both sides"
        )
    if off > _ORTHONORMAL:
        raise CalibrationError(
            f"expected a rotation, got axes that are not of length 1 and at right angles, by {off:.2g} "
            f"({words}, {view}); check how it was written"
        )
    pose[:3, :3] = Rotation.from_matrix(rotation).as_matrix()
    return pose


@dataclass(frozen=True)
class _Entry:
    """What a recording says of one view, metres."""

    name: str
    """Of its picture, where it has one."""
    T_base_hand: FloatArray
    T_camera_board: FloatArray | None
    """None where the picture is to tell."""

    @classmethod
    def read(cls, folder: Path, content: Mapping[str, Any], number: int, metres: float) -> _Entry:
        """The view of this number, whose translations are in so many metres."""
        entry = content["views"][number]
        name = str(entry.get("image", f"view {number}"))
        if "T_base_hand" not in entry:
            _fail(folder, f"view {number} has no T_base_hand; give where the hand was, in the base's frame")

        def pose(key: str) -> FloatArray:
            matrix = checked_pose(entry[key], key, name)
            matrix[:3, 3] *= metres
            return matrix

        if "image" in entry and ("board" in content or "T_camera_board" not in entry):
            return cls(name, pose("T_base_hand"), None)
        if "T_camera_board" not in entry:
            _fail(folder, f"view {number} has neither T_camera_board nor image; give one of them")
        return cls(name, pose("T_base_hand"), pose("T_camera_board"))


@dataclass(frozen=True)
class _Setting:
    """What a recording says of all its pictures: the board and the camera, and how sure its lens is."""

    board: Target
    intrinsics: Intrinsics
    covariance: FloatArray | None
    camera: CameraIdentity | None

    @classmethod
    def read(cls, folder: Path, content: Mapping[str, Any], picture: Image) -> _Setting:
        """Read the setting for pictures of the size of `picture`."""
        height, width = picture.shape[:2]
        missing = [key for key in ("camera_matrix", "distortion", "board") if key not in content]
        if missing:
            _fail(folder, f'expected {" and ".join(missing)} beside "views", because it names pictures')
        try:
            matrix = np.array(content["camera_matrix"], float).reshape(3, 3)
            distortion = np.array(content["distortion"], float).ravel()
        except (TypeError, ValueError):
            _fail(folder, "expected 3 x 3 numbers as camera_matrix and a list of numbers as distortion")
        if len(distortion) not in (0, 4, 5, 8, 12, 14):
            _fail(folder, f"expected 0, 4, 5, 8, 12 or 14 distortion coefficients, got {len(distortion)}")
        try:
            sag = Sag.from_yaml(content.get("sag")) or FLAT
        except (KeyError, TypeError, ValueError):
            _fail(folder, "expected along_m and across_m, metres, as sag")
        covariance, camera, numbers = None, None, 4 + len(distortion)
        try:
            if content.get("intrinsics_covariance") is not None:
                covariance = np.array(content["intrinsics_covariance"], float).reshape(numbers, numbers)
        except (TypeError, ValueError):
            _fail(folder, f"expected {numbers} x {numbers} numbers as intrinsics_covariance")
        try:
            if "camera" in content:
                camera = CameraIdentity.from_yaml(content["camera"])
        except (KeyError, TypeError, ValueError):
            _fail(folder, "expected name, width and height as camera")
        if camera is not None:
            camera.check(CameraIdentity(camera.name, width, height), f"the recording {folder}")
        board = with_sag(parse_target(str(content["board"])), sag)
        return cls(board, Intrinsics(width, height, matrix, distortion), covariance, camera)

    def detect(self, folder: Path, name: str) -> TargetDetection | str:
        """The board's corners in a picture, or why it is not found there."""
        picture = _read_picture(folder, name)
        height, width = picture.shape[:2]
        if (width, height) != (self.intrinsics.width, self.intrinsics.height):
            _fail(
                folder,
                f"{name} has {width} x {height} pixels, those before it {self.intrinsics.width} x "
                f"{self.intrinsics.height}; one camera matrix is good for one resolution",
            )
        return self.board.detect(picture) or self.board.why_not(picture)


def _read_picture(folder: Path, name: str) -> Image:
    path = folder / name
    if not path.is_file():
        raise DataError(f"no picture {path}; put it there, or take its view out of views.json")
    return read_picture(path)


def _check_units(views: HandEyeViews, units: str) -> None:
    for words, poses in (("T_base_hand", views.T_base_hand), ("T_camera_board", views.T_camera_board)):
        if words == "T_camera_board" and views.seen is not None:
            continue  # from pictures, in metres whatever the units
        usual = float(np.median(np.linalg.norm(poses[:, :3, 3], axis=1))) if len(poses) else 1.0
        if units == "m" and usual > _FAR_M:
            raise CalibrationError(
                f"expected metres in {words}, got translations of usually {usual:.1f}; "
                'looks like mm: write "units": "mm"'
            )
        if units == "mm" and usual < _NEAR_M:
            raise CalibrationError(
                f"expected millimetres in {words}, got translations of usually {usual * 1000:.3f}; looks like metres: "
                'write "units": "m"'
            )


def _fail(folder: Path, what: str) -> NoReturn:
    raise DataError(f"{folder / 'views.json'}: {what}")
