"""A task of your own with rigid things: what lies on the table, where, and what counts.

Shows that a task is plain data and a function that draws scenes. From what counts, the conditions, follow the scripted
demonstrator, the score as Ravens counts it, and strict success: every block upright in a slot of its own, and still so
two seconds later. `check_task` of `baggie.collect.task_contract` says whether a task keeps its promises; as an entry
point of a package (examples/outside_package) it is known to every command.

Prints what the demonstrator does, and what that earns:

    Put the small block onto the large one.
    step 0: earned 1.00 of 1
    done, strictly: True
"""

from __future__ import annotations

from contextlib import closing

import numpy as np

from baggie.geometry import PlanarPose
from baggie.sim.objects import Block, Fixture, Part
from baggie.tasks.conditions import InSlots, Score, Slot, strict_success
from baggie.tasks.layout import COLORS, radius_m, scatter
from baggie.tasks.task import Scene, Setting, Task
from baggie.workcell.simulated import SimulatedWorkcell

SMALL = Block("small block", (0.04, 0.04, 0.04), COLORS["blue"])
LARGE = Fixture("large block", (Part((0.08, 0.08, 0.03), COLORS["yellow"], (0.0, 0.0, 0.015)),))
RADII_M = {"small block": radius_m((0.04, 0.04)), "large block": radius_m((0.08, 0.08))}
ON_TOP = Slot(PlanarPose(0.0, 0.0), 0.03 + 0.02, frame="large block")


def draw(rng: np.random.Generator, _setting: Setting) -> Scene:
    """Anywhere on the table, apart; what counts is the small block's place on the large one."""
    return Scene((SMALL, LARGE), scatter(RADII_M, rng), (InSlots(("small block",), (ON_TOP,), weight=1.0),))


TASK = Task(
    name="small-on-large",
    instruction="Put the small block onto the large one.",
    tool="cup",
    view="height-map",
    things=(SMALL, LARGE),
    draw_scene=draw,
    max_steps=2,
    object_symmetry=4,
)


def main() -> None:
    """Play one scene to its end."""
    with closing(SimulatedWorkcell(0, TASK)) as cell:
        cell.reset((1,))
        print(TASK.instruction)
        score, step = Score(cell.scene.conditions), 0
        while (action := cell.demonstrate()) is not None:
            cell.execute(action)
            print(f"step {step}: earned {score.count(cell.state()):.2f} of 1")
            step += 1
        print(f"done, strictly: {strict_success(cell.scene.conditions, cell)}")


if __name__ == "__main__":
    main()
