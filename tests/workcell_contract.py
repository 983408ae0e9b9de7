"""What every workcell must do, whoever made its camera. Arms: `baggie.workcell.arm_contract.check_arm`."""

from __future__ import annotations

import numpy as np

from baggie.workcell.camera import Camera
from baggie.workcell.workcell import Workcell


def check_camera(cell: Workcell) -> None:
    """Pictures have the size that was promised, and are new each time."""
    camera = cell.camera
    assert isinstance(camera, Camera)
    first, second = cell.look(), cell.look()
    for observation in (first, second):
        assert observation.color.dtype == np.uint8
        assert observation.size == tuple(camera.size)
        if observation.depth is not None:
            assert observation.depth.shape == observation.color.shape[:2]
            assert observation.depth.dtype == np.float32
    assert not np.array_equal(first.color, second.color), "two pictures never have the same noise"
