"""What can be chosen about a Transporter network."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Self

from baggie.errors import BaggieError
from baggie.options.values import Preset

_FEWEST_BINS = 3
"""So that the best bin has two neighbours, between which an angle can be read."""


@dataclass(frozen=True)
class TransporterConfig:
    """Which network, and what it has to tell apart. Raises `BaggieError` for what is out of range."""

    preset: Preset = "fast"
    """`fast` is ours; `paper` has the published sizes."""
    rotations: int = 36
    """Bins of angle a whole turn, for things that look the same only once a turn."""
    symmetry: int = 1
    """How often a turn all that is picked looks the same; 0 for any angle. Only one such part of a turn is searched."""
    pick_yaw: bool = False
    """Whether a gripper has to be turned to pick, as fingers have; a suction cup picks at yaw 0."""
    orders: int = 8
    """`fast`: the highest angular order of the phases."""
    pick_symmetry: int | None = None
    """How often a turn a grasp is the same; unless given, as often as all that is picked and two fingers are."""

    def __post_init__(self) -> None:
        if self.preset not in ("fast", "paper"):
            raise BaggieError(f"expected the preset fast or paper, got {self.preset!r}; take fast")
        if self.rotations < _FEWEST_BINS:
            raise BaggieError(f"expected at least 3 rotations a turn, got {self.rotations}; the paper has 36")
        if self.symmetry < 0 or self.orders < 1:
            raise BaggieError(
                "expected a symmetry of 0 (any angle), 1 (none), 2, ... and orders of at least 1, "
                f"got {self.symmetry} and {self.orders}; of a square block the symmetry is 4"
            )

    @property
    def pick_fold(self) -> int:
        """How often a turn a grasp is the same: two fingers change places after half a turn."""
        return math.lcm(2, self.symmetry) if self.pick_symmetry is None else self.pick_symmetry

    def bins(self, fold: int) -> int:
        """Count the bins of the `fold`-th part of a turn, as wide as those of a whole one."""
        return 1 if fold == 0 else max(_FEWEST_BINS, round(self.rotations / fold))

    def orders_of(self, fold: int) -> int:
        """How many phases: only multiples of the symmetry can be excited. At least 1."""
        return max(1, self.orders // max(fold, 1))

    def config(self) -> dict[str, Any]:
        """Give the settings in plain YAML types."""
        return asdict(self)

    @classmethod
    def of(cls, config: Mapping[str, Any]) -> Self:
        """The inverse of `config`."""
        return cls(**config)
