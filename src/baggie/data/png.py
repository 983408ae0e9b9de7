"""Pictures as PNG and back: colour exactly, depth to the millimetre, heights to a hundredth of one."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from baggie.data.files import broken
from baggie.types import Image

_HEIGHT_STEPS = 100_000
"""Per metre."""
_MOST = int(np.iinfo(np.uint16).max)
MAX_HEIGHT_M = _MOST / _HEIGHT_STEPS
"""The greatest height that can be stored."""
_START, _END = b"\x89PNG\r\n\x1a\n", b"IEND\xaeB`\x82"


def is_whole(png: bytes) -> bool:
    """Whether these are the bytes of one PNG, from the first to the last."""
    return png.startswith(_START) and png.endswith(_END)


def encode_color(color: Image) -> bytes:
    """RGB `(H, W, 3)` uint8 -> PNG."""
    # OpenCV's own defaults are both the fastest and the smallest it has on pictures of a table.
    return _encode(np.asarray(cv2.cvtColor(color, cv2.COLOR_RGB2BGR), np.uint8))


def decode_color(png: bytes | memoryview, source: Path, out: Image | None = None) -> Image:
    """PNG -> RGB `(H, W, 3)` uint8; into `out` where given, resized (area average) to its size.

    Raises DataError naming `source` when the picture is damaged.
    """
    picture = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    if picture is None:
        raise broken(source, "holds a damaged picture")
    if out is not None and out.shape != picture.shape:
        picture = cv2.resize(picture, (out.shape[1], out.shape[0]), interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB, dst=out), np.uint8)


def encode_depth(depth_m: NDArray[np.float32]) -> bytes:
    """Depth `(H, W)` float32 metres -> 16-bit PNG of millimetres; 0 where unknown or beyond 65.535 m."""
    millimetres = np.rint(np.nan_to_num(depth_m, nan=0.0, posinf=0.0, neginf=0.0) * 1000.0)
    millimetres[(millimetres < 0) | (millimetres > _MOST)] = 0
    return _encode(millimetres.astype(np.uint16))


def decode_depth(png: bytes | memoryview, source: Path) -> NDArray[np.float32]:
    """The inverse of `encode_depth`, to the millimetre."""
    return np.asarray(_decode16(png, source, "depth") / 1000.0, np.float32)


def encode_height(height_m: NDArray[np.float32]) -> bytes:
    """Heights `(H, W)` float32 metres, 0 to `MAX_HEIGHT_M` -> 16-bit PNG in steps of 10 micrometres, the nearest."""
    return _encode(np.rint(np.asarray(height_m, float) * _HEIGHT_STEPS).astype(np.uint16))


def decode_height(png: bytes | memoryview, source: Path) -> NDArray[np.float32]:
    """The inverse of `encode_height`, to 5 micrometres."""
    return np.asarray(_decode16(png, source, "height") / _HEIGHT_STEPS, np.float32)


def _decode16(png: bytes | memoryview, source: Path, kind: str) -> NDArray[np.uint16]:
    picture = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_UNCHANGED)
    if picture is None:
        raise broken(source, f"holds a damaged {kind} picture")
    return np.asarray(picture, np.uint16)


def _encode(picture: NDArray[np.uint8] | NDArray[np.uint16]) -> bytes:
    return bytes(cv2.imencode(".png", picture)[1])
