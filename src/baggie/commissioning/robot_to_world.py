"""`baggie calibrate camera-to-world` and `robot-to-world`: where camera and robot are, by a target on the table.

The camera sees the target; the robot touches points of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baggie.calibration.camera_to_world import CameraToWorld, fit_camera_to_world
from baggie.calibration.files import CameraIdentity, read_views_file
from baggie.calibration.intrinsics.camera_calibration import CameraCalibration
from baggie.calibration.robot_to_world import RobotToWorld, compose, fit_from_axes, fit_from_points
from baggie.commissioning.printed import T_world_target, points_to_touch
from baggie.commissioning.session import Bench, ViewFolder, open_bench
from baggie.errors import CalibrationError, DataError
from baggie.geometry import transform_points
from baggie.operator import Operator
from baggie.options.commissioning import CameraToWorldOptions, RobotToWorldOptions
from baggie.pictures import read_pictures
from baggie.robot.arm import hand_pose
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
        with open_bench(options, operator) as bench:
            result = calibrate_camera_to_world_live(bench, options)
    result.save(options.out)
    return {
        "calibration": str(options.out),
        **result.summary(),
        "next": f"baggie calibrate robot-to-world --target {target.spec}, the target left where it is",
    }


def calibrate_camera_to_world_live(bench: Bench, options: CameraToWorldOptions) -> CameraToWorld:
    """Have the target laid on the table, and average some pictures of it."""
    lens = CameraCalibration.load(options.intrinsics, bench.identity)
    target = lens.shaped(parse_target(options.target))
    folder = ViewFolder(
        options.out.with_suffix(""), {"target": target.spec, "camera": bench.identity.to_yaml()}
    )
    if not folder.views:  # else the target lies there already
        bench.assistant.clear_table()
        bench.assistant.lay(
            target, "lay the target flat on the table, in the middle of the workspace, all of it in view"
        )
    depths: list[NDArray[np.float32]] = []
    while len(folder) < options.frames:
        observation = bench.look()
        picture = observation.color
        if observation.depth is not None:
            depths.append(observation.depth)
        found = target.detect(picture)
        bench.show(folder.folder, picture, found, f"the target on the table, picture {len(folder) + 1}")
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
        with open_bench(options, operator) as bench:
            result = calibrate_robot_to_world_live(bench, options, camera)
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
    bench: Bench, options: RobotToWorldOptions, camera: CameraToWorld | None = None
) -> RobotToWorld:
    """Have the arm led to points of the target, one after the other; each touch is kept at once.

    A target that the camera was calibrated to is as bent as it was taken to be there.
    """
    cell, target = bench.workcell(), parse_target(options.target)
    if camera is not None and camera.target == target.spec:
        target = with_sag(target, camera.sag)
    folder = ViewFolder(options.out.with_suffix(""), {"target": target.spec, "probe_m": options.probe})
    if not folder.views:
        bench.assistant.clear_table()
    wanted = points_to_touch(target, options.axes_only)
    tip = np.array([[0.0, 0.0, options.probe]])
    try:
        for words, point in wanted[len(folder.views) :]:
            bench.assistant.touch(target, point, f"lead the tip of the probe onto {words}")
            base = transform_points(hand_pose(cell.arm), tip)[0]
            folder.append({"name": words, "world": point.tolist(), "base": base.tolist()})
            bench.say(f"touched {words} at x {base[0]:.4f}, y {base[1]:.4f}, z {base[2]:.4f} m")
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"interrupted after {len(folder.views)} of {len(wanted)} touches; the same command again goes on"
        ) from None
    return _fit(folder.views, options)
