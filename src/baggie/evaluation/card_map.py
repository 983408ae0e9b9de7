"""The map of a cell with which a card's corners are raised to where a bag on it would be seen."""

from __future__ import annotations

from pathlib import Path

from baggie.calibration.files import MAP_FILE
from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.data.layout import CALIBRATION_FOLDER
from baggie.evaluation.options import EvaluateOptions
from baggie.evaluation.subjects import config_of, in_its_cell
from baggie.policies import ColorMaskPolicy


def card_map(options: EvaluateOptions) -> Path | None:
    """The map that raises a card's corners to the bag's height, if one is known: the calibration of the recording
    given, or of the one the policy was trained on, or that of `color-mask`.
    """
    if options.goal != "card":
        return None
    trained_on = config_of(options.policy).get("training", {}).get("data")
    own = options.out if options.policy == ColorMaskPolicy.name else trained_on
    given = options.calibration or own
    if given is None or (options.calibration is None and not in_its_cell(options.policy, options.cell)):
        return None
    return next(
        (f for f in (Path(given, CALIBRATION_FOLDER, MAP_FILE), Path(given, MAP_FILE)) if _raises(f)), None
    )


def _raises(map_file: Path) -> bool:
    """Whether there is a map that knows more than one height."""
    return map_file.exists() and ImageToRobot.load(map_file).height_aware
