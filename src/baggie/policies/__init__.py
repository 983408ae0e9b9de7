"""Everything that maps a picture and a goal to a plan."""

from __future__ import annotations

from pathlib import Path

from baggie.errors import DataError
from baggie.policies import checkpoint
from baggie.policies.base import Policy
from baggie.policies.color_mask import ColorMaskPolicy
from baggie.policies.keypoint import KeypointPolicy
from baggie.policies.learned import LearnedPolicy
from baggie.policies.oracle import OraclePolicy
from baggie.policies.regression import RegressionPolicy

LEARNED: dict[str, type[LearnedPolicy]] = {
    policy.name: policy for policy in (KeypointPolicy, RegressionPolicy)
}
"""Policies that are trained, by name."""

__all__ = [
    "LEARNED",
    "ColorMaskPolicy",
    "KeypointPolicy",
    "LearnedPolicy",
    "OraclePolicy",
    "Policy",
    "RegressionPolicy",
    "load_policy",
]


def load_policy(source: str | Path, device: str = "cpu") -> Policy:
    """The policy saved in a folder, or under a Hub id `owner/name`.

    Raises `DataError` when there is none, or one of its files is missing or damaged.
    """
    folder = checkpoint.fetch(source)
    name = checkpoint.read_config(folder)["policy"]
    if name == ColorMaskPolicy.name:
        return ColorMaskPolicy.load(folder)
    if name not in LEARNED:
        raise DataError(
            f"{folder} holds a policy {name!r}; known are {', '.join([*LEARNED, ColorMaskPolicy.name])}"
        )
    return LEARNED[name].from_pretrained(folder, device)
