"""What a trained `keypoint` policy has learned of its camera by itself, against fitted calibrations and the truth.

    python benchmarks/learned_map.py --policy runs/keypoint --data runs/recording

Writes docs/results/learned-map.{json,md} and docs/media/calibration-learned.jpg.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

import baggie
from baggie.calibration.files import MAP_FILE
from baggie.calibration.image_to_robot.map import ImageToRobot, compare_maps
from baggie.calibration.image_to_robot.residuals import draw_comparison, lattice
from baggie.data.files import CALIBRATION_FOLDER
from baggie.evaluation.marked_pictures import save_jpeg
from baggie.geometry import Rectangle
from baggie.pictures import read_picture
from baggie.policies.keypoint.policy import KeypointPolicy, as_calibration
from baggie.results import provenance, write_results
from baggie.sim.bag import FULL_HEIGHT_M
from baggie.sim.cell import draw_cell

WORKSPACE = Rectangle(0.35, 0.65, -0.30, 0.30)


@dataclass(frozen=True)
class Options:
    """Which policy, and the recording it was trained on."""

    policy: Path = Path("runs/keypoint")
    """A training run."""
    data: Path = Path("runs/recording")
    """Holds the map that the collector fitted."""


def main(options: Options) -> None:
    """Compare and write."""
    policy = baggie.load_policy(options.policy)
    assert isinstance(policy, KeypointPolicy)
    learned = as_calibration(policy, FULL_HEIGHT_M / 2)
    fitted = ImageToRobot.load(options.data / CALIBRATION_FOLDER / MAP_FILE)
    cell = draw_cell(policy.cell)
    rows = []
    for name, found in (("learned by keypoint", learned), ("fitted by the collector", fitted)):
        spots = lattice(WORKSPACE, 7, 13)
        height = found.height_m
        seen = cell.project(np.c_[spots, np.full(len(spots), height)])
        errors = 1000 * (found.for_size(cell.lens.size).to_robot(seen) - spots)
        rows.append(
            {
                "map": name,
                "height (mm)": 1000 * height,
                "RMS off the truth (mm)": float(np.sqrt((errors**2).sum(axis=1).mean())),
                "worst (mm)": float(np.linalg.norm(errors, axis=1).max()),
                "of it a shift x, y (mm)": ", ".join(f"{value:.2f}" for value in errors.mean(axis=0)),
            }
        )
    comparison = compare_maps(learned, fitted, WORKSPACE)
    notes = (
        f"Against each other they differ by {comparison.rms_mm:.2f} mm (RMS), {comparison.max_mm:.2f} mm at most, over "
        "the workspace. The truth is the simulator's camera. The learned map comes with the policy: nobody calibrated "
        "anything."
    )
    for path in write_results(
        Path("docs/results/learned-map"), "The camera as a policy has learned it", rows, provenance([]), notes
    ):
        print(path)
    picture = options.policy / "learned-map.png"
    draw_comparison(comparison, picture)
    save_jpeg(Path("docs/media/calibration-learned.jpg"), read_picture(picture))


if __name__ == "__main__":
    main(tyro.cli(Options))
