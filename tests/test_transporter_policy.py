"""The `transporter` policy: what its looks say, what its networks are, and what it promises."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st

from baggie.errors import BaggieError
from baggie.geometry import Grid, PlanarPose
from baggie.policies import TransporterPolicy, load_policy
from baggie.policies.base import check_policy
from baggie.policies.planning import GoalInput
from baggie.policies.transporter.config import TransporterConfig
from baggie.policies.transporter.fast import CELL, DEEPEST, Trunk
from baggie.policies.transporter.network import Attention, Decision, PaperMaps, ResidualFCN, TransporterNet
from baggie.policies.transporter.policy import _over_map, quarter_turned, turned_back
from baggie.policies.transporter.scores import PlaceAngle, Scores, soft_targets, turn_angles
from baggie.policies.transporter.spatial import patches
from baggie.types import Goal, Observation

GRID = Grid(x=(0.3, 0.39), y=(-0.06, 0.06), pixel_m=0.0025)
"""36 x 48 pixels: not multiples of 16."""
GOAL = Goal(np.array([[10.0, 10.0], [18, 10], [18, 18], [10, 18]]))
CONFIGS = [
    TransporterConfig(rotations=12),
    TransporterConfig(symmetry=4, pick_yaw=True),
    TransporterConfig(symmetry=0),
    TransporterConfig("paper", rotations=3),
    pytest.param(
        TransporterConfig("paper", rotations=6, symmetry=4, pick_yaw=True),
        marks=pytest.mark.slow,
        id="paper-gripper",
    ),
]
angles = st.floats(-math.pi, math.pi)


@pytest.fixture(autouse=True)
def _one_thread():
    torch.set_num_threads(1)


def policy_of(config: TransporterConfig, goal_input: GoalInput | None = None) -> TransporterPolicy:
    torch.manual_seed(0)
    return TransporterPolicy(TransporterNet(config), GRID, 3, goal_input)


def seen(number: int = 0, grid: Grid = GRID) -> Observation:
    rng = np.random.default_rng(number)
    color = rng.integers(0, 256, (*grid.shape, 3)).astype(np.uint8)
    return Observation(color, grid=grid, height=rng.uniform(0, 0.1, grid.shape).astype(np.float32))


# --- what a look says


@given(st.floats(20, 44), st.floats(20, 44), st.integers(-6, 6), st.integers(-6, 6))
def test_of_two_places_that_fit_as_well_the_coarse_look_decides(u, v, right, down):
    """A finer look that knows of two places alike chooses the one where the coarse one saw it, and reads it alike."""
    truth = PlaceAngle(torch.tensor([[u, v]]), torch.zeros(1))
    coarse = look_at(truth.place, (16, 16), torch.full((1, 2), 1.5), 4)
    centre = truth.place.round()
    other = truth.place + torch.tensor([[float(right), float(down)]])
    fine = look_at(truth.place, (13, 13), centre - 6, 1)
    both = torch.logaddexp(fine.logits, look_at(other, (13, 13), centre - 6, 1).logits)
    found = fine._replace(logits=both).given(coarse).read(truth).place
    if math.hypot(right, down) >= 5:
        assert found == pytest.approx(truth.place, abs=0.35)
    alone = fine.given(coarse).read(truth).place
    assert alone == pytest.approx(fine.read(truth).place, abs=0.35)


@given(st.integers(0, 3), st.integers(9, 30), st.integers(9, 30), st.integers(0, 1000))
def test_a_view_of_a_map_that_was_turned_is_over_what_it_is_about(quarters, rows, columns, seed):
    """Of sides that are not a multiple of 4 the last cell is partly outside, and may be the first after a turn."""
    height, width = quarter_turned(np.zeros((rows, columns)), quarters).shape
    u, v = (
        float(np.random.default_rng([seed, axis]).integers(0, n)) for axis, n in ((0, width), (1, height))
    )
    cells = -(-height // CELL), -(-width // CELL)
    logits = torch.zeros(1, 1, *cells)
    logits[0, 0, int(v) // CELL, int(u) // CELL] = 5
    look = Scores(logits, torch.full((1, 2), (CELL - 1) / 2), CELL, 1)
    at = PlaceAngle(torch.tensor([[u, v]]), torch.zeros(1))
    back = turned_back(Decision(at, at, [look], [look]), quarters, (rows, columns))
    view = _over_map(back.places[0], (rows, columns))
    assert view.shape == (rows, columns)
    column, row = back.place.place[0].int().tolist()
    assert view[row, column] == 1
    assert np.count_nonzero(view == 1) <= CELL**2


def look_at(place: torch.Tensor, shape: tuple[int, int], origin: torch.Tensor, stride: int) -> Scores:
    """One that says of a place `(1, 2)` what it should."""
    sigma = 1.0 if stride == 1 else 0.0
    cells = PlaceAngle(((place - origin) / stride).clamp(0, shape[0] - 1), torch.zeros(1))
    target = soft_targets(cells, torch.ones(1, dtype=torch.long), (1, *shape), sigma_px=sigma)
    return Scores((target + 1e-9).log(), origin, stride, 1)


def test_after_a_look_at_one_cell_the_next_stays_as_it_is():
    fine = Scores(torch.randn(1, 4, 5, 5), torch.zeros(1, 2), 1, 1)
    angle = Scores(torch.randn(1, 8, 1, 1), torch.zeros(1, 2), 1, 1)
    assert fine.given(angle) is fine
    assert angle.given(fine) is angle


@given(
    st.tuples(st.floats(9, 50), st.floats(9, 50)),
    angles,
    st.sampled_from([1, 2, 4]),
    st.sampled_from([1, 2]),
    st.booleans(),
)
def test_a_look_that_knows_the_truth_reads_the_truth(place, angle, fold, copies, coarse):
    """Place and least turn, whichever of the angles that look alike is called true."""
    stride, bins = (4, 12) if coarse else (1, 12)
    truth = PlaceAngle(torch.tensor([place]), torch.tensor([angle]))
    origin = torch.full((1, 2), (stride - 1) / 2)
    cells = 64 // stride
    at = (truth.place - origin) / stride
    targets = soft_targets(PlaceAngle(at, fold * truth.angle), torch.tensor([1]), (bins, cells, cells))
    look = Scores(targets.log(), origin, stride, fold)
    found = look.read(PlaceAngle(torch.zeros(1, 2), torch.zeros(1)))
    assert found.place[0].tolist() == pytest.approx(place, abs=0.05 * stride)
    assert abs(found.angle) <= math.pi / fold + 1e-5
    assert math.degrees(math.remainder(float(found.angle) - angle, math.tau / fold)) == pytest.approx(
        0, abs=0.6
    )
    symmetry = torch.tensor([fold * copies])
    other = PlaceAngle(truth.place, truth.angle + math.tau / (fold * copies))
    flat = look._replace(logits=torch.randn_like(targets))
    assert flat.loss(truth, symmetry) == pytest.approx(float(flat.loss(other, symmetry)), abs=1e-3)


def test_a_look_is_only_about_what_it_has_cells_and_bins_for():
    before = PlaceAngle(torch.tensor([[3.0, 4.0]]), torch.tensor([0.5]))
    zero = torch.zeros(1, 2)
    assert Scores(torch.randn(1, 12, 1, 1), zero, 1, 2).read(before).place.tolist() == [[3.0, 4.0]]
    assert Scores(torch.randn(1, 1, 9, 9), zero, 1, 1).read(before).angle.tolist() == [0.5]


@given(st.integers(1, 6), st.integers(3, 40))
def test_bins_are_the_least_turns_of_those_that_look_alike(fold, bins):
    turns = turn_angles(bins, fold)
    assert (turns.abs() <= math.pi / fold + 1e-6).all()
    steps = torch.sort(turns).values.diff()
    assert torch.allclose(steps, torch.full_like(steps, math.tau / fold / bins), atol=1e-5)


def test_patches_of_any_resolution_are_about_the_same_pixels():
    down, right = torch.meshgrid(torch.arange(48.0), torch.arange(64.0), indexing="ij")
    plane = (2 * right - 3 * down)[None, None]
    coarse = torch.nn.functional.avg_pool2d(plane, 4)
    centre = torch.tensor([[30.0, 20.0]])
    fine, from_coarse = patches(plane, centre, 9, 1), patches(coarse, centre, 9, 4)
    assert torch.allclose(fine[0, 0], plane[0, 0, 16:25, 26:35], atol=1e-3)
    assert torch.allclose(from_coarse, fine, atol=1e-3)


# --- the networks


def test_features_shift_with_the_map():
    torch.manual_seed(0)
    trunk, cells = Trunk().double().eval(), DEEPEST // CELL
    color = torch.randint(0, 256, (1, 3, 400, 400))
    height = torch.rand(1, 400, 400, dtype=torch.float64) / 10
    with torch.no_grad():
        there = trunk(color.double(), height).features
        moved = trunk(color.roll((16, 32), (2, 3)).double(), height.roll((16, 32), (1, 2))).features
    inner = slice(48, 52)  # 48 cells from the edges, more than a feature sees
    assert there[..., inner, inner].std() > 0.01
    ahead = moved[..., 48 + cells : 52 + cells, 48 + 2 * cells : 52 + 2 * cells]
    assert torch.allclose(there[..., inner, inner], ahead, atol=1e-4)


@pytest.mark.parametrize("config", CONFIGS, ids=str)
def test_gradients_reach_every_part(config):
    torch.manual_seed(0)
    network = TransporterNet(config)
    color = torch.randint(0, 256, (1, 3, 22, 36), dtype=torch.uint8)
    truth = PlaceAngle(torch.tensor([[20.0, 12.0]]), torch.tensor([0.3]))
    symmetry = torch.tensor([config.symmetry])
    looks = network(color, torch.rand(1, 22, 36) / 20, truth, truth.place + 2)
    picks = len(network.picks)
    losses = [look.loss(truth, torch.lcm(symmetry, torch.tensor([2]))) for look in looks[:picks]]
    losses += [look.loss(truth, symmetry) for look in looks[picks:]]
    torch.stack(losses).sum().backward()
    for name, parameter in network.named_parameters():
        last_bias = name.endswith("bias") and parameter.grad is not None  # of logits: adds to all alike
        assert last_bias or parameter.grad.abs().max() > 0, name


def test_a_square_thing_needs_a_quarter_of_the_angles():
    once, four = TransporterConfig(), TransporterConfig(symmetry=4)
    assert (once.bins(1), four.bins(4), four.bins(0)) == (36, 9, 1)
    assert (once.orders_of(1), four.orders_of(4)) == (8, 2)
    assert (once.pick_fold, four.pick_fold, TransporterConfig(symmetry=3).pick_fold) == (2, 4, 6)


def test_the_paper_s_network_is_the_published_one():
    """Sixteen bottlenecks; stride 8; the count of weights follows from the published widths."""
    network = ResidualFCN(6, 3)
    widths = [64, 128, 256, 512, 256, 128, 64]
    expected, inputs = 6 * 64 * 9 + 64, 64
    for width, middle in [*((w, w) for w in widths), (3, 16)]:
        for source, shortcut in ((inputs, True), (width, False)):
            expected += source * middle + middle + 9 * middle**2 + middle + middle * width + width
            expected += (source * width + width) if shortcut else 0
        inputs = width
    assert sum(parameter.numel() for parameter in network.parameters()) == expected
    with torch.no_grad():
        assert network(torch.zeros(1, 6, 50, 70)).shape == (1, 3, 50, 70)
        assert network.down(torch.zeros(1, 64, 64, 64)).shape == (1, 256, 8, 8)


def test_the_paper_s_maps_are_normalised_as_published():
    color = torch.full((1, 3, 2, 2), 51, dtype=torch.uint8)
    maps = PaperMaps()(color, torch.full((1, 2, 2), 0.0141323)).maps
    assert maps.shape == (1, 6, 2, 2)
    assert maps[0, :3].flatten().tolist() == pytest.approx([(0.2 - 0.18877631) / 0.07276466] * 12, abs=1e-4)
    assert maps[0, 3:].flatten().tolist() == pytest.approx([1.0] * 12, abs=1e-3)


def test_the_paper_s_gripper_turns_with_the_scene():
    torch.manual_seed(0)
    attention = Attention(TransporterConfig("paper", rotations=8, pick_yaw=True))
    scene = PaperMaps()(torch.randint(0, 256, (1, 3, 33, 33), dtype=torch.uint8), torch.zeros(1, 33, 33))
    turned = scene._replace(maps=scene.maps.rot90(-1, dims=(2, 3)))
    nowhere = PlaceAngle(torch.zeros(1, 2), torch.zeros(1))
    with torch.no_grad():
        there, after = (attention(each, nowhere).logits for each in (scene, turned))
    assert there.std() > 0.01
    assert torch.rad2deg(attention.angles).round().tolist() == [0, 45, -90, -45]
    expected = there[:, 2:].rot90(-1, dims=(2, 3))  # the other two come to lie beyond half a turn
    assert torch.allclose(after[:, :2], expected, atol=1e-3 * float(there.abs().max()))


# --- the policy


@pytest.mark.parametrize("config", CONFIGS, ids=str)
def test_every_kind_keeps_the_contract(config):
    policy = policy_of(config)
    check_policy(policy, seen(), GOAL, looks_at_goal=False)
    plan = policy.plan(seen())
    assert set(plan.views) == {"pick", "place"}
    assert all(view.shape == GRID.shape for view in plan.views.values())
    assert plan.views["pick"].max() == pytest.approx(1)
    action, fold = plan.action, max(config.symmetry, 1)
    turn = math.remainder(action.place.yaw - action.pick.yaw, math.tau)
    assert abs(turn) <= math.pi / fold + 1e-5
    assert abs(action.pick.yaw) <= (math.pi / config.pick_fold + 1e-5 if config.pick_yaw else 0)
    if config.symmetry == 0:
        assert action.place.yaw == 0
    assert GRID.contains([action.pick.xy, action.place.xy]).all()


def test_with_marked_goals_it_keeps_the_contract_and_needs_one():
    policy = policy_of(CONFIGS[0], GoalInput("painted"))
    check_policy(policy, seen(), GOAL)
    with pytest.raises(BaggieError, match="expected a goal"):
        policy.plan(seen())


def test_a_goal_is_painted_in_the_style_and_colour_it_was_trained_with():
    policy = policy_of(CONFIGS[0], GoalInput("painted", "solid", (1, 2, 3)))
    painted = policy.painted(seen().color, replace(GOAL, style="outline", color=(9, 9, 9)))
    assert painted[14, 14].tolist() == [1, 2, 3]
    assert np.array_equal(painted[24:], seen().color[24:])


@pytest.mark.parametrize("config", CONFIGS[:4], ids=str)
def test_saved_policies_plan_the_same(tmp_path, config):
    policy = policy_of(config, GoalInput("painted", "outline", (9, 8, 7)))
    policy.save_pretrained(tmp_path)
    loaded = load_policy(tmp_path)
    assert isinstance(loaded, TransporterPolicy)
    assert (loaded.config(), loaded.grid) == (policy.config(), policy.grid)
    plans = [each.plan(seen(), GOAL).action.to_array() for each in (policy, loaded)]
    assert np.array_equal(*plans)


@settings(deadline=None, max_examples=8)
@given(st.integers(33, 90), st.integers(33, 90))
@example(81, 88)  # the place ends on the edge
def test_maps_of_any_size(rows, columns):
    size = GRID.pixel_m
    grid = Grid((0.3, 0.3 + columns * size), (0.0, rows * size), GRID.z, size)
    drawn = np.random.default_rng(0).integers(0, 255, (rows, columns, 3)).astype(np.uint8)
    plan = policy_of(TransporterConfig()).plan(
        Observation(drawn, grid=grid, height=np.zeros((rows, columns), np.float32))
    )
    assert grid.contains([plan.action.pick.xy, plan.action.place.xy]).all()
    assert plan.views["place"].shape == (rows, columns)


def test_the_same_map_elsewhere_on_the_table_is_the_same_plan_there():
    policy, here = policy_of(CONFIGS[0]), seen()
    there = replace(here, grid=Grid(x=(0.4, 0.49), y=(0.04, 0.16), pixel_m=GRID.pixel_m))
    one, other = (policy.plan(each).action.to_array() for each in (here, there))
    assert (other - one).tolist() == pytest.approx([0.1, 0.1, 0, 0.1, 0.1, 0])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"grid": None, "height": None}, "expected a picture from straight above"),
        ({"height": None}, "expected a picture from straight above"),
        ({"grid": Grid(x=(0.3, 0.7), y=(-0.3, 0.3), pixel_m=0.005)}, "expected pixels of 0.0025 m"),
        ({"grid": replace(GRID, z=(0.1, 0.3))}, "heights from z = 0.0 m"),
        ({"height": np.zeros((30, 36), np.float32)}, "36 x 48 pixels, got 36 x 48 and 36 x 30"),
    ],
)
def test_other_pictures_are_one_clear_line(change, message):
    with pytest.raises(BaggieError, match=message) as error:
        policy_of(CONFIGS[0]).plan(replace(seen(), **change))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "wrong", [{"preset": "large"}, {"rotations": 2}, {"symmetry": -1}, {"orders": 0}], ids=str
)
def test_networks_there_are_not(wrong):
    with pytest.raises(BaggieError, match="expected") as error:
        TransporterConfig(**wrong)
    assert "\n" not in str(error.value)


def test_the_turn_is_added_to_the_yaw_of_the_pick(monkeypatch):
    policy = policy_of(CONFIGS[0])
    decision = policy.decide(seen().color, seen().height)
    pick, place = (
        PlaceAngle(torch.tensor([[u, 30.0]]), torch.tensor([a])) for u, a in ((10.0, 3.0), (20.0, 0.5))
    )
    monkeypatch.setattr(policy, "decide", lambda *_: decision._replace(pick=pick, place=place))
    action = policy.plan(seen()).action
    assert action.pick.yaw == pytest.approx(3.0)
    assert action.place.yaw == pytest.approx(3.5 - math.tau)
    assert action.place.distance(PlanarPose(*GRID.to_robot([20.0, 30.0])[0])) < 1e-6
