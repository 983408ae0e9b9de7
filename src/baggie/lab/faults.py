"""Faults that the lab can be told to have, by name, and its camera's stream, which some of them disturb."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from baggie.errors import UsageError
from baggie.lab.fci import LATE
from baggie.lab.lab import Lab
from baggie.lab.robot import TICK_S

PERIOD_S = 0.2
LONGEST_PERIOD_S = 1.0
SHARE = 1 / 3
"""Of the time, which drawing may take on a slow computer: physics needs a processor, too."""
BUSY = 1.6
"""So many times longer are periods while the arm moves and nobody looks. Less than twice, or a client that knows this
rhythm takes the first frames of a faster one for old ones."""
_NAP_S = 0.02
_QUALITY = [
    cv2.IMWRITE_JPEG_QUALITY,
    97,
    cv2.IMWRITE_JPEG_SAMPLING_FACTOR,
    cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444,
]
"""Nearly all of the picture, and all of its colour."""


class LabCamera:
    """A stream of JPEGs, for as many clients as there are."""

    def __init__(self, lab: Lab) -> None:
        self._lab = lab
        self._last = b""
        self.heal()

    def freeze(self, seconds: float) -> None:
        """Repeat the last frame for so long."""
        self._frozen_until = time.monotonic() + seconds

    def unplug(self, seconds: float) -> None:
        """Be gone for so long."""
        self._gone_until = time.monotonic() + seconds

    def heal(self) -> None:
        """Work again."""
        self._frozen_until = self._gone_until = 0.0

    @property
    def is_there(self) -> bool:
        """Whether it is plugged in."""
        return time.monotonic() >= self._gone_until

    def frames(self) -> Iterator[bytes]:
        """JPEG files, each of the scene when it is asked for; until the lab closes or the camera is unplugged."""
        while not self._lab.closing and self.is_there:
            began = time.monotonic()
            frame = self._frame()
            period = min(max((time.monotonic() - began) / SHARE, PERIOD_S), LONGEST_PERIOD_S)
            yield frame
            while time.monotonic() - began < (BUSY * period if self._lab.busy else period):
                time.sleep(_NAP_S)

    def _frame(self) -> bytes:
        if not self._last or time.monotonic() >= self._frozen_until:
            picture = self._lab.render_process.render(self._lab.call(self._lab.render_state))
            self._last = cv2.imencode(".jpg", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), _QUALITY)[1].tobytes()
        return self._last


DEFAULT_S = 3.0
LONGEST_S = 86400.0
"""A day: what is to last longer is meant to last for ever, or is a slip."""
CAMERA_SHIFT_M = np.array([0.01, 0.0, 0.0])
CAMERA_TURN_RAD = np.array([-0.01, 0.0, 0.0])
"""10 mm and half a degree, what an elbow does to a tripod: 15 pixels of 1280 on the table."""


@dataclass(frozen=True)
class Fault:
    """Something that goes wrong."""

    what: str
    """In one line, for people."""
    happen: Callable[[Lab, LabCamera, float], None]
    """Called between two ticks, with seconds that it is to last, where it lasts."""


FAULTS = {
    "refuse": Fault("the robot refuses the next motion", lambda lab, _camera, _s: lab.fci.refuse()),
    "reflex": Fault(
        "the motion under way, or the next, ends as if the arm had run into something",
        lambda lab, _camera, _s: lab.fci.abort("cartesian_reflex"),
    ),
    "joint-reflex": Fault(
        "the same, felt in a joint", lambda lab, _camera, _s: lab.fci.abort("joint_reflex")
    ),
    "late-packet": Fault(
        "the motion under way, or the next, ends because a packet came too late",
        lambda lab, _camera, _s: lab.fci.abort(LATE),
    ),
    "stuck": Fault(
        "the robot does not recover from errors any more", lambda lab, _camera, _s: lab.fci.get_stuck()
    ),
    "drop-packets": Fault(
        "the motion under way, or the next, goes unheard for these seconds of the robot's time",
        lambda lab, _camera, seconds: lab.fci.lose_packets(round(seconds / TICK_S)),
    ),
    "cut-link": Fault(
        "the robot's cable is out for these seconds", lambda lab, _camera, seconds: lab.fci.cut(seconds)
    ),
    "slip": Fault("the hand loses what it holds", lambda lab, _camera, _s: lab.robot.hand.slip()),
    "freeze-camera": Fault(
        "the camera repeats one picture for these seconds",
        lambda _lab, camera, seconds: camera.freeze(seconds),
    ),
    "unplug-camera": Fault(
        "the camera's cable is out for these seconds", lambda _lab, camera, seconds: camera.unplug(seconds)
    ),
    "bump-camera": Fault(
        "somebody runs into the camera, which stays where it is then",
        lambda lab, _camera, _s: lab.world.bump_camera(CAMERA_SHIFT_M, CAMERA_TURN_RAD),
    ),
    "heal": Fault(
        "nothing of this any more, but what is bumped stays so", lambda lab, camera, _s: _heal(lab, camera)
    ),
}


def cause(name: str, lab: Lab, camera: LabCamera, after_s: float = 0.0, seconds: float = DEFAULT_S) -> None:
    """Let something of `FAULTS` go wrong when `after_s` have passed in the lab, for `seconds` where it lasts.

    Raises `UsageError` as `check_fault` does.
    """
    check_fault(name, after_s, seconds)
    lab.later(after_s, lambda: FAULTS[name].happen(lab, camera, seconds))


def check_fault(name: str, after_s: float = 0.0, seconds: float = DEFAULT_S) -> None:
    """Raise `UsageError` for a fault that is not there, and for times that are none."""
    if name not in FAULTS:
        raise UsageError(f"expected a fault among {', '.join(FAULTS)}, got {name!r}")
    if not (0 <= after_s <= LONGEST_S and 0 <= seconds <= LONGEST_S):
        raise UsageError(
            f"expected times of a fault from 0 to {LONGEST_S:g} s, got after {after_s:g} s for {seconds:g} s"
        )


def _heal(lab: Lab, camera: LabCamera) -> None:
    lab.fci.heal()
    camera.heal()
