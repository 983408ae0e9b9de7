"""Whom an evaluation is about: what `--policy` may name."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

from baggie.data.files import CALIBRATION_FOLDER
from baggie.errors import BaggieError
from baggie.policies import ColorMaskPolicy, OraclePolicy, Policy, checkpoint, load_policy
from baggie.registry import TASKS

_BY_CAMERA, _FROM_ABOVE = ("keypoint", "regression", ColorMaskPolicy.name), "transporter"
"""Policies that look at a camera's pictures, and the one that looks at height maps, unless it has a camera."""
NAMED = (ColorMaskPolicy.name, OraclePolicy.name)
"""Policies that are not loaded from anywhere."""
UNKNOWN = ""
"""The fingerprint of what is not there."""


def open_policy(policy: str, calibration: Path | None, device: str = "cpu") -> Policy:
    """The policy of a run's folder or a Hub id, or `color-mask` with the calibration of a recording.

    `device`: where a learned one computes, in PyTorch's words. Raises `BaggieError` when there is none.
    """
    if policy == OraclePolicy.name:
        raise BaggieError("the oracle reads the simulator's truth: it can only be evaluated in a cell")
    if policy != ColorMaskPolicy.name:
        return load_policy(policy, device)
    if calibration is None:
        raise BaggieError("color-mask needs a calibration: give --calibration a recording of the cell")
    return ColorMaskPolicy.load(calibration_folder(calibration))


def calibration_folder(given: Path) -> Path:
    """Where the calibration of a recording is; `given` may be that folder itself."""
    inside = given / CALIBRATION_FOLDER
    return inside if inside.is_dir() else given


def config_of(policy: str) -> dict[str, Any]:
    """The `config.yaml` of a run's folder or a Hub id; empty for a policy known by name."""
    return {} if policy in NAMED else checkpoint.read_config(checkpoint.fetch(policy))


def in_its_cell(policy: str, cell: int) -> bool:
    """Whether a policy, if it was trained, was trained in this cell."""
    return bool(config_of(policy).get("cell", cell) == cell)


def check_taught(policy: str, task: str) -> None:
    """Raise `BaggieError` where a policy was taught another task, or looks at other pictures than this one shows."""
    config = config_of(policy)
    if not config:
        return
    instruction = config.get("training", {}).get("task")  # None of a run begun before runs said so
    words = {name: known.instruction for name, known in TASKS.all().items()}
    taught = next((name for name in words if words[name] == instruction), task)
    if taught != task:
        raise BaggieError(
            f"expected a policy that was taught {task}, got {policy}, which was taught {taught}; "
            f"give --task {taught}, or another policy"
        )
    if config["policy"] not in (*_BY_CAMERA, _FROM_ABOVE):  # another package's knows itself what it looks at
        return
    from_above = config["policy"] == _FROM_ABOVE and config.get("model", {}).get("camera") is None
    if from_above != (TASKS[task].view == "height-map"):
        looks, needed = ("height maps", "a camera's pictures")[:: 1 if from_above else -1]
        raise BaggieError(
            f"expected a policy that looks at {needed} with --task {task}, got {policy}, which looks at {looks}; "
            "give the --task that it was taught"
        )


def policy_name(policy: str) -> str:
    """What `--policy` names: `keypoint` for the folder or Hub id of such a run, itself for a name."""
    return policy if policy in NAMED else str(config_of(policy)["policy"])


def fingerprint(policy: str) -> str:
    """Changes when a run is trained or exported again: the hash of its weights; `UNKNOWN` for what has none."""
    if policy in NAMED:
        return UNKNOWN
    folder = checkpoint.fetch(policy)
    return fingerprint_of(
        folder / (checkpoint.GRAPH if checkpoint.is_exported(folder) else checkpoint.WEIGHTS)
    )


def fingerprint_of(*files: Path, besides: bytes = b"") -> str:
    """Changes when one of the files does: a hash of those there are, `UNKNOWN` where there is none."""
    contents = [besides, *(path.read_bytes() for path in files if path.exists())]
    return hashlib.sha256(b"".join(contents)).hexdigest()[:16] if any(contents) else UNKNOWN
