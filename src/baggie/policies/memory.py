"""What became of a policy's plans in one episode: a miss is not tried again, and what came to lie askew is put right.

A policy plans from one map alone, so that it would repeat for ever what changes nothing. Whoever begins an episode
makes one of these and asks it instead.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from baggie.geometry import FloatArray, PlanarPose, rotation, wrap_angle
from baggie.types import Goal, Observation, PickPlace, Plan
from baggie.vision.carried import CHANGED_M, Carried, changed_parts, middle_of, place_of

_BESIDE_PX = 25.0
"""What a carry may touch: so far from its way. What changed further away was somebody else."""
_AT_PICK_PX = 3.0
"""A map that is lower nowhere so near to a pick shows that nothing was picked there."""
_ASKEW_RAD = np.deg2rad(10.0)
"""More than a thing turns that is let go squarely, and less than counts as wrong."""
_SEARCH_RAD = np.deg2rad(30.0)
_ALIKE = 0.8
"""Of its footprint, what has to be seen of a thing to put it right: else it lies on its side, or under another."""
_CORRECTIONS = 2
"""In a row; what still lies askew then does not lie there by mistake."""


@dataclass(frozen=True)
class _Asked:
    """The last plan, and the map it was made for."""

    seen: Observation
    places: FloatArray
    """`(2, 2)`: pick and place, (u, v) pixels."""
    turn: float


class Planner(Protocol):
    """Whatever plans from a picture: a policy, or a memory that asks one."""

    def plan(self, observation: Observation, goal: Goal | None = None) -> Plan:
        """Where to pick and where to place."""
        ...


class Memory:
    """Plans as its policy does, but for what has failed since `begin`. For policies that look at height maps.

    memory = Memory(policy)
    plan = memory.plan(cell.look())
    """

    def __init__(self, policy: Planner, lands_within_px: float = 3.0) -> None:
        """`lands_within_px`: how far from where it was to go a thing may come to lie and count as well placed."""
        self._policy, self._lands_within_px = policy, lands_within_px
        self.begin()

    def begin(self) -> None:
        """Forget everything: a new episode. A map that changed far from the last plan's way begins one by itself."""
        self._asked: _Asked | None = None
        self._tried: list[FloatArray] = []
        self._corrections = 0

    def plan(self, observation: Observation, goal: Goal | None = None) -> Plan:
        """The next plan, in which no pick is repeated that has failed. Raises what the policy's `plan` raises."""
        if observation.grid is None or observation.height is None:
            return self._policy.plan(observation, goal)
        correction = self._learn(observation)
        tried = np.array(self._tried, float).reshape(-1, 2)
        plan = correction or self._policy.plan(replace(observation, tried=tried), goal)
        action = plan.action
        places = observation.grid.to_pixels([action.pick.xy, action.place.xy])
        self._asked = _Asked(observation, places, action.place.yaw - action.pick.yaw)
        return plan

    def _learn(self, observation: Observation) -> Plan | None:
        """Remember what came of the last plan; what puts right what it left askew, if anything has to."""
        asked, self._asked = self._asked, None
        if asked is None:
            return None
        assert observation.height is not None
        assert asked.seen.height is not None
        if observation.grid != asked.seen.grid:
            self.begin()
            return None
        change = observation.height - asked.seen.height
        parts = changed_parts(np.abs(change) > CHANGED_M)
        if parts.any() and _distance_to_way(parts, asked.places) > _BESIDE_PX:
            self.begin()
            return None
        lower = changed_parts(change < -CHANGED_M)
        if not lower.any() or _distance(lower, asked.places[0]) > _AT_PICK_PX:
            self._tried.append(asked.places[0])
            return None
        self._tried.clear()
        return self._correction(observation, asked)

    def _correction(self, observation: Observation, asked: _Asked) -> Plan | None:
        """From where the thing came to lie to where it was to lie."""
        assert observation.height is not None
        assert asked.seen.height is not None
        carried = Carried.between(asked.seen.height, observation.height, asked.places, asked.turn)
        if carried is None or self._corrections >= _CORRECTIONS:
            self._corrections = 0
            return None
        to = place_of(carried.middle, asked.places, asked.turn)
        off_px = carried.stray_px(asked.places, asked.turn)
        askew = _turned(carried.moved(asked.places, asked.turn), to, carried.lies)
        seen = np.count_nonzero(carried.lies) >= _ALIKE * np.count_nonzero(carried.stood)
        if not seen or (off_px <= self._lands_within_px and abs(askew) <= _ASKEW_RAD):
            self._corrections = 0
            return None
        point = Carried(carried.lies, carried.lies).cup_point(observation.height)
        if point is None:
            return None
        self._corrections += 1
        place = to + rotation(-askew) @ (point - middle_of(carried.lies))
        assert observation.grid is not None
        (px, py), (qx, qy) = observation.grid.to_robot([point, place]).tolist()
        return Plan(PickPlace(PlanarPose(px, py), PlanarPose(qx, qy, wrap_angle(-askew))))


def remembering(policy: Planner) -> Memory:
    """A memory for an episode, with what the policy knows of how exactly things land."""
    scale = getattr(policy, "scale", None)
    return Memory(policy) if scale is None else Memory(policy, scale.lands_within_px)


def _distance(mask: NDArray[np.bool_], at: FloatArray) -> float:
    """Pixels from `at` `(2,)` to the nearest of what is in a mask `(H, W)`."""
    v, u = np.nonzero(mask)
    return float(np.hypot(u - at[0], v - at[1]).min())


def _distance_to_way(mask: NDArray[np.bool_], places: FloatArray) -> float:
    """Pixels from the straight way between `places` `(2, 2)` to the furthest of what is in a mask `(H, W)`."""
    v, u = np.nonzero(mask)
    points, along = np.c_[u, v] - places[0], places[1] - places[0]
    share = np.clip(points @ along / max(float(along @ along), 1e-9), 0, 1)
    return float(np.linalg.norm(points - share[:, None] * along, axis=1).max())


def _turned(meant: NDArray[np.bool_], about: FloatArray, lies: NDArray[np.bool_]) -> float:
    """Radians by which a footprint `(H, W)` has to turn about its middle to cover most of another, moved onto it."""
    rows, columns = meant.shape
    best, found = 0.0, 0.0
    to = middle_of(lies)
    for angle in np.linspace(-_SEARCH_RAD, _SEARCH_RAD, 31):
        move = np.c_[rotation(angle), to - rotation(angle) @ about]
        turned = cv2.warpAffine(meant.astype(np.uint8), move, (columns, rows), flags=cv2.INTER_NEAREST) > 0
        covered = np.count_nonzero(turned & lies) / np.count_nonzero(turned | lies)
        # Of angles that cover as much, as of round things, the least.
        if covered > best + 0.01 or (covered > best - 0.01 and abs(angle) < abs(found)):
            best, found = max(best, covered), float(angle)
    return found
