"""Transporter Networks, whichever preset: one look at the maps, then looks for the pick, then looks for the place."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

from baggie.policies.transporter.config import TransporterConfig
from baggie.policies.transporter.paper import Attention, PaperMaps, Transport
from baggie.policies.transporter.pick import PickAngle, PickMap
from baggie.policies.transporter.place import CoarsePlace, FinePlace
from baggie.policies.transporter.scores import Scores
from baggie.policies.transporter.soft_targets import PlaceAngle
from baggie.policies.transporter.trunk import Scene, Trunk


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
        scene: Scene = self.look(color, height)
        near = PlaceAngle(about, torch.zeros_like(pick.angle))
        return [stage(scene, pick) for stage in self.picks] + [
            stage(scene, pick, near) for stage in self.places
        ]

    def decide(self, color: Tensor, height: Tensor, barred: Tensor | None = None) -> Decision:
        """Where to pick and where to place; each look is about where the one before it ended, and given what that said.

        `barred` `(B, H, W)`: where not to pick.
        """
        scene: Scene = self.look(color, height)
        rows, columns = height.shape[-2:]
        last = height.new_tensor([columns - 1.0, rows - 1.0])
        start = PlaceAngle(height.new_zeros(len(height), 2), height.new_zeros(len(height)))
        pick, place = start, start
        picks: list[Scores] = []
        places: list[Scores] = []
        for stage in self.picks:
            look: Scores = stage(scene, pick)
            picks.append(look if barred is None or picks else look.without(barred))
            pick = picks[-1].read(pick)
        for stage in self.places:
            look = stage(scene, pick, place)
            places.append(look.given(places[-1]) if places else look)
            found = places[-1].read(place)
            place = PlaceAngle(found.place.clamp_min(0).minimum(last), found.angle)
        return Decision(pick, place, picks, places)
