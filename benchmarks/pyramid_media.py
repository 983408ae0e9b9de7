"""A pyramid being built, where the policy pointed at each step, and what it learned from: pictures of one run.

python benchmarks/pyramid_media.py --run runs/pyramid/fast-1-0
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import tyro
from PIL import Image

from baggie.data import open_dataset
from baggie.evaluation.marked_pictures import save_jpeg
from baggie.learning.demonstrations import read_demonstrations
from baggie.learning.moved_maps import MovedMaps, Moves
from baggie.policies.checkpoint import read_config
from baggie.types import Image as RgbImage

_EVERY = 2
"""Of the film's frames."""
_SIZE = (480, 360)
_MADE = 5
_RIM_PX = 12


@dataclass(frozen=True)
class Options:
    """What to show."""

    run: Path = Path("runs/pyramid/fast-1-0")
    """Of `benchmarks/pyramid.py`: its evaluation was filmed."""
    episode: int = 0
    out: Path = Path("docs/media")
    """Where the pictures go."""


def main(options: Options) -> None:
    """Make all three."""
    save_jpeg(options.out / "pyramid-rearranged.jpg", learned_from(options.run))
    episode = options.run / "evaluation" / "episodes" / f"episode-{options.episode:04d}"
    film = [Image.fromarray(frame) for frame in frames(episode.with_suffix(".mp4"))[::_EVERY]]
    small = [frame.resize(_SIZE, Image.Resampling.LANCZOS) for frame in film]
    small[0].save(
        options.out / "pyramid.webp", save_all=True, append_images=small[1:], duration=100, loop=0, quality=60
    )
    steps = [
        np.asarray(Image.open(path)) for path in sorted(episode.parent.glob(f"{episode.name}-step-*.jpg"))
    ]
    rows = [np.hstack(steps[first : first + 3]) for first in range(0, len(steps), 3)]
    save_jpeg(
        options.out / "pyramid-steps.jpg", np.vstack([row for row in rows if row.shape == rows[0].shape])
    )


def learned_from(run: Path) -> RgbImage:
    """The first map of a recording, and what the learner made of it."""
    recording = open_dataset(Path(read_config(run)["training"]["data"]))
    maps = MovedMaps(read_demonstrations([recording[0]]), Moves(recolor=False), rearranged=1.0)
    rng = np.random.default_rng(0)
    made = [maps.draw(rng, [0])[0].color for _ in range(_MADE)]
    rim = np.full((recording[0].before.color.shape[0], _RIM_PX, 3), 255, np.uint8)
    return np.hstack([recording[0].before.color, rim, *made])


def frames(path: Path) -> list[RgbImage]:
    """Of a film, `(H, W, 3)` RGB each."""
    film = cv2.VideoCapture(str(path))
    found = []
    while (read := film.read())[0]:
        found.append(cv2.cvtColor(read[1], cv2.COLOR_BGR2RGB))
    return [np.asarray(frame, np.uint8) for frame in found]


if __name__ == "__main__":
    main(tyro.cli(Options))
