"""Augment without a calibration: change pictures so that the label stays known.

Shows why a warped picture still has a label in robot coordinates although nobody knows the camera. With `f` the point
that is found in a picture `I` and `g` the map from the picture to the robot, a warp `A` leaves `g(A⁻¹ f(A·I))` as it
was. Light and looks move nothing. Needs the recording that `make demo` leaves behind.

Prints where the bag goes in each warped picture and that the way back is exact, and draws six changed pictures into
`runs/examples/augmented.png`:

    the bag is at (214.0, 120.4); the arm picked it at (0.412, -0.083)
    warped to (251.3, 97.2), and back to (214.0, 120.4)
    ...
    drawn: runs/examples/augmented.png
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

import baggie
from baggie.geometry import apply_homography
from baggie.learning.augmentation import object_mask, random_light, random_look, random_warp, without_object
from baggie.pictures import write_picture

RECORDING = Path("demo/recording")
PICTURE = Path("runs/examples/augmented.png")


def main() -> None:
    """Six changes of one picture."""
    if not RECORDING.is_dir():
        sys.exit(f"error: no recording in {RECORDING}; make one first: make demo")
    rng = np.random.default_rng(0)  # the same seed gives the same pictures
    attempt = baggie.open_dataset(RECORDING)[0]
    picture, size, box = attempt.before.color, attempt.before.size, attempt.box_before
    (u, v), pick = box.mean(axis=0), attempt.outcome.executed.pick
    print(f"the bag is at ({u:.1f}, {v:.1f}); the arm picked it at ({pick.x:.3f}, {pick.y:.3f})")

    mask = object_mask(picture, box)
    table = without_object(picture, mask)
    changed = []
    for _ in range(6):
        looks = random_look(rng, picture, table, mask)  # another cloth, table and clutter
        lit = np.asarray(cv2.LUT(looks, random_light(rng)[:, None]), np.uint8)
        warp = random_warp(rng, size, box)  # (3, 3), pixels to pixels; the bag stays in the picture
        changed.append(np.asarray(cv2.warpPerspective(lit, warp, size), np.uint8))
        there = apply_homography(warp, box.mean(axis=0)[None])
        back = apply_homography(np.linalg.inv(warp), there)
        (to_u, to_v), (from_u, from_v) = there[0], back[0]
        print(f"warped to ({to_u:.1f}, {to_v:.1f}), and back to ({from_u:.1f}, {from_v:.1f})")
    write_picture(PICTURE, np.vstack([np.hstack(changed[:3]), np.hstack(changed[3:])]))
    print(f"drawn: {PICTURE}")


if __name__ == "__main__":
    main()
