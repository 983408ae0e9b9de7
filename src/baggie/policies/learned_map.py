"""What a `keypoint` policy has learned of the camera, as a calibration like any other."""

from __future__ import annotations

import copy

import numpy as np
import torch

from baggie.calibration.files import CameraIdentity
from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.geometry import FloatArray, apply_homography
from baggie.policies.keypoint import KeypointPolicy

_ROWS, _COLUMNS = 9, 16
_LIMIT_MM = 1.0


def as_calibration(policy: KeypointPolicy, height_m: float) -> ImageToRobot:
    """The policy's map from its picture to the robot, fitted to a grid over its view.

    `height_m` is the height it was learned at, half that of the bags at rest. The map's lens bends from the picture to
    the table and a calibration's the other way: `residuals` says what the conversion costs; what the policy's own map
    is worth it does not know. The camera is named after the cell.

    Raises `CalibrationError` where the conversion costs more than a millimetre, or the map is no camera's.
    """
    view = policy.view
    u, v = np.linspace(view.left, view.right - 1, _COLUMNS), np.linspace(view.top, view.bottom - 1, _ROWS)
    pixels = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    xy = _to_robot(policy, apply_homography(view.normalize(), pixels))
    robot = np.column_stack([xy, np.full(len(xy), height_m)])
    camera = CameraIdentity(f"cell {policy.cell}", *policy.picture_size)
    return ImageToRobot.fit(pixels, robot, camera, limit_mm=_LIMIT_MM)


def _to_robot(policy: KeypointPolicy, normalized: FloatArray) -> FloatArray:
    exact = copy.deepcopy(policy.network.to_robot).cpu().double()
    with torch.no_grad():
        return np.asarray(exact(torch.from_numpy(normalized)).numpy(), float)
