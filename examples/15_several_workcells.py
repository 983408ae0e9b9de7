"""Several workcells side by side: one process each.

Shows how to use all cores: each process opens a workcell of its own, whose camera, lens, lamps and table its number
draws, and hands back numbers, not pictures. Processes are spawned, never forked: OpenGL does not survive a fork.
(`baggie collect` and `baggie evaluate` do the same by themselves: `--workers`.)

Prints how near to its goal the bag came in each:

    cell 0: 1 mm
    cell 1: 8 mm
    cell 2: 1 mm
"""

from __future__ import annotations

import multiprocessing

from baggie.geometry import PlanarPose
from baggie.policies import OraclePolicy
from baggie.workcell.simulated import open_simulated

CELLS = range(3)
GOAL = PlanarPose(0.50, 0.15)


def work(number: int) -> float:
    """One turn of the loop in a workcell; how far from its goal the bag ended, metres."""
    cell = open_simulated(number)
    try:
        cell.reset((0, number))  # the scene that these integers name
        cell.give_goal(GOAL)
        policy = OraclePolicy(cell.demonstrate)
        cell.carry_out(policy.plan(cell.look()))
        return cell.truth().distance(GOAL)
    finally:
        cell.close()


def main() -> None:
    """Two at a time."""
    with multiprocessing.get_context("spawn").Pool(processes=2) as pool:
        for number, distance in zip(CELLS, pool.imap(work, CELLS), strict=True):
            print(f"cell {number}: {1000 * distance:.0f} mm")


if __name__ == "__main__":
    main()
