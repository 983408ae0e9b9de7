"""What was as right as a step, told from the height maps of its episode; and errors of plans by what they carry."""

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from baggie.data import Dataset, DatasetWriter, open_dataset
from baggie.evaluation import validate as module
from baggie.evaluation.choices_of_scene import Done, replayed
from baggie.evaluation.predictions import Prediction
from baggie.evaluation.scored_plans import (
    CarriedStep,
    MapChoices,
    choices_of_episode,
    choices_of_maps,
    rates_that_count,
    stages_of,
    with_what_was_carried,
)
from baggie.evaluation.validate import validate
from baggie.geometry import Grid, PlanarPose, planar_pose, wrap_angle
from baggie.learning.demonstrations import carried_in
from baggie.learning.split import with_after
from baggie.learning.symmetry import turn_onto
from baggie.learning.train import plan_errors
from baggie.metrics import action_errors, success_rate
from baggie.options.evaluating import ValidateOptions
from baggie.registry import TASKS
from baggie.seeds import STYLE, generator
from baggie.tasks.conditions import Score, State
from baggie.tasks.demonstrator import varied_action
from baggie.types import Attempt, Observation, Outcome, PickPlace, Plan
from helpers.ideal_arm import away, carried, poses_of

GRID = Grid(x=(0.25, 0.75), y=(-0.25, 0.25), pixel_m=0.003125)
NOWHERE = np.full((4, 2), np.nan)
HEIGHT_M = 0.04
TABLE = (120, 105, 90)


def box(length: float, width: float) -> np.ndarray:
    """`(4, 2)` metres: a rectangle about its middle."""
    return np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * [length / 2, width / 2]


SQUARE, LONG, PLATE = box(0.04, 0.04), box(0.08, 0.035), box(0.12, 0.1)
ELL = np.array([[0, 0], [8, 0], [8, 4], [4, 4], [4, 8], [0, 8]]) / 100 - [10 / 300, 10 / 300]
"""About its middle, the mean of three squares."""
DISC = 0.025 * np.c_[np.cos(a := np.linspace(0, 2 * math.pi, 60, endpoint=False)), np.sin(a)]
SYMMETRY = {id(SQUARE): 4, id(LONG): 2, id(PLATE): 2, id(ELL): 1, id(DISC): 0}


@dataclass(frozen=True)
class Move:
    """A thing, by number, picked `at` a point of its frame and put where its frame is `to`."""

    thing: int
    to: PlanarPose
    at: tuple[float, float] = (0.0, 0.0)
    right: bool = True


def action_of(stands: PlanarPose, to: PlanarPose, at: Sequence[float] = (0.0, 0.0)) -> PickPlace:
    """Picked at a point of its frame, with the cup at yaw 0, so that a thing at `stands` comes to lie at `to`."""
    pick = replace(stands @ PlanarPose(*at), yaw=0.0)
    return PickPlace(pick, to @ stands.inverse() @ pick)


def drawn(things: Sequence[tuple[np.ndarray, PlanarPose]]) -> np.ndarray:
    """A height map of outlines `(N, 2)` at their poses, each on what is below it."""
    height = np.zeros(GRID.shape, np.float32)
    for outline, pose in things:
        corners = GRID.to_pixels((np.c_[outline, np.ones(len(outline))] @ pose.matrix().T)[:, :2])
        mask = np.zeros(GRID.shape, np.uint8)
        cv2.fillPoly(mask, [np.round(corners * 16).astype(np.int32)], 1, cv2.LINE_8, 4)
        height[mask > 0] = height[mask > 0].max(initial=0.0) + HEIGHT_M
    return height


def shown(
    outlines: Sequence[np.ndarray], poses: Sequence[PlanarPose], moves: Sequence[Move]
) -> list[Attempt]:
    """An episode; what was moved last is on top. Wasted steps earn nothing."""
    there, order, maps, attempts = dict(enumerate(poses)), list(range(len(poses))), [], []
    for move in moves:
        maps.append(drawn([(outlines[number], there[number]) for number in order]))
        action = action_of(there[move.thing], move.to, move.at)
        there[move.thing] = move.to
        order = [number for number in order if number != move.thing] + [move.thing]
        attempts.append(action)
    maps.append(drawn([(outlines[number], there[number]) for number in order]))
    color = np.full((*GRID.shape, 3), TABLE, np.uint8)
    share = 1 / sum(move.right for move in moves)
    seen = [Observation(color, grid=GRID, height=height) for height in maps]
    return [
        Attempt(
            step, "build", seen[step], seen[step + 1], action, Outcome(action), NOWHERE, NOWHERE,
            episode=0, step=step, reward=share if move.right else 0.0,
        )
        for step, (action, move) in enumerate(zip(attempts, moves, strict=True))
    ]  # fmt: skip


def steps_of(
    outlines: Sequence[np.ndarray], poses: Sequence[PlanarPose], moves: Sequence[Move]
) -> list[CarriedStep]:
    steps = []
    for attempt, move in zip(shown(outlines, poses, moves), moves, strict=True):
        thing = carried_in(attempt)
        assert thing is not None
        steps.append(CarriedStep(attempt, thing, SYMMETRY[id(outlines[move.thing])], move.right))
    return steps


def counts(choices: MapChoices, planned: PickPlace) -> bool:
    return choices.pick_counts(planned) and choices.place_counts(planned)


# --- stages

CORNERS = [PlanarPose(x, y, yaw) for x, y, yaw in ((0.3, -0.2, 0.4), (0.3, 0.0, -0.7), (0.3, 0.2, 1.0))]
FURTHER = [PlanarPose(x, y, yaw) for x, y, yaw in ((0.4, -0.19, 2.0), (0.4, 0.01, -0.1), (0.4, 0.18, 0.9))]
BASE = PlanarPose(0.62, 0.0, 0.3)
PYRAMID = [BASE @ PlanarPose(0.0, 0.05 * y) for y in (-1, 0, 1, -0.5, 0.5, 0)]


def pyramid(
    order: Sequence[int] = range(6), seed: int = 0, turned: float = 0.0
) -> tuple[list[PlanarPose], list[Move]]:
    rng = np.random.default_rng(seed)
    poses = [PlanarPose(p.x, p.y, p.yaw + rng.uniform(-3, 3)) for p in (*CORNERS, *FURTHER)]
    places = [BASE @ PlanarPose(0.0, 0.0, turned) @ BASE.inverse() @ slot for slot in PYRAMID]
    return poses, [Move(number, places[number], tuple(rng.uniform(-0.015, 0.015, 2))) for number in order]


def stages(outlines: Sequence[np.ndarray], poses: Sequence[PlanarPose], moves: Sequence[Move]) -> list[int]:
    return stages_of([step.carried for step in steps_of(outlines, poses, moves)])


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10**6), st.permutations([0, 1, 2]), st.permutations([3, 4]))
def test_rows_of_a_pyramid_are_stages_in_whatever_order_and_however_turned_they_are_built(seed, low, middle):
    yaw = np.random.default_rng(seed).uniform(-1.0, 1.0)
    poses, moves = pyramid([*low, *middle, 5], seed, yaw)
    assert stages([SQUARE] * 6, poses, moves) == [1, 1, 1, 2, 2, 3]


def test_a_block_that_rests_on_two_may_be_put_before_the_third():
    poses, moves = pyramid([0, 1, 3, 2, 4, 5])
    assert stages([SQUARE] * 6, poses, moves) == [1, 1, 2, 1, 2, 3]


def test_what_touches_side_by_side_is_one_stage():
    poses, row = [*CORNERS, *FURTHER], [BASE @ PlanarPose(0.0, 0.04 * y) for y in (-1, 0, 1)]
    assert stages([SQUARE] * 6, poses, [Move(n, to) for n, to in enumerate(row)]) == [1, 1, 1]


def test_what_is_picked_again_or_uncovered_or_put_where_another_was_comes_later():
    free, beside = PlanarPose(0.6, -0.15, 0.2), PlanarPose(0.6, 0.15, -0.3)
    poses = [CORNERS[0], replace(CORNERS[0], yaw=1.0), CORNERS[1]]  # one on another, and one by itself
    outlines = [PLATE, SQUARE, SQUARE]
    assert stages(outlines, poses, [Move(1, free), Move(0, beside)]) == [1, 2]
    assert stages(outlines, poses, [Move(1, free), Move(2, beside)]) == [1, 1]
    assert stages(outlines, poses, [Move(1, free), Move(1, beside)]) == [1, 2]
    assert stages(outlines, poses, [Move(2, free), Move(1, CORNERS[1])]) == [1, 2]


# --- what counts

on_it = st.tuples(st.floats(-0.015, 0.015), st.floats(-0.015, 0.015))
ways = st.floats(-math.pi, math.pi)
misses = st.tuples(st.integers(0, 3), ways, st.sampled_from([-1, 1]))
"""A turn that looks the same, and to which side it goes wrong."""


@functools.cache
def pyramid_choices(seed: int) -> tuple[list[PlanarPose], list[Move], list[MapChoices]]:
    poses, moves = pyramid(seed=seed)
    return poses, moves, list(choices_of_episode(steps_of([SQUARE] * 6, poses, moves)).values())


@settings(deadline=None)
@given(st.integers(0, 2), st.data(), on_it, misses)
def test_any_thing_of_the_stage_held_anywhere_counts_in_any_of_its_slots(seed, data, at, miss):
    (poses, _, choices), (alike, way, sign) = pyramid_choices(seed), miss
    step = data.draw(st.integers(0, 5))
    stage = next(range(*each) for each in ((0, 3), (3, 5), (5, 6)) if step in range(*each))
    thing, slot = data.draw(st.integers(step, stage[-1])), data.draw(st.integers(step, stage[-1]))

    def placed(metres: float, degrees: float) -> PickPlace:
        to = PYRAMID[slot]
        ends = PlanarPose(
            to.x + metres * math.cos(way),
            to.y + metres * math.sin(way),
            to.yaw + alike * math.pi / 2 + sign * math.radians(degrees),
        )
        return action_of(poses[thing], ends, at)

    assert counts(choices[step], placed(0.0, 0.0))
    assert choices[step].place_counts(placed(0.005, 0.0))
    assert not choices[step].place_counts(placed(0.015, 0.0))
    # From pixels of 3 mm the turn between two such blocks is told to some degrees.
    within, beyond = (14.0, 16.0) if thing == slot else (7.0, 23.0)
    assert choices[step].place_counts(placed(0.0, within))
    assert not choices[step].place_counts(placed(0.0, beyond))


def test_things_and_slots_of_another_stage_and_those_that_are_done_do_not_count():
    poses, moves, choices = pyramid_choices(0)
    now = [*poses]
    for step, move in enumerate(moves):
        stage = next(each for each in ((0, 1, 2), (3, 4), (5,)) if step in each)
        for other in range(6):
            on_other = action_of(now[other], move.to)
            assert choices[step].pick_counts(on_other) is (other in stage and other >= step)
            free = any(PYRAMID[other].distance(PYRAMID[each]) < 0.01 for each in stage if each >= step)
            assert choices[step].place_counts(action_of(poses[step], PYRAMID[other])) is free
        now[move.thing] = move.to


def test_a_pick_counts_on_the_thing_and_within_a_pixel_of_it():
    poses, _, choices = pyramid_choices(1)
    slot, half = PYRAMID[0], 0.02
    for way in range(4):
        at = PlanarPose(0, 0, way * math.pi / 2)
        inside, beside = (at @ PlanarPose(half + off, 0.0) for off in (-0.002, 0.008))
        assert choices[0].pick_counts(action_of(poses[0], slot, inside.xy))
        assert not choices[0].pick_counts(action_of(poses[0], slot, beside.xy))
    assert not choices[0].pick_counts(PickPlace(PlanarPose(0.5, -0.1), slot))  # the table


def test_where_something_else_covers_a_thing_a_pick_does_not_count():
    """A block that a wasted step takes off a plate: until then it hides that part of it."""
    hiding = CORNERS[0] @ PlanarPose(0.03, 0.02)
    poses = [CORNERS[0], hiding, CORNERS[2]]
    moves = [
        Move(2, PlanarPose(0.55, 0.15, 0.3)),
        Move(1, PlanarPose(0.45, 0.02), right=False),
        Move(0, PlanarPose(0.6, -0.1, 0.7), at=(-0.03, 0.0)),
    ]
    first, last = choices_of_episode(steps_of([PLATE, SQUARE, SQUARE], poses, moves)).values()
    covered, free = ((0.03, 0.02), True), ((-0.03, -0.02), False)
    for at, hidden in (covered, free):
        plan = action_of(poses[0], moves[2].to, at)
        assert first.pick_counts(plan) is not hidden
        assert first.place_counts(plan)
        assert counts(last, plan)


def test_what_a_wasted_step_put_aside_counts_where_it_is_at_the_time():
    aside, slots = PlanarPose(0.5, 0.1, -0.4), [PlanarPose(0.65, y, 0.2) for y in (-0.1, 0.1)]
    moves = [Move(0, slots[0]), Move(1, aside, (0.01, 0.0), right=False), Move(1, slots[1])]
    steps = steps_of([ELL, ELL, SQUARE], CORNERS, moves)
    found = choices_of_episode(steps)
    assert list(found) == [0, 2]  # nothing is said of the wasted one
    first, last = found.values()
    for slot in slots:
        assert counts(first, action_of(CORNERS[1], slot, (-0.01, 0.0)))
    assert not first.pick_counts(action_of(aside, slots[1]))
    assert counts(last, action_of(aside, slots[1]))
    assert not last.pick_counts(action_of(CORNERS[1], slots[1]))


def test_what_a_wasted_step_put_on_a_thing_and_took_off_again_is_not_that_thing():
    off = PlanarPose(0.45, 0.02)
    moves = [
        Move(2, PlanarPose(0.55, 0.15, 0.3)),
        Move(1, CORNERS[0] @ PlanarPose(0.0, 0.01), right=False),
        Move(1, off, right=False),
        Move(0, PlanarPose(0.6, -0.1, 0.7), at=(-0.03, 0.0)),
    ]
    poses = [CORNERS[0], FURTHER[1], CORNERS[2]]
    first, last = choices_of_episode(steps_of([PLATE, SQUARE, SQUARE], poses, moves)).values()
    for choices in (first, last):
        assert counts(choices, action_of(poses[0], moves[3].to))
    assert not first.pick_counts(action_of(poses[1], moves[3].to))


SLOTS = [PlanarPose(0.62, -0.12, 0.4), PlanarPose(0.62, 0.02, -1.1), PlanarPose(0.62, 0.16, 2.0)]


@settings(max_examples=15, deadline=None)
@given(st.permutations([SQUARE, LONG, ELL, DISC]), st.lists(ways, min_size=3, max_size=3), st.booleans())
def test_a_thing_may_take_the_slot_of_another_where_their_outlines_are_the_same(shapes, yaws, twins):
    outlines = [shapes[0], shapes[0] if twins else shapes[1], shapes[2]]
    poses = [replace(pose, yaw=yaw) for pose, yaw in zip(CORNERS, yaws, strict=True)]
    choices = choices_of_episode(steps_of(outlines, poses, [Move(n, slot) for n, slot in enumerate(SLOTS)]))
    for thing, own in enumerate(outlines):
        for slot, other in zip(SLOTS, outlines, strict=True):
            assert counts(choices[0], action_of(poses[thing], slot)) is (own is other)
            fold = SYMMETRY[id(own)]
            # 15 degrees count, and how two things are turned to each other is told to 4.5.
            turned = replace(slot, yaw=slot.yaw + math.radians(25.0))
            assert choices[0].place_counts(action_of(poses[thing], turned)) is (own is other and fold == 0)
            alike = replace(slot, yaw=slot.yaw + 2 * math.pi / max(fold, 1))
            assert choices[0].place_counts(action_of(poses[thing], alike)) is (own is other)


def test_two_things_are_compared_once_however_many_steps_are_left(monkeypatch):
    """It is what takes the time: else it would grow with the cube of how many things there are."""
    compared = []

    def counted(mask, other, symmetry):
        compared.append((mask.tobytes(), other.tobytes()))
        return turn_onto(mask, other, symmetry)

    monkeypatch.setattr("baggie.evaluation.scored_plans.turn_onto", counted)
    poses = [PlanarPose(0.3 + 0.1 * (n // 4), -0.2 + 0.1 * (n % 4), 0.3 * n) for n in range(5)]
    moves = [Move(n, PlanarPose(0.6 + 0.07 * (n // 4), -0.2 + 0.1 * (n % 4), 0.1)) for n in range(5)]
    choices = choices_of_episode(steps_of([SQUARE] * 5, poses, moves)).values()
    assert [len(each.things) for each in choices] == [5, 4, 3, 2, 1]
    assert len(compared) == len(set(compared)) == 5 * 4


def mask_of(outline: np.ndarray, pose: PlanarPose) -> np.ndarray:
    return drawn([(outline, pose)]) > 0


@given(st.sampled_from([SQUARE, LONG, ELL, DISC]), ways, ways)
def test_the_turn_between_two_of_a_kind_is_told_modulo_symmetry(outline, yaw, other):
    turn = turn_onto(
        mask_of(outline, PlanarPose(0.4, -0.1, yaw)),
        mask_of(outline, PlanarPose(0.6, 0.1, other)),
        SYMMETRY[id(outline)],
    )
    assert turn is not None
    if outline is not DISC:
        period = 2 * math.pi / SYMMETRY[id(outline)]
        assert abs(wrap_angle(turn - (other - yaw), period)) < math.radians(9.0)


def test_an_outline_that_looks_alike_more_often_than_its_thing_does_not_tell_the_turn():
    """A square with a mark on it."""
    one, other = (mask_of(SQUARE, PlanarPose(0.4, y)) for y in (-0.1, 0.1))
    assert turn_onto(one, other, 4) is not None
    assert turn_onto(one, other, 1) is None
    assert turn_onto(one, mask_of(LONG, PlanarPose(0.4, 0.0)), 1) is None


# --- against the scene itself

RAVENS = Grid()


def seen_from_above(scene, poses) -> Observation:
    height, color = np.zeros(RAVENS.shape, np.float32), np.full((*RAVENS.shape, 3), TABLE, np.uint8)
    pixels = np.argwhere(np.ones(RAVENS.shape))[:, ::-1]
    for block in scene.blocks:
        covers = (away(block, poses, RAVENS.to_robot(pixels)) == 0.0).reshape(RAVENS.shape)
        height[covers] = np.maximum(height[covers], poses[block.name][2, 3] + block.size_m[2] / 2)
    return Observation(color, grid=RAVENS, height=height)


@pytest.mark.parametrize("name", ["block-pyramid", "block-insertion", "place-red-in-green"])
def test_maps_say_of_any_plan_what_the_scene_says(name):
    """Where neither the scene nor a map is at the edge of what counts; of slots that stay free maps know nothing."""
    scene, rng = TASKS[name].draw(np.random.default_rng(3)), np.random.default_rng(5)
    there, score, done, attempts, stood = poses_of(scene), Score(scene.conditions), [], [], []
    while (action := varied_action(scene, State.of(there), generator(STYLE, 8, 0, len(done)))) is not None:
        after = carried(action, scene, there)
        earned = score.count(State.of(after))
        done.append(Done(action, None, earned))
        stood.append(there)
        seen = (seen_from_above(scene, poses) for poses in (there, after))
        attempts.append(
            Attempt(
                len(done) - 1, "build", *seen, action, Outcome(action), NOWHERE, NOWHERE,
                episode=0, step=len(done) - 1, reward=earned,
            )
        )  # fmt: skip
        there = after
    symmetry, slots_left_over = scene.conditions[0].symmetry, name == "place-red-in-green"
    things = [carried_in(attempt) for attempt in attempts]
    assert all(things)
    by_maps = choices_of_episode(
        [
            CarriedStep(attempt, thing, symmetry, attempt.reward > 0)
            for attempt, thing in zip(attempts, things, strict=True)
            if thing is not None
        ]
    )
    picks, places = [0, 0], [0, 0]
    for step, by_scene in enumerate(replayed(scene, done)):
        assert counts(by_maps[step], done[step].executed)
        for _ in range(60):
            block = scene.blocks[rng.integers(len(scene.blocks))]
            pose = planar_pose(stood[step][block.name])
            slot = by_scene.slots[rng.integers(len(by_scene.slots))]
            off, turned = rng.choice([0.0, 0.006, 0.015, 0.03]), math.radians(rng.choice([0, -8, 22]))
            ends = slot @ PlanarPose(off, 0.0, turned + rng.integers(4) * math.pi / 2)
            plan = action_of(pose, ends, rng.uniform(-0.012, 0.012, 2))
            pick = by_scene.pick_counts(plan)
            assert by_maps[step].pick_counts(plan) is pick
            picks[pick] += 1
            if pick:
                place = by_scene.place_counts(plan)
                told = by_maps[step].place_counts(plan)
                assert told is place or (not told and slots_left_over)
                places[place] += 1
    assert min(places) > 5
    assert min(picks) > 10 or len(scene.blocks) == 1


# --- recordings


def recorded(root: Path, attempts: Sequence[Attempt], **collection: object) -> Dataset:
    rows, columns = GRID.shape
    settings = {"task": "build", "robot_type": "drawn", "picture_size": (columns, rows)}
    with DatasetWriter(root, collection={"cell": 0, **collection}, **settings) as writer:
        for attempt in attempts:
            writer.append(attempt)
    return open_dataset(root)


def predictions(attempts: Sequence[Attempt]) -> list[Prediction]:
    """What the demonstrator did."""
    return [
        Prediction(each.attempt_id, each.commanded, {"labels": each.commanded}, 1.0, symmetry=1)
        for each in attempts
    ]


@pytest.fixture(scope="module")
def episode() -> list[Attempt]:
    """Two L's and a wasted step, which misses; each map is recorded once."""
    moves = [
        Move(0, SLOTS[0], (-0.02, -0.02)),
        Move(2, CORNERS[2], right=False),
        Move(1, SLOTS[1], (-0.02, 0.03)),
    ]
    attempts = shown([ELL, ELL, SQUARE], CORNERS, moves)
    return [*(replace(attempt, after=None) for attempt in attempts[:-1]), attempts[-1]]


def test_the_demonstrator_counts_and_so_does_another_order(tmp_path, episode):
    dataset = recorded(tmp_path / "a", episode, ravens="assembling-kits-train")
    own = predictions(episode)
    assert rates_that_count(dataset, own) == dict.fromkeys(("pick", "place", "both"), success_rate(2, 2))
    swapped = [replace(own[0], action=action_of(CORNERS[1], SLOTS[0])), own[1], replace(own[2], action=None)]
    assert rates_that_count(dataset, swapped)["both"] == success_rate(1, 2)
    beside = [replace(own[0], action=replace(episode[0].commanded, pick=PlanarPose(0.5, 0.0)))]
    assert rates_that_count(dataset, beside)["pick"] == success_rate(0, 1)
    assert rates_that_count(dataset, []) == {}
    assert rates_that_count(dataset, [own[1]]) == {}


def test_nothing_is_said_of_what_did_not_do_its_task_nor_of_maps_without_heights(tmp_path, episode):
    failed = [replace(each, reward=0.0) for each in episode]
    assert rates_that_count(recorded(tmp_path / "failed", failed), predictions(failed)) == {}
    flat = [replace(each, before=Observation(each.before.color), after=None) for each in episode]
    dataset = recorded(tmp_path / "flat", flat)
    assert choices_of_maps(dataset, dataset.attempt_ids.tolist()) == {}
    assert with_what_was_carried(dataset, predictions(flat)) == predictions(flat)


def test_an_attempt_that_stands_alone_is_an_episode_of_one_step(tmp_path):
    first, second = (
        replace(shown([ELL], [CORNERS[n]], [Move(0, SLOTS[n])])[0], attempt_id=n, episode=None, reward=None)
        for n in range(2)
    )
    dataset = recorded(tmp_path / "alone", [first, second])
    assert rates_that_count(dataset, predictions([first, second]))["both"] == success_rate(2, 2)
    other = [replace(predictions([first])[0], action=action_of(CORNERS[0], SLOTS[1]))]
    assert rates_that_count(dataset, other)["place"] == success_rate(0, 1)


def test_what_a_thing_looks_like_is_found_unless_the_recording_says_it(tmp_path):
    attempts = shown([SQUARE], CORNERS[:1], [Move(0, SLOTS[0])])
    turned = replace(SLOTS[0], yaw=SLOTS[0].yaw + math.pi / 2)
    plan = [replace(predictions(attempts)[0], action=action_of(CORNERS[0], turned, (0.01, 0.01)))]
    assert rates_that_count(recorded(tmp_path / "found", attempts), plan)["both"]["rate"] == 1.0
    said = [replace(each, object_symmetry=1) for each in attempts]
    assert rates_that_count(recorded(tmp_path / "said", said), plan)["both"]["rate"] == 0.0


# --- errors against the labels


@given(st.builds(PlanarPose, ways, ways, ways), st.builds(PlanarPose, ways, ways, ways), on_it, on_it, ways)
def test_a_place_is_right_however_the_thing_is_held_and_whichever_turn_that_looks_the_same(
    stands, to, at, other, off
):
    right, turned = action_of(stands, to, at), replace(to, yaw=to.yaw + math.pi / 2)
    assert action_errors(action_of(stands, turned, other), right, 4, stands) == pytest.approx(
        {
            "pick_error_cm": 100 * math.dist(at, other),
            "place_error_cm": 0.0,
            "pick_yaw_error_deg": 0.0,
            "place_yaw_error_deg": 0.0,
            "turn_error_deg": 0.0,
        },
        abs=1e-5,
    )
    moved = PlanarPose(to.x + off, to.y, to.yaw)
    assert action_errors(action_of(stands, moved, other), right, 4, stands)[
        "place_error_cm"
    ] == pytest.approx(100 * abs(off))


def test_places_are_compared_by_the_thing_where_a_plan_picks_it(tmp_path, episode):
    dataset = recorded(tmp_path / "a", episode)
    by_the_middle, _, _ = predictions(episode)
    by_the_middle = replace(by_the_middle, action=action_of(CORNERS[0], SLOTS[0]))
    another = replace(by_the_middle, action=action_of(CORNERS[1], SLOTS[0]))
    known, elsewhere = with_what_was_carried(dataset, [by_the_middle, another])
    assert by_the_middle.errors()["labels"]["place_error_cm"] == pytest.approx(2.83, abs=0.01)
    assert known.errors()["labels"]["place_error_cm"] < 0.2
    assert known.stands is not None
    assert elsewhere.stands is None
    assert elsewhere.errors() == another.errors()


class ByTheMiddle:
    """Picks squares by their middles, as the demonstrator does not, and turns them as far as looks the same."""

    name = "transporter"

    def plan(self, observation, goal=None):
        yaw = SLOTS[0].yaw - math.pi / 2
        return Plan(action_of(CORNERS[0], replace(SLOTS[0], yaw=yaw)), views={"pick": observation.height})


def test_training_measures_places_as_validation_does(tmp_path, episode):
    first = replace(with_after(episode)[0], object_symmetry=4)
    trained = plan_errors(ByTheMiddle(), [first])["labels"]
    known = with_what_was_carried(recorded(tmp_path / "a", episode), predictions(episode))[0]
    plan = ByTheMiddle().plan(first.before).action
    validated = replace(known, action=plan, stands=carried_in(first).stood_at(plan.pick, first.before.grid))
    assert trained["place_error_cm"]["max"] == pytest.approx(validated.errors()["labels"]["place_error_cm"])
    assert trained["place_error_cm"]["max"] < 0.2
    elsewhere = plan_errors(ByTheMiddle(), [replace(first, after=None)])["labels"]
    assert elsewhere["place_error_cm"]["max"] == pytest.approx(
        2.83, abs=0.01
    )  # by the hand, as nothing tells


def test_validation_says_of_an_imported_recording_what_would_count(tmp_path, monkeypatch):
    attempts = shown([SQUARE], CORNERS[:1], [Move(0, SLOTS[0], (0.012, -0.012))])
    recorded(tmp_path / "data", attempts, ravens="block-train")
    monkeypatch.setattr(module, "open_policy", lambda *_: ByTheMiddle())
    metrics = validate(ValidateOptions("color-mask", tmp_path / "data", tmp_path / "out"))
    assert metrics["would_count"] == dict.fromkeys(("pick", "place", "both"), success_rate(1, 1))
    assert metrics["symmetry"] == 4
    labels = {key: value["max"] for key, value in metrics["labels"].items()}
    assert labels["pick_error_cm"] == pytest.approx(1.7, abs=0.01)
    assert labels["place_error_cm"] < 0.2
    assert labels["turn_error_deg"] == pytest.approx(0.0, abs=1e-6)
