"""The workcell file: what a person writes down about a workcell, in YAML."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from baggie.calibration.files import CameraIdentity
from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.calibration.intrinsics.camera_calibration import CameraCalibration
from baggie.calibration.world.camera_to_robot import CameraToRobot
from baggie.data import open_dataset
from baggie.errors import BaggieError
from baggie.geometry import Rectangle
from baggie.sim.bag import LONG_ASPECT, BagParameters
from baggie.workcell.calibrations import Calibrations
from baggie.workcell.cameras.settings import CameraSettings
from baggie.workcell.file_errors import explain
from baggie.workcell.replay import ReplayWorkcell
from baggie.workcell.simulated import SimulatedWorkcell
from baggie.workcell.workcell import Workcell, WorkcellSettings


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Bounds(_Section):
    """The workspace, metres in the robot's base frame."""

    x: tuple[float, float] = (0.35, 0.65)
    y: tuple[float, float] = (-0.30, 0.30)


class Bag(_Section):
    """The bag in a simulated cell."""

    length_m: float = Field(0.12, gt=0.06, lt=0.2)
    width_m: float = Field(0.12, gt=0.06, lt=0.2)
    mass_kg: float = Field(0.2, gt=0.02, lt=1.0)
    color: tuple[int, int, int] = (196, 40, 44)


class CalibrationFiles(_Section):
    """Where the calibrations are, from the workcell file's own folder. Each is refused for another camera."""

    intrinsics: Path | None = None
    image_to_robot: Path | None = None
    camera_to_robot: Path | None = None
    """Of `robot-to-world --camera-to-world`, or of `hand-eye` with a fixed camera."""


class WorkcellFile(_Section):
    """The whole file. The simulated arm and the recorded one see with the camera they have."""

    arm: Literal["sim", "replay"] = "sim"
    camera: CameraSettings | None = None
    """Of a real arm."""
    recording: Path | None = None
    """Of `arm: replay`: the folder, from the workcell file's own."""
    cell: int = Field(0, ge=0)
    workspace: Bounds = Bounds()
    bag: Bag = Bag()
    calibrations: CalibrationFiles = CalibrationFiles()
    sure_within_m: float = Field(WorkcellSettings().sure_within_m, gt=0)
    """A person is asked when a plan's pick or place is not known within this, nine times of ten."""


def open_workcell(source: str | Path, cell: int = 0) -> Workcell:
    """The workcell a YAML file describes, or `"sim"` for the simulated one with the number `cell`.

    Raises `BaggieError` naming the file and the entry when it cannot be used, `CalibrationError` when a calibration it
    points to is of another camera.
    """
    if str(source) == "sim":
        return SimulatedWorkcell(cell)
    written = read_workcell_file(Path(source))
    if written.camera is not None:
        raise BaggieError(
            f"{source}: the arm {written.arm!r} sees with a camera of its own; take camera out of the file"
        )
    if (written.arm == "replay") != (written.recording is not None):
        raise BaggieError(
            f"{source}: `arm: replay` and `recording: FOLDER` go together; give both or neither"
        )
    bag = BagParameters(
        length_m=written.bag.length_m,
        width_m=written.bag.width_m,
        shape="long" if written.bag.length_m >= LONG_ASPECT * written.bag.width_m else "square",
        mass_kg=written.bag.mass_kg,
        color=written.bag.color,
    )
    defaults = WorkcellSettings()
    settings = replace(
        defaults,
        name=Path(source).stem,
        workspace=Rectangle(*written.workspace.x, *written.workspace.y),
        object_color=bag.color,
        object_size_m=(bag.length_m, bag.width_m, defaults.object_size_m[2]),
        object_symmetry=bag.symmetry,
        sure_within_m=written.sure_within_m,
    )
    opened: Workcell
    if written.recording is not None:
        opened = ReplayWorkcell(open_dataset(Path(source).parent / written.recording), settings)
    else:
        opened = SimulatedWorkcell(written.cell, settings, bag)
    identity = CameraIdentity(opened.camera.name, *opened.camera.size)
    try:
        opened.use(_load(written.calibrations, Path(source).parent, identity))
    except BaggieError:
        opened.close()
        raise
    return opened


def _load(files: CalibrationFiles, folder: Path, camera: CameraIdentity) -> Calibrations:
    lens, to_robot, pose = files.intrinsics, files.image_to_robot, files.camera_to_robot
    return Calibrations(
        CameraCalibration.load(folder / lens, camera) if lens else None,
        ImageToRobot.load(folder / to_robot, camera) if to_robot else None,
        CameraToRobot.load(folder / pose, camera) if pose else None,
    )


def read_workcell_file(path: Path) -> WorkcellFile:
    """Read and check a workcell file. Raises `BaggieError` with the entry that is wrong and what it may be."""
    try:
        text = path.read_text()
        return WorkcellFile.model_validate(yaml.safe_load(text) or {})
    except OSError as error:
        raise BaggieError(
            f"no workcell file {path} ({error.strerror}); give a YAML file, or 'sim' for the simulated workcell"
        ) from None
    except yaml.YAMLError as error:
        raise BaggieError(f"{path} is no YAML: {' '.join(str(error).split())}") from None
    except ValidationError as error:
        raise BaggieError(explain(path, text, error, WorkcellFile)) from None
