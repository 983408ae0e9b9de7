"""Scenes of tasks with blocks, played by an arm without any error."""

from __future__ import annotations

import numpy as np

from baggie.geometry import FloatArray, planar_pose, transform_points
from baggie.sim.objects import Block, distance_m
from baggie.tasks.task import Scene
from baggie.types import PickPlace


def poses_of(scene: Scene) -> dict[str, FloatArray]:
    heights = {block.name: block.size_m[2] / 2 for block in scene.blocks}
    return {name: pose.upright(heights.get(name, 0.0)) for name, pose in scene.poses.items()}


def away(block: Block, poses: dict[str, FloatArray], points: FloatArray) -> FloatArray:
    """`(N,)` metres from points `(N, 2)` on the table to what a block covers of it."""
    own = transform_points(np.linalg.inv(poses[block.name]), np.c_[points, np.zeros(len(points))])
    return distance_m(block, own[:, :2])


def carried(action: PickPlace, scene: Scene, poses: dict[str, FloatArray]) -> dict[str, FloatArray]:
    """What an arm without any error would make of it: what is picked moves with the cup, onto the slot it is put at."""
    off = {block.name: away(block, poses, action.pick.xy[None])[0] for block in scene.blocks}
    name = min(off, key=lambda each: (off[each], -poses[each][2, 3]))
    if off[name] > 0.0:
        return poses
    moved = action.place @ action.pick.inverse() @ planar_pose(poses[name])
    slots = [
        slot.T_base_slot(poses) for stage in scene.conditions if name in stage.blocks for slot in stage.slots
    ]
    heights = [T[2, 3] for T in slots if moved.distance(planar_pose(T)) < 0.01]
    block = next(block for block in scene.blocks if block.name == name)
    return poses | {name: moved.upright(max(heights, default=block.size_m[2] / 2))}
