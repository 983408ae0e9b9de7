"""On what terms an evaluation tries a policy: all else that decides how its episodes end."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Self

from baggie.calibration.files import MAP_FILE
from baggie.evaluation.setup import UNKNOWN, calibration_folder, card_map, fingerprint_of
from baggie.operator import Caution, Operator
from baggie.options.evaluating import EvaluateOptions
from baggie.options.values import USUAL_TASK, GoalKind, Scenery
from baggie.policies import ColorMaskPolicy
from baggie.policies.baselines import CONFIG_FILE
from baggie.registry import TASKS
from baggie.tasks.pattern import PATTERN_FILES, Pattern
from baggie.workcell.workcell_file import read_workcell_file

_GOALS = {"turned": "turned goals", "card": "card"}


@dataclass(frozen=True)
class Terms:
    """What two evaluations have in common whose figures can be compared. None is for what means nothing there."""

    task: str = USUAL_TASK
    cell: int | None = None
    """The number of the simulated one."""
    workcell: str | None = None
    """The file of the real one, whose camera is all that knows where things are; None where it was simulated."""
    pattern: str | None = None
    """Of stacked bags, where that is not the task's own: in words, or all slots as YAML."""
    one_color: bool | None = None
    """Whether all of them are of one colour; None where each has its own."""
    scenery: Scenery | None = None
    """How much of a scene varies; None where nothing can, and where stacked bags are the usual ones."""
    workcell_says: str | None = None
    """A fingerprint of what the file says."""
    goal: GoalKind | None = None
    card_raised: bool | None = None
    """Whether a card's corners were raised to the bag's height, or taken as seen."""
    retries: int | None = None
    calibration: str | None = None
    """A fingerprint of the one that bags are carried by."""

    @classmethod
    def of(cls, options: EvaluateOptions, operator: Operator) -> Self:
        """What the options say; warns of what may surprise."""
        real = options.workcell is not None
        where: dict[str, Any] = {"workcell": str(options.workcell)} if real else {"cell": options.cell}
        if not TASKS[options.task].has_goal:
            by_color = options.policy == ColorMaskPolicy.name
            return cls(
                task=options.task,
                **where,
                pattern=_pattern(options),
                one_color=options.one_color or None,
                scenery=None if options.scenery == "plain" else options.scenery,
                calibration=fingerprint_of(*_maps(options)) or "none given" if by_color else None,
            )
        if options.workcell is not None:
            where["workcell_says"] = _says(options.workcell)
        else:
            where["scenery"] = options.scenery
        return cls(
            task=options.task,
            **where,
            goal=options.goal,
            card_raised=_card_raised(options, operator) if options.goal == "card" else None,
            retries=options.retries,
            calibration=fingerprint_of(*_maps(options)) or "none given",
        )

    @classmethod
    def from_metrics(cls, metrics: Mapping[str, Any]) -> Self:
        """The terms that an evaluation's `metrics.json` says."""
        return cls(**{entry.name: metrics[entry.name] for entry in fields(cls) if entry.name in metrics})

    def to_json(self) -> dict[str, Any]:
        """As `metrics.json` says them, without what means nothing."""
        return {name: value for name, value in asdict(self).items() if value is not None}

    @property
    def place(self) -> str:
        """Which workcell it is, in words."""
        return self.workcell or f"cell {self.cell}"

    @property
    def harder(self) -> str:
        """What differs from the plain closed loop in scenes, goals and patterns, in words; empty for nothing."""
        scenery = self.scenery if self.scenery not in (None, "plain") else ""
        one_color = "one colour" if self.one_color else ""
        return ", ".join(
            filter(None, [self._pattern_in_words, one_color, scenery, _GOALS.get(self.goal or "", "")])
        )

    @property
    def _pattern_in_words(self) -> str:
        if self.pattern is None or not self.pattern.startswith("slots:"):
            return self.pattern or ""
        return f"a pattern of {len(Pattern.parse(self.pattern).slots)} bags"


def _pattern(options: EvaluateOptions) -> str | None:
    """The pattern that is asked for: in words, or what its file says. Raises `BaggieError` for what is none."""
    if options.pattern is None:
        return None
    pattern = Pattern.given(options.pattern)
    return pattern.to_yaml() if Path(options.pattern).suffix in PATTERN_FILES else options.pattern


def _says(workcell: Path) -> str:
    """A fingerprint of what a workcell file says, and the calibrations it names, but for where arm and camera are."""
    if not workcell.exists():
        return UNKNOWN
    file = read_workcell_file(workcell)
    follows = {"bag": file.bag.recorded(), "handling": asdict(file.handled().handling)}
    written = {**file.model_dump(mode="json"), **follows}
    for section in (written["arm"], written["camera"] or {}):
        for address in ("host", "port", "source", "timeout_s"):
            section.pop(address, None)
    maps = [workcell.parent / path for path in written.pop("calibrations").values() if path]
    return fingerprint_of(*maps, besides=json.dumps(written, sort_keys=True).encode())


def _maps(options: EvaluateOptions) -> list[Path]:
    """The files of the calibration that bags are carried by; none where the folder's own is used, or the workcell's."""
    if options.policy == ColorMaskPolicy.name:
        if options.calibration is None:
            return []
        folder = calibration_folder(options.calibration)
        ColorMaskPolicy.load(folder)  # refused before anything is written
        return [folder / CONFIG_FILE, folder / MAP_FILE]
    of_the_card = card_map(options)
    return [] if of_the_card is None else [of_the_card]


def _card_raised(options: EvaluateOptions, operator: Operator) -> bool:
    """Whether a map of the cell is, or will be, known that raises a card's corners to the bag's height."""
    will_be = options.policy == ColorMaskPolicy.name and options.calibration is None
    if will_be or card_map(options) is not None:
        return True
    as_seen = (
        "no calibration of this cell tells how much lower a card lies than a bag's middle; its corners are "
        "taken as seen, some millimetres off at the picture's edge; give --calibration a recording of the cell"
    )
    operator.tell(Caution(as_seen))
    return False
