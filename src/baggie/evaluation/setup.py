"""What an episode needs: a cell, where its bag is, and the policy to try in it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from baggie.calibration.files import MAP_FILE
from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.data.files import CALIBRATION_FOLDER
from baggie.errors import BaggieError
from baggie.evaluation.subjects import config_of, in_its_cell
from baggie.geometry import FloatArray, PlanarPose, Rectangle
from baggie.options.evaluating import EvaluateOptions
from baggie.policies import ColorMaskPolicy, Policy
from baggie.robot.limits import Limits
from baggie.types import Image, Observation, Outcome, Plan


def card_map(options: EvaluateOptions) -> Path | None:
    """The map that raises a card's corners to the bag's height, if one is known: the calibration of the recording
    given, or of the one the policy was trained on, or that of `color-mask`.
    """
    if options.goal != "card":
        return None
    trained_on = config_of(options.policy).get("training", {}).get("data")
    own = options.out if options.policy == ColorMaskPolicy.name else trained_on
    given = options.calibration or own
    if given is None or (options.calibration is None and not in_its_cell(options.policy, options.cell)):
        return None
    return next(
        (f for f in (Path(given, CALIBRATION_FOLDER, MAP_FILE), Path(given, MAP_FILE)) if _raises(f)), None
    )


def _raises(map_file: Path) -> bool:
    """Whether there is a map that knows more than one height."""
    return map_file.exists() and ImageToRobot.load(map_file).height_aware


Find = Callable[[Observation], PlanarPose]
"""Where a picture shows the bag, robot base frame. Raises `BaggieError` where it does not."""


class Settings(Protocol):
    """What an episode must know of a workcell's settings."""

    @property
    def workspace(self) -> Rectangle:
        """Where bags may lie, robot base frame, metres."""
        ...

    @property
    def limits(self) -> Limits:
        """Where the hand may go."""
        ...

    @property
    def object_size_m(self) -> tuple[float, float, float]:
        """Length, width and resting height of the bag in the scene."""
        ...

    @property
    def object_symmetry(self) -> int:
        """How many times a turn it looks the same; 0 for a round one."""
        ...


class EvaluationCell(Protocol):
    """A workcell whose scenes can be set: a simulated one, or a real one as it is."""

    @property
    def settings(self) -> Settings:
        """What it is; in some sceneries another bag in every scene."""
        ...

    def reset(self, seed: Sequence[int]) -> None:
        """A new scene, drawn from the random stream with this name; no card lies there."""
        ...

    def look(self) -> Observation:
        """A picture with the arm out of view."""
        ...

    def carry_out(self, plan: Plan) -> Outcome:
        """Pick and place; raises `UnsureError`, `LimitError` and `ReachError`."""
        ...

    def truth(self) -> PlanarPose | None:
        """Where the bag is now; None where nobody knows."""
        ...

    def second_truth(self) -> PlanarPose | None:
        """Where a bag is that is to stay, if there is one."""
        ...

    def obstacles(self) -> list[PlanarPose]:
        """Where things stand that no bag may be put on."""
        ...

    def goal_corners(self, pose: PlanarPose) -> FloatArray:
        """`(4, 2)` pixels: the outline of a bag resting there, in the true camera."""
        ...

    def lay_card(self, pose: PlanarPose | None) -> None:
        """Lay the goal card on the table, or take it away."""
        ...

    def film(self, size: tuple[int, int] = ..., fps: int = ...) -> AbstractContextManager[list[Image]]:
        """Frames of the arm at work while open."""
        ...


@dataclass
class Bench:
    """A cell and the policy to try in it."""

    cell: EvaluationCell
    policy: Policy
    image_to_robot: ImageToRobot | None = None
    """A map of this cell that knows more than one height: with it a card's corners are raised to the bag's."""
    find: Find | None = None
    """Where a picture shows the bag: for a cell of which nobody knows the truth."""
    goal: PlanarPose = field(init=False)
    """Where the bag is to go in this episode; only an oracle may ask."""

    def bag_at_start(self) -> PlanarPose:
        """Where the bag lies in a scene that has just begun: the truth, or else as a picture of it shows.

        Raises `BaggieError` where that shows none, or one that lies where no plan gets it back: that takes a person.
        """
        truth = self.cell.truth()
        if truth is not None:
            return truth
        bag, reach = self.bag_in(self.cell.look()), self.cell.settings.limits.workspace
        if not reach.contains(bag.x, bag.y):
            raise BaggieError(
                f"expected the object within {reach}, got it at x {bag.x:.2f} m, y {bag.y:.2f} m; put it back and give "
                "the same command again: it goes on from there"
            )
        return bag

    def bag_in(self, seen: Observation) -> PlanarPose:
        """Where the bag was in the last picture: the truth, which is what it was then, or else as the picture shows."""
        truth = self.cell.truth()
        if truth is not None:
            return truth
        assert self.find is not None, "nobody knows where the bag is"
        return self.find(seen)
