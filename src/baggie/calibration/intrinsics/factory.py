"""Camera matrices as others write them: ROS camera_info, RealSense JSON, OpenCV's FileStorage, mrcal's cameramodel."""

from __future__ import annotations

import ast
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from baggie.errors import CalibrationError, DataError
from baggie.files import parse_yaml, read_text
from baggie.geometry import FloatArray
from baggie.types import Intrinsics

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
    """As `camera_calibration` saves it, or as `ros2 topic echo` prints the message."""
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
