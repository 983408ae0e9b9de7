"""The state of a training on disk: a kill costs what was learned since the last save, and nothing else."""

from __future__ import annotations

import io
import time
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import nn
from torch.optim import Optimizer
from torch.optim.swa_utils import AveragedModel

from baggie.errors import DataError
from baggie.policies.checkpoint import write_files

FILE = "resume.pt"


@dataclass
class State:
    """All that changes during a training. Random numbers are none of it: every batch follows from seed and
    step.
    """

    network: nn.Module
    optimizer: Optimizer
    average: AveragedModel | None
    where: str = "cpu"
    """What computes: going on elsewhere would be another training."""
    step: int = 0
    seconds: float = 0.0
    """Spent in training so far, over all runs."""

    def save(self, folder: Path) -> None:
        """Write `resume.pt`, complete or not at all. Raises `DataError`."""
        stream = io.BytesIO()
        content = {"step": self.step, "seconds": self.seconds, "where": self.where}
        torch.save(content | {name: part.state_dict() for name, part in self._parts().items()}, stream)
        write_files(folder, {FILE: stream.getvalue()})

    def load(self, folder: Path) -> None:
        """Take over what `save` wrote; without a file, nothing.

        Raises `DataError` when it is damaged, or was written elsewhere than `where`.
        """
        path = folder / FILE
        if not path.exists():
            return
        try:
            content = torch.load(path, map_location="cpu", weights_only=True)
            for name, part in self._parts().items():
                part.load_state_dict(content[name])
            self.step, self.seconds = int(content["step"]), float(content["seconds"])
            where = str(content.get("where", self.where))  # older versions did not say
        except Exception as error:  # a damaged pickle or zip raises nearly anything
            raise DataError(
                f"{path} cannot be read ({type(error).__name__}): delete {folder} and train again"
            ) from None
        if where != self.where:
            raise DataError(
                f"the training in {folder} was begun on {where}, not on {self.where}: go on there, or give another "
                "--out"
            )

    def _parts(self) -> dict[str, nn.Module | Optimizer]:
        parts: dict[str, nn.Module | Optimizer] = {"network": self.network, "optimizer": self.optimizer}
        return parts if self.average is None else parts | {"average": self.average}


class Every:
    """True once every so many seconds."""

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._last = time.monotonic()

    def __call__(self) -> bool:
        """Whether it is time again."""
        now = time.monotonic()
        if now - self._last < self._seconds:
            return False
        self._last = now
        return True
