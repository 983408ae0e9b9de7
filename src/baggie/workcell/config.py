"""The workcell that a workcell file describes.

A workcell in the real world: a robot at an address, a camera on this computer, a clock on the wall.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from baggie.calibration.files import CameraIdentity
from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.calibration.intrinsics.camera_calibration import CameraCalibration
from baggie.calibration.robot_to_world import CameraToRobot
from baggie.cameras.camera import Camera
from baggie.cameras.live import LiveCamera
from baggie.errors import BaggieError
from baggie.geometry import Rectangle
from baggie.options.values import Color
from baggie.robot.arm import Arm, let_go
from baggie.robot.limits import Watchdog
from baggie.workcell.workcell import Calibrations, Workcell, WorkcellSettings
from baggie.workcell.workcell_file import CalibrationFiles, WorkcellFile, read_workcell_file


class RealWorkcell(Workcell):
    """Any arm and any camera. Nobody puts things back here but the hand, what it still holds."""

    repeatable = False

    def __init__(self, arm: Arm, camera: Camera, settings: WorkcellSettings) -> None:
        super().__init__(arm, camera, settings)
        if isinstance(camera, LiveCamera):
            self.arm.watchdog = Watchdog(camera.silent_s, camera.frame_timeout_s, camera.name)
        self._devices = (arm, camera)
        self._epoch = time.time() - time.monotonic()

    def reset(self, seed: Sequence[int]) -> None:
        """Nobody lays the table anew: what the hand still holds is put down, the arm parks, the rest stays as it is."""
        self.put_down()
        self.arm.park()

    def rescue(self) -> bool:
        """Put down what the hand still holds; whether that was where the object was."""
        return self.put_down()

    def truth(self, color: Color | None = None) -> None:
        """Nobody knows where the object really is."""

    def show_paddle(self, shown: bool) -> None:
        """Raises `BaggieError`: a person puts things into this hand, for a calibration that the file points to."""
        if shown:
            raise BaggieError(
                f"expected {self.settings.name} to be calibrated, got no image_to_robot below `calibrations` in its "
                "file; make one with: baggie calibrate image-to-robot --workcell FILE"
            )

    def clock(self) -> float:
        """Seconds of the wall clock, as its pictures have them; never set back while the workcell is open."""
        return self._epoch + time.monotonic()

    def close(self) -> None:
        """Let go of arm and camera, each if it has a `close`."""
        let_go(*self._devices)


_STRAY_M = 0.08
"""So far beyond the workspace the hand may stray after an object at its edge."""


def open_workcell(source: str | Path, cell: int = 0) -> Workcell:
    """The workcell a YAML file describes, or `"sim"` for the simulated one with the number `cell`.

    Raises `BaggieError` naming the file and the entry when it cannot be used, `CalibrationError` when a calibration it
    points to is of another camera.
    """
    if str(source) == "sim":
        from baggie.workcell.simulated import SimulatedWorkcell  # noqa: PLC0415 -- MuJoCo takes its time

        return SimulatedWorkcell(cell)
    path = Path(source)
    return open_written(read_workcell_file(path), path)


def open_written(written: WorkcellFile, path: Path) -> Workcell:
    """The workcell that is `written` in the file `path`. Raises as `open_workcell` does."""
    opened = _open(written, path)
    try:
        opened.use(_load(written.calibrations, path.parent, opened.calibrated_camera))
    except BaggieError:
        opened.close()
        raise
    return opened


def _open(written: WorkcellFile, path: Path) -> Workcell:
    defaults, bounds = WorkcellSettings(), written.workspace
    gate = Rectangle(
        bounds.x[0] - _STRAY_M, bounds.x[1] + _STRAY_M, bounds.y[0] - _STRAY_M, bounds.y[1] + _STRAY_M
    )
    settings = replace(
        defaults,
        name=path.stem,
        workspace=Rectangle(*bounds.x, *bounds.y),
        limits=replace(
            defaults.limits,
            workspace=gate,
            reach=_around(defaults.limits.reach, gate),
            **written.limits.model_dump(),
        ),
        handling=written.handled().handling,
        object_color=written.bag.color,
        object_colors=written.bag.colors,
        object_size_m=written.bag.thing.size_m,
        object_hard=written.bag.hard,
        object_symmetry=written.bag.symmetry,
        sure_within_m=written.sure_within_m,
    )
    if written.own_cell:
        return written.own_cell.workcell(written, settings, path.parent)
    assert written.camera is not None  # or the file would have been refused
    arm = written.arm.open(path.parent)
    try:
        if line := written.contradiction(arm.info):
            raise BaggieError(f"{path}: {line}")
        camera = written.camera.open(path.parent)
    except BaggieError:
        let_go(arm)
        raise
    return RealWorkcell(arm, camera, replace(settings, handling=written.handled(arm.info).handling))


def _around(a: Rectangle, b: Rectangle) -> Rectangle:
    return Rectangle(
        min(a.x_min, b.x_min), max(a.x_max, b.x_max), min(a.y_min, b.y_min), max(a.y_max, b.y_max)
    )


def _load(files: CalibrationFiles, folder: Path, camera: CameraIdentity) -> Calibrations:
    lens, to_robot, pose = files.intrinsics, files.image_to_robot, files.camera_to_robot
    return Calibrations(
        CameraCalibration.load(folder / lens, camera) if lens else None,
        ImageToRobot.load(folder / to_robot, camera) if to_robot else None,
        CameraToRobot.load(folder / pose, camera) if pose else None,
    )
