"""What a camera must offer."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from baggie.types import Intrinsics, Observation


@runtime_checkable
class Camera(Protocol):
    """A colour camera (with depth, perhaps) that looks at the table from where it stands."""

    name: str
    size: tuple[int, int]
    """`(width, height)` of its pictures, pixels."""
    intrinsics: Intrinsics | None
    """None where nobody has calibrated it."""

    def look(self) -> Observation:
        """A picture taken after the call, never an older one. Raises `CameraError` when none comes."""
        ...
