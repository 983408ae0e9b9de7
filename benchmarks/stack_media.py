"""A pyramid of bags being built, and where it was marked in the picture: of one filmed evaluation.

python benchmarks/stack_media.py --evaluation runs/stacks/keypoint-300/pyramid-3-2-1
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro
from PIL import Image

from pyramid_media import frames

_SIZE = (480, 360)
_MOST = 140
"""Frames of the film, of all its length."""


@dataclass(frozen=True)
class Options:
    """What to show."""

    evaluation: Path
    """Of `baggie evaluate --task bag-pyramid`."""
    episode: int = 0
    out: Path = Path("docs/media")
    """Where the pictures go."""


def main(options: Options) -> None:
    """Make both."""
    episode = options.evaluation / "episodes" / f"episode-{options.episode:04d}"
    film = frames(episode.with_suffix(".mp4"))
    small = [
        Image.fromarray(frame).resize(_SIZE, Image.Resampling.LANCZOS)
        for frame in film[:: max(len(film) // _MOST, 1)]
    ]
    small[0].save(
        options.out / "bag-pyramid.webp",
        save_all=True,
        append_images=small[1:],
        duration=100,
        loop=0,
        quality=50,
    )
    marked = Image.open(episode.with_name(f"{episode.name}-before.jpg"))
    marked.save(options.out / "bag-pyramid-marked.jpg", quality=85)


if __name__ == "__main__":
    main(tyro.cli(Options))
