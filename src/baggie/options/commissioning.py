"""Options of what sets up a workcell: its file, check-up and calibrations, printed targets, the virtual lab."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from annotated_types import Interval
from tyro.conf import Positional, arg

from baggie.errors import UsageError
from baggie.options.values import (
    BOARD,
    CARD_COLOR,
    HAND_BOARD,
    HAND_MARKER,
    TABLE_MARKER,
    USUAL_TASK,
    Color,
    Count,
    Height,
    NotNegative,
    Number,
    Options,
    Point,
    Port,
    Positive,
    Seed,
)


@dataclass(frozen=True)
class NewWorkcellOptions:
    """Write a workcell file."""

    out: Positional[Path] = Path("cell.yaml")
    """Where to; a file that is there already is left as it is."""


@dataclass(frozen=True)
class ShowWorkcellOptions:
    """Show what a workcell file says."""

    file: Positional[Path]
    """The workcell file."""


@dataclass(frozen=True)
class DoctorOptions(Options):
    """Check a workcell."""

    workcell: Positional[str] = "sim"
    """A workcell file, or `sim`."""
    cell: Seed = 0
    """Number of the simulated workcell."""
    move: Literal["ask", "yes", "no"] = "ask"
    """Whether the arm may move, slowly, through the whole workspace: clear the table, and have the stop at hand. With
    `yes` nobody is asked for anything: what needs a person is not tried."""
    lab: str | None = None
    """Address of the virtual lab that the workcell is in, such as http://127.0.0.1:8090: it does what a person would
    have to."""


@dataclass(frozen=True)
class LabOptions(Options):
    """What is in the lab, and where it is reached."""

    task: str = USUAL_TASK
    """Whose bags lie on the table, and where: one, or those of a task that stacks several, such as bag-tower."""
    cell: Seed = 0
    """Number of the simulated workcell: camera, lens, lights, table."""
    seed: Seed = 0
    """Of the scene: where the bags lie at first."""
    size: str = "1280x720"
    """Of the camera's pictures, pixels: WxH."""
    host: str = "127.0.0.1"
    """Address to listen at. The robot's ports there, 1337 and 1338, are given by its protocol; a second lab on the
    same computer takes another address, such as 127.0.0.2."""
    camera_port: Port = 8090
    """Port of the camera's stream and of the control channel; 0 for any that is free."""
    pace: NotNegative = 1.0
    """How many times as fast as real time it may go at most; 0: as fast as it can while the arm is at work."""
    fault: tuple[str, ...] = ()
    """What goes wrong: NAME, or NAME:AFTER with seconds of the lab's time; see docs/lab.md for the names."""
    out: Path | None = None
    """Where to write the workcell file, which is printed in any case."""

    def check(self) -> None:
        """Raise `UsageError` for what makes no lab."""
        self.faults()
        self.picture_size()

    def picture_size(self) -> tuple[int, int]:
        """`(width, height)` of the camera's pictures, pixels. Raises `UsageError` for what is none."""
        match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", self.size)
        if not match:
            raise UsageError(f"expected --size WIDTHxHEIGHT, in pixels, got {self.size}; try 640x480")
        width, height = match.groups()
        return int(width), int(height)

    def faults(self) -> list[tuple[str, float]]:
        """Names of faults, and when they come. Raises `UsageError` for what is neither."""
        faults = []
        for words in self.fault:
            name, _, after = words.partition(":")
            try:
                after_s = float(after or 0)
            except ValueError:
                after_s = math.nan
            if not 0 <= after_s < math.inf:
                raise UsageError(
                    f"expected --fault NAME or NAME:SECONDS, of the lab's time, got {words}; try {name}:5"
                )
            faults.append((name, after_s))
        return faults


@dataclass(frozen=True)
class PrintOptions(Options):
    """What to print, and on what."""

    target: Positional[str] = "board"
    """board, hand-marker, table-marker, hand-board, goal-card, or a target in full such as
    charuco:7x5:0.030:0.021:DICT_4X4_50, chessboard:9x6:0.025 or aruco:DICT_4X4_50:3:0.10 (metres)."""
    out: Path | None = None
    """The PDF; TARGET.pdf unless given."""
    paper: str | None = None
    """A4 or A3; what the target was made for unless given."""
    size: Annotated[float, Interval(gt=0, le=1)] = 0.13
    """Side of a goal card, metres."""
    color: Color = CARD_COLOR
    """RGB of a goal card."""


@dataclass(frozen=True)
class LiveOptions(Options):
    """Which camera and arm, when a calibration is made live."""

    workcell: str = "sim"
    """A workcell file, or `sim`: the simulated one, where everything a person would do happens by itself."""
    cell: Seed = 0
    """Number of the simulated workcell."""
    camera: str | None = None
    """A camera without an arm: its number, device or address as OpenCV opens it, or a video file; or `realsense`,
    `orbbec`, `k4a`, each with `:SERIAL` where several are plugged in."""
    seed: Seed = 0
    """Of what is random: where a simulated person holds the board, which points are visited."""


From = Annotated[Path | None, arg(name="from")]
"""The option `--from`, a word that Python keeps for itself."""


@dataclass(frozen=True)
class IntrinsicsOptions(LiveOptions):
    """Where the pictures come from, and what is in them."""

    out: Path = Path("camera.yaml")
    """The calibration to write. Beside it go a picture of where the board was seen and, live, a folder of pictures."""
    from_: From = None
    """Pictures already taken: a folder, one picture, or a video. Without it they are taken live."""
    board: str = BOARD
    """charuco:COLUMNSxROWS:SQUARE:MARKER:DICTIONARY or chessboard:COLUMNSxROWS:SQUARE, in metres, as measured."""
    name: str | None = None
    """The camera's name, which a workcell must repeat; that of the camera or the folder unless given."""
    factory: Path | None = None
    """Take the manufacturer's values instead: a ROS camera_info, a RealSense, an OpenCV or an mrcal file."""


@dataclass(frozen=True)
class ImageToRobotOptions(LiveOptions):
    """Where the arm goes, and what it carries."""

    out: Path = Path("image-to-robot.yaml")
    """The calibration to write. Beside it go a picture of its residuals and, live, a folder of pictures."""
    from_: From = None
    """Points already taken: a folder with views.json: {"camera": {"name", "width", "height"}, "views": [{"T_base_hand":
    4 x 4 or "base": [x, y, z] of the marker itself, "pixel": [u, v] or "image": "000.png"}, ...]}, metres."""
    intrinsics: Path | None = None
    """The camera's own calibration: the lens is then exact, and one height enough. Without it the lens is estimated."""
    marker: str = HAND_MARKER
    """What the hand carries: aruco:DICTIONARY:NUMBER:SIZE, or color:R,G,B for a coloured blob."""
    marker_in_hand: Point = (0.13, 0.0, 0.0)
    """The marker's middle in the tool's frame (x forward, y right, z down), metres."""
    prepared: bool = False
    """The table is clear, the marker in the hand and nobody near the arm: it begins at once, and asks nobody."""
    heights: tuple[Height, ...] = (0.05, 0.15)
    """At which the marker is carried, metres above the table. With one height and no intrinsics the map is right at
    that height only."""
    map_height: Height = 0.0
    """The height the saved map is right at, metres above the table, for whoever takes it as it is. Collecting and
    evaluating carry it to half of the bag's `height_m` in the workcell file, whatever this is."""
    columns: Count = 4
    """Of points from right to left."""
    rows: Count = 3
    """Of points from near to far."""
    limit_mm: Positive = 5.0
    """A map whose points disagree by more, each judged by a fit to the others (RMS), is refused."""


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


@dataclass(frozen=True)
class HandEyeOptions(LiveOptions):
    """Where the views come from."""

    out: Path = Path("hand-eye.yaml")
    """The calibration to write. Beside it go a picture and, live, a folder of views."""
    from_: From = None
    """A recording: a folder with views.json (units, mount; T_base_hand and T_camera_board or image of each view)."""
    keep_all: bool = False
    """Use all views, also those that disagree with the others."""
    intrinsics: Path = Path("camera.yaml")
    """The camera's own calibration; live only, a recording brings its own. It knows how the board sags that it was made
    with; where that is `board`, it is taken so."""
    mount: Literal["fixed", "hand"] = "fixed"
    """Live: the camera fixed and the board in the hand, or the camera on the hand and the board on the table."""
    board: str = HAND_BOARD
    """The board in the hand or on the table; live."""
    views: Annotated[int, Interval(ge=3)] = 15
    """How many to take, live."""


@dataclass(frozen=True)
class CheckOptions(LiveOptions):
    """What to check, and how."""

    map: Path = Path("image-to-robot.yaml")
    """The calibration to check."""
    points: Count = 8
    """How many points the marker in the hand is taken to, other ones than the map was made from."""
    touches: Number = 3
    """How often the marker on the table is touched; somebody says, or the simulator knows, how far off."""
    limit_mm: Positive = 3.0
    """A mean error above this is a failure: the exit status is 1."""
    marker: str = HAND_MARKER
    """In the hand, as for `image-to-robot`."""
    marker_in_hand: Point = (0.13, 0.0, 0.0)
    """As for `image-to-robot`."""
    prepared: bool = False
    """As for `image-to-robot`; with --touches 0, nobody is needed at all."""
    table_marker: str = TABLE_MARKER
    """Laid on the table and touched."""
    against: str | None = None
    """Instead of moving anything, compare the map with another one (a calibration file), or with what a trained
    `keypoint` policy has learned (a run's folder), at half the height of the workcell's bag."""
