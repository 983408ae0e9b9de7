"""What each part of the `keypoint` policy is worth: it is taken away, and the policy is trained again.

    python benchmarks/ablations.py --recordings runs/recordings --runs runs/ablations

Several cells, 200 attempts to learn from and 50 to measure on in each. Writes docs/results/ablations.{json,md}.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
import tyro
from torch import Tensor, nn

from baggie.learning.augmentation import WarpRange
from baggie.learning.keypoint import IntArray, KeypointOptions, KeypointRecipe
from baggie.learning.samples import Changes
from baggie.options.values import Backbone
from baggie.policies.keypoint.heads import PlanarMap, heat_maps, soft_argmax
from baggie.policies.keypoint.policy import KeypointNet
from baggie.results import provenance, write_results
from teaching import Lesson, teach_all


class FullyConnectedNet(KeypointNet):
    """Eight feature maps, pooled to 12 x 20, and two layers that say where in them the points are."""

    def __init__(self, width: int = 24, channels: int = 4, backbone: Backbone = "small") -> None:
        super().__init__(width, channels, backbone)
        self.heat = nn.Conv2d(width, 8, 1)
        self.head = nn.Sequential(
            nn.AdaptiveAvgPool2d((12, 20)),
            nn.Flatten(),
            nn.Linear(8 * 240, 256),
            nn.ReLU(),
            nn.Linear(256, 4),
        )

    def locate(self, logits: Tensor) -> Tensor:
        height, width = logits.shape[-2:]
        return self.head(logits).view(-1, 2, 2).sigmoid() * torch.tensor([width - 1.0, height - 1.0])

    def read(self, logits: Tensor, field: Tensor, to_picture: Tensor, layers: Tensor | None = None) -> Any:
        found = super().read(logits, field, to_picture, layers)
        return found._replace(logits=logits[:, :2])


class GlobalNet(KeypointNet):
    """The mean under the whole heat map."""

    def locate(self, logits: Tensor) -> Tensor:
        return soft_argmax(heat_maps(logits))


class Homography(PlanarMap):
    """Without the lens."""

    def _straighten(self, points: Tensor) -> Tensor:
        return points


class HomographyNet(KeypointNet):
    def __init__(self, width: int = 24, channels: int = 4, backbone: Backbone = "small") -> None:
        super().__init__(width, channels, backbone)
        self.to_robot = Homography()


class NoEdgesNet(KeypointNet):
    """The yaw from what the network finds by itself."""

    def directions(self, images: Tensor) -> Tensor:
        return torch.zeros_like(super().directions(images))


class FullyConnectedRecipe(KeypointRecipe):
    network_class: ClassVar[type[KeypointNet]] = FullyConnectedNet
    heat_weight: ClassVar[float] = 0.0


class GlobalRecipe(KeypointRecipe):
    network_class: ClassVar[type[KeypointNet]] = GlobalNet


class HomographyRecipe(KeypointRecipe):
    network_class: ClassVar[type[KeypointNet]] = HomographyNet


class NoEdgesRecipe(KeypointRecipe):
    network_class: ClassVar[type[KeypointNet]] = NoEdgesNet


class OwnGoalsRecipe(KeypointRecipe):
    """Every picture keeps its own goal."""

    def pairs(self, rng: np.random.Generator) -> tuple[IntArray, IntArray]:
        pick_from, _ = super().pairs(rng)
        return pick_from, pick_from


STILL = WarpRange(rotation=0.0, scale=1.0, shear=0.0, perspective=0.0, shift=0.0)
VARIANTS: dict[str, tuple[type[KeypointRecipe], KeypointOptions]] = {
    "keypoint, all of it": (KeypointRecipe, KeypointOptions()),
    "fully connected head": (FullyConnectedRecipe, KeypointOptions()),
    "global soft-argmax": (GlobalRecipe, KeypointOptions()),
    "no calibration-free augmentation": (KeypointRecipe, KeypointOptions(changes=Changes(warps=STILL))),
    "goals not exchanged": (OwnGoalsRecipe, KeypointOptions()),
    "no label fusion, no consensus": (KeypointRecipe, KeypointOptions(fuse_labels=False)),
    "homography without lens": (HomographyRecipe, KeypointOptions()),
    "no directions of edges": (NoEdgesRecipe, KeypointOptions()),
    "no new looks": (KeypointRecipe, KeypointOptions(changes=Changes(new_looks=0.0))),
}


@dataclass(frozen=True)
class Options:
    """Train and measure."""

    recordings: Path = Path("runs/recordings")
    """Holds a recording `cell-N` of each cell."""
    runs: Path = Path("runs/ablations")
    cells: tuple[int, ...] = (17, 18, 19)
    steps: int | None = None


def main(options: Options) -> None:
    """Train what is missing and write the table."""
    lessons = {
        (variant, cell): Lesson(
            f"{variant.replace(' ', '-').replace(',', '')}-{cell}",
            options.recordings / f"cell-{cell}",
            first=0,
            train=200,
            val_after=200,
            steps=options.steps,
            options=chosen,
            recipe=recipe,
        )
        for cell in options.cells
        for variant, (recipe, chosen) in VARIANTS.items()
    }
    errors = teach_all(list(lessons.values()), options.runs)
    rows = []
    for variant in VARIANTS:
        of_cells = [errors[lessons[variant, cell].name] for cell in options.cells]
        row: dict[str, Any] = {"variant": variant}
        for what in ("pick", "place"):
            means = [float(np.mean(e[f"{what}_cm"])) for e in of_cells]
            worst = max(max(e[f"{what}_cm"]) for e in of_cells)
            row[f"{what} error (cm)"] = f"{np.mean(means):.2f} ± {np.std(means, ddof=1):.2f}"
            row[f"worst {what} (cm)"] = round(worst, 2)
        yaw = [float(np.mean(e["yaw_deg"])) for e in of_cells]
        row["pick yaw error (deg)"] = f"{np.mean(yaw):.1f} ± {np.std(yaw, ddof=1):.1f}"
        rows.append(row)
    notes = (
        "Errors against the simulator's truth on 50 held-out attempts after 200, mean and standard deviation over "
        f"cells {', '.join(map(str, options.cells))}; worst of all. Each row is trained anew, one part taken away."
    )
    write_results(Path("docs/results/ablations"), "What each part is worth", rows, provenance([0]), notes)


if __name__ == "__main__":
    main(tyro.cli(Options))
