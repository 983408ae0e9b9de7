"""Every registered policy is made, saved, loaded and exported; it keeps its contract, and plans the same throughout."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from baggie.data.summary import goal_of
from baggie.errors import BaggieError
from baggie.learning import train
from baggie.options.evaluating import ExportOptions
from baggie.options.training import TRAININGS
from baggie.policies import ColorMaskPolicy, KeypointPolicy, Policy, load_policy
from baggie.policies.base import POLICIES, check_policy
from baggie.policies.export import export
from baggie.policies.learned import LearnedPolicy
from baggie.types import Attempt
from helpers.box_scenes import box_attempts
from helpers.synthetic import RED, image_to_robot, make_attempt

SIZE = (320, 180)
STEPS = 1
ONNX_TOLERANCE = 1e-4


def bag_attempts(count: int) -> list[Attempt]:
    return [make_attempt(i, np.random.default_rng([1, i]), SIZE, depth=False) for i in range(count)]


RECORDED = {"transporter": box_attempts(10, seed=0)}
"""What a policy is shown that does not look at a camera's own pictures."""
UNTRAINED: dict[str, Callable[[], ColorMaskPolicy]] = {
    "color-mask": lambda: ColorMaskPolicy(image_to_robot(SIZE), RED)
}
EXPORTED = ("keypoint", "regression")


def make(name: str, recorded: list[Attempt], folder: Path) -> Policy:
    """A policy of this name, saved in a folder and loaded; trained a little where it has a training."""
    if name in TRAININGS:
        options = TRAININGS[name](Path("drawn"), folder, train=4, val=1, steps=STEPS, device="cpu")
        assert train(options, recorded)["steps"] == STEPS
    elif name in UNTRAINED:
        UNTRAINED[name]().save(folder)
    else:
        pytest.fail(f"{name} is registered, and nothing here makes one: say how in UNTRAINED")
    policy = load_policy(folder)
    if isinstance(policy, KeypointPolicy):
        with torch.no_grad():
            policy.network.heat.weight.mul_(300)  # as sure as one that was trained for long
    return policy


@pytest.mark.parametrize("name", POLICIES.names())
def test_a_policy_keeps_its_contract_and_plans_the_same_saved_and_exported(name: str, tmp_path: Path) -> None:
    torch.set_num_threads(1)
    recorded = RECORDED.get(name) or bag_attempts(5)
    seen = recorded[0].before
    goal = goal_of(recorded[0]) if np.isfinite(recorded[0].box_after).all() else None
    policy = make(name, recorded, tmp_path / "made")
    assert type(policy) is POLICIES[name]
    assert policy.name == name
    check_policy(policy, seen, goal)

    planned = policy.plan(seen, goal).action.to_array()
    if isinstance(policy, LearnedPolicy):
        policy.save_pretrained(tmp_path / "again")
        files = {path.name for path in (tmp_path / "again").iterdir()}
        assert files == {"config.yaml", "policy.safetensors"}
    else:
        policy.save(tmp_path / "again")
    again = load_policy(tmp_path / "again")
    assert type(again) is type(policy)
    for what in ("cell", "picture_size"):
        assert getattr(again, what, None) == getattr(policy, what, None)
    assert np.array_equal(again.plan(seen, goal).action.to_array(), planned)

    asked = ExportOptions(str(tmp_path / "again"), tmp_path / "exported")
    if name in EXPORTED:
        export(asked)
        exported = load_policy(asked.out)
        assert np.abs(exported.plan(seen, goal).action.to_array() - planned).max() <= ONNX_TOLERANCE
    else:
        with pytest.raises(BaggieError, match="PyTorch"):
            export(asked)
        assert not asked.out.exists()
