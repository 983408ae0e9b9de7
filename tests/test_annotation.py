from dataclasses import replace

import numpy as np
import pytest

from baggie.data.summary import goal_of, is_demonstration
from baggie.errors import DataError
from baggie.vision.draw import paint_goal
from helpers.synthetic import make_attempt


@pytest.fixture
def attempt():
    return make_attempt(3, np.random.default_rng(3), (320, 180), depth=False)


def test_goal_is_where_the_bag_came_to_rest(attempt):
    assert np.array_equal(goal_of(attempt).corners, attempt.box_after)


def test_the_recording_is_never_painted(attempt):
    before = attempt.before.color.copy()
    painted = paint_goal(attempt.before.color, goal_of(attempt))
    assert not np.array_equal(painted, before)
    assert np.array_equal(attempt.before.color, before)


def test_only_successes_with_a_goal_in_the_picture_demonstrate(attempt):
    assert is_demonstration(attempt)
    assert not is_demonstration(replace(attempt, outcome=replace(attempt.outcome, failure="dropped")))
    assert not is_demonstration(replace(attempt, box_after=attempt.box_after + np.array([400, 0])))
    lost = replace(attempt, box_after=attempt.box_after * np.nan)
    assert not is_demonstration(lost)
    with pytest.raises(DataError, match="attempt 3"):
        goal_of(lost)
