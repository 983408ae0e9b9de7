"""The one gate every motion passes: where to, which way, how far, fast and hard; checked before the arm is told.

Stops the arm when the camera no longer sees what it does.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, replace

import numpy as np

from baggie.errors import BaggieError, CameraError, LimitError, ReachError
from baggie.geometry import FloatArray, PlanarPose, Rectangle, ToolPose
from baggie.robot.arm import Arm, ArmInfo, foresee, hand_pose

PERIOD_S = 0.05
WORKSPACE = Rectangle(0.35, 0.65, -0.30, 0.30)
"""Where objects may be picked and placed unless a file says otherwise; robot base frame, metres."""
MARGIN_M = 0.03
"""Between any place and the workspace's edge: a soft bag lands up to this far from where it is let go."""


class BarkError(CameraError):
    """It was silent for too long: whatever moved has been stopped, and nothing moves."""


class Watchdog:
    """Looks after motions from a thread of its own."""

    def __init__(self, silent_s: Callable[[], float], limit_s: float, name: str = "the camera") -> None:
        """`silent_s` says for how long nothing was heard, of `name`; more than `limit_s` stops the arm."""
        self._silent_s, self._limit_s, self._name = silent_s, limit_s, name

    @contextmanager
    def watching(self, stop: Callable[[], None]) -> Iterator[None]:
        """While the block runs, call `stop` as soon as it has been silent for too long.

        Raises `BarkError` before the block where it is silent already, and after it where it was stopped, whatever the
        block itself raised because of that.
        """
        self._check()
        over, barked, stopped = threading.Event(), threading.Event(), threading.Event()

        def watch() -> None:
            while not over.wait(PERIOD_S):
                if self._silent_s() > self._limit_s:
                    barked.set()
                    with suppress(BaggieError):
                        stop()
                        stopped.set()
                    return

        thread = threading.Thread(target=watch, name="watchdog", daemon=True)
        thread.start()
        try:
            yield
        except BaggieError:
            if not barked.is_set():
                raise
        finally:
            over.set()
            thread.join()
        if barked.is_set():
            if not stopped.is_set():
                stop()  # it could not, from the thread: once more, where its error is heard
            raise self._error()

    def _check(self) -> None:
        if self._silent_s() > self._limit_s:
            raise BarkError(
                f"{self._name} has been silent for more than {self._limit_s:g} s; nothing was moved: check its cable"
            )

    def _error(self) -> BarkError:
        return BarkError(
            f"{self._name} was silent for more than {self._limit_s:g} s, so the arm was stopped; check its cable, and "
            "see what the arm holds"
        )


_STRAIGHT_M = 0.005
"""A motion that leads less far aside than this is straight up or down."""


@dataclass(frozen=True)
class Limits:
    """What the tool may do. Robot base frame; metres, seconds, newtons."""

    workspace: Rectangle
    """Where the tool may be below `clearance_z_m`."""
    reach: Rectangle
    """Where it may be above."""
    z_min_m: float = 0.012
    """The lowest the tool may go: 12 mm keep a Franka hand's fingertips off the table."""
    z_max_m: float = 0.70
    clearance_z_m: float = 0.12
    max_step_m: float = 1.2
    """The farthest one motion may lead: further is taken for a mistake."""
    max_speed_m_s: float = 1.2
    max_contact_force_n: float = 40.0
    """The most that lowering may press before it stops."""
    max_grasp_force_n: float = 30.0


class GuardedArm:
    """An arm behind the gate. Raises `LimitError` for whatever the limits forbid; then nothing was sent.

    Whatever interrupts a motion, Ctrl-C too, stops the arm first. Then it is passed on.
    """

    def __init__(self, arm: Arm, limits: Limits) -> None:
        self._arm = arm
        self.limits = limits
        self.info: ArmInfo = replace(
            arm.info,
            max_speed_m_s=min(arm.info.max_speed_m_s, limits.max_speed_m_s),
            max_force_n=min(arm.info.max_force_n, limits.max_grasp_force_n),
        )
        """What it can do here."""
        self.watchdog: Watchdog | None = None
        """Given one, motions are stopped when it barks; then they raise `BarkError`."""

    def check(self, pose: PlanarPose | ToolPose, name: str = "tool") -> None:
        """Raise `LimitError` unless the pose is allowed; a planar pose is one at table height."""
        limits = self.limits
        z = pose.z if isinstance(pose, ToolPose) else limits.z_min_m
        if not all(math.isfinite(value) for value in (pose.x, pose.y, z, pose.yaw)):
            raise LimitError(f"{name} pose {pose} is not finite; nothing was moved")
        if not limits.z_min_m - 1e-9 <= z <= limits.z_max_m:
            raise LimitError(
                f"{name} height {z:.3f} m is outside {limits.z_min_m:.3f}..{limits.z_max_m:.3f} m; nothing was moved"
            )
        area = limits.workspace if z < limits.clearance_z_m else limits.reach
        if not area.contains(pose.x, pose.y):
            raise LimitError(
                f"{name} position x {pose.x:.3f}, y {pose.y:.3f} m is outside the workspace ({area}); "
                "choose a place inside or widen the workspace in the workcell file"
            )

    def at_most(self, speed_m_s: float) -> float:
        """The speed, metres a second, or the fastest that arm and limits allow, where that is less."""
        return min(speed_m_s, self.info.max_speed_m_s)

    def pose(self) -> ToolPose:
        """Where the tool is now."""
        return self._arm.pose()

    def hand_pose(self) -> FloatArray:
        """`T_base_hand` `(4, 4)`: the function `hand_pose` of the arm."""
        return hand_pose(self._arm)

    def foresee(self, way: Sequence[ToolPose]) -> float:
        """Radians that the tool would turn along `way`: the function `foresee` of the arm."""
        return foresee(self._arm, way)

    def move_to(self, target: ToolPose, speed_m_s: float) -> ToolPose:
        """`Arm.move_to`, if target, way and speed are allowed."""
        self.check(target)
        self._check_way(target)
        self._check_speed(speed_m_s)
        with self._motion():
            return self._arm.move_to(target, speed_m_s)

    def lower_until_contact(self, z_min: float, speed_m_s: float, force_n: float) -> ToolPose:
        """`Arm.lower_until_contact`, if height, speed and force are allowed."""
        here = self._arm.pose()
        self.check(ToolPose(here.x, here.y, z_min, here.yaw))
        self._check_speed(speed_m_s)
        self._check_at_most("contact force", force_n, self.limits.max_contact_force_n, "N")
        with self._motion():
            return self._arm.lower_until_contact(z_min, speed_m_s, force_n)

    def move_gripper(self, width_m: float) -> float:
        """`Arm.move_gripper`, if the gripper opens that wide."""
        if not 0.0 <= width_m <= self.info.max_width_m:
            raise LimitError(
                f"gripper width {width_m:.3f} m is outside 0..{self.info.max_width_m:.3f} m; nothing was moved"
            )
        with self._motion():
            return self._arm.move_gripper(width_m)

    def grasp(self, force_n: float) -> float:
        """`Arm.grasp`, if the gripper may squeeze that hard."""
        self._check_at_most("grasp force", force_n, self.info.max_force_n, "N")
        with self._motion():
            return self._arm.grasp(force_n)

    def gripper_width(self) -> float:
        """Metres between the fingers now."""
        return self._arm.gripper_width()

    def park(self) -> ToolPose:
        """Move out of the camera's view. The parking pose is part of the arm's set-up, not a command.

        It needs no camera: this is how to begin again after one was lost.
        """
        with self._motion(watched=False):
            return self._arm.park()

    def stop(self) -> None:
        """Stop moving, now."""
        self._arm.stop()

    def _check_way(self, target: ToolPose) -> None:
        """Raise `LimitError` unless the straight line from here is short enough, and low only inside the workspace."""
        here, limits = self._arm.pose(), self.limits
        step = float(np.linalg.norm(target.xyz - here.xyz))
        if step > limits.max_step_m:
            raise LimitError(
                f"a motion of {step:.2f} m from here is longer than {limits.max_step_m:.2f} m; nothing was moved"
            )
        low, high = sorted((here, target), key=lambda pose: pose.z)
        aside = math.hypot(target.x - here.x, target.y - here.y)
        if low.z >= limits.clearance_z_m or (low is here and aside <= _STRAIGHT_M):
            return  # all of it is high, or it leads straight up, which is how to get out of anywhere
        # The workspace is convex: the low part of the line is in it where both of its ends are.
        share = 1.0 if high.z <= limits.clearance_z_m else (limits.clearance_z_m - low.z) / (high.z - low.z)
        for x, y in ((low.x, low.y), (low.x + share * (high.x - low.x), low.y + share * (high.y - low.y))):
            if not limits.workspace.contains(x, y):
                raise LimitError(
                    f"on its way to {target} the tool would be lower than {limits.clearance_z_m:.3f} m at x {x:.3f}, "
                    f"y {y:.3f} m, outside the workspace ({limits.workspace}); nothing was moved: raise the arm first"
                )

    @contextmanager
    def _motion(self, watched: bool = True) -> Iterator[None]:
        watching = self.watchdog.watching(self._arm.stop) if self.watchdog and watched else nullcontext()
        try:
            with watching:
                yield
        except (ReachError, BarkError):  # nothing moves
            raise
        except BaseException:
            self._arm.stop()
            raise

    def _check_speed(self, speed_m_s: float) -> None:
        self._check_at_most("speed", speed_m_s, self.info.max_speed_m_s, "m/s")

    @staticmethod
    def _check_at_most(name: str, value: float, highest: float, unit: str) -> None:
        if not 0.0 < value <= highest:
            raise LimitError(f"{name} {value:g} {unit} is outside 0..{highest:g} {unit}; nothing was moved")
