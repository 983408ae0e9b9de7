"""Everything that maps a picture and a goal to a plan."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from baggie.errors import DataError
from baggie.policies import checkpoint
from baggie.policies.base import Policy

if TYPE_CHECKING:
    from baggie.policies.color_mask import ColorMaskPolicy
    from baggie.policies.keypoint import KeypointPolicy
    from baggie.policies.learned import LearnedPolicy
    from baggie.policies.oracle import DemonstratorPolicy, OraclePolicy
    from baggie.policies.regression import RegressionPolicy
    from baggie.policies.transporter.policy import TransporterPolicy

__all__ = [
    "ColorMaskPolicy",
    "DemonstratorPolicy",
    "KeypointPolicy",
    "LearnedPolicy",
    "OraclePolicy",
    "Policy",
    "RegressionPolicy",
    "TransporterPolicy",
    "load_policy",
]

_MODULES = {
    "ColorMaskPolicy": "color_mask",
    "DemonstratorPolicy": "oracle",
    "KeypointPolicy": "keypoint",
    "LearnedPolicy": "learned",
    "OraclePolicy": "oracle",
    "RegressionPolicy": "regression",
    "TransporterPolicy": "transporter.policy",
}
"""Each is imported when it is first needed: an exported policy must run where there is no PyTorch."""
_LEARNED = {
    "keypoint": "KeypointPolicy",
    "regression": "RegressionPolicy",
    "transporter": "TransporterPolicy",
}
_COLOR_MASK = "color-mask"


def load_policy(source: str | Path, device: str = "cpu") -> Policy:
    """The policy saved in a folder, or under a Hub id `owner/name`: a training run's, or what `baggie export` made.

    Raises `DataError` when there is none, one of its files is missing or damaged, or what would run it is not
    installed.
    """
    folder = checkpoint.fetch(source)
    name = checkpoint.read_config(folder)["policy"]
    if name == _COLOR_MASK:
        from baggie.policies.color_mask import ColorMaskPolicy  # noqa: PLC0415

        return ColorMaskPolicy.load(folder)
    if name not in _LEARNED:
        raise DataError(f"{folder} holds a policy {name!r}; known are {', '.join([*_LEARNED, _COLOR_MASK])}")
    if checkpoint.is_exported(folder):
        from baggie.policies.exported import load_exported  # noqa: PLC0415

        return load_exported(folder, device)
    try:
        kind: type[Policy] = __getattr__(_LEARNED[name])
    except ModuleNotFoundError as error:
        if error.name != "torch":
            raise
        raise DataError(
            f"{folder} needs PyTorch, which is not installed here: export it where it is, with `baggie export`"
        ) from None
    return kind.from_pretrained(folder, device)


def __getattr__(name: str) -> type[Policy]:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found: type[Policy] = getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
    return found
