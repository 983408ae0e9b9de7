"""What whoever shows how a task is done has in common: the robot that teaches itself, and the script."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

from baggie.data import DatasetWriter
from baggie.options.values import USUAL_TASK, CollectedScenery, CollectedStyle
from baggie.processes import OpenWorker
from baggie.registry import TASKS
from baggie.types import Attempt
from baggie.workcell.workcell import Workcell

Size = tuple[int, int]
Work = TypeVar("Work")
OpenCell = Callable[[int], Workcell]
"""Opens the cell with a number; picklable, because each worker process opens its own."""


@dataclass(frozen=True)
class Recording:
    """What all attempts of one collection have in common."""

    instruction: str
    """The task in words."""
    seed: int
    cell: int
    size: Size
    """`(width, height)` of the recorded pictures, pixels."""
    style: CollectedStyle = "plain"
    """Of whoever demonstrates."""
    depth: bool = False
    """Whether pictures are recorded with the depth that their camera may measure."""
    stacks: bool = False
    """Whether several bags lie about, which the robot builds of."""


class Demonstrator(Protocol, Generic[Work]):
    """Makes a recording's episodes, in pieces of work that depend on the seed, the cell and their number alone."""

    @property
    def robot(self) -> str:
        """What moves."""
        ...

    @property
    def simulated(self) -> bool:
        """Whether the cell is simulated."""
        ...

    @property
    def collection(self) -> Mapping[str, Any]:
        """What a recording says of how it was made."""
        ...

    @property
    def doing(self) -> str:
        """What it does, in words, beside the progress."""
        ...

    @property
    def counted(self) -> str:
        """What `--attempts` counts, in words."""
        ...

    def picture_size(self) -> Size:
        """`(width, height)` at which pictures are recorded unless the recording has a size already."""
        ...

    def begun(self, writer: DatasetWriter) -> int:
        """How many of what `--attempts` counts are recorded, whole or not."""
        ...

    def missing(self, writer: DatasetWriter) -> list[Work]:
        """The work that is still to be done; first what may have been cut short."""
        ...

    def open_worker(self, recording: Recording) -> OpenWorker[Work, list[Attempt]]:
        """What a worker process begins with: it then does piece after piece, and hands over whole episodes."""
        ...

    def summary(self, rate: float | None) -> dict[str, Any]:
        """What the recording came to, ready for JSON; `rate`: how many a minute of what `--attempts` counts, if any."""
        ...


def open_simulated_cell(number: int, task: str = USUAL_TASK, scenery: CollectedScenery = "plain") -> Workcell:
    """The simulated workcell; imported late, because MuJoCo takes its time."""
    from baggie.workcell.simulated import open_simulated  # noqa: PLC0415

    return open_simulated(number, task, scenery=scenery, depth=TASKS[task].depth)
