"""The learned map from the picture to the robot's plane: `g` of the calibration-free augmentation."""

from __future__ import annotations

import cv2
import numpy as np
import torch
from torch import Tensor, nn

from baggie.errors import DataError
from baggie.geometry import FloatArray

_ITERATIONS = 20
"""Of the fit; it settles in about five."""
_FAR = 4
"""A start with so many times another one's loss is none."""


def apply(matrix: Tensor, points: Tensor) -> Tensor:
    """Map points through homographies: `(..., 3, 3)`, `(..., 2)` -> `(..., 2)`."""
    mapped = (matrix[..., :2] @ points.unsqueeze(-1)).squeeze(-1) + matrix[..., 2]
    return mapped[..., :2] / mapped[..., 2:]


def jacobian(matrix: Tensor, points: Tensor) -> Tensor:
    """Derivative of `apply` at the points: `(..., 3, 3)`, `(..., 2)` -> `(..., 2, 2)`.

    For p' = N / D it is (dN - p' dD) / D, with the rows of the matrix as dN and dD.
    """
    denominator = (matrix[..., 2, :2] * points).sum(dim=-1) + matrix[..., 2, 2]
    mapped = apply(matrix, points)
    numerator = matrix[..., :2, :2] - mapped.unsqueeze(-1) * matrix[..., 2:, :2]
    return numerator / denominator[..., None, None]


class PlanarMap(nn.Module):
    """A lens and a homography: points of the picture -> points of one plane in the robot's base frame.

    Points of the picture are normalised so that its centre is (0, 0) and its left and right edges are at u =
    -1 and 1. A point p at q = p - c from the centre of distortion c moves to c + q (1 + k1 |q|² + k2 |q|⁴),
    then through the homography. Twelve numbers, so that 200 noisy labels settle it to a fraction of their
    noise. Right on one plane only: the height at which the labels' bags lie.
    """

    homography: Tensor
    distortion: Tensor
    center: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.homography = nn.Parameter(torch.eye(3).flatten()[:8].clone())
        self.distortion = nn.Parameter(torch.zeros(2))
        self.center = nn.Parameter(torch.zeros(2))

    def matrix(self) -> Tensor:
        """The homography, `(3, 3)`; its last element is 1."""
        return torch.cat([self.homography, self.homography.new_ones(1)]).view(3, 3)

    def forward(self, points: Tensor) -> Tensor:
        """`(..., 2)` normalised picture coordinates -> `(..., 2)` metres."""
        return apply(self.matrix(), self._straighten(points))

    def jacobian(self, points: Tensor) -> Tensor:
        """Derivative of `forward`: `(..., 2)` -> `(..., 2, 2)`."""
        k1, k2 = self.distortion
        offset = points - self.center
        r2 = (offset**2).sum(dim=-1)[..., None, None]
        outer = offset.unsqueeze(-1) * offset.unsqueeze(-2)
        identity = torch.eye(2, dtype=points.dtype, device=points.device)
        lens = identity * (1 + k1 * r2 + k2 * r2**2) + outer * (2 * k1 + 4 * k2 * r2)
        plane = jacobian(self.matrix(), self._straighten(points))
        return torch.matmul(plane, lens)

    def inverse(self, xy: Tensor, iterations: int = 8) -> Tensor:
        """`(..., 2)` metres -> `(..., 2)` normalised picture coordinates, by Newton's method from the
        homography's.
        """
        points = apply(torch.linalg.inv(self.matrix()), xy)
        for _ in range(iterations):
            residual = (xy - self(points)).unsqueeze(-1)
            points = points + torch.linalg.solve(self.jacobian(points), residual).squeeze(-1)
        return points

    def _straighten(self, points: Tensor) -> Tensor:
        offset = points - self.center
        r2 = (offset**2).sum(dim=-1, keepdim=True)
        return self.center + offset * (1 + self.distortion[0] * r2 + self.distortion[1] * r2**2)

    def fit(self, points: FloatArray, xy: FloatArray, noise_m: float | FloatArray = 0.005) -> FloatArray:
        """Fit to pairs `(N, 2)` normalised and `(N, 2)` metres; returns the residuals `(N, 2)` metres.

        Gauss-Newton on Huber's loss. Weak priors on the lens (coefficients within about 0.2, its centre
        within 0.1 of the picture's) make few or clustered pairs give a plain homography rather than nonsense.
        `noise_m`: what is expected of a label, of all or `(N,)` of each; residuals over twice that count linearly.
        Raises `DataError` when there are too few pairs, or they lie in one line.
        """
        source, target = np.asarray(points, float), np.asarray(xy, float)
        pixels = torch.from_numpy(source)
        noise = np.repeat(np.broadcast_to(np.asarray(noise_m, float), len(source)), 2)

        def residuals(theta: FloatArray) -> FloatArray:
            with torch.no_grad():
                mapped = torch.func.functional_call(self, _named(theta), (pixels,))
            return np.asarray(mapped.numpy() - target).ravel()

        def loss(theta: FloatArray) -> float:
            off = np.linalg.norm(residuals(theta).reshape(-1, 2), axis=1) / noise[::2]
            return float(np.where(off < 2, off**2, 4 * off - 4).sum())

        prior = np.r_[np.zeros(8), np.full(2, 1 / 0.2), np.full(2, 1 / 0.1)]
        robust, least_squares = _starts(source, target)
        theta = robust if loss(robust) <= _FAR * loss(least_squares) else least_squares
        steps = 1e-6 * np.eye(len(theta))
        for _ in range(_ITERATIONS):
            r = residuals(theta)
            slopes = [(residuals(theta + step) - residuals(theta - step)) / 2e-6 for step in steps]
            size = np.repeat(np.linalg.norm(r.reshape(-1, 2), axis=1), 2)
            weight = np.sqrt(np.minimum(1.0, 2 * noise / np.maximum(size, 1e-12))) / noise
            a = np.vstack([np.stack(slopes, axis=1) * weight[:, None], np.diag(prior)])
            theta = theta - np.linalg.lstsq(a, np.r_[r * weight, prior * theta], rcond=None)[0]
        self.load_state_dict(_named(theta))
        return residuals(theta).reshape(-1, 2)


def _starts(source: FloatArray, target: FloatArray) -> list[FloatArray]:
    """Two homographies, without a lens: one that sees past many wrong pairs, and one that heeds all.

    Of few pairs half may tell of the same four places: the first then fits these and nothing else.
    Raises `DataError` when there are too few pairs, or they lie in one line.
    """
    methods = (cv2.LMEDS, 0) if len(source) >= 4 else ()
    found = [h for method in methods if (h := cv2.findHomography(source, target, method)[0]) is not None]
    if len(found) < 2:
        raise DataError(f"a map from picture to robot needs at least 4 spread points, got {len(source)}")
    return [np.r_[(h / h[2, 2]).ravel()[:8], np.zeros(4)] for h in found]


def _named(theta: FloatArray) -> dict[str, Tensor]:
    """Twelve numbers as the parameters of a `PlanarMap`."""
    values = torch.from_numpy(theta)
    return {"homography": values[:8], "distortion": values[8:10], "center": values[10:]}
