"""What a calibration works with: a camera, perhaps an arm, an assistant, an operator, and a folder of views.

An assistant does by hand what the robot cannot do by itself: a person, or in the simulator `simulated_assistant.py`.
The folder keeps pictures and what goes with each, so that the calibration can be made again.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np

from baggie import seeds
from baggie.calibration.files import VIEWS_FILE, CameraIdentity, read_views_file
from baggie.cameras import open_camera, settings_of
from baggie.cameras.camera import Camera
from baggie.errors import BaggieError, CalibrationError, NobodyError
from baggie.files import write_text
from baggie.geometry import FloatArray
from baggie.operator import ENTER, Answer, Hint, Line, Operator, Picture, Question, TerminalOperator, errand
from baggie.options.commissioning import LiveOptions
from baggie.pictures import write_picture
from baggie.types import Image, Observation
from baggie.vision.targets import Target, TargetDetection
from baggie.workcell.config import open_workcell
from baggie.workcell.workcell import Workcell


class Helper(Protocol):
    """What the doctor needs of somebody. Methods return when it is done; `words` say what to do, in a sentence."""

    def hold(self, target: Target | None, words: str) -> None:
        """Fix a target to the hand; None stands for a coloured paddle."""
        ...

    def lay_firm(self, heights_m: tuple[float, float], words: str) -> float | None:
        """Lay a firm thing on the table under the hand, not lower than the first, not higher than the second of these.

        How high it is, metres; None where nobody lays one.
        """
        ...

    def confirm(self, question: str) -> bool | None:
        """Whether it is so; None where nobody can tell."""
        ...

    def clock(self) -> float:
        """Seconds of the arm's own time."""
        ...

    def put_away(self) -> None:
        """Take what was held, shown or laid out of hand and view."""
        ...


class Assistant(Helper, Protocol):
    """What calibrations need of somebody, in the same way."""

    def show(self, target: Target, words: str) -> None:
        """Hold a board in front of the camera, somewhere else than before."""
        ...

    def clear_table(self) -> None:
        """Take everything off the table."""
        ...

    def lay(self, target: Target, words: str) -> None:
        """Lay a target flat on the table."""
        ...

    def lead_to(self, T_base_hand: FloatArray | None, words: str) -> None:
        """Lead the arm by hand: to about this pose `(4, 4)`, or as the words say."""
        ...

    def touch(self, target: Target, point: FloatArray, words: str) -> None:
        """Lead the tip of the probe onto a point `(3,)`, in the world's frame, of the target that lies on the table."""
        ...

    def measure_touch(self, words: str) -> FloatArray | None:
        """How far the tip is from the middle of the target it was sent to: `(2,)` metres, base frame.

        None where nobody can tell.
        """
        ...


class Person:
    """Asks a person, and waits. Ctrl-C stops; what was recorded by then stays."""

    def __init__(self, operator: Operator, *, prepared: bool = False) -> None:
        """`operator` is asked.

        `prepared`: the table is clear already, and what the hand is to hold is in it, so nobody is asked for either.
        """
        self._operator = operator
        self._prepared = prepared
        self._last = ""

    def show(self, target: Target, words: str) -> None:
        """Say what to show next; pictures are taken by themselves, so nobody has to press a key with full hands."""
        if words != self._last:
            self._operator.tell(Hint(words))
            self._last = words

    def clear_table(self) -> None:
        """Ask, and wait, unless all is prepared."""
        if not self._prepared:
            self._ask(errand("take everything off the table"))

    def lay(self, target: Target, words: str) -> None:
        """Ask, and wait."""
        self._ask(errand(words))

    def hold(self, target: Target | None, words: str) -> None:
        """Ask, and wait, unless all is prepared."""
        if not self._prepared:
            self._ask(errand(words))

    def lay_firm(self, heights_m: tuple[float, float], words: str) -> float | None:
        """Ask for its height in millimetres, until there is one that will do, or nothing."""
        lowest, highest = (1000 * height for height in heights_m)
        wanted = f"{lowest:.0f} to {highest:.0f}"

        def height_m(typed: str) -> float | None:
            if not typed:
                return None
            try:
                height = float(typed)
            except ValueError:
                height = np.nan
            if not lowest <= height <= highest:
                raise ValueError(f"expected {wanted}")
            return height / 1000

        words = f"{words}; type its height in mm ({wanted}), or nothing to leave this out"
        return self._ask(Question(words, "", height_m, keys=ENTER))

    def confirm(self, question: str) -> bool | None:
        """Ask for yes or no; anything else is neither."""

        def meant(typed: str) -> bool | None:
            return {"y": True, "yes": True, "n": False, "no": False}.get(typed.lower())

        keys = f" [y/n, nothing where you cannot tell]{ENTER}"
        return self._ask(Question(question, "", meant, ("y", "n"), keys))

    def clock(self) -> float:
        """A real arm's: the wall clock's."""
        return time.monotonic()

    def lead_to(self, T_base_hand: FloatArray | None, words: str) -> None:
        """Ask, and wait."""
        self._ask(errand(words))

    def touch(self, target: Target, point: FloatArray, words: str) -> None:
        """Ask, and wait."""
        self._ask(errand(words))

    def measure_touch(self, words: str) -> FloatArray | None:
        """Ask for two numbers in millimetres."""

        def metres(typed: str) -> FloatArray | None:
            try:
                forward, left = (float(word) / 1000 for word in typed.split())
            except ValueError:
                return None
            return np.array([forward, left])

        words = f"{words}: type how far the tip is off, forward and left, in mm (such as 1 -0.5), or nothing"
        return self._ask(Question(words, "", metres, keys=ENTER))

    def put_away(self) -> None:
        """Say so; whatever comes next waits."""
        self._operator.tell(Hint("what was laid or held can be taken away"))

    def _ask(self, question: Question[Answer]) -> Answer:
        try:
            return self._operator.ask(question)
        except NobodyError:
            raise KeyboardInterrupt("nobody is at the terminal; the same command again goes on") from None


@dataclass
class Session:
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

    def show(self, folder: Path, picture: Image, seen: TargetDetection | None, words: str) -> None:
        """Show what the camera sees now, what was found in it, and what to do next.

        A file of it, FOLDER.live.jpg, is not in the folder, whose pictures are to be measured in.
        """
        path = folder.with_name(folder.name + ".live.jpg")
        self.operator.tell(Picture(drawn_upon(picture, seen, words), path))


@contextmanager
def open_session(
    options: LiveOptions, operator: Operator | None = None, *, prepared: bool = False
) -> Iterator[Session]:
    """Open what the options name, and close it after. Raises `BaggieError`, `CameraError`.

    A person helps at a real workcell, who finds it `prepared` or not: the one at the terminal unless `operator` is
    given.
    """
    operator = operator or TerminalOperator()
    person = Person(operator, prepared=prepared)
    if options.camera is not None:
        camera = open_camera(settings_of(options.camera))
        try:
            yield Session(camera, None, person, operator)
        finally:
            camera.close()
        return
    cell = open_workcell(options.workcell, options.cell)
    try:
        yield Session(cell.camera, cell, _assistant(cell, options.seed, person), operator)
    finally:
        cell.close()


def _assistant(cell: Workcell, seed: int, person: Assistant) -> Assistant:
    from baggie.commissioning.simulated_assistant import SimulatedAssistant  # noqa: PLC0415
    from baggie.workcell.simulated import SimulatedWorkcell  # noqa: PLC0415

    if not isinstance(cell, SimulatedWorkcell):
        return person
    cell.reset((seeds.CALIBRATION, seed))
    return SimulatedAssistant(cell, seed)


def drawn_upon(picture: Image, seen: TargetDetection | None, words: str) -> Image:
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
