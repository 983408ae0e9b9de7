"""Everything that maps a picture and a goal to a plan."""

from __future__ import annotations

from typing import TYPE_CHECKING

from baggie.policies.base import CLASSES, Policy, class_named, load_policy

if TYPE_CHECKING:
    from baggie.policies.baselines import ColorMaskPolicy, OraclePolicy
    from baggie.policies.keypoint.policy import KeypointPolicy
    from baggie.policies.learned import LearnedPolicy
    from baggie.policies.regression import RegressionPolicy
    from baggie.policies.transporter.policy import TransporterPolicy

__all__ = [
    "ColorMaskPolicy",
    "KeypointPolicy",
    "LearnedPolicy",
    "OraclePolicy",
    "Policy",
    "RegressionPolicy",
    "TransporterPolicy",
    "load_policy",
]


def __getattr__(name: str) -> type[Policy]:
    if name not in CLASSES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return class_named(name)
