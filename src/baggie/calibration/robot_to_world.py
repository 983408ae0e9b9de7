"""The pose of the world for a robot, from points of it that the arm's tool was led or driven to; and so the camera's.

Either its origin, a point on its x axis and one on its y axis, or any points whose place in the world is known. The
published system builds its matrix from the three points' differences as they are, so that its third column is no
rotation's; here it is a proper one, right-handed. Composed with a camera's pose in the world it gives the camera's pose
for the robot.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baggie.calibration.camera_to_world import CameraToWorld
from baggie.calibration.files import Calibration, CameraCalibrated, CameraIdentity
from baggie.calibration.point_registration import (
    axes_covariance,
    centroid_size,
    distances,
    fit_rigid,
    from_axes,
    in_line,
    inliers,
    rigid_covariance,
)
from baggie.calibration.pose import UncertainTransform, pose_from_yaml, squared_radius, uncertainty_to_yaml
from baggie.errors import CalibrationError
from baggie.geometry import FloatArray, difference, transform_points

TOUCH_STD_M = 0.0005
"""Per axis: how far off a careful touch with a pointed tool is."""

_MIN_LENGTH_M, _SHORT_M = 0.05, 0.15
_MAX_OFF_DEG, _WARN_OFF_DEG = 20.0, 2.0
_MAX_SCALE_OFF = 0.005
_MAX_SCATTER_M = 0.02
_MIRRORED_M = 0.002


@dataclass(frozen=True)
class Touch:
    """One point the tool was at."""

    name: str
    base_m: tuple[float, float, float]
    """Robot base frame."""
    world_m: tuple[float, float, float]
    """Where it should be in the world. Of a point somewhere on an axis: where that axis has its nearest."""
    residual_mm: float
    """From there to where the result says it was."""
    leave_one_out_mm: float | None
    """The same for a fit to the others; None where they are too few to fit."""
    used: bool
    """False where it disagreed with the others, and was left out."""


@dataclass(frozen=True)
class RobotToWorld(Calibration):
    """The pose of a robot's base in the world, and what speaks for it."""

    KIND = "robot-to-world"

    pose: UncertainTransform
    """`T_world_base`, metres."""
    touches: tuple[Touch, ...]
    perpendicular_off_deg: float | None
    """How far from 90 degrees the two axes were touched; None where points were fitted."""
    scale: float | None
    """Distances between touched points over the stated ones; None where axes were touched."""
    warnings: tuple[str, ...]

    def summary(self) -> dict[str, Any]:
        """What a person or a script wants to know, ready for JSON."""
        return {
            "T_world_base": self.pose.transform.tolist(),
            "uncertainty": self.pose.summary(),
            "perpendicular_off_deg": self.perpendicular_off_deg,
            "scale": self.scale,
            "touches": [asdict(touch) for touch in self.touches],
            "warnings": list(self.warnings),
        }

    def to_yaml(self) -> dict[str, Any]:
        """Give the content of a file in plain YAML types."""
        return {
            "frames": "world: as touched; base: x forward, y left, z up",
            "units": "metres, radians",
            **self.summary(),
            "uncertainty": uncertainty_to_yaml(self.pose),
        }

    @classmethod
    def from_yaml(cls, content: Mapping[str, Any]) -> Self:
        """The inverse of `to_yaml`."""
        return cls(
            pose_from_yaml(content, "T_world_base"),
            tuple(
                Touch(**{**touch, "base_m": tuple(touch["base_m"]), "world_m": tuple(touch["world_m"])})
                for touch in content["touches"]
            ),
            content["perpendicular_off_deg"],
            content["scale"],
            tuple(map(str, content["warnings"])),
        )


@dataclass(frozen=True)
class CameraToRobot(CameraCalibrated):
    """The pose of a camera that stands still beside a robot."""

    KIND = "camera-to-robot"

    pose: UncertainTransform
    """`T_base_camera`, metres; OpenCV's camera axes."""
    source: str
    """How it was found, in words."""

    def summary(self) -> dict[str, Any]:
        """What a person or a script wants to know, ready for JSON."""
        return {
            "T_base_camera": self.pose.transform.tolist(),
            "uncertainty": self.pose.summary(),
            "source": self.source,
        }

    def to_yaml(self) -> dict[str, Any]:
        """Give the content of a file in plain YAML types."""
        return {
            "camera": self.camera.to_yaml(),
            "frames": "base: x forward, y left, z up; camera: x right, y down, z ahead",
            "units": "metres, radians",
            **self.summary(),
            "uncertainty": uncertainty_to_yaml(self.pose),
        }

    @classmethod
    def from_yaml(cls, content: Mapping[str, Any]) -> Self:
        """The inverse of `to_yaml`."""
        camera = CameraIdentity.from_yaml(content["camera"])
        return cls(camera, pose_from_yaml(content, "T_base_camera"), str(content["source"]))


@dataclass(frozen=True)
class CalibrationComparison:
    """How far apart two calibrations of the same camera and robot are."""

    mm: float
    """Between the two positions of the camera."""
    deg: float
    """Between the two orientations."""
    agree: bool
    """Whether that is within what both state, with 95% probability, their errors independent."""


def compose(camera_to_world: CameraToWorld, robot_to_world: RobotToWorld) -> CameraToRobot:
    """`T_base_camera` = inverse(`T_world_base`) @ `T_world_camera`, the uncertainty of both in it.

    Both must have been made in the same world: the arm touched the target that the camera saw, in the same place.
    """
    pose = robot_to_world.pose.inverse() @ camera_to_world.pose
    return CameraToRobot(camera_to_world.camera, pose, "camera-to-world and robot-to-world composed")


def compare_calibrations(a: CameraToRobot, b: CameraToRobot) -> CalibrationComparison:
    """Compare two calibrations. Raises `CalibrationError` when they are of different cameras or resolutions."""
    a.camera.check(b.camera, "the first calibration")
    metres, radians = difference(a.pose.transform, b.pose.transform)
    together = UncertainTransform(a.pose.transform, a.pose.covariance + b.pose.covariance)
    return CalibrationComparison(metres * 1000, float(np.degrees(radians)), together.holds(b.pose.transform))


def fit_from_axes(
    origin: ArrayLike, on_x: ArrayLike, on_y: ArrayLike, touch_std_m: float = TOUCH_STD_M
) -> RobotToWorld:
    """`T_world_base` from the world's origin, a point on its x and one on its y axis: `(3,)` metres, base frame.

    x runs from the origin through `on_x`; y is at right angles to it in the plane of the three points, on the side of
    `on_y`; z = x × y. Each touch is off by `touch_std_m` a coordinate.

    Raises `CalibrationError` for points too close, in line, far from a right angle, or touched the wrong way round.
    """
    touched = _finite(np.array([origin, on_x, on_y], float).reshape(3, 3))
    x, y = touched[1] - touched[0], touched[2] - touched[0]
    lengths = np.linalg.norm([x, y], axis=1)
    if lengths.min() < _MIN_LENGTH_M:
        raise CalibrationError(
            f"expected points on the axes {_MIN_LENGTH_M * 100:.0f} cm from the origin or more, got "
            f"{lengths[0] * 100:.1f} cm on x and {lengths[1] * 100:.1f} cm on y; touch further out, 30 cm if you can"
        )
    off = float(np.degrees(np.arccos(np.clip(x @ y / lengths.prod(), -1, 1)))) - 90
    if abs(off) > _MAX_OFF_DEG:
        raise CalibrationError(
            f"expected the touched axes at right angles, got {90 + off:.0f} degrees; touch the origin, a point on x "
            "and one on y, in this order"
        )
    T_base_world = from_axes(touched)
    _check_upright(T_base_world[:3, :3])
    pose = UncertainTransform(T_base_world, axes_covariance(touched, touch_std_m)).inverse()
    world = transform_points(pose.transform, touched)
    axes = np.array([[0.0, 0.0, 0.0], [world[1, 0], 0.0, 0.0], [0.0, world[2, 1], 0.0]])
    residuals = np.linalg.norm(world - axes, axis=1) * 1000
    return RobotToWorld(
        pose,
        tuple(
            Touch(name, _triple(base), _triple(at), float(residual), None, True)
            for name, base, at, residual in zip(
                ("origin", "on x", "on y"), touched, axes, residuals, strict=True
            )
        ),
        abs(off),
        None,
        tuple(_axes_warnings(lengths, off, touch_std_m)),
    )


def fit_from_points(world: ArrayLike, base: ArrayLike, touch_std_m: float = TOUCH_STD_M) -> RobotToWorld:
    """`T_world_base` from three or more points: `world` `(N, 3)` as stated and `base` `(N, 3)` as touched, metres.

    Least squares (Umeyama, "Least-Squares Estimation of Transformation Parameters Between Two Point Patterns", 1991,
    with no scale). Of five or more, those that disagree with the rest are left out. The uncertainty comes from how far
    the touches are off; of three points alone, from `touch_std_m`, a coordinate.

    Raises `CalibrationError` for too few points, points in line, points mirrored or mostly at odds.
    """
    world, base = (_finite(np.asarray(points, float).reshape(-1, 3)) for points in (world, base))
    _check_points(world, base)
    used = inliers(world, base)
    T_world_base = fit_rigid(world[used], base[used])
    _check_handed(world, base, T_world_base)
    _check_agreement(used, distances(T_world_base, world, base))
    _check_upright(T_world_base[:3, :3].T)
    residuals, count = distances(T_world_base, world[used], base[used]), int(used.sum())
    variance, spare = float((residuals**2).sum()) / (3 * count - 6), 3 * count - 6
    if count == 3:
        variance = max(variance, touch_std_m**2)
    else:
        # Known from few touches: as much wider as makes the 95% region of `holds` that of an F distribution.
        from scipy.special import fdtri  # noqa: PLC0415 -- who only reads a calibration does not wait for it

        variance *= 6 * fdtri(6, spare, 0.95) / squared_radius(0.95)
    covariance = rigid_covariance(T_world_base, base[used], np.sqrt(variance))
    pose = UncertainTransform(T_world_base, covariance)
    touches = tuple(_touches(world, base, used, T_world_base))
    scale = centroid_size(base[used]) / centroid_size(world[used])
    off = distances(fit_rigid(world[used], base[used] / scale), world[used], base[used] / scale)
    scatter = np.sqrt((off**2).sum() / (3 * count - 7))
    scale_std = max(float(scatter), touch_std_m) / centroid_size(world[used])
    return RobotToWorld(pose, touches, None, scale, tuple(_point_warnings(touches, scale, scale_std)))


def _finite(points: FloatArray) -> FloatArray:
    if not np.isfinite(points).all():
        raise CalibrationError(
            f"expected touched points as numbers in metres, got {points.tolist()}; touch them again"
        )
    return points


def _check_points(world: FloatArray, base: FloatArray) -> None:
    if len(world) != len(base) or len(world) < 3:
        raise CalibrationError(
            f"expected three or more points, each stated and touched, got {len(world)} and {len(base)}; touch more"
        )
    for points, which in ((world, "stated"), (base, "touched")):
        if in_line(points) or centroid_size(points) < _MIN_LENGTH_M:
            raise CalibrationError(
                f"expected points spread over the table, got {which} points nearly in line or within "
                f"{_MIN_LENGTH_M * 100:.0f} cm of one; touch others, 30 cm apart if you can"
            )


def _check_upright(R_base_world: FloatArray) -> None:
    if R_base_world[2, 2] < 0:
        raise CalibrationError(
            "expected the world's z to point up, but with these points it points down; x and y seem to be "
            "swapped, or one of them reversed"
        )


def _check_handed(world: FloatArray, base: FloatArray, T_world_base: FloatArray) -> None:
    mirrored = world * [1.0, 1.0, -1.0]
    agree = inliers(mirrored, base)
    as_stated = np.median(distances(T_world_base, world, base))
    in_mirror = np.median(distances(fit_rigid(mirrored[agree], base[agree]), mirrored, base))
    if in_mirror < as_stated / 3 and as_stated > _MIRRORED_M:
        raise CalibrationError(
            f"expected a right-handed world, but the points fit {as_stated / max(in_mirror, 1e-6):.0f} times better "
            "in a mirror; axes seem swapped or mirrored: check order and signs of the stated coordinates"
        )


def _check_agreement(used: NDArray[np.bool_], off_m: FloatArray) -> None:
    scatter = np.sqrt((off_m[used] ** 2).mean())
    if used.sum() < 0.6 * len(used) or scatter > _MAX_SCATTER_M:
        raise CalibrationError(
            f"expected most of {len(used)} touches to agree within {_MAX_SCATTER_M * 100:.0f} cm, {used.sum()} are "
            f"within {scatter * 100:.1f} cm (RMS); check that each stated point is in metres and beside its own touch"
        )


def _touches(
    world: FloatArray, base: FloatArray, used: NDArray[np.bool_], T_world_base: FloatArray
) -> Iterator[Touch]:
    off = distances(T_world_base, world, base) * 1000
    for number in range(len(world)):
        others = used & (np.arange(len(world)) != number)
        left_out = None
        if others.sum() >= 3 and not in_line(base[others]):
            fit = fit_rigid(world[others], base[others])
            left_out = float(distances(fit, world[number : number + 1], base[number : number + 1])[0]) * 1000
        yield Touch(
            str(number),
            _triple(base[number]),
            _triple(world[number]),
            float(off[number]),
            left_out,
            bool(used[number]),
        )


def _triple(point: FloatArray) -> tuple[float, float, float]:
    x, y, z = point.tolist()
    return x, y, z


def _axes_warnings(lengths: FloatArray, off_deg: float, touch_std_m: float) -> Iterator[str]:
    if abs(off_deg) > _WARN_OFF_DEG:
        yield (
            f"the axes were touched {abs(off_deg):.1f} degrees off a right angle; y was turned to be at right angles "
            "to x; touch again if the print's own axes are square"
        )
    for axis, length in zip("xy", lengths, strict=True):
        if length < _SHORT_M:
            angle = np.degrees(np.sqrt(2) * touch_std_m / length)
            yield (
                f"the point on {axis} is {length * 100:.0f} cm from the origin only, so that touches off by "
                f"{touch_std_m * 1000:.1f} mm turn the world by {angle:.2f} degrees; touch a point further out"
            )


def _point_warnings(touches: Sequence[Touch], scale: float, scale_std: float) -> Iterator[str]:
    for touch in touches:
        if not touch.used:
            yield (
                f"touch {touch.name} (counted from 0) is {touch.residual_mm:.1f} mm from where the others say and was "
                "left out; touch it again"
            )
    if abs(scale - 1) > max(_MAX_SCALE_OFF, 3 * scale_std):
        how = "nearer" if scale < 1 else "further apart"
        yield (
            f"the touched points are {100 * abs(scale - 1):.1f}% {how} than stated; was the board printed at "
            f"{100 * scale:.0f}%?"
        )
