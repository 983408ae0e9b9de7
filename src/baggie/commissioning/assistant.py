"""Who does by hand what the robot cannot do by itself: a person.

In the simulator, `simulated_assistant.py` does the same things in the world.
"""

from __future__ import annotations

import time
from typing import Protocol

import numpy as np

from baggie.errors import NobodyError
from baggie.geometry import FloatArray
from baggie.operator import ENTER, Answer, Hint, Operator, Question, errand
from baggie.vision.targets import Target


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
