"""Several cameras with depth as one that looks straight down."""

from __future__ import annotations

from collections.abc import Sequence

from numpy.typing import ArrayLike

from baggie.errors import BaggieError
from baggie.grid import Grid
from baggie.types import Intrinsics, Observation
from baggie.vision.height_map import fuse
from baggie.workcell.camera import Camera


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
        fused = fuse(seen, self._poses, self.grid)
        return Observation(fused.color, time=seen[-1].time, grid=self.grid, height=fused.height)
