"""Single pictures on disk."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from baggie.errors import DataError
from baggie.types import Image


def write_picture(path: Path, picture: Image) -> None:
    """Write an RGB picture `(H, W, 3)`, whole or not at all. Raises `DataError` when the disk is full."""
    path.parent.mkdir(parents=True, exist_ok=True)
    _, data = cv2.imencode(path.suffix, cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
    partial = path.with_name(path.name + ".partial")
    try:
        partial.write_bytes(data.tobytes())
        partial.replace(path)
    except OSError as error:
        raise DataError(
            f"{path} cannot be written: {error.strerror}; free some space or mend the rights"
        ) from error


def read_picture(path: Path) -> Image:
    """Read an RGB picture `(H, W, 3)`. Raises `DataError` when there is none."""
    picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if picture is None:
        raise DataError(f"expected a picture at {path}, found none that can be read")
    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB), np.uint8)
