"""What `baggie evaluate` may be asked."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

from baggie.errors import BaggieError
from baggie.sim.variety import Scenery

TASKS = ("bag-place",)
GoalKind = Literal["virtual", "turned", "card"]
"""How a goal is given: marked square to the workspace, marked at any angle, or by a card that really lies there."""


@dataclass(frozen=True)
class EvaluateOptions:
    """Run a policy in the closed loop on unseen scenes of the simulator, and measure where the bags end.

    Again with the same words it goes on where it stopped; with more episodes it adds to those it has.

    Example: baggie evaluate --policy runs/keypoint --episodes 100 --out runs/keypoint/evaluation
    """

    policy: str
    """A training run's folder, a Hub id, `color-mask`, or `oracle`, which reads the simulator's truth."""
    out: Path
    """Where metrics.json, episodes.jsonl, pictures and videos go."""
    task: str = "bag-place"
    """What to do. There is one: bag-place."""
    episodes: int = 100
    """How many scenes."""
    seed: int = 0
    """Names the scenes; no seed of `collect` ever gives one of them."""
    cell: int = 0
    """The workcell; a policy belongs to the one it was trained in."""
    scenery: Scenery = "plain"
    """The cell as it is; other light; what a varied collection shows; a bag, or all of a scene, that none ever shows;
    or a second bag.
    """
    goal: GoalKind = "virtual"
    """Marked in the picture, square to the workspace; at any angle; or a real green card that has to be found."""
    radius_cm: float = 2.0
    """A bag this near the middle of its goal is a success."""
    retries: int = 2
    """How often to look again when the gripper noticed that it missed."""
    workers: int | None = None
    """Processes, each with a workcell of its own; as many as there are cores unless given."""
    film: int = 2
    """How many of the first episodes to make a video of."""
    calibration: Path | None = None
    """A recording of this cell, for its map: `color-mask` plans with it, `--goal card` allows for a bag's height."""

    def check(self) -> None:
        """Raise `BaggieError` for what cannot be evaluated."""
        for name, chosen, known in (
            ("task", self.task, TASKS),
            ("scenery", self.scenery, get_args(Scenery)),
            ("goal", self.goal, get_args(GoalKind)),
        ):
            if chosen not in known:
                raise BaggieError(f"expected a {name} among {', '.join(known)}, got {chosen!r}")
        for name, least in (("episodes", 1), ("seed", 0), ("cell", 0), ("retries", 0), ("film", 0)):
            if getattr(self, name) < least:
                raise BaggieError(f"expected --{name} of at least {least}, got {getattr(self, name)}")
        if self.workers is not None and self.workers < 1:
            raise BaggieError(f"expected --workers of at least 1, got {self.workers}")
        if self.radius_cm <= 0:
            raise BaggieError(f"expected --radius-cm above 0, got {self.radius_cm}")
