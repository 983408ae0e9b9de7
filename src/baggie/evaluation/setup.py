"""The cell and the policy that `baggie evaluate` names, put together."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from baggie.calibration.files import MAP_FILE, REFERENCE_FILE
from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.collect.machine import detect
from baggie.commissioning.image_to_robot import calibrate_into
from baggie.data.files import CALIBRATION_FOLDER
from baggie.errors import BaggieError
from baggie.geometry import PlanarPose
from baggie.operator import Operator, progress
from baggie.options.evaluating import EvaluateOptions
from baggie.pictures import read_picture, same_shape
from baggie.policies import ColorMaskPolicy, LearnedPolicy, OraclePolicy, Policy, checkpoint, load_policy
from baggie.policies.baselines import CONFIG_FILE
from baggie.policies.checkpoint import check_picture_shape
from baggie.policies.exported import ExportedPolicy
from baggie.registry import TASKS
from baggie.sim.cell import PICTURE_SIZE
from baggie.tasks.bag_stacks import stacking
from baggie.tasks.pattern import Pattern
from baggie.tasks.task import Task
from baggie.types import Goal, Observation, Plan
from baggie.workcell.workcell import Watch, Workcell, at_outline

_TRAINED_BY_CAMERA, _FROM_ABOVE = ("keypoint", "regression"), "transporter"
"""Policies that learn from a camera's pictures, and the one that looks at height maps, unless it has a camera."""
_BY_CAMERA = (*_TRAINED_BY_CAMERA, ColorMaskPolicy.name)
STACKING_TASK = "bag-stack"
"""What teaches a policy that wants a goal to stack bags, in any pattern."""
NAMED = (ColorMaskPolicy.name, OraclePolicy.name)
"""Policies that are not loaded from anywhere."""
UNKNOWN = ""
"""The fingerprint of what is not there."""


def open_policy(policy: str, calibration: Path | None, device: str = "cpu") -> Policy:
    """The policy of a run's folder or a Hub id, or `color-mask` with the calibration of a recording.

    `device`: where a learned one computes, in PyTorch's words. Raises `BaggieError` when there is none.
    """
    if policy == OraclePolicy.name:
        raise BaggieError("the oracle reads the simulator's truth: it can only be evaluated in a cell")
    if policy != ColorMaskPolicy.name:
        return load_policy(policy, device)
    if calibration is None:
        raise BaggieError("color-mask needs a calibration: give --calibration a recording of the cell")
    return ColorMaskPolicy.load(calibration_folder(calibration))


def calibration_folder(given: Path) -> Path:
    """Where the calibration of a recording is; `given` may be that folder itself."""
    inside = given / CALIBRATION_FOLDER
    return inside if inside.is_dir() else given


def config_of(policy: str) -> dict[str, Any]:
    """The `config.yaml` of a run's folder or a Hub id; empty for a policy known by name."""
    return {} if policy in NAMED else checkpoint.read_config(checkpoint.fetch(policy))


def in_its_cell(policy: str, cell: int) -> bool:
    """Whether a policy, if it was trained, was trained in this cell."""
    return bool(config_of(policy).get("cell", cell) == cell)


def check_taught(policy: str, task: str) -> None:
    """Raise `BaggieError` where a policy was taught another task, or looks at other pictures than this one shows."""
    config = config_of(policy)
    if not config:
        return
    from_above = config["policy"] == _FROM_ABOVE and config.get("model", {}).get("camera") is None
    by_goal = config["policy"] in (*_TRAINED_BY_CAMERA, _FROM_ABOVE) and not from_above
    stacks = TASKS[task].pattern is not None
    instruction = config.get("training", {}).get("task")  # None of a run begun before runs said so
    words = {name: known.instruction for name, known in TASKS.all().items()}
    taught = next((name for name in words if words[name] == instruction), None)
    needed = STACKING_TASK if stacks and by_goal else task
    if taught is None and needed != task:
        raise BaggieError(
            f"expected a policy that was taught {needed}, got {policy}, which does not say so; collect {needed}, and "
            "train on it"
        )
    if taught not in (None, needed):
        raise BaggieError(
            f"expected a policy that was taught {needed}, got {policy}, which was taught {taught}; "
            f"give --task {taught}, or another policy"
        )
    if config["policy"] not in (*_BY_CAMERA, _FROM_ABOVE):  # another package's knows itself what it looks at
        return
    if from_above != (TASKS[task].view == "height-map"):
        looks, needed = ("height maps", "a camera's pictures")[:: 1 if from_above else -1]
        raise BaggieError(
            f"expected a policy that looks at {needed} with --task {task}, got {policy}, which looks at {looks}; "
            "give the --task that it was taught"
        )
    if not (from_above or TASKS[task].has_goal or (stacks and by_goal)):
        raise BaggieError(
            f"expected a policy that knows by itself where things go in {task}, got {policy}, which wants a goal in "
            "the picture; give a --task with one, such as bag-place"
        )


def task_of(options: EvaluateOptions) -> Task:
    """The task that the options say; of stacked bags, in the pattern and the colours that they say."""
    task = TASKS[options.task]
    if options.pattern is None and not options.one_color:
        return task
    pattern = None if options.pattern is None else Pattern.given(options.pattern)
    return stacking(task, pattern, options.one_color)


def policy_name(policy: str) -> str:
    """What `--policy` names: `keypoint` for the folder or Hub id of such a run, itself for a name."""
    return policy if policy in NAMED else str(config_of(policy)["policy"])


def fingerprint(policy: str) -> str:
    """Changes when a run is trained, exported or saved again: the hash of its weights, or, where it has none, of all
    files of its folder; `UNKNOWN` for a policy known by name.
    """
    if policy in NAMED:
        return UNKNOWN
    folder = checkpoint.fetch(policy)
    learned = folder / (checkpoint.GRAPH if checkpoint.is_exported(folder) else checkpoint.WEIGHTS)
    if learned.exists():
        return fingerprint_of(learned)
    return fingerprint_of(*sorted(path for path in folder.iterdir() if path.is_file()))


def fingerprint_of(*files: Path, besides: bytes = b"") -> str:
    """Changes when one of the files does: a hash of those there are, `UNKNOWN` where there is none."""
    contents = [besides, *(path.read_bytes() for path in files if path.exists())]
    return hashlib.sha256(b"".join(contents)).hexdigest()[:16] if any(contents) else UNKNOWN


Find = Callable[[Observation], PlanarPose]
"""Where a picture shows the object, robot base frame. Raises `BaggieError` where it does not."""


@dataclass(frozen=True)
class Setup:
    """A cell and the policy to try in it."""

    cell: Workcell
    policy: Policy
    image_to_robot: ImageToRobot | None = None
    """A map of this cell that knows more than one height: with it a card's corners are raised to the object's."""
    find: Find | None = None
    """Where a picture shows the object: for a cell of which nobody knows the state."""

    def object_in(self, seen: Observation) -> PlanarPose:
        """Where the object was in the last picture: the truth, which is what it was then, or else as that shows."""
        return self.cell.truth() or self._found(seen)

    def object_at_start(self) -> PlanarPose:
        """Where the object lies in a scene that has just begun: the truth, or else as a picture of it shows.

        Raises `BaggieError` where that shows none, or one that lies where no plan gets it back: that takes a person.
        """
        if (known := self.cell.truth()) is not None:
            return known
        here, reach = self._found(self.cell.look()), self.cell.settings.limits.workspace
        if not reach.contains(here.x, here.y):
            raise BaggieError(
                f"expected the object within {reach}, got it at x {here.x:.2f} m, y {here.y:.2f} m; put it back and "
                "give the same command again: it goes on from there"
            )
        return here

    def _found(self, seen: Observation) -> PlanarPose:
        assert self.find is not None, "nobody knows where the object is"
        return self.find(seen)


class ObjectFinder:
    """Finds the object of a real workcell by its colour, and by the workcell's map from the picture to the robot.

    What is measured by it is as right as that map; the policy does not need it.
    """

    def __init__(self, cell: Workcell, path: Path) -> None:
        """`path`: of the workcell's file, for people. Raises `BaggieError` where it names no map."""
        if cell.calibrations.image_to_robot is None:
            raise BaggieError(
                f"expected image_to_robot below `calibrations` in {path}, to measure where bags end, got none; make "
                f"one with: baggie calibrate image-to-robot --workcell {path}"
            )
        self._settings, self._path = cell.settings, path
        self.image_to_robot = at_outline(cell.calibrations.image_to_robot, cell.settings).for_size(
            cell.camera.size
        )

    def __call__(self, seen: Observation) -> PlanarPose:
        """Where a picture shows the object. Raises `BaggieError` where it shows none."""
        found = detect(seen, self.image_to_robot, self._settings)
        if found is None:
            raise BaggieError(
                f"expected an object of colour RGB {self._settings.object_color} in the picture of {self._path}, found "
                "none; bring it back into view and give the same command again: it goes on from there"
            )
        return found[1]


class ColorOfTheBag(Policy):
    """The colour mask, told the colour of the bag in each scene: what a person writes into the workcell's file."""

    name = ColorMaskPolicy.name
    wants_goal = True

    def __init__(self, policy: ColorMaskPolicy, cell: Workcell) -> None:
        self.policy, self.cell = policy, cell

    def plan(self, observation: Observation, goal: Goal | None = None) -> Plan:
        """What the colour mask plans for an object of the colour in the cell's settings."""
        self.policy.object_color = self.cell.settings.object_color
        return self.policy.plan(observation, goal)


def open_setup(options: EvaluateOptions) -> Setup:
    """The cell and the policy that the options name. Raises `BaggieError` where they do not go together."""
    return _open_real(options, options.workcell) if options.workcell is not None else _open_simulated(options)


def _open_real(options: EvaluateOptions, path: Path) -> Setup:
    """In a real workcell things are where its own camera sees them; `color-mask` plans with the workcell's own map."""
    from baggie.workcell.config import RealWorkcell, open_workcell  # noqa: PLC0415 -- as below
    from baggie.workcell.replay import ReplayWorkcell  # noqa: PLC0415

    cell = open_workcell(path)
    try:
        if not isinstance(cell, RealWorkcell):
            got = "a recording" if isinstance(cell, ReplayWorkcell) else "a simulated workcell"
            raise BaggieError(
                f"expected a real arm in {path}, got {got}; try policies in a cell by its number: --cell N"
            )
        find = ObjectFinder(cell, path)
        policy: Policy
        if options.policy == ColorMaskPolicy.name and options.calibration is None:
            policy = ColorMaskPolicy(find.image_to_robot, cell.settings.object_color)
        else:
            policy = open_policy(options.policy, options.calibration, options.device)
        if isinstance(policy, LearnedPolicy | ExportedPolicy):
            check_picture_shape(cell.camera.size, policy.camera_size)
    except BaggieError:
        cell.close()
        raise
    return Setup(cell, policy, find.image_to_robot, find)


def _open_simulated(options: EvaluateOptions) -> Setup:
    from baggie.workcell.simulated import SimulatedWorkcell  # noqa: PLC0415 -- MuJoCo takes its time

    task = task_of(options)
    size = camera_size(options) if task.view == "camera" else PICTURE_SIZE
    cell = SimulatedWorkcell(options.cell, task, scenery=options.scenery, picture_size=size, depth=task.depth)
    reference = _reference(options) if task.has_goal else None
    cell.watch = Watch(read_picture(reference)) if reference else None
    map_file = card_map(options)
    to_robot = ImageToRobot.load(map_file) if map_file else None
    if options.policy == OraclePolicy.name:
        return Setup(cell, OraclePolicy(cell.demonstrate), to_robot)
    policy = open_policy(options.policy, options.calibration or options.out, options.device)
    return Setup(
        cell, ColorOfTheBag(policy, cell) if isinstance(policy, ColorMaskPolicy) else policy, to_robot
    )


def camera_size(options: EvaluateOptions) -> tuple[int, int]:
    """`(width, height)` of the pictures of the camera that the policy knows, pixels; the simulator's own for others."""
    if options.policy == OraclePolicy.name:
        return PICTURE_SIZE
    if options.policy == ColorMaskPolicy.name:
        folder = calibration_folder(options.calibration or options.out)
        return ColorMaskPolicy.load(folder).image_to_robot.camera.size
    width, height = config_of(options.policy).get("camera_size", PICTURE_SIZE)  # another package may say none
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


def calibrate_if_needed(options: EvaluateOptions, operator: Operator) -> None:
    """Calibrate the cell for `color-mask`, once for all processes, unless a calibration is given."""
    folder = options.out / CALIBRATION_FOLDER
    needed = (
        options.policy == ColorMaskPolicy.name and options.workcell is None and options.calibration is None
    )
    if not needed or (folder / CONFIG_FILE).exists():
        return
    from baggie.workcell.simulated import open_simulated  # noqa: PLC0415 -- MuJoCo takes its time

    with (
        progress(operator, "calibrating the picture to the robot"),
        closing(open_simulated(options.cell)) as cell,
    ):
        calibrate_into(folder, cell, options.seed)


def card_map(options: EvaluateOptions) -> Path | None:
    """The map that raises a card's corners to the bag's height, if one is known: the calibration of the recording
    given, or of the one the policy was trained on, or that of `color-mask`.
    """
    if options.goal != "card":
        return None
    trained_on = config_of(options.policy).get("training", {}).get("data")
    own = options.out if options.policy == ColorMaskPolicy.name else trained_on
    given = options.calibration or own
    if given is None or (options.calibration is None and not in_its_cell(options.policy, options.cell)):
        return None
    return next(
        (f for f in (Path(given, CALIBRATION_FOLDER, MAP_FILE), Path(given, MAP_FILE)) if _raises(f)), None
    )


def _raises(map_file: Path) -> bool:
    """Whether there is a map that knows more than one height."""
    return map_file.exists() and ImageToRobot.load(map_file).height_aware
