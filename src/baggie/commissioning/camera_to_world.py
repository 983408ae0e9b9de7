"""`baggie calibrate camera-to-world`: where the camera is, from a target that lies on the table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baggie.calibration.files import CameraIdentity
from baggie.calibration.intrinsics.camera_calibration import CameraCalibration
from baggie.calibration.world.camera_to_world import CameraToWorld, fit_camera_to_world
from baggie.commissioning.bench import Bench, From, LiveOptions, open_bench, show_live
from baggie.commissioning.printed import BOARD
from baggie.commissioning.view_folder import ViewFolder
from baggie.commissioning.world import T_world_target
from baggie.errors import CalibrationError
from baggie.ranges import Count
from baggie.vision.picture_files import read_pictures
from baggie.vision.targets import Seen, Target, parse_target


@dataclass(frozen=True)
class CameraToWorldOptions(LiveOptions):
    """What lies on the table, and how the camera sees."""

    out: Path = Path("camera-to-world.yaml")
    """The calibration to write; live, the pictures go into a folder of the same name."""
    intrinsics: Path = Path("camera.yaml")
    """The camera's own calibration, made by `baggie calibrate intrinsics`. It knows how the board sags that it was made
    with; where that is the target, it is taken so."""
    from_: From = None
    """Pictures already taken, the camera standing still: a folder, one picture, or a video."""
    target: str = BOARD
    """What lies on the table: a charuco or chessboard (see `calibrate intrinsics`), or aruco:DICTIONARY:NUMBER:SIZE."""
    frames: Count = 10
    """Pictures to average, live."""


def calibrate_camera_to_world(options: CameraToWorldOptions) -> dict[str, Any]:
    """Calibrate and save; the result, ready for JSON. Raises `BaggieError`, or `KeyboardInterrupt` live."""
    target = parse_target(options.target)
    if options.from_ is not None:
        lens = CameraCalibration.load(options.intrinsics)
        result = _from_pictures(options.from_, lens.shaped(target), lens)
    else:
        with open_bench(options) as bench:
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
        show_live(folder.folder, picture, found, f"the target on the table, picture {len(folder) + 1}")
        if found is None:
            raise CalibrationError(f"the target {target.spec} is not seen: {target.why_not(picture)}")
        folder.append({}, picture)
    return _from_pictures(folder.folder, target, lens, depths)


def _from_pictures(
    source: Path, target: Target, lens: CameraCalibration, depths: Sequence[NDArray[np.float32]] = ()
) -> CameraToWorld:
    seen: dict[str, Seen] = {}
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
