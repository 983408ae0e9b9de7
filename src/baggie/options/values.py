"""Values of options: words to choose from, what is meant where none is given, and numbers with their intervals."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import fields
from typing import Annotated, Any, Literal, get_args, get_type_hints

from annotated_types import Interval

from baggie.errors import UsageError

USUAL_TASK = "bag-place"
"""The task where none is named."""

Scenery = Literal["plain", "light", "varied", "unseen-bag", "unseen", "two-bags"]
"""What a scene with bags shows."""
CollectedScenery = Literal["plain", "varied"]
"""What a recording may show: what others show is kept for evaluation."""
CollectedStyle = Literal["plain", "varied"]
"""How whoever demonstrates goes about it."""
GoalKind = Literal["virtual", "turned", "card"]
"""How a goal is given: marked square to the workspace, marked at any angle, or by a card that really lies there."""
DrawnStyle = Literal["outline", "solid"]
"""How a goal is drawn or printed."""

Backbone = Literal["small", "resnet18"]
"""What sees, in a `keypoint` policy."""
Statistics = Literal["running", "picture"]
"""What a trained network normalises by: averages over its training, as published, or each picture's own."""
Preset = Literal["fast", "paper"]
"""Of a `transporter` policy: `fast` is ours; `paper` has the published sizes."""

COLOR_MASK, ORACLE = "color-mask", "oracle"
"""Policies that nobody has to train: the one that goes by a bag's colour, the one that knows the truth."""

CARD_COLOR = (26, 140, 51)
"""RGB of the cards that `baggie print-target goal-card` makes."""
HAND_MARKER = "aruco:DICT_4X4_50:0:0.060"
"""On the plate in front of the fingertips, for `image-to-robot` and `check`."""
TABLE_MARKER = "aruco:DICT_4X4_50:1:0.060"
"""Laid on the table, to be touched by `check`."""
BOARD = "charuco:12x8:0.032:0.024:DICT_4X4_50"
"""For everything else: held in front of the camera, laid on the table. As large as A3 allows: with a board half as
large the focal length is three times as uncertain, and the camera's angle four times."""
HAND_BOARD = "charuco:5x4:0.020:0.015:DICT_4X4_50"
"""On the plate in the hand, for `hand-eye`."""


_MANY = 10**7
"""More than anybody has time for, and few enough to be listed."""
Number = Annotated[int, Interval(ge=0, le=_MANY)]
"""How many, none perhaps."""
Count = Annotated[int, Interval(ge=1, le=_MANY)]
"""How many, at least one."""
Seed = Annotated[int, Interval(ge=0, le=2**63 - 1)]
"""What names something random: whatever fits a column of a recording."""
Workers = Annotated[int, Interval(ge=1, le=1024)]
"""How many processes."""
Port = Annotated[int, Interval(ge=0, le=65535)]
"""A port of this computer; 0 for any that is free."""
Share = Annotated[float, Interval(ge=0, le=1)]
Positive = Annotated[float, Interval(gt=0)]
NotNegative = Annotated[float, Interval(ge=0)]
Coordinate = Annotated[float, Interval(ge=-10, le=10)]
"""Metres in the frame of a robot or of its hand; more would be millimetres."""
Bounds = tuple[Coordinate, Coordinate]
Point = tuple[Coordinate, Coordinate, Coordinate]
Height = Annotated[float, Interval(ge=0, le=2)]
"""Metres above the table."""
Channel = Annotated[int, Interval(ge=0, le=255)]
Color = tuple[Channel, Channel, Channel]
"""RGB."""


class Options:
    """What a command may be asked: dataclasses of this kind raise `UsageError` for numbers outside their intervals."""

    def __post_init__(self) -> None:
        for name, hint in hints(type(self)).items():
            for number, interval in intervals(hint, getattr(self, name)):
                if not _contains(interval, number):
                    option = name.rstrip("_").replace("_", "-")
                    raise UsageError(f"expected --{option} to be a number {_words(interval)}, got {number}")


def hints(kind: type[Options]) -> dict[str, Any]:
    """The types of all options by name, with their intervals."""
    known = get_type_hints(kind, include_extras=True)
    return {each.name: known[each.name] for each in fields(kind)}  # type: ignore[arg-type]  # it is a dataclass


def intervals(hint: Any, value: Any) -> Iterator[tuple[float, Interval]]:
    """The numbers in a value of this type that have an interval, alone or in tuples, and their intervals."""
    interval = next((each for each in getattr(hint, "__metadata__", ()) if isinstance(each, Interval)), None)
    if interval is not None and isinstance(value, int | float):
        yield value, interval
    elif isinstance(value, tuple) and interval is None:
        inner = [each for each in get_args(hint) if each is not ...]
        for position, part in enumerate(value):
            yield from intervals(inner[min(position, len(inner) - 1)], part)
    else:
        for alternative in get_args(hint):
            yield from intervals(alternative, value)


def _contains(interval: Interval, number: float) -> bool:
    """Whether it lies in there; NaN and the infinities never do."""
    low, above, high = interval.ge, interval.gt, interval.le
    return (
        math.isfinite(number)
        and (low is None or number >= low)  # type: ignore[operator]  # bounds are numbers
        and (above is None or number > above)  # type: ignore[operator]
        and (high is None or number <= high)  # type: ignore[operator]
    )


def _words(interval: Interval) -> str:
    if interval.ge is not None and interval.le is not None:
        return f"from {interval.ge} to {interval.le}"
    at_least = f"of at least {interval.ge}" if interval.gt is None else f"above {interval.gt}"
    return at_least if interval.le is None else f"{at_least} and at most {interval.le}"
