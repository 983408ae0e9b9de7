"""The pictures of docs/calibration.md: every calibration of one simulated cell, as its command draws it.

    python benchmarks/calibration_media.py --cell 7 --out runs/calibration-media

Writes docs/media/calibration-*.jpg.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import tyro

from baggie.cli.main import main as baggie
from baggie.evaluation.marked_pictures import save_jpeg
from baggie.options.values import BOARD
from baggie.pictures import read_picture
from baggie.vision.printing import draw_target
from baggie.vision.targets import parse_target
from helpers.printed_pages import page_picture

MEDIA = Path("docs/media")
_DPI = 80


@dataclass(frozen=True)
class Options:
    """Which cell, and where its calibrations go."""

    cell: int = 7
    """The simulated workcell."""
    out: Path = Path("runs/calibration-media")
    """Folder of the calibrations."""


def main(options: Options) -> None:
    """Run the commands, then gather what they drew."""
    out = options.out
    lens = ["--intrinsics", str(out / "camera.yaml")]
    for command in (
        ["intrinsics", "--out", str(out / "camera.yaml")],
        ["image-to-robot", *lens, "--out", str(out / "image-to-robot.yaml")],
        ["camera-to-world", *lens, "--out", str(out / "camera-to-world.yaml")],
        ["hand-eye", *lens, "--out", str(out / "hand-eye.yaml")],
    ):
        if status := baggie(["calibrate", *command, "--cell", str(options.cell)]):
            raise SystemExit(status)
    pictures = {
        "print": page_picture(draw_target(parse_target(BOARD), "A3"), _DPI),
        "intrinsics": read_picture(out / "camera.png"),
        "image-to-robot": read_picture(out / "image-to-robot.png"),
        "table": read_picture(out / "camera-to-world.live.jpg"),
        "hand-eye": read_picture(out / "hand-eye.png"),
    }
    for name, picture in pictures.items():
        save_jpeg(MEDIA / f"calibration-{name}.jpg", picture)
        print(MEDIA / f"calibration-{name}.jpg")


if __name__ == "__main__":
    main(tyro.cli(Options))
