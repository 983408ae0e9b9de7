"""The robot teaches itself: it takes the object, found by its colour, to random places, and looks where it is.

It does so in sittings of ten attempts one after another from a fresh scene. Attempts `10 k .. 10 k + 9` depend on the
seed, the cell and k alone, so any process may run any sitting, and one that was interrupted is run again from its start
and gives the same attempts.
"""

from __future__ import annotations

import functools
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from baggie import seeds
from baggie.calibration.files import REFERENCE_FILE
from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.collect.machine import Play, Scatter, Turn, helped, run_turn, stopped
from baggie.collect.patience import Patience
from baggie.collect.recording import OpenCell, Recording, Size, open_simulated_cell
from baggie.collect.stacking import Stacking
from baggie.commissioning.image_to_robot import calibrate_into
from baggie.data import Dataset, DatasetWriter, open_dataset
from baggie.data.files import CALIBRATION_FOLDER, PHYSICS
from baggie.data.record import fit, without_depth
from baggie.data.summary import layers
from baggie.errors import BaggieError
from baggie.files import write_if_possible
from baggie.geometry import FloatArray, Rectangle
from baggie.operator import Line, Operator, progress
from baggie.options.collecting import CollectOptions
from baggie.options.values import USUAL_TASK
from baggie.pictures import read_picture, recorded_size, same_shape, write_figure
from baggie.processes import OpenWorker
from baggie.types import Attempt, Observation, Truth
from baggie.vision.color_mask import Detection
from baggie.workcell.config import open_written
from baggie.workcell.replay import ReplayWorkcell
from baggie.workcell.workcell import Watch, Workcell
from baggie.workcell.workcell_file import SIMULATED, WorkcellFile, read_workcell_file

COVERAGE_FILE = "coverage.png"

Ids = tuple[int, ...]
"""Of attempts of one sitting."""
Sit = Callable[[Ids], Iterable[list[Attempt]]]
"""Makes the attempts with these ids, each an episode."""
ATTEMPTS_PER_SITTING = 10
SIMULATED_PHYSICS = 2
"""Of soft things, as recordings say it: it rises whenever the same seed comes to give other attempts."""
SQUARE = 4
"""The symmetry of bags to stack: they are turned as it is said, but look the same after a quarter turn."""
STALL_AFTER = 5
"""Attempts in a row without a success before a person is asked."""


class SelfTaught:
    """Collects attempts at a task whose goal is given in the picture; needs no truth, so on real arms, too."""

    doing, counted = "collecting", "attempts recorded"

    def __init__(self, options: CollectOptions, open_cell: OpenCell | None, operator: Operator) -> None:
        """In the cell that the options say, unless `open_cell` opens another. Raises what `what_opens` raises."""
        self._options, self._operator = options, operator
        self._open_cell, self.robot, table = what_opens(options, open_cell)
        self.simulated = self.robot == SIMULATED
        physics = {PHYSICS: SIMULATED_PHYSICS} if self.simulated else {}
        self.collection = {
            "seed": options.seed,
            "cell": options.cell,
            "scenery": options.scenery,
            **table,
            **physics,
        }

    @functools.cached_property
    def image_to_robot(self) -> ImageToRobot:
        """The collector's map from the picture to the robot: as saved, or fitted now."""
        patience = Patience.for_cell(self._operator, simulated=self.simulated)
        (image_to_robot,) = patience.bear(
            lambda: [_calibrated(self._options, self._open_cell, self._operator)]
        )
        return image_to_robot

    def picture_size(self) -> Size:
        """That of the camera, or less."""
        return recorded_size(self.image_to_robot.camera.size)

    def begun(self, writer: DatasetWriter) -> int:
        """How many of the attempts are recorded."""
        return sum(attempt_id < self._options.attempts for attempt_id in writer.attempt_ids)

    def missing(self, writer: DatasetWriter) -> list[Ids]:
        """The attempts still to be made, by sitting."""
        return missing_sittings(self._options.attempts, writer.attempt_ids)

    def open_worker(self, recording: Recording) -> OpenWorker[Ids, list[Attempt]]:
        """Runs sittings."""
        _describe(self.image_to_robot, recording.size, self._operator)
        watched = self._options.watched
        reference = self._options.out / CALIBRATION_FOLDER / REFERENCE_FILE if watched else None
        return functools.partial(_open_worker, self._open_cell, self.image_to_robot, recording, reference)

    def summary(self, rate: float | None) -> dict[str, Any]:
        """Counts, how much of the workspace was reached, also as a picture, and the attempts a minute."""
        dataset, area = open_dataset(self._options.out), self.image_to_robot.area
        summary = {**summarize(dataset, area), "attempts_per_minute": rate}
        picture = self._options.out / COVERAGE_FILE
        if write_if_possible(picture, functools.partial(draw_coverage, dataset, area)):
            summary["coverage_picture"] = str(picture)
        return summary


def open_written_cell(written: WorkcellFile, path: Path, number: int) -> Workcell:
    """The workcell `written` in a file. Raises `BaggieError` for one that cannot be used, or of another cell."""
    cell = open_written(written, path)
    if isinstance(cell, ReplayWorkcell):
        cell.close()
        raise BaggieError(
            f"expected {path} to describe a workcell with an arm, to collect in; a recording has none"
        )
    if not written.arm.real and written.cell != number:
        cell.close()
        raise BaggieError(f"{path} describes cell {written.cell}, not {number}; give --cell to match")
    return cell


def what_opens(
    options: CollectOptions, open_cell: OpenCell | None = None
) -> tuple[OpenCell, str, dict[str, Any]]:
    """What opens the cell that the options say, what a recording of it says moved, and what else it says of the cell.

    Or `open_cell`, where it is given, whose arm says its name. A file is read once, now: of it a recording says what
    lies on the table and where.

    Raises `BaggieError` for a file that cannot be used, and where there are more workers than arms.
    """
    opener, robot, table = _written(options)
    if open_cell is not None:
        with closing(open_cell(options.cell)) as cell:
            return open_cell, cell.arm.info.name, table
    return opener, robot(), table


def _written(options: CollectOptions) -> tuple[OpenCell, Callable[[], str], dict[str, Any]]:
    """As `what_opens`, but the robot's name only where it is asked for: some arms have to be made for it."""
    if options.workcell is None:
        return (
            functools.partial(open_simulated_cell, task=options.task, scenery=options.scenery),
            lambda: SIMULATED,
            {},
        )
    path = options.workcell
    written = read_workcell_file(path)
    if written.arm.real and options.workers not in (None, 1):
        raise BaggieError(f"expected --workers 1 with {path}, which has one arm, got {options.workers}")
    if not written.arm.real and options.task != USUAL_TASK:
        raise BaggieError(
            f"expected --task {USUAL_TASK} with {path}, which describes a simulated workcell with one bag, got "
            f"{options.task}; leave --workcell out, or give that of a real arm"
        )
    table = {**written.model_dump(mode="json", include={"workspace"}), "bag": written.bag.recorded()}
    opener = functools.partial(open_written_cell, written, path)
    return opener, functools.partial(written.arm.title, path.parent), {"workcell": table}


def _calibrated(options: CollectOptions, open_cell: OpenCell, operator: Operator) -> ImageToRobot:
    """The collector's map from the picture to the robot: as saved, or fitted now."""
    from baggie.policies.baselines import CONFIG_FILE, ColorMaskPolicy  # noqa: PLC0415 -- as in workers

    folder = options.out / CALIBRATION_FOLDER
    if not (folder / CONFIG_FILE).exists():
        with (
            progress(operator, "getting the map from the picture to the robot"),
            closing(open_cell(options.cell)) as cell,
        ):
            calibrate_into(folder, cell, options.seed, options.watched)
    return ColorMaskPolicy.load(folder).image_to_robot


def _describe(image_to_robot: ImageToRobot, size: tuple[int, int], operator: Operator) -> None:
    """Say how good the map is, and where pictures are recorded in another shape than the camera's."""
    residuals, (width, height) = image_to_robot.residuals, image_to_robot.camera.size
    fitted = (
        f"picture to robot: {residuals.kept.sum()} points, residual {residuals.rms_mm:.1f} mm, "
        f"{residuals.leave_one_out_mm:.1f} mm leave-one-out"
    )
    operator.tell(Line(fitted))
    if not same_shape(size, (width, height)):
        squeezed = (
            f"pictures of {width} x {height} pixels are squeezed to {size[0]} x {size[1]}, as they were when this "
            "recording was begun; another folder records them in their own shape"
        )
        operator.tell(Line(squeezed))


def missing_sittings(attempts: int, recorded: Iterable[int]) -> list[Ids]:
    """The ids that are still to be recorded, `0 .. attempts - 1`, by sitting, early ones first."""
    missing = sorted(set(range(attempts)) - set(recorded))
    sittings: dict[int, list[int]] = {}
    for attempt_id in missing:
        sittings.setdefault(attempt_id // ATTEMPTS_PER_SITTING, []).append(attempt_id)
    return [tuple(ids) for ids in sittings.values()]


def _check_camera(cell: Workcell, image_to_robot: ImageToRobot) -> None:
    """Raise `BaggieError` where the camera's pictures are not as large as those that the map was fitted to."""
    (width, height), (own_width, own_height) = cell.camera.size, image_to_robot.camera.size
    if (width, height) != (own_width, own_height):
        raise BaggieError(
            f"expected a camera of {own_width} x {own_height} pixels, as when this recording was calibrated, got one "
            f"of {width} x {height}; set it as it was, or record into another folder"
        )


def _open_worker(
    open_cell: OpenCell,
    image_to_robot: ImageToRobot,
    recording: Recording,
    reference: Path | None,
    operator: Operator,
) -> Sit:
    """What a worker process does: run a sitting from its start and hand over the attempts asked for."""
    cv2.setNumThreads(1)
    cell = open_cell(recording.cell)
    _check_camera(cell, image_to_robot)
    cell.watch = Watch(read_picture(reference)) if reference else None

    def sit(wanted: Ids) -> Iterable[list[Attempt]]:
        number = wanted[0] // ATTEMPTS_PER_SITTING
        first = 0 if cell.repeatable else wanted[0] % ATTEMPTS_PER_SITTING
        for attempt in run_sitting(cell, image_to_robot, recording, number, operator=operator, first=first):
            if attempt.attempt_id in wanted:
                yield [attempt]
            if attempt.attempt_id == wanted[-1]:
                return

    return sit


def run_sitting(
    cell: Workcell,
    image_to_robot: ImageToRobot,
    recording: Recording,
    number: int,
    *,
    operator: Operator,
    first: int = 0,
) -> Iterator[Attempt]:
    """The ten attempts of one sitting, or those from `first` on, one by one as they are finished, failed ones too.

    `operator` is asked for help when the cell cannot help itself. Raises `Stopped` when nobody helps.
    """
    cell.reset((seeds.COLLECTION, recording.seed, number))
    begun_at = (first,) if first else ()  # or places would be the first ones over again
    rng = seeds.generator(seeds.PLACES, recording.seed, number, *begun_at)
    play: Play = Stacking(image_to_robot, cell.settings, rng) if recording.stacks else Scatter()
    doubted = rescued = False
    seen: Observation | None = None
    failures = 0
    for index in range(first, ATTEMPTS_PER_SITTING):
        time = cell.clock()
        turn = run_turn(Turn(cell, image_to_robot, rng, operator, play, doubted, seen))
        doubted, seen = turn.doubted, turn.after
        attempt = as_attempt(turn, recording, number * ATTEMPTS_PER_SITTING + index, time)
        yield attempt
        failures = 0 if attempt.outcome.success else failures + 1
        if attempt.outcome.failure == "stalled" or failures >= STALL_AFTER:
            trouble = _stall(attempt, failures, turn.trouble)
            helps_itself = not rescued and cell.rescue()
            if not (helps_itself or helped(operator, trouble)):
                raise stopped(trouble)
            rescued, failures, seen = rescued or helps_itself, 0, None


def _stall(attempt: Attempt, failures: int, trouble: str) -> str:
    if attempt.outcome.failure == "stalled":
        return (
            f"after attempt {attempt.attempt_id} the object is still where it was, though the gripper held "
            "something; check that the camera is live and the gripper free"
        )
    failed = f"{failures} attempts in a row failed, the last one ({attempt.attempt_id}) with {attempt.outcome.failure}"
    if attempt.outcome.failure == "unreachable":
        return f"{failed}: {trouble}"
    return f"{failed}; check the gripper, the calibration and the object's colour"


def as_attempt(turn: Turn, recording: Recording, attempt_id: int, time: float) -> Attempt:
    """A finished turn as a record, its pictures and boxes at the recorded size."""
    assert turn.before is not None
    assert turn.action is not None
    assert turn.outcome is not None
    assert turn.after is not None
    attempt = Attempt(
        attempt_id=attempt_id,
        task=recording.instruction,
        before=turn.before,
        after=turn.after,
        commanded=turn.action,
        outcome=turn.outcome,
        box_before=_box(turn.found),
        box_after=_box(turn.found_after),
        cell=recording.cell,
        seed=recording.seed,
        time=time,
        object_symmetry=SQUARE if recording.stacks else turn.cell.settings.object_symmetry,
        truth=_truth(turn),
        pick_layer=turn.layers[0] if turn.layers else None,
        place_layer=turn.layers[1] if turn.layers else None,
        under=turn.under,
    )
    return fit(attempt if recording.depth else without_depth(attempt), recording.size)


def _truth(turn: Turn) -> Truth | None:
    """Where the object was before and is now, where somebody knows it."""
    after = turn.truth()
    return Truth(turn.truth_before, after) if turn.truth_before and after else None


def _box(found: Detection | None) -> FloatArray:
    """`(4, 2)` corners, NaN where nothing was found."""
    return np.full((4, 2), np.nan) if found is None else found.corners


_CELL_M = 0.05


def summarize(dataset: Dataset, area: Rectangle) -> dict[str, Any]:
    """Counts by cause, and how much of `area` was reached, ready for JSON.

    `coverage` is the fraction of squares of 5 cm in which the object was successfully picked up or put down.
    """
    numbers = dataset.numbers()
    succeeded = numbers["success"]
    failed = Counter(failure for failure in dataset.failures if failure is not None)
    executed = numbers["executed"][succeeded]
    return {
        "attempts": len(dataset),
        "succeeded": int(succeeded.sum()),
        "failed": dict(failed.most_common()),
        **layers(dataset),
        "grasped_at_first_try": int((succeeded & (numbers["tries"] == 1)).sum()),
        "coverage": coverage(np.concatenate([executed[:, 0:2], executed[:, 3:5]]), area),
    }


def coverage(points: FloatArray, area: Rectangle) -> float:
    """The fraction of 5 cm squares of `area` with at least one of `points` `(N, 2)` in it."""
    shape = (
        max(round((area.x_max - area.x_min) / _CELL_M), 1),
        max(round((area.y_max - area.y_min) / _CELL_M), 1),
    )
    span = [(area.x_min, area.x_max), (area.y_min, area.y_max)]
    counts, _, _ = np.histogram2d(points[:, 0], points[:, 1], bins=shape, range=span)
    return float((counts > 0).mean())


def draw_coverage(dataset: Dataset, area: Rectangle, path: Path) -> None:
    """Save a picture of all picks and places over the workspace, seen from above, the robot at the bottom.

    Raises `WriteError`.
    """
    from matplotlib.figure import Figure  # noqa: PLC0415 -- worker processes start without it
    from matplotlib.patches import Rectangle as Patch  # noqa: PLC0415

    numbers = dataset.numbers()
    executed, succeeded = numbers["executed"], numbers["success"]
    figure = Figure(figsize=(7.5, 5.0), layout="constrained")
    axes = figure.subplots()
    size = (area.y_max - area.y_min, area.x_max - area.x_min)
    axes.add_patch(Patch((area.y_min, area.x_min), *size, fill=False, color="0.4", linestyle="--"))
    good, bad = executed[succeeded], executed[~succeeded]
    axes.scatter(good[:, 1], good[:, 0], s=14, color="tab:blue", label="picked up")
    axes.scatter(good[:, 4], good[:, 3], s=14, color="tab:green", marker="s", label="put down")
    axes.scatter(
        bad[:, 1], bad[:, 0], s=40, color="tab:red", marker="x", label="failed (where it was gripped)"
    )
    axes.invert_xaxis()  # y points left when x points away
    axes.set(aspect="equal", xlabel="y, left of the robot (m)", ylabel="x, in front of the robot (m)")
    axes.set_title(f"{len(dataset)} attempts, {int(succeeded.sum())} succeeded")
    figure.legend(loc="outside lower center", ncols=3, frameon=False)
    write_figure(path, figure)
