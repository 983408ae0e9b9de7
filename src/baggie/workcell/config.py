"""The workcell that a workcell file describes.

A workcell in the real world: a robot at an address, a camera on this computer, a clock on the wall.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Protocol, runtime_checkable

from baggie.calibration.files import CameraIdentity
from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.calibration.intrinsics.camera_calibration import CameraCalibration
from baggie.calibration.robot_to_world import CameraToRobot
from baggie.cameras.camera import Camera, CameraSettings
from baggie.cameras.live import LiveCamera
from baggie.cameras.opening import open_camera
from baggie.data import open_dataset
from baggie.errors import BaggieError
from baggie.geometry import Rectangle
from baggie.robot.arm import Arm, ArmInfo
from baggie.robot.franka.arm import FrankaArm
from baggie.robot.lerobot.arm import LeRobotArm
from baggie.robot.lerobot.link import open_robot
from baggie.robot.limits import Watchdog
from baggie.robot.python_devices import open_python_arm, open_python_camera
from baggie.sim.bag import Bag
from baggie.workcell.replay import ReplayWorkcell
from baggie.workcell.simulated import SimulatedWorkcell
from baggie.workcell.workcell import Calibrations, Workcell, WorkcellSettings
from baggie.workcell.workcell_file import (
    CalibrationFiles,
    FrankaEntry,
    LeRobotEntry,
    PythonEntry,
    ReplayEntry,
    SimulatedEntry,
    WorkcellFile,
    read_workcell_file,
)


@runtime_checkable
class _Closable(Protocol):
    def close(self) -> None: ...


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

    def truth(self) -> None:
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


def let_go(*devices: object) -> None:
    """Close those that have a `close`."""
    for device in devices:
        if isinstance(device, _Closable):
            device.close()


_STRAY_M = 0.08
"""So far beyond the workspace the hand may stray after an object at its edge."""


def open_workcell(source: str | Path, cell: int = 0) -> Workcell:
    """The workcell a YAML file describes, or `"sim"` for the simulated one with the number `cell`.

    Raises `BaggieError` naming the file and the entry when it cannot be used, `CalibrationError` when a calibration it
    points to is of another camera.
    """
    if str(source) == "sim":
        return SimulatedWorkcell(cell)
    path = Path(source)
    return open_written(read_workcell_file(path), path)


def open_written(written: WorkcellFile, path: Path) -> Workcell:
    """The workcell that is `written` in the file `path`. Raises as `open_workcell` does."""
    opened = _open(written, path)
    identity = CameraIdentity(opened.camera.name, *opened.camera.size)
    try:
        opened.use(_load(written.calibrations, path.parent, identity))
    except BaggieError:
        opened.close()
        raise
    return opened


def _open(written: WorkcellFile, path: Path) -> Workcell:
    bag = Bag(
        length_m=written.bag.length_m,
        width_m=written.bag.width_m,
        shape="long" if written.bag.long else "square",
        mass_kg=written.bag.mass_kg,
        color=written.bag.color,
    )
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
        object_color=bag.color,
        object_size_m=written.bag.thing.size_m,
        object_hard=written.bag.hard,
        object_symmetry=bag.symmetry,
        sure_within_m=written.sure_within_m,
    )
    entry = written.arm
    if isinstance(entry, ReplayEntry):
        return ReplayWorkcell(open_dataset(path.parent / entry.recording), settings)
    if isinstance(entry, SimulatedEntry):
        return SimulatedWorkcell(
            written.cell, settings=settings, things=(bag,), picture_size=written.picture_size
        )
    arm = _open_arm(entry, path.parent)
    try:
        if line := written.contradiction(arm.info):
            raise BaggieError(f"{path}: {line}")
        assert isinstance(written.camera, CameraSettings | PythonEntry)  # or the file would have been refused
        camera = _open_camera(written.camera, path.parent)
    except BaggieError:
        let_go(arm)
        raise
    return RealWorkcell(arm, camera, replace(settings, handling=written.handled(arm.info).handling))


def arm_of(written: WorkcellFile, path: Path) -> ArmInfo | None:
    """What the arm that is `written` in the file `path` can do, nothing connected; None for one that is not real.

    Raises `BaggieError` where it cannot be made here.
    """
    if not isinstance(written.arm, FrankaEntry | LeRobotEntry | PythonEntry):
        return None
    arm = _open_arm(written.arm, path.parent)
    let_go(arm)
    return arm.info


def _open_arm(entry: FrankaEntry | LeRobotEntry | PythonEntry, folder: Path) -> Arm:
    if isinstance(entry, FrankaEntry):
        return FrankaArm(entry.host, entry.model, speed=entry.speed, realtime=entry.realtime)
    if isinstance(entry, PythonEntry):
        return open_python_arm(entry.factory, entry.model_extra or {}, folder)
    given = {"port": entry.port, "id": entry.id}
    options = {name: value for name, value in given.items() if value is not None} | entry.options
    model = folder / entry.model
    return LeRobotArm(open_robot(entry.type, options), entry.model_copy(update={"model": model}))


def _open_camera(entry: CameraSettings | PythonEntry, folder: Path) -> Camera:
    if isinstance(entry, PythonEntry):
        return open_python_camera(entry.factory, entry.model_extra or {}, folder)
    return open_camera(entry)


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
