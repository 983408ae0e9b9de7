"""The simulated cell and the policy that `baggie evaluate` names, put together."""

from __future__ import annotations

from pathlib import Path

from baggie.calibration.files import REFERENCE_FILE
from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.data.layout import CALIBRATION_FOLDER
from baggie.evaluation.bench import Bench
from baggie.evaluation.card_map import card_map
from baggie.evaluation.options import EvaluateOptions
from baggie.evaluation.subjects import calibration_folder, config_of, in_its_cell, open_policy
from baggie.pictures import same_shape
from baggie.policies import ColorMaskPolicy, OraclePolicy, Policy
from baggie.sim.cell import PICTURE_SIZE
from baggie.types import Goal, Observation, Plan
from baggie.vision.picture_files import read_picture
from baggie.workcell.simulated import SimulatedWorkcell, open_simulated
from baggie.workcell.watch import Watch


class ColorOfTheBag(Policy):
    """The colour mask, told the colour of the bag in each scene: what a person writes into the workcell's file."""

    name = ColorMaskPolicy.name

    def __init__(self, policy: ColorMaskPolicy, cell: SimulatedWorkcell) -> None:
        self.policy, self.cell = policy, cell

    def plan(self, observation: Observation, goal: Goal | None = None) -> Plan:
        """What the colour mask plans for an object of the colour in the cell's settings."""
        self.policy.object_color = self.cell.settings.object_color
        return self.policy.plan(observation, goal)


def open_bench(options: EvaluateOptions) -> Bench:
    """The cell and the policy, and for `--goal card` the map that raises the card's corners, where there is one."""
    cell = open_simulated(options.cell, scenery=options.scenery, picture_size=camera_size(options))
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
