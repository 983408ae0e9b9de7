"""`baggie workcell show`: all that a workcell file says, and what follows from it."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from baggie.errors import BaggieError
from baggie.import_errors import explained
from baggie.workcell.arm import ArmInfo
from baggie.workcell.workcell_file import read_workcell_file


def shown_workcell(path: Path) -> dict[str, Any]:
    """What is written and what is left to defaults; of `handling` each value, and what it comes from.

    Nothing is connected. Raises `BaggieError` for a file that cannot be used, and for a handling that this arm cannot
    do; where the arm cannot be made here, `gripper` says why, and nothing follows from it.
    """
    written = read_workcell_file(path)
    arm: ArmInfo | None = None
    gripper = "of no real arm"
    try:
        from baggie.workcell.config import arm_of  # noqa: PLC0415 -- MuJoCo takes its time, and may not be whole

        arm = arm_of(written, path)
    except BaggieError as error:
        gripper = f"not known here: {error}"
    except ImportError as error:
        if (known := explained(error)) is None:
            raise
        gripper = f"not known here: {known}"
    if arm is not None:
        if line := written.contradiction(arm):
            raise BaggieError(f"{path}: {line}")
        gripper = f"of {arm.name}: opens to {arm.max_width_m:g} m"
    found = written.handled(arm)
    handling = {
        name: {"value": value, "source": found.sources[name]}
        for name, value in asdict(found.handling).items()
    }
    return {**written.model_dump(mode="json"), "gripper": gripper, "handling": handling}
