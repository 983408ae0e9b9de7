"""The `transporter` policy: from the table as seen from straight above, or rectified to that, to pick and place.

Where it is unsure it looks at the map turned by quarter turns, too: exactly, as no pixel falls between others.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Self, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from baggie.calibration.image_to_robot.rectify import Rectifier
from baggie.errors import BaggieError
from baggie.geometry import FloatArray, Grid, PlanarPose, wrap_angle
from baggie.policies.checkpoint import at_training_size
from baggie.policies.learned import LearnedPolicy
from baggie.policies.planning import GoalInput, require_on_table
from baggie.policies.transporter.config import TransporterConfig
from baggie.policies.transporter.network import Decision, TransporterNet
from baggie.policies.transporter.scores import PlaceAngle, Scores
from baggie.types import (
    LAYER_M,
    Goal,
    Image,
    Observation,
    PickPlace,
    Plan,
    require_goal,
    require_observation,
)
from baggie.vision.draw import region_mask

Pixels = TypeVar("Pixels", bound=np.generic)


def quarter_turned(pixels: NDArray[Pixels], quarters: int) -> NDArray[Pixels]:
    """Pixels `(H, W)` or `(H, W, C)` of a map, turned by so many quarters from v towards u."""
    return np.ascontiguousarray(np.rot90(pixels, quarters))


def turned_back(decision: Decision, quarters: int, shape: tuple[int, int]) -> Decision:
    """What a decision about a map `quarter_turned` by so many quarters says of the map itself, whose `shape` is (H, W).

    The pick's yaw is the least of those that look alike; 0, as it was, where no look was about it.
    """
    pick, place = decision.pick, decision.place
    yaw = pick.angle
    for look in decision.picks:
        if look.logits.shape[1] > 1:
            part = 2 * math.pi / max(look.fold, 1)
            yaw = torch.remainder(yaw + quarters * math.pi / 2 + part / 2, part) - part / 2
    return Decision(
        PlaceAngle(_place_back(pick.place, quarters, shape), yaw),
        PlaceAngle(_place_back(place.place, quarters, shape), place.angle),
        [_scores_back(look, quarters, shape) for look in decision.picks],
        [_scores_back(look, quarters, shape) for look in decision.places],
    )


def _scores_back(look: Scores, quarters: int, shape: tuple[int, int]) -> Scores:
    height, width = look.logits.shape[-2:]
    reach = look.stride * look.origin.new_tensor([width - 1, height - 1])
    corners = torch.stack([_place_back(at, quarters, shape) for at in (look.origin, look.origin + reach)])
    return look._replace(logits=torch.rot90(look.logits, -quarters, (2, 3)), origin=corners.amin(dim=0))


def _place_back(place: Tensor, quarters: int, shape: tuple[int, int]) -> Tensor:
    """Places `(B, 2)` (u, v) of a turned map in the map itself."""
    rows, columns = shape
    u, v = place.unbind(dim=-1)
    back = {
        0: (u, v),
        1: (columns - 1 - v, u),
        2: (columns - 1 - u, rows - 1 - v),
        3: (v, rows - 1 - u),
    }[quarters % 4]
    return torch.stack(back, dim=-1)


_SURE = 0.8
"""Of a place: surer than that is right nearly always."""
_TRIED_PX = 4.0
"""Around a pick that came to nothing; the next one is as far away as a thing is wide."""
_POINTED_M = 0.05
"""A bag that is pointed at is looked for so near: half of it shows beside one that lies on it."""
_FAINT = 0.001
"""Of the peak of a heat map: where nothing is brighter, no bag lies that can be picked."""


@dataclass(frozen=True)
class Scale:
    """What demonstrations showed of the sizes of things and of how exactly they land."""

    highest_m: float = math.inf
    """Nothing higher is picked."""
    lands_within_px: float = 3.0
    """How far from where it was to go a thing lies that was well placed."""

    def config(self) -> dict[str, float]:
        """Give the sizes in plain YAML types; nothing where nothing is known."""
        return (
            {} if self == UNKNOWN else {"highest_m": self.highest_m, "lands_within_px": self.lands_within_px}
        )

    @classmethod
    def of(cls, model: Mapping[str, Any]) -> Self:
        """The inverse of `config`, for older versions' models, too."""
        known = {each.name: float(model[each.name]) for each in fields(cls) if each.name in model}
        return cls(**known)


UNKNOWN = Scale()


class TransporterPolicy(LearnedPolicy):
    """Looks at orthographic pictures with height (`baggie.vision.height_map`): cameras with depth, and calibrated.

    Maps may be of any size, with pixels as large as those it was trained on. With a `rectifier` it looks at one
    camera's own pictures, which it rectifies to its grid; then everything has a height of 0. Where that knows layers,
    from a recording of stacks, the network still sees and says places in the rectified picture: a bag's layer tells
    where the robot has what appears there.
    """

    name = "transporter"
    network: TransporterNet

    def __init__(
        self,
        network: TransporterNet,
        grid: Grid,
        cell: int,
        goal_input: GoalInput | None = None,
        rectifier: Rectifier | None = None,
        *,
        scale: Scale = UNKNOWN,
    ) -> None:
        """`grid`: of its training maps; `goal_input`: how goals are painted, None for a task that marks no goal.

        `rectifier`: to this grid, of the training pictures; None for one that is given height maps. `scale`: of what
        was demonstrated.
        """
        rows, columns = grid.shape
        super().__init__(network, (columns, rows) if rectifier is None else rectifier.size, cell)
        self.grid, self.goal_input, self.rectifier = grid, goal_input, rectifier
        self.scale = scale
        self.wants_goal = goal_input is not None

    @property
    def knows_layers(self) -> bool:
        """Whether it learned from stacks."""
        return self.rectifier is not None and self.rectifier.leaning is not None

    def model_config(self) -> dict[str, Any]:
        """The network's kind, the grid, how goals get into its input, and what a camera sees of the grid."""
        grid = {"x": list(self.grid.x), "y": list(self.grid.y), "z": list(self.grid.z)}
        return {
            "network": self.network.config.config(),
            "grid": {**grid, "pixel_m": self.grid.pixel_m},
            "goal": None if self.goal_input is None else self.goal_input.config(),
            "camera": None if self.rectifier is None else self.rectifier.config(),
            **self.scale.config(),
        }

    @classmethod
    def build(cls, model: Mapping[str, Any], picture_size: tuple[int, int], cell: int) -> Self:
        """The policy with an untrained network. Of height maps, the picture's size follows from the grid."""
        x, y, z = (tuple(map(float, model["grid"][axis])) for axis in "xyz")
        grid = Grid(x, y, z, float(model["grid"]["pixel_m"]))  # type: ignore[arg-type]  # pairs, of floats
        goal_input = None if model["goal"] is None else GoalInput.of(model["goal"])
        camera = model["camera"]
        rectifier = None if camera is None else Rectifier.from_config(camera, picture_size, grid)
        network = TransporterNet(TransporterConfig.of(model["network"]))
        return cls(network, grid, cell, goal_input, rectifier, scale=Scale.of(model))

    def plan(self, observation: Observation, goal: Goal | None = None) -> Plan:
        """Where to pick and where to place, metres and radians in the robot's base frame.

        A suction cup picks at yaw 0; the place's yaw is the pick's and the turn between them. Of the angles that look
        the same (`TransporterConfig.symmetry`) the turn is the least, and so is a gripper's yaw at the pick. Confidence
        is the share of the heat maps' weight within two cells of their peaks, the smaller of the two: among things that
        are as good to pick it is shared. A goal is painted into the colours as in training. Views are of the whole map,
        or over the camera's own picture where that was rectified. Where it knows layers it picks what is pointed at,
        else nothing under the goal, and heights are counted by the goal's layers.
        Raises `BaggieError` where there is no height map, one with other pixels than it was trained on, or no goal
        where it needs one; of a camera's own picture, where it has another shape than those it was trained on, or the
        goal, or what is pointed at, leaves it or the grid, or a layer is above the table and it knows that only; and
        where no bag is seen that is pointed at.
        """
        straight, goal = self._rectified(require_observation(observation), goal)
        grid, height = self._checked(straight)
        color = self.painted(straight.color, goal)
        barred, elsewhere = self.barred(height, straight.tried), np.zeros(height.shape, np.bool_)
        if self.knows_layers and goal is not None:
            if goal.object_at is None:  # what its patch hides is a bag that lies there already, if any
                barred |= region_mask(goal.corners, straight.size) > 0
            else:
                elsewhere = _distances(height.shape, goal.object_at) > _POINTED_M / grid.pixel_m
        decision = self.decide(color, height, barred, elsewhere)
        pointed = self._pointed(decision, elsewhere)[0]
        _require_in_sight(decision.picks[0], pointed)
        pick_xy, place_xy = (
            grid.to_robot(found.place.double().cpu().numpy())[0] for found in (decision.pick, decision.place)
        )
        pick_yaw, turn = float(decision.pick.angle[0]), float(decision.place.angle[0])
        pick = PlanarPose(float(pick_xy[0]), float(pick_xy[1]), pick_yaw)
        place = PlanarPose(float(place_xy[0]), float(place_xy[1]), wrap_angle(pick_yaw + turn))
        where = {"pick": decision.picks[0], "place": decision.places[0]}
        sure = min(float(scores.share()[0]) for scores in (pointed, decision.places[0]))
        views = {name: _over_map(scores, height.shape) for name, scores in where.items()}
        if self.rectifier is not None:
            views = {name: self.rectifier.over_picture(view) for name, view in views.items()}
        return Plan(self._there(pick, place, goal), min(max(sure, 0.0), 1.0), views=views)

    def _there(self, pick: PlanarPose, place: PlanarPose, goal: Goal | None) -> PickPlace:
        """The action whose pick and place appear at these poses from straight above, by the goal's layers."""
        leaning = None if self.rectifier is None else self.rectifier.leaning
        if goal is None or leaning is None:
            return PickPlace(pick, place)
        pick, place = leaning.there(pick, goal.object_layer), leaning.there(place, goal.layer)
        return PickPlace(pick, place, goal.object_layer * LAYER_M, goal.layer * LAYER_M)

    def painted(self, color: Image, goal: Goal | None) -> Image:
        """The colours `(H, W, 3)` with the goal in them. Raises `BaggieError` where it is missing or leaves the map."""
        if self.goal_input is not None:
            goal = require_goal(goal)
        if goal is None:
            return color
        drawn = self.goal_input or GoalInput("painted")
        return drawn.network_input(color, goal).transpose(1, 2, 0)

    def barred(self, height: NDArray[np.float32], tried: FloatArray) -> NDArray[np.bool_]:
        """`(H, W)`: where not to pick: what is too high to be one of the things, such as an arm, and what was tried.

        Raises `BaggieError` where nothing is left.
        """
        barred = height > self.scale.highest_m
        for at in tried:
            barred |= _distances(height.shape, at) <= _TRIED_PX
        if barred.all():
            raise BaggieError(
                "expected a place to pick at, got a map where all is too high or was tried in vain"
            )
        return np.asarray(barred)

    def decide(
        self,
        color: Image,
        height: NDArray[np.float32],
        barred: NDArray[np.bool_] | None = None,
        elsewhere: NDArray[np.bool_] | None = None,
    ) -> Decision:
        """Run the network on one map: `(H, W, 3)` uint8 with the goal in it, `(H, W)` metres.

        Where `fast` is unsure of the place, it looks at the map turned by each quarter, too, and what it is surest of
        counts: it has learned from examples that a scene means the same however it is turned, and is at times mistaken.
        `barred` `(H, W)`: where not to pick; `elsewhere` `(H, W)`: where what is pointed at is not.
        """
        nowhere = np.zeros(height.shape, np.bool_)
        barred, elsewhere = (nowhere if where is None else where for where in (barred, elsewhere))
        straight = self._decide(color, height, barred, elsewhere)
        if self.network.config.preset == "paper" or _sure(straight.places) >= _SURE:
            return straight
        others = []
        for quarters in (1, 2, 3):
            there = self._decide(
                quarter_turned(color, quarters),
                quarter_turned(height, quarters),
                quarter_turned(barred, quarters),
                quarter_turned(elsewhere, quarters),
            )
            others.append(turned_back(there, quarters, height.shape))
        return max(
            [straight, *others],
            key=lambda each: _sure(self._pointed(each, elsewhere)) * _sure(each.places),
        )

    def _pointed(self, decision: Decision, elsewhere: NDArray[np.bool_]) -> list[Scores]:
        """The looks for the pick, the first without what lies `elsewhere` `(H, W)`."""
        first, *finer = decision.picks
        return [first.without(torch.from_numpy(elsewhere)[None].to(self.device)), *finer]

    def _decide(
        self,
        color: Image,
        height: NDArray[np.float32],
        barred: NDArray[np.bool_],
        elsewhere: NDArray[np.bool_],
    ) -> Decision:
        colors = torch.from_numpy(np.ascontiguousarray(color.transpose(2, 0, 1)))[None]
        heights = torch.from_numpy(np.array(height, np.float32))[None]  # a copy: the map may be read-only
        self.network.eval()
        with torch.inference_mode():
            masks = (torch.from_numpy(mask)[None].to(self.device) for mask in (barred, elsewhere))
            return self.network.decide(colors.to(self.device), heights.to(self.device), *masks)

    def _rectified(self, observation: Observation, goal: Goal | None) -> tuple[Observation, Goal | None]:
        """A camera's own picture and the goal in it as they are from straight above; a height map as it is."""
        if self.rectifier is None:
            return observation, goal
        goal = require_goal(goal)
        if not self.knows_layers:
            require_on_table(goal, self.name)  # the picture is rectified at one height
        picture, goal = at_training_size(observation, goal, self.picture_size, self.camera_size)
        self._require_on_grid(self.rectifier, goal.corners, "a goal")
        if self.knows_layers and goal.object_at is not None:
            self._require_on_grid(self.rectifier, np.array([goal.object_at]), "a bag pointed at")
        return self.rectifier.observation(picture), self.rectifier.goal(goal)

    def _require_on_grid(self, rectifier: Rectifier, pixels: FloatArray, what: str) -> None:
        """Raise `BaggieError` where one of `(N, 2)` pixels of the camera's picture shows no place of the grid."""
        if not rectifier.contains(pixels):
            (u, v), grid = pixels.mean(axis=0), self.grid
            raise BaggieError(
                f"expected {what} on the part of the table it was trained on, x {grid.x[0]:.2f} to {grid.x[1]:.2f} m "
                f"and y {grid.y[0]:.2f} to {grid.y[1]:.2f} m, got one at pixel ({u:.0f}, {v:.0f}) that leaves it; "
                "choose one nearer to the workspace's middle, or collect there"
            )

    def _checked(self, observation: Observation) -> tuple[Grid, NDArray[np.float32]]:
        grid, height = observation.grid, observation.height
        if grid is None or height is None:
            raise BaggieError(
                "expected a picture from straight above, with a grid and heights, got a camera's own; "
                "fuse what calibrated cameras with depth see, with baggie.vision.height_map.fuse"
            )
        if not np.isclose(grid.pixel_m, self.grid.pixel_m, rtol=1e-6) or grid.z[0] != self.grid.z[0]:
            raise BaggieError(
                f"expected pixels of {self.grid.pixel_m} m and heights from z = {self.grid.z[0]} m, as in training, "
                f"got {grid.pixel_m} m and z = {grid.z[0]} m; fuse over the grid it was trained on"
            )
        if not observation.color.shape[:2] == height.shape == grid.shape:
            raise BaggieError(
                f"expected colours and heights of the grid's {grid.shape[1]} x {grid.shape[0]} pixels, got "
                f"{observation.color.shape[1]} x {observation.color.shape[0]} and {height.shape[1]} x "
                f"{height.shape[0]}; give all three from one height map"
            )
        return grid, height


def _require_in_sight(whole: Scores, pointed: Scores) -> None:
    """Raise `BaggieError` where, as the first look for the pick says, no bag lies where one was pointed at."""
    faint = float((pointed.logits.max() - whole.logits.max()).exp())
    if not faint >= _FAINT:
        raise BaggieError(
            f"no bag in sight where one was pointed at: the heat map there is at {faint:.1%} of its peak; point at the "
            "middle of a bag on which no other lies"
        )


def _distances(shape: tuple[int, ...], at: FloatArray | tuple[float, float]) -> FloatArray:
    """`(H, W)`: how far all pixels of a map of this shape are from a point (u, v), pixels."""
    v, u = np.mgrid[: shape[0], : shape[1]]
    return np.asarray(np.hypot(u - at[0], v - at[1]), float)


def _sure(looks: Sequence[Scores]) -> float:
    """How much of the weight is near the peaks of all of these looks."""
    return math.prod(float(look.share()[0]) for look in looks)


def _over_map(scores: Scores, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """The heat of the first look at the map's own size, its peak at 1: `(H, W)`."""
    heat: Tensor = scores.heat()[0]
    heat = heat / heat.max()
    # Of a map that was turned the cells need not begin at a corner.
    first = ((scores.stride - 1) / 2 - scores.origin[0]).round().long().tolist()
    u, v = (
        ((torch.arange(size, device=heat.device) + off) // scores.stride).clamp(0, cells - 1)
        for size, off, cells in zip(shape[::-1], first, heat.shape[::-1], strict=True)
    )
    return np.ascontiguousarray(heat[v[:, None], u].cpu().numpy(), np.float32)
