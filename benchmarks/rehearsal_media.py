"""The pictures of the guide to the first night, from a rehearsal in the virtual lab.

python benchmarks/rehearsal_media.py --run runs/rehearsal
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro
from PIL import Image

from baggie.data import contact_sheet

_WIDTH = 640
_COLUMNS = 3


@dataclass(frozen=True)
class Options:
    """What to show."""

    run: Path = Path("runs/rehearsal")
    """Of benchmarks/rehearsal.py."""
    out: Path = Path("docs/media")
    """Where the pictures go."""


def main(options: Options) -> None:
    """Make them."""
    run, out = options.run, options.out
    out.mkdir(parents=True, exist_ok=True)
    sheet = contact_sheet(run / "recording", run / "recording" / "contact-sheet.png", _COLUMNS)
    episode = run / "evaluation" / "episodes" / "episode-0000"
    save([run / "recording" / "calibration" / "reference.png"], out / "night-view.jpg")
    save([run / "image-to-robot.live.jpg"], out / "night-marker.jpg")
    save([run / "image-to-robot.png"], out / "night-map.jpg")
    save([sheet], out / "night-attempts.jpg")
    save([Path(f"{episode}-{what}.jpg") for what in ("before", "heat", "after")], out / "night-plan.jpg")


def save(parts: list[Path], out: Path) -> None:
    """Pictures of equal height side by side, not wider than a page."""
    pictures = [Image.open(path).convert("RGB") for path in parts]
    whole = Image.new("RGB", (sum(p.width for p in pictures), max(p.height for p in pictures)))
    left = 0
    for picture in pictures:
        whole.paste(picture, (left, 0))
        left += picture.width
    whole.thumbnail((_WIDTH * min(len(parts), 2), whole.height))
    whole.save(out, quality=85)


if __name__ == "__main__":
    main(tyro.cli(Options))
