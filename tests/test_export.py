"""An exported policy says what PyTorch says, without PyTorch; what cannot be exported or loaded is one line."""

import json
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import safetensors.torch
import torch
from torch import nn

from baggie import Policy
from baggie.calibration.image_to_robot.rectify import Rectifier
from baggie.cli.main import main
from baggie.data.summary import goal_of
from baggie.errors import BaggieError, DataError, install_extra
from baggie.geometry import Grid
from baggie.policies import KeypointPolicy, RegressionPolicy, export, load_policy
from baggie.policies.base import check_policy
from baggie.policies.exported import ExportedKeypoint, ExportedRegression
from baggie.policies.keypoint.policy import KeypointNet
from baggie.policies.planning import GoalInput, Reading, View
from baggie.policies.regression import RegressionNet
from baggie.policies.transporter.config import TransporterConfig
from baggie.policies.transporter.network import TransporterNet
from baggie.policies.transporter.policy import TransporterPolicy
from baggie.types import LAYER_M
from helpers.synthetic import image_to_robot, make_attempt

SIZE = (640, 360)
VIEW = View(SIZE, 127, 78, 470, 281, (160, 96))
ROOT = Path(__file__).parents[1]
TOLERANCE = 1e-4


@pytest.fixture(scope="module", autouse=True)
def one_thread():
    """Two engines with two threads each wait for each other on two cores."""
    before = torch.get_num_threads(), cv2.getNumThreads()
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    yield
    torch.set_num_threads(before[0])
    cv2.setNumThreads(before[1])


def shaken(network: nn.Module, *inputs: torch.Tensor) -> nn.Module:
    """Batch norm as after a training: statistics of pictures, and no two channels treated alike."""
    for module in network.modules():
        if isinstance(module, nn.BatchNorm2d):
            module.momentum = 1.0
            nn.init.uniform_(module.weight, 0.5, 1.5)
            nn.init.normal_(module.bias, 0, 0.1)
    with torch.no_grad():
        network.train()(*inputs)
    return network.eval()


def make_keypoint(backbone="small", goal_input=None, seed=0, lift=(0.0, 0.0, 0.0)) -> KeypointPolicy:
    """Untrained, but as sure as a trained one, with a lens, a tilted camera and radii; with a `lift`, from stacks."""
    torch.manual_seed(seed)
    goal_input = goal_input or GoalInput()
    pictures = [random_inputs(np.random.default_rng(n), goal_input.channels)[0] for n in range(8)]
    network = KeypointNet(8, goal_input.channels, backbone)
    shaken(network, torch.from_numpy(np.concatenate(pictures)), torch.eye(3).expand(8, 3, 3))
    with torch.no_grad():
        network.heat.weight.mul_(100)
        network.radius.times_spread.copy_(torch.tensor([2.0, 3.0]))
        plane = torch.tensor([0.02, 0.3, 0.5, 0.28, -0.03, 0.01, 0.02, 0.1])
        network.to_robot.homography.copy_(plane)
        network.to_robot.distortion.copy_(torch.tensor([0.05, -0.02]))
        network.to_robot.center.copy_(torch.tensor([0.02, -0.01]))
        network.to_robot.lift.copy_(torch.tensor(lift))
    return KeypointPolicy(network, VIEW, 3, goal_input)


@pytest.fixture(scope="module")
def keypoint():
    return make_keypoint()


@pytest.fixture(scope="module")
def regression():
    torch.manual_seed(0)
    network = shaken(RegressionNet(), torch.randint(0, 256, (2, 3, 224, 224), dtype=torch.uint8))
    return RegressionPolicy(network, SIZE, 3, "outline", (0, 0, 255))


@pytest.fixture(scope="module")
def policies(keypoint, regression):
    return {policy.name: policy for policy in (keypoint, regression)}


@pytest.fixture(scope="module")
def exported(tmp_path_factory, policies):
    """Where both are exported to, by name."""
    folders = {name: tmp_path_factory.mktemp(name) for name in policies}
    for name, policy in policies.items():
        export.export_policy(policy, folders[name])
    return folders


@pytest.fixture(scope="module")
def attempt():
    return make_attempt(5, np.random.default_rng(5), SIZE, depth=False)


def random_inputs(rng, channels):
    """A picture, where to look for the object, a goal's corners in the normalised picture, layers."""
    width, height = VIEW.size
    noise = rng.integers(0, 256, (channels, height // 8, width // 8), np.uint8)
    images = np.stack([cv2.resize(channel, (width, height)) for channel in noise])[None]
    near = np.array([rng.uniform(0, width / 2), rng.uniform(0, height / 2), rng.choice([16.0, 1e4])])
    corners = rng.uniform(-0.6, 0.6, (rng.integers(3, 9), 2))
    layers = rng.integers(0, 4, 2)
    return images, near.astype(np.float32), corners.astype(np.float32), layers.astype(np.float32)


def assert_same_reading(policy, loaded, pictures) -> set[int]:
    """Fails where both are further apart than 1e-4; the symmetries that came."""
    symmetries = set()
    rng = np.random.default_rng(1)
    for _ in range(pictures):
        given = random_inputs(rng, policy.goal_input.channels)
        ours, theirs = policy.read(*given), loaded.read(*given)
        for name, a, b in zip(Reading._fields, ours, theirs, strict=True):
            assert a.shape == b.shape, name
            assert np.isfinite(a).all(), name
            assert np.abs(a - b).max() <= TOLERANCE, name
        symmetries.add(int(ours.symmetry))
    return symmetries


def test_an_exported_keypoint_reads_as_pytorch_does(keypoint, exported):
    loaded = load_policy(exported["keypoint"])
    assert isinstance(loaded, ExportedKeypoint)
    symmetries = assert_same_reading(keypoint, loaded, 25)
    assert symmetries == {0, 2, 4}, "pictures in which a thing is long, square and neither"


@pytest.mark.parametrize("backbone", ["small", pytest.param("resnet18", marks=pytest.mark.slow)])
def test_painted_goals_and_another_backbone_are_exported_too(tmp_path, backbone):
    policy = make_keypoint(backbone, GoalInput("painted", "outline", (0, 0, 255)))
    export.export_policy(policy, tmp_path)
    loaded = load_policy(tmp_path)
    assert isinstance(loaded, ExportedKeypoint)
    assert loaded.goal_input == policy.goal_input
    assert_same_reading(policy, loaded, 4)


def test_an_exported_regression_reads_as_pytorch_does(regression, exported):
    loaded = load_policy(exported["regression"])
    assert isinstance(loaded, ExportedRegression)
    rng = np.random.default_rng(2)
    for _ in range(4):
        images = rng.integers(0, 256, (1, 3, 224, 224), np.uint8)
        assert np.abs(regression.read(images) - loaded.read(images)).max() <= TOLERANCE


def test_exported_policies_keep_the_contract_and_plan_the_same(attempt, policies, exported):
    goal = goal_of(attempt)
    pointed = replace(goal, object_at=tuple(attempt.box_before.mean(axis=0)))
    for policy in policies.values():
        loaded = Policy.from_pretrained(exported[policy.name])
        assert (loaded.name, loaded.cell, loaded.picture_size) == (policy.name, 3, SIZE)
        check_policy(loaded, attempt.before, goal)
        for asked in (goal, pointed):
            ours, theirs = (p.plan(attempt.before, asked) for p in (policy, loaded))
            assert np.abs(ours.action.to_array() - theirs.action.to_array()).max() <= TOLERANCE
            assert abs(ours.confidence - theirs.confidence) <= TOLERANCE
            assert ours.views.keys() == theirs.views.keys()
            for name, view in ours.views.items():
                assert np.abs(view - theirs.views[name]).max() <= TOLERANCE


def test_a_policy_that_learned_from_stacks_plans_on_them_exported_too(tmp_path, attempt):
    policy = make_keypoint(lift=(0.012, -0.003, 0.024))
    export.export_policy(policy, tmp_path)
    loaded = load_policy(tmp_path)
    assert isinstance(loaded, ExportedKeypoint)
    assert_same_reading(policy, loaded, 8)
    goal = goal_of(attempt)
    check_policy(loaded, attempt.before, replace(goal, layer=2, object_layer=1))
    flat = policy.plan(attempt.before, goal).action
    assert (flat.pick_on_m, flat.place_on_m) == (0.0, 0.0)
    for object_layer, layer in ((0, 1), (2, 0), (1, 3)):
        asked = replace(goal, layer=layer, object_layer=object_layer)
        ours, theirs = (p.plan(attempt.before, asked).action for p in (policy, loaded))
        assert np.abs(ours.to_array() - theirs.to_array()).max() <= TOLERANCE
        assert (theirs.pick_on_m, theirs.place_on_m) == (object_layer * LAYER_M, layer * LAYER_M)
        for now, before, up in ((ours.pick, flat.pick, object_layer), (ours.place, flat.place, layer)):
            shift = up * (np.array([0.012, -0.003]) - 0.024 * before.xy)
            np.testing.assert_allclose(now.xy - before.xy, shift, atol=1e-5)
            assert now.yaw == pytest.approx(before.yaw, abs=1e-5)


def test_what_knows_the_table_only_is_exported_and_loaded_as_before_and_refuses_stacks(
    tmp_path, attempt, keypoint, exported, policies
):
    """A run of an older version lacks what layers shift, and its export the input that asks for them."""
    goal = goal_of(attempt)
    keypoint.save_pretrained(tmp_path)
    path = tmp_path / "policy.safetensors"
    tensors = safetensors.torch.load_file(path)
    del tensors["to_robot.lift"]
    safetensors.torch.save_file(tensors, path, metadata={"policy": "keypoint"})
    trained = load_policy(tmp_path)
    graph = load_policy(exported["keypoint"])
    assert graph.graph.inputs.keys() == {"images", "near", "corners"}
    expected = keypoint.plan(attempt.before, goal).action.to_array()
    assert np.array_equal(trained.plan(attempt.before, goal).action.to_array(), expected)
    assert np.abs(graph.plan(attempt.before, goal).action.to_array() - expected).max() <= TOLERANCE
    camera = TransporterPolicy(
        TransporterNet(TransporterConfig()),
        Grid(),
        3,
        GoalInput("painted"),
        Rectifier.of(image_to_robot(SIZE), Grid()),
    )
    for policy in (trained, graph, *policies.values(), load_policy(exported["regression"]), camera):
        for layers in ({"layer": 1}, {"object_layer": 2}):
            with pytest.raises(
                BaggieError, match="collect bag-stack and train keypoint or transporter on it"
            ) as error:
                policy.plan(attempt.before, replace(goal, **layers))
            assert policy.name in str(error.value)
            assert "\n" not in str(error.value)


def test_what_is_off_is_not_written(tmp_path, keypoint, monkeypatch):
    monkeypatch.setattr(export, "_TOLERANCE", -1.0)
    with pytest.raises(BaggieError, match="nothing was written"):
        export.export_policy(keypoint, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_differences_find_another_network(keypoint, exported):
    """The comparison that guards an export notices a network that is another one."""
    other = export.Exportable.of(make_keypoint(seed=1))
    graph = load_policy(exported["keypoint"]).graph
    assert max(export.Exportable.of(keypoint).differences(graph).values()) <= TOLERANCE
    assert max(other.differences(graph).values()) > 100 * TOLERANCE


WITHOUT_TORCH = """
import sys
for name in ("torch", "safetensors", "pyarrow", "mujoco", "matplotlib", "accelerate"):
    sys.modules[name] = None  # importing it fails
import numpy as np
from baggie import Policy
from baggie.types import Goal, Observation
policy = Policy.from_pretrained(sys.argv[1])
given = np.load(sys.argv[2])
print(policy.plan(Observation(given["color"]), Goal(given["corners"])).action.to_array().tolist())
"""


@pytest.mark.parametrize("name", ["keypoint", "regression"])
def test_an_exported_policy_needs_no_pytorch(tmp_path, attempt, exported, policies, name):
    goal = goal_of(attempt)
    np.savez(tmp_path / "given.npz", color=attempt.before.color, corners=goal.corners)
    command = [sys.executable, "-c", WITHOUT_TORCH, str(exported[name]), str(tmp_path / "given.npz")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    expected = policies[name].plan(attempt.before, goal).action.to_array()
    assert np.abs(expected - json.loads(done.stdout)).max() <= TOLERANCE


def without(monkeypatch, module: str) -> None:
    monkeypatch.setitem(sys.modules, module, None)


def test_without_onnxruntime_one_line_says_what_to_install(exported, monkeypatch):
    without(monkeypatch, "onnxruntime")
    with pytest.raises(DataError, match=re.escape(install_extra("deploy"))) as error:
        load_policy(exported["keypoint"])
    assert "\n" not in str(error.value)


def test_a_training_run_without_pytorch_is_one_line(tmp_path, keypoint):
    keypoint.save_pretrained(tmp_path)
    code = (
        "import sys; sys.modules['torch'] = None\n"
        "from baggie import load_policy\nfrom baggie.errors import DataError\n"
        f"try: load_policy({str(tmp_path)!r})\nexcept DataError as error: print(error)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "baggie export" in done.stdout
    assert done.stdout.count("\n") == 1


@pytest.mark.parametrize(
    "damage",
    [
        lambda folder: (folder / "policy.onnx").write_bytes((folder / "policy.onnx").read_bytes()[:-1000]),
        lambda folder: (folder / "policy.onnx").write_bytes(b"nothing of the kind"),
        lambda folder: (folder / "config.yaml").unlink(),
        lambda folder: (folder / "config.yaml").write_text("policy: regression\n"),
        lambda folder: (folder / "config.yaml").write_text("policy: transporter\n"),
    ],
)
def test_damaged_exports_are_one_clear_line(tmp_path, exported, damage):
    folder = shutil.copytree(exported["keypoint"], tmp_path / "copy")
    damage(folder)
    with pytest.raises(DataError) as error:
        load_policy(folder)
    assert "\n" not in str(error.value)


def test_files_of_two_policies_do_not_belong_together(tmp_path, exported):
    folder = shutil.copytree(exported["keypoint"], tmp_path / "copy")
    shutil.copyfile(exported["regression"] / "config.yaml", folder / "config.yaml")
    with pytest.raises(DataError, match="do not belong together"):
        load_policy(folder)


def test_an_exported_policy_is_for_the_cpu(exported):
    with pytest.raises(DataError, match="runs on the CPU, but cuda was asked for"):
        load_policy(exported["keypoint"], device="cuda")


def test_the_command_exports_once_and_nothing_twice(tmp_path, keypoint, capsys):
    run, out = tmp_path / "run", tmp_path / "out"
    keypoint.save_pretrained(run)
    assert main(["export", "--policy", str(run), "--out", str(out), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert sorted(path.name for path in out.iterdir()) == ["config.yaml", "policy.onnx"]
    assert set(result["largest_difference"]) == set(Reading._fields)
    assert max(result["largest_difference"].values()) <= TOLERANCE
    for wrong in ([str(out), str(tmp_path / "again")], [str(run), str(run)]):
        assert main(["export", "--policy", wrong[0], "--out", wrong[1]]) == 1
        assert capsys.readouterr().err.startswith("error: ")
    assert not (tmp_path / "again").exists()


def test_a_kind_that_cannot_be_exported_says_what_to_do_and_writes_nothing(tmp_path, capsys, monkeypatch):
    run, out = tmp_path / "run", tmp_path / "out"
    TransporterPolicy(TransporterNet(TransporterConfig()), Grid(), 3).save_pretrained(run)
    monkeypatch.setattr(
        export, "find_spec", lambda name: None
    )  # nobody is asked to install what would not help
    assert main(["export", "--policy", str(run), "--out", str(out)]) == 1
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith(
        "error: expected a keypoint or regression policy to export, got transporter;"
    )
    assert captured.err.count("\n") == 1
    assert not out.exists()
