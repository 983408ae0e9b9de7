"""`baggie calibrate robot-to-world`: where the robot is, by touching points of the target on the table."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from baggie.calibration.files import read_views_file
from baggie.calibration.world.camera_to_robot import compose
from baggie.calibration.world.camera_to_world import CameraToWorld
from baggie.calibration.world.robot_to_world import RobotToWorld, fit_from_axes, fit_from_points
from baggie.commissioning.bench import Bench, From, LiveOptions, open_bench
from baggie.commissioning.printed import BOARD
from baggie.commissioning.view_folder import ViewFolder
from baggie.commissioning.world import points_to_touch
from baggie.errors import DataError
from baggie.geometry import transform_points
from baggie.ranges import Height
from baggie.vision.targets import parse_target, with_sag
from baggie.workcell.arm import hand_pose


@dataclass(frozen=True)
class RobotToWorldOptions(LiveOptions):
    """What is touched, and with what."""

    out: Path = Path("robot-to-world.yaml")
    """The calibration to write; live, the touches go into a folder of the same name."""
    from_: From = None
    """Touches already made: a folder with views.json, {"views": [{"world": [x, y, z], "base": [x, y, z]}]}, metres."""
    target: str = BOARD
    """What lies on the table, and has not been moved since the camera was calibrated to it."""
    axes_only: bool = False
    """Touch the origin and a point on each axis, no more; then a wrong touch cannot be noticed."""
    probe: Height = 0.03
    """How far the tip that touches is beyond the point between the fingertips, metres."""
    camera_to_world: Path | None = None
    """Given, the camera's pose in the robot's frame is written as well, to camera-to-robot.yaml beside `out`."""


def calibrate_robot_to_world(options: RobotToWorldOptions) -> dict[str, Any]:
    """Calibrate and save; the result, ready for JSON. Raises `BaggieError`, or `KeyboardInterrupt` live."""
    camera = None if options.camera_to_world is None else CameraToWorld.load(options.camera_to_world)
    if options.from_ is not None:
        result = _fit(read_views_file(options.from_)["views"], options)
    else:
        with open_bench(options) as bench:
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
