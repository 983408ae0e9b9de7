"""What `keypoint` learns from: labels on which all attempts agree, and pictures with other goals, looks and views.

Three things make better labels for free. *Executed* poses are where the arm really was. The *release* pose of an
attempt says where the object lies in the picture after it, which is the next attempt's picture before: a second opinion
beside the detector's, wrong in other ways; and the next pick says where the object came to rest, which is some
millimetres from where it was let go. And the *consensus*, the map from the picture to the robot that explains most
labels, shows which ones do not fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import NamedTuple

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from baggie.data.summary import goal_of
from baggie.geometry import FloatArray, apply_homography, wrap_angle
from baggie.learning.augmentation import (
    LONG,
    SQUARE,
    Mask,
    Shape,
    WarpRange,
    object_mask,
    random_light,
    random_look,
    random_warp,
    randomly_turned,
    reshaped,
    stands_alone,
    unchanged,
    with_shape,
    without_object,
)
from baggie.policies.keypoint.heads import PlanarMap
from baggie.policies.keypoint.policy import KeypointPolicy
from baggie.policies.planning import CELLS_TO_INPUT, LONG_RATIO, View
from baggie.types import Attempt, Goal, Image

DETECTION_NOISE_M, PLACING_NOISE_M = 0.002, 0.005
"""Noise expected of labels by the collector's detection and by releases, metres, until the residuals tell."""
_SAME_PLACE = 0.004
"""Of the picture's width: an object seen this near to where it was seen last has not been moved in between."""
SYSTEMATIC_M = 0.002
"""How far a kind of label may be off the same way everywhere, or from the middle of the workspace to its edge."""
_KEPT, _DOUBTED = 2.5, 4.0
"""Times the usual residual: beyond the first a label loses weight, beyond the second a person should look at it."""
_YAW_AGREES = np.deg2rad(10)


@dataclass(frozen=True)
class Outlier:
    """A label that does not fit what the others agree on."""

    attempt_id: int
    what: str
    """`pick` or `place`."""
    off_mm: float
    """From where the consensus puts it."""


@dataclass(frozen=True)
class Disagreement:
    """How far releases say an object is from where the collector detected it, as a smooth field over the table."""

    middle: FloatArray
    """`(2,)` metres, where `extent` is measured from."""
    extent: FloatArray
    """`(2,)` metres."""
    field: FloatArray
    """`(3, 2)` metres: the constant, and the slopes over `extent` along x and y."""

    def at(self, xy: FloatArray) -> FloatArray:
        """`(N, 2)` -> `(N, 2)`, metres."""
        return np.asarray(self.terms(xy) @ self.field)

    def terms(self, xy: FloatArray) -> FloatArray:
        """`(N, 3)`: what the field's rows are multiplied with."""
        return np.column_stack([np.ones(len(xy)), (xy - self.middle) / self.extent])


@dataclass(frozen=True)
class Labels:
    """Labels of N attempts; K = 2 are (pick, place)."""

    xy: FloatArray
    """`(N, K, 2)` metres, robot base frame: where the object is, and where to let go of it."""
    weight: FloatArray
    """`(N, K)`: 1 for labels by the collector's detection that agree with the consensus, less for others."""
    layers: FloatArray
    """`(N, K)`: how many others lie below it; 0 where nobody counted."""
    counted: NDArray[np.bool_]
    """`(N,)`: where somebody counted them: others may lie about."""
    yaw: FloatArray
    """`(N,)` radians: of the object at the pick."""
    yaw_weight: FloatArray
    """`(N,)`: 1 where the hand was turned as the object lies in the picture, else 0."""
    symmetry: NDArray[np.int64]
    """`(N,)`: how often a turn the object looks the same: as its attempt says, else 2 where its box is clearly longer
    than wide and 4 where it is not."""
    outliers: list[Outlier]
    """Worst first."""
    pairs: int
    """Pictures with a second opinion, from the release before."""
    disagreement: Disagreement
    """Between both kinds of label; half of it was corrected, as neither is known to be right."""
    systematic_m: float
    """Its root mean square over the picks."""

    @classmethod
    def of(cls, attempts: Sequence[Attempt], view: View, to_robot: PlanarMap, fuse: bool = True) -> Labels:
        """Labels of successful attempts, and `to_robot` fitted to them.

        Without `fuse`, the executed poses as they are. Raises `DataError` when the goals are too few or in one line.
        """
        executed = [attempt.outcome.executed for attempt in attempts]
        xy = np.array([(action.pick.xy, action.place.xy) for action in executed])
        layers = np.array([(a.pick_layer or 0, a.place_layer or 0) for a in attempts], float)
        boxes = np.stack([[a.box_before for a in attempts], [goal_of(a).corners for a in attempts]], axis=1)
        seen = apply_homography(view.normalize(), boxes.reshape(-1, 2)).reshape(*boxes.shape)  # (N, K, 4, 2)
        centers = seen.mean(axis=2)
        known = np.isfinite(centers).all(axis=-1)
        later = _followers(attempts, centers) if fuse else np.empty(0, int)
        disagreement = _disagreement(xy[later - 1, 1] - xy[later, 0], xy[:, 0], later)
        shift = disagreement.at(xy[:, 0])
        noise = np.tile([DETECTION_NOISE_M, PLACING_NOISE_M], (len(xy), 1))
        xy[:, 0] += shift / 2  # neither kind is known to be right
        xy[:, 1] -= disagreement.at(xy[:, 1]) / 2
        said = xy.copy()
        # The next pick tells where the object came to rest, and does not scatter.
        xy[later - 1, 1] = xy[later, 0]
        noise[later - 1, 1] = DETECTION_NOISE_M
        if fuse:
            to_robot.fit(centers[known], xy[known], noise[known], layers[known])
        else:
            to_robot.fit(centers[:, 1], xy[:, 1], layer=layers[:, 1])
        off, off_said = (_off(to_robot, centers, layers, labels, known) for labels in (xy, said))
        weight = np.ones_like(off)
        if fuse:
            near = _KEPT * _usual(off) / np.maximum(np.nan_to_num(off), 1e-9)
            weight = (DETECTION_NOISE_M / noise) ** 2 * np.minimum(1.0, near) ** 2
        yaw = np.array([action.pick.yaw for action in executed])
        # As on the table: a layer turns no side, and keeps the sides' ratio.
        in_picture, long = directions(_mapped(to_robot, seen[:, 0].reshape(-1, 2)).reshape(-1, 4, 2))
        turned = np.abs(wrap_angle(in_picture - yaw, np.pi / 2))
        outliers = [
            Outlier(attempts[i].attempt_id, ("pick", "place")[k], 1000 * float(off_said[i, k]))
            for i, k in zip(*np.nonzero(off_said > _DOUBTED * _usual(off_said)), strict=True)
        ]
        return cls(
            xy,
            weight,
            layers,
            np.array([(a.pick_layer, a.place_layer) != (None, None) for a in attempts]),
            yaw,
            1.0 - (turned > _YAW_AGREES),  # NaN where the object was not seen: nothing speaks against it
            np.array(
                [
                    (LONG if is_long else SQUARE) if a.object_symmetry is None else a.object_symmetry
                    for a, is_long in zip(attempts, long, strict=True)
                ]
            ),
            sorted(outliers, key=lambda outlier: -outlier.off_mm),
            len(later),
            disagreement,
            float(np.sqrt((shift**2).sum(axis=1).mean())),
        )


def _followers(attempts: Sequence[Attempt], centers: FloatArray) -> NDArray[np.int64]:
    """Attempts whose object is where the attempt before put it: `(M,)` indices; `centers` `(N, K, 2)` normalised.

    In another layer it is another one, on it or below it.
    """
    return np.array(
        [
            later
            for later, (a, b) in enumerate(pairwise(attempts), start=1)
            if b.attempt_id == a.attempt_id + 1
            and b.pick_layer == a.place_layer
            and np.linalg.norm(centers[later, 0] - centers[later - 1, 1]) < 2 * _SAME_PLACE
        ],
        int,
    )


def _disagreement(apart: FloatArray, picks: FloatArray, later: NDArray[np.int64]) -> Disagreement:
    """The field that `apart` `(M, 2)`, releases less picks of the same objects, says of all `picks` `(N, 2)`, metres.

    A constant and a slope, the most probable ones: pairs that scatter by `PLACING_NOISE_M` against a prior of
    `SYSTEMATIC_M`.
    """
    middle = picks.mean(axis=0)
    extent = np.maximum(np.abs(picks - middle).max(axis=0), 0.05)
    found = Disagreement(middle, extent, np.zeros((3, 2)))
    terms = found.terms(picks[later])
    weight = np.ones(len(apart))
    prior = np.eye(3) * (PLACING_NOISE_M / SYSTEMATIC_M) ** 2
    for _ in range(10):  # Huber's weights, so that one bad release does not count
        weighted = terms * weight[:, None]
        found = replace(
            found, field=np.asarray(np.linalg.solve(terms.T @ weighted + prior, weighted.T @ apart), float)
        )
        size = np.linalg.norm(apart - terms @ found.field, axis=1)
        weight = np.minimum(1.0, 2 * PLACING_NOISE_M / np.maximum(size, 1e-9))
    return found


def _off(
    to_robot: PlanarMap,
    centers: FloatArray,
    layers: FloatArray,
    labels: FloatArray,
    known: NDArray[np.bool_],
) -> FloatArray:
    """How far labels are from where the map puts what was seen: `(N, K)` metres, NaN where nothing was."""
    off = np.full(known.shape, np.nan)
    off[known] = np.linalg.norm(labels[known] - _mapped(to_robot, centers[known], layers[known]), axis=1)
    return off


def _usual(off: FloatArray) -> FloatArray:
    """Half of the residuals of either kind are smaller, `(K,)` metres; but for half a millimetre nothing is doubted."""
    return np.asarray(np.maximum(np.nanmedian(off, axis=0), 5e-4))


def _mapped(to_robot: PlanarMap, points: FloatArray, layers: FloatArray | None = None) -> FloatArray:
    """`(N, 2)` normalised, in layers `(N,)` -> `(N, 2)` metres."""
    above = None if layers is None else torch.from_numpy(layers).float()
    with torch.no_grad():
        return np.asarray(to_robot(torch.from_numpy(points).float(), above).double().numpy())


def directions(corners: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Rectangles `(N, 4, 2)` on the table -> the direction of their longer sides `(N,)`, and which are long."""
    sides = np.roll(corners, -1, axis=1) - corners
    length = np.linalg.norm(sides, axis=2)
    first, second = length[:, 0::2].sum(axis=1), length[:, 1::2].sum(axis=1)
    longer = np.where((first >= second)[:, None], sides[:, 0], sides[:, 1])
    ratio = np.maximum(first, second) / np.maximum(np.minimum(first, second), 1e-9)
    return np.arctan2(longer[:, 1], longer[:, 0]), ratio > LONG_RATIO


_RESHAPED = 0.5
"""The share of objects with new looks that get another shape."""
_APART = 1.5
"""Of a goal's size: a painted one nearer than this to the object would hide it."""


@dataclass(frozen=True)
class Changes:
    """What is changed in pictures."""

    new_looks: float = 0.25
    """The share that is given another cloth, shape, table and clutter."""
    warps: WarpRange = field(default_factory=WarpRange)


class Sample(NamedTuple):
    """One picture to learn from."""

    image: Image
    """`(C, H, W)`, the network's input."""
    to_picture: FloatArray
    """`(3, 3)`: its cells -> the normalised picture."""
    cells: FloatArray
    """`(2, 2)`: about where pick and place are, in cells (u, v)."""
    shape: Shape
    """Of the object."""


class Samples:
    """The pictures of N attempts, and how to make samples of them."""

    def __init__(
        self,
        attempts: Sequence[Attempt],
        labels: Labels,
        policy: KeypointPolicy,
        changes: Changes,
    ) -> None:
        """`policy`: says what its network sees, and has its map fitted to the labels."""
        view, to_robot = policy.view, policy.network.to_robot
        self._view, self._goal_input, self._changes = view, policy.goal_input, changes
        self._yaw, self._symmetry = labels.yaw, labels.symmetry
        self._pictures = np.stack([view.cut(attempt.before.color) for attempt in attempts])
        self._masks = [
            mask_alone(attempt, picture, view.to_input(attempt.box_before))
            for attempt, picture in zip(attempts, self._pictures, strict=True)
        ]
        self._tables = [
            None if mask is None else without_object(picture, mask)
            for picture, mask in zip(self._pictures, self._masks, strict=True)
        ]
        self._goals = [view.goal_to_input(goal_of(attempt)) for attempt in attempts]
        with torch.no_grad():
            layers = torch.from_numpy(labels.layers).float()
            normalized = to_robot.inverse(torch.from_numpy(labels.xy).float(), layers)
            jacobian = to_robot.jacobian(normalized[:, 0], layers[:, 0]).double().numpy()
        self._from_input = view.normalize() @ view.from_input()
        self._jacobian = jacobian @ self._from_input[:2, :2]
        """`(N, 2, 2)`: d (x, y) / d (u, v) at the picks, metres per pixel of the input."""
        points = normalized.double().numpy().reshape(-1, 2)
        in_input = apply_homography(np.linalg.inv(self._from_input), points)
        self._points: FloatArray = in_input.reshape(-1, 2, 2)
        """`(N, 2, 2)`: about where pick and place labels are in the input, pixels."""

    def __len__(self) -> int:
        return len(self._pictures)

    def hides(self, pick_from: int, place_from: int) -> bool:
        """Whether the goal of one attempt, painted into the picture of another, would hide the object there."""
        if self._goal_input.kind == "region":
            return False
        goal = self._goals[place_from].corners
        distance = np.linalg.norm(goal.mean(axis=0) - self._points[pick_from, 0])
        return bool(distance < _APART * np.ptp(goal, axis=0).max())

    def draw(self, rng: np.random.Generator, pick_from: int, place_from: int) -> Sample:
        """The picture of one attempt with the goal of another, changed at random."""
        size, goal = self._view.size, self._goals[place_from]
        points = np.stack([self._points[pick_from, 0], self._points[place_from, 1]])
        warp = random_warp(rng, size, points, self._changes.warps)
        picture, shape = self._changed(rng, pick_from)
        if self._goal_input.kind == "painted":  # first: light and warp change a card as they change the table
            picture = self._goal_input.network_input(picture, goal).transpose(1, 2, 0)
        picture = np.asarray(cv2.LUT(picture, random_light(rng)[:, None]), np.uint8)
        warped = cv2.warpPerspective(
            picture, warp, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        image = np.asarray(warped.transpose(2, 0, 1), np.uint8)
        if self._goal_input.kind == "region":
            # The goal's corners are warped rather than its mask: as sharp as in a picture that is not.
            moved = Goal(apply_homography(warp, goal.corners))
            image = self._goal_input.network_input(np.asarray(warped, np.uint8), moved)
        to_picture = self._from_input @ np.linalg.inv(warp) @ CELLS_TO_INPUT
        cells = apply_homography(np.linalg.inv(CELLS_TO_INPUT) @ warp, points)
        return Sample(image, to_picture / to_picture[2, 2], cells, shape)

    def _changed(self, rng: np.random.Generator, number: int) -> tuple[Image, Shape]:
        """A picture with its object turned, of another shape or looking otherwise, and the object's shape then."""
        picture, mask, table = self._pictures[number], self._masks[number], self._tables[number]
        before = shape = unchanged(float(self._yaw[number]), int(self._symmetry[number]))
        if mask is None or table is None:
            return picture, shape
        new_look = rng.random() < self._changes.new_looks
        if new_look and rng.random() < _RESHAPED:
            shape = reshaped(rng, shape, self._jacobian[number], LONG_RATIO)
        shape = randomly_turned(rng, shape, self._jacobian[number])
        if shape is not before:
            picture, mask = with_shape(picture, table, mask, self._points[number, 0], shape)
        if new_look:
            picture = random_look(rng, picture, table, mask)
        return picture, shape


def mask_alone(attempt: Attempt, picture: Image, box: FloatArray) -> Mask | None:
    """Where the object is in a picture `(H, W, 3)`, in which its box is `(4, 2)`, to be changed there.

    None where it was not seen, or lies on others or right beside some: what is below it and behind it, nobody knows.
    """
    if not np.isfinite(box).all() or attempt.pick_layer:
        return None
    mask = object_mask(picture, box)
    return mask if attempt.pick_layer is None or stands_alone(picture, mask) else None
