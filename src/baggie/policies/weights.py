"""`policy.safetensors`: a network's tensors, beside the `config.yaml` of `checkpoint.py`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import safetensors
import safetensors.torch
from torch import Tensor

from baggie.errors import DataError
from baggie.policies.checkpoint import CONFIG, WEIGHTS, config_bytes, write_files


def write(folder: Path, config: Mapping[str, Any], tensors: Mapping[str, Tensor]) -> None:
    """Write both files, complete or not at all. Raises `DataError` when that is impossible."""
    weights = safetensors.torch.save(
        {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()},
        metadata={"policy": str(config["policy"])},
    )
    write_files(folder, {WEIGHTS: weights, CONFIG: config_bytes(config)})


def read(folder: Path, policy: str) -> dict[str, Tensor]:
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
