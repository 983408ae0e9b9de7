"""Pictures on disk: one, a folder of them, or the frames of a video."""

from __future__ import annotations

import io
import math
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from PIL import Image as Pillow

from baggie.errors import BaggieError, DataError
from baggie.files import only_ours, write_bytes
from baggie.pictures import as_picture
from baggie.types import Image

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
