"""A policy's folder, local or on the Hub: `config.yaml` to read, beside it `policy.safetensors` or `policy.onnx`.

Pictures and goals come to the policy at the size it was trained on. Nothing here needs PyTorch.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import huggingface_hub
import yaml
from huggingface_hub.errors import HfHubHTTPError, HFValidationError, LocalEntryNotFoundError

from baggie.calibration.files import REFERENCE_FILE
from baggie.errors import BaggieError, DataError, WriteError
from baggie.files import read_yaml
from baggie.pictures import same_shape
from baggie.types import Goal, Image, Observation, require_observation
from baggie.vision.draw import check_goal

CONFIG = "config.yaml"
WEIGHTS = "policy.safetensors"
"""Of a training run: PyTorch loads it."""
GRAPH = "policy.onnx"
"""Of an exported policy: onnxruntime runs it."""

_HUB_ID = re.compile(r"[\w.-]+/[\w.-]+")


def fetch(source: str | Path) -> Path:
    """The folder of a checkpoint: `source` itself, or where the Hub's `owner/name` was downloaded to.

    Raises `DataError` when it is neither.
    """
    folder = Path(source)
    if folder.is_dir():
        return folder
    if not _HUB_ID.fullmatch(str(source)):
        raise DataError(f"{source} is neither the folder of a training run nor a Hub id like owner/name")
    try:
        return Path(huggingface_hub.snapshot_download(str(source), allow_patterns=[CONFIG, WEIGHTS, GRAPH]))
    except (HfHubHTTPError, HFValidationError, LocalEntryNotFoundError, OSError) as error:
        reason = str(error).strip().partition("\n")[0]
        raise DataError(
            f"{source} is no folder here and could not be downloaded from the Hub: {reason}"
        ) from None


def is_exported(folder: Path) -> bool:
    """Whether it holds an exported policy, and no training run."""
    return (folder / GRAPH).exists() and not (folder / WEIGHTS).exists()


def config_bytes(config: Mapping[str, Any]) -> bytes:
    """The content of `config.yaml`."""
    text = yaml.safe_dump(dict(config), sort_keys=False, default_flow_style=None, width=110)
    return str(text).encode()


def sizes(config: Mapping[str, Any]) -> tuple[tuple[int, int], tuple[int, int]]:
    """`(width, height)` of a policy's training pictures, and at which its camera took them; pixels.

    Raises `KeyError`, `TypeError` or `ValueError` for what is none.
    """
    (width, height), (camera_width, camera_height) = config["picture_size"], config["camera_size"]
    return (int(width), int(height)), (int(camera_width), int(camera_height))


def write_files(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write files by name into a folder, which is made, complete or not at all.

    Raises `WriteError` when that is impossible: a full disk, no right to write.
    """
    from baggie.data.files import write_all  # noqa: PLC0415 -- what only reads needs no pyarrow

    partial = folder / ".partial"
    try:
        write_all([(folder / name, content) for name, content in files.items()], partial)
    except OSError as error:
        raise WriteError(
            f"{folder} cannot be written: {error.strerror}; free some space or mend the rights, then run the "
            "same command again"
        ) from None
    with contextlib.suppress(OSError):  # somebody else's files may be in it
        partial.rmdir()


def read_config(folder: Path) -> dict[str, Any]:
    """The content of `config.yaml`. Raises `DataError` when it is missing or no policy's."""
    path = folder / CONFIG
    try:
        config = read_yaml(path)
    except FileNotFoundError:
        raise DataError(f"{path} is missing: give the folder of a training run that has finished") from None
    except OSError as error:
        raise DataError(f"{path} cannot be read: {error.strerror}; mend that or take a copy") from None
    except DataError:
        raise DataError(f"{path} cannot be read: it is damaged; train again or take a copy") from None
    if not isinstance(config, dict) or "policy" not in config:
        raise DataError(f"{path} does not describe a policy: give the folder of a training run")
    if (
        "camera_size" not in config and "picture_size" in config
    ):  # an older version squeezed pictures, and did not say
        config["camera_size"] = _reference_size(folder) or config["picture_size"]
    return config


def _reference_size(folder: Path) -> list[int] | None:
    """`[width, height]` of what the camera saw when the policy's cell was calibrated; None where nobody kept that."""
    path = folder / REFERENCE_FILE
    if not path.exists():
        return None
    from baggie.pictures import read_picture  # noqa: PLC0415 -- of older versions' runs only

    return list(read_picture(path).shape[1::-1])


def check_picture_shape(size: tuple[int, int], camera_size: tuple[int, int]) -> None:
    """Raise `BaggieError` where pictures of `size` are of another shape than those the training's camera took."""
    (width, height), (own_width, own_height) = size, camera_size
    if not same_shape(size, camera_size):
        raise BaggieError(
            f"this policy was trained on pictures of {own_width} x {own_height} pixels, but got one of {width} x "
            f"{height}: it belongs to another camera; train one for this one"
        )


def at_training_size(
    observation: Observation, goal: Goal, size: tuple[int, int], camera_size: tuple[int, int]
) -> tuple[Image, Goal]:
    """Picture and goal at `size` (width, height), that of the training pictures.

    Those are pictures of `camera_size` resized, squeezed where their shape is another. Raises `BaggieError` when the
    goal leaves the picture, or the picture is neither one of the training's size nor of the camera's shape.
    """
    (width, height), (to_width, to_height) = require_observation(observation).size, size
    check_goal(goal, (width, height))
    if (width, height) != size:
        check_picture_shape((width, height), camera_size)
    color = Observation(observation.color).resized(to_width, to_height).color
    return color, goal.scaled(to_width / width, to_height / height)
