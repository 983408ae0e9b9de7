"""Least squares on the error in the picture, with lens terms as far as left-out points justify them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import null_space
from scipy.optimize import least_squares

from baggie.calibration.image_to_robot.projection import derivatives, from_numbers, project, to_numbers
from baggie.calibration.image_to_robot.start import normalized
from baggie.geometry import FloatArray
from baggie.types import Intrinsics

_LENS_TERMS = ((), (4,), (4, 5), (2, 3, 4, 5))
"""Places in `to_numbers` of what is estimated along: nothing, k1, k1 and k2, these and the centre of distortion."""
_BETTER = 0.9
"""More terms have to make left-out points this much better; by chance they are a few per cent better or worse."""
_NOISELESS_PX = 1e-3
_STEPS = 100
"""Points of a camera take about ten; nonsense never settles."""
_NEEDED = 1e-9
"""Of det(1 - H): the other points do not determine the fit without this one."""


@dataclass(frozen=True)
class Adjusted:
    """A least squares fit and its first-order statistics."""

    lens: Intrinsics
    matrix: FloatArray
    basis: FloatArray
    """`(4 + D + M, p)`: how the numbers of `to_numbers` follow what was fitted."""
    by_numbers: FloatArray
    """`(2 N, 4 + D + M)`, derivative of the pixels."""
    by_xy: FloatArray
    """`(N, 2, 2)`, pixels per metre."""
    spread: FloatArray
    """`(p, p)`: covariance of what was fitted, for pixels with variance 1."""
    left_out_px: FloatArray
    """`(N, 2)`: residuals from fits to the other points; infinite where those cannot do without the point."""
    variance: float
    """Of a pixel's coordinate."""

    @classmethod
    def of(
        cls, lens: Intrinsics, matrix: FloatArray, basis: FloatArray, points: FloatArray, pixels: FloatArray
    ) -> Adjusted:
        """The statistics of a fit that has converged.

        A residual r of a point with leverage H becomes (1 - H)^-1 r when the point is left out.
        """
        seen, by_xy, by_each = derivatives(lens, matrix, points)
        by_numbers = by_each.reshape(-1, by_each.shape[2])
        jacobian = by_numbers @ basis
        scale = np.linalg.norm(jacobian, axis=0)
        left, singular, right = np.linalg.svd(jacobian / scale, full_matrices=False)
        told = singular > 1e-9 * singular[0]
        left, weighted = left[:, told], right[told].T / singular[told] / scale[:, None]
        blocks = left.reshape(len(points), 2, -1)
        rest = np.eye(2) - blocks @ blocks.transpose(0, 2, 1)
        residuals = seen - pixels
        needed = np.linalg.det(rest) < _NEEDED
        rest[needed] = np.eye(2)
        left_out = np.linalg.solve(rest, residuals[..., None])[..., 0]
        left_out[needed] = np.inf
        # Both allow for the scatter being known from a few points only: Student's t with as many degrees has the
        # first variance; the second, of left-out points, also grows with what the model cannot explain.
        spare = max(residuals.size - int(told.sum()), 3)
        variance = max(float((residuals**2).sum()) / (spare - 2), float((left_out**2).mean()))
        return cls(lens, matrix, basis, by_numbers, by_xy, weighted @ weighted.T, left_out, variance)

    def distance_px(self, points: FloatArray, pixels: FloatArray, used: NDArray[np.bool_]) -> FloatArray:
        """`(N,)`: how far each point is off, in pixels of equal likelihood, where the fit `used` some `(N,)` of them.

        A point the fit was drawn to comes out nearer than it should, with covariance 1 - H, and another one farther,
        with 1 + H.
        """
        seen, _, by_each = derivatives(self.lens, self.matrix, points)
        moved = by_each @ self.basis
        leverage = moved @ self.spread @ moved.transpose(0, 2, 1)
        shape = np.eye(2) + np.where(used, -1.0, 1.0)[:, None, None] * leverage
        residuals = seen - pixels
        shape[np.linalg.det(shape) < _NEEDED] = np.eye(2)
        weighted = np.linalg.solve(shape, residuals[..., None])[..., 0]
        return np.asarray(np.sqrt(np.maximum((residuals * weighted).sum(axis=1), 0.0)), float)

    @property
    def covariance(self) -> FloatArray:
        """`(4 + D + M, 4 + D + M)` of the numbers of `to_numbers`."""
        return self.variance * self.basis @ self.spread @ self.basis.T

    @property
    def left_out_rms_px(self) -> float:
        """Root mean square length."""
        return float(np.sqrt((self.left_out_px**2).sum(axis=1).mean()))


def fit_projection(lens: Intrinsics, matrix: FloatArray, points: FloatArray, pixels: FloatArray) -> Adjusted:
    """The fit with as few lens terms as left-out points allow."""
    best: Adjusted | None = None
    for terms in _LENS_TERMS:
        if best is not None and best.left_out_rms_px < _NOISELESS_PX:
            break
        straight = replace(lens, distortion=np.zeros(4 if terms else 0))
        fit = adjust(straight, matrix, terms, points, pixels)
        if best is None or fit.left_out_rms_px < _BETTER * best.left_out_rms_px:
            best = fit
    assert best is not None
    return best


def adjust(
    lens: Intrinsics, matrix: FloatArray, terms: tuple[int, ...], points: FloatArray, pixels: FloatArray
) -> Adjusted:
    """Least squares on reprojection over the matrix, whose scale has no meaning, and these lens terms."""
    numbers = to_numbers(lens, matrix)
    basis = np.zeros((len(numbers), len(terms) + matrix.size - 1))
    basis[terms, range(len(terms))] = 1.0
    basis[-matrix.size :, len(terms) :] = null_space(matrix.reshape(1, -1))

    def residuals(change: FloatArray) -> FloatArray:
        return (project(*from_numbers(numbers + basis @ change, lens, matrix), points) - pixels).ravel()

    def jacobian(change: FloatArray) -> FloatArray:
        _, _, by_each = derivatives(*from_numbers(numbers + basis @ change, lens, matrix), points)
        return by_each.reshape(-1, len(numbers)) @ basis

    still = np.zeros(basis.shape[1])
    solution = least_squares(
        residuals, still, jacobian, method="lm", xtol=1e-14, ftol=1e-14, gtol=1e-14, max_nfev=_STEPS
    )
    lens, found = from_numbers(numbers + basis @ solution.x, lens, matrix)
    matrix = normalized(found, points)
    basis[-matrix.size :] *= np.linalg.norm(matrix) / np.linalg.norm(found)
    return Adjusted.of(lens, matrix, basis, points, pixels)
