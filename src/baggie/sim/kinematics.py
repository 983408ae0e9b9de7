"""Inverse kinematics of the arm: straight tool paths as joint trajectories."""

from __future__ import annotations

import mink
import mujoco
import numpy as np

from baggie.errors import ReachError
from baggie.geometry import FloatArray, ToolPose

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
        self._configuration.update(self._full(q))
        transform = self._configuration.get_transform_frame_to_world("tool", "site")
        x_axis = transform.rotation().as_matrix()[:, 0]
        x, y, z = transform.translation()
        return ToolPose(float(x), float(y), float(z), float(np.arctan2(x_axis[1], x_axis[0])))

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
            path.append(self._solve(xyz, yaw, iterations=30 if fraction == 1.0 else 3))
        self._check(target)
        return np.array(path)

    def _solve(self, xyz: FloatArray, yaw: float, iterations: int) -> FloatArray:
        down = np.array([[np.cos(yaw), np.sin(yaw), 0], [np.sin(yaw), -np.cos(yaw), 0], [0, 0, -1]])
        self._task.set_target(mink.SE3.from_rotation_and_translation(mink.SO3.from_matrix(down), xyz))
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

    def _check(self, target: ToolPose) -> None:
        error = self._task.compute_error(self._configuration)
        off_m, off_rad = float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))
        if off_m > POSITION_TOLERANCE_M or off_rad > ROTATION_TOLERANCE_RAD:
            raise ReachError(
                f"the arm cannot reach x {target.x:.3f}, y {target.y:.3f}, z {target.z:.3f} m with the tool pointing "
                f"down at yaw {np.rad2deg(target.yaw):.0f} degrees (it ends {off_m * 1000:.0f} mm and "
                f"{np.rad2deg(off_rad):.0f} degrees away); choose a place nearer the robot's base"
            )

    def _full(self, q: FloatArray) -> FloatArray:
        full = np.zeros(self._configuration.model.nq)
        full[:ARM_JOINTS] = q
        return full


def quintic(fraction: FloatArray) -> FloatArray:
    """Smooth time: 0 to 1 with no velocity and no acceleration at either end (Flash and Hogan 1985, minimum jerk)."""
    return np.asarray(fraction**3 * (10 - 15 * fraction + 6 * fraction**2))


QUINTIC_PEAK = 1.875  # the highest slope of `quintic`
