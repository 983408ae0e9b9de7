"""Rigid transforms that know how sure they are.

A true transform is `R = exp(w) R0`, `t = t0 + d` with a small error (w, d), radians and metres, in the frame the
transform maps *to*. Its covariance is `(6, 6)`, w first. Errors travel through inversion and composition to first
order (Barfoot & Furgale, "Associating Uncertainty With Three-Dimensional Poses", 2014, with this choice of error).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from baggie.geometry import FloatArray, invert_transform

_ROUNDING = 1e-9


@dataclass(frozen=True)
class UncertainTransform:
    """`T_a_b` and the covariance of its error."""

    transform: FloatArray
    """`(4, 4)`, maps points of frame b into frame a."""
    covariance: FloatArray
    """`(6, 6)`: rotation (radians) and then translation (metres), in frame a."""

    def inverse(self) -> UncertainTransform:
        """`T_b_a`: R' = R0ᵀ exp(-w), t' = -R' t."""
        rotation, t = self.transform[:3, :3], self.transform[:3, 3]
        zero = np.zeros((3, 3))
        jacobian = np.block([[-rotation.T, zero], [-rotation.T @ _cross(t), -rotation.T]])
        return UncertainTransform(invert_transform(self.transform), jacobian @ self.covariance @ jacobian.T)

    def __matmul__(self, other: UncertainTransform) -> UncertainTransform:
        """`T_a_b @ T_b_c`, their errors independent."""
        rotation, zero = self.transform[:3, :3], np.zeros((3, 3))
        ours = np.block([[np.eye(3), zero], [-_cross(rotation @ other.transform[:3, 3]), np.eye(3)]])
        theirs = np.block([[rotation, zero], [zero, rotation]])
        covariance = ours @ self.covariance @ ours.T + theirs @ other.covariance @ theirs.T
        return UncertainTransform(self.transform @ other.transform, covariance)

    @property
    def std_mm(self) -> float:
        """One standard deviation of the position, root mean square over directions in space together."""
        return float(np.sqrt(np.trace(self.covariance[3:, 3:]))) * 1000

    @property
    def std_deg(self) -> float:
        """The same of the rotation."""
        return float(np.degrees(np.sqrt(np.trace(self.covariance[:3, :3]))))

    def error_of(self, truth: ArrayLike) -> FloatArray:
        """`(6,)`: the error (w, d) that would make this transform the true one."""
        truth = np.asarray(truth, float)
        turn = Rotation.from_matrix(truth[:3, :3] @ self.transform[:3, :3].T).as_rotvec()
        return np.concatenate([turn, truth[:3, 3] - self.transform[:3, 3]])

    def holds(self, truth: ArrayLike, probability: float = 0.95) -> bool:
        """Whether `truth` `(4, 4)` lies in the region that is to hold it with this probability."""
        error = self.error_of(truth)
        # Where there is no uncertainty at all, there may be no error but what rounding leaves.
        distance = error @ np.linalg.inv(self.covariance + _ROUNDING**2 * np.eye(6)) @ error
        return bool(distance <= chi2.ppf(probability, 6))


def _cross(v: FloatArray) -> FloatArray:
    """`(3, 3)`, with `_cross(a) @ b == cross(a, b)`."""
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
