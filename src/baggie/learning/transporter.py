"""How the `transporter` policy is taught: every look at once, each as if those before it had been right."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.optim import Adam, Optimizer

from baggie.calibration.image_to_robot.rectify import Rectifier
from baggie.geometry import FloatArray, rotation, wrap_angle
from baggie.learning.demonstrations import (
    Demonstrations,
    from_camera,
    read_demonstrations,
    rectified,
    rectifier_for,
    with_seen_symmetry,
    with_turns,
)
from baggie.learning.loop import Batch, Recipe
from baggie.learning.moved_maps import MovedMap, MovedMaps, Moves
from baggie.learning.split import Split, split_episodes
from baggie.options.training import TransporterTraining
from baggie.options.values import Preset
from baggie.policies.planning import GoalInput
from baggie.policies.transporter.config import TransporterConfig
from baggie.policies.transporter.network import TransporterNet
from baggie.policies.transporter.policy import TransporterPolicy
from baggie.policies.transporter.scores import PlaceAngle, Scores
from baggie.types import Attempt
from baggie.vision.carried import with_turn

_RATE = {"fast": 1e-3, "paper": 1e-4}
_BATCH = {"fast": 4, "paper": 1}
_STEPS = {"fast": 3600, "paper": 10_000}
_REARRANGED = {"fast": 0.5, "paper": 0.0}
_WARM_UP = 0.03
"""Of the training of `fast`."""
_WINDOW = {"fast": (160, 160), "paper": None}
"""Pixels of a map that are looked at in a step: empty table teaches little, and a step takes as long as they are many.
"""
_FINGERS = 2
"""How often a turn two fingers are the same."""
_BESIDE_PICK_PX = 1.0
"""Largest error of a pick, along each axis, that the place learns to make up for."""
_BESIDE_PLACE_PX = 4.0
"""The same of the coarse place that the fine one starts from."""


@dataclass(frozen=True)
class TransporterOptions:
    """What can be chosen about a `transporter` policy and its training."""

    preset: Preset = "fast"
    rotations: int = 36
    pick_yaw: bool = False
    """Whether a gripper has to be turned to pick; so it is where it was in any demonstration."""
    batch: int | None = None
    """Maps a step; by default 4 for fast, 1 for paper, as published."""
    rearranged: float | None = None
    """The share of maps in which everything that stands alone is moved by itself; by default half for fast, none for
    paper, as published.
    """
    moves: Moves = field(default_factory=Moves)
    """Of whole scenes."""


class TransporterRecipe(Recipe):
    """Scenes are moved as wholes; the place is learned relative to a pick that is a little off, as picks are."""

    average: ClassVar[bool] = True
    max_gradient: ClassVar[float | None] = 10.0
    steps_before = 3200
    policy: TransporterPolicy

    def __init__(
        self,
        demonstrations: Demonstrations,
        options: TransporterOptions | None = None,
        rectifier: Rectifier | None = None,
    ) -> None:
        """`rectifier`: with which the maps were made of one camera's pictures, where they were.

        Raises `BaggieError` for options out of range.
        """
        self.options = options = options or TransporterOptions()
        if options.preset == "fast":  # as published, what is taught is the pick that was shown
            demonstrations = demonstrations.by_the_thing()
        pick_yaw = options.pick_yaw or demonstrations.turned_to_pick
        off = np.linalg.norm(demonstrations.middles - demonstrations.places[:, 0], axis=1)
        beside = off > _BESIDE_PICK_PX
        config = TransporterConfig(
            options.preset,
            options.rotations,
            demonstrations.common_symmetry,
            pick_yaw,
            # Beside its middle a thing that looks the same after a turn is held otherwise then.
            pick_symmetry=_FINGERS if pick_yaw and beside.any() else None,
        )
        network = TransporterNet(config)
        shown = demonstrations
        self.policy = TransporterPolicy(
            network, shown.grid, shown.cell, shown.goal_input, rectifier, scale=shown.scale
        )
        self.looks = {
            "origin": demonstrations.symmetry_origin,
            "things": np.unique(demonstrations.symmetry).tolist(),
            "all": demonstrations.common_symmetry,
        }
        """Who said how often things look the same a turn, how often they do, and how often all of them do."""
        share = _REARRANGED[options.preset] if options.rearranged is None else options.rearranged
        moves = options.moves if options.preset == "fast" else replace(options.moves, other_views=0.0)
        self._maps = MovedMaps(demonstrations, moves, share, _WINDOW[options.preset])
        # Held beside its middle, a thing that was turned otherwise has another place: then only the one shown is right.
        self._symmetry = np.where(beside, config.symmetry, demonstrations.symmetry)
        self._grasps = np.where(beside, _FINGERS, np.lcm(_FINGERS, demonstrations.symmetry))
        self._batch = options.batch or _BATCH[options.preset]
        self.steps = _STEPS[options.preset]
        if self.looks["origin"] in ("given", "found"):  # else what each attempt says is as good
            self.symmetry = demonstrations.common_symmetry

    @classmethod
    def of(cls, options: TransporterTraining, attempts: Sequence[Attempt]) -> Self:
        """The recipe that a command asks for. Raises `BaggieError` for what cannot be learned from together."""
        painted = GoalInput("painted", options.goal_style, options.goal_color)
        chosen = TransporterOptions(options.preset, pick_yaw=options.pick_yaw, rearranged=options.rearranged)
        rectifier = None
        if from_camera(attempts):
            rectifier = rectifier_for(attempts, options.data)
            attempts = with_seen_symmetry([rectified(attempt, rectifier) for attempt in attempts])
            attempts = with_turns(attempts, np.random.default_rng(options.seed))
        return cls(read_demonstrations(attempts, options.symmetry, painted), chosen, rectifier)

    @classmethod
    def split(cls, attempts: Sequence[Attempt], train: int | None, val: int | None) -> Split:
        """Split by whole episodes, but for one camera's pictures."""
        return (Split.of if from_camera(attempts) else split_episodes)(attempts, train, val)

    def chosen(self) -> dict[str, Any]:
        """How many maps are rearranged, how often a turn things look the same."""
        return {"rearranged": self.options.rearranged, "symmetry": self.looks}

    def note(self) -> str:
        """How often a turn things look the same, and who said so."""
        things = " or ".join(_looks(times) for times in self.looks["things"])
        of_all = "" if len(self.looks["things"]) == 1 else f"; all of it {_looks(self.looks['all'])}"
        return f"what is picked looks {things}{of_all} (symmetry {self.looks['origin']})"

    def optimizer(self) -> Optimizer:
        """Adam, as published; at ten times the rate for `fast`."""
        return Adam(self.policy.network.parameters(), lr=_RATE[self.options.preset], fused=True)

    def rate(self, progress: float) -> float:
        """`fast`: a short warm-up, then half a cosine. `paper`: always the same."""
        if self.options.preset == "paper":
            return 1.0
        return min(1.0, (progress + 1e-3) / _WARM_UP) * (1 + math.cos(math.pi * progress)) / 2

    def batch(self, rng: np.random.Generator) -> Batch:
        """Maps, `color` `(B, 3, H, W)` uint8 and `height` `(B, H, W)` metres; labels in pixels (u, v) and radians.

        `pick` `(B, 3)`: place and yaw; `held` `(B, 2)`: where it is really picked, a little off; `target` `(B, 3)`: the
        place and turn that belong to that; `about` `(B, 2)`: where the fine look starts; how often a turn what is
        picked looks the same, `symmetry` `(B,)`, and how often its grasp is, `grasps` `(B,)`.
        """
        numbers = rng.integers(0, len(self._maps), self._batch)
        samples = [self._sample(rng, moved) for moved in self._maps.draw(rng, numbers.tolist())]
        stacked = {name: np.stack([sample[name] for sample in samples]) for name in samples[0]}
        batch = {name: torch.from_numpy(array) for name, array in stacked.items()}
        alike = {"symmetry": self._symmetry, "grasps": self._grasps}
        return {**batch, **{name: torch.from_numpy(times[numbers]) for name, times in alike.items()}}

    def _sample(self, rng: np.random.Generator, moved: MovedMap) -> dict[str, NDArray[Any]]:
        beside = rng.uniform(-_BESIDE_PICK_PX, _BESIDE_PICK_PX, 2)
        target = self._target(moved, beside)
        about = target[:2] + rng.uniform(-_BESIDE_PLACE_PX, _BESIDE_PLACE_PX, 2)
        single = {
            "height": moved.height,
            "pick": np.array([*moved.places[0], moved.yaws[0]]),
            "held": moved.places[0] + beside,
            "target": target,
            "about": about,
        }
        floats = {name: np.asarray(array, np.float32) for name, array in single.items()}
        return {"color": np.ascontiguousarray(moved.color.transpose(2, 0, 1)), **floats}

    def _target(self, moved: MovedMap, beside: FloatArray) -> FloatArray:
        """Place and turn `(3,)` for what is held `beside` `(2,)` pixels from its pick: the thing itself ends the same.

        Held at p + d and turned by a, it has to be let go at y + R(a) d; a is the least turn of those that look alike,
        and about its middle they look alike, not about its pick.
        """
        shown = float(moved.yaws[1] - moved.yaws[0])
        fold = self.policy.network.config.symmetry
        turn = float(wrap_angle(shown, 2 * math.pi / fold)) if fold else 0.0
        rows, columns = moved.height.shape
        place = with_turn(moved.places, shown, turn, moved.middle) + rotation(turn) @ beside
        return np.array([*np.clip(place, -0.5, [columns - 0.5, rows - 0.5]), turn])

    def loss(self, network: nn.Module, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        """The sum of the looks' cross-entropies, nats."""
        pick, target = batch["pick"], batch["target"]
        held = PlaceAngle(batch["held"], pick[:, 2])
        looks: list[Scores] = network(batch["color"], batch["height"], held, batch["about"])
        truth_pick, truth_place = (PlaceAngle(pose[:, :2], pose[:, 2]) for pose in (pick, target))
        picks = len(self.policy.network.picks)
        losses = [look.loss(truth_pick, batch["grasps"]) for look in looks[:picks]]
        losses += [look.loss(truth_place, batch["symmetry"]) for look in looks[picks:]]
        names = [f"pick_{i}_nats" for i in range(picks)]
        names += [f"place_{i}_nats" for i in range(len(looks) - picks)]
        parts = {name: part.detach() for name, part in zip(names, losses, strict=True)}
        return torch.stack(losses).sum(), parts


def _looks(times: int) -> str:
    if times == 0:
        return "the same at any angle"
    return "the same only after a whole turn" if times == 1 else f"the same {times} times a turn"
