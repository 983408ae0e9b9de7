"""What can be said about a training: much is common to all policies, and each has options of its own.

A package adds a policy that can be trained by an entry point of the group `baggie.trainings`: a dataclass like
those here.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from annotated_types import Interval

from baggie.errors import UsageError
from baggie.options.values import (
    Backbone,
    Color,
    Count,
    DrawnStyle,
    NotNegative,
    Number,
    Options,
    Preset,
    Seed,
    Share,
    Statistics,
)
from baggie.registry import Registry


@dataclass(frozen=True)
class TrainOptions(Options):
    """Teach a policy from recorded attempts. Run again with the same words, it goes on where it was stopped.

    What is common to all policies; each has a class of its own, which names its recipe.
    """

    recipe: ClassVar[str]
    """How it is taught: the `module:class` of a `baggie.learning.loop.Recipe`, imported when a training begins."""

    data: Path
    """The recording."""
    out: Path
    """The run's folder: config.yaml, policy.safetensors, metrics.json, TensorBoard events, what is needed to
    resume.
    """
    train: Count | None = None
    """How many attempts to learn from: the first successful ones, by attempt id; of height maps, how many episodes. By
    default four fifths of what there is, at most 200."""
    val: Number | None = None
    """How many attempts, or episodes, to measure on: the next successful ones. By default a fifth of what there is, at
    most 50."""
    seed: Seed = 0
    """Of the first weights and of all batches."""
    steps: Count | None = None
    """Batches to learn from."""
    device: Literal["auto", "cpu", "cuda", "mps"] = "auto"
    """Where to compute; `auto` takes the best there is. Several GPUs: `accelerate launch -m baggie train
    ...`.
    """
    save_every_s: NotNegative = 30.0
    """Seconds between saves of the state: what a kill can cost."""

    def check(self) -> None:
        """Raise `UsageError` for what does not go together, or would be ignored."""


@dataclass(frozen=True)
class KeypointTraining(TrainOptions):
    """Teach `keypoint`, which looks at a camera's own pictures.

    Example: baggie train --policy keypoint --data recordings/bags --out runs/keypoint
    """

    recipe = "baggie.learning.keypoint:KeypointRecipe"

    steps: Count | None = None
    """Batches of 8 to learn from; by default 800."""
    goal_input: Literal["region", "painted"] = "region"
    """Whether a goal is a channel of its own, or is painted into the picture as it is for regression."""
    goal_style: DrawnStyle = "solid"
    """How goals are painted into pictures, with --goal-input painted."""
    goal_color: Color = (0, 200, 0)
    """The colour of painted goals, RGB."""
    backbone: Backbone = "small"
    """What sees; `resnet18` is slower and can start from published weights."""
    weights: str | None = None
    """ImageNet weights of a ResNet-18 to start from, a .pth or .safetensors file or a Hub id; none by default."""
    new_looks: Share = 0.25
    """The share of pictures with cloth, shape, table and clutter drawn anew, to know bags of any kind."""

    def check(self) -> None:
        """Raise `UsageError` for what does not go together, or would be ignored."""
        for name in ("goal_style", "goal_color") if self.goal_input == "region" else ():
            if (given := getattr(self, name)) != getattr(type(self), name):
                raise UsageError(
                    f"expected no --{name.replace('_', '-')} with --goal-input region, which paints no goals, got "
                    f"{given}; leave it out, or add --goal-input painted"
                )
        if self.weights is not None and self.backbone != "resnet18":
            raise UsageError(
                f"--weights are those of a ResNet-18, but keypoint's backbone is {self.backbone}: "
                "add --backbone resnet18"
            )


@dataclass(frozen=True)
class RegressionTraining(TrainOptions):
    """Teach `regression`, which is kept as published.

    Example: baggie train --policy regression --data recordings/bags --out runs/regression
    """

    recipe = "baggie.learning.regression:RegressionRecipe"

    steps: Count | None = None
    """Batches of 1 to learn from; by default 10,000, as published."""
    goal_style: DrawnStyle = "solid"
    """How goals are painted into pictures."""
    goal_color: Color = (0, 200, 0)
    """The colour of painted goals, RGB."""
    weights: str | None = None
    """ImageNet weights of a ResNet-18 to start from, a .pth or .safetensors file or a Hub id; none by default."""
    statistics: Statistics = "running"
    """What its batch normalisation goes by once trained. `running` averages, as published; or each `picture`'s own, as
    it learned from batches of one.
    """


@dataclass(frozen=True)
class TransporterTraining(TrainOptions):
    """Teach `transporter`, which looks from straight above.

    Example: baggie train --policy transporter --data recordings/pyramid --out runs/pyramid
    """

    recipe = "baggie.learning.transporter:TransporterRecipe"

    steps: Count | None = None
    """Batches to learn from; by default 3,600 of 4 for fast, 10,000 of 1 for paper."""
    goal_style: DrawnStyle = "solid"
    """How goals are painted into pictures."""
    goal_color: Color = (0, 200, 0)
    """The colour of painted goals, RGB."""
    preset: Preset = "fast"
    """`fast` is ours; `paper` has the published sizes and takes 200 times as long a map."""
    symmetry: Annotated[int, Interval(ge=0, le=360)] | None = None
    """How often a turn all that is picked looks the same, 4 for square blocks, 0 at any angle; as the recording says
    unless given. Where it says nothing it is found in the maps before and after each step; by the boxes in a camera's
    pictures 4, or 2 where most are long; else 1.
    """
    pick_yaw: bool = False
    """Whether a gripper has to be turned to pick; a suction cup has not. Implied where it was turned."""
    rearranged: Share | None = None
    """The share of maps in which everything that stands alone is put elsewhere by itself, and a place with what it
    belongs to: from few demonstrations that teaches most. Give 0 where which thing is meant depends on how they lie to
    each other: the left one, the one beside the bowl. By default half for fast, none for paper.
    """


TRAININGS: Registry[type[TrainOptions]] = Registry(
    "baggie.trainings",
    {
        "keypoint": f"{__name__}:KeypointTraining",
        "regression": f"{__name__}:RegressionTraining",
        "transporter": f"{__name__}:TransporterTraining",
    },
    "policy",
)
"""What can be said about training each policy, by its name."""
