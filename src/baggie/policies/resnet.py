"""ResNet-18, with the parameter names under which its ImageNet weights are published.

Source: K. He, X. Zhang, S. Ren, J. Sun, "Deep residual learning for image recognition", CVPR 2016.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import huggingface_hub
import safetensors
import safetensors.torch
import torch
from huggingface_hub.errors import HfHubHTTPError, HFValidationError, LocalEntryNotFoundError
from torch import Tensor, nn
from torch.nn import functional as F

from baggie.errors import DataError

IMAGENET_MEAN = (0.485, 0.456, 0.406)
IMAGENET_STD = (0.229, 0.224, 0.225)

_HUB_FILE = "model.safetensors"


Statistics = Literal["running", "picture"]
"""What a trained network normalises by: averages over its training, as published, or each picture's own."""


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
