"""Contracts, checkpoints, the published network's shape."""

import math
from dataclasses import replace

import numpy as np
import pytest
import safetensors.torch
import torch
import yaml

from baggie.data.summary import goal_of
from baggie.errors import BaggieError, DataError
from baggie.geometry import PlanarPose
from baggie.policies import (
    KeypointPolicy,
    OraclePolicy,
    RegressionPolicy,
    load_policy,
)
from baggie.policies.base import check_policy
from baggie.policies.keypoint.policy import KeypointNet
from baggie.policies.planning import View
from baggie.policies.regression import RegressionNet, Regressor, ResNet18, load_imagenet
from baggie.tasks.conditions import AtGoal, State
from helpers.synthetic import box_corners, make_attempt

SIZE = (640, 360)
VIEW = View(SIZE, 180, 90, 450, 290, (160, 120))


@pytest.fixture(scope="module")
def attempt():
    return make_attempt(5, np.random.default_rng(5), SIZE, depth=False)


@pytest.fixture(scope="module")
def keypoint():
    torch.manual_seed(0)
    network = KeypointNet()
    with torch.no_grad():
        network.heat.weight.mul_(300)  # untrained, but as sure as a trained one
    return KeypointPolicy(network, VIEW, cell=3)


@pytest.fixture(scope="module")
def regression():
    torch.manual_seed(0)
    return RegressionPolicy(RegressionNet(), SIZE, 0, "outline", (0, 0, 255))


def told(places, condition):
    """An oracle that is told where things are whenever it is asked."""
    return OraclePolicy(lambda: condition.next_action(State({}, places)))


def test_the_oracle_keeps_the_contract(attempt):
    oracle = told({"bag": attempt.truth.before}, AtGoal("bag", attempt.truth.after))
    check_policy(oracle, attempt.before, goal_of(attempt), looks_at_goal=False)


def test_oracle_says_the_truth_as_it_is_now(attempt):
    places = {"bag": PlanarPose(0.4, 0.1, 0.2)}
    oracle = told(places, AtGoal("bag", PlanarPose(0.5, -0.1, 0.0)))
    for place in (places["bag"], PlanarPose(0.6, 0.0)):
        places["bag"] = place
        assert oracle.plan(attempt.before, goal_of(attempt)).action.pick.xy.tolist() == [place.x, place.y]
    places["bag"] = PlanarPose(0.5, -0.095)  # there it is done
    with pytest.raises(BaggieError, match="the task is done"):
        oracle.plan(attempt.before, goal_of(attempt))


@pytest.mark.parametrize("symmetry", [0, 1, 2, 4])
@pytest.mark.parametrize("yaws", [(2.5, -3.0), (-0.2, 0.1), (1.5, 1.7)])
def test_the_oracle_turns_the_wrist_no_more_than_it_has_to(attempt, symmetry, yaws):
    bag, goal = PlanarPose(0.5, 0.0, yaws[0]), PlanarPose(0.5, 0.2, yaws[1])
    action = told({"bag": bag}, AtGoal("bag", goal, symmetry)).plan(attempt.before).action
    turn = 2 * math.pi / symmetry if symmetry else 0.0
    turned = action.place.yaw - action.pick.yaw
    assert abs(action.pick.yaw) <= turn / 2 + 1e-9
    assert abs(turned) <= turn / 2 + 1e-9
    if symmetry:  # and what it carries ends as it should
        assert math.remainder(bag.yaw + turned - goal.yaw, turn) == pytest.approx(0, abs=1e-9)


def published_resnet18() -> dict[str, tuple[int, ...]]:
    """Names and shapes of the published ImageNet weights, by the rule they follow."""

    def norm(name, channels):
        shapes = dict.fromkeys(("weight", "bias", "running_mean", "running_var"), (channels,))
        return {f"{name}.{part}": shape for part, shape in {**shapes, "num_batches_tracked": ()}.items()}

    shapes = {"conv1.weight": (64, 3, 7, 7), **norm("bn1", 64)}
    inputs = 64
    for layer, channels in enumerate((64, 128, 256, 512), start=1):
        for block in (0, 1):
            name = f"layer{layer}.{block}"
            shapes[f"{name}.conv1.weight"] = (channels, inputs, 3, 3)
            shapes[f"{name}.conv2.weight"] = (channels, channels, 3, 3)
            shapes |= norm(f"{name}.bn1", channels) | norm(f"{name}.bn2", channels)
            if inputs != channels:
                shapes[f"{name}.downsample.0.weight"] = (channels, inputs, 1, 1)
                shapes |= norm(f"{name}.downsample.1", channels)
            inputs = channels
    return shapes | {"fc.weight": (1000, 512), "fc.bias": (1000,)}


def test_resnet18_has_the_published_names_and_shapes():
    network = ResNet18()
    shapes = {name: tuple(tensor.shape) for name, tensor in network.state_dict().items()}
    assert shapes == published_resnet18()
    assert len(shapes) == 122
    assert sum(parameter.numel() for parameter in network.parameters()) == 11_689_512


def test_regressor_is_the_published_one():
    head = [layer for layer in Regressor().head if isinstance(layer, torch.nn.Linear)]
    assert [(layer.in_features, layer.out_features) for layer in head] == [(1000, 128), (128, 32), (32, 2)]


@pytest.mark.parametrize("suffix", [".pth", ".safetensors"])
def test_imagenet_weights_load_from_files(tmp_path, suffix):
    path, weights = tmp_path / f"resnet18{suffix}", ResNet18().state_dict()
    without_counters = {k: v for k, v in weights.items() if not k.endswith("num_batches_tracked")}
    (torch.save if suffix == ".pth" else safetensors.torch.save_file)(without_counters, path)
    network = ResNet18()
    network.load_state_dict(load_imagenet(str(path)))
    assert torch.equal(network.layer4[1].conv2.weight, weights["layer4.1.conv2.weight"])


def test_wrong_imagenet_weights_are_one_clear_line(tmp_path):
    other = tmp_path / "other.safetensors"
    safetensors.torch.save_file({"conv1.weight": torch.zeros(3, 3)}, other)
    cut = tmp_path / "cut.pth"
    torch.save(ResNet18().state_dict(), cut)
    cut.write_bytes(cut.read_bytes()[:1000])
    for source in (other, cut, tmp_path / "none.pth"):
        with pytest.raises(DataError) as error:
            load_imagenet(str(source))
        assert "\n" not in str(error.value)
        assert source.name in str(error.value)


def break_config(folder, **changes):
    config = yaml.safe_load((folder / "config.yaml").read_text()) | changes
    (folder / "config.yaml").write_text(yaml.safe_dump(config))


@pytest.mark.parametrize(
    "damage",
    [
        lambda folder: (folder / "policy.safetensors").unlink(),
        lambda folder: (folder / "config.yaml").unlink(),
        lambda folder: (folder / "config.yaml").write_text("- nothing"),
        lambda folder: (folder / "config.yaml").write_bytes(b"\xff\xfe: ["),
        lambda folder: (folder / "policy.safetensors").write_bytes(
            (folder / "policy.safetensors").read_bytes()[:-100]
        ),
        lambda folder: break_config(folder, policy="regression"),
        lambda folder: break_config(folder, policy="transporter"),
        lambda folder: break_config(folder, model={"width": 8}),
        lambda folder: break_config(folder, picture_size=None),
    ],
)
def test_damaged_checkpoints_are_one_clear_line(tmp_path, keypoint, damage):
    keypoint.save_pretrained(tmp_path)
    damage(tmp_path)
    with pytest.raises(DataError) as error:
        load_policy(tmp_path)
    assert "\n" not in str(error.value)


def test_a_checkpoint_that_may_not_be_read_is_not_called_damaged(tmp_path):
    (tmp_path / "config.yaml").mkdir()  # as root, everything may be read
    with pytest.raises(DataError, match=r"config\.yaml cannot be read: Is a directory"):
        load_policy(tmp_path)


def test_a_checkpoint_of_another_policy_is_refused(tmp_path, keypoint):
    keypoint.save_pretrained(tmp_path)
    with pytest.raises(DataError, match="holds a keypoint policy, but regression was asked for"):
        RegressionPolicy.from_pretrained(tmp_path)


def test_a_device_that_is_not_there_is_refused(tmp_path, keypoint, monkeypatch):
    monkeypatch.setattr(torch.backends.mps, "is_available", lambda: False)
    keypoint.save_pretrained(tmp_path)
    with pytest.raises(BaggieError, match="device mps was asked for, but PyTorch finds none here"):
        load_policy(tmp_path, device="mps")


def test_neither_folder_nor_hub_id():
    with pytest.raises(DataError, match="neither the folder"):
        load_policy("no such/folder/at all")


def test_pictures_of_another_shape_are_refused(attempt, keypoint):
    small = replace(attempt.before, color=attempt.before.color[:, :480])
    with pytest.raises(BaggieError, match="another camera"):
        keypoint.plan(small, replace(goal_of(attempt), corners=box_corners(PlanarPose(0.5, 0.1), SIZE)))


def test_goal_where_no_attempt_was_is_refused(attempt, keypoint):
    far = replace(goal_of(attempt), corners=np.array([[5.0, 5], [35, 5], [35, 35], [5, 35]]))
    with pytest.raises(BaggieError, match=r"at \(20, 20\) is outside of what the training attempts covered"):
        keypoint.plan(attempt.before, far)
    width, height = attempt.before.size
    large = attempt.before.resized(2 * width, 2 * height)
    with pytest.raises(BaggieError, match=rf"at \(4[01], 4[01]\) .* of {2 * width} x {2 * height} pixels"):
        keypoint.plan(large, far.scaled(2, 2))


def test_goals_drawing_is_the_policys_own_business(attempt, keypoint, regression):
    goal = goal_of(attempt)
    other = replace(goal, style="outline", color=(255, 0, 0))
    for policy in (keypoint, regression):
        plans = [policy.plan(attempt.before, g).action.to_array() for g in (goal, other)]
        assert np.array_equal(*plans)


def test_regression_has_no_yaw(attempt, regression):
    action = regression.plan(attempt.before, goal_of(attempt)).action
    assert (action.pick.yaw, action.place.yaw) == (0.0, 0.0)
    assert math.isfinite(action.pick.x)


def test_by_each_pictures_own_statistics_a_network_does_what_it_did_when_it_learned_from_one(
    tmp_path, regression
):
    torch.manual_seed(1)
    learning = RegressionNet().train()
    images = torch.randint(0, 256, (1, 3, 224, 224), dtype=torch.uint8)
    own = RegressionNet("picture")
    own.load_state_dict(learning.state_dict())
    with torch.no_grad():
        torch.testing.assert_close(own.eval()(images), learning(images), rtol=1e-3, atol=1e-5)
        two = torch.cat([images, images.flip(-1)])
        torch.testing.assert_close(own(two)[:1], own(images), rtol=1e-3, atol=1e-5)  # whatever lies beside it
        assert not torch.allclose(learning.eval()(images), own(images), atol=1e-4)
    policy = RegressionPolicy(own, SIZE, 0, "solid", (0, 200, 0))
    policy.save_pretrained(tmp_path)
    loaded = load_policy(tmp_path)
    assert loaded.network.statistics == "picture"
    assert "statistics" not in regression.model_config()  # as published
