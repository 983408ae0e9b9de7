"""The workcell file: what a person writes down about a workcell, in YAML."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from baggie.calibration.files import CameraIdentity
from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.calibration.intrinsics.camera_calibration import CameraCalibration
from baggie.calibration.world.camera_to_robot import CameraToRobot
from baggie.errors import BaggieError
from baggie.geometry import Rectangle
from baggie.sim.bag import LONG_ASPECT, BagParameters
from baggie.workcell.calibrations import Calibrations
from baggie.workcell.franka import FrankaArm
from baggie.workcell.franka_models import ModelName
from baggie.workcell.opencv_camera import OpenCVCamera
from baggie.workcell.real import RealWorkcell
from baggie.workcell.simulated import SimulatedWorkcell
from baggie.workcell.workcell import Workcell, WorkcellSettings


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class SimulatedEntry(_Section):
    """`arm: sim` for short."""

    kind: Literal["sim"] = "sim"


class FrankaEntry(_Section):
    """A real arm, or one behind the same protocol."""

    kind: Literal["franka"]
    host: str = Field(min_length=1)
    """The address of its control box."""
    model: ModelName = "fr3"
    speed: float = Field(0.1, gt=0, le=1)
    """The share of every speed that it really goes at: as slow as this until a person has watched it work."""
    realtime: bool = True
    """Whether to refuse to move it from a computer without a real-time kernel."""


ArmEntry = Annotated[
    Annotated[SimulatedEntry | FrankaEntry, Field(discriminator="kind")],
    BeforeValidator(lambda entry: {"kind": entry} if isinstance(entry, str) else entry),
]


class Bounds(_Section):
    """The workspace, metres in the robot's base frame."""

    x: tuple[float, float] = (0.35, 0.65)
    y: tuple[float, float] = (-0.30, 0.30)


class Bag(_Section):
    """The bag: in a simulated cell all of it, for a real one its size and colour."""

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
    """The whole file."""

    arm: ArmEntry = SimulatedEntry()
    camera: str | int | None = None
    """With a real arm: the camera's number, device or address as OpenCV opens it."""
    cell: int = Field(0, ge=0)
    """Of a simulated workcell."""
    workspace: Bounds = Bounds()
    bag: Bag = Bag()
    calibrations: CalibrationFiles = CalibrationFiles()
    sure_within_m: float = Field(WorkcellSettings().sure_within_m, gt=0)
    """A person is asked when a plan's pick or place is not known within this, nine times of ten."""

    @model_validator(mode="after")
    def _real_or_simulated(self) -> WorkcellFile:
        if isinstance(self.arm, FrankaEntry) and self.camera is None:
            raise ValueError("a real arm needs a real camera; write `camera: 0`, or its device or address")
        if isinstance(self.arm, SimulatedEntry) and self.camera is not None:
            raise ValueError("a simulated arm has a simulated camera; leave `camera` out")
        return self


def open_workcell(source: str | Path, cell: int = 0) -> Workcell:
    """The workcell a YAML file describes, or `"sim"` for the simulated one with the number `cell`.

    Raises `BaggieError` naming the file and the entry when it cannot be used, `CalibrationError` when a calibration it
    points to is of another camera.
    """
    if str(source) == "sim":
        return SimulatedWorkcell(cell)
    written = read_workcell_file(Path(source))
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
    if isinstance(written.arm, FrankaEntry):
        entry = written.arm
        arm = FrankaArm(entry.host, entry.model, speed=entry.speed, realtime=entry.realtime)
        opened = RealWorkcell(arm, OpenCVCamera(str(written.camera)), settings)
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
    """Read and check a workcell file. Raises `BaggieError` with the line and entry that is wrong and what it may be."""
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
        first = error.errors()[0]
        entry, line = _place(text, first["loc"])
        wrong = first["msg"].removeprefix("Value error, ")
        got = "" if first["type"] in {"missing", "value_error"} else f", got {first['input']!r}"
        raise BaggieError(f"{path}, line {line}: {entry}: {wrong}{got}") from None


def _place(text: str, keys: tuple[int | str, ...]) -> tuple[str, int]:
    """What a person calls the entry that pydantic names with these keys, and the line it is on, from 1."""
    node: Any = yaml.compose(text)
    line, names = 1, []
    for position, key in enumerate(keys):
        found = [
            (name, value)
            for name, value in (node.value if isinstance(node, yaml.MappingNode) else [])
            if name.value == str(key)
        ]
        if found:
            line, node = found[0][0].start_mark.line + 1, found[0][1]
        if found or position == len(keys) - 1:  # others are pydantic's own names of alternatives
            names.append(str(key))
    return ".".join(names) or "the file", line
