"""What a calibration works with: a camera, an arm perhaps, somebody to help, and a way to tell them.

What it is made from is kept in a folder, pictures and what goes with each, so that it can be made again.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from baggie import seeds
from baggie.calibration.files import VIEWS_FILE, CameraIdentity, read_views_file
from baggie.cameras import open_camera, settings_of
from baggie.cameras.camera import Camera
from baggie.commissioning.assistant import Assistant, Person
from baggie.errors import BaggieError, CalibrationError
from baggie.files import write_text
from baggie.operator import Line, Operator, Picture, TerminalOperator
from baggie.options.calibrating import LiveOptions
from baggie.pictures import write_picture
from baggie.types import Image, Observation
from baggie.vision.targets import Seen
from baggie.workcell.workcell import Workcell


@dataclass
class Bench:
    """An open camera, and the workcell it belongs to if it does."""

    camera: Camera
    cell: Workcell | None
    assistant: Assistant
    operator: Operator

    @property
    def identity(self) -> CameraIdentity:
        """Which camera, at what size."""
        return CameraIdentity(self.camera.name, *self.camera.size)

    def workcell(self) -> Workcell:
        """The workcell. Raises `BaggieError` where there is only a camera."""
        if self.cell is None:
            raise BaggieError(
                "this calibration moves an arm: give --workcell a workcell file, not --camera alone"
            )
        return self.cell

    def look(self) -> Observation:
        """A picture with the arm out of the way, if there is one."""
        return self.cell.look() if self.cell is not None else self.camera.look()

    def say(self, words: str) -> None:
        """Tell in a line what came of something."""
        self.operator.tell(Line(words))

    def show(self, folder: Path, picture: Image, seen: Seen | None, words: str) -> None:
        """Show what the camera sees now, what was found in it, and what to do next.

        A file of it, FOLDER.live.jpg, is not in the folder, whose pictures are to be measured in.
        """
        path = folder.with_name(folder.name + ".live.jpg")
        self.operator.tell(Picture(drawn_upon(picture, seen, words), path))


@contextmanager
def open_bench(
    options: LiveOptions, operator: Operator | None = None, *, prepared: bool = False
) -> Iterator[Bench]:
    """Open what the options name, and close it after. Raises `BaggieError`, `CameraError`.

    A person helps at a real workcell, who finds it `prepared` or not: the one at the terminal unless `operator` is
    given.
    """
    operator = operator or TerminalOperator()
    person = Person(operator, prepared=prepared)
    if options.camera is not None:
        camera = open_camera(settings_of(options.camera))
        try:
            yield Bench(camera, None, person, operator)
        finally:
            camera.close()
        return
    from baggie.workcell.config import open_workcell  # noqa: PLC0415 -- the simulator takes its time to import

    cell = open_workcell(options.workcell, options.cell)
    try:
        yield Bench(cell.camera, cell, _assistant(cell, options.seed, person), operator)
    finally:
        cell.close()


def _assistant(cell: Workcell, seed: int, person: Assistant) -> Assistant:
    from baggie.commissioning.simulated_assistant import SimulatedAssistant  # noqa: PLC0415
    from baggie.workcell.simulated import SimulatedWorkcell  # noqa: PLC0415

    if not isinstance(cell, SimulatedWorkcell):
        return person
    cell.reset((seeds.CALIBRATION, seed))
    return SimulatedAssistant(cell, seed)


def drawn_upon(picture: Image, seen: Seen | None, words: str) -> Image:
    """A picture with what was found in it, and words above."""
    canvas = picture.copy()
    radius = max(2, picture.shape[1] // 320)
    for u, v in np.zeros((0, 2)) if seen is None else seen.pixels:
        cv2.circle(canvas, (round(u), round(v)), radius, (255, 64, 160), 1, cv2.LINE_AA)
    height = max(24, picture.shape[0] // 20)
    canvas[:height] //= 4
    scale = height / 40
    cv2.putText(
        canvas,
        words,
        (height // 4, round(0.7 * height)),
        cv2.FONT_HERSHEY_SIMPLEX,
        scale,
        (255, 255, 255),
        1,
        cv2.LINE_AA,
    )
    return canvas


class ViewFolder:
    """Pictures `000.png`, `001.png`, ... and `views.json`, which lists them with what is known of each.

    A view is in `views.json` once its picture is on the disk, so an interruption loses at most the one being taken. A
    folder that was begun under other conditions (`header`) is refused.
    """

    def __init__(self, folder: Path, header: Mapping[str, Any]) -> None:
        """Open the folder, or begin it. Raises `DataError`, `CalibrationError`."""
        self.folder = folder
        self._header = json.loads(json.dumps(dict(header)))
        self.views: list[dict[str, Any]] = []
        path = folder / VIEWS_FILE
        if path.exists():
            self.views = self._resume(path)

    def append(self, view: Mapping[str, Any], picture: Image | None = None) -> None:
        """Keep a view; its picture, if there is one, under the name `view["image"]` gets here."""
        entry = dict(view)
        if picture is not None:
            entry["image"] = f"{len(self.views):03d}.png"
            write_picture(self.folder / entry["image"], picture)
        self.views.append(entry)
        write_text(
            self.folder / VIEWS_FILE, json.dumps({**self._header, "views": self.views}, indent=1) + "\n"
        )

    def __len__(self) -> int:
        return len(self.views)

    def _resume(self, path: Path) -> list[dict[str, Any]]:
        content = read_views_file(self.folder)
        for key, value in self._header.items():
            if content.get(key) != value:
                raise CalibrationError(
                    f"{path} was begun with {key} {content.get(key)!r}, not {value!r}; go on as it was begun, "
                    "or remove the folder to start again"
                )
        return list(content["views"])
