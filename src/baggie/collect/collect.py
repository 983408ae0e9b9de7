"""Collect attempts unattended: calibrate once, then sittings of ten attempts on every core."""

from __future__ import annotations

import functools
import os
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import cv2

from baggie.calibration.files import REFERENCE_FILE
from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.collect.calibrate import calibrate_into
from baggie.collect.cell import CollectorCell, OpenCell, what_opens
from baggie.collect.demonstrations import record_demonstrations
from baggie.collect.sitting import ATTEMPTS_PER_SITTING, PAUSES_S, Awaited, Patience, Recording, run_sitting
from baggie.collect.summary import draw_coverage, summarize
from baggie.data import DatasetWriter, open_dataset
from baggie.data.files import CALIBRATION_FOLDER
from baggie.errors import BaggieError
from baggie.files import write_if_possible
from baggie.operator import Line, Operator, TerminalOperator, progress
from baggie.options.collecting import CollectOptions
from baggie.pictures import read_picture, recorded_size, same_shape
from baggie.processes import Executor, LocalProcesses, OpenWorker
from baggie.registry import TASKS
from baggie.types import Attempt
from baggie.workcell.workcell import Watch
from baggie.workcell.workcell_file import SIMULATED

COVERAGE_FILE = "coverage.png"

Ids = tuple[int, ...]
"""Of attempts of one sitting."""
Sit = Callable[[Ids], Iterable[Attempt]]
"""Makes the attempts with these ids."""


def collect(
    options: CollectOptions,
    open_cell: OpenCell | None = None,
    *,
    operator: Operator | None = None,
    executor: Executor | None = None,
) -> dict[str, Any]:
    """Collect until `options.attempts` attempts are in `options.out`; the summary, ready for JSON.

    In the cell that the options say, unless `open_cell` opens another. Faults of an arm or a camera that are not
    simulated are borne with patience (`sitting.py`), and a person is asked for what only one can do: the one at the
    terminal unless `operator` is given. Attempts are made in processes of this machine unless `executor` is given.
    Raises `BaggieError` when faults do not end, nobody helps, the cell cannot be calibrated, the disk is full, or the
    folder holds another recording: what was recorded before stays, and the same command goes on from there. Raises
    `KeyboardInterrupt`, with how to go on as its message, when stopped.
    """
    options.check()
    if options.demonstrated:
        return record_demonstrations(options, operator=operator, executor=executor)
    operator = operator or TerminalOperator()
    open_cell, robot, table = what_opens(options, open_cell)
    simulated = robot == SIMULATED
    patience = Patience(operator, () if simulated else PAUSES_S)
    collection = {"seed": options.seed, "cell": options.cell, "scenery": options.scenery, **table}

    def calibrated() -> ImageToRobot:
        (image_to_robot,) = patience.bear(lambda: [_calibrated(options, open_cell, operator)])
        return image_to_robot

    writer: DatasetWriter | None = None
    try:
        with DatasetWriter(
            options.out,
            task=TASKS[options.task].instruction,
            robot_type=robot,
            picture_size=lambda: recorded_size(calibrated().camera.size),
            collection=collection,
        ) as writer:
            image_to_robot, size = calibrated(), writer.settings.picture_size
            _describe(image_to_robot, size, operator)
            worker = _worker(options, open_cell, image_to_robot, size)
            awaited = Awaited(operator, 60 * options.wait, can_help=not simulated)
            workers = options.workers or ((os.cpu_count() or 1) if simulated else 1)
            run = functools.partial(
                (executor or LocalProcesses()).stream, worker, workers=workers, operator=awaited
            )
            rate = _record(options, writer, run, patience, awaited)
    except KeyboardInterrupt:
        recorded = f"{len(writer.attempt_ids) if writer else 0} of {options.attempts} attempts recorded"
        raise KeyboardInterrupt(f"interrupted with {recorded}; go on with: {options.command()}") from None
    dataset = open_dataset(options.out)
    summary = {**summarize(dataset, image_to_robot.area), "attempts_per_minute": rate}
    picture = options.out / COVERAGE_FILE
    if write_if_possible(picture, functools.partial(draw_coverage, dataset, image_to_robot.area)):
        summary["coverage_picture"] = str(picture)
    return summary


def _calibrated(options: CollectOptions, open_cell: OpenCell, operator: Operator) -> ImageToRobot:
    """The collector's map from the picture to the robot: as saved, or fitted now."""
    from baggie.policies.color_mask import CONFIG_FILE, ColorMaskPolicy  # noqa: PLC0415 -- as in workers

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


def _record(
    options: CollectOptions,
    writer: DatasetWriter,
    run: Callable[[Iterable[Ids]], Iterator[Attempt]],
    patience: Patience,
    operator: Awaited,
) -> float | None:
    """Have what is missing `run`; attempts per minute, or None when nothing was."""
    if not missing_sittings(options.attempts, writer.attempt_ids):
        operator.tell(Line(f"all {options.attempts} attempts are recorded already"))
        return None
    done, good, start = 0, 0, time.monotonic()
    recorded = sum(attempt_id < options.attempts for attempt_id in writer.attempt_ids)

    with progress(operator, "collecting", options.attempts, recorded) as advance:

        def missing() -> Iterator[Attempt]:
            return run(missing_sittings(options.attempts, writer.attempt_ids))

        for attempt in patience.bear(missing):
            writer.append(attempt)
            if attempt.outcome.success:
                operator.worked()
            done, good = done + 1, good + attempt.outcome.success
            rate = 60 * done / (time.monotonic() - start)
            advance(f"{good}/{done} succeeded, {rate:.0f} a minute")
    return 60 * done / (time.monotonic() - start)


def missing_sittings(attempts: int, recorded: Iterable[int]) -> list[Ids]:
    """The ids that are still to be recorded, `0 .. attempts - 1`, by sitting, early ones first."""
    missing = sorted(set(range(attempts)) - set(recorded))
    sittings: dict[int, list[int]] = {}
    for attempt_id in missing:
        sittings.setdefault(attempt_id // ATTEMPTS_PER_SITTING, []).append(attempt_id)
    return [tuple(ids) for ids in sittings.values()]


def _worker(
    options: CollectOptions, open_cell: OpenCell, image_to_robot: ImageToRobot, size: tuple[int, int]
) -> OpenWorker[Ids, Attempt]:
    """What a worker process begins with, to record pictures of `size`, pixels."""
    recording = Recording(
        TASKS[options.task].instruction, options.seed, options.cell, size, depth=TASKS[options.task].depth
    )
    reference = options.out / CALIBRATION_FOLDER / REFERENCE_FILE if options.watched else None
    return functools.partial(_open_worker, open_cell, image_to_robot, recording, reference)


def _check_camera(cell: CollectorCell, image_to_robot: ImageToRobot) -> None:
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

    def sit(wanted: Ids) -> Iterable[Attempt]:
        number = wanted[0] // ATTEMPTS_PER_SITTING
        first = 0 if cell.repeatable else wanted[0] % ATTEMPTS_PER_SITTING
        for attempt in run_sitting(cell, image_to_robot, recording, number, operator=operator, first=first):
            if attempt.attempt_id in wanted:
                yield attempt
            if attempt.attempt_id == wanted[-1]:
                return

    return sit
