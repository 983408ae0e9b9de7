"""Calibrate the picture to the robot, and read how sure the map is.

Shows that a fit tells its own uncertainty, place by place, and how to check it. No board is needed here: every attempt
of a recording tells where in the picture a bag was, and where the arm closed on it. What the fit states is the scatter
of these points; what all grasps have wrong alike it cannot know. (A marker in the hand is far more exact:
`baggie calibrate image-to-robot`.) Needs the recording that `make demo` leaves behind.

Prints the fit, and how far it is from the map that the collector made, beside what the fit says of itself:

    fitted to 128 bags: 2.2 mm off where left out
    at (0.45, -0.15) m: 1.1 mm from the collector's map, stated: 0.7 mm (one standard deviation)
    at (0.50, 0.00) m: 0.8 mm from the collector's map, stated: 0.5 mm (one standard deviation)
    at (0.55, 0.15) m: 1.2 mm from the collector's map, stated: 0.6 mm (one standard deviation)
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import baggie
from baggie.calibration.files import CameraIdentity
from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.data.summary import is_demonstration

RECORDING = Path("demo/recording")
HEIGHT_M = 0.015
"""Of the bag's outline above the table: the map is right at this height only."""


def main() -> None:
    """Fit, and compare."""
    if not RECORDING.is_dir():
        sys.exit(f"error: no recording in {RECORDING}; make one first: make demo")
    recording = baggie.open_dataset(RECORDING)
    attempts = [attempt for attempt in recording if is_demonstration(attempt)]
    pixels = np.array([attempt.box_before.mean(axis=0) for attempt in attempts])
    picks = np.array([attempt.outcome.executed.pick.xy for attempt in attempts])
    robot = np.c_[picks, np.full(len(picks), HEIGHT_M)]

    camera = CameraIdentity("the demo's", *recording.settings.picture_size)
    fitted = ImageToRobot.fit(pixels, robot, camera, limit_mm=10.0)
    left_out = fitted.residuals.leave_one_out_mm
    print(f"fitted to {len(attempts)} bags: {left_out:.1f} mm off where left out")

    made = ImageToRobot.load(RECORDING / "calibration" / "image-to-robot.yaml").for_size(camera.size)
    places = np.array([[0.45, -0.15], [0.50, 0.00], [0.55, 0.15]])
    seen = made.at_height(HEIGHT_M).to_pixels(places)
    off_mm = 1000 * np.linalg.norm(fitted.to_robot(seen) - places, axis=1)
    for (x, y), off, std in zip(places, off_mm, fitted.std_mm_at(places), strict=True):
        stated = f"stated: {std:.1f} mm (one standard deviation)"
        print(f"at ({x:.2f}, {y:.2f}) m: {off:.1f} mm from the collector's map, {stated}")


if __name__ == "__main__":
    main()
