"""`baggie evaluate`: look, plan, move, check, on scenes no policy has seen; how often it ends well."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import torch

from baggie.errors import BaggieError
from baggie.evaluation.episode import run_episode
from baggie.evaluation.log import Credit, Episode, Landing, append_episode, read_episodes
from baggie.evaluation.setup import (
    UNKNOWN,
    Setup,
    calibrate_if_needed,
    check_taught,
    config_of,
    fingerprint,
    in_its_cell,
    open_setup,
    policy_name,
)
from baggie.evaluation.terms import Terms
from baggie.metrics import success_rate, summary, within_stated
from baggie.operator import Caution, Operator, TerminalOperator, progress
from baggie.options.evaluating import EvaluateOptions
from baggie.policies.learned import check_device
from baggie.processes import Executor, LocalProcesses
from baggie.results import EVALUATION, check_unmixed, provenance, write_json
from baggie.workcell.workcell_file import read_workcell_file

__all__ = ["EvaluateOptions", "OpenSetup", "evaluate"]

_LATER = frozenset({"device", "calibration", "workcell_says"})
"""What older versions did not write down of an evaluation."""
OpenSetup = Callable[[EvaluateOptions], Setup]
"""Opens a cell and the policy to try in it; called once in each process, so it must be a function of a module."""


def evaluate(
    options: EvaluateOptions,
    open_own: OpenSetup | None = None,
    *,
    operator: Operator | None = None,
    executor: Executor | None = None,
) -> dict[str, Any]:
    """Run the episodes that are missing in `options.out`, write `metrics.json` there, and return it.

    The same options give the same episodes, whatever the number of workers and however often interrupted; in a real
    workcell each starts where the one before it ended. Cell and policy are those of the options unless `open_own` opens
    others; the person at the terminal is told, and processes of this machine run them, unless `operator` or `executor`
    is given.
    Raises `BaggieError` for an unknown task, scenery, goal or policy, for what a real workcell cannot go on with, or
    when `out` holds another evaluation; `KeyboardInterrupt`, with how to go on as its message, when stopped.
    """
    options.check()
    check_device(options.device)
    check_unmixed(options.out, EVALUATION)
    operator = operator or TerminalOperator()
    name = policy_name(options.policy)
    check_taught(options.policy, options.task)
    _warn_of_another_cell(options, operator)
    terms = Terms.of(options, operator)
    _same_evaluation(options, terms)
    if open_own is None:
        calibrate_if_needed(options, operator)
    episodes = read_episodes(options.out)
    missing = [number for number in range(options.episodes) if number not in episodes]
    worker = partial(_open_worker, options, open_own or open_setup)
    try:
        with progress(operator, "evaluating", options.episodes, options.episodes - len(missing)) as advance:
            run = (executor or LocalProcesses()).stream
            for episode in run(worker, missing, options.processes, operator):
                append_episode(options.out, episode)
                episodes[episode.episode] = episode
                advance(_note(episode))
    except KeyboardInterrupt:
        done = f"{len(episodes)} of {options.episodes} episodes are done"
        raise KeyboardInterrupt(f"interrupted: {done}; the same command again goes on from there") from None
    metrics = {
        "policy": name,
        "run": Path(options.policy).name,
        **terms.to_json(),
        **_robot(options),
        **measure([episodes[number] for number in range(options.episodes)], options.radius_cm),
        "provenance": provenance([options.seed]),
    }
    write_json(options.out / "metrics.json", metrics)
    return metrics


def _open_worker(
    options: EvaluateOptions, open_own: OpenSetup, _operator: Operator
) -> Callable[[int], Iterable[Episode]]:
    # Sums in another order would give other plans: results must not depend on how many work beside.
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    setup = open_own(options)

    def run(number: int) -> Iterable[Episode]:
        yield run_episode(setup, number, options)

    return run


def _note(episode: Episode) -> str:
    """How an episode ended, beside the progress."""
    if episode.landing is not None:
        return f"last {episode.landing.distance_cm:.1f} cm from its goal"
    return f"last got {100 * episode.credit.partial_credit:.0f}% done" if episode.credit else ""


def _warn_of_another_cell(options: EvaluateOptions, operator: Operator) -> None:
    if options.workcell is None and not in_its_cell(options.policy, options.cell):
        trained_in = config_of(options.policy)["cell"]
        belongs = f"{options.policy} belongs to cell {trained_in}, not to cell {options.cell}"
        operator.tell(Caution(belongs))


def _robot(options: EvaluateOptions) -> dict[str, Any]:
    """What moved, where a file says it."""
    if options.workcell is None or not options.workcell.exists():
        return {}
    return {"robot": read_workcell_file(options.workcell).arm.title(options.workcell.parent)}


def _same_evaluation(options: EvaluateOptions, terms: Terms) -> None:
    """Never mix two evaluations in one folder: the log belongs to one policy, one stream of scenes, and all else that
    decides how an episode ends. What older versions did not write down is taken to be the same.
    """
    path = options.out / EVALUATION
    asked = {
        "policy": options.policy,
        "fingerprint": fingerprint(options.policy),
        "seed": options.seed,
        "device": options.device,
        **terms.to_json(),
    }
    found = json.loads(path.read_text()) if path.exists() else {}
    no_longer = {entry.name: None for entry in fields(Terms) if entry.name in found.keys() - asked.keys()}
    for key, value in (asked | no_longer).items():
        told = found.get(key, UNKNOWN if key in _LATER or not found else None)
        if told not in (UNKNOWN, value):
            raise BaggieError(
                f"{options.out} holds an evaluation with {key} {told}, not {value}; "
                "give another --out, or remove it to start again"
            )
    if found != found | asked:
        write_json(path, found | asked)


RADII_CM = (1.0, 2.0, 3.0)


def measure(episodes: Sequence[Episode], radius_cm: float) -> dict[str, Any]:
    """`success`, strictly or within `radius_cm`; steps and times; failures by cause; and what the task gives besides.

    Of objects with a goal in the picture: `success_within` 1, 2, 3 cm, where they ended, and how good plans were. Of
    tasks that say themselves where things go: `ravens_success` and `partial_credit`, and of stacked bags `layers`.
    `asked_for_help` is the share of episodes in which the plan was less sure than the workcell asks for.
    """
    count, steps = len(episodes), [step for episode in episodes for step in episode.steps]
    failed = [episode for episode in episodes if not episode.succeeded(radius_cm)]
    landings = [episode.landing for episode in episodes if episode.landing is not None]
    credits = [episode.credit for episode in episodes if episode.credit is not None]
    return {
        "success": success_rate(count - len(failed), count),
        **(_of_landings(landings, radius_cm) | _of_plans(episodes) if landings else {}),
        **(_of_credits(credits) if credits else {}),
        "steps": summary([len(episode.steps) for episode in episodes]),
        **({"looks": summary([len(episode.steps) for episode in episodes])} if landings else {}),
        **({"decision_ms": summary([step.decision_ms for step in steps])} if steps else {}),
        "asked_for_help": success_rate(sum(episode.failure == "unsure" for episode in episodes), count),
        "failures": _counted(episode.failure or "off-goal" for episode in failed),
        "failed_steps": _counted(step.failure for step in steps),
    }


def _of_landings(landings: Sequence[Landing], radius_cm: float) -> dict[str, Any]:
    distances = [landing.distance_cm for landing in landings]
    within = {
        f"{radius:g}_cm": success_rate(sum(distance <= radius for distance in distances), len(distances))
        for radius in RADII_CM
    }
    return {
        "radius_cm": radius_cm,
        "success_within": within,
        "distance_cm": summary(distances),
        "yaw_error_deg": summary([landing.yaw_error_deg for landing in landings]),
    }


def _of_credits(credits: Sequence[Credit]) -> dict[str, Any]:
    layered = [credit for credit in credits if credit.layers]
    return {
        "ravens_success": success_rate(sum(credit.ravens_success for credit in credits), len(credits)),
        "partial_credit": summary([credit.partial_credit for credit in credits]),
        **({"layers": _of_layers(layered)} if layered else {}),
    }


def _of_layers(credits: Sequence[Credit]) -> dict[str, Any]:
    """Of each layer of a pattern, from 1 below: how often it is right at the end, and how far off its bags are then."""
    of_all = zip(*(zip(credit.layers, credit.offsets_cm, strict=True) for credit in credits), strict=True)
    layers: dict[str, Any] = {}
    for number, of_one in enumerate(of_all, start=1):
        offsets = [off for _, layer in of_one for off in layer if off is not None]
        right = success_rate(sum(right for right, _ in of_one), len(of_one))
        layers[str(number)] = {"success": right, **({"offset_cm": summary(offsets)} if offsets else {})}
    return layers


def _of_plans(episodes: Sequence[Episode]) -> dict[str, Any]:
    """Summaries of the last plans' errors, and `confidence`, how true plans are to the radii they state."""
    last = [(episode, episode.steps[-1]) for episode in episodes if episode.steps]
    picks = [(s.pick_error_cm, s.pick_within_m) for _, s in last if s.pick_error_cm is not None]
    if not picks:
        return {}
    # A plan states of its place where the object will end, so only what was carried there says how true that is.
    ended = [
        (e.landing.distance_cm, s.place_within_m)
        for e, s in last
        if e.landing is not None and s.executed is not None and not e.failure
    ]
    confidence: dict[str, Any] = {}
    for what, stated in (("pick", picks), ("place", ended)):
        if stated:
            errors, radii = zip(*stated, strict=True)
            confidence |= within_stated(what, errors, radii)
    return {
        "pick_error_cm": summary([error for error, _ in picks]),
        "place_error_cm": summary([s.place_error_cm for _, s in last if s.place_error_cm is not None]),
        "pick_yaw_error_deg": summary(
            [s.pick_yaw_error_deg for _, s in last if s.pick_yaw_error_deg is not None]
        ),
        **({"confidence": confidence} if confidence else {}),
    }


def _counted(causes: Iterable[str]) -> dict[str, int]:
    """How often each came, the most frequent first; no cause is no failure."""
    return dict(Counter(cause for cause in causes if cause).most_common())
