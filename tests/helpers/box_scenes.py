"""Drawn height maps: coloured boxes on a flat table, one of them to be picked, a slot to place it at, turned."""

from __future__ import annotations

import cv2
import numpy as np

from baggie.geometry import Grid
from baggie.learning.demonstrations import Demonstrations
from baggie.types import Attempt, Observation, Outcome, PickPlace

GRID = Grid(x=(0.25, 0.65), y=(-0.2, 0.2), pixel_m=0.003125)
"""128 x 128 pixels."""
BOX_M = 0.04
TABLE, _BOX, _OTHER, _SLOT, _MARK = (
    (120, 105, 90),
    (200, 60, 50),
    (60, 90, 200),
    (235, 235, 225),
    (250, 220, 60),
)


def box_scene(
    rng: np.random.Generator, symmetry: int = 1, grid: Grid = GRID
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Color `(H, W, 3)`, height `(H, W)`, pose `(6,)`: pick at yaw 0, place turned by how much the box has to turn.

    The red box goes to the white slot so that its sides lie along the slot's; without symmetry it and the slot have a
    yellow mark at one side, which must come to lie on each other.
    """
    rows, columns = grid.shape
    color = np.full((rows, columns, 3), TABLE, np.uint8)
    height = np.zeros((rows, columns), np.float32)
    places = _apart(rng, 3, columns, rows)
    yaws = rng.uniform(-np.pi, np.pi, 3)
    half = BOX_M / 2 / grid.pixel_m
    drawn = color, height
    looks = (_SLOT, 0.004, 1.25 * half), (_BOX, BOX_M, half), (_OTHER, BOX_M, half)
    for place, yaw, (paint, above, reach) in zip(places, yaws, looks, strict=True):
        draw_rectangle(drawn, place, yaw, (-reach, reach), (paint, above))
        if symmetry == 1 and paint != _OTHER:
            draw_rectangle(drawn, place, yaw, (0.35 * half, reach), (_MARK, above))
    turn = np.angle(np.exp(1j * (yaws[0] - yaws[1])))
    slot, box = (grid.to_robot(place)[0] for place in places[:2])
    return color, height, np.array([*box, 0.0, *slot, turn])


def box_demonstrations(count: int, seed: int, symmetry: int = 1, grid: Grid = GRID) -> Demonstrations:
    scenes = [box_scene(np.random.default_rng([seed, i]), symmetry, grid) for i in range(count)]
    colors, heights, poses = (np.stack(part) for part in zip(*scenes, strict=True))
    return Demonstrations(colors, heights, poses, np.full(count, symmetry), grid)


def draw_rectangle(drawn, place, yaw, along, look) -> None:
    """Filled, from `along[0]` to `along[1]` pixels along its own u axis and `along[1]` either way across."""
    (color, height), (paint, above), across = drawn, look, along[1]
    c, s = np.cos(yaw), np.sin(yaw)
    corners = np.array([[along[0], -across], [along[1], -across], [along[1], across], [along[0], across]])
    corners = corners @ np.array([[c, s], [-s, c]]) + place
    fixed = np.round(corners * 16).astype(np.int32)
    cv2.fillPoly(color, [fixed], paint, cv2.LINE_AA, 4)
    mask = np.zeros(height.shape, np.uint8)
    cv2.fillPoly(mask, [fixed], 1, cv2.LINE_8, 4)
    height[mask > 0] = above


def _apart(rng: np.random.Generator, count: int, columns: int, rows: int, distance: float = 24) -> np.ndarray:
    places: list[np.ndarray] = []
    while len(places) < count:
        new = rng.uniform([14, 14], [columns - 14, rows - 14])
        if all(np.linalg.norm(new - old) > distance for old in places):
            places.append(new)
    return np.array(places)


def box_attempts(count: int, seed: int, symmetry: int = 1, grid: Grid = GRID) -> list[Attempt]:
    """Two attempts an episode, without a goal; the second has done the task."""
    shown = box_demonstrations(count, seed, symmetry, grid)
    return [
        Attempt(
            attempt_id=i,
            task="put the red box into the slot",
            before=Observation(shown.colors[i], grid=grid, height=shown.heights[i]),
            after=None,
            commanded=PickPlace.from_array(shown.poses[i]),
            outcome=Outcome(PickPlace.from_array(shown.poses[i])),
            box_before=np.full((4, 2), np.nan),
            box_after=np.full((4, 2), np.nan),
            episode=i // 2,
            step=i % 2,
            reward=0.5,
        )
        for i in range(count)
    ]
