"""What a person writes down about a camera: the section `camera:` of a workcell file."""

from __future__ import annotations

from typing import Literal, get_args

from pydantic import Field, PositiveInt

from baggie.workcell.entries import Section, Words

Kind = Literal["opencv", "realsense", "orbbec", "k4a"]


class CameraSettings(Section):
    """Which camera, and how it is set. What is None is left to the camera."""

    kind: Kind = "opencv"
    """`opencv`: anything OpenCV opens. The others have depth, and need their maker's package."""
    source: Words | None = None
    """`opencv`: its number, device, address or a video file, 0 unless given. The others: a serial number, or, with
    `realsense`, a recording; the only one that is plugged in unless given."""
    size: tuple[PositiveInt, PositiveInt] | None = None
    """`(width, height)` of its pictures, pixels. Refused when the camera does not give them."""
    fps: float | None = Field(None, gt=0)
    """Pictures per second. Refused likewise."""
    lock: bool = True
    """Keep exposure and white balance as they are a second after opening, where the driver lets us."""
    exposure_ms: float | None = Field(None, gt=0)
    """Expose for so long, always. Refused when the camera cannot be set."""
    white_balance_k: int | None = Field(None, gt=0)
    """Take light of this colour temperature, kelvin, for white, always. Refused likewise."""
    timeout_s: float = Field(10.0, gt=0)
    """How long a look may take, opening again what was lost included."""

    @property
    def frame_timeout_s(self) -> float:
        """A stream without a frame for this long is opened again, while a look still has time for that."""
        return self.timeout_s / 4

    @classmethod
    def from_words(cls, words: str) -> CameraSettings:
        """`"realsense"` or `"realsense:SERIAL"`, likewise `orbbec` and `k4a`; anything else is a source for OpenCV."""
        kind, _, source = words.partition(":")
        for known in get_args(Kind):
            if kind == known != "opencv":
                return cls(kind=known, source=source or None)
        return cls(source=words)
