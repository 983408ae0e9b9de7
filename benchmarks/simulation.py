"""How fast the simulated workcell runs, on one core: physics, pictures, whole attempts.

    python benchmarks/simulation.py

Physics stands beside the same world without its soft bag. Medians of interleaved rounds, with the fastest and slowest.
"""

from __future__ import annotations

import resource
import time
from collections.abc import Callable

import mujoco
import numpy as np

from baggie.geometry import PlanarPose, wrap_angle
from baggie.robot.primitives import pick
from baggie.sim.scene import TIMESTEP_S, arm_spec
from baggie.types import PickPlace
from baggie.workcell.simulated import SimulatedWorkcell, open_simulated

ROUNDS = 7
STEPS = 100


def main() -> None:
    cell = open_simulated(0)
    world = cell.world
    arm = arm_spec().compile()
    arm_data = mujoco.MjData(arm)
    cell.reset((0,))
    resting = mujoco.MjData(world.model)
    mujoco.mj_copyData(resting, world.model, world.data)
    pick(cell.arm, cell.truth(), cell.settings.handling)
    held = mujoco.MjData(world.model)
    mujoco.mj_copyData(held, world.model, world.data)
    world.model.opt.timestep = TIMESTEP_S

    def steps(model: mujoco.MjModel, data: mujoco.MjData) -> Callable[[], None]:
        return lambda: [mujoco.mj_step(model, data) for _ in range(STEPS)] and None

    print("physics, ms a step")
    table(
        {
            "the arm alone": steps(arm, arm_data),
            "bag on the table": steps(world.model, resting),
            "bag in the hand": steps(world.model, held),
        },
        per=STEPS,
    )
    cell.reset((0,))
    print("\npictures, ms each")
    table({"1280 x 720, colour and depth, lens, noise": lambda: cell.camera.look() and None})
    print("\nwhole attempts, ms each")
    table({"look, pick, carry, place, look": lambda: attempt(cell)})
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"\npeak memory {peak:.0f} MiB")


def attempt(cell: SimulatedWorkcell) -> None:
    """One attempt by the simulator's own truth."""
    cell.look()
    bag = cell.truth()
    start = PlanarPose(bag.x, bag.y, wrap_angle(bag.yaw, np.pi / 2))
    cell.execute(PickPlace(start, PlanarPose(0.5, -0.12 if bag.y > 0 else 0.12)))
    cell.look()


def table(cases: dict[str, Callable[[], None]], per: int = 1) -> None:
    """Run the cases in turn, and print what each took."""
    times: dict[str, list[float]] = {name: [] for name in cases}
    for turn in range(ROUNDS + 1):
        for name, run in cases.items():
            start = time.perf_counter()
            run()
            if turn:  # the first warms up
                times[name].append(1000 * (time.perf_counter() - start) / per)
    print(f"{'':<44}{'median':>10}{'fastest':>10}{'slowest':>10}{'per second':>12}")
    for name, values in times.items():
        median = float(np.median(values))
        print(f"{name:<44}{median:>10.2f}{min(values):>10.2f}{max(values):>10.2f}{1000 / median:>12.1f}")


if __name__ == "__main__":
    main()
