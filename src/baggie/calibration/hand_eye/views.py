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
from baggie.vision.targets import Seen, Target, parse_target, with_sag

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
    seen: tuple[Seen, ...] | None = None
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
        seen: Sequence[Seen | None],
        intrinsics: Intrinsics,
        *,
        intrinsics_covariance: FloatArray | None = None,
        names: Sequence[str] | None = None,
        camera: CameraIdentity | None = None,
    ) -> HandEyeViews:
        """From N poses of the hand `(4, 4)` and the board's corners seen there; None for a view without the board."""
        names = [f"view {i}" for i in range(len(seen))] if names is None else names
        hands, boards, kept, kept_names, dropped = [], [], [], [], []
        for hand, corners, name in zip(T_base_hand, seen, names, strict=True):
            if corners is None:
                dropped.append((name, "the board is not seen"))
                continue
            try:
                boards.append(fit_pose(corners.points, corners.pixels, intrinsics).pose.transform)
            except CalibrationError as error:
                dropped.append((name, str(error)))
                continue
            hands.append(np.asarray(hand, float))
            kept.append(corners)
            kept_names.append(name)
        return cls(
            mount,
            np.array(hands).reshape(-1, 4, 4),
            np.array(boards).reshape(-1, 4, 4),
            tuple(kept_names),
            tuple(kept),
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
        """These views only: `(N,)`."""
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
    entries = content["views"]

    def pose(entry: Mapping[str, Any], key: str, name: str) -> FloatArray:
        matrix = checked_pose(entry[key], key, name)
        matrix[:3, 3] *= _METRES[units]
        return matrix

    pictures = _Pictures(folder, content)
    hands, boards, names, seen, dropped = [], [], [], [], []
    for i, entry in enumerate(entries):
        name = str(entry.get("image", f"view {i}"))
        if "T_base_hand" not in entry:
            _fail(folder, f"view {i} has no T_base_hand; give where the hand was, in the base's frame")
        hand = pose(entry, "T_base_hand", name)
        corners = None
        if "image" in entry and ("board" in content or "T_camera_board" not in entry):
            try:
                board, corners = pictures.look(name)
            except CalibrationError as error:
                dropped.append((name, str(error)))
                continue
        elif "T_camera_board" in entry:
            board = pose(entry, "T_camera_board", name)
        else:
            _fail(folder, f"view {i} has neither T_camera_board nor image; give one of them")
        hands.append(hand)
        boards.append(board)
        names.append(name)
        seen.append(corners)
    shown = tuple(corners for corners in seen if corners is not None)
    views = HandEyeViews(
        mount,
        np.array(hands).reshape(-1, 4, 4),
        np.array(boards).reshape(-1, 4, 4),
        tuple(names),
        shown if len(shown) == len(seen) and shown else None,
        pictures.intrinsics,
        pictures.covariance,
        pictures.camera,
        tuple(dropped),
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


class _Pictures:
    """The pictures of a recording, all of one camera; the camera and the board are read when first needed."""

    def __init__(self, folder: Path, content: Mapping[str, Any]) -> None:
        self._folder, self._content = folder, content
        self._target: Target | None = None
        self.intrinsics: Intrinsics | None = None
        self.covariance: FloatArray | None = None
        self.camera: CameraIdentity | None = None

    def look(self, name: str) -> tuple[FloatArray, Seen]:
        """`T_camera_board` and the corners. Raises `CalibrationError` where the board is not found."""
        image = self._read(name)
        size = (image.shape[1], image.shape[0])
        if self._target is None or self.intrinsics is None:
            self._target, self.intrinsics = self._setting(*size)
        if size != (self.intrinsics.width, self.intrinsics.height):
            _fail(
                self._folder,
                f"{name} has {size[0]} x {size[1]} pixels, those before it {self.intrinsics.width} x "
                f"{self.intrinsics.height}; one camera matrix is good for one resolution",
            )
        seen = self._target.detect(image)
        if seen is None:
            raise CalibrationError(self._target.why_not(image))
        return fit_pose(seen.points, seen.pixels, self.intrinsics).pose.transform, seen

    def _read(self, name: str) -> Image:
        path = self._folder / name
        if not path.is_file():
            raise DataError(f"no picture {path}; put it there, or take its view out of views.json")
        return read_picture(path)

    def _setting(self, width: int, height: int) -> tuple[Target, Intrinsics]:
        missing = [key for key in ("camera_matrix", "distortion", "board") if key not in self._content]
        if missing:
            _fail(self._folder, f'expected {" and ".join(missing)} beside "views", because it names pictures')
        try:
            matrix = np.array(self._content["camera_matrix"], float).reshape(3, 3)
            distortion = np.array(self._content["distortion"], float).ravel()
        except (TypeError, ValueError):
            _fail(self._folder, "expected 3 x 3 numbers as camera_matrix and a list of numbers as distortion")
        if len(distortion) not in (0, 4, 5, 8, 12, 14):
            _fail(
                self._folder, f"expected 0, 4, 5, 8, 12 or 14 distortion coefficients, got {len(distortion)}"
            )
        self._read_calibration(width, height, 4 + len(distortion))
        try:
            sag = Sag.from_yaml(self._content.get("sag")) or FLAT
        except (KeyError, TypeError, ValueError):
            _fail(self._folder, "expected along_m and across_m, metres, as sag")
        board = with_sag(parse_target(str(self._content["board"])), sag)
        return board, Intrinsics(width, height, matrix, distortion)

    def _read_calibration(self, width: int, height: int, parameters: int) -> None:
        """What our own recordings say besides: which camera it is, and how sure its lens is."""
        if "camera" in self._content:
            try:
                self.camera = CameraIdentity.from_yaml(self._content["camera"])
            except (KeyError, TypeError, ValueError):
                _fail(self._folder, "expected name, width and height as camera")
            self.camera.check(
                CameraIdentity(self.camera.name, width, height), f"the recording {self._folder}"
            )
        if self._content.get("intrinsics_covariance") is not None:
            try:
                self.covariance = np.array(self._content["intrinsics_covariance"], float).reshape(
                    parameters, parameters
                )
            except (TypeError, ValueError):
                _fail(self._folder, f"expected {parameters} x {parameters} numbers as intrinsics_covariance")


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
