"""What every camera promises, as a function: call it with yours."""

from __future__ import annotations

import numpy as np

from baggie.types import Observation
from baggie.workcell.camera import Camera


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
