"""What every policy promises, as a function: call it with any policy and a picture it was made for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from baggie.errors import BaggieError
from baggie.policies.base import Policy
from baggie.types import Goal, Observation, PickPlace


def check_policy(policy: Policy, observation: Observation, goal: Goal, *, looks_at_goal: bool = True) -> None:
    """Fails with an assertion where `policy` breaks its contract."""
    assert isinstance(policy, Policy)
    assert policy.name
    assert policy.name == policy.name.lower()

    picture, corners = observation.color.copy(), goal.corners.copy()
    plan = policy.plan(observation, goal)
    assert np.array_equal(observation.color, picture), "a policy must not draw into the picture it is given"
    assert np.array_equal(goal.corners, corners)

    assert isinstance(plan.action, PickPlace)
    values = plan.action.to_array()
    assert np.isfinite(values).all()
    assert (np.abs(values[[2, 5]]) <= np.pi).all()
    assert 0 <= plan.confidence <= 1
    for name, view in plan.views.items():
        assert name
        assert view.ndim == 2
        assert view.dtype == np.float32
        assert view.min() >= 0
        assert view.max() <= 1 + 1e-6

    again = policy.plan(observation, goal)
    assert np.array_equal(again.action.to_array(), values), "the same picture must give the same plan"

    for form in (
        observation.color.tolist(),
        np.dstack([observation.color, np.full(observation.color.shape[:2], 9)]),
    ):
        taken = policy.plan(replace(observation, color=form), replace(goal, corners=goal.corners.tolist()))
        assert np.array_equal(taken.action.to_array(), values), "pictures and corners are taken as they come"

    if looks_at_goal:
        zigzag = goal.corners[[0, 1, 3, 2]] if len(goal.corners) == 4 else goal.corners
        same = policy.plan(observation, replace(goal, corners=zigzag)).action.to_array()
        np.testing.assert_allclose(
            same, values, atol=1e-6, err_msg="corners in a zigzag are those of the same goal"
        )
        for not_an_observation, not_a_goal in (
            (observation.color, goal),
            (observation, goal.corners.tolist()),
        ):
            with pytest.raises(BaggieError, match=r"expected (an observation|a goal), got") as error:
                policy.plan(not_an_observation, not_a_goal)  # type: ignore[arg-type]
            assert "\n" not in str(error.value)

    if looks_at_goal:
        width, height = observation.size
        for offset in ([2.0 * width, 0], [0, 2.0 * height], [-2.0 * width, 0]):
            with pytest.raises(BaggieError) as error:
                policy.plan(observation, replace(goal, corners=goal.corners + offset))
            assert "\n" not in str(error.value)
