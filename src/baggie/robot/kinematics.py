"""Kinematics of an arm: straight tool paths as joint paths and their timing, and single poses at any tilt.

The kinematics of any arm, from the MJCF or URDF file that its maker publishes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import mink
import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from baggie.errors import BaggieError, ReachError
from baggie.geometry import (
    FloatArray,
    ToolPose,
    from_vector,
    hand_matrix,
    invert_transform,
    nearest_angle,
    rigid,
    to_vector,
    tool_pose,
    wrap_angle,
)


def load_arm_model(
    path: Path,
    joints: Sequence[str],
    *,
    tool: str,
    tool_xyz_m: Sequence[float] = (0.0, 0.0, 0.0),
    tool_rpy_rad: Sequence[float] = (0.0, 0.0, 0.0),
    base_z_m: float = 0.0,
) -> mujoco.MjModel:
    """The bare chain of an arm, with a site "tool", as `Kinematics` wants it.

    The file's world, raised by `base_z_m`, is the robot's base frame: an arm on a pedestal is so high above the table.
    `joints`: the hinges that move; every other one (the gripper's) stays at zero. `tool`: a site, body or link of the
    file. The tool, whose frame is that of `geometry.hand_matrix`, sits in its frame at `tool_xyz_m`, turned by
    `tool_rpy_rad` (about the fixed axes x, y, z in this order, as in URDF). Shapes are left out, so meshes need not be
    there. Raises `BaggieError` when the file cannot be read or has no such joint or tool.
    """
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise BaggieError(f"{path} is no model of an arm ({reason}); give its MJCF or URDF file") from None
    spec.compiler.fusestatic = False  # or URDF links without a joint, a tool's frame among them, are gone
    known = [joint.name for joint in spec.joints]
    for name in joints:
        if name not in known:
            raise BaggieError(f"{path} has no joint {name!r}; it has {', '.join(known) or 'none'}")
    _strip(spec, joints)
    body, T_body_frame = _frame(spec, tool, path)
    for root in spec.worldbody.bodies:
        root.pos[2] += base_z_m
    T_frame_tool = rigid(Rotation.from_euler("xyz", tool_rpy_rad).as_matrix(), tool_xyz_m)
    T_body_tool = T_body_frame @ T_frame_tool
    for site in list(spec.sites):
        spec.delete(site)
    body.add_site(name="tool", pos=T_body_tool[:3, 3], quat=_quaternion(T_body_tool[:3, :3]))
    try:
        return spec.compile()
    except ValueError as error:
        raise BaggieError(f"{path} is no model of an arm: {' '.join(str(error).split())}") from None


def _strip(spec: mujoco.MjSpec, joints: Sequence[str]) -> None:
    """Leave bodies, sites and these joints."""
    for parts in (
        spec.keys,
        spec.actuators,
        spec.sensors,
        spec.equalities,
        spec.tendons,
        spec.pairs,
        spec.excludes,
        spec.geoms,
        spec.meshes,
        spec.materials,
        spec.textures,
        spec.cameras,
        spec.lights,
        [joint for joint in spec.joints if joint.name not in joints],
    ):
        for part in list(parts):
            spec.delete(part)
    spec.compiler.boundmass = spec.compiler.boundinertia = (
        1e-3  # motion is not simulated; mass is not asked for
    )


def _frame(spec: mujoco.MjSpec, name: str, path: Path) -> tuple[mujoco.MjsBody, FloatArray]:
    """The body that carries a site or is a link, and the pose `(4, 4)` of that frame in the body's."""
    site = spec.site(name)
    if site is not None:
        rotation = Rotation.from_quat(site.quat, scalar_first=True).as_matrix()
        return site.parent, rigid(rotation, site.pos)
    body = spec.body(name)
    if body is None:
        frames = [each.name for each in (*spec.sites, *spec.bodies) if each.name]
        raise BaggieError(f"{path} has no site, body or link {name!r}; it has {', '.join(frames)}")
    return body, np.eye(4)


def _quaternion(rotation: FloatArray) -> FloatArray:
    """`(4,)`, w first."""
    return np.asarray(Rotation.from_matrix(rotation).as_quat(scalar_first=True), float)


CONTROL_PERIOD_S = 0.024
"""Of simulated arms, between two commands: a multiple of all steps of physics."""
POSITION_TOLERANCE_M = 0.0005
ROTATION_TOLERANCE_RAD = 0.002
_ASTRAY_M = 0.004
"""A path that strays so far from its line runs along a joint's limit, where the arm has to swing round."""
_STEP = 0.03  # metres and, for yaw, radians/5 between two solutions; between them joints are interpolated
_STAYS_M = 1e-9
"""So little a tool moves where only joints turn, by rounding."""

Line = Callable[[FloatArray, ToolPose], FloatArray]
"""Joint positions `(N, J)` on the way from some `(J,)` to a pose."""


class Kinematics:
    """An arm alone, without scene or bag: forward and inverse kinematics at joint positions `q` `(J,)` radians."""

    def __init__(self, arm: mujoco.MjModel, home: FloatArray, joints: Sequence[str] | None = None) -> None:
        """`arm` has a site "tool", whose frame is that of `hand_matrix`.

        `home`: `(J,)`, to where a joint that is free to move is drawn. `joints`: their names, all hinges; the model's
        first unless given.
        """
        self._at = np.array(
            [arm.joint(name).qposadr[0] for name in joints] if joints else range(len(home))
        )  # no joint of an arm has more than one coordinate, so its velocities are numbered alike
        self._configuration = mink.Configuration(arm)
        self._task = mink.FrameTask("tool", "site", position_cost=1.0, orientation_cost=0.3, lm_damping=1e-4)
        # The elbow is free: draw it gently home, so that the same pose always has about the same joints.
        self._posture = mink.PostureTask(arm, cost=2e-3 * np.isin(np.arange(arm.nq), self._at))
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
        """Joint positions `(N, J)` along the straight line from `start` `(J,)` to `target`, both ends included.

        A yaw is taken modulo a turn: the tool turns the shorter way, or the other if only that can be. Raises
        `ReachError` when the arm can follow it neither way within its joint limits.
        """
        here = self.tool_pose(start).yaw
        shorter = nearest_angle(target.yaw, here)
        longer = shorter - math.copysign(2 * math.pi, shorter - here)
        try:
            return self._line(start, replace(target, yaw=shorter))
        except ReachError as error:
            try:
                return self._line(start, replace(target, yaw=longer))
            except ReachError:
                raise error from None

    def turn(self, path: FloatArray) -> float:
        """Radians, counterclockwise, that the tool turns in all along a joint path `(N, J)` of `line`."""
        yaws = [self.tool_pose(q).yaw for q in path]
        return sum(wrap_angle(after - before) for before, after in pairwise(yaws))

    def turn_along(self, start: FloatArray, way: Sequence[ToolPose], line: Line | None = None) -> float:
        """Radians that the tool turns in all, either way, from joints at `start` `(J,)` through the poses of `way`.

        `line`: how from one to the next, the method `line` unless given; raises what that raises.
        """
        turned, line = 0.0, line or self.line
        for target in way:
            path = line(start, target)
            turned, start = turned + abs(self.turn(path)), path[-1]
        return turned

    def _line(self, start: FloatArray, target: ToolPose) -> FloatArray:
        """`line`, turning by the difference of the yaws as they are."""
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
        turned = f"pointing down at yaw {np.rad2deg(wrap_angle(target.yaw)):.0f} degrees"
        if not self._is_there():
            raise self._unreachable(target.xyz, turned)
        astray_m = self._astray_m(np.array(path), target)
        if astray_m > _ASTRAY_M:
            x, y, z = target.xyz
            raise ReachError(
                f"the arm cannot follow a straight line to x {x:.3f}, y {y:.3f}, z {z:.3f} m with the tool {turned} "
                f"(it is {astray_m * 1000:.0f} mm beside it on the way); turn the tool less, or choose a place nearer "
                "the robot's base"
            )
        return np.array(path)

    def _astray_m(self, path: FloatArray, target: ToolPose) -> float:
        """How far a joint path `(N, J)` leaves the straight line to `target`, metres; joints are interpolated."""
        ways = np.concatenate([path, (path[1:] + path[:-1]) / 2])
        xyz = np.array([self.tool_pose(q).xyz for q in ways])
        line = target.xyz - xyz[0]
        along = np.clip((xyz - xyz[0]) @ line / max(float(line @ line), 1e-12), 0.0, 1.0)
        return float(np.linalg.norm(xyz - xyz[0] - along[:, None] * line, axis=1).max())

    def reach(self, start: FloatArray, transform: FloatArray) -> FloatArray:
        """Joint positions `(J,)` that bring the hand to `transform`, `T_base_hand` `(4, 4)`, found from `start` `(J,)`.

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

    def shortest_times(
        self, path: FloatArray, speed_m_s: float, joint_speeds_rad_s: FloatArray
    ) -> FloatArray:
        """`(N - 1,)` seconds that each stretch of a joint path `(N, J)` takes at the highest speed allowed.

        That is `speed_m_s` of the tool and `(J,)` of the joints, whichever is slower.
        """
        poses = [self.tool_pose(q) for q in path]
        tool = [np.linalg.norm(b.xyz - a.xyz) / speed_m_s for a, b in pairwise(poses)]
        joints = (np.abs(np.diff(path, axis=0)) / joint_speeds_rad_s).max(axis=1)
        return np.asarray(np.maximum(np.maximum(tool, joints), 1e-6))

    def even_speed(self, path: FloatArray, joint_speeds_rad_s: FloatArray) -> float:
        """The highest speed, m/s, at which the tool can follow all of a joint path `(N, J)` evenly.

        Along all of it no joint is faster then than `joint_speeds_rad_s` `(J,)`. Where the tool stays where it is, it
        has no speed to keep; infinite where it does all along.
        """
        stretches = self.shortest_times(path, math.inf, joint_speeds_rad_s)
        tool = [np.linalg.norm(b.xyz - a.xyz) for a, b in pairwise(map(self.tool_pose, path))]
        speeds = [length / time for length, time in zip(tool, stretches, strict=True) if length > _STAYS_M]
        return float(min(speeds, default=math.inf))

    def approach(self, start: FloatArray, transform: FloatArray) -> FloatArray:
        """Joint positions `(J,)` for `transform`, `T_base_hand` `(4, 4)`, a centimetre or so from those of `start`.

        For following, a step at a time: there to a tenth of a millimetre, or as near as joint limits allow.
        """
        self._configuration.update(self._full(start))
        return self._solve(transform, iterations=2)

    def _solve(self, transform: FloatArray, iterations: int) -> FloatArray:
        """Joint positions `(J,)` nearer to `T_base_hand` `(4, 4)`, from those of the last solution."""
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
        return np.asarray(self._configuration.q[self._at])

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
        full[self._at] = q
        return full


def minimum_jerk(path: FloatArray, shortest_s: FloatArray, period_s: float) -> FloatArray:
    """Joint positions `(M, J)`, one every `period_s`, that follow a path `(N, J)` smoothly from rest to rest.

    `shortest_s`: `(N - 1,)` seconds that each stretch takes at full speed. The quintic eases the whole in and out, and
    is nowhere faster than that. Both ends are included.
    """
    clock = np.r_[0.0, np.cumsum(shortest_s)]
    steps = max(int(np.ceil(QUINTIC_PEAK * clock[-1] / period_s)), 1)
    moments = clock[-1] * quintic(np.linspace(0.0, 1.0, steps + 1))
    return np.column_stack([np.interp(moments, clock, joint) for joint in path.T])


def quintic(fraction: FloatArray) -> FloatArray:
    """Smooth time: 0 to 1 with no velocity and no acceleration at either end (Flash and Hogan 1985, minimum jerk)."""
    return np.asarray(fraction**3 * (10 - 15 * fraction + 6 * fraction**2))


QUINTIC_PEAK = 1.875  # the highest slope of `quintic`
