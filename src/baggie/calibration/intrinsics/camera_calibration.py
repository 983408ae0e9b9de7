"""A camera's calibration: its matrix and lens, how sure they are, and what they were fitted to.

Ours in its file and as a picture of where it saw corners and how far off they are; and camera matrices as others write
them: ROS camera_info, RealSense JSON, OpenCV's FileStorage, mrcal's cameramodel.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Self

import cv2
import numpy as np

from baggie.calibration.files import CameraCalibrated, CameraIdentity
from baggie.calibration.intrinsics.lens import PARAMETERS
from baggie.errors import CalibrationError, DataError
from baggie.files import parse_yaml, read_text
from baggie.geometry import FloatArray
from baggie.pictures import write_figure
from baggie.types import Intrinsics
from baggie.vision.corners import Sag
from baggie.vision.targets import Target, with_sag

_SEEN_STDS, _SEEN_M = 3.0, 0.5e-4
"""A smaller sag is not spoken of, though it is counted in."""


def _none() -> FloatArray:
    return np.zeros((0, 2))


@dataclass(frozen=True)
class ViewError:
    """How well one picture is explained."""

    name: str
    rms_px: float
    corners: int
    """How many of its corners took part."""
    pixels: FloatArray = field(default_factory=_none, compare=False)
    """`(N, 2)` (u, v): where they were seen. Not kept in a file."""
    residuals_px: FloatArray = field(default_factory=_none, compare=False)
    """`(N, 2)`: where they should appear, less where they were seen. Not kept in a file."""


@dataclass(frozen=True)
class CameraCalibration(CameraCalibrated):
    """The matrix and the lens of one camera at one resolution."""

    KIND = "intrinsics"

    intrinsics: Intrinsics
    covariance: FloatArray | None
    """`(9, 9)` of fx, fy, cx, cy, k1, k2, p1, p2, k3; zero where a term was held; None from the factory."""
    terms: tuple[str, ...]
    """The distortion terms that were fitted; the others are zero."""
    rms_px: float | None
    """Of the corners it was fitted to; None from the factory."""
    held_out_rms_px: float | None
    """Of corners in views it was not fitted to, by cross-validation: what to expect of a new picture."""
    views: tuple[ViewError, ...]
    dropped: tuple[tuple[str, str], ...]
    """Pictures left out, each with the reason why."""
    warnings: tuple[str, ...]
    target: str
    """The board, as `parse_target` reads it; empty from the factory."""
    source: str
    """What it was made from."""
    sag: Sag | None = None
    """How the board is bent; None from the factory, and in files from before it was fitted."""
    sag_std: Sag | None = None
    """One standard deviation of it."""
    corner_noise_px: float | None = None
    """What of `rms_px` goes from corner to corner: how exactly they were found. None where that is not known."""

    def shaped(self, target: Target) -> Target:
        """A target as it is bent, where it is the board that this camera was calibrated with; else as it is."""
        return with_sag(target, self.sag) if self.sag and target.spec == self.target else target

    @property
    def board_shape(self) -> str | None:
        """How the board is bent, in words; None where nobody knows."""
        if self.sag is None or self.sag_std is None:
            return None
        found, std = (np.array([sag.along_m, sag.across_m]) for sag in (self.sag, self.sag_std))
        if (np.abs(found) < np.maximum(_SEEN_STDS * std, _SEEN_M)).all():
            return f"the board is flat (to {1000 * max(_SEEN_M, 2 * std.max()):.1f} mm)"
        return f"the board sags by {self.sag}"

    @property
    def standard_deviations(self) -> dict[str, float]:
        """Standard deviations by parameter: `fx_px`, `fy_px`, `cx_px`, `cy_px`, `k1`, ...; empty from the factory."""
        if self.covariance is None:
            return {}
        names = [f"{name}_px" if name[0] in "fc" else name for name in PARAMETERS]
        return dict(zip(names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    def summary(self) -> dict[str, Any]:
        """What a person or a script wants to know, ready for JSON."""
        return {
            "camera": self.camera.to_yaml(),
            "camera_matrix": self.intrinsics.matrix.tolist(),
            "distortion": self.intrinsics.distortion.tolist(),
            "terms": list(self.terms),
            "rms_px": self.rms_px,
            "held_out_rms_px": self.held_out_rms_px,
            "corner_noise_px": self.corner_noise_px,
            "standard_deviations": self.standard_deviations,
            "board_shape": self.board_shape,
            "views": [{"view": v.name, "rms_px": v.rms_px, "corners": v.corners} for v in self.views],
            "dropped": [{"view": name, "why": why} for name, why in self.dropped],
            "warnings": list(self.warnings),
        }

    def to_yaml(self) -> dict[str, Any]:
        """Give the content of a file in plain YAML types."""
        return {
            "units": "pixels (u, v) with centres at integers; distortion in OpenCV's order",
            **self.summary(),
            "covariance_of": list(PARAMETERS) if self.covariance is not None else None,
            "covariance": self.covariance,
            "board": self.target,
            "sag": None if self.sag is None else asdict(self.sag),
            "sag_std": None if self.sag_std is None else asdict(self.sag_std),
            "source": self.source,
        }

    @classmethod
    def from_yaml(cls, content: Mapping[str, Any]) -> Self:
        """The inverse of `to_yaml`."""
        camera = CameraIdentity.from_yaml(content["camera"])
        matrix = np.array(content["camera_matrix"], float).reshape(3, 3)
        distortion = np.array(content["distortion"], float).reshape(-1)
        covariance = content["covariance"]
        if covariance is not None:
            covariance = np.array(covariance, float).reshape(len(PARAMETERS), len(PARAMETERS))
        if not np.isfinite(matrix).all():
            raise ValueError("camera_matrix is not finite")
        return cls(
            camera=camera,
            intrinsics=Intrinsics(*camera.size, matrix, distortion),
            covariance=covariance,
            terms=tuple(map(str, content["terms"])),
            rms_px=_number(content["rms_px"]),
            held_out_rms_px=_number(content["held_out_rms_px"]),
            views=tuple(
                ViewError(str(v["view"]), float(v["rms_px"]), int(v["corners"])) for v in content["views"]
            ),
            dropped=tuple((str(d["view"]), str(d["why"])) for d in content["dropped"]),
            warnings=tuple(map(str, content["warnings"])),
            target=str(content["board"]),
            source=str(content["source"]),
            corner_noise_px=_number(content.get("corner_noise_px")),
            sag=Sag.from_yaml(content.get("sag")),
            sag_std=Sag.from_yaml(content.get("sag_std")),
        )


def import_intrinsics(path: Path, camera_name: str) -> CameraCalibration:
    """The manufacturer's or another program's calibration, without covariance or errors: nobody says how good it is.

    Reads ROS camera_info (YAML or JSON), RealSense (JSON) and OpenCV's FileStorage (YAML, XML or JSON).
    Raises `DataError` for anything else, `CalibrationError` for lens models that are not supported.
    """
    intrinsics = read_factory(path)
    camera = CameraIdentity(camera_name, intrinsics.width, intrinsics.height)
    warning = f"taken from {path.name} unchecked; how exact it is, is not known"
    return CameraCalibration(
        camera, intrinsics, None, (), None, None, (), (), (warning,), "", f"factory file {path.name}"
    )


_MODELS = frozenset({"plumb_bob", "rational_polynomial", "brown_conrady", "brown_conrady_k6", "none"})
"""Names of OpenCV's model. Others bend rays another way."""
_VARIANTS = frozenset({"inverse_brown_conrady", "modified_brown_conrady"})
"""The same where all coefficients are zero, as they often are."""
_LENGTHS = frozenset({0, 4, 5, 8, 12, 14})
"""Numbers of coefficients that OpenCV's model may have."""
_MATRIX = ("camera_matrix", "cameraMatrix", "K", "M1")
_DISTORTION = ("distortion_coefficients", "dist_coeffs", "distCoeffs", "D", "D1")
_MRCAL = (
    "LENSMODEL_PINHOLE",
    "LENSMODEL_OPENCV4",
    "LENSMODEL_OPENCV5",
    "LENSMODEL_OPENCV8",
    "LENSMODEL_OPENCV12",
)
"""mrcal's models that are OpenCV's: its coefficients in its order, pixel centres at whole numbers."""
_SQUARE = 1e-9
"""Of the focal length; entries of a camera matrix below it are 0 but for rounding."""
_SIZE = (("image_width", "width"), ("image_height", "height"))


def read_factory(path: Path) -> Intrinsics:
    """The camera matrix and distortion in a file. The coefficients are padded to five.

    Raises `DataError` where the file is none of the four kinds, `CalibrationError` where its lens model is not
    OpenCV's.
    """
    try:
        text = read_text(path)
    except (OSError, DataError) as error:
        raise DataError(
            f"expected a camera's calibration at {path}, got {error}; name the right file"
        ) from None
    try:
        if "opencv-matrix" in text:
            return _opencv(text)
        if "'lensmodel'" in text:
            return _mrcal(text)
        # JSON is YAML; `ros2 topic echo` ends every message with a line of ---.
        content = parse_yaml(text.removeprefix("---\n").split("\n---", 1)[0], path)
        if isinstance(content, dict):
            for reads in (_ros, _realsense):
                found = reads(content)
                if found is not None:
                    return found
    except (DataError, KeyError, TypeError, ValueError, SyntaxError, cv2.error, SystemError) as error:
        raise DataError(
            f"the camera calibration in {path} is damaged ({' '.join(str(error).split())}); export it again"
        ) from None
    raise DataError(
        f"expected a ROS camera_info, a RealSense JSON, an OpenCV FileStorage or a cameramodel of mrcal in {path}, got "
        "something else; "
        "export the camera's intrinsics as one of these"
    )


def _ros(content: Mapping[str, Any]) -> Intrinsics | None:
    """Read what `camera_calibration` saves, or as `ros2 topic echo` prints the message."""
    if "distortion_model" not in content:
        return None
    model = str(content["distortion_model"])
    if "camera_matrix" in content:
        size = content["image_width"], content["image_height"]
        return opencv_intrinsics(
            size, content["camera_matrix"]["data"], content["distortion_coefficients"]["data"], model
        )
    lower = {str(key).lower(): value for key, value in content.items()}
    return opencv_intrinsics((lower["width"], lower["height"]), lower["k"], lower["d"], model)


def _realsense(content: Mapping[str, Any]) -> Intrinsics | None:
    if not {"fx", "fy", "ppx", "ppy", "coeffs"} <= set(content):
        return None
    matrix = [content["fx"], 0, content["ppx"], 0, content["fy"], content["ppy"], 0, 0, 1]
    return opencv_intrinsics(
        (content["width"], content["height"]), matrix, content["coeffs"], str(content["model"])
    )


def _opencv(text: str) -> Intrinsics:
    """Under the names that OpenCV's own samples, and most programs after them, use."""
    storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)

    def first(names: tuple[str, ...]) -> cv2.FileNode:
        nodes = [node for node in map(storage.getNode, names) if not node.empty()]
        if not nodes:
            raise KeyError(names[0])
        return nodes[0]

    fisheye = storage.getNode("fisheye_model")
    model = "fisheye" if not fisheye.empty() and fisheye.real() else "plumb_bob"
    size = first(_SIZE[0]).real(), first(_SIZE[1]).real()
    return opencv_intrinsics(size, first(_MATRIX).mat(), first(_DISTORTION).mat(), model)


def _mrcal(text: str) -> Intrinsics:
    """A `.cameramodel`: a dict as Python writes it, with comments (mrcal.secretsauce.net)."""
    content = ast.literal_eval(text)
    name, (fx, fy, cx, cy, *distortion) = content["lensmodel"], content["intrinsics"]
    model = "plumb_bob" if name in _MRCAL else name
    return opencv_intrinsics(content["imagersize"], [fx, 0, cx, 0, fy, cy, 0, 0, 1], distortion, model)


def opencv_intrinsics(size: tuple[Any, Any], matrix: Any, distortion: Any, model: str) -> Intrinsics:
    """What a maker says of a camera: `(width, height)`, 9 numbers, coefficients in OpenCV's order, the lens model.

    Raises `CalibrationError` where the model is not OpenCV's, `ValueError` where numbers are impossible.
    """
    coefficients = np.array(distortion, float).ravel()
    _check_model(model, coefficients)
    if len(coefficients) not in _LENGTHS:
        raise ValueError(f"{len(coefficients)} distortion coefficients")
    padded = np.zeros(max(len(coefficients), 5))
    padded[: len(coefficients)] = coefficients
    camera_matrix = np.array(matrix, float).reshape(3, 3)
    width, height = (int(side) for side in size)
    if not (np.isfinite(camera_matrix).all() and np.isfinite(padded).all()):
        raise ValueError("numbers that are not finite")
    if min(width, height, camera_matrix[0, 0], camera_matrix[1, 1]) <= 0:
        raise ValueError("a picture size and focal lengths above 0 are needed")
    _check_matrix(camera_matrix, width, height)
    return Intrinsics(width, height, camera_matrix, padded)


def _check_matrix(matrix: FloatArray, width: int, height: int) -> None:
    """Raise `ValueError` unless it is [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] with the middle inside the picture."""
    spare = _SQUARE * matrix[0, 0]
    if np.abs(matrix[:2, 2]).max() < spare <= np.abs(matrix[2, :2]).max():
        raise ValueError("its camera matrix is transposed, as MATLAB writes it: write it row by row")
    if max(abs(matrix[1, 0]), *np.abs(matrix[2, :2]), abs(matrix[2, 2] - 1)) > spare:
        raise ValueError("its camera matrix is none: [fx, 0, cx], [0, fy, cy], [0, 0, 1] is expected")
    if abs(matrix[0, 1]) > spare:
        raise ValueError(f"its camera matrix has a skew of {matrix[0, 1]:g} px, which OpenCV's model has not")
    if not (0 < matrix[0, 2] < width and 0 < matrix[1, 2] < height):
        raise ValueError(
            f"its principal point ({matrix[0, 2]:g}, {matrix[1, 2]:g}) lies outside of {width} x {height} pixels"
        )


def _check_model(model: str, coefficients: FloatArray) -> None:
    name = model.lower().replace(" ", "_").replace("-", "_").split(".")[-1].removeprefix("rs2_distortion_")
    if name in _MODELS or (name in _VARIANTS and not coefficients.any()):
        return
    raise CalibrationError(
        f"expected the lens model plumb_bob, rational_polynomial or Brown-Conrady, got {model!r}, which is not "
        "supported; calibrate with pictures of a board, or export rectified intrinsics"
    )


def _number(value: Any) -> float | None:
    return None if value is None else float(value)


_ARROW = 0.03
"""Of the picture's width: how long a large residual (the 95th percentile) is about drawn."""


def draw_corner_errors(calibration: CameraCalibration, path: Path) -> None:
    """Save a picture of all corners, a colour for each view, with enlarged arrows to where they should appear.

    Arrows that point all ways are noise; arrows that agree with their neighbours are what the lens model misses.
    Raises `CalibrationError` for a calibration read from a file, which has no corners, and
    `WriteError`.
    """
    from matplotlib.figure import Figure  # noqa: PLC0415 -- worker processes start without it

    views = [view for view in calibration.views if len(view.pixels)]
    if not views:
        raise CalibrationError(
            "a calibration read from a file has no corners to draw; draw it when it is made"
        )
    camera = calibration.camera
    large = float(np.percentile(np.linalg.norm(np.concatenate([v.residuals_px for v in views]), axis=1), 95))
    enlarged = 10 ** math.floor(math.log10(_ARROW * camera.width / max(large, 1e-6)))
    figure = Figure(figsize=(9.0, 1.5 + 8.0 * camera.height / camera.width), layout="constrained")
    axes = figure.subplots()
    for view in views:
        (u, v), (du, dv) = view.pixels.T, view.residuals_px.T
        points = axes.scatter(u, v, s=6)
        arrows = {"angles": "xy", "scale_units": "xy", "scale": 1 / enlarged, "width": 0.0012}
        axes.quiver(u, v, du, dv, color=points.get_facecolor(), **arrows)
    for share in (1 / 3, 2 / 3):
        axes.axvline(share * camera.width - 0.5, color="0.85", linewidth=0.8, zorder=0)
        axes.axhline(share * camera.height - 0.5, color="0.85", linewidth=0.8, zorder=0)
    axes.set(xlim=(-0.5, camera.width - 0.5), ylim=(camera.height - 0.5, -0.5), aspect="equal")
    axes.set(xlabel="u (pixels)", ylabel="v (pixels)")
    axes.set_title(
        f"{camera.name}: {len(views)} views, {calibration.rms_px:.2f} px RMS, {calibration.held_out_rms_px:.2f} px on "
        f"views not fitted to; residuals {enlarged:g} times enlarged",
        fontsize=9,
    )
    write_figure(path, figure)
