"""Labels that were fused from several attempts: what they recover, and what they refuse to believe."""

import math
from dataclasses import replace

import numpy as np
import pytest

from baggie.data.summary import goal_of
from baggie.geometry import PlanarPose
from baggie.learning.augmentation import unchanged
from baggie.learning.samples import Labels
from baggie.policies.keypoint.heads import PlanarMap
from baggie.policies.planning import View
from baggie.types import PickPlace
from helpers.synthetic import WORKSPACE, box_corners, make_attempt, make_stacking

SIZE = (640, 360)
VIEW = View(SIZE, 0, 0, *SIZE, (160, 88))
PLAIN = make_attempt(0, np.random.default_rng(0), (64, 36), depth=False)


def sitting(count: int, seed: int = 0, eye_bias=(0.0, 0.0), landing_m: float = 0.004):
    """Attempts one after another with one bag: picks off by a bias of the eye, landings scattered; without pictures."""
    rng = np.random.default_rng(seed)

    def anywhere() -> PlanarPose:
        x, y = WORKSPACE.sample(rng, 0.02)
        return PlanarPose(float(x), float(y), float(rng.uniform(-0.2, 0.2)))

    bag, attempts = anywhere(), []
    for number in range(count):
        lands = anywhere()
        pick = PlanarPose(*(bag.xy + eye_bias + rng.normal(0, 0.0007, 2)), bag.yaw)
        release = PlanarPose(*(lands.xy + rng.normal(0, landing_m / math.sqrt(2), 2)), lands.yaw)
        attempts.append(
            replace(
                PLAIN,
                attempt_id=number,
                outcome=replace(PLAIN.outcome, executed=PickPlace(pick, release)),
                box_before=box_corners(bag, SIZE),
                box_after=box_corners(lands, SIZE),
                truth=replace(PLAIN.truth, before=bag, after=lands),
            )
        )
        bag = lands
    return attempts


def pick_errors(attempts, labels: Labels) -> np.ndarray:
    return labels.xy[:, 0] - [attempt.truth.before.xy for attempt in attempts]


def test_the_release_before_takes_half_of_what_the_eye_gets_wrong_everywhere():
    attempts = sitting(200, eye_bias=(0.003, -0.002))
    plain = Labels.of(attempts, VIEW, PlanarMap(), fuse=False)
    fused = Labels.of(attempts, VIEW, PlanarMap())
    assert np.linalg.norm(pick_errors(attempts, plain).mean(axis=0)) == pytest.approx(0.0036, abs=3e-4)
    assert np.linalg.norm(pick_errors(attempts, fused).mean(axis=0)) == pytest.approx(0.0018, abs=5e-4)
    assert fused.pairs == 199
    assert fused.systematic_m == pytest.approx(0.0036, abs=8e-4)


def test_without_a_bias_nothing_is_made_worse():
    for seed in range(3):
        attempts = sitting(200, seed)
        fused = Labels.of(attempts, VIEW, PlanarMap())
        assert np.linalg.norm(pick_errors(attempts, fused), axis=1).mean() < 0.0013


def test_attempts_that_do_not_follow_each_other_have_no_second_opinion():
    alone = [replace(attempt, attempt_id=2 * attempt.attempt_id) for attempt in sitting(30)]
    moved = [
        replace(attempt, box_before=attempt.box_before + 30.0) for attempt in sitting(30)
    ]  # by a person, in between
    assert Labels.of(alone, VIEW, PlanarMap()).pairs == 0
    assert Labels.of(moved, VIEW, PlanarMap()).pairs == 0


def test_what_lies_in_another_layer_is_another_object():
    """It is seen where the last one was put down: on it, or below it once that was taken away."""
    attempts = [replace(attempt, pick_layer=0, place_layer=0) for attempt in sitting(30)]
    attempts[10] = replace(attempts[10], pick_layer=1)
    attempts[20] = replace(attempts[20], place_layer=2)
    plain = Labels.of(sitting(30), VIEW, PlanarMap())
    labels = Labels.of(attempts, VIEW, PlanarMap())
    assert (plain.pairs, labels.pairs) == (29, 27)
    for number in (9, 20):  # nobody tells where these came to rest
        assert labels.weight[number, 1] < 0.2


def test_labels_of_stacks_say_their_layers_and_fit_the_map_to_them():
    attempts = make_stacking(60, 1, SIZE)
    to_robot = PlanarMap()
    labels = Labels.of(attempts, VIEW, to_robot)
    assert labels.layers.tolist() == [[a.pick_layer, a.place_layer] for a in attempts]
    assert labels.layers.max() == 2
    assert labels.counted.all()
    assert to_robot.knows_layers
    truth = np.array([(a.truth.before.xy, a.truth.after.xy) for a in attempts])
    assert np.linalg.norm(labels.xy - truth, axis=2).mean() < 0.003
    unknown = Labels.of(sitting(30), VIEW, to_robot)
    assert not unknown.counted.any()
    assert not unknown.layers.any()
    assert not to_robot.knows_layers


def test_places_are_where_the_next_pick_found_the_object():
    attempts = sitting(200, landing_m=0.006)
    truth = [attempt.truth.after.xy for attempt in attempts]
    errors = [
        np.linalg.norm(Labels.of(attempts, VIEW, PlanarMap(), fuse).xy[:, 1] - truth, axis=1)
        for fuse in (False, True)
    ]
    assert errors[0].mean() == pytest.approx(0.0053, abs=0.0006)
    assert errors[1][:-1].mean() < 0.0014
    weights = Labels.of(attempts, VIEW, PlanarMap()).weight[:, 1]
    assert weights[-1] < 0.2 < np.median(weights), "the last landing has nobody to tell of it"


@pytest.mark.parametrize(("what", "column"), [("pick", 0), ("place", 1)])
def test_a_label_that_does_not_fit_is_doubted_and_loses_its_weight(what, column):
    attempts = sitting(21)
    executed = attempts[20].outcome.executed
    poses = [executed.pick, executed.place]
    poses[column] = PlanarPose(poses[column].x + 0.05, poses[column].y, poses[column].yaw)
    attempts[20] = replace(attempts[20], outcome=replace(attempts[20].outcome, executed=PickPlace(*poses)))
    labels = Labels.of(attempts, VIEW, PlanarMap())
    assert (labels.outliers[0].attempt_id, labels.outliers[0].what) == (20, what)
    assert labels.outliers[0].off_mm == pytest.approx(50, abs=10)
    assert labels.weight[20, column] < 0.1
    assert np.median(labels.weight) == pytest.approx(1)


def test_a_hand_turned_otherwise_than_the_object_does_not_teach_yaw():
    attempts = sitting(40)
    pick = attempts[7].outcome.executed.pick
    wrong = PickPlace(replace(pick, yaw=pick.yaw + 0.5), attempts[7].outcome.executed.place)
    attempts[7] = replace(attempts[7], outcome=replace(attempts[7].outcome, executed=wrong))
    weights = Labels.of(attempts, VIEW, PlanarMap()).yaw_weight
    assert weights[7] == 0
    assert weights.sum() == len(attempts) - 1


def test_long_things_are_told_from_square_ones():
    attempts = sitting(40)
    corners = goal_of(attempts[3]).corners
    longer = corners.mean(axis=0) + (corners - corners.mean(axis=0)) * [1.6, 1.0]
    attempts[3] = replace(attempts[3], box_before=longer)
    assert Labels.of(attempts, VIEW, PlanarMap()).symmetry.tolist() == [4] * 3 + [2] + [4] * 36


def test_what_an_attempt_says_of_its_object_counts_and_not_how_it_looks():
    attempts = sitting(40)
    for number, symmetry in ((3, 2), (4, 0), (5, 4)):
        attempts[number] = replace(attempts[number], object_symmetry=symmetry)
    corners = attempts[5].box_before
    longer = corners.mean(axis=0) + (corners - corners.mean(axis=0)) * [1.6, 1.0]
    attempts[5] = replace(attempts[5], box_before=longer)  # squeezed, say
    labels = Labels.of(attempts, VIEW, PlanarMap())
    assert labels.symmetry.tolist() == [4] * 3 + [2, 0] + [4] * 35
    drawn = [unchanged(0.3, int(symmetry)).phases for symmetry in labels.symmetry[3:6]]
    assert drawn == [(1.0, 1.0), (0.0, 0.0), (1.0, 0.0)]
