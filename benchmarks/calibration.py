"""How far from the truth calibrations are, over many simulated cells, and whether their stated uncertainty is honest.

    python benchmarks/calibration.py --cells 50 --out runs/calibration

In each cell: (1) with exact detections; (2) with detections as noisy as real ones and a fifth of them wrong, against
the same without the wrong ones; (3) live, from pictures: every calibration as its command makes it, with the cell's own
lens, lamps, exposure and noise, and a blur of 0.3 to 1 pixel. Cells that are done are kept in OUT/cells.jsonl, again
goes on; without that file, what was recorded is fitted again. Writes docs/results/calibration.{json,md}.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tyro
from rich.progress import track

from baggie.calibration.camera_to_world import CameraToWorld, fit_camera_to_world
from baggie.calibration.files import CameraIdentity
from baggie.calibration.hand_eye.solve import solve_hand_eye
from baggie.calibration.hand_eye.views import HandEyeViews, read_views
from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.calibration.intrinsics.camera_calibration import CameraCalibration
from baggie.calibration.intrinsics.fit import fit_intrinsics
from baggie.calibration.intrinsics.views import BoardView
from baggie.calibration.point_registration import T_world_target, points_to_touch
from baggie.calibration.pose import UncertainTransform
from baggie.calibration.robot_to_world import compose, fit_from_points
from baggie.commissioning.image_to_robot import calibrate_image_to_robot_live, grid
from baggie.commissioning.intrinsics import calibrate_intrinsics_live
from baggie.commissioning.poses import (
    calibrate_camera_to_world_live,
    calibrate_robot_to_world_live,
    random_hand_pose,
    take_hand_eye_views,
)
from baggie.commissioning.session import Session, open_session
from baggie.commissioning.simulated_assistant import SimulatedAssistant, board_in_view, lying
from baggie.errors import BaggieError
from baggie.files import write_text
from baggie.geometry import FloatArray, PlanarPose, Rectangle, invert_transform, rigid, transform_points
from baggie.operator import Nobody, Operator
from baggie.options.commissioning import (
    CameraToWorldOptions,
    HandEyeOptions,
    ImageToRobotOptions,
    IntrinsicsOptions,
    LiveOptions,
    RobotToWorldOptions,
)
from baggie.options.values import BOARD, HAND_BOARD
from baggie.processes import LocalProcesses
from baggie.results import provenance, write_results
from baggie.sim.cell import Cell, draw_cell
from baggie.types import Observation
from baggie.vision.targets import Target, TargetDetection, parse_target
from baggie.workcell.simulated import SimulatedWorkcell

RESULTS = Path("docs/results")
WORKSPACE = Rectangle(0.35, 0.65, -0.30, 0.30)
NOISE_PX, TOUCH_M = 0.2, 0.0003
WRONG = 0.2
INSIDE, STATED = "in 95%", "stated mm"
COLUMNS = (
    "calibration",
    "from",
    "cells",
    *(f"{u} {s}" for u in ("mm", "deg") for s in ("median", "RMS", "worst")),
)
Truth = dict[str, Any]


@dataclass(frozen=True)
class Options:
    """How many cells, and where to keep what is done."""

    cells: int = 50
    """Cells 0, 1, ...; each has another camera, lens, lamps and table."""
    out: Path = Path("runs/calibration")
    """Folder of the cells that are done."""
    workers: int = 2
    """Processes."""


def main(options: Options) -> None:
    """Run what is missing, then write the table."""
    path = options.out / "cells.jsonl"
    options.out.mkdir(parents=True, exist_ok=True)
    done = (
        {row["cell"]: row for row in map(json.loads, path.read_text().splitlines())} if path.exists() else {}
    )
    missing = [number for number in range(options.cells) if number not in done]
    results = LocalProcesses().stream(partial(open_worker, options.out), missing, options.workers, Nobody())
    with path.open("a") as log:
        for row in track(results, "cells", total=len(missing)):
            log.write(json.dumps(row) + "\n")
            log.flush()
            done[row["cell"]] = row
    rows = [done[number] for number in range(options.cells)]
    for written in write_results(
        RESULTS / "calibration",
        f"Calibrations against the truth, in {options.cells} simulated cells",
        table(rows),
        provenance(range(options.cells)),
        NOTES,
    ):
        print(written)


NOTES = (
    "Position: distance from the true position of the camera (of the board in the hand's frame, ...), or on the table, "
    "RMS over the workspace. Over the cells: median, RMS and the worst. `in 95%`: in how many cells (for maps: at how "
    "many points of the workspace) the truth lies in the region that is to hold it with 95% probability."
)


def open_worker(folder: Path, _operator: Operator) -> Callable[[int], Iterable[dict[str, Any]]]:
    """What a process does with a cell's number."""
    cv2.setNumThreads(1)

    def run(number: int) -> Iterable[dict[str, Any]]:
        recorded = folder / f"cell-{number:02d}"
        yield {
            "cell": number,
            "exact": exact(number),
            "wrong": wrong(number),
            "pictures": pictures(number, recorded),
        }

    return run


# -- judging ---------------------------------------------------------------------------------------


def judge_pose(found: UncertainTransform, truth: FloatArray) -> Truth:
    """Errors of a pose, and whether it said so."""
    error = found.error_of(truth)
    return {
        "mm": 1000 * float(np.linalg.norm(error[3:])),
        "deg": float(np.degrees(np.linalg.norm(error[:3]))),
        "inside": found.holds(truth),
        "stated_mm": found.std_mm,
        "stated_deg": found.std_deg,
    }


def judge_map(found: ImageToRobot, cell: Cell, height_m: float = 0.0) -> Truth:
    """Errors of a map over the workspace, on the table, and at how many of the points it said so."""
    spots = grid(WORKSPACE, 0.0, (height_m,), columns=13, rows=7)
    errors = found.at_height(height_m).to_robot(cell.project(spots)) - spots[:, :2]
    covariance = found.at_height(height_m).covariance_at(spots[:, :2])
    distance = np.einsum("ni,nij,nj->n", errors, np.linalg.pinv(covariance), errors)
    return {
        "mm": 1000 * float(np.sqrt((errors**2).sum(axis=1).mean())),
        "max_mm": 1000 * float(np.linalg.norm(errors, axis=1).max()),
        "inside": float((distance <= 5.991).mean()),  # chi-squared, two degrees of freedom
        "stated_mm": found.at_height(height_m).std_mm,
    }


# -- exact and wrong detections --------------------------------------------------------------------


class Detector:
    """Where things appear to the cell's camera: exactly, or with noise, or with a share of them somewhere else."""

    def __init__(
        self, cell: Cell, rng: np.random.Generator, noise_px: float = 0.0, wrong: float = 0.0
    ) -> None:
        self.cell, self._rng, self._noise, self._wrong = cell, rng, noise_px, wrong

    def pixels(self, points: FloatArray) -> FloatArray:
        """`(N, 3)` metres, base frame -> `(N, 2)`."""
        pixels = self.cell.project(points)
        return pixels + self._rng.normal(0.0, self._noise, pixels.shape) if self._noise else pixels

    def spoil(self, values: FloatArray, size: float) -> FloatArray:
        """The same with a share of its rows replaced by something wrong by up to `size`."""
        values = values.copy()
        rows = self._rng.permutation(len(values))[: round(self._wrong * len(values))]
        values[rows] += (
            self._rng.uniform(0.2, 1.0, values[rows].shape)
            * size
            * self._rng.choice([-1, 1], values[rows].shape)
        )
        return values

    def see(self, target: Target, T_base_target: FloatArray) -> TargetDetection:
        """The target's points that are in the picture."""
        pixels = self.pixels(transform_points(T_base_target, target.points))
        inside = ((pixels > 0) & (pixels < np.array(self.cell.lens.size) - 1)).all(axis=1)
        ids = np.flatnonzero(inside)
        return TargetDetection(ids, pixels[ids], target.points[ids])


def intrinsics_of(detector: Detector, rng: np.random.Generator, views: int = 20) -> CameraCalibration:
    """From a board held in front of the camera."""
    cell, board = detector.cell, parse_target(BOARD)
    seen = [detector.see(board, board_in_view(cell, board, part, rng)) for part in range(views)]
    identity = CameraIdentity("camera", *cell.lens.size)
    named = [BoardView(f"{i}", s) for i, s in enumerate(seen) if len(s.ids) >= 8]
    return fit_intrinsics(named, identity, board)


def all_of(detector: Detector, rng: np.random.Generator, lens: CameraCalibration) -> dict[str, Truth]:
    """Every other calibration from detections alone."""
    cell, camera = detector.cell, lens.camera
    T_base_camera = invert_transform(cell.T_camera_base)
    positions = grid(WORKSPACE, 0.03, (0.05, 0.15))
    pixels = detector.spoil(detector.pixels(positions), 100.0)
    known: dict[str, Any] = {"intrinsics": lens.intrinsics, "intrinsics_covariance": lens.covariance}
    result = {
        "image to robot, lens known": judge_map(
            ImageToRobot.fit(pixels, positions, camera, limit_mm=20.0, **known), cell
        ),
        "image to robot, lens unknown": judge_map(
            ImageToRobot.fit(pixels, positions, camera, limit_mm=20.0), cell
        ),
    }
    board = parse_target(BOARD)
    T_base_target = lying(board, PlanarPose(0.5, 0.0, float(rng.uniform(-0.2, 0.2) - np.pi / 2)))
    seen = detector.see(board, T_base_target)
    seen = replace(seen, pixels=detector.spoil(seen.pixels, 50.0))
    to_world = fit_camera_to_world(
        [seen], board, camera, lens.intrinsics, lens.covariance, T_world_target=T_world_target(board)
    )
    T_base_world = T_base_target @ invert_transform(T_world_target(board))
    result["camera to world"] = judge_pose(to_world.pose, invert_transform(T_base_world) @ T_base_camera)
    world = np.array([point for _, point in points_to_touch(board, axes_only=False)])
    touched = transform_points(T_base_world, world) + rng.normal(0.0, 1.0, world.shape) * (
        TOUCH_M if detector._noise else 0.0
    )
    robot = fit_from_points(world, detector.spoil(touched, 0.05))
    result["robot to world"] = judge_pose(robot.pose, invert_transform(T_base_world))
    result["camera to robot, composed"] = judge_pose(compose(to_world, robot).pose, T_base_camera)
    views = hand_eye_views(detector, rng, lens)
    hands = detector.spoil(views.T_base_hand[:, :3, 3], 0.1)
    spoiled = replace(
        views,
        T_base_hand=np.array([rigid(T[:3, :3], p) for T, p in zip(views.T_base_hand, hands, strict=True)]),
    )
    result["camera to robot, hand-eye"] = judge_pose(solve_hand_eye(spoiled).transform, T_base_camera)
    return result


def hand_eye_views(detector: Detector, rng: np.random.Generator, lens: CameraCalibration) -> HandEyeViews:
    """A board in the hand, the camera fixed."""
    board = parse_target(HAND_BOARD)
    T_hand_board = rigid(np.diag([1.0, 1.0, 1.0]), [0.10, -0.03, 0.0])
    hands = [random_hand_pose(WORKSPACE, rng) for _ in range(15)]
    seen = [detector.see(board, hand @ T_hand_board) for hand in hands]
    return HandEyeViews.from_seen(
        "fixed",
        hands,
        [s if len(s.ids) >= 6 else None for s in seen],
        lens.intrinsics,
        intrinsics_covariance=lens.covariance,
        camera=lens.camera,
    )


def exact(number: int) -> dict[str, Truth]:
    """Everything from exact detections."""
    cell, rng = draw_cell(number), np.random.default_rng([1, number])
    detector = Detector(cell, rng)
    lens = intrinsics_of(detector, rng)
    return {"intrinsics": judge_lens(lens, cell), **all_of(detector, rng, lens)}


def wrong(number: int) -> dict[str, dict[str, float]]:
    """For each calibration its error with noisy detections, and with a fifth of them wrong as well."""
    cell = draw_cell(number)
    lens = true_lens(cell)
    clean, spoiled = (
        all_of(
            Detector(cell, np.random.default_rng([2, number]), NOISE_PX, share),
            np.random.default_rng([3, number]),
            lens,
        )
        for share in (0.0, WRONG)
    )
    return {name: {"clean_mm": clean[name]["mm"], "wrong_mm": spoiled[name]["mm"]} for name in clean}


def true_lens(cell: Cell) -> CameraCalibration:
    """The cell's own lens, as from the factory."""
    identity = CameraIdentity("camera", *cell.lens.size)
    return CameraCalibration(
        identity, cell.lens.intrinsics, None, (), None, None, (), (), (), "", "the simulator"
    )


def judge_lens(lens: CameraCalibration, cell: Cell) -> Truth:
    """How far the calibrated lens looks past where the true one does, on the table, mm."""
    spots = grid(WORKSPACE, 0.0, (0.0,), columns=13, rows=7)
    truly = transform_points(cell.T_camera_base, spots)
    apart = lens.intrinsics.rays(cell.project(spots)) * truly[:, 2:] - truly[:, :2]
    return {"mm": 1000 * float(np.sqrt((apart**2).sum(axis=1).mean()))}


# -- pictures --------------------------------------------------------------------------------------


class Blurred:
    """A camera slightly out of focus."""

    def __init__(self, camera: Any, sigma_px: float) -> None:
        self._camera, self._sigma = camera, sigma_px
        self.name, self.size = camera.name, camera.size
        self.intrinsics = None

    def look(self) -> Observation:
        """A picture."""
        seen = self._camera.look()
        return replace(seen, color=cv2.GaussianBlur(seen.color, (0, 0), self._sigma))


def pictures(number: int, folder: Path) -> dict[str, Truth]:
    """Every calibration as its command makes it, from rendered pictures; those in `folder` are not taken again."""
    rng = np.random.default_rng([4, number])
    with open_session(LiveOptions(cell=number, seed=number), Nobody()) as session:
        cell = session.workcell()
        assert isinstance(cell, SimulatedWorkcell)
        blurred: Any = Blurred(cell.camera, float(rng.uniform(0.3, 1.0)))
        cell.camera = session.camera = blurred
        return live(session, cell, folder)


def live(session: Session, cell: SimulatedWorkcell, folder: Path) -> dict[str, Truth]:
    """The commands one after the other; what fails is said, and counts as such."""
    true = cell.world.cell
    T_base_camera = invert_transform(true.T_camera_base)
    result: dict[str, Truth] = {}
    camera_file = folder / "camera.yaml"
    lens = calibrate_intrinsics_live(session, IntrinsicsOptions(out=camera_file))
    lens.save(camera_file)
    result["intrinsics"] = {**judge_lens(lens, true), "rms_px": lens.rms_px}

    def attempt(name: str, run: Callable[[], Truth]) -> None:
        try:
            result[name] = run()
        except BaggieError as error:
            result[name] = {"refused": str(error)}

    for name, known in (("image to robot, lens known", camera_file), ("image to robot, lens unknown", None)):
        options = ImageToRobotOptions(
            out=folder / "map.yaml", intrinsics=known
        )  # the second takes no new pictures
        attempt(
            name, lambda options=options: judge_map(calibrate_image_to_robot_live(session, options), true)
        )  # type: ignore[misc]
    found: dict[str, CameraToWorld] = {}

    def to_world() -> Truth:
        options = CameraToWorldOptions(out=folder / "camera-to-world.yaml", intrinsics=camera_file)
        found["camera"] = calibrate_camera_to_world_live(session, options)
        assistant, truth = session.assistant, folder / "T_base_target.json"
        assert isinstance(assistant, SimulatedAssistant)
        if truth.exists():  # the board was laid when the pictures were taken
            assistant.T_base_target = np.array(json.loads(truth.read_text()))
        write_text(truth, json.dumps(assistant.T_base_target.tolist()))
        found["T_base_world"] = assistant.T_base_target @ invert_transform(
            T_world_target(parse_target(BOARD))
        )
        return judge_pose(found["camera"].pose, invert_transform(found["T_base_world"]) @ T_base_camera)

    def to_robot() -> Truth:
        robot = calibrate_robot_to_world_live(
            session, RobotToWorldOptions(out=folder / "robot-to-world.yaml")
        )
        result["robot to world"] = judge_pose(robot.pose, invert_transform(found["T_base_world"]))
        return judge_pose(compose(found["camera"], robot).pose, T_base_camera)

    def hand_eye() -> Truth:
        options = HandEyeOptions(out=folder / "hand-eye.yaml", intrinsics=camera_file, seed=true.number)
        return judge_pose(
            solve_hand_eye(read_views(take_hand_eye_views(session, options))).transform, T_base_camera
        )

    attempt("camera to world", to_world)
    attempt("camera to robot, composed", to_robot)
    session.assistant.put_away()
    attempt("camera to robot, hand-eye", hand_eye)
    return result


# -- the table -------------------------------------------------------------------------------------


def table(rows: list[dict[str, Any]]) -> list[dict[str, object]]:
    """One line for each calibration and kind of detection."""
    lines: list[dict[str, object]] = []
    for kind, words in (("exact", "exact detections"), ("pictures", "pictures")):
        for name in rows[0][kind]:
            over_cells = _over_cells([row[kind].get(name, {}) for row in rows])
            if kind == "exact":  # there is nothing to be uncertain about
                over_cells = {key: value for key, value in over_cells.items() if key not in (INSIDE, STATED)}
            lines.append({"calibration": name, "from": words, **over_cells})
    for name in rows[0]["wrong"]:
        clean, spoiled = (
            np.array([row["wrong"][name][key] for row in rows]) for key in ("clean_mm", "wrong_mm")
        )
        lines.append(
            {
                "calibration": name,
                "from": f"{NOISE_PX} px noise, {WRONG:.0%} wrong",
                "cells": len(rows),
                **_spread("mm", spoiled),
                "times the error without": float(np.sqrt((spoiled**2).mean() / (clean**2).mean())),
            }
        )
    blank = dict.fromkeys(COLUMNS, "")
    return [{**blank, **line} for line in lines]


def _over_cells(found: list[Truth]) -> dict[str, object]:
    good = [truth for truth in found if "mm" in truth]
    line: dict[str, object] = {"cells": len(good)}
    for unit in ("mm", "deg"):
        if good and unit in good[0]:
            line.update(_spread(unit, np.array([truth[unit] for truth in good])))
    if good and "inside" in good[0]:
        line[INSIDE] = f"{np.mean([truth['inside'] for truth in good]):.0%}"
        line[STATED] = float(np.sqrt(np.mean([truth["stated_mm"] ** 2 for truth in good])))
    return line


def _spread(unit: str, values: FloatArray) -> dict[str, object]:
    return {
        f"{unit} median": float(np.median(values)),
        f"{unit} RMS": float(np.sqrt((values**2).mean())),
        f"{unit} worst": float(values.max()),
    }


if __name__ == "__main__":
    main(tyro.cli(Options))
