"""What a person writes down about a workcell, in YAML."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    field_validator,
    model_validator,
)

from baggie.errors import BaggieError
from baggie.ranges import Seed
from baggie.sim.cell import LARGEST_SIDE, PICTURE_SIZE, SMALLEST_SIDE
from baggie.text_files import parse_yaml, read_text
from baggie.workcell.arm import ArmInfo
from baggie.workcell.bag_entry import Bag, HandlingEntry
from baggie.workcell.cameras.settings import CameraSettings
from baggie.workcell.entries import Metres, Section, Words
from baggie.workcell.file_errors import explain
from baggie.workcell.franka_models import ModelName
from baggie.workcell.handling_rules import SIMULATED_HANDLING, Handled, contradiction, handled
from baggie.workcell.lerobot_settings import LeRobotSettings
from baggie.workcell.limits import Limits
from baggie.workcell.primitives import Handling
from baggie.workcell.workcell import WorkcellSettings

_LIMITS = WorkcellSettings().limits


class SimulatedEntry(Section):
    """`arm: sim` for short."""

    kind: Literal["sim"] = "sim"


class ReplayEntry(Section):
    """No arm: a recording is shown."""

    kind: Literal["replay"]
    recording: Path
    """Its folder, from the workcell file's own."""


class FrankaEntry(Section):
    """A real arm, or one behind the same protocol."""

    kind: Literal["franka"]
    host: Words = Field(min_length=1)
    """The address of its control box."""
    model: ModelName = "fr3"
    speed: float = Field(0.1, gt=0, le=1)
    """The share of every speed that it really goes at: as slow as this until a person has watched it work."""
    realtime: bool = True
    """Whether to refuse to move it from a computer without a real-time kernel."""


class LeRobotEntry(LeRobotSettings):
    """A robot of LeRobot's. `model` is looked for from the workcell file's own folder."""

    kind: Literal["lerobot"]
    type: Words = Field(min_length=1)
    """LeRobot's name for it, `so101_follower`."""
    port: Words | None = None
    id: Words | None = None
    """The name of its calibration."""
    options: dict[str, Any] = Field(default_factory=dict)
    """Whatever else LeRobot's configuration of this type takes."""


class PythonEntry(BaseModel):
    """An arm, or a camera, of one's own. Every other entry is an option of its factory."""

    model_config = ConfigDict(extra="allow", frozen=True)

    kind: Literal["python"]
    factory: str = Field(pattern=r"^[\w.]+:\w+$")
    """`my_lab.my_arm:open_arm`, a function or class that makes an `Arm`, or a `Camera`; the module may be in the file's
    own folder."""


REAL_ARMS = (FrankaEntry, LeRobotEntry, PythonEntry)


def _kind_alone(entry: Any) -> Any:
    return {"kind": entry} if isinstance(entry, str) else entry


class SimulatedCameraEntry(Section):
    """The camera of a simulated workcell, `camera: {width: 640, height: 480}`."""

    kind: Literal["sim"] = "sim"
    width: int = Field(PICTURE_SIZE[0], ge=SMALLEST_SIDE, le=LARGEST_SIDE)
    """Of its pictures, pixels."""
    height: int = Field(PICTURE_SIZE[1], ge=SMALLEST_SIDE, le=LARGEST_SIDE)


def _camera_kind(entry: Any) -> Any:
    """The entry with its kind: `camera: 0` for short, and a section with a width or a height is a simulated one's."""
    if isinstance(entry, (str, int)) and not isinstance(entry, bool):
        return CameraSettings.from_words(str(entry))
    if isinstance(entry, Mapping) and "kind" not in entry:
        return {"kind": "sim" if {"width", "height"} & entry.keys() else "opencv", **entry}
    return entry


ArmEntry = Annotated[
    Annotated[
        SimulatedEntry | ReplayEntry | FrankaEntry | LeRobotEntry | PythonEntry, Field(discriminator="kind")
    ],
    BeforeValidator(_kind_alone),
]
CameraEntry = Annotated[
    Annotated[SimulatedCameraEntry | CameraSettings | PythonEntry, Field(discriminator="kind")],
    BeforeValidator(_camera_kind),
]


class Bounds(Section):
    """The workspace, metres in the robot's base frame."""

    x: tuple[Metres, Metres] = (0.35, 0.65)
    y: tuple[Metres, Metres] = (-0.30, 0.30)

    @field_validator("x", "y")
    @classmethod
    def _from_low_to_high(cls, bounds: tuple[float, float]) -> tuple[float, float]:
        if not bounds[0] < bounds[1]:
            raise ValueError(f"expected the lower bound first, got {bounds[0]:g} and {bounds[1]:g}")
        return bounds


class LimitsEntry(Section):
    """What the gate lets through; see `Limits`."""

    z_min_m: Metres = Field(_LIMITS.z_min_m, ge=0)
    z_max_m: Metres = Field(_LIMITS.z_max_m, gt=0)
    clearance_z_m: Metres = Field(_LIMITS.clearance_z_m, gt=0)
    max_step_m: Metres = Field(_LIMITS.max_step_m, gt=0)
    max_speed_m_s: float = Field(_LIMITS.max_speed_m_s, gt=0, le=5)
    max_contact_force_n: float = Field(_LIMITS.max_contact_force_n, gt=0, le=500)
    max_grasp_force_n: float = Field(_LIMITS.max_grasp_force_n, gt=0, le=500)


class CalibrationFiles(Section):
    """Where the calibrations are, from the workcell file's own folder. Each is refused for another camera."""

    intrinsics: Path | None = None
    image_to_robot: Path | None = None
    camera_to_robot: Path | None = None
    """Of `robot-to-world --camera-to-world`, or of `hand-eye` with a fixed camera."""


class WorkcellFile(Section):
    """The whole file."""

    arm: ArmEntry = SimulatedEntry()
    camera: CameraEntry | None = None
    """Of a real arm: a number, a device, an address or a kind, or a section. Of a simulated one: its pictures' size."""
    cell: Seed = 0
    """Of a simulated workcell."""
    workspace: Bounds = Bounds()
    limits: LimitsEntry = LimitsEntry()
    handling: HandlingEntry = HandlingEntry()
    """Heights, forces and speeds of pick and place, as far as they do not follow from the bag and the gripper."""
    bag: Bag = Bag()
    calibrations: CalibrationFiles = CalibrationFiles()
    sure_within_m: Metres = Field(WorkcellSettings().sure_within_m, gt=0)
    """Nothing moves when a plan's pick or place is not known within this, nine times of ten."""

    @property
    def gate(self) -> Limits:
        """The limits; where, around the workspace, `config` says."""
        return replace(WorkcellSettings().limits, **self.limits.model_dump())

    def handled(self, arm: ArmInfo | None = None) -> Handled:
        """How the bag is handled, by this arm; a simulated cell's always as it always was."""
        simulated = isinstance(self.arm, SimulatedEntry)
        usual, thing = (SIMULATED_HANDLING, Bag().thing) if simulated else (Handling(), self.bag.thing)
        return handled(thing, self.gate, arm, self.handling.written, usual)

    def contradiction(self, arm: ArmInfo | None = None) -> str | None:
        """What in the handling contradicts the bag, the limits or this arm: one line, or None."""
        return contradiction(self.handled(arm).handling, self.bag.thing, self.gate, arm)

    @model_validator(mode="after")
    def _handled_without_contradiction(self) -> WorkcellFile:
        if isinstance(self.arm, SimulatedEntry):
            self.bag.check_simulated()
        if line := self.contradiction():
            raise ValueError(line)
        return self

    @model_validator(mode="after")
    def _real_arms_need_real_cameras(self) -> WorkcellFile:
        real = isinstance(self.camera, CameraSettings | PythonEntry)
        if isinstance(self.arm, REAL_ARMS) and not real:
            raise ValueError("a real arm needs a real camera; write `camera: 0`, or its device or address")
        if isinstance(self.arm, SimulatedEntry) and real:
            raise ValueError(
                "the arm 'sim' sees with a camera of its own; give its `width` and `height`, or leave `camera` out"
            )
        if isinstance(self.arm, ReplayEntry) and self.camera is not None:
            raise ValueError("the arm 'replay' shows what a camera saw; leave `camera` out")
        return self

    @property
    def picture_size(self) -> tuple[int, int]:
        """`(width, height)` of a simulated camera's pictures, pixels."""
        camera = self.camera
        return (camera.width, camera.height) if isinstance(camera, SimulatedCameraEntry) else PICTURE_SIZE


def read_workcell_file(path: Path) -> WorkcellFile:
    """Read and check a workcell file. Raises `BaggieError` with the line and entry that is wrong and what it may be."""
    try:
        text = read_text(path)
    except OSError as error:
        raise BaggieError(
            f"no workcell file {path} ({error.strerror}); give a YAML file, or 'sim' for the simulated workcell"
        ) from None
    content = parse_yaml(text, path)
    if not isinstance(content, dict) or not content:
        came = f"a {type(content).__name__}" if content else "nothing"
        raise BaggieError(
            f"expected entries such as `arm: sim` in {path}, got {came}; `baggie workcell new` writes such a file"
        )
    try:
        return WorkcellFile.model_validate(content)
    except ValidationError as error:
        raise BaggieError(explain(path, text, error, WorkcellFile)) from None
