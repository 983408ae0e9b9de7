"""A cell: one concrete workcell, with its camera, lens, lights and table. `--cell C` draws one.

Colours are drawn by hue, so that things can be told apart by it; the table top is a procedural texture with grain.
"""

from __future__ import annotations

import colorsys
from dataclasses import dataclass, replace

import cv2
import numpy as np

from baggie.errors import BaggieError
from baggie.geometry import FloatArray, invert_transform
from baggie.seeds import first_fit
from baggie.sim.sensor import Exposure, Lens
from baggie.types import Image

Color = tuple[int, int, int]
"""RGB, 0 to 255."""
Hues = tuple[tuple[float, float], ...]
"""Bands of hues, degrees; one that spans 0 ends above 360."""
ALL_HUES: Hues = ((0.0, 360.0),)
GOAL_CARD_HUE, PADDLE_HUE = 133.0, 307.0
"""Degrees: of the goal card and of the calibration paddle."""
APART = 60.0
"""Degrees between the hues of two things that are to be told apart by them."""
RESERVED_APART = 35.0
"""The same from a hue that is reserved."""


def hue_of(color: Color) -> float:
    """Hue of an RGB colour, degrees."""
    return 360.0 * colorsys.rgb_to_hsv(*(value / 255 for value in color))[0]


def rgb(hue: float, saturation: float, value: float) -> Color:
    """The colour with this hue (degrees), saturation and value (0 to 1)."""
    red, green, blue = colorsys.hsv_to_rgb(hue / 360.0 % 1.0, saturation, value)
    return round(255 * red), round(255 * green), round(255 * blue)


def hue_distance(a: float, b: float) -> float:
    """Degrees between two hues, at most 180."""
    return abs((a - b + 180.0) % 360.0 - 180.0)


def random_hue(
    rng: np.random.Generator,
    bands: Hues,
    unlike: float | None = None,
    reserved: tuple[float, ...] = (GOAL_CARD_HUE, PADDLE_HUE),
) -> float:
    """A hue from one of the bands, 60 degrees from `unlike` and 35 from the reserved ones.

    Raises `BaggieError` where the bands leave none.
    """

    def somewhere() -> float:
        low, high = bands[rng.integers(len(bands))]
        return float(rng.uniform(low, high)) % 360.0

    def apart(hue: float) -> bool:
        unlike_that = unlike is None or hue_distance(hue, unlike) >= APART
        return unlike_that and all(hue_distance(hue, other) >= RESERVED_APART for other in reserved)

    hue = first_fit(somewhere, apart)
    if hue is None:
        raise BaggieError(
            f"expected bands with a hue {APART:.0f} degrees from {unlike} and {RESERVED_APART:.0f} from each of "
            f"{reserved}, got {bands}; widen them"
        )
    return hue


def table_top(rng: np.random.Generator, color: tuple[int, int, int], grain: float, size: int = 512) -> Image:
    """A wooden or laminated surface, `(size, size, 3)`: streaks along one side, blotches, a few marks."""
    streaks = cv2.GaussianBlur(rng.normal(size=(size, size)), (0, 0), sigmaX=40, sigmaY=1.2)
    blotches = cv2.resize(rng.normal(size=(12, 12)), (size, size), interpolation=cv2.INTER_CUBIC)
    pattern = streaks / streaks.std() + 0.5 * blotches
    picture = np.array(color) * (1 + grain * pattern[..., None] / 2)
    for _ in range(6):  # pencil marks and scratches
        start, end = rng.integers(0, size, (2, 2))
        end = start + (end - start) // 6
        shade = [int(value) for value in np.array(color) * rng.uniform(0.6, 0.9)]
        cv2.line(picture, start.tolist(), end.tolist(), shade, 1, cv2.LINE_AA)
    return np.asarray(np.clip(picture, 0, 255), np.uint8)


PICTURE_SIZE = (1280, 720)
"""`(width, height)` pixels, unless another camera is asked for."""
SMALLEST_SIDE, LARGEST_SIDE = 120, 4096
"""Pixels of a picture's side: on fewer a bag is a few pixels wide, and more fill no memory of a renderer's."""
HORIZONTAL_FOV = np.deg2rad(90.0)
"""Azure Kinect colour camera: 90 x 59 degrees in its 16:9 modes, 90 x 74 in its 4:3 ones (Microsoft's data sheet)."""


@dataclass(frozen=True)
class Lamp:
    """A lamp: where it hangs, where it points, how bright it is."""

    position: tuple[float, float, float]
    direction: tuple[float, float, float]
    diffuse: float
    shadow: bool


@dataclass(frozen=True)
class Cell:
    """Everything about a workcell that stays as it is from one attempt to the next."""

    number: int
    camera_position: FloatArray
    """`(3,)` metres, robot base frame."""
    camera_rotation: FloatArray
    """`(3, 3)`, `R_base_camera` with OpenCV's axes: x right, y down, z into the picture."""
    lens: Lens
    lights: tuple[Lamp, ...]
    ambient: float
    table_color: tuple[int, int, int]
    table_grain: float
    """Contrast of the table's texture."""
    floor_color: tuple[int, int, int]
    table_pattern: int = 0
    """Which of its many tables stands there; 0 is its own."""

    @property
    def T_camera_base(self) -> FloatArray:
        """`(4, 4)`, maps base-frame points into the camera's frame."""
        T_base_camera = np.eye(4)
        T_base_camera[:3, :3] = self.camera_rotation
        T_base_camera[:3, 3] = self.camera_position
        return invert_transform(T_base_camera)

    def project(self, points: FloatArray) -> FloatArray:
        """Where points of the robot base frame appear: `(N, 3)` metres -> `(N, 2)` pixels (u, v)."""
        homogeneous = np.c_[points, np.ones(len(points))]
        in_camera = (homogeneous @ self.T_camera_base.T)[:, :3]
        return self.lens.project(in_camera)


def draw_cell(number: int, picture_size: tuple[int, int] = PICTURE_SIZE) -> Cell:
    """The cell with this number, always the same one, seen by a camera with pictures of `picture_size`, pixels.

    Whatever their shape, they are as many degrees wide. Raises `BaggieError` for a number below 0, or for none, and for
    pictures smaller or larger than can be drawn.
    """
    if not isinstance(number, int | np.integer) or number < 0:
        raise BaggieError(f"expected the number of a cell, a whole one from 0 on, got {number!r}; take 0")
    if not all(SMALLEST_SIDE <= side <= LARGEST_SIDE for side in picture_size):
        raise BaggieError(
            f"expected a camera whose pictures have sides of {SMALLEST_SIDE} to {LARGEST_SIDE} pixels, got "
            f"{picture_size[0]} x {picture_size[1]}; take 640 x 480"
        )
    rng = np.random.default_rng([0xCE11, number])
    position = np.array([rng.uniform(0.54, 0.66), rng.uniform(-0.12, 0.12), rng.uniform(0.76, 0.86)])
    aim = np.array([0.52 + rng.uniform(-0.03, 0.03), rng.uniform(-0.04, 0.04), 0.0])
    lights = tuple(
        Lamp(
            position=(rng.uniform(-0.2, 1.2), side * rng.uniform(0.5, 1.2), rng.uniform(1.6, 2.2)),
            direction=(rng.uniform(-0.2, 0.2), -side * rng.uniform(0.2, 0.5), -1.0),
            diffuse=rng.uniform(0.3, 0.45),
            shadow=side > 0,
        )
        for side in (-1.0, 1.0)
    )
    table = rng.uniform(110, 190) * np.array(
        [1.0, rng.uniform(0.85, 1.0), rng.uniform(0.65, 0.98)]
    )  # wood or grey
    return Cell(
        number=number,
        camera_position=position,
        camera_rotation=_look_at(position, aim, roll=rng.normal(0.0, np.deg2rad(3.0))),
        lens=Lens.random(rng, picture_size, HORIZONTAL_FOV),
        lights=lights,
        ambient=rng.uniform(0.25, 0.35),
        table_color=(int(table[0]), int(table[1]), int(table[2])),
        table_grain=rng.uniform(0.03, 0.12),
        floor_color=(int(rng.integers(60, 110)),) * 3,
    )


def _look_at(position: FloatArray, aim: FloatArray, roll: float) -> FloatArray:
    """`R_base_camera` of a camera that looks from `position` to `aim`, the robot at the top of its picture."""
    forward = aim - position
    forward /= np.linalg.norm(forward)
    up = np.array([-1.0, 0.0, 0.0])  # towards the robot
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    c, s = np.cos(roll), np.sin(roll)
    return np.column_stack([c * right + s * down, -s * right + c * down, forward])


_HEADLIGHT = 0.15  # what the scene's camera light adds straight down
_SPOT_M = 0.15  # how far from the table's middle a lamp may point


@dataclass(frozen=True)
class LightRange:
    """Ranges from which the light is drawn; lengths in metres."""

    lamps: tuple[int, int]
    height_m: tuple[float, float]
    aside_m: tuple[float, float]
    """How far to the left or right of the robot they hang."""
    brightness: tuple[tuple[float, float], ...]
    """Of all light together, 1 showing a white sheet white: one of these bands."""
    ambient: tuple[float, float]
    """Share of the ambient light."""
    gain: tuple[float, float]
    """Of the exposure."""
    cast: tuple[float, float]
    """By how much red is raised and blue lowered, or the other way round."""


USUAL = LightRange((1, 2), (1.6, 2.2), (0.4, 1.2), ((0.9, 1.2),), (0.25, 0.45), (0.95, 1.05), (0.0, 0.04))
UNSEEN = LightRange(
    (1, 3), (1.0, 1.5), (0.3, 1.2), ((0.6, 0.8), (1.25, 1.4)), (0.1, 0.6), (0.85, 1.1), (0.07, 0.14)
)


def draw_light(cell: Cell, light: LightRange, rng: np.random.Generator) -> tuple[Cell, Exposure]:
    """The cell under other lamps, and the exposure that its pictures have on the average."""
    low, high = light.brightness[rng.integers(len(light.brightness))]
    brightness = rng.uniform(low, high) - _HEADLIGHT
    ambient = brightness * rng.uniform(*light.ambient)
    count = int(rng.integers(light.lamps[0], light.lamps[1] + 1))
    shares = rng.uniform(0.5, 1.0, count)
    side = rng.choice([-1.0, 1.0])
    lamps = []
    for number, share in enumerate(shares / shares.sum()):
        position = np.array(
            [rng.uniform(-0.1, 1.1), side * rng.uniform(*light.aside_m), rng.uniform(*light.height_m)]
        )
        aim = np.array([0.5, 0.0, 0.0]) + np.append(rng.uniform(-_SPOT_M, _SPOT_M, 2), 0.0)
        direction = (aim - position) / np.linalg.norm(aim - position)
        # What hits the table askew is spread over more of it.
        diffuse = (brightness - ambient) * share / -direction[2]
        x, y, z = position.tolist()
        to_x, to_y, to_z = direction.tolist()
        lamps.append(Lamp((x, y, z), (to_x, to_y, to_z), float(diffuse), shadow=number == 0))
        side = -side
    cast = rng.choice([-1.0, 1.0]) * rng.uniform(*light.cast)
    exposure = Exposure(float(rng.uniform(*light.gain)), (float(1 + cast), 1.0, float(1 - cast)))
    return replace(cell, lights=tuple(lamps), ambient=float(ambient)), exposure
