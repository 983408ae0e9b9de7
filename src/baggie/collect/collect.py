"""Collect attempts unattended: calibrate once, then sittings of ten attempts on every core."""

from __future__ import annotations

import functools
import os
import time
from collections.abc import Callable, Iterable
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
from rich.console import Console

from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.collect.calibrate import calibrate_into
from baggie.collect.cell import CollectorCell
from baggie.collect.demonstrations import record_demonstrations
from baggie.collect.options import INSTRUCTIONS, CollectedScenery, CollectOptions
from baggie.collect.sitting import ATTEMPTS_PER_SITTING, Recording, run_sitting
from baggie.collect.summary import draw_coverage, summarize
from baggie.data import DatasetWriter, open_dataset
from baggie.data.layout import CALIBRATION_FOLDER
from baggie.errors import BaggieError
from baggie.processes import stream_in_processes
from baggie.progress import progress_bar
from baggie.types import Attempt
from baggie.vision.picture_files import read_picture
from baggie.workcell.watch import REFERENCE_FILE, Watch

if TYPE_CHECKING:
    from baggie.workcell.workcell_file import WorkcellFile

PICTURE_SIZE = (640, 360)
"""`(width, height)` of the recorded pictures."""
COVERAGE_FILE = "coverage.png"
SIMULATED_ROBOT = "simulated FR3"

OpenCell = Callable[[int], CollectorCell]
"""Opens the cell with a number; picklable, because each worker process opens its own."""


def open_simulated_cell(number: int, scenery: CollectedScenery = "plain") -> CollectorCell:
    """The simulated workcell; imported late, because MuJoCo takes its time."""
    from baggie.workcell.simulated import open_simulated  # noqa: PLC0415

    return open_simulated(number, scenery=scenery)


def open_written_cell(written: WorkcellFile, path: Path, number: int) -> CollectorCell:
    """The workcell `written` in a file. Raises `BaggieError` for one that cannot be used, or of another cell."""
    from baggie.workcell.config import open_written  # noqa: PLC0415 -- MuJoCo takes its time
    from baggie.workcell.real import RealWorkcell  # noqa: PLC0415
    from baggie.workcell.simulated import SimulatedWorkcell  # noqa: PLC0415

    cell = open_written(written, path)
    if isinstance(cell, RealWorkcell):
        return cell
    if not isinstance(cell, SimulatedWorkcell):
        cell.close()
        raise BaggieError(
            f"expected {path} to describe a workcell with an arm, to collect in; a recording has none"
        )
    if cell.world.cell.number != number:
        cell.close()
        raise BaggieError(
            f"{path} describes cell {cell.world.cell.number}, not {number}; give --cell to match"
        )
    return cell


def collect(options: CollectOptions, open_cell: OpenCell = open_simulated_cell) -> dict[str, Any]:
    """Collect until `options.attempts` attempts are in `options.out`; the summary, ready for JSON.

    Raises `BaggieError` when the cell cannot be calibrated, nobody could help a stalled collector, the disk
    is full, or the folder holds another recording: what was recorded before stays, and the same command goes
    on from there. Raises `KeyboardInterrupt`, with how to go on as its message, when stopped.
    """
    options.check()
    if options.demonstrated:
        return record_demonstrations(options)
    robot = SIMULATED_ROBOT
    if options.workcell is not None:
        written = _read(options.workcell, options.workers)
        open_cell, robot = functools.partial(open_written_cell, written, options.workcell), _robot(written)
    elif open_cell is open_simulated_cell:
        open_cell = functools.partial(open_simulated_cell, scenery=options.scenery)
    console = Console(stderr=True)
    collection = {"seed": options.seed, "cell": options.cell, "scenery": options.scenery}
    with DatasetWriter(
        options.out,
        task=INSTRUCTIONS[options.task],
        robot_type=robot,
        picture_size=PICTURE_SIZE,
        collection=collection,
    ) as writer:
        try:
            image_to_robot = _calibrated(options, open_cell, console)
            rate = _record(options, open_cell, image_to_robot, writer, console)
        except KeyboardInterrupt:
            recorded = f"{len(writer.attempt_ids)} of {options.attempts} attempts recorded"
            raise KeyboardInterrupt(f"interrupted with {recorded}; go on with: {options.command()}") from None
    dataset = open_dataset(options.out)
    draw_coverage(dataset, image_to_robot.area, options.out / COVERAGE_FILE)
    summary = summarize(dataset, image_to_robot.area)
    return {
        **summary,
        "attempts_per_minute": rate,
        "coverage_picture": str(options.out / COVERAGE_FILE),
    }


def _read(path: Path, workers: int | None) -> WorkcellFile:
    """What a workcell file says. Raises `BaggieError`, also where there are more workers than arms."""
    from baggie.workcell.workcell_file import REAL_ARMS, read_workcell_file  # noqa: PLC0415 -- MuJoCo takes its time

    written = read_workcell_file(path)
    if isinstance(written.arm, REAL_ARMS) and workers != 1:
        raise BaggieError(
            f"expected --workers 1 with {path}, which has one arm, got {workers or 'all cores'}"
        )
    return written


def _robot(written: WorkcellFile) -> str:
    """What the recording says moved."""
    from baggie.workcell.franka_models import MODELS  # noqa: PLC0415 -- MuJoCo takes its time
    from baggie.workcell.workcell_file import REAL_ARMS, FrankaEntry  # noqa: PLC0415

    if isinstance(written.arm, FrankaEntry):
        return MODELS[written.arm.model].title
    return written.arm.kind if isinstance(written.arm, REAL_ARMS) else SIMULATED_ROBOT


def _calibrated(options: CollectOptions, open_cell: OpenCell, console: Console) -> ImageToRobot:
    """The collector's map from the picture to the robot: as saved, or fitted now."""
    from baggie.policies.color_mask import CONFIG_FILE, ColorMaskPolicy  # noqa: PLC0415 -- as in workers

    folder = options.out / CALIBRATION_FOLDER
    if not (folder / CONFIG_FILE).exists():
        with console.status("calibrating the picture to the robot"), closing(open_cell(options.cell)) as cell:
            calibrate_into(folder, cell, options.seed, options.watched)
    image_to_robot = ColorMaskPolicy.load(folder).image_to_robot
    residuals = image_to_robot.residuals
    console.print(
        f"picture to robot: {residuals.kept.sum()} points, residual {residuals.rms_mm:.1f} mm, "
        f"{residuals.leave_one_out_mm:.1f} mm leave-one-out"
    )
    return image_to_robot


def _record(
    options: CollectOptions,
    open_cell: OpenCell,
    image_to_robot: ImageToRobot,
    writer: DatasetWriter,
    console: Console,
) -> float | None:
    """Run what is missing; attempts per minute, or None when nothing was."""
    sittings = missing_sittings(options.attempts, writer.attempt_ids)
    if not sittings:
        console.print(f"all {options.attempts} attempts are recorded already")
        return None
    recording = Recording(INSTRUCTIONS[options.task], options.seed, options.cell, PICTURE_SIZE)
    reference = options.out / CALIBRATION_FOLDER / REFERENCE_FILE if options.watched else None
    worker = functools.partial(_open_worker, open_cell, image_to_robot, recording, reference)
    done, good, start = 0, 0, time.monotonic()
    recorded = sum(attempt_id < options.attempts for attempt_id in writer.attempt_ids)
    workers = options.workers or os.cpu_count() or 1
    with progress_bar("collecting", options.attempts, recorded, console) as advance:
        for attempt in stream_in_processes(worker, sittings, workers):
            writer.append(attempt)
            done, good = done + 1, good + attempt.outcome.success
            rate = 60 * done / (time.monotonic() - start)
            advance(f"{good}/{done} succeeded, {rate:.0f} a minute")
    return 60 * done / (time.monotonic() - start)


def missing_sittings(attempts: int, recorded: Iterable[int]) -> list[tuple[int, ...]]:
    """The ids that are still to be recorded, `0 .. attempts - 1`, by sitting, early ones first."""
    missing = sorted(set(range(attempts)) - set(recorded))
    sittings: dict[int, list[int]] = {}
    for attempt_id in missing:
        sittings.setdefault(attempt_id // ATTEMPTS_PER_SITTING, []).append(attempt_id)
    return [tuple(ids) for ids in sittings.values()]


def _open_worker(
    open_cell: OpenCell, image_to_robot: ImageToRobot, recording: Recording, reference: Path | None
) -> Callable[[tuple[int, ...]], Iterable[Attempt]]:
    """What a worker process does: run a sitting from its start and hand over the attempts asked for."""
    cv2.setNumThreads(1)
    cell = open_cell(recording.cell)
    cell.watch = Watch(read_picture(reference)) if reference else None

    def sit(wanted: tuple[int, ...]) -> Iterable[Attempt]:
        number = wanted[0] // ATTEMPTS_PER_SITTING
        first = 0 if cell.repeatable else wanted[0] % ATTEMPTS_PER_SITTING
        for attempt in run_sitting(cell, image_to_robot, recording, number, first=first):
            if attempt.attempt_id in wanted:
                yield attempt
            if attempt.attempt_id == wanted[-1]:
                return

    return sit
