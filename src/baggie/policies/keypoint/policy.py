"""The `keypoint` policy: a U-Net with two soft-argmax heads finds bag and goal, a learned map says where that is.

What is computed from the network for a plan is the module `KeypointReader`: PyTorch runs it, or onnxruntime its export.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any, NamedTuple, Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional as F

from baggie.calibration.files import CameraIdentity
from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.geometry import FloatArray, apply_homography
from baggie.options.values import Backbone
from baggie.policies.keypoint.heads import (
    CHANNELS,
    PlanarMap,
    apply_homographies,
    certain_yaw,
    edge_phases,
    heat_maps,
    homography_jacobian,
    local_soft_argmax,
    picked_near,
    squared_distances,
)
from baggie.policies.learned import LearnedPolicy
from baggie.policies.planning import CELL, Float32, GoalInput, Reading, View, keypoint_plan, to_picture
from baggie.policies.regression import IMAGENET_MEAN, IMAGENET_STD, ResNet18
from baggie.types import Goal, Observation, Plan, require_goal


class Features(NamedTuple):
    """Channels by scale; each scale has half the rows and columns of the one before."""

    fine: Tensor
    """`(B, C, H / 2, W / 2)`."""
    middle: Tensor
    """`(B, C, H / 4, W / 4)`."""
    coarse: Tensor
    """`(B, C, H / 8, W / 8)`."""


class SmallFeatures(nn.Module):
    """Six convolutions. The four pixels of a cell become channels, so the first works at half size already."""

    def __init__(self, channels: int, width: int) -> None:
        """`channels`: of the input; `width`: at the finest scale, twice as many below."""
        super().__init__()
        double = 2 * width
        self.sizes = (width, double, double)
        self.stem = convolution_block(channels * CELL**2, width)
        self.down1 = nn.Sequential(convolution_block(width, double), convolution_block(double, double))
        self.down2 = nn.Sequential(
            convolution_block(double, double),
            convolution_block(double, double),
            convolution_block(double, double),
        )

    def forward(self, images: Tensor) -> Features:
        """`(B, C, H, W)`, values -0.5 to 0.5."""
        x = F.pixel_unshuffle(images, CELL).contiguous(memory_format=torch.channels_last)
        fine = self.stem(x)
        middle = self.down1(F.max_pool2d(fine, 2))
        return Features(fine, middle, self.down2(F.max_pool2d(middle, 2)))


class ResNetFeatures(nn.Module):
    """The first three scales of a ResNet-18, for its published weights; what is no colour has a path of its own."""

    mean: Tensor
    std: Tensor

    def __init__(self, channels: int) -> None:
        """`channels`: of the input, of which the first three are red, green and blue."""
        super().__init__()
        self.sizes = (64, 64, 128)
        resnet = ResNet18()
        self.conv1, self.bn1, self.maxpool = resnet.conv1, resnet.bn1, resnet.maxpool
        self.layer1, self.layer2 = resnet.layer1, resnet.layer2
        self.beside_color = convolution_block((channels - 3) * CELL**2, 64) if channels > 3 else None
        self.register_buffer("mean", torch.tensor(IMAGENET_MEAN).view(3, 1, 1) - 0.5, persistent=False)
        self.register_buffer("std", torch.tensor(IMAGENET_STD).view(3, 1, 1), persistent=False)

    def load_imagenet(self, weights: dict[str, Tensor]) -> None:
        """Take over published weights by name, as `resnet.load_imagenet` reads them, but for the deepest scales."""
        own = self.state_dict()
        self.load_state_dict(own | {name: tensor for name, tensor in weights.items() if name in own})

    def forward(self, images: Tensor) -> Features:
        """`(B, C, H, W)`, values -0.5 to 0.5."""
        color = ((images[:, :3] - self.mean) / self.std).contiguous(memory_format=torch.channels_last)
        fine = F.relu(self.bn1(self.conv1(color)))
        if self.beside_color is not None:
            fine = fine + self.beside_color(F.pixel_unshuffle(images[:, 3:], CELL))
        middle = self.layer1(self.maxpool(fine))
        return Features(fine, middle, self.layer2(middle))


def convolution_block(inputs: int, outputs: int) -> nn.Sequential:
    """A 3 x 3 convolution, batch normalisation, ReLU."""
    convolution = nn.Conv2d(inputs, outputs, 3, padding=1, bias=False)
    return nn.Sequential(convolution, nn.BatchNorm2d(outputs), nn.ReLU(inplace=True))


PEAK_RADIUS = 8.0
"""Cells around a heat map's greatest value that decide where its point is."""
FAR = 12.0
"""Cells: weight further than this from the point counts as this far, when it comes to how unsure the map is."""


class Keypoints(NamedTuple):
    """What the network says about B pictures; axes of length K = 2 are (pick, place)."""

    xy: Tensor
    """`(B, K, 2)` metres in the robot's base frame."""
    jacobian: Tensor
    """`(B, K, 2, 2)`: d xy / d cells at the points."""
    logits: Tensor
    """`(B, K, h, w)`: their softmax over the cells is the heat map."""
    cells: Tensor
    """`(B, K, 2)`: the points in the heat maps as (u, v), cell centres at integers."""
    field: Tensor
    """`(B, 4, h / 2, w / 2)`: the phases that every place would have; see `phases_under`."""

    def heat(self) -> Tensor:
        """`(B, K, h, w)`: each map sums to 1."""
        return heat_maps(self.logits)

    def phases(self) -> Tensor:
        """Phases (cos, sin) of the object's yaw at the pick, as a square and as a long thing: `(B, 2, 2)`, see `phase`.

        Each is about as long as it is certain.
        """
        return phases_under(self.heat()[:, :1], self.field)

    def log_heat(self) -> Tensor:
        """`(B, K, h, w)`: the heat maps' logarithms."""
        return self.logits.flatten(2).log_softmax(dim=2).view_as(self.logits)

    def spread(self) -> Tensor:
        """How far the heat maps' weight is from the points, `(B, K)` cells, root mean square."""
        far = squared_distances(self.logits, self.cells).clamp(max=FAR**2)
        return (self.heat() * far).sum(dim=(-2, -1)).sqrt()


class KeypointNet(nn.Module):
    """Picture and goal in, pick and place in robot coordinates out.

    Works at half the input's resolution from its first layer: that costs a quarter, and the soft-argmax reads
    positions to a small fraction of a cell anyway. The phases of the yaw are read from coarser features, which see the
    whole object at once, and from the directions of the edges around, where the heat map is.
    """

    features: SmallFeatures | ResNetFeatures

    def __init__(self, width: int = 24, channels: int = 4, backbone: Backbone = "small") -> None:
        """`width`: channels at the finest scale, twice as many below; `channels`: of the input."""
        super().__init__()
        self.width, self.channels, self.backbone = width, channels, backbone
        self.features = SmallFeatures(channels, width) if backbone == "small" else ResNetFeatures(channels)
        double = 2 * width
        self.bring = nn.ModuleList(
            nn.Identity() if size == wanted else nn.Conv2d(size, wanted, 1, bias=False)
            for size, wanted in zip(self.features.sizes, (width, double, double), strict=True)
        )
        self.up1 = convolution_block(double, double)
        self.narrow = nn.Conv2d(double, width, 1, bias=False)
        self.up0 = convolution_block(width, width)
        self.heat = nn.Conv2d(width, 2, 1)
        self.phase = nn.Sequential(convolution_block(double + CHANNELS, double), nn.Conv2d(double, 4, 1))
        self.to_robot = PlanarMap()
        self.radius = Radius()
        for parameter in self.parameters():
            if parameter.dim() == 4:  # a convolution's: this layout is the faster one on a CPU
                parameter.data = parameter.data.contiguous(memory_format=torch.channels_last)

    def forward(
        self, images: Tensor, to_picture: Tensor, near: Tensor | None = None, layers: Tensor | None = None
    ) -> Keypoints:
        """Images `(B, C, H, W)` uint8; `to_picture` `(B, 3, 3)` takes their cells to the normalised picture.

        A warped image needs nothing but its own `to_picture`: that is all there is to augmentation without
        calibration. `near` `(B, 3)`: points of the picks are looked for there only (`picked_near`), while their heat
        maps stay whole. `layers` `(B, 2)` of pick and place: both on the table unless given.
        """
        logits, field = self.fields(images)
        if near is None:
            return self.read(logits, field, to_picture, layers)
        return self.read(picked_near(logits, near), field, to_picture, layers)._replace(logits=logits)

    def fields(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """`(B, C, H, W)` uint8 -> heat map logits `(B, 2, H / 2, W / 2)`, phases `(B, 4, H / 4, W / 4)`."""
        found: Features = self.features(images.float() / 255 - 0.5)
        fine, middle, coarse = (bring(x) for bring, x in zip(self.bring, found, strict=True))
        middle = self.up1(middle + _twice(coarse))
        fine = self.up0(fine + _twice(self.narrow(middle)))
        return self.heat(fine), self.phase(torch.cat([middle, self.directions(images)], dim=1))

    def directions(self, images: Tensor) -> Tensor:
        """What the phases are read from beside the features: `edge_phases`."""
        return edge_phases(images)

    def read(
        self, logits: Tensor, field: Tensor, to_picture: Tensor, layers: Tensor | None = None
    ) -> Keypoints:
        """Points and poses from what `fields` gives."""
        cells = self.locate(logits)
        matrix = to_picture.unsqueeze(1)
        points = apply_homographies(matrix, cells)
        jacobian = self.to_robot.jacobian(points, layers) @ homography_jacobian(matrix, cells)
        return Keypoints(self.to_robot(points, layers), jacobian, logits, cells, field)

    def locate(self, logits: Tensor) -> Tensor:
        """`(B, K, h, w)` -> `(B, K, 2)`: the points as (u, v) in cells."""
        return local_soft_argmax(logits, PEAK_RADIUS)


def phases_under(heat: Tensor, field: Tensor) -> Tensor:
    """The mean phases of a field `(B, 4, h / 2, w / 2)` where a heat map `(B, 1, h, w)` has its weight: `(B, 2, 2)`."""
    # A mean times four and not a sum, `divisor_override=1`: the ONNX exporter forgets that.
    weight = CELL**2 * F.avg_pool2d(heat, CELL)
    return (field * weight).sum(dim=(-2, -1)).view(-1, 2, 2)


class Radius(nn.Module):
    """How far from its points the truth may be: as many times a heat map's spread as held-out attempts say."""

    times_spread: Tensor
    """`(2,)`: of pick and place; 0 until it is known."""
    floor_m: Tensor
    """`(2,)`: what labels may be off the same way everywhere, which none that is held out can show."""

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("times_spread", torch.zeros(2))
        self.register_buffer("floor_m", torch.zeros(2))

    def forward(self, found: Keypoints) -> Tensor:
        """Radii that hold the truth nine times of ten: `(B, 2)` metres."""
        return ((self.times_spread * spread_m(found)) ** 2 + self.floor_m**2).sqrt()


def spread_m(found: Keypoints) -> Tensor:
    """`Keypoints.spread` on the table: `(B, 2)` metres."""
    return found.spread() * torch.det(found.jacobian).abs().sqrt()


def _twice(x: Tensor) -> Tensor:
    return F.interpolate(x, scale_factor=2.0, mode="bilinear")


_PEAK = 4.0
"""Cells around the point in which a confident heat map has all its weight."""


class KeypointReader(nn.Module):
    """One picture and goal -> what `Reading` holds, as tensors in its order."""

    to_picture: Tensor

    def __init__(self, network: KeypointNet, to_picture: FloatArray) -> None:
        """`to_picture` `(3, 3)`: cells of the heat maps -> the normalised picture."""
        super().__init__()
        self.network = network
        device = network.to_robot.homography.device
        self.register_buffer("to_picture", torch.from_numpy(to_picture).float().unsqueeze(0).to(device))

    def forward(
        self, images: Tensor, near: Tensor, corners: Tensor, layers: Tensor | None = None
    ) -> tuple[Tensor, ...]:
        """Images `(1, C, H, W)` uint8; `near` `(3,)`: the object is within so many cells (last) of (u, v) in cells;
        `corners` `(N, 2)` of the goal in the normalised picture; `layers` `(2,)` of pick and place.
        """
        logits, field = self.network.fields(images)
        logits = picked_near(logits, near.unsqueeze(0))
        above = None if layers is None else layers.unsqueeze(0)
        found = self.network.read(logits, field, self.to_picture, above)
        heat = found.heat()
        share = (heat * (squared_distances(heat, found.cells) < _PEAK**2)).sum(dim=(-2, -1))
        yaw, symmetry = certain_yaw(found.phases()[0], found.jacobian[0, 0])
        return (
            found.xy[0],
            yaw,
            symmetry,
            share[0],
            self.network.radius(found)[0],
            heat[0],
            # As on the table: a layer scales the goal, and turns no side of it.
            self.network.to_robot(corners),
        )


class KeypointPolicy(LearnedPolicy):
    """One small network for pick and place.

    The goal's region goes in as a fourth channel rather than painted over the picture: a patch over the bag
    would hide what is to be picked, and how the goal is drawn (style, colour) makes no difference.
    """

    name = "keypoint"
    wants_goal = True
    network: KeypointNet

    def __init__(
        self, network: KeypointNet, view: View, cell: int, goal_input: GoalInput | None = None
    ) -> None:
        """`view`: the part of the picture in which its training attempts took place."""
        super().__init__(network, view.picture, cell)
        self.view = view
        self.goal_input = goal_input or GoalInput()

    def model_config(self) -> dict[str, Any]:
        """The network's kind, its view, and how goals get into its input."""
        return {
            "width": self.network.width,
            "backbone": self.network.backbone,
            "view": self.view.config(),
            "goal": self.goal_input.config(),
        }

    @classmethod
    def build(cls, model: Mapping[str, Any], picture_size: tuple[int, int], cell: int) -> Self:
        """The policy with an untrained network."""
        goal_input = GoalInput.of(model["goal"])
        network = KeypointNet(int(model["width"]), goal_input.channels, model["backbone"])
        return cls(network, View.of(model["view"], picture_size), cell, goal_input)

    def plan(self, observation: Observation, goal: Goal | None = None) -> Plan:
        """Where to pick and where to place; see `keypoint_plan`, whose errors it raises."""
        return keypoint_plan(
            self.read,
            self.view,
            self.goal_input,
            observation,
            require_goal(goal),
            camera_size=self.camera_size,
            knows_layers=self.knows_layers,
        )

    @property
    def knows_layers(self) -> bool:
        """Whether it learned from stacks."""
        return self.network.to_robot.knows_layers

    def reader(self) -> KeypointReader:
        """The network with all that is computed from it, in evaluation mode: what is exported."""
        return KeypointReader(self.network, to_picture(self.view)).eval()

    def read(self, images: NDArray[np.uint8], near: Float32, corners: Float32, layers: Float32) -> Reading:
        """Run the network; see `KeypointRead`."""
        with torch.inference_mode():
            given = (torch.from_numpy(array).to(self.device) for array in (images, near, corners, layers))
            return Reading(*(part.cpu().numpy() for part in self.reader()(*given)))


_ROWS, _COLUMNS = 9, 16
_LIMIT_MM = 1.0


def as_calibration(policy: KeypointPolicy, height_m: float) -> ImageToRobot:
    """The policy's map from its picture to the robot, fitted to a grid over its view.

    `height_m` is the height it was learned at, half that of the bags at rest. The map's lens bends from the picture to
    the table and a calibration's the other way: `residuals` says what the conversion costs; what the policy's own map
    is worth it does not know. The camera is named after the cell.

    Raises `CalibrationError` where the conversion costs more than a millimetre, or the map is no camera's.
    """
    view = policy.view
    u, v = np.linspace(view.left, view.right - 1, _COLUMNS), np.linspace(view.top, view.bottom - 1, _ROWS)
    pixels = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    xy = _to_robot(policy, apply_homography(view.normalize(), pixels))
    robot = np.column_stack([xy, np.full(len(xy), height_m)])
    camera = CameraIdentity(f"cell {policy.cell}", *policy.picture_size)
    return ImageToRobot.fit(pixels, robot, camera, limit_mm=_LIMIT_MM)


def _to_robot(policy: KeypointPolicy, normalized: FloatArray) -> FloatArray:
    exact = copy.deepcopy(policy.network.to_robot).cpu().double()
    with torch.no_grad():
        return np.asarray(exact(torch.from_numpy(normalized)).numpy(), float)
