"""What many episodes say together: rates, summaries, and what went wrong how often."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

from baggie.evaluation.log import Credit, Episode, Landing
from baggie.metrics import success_rate, summary, within_stated

RADII_CM = (1.0, 2.0, 3.0)


def measure(episodes: Sequence[Episode], radius_cm: float) -> dict[str, Any]:
    """`success`, strictly or within `radius_cm`; steps and times; failures by cause; and what the task gives besides.

    Of objects with a goal in the picture: `success_within` 1, 2, 3 cm, where they ended, and how good plans were. Of
    tasks that say themselves where things go: `ravens_success` and `partial_credit`. `asked_for_help` is the share of
    episodes in which the plan was less sure than the workcell asks for.
    """
    count, steps = len(episodes), [step for episode in episodes for step in episode.steps]
    failed = [episode for episode in episodes if not episode.succeeded(radius_cm)]
    landings = [episode.landing for episode in episodes if episode.landing is not None]
    credits = [episode.credit for episode in episodes if episode.credit is not None]
    return {
        "success": success_rate(count - len(failed), count),
        **(_of_landings(landings, radius_cm) | _of_plans(episodes) if landings else {}),
        **(_of_credits(credits) if credits else {}),
        "steps": summary([len(episode.steps) for episode in episodes]),
        **({"looks": summary([len(episode.steps) for episode in episodes])} if landings else {}),
        **({"decision_ms": summary([step.decision_ms for step in steps])} if steps else {}),
        "asked_for_help": success_rate(sum(episode.failure == "unsure" for episode in episodes), count),
        "failures": _counted(episode.failure or "off-goal" for episode in failed),
        "failed_steps": _counted(step.failure for step in steps),
    }


def _of_landings(landings: Sequence[Landing], radius_cm: float) -> dict[str, Any]:
    distances = [landing.distance_cm for landing in landings]
    within = {
        f"{radius:g}_cm": success_rate(sum(distance <= radius for distance in distances), len(distances))
        for radius in RADII_CM
    }
    return {
        "radius_cm": radius_cm,
        "success_within": within,
        "distance_cm": summary(distances),
        "yaw_error_deg": summary([landing.yaw_error_deg for landing in landings]),
    }


def _of_credits(credits: Sequence[Credit]) -> dict[str, Any]:
    return {
        "ravens_success": success_rate(sum(credit.ravens_success for credit in credits), len(credits)),
        "partial_credit": summary([credit.partial_credit for credit in credits]),
    }


def _of_plans(episodes: Sequence[Episode]) -> dict[str, Any]:
    """Summaries of the last plans' errors, and `confidence`, how true plans are to the radii they state."""
    last = [(episode, episode.steps[-1]) for episode in episodes if episode.steps]
    picks = [(s.pick_error_cm, s.pick_within_m) for _, s in last if s.pick_error_cm is not None]
    if not picks:
        return {}
    # A plan states of its place where the object will end, so only what was carried there says how true that is.
    ended = [
        (e.landing.distance_cm, s.place_within_m)
        for e, s in last
        if e.landing is not None and s.executed is not None and not e.failure
    ]
    confidence: dict[str, Any] = {}
    for what, stated in (("pick", picks), ("place", ended)):
        if stated:
            errors, radii = zip(*stated, strict=True)
            confidence |= within_stated(what, errors, radii)
    return {
        "pick_error_cm": summary([error for error, _ in picks]),
        "place_error_cm": summary([s.place_error_cm for _, s in last if s.place_error_cm is not None]),
        "pick_yaw_error_deg": summary(
            [s.pick_yaw_error_deg for _, s in last if s.pick_yaw_error_deg is not None]
        ),
        **({"confidence": confidence} if confidence else {}),
    }


def _counted(causes: Iterable[str]) -> dict[str, int]:
    """How often each came, the most frequent first; no cause is no failure."""
    return dict(Counter(cause for cause in causes if cause).most_common())
