"""Numbers that stand for many: summaries, success rates with their interval, errors in centimetres."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, TypedDict

import numpy as np
from numpy.typing import ArrayLike

from baggie.geometry import PlanarPose, wrap_angle
from baggie.types import Attempt, PickPlace


class Summary(TypedDict):
    """Five numbers for a list of measurements, in the unit of the key they stand under."""

    mean: float
    median: float
    p95: float
    max: float
    n: int


class Rate(TypedDict):
    """A success rate with its 95% interval; all in [0, 1]."""

    rate: float
    low: float
    high: float
    n: int


def summary(values: ArrayLike) -> Summary:
    """Mean, median, 95th percentile (linear interpolation), maximum and count of `(N,)` finite numbers.

    Raises `ValueError` when there are none or one is not finite: the result would read like a measurement.

    >>> summary([1.0, 2.0, 6.0])
    {'mean': 3.0, 'median': 2.0, 'p95': 5.6, 'max': 6.0, 'n': 3}
    """
    array = np.asarray(values, float).reshape(-1)
    if array.size == 0 or not np.isfinite(array).all():
        raise ValueError(f"a summary needs at least one number, all finite; got {array.tolist()[:5]}")
    return {
        "mean": float(array.mean()),
        "median": float(np.median(array)),
        "p95": float(np.percentile(array, 95)),
        "max": float(array.max()),
        "n": int(array.size),
    }


def success_rate(successes: int, n: int) -> Rate:
    """The rate of `successes` among `n` trials with its 95% score interval.

    Wilson's: it holds every p whose score test does not reject the count seen, so unlike p̂ ± z √(p̂ (1 - p̂) / n) it
    stays inside [0, 1], and never has no width.

    >>> success_rate(0, 4)["low"], round(success_rate(0, 4)["high"], 3)
    (0.0, 0.49)
    """
    if n < 1 or not 0 <= successes <= n:
        raise ValueError(f"successes must be between 0 and n, and n at least 1; got {successes} of {n}")
    from scipy.stats import binomtest  # noqa: PLC0415 -- half a second, for what mostly starts without

    interval = binomtest(successes, n).proportion_ci(method="wilson")
    return {"rate": successes / n, "low": float(interval.low), "high": float(interval.high), "n": n}


def position_error_cm(a: PlanarPose, b: PlanarPose) -> float:
    """Centimetres between the positions of two poses; yaw plays no part."""
    return 100 * a.distance(b)


def yaw_error_deg(a: PlanarPose, b: PlanarPose, symmetry: int = 4) -> float:
    """Degrees between the yaws of two poses of an object that looks the same `symmetry` times a turn.

    A symmetry of 0 is that of a round object, which looks the same at any angle: no error.
    """
    if symmetry == 0:
        return 0.0
    return abs(math.degrees(wrap_angle(a.yaw - b.yaw, 2 * math.pi / symmetry)))


def within_stated(what: str, errors_cm: Sequence[float], radii_m: Sequence[float | None]) -> dict[str, Any]:
    """How true plans are to the radii they state, of picks or places (`what`); empty where none states one.

    `WHAT_within` is the share of errors inside their own radius, nine of ten by `Plan`'s definition, and
    `WHAT_radius_cm` a summary of the radii.
    """
    pairs = zip(errors_cm, radii_m, strict=True)
    stated = [(error, 100 * radius) for error, radius in pairs if radius is not None]
    if not stated:
        return {}
    inside = sum(error <= radius for error, radius in stated)
    return {
        f"{what}_within": success_rate(inside, len(stated)),
        f"{what}_radius_cm": summary([radius for _, radius in stated]),
    }


def symmetry_of(attempt: Attempt) -> int:
    """How often a turn what an attempt moved looks the same; 0 at any angle.

    Where nobody said it: 4 in a camera's picture, where it is a bag; 1, none, in a height map, unless it is found in
    the maps (`carried_steps`).
    """
    if attempt.object_symmetry is not None:
        return attempt.object_symmetry
    return 4 if attempt.before.grid is None else 1


def references(attempt: Attempt) -> dict[str, PickPlace]:
    """What a plan for an attempt is measured against.

    `labels`: the poses the arm was really at. `truth`, where it is known: the object's pose before the
    attempt for the pick, and after it for the place.
    """
    found = {"labels": attempt.outcome.executed}
    if attempt.truth is not None:
        found["truth"] = PickPlace(attempt.truth.before, attempt.truth.after)
    return found


def turn_error_deg(planned: PickPlace, right: PickPlace, symmetry: int = 4) -> float:
    """Degrees by which the object is turned wrongly between pick and place, modulo its symmetry."""
    ours, theirs = (PlanarPose(0.0, 0.0, action.place.yaw - action.pick.yaw) for action in (planned, right))
    return yaw_error_deg(ours, theirs, symmetry)


def action_errors(
    planned: PickPlace, right: PickPlace, symmetry: int = 4, stands: PlanarPose | None = None
) -> dict[str, float]:
    """How far an action is off; units in the keys. `symmetry`: how often a turn what is moved looks the same.

    `stands`: where the middle of the thing is that both pick. Given, a place is off by as much as that comes to lie
    off, wherever either holds it and whichever of the turns that look the same it chooses.
    """
    ends = [action.place if stands is None else action.carry(stands) for action in (planned, right)]
    return {
        "pick_error_cm": position_error_cm(planned.pick, right.pick),
        "place_error_cm": position_error_cm(*ends),
        "pick_yaw_error_deg": yaw_error_deg(planned.pick, right.pick, symmetry),
        "place_yaw_error_deg": yaw_error_deg(planned.place, right.place, symmetry),
        "turn_error_deg": turn_error_deg(planned, right, symmetry),
    }
