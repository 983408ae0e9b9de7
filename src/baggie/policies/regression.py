"""The published regressor: a ResNet-18 turns a picture with the goal painted in it into x and y, of pick and of place.

It is the baseline to beat, kept as published: 7.8 cm off when picking, 5.8 cm when placing.

The ResNet-18 has the parameter names under which its ImageNet weights are published. Source: K. He, X. Zhang, S. Ren,
J. Sun, "Deep residual learning for image recognition", CVPR 2016.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

import huggingface_hub
import numpy as np
import safetensors
import safetensors.torch
import torch
from huggingface_hub.errors import HfHubHTTPError, HFValidationError, LocalEntryNotFoundError
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional as F

from baggie.errors import DataError
from baggie.options.values import DrawnStyle, Statistics
from baggie.policies.learned import LearnedPolicy
from baggie.policies.planning import GoalInput, regression_goal_input, regression_input, regression_plan
from baggie.types import Goal, Image, Observation, Plan, require_goal

__path__: list[str] = []
"""Lets Python look below here for what `baggie.moved` gives: `baggie.policies.regression.policy`, this file before."""

IMAGENET_MEAN = (0.485, 0.456, 0.406)
IMAGENET_STD = (0.229, 0.224, 0.225)

_HUB_FILE = "model.safetensors"


class PictureNorm(nn.BatchNorm2d):
    """Batch normalisation by each picture's own mean and deviation: what one that learns from batches of one does.

    Its running averages are of single pictures, and what it learned does not hold with them.
    """

    def forward(self, x: Tensor) -> Tensor:
        """`(B, C, H, W)` -> the same, each picture by itself, whether training or not."""
        return F.instance_norm(x, weight=self.weight, bias=self.bias, eps=self.eps)


NORMS: dict[Statistics, type[nn.BatchNorm2d]] = {"running": nn.BatchNorm2d, "picture": PictureNorm}


class BasicBlock(nn.Module):
    """Two 3 x 3 convolutions around which the input is added."""

    def __init__(self, inputs: int, outputs: int, stride: int, statistics: Statistics = "running") -> None:
        super().__init__()
        norm = NORMS[statistics]
        self.conv1 = nn.Conv2d(inputs, outputs, 3, stride, padding=1, bias=False)
        self.bn1 = norm(outputs)
        self.conv2 = nn.Conv2d(outputs, outputs, 3, padding=1, bias=False)
        self.bn2 = norm(outputs)
        self.downsample: nn.Module | None = None
        if stride != 1 or inputs != outputs:
            projection = nn.Conv2d(inputs, outputs, 1, stride, bias=False)
            self.downsample = nn.Sequential(projection, norm(outputs))

    def forward(self, x: Tensor) -> Tensor:
        """`(B, inputs, H, W)` -> `(B, outputs, H / stride, W / stride)`."""
        shortcut: Tensor = x if self.downsample is None else self.downsample(x)
        x = F.relu(self.bn1(self.conv1(x)), inplace=True)
        return F.relu(self.bn2(self.conv2(x)) + shortcut, inplace=True)


class ResNet18(nn.Module):
    """Images `(B, 3, H, W)`, normalised with ImageNet's mean and deviation -> logits `(B, 1000)`."""

    def __init__(self, statistics: Statistics = "running") -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(3, 64, 7, stride=2, padding=3, bias=False)
        self.bn1 = NORMS[statistics](64)
        self.maxpool = nn.MaxPool2d(3, stride=2, padding=1)
        self.layer1, self.layer2, self.layer3, self.layer4 = (
            nn.Sequential(
                BasicBlock(inputs, outputs, stride, statistics), BasicBlock(outputs, outputs, 1, statistics)
            )
            for inputs, outputs, stride in ((64, 64, 1), (64, 128, 2), (128, 256, 2), (256, 512, 2))
        )
        self.fc = nn.Linear(512, 1000)
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight, mode="fan_out", nonlinearity="relu")

    def forward(self, x: Tensor) -> Tensor:
        """`(B, 3, H, W)` -> `(B, 1000)`."""
        x = self.maxpool(F.relu(self.bn1(self.conv1(x)), inplace=True))
        x = self.layer4(self.layer3(self.layer2(self.layer1(x))))
        logits: Tensor = self.fc(x.mean(dim=(2, 3)))
        return logits


def load_imagenet(source: str) -> dict[str, Tensor]:
    """Published weights by name, ready for `ResNet18.load_state_dict`.

    `source`: a `.pth` or `.safetensors` file, or a Hub id whose `model.safetensors` has these names.
    Files from before batch norm counted its batches lack those counters; they start at 0.
    Raises `DataError` when the file is missing, damaged, or of another network.
    """
    path = _find(source)
    try:
        if path.suffix == ".safetensors":
            tensors = safetensors.torch.load_file(path)
        else:
            tensors = torch.load(path, map_location="cpu", weights_only=True)
        shapes = {name: tuple(tensor.shape) for name, tensor in tensors.items()}
    except Exception as error:  # a damaged pickle or zip raises nearly anything
        raise DataError(
            f"{path} cannot be read as weights ({type(error).__name__}): download it again"
        ) from None
    expected = ResNet18().state_dict()
    for name, tensor in expected.items():
        if name.endswith("num_batches_tracked"):
            tensors.setdefault(name, tensor)
        elif shapes.get(name) != tuple(tensor.shape):
            raise DataError(
                f"{path} does not hold a ResNet-18: expected {name} of shape {tuple(tensor.shape)}, "
                f"got {shapes.get(name, 'none')}"
            )
    return {name: tensors[name] for name in expected}


def _find(source: str) -> Path:
    path = Path(source)
    if path.is_file():
        return path
    if path.suffix in {".pth", ".pt", ".safetensors"} or "/" not in source:
        raise DataError(f"{source} is missing: give a .pth or .safetensors file, or a Hub id like owner/name")
    try:
        return Path(huggingface_hub.hf_hub_download(source, _HUB_FILE))
    except (HfHubHTTPError, HFValidationError, LocalEntryNotFoundError, OSError) as error:
        reason = str(error).strip().partition("\n")[0]
        raise DataError(
            f"{source} is no file here and could not be downloaded from the Hub: {reason}"
        ) from None


class Regressor(nn.Module):
    """ResNet-18 to its 1000 logits, then 1000-128-32-2 with ReLU: `(B, 3, 224, 224)` -> `(B, 2)` metres."""

    def __init__(self, statistics: Statistics = "running") -> None:
        super().__init__()
        self.resnet = ResNet18(statistics)
        self.head = nn.Sequential(
            nn.Linear(1000, 128), nn.ReLU(), nn.Linear(128, 32), nn.ReLU(), nn.Linear(32, 2)
        )

    def forward(self, x: Tensor) -> Tensor:
        """Normalised images -> x, y in the robot's base frame."""
        xy: Tensor = self.head(self.resnet(x))
        return xy


class RegressionNet(nn.Module):
    """One network for the pick and one for the place; they share nothing."""

    mean: Tensor
    std: Tensor

    def __init__(self, statistics: Statistics = "running") -> None:
        super().__init__()
        self.statistics: Statistics = statistics
        self.pick = Regressor(statistics)
        self.place = Regressor(statistics)
        self.register_buffer("mean", torch.tensor(IMAGENET_MEAN).view(3, 1, 1), persistent=False)
        self.register_buffer("std", torch.tensor(IMAGENET_STD).view(3, 1, 1), persistent=False)

    def forward(self, images: Tensor) -> Tensor:
        """`(B, 3, 224, 224)` uint8 -> `(B, 2, 2)`: (pick, place) x (x, y), metres."""
        x = (images.float() / 255 - self.mean) / self.std
        return torch.stack([self.pick(x), self.place(x)], dim=1)


class RegressionPolicy(LearnedPolicy):
    """Picks and places at yaw 0: the published network predicts none."""

    name = "regression"
    wants_goal = True
    network: RegressionNet

    def __init__(
        self,
        network: RegressionNet,
        picture_size: tuple[int, int],
        cell: int,
        goal_style: DrawnStyle,
        goal_color: tuple[int, int, int],
    ) -> None:
        """Goals are drawn in the style and colour (RGB) it was trained with, whatever is asked."""
        super().__init__(network, picture_size, cell)
        self.goal_input = GoalInput("painted", goal_style, goal_color)

    def model_config(self) -> dict[str, Any]:
        """How goals are drawn, and what the network normalises by where that is not as published."""
        own = {} if self.network.statistics == "running" else {"statistics": self.network.statistics}
        return {"goal_style": self.goal_input.style, "goal_color": list(self.goal_input.color), **own}

    @classmethod
    def build(cls, model: Mapping[str, Any], picture_size: tuple[int, int], cell: int) -> Self:
        """The policy with an untrained network."""
        drawn = regression_goal_input(model)
        network = RegressionNet(model.get("statistics", "running"))
        return cls(network, picture_size, cell, drawn.style, drawn.color)

    def painted(self, picture: Image, goal: Goal) -> Image:
        """A picture at its trained size and its goal -> `(224, 224, 3)` uint8 with the goal painted in it."""
        return regression_input(self.goal_input, picture, goal).transpose(1, 2, 0)

    def plan(self, observation: Observation, goal: Goal | None = None) -> Plan:
        """Pick and place positions; see `regression_plan`, whose errors it raises."""
        return regression_plan(
            self.read,
            self.goal_input,
            self.picture_size,
            observation,
            require_goal(goal),
            camera_size=self.camera_size,
        )

    def read(self, images: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Run the network; see `RegressionRead`."""
        self.network.eval()
        with torch.inference_mode():
            found: Tensor = self.network(torch.from_numpy(images).to(self.device))
        return np.asarray(found.cpu().numpy())
