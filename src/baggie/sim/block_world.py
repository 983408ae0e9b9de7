"""The running simulation of the arm with a suction cup among rigid blocks."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from baggie.errors import BaggieError
from baggie.geometry import FloatArray, PlanarPose, planar_pose, rigid
from baggie.sim.arm_world import ArmWorld
from baggie.sim.blocks import Block, Fixture, block_xml, fixture_xml, reshape
from baggie.sim.cell import Cell
from baggie.sim.renderer import HIDDEN_GROUP, add_depth_cameras
from baggie.sim.scene import TIMESTEP_S, paint_table, scene_spec
from baggie.sim.tools import Suction, add_seals
from baggie.vision.height_map import DepthCamera

Pose = PlanarPose | FloatArray
"""Flat on the table, or `T_base_body` `(4, 4)`."""

SETTLE_S = 0.1
PERIOD_S = 0.008
"""Between two looks at the seal."""
COARSE_TIMESTEP_S = 0.008
CLEARANCE_M = 0.02  # further than the hand moves in one period
ASIDE_X_M, ASIDE_SPACING_M = -1.0, 0.3  # where blocks wait that play no part, behind the robot


class BlockWorld(ArmWorld):
    """The arm, blocks that can be picked up, and fixtures that cannot."""

    def __init__(
        self,
        cell: Cell,
        blocks: Sequence[Block],
        fixtures: Sequence[Fixture] = (),
        cameras: Sequence[DepthCamera] = (),
    ) -> None:
        """`cameras`: for `DepthRenderer`. Raises `BaggieError` where two things have the same name."""
        self.blocks = {block.name: block for block in blocks}
        self.fixtures = {fixture.name: fixture for fixture in fixtures}
        names = [block.name for block in blocks] + [fixture.name for fixture in fixtures]
        if len(set(names)) < len(names):
            raise BaggieError(f"expected a name of its own for every block and fixture, got {names}")
        super().__init__(cell, _build(cell, blocks, fixtures, cameras))
        self.suction = Suction(self.model, self.data, self.blocks)
        of_body = {self.model.body(name).id: name for name in self.blocks}
        self._geoms = np.flatnonzero(np.isin(self.model.geom_bodyid, list(of_body)))
        self._block_of_geom = np.array([of_body[body] for body in self.model.geom_bodyid[self._geoms]])
        places = np.linspace(-0.3, 0.3, max(len(blocks), 2))
        self.reset({block.name: PlanarPose(0.5, y) for block, y in zip(blocks, places, strict=False)})

    def advance(self, seconds: float) -> None:
        """Let physics run; what is held too loosely for what pulls at it is lost within `PERIOD_S`."""
        for _ in range(max(round(seconds / PERIOD_S), 1)):
            super().advance(min(seconds, PERIOD_S))
            self.suction.check()

    def _choose_timestep(self, seconds: float) -> float:
        """Coarse as long as what the arm carries is well above all other blocks."""
        if seconds < COARSE_TIMESTEP_S or self._clearance() < CLEARANCE_M:
            return TIMESTEP_S
        return COARSE_TIMESTEP_S

    def _clearance(self) -> float:
        """Metres between the cup, or what hangs from it, and the highest block."""
        heights = self.data.geom_xpos[self._geoms, 2]
        radii = self.model.geom_rbound[self._geoms]
        tops = heights + radii
        lowest = self.data.site_xpos[self._tool_site, 2]
        if self.suction.held is not None:
            held = self._block_of_geom == self.suction.held
            lowest = (heights - radii)[held].min()
            tops[held] = 0.0
        return float(lowest - tops.max(initial=0.0))

    def reshape(self, things: Iterable[Block | Fixture]) -> None:
        """Give what has the names of these things their sizes, weights and colours; `reset` has to follow.

        Raises `BaggieError` where nothing has this name, or what is of several boxes is not of those it was built of.
        """
        for thing in things:
            named: dict[str, Any] = self.blocks if isinstance(thing, Block) else self.fixtures
            if thing.name not in named:
                raise BaggieError(f"expected one of {[*named]}, got {thing.name!r}")
            reshape(self.model, self.data, thing)
            named[thing.name] = thing

    def reset(self, poses: Mapping[str, Pose], aside: Collection[str] = ()) -> None:
        """Arm home, suction off, every block at its pose, at rest; fixtures without one go under the table.

        `aside`: blocks that play no part; unseen, they wait behind the robot. Raises `BaggieError` where any other
        block has no pose, or a pose no block or fixture.
        """
        poses = {**poses, **self._aside(aside)}
        known = {*self.blocks, *self.fixtures}
        if not set(self.blocks) <= set(poses) <= known:
            raise BaggieError(
                f"expected poses of all of {sorted(self.blocks)} and at most of {sorted(self.fixtures)} besides, "
                f"got poses of {sorted(poses)}"
            )
        self._reset_arm()
        self.suction.off()
        self.model.geom_group[self._geoms] = [
            HIDDEN_GROUP if name in aside else 0 for name in self._block_of_geom
        ]
        for name, pose in poses.items():
            self._lay(name, pose)
        mujoco.mj_forward(self.model, self.data)
        self.advance(SETTLE_S)

    def put(self, name: str, pose: Pose) -> None:
        """Put a block or fixture somewhere, at rest, without time passing.

        Raises `BaggieError` where nothing has this name.
        """
        if name not in self.blocks and name not in self.fixtures:
            raise BaggieError(f"expected one of {[*self.blocks, *self.fixtures]}, got {name!r}")
        self._lay(name, pose)
        mujoco.mj_forward(self.model, self.data)

    def pose(self, name: str) -> FloatArray:
        """`T_base_body` `(4, 4)` of a block or fixture now."""
        position, quaternion = self._place(name)
        return rigid(Rotation.from_quat(quaternion, scalar_first=True).as_matrix(), position)

    def poses(self) -> dict[str, FloatArray]:
        """By name, `T_base_body` `(4, 4)` of every block and fixture now."""
        return {name: self.pose(name) for name in (*self.blocks, *self.fixtures)}

    def planar_pose(self, name: str) -> PlanarPose:
        """Where its middle is above the table, and which way its x axis points there."""
        return planar_pose(self.pose(name))

    def _aside(self, names: Collection[str]) -> dict[str, PlanarPose]:
        return {
            name: PlanarPose(ASIDE_X_M, ASIDE_SPACING_M * number) for number, name in enumerate(sorted(names))
        }

    def _lay(self, name: str, pose: Pose) -> None:
        position, quaternion = self._place(name)
        T = self._standing(name, pose) if isinstance(pose, PlanarPose) else np.asarray(pose, float)
        position[:] = T[:3, 3]
        quaternion[:] = Rotation.from_matrix(T[:3, :3]).as_quat(scalar_first=True)
        if name in self.blocks:
            dof = int(self.model.joint(name).dofadr[0])
            self.data.qvel[dof : dof + 6] = 0.0

    def _standing(self, name: str, pose: PlanarPose) -> FloatArray:
        height = self.blocks[name].size_m[2] / 2 if name in self.blocks else 0.0
        turn = Rotation.from_euler("z", pose.yaw).as_matrix()
        return rigid(turn, [pose.x, pose.y, height])

    def _place(self, name: str) -> tuple[FloatArray, FloatArray]:
        """Position `(3,)` and quaternion `(4,)`, w first, of a block or fixture, to read and to write."""
        if name in self.blocks:
            start = int(self.model.joint(name).qposadr[0])
            return self.data.qpos[start : start + 3], self.data.qpos[start + 3 : start + 7]
        body = int(self.model.body(name).mocapid[0])
        return self.data.mocap_pos[body], self.data.mocap_quat[body]


def _build(
    cell: Cell, blocks: Sequence[Block], fixtures: Sequence[Fixture], cameras: Sequence[DepthCamera]
) -> mujoco.MjModel:
    things = "".join([block_xml(block) for block in blocks] + [fixture_xml(thing) for thing in fixtures])
    scene = scene_spec(cell, "", things, tool="cup")
    scene.option.cone = (
        mujoco.mjtCone.mjCONE_ELLIPTIC
    )  # round friction cones: blocks do not creep, and cheaper
    # Blocks that rest on the table stand still and cost nothing; on a fixture, a mocap body, MuJoCo lets none sleep.
    scene.option.enableflags |= mujoco.mjtEnableBit.mjENBL_SLEEP
    add_depth_cameras(scene, cameras)
    add_seals(scene, [block.name for block in blocks])
    model = scene.compile()
    paint_table(model, cell)
    return model
