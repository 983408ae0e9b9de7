"""Tasks for the workcell with blocks, by name. A new one is one file and one line here."""

from __future__ import annotations

from baggie.errors import BaggieError
from baggie.tasks.align_box_corner import ALIGN_BOX_CORNER
from baggie.tasks.block_insertion import BLOCK_INSERTION
from baggie.tasks.block_pyramid import BLOCK_PYRAMID
from baggie.tasks.place_red_in_green import PLACE_RED_IN_GREEN
from baggie.tasks.task import Scene, Slot, Stage, Task

__all__ = ["TASKS", "Scene", "Slot", "Stage", "Task", "find_task"]

TASKS: dict[str, Task] = {
    task.name: task for task in (BLOCK_PYRAMID, PLACE_RED_IN_GREEN, ALIGN_BOX_CORNER, BLOCK_INSERTION)
}


def find_task(name: str) -> Task:
    """The task of this name. Raises `BaggieError` where there is none."""
    if name not in TASKS:
        raise BaggieError(f"expected a task, one of {', '.join(TASKS)}, got {name!r}")
    return TASKS[name]
