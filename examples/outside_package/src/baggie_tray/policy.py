"""A policy that learns nothing: the highest thing goes to the middle of the table."""

from __future__ import annotations

from pathlib import Path
from typing import Self

import cv2
import numpy as np
import yaml

import baggie
from baggie.errors import BaggieError
from baggie.geometry import PlanarPose
from baggie.types import Goal, Observation, PickPlace, Plan, require_observation


class HighestPolicy(baggie.Policy):
    """Picks the highest thing of a height map, and places it at one place."""

    name = "highest"

    def __init__(self, place: tuple[float, float]) -> None:
        """`place`: x and y, metres, robot base frame."""
        self.place = place

    def plan(self, observation: Observation, goal: Goal | None = None) -> Plan:
        """From the table as seen from straight above. Raises `BaggieError` for a picture without heights."""
        table = require_observation(observation)
        if table.height is None or table.grid is None:
            raise BaggieError(
                "expected a picture with heights, got one without; take a task seen from straight above"
            )
        smooth = cv2.blur(table.height, (5, 5))
        row, column = np.unravel_index(int(smooth.argmax()), smooth.shape)
        x, y = table.grid.to_robot(np.array([[column, row]], float))[0]
        return Plan(PickPlace(PlanarPose(float(x), float(y)), PlanarPose(*self.place)))

    def save(self, folder: Path) -> None:
        """Write `config.yaml`."""
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "config.yaml").write_text(yaml.safe_dump({"policy": self.name, "place": list(self.place)}))

    @classmethod
    def from_pretrained(cls, source: str | Path, device: str = "cpu") -> Self:
        """Read what `save` wrote."""
        x, y = yaml.safe_load((Path(source) / "config.yaml").read_text())["place"]
        return cls((float(x), float(y)))
