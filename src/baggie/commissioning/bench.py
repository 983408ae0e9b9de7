"""What a calibration works with: a camera, an arm perhaps, somebody to help, and a screen to tell them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import tyro
from rich.console import Console

from baggie import seeds
from baggie.calibration.files import CameraIdentity
from baggie.commissioning.assistant import Assistant, PersonAtTerminal
from baggie.errors import BaggieError
from baggie.files import write_if_possible
from baggie.ranges import Options, Seed
from baggie.types import Image, Observation
from baggie.vision.picture_files import write_picture
from baggie.vision.targets import Seen
from baggie.workcell.camera import Camera
from baggie.workcell.cameras.opening import open_camera
from baggie.workcell.cameras.settings import CameraSettings
from baggie.workcell.workcell import Workcell


@dataclass(frozen=True)
class LiveOptions(Options):
    """Which camera and arm, when a calibration is made live."""

    workcell: str = "sim"
    """A workcell file, or `sim`: the simulated one, where everything a person would do happens by itself."""
    cell: Seed = 0
    """Number of the simulated workcell."""
    camera: str | None = None
    """A camera without an arm: its number, device or address as OpenCV opens it, or a video file; or `realsense`,
    `orbbec`, `k4a`, each with `:SERIAL` where several are plugged in."""
    seed: Seed = 0
    """Of what is random: where a simulated person holds the board, which points are visited."""


From = Annotated[Path | None, tyro.conf.arg(name="from")]
"""The option `--from`, a word that Python keeps for itself."""


@dataclass
class Bench:
    """An open camera, and the workcell it belongs to if it does."""

    camera: Camera
    cell: Workcell | None
    assistant: Assistant
    console: Console

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
        """A line for the person at the terminal."""
        self.console.print(words, highlight=False)


@contextmanager
def open_bench(options: LiveOptions, person: Assistant | None = None) -> Iterator[Bench]:
    """Open what the options name, and close it after. Raises `BaggieError`, `CameraError`.

    `person` helps at a real workcell: one at the terminal unless given.
    """
    person = person or PersonAtTerminal()
    console = Console(stderr=True)
    if options.camera is not None:
        camera = open_camera(CameraSettings.from_words(options.camera))
        try:
            yield Bench(camera, None, person, console)
        finally:
            camera.close()
        return
    from baggie.workcell.config import open_workcell  # noqa: PLC0415 -- the simulator takes its time to import

    cell = open_workcell(options.workcell, options.cell)
    try:
        yield Bench(cell.camera, cell, _assistant(cell, options.seed, person), console)
    finally:
        cell.close()


def _assistant(cell: Workcell, seed: int, person: Assistant) -> Assistant:
    from baggie.commissioning.simulated_assistant import SimulatedAssistant  # noqa: PLC0415
    from baggie.workcell.simulated import SimulatedWorkcell  # noqa: PLC0415

    if not isinstance(cell, SimulatedWorkcell):
        return person
    cell.reset((seeds.CALIBRATION, seed))
    return SimulatedAssistant(cell, seed)


def show_live(folder: Path, picture: Image, seen: Seen | None, words: str) -> None:
    """Write FOLDER.live.jpg: what the camera sees now, what was found in it, and what to do next.

    Not into the folder, whose pictures are to be measured in. Any picture viewer that reloads shows it live.
    """
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
    write_if_possible(folder.with_name(folder.name + ".live.jpg"), lambda path: write_picture(path, canvas))
