"""The simulated workcell: arm, cameras and table in MuJoCo with a task, behind the same protocols as real ones."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from baggie.errors import BaggieError
from baggie.geometry import FloatArray, PlanarPose, Rectangle
from baggie.options.values import USUAL_TASK, Color, Scenery
from baggie.registry import TASKS
from baggie.robot.limits import Limits
from baggie.sim.arm import BLOCK_HANDLING, SimulatedArm, SuctionArm
from baggie.sim.bag import Bag, SoftBody
from baggie.sim.cell import PICTURE_SIZE, draw_cell
from baggie.sim.objects import SceneObject
from baggie.sim.renderer import Film
from baggie.sim.sensor import Exposure
from baggie.sim.variety import lay_bags, random_pose
from baggie.sim.world import World
from baggie.tasks.conditions import State
from baggie.tasks.demonstrator import next_action, varied_action
from baggie.tasks.layout import REACH
from baggie.tasks.task import Scene, Setting, Task
from baggie.types import Image, PickPlace
from baggie.vision.height_map import RAVENS_DEPTH_CAMERAS
from baggie.vision.targets import Target
from baggie.workcell.simulated_cameras import NoPictures, SimulatedCamera, SimulatedHeightMap, SimulatedView
from baggie.workcell.workcell import Workcell, WorkcellSettings, middle_m

_FIRST = (0,)
"""Names the scene a workcell opens with."""
_DRAWN = 200
_STRAY_M = 0.01  # the arm is not quite where it was sent, at the workspace's edge too


class SimulatedWorkcell(Workcell):
    """A workcell in MuJoCo with a task.

    `world`, `scene`, `state`, `truth`, `outline` and `demonstrate` are for demonstrations and evaluation only.
    In a scenery other than `plain` every reset builds another world, which
    takes a second or two; a film ends with it.
    """

    repeatable = True
    scene: Scene

    def __init__(
        self,
        cell: int = 0,
        task: Task | None = None,
        *,
        settings: WorkcellSettings | None = None,
        things: Sequence[SceneObject] | None = None,
        scenery: Scenery = "plain",
        picture_size: tuple[int, int] = PICTURE_SIZE,
        pictures: bool = True,
        depth: bool = True,
    ) -> None:
        """`task`: the usual one unless given; `things`: the task's. `picture_size`: of the overhead camera, pixels;
        `depth`: whether it measures that, too.
        """
        self.task = task or TASKS[USUAL_TASK]
        self.scenery: Scenery = scenery
        self._things = tuple(self.task.things if things is None else things)
        self._cell = draw_cell(cell, picture_size)
        described = settings or _settings(self.task, self._things, cell)
        self._rng = np.random.default_rng(_FIRST)
        self.scene = self._draw(described.workspace, _FIRST)
        if scenery != "plain" and self.scene.variety is None:
            raise BaggieError(
                f"expected the scenery plain with the task {self.task.name}, whose scenes do not vary, got {scenery!r}"
            )
        self.world = self._build()
        self._tool = SimulatedArm(self.world) if self.task.tool == "hand" else SuctionArm(self.world)
        self._view: SimulatedView = NoPictures()
        if pictures:
            overhead = self.task.view == "camera"
            self._view = (
                SimulatedCamera(self.world, self._exposure, depth)
                if overhead
                else SimulatedHeightMap(self.world)
            )
        super().__init__(self._tool, self._view, described)
        if scenery != "plain":
            self._describe()
        self._begin()

    def reset(self, seed: Sequence[int]) -> None:
        """A new scene of the task, the one these integers name; arm parked.

        Where the scenery varies, `settings` describe the bag at hand from now on.
        """
        self._rng = np.random.default_rng(list(seed))
        self.scene = self._draw(self.settings.workspace, tuple(seed))
        if self.scenery != "plain":
            self.world = self._build()
            self._tool.enter(self.world)
            self._view.enter(self.world, self._exposure)
            self._describe()
        self._begin()

    def _begin(self) -> None:
        """Lay out the scene at hand in the world at hand, all else cleared away."""
        self._view.reseed(self._rng)
        self.world.reshape([*self.scene.blocks, *self.scene.fixtures])
        self.show_paddle(False)
        self.lay_card(None)
        self.hide_target()
        self.hold_target(None)
        self.world.reset(self.scene.starts, aside=set(self.world.movable) - set(self.scene.poses))
        self._tool.reset()
        self.arm.park()

    def _draw(self, workspace: Rectangle, seed: Sequence[int]) -> Scene:
        return self.task.draw(
            self._rng, Setting(self._things, self._cell, workspace, self.scenery, tuple(seed))
        )

    def _build(self) -> World:
        """The world of the scene at hand; where nothing varies, of all that any scene needs."""
        cameras = RAVENS_DEPTH_CAMERAS if self.task.view == "height-map" else ()
        variety = self.scene.variety
        if variety is None:
            return World(self._cell, self._things, self.task.tool, cameras=cameras)
        return World(variety.cell, self.scene.things, self.task.tool, variety.distractors, cameras)

    @property
    def _exposure(self) -> Exposure:
        return Exposure() if self.scene.variety is None else self.scene.variety.exposure

    def _describe(self) -> None:
        """Make the settings say what the bags of this scene are."""
        own = {thing.name for thing in self._things}
        things = [thing for thing in self.scene.things if thing.name in own]
        self.settings = _describing(self.task, things, self.settings)

    # -- time ---------------------------------------------------------------------------------------------------

    def clock(self) -> float:
        """Seconds of simulated time since the last reset."""
        return self.world.time

    def wait(self, seconds: float) -> None:
        """Let simulated time pass in which nothing sleeps: what stands then stands by itself."""
        self.world.advance_awake(seconds)

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

    # -- the truth ----------------------------------------------------------------------------------------------

    def state(self) -> State:
        """Where everything is now, and where things stand that a hand or a bag can run into."""
        world = self.world
        return State(
            world.poses(),
            {name: world.planar_pose(name) for name in world.bodies},
            tuple(thing.pose for thing in world.distractors if thing.standing),
            {name: body.points for name, body in world.bodies.items() if isinstance(body, SoftBody)},
        )

    def truth(self, color: Color | None = None) -> PlanarPose:
        """Where the object that is carried is now, or that of this colour (RGB): its true centre and yaw."""
        colored = (each.name for each in self.scene.things if isinstance(each, Bag) and each.color == color)
        return self.world.planar_pose(next(colored, self.scene.carried.name))

    def demonstrate(self, rng: np.random.Generator | None = None) -> PickPlace | None:
        """What a demonstrator who knows where everything is does next; None when all is done, strictly.

        With a stream in the style of others, whose whims are drawn from it (`baggie.tasks.demonstrator`).
        """
        if rng is None:
            return next_action(self.scene.conditions, self.state(), self.task.tool)
        return varied_action(self.scene, self.state(), rng)

    def outline(self, pose: PlanarPose, layer: int = 0) -> FloatArray:
        """`(4, 2)` pixels: where the outline of an object truly appears that rests at `pose`, on so many like it."""
        length, width, _ = self.settings.object_size_m
        corners = pose.outline(length, width)
        return self.world.cell.project(np.c_[corners, np.full(4, middle_m(self.settings, layer))])

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
        return self._tool.lead_to(T_base_hand)

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

    def lay_aside(self, pose: PlanarPose) -> None:
        """Put the bag somewhere else, as a person would; its dents stay."""
        self.world.put(self.scene.carried.name, pose)

    def rescue(self) -> bool:
        """What a person would do: lay the lost bag back on the table, its dents with it.

        Of several bags those that strayed, each to a free place; False where none did.
        """
        state = self.state()
        if self.settings.object_colors:
            return self._lay_back(state)
        in_the_way = [*state.obstacles, *(state.places[name] for name in self.scene.staying)]
        pose, _ = lay_bags(self.settings.workspace, in_the_way, two=False, rng=self._rng)
        self.lay_aside(pose)
        self.world.advance(1.0)
        return True

    def _lay_back(self, state: State) -> bool:
        """Lay the bags that strayed out of the hand's reach back on the table; whether any did."""
        names = [thing.name for thing in self.scene.things if thing.movable]
        area, places = self.settings.limits.workspace, dict(state.places)
        strayed = [name for name in names if not area.contains(*places[name].xy)]
        for name in strayed:
            del places[name]
            places[name] = self._free_place(list(places.values()))
            self.world.put(name, places[name])
            self.world.advance(1.0)
        return bool(strayed)

    def _free_place(self, others: Sequence[PlanarPose]) -> PlanarPose:
        """A place in the workspace beside others; of those drawn the freest."""
        drawn = [random_pose(self.settings.workspace, self._rng) for _ in range(_DRAWN)]
        return max(drawn, key=lambda pose: min(pose.distance(other) for other in others))

    def close(self) -> None:
        """Free the OpenGL context."""
        self._view.close()

    def _check_plain(self) -> None:
        if self.scenery != "plain":
            raise BaggieError(
                f"expected a plain workcell to bump, got the scenery {self.scenery!r}, which every reset builds anew; "
                "open it with scenery='plain'"
            )


def _settings(task: Task, things: Sequence[SceneObject], cell: int) -> WorkcellSettings:
    """What a person would write down: a hand grips bags within the usual workspace, a cup goes all over the table."""
    if task.tool == "hand":
        settings = WorkcellSettings(name=f"sim cell {cell}", workspace=task.workspace)
        return _describing(task, things, settings)
    largest = max(task.blocks, key=lambda block: block.size_m)
    return WorkcellSettings(
        name=f"sim cell {cell}, {task.name}",
        workspace=REACH,
        limits=Limits(workspace=_wider(REACH), reach=Rectangle(0.15, 0.75, -0.50, 0.50), z_min_m=0.0),
        handling=BLOCK_HANDLING,
        object_color=largest.color,
        object_size_m=largest.size_m,
        object_symmetry=1,  # a cup picks it anywhere, so a plan's turn is carried out as it is said
    )


def _wider(area: Rectangle) -> Rectangle:
    return Rectangle(
        area.x_min - _STRAY_M, area.x_max + _STRAY_M, area.y_min - _STRAY_M, area.y_max + _STRAY_M
    )


def _describing(task: Task, things: Sequence[SceneObject], settings: WorkcellSettings) -> WorkcellSettings:
    """These settings for what a hand takes in this task, of which these are the things."""
    bags = [thing for thing in things if isinstance(thing, Bag)]
    for bag in bags[:1]:
        settings = replace(
            settings, object_color=bag.color, object_size_m=bag.size_m, object_symmetry=bag.symmetry
        )
    if task.has_goal and len(bags) < 2:
        return settings
    # Where there are several, or the task itself says where they go, it says by which yaws of the hand, too.
    colors = tuple(bag.color for bag in bags) if task.has_goal else ()
    return replace(settings, object_symmetry=task.object_symmetry, object_colors=colors)


def open_simulated(
    cell: int = 0,
    task: str = USUAL_TASK,
    *,
    settings: WorkcellSettings | None = None,
    scenery: Scenery = "plain",
    picture_size: tuple[int, int] = PICTURE_SIZE,
    pictures: bool = True,
    depth: bool = True,
) -> SimulatedWorkcell:
    """The simulated workcell with this cell number and the task of this name, its scenes as `baggie.sim.variety` says.

    `picture_size`: `(width, height)` of its overhead camera's pictures, pixels; `depth`: whether they have it. Raises
    `BaggieError` where there is no such task.
    """
    return SimulatedWorkcell(
        cell,
        TASKS[task],
        settings=settings,
        scenery=scenery,
        picture_size=picture_size,
        pictures=pictures,
        depth=depth,
    )
