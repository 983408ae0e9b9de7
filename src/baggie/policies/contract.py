"""What every policy promises, as a function: call it with a policy of your own and a picture it was made for."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from baggie.errors import BaggieError
from baggie.policies.base import Policy
from baggie.types import Goal, Observation, PickPlace


def check_policy(
    policy: Policy, observation: Observation, goal: Goal | None = None, *, looks_at_goal: bool | None = None
) -> None:
    """Raise `AssertionError` where a policy breaks its contract.

    `observation`, and `goal` where the policy is given one: some that it can plan from. `looks_at_goal`: whether the
    goal decides the plan; where there is one unless given.
    """
    looks_at_goal = goal is not None if looks_at_goal is None else looks_at_goal
    assert isinstance(policy, Policy), f"expected a subclass of Policy, got {type(policy).__name__}"
    assert policy.name, "a policy has a name"
    assert policy.name == policy.name.lower(), f"names are in lower case, got {policy.name}"
    picture, corners = observation.color.copy(), np.zeros(0) if goal is None else goal.corners.copy()
    plan = policy.plan(observation, goal)
    assert np.array_equal(observation.color, picture), "a policy must not draw into the picture it is given"
    assert goal is None or np.array_equal(goal.corners, corners), (
        "a policy must not move the goal it is given"
    )

    assert isinstance(plan.action, PickPlace)
    values = plan.action.to_array()
    assert np.isfinite(values).all(), f"a plan's numbers are finite, got {values}"
    assert (np.abs(values[[2, 5]]) <= np.pi).all(), f"yaws are from -pi to pi, got {values[[2, 5]]}"
    assert 0 <= plan.confidence <= 1, f"confidence is a share, got {plan.confidence}"
    for name, view in plan.views.items():
        assert name, "a view has a name"
        assert view.ndim == 2, f"the view {name} is (H, W), got {view.shape}"
        assert view.dtype == np.float32, f"the view {name} is float32, got {view.dtype}"
        assert view.min() >= 0, f"the view {name} is from 0 to 1, got {view.min()}"
        assert view.max() <= 1 + 1e-6, f"the view {name} is from 0 to 1, got {view.max()}"

    again = policy.plan(observation, goal).action.to_array()
    assert np.array_equal(again, values), "the same picture must give the same plan"
    for form in (
        observation.color.tolist(),
        np.dstack([observation.color, np.full(observation.color.shape[:2], 9)]),
    ):
        listed: Any = goal if goal is None else replace(goal, corners=goal.corners.tolist())
        taken = policy.plan(replace(observation, color=form), listed).action.to_array()
        assert np.array_equal(taken, values), "pictures and corners are taken as they come"
    if goal is not None and looks_at_goal:
        _check_goals(policy, observation, goal)


def _check_goals(policy: Policy, observation: Observation, goal: Goal) -> None:
    """Raise `AssertionError` where a policy takes goals otherwise than all do."""
    values = policy.plan(observation, goal).action.to_array()
    zigzag = goal.corners[[0, 1, 3, 2]] if len(goal.corners) == 4 else goal.corners
    same = policy.plan(observation, replace(goal, corners=zigzag)).action.to_array()
    assert np.allclose(same, values, rtol=0, atol=1e-6), "corners in a zigzag are those of the same goal"
    for no_observation, no_goal in ((observation.color, goal), (observation, goal.corners.tolist())):
        line = _refusal(policy, no_observation, no_goal)
        asked = ("expected an observation, got", "expected a goal, got")
        assert any(words in line for words in asked), f"it says what was expected and what came, got {line!r}"
    width, height = observation.size
    for offset in ([2.0 * width, 0], [0, 2.0 * height], [-2.0 * width, 0]):
        _refusal(policy, observation, replace(goal, corners=goal.corners + offset))


def _refusal(policy: Policy, observation: Any, goal: Any) -> str:
    """The line with which a policy refuses to plan. Raises `AssertionError` where it plans, or says more."""
    line = ""
    try:
        policy.plan(observation, goal)
    except BaggieError as error:
        line = str(error)
    assert "\n" not in line, f"an error is one line, got {line}"
    if line:
        return line
    raise AssertionError(
        f"expected a BaggieError, as no plan follows from {type(observation).__name__} and {goal}"
    )
