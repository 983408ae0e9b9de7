"""How long a pick-and-place of a rigid block takes, on one thread, and where the time goes.

    OMP_NUM_THREADS=1 python benchmarks/block_simulation.py

An episode is a pyramid of six 4 cm blocks on a stand, built by `pick` and `place` with the simulator's own truth.
"Other" is the arm's timing, the force at the wrist and the seal's. Processor time, so that a busy machine counts less.
"""

from __future__ import annotations

import time
from collections import defaultdict
from typing import Any

import mujoco
import numpy as np

from baggie.geometry import PlanarPose, wrap_angle
from baggie.robot.kinematics import Kinematics
from baggie.robot.primitives import pick, place
from baggie.sim.arm import BLOCK_HANDLING, SuctionArm
from baggie.sim.cell import draw_cell
from baggie.sim.objects import Block, stand
from baggie.sim.world import World
from stopwatch import timed

EPISODES = 5
PLACES = (-0.042, 0.0, 0.042, -0.021, 0.021, 0.0)
BLOCKS = [f"block{number}" for number in range(len(PLACES))]


def main() -> None:
    world = World(draw_cell(0), [*map(Block, BLOCKS), stand()], "cup")
    arm = SuctionArm(world)
    spent: defaultdict[str, float] = defaultdict(float)
    steps = [0]
    step = mujoco.mj_step

    def counted(model: Any, data: Any, number: int = 1) -> None:
        steps[0] += number
        step(model, data, number)

    mujoco.mj_step = timed(counted, "physics", spent)
    Kinematics.line = timed(Kinematics.line, "inverse kinematics", spent)  # type: ignore[method-assign]
    totals, simulated, off_m, off_rad = [], [], [], []
    for number in range(EPISODES + 1):
        base, poses = scene(np.random.default_rng(number))
        world.reset({**poses, "stand": base})
        arm.reset()
        if number == 1:  # the first warms up
            spent.clear()
            steps[0] = 0
        start, clock = time.process_time(), world.time
        for name, along in zip(BLOCKS, PLACES, strict=True):
            goal = base @ PlanarPose(0.0, along)
            pick(arm, world.planar_pose(name), BLOCK_HANDLING)
            place(arm, goal, BLOCK_HANDLING)
            there = world.planar_pose(name)
            off_m.append(there.distance(goal))
            off_rad.append(abs(wrap_angle(there.yaw - goal.yaw)))
        if number:
            totals.append(time.process_time() - start)
            simulated.append(world.time - clock)
    moves = EPISODES * len(BLOCKS)
    spent["other"] = sum(totals) - spent["physics"] - spent["inverse kinematics"]
    print(
        f"an episode of {len(BLOCKS)}: median {np.median(totals):.2f} s, {min(totals):.2f}..{max(totals):.2f}"
    )
    print(
        f"a pick-and-place: {1000 * sum(totals) / moves:.0f} ms for {sum(simulated) / moves:.2f} s of simulation"
    )
    for name, seconds in spent.items():
        print(f"    {name:<20}{1000 * seconds / moves:>6.0f} ms")
    print(f"    {steps[0] / moves:.0f} steps of {1e6 * spent['physics'] / steps[0]:.0f} microseconds")
    print(f"placed within: median {1000 * np.median(off_m):.2f} mm, worst {1000 * max(off_m):.2f} mm,")
    print(f"    median {np.rad2deg(np.median(off_rad)):.2f} degrees, worst {np.rad2deg(max(off_rad)):.2f}")


def scene(rng: np.random.Generator) -> tuple[PlanarPose, dict[str, PlanarPose]]:
    """Where the stand and the blocks are at first: blocks to the robot's right, the stand to its left."""
    base = PlanarPose(rng.uniform(0.42, 0.58), rng.uniform(0.12, 0.22), rng.uniform(-0.5, 0.5))
    poses = {
        name: PlanarPose(
            0.42 + 0.08 * (number % 3), -0.22 + 0.1 * (number // 3), float(rng.uniform(-0.7, 0.7))
        )
        for number, name in enumerate(BLOCKS)
    }
    return base, poses


if __name__ == "__main__":
    main()
