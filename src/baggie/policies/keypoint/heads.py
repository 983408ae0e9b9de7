"""Heads of the `keypoint` network: points from heat maps, yaws from phases of edges, and the map to the robot's plane.

The learned map is `g` of the calibration-free augmentation.

Which way edges run is computed rather than learned. A phase of angular order s says exp(i s θ) of directions θ that
look the same s times a turn: order 2 for edges, whose two sides are alike, and order 4 for the sides of a square.
Averaged over edges it is a sum of unit vectors, as in the structure tensor (J. Bigün and G. Granlund, "Optimal
orientation detection of linear symmetry", ICCV 1987) and its higher orders. A network that has to find this by itself
under random rotations may not in some hundred batches.

Angles as phases have no seam, and no ambiguity for things that look the same several times a turn. The yaw ψ of an
object that looks the same s times a turn is the phase exp(i s θ) of its direction θ in the picture. A map with Jacobian
J from picture to robot turns directions: a side at ψ in the robot's frame lies along J⁻¹ (cos ψ, sin ψ) in the picture.
A tilted camera shears the sides of a square, so both sides' phases are averaged; of a long thing the long side counts.
"""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from baggie.errors import DataError
from baggie.geometry import FloatArray

_NOWHERE = -1e4
"""A logit that leaves nothing of a cell."""


def heat_maps(logits: Tensor) -> Tensor:
    """Softmax over the cells of each map: `(B, K, h, w)` -> `(B, K, h, w)`, each map sums to 1."""
    return logits.flatten(2).softmax(dim=2).view_as(logits)


def soft_argmax(heat: Tensor) -> Tensor:
    """The mean position under each heat map: `(B, K, h, w)` -> `(B, K, 2)` as (u, v) in cells.

    Cell centres are at integers. Unlike the argmax it is differentiable and finer than a cell.
    Source: S. Levine, C. Finn, T. Darrell, P. Abbeel, "End-to-end training of deep visuomotor policies", JMLR
    17 (2016).

    >>> heat = torch.zeros(1, 1, 3, 5)
    >>> heat[0, 0, 1, 2] = heat[0, 0, 1, 3] = 0.5
    >>> soft_argmax(heat)
    tensor([[[2.5000, 1.0000]]])
    """
    u, v = cell_axes(heat)
    return torch.stack([heat.sum(dim=2) @ u, heat.sum(dim=3) @ v], dim=-1)


def local_soft_argmax(logits: Tensor, radius: float) -> Tensor:
    """The mean position within `radius` cells of each map's greatest value: `(B, K, h, w)` -> `(B, K, 2)` (u, v).

    What little weight lies elsewhere, on a second bag or something like one, does not pull.
    """
    width = logits.shape[-1]
    peak = logits.flatten(2).argmax(dim=2)
    at = torch.stack([peak % width, peak // width], dim=-1).to(logits.dtype)
    return soft_argmax(heat_maps(near_only(logits, at, radius)))


def near_only(logits: Tensor, points: Tensor, radius: float | Tensor) -> Tensor:
    """`(B, K, h, w)` with nothing left further than `radius` cells from the points `(B, K, 2)` (u, v) in cells."""
    return torch.where(squared_distances(logits, points) <= radius**2, logits, _NOWHERE)


def picked_near(logits: Tensor, near: Tensor) -> Tensor:
    """Heat map logits `(B, 2, h, w)` whose picks, the first, are near: `near` `(B, 3)`, (u, v) and within how many
    cells.
    """
    pick = near_only(logits[:, :1], near[:, None, :2], near[:, 2].view(-1, 1, 1, 1))
    return torch.cat([pick, logits[:, 1:]], dim=1)


def squared_distances(maps: Tensor, points: Tensor) -> Tensor:
    """From points `(B, K, 2)` (u, v) to every cell of `maps` `(B, K, h, w)`, in cells squared: `(B, K, h, w)`."""
    u, v = cell_axes(maps)
    return (u - points[..., 0:1]).square().unsqueeze(-2) + (v - points[..., 1:2]).square().unsqueeze(-1)


def gaussians(centers: Tensor, sigma: float, height: int, width: int) -> Tensor:
    """Heat maps of normal distributions: centres `(B, K, 2)` (u, v) in cells -> `(B, K, height, width)`, sums 1."""
    u, v = cell_axes(centers.new_empty(height, width))
    along_u = torch.softmax(-((u - centers[..., :1]) ** 2) / (2 * sigma**2), dim=-1)
    along_v = torch.softmax(-((v - centers[..., 1:]) ** 2) / (2 * sigma**2), dim=-1)
    return along_v.unsqueeze(-1) * along_u.unsqueeze(-2)


def cell_axes(maps: Tensor) -> tuple[Tensor, Tensor]:
    """The u `(w,)` and the v `(h,)` of the cells of maps `(..., h, w)`."""
    height, width = maps.shape[-2:]
    u = torch.arange(width, dtype=maps.dtype, device=maps.device)
    return u, torch.arange(height, dtype=maps.dtype, device=maps.device)


STRIDE = 4
"""Pixels of the image to one of the phases."""
AROUND = (1.5, 3.0, 5.0)
"""Radii, sigmas in strides, within which edges are averaged: from a corner to all of a bag."""
CHANNELS = 4 * len(AROUND)
_FAINT = 0.01
"""Edges that are fainter than this, in brightness a pixel, count little: they are noise."""
_SOBEL = (
    torch.tensor([[[[-1.0, 0, 1], [-2, 0, 2], [-1, 0, 1]]], [[[-1.0, -2, -1], [0, 0, 0], [1, 2, 1]]]]) / 8
)


def edge_phases(images: Tensor) -> Tensor:
    """Images `(B, C, H, W)`, 0 to 255, of which the first three channels are colours -> `(B, CHANNELS, H / 4, W / 4)`.

    For each radius in `AROUND` cos and sin of order 4, then of order 2, of the directions across the edges around, as
    long as these agree, at most 1. Directions are from u towards v. No gradients pass.
    """
    with torch.no_grad():
        colors = images[:, :3].float() / 255
        batch, channels, height, width = colors.shape
        sobel = _SOBEL.to(colors)
        slopes = F.conv2d(colors.reshape(-1, 1, height, width), sobel, padding=1)
        du, dv = slopes.view(batch, channels, 2, height, width).unbind(dim=2)
        strength = (du.square() + dv.square() + 1e-6).sqrt()
        # z = du + i dv: |z| exp(2 i θ) is z² / |z|, and squared once more and divided again |z| exp(4 i θ).
        cos2, sin2 = (du.square() - dv.square()) / strength, 2 * du * dv / strength
        cos4, sin4 = (cos2.square() - sin2.square()) / strength, 2 * cos2 * sin2 / strength
        sums = torch.stack([cos4, sin4, cos2, sin2, strength], dim=1).mean(dim=2)
        sums = F.avg_pool2d(sums, STRIDE)
        around = [_blurred(sums, sigma) for sigma in AROUND]
        return torch.cat([part[:, :4] / (part[:, 4:] + _FAINT) for part in around], dim=1)


def _blurred(x: Tensor, sigma: float) -> Tensor:
    """Averaged with a normal distribution's weights, 2.5 `sigma` far; zero outside the picture."""
    reach = int(2.5 * sigma)
    along = torch.arange(-reach, reach + 1, dtype=x.dtype, device=x.device)
    weights = torch.softmax(-along.square() / (2 * sigma**2), dim=0).expand(x.shape[1], 1, 1, -1)
    x = F.conv2d(x, weights, padding=(0, reach), groups=x.shape[1])
    return F.conv2d(x, weights.transpose(2, 3), padding=(reach, 0), groups=x.shape[1])


SQUARE = 4
"""How often a square bag looks the same in one turn."""
LONG = 2
"""The same for one that is clearly longer than wide; its yaw is that of its long side."""


def phase_of(yaw: Tensor, jacobian: Tensor, symmetry: int = SQUARE) -> Tensor:
    """Yaw in the robot's frame `(...)` radians, J `(..., 2, 2)` -> unit phase in the picture `(..., 2)` (cos, sin).

    `symmetry` is even: `SQUARE` or `LONG`.
    """
    total: Tensor | float = 0.0
    for turn in range(symmetry // 2):
        side = yaw + turn * 2 * math.pi / symmetry
        cos, sin = side.cos(), side.sin()
        # The adjugate of J turns directions as its inverse does, but for a half turn where J mirrors: s θ is the same.
        u = jacobian[..., 1, 1] * cos - jacobian[..., 0, 1] * sin
        v = jacobian[..., 0, 0] * sin - jacobian[..., 1, 0] * cos
        theta = symmetry * torch.atan2(v, u)
        total = total + torch.stack([theta.cos(), theta.sin()], dim=-1)
    return torch.nn.functional.normalize(torch.as_tensor(total), dim=-1)


def yaw_of_phase(phase: Tensor, jacobian: Tensor, symmetry: int = SQUARE, iterations: int = 10) -> Tensor:
    """The inverse of `phase_of` by fixed-point iteration: yaw `(...)`, radians in [-π / s, π / s)."""
    yaw = torch.zeros_like(phase[..., 0])
    j = jacobian
    mirrored = torch.sign(j[..., 0, 0] * j[..., 1, 1] - j[..., 0, 1] * j[..., 1, 0])
    for _ in range(iterations):
        now = phase_of(yaw, jacobian, symmetry)
        sine = phase[..., 1] * now[..., 0] - phase[..., 0] * now[..., 1]
        cosine = (phase * now).sum(dim=-1)
        yaw = yaw + mirrored * torch.atan2(sine, cosine) / symmetry
    turn = 2 * math.pi / symmetry
    return torch.remainder(yaw + turn / 2, turn) - turn / 2


_SURE_LONG, _SURE_SQUARE = 0.5, 0.25
"""Phases are as long as they are certain: below these, a thing is not taken for long, or for square."""


def certain_yaw(phases: Tensor, jacobian: Tensor) -> tuple[Tensor, Tensor]:
    """Phases `(2, 2)` as a square and as a long thing -> yaw, radians, and how often a turn it looks the same."""
    square, long = phases
    is_long = long.norm() > _SURE_LONG
    is_square = square.norm() > _SURE_SQUARE
    as_long, as_square = (
        yaw_of_phase(long, jacobian, LONG),
        yaw_of_phase(square, jacobian, SQUARE),
    )
    zero = torch.zeros_like(as_long)
    yaw = torch.where(is_long, as_long, torch.where(is_square, as_square, zero))
    symmetry = torch.where(is_long, zero + LONG, torch.where(is_square, zero + SQUARE, zero))
    return yaw, symmetry


_ITERATIONS = 20
"""Of the fit; it settles in about five."""
_FAR = 4
"""A start with so many times another one's loss is none."""


def apply_homographies(matrix: Tensor, points: Tensor) -> Tensor:
    """Map points through homographies: `(..., 3, 3)`, `(..., 2)` -> `(..., 2)`."""
    mapped = (matrix[..., :2] @ points.unsqueeze(-1)).squeeze(-1) + matrix[..., 2]
    return mapped[..., :2] / mapped[..., 2:]


def homography_jacobian(matrix: Tensor, points: Tensor) -> Tensor:
    """Derivative of `apply_homographies` at the points: `(..., 3, 3)`, `(..., 2)` -> `(..., 2, 2)`.

    For p' = N / D it is (dN - p' dD) / D, with the rows of the matrix as dN and dD.
    """
    denominator = (matrix[..., 2, :2] * points).sum(dim=-1) + matrix[..., 2, 2]
    mapped = apply_homographies(matrix, points)
    numerator = matrix[..., :2, :2] - mapped.unsqueeze(-1) * matrix[..., 2:, :2]
    return numerator / denominator[..., None, None]


class PlanarMap(nn.Module):
    """A lens, a homography, and what stacks shift: points of the picture -> planes of the robot's base frame.

    Points of the picture are normalised so that its centre is (0, 0) and its left and right edges are at u =
    -1 and 1. A point p at q = p - c from the centre of distortion c moves to c + q (1 + k1 |q|² + k2 |q|⁴),
    then through the homography. Twelve numbers, so that 200 noisy labels settle it to a fraction of their
    noise. Right on one plane: the height at which bags lie on the table.

    What lies on n others, in the layer n, is nearer to the camera's foot, the place right below the camera, than it
    looks: seen at p on the table, it is at p + n k (foot - p), where k is a layer's share of the camera's height. Three
    more numbers, `lift`, are (k foot_x, k foot_y, k), metres and a share, in which that is linear. They are 0, and not
    trained, unless labels of several layers told them.
    """

    homography: Tensor
    distortion: Tensor
    center: Tensor
    lift: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.homography = nn.Parameter(torch.eye(3).flatten()[:8].clone())
        self.distortion = nn.Parameter(torch.zeros(2))
        self.center = nn.Parameter(torch.zeros(2))
        self.lift = nn.Parameter(torch.zeros(3), requires_grad=False)

    def _load_from_state_dict(self, state_dict: dict[str, Tensor], prefix: str, *args: Any) -> None:
        state_dict.setdefault(f"{prefix}lift", torch.zeros(3))  # older versions knew the table only
        super()._load_from_state_dict(state_dict, prefix, *args)

    @property
    def knows_layers(self) -> bool:
        """Whether labels of several layers told it what these shift."""
        return bool(self.lift.any())

    def matrix(self) -> Tensor:
        """The homography, `(3, 3)`; its last element is 1."""
        return torch.cat([self.homography, self.homography.new_ones(1)]).view(3, 3)

    def forward(self, points: Tensor, layer: Tensor | None = None) -> Tensor:
        """`(..., 2)` normalised picture coordinates -> `(..., 2)` metres; each in its layer `(...)`, all on the table
        unless given.
        """
        xy = apply_homographies(self.matrix(), self._straighten(points))
        if layer is None:
            return xy
        return xy + layer.unsqueeze(-1) * (self.lift[:2] - self.lift[2] * xy)

    def jacobian(self, points: Tensor, layer: Tensor | None = None) -> Tensor:
        """Derivative of `forward` by the points: `(..., 2)` -> `(..., 2, 2)`."""
        k1, k2 = self.distortion
        offset = points - self.center
        r2 = (offset**2).sum(dim=-1)[..., None, None]
        outer = offset.unsqueeze(-1) * offset.unsqueeze(-2)
        identity = torch.eye(2, dtype=points.dtype, device=points.device)
        lens = identity * (1 + k1 * r2 + k2 * r2**2) + outer * (2 * k1 + 4 * k2 * r2)
        plane = homography_jacobian(self.matrix(), self._straighten(points))
        on_table = torch.matmul(plane, lens)
        return on_table if layer is None else (1 - layer * self.lift[2])[..., None, None] * on_table

    def inverse(self, xy: Tensor, layer: Tensor | None = None, iterations: int = 8) -> Tensor:
        """`(..., 2)` metres, each in its layer `(...)` -> `(..., 2)` normalised picture coordinates.

        By Newton's method from the homography's.
        """
        if layer is not None:
            up = layer.unsqueeze(-1)
            xy = (xy - up * self.lift[:2]) / (1 - up * self.lift[2])
        points = apply_homographies(torch.linalg.inv(self.matrix()), xy)
        for _ in range(iterations):
            residual = (xy - self(points)).unsqueeze(-1)
            points = points + torch.linalg.solve(self.jacobian(points), residual).squeeze(-1)
        return points

    def _straighten(self, points: Tensor) -> Tensor:
        offset = points - self.center
        r2 = (offset**2).sum(dim=-1, keepdim=True)
        return self.center + offset * (1 + self.distortion[0] * r2 + self.distortion[1] * r2**2)

    def fit(
        self,
        points: FloatArray,
        xy: FloatArray,
        noise_m: float | FloatArray = 0.005,
        layer: FloatArray | None = None,
    ) -> FloatArray:
        """Fit to pairs `(N, 2)` normalised and `(N, 2)` metres; returns the residuals `(N, 2)` metres.

        Gauss-Newton on Huber's loss. Weak priors on the lens (coefficients within about 0.2, its centre
        within 0.1 of the picture's) make few or clustered pairs give a plain homography rather than nonsense,
        and one on `lift` (each number within about 0.05) labels that hardly leave the table.
        `noise_m`: what is expected of a label, of all or `(N,)` of each; residuals over twice that count linearly.
        `layer` `(N,)`: of each pair. Where any is above the table, `lift` is fitted along, and trained from then on.
        Raises `DataError` when there are too few pairs, or they lie in one line.
        """
        source, target = np.asarray(points, float), np.asarray(xy, float)
        stacked = layer is not None and bool(np.any(layer))
        given = (torch.from_numpy(source), torch.from_numpy(np.asarray(layer, float)) if stacked else None)
        noise = np.repeat(np.broadcast_to(np.asarray(noise_m, float), len(source)), 2)

        def residuals(theta: FloatArray) -> FloatArray:
            with torch.no_grad():
                mapped = torch.func.functional_call(self, _named(theta), given)
            return np.asarray(mapped.numpy() - target).ravel()

        def loss(theta: FloatArray) -> float:
            off = np.linalg.norm(residuals(theta).reshape(-1, 2), axis=1) / noise[::2]
            return float(np.where(off < 2, off**2, 4 * off - 4).sum())

        prior = np.r_[np.zeros(8), np.full(2, 1 / 0.2), np.full(2, 1 / 0.1), np.full(3 * stacked, 1 / 0.05)]
        robust, least_squares = (np.r_[start, np.zeros(3 * stacked)] for start in _starts(source, target))
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
        self.lift.requires_grad_(stacked)
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
    """Twelve numbers, or fifteen, as the parameters of a `PlanarMap`."""
    values = torch.from_numpy(theta)
    named = {"homography": values[:8], "distortion": values[8:10], "center": values[10:12]}
    return named | ({"lift": values[12:]} if len(values) > 12 else {})
