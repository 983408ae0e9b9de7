"""A workcell: one arm, one camera, one table. The code above never knows whether it is simulated."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from baggie.errors import LimitError, ReachError, UnsureError
from baggie.geometry import PlanarPose, Rectangle
from baggie.types import Failure, Observation, Outcome, PickPlace, Plan
from baggie.workcell.arm import Arm
from baggie.workcell.calibrations import Calibrations
from baggie.workcell.camera import Camera
from baggie.workcell.limits import GuardedArm, Limits
from baggie.workcell.primitives import Handling, least_turn, pick, place

if TYPE_CHECKING:
    from baggie.workcell.watch import Watch

_SAME_WIDTH_M = 0.003
"""Fingers that let go stand so near to where they were sent."""
_OPEN_M = 0.005
"""A hand that is so near to as wide as it opens is empty: what it goes over is narrower by more."""


@dataclass(frozen=True)
class Marker:
    """The calibration paddle: a coloured disk in front of the fingertips, at their height."""

    color: tuple[int, int, int] = (217, 13, 191)
    """RGB."""
    offset_m: float = 0.09
    """From the tool along its own x axis to the disk's centre."""
    radius_m: float = 0.025


@dataclass(frozen=True)
class WorkcellSettings:
    """What a person writes down about a workcell. Robot base frame, SI units, RGB."""

    name: str = "sim"
    workspace: Rectangle = field(default_factory=lambda: Rectangle(0.35, 0.65, -0.30, 0.30))
    """Where objects may be picked and placed."""
    limits: Limits = field(
        default_factory=lambda: Limits(
            # The hand may stray a little beyond the workspace after an object at its edge.
            workspace=Rectangle(0.28, 0.70, -0.38, 0.38),
            reach=Rectangle(0.15, 0.75, -0.50, 0.50),
        )
    )
    handling: Handling = field(default_factory=Handling)
    object_color: tuple[int, int, int] = (196, 40, 44)
    object_size_m: tuple[float, float, float] = (0.12, 0.12, 0.03)
    """Length, width and resting height."""
    object_hard: bool = False
    """Whether the hand goes over it, and so grips it by its middle or not at all."""
    object_symmetry: int = 4
    """How many times a turn it looks the same about its middle, by which it is picked; 0 for at any angle. With 1, of
    what has no symmetry or is picked elsewhere, yaws are carried out as they are said."""
    marker: Marker = field(default_factory=Marker)
    sure_within_m: float = 0.03
    """`carry_out` asks for help when a plan's pick or place is not known within this, nine times of ten."""


class Workcell:
    """Look, move, check. Planning is a policy's."""

    def __init__(self, arm: Arm, camera: Camera, settings: WorkcellSettings) -> None:
        self.arm = GuardedArm(arm, settings.limits)
        self.camera = camera
        self.settings = settings
        self.calibrations = Calibrations()
        self.watch: Watch | None = None
        """Given one, `look` raises `BumpedError` as soon as the camera or the table has moved."""

    def use(self, calibrations: Calibrations) -> None:
        """Take calibrations of this camera into use; its pictures say how its lens sees from now on."""
        self.calibrations = calibrations
        if calibrations.intrinsics is not None:
            self.camera.intrinsics = calibrations.intrinsics.intrinsics

    def look(self) -> Observation:
        """Move the arm out of view and take a picture.

        Raises `BumpedError`, where there is a watch, when that picture and the next show that camera or table moved.
        """
        self.arm.park()
        observation = self.camera.look()
        if self.watch is not None and self.watch.moved(observation.color):
            observation = self.camera.look()  # somebody may have passed by
            self.watch.check(observation.color)
        return observation

    def carry_out(self, plan: Plan) -> Outcome:
        """Execute a plan that is sure enough: neither of its radii wider than `sure_within_m`; None passes.

        Raises `UnsureError` before anything moves when one is, and whatever `execute` raises.
        """
        limit = self.settings.sure_within_m
        radii = {"pick": plan.pick_within_m, "place": plan.place_within_m}
        unsure = [
            f"the {name} within {1000 * radius:.0f} mm"
            for name, radius in radii.items()
            if radius is not None and not radius <= limit  # NaN is not sure either
        ]
        if unsure:
            raise UnsureError(
                f"expected a plan that is sure within {1000 * limit:.0f} mm, got {' and '.join(unsure)}; nothing was "
                "moved: clear the view of the object and the goal, collect more to learn from, or raise sure_within_m "
                "in the workcell file"
            )
        return self.execute(plan.action)

    def execute(self, action: PickPlace) -> Outcome:
        """Pick, verify, place.

        Yaws that mean the same give the same motion: `least_turn`, with the settings' `object_symmetry`. All of it is
        checked before anything moves: raises `LimitError` for what leaves the limits, `ReachError` for what the arm
        foresees not to reach. Raises either, too, where it turns out so on the way; what was picked up by then is put
        back. A grasp that failed is no error; the outcome says so and the arm is above the pick.
        """
        self.arm.check(action.pick, "pick")
        self.arm.check(action.place, "place")
        handling = self.settings.handling
        action = least_turn(self.arm, action, handling, self.settings.object_symmetry)
        start = self.clock()
        try:
            grasp = pick(self.arm, action.pick, handling)
        except (LimitError, ReachError):
            self.put_down()
            raise
        picked = self.clock()
        if not grasp.held:
            self.arm.move_gripper(handling.open_width_m)
            return Outcome(
                executed=PickPlace(grasp.pose.planar, action.place),
                failure="missed-grasp",
                grasp_width_m=grasp.width_m,
                pick_z_m=grasp.pose.z,
                timings_s={"pick": picked - start},
            )
        try:
            release = place(self.arm, action.place, handling)
        except (LimitError, ReachError):
            self.put_down(grasp.pose.planar)
            raise
        failure: Failure | None = None if release.held else "dropped"
        return Outcome(
            executed=PickPlace(grasp.pose.planar, release.pose.planar),
            failure=failure,
            grasp_width_m=grasp.width_m,
            release_width_m=release.width_m,
            pick_z_m=grasp.pose.z,
            place_z_m=release.pose.z,
            timings_s={"pick": picked - start, "place": self.clock() - picked},
        )

    def put_down(self, at: PlanarPose | None = None) -> bool:
        """Put down what the hand may still hold after a motion was cut short; whether it held anything.

        Where it is, or at the nearest place of the workspace, unless `at` says where.
        """
        if not self._holds():
            return False
        if at is None:
            here = self.arm.pose()
            at = PlanarPose(*self.settings.workspace.nearest(here.x, here.y), here.yaw)
        place(self.arm, at, self.settings.handling)
        return True

    def _holds(self) -> bool:
        """Whether the hand seems to hold something: it is neither shut, nor open, nor as wide as where it lets go."""
        h, width = self.settings.handling, self.arm.gripper_width()
        if width <= h.empty_width_m:
            return False
        if h.open_width_m <= h.empty_width_m:  # a suction cup, which is as wide as that only while it holds
            return True
        return abs(width - h.release_width_m) > _SAME_WIDTH_M and width < h.open_width_m - _OPEN_M

    def rescue(self) -> bool:
        """Get a lost object back into the workspace, if this workcell knows how; whether it did."""
        return False

    def clock(self) -> float:
        """Seconds of the workcell's own clock."""
        raise NotImplementedError

    def close(self) -> None:
        """Let go of arm and camera."""
