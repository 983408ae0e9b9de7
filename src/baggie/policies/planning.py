"""How `keypoint` and `regression` plan, whatever runs their networks: what goes in, and the plan that follows.

Nothing here needs PyTorch.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from baggie.errors import BaggieError
from baggie.geometry import FloatArray, PlanarPose, apply_homography
from baggie.options.values import DrawnStyle
from baggie.policies.checkpoint import at_training_size
from baggie.types import LAYER_M, Goal, Image, Observation, PickPlace, Plan, require_observation
from baggie.vision.draw import paint_goal, region_mask, without_card

_STRIDE = 8
"""The input's sides are multiples of this, so that a U-Net can halve them three times."""


@dataclass(frozen=True)
class View:
    """A rectangle of the picture, resized: an overhead camera sees far more than the workspace.

    Coordinates: *pixels* of the picture, *input pixels* of the network, and the *normalised* picture, whose
    centre is (0, 0) and whose left and right edges are at u = -1 and 1.
    """

    picture: tuple[int, int]
    """`(width, height)` of the camera's picture, pixels."""
    left: int
    top: int
    right: int
    bottom: int
    """The rectangle, pixels; right and bottom are the first column and row outside."""
    size: tuple[int, int]
    """`(width, height)` of the network's input."""

    @classmethod
    def around(
        cls, points: FloatArray, picture: tuple[int, int], side: int = 160, margin: float = 0.1
    ) -> View:
        """The rectangle that holds `points` `(N, 2)` pixels, wider by `margin` of its size on every side.

        The input's longer side gets `side` pixels.
        """
        low, high = points.min(axis=0), points.max(axis=0)
        spare = margin * (high - low)
        left, top = np.clip(np.floor(low - spare), 0, None).astype(int)
        right, bottom = np.clip(np.ceil(high + spare) + 1, 1, picture).astype(int)
        extent = np.array([right - left, bottom - top])
        width, height = np.maximum(np.round(side * extent / extent.max() / _STRIDE).astype(int), 1) * _STRIDE
        return cls(picture, int(left), int(top), int(right), int(bottom), (int(width), int(height)))

    def cut(self, picture: Image) -> Image:
        """`(H, W, 3)` picture -> `(h, w, 3)` network input."""
        part = picture[self.top : self.bottom, self.left : self.right]
        return np.asarray(cv2.resize(part, self.size, interpolation=cv2.INTER_AREA), np.uint8)

    def from_input(self) -> FloatArray:
        """`(3, 3)`: input pixels -> pixels, both with centres at integers."""
        su = (self.right - self.left) / self.size[0]
        sv = (self.bottom - self.top) / self.size[1]
        return np.array(
            [[su, 0, self.left + su / 2 - 0.5], [0, sv, self.top + sv / 2 - 0.5], [0.0, 0.0, 1.0]]
        )

    def normalize(self) -> FloatArray:
        """`(3, 3)`: pixels -> the normalised picture."""
        half = self.picture[0] / 2
        return np.array(
            [
                [1 / half, 0, (0.5 - self.picture[0] / 2) / half],
                [0, 1 / half, (0.5 - self.picture[1] / 2) / half],
                [0.0, 0.0, 1.0],
            ]
        )

    def to_input(self, points: FloatArray) -> FloatArray:
        """`(N, 2)` pixels -> `(N, 2)` input pixels."""
        return apply_homography(np.linalg.inv(self.from_input()), points)

    def goal_to_input(self, goal: Goal) -> Goal:
        """A goal in pixels -> in input pixels."""
        return replace(goal, corners=self.to_input(goal.corners))

    def config(self) -> dict[str, Any]:
        """Give the view in plain YAML types; the picture's size is kept elsewhere."""
        edges = {"left": self.left, "top": self.top, "right": self.right, "bottom": self.bottom}
        return {**edges, "size": list(self.size)}

    @classmethod
    def of(cls, config: Mapping[str, Any], picture: tuple[int, int]) -> Self:
        """The inverse of `config`, for a picture of `(width, height)` pixels."""
        width, height = (int(value) for value in config["size"])
        edges = {key: int(config[key]) for key in ("left", "top", "right", "bottom")}
        return cls(picture, **edges, size=(width, height))

    def contains(self, points: FloatArray) -> bool:
        """Whether all points `(N, 2)` pixels lie in the rectangle."""
        low, high = np.array([self.left, self.top]) - 0.5, np.array([self.right, self.bottom]) - 0.5
        return bool(((points >= low) & (points <= high)).all())


Float32 = NDArray[np.float32]

CELL = 2
"""A cell of the heat maps is this many pixels of the network's input wide and high."""
CELLS_TO_INPUT: FloatArray = np.array(
    [[CELL, 0.0, (CELL - 1) / 2], [0.0, CELL, (CELL - 1) / 2], [0.0, 0.0, 1.0]]
)
"""`(3, 3)`: cells of the heat maps -> pixels of the network's input, centres at integers in both."""

_IN_SIGHT = 0.15
"""With a bag in sight this share of the pick's heat map, and far more, is at its peak; on an empty table, 0.05."""
_SPREAD_OUT = 0.35
"""Of a heat map's cells: eight bags in sight spread it over as many as 12% of them, an empty table over 75%."""
_VIEW_SCALE = 4
"""Heat maps are shown at a quarter of the picture's size."""
POINTED_CELLS = 10.0
"""An object that is pointed at is looked for within so many cells: some 10 cm on a table, less than to the next bag."""
STACKED_CELLS = 5.0
"""The same in stacks, where half of a bag shows beside the one that lies on it."""
ANYWHERE_CELLS = 1e4
"""More than there are."""
LONG_RATIO = 1.25
"""What is seen so many times longer than wide, an object or a goal, is long."""


class Reading(NamedTuple):
    """What the network says of one picture; K = 2 are (pick, place)."""

    xy: Float32
    """`(K, 2)` metres, robot base frame."""
    yaw: Float32
    """`()`: of the object, radians; 0 where it looks the same at any angle."""
    symmetry: Float32
    """`()`: how often a turn it looks the same: 4, 2, or 0 for at any angle."""
    share: Float32
    """`(K,)`: of the heat maps' weight near their points."""
    within_m: Float32
    """`(K,)`: radii that hold the truth nine times of ten; 0 where nobody measured."""
    heat: Float32
    """`(K, h, w)`: each map sums to 1."""
    goal_xy: Float32
    """`(N, 2)`: the goal's corners on the table, metres."""


KeypointRead = Callable[[NDArray[np.uint8], Float32, Float32, Float32], Reading]
"""Runs the network: `(1, C, H, W)` images, `(3,)` near, `(N, 2)` corners, `(2,)` layers; see `KeypointReader`."""


@dataclass(frozen=True)
class GoalInput:
    """How a goal gets into the network's input."""

    kind: Literal["region", "painted"] = "region"
    """`region`: as a fourth channel, however it is drawn; `painted`: in the picture's own colours, as published."""
    style: DrawnStyle = "solid"
    color: tuple[int, int, int] = (0, 200, 0)
    """Style and RGB colour of painted goals."""

    @property
    def channels(self) -> int:
        """Channels of the network's input."""
        return 4 if self.kind == "region" else 3

    def network_input(self, cut: Image, goal: Goal) -> Image:
        """A view `(H, W, 3)` and the goal in its pixels -> `(C, H, W)` uint8.

        A `region` is learned where nothing lies: a real card is taken out of the picture, or it might be picked.
        """
        if self.kind == "painted":
            drawn = goal if goal.style == "card" else Goal(goal.corners, self.style, self.color)
            return np.ascontiguousarray(paint_goal(cut, drawn).transpose(2, 0, 1))
        height, width = cut.shape[:2]
        if goal.style == "card":
            cut = without_card(cut, goal.corners)
        return np.concatenate([cut.transpose(2, 0, 1), region_mask(goal.corners, (width, height))[None]])

    def config(self) -> dict[str, Any]:
        """Give the settings in plain YAML types."""
        return {"kind": self.kind, "style": self.style, "color": list(self.color)}

    @classmethod
    def of(cls, config: dict[str, Any]) -> GoalInput:
        """Build it from what `config` gives."""
        red, green, blue = (int(value) for value in config["color"])
        return cls(config["kind"], config["style"], (red, green, blue))


def to_picture(view: View) -> FloatArray:
    """`(3, 3)`: cells of an unwarped image's heat maps -> the normalised picture."""
    return view.normalize() @ view.from_input() @ CELLS_TO_INPUT


def keypoint_plan(
    read: KeypointRead,
    view: View,
    goal_input: GoalInput,
    observation: Observation,
    goal: Goal,
    *,
    camera_size: tuple[int, int],
    knows_layers: bool = False,
) -> Plan:
    """Where to pick and where to place, by a network whose training pictures a camera took at `camera_size` pixels.

    The pick's yaw is that of the object's sides, the long ones where it has any; the place's that of the goal's, turned
    by whole symmetries so that the hand turns least. Confidence is the share of the heat maps' weight near the points,
    the smaller of the two. A network that knows layers (`knows_layers`) knows several bags: where nobody points at one,
    it takes the one at the heat map's peak, and says how sure it is of where that is. Heights are counted by the goal's
    layers. Raises `BaggieError` when no bag is in sight, when the goal, or what is pointed at, lies outside the part of
    the picture in which the training attempts took place, and for layers above the table unless the network knows them.
    """
    size = require_observation(observation).size
    if not knows_layers:
        require_on_table(goal, "keypoint")
    picture, goal = at_training_size(observation, goal, view.picture, camera_size)
    _check_view(view, goal.corners, "the goal", size)
    near = np.array([0.0, 0.0, ANYWHERE_CELLS], np.float32)
    pointed_cells = STACKED_CELLS if knows_layers else POINTED_CELLS
    if goal.object_at is not None:
        _check_view(view, np.array([goal.object_at]), "the object pointed at", size)
        cell = apply_homography(np.linalg.inv(view.from_input() @ CELLS_TO_INPUT), [goal.object_at])[0]
        near = np.array([*cell, pointed_cells], np.float32)
    image = goal_input.network_input(view.cut(picture), view.goal_to_input(goal))
    corners = apply_homography(view.normalize(), goal.corners).astype(np.float32)
    layers = np.array([goal.object_layer, goal.layer], np.float32)
    found = read(image[None], near, corners, layers)
    share, heat = found.share[0], found.heat[0]  # of the whole picture, which the views show
    in_sight = share >= _IN_SIGHT
    if knows_layers and goal.object_at is None:
        # Several bags that can be picked share the heat map; the one at its peak is as if it were pointed at.
        in_sight = 1 / np.square(heat).sum() < _SPREAD_OUT * heat.size
        v, u = np.unravel_index(heat.argmax(), heat.shape)
        found = read(image[None], np.array([u, v, pointed_cells], np.float32), corners, layers)
    if not in_sight:
        raise BaggieError(
            f"no bag in sight: only {share:.0%} of the heat map is at its peak; put one into the workspace"
        )
    sure = float(found.share.min())
    pick = PlanarPose(float(found.xy[0, 0]), float(found.xy[0, 1]), float(found.yaw))
    yaw = place_yaw(found.goal_xy.astype(float), int(found.symmetry), pick.yaw)
    place = PlanarPose(float(found.xy[1, 0]), float(found.xy[1, 1]), yaw)
    views = {"pick": _over_picture(view, heat), "place": _over_picture(view, found.heat[1])}
    pick_within, place_within = (float(r) if r > 0 else None for r in found.within_m)
    action = PickPlace(pick, place, goal.object_layer * LAYER_M, goal.layer * LAYER_M)
    return Plan(action, min(sure, 1.0), pick_within, place_within, views)


def require_on_table(goal: Goal, name: str) -> None:
    """Raise `BaggieError` where a goal has to do with stacks, for a policy of this name that knows the table only."""
    if goal.layer or goal.object_layer:
        raise BaggieError(
            f"expected a policy that learned from stacks, as the goal takes a bag from layer {goal.object_layer} to "
            f"layer {goal.layer}, got a {name} policy that knows the table only; collect bag-stack and train keypoint "
            "or transporter on it"
        )


def place_yaw(corners: FloatArray, symmetry: int, pick_yaw: float) -> float:
    """The yaw at which an object lies along the sides of a goal with these corners `(N, 2)` on the table, radians.

    Long on long, where both are; else to the nearest quarter turn. Of those that look the same, the one nearest to the
    yaw it is picked at. Corners of what is seen askew, or stands up from the table, are sheared: half of that is the
    most it turns, since both directions of sides count by their length.
    """
    x, y = (np.roll(corners, -1, axis=0) - corners).T
    length, direction = np.hypot(x, y), np.arctan2(y, x)
    yaw = float(np.angle((length * np.exp(4j * direction)).sum())) / 4
    # Twice how far it reaches along this yaw and across it. Sheared, a square reaches as far either way.
    along = float((length * np.abs(np.cos(direction - yaw))).sum())
    across = float((length * np.abs(np.sin(direction - yaw))).sum())
    turn = math.pi / 2
    if symmetry == 2 and max(along, across) > LONG_RATIO * min(along, across):
        yaw, turn = yaw + (math.pi / 2 if across > along else 0.0), math.pi
    return yaw + turn * round((pick_yaw - yaw) / turn)


def _check_view(view: View, points: FloatArray, what: str, size: tuple[int, int]) -> None:
    """Raises `BaggieError`, in pixels of the picture that was given, which may be larger than those of the training."""
    if not view.contains(points):
        pixels = np.array([points.mean(axis=0), (view.left, view.top), (view.right, view.bottom)])
        (u, v), (left, top), (right, bottom) = (pixels + 0.5) * np.array(size) / view.picture - 0.5
        raise BaggieError(
            f"{what} at ({u:.0f}, {v:.0f}) is outside of what the training attempts covered, u {left:.0f}.."
            f"{right:.0f} and v {top:.0f}..{bottom:.0f} of {size[0]} x {size[1]} pixels: "
            "choose one nearer to the workspace's middle, or collect there"
        )


def _over_picture(view: View, heat: Float32) -> Float32:
    """A heat map `(h, w)` of the view -> of the whole picture, a quarter its size, greatest value 1."""
    width, height = (side // _VIEW_SCALE for side in view.picture)
    offset = (1 / _VIEW_SCALE - 1) / 2
    shrink = np.array([[1 / _VIEW_SCALE, 0, offset], [0, 1 / _VIEW_SCALE, offset], [0, 0, 1]])
    place = shrink @ view.from_input() @ CELLS_TO_INPUT
    return np.asarray(cv2.warpAffine(heat / heat.max(), place[:2], (width, height)), np.float32)


REGRESSION_SIDE = 224
"""The network's input is this many pixels wide and high, whatever the shape of the picture."""

RegressionRead = Callable[[NDArray[np.uint8]], NDArray[np.float32]]
"""Runs the network: `(1, 3, 224, 224)` images -> `(1, 2, 2)`: (pick, place) x (x, y), metres."""


def regression_goal_input(model: Mapping[str, Any]) -> GoalInput:
    """How goals are painted, by a config's `model`."""
    red, green, blue = (int(value) for value in model["goal_color"])
    return GoalInput("painted", model["goal_style"], (red, green, blue))


def regression_input(drawn: GoalInput, picture: Image, goal: Goal) -> Image:
    """A picture and its goal -> `(3, 224, 224)` uint8 with the goal painted in it."""
    small = np.asarray(
        cv2.resize(picture, (REGRESSION_SIDE, REGRESSION_SIDE), interpolation=cv2.INTER_AREA), np.uint8
    )
    height, width = picture.shape[:2]
    return drawn.network_input(small, goal.scaled(REGRESSION_SIDE / width, REGRESSION_SIDE / height))


def regression_plan(
    read: RegressionRead,
    drawn: GoalInput,
    picture_size: tuple[int, int],
    observation: Observation,
    goal: Goal,
    *,
    camera_size: tuple[int, int],
) -> Plan:
    """Pick and place positions; yaw 0 and confidence 1, as it has no word on either.

    `picture_size`: `(width, height)` of the training pictures, which a camera took at `camera_size`; pixels. Raises
    `BaggieError` as `at_training_size` does, and for layers above the table.
    """
    require_on_table(goal, "regression")
    image = regression_input(drawn, *at_training_size(observation, goal, picture_size, camera_size))
    pick, place = read(image[None])[0]
    return Plan(PickPlace(PlanarPose(*map(float, pick)), PlanarPose(*map(float, place))))
