"""What every policy is: the colour mask, the published regressor, ours, the oracle; and how a saved one is loaded."""

from __future__ import annotations

from abc import ABC, abstractmethod
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from baggie.errors import DataError
from baggie.policies import checkpoint
from baggie.registry import Registry

if TYPE_CHECKING:
    from baggie.types import Goal, Observation, Plan

_HERE = "baggie.policies"
CLASSES = {
    "ColorMaskPolicy": "color_mask",
    "KeypointPolicy": "keypoint.policy",
    "LearnedPolicy": "learned",
    "OraclePolicy": "oracle",
    "RegressionPolicy": "regression.policy",
    "TransporterPolicy": "transporter.policy",
}
"""Each is imported when it is first needed: an exported policy must run where there is no PyTorch."""


class Policy(ABC):
    """Maps a picture and a goal in it to a plan in robot coordinates. Never sees a robot.

    policy = Policy.from_pretrained("runs/keypoint")
    plan = policy.plan(observation, goal)
    """

    name: str

    @abstractmethod
    def plan(self, observation: Observation, goal: Goal | None = None) -> Plan:
        """Where to pick and where to place. Without a goal: what comes next in the task the policy has learned.

        Raises `BaggieError` when it cannot tell: no bag in sight, the goal outside the picture or missing.
        """

    @classmethod
    def from_pretrained(cls, source: str | Path, device: str = "cpu") -> Policy:
        """The policy saved in the folder of a training run, or under a Hub id `owner/name`, of whatever kind it is.

        `device` is PyTorch's name for where to compute. Raises `DataError` when there is none, or one of its files is
        missing or damaged.
        """
        return load_policy(source, device)


POLICIES: Registry[type[Policy]] = Registry(
    "baggie.policies",
    {
        "keypoint": f"{_HERE}.keypoint.policy:KeypointPolicy",
        "regression": f"{_HERE}.regression.policy:RegressionPolicy",
        "transporter": f"{_HERE}.transporter.policy:TransporterPolicy",
        "color-mask": f"{_HERE}.color_mask:ColorMaskPolicy",
    },
    "policy",
)
"""Those that can be saved and loaded, by the name that stands in their folder's `config.yaml`."""


def load_policy(source: str | Path, device: str = "cpu") -> Policy:
    """The policy saved in a folder, or under a Hub id `owner/name`: a training run's, or what `baggie export` made.

    Raises `DataError` when there is none, one of its files is missing or damaged, or what would run it is not
    installed.
    """
    folder = checkpoint.fetch(source)
    name = checkpoint.read_config(folder)["policy"]
    if name not in POLICIES:
        raise DataError(f"{folder} holds a policy {name!r}; known are {', '.join(POLICIES.names())}")
    if checkpoint.is_exported(folder):
        exported: Policy = _module("exported").load_exported(folder, device)
        return exported
    try:
        kind = POLICIES[name]
    except ModuleNotFoundError as error:
        if error.name != "torch":
            raise
        raise DataError(
            f"{folder} needs PyTorch, which is not installed here: export it where it is, with `baggie export`"
        ) from None
    return kind.from_pretrained(folder, device)


def class_named(name: str) -> type[Policy]:
    """The policy of that class name, imported. Raises `KeyError` for one that is unknown."""
    found: type[Policy] = getattr(_module(CLASSES[name]), name)
    return found


def _module(name: str) -> Any:
    return import_module(f"{_HERE}.{name}")
