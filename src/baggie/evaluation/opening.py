"""The cell and the policy that `baggie evaluate` names, put together.

In a real workcell, things are where its own camera sees them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from baggie.calibration.files import REFERENCE_FILE
from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.collect.machine import at_outline, detect
from baggie.data.files import CALIBRATION_FOLDER
from baggie.errors import BaggieError
from baggie.evaluation.setup import Bench, card_map
from baggie.evaluation.subjects import calibration_folder, config_of, in_its_cell, open_policy
from baggie.geometry import FloatArray, PlanarPose
from baggie.options.evaluating import EvaluateOptions
from baggie.pictures import read_picture, same_shape
from baggie.policies import ColorMaskPolicy, LearnedPolicy, OraclePolicy, Policy
from baggie.policies.checkpoint import check_picture_shape
from baggie.policies.exported import ExportedPolicy
from baggie.registry import TASKS
from baggie.sim.cell import PICTURE_SIZE
from baggie.types import Goal, Image, Observation, Outcome, Plan
from baggie.workcell.config import RealWorkcell, open_workcell
from baggie.workcell.simulated import SimulatedWorkcell, open_simulated
from baggie.workcell.workcell import Watch, WorkcellSettings


class SeenCell:
    """Nobody lays the table anew: a scene begins where the one before it ended. And nobody knows the truth.

    In a picture the object is found by its colour, and the workcell's `image_to_robot` says where that is. So what is
    measured here is as right as that map; the policy does not need it.
    """

    def __init__(self, cell: RealWorkcell, path: Path) -> None:
        """`path`: of its file, for people. Raises `BaggieError` where it names no map from the picture to the robot."""
        if cell.calibrations.image_to_robot is None:
            raise BaggieError(
                f"expected image_to_robot below `calibrations` in {path}, to measure where bags end, got none; make "
                f"one with: baggie calibrate image-to-robot --workcell {path}"
            )
        self._cell, self._path = cell, path
        to_robot = at_outline(cell.calibrations.image_to_robot, cell.settings)
        self.image_to_robot = to_robot.for_size(cell.camera.size)

    @property
    def settings(self) -> WorkcellSettings:
        """What its file says."""
        return self._cell.settings

    def reset(self, seed: Sequence[int]) -> None:
        """What the hand still holds is put down, the arm parks, and the rest stays as it is."""
        self._cell.reset(seed)

    def look(self) -> Observation:
        """A picture with the arm out of view."""
        return self._cell.look()

    def carry_out(self, plan: Plan) -> Outcome:
        """As `Workcell.carry_out`."""
        return self._cell.carry_out(plan)

    def truth(self) -> None:
        """Nobody knows where the object really is."""

    def find(self, seen: Observation) -> PlanarPose:
        """Where a picture shows the object. Raises `BaggieError` where it shows none."""
        found = detect(seen, self.image_to_robot, self.settings)
        if found is None:
            raise BaggieError(
                f"expected an object of colour RGB {self.settings.object_color} in the picture of {self._path}, found "
                "none; bring it back into view and give the same command again: it goes on from there"
            )
        return found[1]

    def second_truth(self) -> None:
        """There is one object."""

    def obstacles(self) -> list[PlanarPose]:
        """None that anybody knows of."""
        return []

    def goal_corners(self, pose: PlanarPose) -> FloatArray:
        """`(4, 2)` pixels: where the outline of an object that rests at `pose` is to be expected."""
        length, width, _ = self.settings.object_size_m
        return self.image_to_robot.to_pixels(pose.outline(length, width))

    def lay_card(self, pose: PlanarPose | None) -> None:
        """Raises `BaggieError`: only a person lays a card there."""
        raise BaggieError("expected a goal that can be marked in the picture, got a card for a real workcell")

    @contextmanager
    def film(self, size: tuple[int, int] = (640, 480), fps: int = 20) -> Iterator[list[Image]]:
        """Nobody films it."""
        yield []

    def close(self) -> None:
        """Let go of arm and camera."""
        self._cell.close()


def open_real_bench(options: EvaluateOptions) -> Bench:
    """The workcell of `options.workcell` and the policy; `color-mask` plans with the workcell's own map.

    Raises `BaggieError` for a file that describes no real workcell, or has no map to measure with, and for a policy
    that was trained with another camera.
    """
    assert options.workcell is not None
    opened = open_workcell(options.workcell)
    try:
        if not isinstance(opened, RealWorkcell):
            raise BaggieError(
                f"expected a real arm in {options.workcell}, got a simulated workcell; give its number: --cell N"
            )
        cell = SeenCell(opened, options.workcell)
        policy: Policy
        if options.policy == ColorMaskPolicy.name and options.calibration is None:
            policy = ColorMaskPolicy(cell.image_to_robot, cell.settings.object_color)
        else:
            policy = open_policy(options.policy, options.calibration, options.device)
        if isinstance(policy, LearnedPolicy | ExportedPolicy):
            check_picture_shape(opened.camera.size, policy.camera_size)
    except BaggieError:
        opened.close()
        raise
    return Bench(cell, policy, cell.image_to_robot, cell.find)


class ColorOfTheBag(Policy):
    """The colour mask, told the colour of the bag in each scene: what a person writes into the workcell's file."""

    name = ColorMaskPolicy.name

    def __init__(self, policy: ColorMaskPolicy, cell: SimulatedWorkcell) -> None:
        self.policy, self.cell = policy, cell

    def plan(self, observation: Observation, goal: Goal | None = None) -> Plan:
        """What the colour mask plans for an object of the colour in the cell's settings."""
        self.policy.object_color = self.cell.settings.object_color
        return self.policy.plan(observation, goal)


def open_simulated_bench(options: EvaluateOptions) -> Bench:
    """The cell and the policy, and for `--goal card` the map that raises the card's corners, where there is one."""
    cell = open_simulated(
        options.cell,
        options.task,
        scenery=options.scenery,
        picture_size=camera_size(options),
        depth=TASKS[options.task].depth,
    )
    reference = _reference(options)
    cell.watch = Watch(read_picture(reference)) if reference else None
    map_file = card_map(options)
    to_robot = ImageToRobot.load(map_file) if map_file else None
    if options.policy == OraclePolicy.name:
        bench = Bench(
            cell,
            OraclePolicy(cell.truth, lambda: bench.goal, lambda: cell.settings.object_symmetry),
            to_robot,
        )
        return bench
    policy = open_policy(options.policy, options.calibration or options.out, options.device)
    if isinstance(policy, ColorMaskPolicy):
        policy = ColorOfTheBag(policy, cell)
    return Bench(cell, policy, to_robot)


def camera_size(options: EvaluateOptions) -> tuple[int, int]:
    """`(width, height)` of the pictures of the camera that the policy knows, pixels; the simulator's own for others."""
    if options.policy == OraclePolicy.name:
        return PICTURE_SIZE
    if options.policy == ColorMaskPolicy.name:
        folder = calibration_folder(options.calibration or options.out)
        return ColorMaskPolicy.load(folder).image_to_robot.camera.size
    width, height = config_of(options.policy)["camera_size"]
    # A size that nobody wrote down is that of the recorded pictures, and the simulator's camera has a finer one.
    return PICTURE_SIZE if same_shape((width, height), PICTURE_SIZE) else (width, height)


def _reference(options: EvaluateOptions) -> Path | None:
    """What the camera saw when the policy's cell was calibrated, if that is known and it is this cell, as it was."""
    if options.scenery != "plain":
        return None  # another table or lamp is no bump
    folder = Path(options.policy)
    if options.policy == ColorMaskPolicy.name:
        folder = (options.calibration or options.out) / CALIBRATION_FOLDER
    elif not in_its_cell(options.policy, options.cell):
        return None
    return folder / REFERENCE_FILE if (folder / REFERENCE_FILE).exists() else None
