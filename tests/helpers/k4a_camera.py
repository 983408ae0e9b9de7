"""A stand-in for an Azure Kinect, held to the signatures of `pyk4a`."""

from __future__ import annotations

import time
from unittest.mock import Mock, create_autospec

import numpy as np
import pyk4a
import pytest

RNG = np.random.default_rng(0)
MATRIX = np.array([[600.0, 0, 640], [0, 601, 360], [0, 0, 1]])
DISTORTION = np.arange(8) / 10


def a_capture(*_: object, **__: object) -> Mock:
    time.sleep(0.03)
    capture: Mock = create_autospec(pyk4a.PyK4ACapture, instance=True)
    capture.color = RNG.integers(0, 255, (720, 1280, 4), dtype=np.uint8)
    capture.transformed_depth = np.full((720, 1280), 1500, np.uint16)
    capture.color_exposure_usec, capture.color_white_balance = 16670, 4503
    return capture


def plug_in(monkeypatch: pytest.MonkeyPatch) -> Mock:
    """One camera."""
    device: Mock = create_autospec(pyk4a.PyK4A, instance=True)
    device.serial, device.is_running = "0001", True
    device.calibration = create_autospec(pyk4a.Calibration, instance=True)
    device.calibration.get_camera_matrix.return_value = MATRIX
    device.calibration.get_distortion_coefficients.return_value = DISTORTION
    device.get_capture.side_effect = a_capture
    monkeypatch.setattr(pyk4a, "connected_device_count", lambda: 1)
    monkeypatch.setattr(pyk4a, "PyK4A", lambda config, device_id: device)
    return device
