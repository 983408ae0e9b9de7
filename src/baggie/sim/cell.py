"""A cell: one concrete workcell, with its camera, lens, lights and table. `--cell C` draws one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from baggie.errors import BaggieError
from baggie.geometry import FloatArray, invert_transform
from baggie.sim.lens import Lens

PICTURE_SIZE = (1280, 720)
"""`(width, height)` pixels, unless another camera is asked for."""
SMALLEST_SIDE, LARGEST_SIDE = 120, 4096
"""Pixels of a picture's side: on fewer a bag is a few pixels wide, and more fill no memory of a renderer's."""
HORIZONTAL_FOV = np.deg2rad(90.0)
"""Azure Kinect colour camera: 90 x 59 degrees in its 16:9 modes, 90 x 74 in its 4:3 ones (Microsoft's data sheet)."""


@dataclass(frozen=True)
class Light:
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
    lights: tuple[Light, ...]
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
        Light(
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
