"""A workcell: one arm, one camera, one table. The code above never knows whether it is simulated.

A watch notices that the camera or the table was bumped, before anything wrong is recorded or done. It compares the
still background with the picture that was taken when the workcell was calibrated; and, where there is too little to see
of it, how far from where they were let go objects are seen to lie, which drifts when the map from the picture to the
robot is no longer true.
"""

from __future__ import annotations

import math
import time
import warnings
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from baggie.calibration.files import CameraIdentity
from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.calibration.intrinsics.camera_calibration import CameraCalibration
from baggie.calibration.robot_to_world import CameraToRobot
from baggie.cameras.camera import Camera
from baggie.errors import BaggieError, BaggieWarning, BumpedError, LimitError, ReachError, UnsureError
from baggie.geometry import FloatArray, PlanarPose, Rectangle
from baggie.options.values import Color
from baggie.robot.arm import Arm
from baggie.robot.limits import WORKSPACE, GuardedArm, Limits
from baggie.robot.primitives import Handling, least_turn, lowered, pick, place
from baggie.types import Image, Observation, Outcome, PickPlace, Plan, middle_of_layer_m
from baggie.vision.drift import Landmarks

if TYPE_CHECKING:
    from baggie.tasks.conditions import State
    from baggie.tasks.task import Scene


@dataclass(frozen=True)
class Calibrations:
    """Nothing here is needed to collect or to run a policy; what there is is used."""

    intrinsics: CameraCalibration | None = None
    image_to_robot: ImageToRobot | None = None
    camera_to_robot: CameraToRobot | None = None


LIMIT_SHARE = 0.4 / 1280
"""Of the picture's width, by which its background may seem to move: 0.4 pixels of 1280 are half a millimetre on a table
seen from 0.8 m. Ordinary pictures stay below 0.2; of bumps along the grain of plain wood only half is seen."""
LANDINGS = 8
"""A drift of landings is judged over this many, by their median: soft things land 3 to 5 mm off, each another way."""
LANDING_LIMIT_M = 0.015
DENTED_LIMIT_M = 0.03
"""The same where the background is seen to stand still: a bag that was gripped aslant keeps its dents, and lands 2 cm
off every time. Camera and table would have to move together, away from the robot.
"""


class Watch:
    """Compares pictures taken with the arm out of the way with the one from when the workcell was calibrated."""

    def __init__(self, reference: Image) -> None:
        """`reference`: `(H, W, 3)`, the arm parked, of the same camera at the same size."""
        try:
            self._landmarks: Landmarks | None = Landmarks.find(reference)
        except BaggieError:  # a bare table: landings must do
            self._landmarks = None
        self._limit_px = LIMIT_SHARE * reference.shape[1]
        self._landings: deque[tuple[float, float]] = deque(maxlen=LANDINGS)

    def moved_px(self, picture: Image) -> float:
        """By how much the background has moved, pixels, median over the picture.

        Infinite where it is another one, 0 where there is too little to see of it to tell. Raises `BaggieError` for a
        picture of another size.
        """
        return self._landmarks.shift(picture).px if self._landmarks else 0.0

    def moved(self, picture: Image) -> bool:
        """Whether that is more than it may be."""
        return bool(self.moved_px(picture) > self._limit_px)

    def check(self, picture: Image) -> None:
        """Raise `BumpedError` when camera or table have moved."""
        px = self.moved_px(picture)
        if not px > self._limit_px:
            return
        what = (
            f"the background is {px:.1f} pixels from where it was when this workcell was calibrated (at most "
            f"{self._limit_px:.1f} are allowed)"
            if math.isfinite(px)
            else "the background is not the one this workcell was calibrated with (or the light is off)"
        )
        raise BumpedError(
            f"the camera or the table was bumped: {what}; put it back, or calibrate again and begin a new recording"
        )

    def landed(self, released: PlanarPose, seen: PlanarPose) -> None:
        """Take note of where an object was let go and where it is seen; raise `BumpedError` when these drift apart."""
        self._landings.append((seen.x - released.x, seen.y - released.y))
        off = float(np.linalg.norm(np.median(self._landings, axis=0)))
        limit_m = DENTED_LIMIT_M if self._landmarks else LANDING_LIMIT_M
        if len(self._landings) == LANDINGS and off > limit_m:
            raise BumpedError(
                f"the last {LANDINGS} objects are seen {1000 * off:.0f} mm from where they were let go, all the same "
                "way: the camera or the table was bumped; calibrate again and begin a new recording"
            )


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
    workspace: Rectangle = WORKSPACE
    """Where objects may be picked and placed."""
    limits: Limits = field(
        default_factory=lambda: Limits(
            # The hand may stray a little beyond the workspace after an object at its edge.
            workspace=Rectangle(0.28, 0.70, -0.38, 0.38),
            reach=Rectangle(0.15, 0.75, -0.50, 0.50),
        )
    )
    handling: Handling = field(default_factory=Handling)
    object_color: Color = (196, 40, 44)
    object_colors: tuple[Color, ...] = ()
    """RGB of all bags that lie about, each another; empty where there is one, of `object_color`."""
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


NEAR_M = 0.005
"""From a plane so near what is seen at half a metre from under a camera 1 m up is 2 mm off, and that will do."""


def middle_m(settings: WorkcellSettings, layer: int = 0) -> float:
    """Metres above the table of the middle of what is seen of the object, in this layer of a stack; 0 is the table."""
    return middle_of_layer_m(layer) if layer else settings.object_size_m[2] / 2


def at_outline(image_to_robot: ImageToRobot, settings: WorkcellSettings, layer: int = 0) -> ImageToRobot:
    """The map at the height where the middle of what is seen of the object is, in this layer of a stack.

    On the table as it is where it knows one height only, with a `BaggieWarning` where that is another. Raises
    `CalibrationError` where it does so higher up.
    """
    if layer or image_to_robot.height_aware:
        return image_to_robot.at_height(middle_m(settings, layer))
    if abs(image_to_robot.height_m - middle_m(settings)) > NEAR_M:
        warnings.warn(
            f"the map from the picture to the robot is right {image_to_robot.height_m:g} m above the table only, the "
            f"middle of the object is {middle_m(settings):g} m up: places are off by some millimetres; calibrate at "
            "two heights, or with --intrinsics",
            BaggieWarning,
            stacklevel=2,
        )
    return image_to_robot


class Workcell:
    """Look, move, check: what collecting, evaluating and the environments ask of every workcell.

    Planning is a policy's. As it is here nobody lays the table anew, nobody knows where things are, and a person does
    what only a person can.
    """

    repeatable = False
    """Whether `reset` gives the same scene again, and with it the same attempts."""
    scene: Scene | None = None
    """What lies on the table at first and what counts; None where nobody knows."""

    def __init__(self, arm: Arm, camera: Camera, settings: WorkcellSettings) -> None:
        self.arm = GuardedArm(arm, settings.limits)
        self.camera = camera
        self.settings = settings
        self.calibrations = Calibrations()
        self.watch: Watch | None = None
        """Given one, `look` raises `BumpedError` as soon as the camera or the table has moved."""

    def reset(self, _seed: Sequence[int]) -> None:
        """Begin a new scene, drawn from the stream these integers name, where the workcell is repeatable.

        Where it is not, what the hand still holds is put down, the arm parks, and the rest stays as it is.
        """
        self.put_down()
        self.arm.park()

    def state(self) -> State | None:
        """Where everything is now; None where nobody knows. Moves nothing and looks at nothing."""
        return None

    def truth(self, color: Color | None = None) -> PlanarPose | None:
        """Where the object that is carried is now, or that of this colour (RGB); None where nobody knows."""
        state = self.state()
        return None if state is None or self.scene is None else state.places[self.scene.carried.name]

    def give_goal(self, goal: PlanarPose) -> None:
        """Let what counts in the scene, where it is known, be that the object comes to lie at a goal."""
        if self.scene is not None:
            self.scene = self.scene.with_goal(goal, self.settings.object_symmetry)

    def outline(self, pose: PlanarPose, layer: int = 0) -> FloatArray:
        """`(4, 2)` pixels: where the outline of the object is to be expected when it rests at `pose`.

        `layer`: how many like it lie below, on each other. Raises `BaggieError` where there is no map from the picture
        to the robot, or, above the table, one that knows one height only.
        """
        to_robot = self.calibrations.image_to_robot
        if to_robot is None:
            raise BaggieError(
                f"expected {self.settings.name} with a map from the picture to the robot, got none; make one with: "
                "baggie calibrate image-to-robot"
            )
        length, width, _ = self.settings.object_size_m
        to_robot = at_outline(to_robot, self.settings, layer).for_size(self.camera.size)
        return to_robot.to_pixels(pose.outline(length, width))

    def demonstrate(self, rng: np.random.Generator | None = None) -> PickPlace | None:
        """What a demonstrator, who knows where everything is, does next; None when all is done, strictly.

        With a stream in the style of others, whose whims are drawn from it. Raises `BaggieError` where nobody knows.
        """
        raise BaggieError(
            f"expected a workcell where somebody knows where things are, got {self.settings.name}"
        )

    def wait(self, seconds: float) -> None:
        """Let time pass."""
        time.sleep(seconds)

    def show_paddle(self, shown: bool) -> None:
        """Put the calibration marker into the hand, or take it away. Raises `BaggieError` where only a person can."""
        if shown:
            raise BaggieError(
                f"expected {self.settings.name} to be calibrated, got no image_to_robot below `calibrations` in its "
                "file; make one with: baggie calibrate image-to-robot --workcell FILE"
            )

    def lay_card(self, pose: PlanarPose | None) -> None:
        """Lay the goal card on the table, or take it away. Raises `BaggieError` where only a person can."""
        if pose is not None:
            raise BaggieError(
                "expected a goal that can be marked in the picture, got a card for a real workcell"
            )

    @contextmanager
    def film(self, size: tuple[int, int] = (640, 480), fps: float = 20.0) -> Iterator[list[Image]]:
        """Collect frames `(H, W, 3)` of the arm at work while open; none where nobody films it."""
        yield []

    @property
    def calibrated_camera(self) -> CameraIdentity:
        """The camera that calibrations have to be of."""
        return CameraIdentity(self.camera.name, *self.camera.size)

    def use(self, calibrations: Calibrations) -> None:
        """Take calibrations of this camera into use; its pictures say how its lens sees from now on."""
        self.calibrations = calibrations
        if calibrations.intrinsics is not None:
            self.camera.intrinsics = calibrations.intrinsics.intrinsics.scaled(*self.camera.size)

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
        action = lowered(action, self.arm.info, handling, self.settings.object_hard)
        action = least_turn(self.arm, action, handling, self.settings.object_symmetry)
        start = self.clock()
        try:
            grasp = pick(self.arm, action.pick, handling, action.pick_on_m, action.tallest_m)
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
            release = place(self.arm, action.place, handling, action.place_on_m, action.tallest_m)
        except (LimitError, ReachError):
            self.put_down(grasp.pose.planar, action.pick_on_m, action.tallest_m)
            raise
        return Outcome(
            executed=PickPlace(grasp.pose.planar, release.pose.planar),
            failure=None if release.held else "dropped",
            grasp_width_m=grasp.width_m,
            release_width_m=release.width_m,
            pick_z_m=grasp.pose.z,
            place_z_m=release.pose.z,
            timings_s={"pick": picked - start, "place": self.clock() - picked},
        )

    def put_down(
        self, at: PlanarPose | None = None, on_m: float | None = 0.0, tallest_m: float = 0.0
    ) -> bool:
        """Put down what the hand may still hold after a motion was cut short; whether it held anything.

        Where it is, or at the nearest place of the workspace, unless `at` says where; `on_m` and `tallest_m` as
        `PickPlace` says them of a place.
        """
        if not self._holds():
            return False
        if at is None:
            here = self.arm.pose()
            at = PlanarPose(*self.settings.workspace.nearest(here.x, here.y), here.yaw)
        place(self.arm, at, self.settings.handling, on_m, tallest_m)
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
        return self.put_down()

    def clock(self) -> float:
        """Seconds of the workcell's own clock."""
        raise NotImplementedError

    def close(self) -> None:
        """Let go of arm and camera."""
