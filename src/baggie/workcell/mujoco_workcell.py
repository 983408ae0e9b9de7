"""What every workcell in MuJoCo has: the world's clock, and a film of it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from baggie.sim.arm_world import ArmWorld
from baggie.sim.renderer import Film
from baggie.types import Image
from baggie.workcell.workcell import Workcell


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
