"""Checkpoints: a folder, local or on the Hub, with `config.yaml` to read and `policy.safetensors` to load."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import huggingface_hub
import safetensors
import safetensors.torch
import yaml
from huggingface_hub.errors import HfHubHTTPError, HFValidationError, LocalEntryNotFoundError
from torch import Tensor

from baggie.data.files import write_all
from baggie.errors import DataError

CONFIG = "config.yaml"
WEIGHTS = "policy.safetensors"

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
        return Path(huggingface_hub.snapshot_download(str(source), allow_patterns=[CONFIG, WEIGHTS]))
    except (HfHubHTTPError, HFValidationError, LocalEntryNotFoundError, OSError) as error:
        reason = str(error).strip().partition("\n")[0]
        raise DataError(
            f"{source} is no folder here and could not be downloaded from the Hub: {reason}"
        ) from None


def write(folder: Path, config: Mapping[str, Any], tensors: Mapping[str, Tensor]) -> None:
    """Write both files, complete or not at all. Raises `DataError` when that is impossible."""
    weights = safetensors.torch.save(
        {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()},
        metadata={"policy": str(config["policy"])},
    )
    write_files(folder, {WEIGHTS: weights, CONFIG: config_bytes(config)})


def config_bytes(config: Mapping[str, Any]) -> bytes:
    """The content of `config.yaml`."""
    text = yaml.safe_dump(dict(config), sort_keys=False, default_flow_style=None, width=110)
    return str(text).encode()


def write_files(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write files by name into a folder, which is made, complete or not at all.

    Raises `DataError` when that is impossible: a full disk, no right to write.
    """
    partial = folder / ".partial"
    try:
        write_all([(folder / name, content) for name, content in files.items()], partial)
        partial.rmdir()
    except OSError as error:
        raise DataError(
            f"{folder} cannot be written: {error.strerror}; free some space or mend the rights, then run the "
            "same command again"
        ) from None


def read_config(folder: Path) -> dict[str, Any]:
    """The content of `config.yaml`. Raises `DataError` when it is missing or no policy's."""
    path = folder / CONFIG
    try:
        config = yaml.safe_load(path.read_text())
    except FileNotFoundError:
        raise DataError(f"{path} is missing: give the folder of a training run that has finished") from None
    except (OSError, UnicodeDecodeError, yaml.YAMLError):
        raise DataError(f"{path} cannot be read: it is damaged; train again or take a copy") from None
    if not isinstance(config, dict) or "policy" not in config:
        raise DataError(f"{path} does not describe a policy: give the folder of a training run")
    return config


def read_weights(folder: Path, policy: str) -> dict[str, Tensor]:
    """The tensors of `policy.safetensors`. Raises `DataError` when missing, cut off, or of another policy."""
    path = folder / WEIGHTS
    if not path.exists():
        raise DataError(
            f"{path} is missing: the training has not finished; run the same `baggie train` again"
        )
    try:
        with safetensors.safe_open(path, framework="pt") as file:
            owner = (file.metadata() or {}).get("policy")
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a dict
    except (safetensors.SafetensorError, OSError):
        raise DataError(f"{path} is cut off or damaged: train again, or take a copy") from None
    if owner != policy:
        raise DataError(f"{path} holds the weights of a {owner} policy, but {policy} was asked for")
    return tensors
