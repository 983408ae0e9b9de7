"""What the learned policies share: the picture they were trained on, saving, loading, the Hub."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Self

import huggingface_hub
import safetensors
import safetensors.torch
import torch
from torch import Tensor, nn

from baggie.errors import BaggieError, DataError
from baggie.policies import checkpoint
from baggie.policies.base import Policy
from baggie.types import Goal, Observation, Plan

_CARD = """\
---
library_name: baggie
tags: [robotics, pick-and-place, baggie, {name}]
---

# A `{name}` policy of Baggie

Maps a picture and a goal in it to pick and place poses (metres, radians, robot base frame). It belongs to the
one workcell whose pictures it was trained on (cell {cell}, pictures of {width} x {height} pixels): another
camera, or the same one moved, needs its own. How it was trained, and on which attempts, is in `config.yaml`.

```python
import baggie

policy = baggie.load_policy("{repo}")
plan = policy.plan(observation, goal)
```
"""


def write_tensors(folder: Path, config: Mapping[str, Any], tensors: Mapping[str, Tensor]) -> None:
    """Write both files, complete or not at all. Raises `DataError` when that is impossible."""
    weights = safetensors.torch.save(
        {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()},
        metadata={"policy": str(config["policy"])},
    )
    files = {checkpoint.WEIGHTS: weights, checkpoint.CONFIG: checkpoint.config_bytes(config)}
    checkpoint.write_files(folder, files)


def read_tensors(folder: Path, policy: str) -> dict[str, Tensor]:
    """The tensors of `policy.safetensors`. Raises `DataError` when missing, cut off, or of another policy."""
    path = folder / checkpoint.WEIGHTS
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


class LearnedPolicy(Policy):
    """A network that belongs to one cell. Subclasses say how to build it and how to plan with it."""

    def __init__(self, network: nn.Module, picture_size: tuple[int, int], cell: int) -> None:
        """`picture_size`: `(width, height)` of its training pictures; `cell`: where they were taken."""
        self.network = network
        self.picture_size = picture_size
        self.camera_size = picture_size
        """`(width, height)` at which the camera took the training pictures, before they were resized for recording."""
        self.cell = cell
        self.training: Mapping[str, Any] = {}
        """How it was trained, as it stands in its config; empty for one that was not."""

    @abstractmethod
    def model_config(self) -> dict[str, Any]:
        """What `build` needs besides picture size and cell, in plain YAML types."""

    @classmethod
    @abstractmethod
    def build(cls, model: Mapping[str, Any], picture_size: tuple[int, int], cell: int) -> Self:
        """The policy with an untrained network."""

    @abstractmethod
    def plan(self, observation: Observation, goal: Goal | None = None) -> Plan:
        """Where to pick and where to place. Raises `BaggieError` when the goal is missing or not in the picture."""

    @property
    def device(self) -> torch.device:
        """Where the network is."""
        return next(self.network.parameters()).device

    def config(self) -> dict[str, Any]:
        """Give all that is needed to build the policy again, and how it was trained."""
        return {
            "policy": self.name,
            "cell": self.cell,
            "picture_size": list(self.picture_size),
            "camera_size": list(self.camera_size),
            "model": self.model_config(),
            "training": dict(self.training),
        }

    def save_pretrained(self, folder: Path | str) -> None:
        """Write `config.yaml` and `policy.safetensors`, complete or not at all. Raises `DataError`."""
        write_tensors(Path(folder), self.config(), self.network.state_dict())

    @classmethod
    def from_pretrained(cls, source: Path | str, device: str = "cpu") -> Self:
        """Load from a folder or a Hub id.

        Raises `DataError` when a file is missing, damaged, or of another policy, and `BaggieError` where there is no
        such device.
        """
        check_device(device)
        folder = checkpoint.fetch(source)
        config = checkpoint.read_config(folder)
        if config["policy"] != cls.name:
            raise DataError(f"{folder} holds a {config['policy']} policy, but {cls.name} was asked for")
        tensors = read_tensors(folder, cls.name)
        try:
            picture_size, camera_size = checkpoint.sizes(config)
            policy = cls.build(config["model"], picture_size, int(config["cell"]))
            policy.camera_size = camera_size
            policy.network.load_state_dict(tensors)
        except (KeyError, TypeError, ValueError, RuntimeError):
            raise DataError(
                f"{folder / checkpoint.CONFIG} and {checkpoint.WEIGHTS} do not belong together: "
                "take both from one training run"
            ) from None
        policy.training = config.get("training", {})
        policy.network.to(device).eval()
        return policy

    def push_to_hub(self, repo_id: str, private: bool = True) -> str:
        """Upload config, weights and a model card to the Hub's `owner/name`; the address. Needs a login
        there.
        """
        with TemporaryDirectory() as folder:
            self.save_pretrained(folder)
            Path(folder, "README.md").write_text(self._card(repo_id))
            huggingface_hub.create_repo(repo_id, private=private, exist_ok=True)
            return str(huggingface_hub.upload_folder(repo_id=repo_id, folder_path=folder))

    def _card(self, repo_id: str) -> str:
        width, height = self.picture_size
        return _CARD.format(name=self.name, cell=self.cell, width=width, height=height, repo=repo_id)


def check_device(device: str) -> None:
    """Raise `BaggieError` where PyTorch finds no such device here; other words than its own are for it to judge."""
    without_cuda = device == "cuda" and not torch.cuda.is_available()
    without_mps = device == "mps" and not torch.backends.mps.is_available()
    if without_cuda or without_mps:
        raise BaggieError(f"device {device} was asked for, but PyTorch finds none here: take --device cpu")
