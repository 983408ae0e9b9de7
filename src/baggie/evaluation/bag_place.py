"""The closed loop with bags: one bag, one goal, and where the bag ends.

What many episodes say together.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from contextlib import closing
from dataclasses import asdict
from pathlib import Path
from typing import Any

from baggie.calibration.files import MAP_FILE
from baggie.collect.calibrate import calibrate_into
from baggie.data.files import CALIBRATION_FOLDER
from baggie.evaluation.episode import Episode, Kind, run_episode
from baggie.evaluation.setup import Bench, card_map
from baggie.evaluation.subjects import UNKNOWN, calibration_folder, fingerprint_of
from baggie.metrics import Rate, success_rate, summary, within_stated
from baggie.operator import Caution, Operator, progress
from baggie.options.evaluating import EvaluateOptions
from baggie.policies import ColorMaskPolicy
from baggie.policies.baselines import CONFIG_FILE
from baggie.seeds import EVALUATION

RADII_CM = (1.0, 2.0, 3.0)


def measure(episodes: Sequence[Episode], radius_cm: float) -> dict[str, Any]:
    """`success` within `radius_cm`, `success_within` 1, 2, 3 cm, summaries of errors and times, failures.

    The cause of a failure is what the cell or the policy gave, else `off-goal`; `asked_for_help` is the share of
    episodes in which the plan was less sure than the workcell asks for. Errors of picks and places, and `confidence`,
    how true plans are to the radii they state, are of the last plan of each episode that had one.
    """
    distances = [episode.distance_cm for episode in episodes]

    def within(radius: float) -> Rate:
        return success_rate(sum(distance <= radius for distance in distances), len(distances))

    failed = [episode for episode in episodes if episode.distance_cm > radius_cm]
    causes = Counter(episode.failure or "off-goal" for episode in failed)
    decisions = [ms for episode in episodes for ms in episode.decision_ms]
    return {
        "success": within(radius_cm),
        "radius_cm": radius_cm,
        "success_within": {f"{radius:g}_cm": within(radius) for radius in RADII_CM},
        "distance_cm": summary(distances),
        "yaw_error_deg": summary([episode.yaw_error_deg for episode in episodes]),
        **_of_plans(episodes),
        **({"decision_ms": summary(decisions)} if decisions else {}),
        "looks": summary([episode.looks for episode in episodes]),
        "asked_for_help": success_rate(sum(e.failure == "unsure" for e in episodes), len(episodes)),
        "failures": dict(causes.most_common()),
    }


def _of_plans(episodes: Sequence[Episode]) -> dict[str, Any]:
    """Summaries of the plans' errors, and `confidence` where plans state radii; empty without a plan."""
    picks = [(e.pick_error_cm, e.pick_within_m) for e in episodes if e.pick_error_cm is not None]
    places = [e.place_error_cm for e in episodes if e.place_error_cm is not None]
    # A plan states of its place where the object will end, so only what was carried there says how true that is.
    ended = [(e.distance_cm, e.place_within_m) for e in episodes if e.executed is not None and not e.failure]
    turned = [e.pick_yaw_error_deg for e in episodes if e.pick_yaw_error_deg is not None]
    if not picks:
        return {}
    confidence: dict[str, Any] = {}
    for what, stated in (("pick", picks), ("place", ended)):
        if not stated:
            continue
        errors, radii = zip(*stated, strict=True)
        confidence |= within_stated(what, errors, radii)
    return {
        "pick_error_cm": summary([error for error, _ in picks]),
        "place_error_cm": summary(places),
        "pick_yaw_error_deg": summary(turned),
        **({"confidence": confidence} if confidence else {}),
    }


def open_any_bench(options: EvaluateOptions) -> Bench:
    """The cell and the policy named; imported late, because MuJoCo takes its time."""
    if options.workcell is not None:
        from baggie.evaluation.opening import open_real_bench  # noqa: PLC0415

        return open_real_bench(options)
    from baggie.evaluation.opening import open_simulated_bench  # noqa: PLC0415

    return open_simulated_bench(options)


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


def _conditions(options: EvaluateOptions, operator: Operator) -> dict[str, Any]:
    raised = {"card_raised": _card_raised(options, operator)} if options.goal == "card" else {}
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


def _card_raised(options: EvaluateOptions, operator: Operator) -> bool:
    """Whether a map of the cell is, or will be, known that raises a card's corners to the bag's height."""
    will_be = options.policy == ColorMaskPolicy.name and options.calibration is None
    if will_be or card_map(options) is not None:
        return True
    as_seen = (
        "no calibration of this cell tells how much lower a card lies than a bag's middle; its corners are "
        "taken as seen, some millimetres off at the picture's edge; give --calibration a recording of the cell"
    )
    operator.tell(Caution(as_seen))
    return False


def _calibrate_if_needed(options: EvaluateOptions, operator: Operator) -> None:
    """Calibrate the cell for `color-mask`, once for all processes, unless a calibration is given."""
    folder = options.out / CALIBRATION_FOLDER
    needed = (
        options.policy == ColorMaskPolicy.name and options.workcell is None and options.calibration is None
    )
    if not needed or (folder / CONFIG_FILE).exists():
        return
    from baggie.workcell.simulated import open_simulated  # noqa: PLC0415

    with (
        progress(operator, "calibrating the picture to the robot"),
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
