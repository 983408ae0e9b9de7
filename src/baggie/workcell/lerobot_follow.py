"""Joint paths and finger motions as what a LeRobot robot takes: small position targets, at a steady rate.

Such robots follow late and, under their own weight, a little short. So what is sent runs ahead of what is measured; how
far tells when something holds them.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Protocol

import numpy as np

from baggie.errors import ReachError, StuckError
from baggie.geometry import FloatArray
from baggie.sim.kinematics import Kinematics, minimum_jerk
from baggie.workcell.lerobot_link import LeRobotLink
from baggie.workcell.lerobot_settings import LeRobotSettings

ARRIVED_RAD = 0.002
ARRIVE_S = 2.0
CATCH_UP_S = 0.15
"""In about this time what a joint is short of its goal is sent on top."""
FINGERS_PER_S = 60.0
STILL = 0.3
STILL_S = 0.25
"""Fingers that moved by less than `STILL` units in this time stand still."""

Touched = Callable[[FloatArray, FloatArray], bool]
"""Whether joints sent to the first `(J,)` and measured at the second touch something."""


class Clock(Protocol):
    """The module `time`, or a clock that does not wait."""

    def monotonic(self) -> float:
        """Seconds."""
        ...

    def sleep(self, seconds: float, /) -> None:
        """Wait."""
        ...


class Follower:
    """Moves joints and fingers. No step between two targets is larger than `max_step`, `(J,)` radians."""

    def __init__(
        self, link: LeRobotLink, kinematics: Kinematics, settings: LeRobotSettings, clock: Clock
    ) -> None:
        self._link, self._kinematics, self._settings, self._clock = link, kinematics, settings, clock
        self._period_s = 1 / settings.rate_hz
        self._joint_speeds = np.full(
            len(settings.joints), np.deg2rad(settings.joint_speed_deg_s) * settings.speed
        )
        self._max_lag = np.deg2rad(settings.max_lag_deg)
        self._due_s = 0.0
        self._stopped = threading.Event()
        self.max_step = self._joint_speeds * self._period_s

    def follow(self, path: FloatArray, speed_m_s: float, touched: Touched | None = None) -> None:
        """Follow a joint path `(N, J)` from where the joints are, until its end or a touch, and come to rest.

        Raises `ReachError` when a joint stays too far behind, `StuckError` when it was stopped.
        """
        self._stopped.clear()
        times = self._kinematics.shortest_times(path, self._settings.speed * speed_m_s, self._joint_speeds)
        points = minimum_jerk(path, times, self._period_s)
        # What is sent begins at what was sent last: further than measured by what the arm's own weight needs.
        sag = self._target()[:-1] - path[0]
        for q in points[1:]:
            self._send(q + sag)
            measured = self._joints()
            if touched and touched(q, measured):
                self._release(measured + sag)
                return
            self._check_held(q, measured, sag)
        self._arrive(points[-1], sag, touched)

    def move_fingers(self, goal: float, squeeze: float = np.inf) -> None:
        """Move the fingers to `goal`, or until something holds them: then leave their target `squeeze` units inside."""
        self._stopped.clear()
        step, window = FINGERS_PER_S * self._period_s, round(STILL_S / self._period_s) + 1
        lead = max(
            squeeze, 1.5 * FINGERS_PER_S * self._settings.lag_s
        )  # no harder than this while they find out
        seen = [self._link.measured()[-1]]
        for _ in range(round(2 * abs(goal - seen[0]) / step) + 4 * window):
            target, at = self._target(), seen[-1]
            still = len(seen) > window and abs(at - seen[-window]) < STILL
            ahead = np.clip(goal - at, *((-squeeze, squeeze) if still else (-lead, lead)))
            if still and abs(target[-1] - at - ahead) < STILL:
                return
            self._send(target[:-1], target[-1] + np.clip(at + ahead - target[-1], -step, step))
            seen.append(self._link.measured()[-1])

    def stop(self) -> None:
        """Send no more targets, from any thread."""
        self._stopped.set()

    def _joints(self) -> FloatArray:
        return self._link.measured()[:-1]

    def _arrive(self, goal: FloatArray, sag: FloatArray, touched: Touched | None) -> None:
        """Send what the joints are short of `goal` on top, little by little, until they are there or it is no use."""
        share = min(self._period_s / CATCH_UP_S, 1.0)
        measured = before = self._joints()
        for _ in range(round(ARRIVE_S / self._period_s)):
            short = goal - measured
            if max(np.abs(short).max(), np.abs(measured - before).max()) < ARRIVED_RAD:
                return
            more = np.clip(share * short, -self.max_step, self.max_step)
            on_top = np.clip(self._target()[:-1] + more - goal - sag, -self._max_lag, self._max_lag)
            self._send(goal + sag + on_top)
            before, measured = measured, self._joints()
            if touched and touched(goal + on_top, measured):
                self._release(measured + sag)
                return

    def _check_held(self, sent: FloatArray, measured: FloatArray, sag: FloatArray) -> None:
        lag = np.abs(sent - measured)
        if lag.max() <= self._max_lag:
            return
        name = self._settings.joints[int(lag.argmax())].name
        self._release(measured + sag)
        raise ReachError(
            f"{name} was {np.rad2deg(lag.max()):.0f} degrees behind where it was sent, so the arm stopped there: "
            "something is in its way, or it is too slow; lower speed, or raise max_lag_deg"
        )

    def _release(self, goal: FloatArray) -> None:
        """Take the targets back to where the arm is, in steps, so that it presses no more."""
        away = goal - self._target()[:-1]
        steps = int(np.ceil((np.abs(away) / self.max_step).max()))
        for left in range(steps - 1, -1, -1):
            self._send(goal - left / steps * away)

    def _target(self) -> FloatArray:
        """What was sent last, `(J + 1,)`; before anything was, where everything is."""
        return self._link.measured() if self._link.sent is None else self._link.sent

    def _send(self, joints: FloatArray, fingers: float | None = None) -> None:
        """Send joints `(J,)`, the fingers as they were unless given, as soon as the next target is due."""
        self._clock.sleep(max(self._due_s - self._clock.monotonic(), 0.0))
        if self._stopped.is_set():
            raise StuckError("the arm was stopped; nothing moves until it is told to again")
        self._link.send(np.append(joints, self._target()[-1] if fingers is None else fingers))
        self._due_s = max(self._due_s, self._clock.monotonic()) + self._period_s
