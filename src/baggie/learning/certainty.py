"""How sure a policy may be, in metres: measured on attempts it did not learn from."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch

from baggie.data.annotation import goal_of
from baggie.errors import BaggieError
from baggie.geometry import FloatArray
from baggie.learning.labels import SYSTEMATIC_M, Disagreement
from baggie.policies.keypoint import KeypointPolicy
from baggie.types import Attempt

COVERAGE = 0.9
"""How often the truth is to be within the radius."""
SEEN_M = 0.001
"""How far the middle of what is seen of a soft object is from its own, another way in every picture.

A dent on one side moves the outline's middle, for the collector's eye and for the network alike."""
_FEWEST = 10
"""Attempts without which nothing is said: a 90% radius needs at least nine."""


def calibrate(
    policy: KeypointPolicy, attempts: Sequence[Attempt], disagreement: Disagreement, opinions: int
) -> list[float] | None:
    """Set how many times the heat maps' spread the stated radii are, of pick and place, from held-out attempts.

    `opinions`: how many kinds of label there were to learn from, 1 or 2.

    Split conformal prediction: with errors over spreads e₁..eₙ of held-out attempts, the ⌈0.9 (n + 1)⌉-th smallest
    holds that of a new one at least nine times of ten, whatever their distribution. Source: H. Papadopoulos et al.,
    "Inductive confidence machines for regression", ECML 2002. None, and plans without radii, when there are fewer than
    ten.

    Picks are compared with labels half-way between the two opinions there are, as those it learned from. What both have
    wrong alike no held-out label shows, and how far they are apart says nothing of it: of two independent errors the
    mean does not depend on the difference. Each kind of label may be off by `SYSTEMATIC_M`, so their mean by that over
    √2, and what is seen by `SEEN_M`; √(ln 10) times both in quadrature holds 90% of a round normal distribution, and is
    added in quadrature.
    """
    radius = policy.network.radius
    radius.floor_m.zero_()
    radius.times_spread.fill_(1.0)
    ratios = [ratio for attempt in attempts if (ratio := _ratios(policy, attempt, disagreement)) is not None]
    if len(ratios) < _FEWEST:
        radius.times_spread.zero_()
        return None
    rank = min(math.ceil(COVERAGE * (len(ratios) + 1)), len(ratios))
    found = np.sort(np.array(ratios), axis=0)[rank - 1]
    radius.times_spread.copy_(torch.from_numpy(found))
    hidden = math.hypot(SYSTEMATIC_M / math.sqrt(opinions), SEEN_M)
    radius.floor_m[0] = math.sqrt(-math.log(1 - COVERAGE)) * hidden
    return [float(value) for value in found]


def _ratios(policy: KeypointPolicy, attempt: Attempt, disagreement: Disagreement) -> FloatArray | None:
    """`(2,)`: errors of pick and place against their labels over the heat maps' spread; None without a plan."""
    try:
        plan = policy.plan(attempt.before, goal_of(attempt))
    except BaggieError:
        return None
    executed, planned = attempt.outcome.executed, plan.action
    pick = executed.pick.xy + disagreement.at(executed.pick.xy[None])[0] / 2
    errors = [float(np.linalg.norm(planned.pick.xy - pick)), planned.place.distance(executed.place)]
    assert plan.pick_within_m is not None
    assert plan.place_within_m is not None
    return np.array(errors) / [plan.pick_within_m, plan.place_within_m]
