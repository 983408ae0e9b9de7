"""How long it takes to fuse pictures of 640 x 480 from Ravens' three cameras into a height map of 320 x 160.

    python benchmarks/height_map.py

One thread. With a lens that bends the picture, the first map of a camera is made anew each time for comparison: later
ones find its rays undone.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"
sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import cv2
import numpy as np

from baggie.geometry import Grid
from baggie.types import Intrinsics
from baggie.vision import height_map
from baggie.vision.height_map import fuse
from helpers.ray_caster import Box, look, pinhole, ravens_poses

ROUNDS = 25
BENT = (0.08, -0.05, 0.0006, -0.0003, 0.005)


def main() -> None:
    cv2.setNumThreads(1)
    poses, boxes = ravens_poses(), blocks()
    straight, bent = pinhole(640, 480, 450.0), pinhole(640, 480, 450.0, BENT)
    cases: list[tuple[str, Intrinsics, int, bool]] = [
        ("three pinholes", straight, 3, False),
        ("three bent lenses", bent, 3, False),
        ("three bent lenses, first map", bent, 3, True),
        ("one pinhole", straight, 1, False),
    ]
    print(f"pictures of 640 x 480, a map of 320 x 160; {ROUNDS} rounds, interleaved; ms a map")
    print(f"{'cameras':<30}{'median':>8}{'quartiles':>14}{'fastest':>9}{'slowest':>9}{'filled':>8}")
    pictures = [[look(camera, pose, boxes) for pose in poses[:count]] for _, camera, count, _ in cases]
    times = np.zeros((ROUNDS, len(cases)))
    for turn in range(-1, ROUNDS):  # the first one warms up
        for column, (_, _, count, first) in enumerate(cases):
            if first:
                height_map._rays_of.cache_clear()
            start = time.perf_counter()
            fuse(pictures[column], poses[:count], Grid())
            times[max(turn, 0), column] = 1000 * (time.perf_counter() - start)
    for column, (name, _, count, _) in enumerate(cases):
        ms = times[:, column]
        low, median, high = np.percentile(ms, (25, 50, 75))
        fused = fuse(pictures[column], poses[:count], Grid())
        filled = (~fused.seen & fused.color.any(axis=-1)).sum()
        print(f"{name:<30}{median:>8.1f}{low:>7.1f}{high:>7.1f}{ms.min():>9.1f}{ms.max():>9.1f}{filled:>8}")


def blocks() -> list[Box]:
    """Six of 4 cm, as in Ravens' block stacking, and one wall that hides some of the table."""
    places = [(0.35, -0.4), (0.62, -0.3), (0.45, -0.12), (0.66, 0.05), (0.36, 0.21), (0.55, 0.38)]
    small = [Box((x - 0.02, y - 0.02, 0.0), (x + 0.02, y + 0.02, 0.04)) for x, y in places]
    return [*small, Box((0.48, 0.08, 0.0), (0.50, 0.28, 0.15), (30, 60, 220))]


if __name__ == "__main__":
    main()
