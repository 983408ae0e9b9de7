"""`baggie calibrate hand-eye`: camera and hand together, from a board seen at many poses of the arm."""

from __future__ import annotations

from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from baggie import seeds
from baggie.calibration.files import CameraIdentity
from baggie.calibration.hand_eye.solve import HandEye, draw_views, solve_hand_eye
from baggie.calibration.hand_eye.views import read_views
from baggie.calibration.intrinsics.camera_calibration import CameraCalibration
from baggie.calibration.robot_to_world import CameraToRobot, compare_calibrations
from baggie.commissioning.session import Bench, ViewFolder, open_bench
from baggie.errors import CalibrationError, ReachError
from baggie.files import write_if_possible
from baggie.geometry import FloatArray, Rectangle, rigid
from baggie.operator import Operator
from baggie.options.commissioning import HandEyeOptions
from baggie.robot.arm import hand_pose
from baggie.seeds import first_fit
from baggie.vision.corners import FLAT
from baggie.vision.targets import parse_target

MAX_MISSES = 20
"""Pictures in a row without the board, or poses out of reach, before giving up."""


def calibrate_hand_eye(options: HandEyeOptions, *, operator: Operator | None = None) -> dict[str, Any]:
    """Calibrate and save; the result, ready for JSON. Raises `BaggieError`, or `KeyboardInterrupt` live.

    The person at the terminal is told and asked, unless `operator` is given.
    """
    folder = options.from_
    if folder is None:
        with open_bench(options, operator) as bench:
            folder = take_hand_eye_views(bench, options)
    result = solve_hand_eye(read_views(folder), keep_all=options.keep_all)
    result.save(options.out)
    picture = options.out.with_suffix(".png")
    drawn = write_if_possible(picture, partial(draw_views, result))
    summary: dict[str, Any] = {
        "calibration": str(options.out),
        **({"picture": str(picture)} if drawn else {}),
        **result.summary(),
    }
    if result.mount == "fixed" and result.camera is not None:
        summary["camera_to_robot"] = _camera_to_robot(result.camera, result, options.out)
    summary["next"] = (
        "take the views that were dropped again" if result.dropped else "name the result in the workcell file"
    )
    return summary


def _camera_to_robot(camera: CameraIdentity, result: HandEye, out: Path) -> dict[str, Any]:
    """Save the pose of a fixed camera as such, for the workcell file, and compare it with a composed one beside it."""
    found = CameraToRobot(camera, result.transform, f"hand-eye: {result.method}, {len(result.views)} views")
    path = out.with_name(f"{out.stem}-camera-to-robot.yaml")
    found.save(path)
    summary: dict[str, Any] = {"calibration": str(path)}
    composed = out.with_name("camera-to-robot.yaml")
    if composed.exists():
        comparison = compare_calibrations(found, CameraToRobot.load(composed, camera))
        summary["against_the_composed_one"] = {
            "mm": comparison.mm,
            "deg": comparison.deg,
            "agree": comparison.agree,
        }
    return summary


def take_hand_eye_views(bench: Bench, options: HandEyeOptions) -> Path:
    """Have the arm led from pose to pose, a picture at each; the folder of views, a recording like any other."""
    cell, lens = bench.workcell(), CameraCalibration.load(options.intrinsics, bench.identity)
    board = lens.shaped(parse_target(options.board))
    header = {
        "units": "m",
        "mount": options.mount,
        "board": board.spec,
        "sag": None if board.sag == FLAT else asdict(board.sag),
        "camera": bench.identity.to_yaml(),
        "camera_matrix": lens.intrinsics.matrix.tolist(),
        "distortion": lens.intrinsics.distortion.tolist(),
        "intrinsics_covariance": None if lens.covariance is None else lens.covariance.tolist(),
    }
    folder = ViewFolder(options.out.with_suffix(""), header)
    bench.assistant.clear_table()
    if options.mount == "fixed":
        bench.assistant.hold(board, "fix the board to the hand, facing the camera")
    else:
        bench.assistant.lay(board, "lay the board flat on the table, where it stays")
    missed = 0
    rng = seeds.generator(seeds.CALIBRATION, options.seed, 2)
    try:
        while len(folder) < options.views:
            count = f"view {len(folder) + 1} of {options.views}"
            words = f"{count}: lead the hand elsewhere, tilted 15 to 30 degrees another way"
            lead_to_random_pose(bench, cell.settings.workspace, rng, words)
            picture = bench.camera.look().color
            seen = board.detect(picture)
            bench.show(folder.folder, picture, seen, words)
            if seen is None:
                missed += 1
                if missed == MAX_MISSES:
                    raise CalibrationError(
                        f"{MAX_MISSES} pictures in a row show no {board.spec}: {board.why_not(picture)}"
                    )
                bench.say(f"no board in this picture: {board.why_not(picture)}")
                continue
            missed = 0
            folder.append({"T_base_hand": hand_pose(cell.arm).tolist()}, picture)
            bench.say(f"view {len(folder)} of {options.views}: {len(seen.ids)} corners")
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"interrupted with {len(folder)} of {options.views} views; the same command again goes on"
        ) from None
    bench.assistant.put_away()
    return folder.folder


def lead_to_random_pose(bench: Bench, workspace: Rectangle, rng: np.random.Generator, words: str) -> None:
    """Have the arm led to a random pose that it reaches. Raises `ReachError` where it reaches none."""

    def led(T_base_hand: FloatArray) -> bool:
        try:
            bench.assistant.lead_to(T_base_hand, words)
        except ReachError:
            return False
        return True

    if first_fit(lambda: random_hand_pose(workspace, rng), led, MAX_MISSES) is None:
        raise ReachError(
            f"expected a workspace on whose near side the hand can be led to and tilted, reached none of {MAX_MISSES} "
            f"poses there, of {workspace}; put it where the arm reaches"
        )


def random_hand_pose(workspace: Rectangle, rng: np.random.Generator) -> FloatArray:
    """`T_base_hand` `(4, 4)` on the robot's side of the workspace, pointing down but for a tilt of up to 30 degrees.

    The board is held out in front of the hand, so it comes to lie over the workspace's middle, in full view.
    """
    x = workspace.x_min + rng.uniform(-0.05, 0.07)
    y = 0.7 * rng.uniform(workspace.y_min, workspace.y_max)
    direction = rng.uniform(0, 2 * np.pi)
    axis = np.array([np.cos(direction), np.sin(direction), 0.0])
    tilt = Rotation.from_rotvec(np.radians(rng.uniform(10, 30)) * axis)
    yaw = Rotation.from_euler("z", rng.uniform(-40, 40), degrees=True)
    down = np.diag([1.0, -1.0, -1.0])
    return rigid((tilt * yaw).as_matrix() @ down, [x, y, rng.uniform(0.28, 0.48)])
