"""The loop in the simulator: look, plan, carry out.

Shows the whole of Baggie in five lines. The policy is the oracle, which is told the truth by the simulator, so that
nothing has to be collected or trained first; every other policy stands in the same place.

Prints where the bag lay, whether it was grasped, carried and put down, and how far from its goal it ended:

    the bag lies at (0.536, -0.129), and is to go to (0.500, 0.150)
    picked at (0.536, -0.129), placed at (0.500, 0.150): success
    it ended 1 mm from its goal
"""

from __future__ import annotations

from baggie.geometry import PlanarPose
from baggie.policies import OraclePolicy
from baggie.workcell.simulated import open_simulated

GOAL = PlanarPose(0.50, 0.15, yaw=0.0)
"""Metres and radians in the robot's base frame: x forward, y left."""


def main() -> None:
    """One turn of the loop."""
    cell = open_simulated(cell=0)
    cell.give_goal(GOAL)
    policy = OraclePolicy(cell.demonstrate)
    bag = cell.truth()
    print(f"the bag lies at ({bag.x:.3f}, {bag.y:.3f}), and is to go to ({GOAL.x:.3f}, {GOAL.y:.3f})")

    observation = cell.look()  # the arm moves out of view; colour and depth from above
    plan = policy.plan(observation)  # poses for the robot
    outcome = cell.carry_out(plan)  # where the arm really was

    pick, place = outcome.executed.pick, outcome.executed.place
    ended = "success" if outcome.success else outcome.failure
    print(f"picked at ({pick.x:.3f}, {pick.y:.3f}), placed at ({place.x:.3f}, {place.y:.3f}): {ended}")
    print(f"it ended {1000 * cell.truth().distance(GOAL):.0f} mm from its goal")
    cell.close()


if __name__ == "__main__":
    main()
