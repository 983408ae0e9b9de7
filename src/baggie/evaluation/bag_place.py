"""The closed loop with bags: one bag, one goal, and where the bag ends."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import closing
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Console

from baggie.calibration.files import MAP_FILE
from baggie.collect.calibrate import calibrate_into
from baggie.data.layout import CALIBRATION_FOLDER
from baggie.evaluation.bench import Bench
from baggie.evaluation.card_map import card_map
from baggie.evaluation.closed_loop_metrics import measure
from baggie.evaluation.episode import Episode, run_episode
from baggie.evaluation.kind import Kind
from baggie.evaluation.options import EvaluateOptions
from baggie.evaluation.subjects import UNKNOWN, calibration_folder, fingerprint_of
from baggie.policies import ColorMaskPolicy
from baggie.policies.color_mask import CONFIG_FILE
from baggie.seeds import EVALUATION


def open_any_bench(options: EvaluateOptions) -> Bench:
    """The cell and the policy named; imported late, because MuJoCo takes its time."""
    if options.workcell is not None:
        from baggie.evaluation.seen_bench import open_bench as open_seen_bench  # noqa: PLC0415

        return open_seen_bench(options)
    from baggie.evaluation.simulated_bench import open_bench  # noqa: PLC0415

    return open_bench(options)


def _run(bench: Bench, number: int, options: EvaluateOptions) -> Episode:
    return run_episode(
        bench,
        number,
        (EVALUATION, options.seed),
        goal_kind=options.goal,
        retries=options.retries,
        out=options.out / "episodes",
        film=number < options.film,
    )


def _measure(episodes: Sequence[Episode], options: EvaluateOptions) -> dict[str, Any]:
    return measure(episodes, options.radius_cm)


def _note(episode: Episode) -> str:
    return f"last {episode.distance_cm:.1f} cm from its goal"


def _conditions(options: EvaluateOptions, console: Console) -> dict[str, Any]:
    raised = {"card_raised": _card_raised(options, console)} if options.goal == "card" else {}
    where: dict[str, Any] = {"scenery": options.scenery}
    if options.workcell is not None:
        where = {"workcell_says": _says(options.workcell)}
    return {
        **where,
        "goal": options.goal,
        **raised,
        "retries": options.retries,
        "calibration": fingerprint_of(*_maps(options)) or "none given",
    }


def _says(workcell: Path) -> str:
    """A fingerprint of what a workcell file says, and the calibrations it names, but for where arm and camera are."""
    from baggie.workcell.workcell_file import read_workcell_file  # noqa: PLC0415 -- MuJoCo takes its time

    if not workcell.exists():
        return UNKNOWN
    file = read_workcell_file(workcell)
    follows = {"bag": file.bag.recorded(), "handling": asdict(file.handled().handling)}
    written = {**file.model_dump(mode="json"), **follows}
    for section in (written["arm"], written["camera"] or {}):
        for address in ("host", "port", "source", "timeout_s"):
            section.pop(address, None)
    maps = [workcell.parent / path for path in written.pop("calibrations").values() if path]
    return fingerprint_of(*maps, besides=json.dumps(written, sort_keys=True).encode())


def _maps(options: EvaluateOptions) -> list[Path]:
    """The files of the calibration that bags are carried by; none where the folder's own is used, or the workcell's."""
    if options.policy == ColorMaskPolicy.name:
        if options.calibration is None:
            return []
        folder = calibration_folder(options.calibration)
        ColorMaskPolicy.load(folder)  # refused before anything is written
        return [folder / CONFIG_FILE, folder / MAP_FILE]
    of_the_card = card_map(options)
    return [] if of_the_card is None else [of_the_card]


def _card_raised(options: EvaluateOptions, console: Console) -> bool:
    """Whether a map of the cell is, or will be, known that raises a card's corners to the bag's height."""
    will_be = options.policy == ColorMaskPolicy.name and options.calibration is None
    if will_be or card_map(options) is not None:
        return True
    console.print(
        "warning: no calibration of this cell tells how much lower a card lies than a bag's middle; its corners are "
        "taken as seen, some millimetres off at the picture's edge; give --calibration a recording of the cell"
    )
    return False


def _calibrate_if_needed(options: EvaluateOptions, console: Console) -> None:
    """Calibrate the cell for `color-mask`, once for all processes, unless a calibration is given."""
    folder = options.out / CALIBRATION_FOLDER
    needed = (
        options.policy == ColorMaskPolicy.name and options.workcell is None and options.calibration is None
    )
    if not needed or (folder / CONFIG_FILE).exists():
        return
    from baggie.workcell.simulated import open_simulated  # noqa: PLC0415

    with (
        console.status("calibrating the picture to the robot"),
        closing(open_simulated(options.cell)) as cell,
    ):
        calibrate_into(folder, cell, options.seed)


BAGS = Kind(
    log="episodes.jsonl",
    episode=Episode,
    open_bench=open_any_bench,
    run=_run,
    measure=_measure,
    note=_note,
    conditions=_conditions,
    prepare=_calibrate_if_needed,
)
