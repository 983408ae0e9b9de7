"""What a person writes down, in YAML, about a workcell, what lies on its table, and how that is to be handled."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, ValidationError, field_validator, model_validator

from baggie.cameras import settings_of
from baggie.cameras.camera import CameraEntry
from baggie.entries import Metres, OfKind, Section, explain
from baggie.errors import BaggieError, explained
from baggie.files import parse_yaml, read_text
from baggie.options.commissioning import ShowWorkcellOptions
from baggie.options.values import Color, Seed
from baggie.registry import ARMS, CAMERAS
from baggie.robot.arm import ArmEntry, ArmInfo
from baggie.robot.handling_rules import Handled, Thing, contradiction, handled
from baggie.robot.limits import Limits
from baggie.robot.primitives import Handling
from baggie.sim.bag import FULL_HEIGHT_M, LONG_ASPECT, Bag
from baggie.sim.cell import LARGEST_SIDE, PICTURE_SIZE, SMALLEST_SIDE
from baggie.workcell.workcell import Workcell, WorkcellSettings

SIMULATED = "simulated FR3"
"""What a recording in a simulated workcell says moved."""

_SIMULATED_M = (0.06, 0.2)
"""Sides of a simulated bag."""


class HandlingEntry(Section):
    """What is written of `Handling`; the rest follows from the object and the gripper, see `handling_rules`."""

    travel_z_m: float | None = None
    approach_z_m: float | None = None
    pick_z_m: float | None = None
    touch_force_n: float | None = None
    land_force_n: float | None = None
    place_z_m: float | None = None
    open_width_m: float | None = None
    grasp_force_n: float | None = None
    release_width_m: float | None = None
    empty_width_m: float | None = None
    fast_m_s: float | None = None
    feel_m_s: float | None = None
    carry_m_s: float | None = None
    top_force_n: float | None = None
    sink_m: float | None = None
    stand_force_n: float | None = None
    press_m: float | None = None

    @property
    def written(self) -> dict[str, float]:
        """By name."""
        return self.model_dump(exclude_none=True)


class BagEntry(Section):
    """The bag, or whatever lies there in its place: in a simulated cell all of it, for a real one size and colour."""

    length_m: float = Field(0.12, gt=0.01, lt=0.5)
    width_m: float = Field(0.12, gt=0.01, lt=0.5)
    height_m: float = Field(FULL_HEIGHT_M, gt=0.001, lt=0.5)
    """Of what rests on the table: it is seen, and measured, at half of it."""
    hard: bool = False
    """Whether the fingers hold it by its sides, rather than pinch it."""
    mass_kg: float = Field(0.2, gt=0.02, lt=1.0)
    """In a simulated cell."""
    color: Color = (196, 40, 44)
    colors: tuple[Color, ...] = ()
    """Of all bags that lie about, each another, where there are several to stack."""

    @model_validator(mode="after")
    def _length_is_the_longer(self) -> BagEntry:
        if self.width_m >= LONG_ASPECT * self.length_m:
            raise ValueError(
                f"expected the longer side as length_m, got {self.length_m:g} and a width_m of {self.width_m:g}; "
                "exchange them"
            )
        return self

    @property
    def long(self) -> bool:
        """Whether it looks the same twice a turn only, and is gripped across its width."""
        return self.length_m >= LONG_ASPECT * self.width_m

    @property
    def symmetry(self) -> int:
        """How often a turn the hand takes it alike: what is stacked half a turn, so that bags bridge gaps below."""
        return 2 if self.colors else self.simulated.symmetry

    @property
    def thing(self) -> Thing:
        """What is handled."""
        return Thing((self.length_m, self.width_m, self.height_m), self.hard, self.long)

    @property
    def simulated(self) -> Bag:
        """The bag of a simulated cell."""
        return Bag(
            length_m=self.length_m,
            width_m=self.width_m,
            shape="long" if self.long else "square",
            mass_kg=self.mass_kg,
            color=self.color,
        )

    def recorded(self) -> dict[str, Any]:
        """What a recording says of it: what older ones do not know, where it is unusual."""
        usual, later = BagEntry(), ("height_m", "hard", "colors")
        return self.model_dump(
            mode="json", exclude={name for name in later if getattr(self, name) == getattr(usual, name)}
        )

    def check_simulated(self) -> None:
        """Raise `ValueError` for what the simulated bag, a soft pillow, cannot be."""
        low, high = _SIMULATED_M
        for name in ("length_m", "width_m"):
            value = getattr(self, name)
            if not low < value < high:
                raise ValueError(
                    f"bag.{name} is {value:g}, expected {low:g} to {high:g} in a simulated cell, where a smaller "
                    "pillow is so thin between the fingers that they seem empty; change it, or take a real arm"
                )
        if self.height_m != FULL_HEIGHT_M:
            raise ValueError(
                f"bag.height_m is {self.height_m:g}, a simulated bag rests {FULL_HEIGHT_M:g} m high; leave it out"
            )
        if self.hard:
            raise ValueError("bag.hard is true, a simulated bag is soft; leave it out, or take a real arm")


_LIMITS = WorkcellSettings().limits


class CellEntry(ArmEntry):
    """An arm that is no robot: it comes with a workcell, camera and table, of its own."""

    real: ClassVar[bool] = False

    def info(self, folder: Path) -> ArmInfo | None:
        """None: nobody has to know what it can do."""
        return None

    def usual(self, bag: BagEntry) -> tuple[Handling, Thing]:
        """From what the handling of a bag follows."""
        return Handling(), bag.thing

    def check_bag(self, bag: BagEntry) -> None:
        """Raise `ValueError` for what cannot lie there."""

    def check_camera(self, camera: CameraEntry | None) -> None:
        """Raise `ValueError` for a camera that it has no use for."""

    def workcell(self, written: WorkcellFile, settings: WorkcellSettings, folder: Path) -> Workcell:
        """The workcell, open. Raises `BaggieError`."""
        raise NotImplementedError


class SimulatedEntry(CellEntry):
    """`arm: sim` for short."""

    kind: Literal["sim"] = "sim"

    def title(self, folder: Path) -> str:
        """As the arm has it."""
        return SIMULATED

    def usual(self, bag: BagEntry) -> tuple[Handling, Thing]:
        """As it always was, whatever the bag."""
        return Handling(), BagEntry().thing

    def check_bag(self, bag: BagEntry) -> None:
        """Raise `ValueError` for what the simulated bag, a soft pillow, cannot be."""
        bag.check_simulated()

    def check_camera(self, camera: CameraEntry | None) -> None:
        """Raise `ValueError` for a real one."""
        if camera is not None and camera.real:
            raise ValueError(
                "the arm 'sim' sees with a camera of its own; give its `width` and `height`, or leave `camera` out"
            )

    def workcell(self, written: WorkcellFile, settings: WorkcellSettings, folder: Path) -> Workcell:
        """The cell with the number in the file, with its bag."""
        from baggie.workcell.simulated import SimulatedWorkcell  # noqa: PLC0415 -- MuJoCo takes its time

        size, things = written.picture_size, (written.bag.simulated,)
        return SimulatedWorkcell(written.cell, settings=settings, things=things, picture_size=size)


class ReplayEntry(CellEntry):
    """No arm: a recording is shown."""

    kind: Literal["replay"] = "replay"
    about: ClassVar[str] = "a recording"
    recording: Path
    """Its folder, from the workcell file's own."""

    def check_camera(self, camera: CameraEntry | None) -> None:
        """Raise `ValueError` for any."""
        if camera is not None:
            raise ValueError("the arm 'replay' shows what a camera saw; leave `camera` out")

    def workcell(self, written: WorkcellFile, settings: WorkcellSettings, folder: Path) -> Workcell:
        """The recording's. Raises `DataError` where it cannot be read."""
        from baggie.data import open_dataset  # noqa: PLC0415 -- pyarrow takes its time
        from baggie.workcell.replay import ReplayWorkcell  # noqa: PLC0415

        recording = open_dataset(folder / self.recording)
        return ReplayWorkcell(recording, settings, recording.camera)


class SimulatedCameraEntry(CameraEntry):
    """The camera of a simulated workcell, `camera: {width: 640, height: 480}`."""

    real: ClassVar[bool] = False

    kind: Literal["sim"] = "sim"
    width: int = Field(PICTURE_SIZE[0], ge=SMALLEST_SIDE, le=LARGEST_SIDE)
    """Of its pictures, pixels."""
    height: int = Field(PICTURE_SIZE[1], ge=SMALLEST_SIDE, le=LARGEST_SIDE)


def _arm_in_full(entry: Any) -> Any:
    return {"kind": entry} if isinstance(entry, str) else entry


def _camera_in_full(entry: Any) -> Any:
    """The entry with its kind: `camera: 0` for short, and a section with a width or a height is a simulated one's."""
    if isinstance(entry, (str, int)) and not isinstance(entry, bool):
        return settings_of(str(entry))
    if isinstance(entry, Mapping) and "kind" not in entry:
        return {"kind": "sim" if {"width", "height"} & entry.keys() else "opencv", **entry}
    return entry


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

    arm: Annotated[ArmEntry, OfKind(ARMS, _arm_in_full)] = SimulatedEntry()
    camera: Annotated[CameraEntry | None, OfKind(CAMERAS, _camera_in_full)] = None
    """Of a real arm: a number, a device, an address or a kind, or a section. Of a simulated one: its pictures' size."""
    cell: Seed = 0
    """Of a simulated workcell."""
    workspace: Bounds = Bounds()
    limits: LimitsEntry = LimitsEntry()
    handling: HandlingEntry = HandlingEntry()
    """Heights, forces and speeds of pick and place, as far as they do not follow from the bag and the gripper."""
    bag: BagEntry = BagEntry()
    calibrations: CalibrationFiles = CalibrationFiles()
    sure_within_m: Metres = Field(WorkcellSettings().sure_within_m, gt=0)
    """Nothing moves when a plan's pick or place is not known within this, nine times of ten."""

    @property
    def gate(self) -> Limits:
        """The limits; where, around the workspace, `config` says."""
        return replace(WorkcellSettings().limits, **self.limits.model_dump())

    @property
    def own_cell(self) -> CellEntry | None:
        """The arm, where it comes with a workcell of its own."""
        return self.arm if isinstance(self.arm, CellEntry) else None

    def handled(self, arm: ArmInfo | None = None) -> Handled:
        """How the bag is handled, by this arm; a simulated cell's always as it always was."""
        usual, thing = self.own_cell.usual(self.bag) if self.own_cell else (Handling(), self.bag.thing)
        return handled(thing, self.gate, arm, self.handling.written, usual)

    def contradiction(self, arm: ArmInfo | None = None) -> str | None:
        """What in the handling contradicts the bag, the limits or this arm: one line, or None."""
        return contradiction(self.handled(arm).handling, self.bag.thing, self.gate, arm)

    @model_validator(mode="after")
    def _handled_without_contradiction(self) -> WorkcellFile:
        if self.own_cell:
            self.own_cell.check_bag(self.bag)
        if line := self.contradiction():
            raise ValueError(line)
        return self

    @model_validator(mode="after")
    def _real_arms_need_real_cameras(self) -> WorkcellFile:
        if self.own_cell:
            self.own_cell.check_camera(self.camera)
        elif self.camera is None or not self.camera.real:
            raise ValueError("a real arm needs a real camera; write `camera: 0`, or its device or address")
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


def shown_workcell(options: ShowWorkcellOptions) -> dict[str, Any]:
    """What `baggie workcell show` says: all that is written or left to defaults, and of `handling` what follows.

    Each value of `handling` is with what it comes from. Nothing is connected. Raises `BaggieError` for a file that
    cannot be used, and for a handling that this arm cannot do; where the arm cannot be made here, `gripper` says why,
    and nothing follows from it.
    """
    path = options.file
    written = read_workcell_file(path)
    arm: ArmInfo | None = None
    gripper = "of no real arm"
    try:
        arm = written.arm.info(path.parent)
    except BaggieError as error:
        gripper = f"not known here: {error}"
    except ImportError as error:
        if (known := explained(error)) is None:
            raise
        gripper = f"not known here: {known}"
    if arm is not None:
        if line := written.contradiction(arm):
            raise BaggieError(f"{path}: {line}")
        gripper = f"of {arm.name}: opens to {arm.max_width_m:g} m"
    found = written.handled(arm)
    handling = {
        name: {"value": value, "source": found.sources[name]}
        for name, value in asdict(found.handling).items()
    }
    return {**written.model_dump(mode="json"), "gripper": gripper, "handling": handling}
