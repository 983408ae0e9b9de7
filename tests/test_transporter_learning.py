"""Teaching `transporter`: labels that move with the scene, what it learns, going on after an interruption."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from baggie.errors import DataError
from baggie.geometry import Grid, apply_homography, wrap_angle
from baggie.learning import TransporterTraining, train
from baggie.learning.demonstrations import read_demonstrations
from baggie.learning.moved_maps import MovedMaps, Moves, random_move, rigid_move
from baggie.learning.split import split_episodes
from baggie.learning.train import plan_errors
from baggie.learning.transporter import TransporterOptions, TransporterRecipe
from baggie.policies import load_policy
from baggie.policies.base import check_policy
from baggie.types import Goal, Observation
from helpers.box_scenes import box_attempts, box_demonstrations, box_scene

GRID = Grid(x=(0.25, 0.55), y=(-0.15, 0.15), pixel_m=0.003125)
"""96 x 96 pixels."""
SHOWN = box_demonstrations(6, 0, grid=GRID)
ATTEMPTS = box_attempts(64, 0, grid=GRID)
angles = st.floats(-math.pi, math.pi)


@pytest.fixture(autouse=True)
def _one_thread():
    torch.set_num_threads(1)


def options(out: Path, **changes) -> TransporterTraining:
    given = {"train": 3, "val": 1, "steps": 4, "device": "cpu", "save_every_s": 1e3}
    return TransporterTraining(data=Path("drawn"), out=out, **(given | changes))


# --- labels


@pytest.mark.parametrize("quarters", [0, 1, 2, 3])
def test_quarter_turns_move_every_pixel_and_label_exactly(quarters):
    maps = MovedMaps(SHOWN, Moves())
    move = rigid_move(quarters * math.pi / 2, np.zeros(2), (96, 96))
    moved, still = maps.moved(2, move), maps.moved(2, np.eye(3))
    assert np.array_equal(moved.color, np.rot90(still.color, -quarters))
    assert np.allclose(moved.height, np.rot90(still.height, -quarters), atol=1e-6)
    for place, before in zip(moved.places, still.places, strict=True):
        off = before - 47.5
        for _ in range(quarters):
            off = np.array([-off[1], off[0]])
        assert place == pytest.approx(off + 47.5, abs=1e-9)
    assert wrap_angle(moved.yaws - still.yaws - quarters * math.pi / 2) == pytest.approx([0, 0], abs=1e-9)


@given(angles, st.floats(-20, 20), st.floats(-20, 20), st.integers(0, 5))
def test_what_was_drawn_at_a_label_is_drawn_there_after_any_move(turn, right, down, number):
    """The red box's middle, found in the moved picture itself, is where the moved label says."""
    move = rigid_move(turn, np.array([right, down]), (96, 96))
    moved = MovedMaps(SHOWN, Moves()).moved(number, move)
    if not ((moved.places[0] > 14) & (moved.places[0] < 82)).all():
        return
    color = moved.color.astype(float)
    box = (moved.height > 0.03) & (color[..., 0] > color[..., 2] + 60)  # red, and its yellow mark
    found = np.argwhere(box).mean(axis=0)[::-1]
    assert np.linalg.norm(found - moved.places[0]) < 0.7


@given(angles, st.floats(-20, 20), st.floats(-20, 20), st.integers(0, 5))
def test_a_moved_scene_keeps_what_is_relative(turn, right, down, number):
    maps = MovedMaps(SHOWN, Moves())
    moved = maps.moved(number, rigid_move(turn, np.array([right, down]), (96, 96)))
    still = maps.moved(number, np.eye(3))
    assert np.linalg.norm(moved.places[1] - moved.places[0]) == pytest.approx(
        np.linalg.norm(still.places[1] - still.places[0])
    )
    turns = wrap_angle(np.diff(moved.yaws) - np.diff(still.yaws))
    assert turns == pytest.approx([0], abs=1e-9)


@given(
    st.integers(0, 10_000), st.lists(st.tuples(st.floats(3, 92), st.floats(3, 92)), min_size=2, max_size=2)
)
def test_no_move_pushes_a_label_out(seed, places):
    moves, points = Moves(margin_px=2), np.array(places)
    move = random_move(np.random.default_rng(seed), points, (96, 96), moves, (96, 96))
    there = apply_homography(move, points)
    assert ((there >= 2) & (there <= 93)).all()
    assert move[:2, :2] @ move[:2, :2].T == pytest.approx(np.eye(2))


@given(
    st.integers(0, 10_000),
    st.lists(st.tuples(st.floats(3, 92), st.floats(3, 92)), min_size=2, max_size=2),
    st.tuples(st.integers(16, 96), st.integers(16, 96)),
)
def test_a_window_holds_every_label_or_there_is_none(seed, places, window):
    moves, points = Moves(margin_px=2, shift_px=10), np.array(places)
    move = random_move(np.random.default_rng(seed), points, (96, 96), moves, window)
    if move is None:
        assert (np.ptp(points, axis=0) > np.array(window) - 6).any() or (np.abs(points - 47.5) > 12).any()
        return
    there = apply_homography(move, points)
    assert ((there >= 2 - 1e-9) & (there <= np.array(window) - 3 + 1e-9)).all()


@given(st.integers(0, 1000), st.booleans())
def test_samples_of_a_batch_are_windows_or_all_of_them_whole(seed, near):
    """What is far apart fits no window: then the whole map is shown, so that a batch has one shape."""
    shown = box_demonstrations(6, 0, grid=GRID)
    side = 64 if near else 40
    apart = np.linalg.norm(shown.places[:, 0] - shown.places[:, 1], axis=1)
    drawn = MovedMaps(shown, Moves(), 0.0, (side, side)).draw(np.random.default_rng(seed), [0, 1, 2])
    shapes = {moved.height.shape for moved in drawn}
    assert len(shapes) == 1
    assert shapes <= {(side, side), (96, 96)}
    if (apart[:3] > side * math.sqrt(2)).any():
        assert shapes == {(96, 96)}
    for moved in drawn:
        assert moved.color.shape[:2] == moved.height.shape
        assert ((moved.places >= 0) & (moved.places <= moved.height.shape[0] - 1)).all()


@pytest.mark.parametrize("number", range(3))
def test_a_window_shows_what_the_map_shows_there(number):
    maps = MovedMaps(SHOWN, Moves())
    whole = maps.moved(number, np.eye(3))
    corner = np.array([[1.0, 0, -20], [0, 1, -30], [0, 0, 1]])
    window = maps.moved(number, corner, (50, 40))
    assert (window.color == whole.color[30:70, 20:70]).all()
    assert (window.height == whole.height[30:70, 20:70]).all()
    assert window.places == pytest.approx(whole.places - [20, 30])
    assert window.middle == pytest.approx(whole.middle - [20, 30])


@settings(deadline=None)
@given(st.integers(0, 1000), st.sampled_from([1, 4]))
def test_held_beside_its_pick_a_thing_still_ends_where_it_was_shown(seed, symmetry):
    """Moving the hold by d moves the place by R(a) d: what was at the pick arrives at the place."""
    recipe = TransporterRecipe(box_demonstrations(2, 1, symmetry, GRID), TransporterOptions(batch=1))
    recipe._maps._moves = Moves(recolor=False)
    batch = recipe.batch(np.random.default_rng(seed))
    a = float(batch["target"][0, 2])
    assert abs(a) <= math.pi / symmetry + 1e-5
    beside = (batch["pick"][0, :2] - batch["held"][0]).numpy()
    assert 0 < np.abs(beside).max() <= 1
    turned = np.array([[math.cos(a), -math.sin(a)], [math.sin(a), math.cos(a)]]) @ beside
    arrives = batch["target"][0, :2].numpy() + turned
    rng = np.random.default_rng(seed)
    number = int(rng.integers(0, 2, 1)[0])
    shown = recipe._maps.draw(rng, [number])[0]
    assert arrives == pytest.approx(shown.places[1], abs=1e-3)
    assert np.abs(batch["about"][0].numpy() - batch["target"][0, :2].numpy()).max() <= 4 + 1e-4


def test_batches_follow_from_their_seed():
    recipe = TransporterRecipe(SHOWN)
    one, same, other = (recipe.batch(np.random.default_rng([seed, 3])) for seed in (4, 4, 5))
    assert all(torch.equal(one[name], same[name]) for name in one)
    assert not torch.equal(one["color"], other["color"])


# --- what is learned


@pytest.fixture(scope="module")
def taught(tmp_path_factory) -> Path:
    torch.set_num_threads(1)
    out = tmp_path_factory.mktemp("run")

    def recipe(attempts):
        few_steps = TransporterOptions(batch=2, rearranged=0.0)  # rearranged, scenes take longer to learn
        return TransporterRecipe(read_demonstrations(attempts), few_steps)

    train(options(out, train=31, val=1, steps=180, seed=2), ATTEMPTS, recipe)
    return out


def errors(policy, number: int, move=None) -> tuple[float, float, float]:
    """On a scene it has not seen: millimetres at the pick, and those and the degrees the box ends off by.

    What is picked d beside its middle has to be let go R(a) d beside the slot's.
    """
    shown = box_demonstrations(1, 1000 + number, grid=GRID)
    moved = MovedMaps(shown, Moves()).moved(0, np.eye(3) if move is None else move)
    action = policy.plan(Observation(moved.color, grid=GRID, height=moved.height)).action
    right = GRID.to_robot(moved.places)
    turn = float(moved.yaws[1] - moved.yaws[0])
    a = action.place.yaw - action.pick.yaw
    beside = action.pick.xy - right[0]
    carried = np.array([[math.cos(a), -math.sin(a)], [math.sin(a), math.cos(a)]]) @ beside
    ends = action.place.xy - carried
    return (
        1000 * float(np.linalg.norm(beside)),
        1000 * float(np.linalg.norm(ends - right[1])),
        abs(math.degrees(math.remainder(a - turn, math.tau))),
    )


def test_learns_where_the_box_and_its_slot_are_and_how_to_turn(taught, below):
    policy = load_policy(taught)
    found = np.array([errors(policy, number) for number in range(20)])
    pick_mm, place_mm, turn_deg = np.median(found, axis=0)
    below(
        "pick (mm)", pick_mm, 14
    )  # on the box, 40 mm wide: with so few steps the pick is the last to sharpen
    below("place (mm)", place_mm, 4)
    below("turn (deg)", turn_deg, 6)


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_plans_turn_with_the_scene(taught, below, quarters):
    policy = load_policy(taught)
    move = rigid_move(quarters * math.pi / 2, np.zeros(2), (96, 96))
    found = np.median([errors(policy, number, move) for number in range(20)], axis=0)
    for what, value, bound in zip(("pick (mm)", "place (mm)", "turn (deg)"), found, (14, 5, 8), strict=True):
        below(what, value, bound)


def test_plans_shift_with_the_scene(taught, below):
    """By whole cells of the coarsest scale, where only what comes in at the edges is new."""
    policy = load_policy(taught)
    color, height, _ = box_scene(
        np.random.default_rng([1000, 0]), grid=Grid(GRID.x, GRID.y, pixel_m=GRID.pixel_m)
    )
    large = Grid(x=(0.25, 0.6), y=(-0.15, 0.2), pixel_m=GRID.pixel_m)
    actions = []
    for by in (0, 16):
        colors = np.full((112, 112, 3), color[0, 0], np.uint8)
        heights = np.zeros((112, 112), np.float32)
        colors[by : by + 96, by : by + 96], heights[by : by + 96, by : by + 96] = color, height
        actions.append(policy.plan(Observation(colors, grid=large, height=heights)).action.to_array())
    shift = 16 * GRID.pixel_m
    moved = actions[1] - actions[0]
    below("pick and place (m)", np.abs(moved[[0, 1, 3, 4]] - shift).max(), 0.004)
    below("turn (deg)", abs(math.degrees(math.remainder(moved[5], math.tau))), 5)


def test_a_taught_policy_keeps_the_contract(taught):
    square = Goal(np.array([[20.0, 20.0], [40, 20], [40, 40], [20, 40]]))
    check_policy(load_policy(taught), ATTEMPTS[0].before, square, looks_at_goal=False)


@pytest.mark.parametrize(
    "changes",
    [pytest.param({"preset": "paper"}, marks=pytest.mark.slow), {"pick_yaw": True, "symmetry": 4}],
    ids=str,
)
def test_every_kind_trains_and_loads(tmp_path, changes):
    small = Grid(x=(0.25, 0.4), y=(0.0, 0.15), pixel_m=0.003125)
    attempts = [
        replace(
            attempt,
            before=Observation(
                np.ascontiguousarray(attempt.before.color[:48, :48]),
                grid=small,
                height=np.ascontiguousarray(attempt.before.height[:48, :48]),
            ),
            commanded=replace(
                attempt.commanded,
                pick=replace(attempt.commanded.pick, x=0.3, y=0.05),
                place=replace(attempt.commanded.place, x=0.35, y=0.1),
            ),
        )
        for attempt in ATTEMPTS[:4]
    ]
    few = None  # angles: of a crop each the published networks take a second

    if "preset" in changes:

        def few(shown):
            return TransporterRecipe(read_demonstrations(shown), TransporterOptions("paper", rotations=3))

    metrics = train(options(tmp_path, train=1, val=1, steps=1, **changes), attempts, few)
    assert metrics["labels"]["pick_error_cm"]["n"] == 2
    loaded = load_policy(tmp_path).network.config
    assert {name: getattr(loaded, name) for name in changes} == changes


@pytest.mark.parametrize(("given", "compared"), [(None, 1), (2, 2), (4, 4)])
def test_yaws_are_compared_modulo_the_symmetry_of_what_is_moved(tmp_path, given, compared):
    metrics = train(options(tmp_path, steps=1, symmetry=given), ATTEMPTS)
    policy = load_policy(tmp_path)
    val = [attempt for attempt in ATTEMPTS if attempt.attempt_id in policy.training["split"]["val"]]
    assert metrics["labels"] == plan_errors(policy, val, compared)["labels"]


@pytest.mark.parametrize(
    ("given", "recorded", "kept"),
    [
        (4, (2, 2), {"origin": "given", "things": [4], "all": 4}),
        (None, (2, 2), {"origin": "recorded", "things": [2], "all": 2}),
        (None, (4, 2), {"origin": "recorded", "things": [2, 4], "all": 2}),
    ],
)
def test_how_often_things_look_the_same_is_printed_and_kept(tmp_path, capsys, given, recorded, kept):
    attempts = [
        replace(attempt, object_symmetry=recorded[number % 2]) for number, attempt in enumerate(ATTEMPTS[:16])
    ]
    train(options(tmp_path, train=4, val=0, steps=1, symmetry=given), attempts)
    assert load_policy(tmp_path).training["symmetry"] == kept
    said = " ".join(capsys.readouterr().err.split())
    assert f"the same {kept['things'][0]} times a turn" in said
    assert f"(symmetry {kept['origin']})" in said
    # An older version kept it nowhere: its run goes on.
    config = (tmp_path / "config.yaml").read_text()
    older = yaml.safe_load(config)
    del older["training"]["symmetry"]
    known = ("preset", "rotations", "symmetry", "pick_yaw", "orders")
    older["model"]["network"] = {name: older["model"]["network"][name] for name in known}
    (tmp_path / "config.yaml").write_text(yaml.safe_dump(older))
    train(options(tmp_path, train=4, val=0, steps=1, symmetry=given), attempts)


def test_what_an_older_version_finished_is_found_finished(tmp_path, monkeypatch, capsys):
    """It took another number of steps unless one was given; another number that was given is another training."""
    monkeypatch.setattr(TransporterRecipe, "steps_before", 2)
    train(options(tmp_path / "older", steps=2), ATTEMPTS)
    assert train(options(tmp_path / "older", steps=None), ATTEMPTS)["steps"] == 2
    assert "finished" in capsys.readouterr().err
    train(options(tmp_path / "other", steps=1), ATTEMPTS)
    with pytest.raises(DataError, match="other options or data"):
        train(options(tmp_path / "other", steps=None), ATTEMPTS)


@pytest.mark.parametrize(("preset", "shadowed"), [("paper", False), ("fast", True)])
def test_the_published_recipe_casts_no_shadows(preset, shadowed):
    """Of a map in which light varies by a gain for each channel alone, pixels alike stay alike."""
    shown = box_demonstrations(1, 0, grid=GRID)
    flat = replace(shown, colors=np.full_like(shown.colors, 120))
    choices = TransporterOptions(preset, rotations=3, rearranged=0.0, batch=8, moves=Moves(0.0))
    colors = TransporterRecipe(flat, choices).batch(np.random.default_rng(0))["color"]
    assert bool((colors.flatten(2).amax(dim=2) > colors.flatten(2).amin(dim=2)).any()) == shadowed


def test_an_interrupted_training_ends_in_the_same_weights(tmp_path, monkeypatch):
    train(options(tmp_path / "whole"), ATTEMPTS)
    learn, calls = TransporterRecipe.loss, []

    def stopping(self, network, batch):
        calls.append(1)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return learn(self, network, batch)

    monkeypatch.setattr(TransporterRecipe, "loss", stopping)
    with pytest.raises(KeyboardInterrupt):
        train(options(tmp_path / "cut", save_every_s=0.0), ATTEMPTS)
    assert torch.load(tmp_path / "cut" / "resume.pt", weights_only=True)["step"] == 2
    monkeypatch.setattr(TransporterRecipe, "loss", learn)
    train(options(tmp_path / "cut", save_every_s=0.0), ATTEMPTS)
    cut, whole = (load_policy(tmp_path / name).network.state_dict() for name in ("cut", "whole"))
    assert all(torch.equal(cut[name], whole[name]) for name in whole)


# --- what it learns from


@given(st.integers(1, 5), st.integers(0, 3), st.integers(0, 100))
def test_no_episode_is_split(train_on, val, seed):
    rng = np.random.default_rng(seed)
    lengths = rng.integers(1, 4, 10)
    episodes = np.repeat(np.arange(10), lengths)
    attempts = [replace(ATTEMPTS[i], episode=int(e), reward=None) for i, e in enumerate(episodes)]
    split = split_episodes(attempts, train_on, val)
    first, next_ones = ({attempt.episode for attempt in part} for part in (split.train, split.val))
    assert (len(first), len(next_ones)) == (train_on, val)
    assert not first & next_ones
    assert len(split.train) + len(split.val) == lengths[: train_on + val].sum()


def test_only_episodes_that_did_their_task_teach_and_of_them_what_succeeded():
    unfinished = replace(ATTEMPTS[1], reward=0.25)
    missed = replace(ATTEMPTS[2], outcome=replace(ATTEMPTS[2].outcome, failure="missed-grasp"))
    split = split_episodes([ATTEMPTS[0], unfinished, missed, *ATTEMPTS[3:8]], 2, 1)
    assert [attempt.attempt_id for attempt in split.train] == [3, 4, 5]
    assert [attempt.attempt_id for attempt in split.val] == [6, 7]
    assert all(attempt.before.height is not None for attempt in split.train)


def test_an_attempt_of_no_episode_stands_alone():
    split = split_episodes([replace(attempt, episode=None, reward=None) for attempt in ATTEMPTS[:5]], 3, 2)
    assert (len(split.train), len(split.val)) == (3, 2)


def test_goals_are_painted_where_all_attempts_show_one():
    box = np.array([[20.0, 20], [30, 20], [30, 30], [20, 30]])
    with_goals = [replace(attempt, box_after=box) for attempt in ATTEMPTS[:2]]
    shown = read_demonstrations(with_goals)
    assert shown.goal_input is not None
    assert shown.colors[0, 25, 25].tolist() == [0, 200, 0]
    assert read_demonstrations(ATTEMPTS[:2]).goal_input is None
    with pytest.raises(DataError, match="a goal in every attempt or in none"):
        read_demonstrations([with_goals[0], ATTEMPTS[1]])


def test_symmetries_are_searched_as_far_as_all_have_them():
    for symmetries, common in (([4, 4], 4), ([4, 2], 2), ([4, 1], 1), ([0, 4], 4), ([0, 0], 0)):
        shown = replace(box_demonstrations(2, 0, grid=GRID), symmetry=np.array(symmetries))
        assert shown.common_symmetry == common
        assert TransporterRecipe(shown).policy.network.config.symmetry == common


def test_demonstrations_have_the_symmetry_that_each_says_unless_all_are_given_one():
    said = [replace(ATTEMPTS[0], object_symmetry=2), replace(ATTEMPTS[1], object_symmetry=0), ATTEMPTS[2]]
    assert read_demonstrations(said).symmetry.tolist() == [2, 0, 1]
    assert read_demonstrations(said, 4).symmetry.tolist() == [4, 4, 4]


def test_unfit_demonstrations_are_one_clear_line():
    camera = replace(ATTEMPTS[0], before=Observation(ATTEMPTS[0].before.color))
    other = replace(ATTEMPTS[1], before=replace(ATTEMPTS[1].before, grid=replace(GRID, z=(0.0, 0.5))))
    far = SHOWN.poses.copy()
    far[3, 0] = 0.9
    for make, message in (
        (lambda: read_demonstrations([]), "at least one attempt"),
        (lambda: read_demonstrations([camera]), "pictures from straight above"),
        (lambda: read_demonstrations([ATTEMPTS[0], other]), "over one grid"),
        (lambda: replace(SHOWN, poses=far), "demonstration 3 goes from"),
        (lambda: replace(SHOWN, heights=SHOWN.heights[:2]), "expected heights of shape"),
        (lambda: replace(SHOWN, symmetry=np.full(6, -1)), "symmetries of 0"),
        (lambda: split_episodes(ATTEMPTS[:4], 2, 1), "recording has 2"),
        (lambda: split_episodes(ATTEMPTS, 0, 1), "at least 1"),
    ):
        with pytest.raises(DataError, match=message) as error:
            make()
        assert "\n" not in str(error.value)
