"""What a memory makes of a policy: no miss is repeated, what lies askew is put right, another scene begins anew."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from baggie.errors import BaggieError
from baggie.geometry import PlanarPose, rotation
from baggie.policies.memory import Memory, remembering
from baggie.policies.transporter.config import TransporterConfig
from baggie.policies.transporter.network import TransporterNet
from baggie.policies.transporter.policy import Scale, TransporterPolicy
from baggie.types import Observation, PickPlace, Plan
from baggie.vision.carried import middle_of
from helpers.box_scenes import GRID, TABLE
from helpers.outlines import after, drawn, shape

PICK, PLACE = np.array([38.0, 40.0]), np.array([90.0, 85.0])
SQUARE = shape(4, 8.0, 0.12, PICK)


class Repeating:
    """Plans the same, whatever it sees, and remembers what it was asked."""

    def __init__(self, turn=0.0):
        self.turn, self.asked = turn, []

    def plan(self, observation, goal=None):
        self.asked.append(observation)
        (px, py), (qx, qy) = GRID.to_robot([PICK, PLACE]).tolist()
        return Plan(PickPlace(PlanarPose(px, py), PlanarPose(qx, qy, self.turn)))


def seen(outline, *others):
    heights = drawn(outline)
    for other in others:
        heights = drawn(other, onto=heights)
    return Observation(np.full((*GRID.shape, 3), TABLE, np.uint8), grid=GRID, height=heights)


def test_a_pick_that_came_to_nothing_is_told_to_the_policy_until_something_moves():
    policy = Repeating()
    memory = Memory(policy)
    for _ in range(3):
        memory.plan(seen(SQUARE))
    assert [len(each.tried) for each in policy.asked] == [0, 1, 2]
    assert policy.asked[1].tried == pytest.approx(PICK[None])
    memory.plan(seen(after(SQUARE, np.array([PICK, PLACE]), 0.0)))  # picked, and placed well
    assert len(policy.asked[3].tried) == 0
    memory.plan(seen(SQUARE))
    memory.begin()
    memory.plan(seen(SQUARE))
    assert len(policy.asked[-1].tried) == 0


def test_what_is_pushed_aside_was_not_picked():
    policy = Repeating()
    memory = Memory(policy)
    beside = shape(4, 6.0, 0.0, [52.0, 44.0])
    memory.plan(seen(SQUARE, beside))
    memory.plan(seen(SQUARE, beside + np.array([4.0, 4.0])))
    assert len(policy.asked[-1].tried) == 1


def test_a_map_that_changed_elsewhere_begins_a_new_episode():
    policy = Repeating()
    memory = Memory(policy)
    memory.plan(seen(SQUARE))
    memory.plan(seen(SQUARE))
    assert len(policy.asked[-1].tried) == 1
    memory.plan(seen(SQUARE, shape(4, 8.0, 0.0, [110.0, 15.0])))
    assert len(policy.asked[-1].tried) == 0


@given(st.floats(3.5, 9.0), st.floats(-math.pi, math.pi), st.floats(-0.4, 0.4), st.floats(-1.5, 1.5))
def test_what_came_to_lie_askew_is_put_right(off, way, askew, turn):
    """The plan that does it picks the thing where it lies and leaves it as it was meant to be."""
    policy = Repeating(turn)
    memory = Memory(policy)
    memory.plan(seen(SQUARE))
    meant = after(SQUARE, np.array([PICK, PLACE]), turn)
    beside = PLACE + off * np.array([math.cos(way), math.sin(way)])
    lies = (meant - PLACE) @ rotation(askew).T + beside
    plan = memory.plan(seen(lies))
    assert len(policy.asked) == 1, "it is the memory's own"
    action = plan.action
    places = GRID.to_pixels([action.pick.xy, action.place.xy])
    assert places[0] == pytest.approx(beside, abs=1.0)
    ends = after(lies, places, action.place.yaw - action.pick.yaw)
    assert middle_of(drawn(ends) > 0) == pytest.approx(middle_of(drawn(meant) > 0), abs=1.0)
    square = (askew + (action.place.yaw - action.pick.yaw) + math.pi / 4) % (math.pi / 2) - math.pi / 4
    assert abs(square) < math.radians(10)


@pytest.mark.parametrize(("off", "askew"), [(0.0, 0.0), (2.0, 0.05), (40.0, 0.0)])
def test_what_lies_well_or_is_lost_is_left_to_the_policy(off, askew):
    policy = Repeating()
    memory = Memory(policy)
    memory.plan(seen(SQUARE))
    lies = (SQUARE - PICK) @ rotation(askew).T + PLACE - np.array([off, 0.0])
    memory.plan(seen(lies))
    assert len(policy.asked) == 2


def test_it_does_not_put_right_for_ever():
    """What slides away each time lies where it can."""
    policy = Repeating()
    memory = Memory(policy)
    memory.plan(seen(SQUARE))
    for times in range(1, 5):
        aside = np.array([12.0 * (-1) ** times, 0.0])
        memory.plan(seen(SQUARE - PICK + PLACE + aside))
        if len(policy.asked) > 1:
            break
    assert times == 3


def test_pictures_of_a_camera_are_passed_on():
    policy = Repeating()
    picture = Observation(np.zeros((20, 30, 3), np.uint8))
    Memory(policy).plan(picture)
    assert policy.asked == [picture]


# --- what a policy makes of it


def policy_of(scale=None):
    network = TransporterNet(TransporterConfig(rotations=8))
    return TransporterPolicy(network, GRID, 0, scale=scale or Scale())


def test_what_was_tried_or_is_too_high_is_not_picked():
    heights = drawn(shape(4, 8.0, 0.1, [60.0, 60.0]))
    heights[:20] = 0.27  # an arm that hangs over the table
    map_ = Observation(np.full((*GRID.shape, 3), TABLE, np.uint8), grid=GRID, height=heights)
    policy = policy_of(Scale(highest_m=0.1))
    tried = []
    for _ in range(6):
        plan = policy.plan(
            Observation(map_.color, grid=GRID, height=heights, tried=np.reshape(tried, (-1, 2)))
        )
        pick = GRID.to_pixels(plan.action.pick.xy)[0]
        assert all(np.linalg.norm(pick - at) > 2 for at in tried)
        assert pick[1] > 18
        tried.append(pick)
    with pytest.raises(BaggieError, match="all is too high or was tried"):
        policy_of(Scale(highest_m=-1.0)).plan(map_)


def test_a_policy_keeps_the_scale_of_what_it_was_shown(tmp_path):
    scale = Scale(0.12, 4.5)
    policy = policy_of(scale)
    policy.save_pretrained(tmp_path)
    assert TransporterPolicy.from_pretrained(tmp_path).scale == scale
    assert remembering(policy)._lands_within_px == 4.5
    older = policy.model_config()
    for name in ("highest_m", "lands_within_px"):
        del older[name]
    assert TransporterPolicy.build(older, policy.picture_size, 0).scale == Scale()
