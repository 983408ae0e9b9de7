"""From the picture to the robot: a homography, right at one height, and an offset for the object's own.

Points on a plane at height h project to the picture by a homography (Hartley & Zisserman, Multiple View
Geometry, section 2.3). Seen through the homography of *another* height, a point appears moved along the line
from the spot under the camera: `x' = x + constant + scale * (x - center)`, three numbers, exactly, for a
camera without lens distortion. The published system calls this its "offset for camera distortion".
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path

import cv2
import numpy as np
import yaml
from numpy.typing import ArrayLike

from baggie.errors import BaggieError, DataError
from baggie.files import write_text
from baggie.geometry import FloatArray, Rectangle, apply_homography, wrap_angle

MIN_POINTS = 6
_OUTLIER_M = 0.01
_KIND = "image-to-robot"


@dataclass(frozen=True)
class HeightOffset:
    """`x' = x + constant_m + scale * (x - center_m)`: from the height of the fit to the object's."""

    constant_m: FloatArray
    """`(2,)`."""
    scale: float
    center_m: FloatArray
    """`(2,)`, the middle of the workspace; it only makes the constant readable."""
    height_m: float
    """Of the object as the camera sees it, above the table."""

    def matrix(self) -> FloatArray:
        """`(3, 3)`, the same as a homogeneous transform of the plane."""
        shift = self.constant_m - self.scale * self.center_m
        grow = 1.0 + self.scale
        return np.array([[grow, 0.0, shift[0]], [0.0, grow, shift[1]], [0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class Residuals:
    """How well the fit explains its own points, millimetres."""

    rms_mm: float
    max_mm: float
    leave_one_out_mm: float
    """Root mean square over points, each predicted by a fit to the others: what to expect of a new point."""
    points: int
    dropped: int
    """Points more than 1 cm off, left out of the fit and of the other figures."""


@dataclass(frozen=True)
class ImageToRobot:
    """Maps pixels (u, v) of pictures of one size to x, y in the robot's base frame, metres, at one height."""

    homography: FloatArray
    """`(3, 3)`, pixels to metres, for points `height_m` above the table."""
    size: tuple[int, int]
    """`(width, height)` of the pictures, pixels."""
    height_m: float
    area: Rectangle
    """What the points of the fit span; beyond, the map extrapolates."""
    residuals: Residuals
    offset: HeightOffset | None = None
    fitted_on: str = ""
    """ISO date."""

    @classmethod
    def fit(cls, pixels: ArrayLike, robot: ArrayLike, size: tuple[int, int], height_m: float) -> ImageToRobot:
        """Fit to pairs of `pixels` `(N, 2)` and `robot` `(N, 2)` metres, all at `height_m`, less outliers.

        Raises `BaggieError` for fewer than six points, or points nearly on a line.
        """
        pixels, robot = np.asarray(pixels, float).reshape(-1, 2), np.asarray(robot, float).reshape(-1, 2)
        _check_points(pixels, robot)
        matrix, inliers = cv2.findHomography(pixels, robot, cv2.RANSAC, _OUTLIER_M, maxIters=5000)
        good, needed = (
            0 if matrix is None else int(inliers.sum()),
            max(MIN_POINTS, math.ceil(0.7 * len(pixels))),
        )
        if good < needed:
            raise BaggieError(
                f"expected at least {needed} of {len(pixels)} points to agree on a homography within "
                f"{_OUTLIER_M * 100:.0f} cm, {good} do; check the marker's colour and collect them again"
            )
        keep = inliers.ravel().astype(bool)
        matrix = _least_squares(pixels[keep], robot[keep])
        residuals = _residuals(matrix, pixels[keep], robot[keep], dropped=int((~keep).sum()))
        low, high = robot[keep].min(axis=0).tolist(), robot[keep].max(axis=0).tolist()
        area = Rectangle(low[0], high[0], low[1], high[1])
        return cls(matrix, size, height_m, area, residuals, fitted_on=date.today().isoformat())

    @property
    def matrix(self) -> FloatArray:
        """`(3, 3)`, pixels to metres, the offset included."""
        return self.homography if self.offset is None else self.offset.matrix() @ self.homography

    def with_offset(self, offset: HeightOffset | None) -> ImageToRobot:
        """The same map with another offset."""
        return replace(self, offset=offset)

    def for_size(self, size: tuple[int, int]) -> ImageToRobot:
        """The map for the same camera's pictures resized. Raises `BaggieError` for another shape."""
        (width, height), (own_width, own_height) = size, self.size
        if width * own_height != height * own_width:
            raise BaggieError(
                f"expected a picture of {own_width} x {own_height} pixels (or the same shape), "
                f"got {width} x {height}; calibrate again with this camera"
            )
        grow = own_width / width
        shift = (grow - 1) / 2
        unresize = np.array([[grow, 0.0, shift], [0.0, grow, shift], [0.0, 0.0, 1.0]])
        return replace(self, homography=self.homography @ unresize, size=size)

    def to_robot(self, pixels: ArrayLike) -> FloatArray:
        """`(N, 2)` pixels (u, v) -> `(N, 2)` metres."""
        return apply_homography(self.matrix, pixels)

    def to_pixels(self, robot: ArrayLike) -> FloatArray:
        """`(N, 2)` metres -> `(N, 2)` pixels (u, v)."""
        return apply_homography(np.linalg.inv(self.matrix), robot)

    def yaw_to_robot(self, pixel: ArrayLike, yaw: float) -> float:
        """The angle of a square seen at `pixel` `(2,)` with image angle `yaw`; radians in [-pi/4, pi/4).

        Both edges of the square are turned by the map's Jacobian; where it shears, they share the error.
        """
        u, v = np.asarray(pixel, float)
        w = self.matrix[2] @ [u, v, 1.0]
        x, y = apply_homography(self.matrix, [[u, v]])[0]
        jacobian = (self.matrix[:2, :2] - np.outer([x, y], self.matrix[2, :2])) / w
        edges = jacobian @ np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
        angles = np.arctan2(edges[1], edges[0])
        return wrap_angle(float(np.angle(np.exp(4j * angles).sum())) / 4, math.pi / 2)

    def save(self, path: Path) -> None:
        """Write readable YAML; floats keep every digit, so `load` gives the same map to the bit."""
        width, height = self.size
        r, o = self.residuals, self.offset
        content: dict[str, object] = {
            "kind": _KIND,
            "frame": "robot base: x forward, y left, on the table",
            "units": "pixels (u, v) with centres at integers -> metres",
            "fitted_on": self.fitted_on,
            "picture": {"width": width, "height": height},
            "height_m": self.height_m,
            "area_m": {"x": [self.area.x_min, self.area.x_max], "y": [self.area.y_min, self.area.y_max]},
            "homography": self.homography.tolist(),
            "residuals_mm": {"rms": r.rms_mm, "max": r.max_mm, "leave_one_out": r.leave_one_out_mm},
            "points": r.points,
            "dropped": r.dropped,
        }
        if o is not None:
            content["offset"] = {
                "constant_m": o.constant_m.tolist(),
                "scale": o.scale,
                "center_m": o.center_m.tolist(),
                "height_m": o.height_m,
            }
        write_text(path, yaml.safe_dump(content, sort_keys=False, default_flow_style=None))

    @classmethod
    def load(cls, path: Path) -> ImageToRobot:
        """Read what `save` wrote. Raises `DataError` when the file is missing or is something else."""
        try:
            content = yaml.safe_load(path.read_text())
            if content["kind"] != _KIND:
                raise ValueError(f"kind {content['kind']}")
            r, o = content["residuals_mm"], content.get("offset")
            offset = o and HeightOffset(
                np.array(o["constant_m"]), o["scale"], np.array(o["center_m"]), o["height_m"]
            )
            return cls(
                np.array(content["homography"], float).reshape(3, 3),
                (content["picture"]["width"], content["picture"]["height"]),
                content["height_m"],
                Rectangle(*content["area_m"]["x"], *content["area_m"]["y"]),
                Residuals(r["rms"], r["max"], r["leave_one_out"], content["points"], content["dropped"]),
                offset,
                content["fitted_on"],
            )
        except (OSError, KeyError, TypeError, ValueError, yaml.YAMLError) as error:
            raise DataError(
                f"expected an image-to-robot calibration in {path}, got {error!r}; calibrate again"
            ) from error


def offset_to_height(low: ImageToRobot, high: ImageToRobot, height_m: float) -> HeightOffset:
    """The offset that takes `low` to `height_m`, by following lines of sight through the planes of two maps.

    The maps are fitted at two heights, with no offset of their own. A line of sight is straight (but for the
    lens), so where it meets a third height follows from where it meets the two.
    """
    area = low.area
    spots = np.array([[x, y] for x in (area.x_min, area.x_max) for y in (area.y_min, area.y_max)])
    center = spots.mean(axis=0)
    along = (height_m - low.height_m) / (high.height_m - low.height_m)
    shifts = along * (high.to_robot(low.to_pixels(spots)) - spots)
    design = np.concatenate([np.tile(np.eye(2), (4, 1, 1)), (spots - center)[:, :, None]], axis=2)
    unknowns, *_ = np.linalg.lstsq(design.reshape(8, 3), shifts.reshape(8), rcond=None)
    return HeightOffset(unknowns[:2], float(unknowns[2]), center, height_m)


def _check_points(pixels: FloatArray, robot: FloatArray) -> None:
    if len(pixels) != len(robot) or len(pixels) < MIN_POINTS:
        raise BaggieError(
            f"expected at least {MIN_POINTS} pairs of pixel and robot position, "
            f"got {len(pixels)} and {len(robot)}; collect more points"
        )
    for points, where in ((pixels, "picture"), (robot, "workspace")):
        spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
        if not np.isfinite(spread).all() or spread[1] < 0.05 * spread[0]:
            raise BaggieError(
                f"expected points spread over the {where}, got points nearly on one line; "
                "move the arm sideways too"
            )


def _least_squares(pixels: FloatArray, robot: FloatArray) -> FloatArray:
    """The homography with least squared error in the robot's plane."""
    matrix, _ = cv2.findHomography(pixels, robot, 0)
    return np.asarray(matrix, float)


def _residuals(matrix: FloatArray, pixels: FloatArray, robot: FloatArray, dropped: int) -> Residuals:
    errors = np.linalg.norm(apply_homography(matrix, pixels) - robot, axis=1) * 1000
    left_out = []
    for i in range(len(pixels)):
        others = np.arange(len(pixels)) != i
        without = _least_squares(pixels[others], robot[others])
        left_out.append(np.linalg.norm(apply_homography(without, pixels[i : i + 1])[0] - robot[i]) * 1000)
    return Residuals(
        rms_mm=float(np.sqrt(np.mean(errors**2))),
        max_mm=float(errors.max()),
        leave_one_out_mm=float(np.sqrt(np.mean(np.square(left_out)))),
        points=len(pixels),
        dropped=dropped,
    )
