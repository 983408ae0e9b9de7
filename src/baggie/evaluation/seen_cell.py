"""A real workcell as the closed loop needs it: where things are is what its own camera sees of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from baggie.collect.detect import at_outline, detect
from baggie.errors import BaggieError
from baggie.geometry import FloatArray, PlanarPose
from baggie.types import Image, Observation, Outcome, Plan
from baggie.workcell.real import RealWorkcell
from baggie.workcell.workcell import WorkcellSettings


class SeenCell:
    """Nobody lays the table anew: a scene begins where the one before it ended. And nobody knows the truth.

    In a picture the object is found by its colour, and the workcell's `image_to_robot` says where that is. So what is
    measured here is as right as that map; the policy does not need it.
    """

    def __init__(self, cell: RealWorkcell, path: Path) -> None:
        """`path`: of its file, for people. Raises `BaggieError` where it names no map from the picture to the robot."""
        if cell.calibrations.image_to_robot is None:
            raise BaggieError(
                f"expected image_to_robot below `calibrations` in {path}, to measure where bags end, got none; make "
                f"one with: baggie calibrate image-to-robot --workcell {path}"
            )
        self._cell, self._path = cell, path
        to_robot = at_outline(cell.calibrations.image_to_robot, cell.settings)
        self.image_to_robot = to_robot.for_size(cell.camera.size)

    @property
    def settings(self) -> WorkcellSettings:
        """What its file says."""
        return self._cell.settings

    def reset(self, seed: Sequence[int]) -> None:
        """What the hand still holds is put down, the arm parks, and the rest stays as it is."""
        self._cell.reset(seed)

    def look(self) -> Observation:
        """A picture with the arm out of view."""
        return self._cell.look()

    def carry_out(self, plan: Plan) -> Outcome:
        """As `Workcell.carry_out`."""
        return self._cell.carry_out(plan)

    def truth(self) -> None:
        """Nobody knows where the object really is."""

    def find(self, seen: Observation) -> PlanarPose:
        """Where a picture shows the object. Raises `BaggieError` where it shows none."""
        found = detect(seen, self.image_to_robot, self.settings)
        if found is None:
            raise BaggieError(
                f"expected an object of colour RGB {self.settings.object_color} in the picture of {self._path}, found "
                "none; bring it back into view and give the same command again: it goes on from there"
            )
        return found[1]

    def second_truth(self) -> None:
        """There is one object."""

    def obstacles(self) -> list[PlanarPose]:
        """None that anybody knows of."""
        return []

    def goal_corners(self, pose: PlanarPose) -> FloatArray:
        """`(4, 2)` pixels: where the outline of an object that rests at `pose` is to be expected."""
        length, width, _ = self.settings.object_size_m
        return self.image_to_robot.to_pixels(pose.outline(length, width))

    def lay_card(self, pose: PlanarPose | None) -> None:
        """Raises `BaggieError`: only a person lays a card there."""
        raise BaggieError("expected a goal that can be marked in the picture, got a card for a real workcell")

    @contextmanager
    def film(self, size: tuple[int, int] = (640, 480), fps: int = 20) -> Iterator[list[Image]]:
        """Nobody films it."""
        yield []

    def close(self) -> None:
        """Let go of arm and camera."""
        self._cell.close()
