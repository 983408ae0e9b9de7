"""The person beside a virtual lab, through its control channel."""

from __future__ import annotations

from baggie.commissioning.simulated_assistant import ASIDE, BLOCK_M
from baggie.geometry import PlanarPose
from baggie.lab.control import LabControl
from baggie.vision.targets import Target


class LabAssistant:
    """Does in the lab what `Helper` asks for. Raises `BaggieError` where no lab answers."""

    def __init__(self, control: LabControl) -> None:
        self._control = control

    def hold(self, target: Target | None, words: str) -> None:
        """The paddle, whatever it is to be."""
        self._control.show_paddle(True)

    def lay_firm(self, heights_m: tuple[float, float], words: str) -> float | None:
        """The block, under the hand, and the bag out of its way."""
        tool = self._control.truth()["tool"]
        self._control.lay_bag(ASIDE)
        self._control.lay_block(PlanarPose(tool["x"], tool["y"]), BLOCK_M)
        return BLOCK_M

    def confirm(self, question: str) -> bool | None:
        """Nobody looks."""
        return None

    def clock(self) -> float:
        """The lab's, which is not the wall clock's on a busy computer."""
        return float(self._control.truth()["time"])

    def put_away(self) -> None:
        """Out of hand and off the table; the bag stays aside."""
        self._control.show_paddle(False)
        self._control.take_block_away()
