"""What every policy is and promises; those there are, by name, and how a saved one is loaded."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from baggie.errors import BaggieError, DataError
from baggie.policies import checkpoint
from baggie.registry import Registry
from baggie.types import Goal, Observation, PickPlace, Plan

_HERE = "baggie.policies"
CLASSES = {
    "ColorMaskPolicy": "baselines",
    "KeypointPolicy": "keypoint.policy",
    "LearnedPolicy": "learned",
    "OraclePolicy": "baselines",
    "RegressionPolicy": "regression",
    "TransporterPolicy": "transporter.policy",
}
"""Each is imported when it is first needed: an exported policy must run where there is no PyTorch."""


class Policy(ABC):
    """Maps a picture and a goal in it to a plan in robot coordinates. Never sees a robot.

    policy = Policy.from_pretrained("runs/keypoint")
    plan = policy.plan(observation, goal)
    """

    name: str
    wants_goal: bool = False
    """Whether it takes an object to a goal in the picture; else it knows by itself where things go."""

    @abstractmethod
    def plan(self, observation: Observation, goal: Goal | None = None) -> Plan:
        """Where to pick and where to place. Without a goal: what comes next in the task the policy has learned.

        Raises `BaggieError` when it cannot tell: no bag in sight, the goal outside the picture or missing.
        """

    @classmethod
    def from_pretrained(cls, source: str | Path, device: str = "cpu") -> Policy:
        """The policy saved in the folder of a training run, or under a Hub id `owner/name`, of whatever kind it is.

        `device` is PyTorch's name for where to compute. Raises `DataError` when there is none, or one of its files is
        missing or damaged.
        """
        return load_policy(source, device)


POLICIES: Registry[type[Policy]] = Registry(
    "baggie.policies",
    {
        "keypoint": f"{_HERE}.keypoint.policy:KeypointPolicy",
        "regression": f"{_HERE}.regression:RegressionPolicy",
        "transporter": f"{_HERE}.transporter.policy:TransporterPolicy",
        "color-mask": f"{_HERE}.baselines:ColorMaskPolicy",
    },
    "policy",
)
"""Those that can be saved and loaded, by the name that stands in their folder's `config.yaml`."""


def load_policy(source: str | Path, device: str = "cpu") -> Policy:
    """The policy saved in a folder, or under a Hub id `owner/name`: a training run's, or what `baggie export` made.

    Raises `DataError` when there is none, one of its files is missing or damaged, or what would run it is not
    installed.
    """
    folder = checkpoint.fetch(source)
    name = checkpoint.read_config(folder)["policy"]
    if name not in POLICIES:
        raise DataError(f"{folder} holds a policy {name!r}; known are {', '.join(POLICIES.names())}")
    if checkpoint.is_exported(folder):
        exported: Policy = _module("exported").load_exported(folder, device)
        return exported
    try:
        kind = POLICIES[name]
    except ModuleNotFoundError as error:
        if error.name != "torch":
            raise
        raise DataError(
            f"{folder} needs PyTorch, which is not installed here: export it where it is, with `baggie export`"
        ) from None
    return kind.from_pretrained(folder, device)


def class_named(name: str) -> type[Policy]:
    """The policy of that class name, imported. Raises `KeyError` for one that is unknown."""
    found: type[Policy] = getattr(_module(CLASSES[name]), name)
    return found


def _module(name: str) -> Any:
    return import_module(f"{_HERE}.{name}")


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
