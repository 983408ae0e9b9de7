"""Evaluations in a cell without physics, of policies that are right, off by so much, blind, or killed."""

import json
import os
import signal
from contextlib import contextmanager
from dataclasses import replace
from functools import partial

import numpy as np

from baggie import seeds
from baggie.errors import BaggieError, ReachError
from baggie.evaluation.closed_loop import EvaluateOptions, evaluate
from baggie.evaluation.setup import Setup
from baggie.geometry import PlanarPose
from baggie.policies.baselines import OraclePolicy
from baggie.sim.bag import Bag
from baggie.tasks.conditions import State
from baggie.tasks.demonstrator import next_action
from baggie.tasks.task import Scene
from baggie.types import Observation, Outcome, Plan
from baggie.workcell.workcell import Workcell, WorkcellSettings
from helpers.streaming import Here
from helpers.synthetic import WORKSPACE, box_corners

SIZE = (320, 180)


class FakeCell(Workcell):
    """A bag that lands where it is put; the first grasp of every third episode misses."""

    def __init__(self):
        self.settings = WorkcellSettings(workspace=WORKSPACE)

    def reset(self, seed):
        assert seed[0] == seeds.EVALUATION
        self.rng = seeds.generator(*seed)
        x, y = WORKSPACE.sample(self.rng, 0.02)
        self.bag = PlanarPose(float(x), float(y), float(self.rng.uniform(-0.7, 0.7)))
        self.misses = 1 if seed[-1] % 3 == 0 else 0
        self.scene = Scene((Bag(),), {"bag": self.bag})

    def look(self):
        return Observation(np.full((SIZE[1], SIZE[0], 3), 90, np.uint8))

    def state(self):
        return State({}, {"bag": self.bag})

    def demonstrate(self, rng=None):
        return next_action(self.scene.conditions, self.state(), "hand")

    def outline(self, pose):
        return box_corners(pose, SIZE)

    def lay_card(self, pose):
        self.card = pose

    def carry_out(self, plan):
        action = plan.action
        if self.misses:
            self.misses -= 1
            return Outcome(action, "missed-grasp")
        if action.place.x > 0.7:
            raise ReachError("too far")
        self.bag = PlanarPose(action.place.x, action.place.y, 0.0)
        return Outcome(action)

    @contextmanager
    def film(self, size=(64, 48), fps=20):
        frames = []
        yield frames
        frames += [np.full((48, 64, 3), shade, np.uint8) for shade in range(0, 200, 20)]

    def close(self):
        pass


class HeatOracle(OraclePolicy):
    """Tells the truth, with a heat map, and kills the evaluation in the middle of a plan if told to."""

    plans, die_at, off_m = 0, None, 0.0

    def plan(self, observation, goal):
        self.plans += 1
        if self.plans == self.die_at:
            os.kill(os.getpid(), signal.SIGKILL)
        view = np.zeros((9, 16), np.float32)
        view[4, 5] = 1
        action = super().plan(observation, goal).action
        action = replace(action, place=action.place @ PlanarPose(self.off_m, 0.0))
        return Plan(action, views={"pick": view})


class BlindPolicy:
    name = "blind"

    def plan(self, observation, goal):
        raise BaggieError("no bag in sight")


def open_perfect(_options, off_m=0.0):
    cell = FakeCell()
    policy = HeatOracle(cell.demonstrate)
    policy.off_m = off_m
    return Setup(cell, policy)


def open_off_by_25_mm(options):
    return open_perfect(options, 0.025)


def open_far(options):
    return open_perfect(options, 1.0)


def open_blind(_options):
    return Setup(FakeCell(), BlindPolicy())


def open_deadly(options):
    setup = open_perfect(options)
    setup.policy.die_at = 4  # the first episode takes two plans
    return setup


evaluate_here = partial(evaluate, executor=Here())


def options(out, **changes):
    return EvaluateOptions(
        **{"policy": "oracle", "out": out, "episodes": 5, "workers": 1, "film": 1} | changes
    )


def timeless(out):
    lines = [json.loads(line) for line in (out / "episodes.jsonl").read_text().splitlines()]
    for line in lines:
        line.pop("wall_s")
        for step in line["steps"]:
            step.pop("decision_ms")
    return sorted(lines, key=lambda line: line["episode"])
