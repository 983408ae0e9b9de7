"""Maps turned by quarter turns, and decisions about them turned back: exactly, as no pixel falls between others."""

from __future__ import annotations

import math
from typing import TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from baggie.policies.transporter.network import Decision
from baggie.policies.transporter.scores import Scores
from baggie.policies.transporter.soft_targets import PlaceAngle

Pixels = TypeVar("Pixels", bound=np.generic)


def turned(pixels: NDArray[Pixels], quarters: int) -> NDArray[Pixels]:
    """Pixels `(H, W)` or `(H, W, C)` of a map, turned by so many quarters from v towards u."""
    return np.ascontiguousarray(np.rot90(pixels, quarters))


def turned_back(decision: Decision, quarters: int, shape: tuple[int, int]) -> Decision:
    """What a decision about a map `turned` by so many quarters says of the map itself, whose `shape` is (H, W).

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
