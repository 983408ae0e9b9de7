"""Tasks by name. A new one is one file and one line here."""

from __future__ import annotations

from baggie.errors import BaggieError
from baggie.tasks.align_box_corner import ALIGN_BOX_CORNER
from baggie.tasks.bag_place import BAG_PLACE
from baggie.tasks.block_insertion import BLOCK_INSERTION
from baggie.tasks.block_pyramid import BLOCK_PYRAMID
from baggie.tasks.place_red_in_green import PLACE_RED_IN_GREEN
from baggie.tasks.task import Scene, Setting, Slot, Stage, Task

__all__ = ["TASKS", "USUAL", "Scene", "Setting", "Slot", "Stage", "Task", "find_task"]

TASKS: dict[str, Task] = {
    task.name: task
    for task in (BAG_PLACE, BLOCK_PYRAMID, PLACE_RED_IN_GREEN, ALIGN_BOX_CORNER, BLOCK_INSERTION)
}
USUAL = BAG_PLACE.name
"""The task where none is named."""


def find_task(name: str) -> Task:
    """The task of this name. Raises `BaggieError` where there is none."""
    if name not in TASKS:
        raise BaggieError(f"expected a task, one of {', '.join(TASKS)}, got {name!r}")
    return TASKS[name]
