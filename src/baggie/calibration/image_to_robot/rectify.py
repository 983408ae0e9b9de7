"""One camera's picture as if taken from straight above, through its map to the robot.

Every pixel of a grid over the table looks up where the camera sees that place, on the one plane the map is right for.
What lies in this plane keeps its size and shape wherever it is; what is higher leans away from the camera. So the
outline of an object that rests on a card is seen elsewhere than the card, and a bag that lies on others elsewhere than
the robot has it: by how much, its layer tells.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.calibration.image_to_robot.projection import project, to_plane
from baggie.errors import BaggieError
from baggie.geometry import FloatArray, Grid, PlanarPose
from baggie.types import LAYER_M, Goal, Image, Intrinsics, Observation, middle_of_layer_m

Float32 = NDArray[np.float32]
Pixels = Float32
"""`(2, rows, columns)`: u and v in the camera's picture."""

_SHRINK = 3
"""A pixel of a heat map over the camera's picture is as wide as about so many of the grid's: none shows nothing."""


@dataclass(frozen=True, eq=False)
class Leaning:
    """Says where bags in layers of a stack appear from straight above, on the plane of the picture, and the inverse.

    The line of sight through a bag meets that plane further from the camera's foot, the place right below it: as many
    times as the plane is further below the camera than the bag is. Yaws appear as they are.
    """

    camera: FloatArray
    """`(3,)` metres in the robot's base frame."""
    plane_m: float
    """Height of the picture's plane above the table: that of the middle of bags on it, layer 0."""

    @classmethod
    def of(cls, fitted: ImageToRobot) -> Self:
        """Tell it by a map at its own height. Raises `CalibrationError` where the map knows one height only."""
        matrix = fitted.at_height(middle_of_layer_m(1)).projection
        return cls(np.asarray(-np.linalg.solve(matrix[:, :3], matrix[:, 3]), float), fitted.height_m)

    def seen(self, pose: PlanarPose, layer: int) -> PlanarPose:
        """Where a bag at a pose in a layer appears on the plane. Raises `BaggieError` for one above the camera."""
        return self._from_foot(pose, self._times(layer))

    def there(self, pose: PlanarPose, layer: int) -> PlanarPose:
        """The inverse of `seen`."""
        return self._from_foot(pose, 1 / self._times(layer))

    def _from_foot(self, pose: PlanarPose, times: float) -> PlanarPose:
        """A pose so many times as far from the camera's foot."""
        x, y = (self.camera[:2] + times * (pose.xy - self.camera[:2])).tolist()
        return replace(pose, x=x, y=y)

    def _times(self, layer: int) -> float:
        above = float(self.camera[2])
        height = middle_of_layer_m(layer) if layer else self.plane_m
        if height >= above:
            raise BaggieError(
                f"expected a layer below the camera, {above:.2f} m above the table, got layer {layer}; give one up to "
                f"{math.ceil(above / LAYER_M - 0.5) - 1}"
            )
        return (above - self.plane_m) / (above - height)


@dataclass(frozen=True, eq=False)
class Rectifier:
    """Maps pictures of one camera, `lens.width` x `lens.height` pixels, to those of a grid, and points both ways."""

    lens: Intrinsics
    plane: FloatArray
    """`(3, 3)`: points (x, y, 1) of the plane, metres in the robot's base frame -> rays of the camera."""
    grid: Grid
    leaning: Leaning | None = None
    """Of bags in layers above the table; None where there are none."""

    @classmethod
    def of(cls, fitted: ImageToRobot, grid: Grid, leaning: Leaning | None = None) -> Self:
        """Make a rectifier at the map's height, for pictures of the size that the map is of."""
        plane = fitted.projection[:, [0, 1, -1]].copy()
        if fitted.height_aware:
            plane[:, 2] += fitted.height_m * fitted.projection[:, 2]
        return cls(fitted.lens, plane, grid, leaning)

    @property
    def size(self) -> tuple[int, int]:
        """`(width, height)` of the camera's pictures."""
        return self.lens.width, self.lens.height

    def to_grid(self, pixels: FloatArray) -> FloatArray:
        """`(N, 2)` pixels of the camera's picture -> `(N, 2)` of the grid, inside it or not; NaN past the horizon."""
        return self.grid.to_pixels(to_plane(self.lens, self.plane, pixels, np.zeros(len(pixels))))

    def from_grid(self, pixels: FloatArray) -> FloatArray:
        """The inverse of `to_grid`."""
        xy = self.grid.to_robot(pixels)
        return project(self.lens, self.plane, np.c_[xy, np.zeros(len(xy))])

    def contains(self, pixels: FloatArray) -> bool:
        """Whether all of `(N, 2)` pixels of the camera's picture show places of the grid."""
        rows, columns = self.grid.shape
        there = self.to_grid(pixels)
        return bool(((there >= -0.5) & (there <= [columns - 0.5, rows - 0.5])).all())

    def observation(self, picture: Image) -> Observation:
        """`(H, W, 3)` -> the table from straight above, with heights of 0 everywhere: nobody measured any."""
        rows, columns = self.grid.shape
        u, v = self._sampling
        fine = cv2.remap(picture, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        color = cv2.resize(fine, (columns, rows), interpolation=cv2.INTER_AREA)
        height = np.zeros((rows, columns), np.float32)
        return Observation(np.asarray(color, np.uint8), grid=self.grid, height=height)

    def goal(self, goal: Goal) -> Goal:
        """A goal in the camera's picture -> in that of the grid."""
        at = goal.object_at
        if at is not None:
            u, v = self.to_grid(np.array([at]))[0]
            at = (float(u), float(v))
        return replace(goal, corners=self.to_grid(goal.corners), object_at=at)

    def over_picture(self, heat: Float32) -> Float32:
        """A heat map of the grid `(rows, columns)`, at least 0 -> over the camera's picture, made smaller.

        Each pixel takes the most of what lies in it; where the camera sees no place of the grid it is 0.
        """
        width, height = (max(1, round(side / (_SHRINK * self._times))) for side in self.size)
        shown = np.zeros((height, width), np.float32)
        u, v = (
            np.floor((at + 0.5) * few / many).astype(int)
            for at, few, many in zip(self._seen_at, (width, height), self.size, strict=True)
        )
        inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
        np.maximum.at(shown, (v[inside], u[inside]), heat[inside])
        return shown

    def config(self) -> dict[str, Any]:
        """Give the settings in plain YAML types; the picture's size and the grid are kept elsewhere."""
        parts = {"matrix": self.lens.matrix, "distortion": self.lens.distortion, "plane": self.plane}
        config: dict[str, Any] = {name: part.tolist() for name, part in parts.items()}
        if (leaning := self.leaning) is not None:
            config["leaning"] = {"camera": leaning.camera.tolist(), "plane_m": leaning.plane_m}
        return config

    @classmethod
    def from_config(cls, config: Mapping[str, Any], size: tuple[int, int], grid: Grid) -> Self:
        """The inverse of `config`, of older versions' runs, too, which know no layers."""
        matrix, distortion, plane = (
            np.array(config[name], float) for name in ("matrix", "distortion", "plane")
        )
        lens, said = Intrinsics(*size, matrix.reshape(3, 3), distortion), config.get("leaning")
        leaning = None
        if said is not None:
            leaning = Leaning(np.array(said["camera"], float).reshape(3), float(said["plane_m"]))
        return cls(lens, plane.reshape(3, 3), grid, leaning)

    @cached_property
    def _times(self) -> int:
        """How many pixels of the camera's picture lie along one of the grid's, in its middle; at least 1."""
        rows, columns = self.grid.shape
        u, v = columns / 2, rows / 2
        here, *beside = self.from_grid(np.array([[u, v], [u + 1, v], [u, v + 1]]))
        return max(1, round(max(float(np.linalg.norm(each - here)) for each in beside)))

    @cached_property
    def _sampling(self) -> Pixels:
        """Where the camera sees the grid's pixels, each cut up so that no pixel of the camera is skipped."""
        return self._pixels(self._times)

    @cached_property
    def _seen_at(self) -> Pixels:
        """Where the camera sees the grid's pixels."""
        return self._pixels(1)

    def _pixels(self, times: int) -> Pixels:
        """Where the camera sees the grid's pixels, each cut into `times` x `times`."""
        rows, columns = self.grid.shape
        v, u = (np.mgrid[: rows * times, : columns * times] + 0.5) / times - 0.5
        seen = self.from_grid(np.c_[u.ravel(), v.ravel()])
        return np.ascontiguousarray(seen.T, np.float32).reshape(2, *u.shape)


def raise_card(corners: FloatArray, image_to_robot: ImageToRobot, height_m: float) -> FloatArray:
    """Where the corners of a card on the table, `(N, 2)` pixels (u, v), would be seen `height_m` above it.

    Pixel -> robot on the table -> pixel at `height_m`: without the camera's place the two differ by up to
    `height_m * distance from under the camera / camera's height`, some millimetres. The pixels are of the map's own
    picture size (`ImageToRobot.for_size`). Raises `CalibrationError` where the map knows one height only.
    """
    on_table = image_to_robot.at_height(0.0).to_robot(corners)
    return image_to_robot.at_height(height_m).to_pixels(on_table)
