"""OpenCV's closed forms for hand-eye calibration, under one signature.

The mount carries the camera, the stand carries the board, so that for every view

    T_stand_mount @ T_mount_camera @ T_camera_board = T_stand_board

with the same two unknown transforms. For a camera on the hand the mount is the hand and the stand the base; for a
fixed camera the mount is the base and the stand the hand.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from baggie.errors import CalibrationError
from baggie.geometry import FloatArray, invert_transform, rigid

MIN_VIEWS = 3
"""Two motions; fewer leave the translation along the one axis open."""

_HAND_EYE = {
    "tsai": cv2.CALIB_HAND_EYE_TSAI,
    "park": cv2.CALIB_HAND_EYE_PARK,
    "horaud": cv2.CALIB_HAND_EYE_HORAUD,
    "andreff": cv2.CALIB_HAND_EYE_ANDREFF,
    "daniilidis": cv2.CALIB_HAND_EYE_DANIILIDIS,
}
_ROBOT_WORLD = {
    "shah": cv2.CALIB_ROBOT_WORLD_HAND_EYE_SHAH,
    "li": cv2.CALIB_ROBOT_WORLD_HAND_EYE_LI,
}

CLOSED_FORMS = (*_HAND_EYE, *_ROBOT_WORLD)
"""Tsai & Lenz 1989, Park & Martin 1994, Horaud & Dornaika 1995, Andreff et al. 1999, Daniilidis 1999; with the board's
pose as a second unknown Shah 2013 and Li et al. 2010."""


def closed_form(method: str, stand_mount: FloatArray, camera_board: FloatArray) -> FloatArray:
    """`T_mount_camera` `(4, 4)` from `T_stand_mount` and `T_camera_board`, both `(N, 4, 4)` in metres.

    Some of these mix rotation and translation in one system, which makes them depend on the unit of length.
    Raises `CalibrationError` where the method finds no rigid transform.
    """
    try:
        if method in _HAND_EYE:
            turn, shift = cv2.calibrateHandEye(
                *_parts(stand_mount), *_parts(camera_board), method=_HAND_EYE[method]
            )
            found = rigid(turn, shift)
        else:
            mount_stand = np.array([invert_transform(pose) for pose in stand_mount])
            _, _, turn, shift = cv2.calibrateRobotWorldHandEye(
                *_parts(camera_board), *_parts(mount_stand), method=_ROBOT_WORLD[method]
            )
            found = invert_transform(rigid(turn, shift))
    except cv2.error as error:
        raise CalibrationError(f"{method} finds no solution for {len(stand_mount)} views") from error
    if not np.isfinite(found).all() or np.linalg.det(found[:3, :3]) <= 0:
        raise CalibrationError(f"{method} finds no rigid transform for {len(stand_mount)} views")
    found[:3, :3] = Rotation.from_matrix(
        found[:3, :3]
    ).as_matrix()  # Andreff's and Li's are rotations only nearly
    return found


def _parts(poses: FloatArray) -> tuple[Sequence[FloatArray], Sequence[FloatArray]]:
    return list(poses[:, :3, :3]), list(poses[:, :3, 3])
