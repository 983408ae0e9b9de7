"""The moving picture of a pyramid being built, and where the policy pointed at each step, from an evaluation.

python benchmarks/pyramid_media.py --evaluation runs/pyramid/fast-10-0/evaluation
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import tyro
from PIL import Image

from baggie.evaluation.pictures import save_jpeg
from baggie.types import Image as RgbImage

_EVERY = 2
"""Of the film's frames."""
_SIZE = (480, 360)


@dataclass(frozen=True)
class Options:
    """What to show."""

    evaluation: Path = Path("runs/pyramid/fast-10-0/evaluation")
    """Of `baggie evaluate --task block-pyramid --film 1`."""
    episode: int = 0
    out: Path = Path("docs/media")
    """Where the pictures go."""


def main(options: Options) -> None:
    """Make both of one episode."""
    episode = options.evaluation / "episodes" / f"episode-{options.episode:04d}"
    film = [Image.fromarray(frame) for frame in frames(episode.with_suffix(".mp4"))[::_EVERY]]
    small = [frame.resize(_SIZE, Image.Resampling.LANCZOS) for frame in film]
    options.out.mkdir(parents=True, exist_ok=True)
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


def frames(path: Path) -> list[RgbImage]:
    """Of a film, `(H, W, 3)` RGB each."""
    film = cv2.VideoCapture(str(path))
    found = []
    while (read := film.read())[0]:
        found.append(cv2.cvtColor(read[1], cv2.COLOR_BGR2RGB))
    return [np.asarray(frame, np.uint8) for frame in found]


if __name__ == "__main__":
    main(tyro.cli(Options))
