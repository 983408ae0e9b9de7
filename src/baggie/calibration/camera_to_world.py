"""Where a camera that stands still is in the world, from a printed target of known size that lies there.

The world is the target's own, turned so that z points up, out of the paper: its origin is the target's, x runs right
along the print, y up it. Of many pictures the corners are averaged, one by one, before the fit.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from baggie.calibration.files import CameraCalibrated, CameraIdentity
from baggie.calibration.pose import (
    MeasuredDepth,
    PoseFit,
    UncertainTransform,
    both_planar_poses,
    fit_pose,
    odds,
    pose_from_yaml,
    residuals_px,
    rigid_from_yaml,
    uncertainty_to_yaml,
)
from baggie.errors import CalibrationError
from baggie.geometry import FloatArray, difference, invert_transform
from baggie.types import Intrinsics
from baggie.vision.corners import FLAT, Sag
from baggie.vision.targets import MIN_CORNERS, ArucoMarker, Chessboard, Target, TargetDetection

T_WORLD_TARGET: FloatArray = np.diag([1.0, -1.0, -1.0, 1.0])
"""`(4, 4)`: the target's frame, z into the paper, in a world with z up and the same origin and x."""

_MOVED_PX = 1.0
_MAX_RMS_PX = 1.5
_MIN_ANGLE_DEG = 15.0
_EXACT_PX = 1e-9
_MIN_ODDS = 99.0
_MAX_SCALE_OFF = 0.015
_MAX_STD_MM, _MAX_STD_DEG = 5.0, 0.5
"""Beyond, a person is told; a bag is found to a few millimetres."""


@dataclass(frozen=True)
class Frame:
    """One picture, against the pose fitted to all of them."""

    name: str
    corners: int
    moved_px: float
    """Median distance of its corners from where they are in most frames."""
    rms_px: float
    """Of its corners' distances from where the pose says they are."""
    used: bool


@dataclass(frozen=True)
class CameraToWorld(CameraCalibrated):
    """The pose of a camera in the world, and what speaks for it."""

    KIND = "camera-to-world"

    pose: UncertainTransform
    """`T_world_camera`, metres; OpenCV's camera axes."""
    T_world_target: FloatArray
    """`(4, 4)`, taken as exact: it is what makes this the world."""
    target: str
    """As `parse_target` reads it."""
    frames: tuple[Frame, ...]
    corners: int
    """Averaged over the frames used, and in agreement with the pose."""
    rms_px: float
    flipped_ratio: float
    """How many times worse the mirrored pose of a flat target explains the corners; 1 means no way to tell."""
    depth_ratio: float | None
    """Depth measured over the target, over what the pose says; None without depth images."""
    warnings: tuple[str, ...]
    sag: Sag = FLAT
    """How the target was taken to be bent."""

    def summary(self) -> dict[str, Any]:
        """What a person or a script wants to know, ready for JSON."""
        return {
            "T_world_camera": self.pose.transform.tolist(),
            "uncertainty": self.pose.summary(),
            "target": self.target,
            "sag": asdict(self.sag),
            "rms_px": self.rms_px,
            "corners": self.corners,
            "flipped_ratio": self.flipped_ratio,
            "depth_ratio": self.depth_ratio,
            "pictures": [asdict(frame) for frame in self.frames],
            "warnings": list(self.warnings),
        }

    def to_yaml(self) -> dict[str, Any]:
        """Give the content of a file in plain YAML types."""
        return {
            "camera": self.camera.to_yaml(),
            "frames": "world: z up, out of the paper; camera: x right, y down, z ahead",
            "units": "metres, radians, pixels",
            **self.summary(),
            "T_world_target": self.T_world_target,
            "uncertainty": uncertainty_to_yaml(self.pose),
        }

    @classmethod
    def from_yaml(cls, content: Mapping[str, Any]) -> Self:
        """The inverse of `to_yaml`."""
        ratio = content["depth_ratio"]
        return cls(
            CameraIdentity.from_yaml(content["camera"]),
            pose_from_yaml(content, "T_world_camera"),
            rigid_from_yaml(content, "T_world_target"),
            str(content["target"]),
            tuple(Frame(**frame) for frame in content["pictures"]),
            int(content["corners"]),
            float(content["rms_px"]),
            float(content["flipped_ratio"]),
            None if ratio is None else float(ratio),
            tuple(map(str, content["warnings"])),
            Sag.from_yaml(content.get("sag")) or FLAT,
        )


def fit_camera_to_world(
    frames: Sequence[TargetDetection],
    target: Target,
    camera: CameraIdentity,
    intrinsics: Intrinsics,
    intrinsics_covariance: FloatArray | None = None,
    *,
    T_world_target: FloatArray = T_WORLD_TARGET,
    depths: Sequence[NDArray[np.float32]] = (),
    names: Sequence[str] = (),
) -> CameraToWorld:
    """Fit `T_world_camera` to a target seen in one or more pictures of a camera that stands still.

    Of a board that sags the world is the plane through its outermost corners.

    Corners are averaged over the frames before the fit: what is wrong in all of them alike then shows in the
    residuals, and so in the uncertainty. `intrinsics_covariance` `(4 + D, 4 + D)` is that of fx, fy, cx, cy and the
    distortion. `depths` are images `(H, W)` of the same camera, metres along its optical axis, 0 where unknown; they
    settle which of a flat target's two poses is the true one, and whether it was printed at its stated size. `names`
    are the pictures'; without, they are counted from 0.

    Raises `CalibrationError` when the pose cannot be trusted: see each message for what to do.
    """
    CameraIdentity(camera.name, intrinsics.width, intrinsics.height).check(camera, "the lens calibration")
    _check_pictures(frames, camera, depths)
    names = names or [str(number) for number in range(len(frames))]
    still = average(frames, 4 if isinstance(target, ArucoMarker) else MIN_CORNERS)
    first = fit_pose(still.points, still.pixels, intrinsics)
    corners = still.points[first.inliers]
    poses = both_planar_poses(corners, still.pixels[first.inliers], intrinsics)
    (pose, error), (flipped, flipped_error) = poses[0], poses[-1]
    _check_view(pose, corners)
    measured = MeasuredDepth.over(corners, pose, intrinsics, depths) if depths else None
    fit = fit_pose(still.points, still.pixels, intrinsics, intrinsics_covariance, start=pose)
    if fit.rms_px > _MAX_RMS_PX:
        raise CalibrationError(
            f"expected corners within {_MAX_RMS_PX} px (RMS) of where the pose says they are, got {fit.rms_px:.1f} px; "
            f"check that the target is flat and is {target.spec}, and that the lens calibration is this camera's"
        )
    if odds(error, flipped_error, len(corners)) < _MIN_ODDS and not fit.pose.holds(flipped):
        pose = _by_depth(measured, poses)
        fit = fit_pose(still.points, still.pixels, intrinsics, intrinsics_covariance, start=pose)
    depth_ratio = measured.ratio(fit.pose.transform) if measured else None
    pose_in_world = (
        UncertainTransform(np.asarray(T_world_target, float), np.zeros((6, 6))) @ fit.pose.inverse()
    )
    judged = tuple(_judge(names, frames, still, fit.pose.transform, intrinsics))
    return CameraToWorld(
        camera,
        pose_in_world,
        np.asarray(T_world_target, float),
        target.spec,
        judged,
        int(fit.inliers.sum()),
        fit.rms_px,
        max(flipped_error, _EXACT_PX) / max(error, _EXACT_PX),
        depth_ratio,
        tuple(_warnings(target, judged, fit, pose_in_world, depth_ratio)),
        target.sag,
    )


def _check_pictures(
    frames: Sequence[TargetDetection], camera: CameraIdentity, depths: Sequence[NDArray[np.float32]]
) -> None:
    if not frames:
        raise CalibrationError(
            "expected at least one picture with the target in it, got none; show it to the camera"
        )
    wrong = {(depth.shape[1], depth.shape[0]) for depth in depths} - {camera.size}
    if wrong:
        raise CalibrationError(
            f"expected depth images of {camera.width} x {camera.height} pixels, aligned with colour, got "
            f"{' and '.join(f'{w} x {h}' for w, h in wrong)}; have the camera's driver align them"
        )


def _check_view(pose: FloatArray, corners: FloatArray) -> None:
    position = invert_transform(pose)[:3, 3]
    if position[2] > 0:
        raise CalibrationError(
            "expected to see the printed side, but the corners are as seen from behind the paper; switch the mirroring "
            "of the camera or its driver off"
        )
    sight = corners.mean(axis=0) - position
    angle = np.degrees(np.arcsin(abs(position[2]) / np.linalg.norm(sight)))
    if angle < _MIN_ANGLE_DEG:
        raise CalibrationError(
            f"expected to see the target at {_MIN_ANGLE_DEG:.0f} degrees from its paper or more, got {angle:.0f}; "
            "tilt it towards the camera, or lay it where the camera sees it from above"
        )


def _by_depth(measured: MeasuredDepth | None, poses: Sequence[tuple[FloatArray, float]]) -> FloatArray:
    (pose, error), (flipped, flipped_error) = poses
    chosen = measured.choose(pose, flipped) if measured else None
    if chosen is None:
        apart = np.degrees(difference(pose, flipped)[1])
        raise CalibrationError(
            f"expected one pose to explain the corners, but two do, {apart:.0f} degrees apart, with errors of "
            f"{error:.2f} and {flipped_error:.2f} px; use a larger target, nearer or seen more from the side, "
            "or a camera with depth"
        )
    return chosen


def _judge(
    names: Sequence[str],
    frames: Sequence[TargetDetection],
    still: StillFrames,
    pose: FloatArray,
    intrinsics: Intrinsics,
) -> Iterator[Frame]:
    for name, seen, moved, used in zip(
        names, frames, still.moved_px.tolist(), still.used.tolist(), strict=True
    ):
        error = residuals_px(pose, seen.points, seen.pixels, intrinsics)
        rms = float(np.sqrt((error**2).sum(axis=1).mean()))
        yield Frame(name, len(seen.ids), moved, rms, used)


def _warnings(
    target: Target,
    frames: Sequence[Frame],
    fit: PoseFit,
    pose: UncertainTransform,
    depth_ratio: float | None,
) -> Iterator[str]:
    moved = [frame for frame in frames if not frame.used]
    if moved:
        yield (
            f"pictures {', '.join(frame.name for frame in moved)} were left out: their corners moved, by up to "
            f"{max(frame.moved_px for frame in moved):.1f} px; fix the camera and the target in place"
        )
    wrong = int((~fit.inliers).sum())
    if wrong:
        yield f"{wrong} of {len(fit.inliers)} corners are not where the pose says and were left out; look for glare"
    if isinstance(target, Chessboard) and (target.columns + target.rows) % 2 == 0:
        yield (
            "this chessboard looks the same turned by half a turn, so the world's origin may be at the other end; "
            "print one with an odd sum of columns and rows, or a ChArUco board"
        )
    if depth_ratio is not None and abs(depth_ratio - 1) > _MAX_SCALE_OFF:
        yield (
            f"the target seems to be printed at {100 * depth_ratio:.0f}% of its stated size, as depth has it; "
            "measure it and state what it measures"
        )
    if pose.std_mm > _MAX_STD_MM or pose.std_deg > _MAX_STD_DEG:
        yield (
            f"the camera's pose is known to {pose.std_mm:.1f} mm and {pose.std_deg:.2f} degrees only "
            "(one standard deviation); use a larger target, or one nearer"
        )


@dataclass(frozen=True)
class StillFrames:
    """Where the corners are in most frames."""

    points: FloatArray
    """`(N, 3)` metres, target frame: those seen in at least half of the frames used."""
    pixels: FloatArray
    """`(N, 2)`, the medians over these frames."""
    moved_px: FloatArray
    """`(F,)`: the median distance of each frame's corners from there."""
    used: NDArray[np.bool_]
    """`(F,)`: frames in which camera and target stood where they stand in most; the others are in no median."""


@dataclass(frozen=True)
class _Corner:
    point: FloatArray
    pixel: FloatArray
    seen: int
    """In how many frames."""


def average(frames: Sequence[TargetDetection], needed: int) -> StillFrames:
    """Average frames, leaving out those in which the corners moved by more than a pixel.

    Raises `CalibrationError` when half of them or more moved, or fewer than `needed` corners, or only corners on one
    line, are seen in most.
    """
    used = np.ones(len(frames), np.bool_)
    for _ in range(3):  # frames that moved have a part in the first medians only
        middle = _medians([frame for frame, kept in zip(frames, used, strict=True) if kept])
        moved = np.array([_moved(frame, middle) for frame in frames])
        used = moved <= _MOVED_PX
        if 2 * used.sum() <= len(frames):
            raise CalibrationError(
                f"expected the camera and the target to stand still, but the corners moved in {(~used).sum()} of "
                f"{len(frames)} frames, by up to {moved.max():.1f} px; fix both in place and take the pictures again"
            )
    least = used.sum() / 2
    kept = [corner for corner in middle.values() if corner.seen >= least]
    points = np.array([corner.point for corner in kept]).reshape(-1, 3)
    if len(kept) < needed:
        raise CalibrationError(
            f"expected at least {needed} corners that most frames show, got {len(kept)}; show more of it, nearer"
        )
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if spread[1] < 0.05 * spread[0]:
        raise CalibrationError(
            f"expected corners spread over the target, got {len(kept)} on one line; show more of its other side"
        )
    return StillFrames(points, np.array([corner.pixel for corner in kept]), moved, used)


def _medians(frames: Sequence[TargetDetection]) -> dict[int, _Corner]:
    ids = np.concatenate([frame.ids for frame in frames])
    points = np.concatenate([frame.points for frame in frames])
    pixels = np.concatenate([frame.pixels for frame in frames])
    corners = {}
    for number in np.unique(ids):
        here = ids == number
        corners[int(number)] = _Corner(points[here][0], np.median(pixels[here], axis=0), int(here.sum()))
    return corners


def _moved(frame: TargetDetection, middle: dict[int, _Corner]) -> float:
    """Pixels; infinite where a frame shows none of the others' corners."""
    shared = [
        np.linalg.norm(pixel - middle[int(number)].pixel)
        for number, pixel in zip(frame.ids, frame.pixels, strict=True)
        if int(number) in middle
    ]
    return float(np.median(shared)) if shared else float("inf")
