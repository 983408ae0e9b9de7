"""What a camera must offer, what a workcell file says of one, and what every one promises, as a function to call.

Several cameras with depth are one that looks straight down.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, PositiveInt

from baggie.entries import Section, Words
from baggie.errors import BaggieError
from baggie.geometry import Grid
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


class OpenCamera(Camera, Protocol):
    """A camera that somebody has to close."""

    def close(self) -> None:
        """Let go of the camera."""
        ...


class CameraEntry(Section):
    """The section `camera` of a workcell file, of one kind. `baggie.registry.CAMERAS` has a subclass for each."""

    kind: str
    """The word it is registered by."""

    real: ClassVar[bool] = True
    """Whether it is a device, which `open` opens, and not a part of a simulated workcell."""
    about: ClassVar[str] = ""
    """What it is, in a few words, for a person who chooses."""

    def open(self, folder: Path) -> Camera:
        """Open the camera; paths in the section begin in `folder`. Raises `BaggieError` where it cannot be opened."""
        raise NotImplementedError


class CameraSettings(CameraEntry):
    """Which camera, and how it is set. What is None is left to the camera."""

    kind: str = "opencv"
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

    def open(self, folder: Path) -> OpenCamera:
        """Open the camera. Raises `CameraError` when it is not there, or cannot be set so."""
        raise NotImplementedError


def check_camera(camera: Camera, *, live: bool = True) -> None:
    """Look twice, and fail with an assertion that says where `camera` breaks its contract.

    `live=False` is for recordings of single pictures, which may show the same one again.
    """
    assert isinstance(camera, Camera), "a camera has name, size, intrinsics and look"
    assert camera.name, "a calibration says by its name which camera it is of"
    assert "\n" not in camera.name, "a name is one line"
    width, height = camera.size
    assert width > 0, "size is (width, height), pixels"
    assert height > 0, "size is (width, height), pixels"

    first = camera.look()
    seen = first.color.copy()
    first.color[:] = 0  # whoever looks may draw into the picture
    second = camera.look()
    for observation in (first, second):
        _check_observation(observation, camera)
    assert second.color.any(), "drawing into a picture must not change the next one"
    assert second.time >= first.time, "time never runs backwards"
    if live:
        assert not np.array_equal(seen, second.color), "two pictures never have the same noise"


def _check_observation(observation: Observation, camera: Camera) -> None:
    color, depth, lens = observation.color, observation.depth, observation.intrinsics
    assert color.dtype == np.uint8, "colour is uint8"
    assert color.ndim == 3, "colour is (H, W, 3)"
    assert color.shape[2] == 3, "colour is RGB, without alpha"
    assert observation.size == tuple(camera.size), "pictures have the size that the camera says"
    if observation.grid is not None:
        assert observation.height is not None, "a picture from straight above has heights"
        assert observation.height.shape == color.shape[:2], "heights and colour show the same pixels"
        return
    if lens is not None:
        assert (lens.width, lens.height) == observation.size, "intrinsics are those of pictures of this size"
        assert lens.matrix.shape == (3, 3), "the camera matrix is (3, 3)"
        assert lens.matrix[0, 0] > 0, "focal lengths are pixels, above 0"
        assert lens.matrix[1, 1] > 0, "focal lengths are pixels, above 0"
    if depth is not None:
        assert depth.dtype == np.float32, "depth is float32"
        assert depth.shape == color.shape[:2], "depth is aligned to colour"
        assert np.isfinite(depth).all(), "depth is 0 where unknown, never NaN"
        assert (depth >= 0).all(), "depth is ahead of the camera"
        assert (depth < 100).all(), "depth is metres, not millimetres"


class HeightMapCamera:
    """A `Camera` whose pictures are orthographic: `color`, `grid` and `height` (`baggie.vision.height_map`)."""

    def __init__(
        self,
        cameras: Sequence[Camera],
        poses: Sequence[ArrayLike],
        grid: Grid | None = None,
        name: str = "height map",
    ) -> None:
        """`cameras`: with depth and intrinsics; `poses`: `T_base_camera` `(4, 4)` of each; `grid`: Ravens' if None.

        Raises `BaggieError` where there is not one pose for each of one or more cameras.
        """
        if len(cameras) != len(poses) or not len(cameras):
            raise BaggieError(
                f"expected one pose for each of one or more cameras, got {len(poses)} poses for {len(cameras)} "
                "cameras; give both in the same order"
            )
        self.name = name
        self.grid = grid or Grid()
        rows, columns = self.grid.shape
        self.size = columns, rows
        self.intrinsics: Intrinsics | None = None  # parallel rays have none
        self._cameras = tuple(cameras)
        self._poses = tuple(poses)

    def look(self) -> Observation:
        """What all cameras see now, from straight above; its time is that of the last picture.

        Raises `CameraError` when a camera gives none, `BaggieError` when one gives no depth or no intrinsics.
        """
        seen = [camera.look() for camera in self._cameras]
        from baggie.vision.height_map import fuse  # noqa: PLC0415 -- scipy takes its time

        fused = fuse(seen, self._poses, self.grid)
        return Observation(fused.color, time=seen[-1].time, grid=self.grid, height=fused.height)
