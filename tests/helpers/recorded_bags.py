"""A recording of drawn bags, and a policy whose errors on it are known."""

import numpy as np

from baggie.data import DatasetWriter, open_dataset
from baggie.errors import BaggieError
from baggie.geometry import PlanarPose
from baggie.types import PickPlace, Plan
from helpers.synthetic import TASK, make_attempt

SIZE = (320, 180)
FAILED = (3, 7)


def record(folder, attempts=14, seed=0):
    rng = np.random.default_rng(seed)
    settings = {"task": TASK, "picture_size": SIZE, "collection": {"seed": seed}}
    with DatasetWriter(folder, robot_type="drawn", **settings) as writer:
        for attempt_id in range(attempts):
            failure = "dropped" if attempt_id in FAILED else None
            writer.append(make_attempt(attempt_id, rng, SIZE, failure=failure, depth=False))
    return folder


class FakePolicy:
    """Tells the truth, wrong by what the test says: 3, 4 mm at the pick, `place_off` at the place."""

    name = "fake"
    radii_m = (0.006, 0.0105)

    def __init__(self, folder, blind=()):
        self.attempts = {a.before.color.tobytes(): a for a in open_dataset(folder)}
        self.blind, self.seen = blind, []

    def plan(self, observation, goal):
        attempt = self.attempts[observation.color.tobytes()]
        self.seen.append(attempt.attempt_id)
        if attempt.attempt_id in self.blind:
            raise BaggieError("no bag in sight")
        before, after = attempt.truth.before, attempt.truth.after
        pick = PlanarPose(before.x + 0.003, before.y - 0.004, before.yaw + np.pi / 2 + 0.1)
        place = PlanarPose(after.x + 0.001 * (attempt.attempt_id + 2), after.y, after.yaw)
        views = {"pick": np.eye(9, 16, dtype=np.float32)}
        return Plan(PickPlace(pick, place), 0.5, *self.radii_m, views=views)
