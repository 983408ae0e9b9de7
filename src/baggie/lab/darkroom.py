"""Where the lab's pictures are drawn: in a process of its own, because MuJoCo's renderer lets no other thread run."""

from __future__ import annotations

import multiprocessing
import signal
import threading
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection

import mujoco
import numpy as np

from baggie.errors import BaggieError
from baggie.geometry import FloatArray
from baggie.sim.arm_world import ArmWorld
from baggie.sim.cell import draw_cell
from baggie.sim.renderer import CameraRenderer
from baggie.sim.sensor import Exposure
from baggie.sim.world import World
from baggie.types import Image

_STATE = mujoco.mjtState.mjSTATE_INTEGRATION


@dataclass(frozen=True)
class Moment:
    """All that a picture of a lab depends on."""

    state: FloatArray
    """Of the physics, as MuJoCo orders it."""
    colors: FloatArray
    """Of all geoms: what is not shown is transparent."""
    camera: tuple[FloatArray, FloatArray]
    """`camera_position` and `camera_rotation` of the cell, which may have been bumped; its lens stays as it is."""
    exposure: Exposure

    @classmethod
    def of(cls, world: ArmWorld, exposure: Exposure) -> Moment:
        """What there is to see now."""
        state = np.empty(mujoco.mj_stateSize(world.model, _STATE))
        mujoco.mj_getState(world.model, world.data, state, _STATE)
        camera = (world.cell.camera_position, world.cell.camera_rotation)
        return cls(state, world.model.geom_rgba.copy(), camera, exposure)

    def lay_out(self, world: ArmWorld) -> None:
        """Make a world of the same cell look as it did then."""
        position, rotation = self.camera
        world.place_camera(replace(world.cell, camera_position=position, camera_rotation=rotation))
        world.model.geom_rgba[:] = self.colors
        mujoco.mj_setState(world.model, world.data, self.state, _STATE)
        world.update_fixed()


class Darkroom:
    """The process that draws, one picture at a time."""

    def __init__(self, cell: int, picture_size: tuple[int, int]) -> None:
        """`picture_size`: `(width, height)`, pixels. Raises `BaggieError` where nothing can render off screen."""
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_work, args=(theirs, cell, picture_size), daemon=True)
        self._process.start()
        theirs.close()
        self._one_at_a_time = threading.Lock()
        trouble = self._pipe.recv()
        if trouble is not None:
            raise BaggieError(trouble)

    def develop(self, moment: Moment) -> Image:
        """The picture of a moment, `(H, W, 3)`. Raises `EOFError` or `OSError` once it is closed."""
        with self._one_at_a_time:
            self._pipe.send(moment)
            picture: Image = self._pipe.recv()
            return picture

    def close(self) -> None:
        """End the process."""
        self._process.terminate()
        self._process.join()


def _work(pipe: Connection, cell: int, picture_size: tuple[int, int]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the lab, which ends this process then
    world = World(draw_cell(cell, picture_size))
    try:
        renderer = CameraRenderer(world)
    except BaggieError as error:
        pipe.send(str(error))
        return
    pipe.send(None)
    rng = np.random.default_rng()
    while True:
        moment: Moment = pipe.recv()
        moment.lay_out(world)
        pipe.send(renderer.look(moment.exposure, rng, depth=False).color)
