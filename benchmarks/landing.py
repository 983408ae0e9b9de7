"""Where bags end in the virtual lab, and why: the closed loop against the truth, step by step, beside the simulator's.

    python benchmarks/landing.py --policy runs/policies/cell-15/keypoint --cell 15

Needs `benchmarks/rehearsal.py`'s calibration, which it makes where there is none. Goes on where it stopped and writes
RESULTS.{json,md}.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from baggie.evaluation.closed_loop import EvaluateOptions, evaluate
from baggie.evaluation.log import LOG, Episode, append_line, read_episodes, read_lines
from baggie.evaluation.setup import Setup, open_setup
from baggie.geometry import PlanarPose
from baggie.lab.web import LabControl
from baggie.results import provenance, write_results
from baggie.types import Observation
from rehearsal import Options as Rehearsal
from rehearsal import calibrate, lab, step

TRUTHS = "truths.jsonl"
"""Where the lab's bag truly was in every picture that a place was measured in."""
FIRST_TOUCH_N = 3.0
"""What hangs in the hand was let go at this force until it turned out to topple then."""


@dataclass(frozen=True)
class Options:
    """Measure."""

    policy: Path = Path("runs/policies/cell-15/keypoint")
    """Trained in the simulated cell, on a recording of its own."""
    cell: int = 15
    episodes: int = 20
    seed: int = 0
    out: Path = Path("runs/landing")
    results: Path = Path("docs/results/landing")
    host: str = "127.0.3.2"
    camera_port: int = 8194


def main(options: Options) -> None:
    """Each condition, and a row of its medians."""
    asked = EvaluateOptions(
        policy=str(options.policy),
        out=options.out,
        episodes=options.episodes,
        seed=options.seed,
        cell=options.cell,
        workers=1,
        film=0,
    )
    rows = [
        {"where": "simulator, another bag every time", **simulated(asked, "anew", open_setup)},
        {"where": "simulator, one bag throughout", **simulated(asked, "worn", open_worn)},
        *in_lab(options, asked),
    ]
    notes = (
        f"The same policy in the same cell {options.cell}, {options.episodes} episodes each; medians, in brackets the "
        "worst, cm, against the simulation's truth; `seen` is against what the camera sees, by the map calibrated over "
        "the robot's protocol. The policy plans as well everywhere, the arm lets go where it was told to, and what "
        "differs is how bags land. A bag keeps dents from every grasp, and hangs and lands askew by them: the "
        "simulator's own evaluation lays an undented one every time, a night's work does not. And a bag that is let go "
        "as soon as it touches the table topples; pressed flat it stays. The middle of a dented bag's outline, which "
        "the camera sees, is not quite that of its matter, which is the truth's."
    )
    for path in write_results(options.results, "Where bags land", rows, provenance([options.seed]), notes):
        print(path)


def simulated(
    asked: EvaluateOptions, name: str, open_own: Callable[[EvaluateOptions], Setup]
) -> dict[str, Any]:
    """The simulated cell, whose truth is what episodes are measured by."""
    asked = replace(asked, out=asked.out / name)
    evaluate(asked, open_own)
    return row(list(read_episodes(asked.out).values()), PlanarPose)


def in_lab(options: Options, asked: EvaluateOptions) -> Iterator[dict[str, Any]]:
    """The lab, asked for the truth whenever the camera is: as bags were let go once, and as they are."""
    words = Rehearsal(
        cell=options.cell,
        seed=options.seed,
        out=options.out,
        host=options.host,
        camera_port=options.camera_port,
    )
    with lab(words) as (file, control):
        step(words, "baggie calibrate image-to-robot", lambda: calibrate(file, control))
        first_touch = file.with_name("first-touch.yaml")
        first_touch.write_text(f"{file.read_text()}handling: {{land_force_n: {FIRST_TOUCH_N:g}}}\n")
        pressed = "pressed flat before it is let go"
        for name, how, workcell, undented in (
            ("new", f"another bag every time, {pressed}", file, True),
            ("pressed", f"one bag throughout, {pressed}", file, False),
            (
                "touched",
                f"one bag throughout, let go at the first touch ({FIRST_TOUCH_N:g} N)",
                first_touch,
                False,
            ),
        ):
            asked = replace(asked, cell=EvaluateOptions.cell, workcell=workcell, out=options.out / name)
            if not (asked.out / LOG).exists():
                control.reset(options.seed)
            evaluate(asked, partial(open_watched, control.address, undented))
            truths = {
                tuple(kept["seen"]): PlanarPose(*kept["true"]) for kept in read_lines(asked.out / TRUTHS)
            }
            episodes = list(read_episodes(asked.out).values())
            yield {"where": f"lab, {how}", **row(episodes, lambda *pose, known=truths: known[pose])}


def open_worn(options: EvaluateOptions) -> Setup:
    """The simulated cell, whose bag is laid there once and stays what it has become."""
    setup = open_setup(options)
    reset, laid = setup.cell.reset, []

    def reset_once(seed: Sequence[int]) -> None:
        if not laid:
            reset(seed)
        laid.append(seed)

    setup.cell.reset = reset_once  # type: ignore[method-assign]
    return setup


def open_watched(lab_address: str, undented: bool, options: EvaluateOptions) -> Setup:
    """The workcell in the lab; what is seen is kept beside the truth. `undented`: the bag is another every time."""
    setup, control = open_setup(options), LabControl(lab_address)
    find, reset = setup.find, setup.cell.reset
    assert find is not None

    def reset_and_exchange(seed: Sequence[int]) -> None:
        reset(seed)
        if undented:
            control.lay_bag(control.bag_pose(), undented=True)

    def find_beside_truth(seen: Observation) -> PlanarPose:
        pose, true = find(seen), control.bag_pose()
        kept = {"seen": (pose.x, pose.y, pose.yaw), "true": (true.x, true.y, true.yaw)}
        append_line(options.out / TRUTHS, kept)
        return pose

    setup.cell.reset = reset_and_exchange  # type: ignore[method-assign]
    return replace(setup, find=find_beside_truth)


def row(episodes: Sequence[Episode], true: Callable[..., PlanarPose]) -> dict[str, str]:
    """Medians of what happened on the way to the goal; `true` says where the bag was when it was seen at a pose."""
    found: dict[str, list[float]] = {}
    for episode in episodes:
        landing, last = episode.landing, episode.steps[-1] if episode.steps else None
        if landing is None or last is None or last.planned is None or last.executed is None:
            continue
        ways = {
            "bag to goal": (true(*landing.final), landing.goal),
            "seen": (landing.final, landing.goal),
            "pick off": (last.planned[:3], true(*landing.start)),
            "place off": (last.planned[3:], landing.goal),
            "let go off": (last.executed[3:], last.planned[3:]),
            "bag off where it was let go": (true(*landing.final), last.executed[3:]),
        }
        for name, (a, b) in ways.items():
            found.setdefault(name, []).append(100 * float(np.hypot(*(xy(a) - xy(b)))))
    return {name: f"{np.median(values):.2f} ({np.max(values):.2f})" for name, values in found.items()}


def xy(pose: PlanarPose | Sequence[float]) -> np.ndarray:
    """`(2,)` metres."""
    return pose.xy if isinstance(pose, PlanarPose) else np.asarray(pose[:2])


if __name__ == "__main__":
    main(tyro.cli(Options))
