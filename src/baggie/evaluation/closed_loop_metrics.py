"""What many episodes say together."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

from baggie.evaluation.episode import Episode
from baggie.evaluation.metrics import Rate, success_rate, summary, within_stated

RADII_CM = (1.0, 2.0, 3.0)


def measure(episodes: Sequence[Episode], radius_cm: float) -> dict[str, Any]:
    """`success` within `radius_cm`, `success_within` 1, 2, 3 cm, summaries of errors and times, failures.

    The cause of a failure is what the cell or the policy gave, else `off-goal`; `asked_for_help` is the share of
    episodes in which the plan was less sure than the workcell asks for. Errors of picks and places, and `confidence`,
    how true plans are to the radii they state, are of the last plan of each episode that had one.
    """
    distances = [episode.distance_cm for episode in episodes]

    def within(radius: float) -> Rate:
        return success_rate(sum(distance <= radius for distance in distances), len(distances))

    failed = [episode for episode in episodes if episode.distance_cm > radius_cm]
    causes = Counter(episode.failure or "off-goal" for episode in failed)
    decisions = [ms for episode in episodes for ms in episode.decision_ms]
    return {
        "success": within(radius_cm),
        "radius_cm": radius_cm,
        "success_within": {f"{radius:g}_cm": within(radius) for radius in RADII_CM},
        "distance_cm": summary(distances),
        "yaw_error_deg": summary([episode.yaw_error_deg for episode in episodes]),
        **_of_plans(episodes),
        **({"decision_ms": summary(decisions)} if decisions else {}),
        "looks": summary([episode.looks for episode in episodes]),
        "asked_for_help": success_rate(sum(e.failure == "unsure" for e in episodes), len(episodes)),
        "failures": dict(causes.most_common()),
    }


def _of_plans(episodes: Sequence[Episode]) -> dict[str, Any]:
    """Summaries of the plans' errors, and `confidence` where plans state radii; empty without a plan."""
    picks = [(e.pick_error_cm, e.pick_within_m) for e in episodes if e.pick_error_cm is not None]
    places = [e.place_error_cm for e in episodes if e.place_error_cm is not None]
    # A plan states of its place where the object will end, so only what was carried there says how true that is.
    ended = [(e.distance_cm, e.place_within_m) for e in episodes if e.executed is not None and not e.failure]
    turned = [e.pick_yaw_error_deg for e in episodes if e.pick_yaw_error_deg is not None]
    if not picks:
        return {}
    confidence: dict[str, Any] = {}
    for what, stated in (("pick", picks), ("place", ended)):
        if not stated:
            continue
        errors, radii = zip(*stated, strict=True)
        confidence |= within_stated(what, errors, radii)
    return {
        "pick_error_cm": summary([error for error, _ in picks]),
        "place_error_cm": summary(places),
        "pick_yaw_error_deg": summary(turned),
        **({"confidence": confidence} if confidence else {}),
    }
