"""From the robot's base frame to pixels: a lens and a matrix, and how pixels follow each of their numbers.

The matrix takes homogeneous points of the base frame to rays of the camera's frame (z forward, up to a positive
factor), which the lens bends into the picture. It is `(3, 4)` for points (x, y, z, 1) of space, or `(3, 3)`, a
homography, for points (x, y, 1) of one plane (Hartley & Zisserman, "Multiple View Geometry", sections 6.1 and 2.3).
"""

from __future__ import annotations

import cv2
import numpy as np

from baggie.geometry import FloatArray
from baggie.types import Intrinsics


def homogeneous(matrix: FloatArray, points: FloatArray) -> FloatArray:
    """Points `(N, 3)` metres as the matrix takes them: `(N, 4)`, or `(N, 3)` without their height for a homography."""
    columns = points if matrix.shape[1] == 4 else points[:, :2]
    return np.column_stack([columns, np.ones(len(points))])


def project(lens: Intrinsics, matrix: FloatArray, points: FloatArray) -> FloatArray:
    """Where points `(N, 3)` metres appear: `(N, 2)` pixels."""
    return lens.project(homogeneous(matrix, points) @ matrix.T)


def derivatives(
    lens: Intrinsics, matrix: FloatArray, points: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """`project` and its derivatives at points `(N, 3)` metres.

    Returns the pixels `(N, 2)`, their change with x and y `(N, 2, 2)` in pixels per metre, and with the numbers of
    `to_numbers` `(N, 2, 4 + D + M)`.
    """
    seen_as = homogeneous(matrix, points)
    rays = seen_as @ matrix.T
    still = np.zeros(3)
    pixels, all_of_them = cv2.projectPoints(
        rays.reshape(-1, 1, 3), still, still, lens.matrix, lens.distortion
    )
    jacobian = np.asarray(all_of_them, float).reshape(len(points), 2, -1)
    by_ray = jacobian[:, :, 3:6]  # of a camera that stands still, moving the point is moving the frame
    by_lens = jacobian[:, :, 6 : 10 + len(lens.distortion)]
    by_matrix = (by_ray[..., None] * seen_as[:, None, None, :]).reshape(len(points), 2, -1)
    by_numbers = np.concatenate([by_lens, by_matrix], axis=2)
    return np.asarray(pixels.reshape(-1, 2), float), by_ray @ matrix[:, :2], by_numbers


def to_plane(lens: Intrinsics, matrix: FloatArray, pixels: FloatArray, heights: FloatArray) -> FloatArray:
    """Where the lines of sight of pixels `(N, 2)` meet planes at `heights` `(N,)` metres: `(N, 2)` x, y metres.

    A homography knows one plane and takes no notice of the heights. NaN where a line leads away from its plane.
    """
    rays = np.column_stack([lens.rays(pixels), np.ones(len(pixels))])
    planes = np.broadcast_to(matrix[:, [0, 1, -1]], (len(pixels), 3, 3)).copy()
    if matrix.shape[1] == 4:
        planes[:, :, 2] += heights[:, None] * matrix[:, 2]
    points = np.linalg.solve(planes, rays[..., None])[..., 0]
    points[points[:, 2] <= 0] = np.nan
    return np.asarray(points[:, :2] / points[:, 2:], float)


def to_numbers(lens: Intrinsics, matrix: FloatArray) -> FloatArray:
    """`(4 + D + M,)`: fx, fy, cx, cy, the D distortion coefficients, the matrix row by row."""
    k = lens.matrix
    return np.concatenate([[k[0, 0], k[1, 1], k[0, 2], k[1, 2]], lens.distortion, matrix.ravel()])


def from_numbers(numbers: FloatArray, lens: Intrinsics, matrix: FloatArray) -> tuple[Intrinsics, FloatArray]:
    """The inverse of `to_numbers`; `lens` and `matrix` give size and shapes."""
    fx, fy, cx, cy = (float(number) for number in numbers[:4])
    camera = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    end = 4 + len(lens.distortion)
    return Intrinsics(lens.width, lens.height, camera, numbers[4:end]), numbers[end:].reshape(matrix.shape)
