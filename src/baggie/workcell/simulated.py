"""The simulated workcell: arm, camera and table in MuJoCo, behind the same protocols as real ones.

What every workcell in MuJoCo has: the world's clock, and a film of it.

The simulated overhead camera, as a workcell has it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from baggie.errors import BaggieError
from baggie.geometry import FloatArray, PlanarPose
from baggie.options.choices import Scenery
from baggie.robot.handling_rules import SIMULATED_HANDLING
from baggie.sim.arm import SimulatedArm
from baggie.sim.arm_world import ArmWorld
from baggie.sim.bag import BagParameters
from baggie.sim.cell import PICTURE_SIZE, draw_cell
from baggie.sim.renderer import CameraRenderer, Film
from baggie.sim.sensor import Exposure
from baggie.sim.variety import Variety, draw_variety, lay_bags
from baggie.sim.world import World
from baggie.types import Image, Intrinsics, Observation
from baggie.vision.targets import Target
from baggie.workcell.workcell import Workcell, WorkcellSettings


class MujocoWorkcell(Workcell):
    """A workcell whose table and arm are a running simulation."""

    world: ArmWorld
    repeatable = True

    def clock(self) -> float:
        """Seconds of simulated time since the last reset."""
        return self.world.time

    @contextmanager
    def film(self, size: tuple[int, int] = (640, 480), fps: float = 20.0) -> Iterator[list[Image]]:
        """Collect frames `(H, W, 3)` of the arm at work, seen from beside the table, while the block runs."""
        film = Film(self.world, size, fps)
        self.world.watchers.append(film.watch)
        try:
            yield film.frames
        finally:
            self.world.watchers.remove(film.watch)
            film.close()


class SimulatedCamera:
    """The overhead colour and depth camera, with exposure and light that drift."""

    def __init__(self, world: ArmWorld, usual: Exposure) -> None:
        """`usual`: what exposures drift about."""
        self.name = f"simulated camera of cell {world.cell.number}"
        self.size = world.cell.lens.size
        self.intrinsics: Intrinsics | None = None  # nobody has calibrated it
        self._renderer = CameraRenderer(world)
        self._usual = usual
        self._rng = np.random.default_rng()

    def enter(self, world: ArmWorld, usual: Exposure) -> None:
        """Look into another world from now on, with exposures that drift about `usual`."""
        self._renderer.close()
        self._renderer = CameraRenderer(world)
        self._usual = usual

    def reseed(self, rng: np.random.Generator) -> None:
        """Draw exposures and noise from this stream from now on."""
        self._rng = rng

    def look(self) -> Observation:
        """A picture of the world as it is now."""
        exposure = self._usual.times(Exposure.random(self._rng))
        return replace(self._renderer.look(exposure, self._rng), intrinsics=self.intrinsics)

    def close(self) -> None:
        """Free the OpenGL context."""
        self._renderer.close()


_FIRST = (0,)
"""Names the scene a workcell opens with."""


class SimulatedWorkcell(MujocoWorkcell):
    """A workcell in MuJoCo. `truth`, `second_truth`, `obstacles`, `goal_corners` and `world` are for evaluation only.

    In a scenery other than `plain` every reset builds another world, which takes a second or two; a film ends with it.
    """

    def __init__(
        self,
        cell: int = 0,
        settings: WorkcellSettings | None = None,
        bag: BagParameters | None = None,
        scenery: Scenery = "plain",
        picture_size: tuple[int, int] = PICTURE_SIZE,
    ):
        self.scenery: Scenery = scenery
        self._plain = draw_cell(cell, picture_size), bag or BagParameters()
        settings = settings or _describing(
            self._plain[1], WorkcellSettings(name=f"sim cell {cell}", handling=SIMULATED_HANDLING)
        )
        first = draw_variety(scenery, *self._plain, settings.workspace, _FIRST)
        self.world: World = _build(first)
        self._simulated_arm = SimulatedArm(self.world)
        self._simulated_camera = SimulatedCamera(self.world, first.exposure)
        if scenery != "plain":
            settings = _describing(first.bag, settings)
        super().__init__(self._simulated_arm, self._simulated_camera, settings)
        self._begin(_FIRST)

    def reset(self, seed: Sequence[int]) -> None:
        """A new scene, the one these integers name: the bag anywhere in the workspace at any angle, arm parked.

        Where the scenery varies, `settings` describe the bag at hand from now on.
        """
        if self.scenery != "plain":
            self._set_the_scene(seed)
        self._begin(seed)

    def _set_the_scene(self, seed: Sequence[int]) -> None:
        """Move into the world that these integers name."""
        variety = draw_variety(self.scenery, *self._plain, self.settings.workspace, seed)
        self.world = _build(variety)
        self._simulated_arm.enter(self.world)
        self._simulated_camera.enter(self.world, variety.exposure)
        self.settings = _describing(variety.bag, self.settings)

    def _begin(self, seed: Sequence[int]) -> None:
        """Lay the bags of the world at hand where these integers say, all else cleared away."""
        self._rng = np.random.default_rng(list(seed))
        self._simulated_camera.reseed(self._rng.spawn(1)[0])
        self.show_paddle(False)
        self.lay_card(None)
        self.hide_target()
        self.hold_target(None)
        two = self.second_truth() is not None
        bag, second = lay_bags(self.settings.workspace, self.obstacles(), two, self._rng)
        self.world.reset(bag, second)
        self._simulated_arm.reset()
        self.arm.park()

    def truth(self) -> PlanarPose:
        """The bag's true centre and yaw now."""
        return self.world.bag_pose()

    def second_truth(self) -> PlanarPose | None:
        """The same of the second bag, which is to stay, where there is one."""
        return self.world.second_pose()

    def obstacles(self) -> list[PlanarPose]:
        """Where things stand that a hand or a bag can run into."""
        return [thing.pose for thing in self.world.distractors if thing.standing]

    def goal_corners(self, pose: PlanarPose) -> FloatArray:
        """`(4, 2)` pixels: where the outline of a bag that rests at `pose` truly appears."""
        length, width, height = self.settings.object_size_m
        corners = pose.outline(length, width)
        return self.world.cell.project(np.c_[corners, np.full(4, height / 2)])

    def show_paddle(self, shown: bool) -> None:
        """Put the calibration paddle into the hand, or take it away."""
        self.world.show_paddle(shown)

    def lay_card(self, pose: PlanarPose | None) -> None:
        """Lay the printed goal card, a thin green sheet of 13 cm, on the table, or take it away."""
        self.world.put_card(pose)

    def show_target(self, target: Target, T_base_target: FloatArray, scale: float = 1.0) -> None:
        """Put a target, printed `scale` times too large on an A3 sheet, where its own frame is at `T_base_target`.

        `(4, 4)`. Raises `BaggieError` where the target does not fit the sheet.
        """
        self.world.show_sheet(target, T_base_target, scale)

    def hide_target(self) -> None:
        """Take the sheet away."""
        self.world.hide_sheet()

    def hold_target(self, target: Target | None, scale: float = 1.0) -> FloatArray:
        """Put a target, printed on a plate that faces up, into the hand: `T_hand_target` `(4, 4)`, the truth.

        None takes the plate away and gives the identity. The hand's frame: `geometry.hand_matrix`. Raises
        `BaggieError` where the target does not fit the plate.
        """
        if target is None:
            self.world.hide_plate()
            return np.eye(4)
        return self.world.show_plate(target, scale)

    def lead_hand(self, T_base_hand: FloatArray) -> FloatArray:
        """Lead the arm by hand until the hand is at `T_base_hand` `(4, 4)`, tilted or not; the pose really reached.

        Raises `ReachError` where the arm does not reach.
        """
        return self._simulated_arm.lead_to(T_base_hand)

    def bump_camera(self, shift_m: ArrayLike, turn_rad: ArrayLike) -> None:
        """Knock the camera for good: `shift_m` `(3,)` in the base frame, `turn_rad` `(3,)` about its own axes.

        Raises `BaggieError` in another scenery than `plain`, where nothing stays for good.
        """
        self._check_plain()
        self.world.bump_camera(np.asarray(shift_m, float), np.asarray(turn_rad, float))

    def bump_table(self, x: float, y: float, yaw: float) -> None:
        """Knock the table for good: turned about the base frame's z and shifted, with everything that is on it.

        Raises `BaggieError` as `bump_camera` does.
        """
        self._check_plain()
        self.world.bump_table(PlanarPose(x, y, yaw))

    def rescue(self) -> bool:
        """What a person would do: lay the lost bag back on the table, its dents with it."""
        second = self.second_truth()
        in_the_way = [*self.obstacles(), *([second] if second else [])]
        pose, _ = lay_bags(self.settings.workspace, in_the_way, two=False, rng=self._rng)
        self.world.put_bag(pose, undented=False)
        self.world.advance(1.0)
        return True

    def close(self) -> None:
        """Free the OpenGL context."""
        self._simulated_camera.close()

    def _check_plain(self) -> None:
        if self.scenery != "plain":
            raise BaggieError(
                f"expected a plain workcell to bump, got the scenery {self.scenery!r}, which every reset builds anew; "
                "open it with scenery='plain'"
            )


def _build(variety: Variety) -> World:
    return World(variety.cell, variety.bag, variety.second, variety.distractors)


def _describing(bag: BagParameters, settings: WorkcellSettings) -> WorkcellSettings:
    """These settings for this bag."""
    return replace(settings, object_color=bag.color, object_size_m=bag.size_m, object_symmetry=bag.symmetry)


def open_simulated(
    cell: int = 0,
    settings: WorkcellSettings | None = None,
    scenery: Scenery = "plain",
    picture_size: tuple[int, int] = PICTURE_SIZE,
) -> SimulatedWorkcell:
    """The simulated workcell with this cell number, its scenes as `baggie.sim.variety` says.

    `picture_size`: `(width, height)` of its camera's pictures, pixels.
    """
    return SimulatedWorkcell(cell, settings, scenery=scenery, picture_size=picture_size)
