"""A task of your own with soft things: two bags come to lie side by side.

Shows that bags are things like blocks: any number of them, each of a colour, size and shape of its own, carried by the
hand and seen by the overhead camera. Bags settle by some millimetres, so slots are counted within 1 cm and 15 degrees.

Prints where the bags end, and how much of the task that is:

    step 0: the blue bag lies 0.3 cm from its slot
    step 1: the green bag lies 0.4 cm from its slot
    partial credit 1.00
"""

from __future__ import annotations

from contextlib import closing

import numpy as np

from baggie.geometry import PlanarPose
from baggie.seeds import first_fit
from baggie.sim.bag import FULL_HEIGHT_M, Bag
from baggie.sim.variety import random_pose
from baggie.tasks.conditions import InSlots, Score, Slot
from baggie.tasks.task import Scene, Setting, Task
from baggie.workcell.simulated import SimulatedWorkcell

BAGS = (
    Bag(length_m=0.10, width_m=0.10, mass_kg=0.14, color=(50, 90, 190), name="blue bag"),
    Bag(length_m=0.10, width_m=0.10, mass_kg=0.14, color=(60, 150, 70), name="green bag"),
)
SLOTS = tuple(Slot(PlanarPose(0.5, y), FULL_HEIGHT_M / 2) for y in (0.07, -0.07))
APART_M = 0.18


def draw(rng: np.random.Generator, setting: Setting) -> Scene:
    """The bags away from each other and from where they are to go."""
    taken = [slot.pose for slot in SLOTS]
    poses = {}
    for bag in BAGS:
        pose = first_fit(
            lambda: random_pose(setting.workspace, rng),
            lambda here: all(here.distance(other) > APART_M for other in taken),
        )
        assert pose is not None
        poses[bag.name] = pose
        taken.append(pose)
    conditions = [InSlots((bag.name,), (slot,), weight=0.5) for bag, slot in zip(BAGS, SLOTS, strict=True)]
    return Scene(BAGS, poses, tuple(conditions))


TASK = Task(
    name="two-bags-side-by-side",
    instruction="Lay the blue bag and the green one side by side.",
    tool="hand",
    view="camera",
    things=BAGS,
    draw_scene=draw,
    max_steps=4,
    object_symmetry=4,
)


def main() -> None:
    """Play one scene to its end."""
    with closing(SimulatedWorkcell(0, TASK)) as cell:
        cell.reset((2,))
        score = Score(cell.scene.conditions)
        for step, (bag, slot) in enumerate(zip(BAGS, SLOTS, strict=True)):
            action = cell.demonstrate()
            if action is None:
                break
            cell.execute(action)
            score.count(cell.state())
            off_cm = 100 * cell.world.planar_pose(bag.name).distance(slot.pose)
            print(f"step {step}: the {bag.name} lies {off_cm:.1f} cm from its slot")
        print(f"partial credit {score.total:.2f}")


if __name__ == "__main__":
    main()
