"""Pictures and outlines as people have them, in memory or on disk, made into what everything here works with."""

from __future__ import annotations

import io
import math
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pillow

from baggie.errors import BaggieError, DataError
from baggie.files import only_ours, write_bytes
from baggie.geometry import FloatArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from baggie.types import Image

LONGEST_RECORDED = 640
"""Pixels of the longer side of recorded pictures, at most."""
_BRIGHTEST = 255
_SENSOR_BITS = (10, 12, 14, 16)
"""Of sensors whose pictures come in uint16."""
_LEAST_PX = 1.0
"""A goal has at least this area, square pixels: corners in shares of the picture make one of less."""
_ROUNDED = 0.5 / 255
"""So far a number may be outside of 0 to 1 and still mean the darkest or the brightest there is."""


def recorded_size(camera_size: tuple[int, int]) -> tuple[int, int]:
    """The size `(width, height)` that pictures of a camera are recorded at: its own shape, at most 640 pixels long."""
    longest = max(camera_size)
    if longest <= LONGEST_RECORDED:
        return camera_size
    width, height = (round(side * LONGEST_RECORDED / longest) for side in camera_size)
    return width, height


def same_shape(size: tuple[int, int], other: tuple[int, int]) -> bool:
    """Whether pictures of one size `(width, height)` are those of the other resized, to whole pixels."""
    (width, height), (other_width, other_height) = size, other
    return abs(width * other_height - height * other_width) <= max(*size, *other) / 2


def as_picture(picture: Any) -> NDArray[np.uint8]:
    """A picture as `(H, W, 3)` uint8 RGB; one that is so already is returned as it is.

    Taken are arrays, tensors, lists and Pillow's pictures: grey, RGB or RGBA, whose transparency is left out; whole
    numbers of 8 bits or, in uint16 with any above 255, of as many of 10, 12, 14 or 16 as the brightest needs, as
    industrial cameras fill 16 bits; fractions from 0 to 1; `(3, H, W)`, as PyTorch orders them. Raises `BaggieError`
    for anything else.
    """
    array = _opaque(_array(picture))
    if array.ndim != 3 or array.shape[2] != 3 or 0 in array.shape:
        raise BaggieError(
            "expected a picture of shape (H, W, 3), RGB, or one in grey or with transparency, got "
            f"{_described(picture)}; give a single picture, its rows first"
        )
    return np.ascontiguousarray(array if array.dtype == np.uint8 else _in_8_bits(array))


def as_metres(values: Any, name: str) -> NDArray[np.float32]:
    """Depths or heights as float32, metres; `name` says which.

    Raises `BaggieError` for whole numbers: those are a camera's own units, millimetres most often.
    """
    array = _array(values)
    if array.dtype.kind != "f":
        raise BaggieError(
            f"expected the {name} in metres, as fractions, got {array.dtype}; divide millimetres by 1000"
        )
    return array.astype(np.float32, copy=False)


def as_outline(corners: Any) -> FloatArray:
    """A goal's corners as `(N, 2)` pixels (u, v), in order around it.

    Taken are arrays and lists, OpenCV's `(N, 1, 2)` too, with the first corner repeated at the end or not. Corners out
    of order, in a zigzag perhaps, are put in order where there is only one. Raises `BaggieError` for what encloses
    nothing, crosses itself, or is no number.
    """
    try:
        points = np.array(corners, float)
    except (TypeError, ValueError):
        points = np.empty(0)
    if points.ndim == 3 and 1 in points.shape[:2]:
        points = points.reshape(-1, points.shape[2])
    if points.ndim != 2 or points.shape[1] != 2:
        raise BaggieError(
            f"expected a goal's corners as pixels (u, v), an array of shape (N, 2), got {_described(corners)}"
        )
    if not np.isfinite(points).all():
        raise BaggieError(f"expected a goal's corners to be finite pixels (u, v), got {points.tolist()}")
    points = points[(points != np.roll(points, 1, axis=0)).any(axis=1)]
    if len(points) >= 3 and _crosses_itself(points):
        points = _around(points)
    if len(points) < 3 or abs(_area(points)) < _LEAST_PX:
        raise BaggieError(
            "expected a goal with at least three corners (u, v) and an area of a pixel or more, got "
            f"{np.asarray(corners).tolist()}; give its corners in pixels of the picture"
        )
    return points


def _array(picture: Any) -> NDArray[Any]:
    pillow = sys.modules.get("PIL.Image")  # nobody has one of its pictures without it
    try:
        if pillow is None or not isinstance(picture, pillow.Image) or picture.mode == "F":
            return np.asarray(picture)
        if picture.mode.startswith("I"):  # 16 bits of grey, which `convert` would clip
            return np.asarray(picture).astype(np.uint16)
        return np.asarray(picture.convert("RGB"))
    except (TypeError, ValueError, RuntimeError) as error:  # RuntimeError: a tensor that wants a gradient
        reason = " ".join(str(error).split())
        raise BaggieError(
            f"expected a picture as an array of shape (H, W, 3), got {_described(picture)}: {reason}"
        ) from None


def _opaque(array: NDArray[Any]) -> NDArray[Any]:
    """Grey, transparent and channels-first pictures as `(H, W, 3)`; anything else as it is."""
    if array.ndim == 3 and array.shape[2] not in {1, 3, 4} and array.shape[0] in {1, 3, 4}:
        array = array.transpose(1, 2, 0)
    if array.ndim == 2:
        array = array[:, :, None]
    if array.ndim == 3 and array.shape[2] == 1:
        return np.repeat(array, 3, axis=2)
    return array[:, :, :3] if array.ndim == 3 and array.shape[2] == 4 else array


def _in_8_bits(array: NDArray[Any]) -> NDArray[np.uint8]:
    """Convert a picture to uint8."""
    kind = array.dtype.kind
    if (
        kind == "u" and array.dtype.itemsize == 2 and array.max() > _BRIGHTEST
    ):  # or there is nothing to see in it
        bits = next(bits for bits in _SENSOR_BITS if array.max() < 1 << bits)
        return (array >> (bits - 8)).astype(np.uint8)
    if kind not in "buif":
        raise BaggieError(f"expected a picture of numbers, got an array of {array.dtype}")
    brightest, spare = (1, _ROUNDED) if kind in "bf" else (_BRIGHTEST, 0.0)
    low, high = array.min(), array.max()
    if not (-spare <= low and high <= brightest + spare):  # NaN is neither
        raise BaggieError(
            f"expected a picture of uint8, or of fractions from 0 to 1, got {array.dtype} from {low:g} to {high:g}; "
            "say what is black and what is white: scale it to one of the two"
        )
    return np.asarray(np.round(array * (255 / brightest)).clip(0, 255), np.uint8)


def _crosses_itself(points: FloatArray) -> bool:
    """Whether two edges of a polygon `(N, 2)` cross."""
    along = np.roll(points, -1, axis=0) - points
    between = points[None] - points[:, None]
    side = np.sign(along[:, None, 0] * between[..., 1] - along[:, None, 1] * between[..., 0])
    # Whether the line along edge i has the ends of edge j on both sides.
    parted = side * np.roll(side, -1, axis=1) < 0
    return bool((parted & parted.T).any())


def _around(points: FloatArray) -> FloatArray:
    """The corners `(N, 2)` of a convex polygon in order around it, from the first on."""
    u, v = (points - points.mean(axis=0)).T
    order = np.argsort(np.arctan2(v, u))
    points = points[np.roll(order, -int(np.argmax(order == 0)))]
    (ax, ay), (bx, by) = (
        (np.roll(points, -step - 1, axis=0) - np.roll(points, -step, axis=0)).T for step in (0, 1)
    )
    if not (ax * by - ay * bx > 0).all():
        raise BaggieError(
            f"expected a goal whose outline does not cross itself, got {points.tolist()}; give its corners in order"
        )
    return points


def _area(points: FloatArray) -> float:
    """Area of a polygon `(N, 2)`, by the shoelace formula; its sign says which way it turns."""
    u, v = (points - points[0]).T
    return float(u @ np.roll(v, -1) - v @ np.roll(u, -1)) / 2


def _described(value: Any) -> str:
    """A value's kind, in a few words."""
    shape = getattr(value, "shape", None)
    kind = type(value).__name__
    return f"{kind} of shape {tuple(shape)}" if isinstance(shape, tuple) else f"{kind} {str(value)[:60]}"


_PICTURES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff"})
_VIDEOS = frozenset({".mp4", ".avi", ".mov", ".mkv", ".webm", ".m4v"})
_FRAMES = 60
"""A video gives at most so many pictures; more of them are more of the same."""


def write_picture(path: Path, picture: Image) -> None:
    """Write an RGB picture `(H, W, 3)`, whole or not at all. Raises `WriteError` when the disk is full."""
    _, data = cv2.imencode(path.suffix, cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
    write_bytes(path, data.tobytes())


def write_figure(path: Path, figure: Figure) -> None:
    """Write a PNG of a figure, 120 dots an inch, whole or not at all. Raises `WriteError` when the disk is full."""
    content = io.BytesIO()
    figure.savefig(content, dpi=120)
    write_bytes(path, content.getvalue())


def read_picture(path: Path) -> Image:
    """An RGB picture `(H, W, 3)`, EXIF orientation ignored. Raises `DataError` where there is none."""
    try:
        with Pillow.open(path) as picture:
            return as_picture(picture)
    except (BaggieError, OSError, SyntaxError, ValueError) as error:
        raise _unreadable(path, error) from None


def read_pictures(source: Path) -> Iterator[tuple[str, Image]]:
    """Names and pictures `(H, W, 3)`, all of one size, read as they are asked for.

    A folder's pictures come sorted by name; hidden ones, such as a Mac leaves, are passed over. Of a video at most 60
    frames are taken, the sharpest of each stretch. The orientation in a file's EXIF data is ignored: a lens is
    calibrated in the sensor's own rows and columns.

    Raises `DataError` at once where nothing can be read or the sizes differ, and on the way for a file that is cut off.
    """
    if source.is_dir():
        pictures = (path for path in source.iterdir() if path.suffix.lower() in _PICTURES)
        paths = sorted(only_ours(source, pictures, lambda path: not path.name.startswith(".")))
        if not paths:
            raise DataError(
                f"expected pictures (png, jpg, bmp, tiff) in {source}, found none; name their folder"
            )
        return _read_files(paths)
    if not source.exists():
        raise DataError(f"expected a folder of pictures, a picture or a video at {source}, found nothing")
    if source.suffix.lower() in _PICTURES:
        return _read_files([source])
    if source.suffix.lower() in _VIDEOS:
        return _read_video(source)
    raise DataError(
        f"expected a folder, a picture (png, jpg, bmp, tiff) or a video (mp4, avi, mov, mkv, webm), got {source.name}"
    )


def _read_files(paths: list[Path]) -> Iterator[tuple[str, Image]]:
    sizes = {path.name: _size(path) for path in paths}
    (usual, _), *others = Counter(sizes.values()).most_common()
    if others:
        odd = [f"{name} {w} x {h}" for name, (w, h) in sizes.items() if (w, h) != usual]
        more = f" and {len(odd) - 3} more" if len(odd) > 3 else ""
        raise DataError(
            f"expected all pictures at {usual[0]} x {usual[1]}, got {', '.join(odd[:3])}{more}; keep those of one size"
        )
    return ((path.name, read_picture(path)) for path in paths)


def _size(path: Path) -> tuple[int, int]:
    try:
        with Pillow.open(path) as picture:
            return picture.size
    except (OSError, Pillow.DecompressionBombError) as error:
        raise _unreadable(path, error) from None


def _unreadable(path: Path, error: Exception) -> DataError:
    reason = " ".join(str(error).replace(f" {str(path)!r}", "").split())
    return DataError(f"the picture {path} cannot be read ({reason}); remove it or copy it again")


def _read_video(path: Path) -> Iterator[tuple[str, Image]]:
    """Two passes, so that only one frame is in memory: how sharp each frame is, then the chosen ones."""
    sharpness = [_sharpness(frame) for frame in _frames(path)]
    if not sharpness:
        raise DataError(f"the video {path} cannot be read; record it again, or give a folder of pictures")
    stretch = math.ceil(len(sharpness) / _FRAMES)
    starts = range(0, len(sharpness), stretch)
    chosen = {start + int(np.argmax(sharpness[start : start + stretch])) for start in starts}
    return (
        (f"{path.name} frame {number:06d}", np.asarray(cv2.cvtColor(frame, cv2.COLOR_BGR2RGB), np.uint8))
        for number, frame in enumerate(_frames(path))
        if number in chosen
    )


def _frames(path: Path) -> Iterator[Image]:
    """All frames, BGR."""
    video = cv2.VideoCapture(str(path))
    video.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
    try:
        while True:
            there, frame = video.read()
            if not there:
                return
            yield np.asarray(frame, np.uint8)
    finally:
        video.release()


def _sharpness(frame: Image) -> float:
    """Variance of the Laplacian (Pech-Pacheco et al., "Diatom autofocusing in brightfield microscopy", 2000)."""
    return float(cv2.Laplacian(cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY), cv2.CV_32F).var())
