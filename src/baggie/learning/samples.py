"""Pictures to learn from: with other goals, other looks, turned bags, warped; where labels are is kept."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import cv2
import numpy as np
import torch

from baggie.data.summary import goal_of
from baggie.geometry import FloatArray, apply_homography
from baggie.learning.augmentation import (
    Shape,
    WarpRange,
    as_it_is,
    object_mask,
    random_light,
    random_look,
    random_warp,
    reshaped,
    turned,
    with_shape,
    without_object,
)
from baggie.learning.labels import Labels
from baggie.policies.keypoint.plan import CELLS_TO_INPUT, LONG
from baggie.policies.keypoint.policy import KeypointPolicy
from baggie.types import Attempt, Goal, Image

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
        boxes = [view.to_input(attempt.box_before) for attempt in attempts]
        self._masks = [
            object_mask(picture, box) if np.isfinite(box).all() else None
            for picture, box in zip(self._pictures, boxes, strict=True)
        ]
        self._tables = [
            None if mask is None else without_object(picture, mask)
            for picture, mask in zip(self._pictures, self._masks, strict=True)
        ]
        self._goals = [view.goal_to_input(goal_of(attempt)) for attempt in attempts]
        with torch.no_grad():
            normalized = to_robot.inverse(torch.from_numpy(labels.xy).float())
            jacobian = to_robot.jacobian(normalized[:, 0]).double().numpy()
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
        before = shape = as_it_is(float(self._yaw[number]), int(self._symmetry[number]))
        if mask is None or table is None:
            return picture, shape
        new_look = rng.random() < self._changes.new_looks
        if new_look and rng.random() < _RESHAPED:
            shape = reshaped(rng, shape, self._jacobian[number], LONG)
        shape = turned(rng, shape, self._jacobian[number])
        if shape is not before:
            picture, mask = with_shape(picture, table, mask, self._points[number, 0], shape)
        if new_look:
            picture = random_look(rng, picture, table, mask)
        return picture, shape
