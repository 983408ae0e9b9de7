"""Baggie: a robot that teaches itself to pick up and place soft things.

cell = baggie.open_workcell("sim")
policy = baggie.Policy.from_pretrained("runs/keypoint")
outcome = cell.carry_out(policy.plan(cell.look(), goal))
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from baggie.gymnasium_ids import register_environments
from baggie.moved import keep_old_names

if TYPE_CHECKING:
    from baggie.data import Dataset
    from baggie.policies import Policy
    from baggie.workcell.workcell import Workcell

__all__ = ["Policy", "load_policy", "open_dataset", "open_workcell"]

keep_old_names()
register_environments()

# PyTorch, MuJoCo and pyarrow take seconds to import: each is loaded when it is first needed.


def open_workcell(source: str | Path = "sim") -> Workcell:
    """The workcell a file describes, or `"sim"`: the simulated one. Raises `BaggieError` for a file it cannot use."""
    from baggie.workcell.config import open_workcell as open_  # noqa: PLC0415

    return open_(source)


def load_policy(source: str | Path) -> Policy:
    """The policy of a training run's folder or a Hub id. Raises `DataError` when there is none."""
    from baggie.policies import load_policy as load  # noqa: PLC0415

    return load(source)


def open_dataset(root: str | Path) -> Dataset:
    """The recording in a folder. Raises `DataError` when there is none, or a file of it is broken."""
    from baggie.data import open_dataset as open_  # noqa: PLC0415

    return open_(root)


def __getattr__(name: str) -> object:
    if name == "Policy":
        from baggie.policies import Policy as policy  # noqa: PLC0415

        return policy
    raise AttributeError(f"module 'baggie' has no attribute {name!r}")
