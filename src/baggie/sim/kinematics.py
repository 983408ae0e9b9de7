"""Inverse kinematics of the arm: straight tool paths as joint trajectories, and single poses at any tilt."""

from __future__ import annotations

import mink
import mujoco
import numpy as np

from baggie.errors import ReachError
from baggie.geometry import (
    FloatArray,
    ToolPose,
    from_vector,
    hand_matrix,
    invert_transform,
    to_vector,
    tool_pose,
)

CONTROL_PERIOD_S = 0.02
ARM_JOINTS = 7
POSITION_TOLERANCE_M = 0.0005
ROTATION_TOLERANCE_RAD = 0.002
_STEP = 0.03  # metres and, for yaw, radians/5 between two solutions; between them joints are interpolated


class Kinematics:
    """The arm alone, without scene or bag: forward and inverse kinematics at joint positions `q` `(7,)` radians."""

    def __init__(self, arm: mujoco.MjModel, home: FloatArray) -> None:
        self._configuration = mink.Configuration(arm)
        self._task = mink.FrameTask("tool", "site", position_cost=1.0, orientation_cost=0.3, lm_damping=1e-4)
        # The elbow is free: draw it gently home, so that the same pose always has about the same joints.
        self._posture = mink.PostureTask(arm, cost=[2e-3] * ARM_JOINTS + [0.0] * (arm.nq - ARM_JOINTS))
        self._limits = [mink.ConfigurationLimit(arm)]
        self._posture.set_target(self._full(home))

    def tool_pose(self, q: FloatArray) -> ToolPose:
        """Forward kinematics."""
        return tool_pose(self.hand_pose(q))

    def hand_pose(self, q: FloatArray) -> FloatArray:
        """`T_base_hand` `(4, 4)` by forward kinematics, tilted or not; the hand's frame is that of `hand_matrix`."""
        self._configuration.update(self._full(q))
        return np.asarray(self._configuration.get_transform_frame_to_world("tool", "site").as_matrix(), float)

    def line(self, start: FloatArray, target: ToolPose) -> FloatArray:
        """Joint positions `(N, 7)` along the straight line from `start` `(7,)` to `target`, both ends included.

        Raises `ReachError` when the arm cannot follow it within its joint limits.
        """
        here = self.tool_pose(start)
        length = max(float(np.linalg.norm(target.xyz - here.xyz)), abs(target.yaw - here.yaw) / 5)
        count = max(int(np.ceil(length / _STEP)), 1)
        self._configuration.update(self._full(start))
        path = [np.asarray(start, float)]
        for fraction in np.linspace(0, 1, count + 1)[1:]:
            xyz = here.xyz + fraction * (target.xyz - here.xyz)
            yaw = here.yaw + fraction * (target.yaw - here.yaw)
            step = hand_matrix(ToolPose(float(xyz[0]), float(xyz[1]), float(xyz[2]), yaw))
            path.append(self._solve(step, iterations=30 if fraction == 1.0 else 3))
        if not self._is_there():
            turned = f"pointing down at yaw {np.rad2deg(target.yaw):.0f} degrees"
            raise self._unreachable(target.xyz, turned)
        return np.array(path)

    def reach(self, start: FloatArray, transform: FloatArray) -> FloatArray:
        """Joint positions `(7,)` that bring the hand to `transform`, `T_base_hand` `(4, 4)`, found from `start` `(7,)`.

        The hand is led there in small steps, so that the elbow does not flip. Raises `ReachError` when the arm cannot
        get there within its joint limits.
        """
        here = self.hand_pose(start)
        way = to_vector(invert_transform(here) @ transform)
        length = max(float(np.linalg.norm(way[3:])), float(np.linalg.norm(way[:3])) / 5)
        count = max(int(np.ceil(length / _STEP)), 1)
        for fraction in np.linspace(0, 1, count + 1)[1:-1]:
            self._solve(here @ from_vector(fraction * way), iterations=3)
        solution = self._solve(transform, iterations=100)
        if self._is_there():
            return solution
        tilt = np.arccos(np.clip(-transform[2, 2], -1.0, 1.0))
        raise self._unreachable(transform[:3, 3], f"tilted by {np.rad2deg(tilt):.0f} degrees")

    def approach(self, start: FloatArray, transform: FloatArray) -> FloatArray:
        """Joint positions `(7,)` for `transform`, `T_base_hand` `(4, 4)`, a centimetre or so from those of `start`.

        For following, a step at a time: there to a tenth of a millimetre, or as near as joint limits allow.
        """
        self._configuration.update(self._full(start))
        return self._solve(transform, iterations=2)

    def _solve(self, transform: FloatArray, iterations: int) -> FloatArray:
        """Joint positions `(7,)` nearer to `T_base_hand` `(4, 4)`, from those of the last solution."""
        self._task.set_target(mink.SE3.from_matrix(transform))
        for _ in range(iterations):
            velocity = mink.solve_ik(
                self._configuration,
                [self._task, self._posture],
                dt=1.0,
                solver="daqp",
                damping=1e-5,
                limits=self._limits,
            )
            self._configuration.integrate_inplace(velocity, 1.0)
            error = self._task.compute_error(self._configuration)
            if np.linalg.norm(error[:3]) < 5e-5 and np.linalg.norm(error[3:]) < 5e-4:
                break
        return np.asarray(self._configuration.q[:ARM_JOINTS].copy())

    def _off(self) -> tuple[float, float]:
        """How far the last solution is from what was asked for: metres, radians."""
        error = self._task.compute_error(self._configuration)
        return float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))

    def _is_there(self) -> bool:
        off_m, off_rad = self._off()
        return off_m <= POSITION_TOLERANCE_M and off_rad <= ROTATION_TOLERANCE_RAD

    def _unreachable(self, xyz: FloatArray, turned: str) -> ReachError:
        off_m, off_rad = self._off()
        return ReachError(
            f"the arm cannot reach x {xyz[0]:.3f}, y {xyz[1]:.3f}, z {xyz[2]:.3f} m with the tool {turned} "
            f"(it ends {off_m * 1000:.0f} mm and {np.rad2deg(off_rad):.0f} degrees away); "
            "choose a place nearer the robot's base"
        )

    def _full(self, q: FloatArray) -> FloatArray:
        full = np.zeros(self._configuration.model.nq)
        full[:ARM_JOINTS] = q
        return full


def quintic(fraction: FloatArray) -> FloatArray:
    """Smooth time: 0 to 1 with no velocity and no acceleration at either end (Flash and Hogan 1985, minimum jerk)."""
    return np.asarray(fraction**3 * (10 - 15 * fraction + 6 * fraction**2))


QUINTIC_PEAK = 1.875  # the highest slope of `quintic`
