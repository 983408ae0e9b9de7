"""`baggie calibrate camera-to-world`, `robot-to-world` and `hand-eye`: where camera and robot are.

To the world, by a target on the table: the camera sees it, the robot touches points of it. To each other, or the hand,
from a board seen at many poses of the arm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from baggie import seeds
from baggie.calibration.camera_to_world import CameraToWorld, fit_camera_to_world
from baggie.calibration.files import CameraIdentity, read_views_file
from baggie.calibration.hand_eye.solve import HandEye, draw_views, solve_hand_eye
from baggie.calibration.hand_eye.views import read_views
from baggie.calibration.intrinsics.camera_calibration import CameraCalibration
from baggie.calibration.point_registration import T_world_target, points_to_touch
from baggie.calibration.robot_to_world import (
    CameraToRobot,
    RobotToWorld,
    compare_calibrations,
    compose,
    fit_from_axes,
    fit_from_points,
)
from baggie.commissioning.session import Session, ViewFolder, open_session
from baggie.errors import CalibrationError, DataError, ReachError
from baggie.files import write_if_possible
from baggie.geometry import FloatArray, Rectangle, rigid, transform_points
from baggie.operator import Operator
from baggie.options.commissioning import CameraToWorldOptions, HandEyeOptions, RobotToWorldOptions
from baggie.pictures import read_pictures
from baggie.robot.arm import hand_pose
from baggie.seeds import first_fit
from baggie.vision.corners import FLAT
from baggie.vision.targets import Target, TargetDetection, parse_target, with_sag


def calibrate_camera_to_world(
    options: CameraToWorldOptions, *, operator: Operator | None = None
) -> dict[str, Any]:
    """Calibrate and save; the result, ready for JSON. Raises `BaggieError`, or `KeyboardInterrupt` live.

    The person at the terminal is told and asked, unless `operator` is given.
    """
    target = parse_target(options.target)
    if options.from_ is not None:
        lens = CameraCalibration.load(options.intrinsics)
        result = _from_pictures(options.from_, lens.shaped(target), lens)
    else:
        with open_session(options, operator) as session:
            result = calibrate_camera_to_world_live(session, options)
    result.save(options.out)
    return {
        "calibration": str(options.out),
        **result.summary(),
        "next": f"baggie calibrate robot-to-world --target {target.spec}, the target left where it is",
    }


def calibrate_camera_to_world_live(session: Session, options: CameraToWorldOptions) -> CameraToWorld:
    """Have the target laid on the table, and average some pictures of it."""
    lens = CameraCalibration.load(options.intrinsics, session.identity)
    target = lens.shaped(parse_target(options.target))
    folder = ViewFolder(
        options.out.with_suffix(""), {"target": target.spec, "camera": session.identity.to_yaml()}
    )
    if not folder.views:  # else the target lies there already
        session.assistant.clear_table()
        session.assistant.lay(
            target, "lay the target flat on the table, in the middle of the workspace, all of it in view"
        )
    depths: list[NDArray[np.float32]] = []
    while len(folder) < options.frames:
        observation = session.look()
        picture = observation.color
        if observation.depth is not None:
            depths.append(observation.depth)
        found = target.detect(picture)
        session.show(folder.folder, picture, found, f"the target on the table, picture {len(folder) + 1}")
        if found is None:
            raise CalibrationError(f"the target {target.spec} is not seen: {target.why_not(picture)}")
        folder.append({}, picture)
    return _from_pictures(folder.folder, target, lens, depths)


def _from_pictures(
    source: Path, target: Target, lens: CameraCalibration, depths: Sequence[NDArray[np.float32]] = ()
) -> CameraToWorld:
    seen: dict[str, TargetDetection] = {}
    for name, picture in read_pictures(source):
        height, width = picture.shape[:2]
        lens.camera.check(CameraIdentity(lens.camera.name, width, height), "the camera's calibration")
        found = target.detect(picture)
        if found is not None:
            seen[name] = found
    if not seen:
        raise CalibrationError(
            f"no target {target.spec} in the pictures of {source}: {target.why_not(picture)}"
        )
    return fit_camera_to_world(
        list(seen.values()),
        target,
        lens.camera,
        lens.intrinsics,
        lens.covariance,
        T_world_target=T_world_target(target),
        depths=depths,
        names=list(seen),
    )


def calibrate_robot_to_world(
    options: RobotToWorldOptions, *, operator: Operator | None = None
) -> dict[str, Any]:
    """Calibrate and save; the result, ready for JSON. Raises `BaggieError`, or `KeyboardInterrupt` live.

    The person at the terminal is told and asked, unless `operator` is given.
    """
    camera = None if options.camera_to_world is None else CameraToWorld.load(options.camera_to_world)
    if options.from_ is not None:
        result = _fit(read_views_file(options.from_)["views"], options)
    else:
        with open_session(options, operator) as session:
            result = calibrate_robot_to_world_live(session, options, camera)
    result.save(options.out)
    summary: dict[str, Any] = {"calibration": str(options.out), **result.summary()}
    if camera is not None:
        composed = compose(camera, result)
        path = options.out.with_name("camera-to-robot.yaml")
        composed.save(path)
        summary["next"] = (
            "name camera-to-robot.yaml in the workcell file; baggie calibrate hand-eye is the stronger way"
        )
        summary["camera_to_robot"] = {"calibration": str(path), **composed.summary()}
    return summary


def _fit(touches: list[dict[str, Any]], options: RobotToWorldOptions) -> RobotToWorld:
    try:
        world = np.array([touch["world"] for touch in touches], float).reshape(-1, 3)
        base = np.array([touch["base"] for touch in touches], float).reshape(-1, 3)
    except (KeyError, TypeError, ValueError) as error:
        raise DataError(
            f"expected touches with `world` and `base`, three metres each, got {error!r}"
        ) from None
    if options.axes_only:
        return fit_from_axes(*base[:3])
    return fit_from_points(world, base)


def calibrate_robot_to_world_live(
    session: Session, options: RobotToWorldOptions, camera: CameraToWorld | None = None
) -> RobotToWorld:
    """Have the arm led to points of the target, one after the other; each touch is kept at once.

    A target that the camera was calibrated to is as bent as it was taken to be there.
    """
    cell, target = session.workcell(), parse_target(options.target)
    if camera is not None and camera.target == target.spec:
        target = with_sag(target, camera.sag)
    folder = ViewFolder(options.out.with_suffix(""), {"target": target.spec, "probe_m": options.probe})
    if not folder.views:
        session.assistant.clear_table()
    wanted = points_to_touch(target, options.axes_only)
    tip = np.array([[0.0, 0.0, options.probe]])
    try:
        for words, point in wanted[len(folder.views) :]:
            session.assistant.touch(target, point, f"lead the tip of the probe onto {words}")
            base = transform_points(hand_pose(cell.arm), tip)[0]
            folder.append({"name": words, "world": point.tolist(), "base": base.tolist()})
            session.say(f"touched {words} at x {base[0]:.4f}, y {base[1]:.4f}, z {base[2]:.4f} m")
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"interrupted after {len(folder.views)} of {len(wanted)} touches; the same command again goes on"
        ) from None
    return _fit(folder.views, options)


MAX_MISSES = 20
"""Pictures in a row without the board, or poses out of reach, before giving up."""


def calibrate_hand_eye(options: HandEyeOptions, *, operator: Operator | None = None) -> dict[str, Any]:
    """Calibrate and save; the result, ready for JSON. Raises `BaggieError`, or `KeyboardInterrupt` live.

    The person at the terminal is told and asked, unless `operator` is given.
    """
    folder = options.from_
    if folder is None:
        with open_session(options, operator) as session:
            folder = take_hand_eye_views(session, options)
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


def take_hand_eye_views(session: Session, options: HandEyeOptions) -> Path:
    """Have the arm led from pose to pose, a picture at each; the folder of views, a recording like any other."""
    cell, lens = session.workcell(), CameraCalibration.load(options.intrinsics, session.identity)
    board = lens.shaped(parse_target(options.board))
    header = {
        "units": "m",
        "mount": options.mount,
        "board": board.spec,
        "sag": None if board.sag == FLAT else asdict(board.sag),
        "camera": session.identity.to_yaml(),
        "camera_matrix": lens.intrinsics.matrix.tolist(),
        "distortion": lens.intrinsics.distortion.tolist(),
        "intrinsics_covariance": None if lens.covariance is None else lens.covariance.tolist(),
    }
    folder = ViewFolder(options.out.with_suffix(""), header)
    session.assistant.clear_table()
    if options.mount == "fixed":
        session.assistant.hold(board, "fix the board to the hand, facing the camera")
    else:
        session.assistant.lay(board, "lay the board flat on the table, where it stays")
    missed = 0
    rng = seeds.generator(seeds.CALIBRATION, options.seed, 2)
    try:
        while len(folder) < options.views:
            count = f"view {len(folder) + 1} of {options.views}"
            words = f"{count}: lead the hand elsewhere, tilted 15 to 30 degrees another way"
            lead_to_random_pose(session, cell.settings.workspace, rng, words)
            picture = session.camera.look().color
            seen = board.detect(picture)
            session.show(folder.folder, picture, seen, words)
            if seen is None:
                missed += 1
                if missed == MAX_MISSES:
                    raise CalibrationError(
                        f"{MAX_MISSES} pictures in a row show no {board.spec}: {board.why_not(picture)}"
                    )
                session.say(f"no board in this picture: {board.why_not(picture)}")
                continue
            missed = 0
            folder.append({"T_base_hand": hand_pose(cell.arm).tolist()}, picture)
            session.say(f"view {len(folder)} of {options.views}: {len(seen.ids)} corners")
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"interrupted with {len(folder)} of {options.views} views; the same command again goes on"
        ) from None
    session.assistant.put_away()
    return folder.folder


def lead_to_random_pose(session: Session, workspace: Rectangle, rng: np.random.Generator, words: str) -> None:
    """Have the arm led to a random pose that it reaches. Raises `ReachError` where it reaches none."""

    def led(T_base_hand: FloatArray) -> bool:
        try:
            session.assistant.lead_to(T_base_hand, words)
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
