"""What can be said about a training."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from annotated_types import Interval

from baggie.errors import UsageError
from baggie.policies.keypoint.network import Backbone
from baggie.policies.regression.policy import Statistics
from baggie.policies.transporter.config import Preset
from baggie.ranges import Color, Count, NotNegative, Number, Options, Seed, Share
from baggie.types import DrawnStyle

_OF = {
    ("goal_input", "backbone", "new_looks"): ("keypoint",),
    ("weights",): ("keypoint", "regression"),
    ("statistics",): ("regression",),
    ("preset", "symmetry", "pick_yaw", "rearranged"): ("transporter",),
}
"""The policies that options are for; all others are for every policy."""
_WHY = {
    "keypoint": "which looks at a camera's own pictures",
    "regression": "which is kept as published",
    "transporter": "which looks from straight above",
}


@dataclass(frozen=True)
class TrainOptions(Options):
    """Teach a policy from recorded attempts. Run again with the same words, it goes on where it was stopped.

    Example: baggie train --policy keypoint --data recordings/bags --out runs/keypoint
    """

    data: Path
    """The recording."""
    out: Path
    """The run's folder: config.yaml, policy.safetensors, metrics.json, TensorBoard events, what is needed to
    resume.
    """
    policy: Literal["keypoint", "regression", "transporter"] = "keypoint"
    """`keypoint` is ours; `regression` the published baseline; `transporter` for precision, on height maps or
    a camera's pictures with a map to the robot.
    """
    train: Count | None = None
    """How many attempts to learn from: the first successful ones, by attempt id. transporter: how many episodes. By
    default four fifths of what there is, at most 200."""
    val: Number | None = None
    """How many attempts, or episodes, to measure on: the next successful ones. By default a fifth of what there is, at
    most 50."""
    seed: Seed = 0
    """Of the first weights and of all batches."""
    steps: Count | None = None
    """Batches to learn from; by default 800 of 8 for keypoint, 10,000 of 1 for regression, 3,600 of 4 for
    transporter."""
    device: Literal["auto", "cpu", "cuda", "mps"] = "auto"
    """Where to compute; `auto` takes the best there is. Several GPUs: `accelerate launch -m baggie train
    ...`.
    """
    goal_style: DrawnStyle = "solid"
    """How goals are painted into pictures: for regression, transporter, and keypoint with --goal-input painted."""
    goal_color: Color = (0, 200, 0)
    """The colour of painted goals, RGB."""
    goal_input: Literal["region", "painted"] = "region"
    """keypoint: whether a goal is a channel of its own, or is painted into the picture as it is for regression."""
    backbone: Backbone = "small"
    """keypoint: what sees; `resnet18` is slower and can start from published weights."""
    weights: str | None = None
    """ImageNet weights of a ResNet-18 to start from, a .pth or .safetensors file or a Hub id; none by default."""
    statistics: Statistics = "running"
    """regression: what its batch normalisation goes by once trained. `running` averages, as published; or each
    `picture`'s own, as it learned from batches of one.
    """
    new_looks: Share = 0.25
    """keypoint: the share of pictures with cloth, shape, table and clutter drawn anew, to know bags of any kind."""
    preset: Preset = "fast"
    """transporter: `fast` is ours; `paper` has the published sizes and takes 200 times as long a map."""
    symmetry: Annotated[int, Interval(ge=0, le=360)] | None = None
    """transporter: how often a turn all that is picked looks the same, 4 for square blocks, 0 at any angle; as the
    recording says unless given. Where it says nothing it is found in the maps before and after each step; by the boxes
    in a camera's pictures 4, or 2 where most are long; else 1.
    """
    pick_yaw: bool = False
    """transporter: whether a gripper has to be turned to pick; a suction cup has not. Implied where it was turned."""
    rearranged: Share | None = None
    """transporter: the share of maps in which everything that stands alone is put elsewhere by itself, and a place
    with what it belongs to: from few demonstrations that teaches most. Give 0 where which thing is meant depends on how
    they lie to each other: the left one, the one beside the bowl. By default half for fast, none for paper.
    """
    save_every_s: NotNegative = 30.0
    """Seconds between saves of the state: what a kill can cost."""

    def check(self) -> None:
        """Raise `UsageError` for what does not go together, or would be ignored."""
        for names, policies in _OF.items():
            if self.policy not in policies:
                where = f"--policy {self.policy}, {_WHY[self.policy]}"
                self._expect_default(names, where, f"take --policy {policies[0]}")
        if self.policy != "keypoint":
            return
        if self.goal_input == "region":
            where = "--goal-input region, which paints no goals"
            self._expect_default(("goal_style", "goal_color"), where, "add --goal-input painted")
        if self.weights is not None and self.backbone != "resnet18":
            raise UsageError(
                f"--weights are those of a ResNet-18, but keypoint's backbone is {self.backbone}: "
                "add --backbone resnet18"
            )

    def _expect_default(self, names: Sequence[str], where: str, remedy: str) -> None:
        for name in names:
            if (given := getattr(self, name)) != getattr(TrainOptions, name):
                raise UsageError(
                    f"expected no --{name.replace('_', '-')} with {where}, got {given}; leave it out, or {remedy}"
                )
