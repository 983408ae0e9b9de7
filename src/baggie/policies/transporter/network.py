"""Transporter Networks, whichever preset: one look at the maps, then looks for the pick, then looks for the place.

The preset `paper` is here: a residual network to one logit a pixel for the pick, and two to correlate for the place.
Source: A. Zeng et al., "Transporter Networks: Rearranging the Visual World for Robotic Manipulation", CoRL 2020,
section 3; widths, normalisation and the order of steps (crop, turn, then look) as in the code published with it.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from baggie.policies.transporter.config import TransporterConfig
from baggie.policies.transporter.fast import CoarsePlace, FinePlace, MapFeatures, PickAngle, PickMap, Trunk
from baggie.policies.transporter.scores import PlaceAngle, Scores, turn_angles
from baggie.policies.transporter.spatial import correlate, rotated_crops

_COLOR_MEAN, _COLOR_STD = 0.18877631, 0.07276466
_HEIGHT_MEAN_M, _HEIGHT_STD_M = 0.00509261, 0.00903967
CROP = 64
"""Pixels."""
CHANNELS = 3
"""That are correlated."""
_STRIDE = 8
_DOWN = ((64, 1), (128, 2), (256, 2), (512, 2), (256, 1))
"""Width and stride of the stages before the first enlargement."""
_UP = (128, 64)


class PaperMaps(nn.Module):
    """Colour and height, the height three times, normalised as published."""

    def forward(self, color: Tensor, height: Tensor) -> MapFeatures:
        """`(B, 3, H, W)` uint8 and `(B, H, W)` metres -> maps `(B, 6, H, W)`; there are no features to share."""
        colors = (color.float() / 255 - _COLOR_MEAN) / _COLOR_STD
        heights = ((height - _HEIGHT_MEAN_M) / _HEIGHT_STD_M).unsqueeze(1).expand(-1, 3, -1, -1)
        return MapFeatures(torch.cat([colors, heights], dim=1), colors.new_zeros(len(colors), 0, 1, 1))


class ResidualBlock(nn.Module):
    """1 x 1, 3 x 3, 1 x 1 beside a shortcut, which is a convolution of its own where the shape changes."""

    def __init__(
        self, inputs: int, width: int, outputs: int, stride: int, *, first: bool, last: bool
    ) -> None:
        """`first` of its stage: the shortcut is a convolution; `last` stage: no ReLU after the sum."""
        super().__init__()
        self.conv1 = _convolution(inputs, width, 1, stride)
        self.conv2 = _convolution(width, width, 3)
        self.conv3 = _convolution(width, outputs, 1)
        self.shortcut = _convolution(inputs, outputs, 1, stride) if first else nn.Identity()
        self.last = last

    def forward(self, x: Tensor) -> Tensor:
        """`(B, inputs, h, w)` -> `(B, outputs, h / stride, w / stride)`."""
        inner = self.conv3(F.relu(self.conv2(F.relu(self.conv1(x)))))
        total: Tensor = inner + self.shortcut(x)
        return total if self.last else F.relu(total)


class ResidualFCN(nn.Module):
    """The network all three are: 43 layers deep in the paper's count, stride 8, bilinear enlargements."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.stem = _convolution(inputs, 64, 3)
        stages, width = [], 64
        for wide, stride in _DOWN:
            stages.append(_stage(width, wide, wide, stride))
            width = wide
        self.down = nn.Sequential(*stages)
        ups = []
        for wide in _UP:
            ups += [_Enlarge(), _stage(width, wide, wide, 1)]
            width = wide
        self.up = nn.Sequential(*ups, _Enlarge(), _stage(width, 16, outputs, 1, last=True))

    def forward(self, maps: Tensor) -> Tensor:
        """`(B, inputs, H, W)` of any size -> `(B, outputs, H, W)`."""
        rows, columns = maps.shape[-2:]
        padded = F.pad(maps, (0, -columns % _STRIDE, 0, -rows % _STRIDE))
        x: Tensor = self.up(self.down(F.relu(self.stem(padded))))
        return x[..., :rows, :columns]


class Attention(nn.Module):
    """Where to pick. With a gripper the map is turned so that every yaw in turn is 0, and the logits turned back."""

    def __init__(self, config: TransporterConfig, inputs: int = 6) -> None:
        super().__init__()
        self.fold = config.pick_fold if config.pick_yaw else 1
        bins = config.bins(self.fold) if config.pick_yaw else 1
        self.register_buffer("angles", turn_angles(bins, self.fold), persistent=False)
        self.angles: Tensor
        self.network = ResidualFCN(inputs, 1)

    def forward(self, scene: MapFeatures, about: PlaceAngle) -> Scores:
        """Over the whole map, whatever it is about."""
        maps = scene.maps
        logits = self.network(maps) if len(self.angles) == 1 else self._at_every_yaw(maps)
        return Scores(logits, torch.zeros_like(about.place), 1, self.fold)

    def _at_every_yaw(self, maps: Tensor) -> Tensor:
        batch, _, rows, columns = maps.shape
        middle = maps.new_tensor([columns // 2, rows // 2]).expand(batch, 2)
        side = -(-int((rows**2 + columns**2) ** 0.5 + 2) // _STRIDE) * _STRIDE
        back = maps.new_full((batch, 2), side // 2)
        top, left = side // 2 - rows // 2, side // 2 - columns // 2
        turned = []
        for angle in self.angles:
            upright = rotated_crops(maps, middle, -angle[None], side)[:, 0]
            logits = rotated_crops(self.network(upright), back, angle[None], side)[:, 0]
            turned.append(logits[..., top : top + rows, left : left + columns])
        return torch.cat(turned, dim=1)


class Transport(nn.Module):
    """Where to place what is in the crop about the pick, turned by how much."""

    def __init__(self, config: TransporterConfig, inputs: int = 6) -> None:
        super().__init__()
        self.fold = config.symmetry
        self.register_buffer("angles", turn_angles(config.bins(self.fold), self.fold), persistent=False)
        self.angles: Tensor
        self.query, self.key = ResidualFCN(inputs, CHANNELS), ResidualFCN(inputs, CHANNELS)

    def forward(self, scene: MapFeatures, pick: PlaceAngle, about: PlaceAngle) -> Scores:
        """Over the whole map, whatever it is about."""
        around = CROP // 2
        padded = F.pad(scene.maps, (around,) * 4)
        crops = rotated_crops(padded, pick.place + around, self.angles, CROP)
        kernels = self.query(crops.flatten(0, 1)).unflatten(0, crops.shape[:2])
        logits = correlate(self.key(padded), kernels)[..., around:-around, around:-around]
        return Scores(logits, torch.zeros_like(about.place), 1, self.fold)


class _Enlarge(nn.Module):
    def forward(self, x: Tensor) -> Tensor:
        return F.interpolate(x, scale_factor=2.0, mode="bilinear", align_corners=False)


def _stage(inputs: int, width: int, outputs: int, stride: int, *, last: bool = False) -> nn.Sequential:
    return nn.Sequential(
        ResidualBlock(inputs, width, outputs, stride, first=True, last=last),
        ResidualBlock(outputs, width, outputs, 1, first=False, last=last),
    )


def _convolution(inputs: int, outputs: int, size: int, stride: int = 1) -> nn.Conv2d:
    layer = nn.Conv2d(inputs, outputs, size, stride=stride, padding=size // 2)
    nn.init.xavier_uniform_(layer.weight)  # as published
    assert layer.bias is not None
    nn.init.zeros_(layer.bias)
    return layer


class Decision(NamedTuple):
    """What B maps ask for, and all that was seen on the way."""

    pick: PlaceAngle
    """Its angle is the yaw of the gripper, 0 for a suction cup."""
    place: PlaceAngle
    """Its angle is by how much to turn what was picked."""
    picks: list[Scores]
    """From coarse to fine."""
    places: list[Scores]


class TransporterNet(nn.Module):
    """The pick depends on nothing but the map; the place on the map about the pick.

    Angles turn as in `rotation`; that of a place is relative to the pick.
    """

    look: Trunk | PaperMaps

    def __init__(self, config: TransporterConfig) -> None:
        super().__init__()
        self.config = config
        if config.preset == "paper":
            self.look = PaperMaps()
            self.picks = nn.ModuleList([Attention(config)])
            self.places = nn.ModuleList([Transport(config)])
            return
        self.look = trunk = Trunk()
        angle = [PickAngle(config, trunk.width)] if config.pick_yaw else []
        self.picks = nn.ModuleList([PickMap(trunk.width), *angle])
        self.places = nn.ModuleList([CoarsePlace(config, trunk.width), FinePlace(config, trunk.width)])

    def forward(self, color: Tensor, height: Tensor, pick: PlaceAngle, about: Tensor) -> list[Scores]:
        """What every look says when the ones before it were right: of the pick's looks, then of the place's.

        Maps `(B, 3, H, W)` uint8 and `(B, H, W)` metres; the true pick; `about` `(B, 2)` (u, v) pixels: near the true
        place, where a finer look for it is to look.
        """
        scene: MapFeatures = self.look(color, height)
        near = PlaceAngle(about, torch.zeros_like(pick.angle))
        return [stage(scene, pick) for stage in self.picks] + [
            stage(scene, pick, near) for stage in self.places
        ]

    def decide(
        self,
        color: Tensor,
        height: Tensor,
        barred: Tensor | None = None,
        elsewhere: Tensor | None = None,
    ) -> Decision:
        """Where to pick and where to place; each look is about where the one before it ended, and given what that said.

        `barred` `(B, H, W)`: where not to pick. `elsewhere` `(B, H, W)`: where what is pointed at is not; the pick is
        not read there, and yet its first look stays whole.
        """
        scene: MapFeatures = self.look(color, height)
        rows, columns = height.shape[-2:]
        last = height.new_tensor([columns - 1.0, rows - 1.0])
        start = PlaceAngle(height.new_zeros(len(height), 2), height.new_zeros(len(height)))
        pick, place = start, start
        picks: list[Scores] = []
        places: list[Scores] = []
        for stage in self.picks:
            look: Scores = stage(scene, pick)
            first = not picks
            picks.append(look.without(barred) if first and barred is not None else look)
            pointed = picks[-1].without(elsewhere) if first and elsewhere is not None else picks[-1]
            pick = pointed.read(pick)
        for stage in self.places:
            look = stage(scene, pick, place)
            places.append(look.given(places[-1]) if places else look)
            found = places[-1].read(place)
            place = PlaceAngle(found.place.clamp_min(0).minimum(last), found.angle)
        return Decision(pick, place, picks, places)
