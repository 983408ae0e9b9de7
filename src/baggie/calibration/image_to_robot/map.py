"""From the picture to the robot: where on a plane of a given height, in the robot's base frame, a pixel is.

Points the arm itself took to known positions tell where the camera is (`fit.py`). With a known lens, or
from points at two heights, the map is good for every height; from points at one height it is a homography, good for
that height alone. It knows how far off it may be: see `covariance_at`.

Whether the marker is where the hand is said to hold it is checked, too. Carried with the hand always turned the same
way, a marker that sits 10 mm further forward than stated only shifts the whole map by 10 mm, and every residual looks
perfect. Turned this way and that, it cannot.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import date
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from baggie.calibration.files import CameraCalibrated, CameraIdentity
from baggie.calibration.image_to_robot.fit import LensOrigin, solve
from baggie.calibration.image_to_robot.projection import derivatives, heights_of, project, to_plane
from baggie.calibration.image_to_robot.residuals import MapComparison, Residuals, lattice, shared_area
from baggie.errors import CalibrationError
from baggie.geometry import FloatArray, Rectangle, wrap_angle
from baggie.pictures import same_shape
from baggie.types import Intrinsics

_SAME_HEIGHT_M = 0.001
_COMPARED = (9, 15)
"""Rows and columns of the grid on which two maps are compared."""


@dataclass(frozen=True)
class ImageToRobot(CameraCalibrated):
    """Maps pixels (u, v) of one camera's pictures to x, y in the robot's base frame, metres, at one height."""

    KIND = "image-to-robot"

    lens: Intrinsics
    lens_origin: LensOrigin
    """`calibrated`: given. `estimated`: radial terms were fitted along. `none`: taken for a pinhole."""
    projection: FloatArray
    """`(3, 4)` from base-frame points (x, y, z, 1) to rays, or, fitted at one height, `(3, 3)` from (x, y, 1)."""
    height_m: float
    """Above the table: the plane on which lines of sight end."""
    heights_m: tuple[float, ...]
    """Of the points of the fit."""
    area: Rectangle
    """What the points of the fit span; beyond, the map extrapolates."""
    covariance: FloatArray
    """Of fx, fy, cx, cy, the distortion, and the projection row by row: `(4 + D + M, 4 + D + M)`."""
    residuals: Residuals
    pictures: tuple[str, ...] = ()
    """Names of the pictures the points were found in."""
    made_on: str = field(default_factory=lambda: date.today().isoformat())
    """ISO date."""

    @classmethod
    def fit(
        cls,
        pixels: ArrayLike,
        robot: ArrayLike,
        camera: CameraIdentity,
        *,
        intrinsics: Intrinsics | None = None,
        intrinsics_covariance: FloatArray | None = None,
        height_m: float | None = None,
        limit_mm: float = 5.0,
        pictures: Sequence[str] = (),
    ) -> ImageToRobot:
        """Fit to pixels `(N, 2)` and where the robot had them, `(N, 3)` metres in its base frame.

        `intrinsics` of the calibrated camera, with the covariance `(4 + D, 4 + D)` of fx, fy, cx, cy and the
        distortion; without them the lens is estimated along as far as the points tell it. `height_m` is where the map
        is to be right, the lowest height of the points unless given. Up to three of ten points may be wrong.

        Raises `CalibrationError` for too few points (six; eight at two heights without intrinsics), points nearly on a
        line, points that do not agree, a mirrored picture, and left-out points more than `limit_mm` (RMS) off.
        """
        pixels, robot = np.asarray(pixels, float).reshape(-1, 2), np.asarray(robot, float).reshape(-1, 3)
        if intrinsics is not None and (intrinsics.width, intrinsics.height) != camera.size:
            raise CalibrationError(
                f"expected intrinsics of pictures of {camera.width} x {camera.height} pixels, got those of "
                f"{intrinsics.width} x {intrinsics.height}; calibrate the camera at this resolution"
            )
        found = solve(robot, pixels, camera.size, intrinsics, intrinsics_covariance)
        residuals = Residuals(robot, found.error_m * 1000, found.left_out_m * 1000, found.kept)
        if not residuals.leave_one_out_mm <= limit_mm:
            raise CalibrationError(
                f"expected points that agree, each within {limit_mm:.1f} mm (RMS) of a fit to the others, got "
                f"{residuals.leave_one_out_mm:.1f} mm; check the marker's offset in the hand, that camera and robot "
                "stood still, and collect more points"
            )
        used = robot[found.kept]
        heights = heights_of(used)
        (x_min, y_min, _), (x_max, y_max, _) = used.min(axis=0).tolist(), used.max(axis=0).tolist()
        fitted = cls(
            camera=camera,
            lens=found.lens,
            lens_origin=found.origin,
            projection=found.matrix,
            height_m=heights[0],
            heights_m=heights,
            area=Rectangle(x_min, x_max, y_min, y_max),
            covariance=found.covariance,
            residuals=residuals,
            pictures=tuple(pictures),
        )
        return fitted if height_m is None else fitted.at_height(height_m)

    @property
    def height_aware(self) -> bool:
        """Whether the map can be carried to other heights than the one of its points."""
        return bool(self.projection.shape[1] == 4)

    def at_height(self, height_m: float) -> ImageToRobot:
        """The map for points at another height. Raises `CalibrationError` where one height is all it knows."""
        if not self.height_aware:
            if abs(height_m - self.height_m) <= _SAME_HEIGHT_M:
                return self
            raise CalibrationError(
                f"this map was fitted at one height only, {self.height_m:.3f} m, not at {height_m:.3f} m; collect "
                "points at a second height, or calibrate the camera's lens"
            )
        return replace(self, height_m=float(height_m))

    def for_size(self, size: tuple[int, int]) -> ImageToRobot:
        """The map for the same camera's pictures resized. Raises `CalibrationError` for another shape."""
        if not same_shape(size, self.camera.size):
            (width, height), (own_width, own_height) = size, self.camera.size
            raise CalibrationError(
                f"expected a picture of {own_width} x {own_height} pixels (or the same shape), "
                f"got {width} x {height}; calibrate again with this camera"
            )
        return self.squeezed(size)

    def squeezed(self, size: tuple[int, int]) -> ImageToRobot:
        """The map for the same camera's pictures resized to `size`, whatever shape that gives them."""
        (width, height), (own_width, own_height) = size, self.camera.size
        if size == self.camera.size:
            return self
        scale = np.ones(len(self.covariance))
        scale[[0, 2]], scale[[1, 3]] = width / own_width, height / own_height  # of fx and cx, of fy and cy
        return replace(
            self,
            camera=CameraIdentity(self.camera.name, width, height),
            lens=self.lens.scaled(width, height),
            covariance=self.covariance * np.outer(scale, scale),
        )

    def to_robot(self, pixels: ArrayLike) -> FloatArray:
        """`(N, 2)` pixels (u, v) -> `(N, 2)` metres; NaN where a line of sight does not lead to the plane."""
        pixels = np.asarray(pixels, float).reshape(-1, 2)
        return to_plane(self.lens, self.projection, pixels, np.full(len(pixels), self.height_m))

    def to_pixels(self, robot: ArrayLike) -> FloatArray:
        """`(N, 2)` metres -> `(N, 2)` pixels (u, v)."""
        return project(self.lens, self.projection, self._on_plane(robot))

    def yaw_to_robot(self, pixel: ArrayLike, yaw: float) -> float:
        """The angle of a square seen at `pixel` `(2,)` with image angle `yaw`; radians in [-pi/4, pi/4).

        Both edges of the square are turned by the map's Jacobian, lens included; where it shears, they share the error.
        """
        _, by_xy, _ = derivatives(self.lens, self.projection, self._on_plane(self.to_robot(pixel)))
        c, s = math.cos(yaw), math.sin(yaw)
        edges = np.linalg.solve(by_xy[0], np.array([[c, -s], [s, c]]))
        angles = np.arctan2(edges[1], edges[0])
        return wrap_angle(float(np.angle(np.exp(4j * angles).sum())) / 4, math.pi / 2)

    def covariance_at(self, robot: ArrayLike) -> FloatArray:
        """Covariance `(N, 2, 2)` m² of the map's error at `(N, 2)` metres, without a detection's own noise."""
        _, by_xy, by_numbers = derivatives(self.lens, self.projection, self._on_plane(robot))
        moved = np.linalg.solve(by_xy, by_numbers)
        return np.asarray(moved @ self.covariance @ moved.transpose(0, 2, 1), float)

    def std_mm_at(self, robot: ArrayLike) -> FloatArray:
        """One standard deviation at `(N, 2)` metres, both directions together: `(N,)` millimetres."""
        return np.asarray(np.sqrt(np.trace(self.covariance_at(robot), axis1=1, axis2=2)) * 1000, float)

    @property
    def std_mm(self) -> float:
        """Root mean square of one standard deviation over the area, millimetres."""
        return float(np.sqrt((self.std_mm_at(lattice(self.area, 9, 9)) ** 2).mean()))

    def summary(self) -> dict[str, Any]:
        """What a person wants to know first, ready for JSON."""
        r = self.residuals
        return {
            "height_m": self.height_m,
            "heights_m": list(self.heights_m),
            "height_aware": self.height_aware,
            "lens_origin": self.lens_origin,
            "points": int(r.kept.sum()),
            "dropped": int((~r.kept).sum()),
            "rms_mm": r.rms_mm,
            "max_mm": r.max_mm,
            "leave_one_out_mm": r.leave_one_out_mm,
            "leave_one_out_max_mm": r.leave_one_out_max_mm,
            "std_mm": self.std_mm,
        }

    def to_yaml(self) -> dict[str, Any]:
        """Give the content of a file in plain YAML types."""
        return {
            "made_on": self.made_on,
            "frame": "robot base: x forward, y left, z up from the table",
            "units": "pixels (u, v) with centres at integers -> metres",
            "camera": self.camera.to_yaml(),
            **self.summary(),
            "area_m": {"x": [self.area.x_min, self.area.x_max], "y": [self.area.y_min, self.area.y_max]},
            "lens": {"matrix": self.lens.matrix, "distortion": self.lens.distortion},
            "projection" if self.height_aware else "homography": self.projection,
            "pictures": list(self.pictures),
            "residuals": self.residuals.to_yaml(),
            "covariance": self.covariance,
        }

    @classmethod
    def from_yaml(cls, content: Mapping[str, Any]) -> Self:
        """The inverse of `to_yaml`."""
        camera, lens = CameraIdentity.from_yaml(content["camera"]), content["lens"]
        origin = content["lens_origin"]
        if origin not in ("calibrated", "estimated", "none"):
            raise ValueError(f"lens_origin {origin}")
        matrix = np.array(lens["matrix"], float).reshape(3, 3)
        distortion = np.array(lens["distortion"], float).reshape(-1)
        name, columns = ("projection", 4) if "projection" in content else ("homography", 3)
        projection = np.array(content[name], float).reshape(3, columns)
        numbers = 4 + len(distortion) + projection.size
        return cls(
            camera=camera,
            lens=Intrinsics(*camera.size, matrix, distortion),
            lens_origin=origin,
            projection=projection,
            height_m=float(content["height_m"]),
            heights_m=tuple(float(height) for height in content["heights_m"]),
            area=Rectangle(*map(float, content["area_m"]["x"]), *map(float, content["area_m"]["y"])),
            covariance=np.array(content["covariance"], float).reshape(numbers, numbers),
            residuals=Residuals.from_yaml(content["residuals"]),
            pictures=tuple(str(name) for name in content["pictures"]),
            made_on=str(content["made_on"]),
        )

    def _on_plane(self, robot: ArrayLike) -> FloatArray:
        """`(N, 2)` -> `(N, 3)` metres."""
        robot = np.asarray(robot, float).reshape(-1, 2)
        return np.column_stack([robot, np.full(len(robot), self.height_m)])


def compare_maps(a: ImageToRobot, b: ImageToRobot, area: Rectangle | None = None) -> MapComparison:
    """Compare two maps of one camera, whatever the size of their pictures, over an area, by default what both span.

    At the height of `a`, or, where only `a` can be carried to another height, of `b`. Raises `CalibrationError` for
    pictures of different shapes, maps good at different heights, or areas that do not meet.
    """
    height = a.height_m if b.height_aware or not a.height_aware else b.height_m
    a, b = a.at_height(height), b.at_height(height).for_size(a.camera.size)
    area = area or shared_area(a.area, b.area)
    points = lattice(area, *_COMPARED)
    return MapComparison(area, height, points, (b.to_robot(a.to_pixels(points)) - points) * 1000)


_LIMIT_M = 0.002
_STDS = 4.0
_MIN_TURN_RAD = 0.15
_STEP_M = 0.01
_ROUNDS = 2
"""The residuals are nearly straight in the offset."""


def check_marker_offset(
    fit: Callable[[FloatArray], ImageToRobot], T_base_hand: FloatArray, marker_in_hand: FloatArray
) -> None:
    """Raise `CalibrationError` when the marker is clearly elsewhere in the hand than `marker_in_hand` `(3,)` metres.

    `fit` makes a map from where the marker was, `(N, 3)` metres in the base frame; `T_base_hand` `(N, 4, 4)`. Nothing
    can be told, and nothing is, when the hand was turned the same way at all points.
    """
    turned = np.arctan2(T_base_hand[:, 1, 0], T_base_hand[:, 0, 0])
    if np.std(turned) < _MIN_TURN_RAD:
        return

    shift, std = np.zeros(2), np.zeros(2)
    for _ in range(_ROUNDS):
        steps = [shift, *(shift + step for step in _STEP_M * np.eye(2))]
        fits = [fit(_each(T_base_hand, marker_in_hand + np.append(step, 0.0))).residuals for step in steps]
        used = np.logical_and.reduce([residuals.kept for residuals in fits])
        here, *beside = ((residuals.error_mm[used] / 1000).ravel() for residuals in fits)
        slopes = np.stack([there - here for there in beside], axis=1) / _STEP_M
        shift = shift - np.linalg.lstsq(slopes, here, rcond=None)[0]
        std = np.sqrt(np.diag(np.linalg.inv(slopes.T @ slopes)) * (here**2).mean())
    off = float(np.linalg.norm(shift))
    if off > max(_LIMIT_M, _STDS * float(np.linalg.norm(std))):
        x, y, z = marker_in_hand + np.append(shift, 0.0)
        raise CalibrationError(
            f"the marker is {1000 * off:.0f} mm from where the hand is said to hold it: as the hand turned, it moved "
            f"as if it were at x {x:.3f}, y {y:.3f} m; measure it, and give --marker-in-hand {x:.3f} {y:.3f} {z:.3f}"
        )


def _each(transforms: FloatArray, point: FloatArray) -> FloatArray:
    """One point `(3,)` through each of `(N, 4, 4)` transforms: `(N, 3)`."""
    return np.asarray(transforms[:, :3, :3] @ point + transforms[:, :3, 3])
