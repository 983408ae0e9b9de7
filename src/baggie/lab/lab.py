"""The virtual lab: a simulated workcell in which time goes on by itself, reached as a real robot is.

Its pictures are drawn in a process of their own, because MuJoCo's renderer lets no other thread run.
"""

from __future__ import annotations

import math
import multiprocessing
import queue
import signal
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from typing import TypeVar

import mujoco
import numpy as np

from baggie import seeds
from baggie.errors import BaggieError
from baggie.geometry import FloatArray, PlanarPose
from baggie.lab.fci import FciServer
from baggie.lab.robot import STEP_S, TICK_S, TICKS_PER_STEP, LabRobot
from baggie.robot.franka.models import PARK
from baggie.sim.arm_world import ArmWorld
from baggie.sim.bag import Bag
from baggie.sim.cell import PICTURE_SIZE, Cell, draw_cell
from baggie.sim.renderer import CameraRenderer
from baggie.sim.scene import MAX_BLOCK_HEIGHT_M
from baggie.sim.sensor import Exposure
from baggie.sim.world import World
from baggie.tasks.task import Scene, Setting, Task
from baggie.types import Image

_STATE = mujoco.mjtState.mjSTATE_INTEGRATION


@dataclass(frozen=True)
class RenderState:
    """All that a picture of a lab depends on."""

    state: FloatArray
    """Of the physics, as MuJoCo orders it."""
    colors: FloatArray
    """Of all geoms: what is not shown is transparent."""
    camera: tuple[FloatArray, FloatArray]
    """`camera_position` and `camera_rotation` of the cell, which may have been bumped; its lens stays as it is."""
    exposure: Exposure

    @classmethod
    def of(cls, world: ArmWorld, exposure: Exposure) -> RenderState:
        """What there is to see now."""
        state = np.empty(mujoco.mj_stateSize(world.model, _STATE))
        mujoco.mj_getState(world.model, world.data, state, _STATE)
        camera = (world.cell.camera_position, world.cell.camera_rotation)
        return cls(state, world.model.geom_rgba.copy(), camera, exposure)

    def apply_to(self, world: ArmWorld) -> None:
        """Make a world of the same cell look as it did then."""
        position, rotation = self.camera
        world.place_camera(replace(world.cell, camera_position=position, camera_rotation=rotation))
        world.model.geom_rgba[:] = self.colors
        mujoco.mj_setState(world.model, world.data, self.state, _STATE)
        world.update_fixed()


class RenderProcess:
    """The process that draws, one picture at a time."""

    def __init__(self, cell: Cell, bags: Sequence[Bag]) -> None:
        """Of a world with these bags in this cell. Raises `BaggieError` where nothing can render off screen."""
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_work, args=(theirs, cell, bags), daemon=True)
        self._process.start()
        theirs.close()
        self._one_at_a_time = threading.Lock()
        trouble = self._pipe.recv()
        if trouble is not None:
            raise BaggieError(trouble)

    def render(self, state: RenderState) -> Image:
        """Draw the picture `(H, W, 3)` of a state. Raises `EOFError` or `OSError` once it is closed."""
        with self._one_at_a_time:
            self._pipe.send(state)
            picture: Image = self._pipe.recv()
            return picture

    def close(self) -> None:
        """End the process."""
        self._process.terminate()
        self._process.join()


def _work(pipe: Connection, cell: Cell, bags: Sequence[Bag]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the lab, which ends this process then
    world = World(cell, bags)
    try:
        renderer = CameraRenderer(world)
    except BaggieError as error:
        pipe.send(str(error))
        return
    pipe.send(None)
    rng = np.random.default_rng()
    while True:
        state: RenderState = pipe.recv()
        state.apply_to(world)
        pipe.send(renderer.look(state.exposure, rng).color)


PORTS = (1337, 1338)
"""Of robot and hand, given by the protocol."""
WITHIN_M = 2.0
"""So far from the robot, along x and along y, a bag may be laid: well off the table, and no further."""
APART_M = 0.16
"""So far apart bags and the block are, so that none lies on another."""
HAND_ABOVE_M = 0.02
"""So far above a block the tool has to be for somebody to lay it."""
BUSY_S = 0.1
"""A robot that was moved less than this ago is likely to go on."""
T = TypeVar("T")


def draw_scene(task: Task, cell: Cell, seed: int) -> tuple[Exposure, Scene]:
    """The daylight and the scene with this number that a lab in this cell draws for a task."""
    rng = seeds.generator(seeds.LAB, seed)
    exposure = Exposure.random(rng)
    return exposure, task.draw(rng, Setting(task.things, cell, task.workspace, seed=(seeds.LAB, seed)))


class Lab:
    """Table, bags, camera and robot. `run` makes time pass; whatever else touches them does so between its ticks."""

    def __init__(
        self,
        task: Task,
        cell: int,
        *,
        seed: int,
        host: str,
        pace: float,
        picture_size: tuple[int, int] = PICTURE_SIZE,
    ) -> None:
        """`pace`: how many times as fast as real time it may go, 0 for as fast as it can while the arm is at work.

        `picture_size`: `(width, height)` of its camera's pictures, pixels. Raises `BaggieError` where the task is of
        more than a hand and bags, where the robot's ports at `host` cannot be had, and for pictures that cannot be
        drawn.
        """
        self.bags = tuple(thing for thing in task.things if isinstance(thing, Bag))
        if task.tool != "hand" or len(self.bags) < len(task.things):
            raise BaggieError(
                f"expected a task of bags and a hand for the lab, got {task.name}; take bag-place, or one that stacks"
            )
        self.host = host
        self.task = task
        self._cell = draw_cell(cell, picture_size)
        self.world = World(self._cell, self.bags)
        assert self.world.fingers is not None
        self.robot = LabRobot(self.world, self.world.fingers)
        self.fci = FciServer(self.robot, [host])
        self.render_process = RenderProcess(self._cell, self.bags)
        self._pace = pace
        self._calls: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._later: list[tuple[float, Callable[[], None]]] = []
        self._closing = threading.Event()
        self._moved_at = 0.0
        self.time = 0.0
        """Seconds that have passed in the lab."""
        self.seed = seed
        self.reset(seed)
        try:
            self.fci.init()
        except OSError:
            self.render_process.close()
            raise BaggieError(
                f"ports {PORTS[0]} and {PORTS[1]} of {host} cannot be had, perhaps because another lab has them; give "
                "another address, such as --host 127.0.0.2"
            ) from None

    # -- time ---------------------------------------------------------------------------------------------------

    def run(self) -> None:
        """Let time pass until somebody closes the lab."""
        try:
            while not self._closing.is_set():
                began = time.monotonic()
                for _ in range(TICKS_PER_STEP):
                    self._tick()
                self._between_steps()
                # Nobody gains by a scene that rests faster than it would, and a processor is left to whoever looks.
                pace = self._pace or (0.0 if self.busy else 1.0)
                if pace:
                    time.sleep(max(0.0, STEP_S / pace - (time.monotonic() - began)))
        finally:
            self.fci.cleanup()
            self.render_process.close()

    def close(self) -> None:
        """End `run`; from any thread."""
        self._closing.set()

    @property
    def closing(self) -> bool:
        """Whether the lab is about to end, or has."""
        return self._closing.is_set()

    @property
    def busy(self) -> bool:
        """Whether the arm is at work."""
        return time.monotonic() - self._moved_at < BUSY_S

    def call(self, action: Callable[[], T]) -> T:
        """What `action` returns or raises, done between two ticks; from any thread but the one that runs the lab."""
        answer: Future[T] = Future()

        def act() -> None:
            try:
                answer.set_result(action())
            except Exception as error:
                answer.set_exception(error)

        self._calls.put(act)
        return answer.result(timeout=60)

    def later(self, seconds: float, action: Callable[[], None]) -> None:
        """Do it when so much time has passed in the lab."""
        self._later.append((self.time + seconds, action))

    def _tick(self) -> None:
        self.fci.process_commands()
        self.robot.tick()
        self.fci.send_state()
        self.time += TICK_S

    def _between_steps(self) -> None:
        if self.fci.moving or self.robot.hand.moving:
            self._moved_at = time.monotonic()
        due = [action for moment, action in self._later if moment <= self.time]
        self._later = [(moment, action) for moment, action in self._later if moment > self.time]
        while not self._calls.empty():
            due.append(self._calls.get())
        for action in due:
            action()

    # -- what is in it; between ticks ---------------------------------------------------------------------------

    def reset(self, seed: int) -> None:
        """The scene with this number: the bags anywhere, undented; arm parked, hand open, daylight another.

        Raises `BaggieError` while somebody moves the arm, and for what numbers no scene; then nothing has changed.
        """
        if seed < 0:
            raise BaggieError(f"expected a scene's number of at least 0, got {seed}")
        if self.fci.moving:
            raise BaggieError(
                "expected the arm at rest, to reset the scene; somebody moves it: wait until it stops"
            )
        exposure, scene = draw_scene(self.task, self._cell, seed)
        self.seed, self._exposure = seed, exposure
        self.world.reset(scene.starts, aside=set(self.world.movable) - set(scene.poses))
        self.world.put_joints(PARK)
        self.robot.hold()
        self.fci.hold()

    def lay_bag(self, pose: PlanarPose, name: str, *, undented: bool) -> None:
        """Put a bag somewhere else, as a person would; its dents stay unless `undented`.

        Raises `BaggieError` where no person would, and where no bag has this name.
        """
        if name not in self.world.bodies:
            raise BaggieError(f"expected a bag among {', '.join(self.world.bodies)}, got {name!r}")
        if not (abs(pose.x) <= WITHIN_M and abs(pose.y) <= WITHIN_M and math.isfinite(pose.yaw)):
            raise BaggieError(
                f"expected x and y within {WITHIN_M:g} m of the robot and a finite yaw, got {pose.x:g}, {pose.y:g} and "
                f"{pose.yaw:g}"
            )
        block = self.world.block.pose
        if block is not None and pose.distance(block) < APART_M:
            raise BaggieError("expected a bag beside the block, got one on it; take the block away first")
        for other in self.world.bodies:
            if other != name and pose.distance(self.world.planar_pose(other)) < APART_M:
                raise BaggieError(
                    f"expected {name} {APART_M:g} m beside all other bags, got it on {other}; lay that elsewhere first"
                )
        self.world.put(name, pose, undented=undented)

    def lay_block(self, pose: PlanarPose, height_m: float) -> None:
        """Lay a firm block, its middle at `pose`, for the arm to feel; a height of 0 takes it away.

        Raises `BaggieError` where no person would.
        """
        if height_m == 0:
            self.world.block.take_away()
            return
        if not (0 < height_m <= MAX_BLOCK_HEIGHT_M and abs(pose.x) <= WITHIN_M and abs(pose.y) <= WITHIN_M):
            raise BaggieError(
                f"expected a block of at most {MAX_BLOCK_HEIGHT_M:g} m within {WITHIN_M:g} m of the robot, got one of "
                f"{height_m:g} m at {pose.x:g}, {pose.y:g}"
            )
        if any(pose.distance(self.world.planar_pose(bag)) < APART_M for bag in self.world.bodies):
            raise BaggieError(
                "expected a block beside the bag, got one on it; lay the bag somewhere else first"
            )
        x, y, z = self.robot.tool_xyz
        if pose.distance(PlanarPose(x, y)) < APART_M and z < height_m + HAND_ABOVE_M:
            raise BaggieError(
                f"expected a block below the hand, got one of {height_m:g} m with the tool at {z:.3f} m; raise the arm"
            )
        self.world.block.lay(pose, height_m)

    def render_state(self) -> RenderState:
        """The scene as it is now, for the render process to draw."""
        return RenderState.of(self.world, self._exposure)
