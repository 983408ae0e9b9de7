"""The running simulation of the arm and the bag, with what is printed and laid on the table.

The table's top, which can be knocked.

A firm block that can be laid on the table, for an arm to feel.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from baggie.geometry import FloatArray, PlanarPose, invert_transform
from baggie.sim.arm_world import ArmWorld, upward_touch
from baggie.sim.bag import BAG, SECOND_BAG, BagParameters, SoftBody
from baggie.sim.cell import Cell
from baggie.sim.clutter import Distractor
from baggie.sim.printed import (
    PLATE,
    PLATE_SIZE_M,
    PLATE_TEXTURE,
    SHEET,
    SHEET_SIZE_M,
    SHEET_TEXTURE,
    T_sheet_target,
    texture,
)
from baggie.sim.scene import (
    ARM,
    BLOCK,
    BLOCK_AWAY,
    BLOCK_HALF_M,
    T_HAND_PLATE,
    TIMESTEP_S,
    build_model,
    paint,
)
from baggie.vision.targets import Target


def bump_table(
    model: mujoco.MjModel, data: mujoco.MjData, motion: PlanarPose, bags: Sequence[SoftBody]
) -> None:
    """Move the top for good, and with it the bags, the card and the sheet: what was at `pose` is at `motion @ pose`.

    The world's `update_fixed` has to follow.
    """
    turn = Rotation.from_euler("z", motion.yaw)
    quaternion, shift = turn.as_quat(scalar_first=True), np.array([motion.x, motion.y, 0.0])
    top = model.geom("table_top")
    for position, orientation in (
        (top.pos, top.quat),
        *zip(data.mocap_pos, data.mocap_quat, strict=True),
    ):
        position[:] = turn.apply(position) + shift
        mujoco.mju_mulQuat(orientation, quaternion, orientation.copy())
    for bag in bags:
        bag.carry_along(turn, shift)


class Block:
    """The block of a running simulation."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self._model, self._data = model, data
        self._body = model.body(BLOCK).id
        self._mocap = int(model.body(BLOCK).mocapid[0])
        self.pose: PlanarPose | None = None
        """Where it lies; None while it is away."""
        self.height_m = 0.0
        """Of its top above the table; 0 while it is away."""

    def lay(self, pose: PlanarPose, height_m: float) -> None:
        """Its middle at this place, its top at this height; its sides stay along x and y."""
        self.pose, self.height_m = pose, height_m
        self._put((pose.x, pose.y, height_m - BLOCK_HALF_M[2]))

    def take_away(self) -> None:
        """Off the table."""
        self.pose, self.height_m = None, 0.0
        self._put(BLOCK_AWAY)

    def _put(self, at: tuple[float, float, float]) -> None:
        self._data.mocap_pos[self._mocap] = at
        self._model.geom(BLOCK).rgba[3] = 1.0 if self.pose else 0.0
        mujoco.mj_forward(self._model, self._data)

    @property
    def pressed_n(self) -> float:
        """Newtons with which something presses on it now."""
        return 0.0 - upward_touch(self._model, self._data, [self._body])


SETTLE_S = 1.0
COARSE_TIMESTEP_S = 0.008  # three times as fast, and good where nothing but the table touches the bag
CLEARANCE_M = 0.03  # further than the hand moves in one control period
FINGERTIP_M = 0.009  # how far the fingers reach beyond the tool point
DROP_HEIGHT_M = 0.02
SECOND_HOME = PlanarPose(0.5, 0.25)  # clear of the first, until it is told where


class World(ArmWorld):
    """The arm, a bag, or two, and what else lies on the table."""

    def __init__(
        self,
        cell: Cell,
        bag: BagParameters | None = None,
        second: BagParameters | None = None,
        distractors: Sequence[Distractor] = (),
    ) -> None:
        self.bag = bag or BagParameters()
        self.distractors = tuple(distractors)
        super().__init__(cell, build_model(cell, self.bag, second, self.distractors))
        self._bag = SoftBody(self.model, self.data, BAG, self.bag)
        self._second = SoftBody(self.model, self.data, SECOND_BAG, second) if second else None
        self.block = Block(self.model, self.data)
        """Firm, for an arm to feel; away until it is laid."""
        self.reset(PlanarPose(0.5, 0.0))

    # -- time ---------------------------------------------------------------------------------------------------

    def _choose_timestep(self, seconds: float) -> float:
        """Coarse as long as the hand is well above whatever it could touch."""
        coarse = self._hand_is_clear()
        # Newton's method is exact when cloth is squeezed; at rest one step of conjugate gradients is as good.
        self.model.opt.solver = mujoco.mjtSolver.mjSOL_CG if coarse else mujoco.mjtSolver.mjSOL_NEWTON
        return COARSE_TIMESTEP_S if coarse else TIMESTEP_S

    def _hand_is_clear(self) -> bool:
        fingertips = self.data.site_xpos[self._tool_site, 2] - FINGERTIP_M
        highest = max(self.data.flexvert_xpos[:, 2].max(), self.block.height_m)
        return bool(fingertips - highest > CLEARANCE_M)

    def reset(self, bag_pose: PlanarPose, second_pose: PlanarPose | None = None) -> None:
        """Arm home, gripper open, the bag dropped flat at this pose without dents, everything at rest.

        So is the second bag at its own pose, where there is one.
        """
        self._reset_arm()
        self.block.take_away()
        if self._second is not None:
            self._second.put(second_pose or SECOND_HOME, DROP_HEIGHT_M, undented=True)
        self.put_bag(bag_pose, undented=True)
        self.advance(SETTLE_S)

    # -- bags, card and printed sheets -------------------------------------------------------------------------

    def put_bag(self, pose: PlanarPose, height: float = DROP_HEIGHT_M, *, undented: bool) -> None:
        """Lay the bag, at rest, with its centre `height` metres above the table; its dents stay unless `undented`."""
        self._bag.put(pose, height, undented=undented)
        mujoco.mj_forward(self.model, self.data)

    @property
    def bag_points(self) -> FloatArray:
        """`(P, 3)` metres: the bag's surface points now."""
        return self._bag.points

    def bag_pose(self) -> PlanarPose:
        """The bag's true centre and yaw."""
        return self._bag.pose()

    def second_pose(self) -> PlanarPose | None:
        """The same of the second bag, where there is one."""
        return self._second.pose() if self._second else None

    def put_card(self, pose: PlanarPose | None) -> None:
        """Lay the printed goal card on the table, or take it away."""
        at = (0.0, 0.0, -1.0) if pose is None else (pose.x, pose.y, 0.0006)
        yaw = 0.0 if pose is None else pose.yaw
        card = int(self.model.body("card").mocapid[0])
        self.data.mocap_pos[card] = at
        self.data.mocap_quat[card] = [np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)]
        mujoco.mj_forward(self.model, self.data)

    def show_sheet(self, target: Target, T_base_target: FloatArray, scale: float = 1.0) -> None:
        """Print a target, `scale` times too large, on the sheet, its own frame at `T_base_target` `(4, 4)`.

        Raises `BaggieError` where it does not fit.
        """
        self._print(SHEET, target, scale, SHEET_SIZE_M, SHEET_TEXTURE)
        T_base_sheet = T_base_target @ invert_transform(T_sheet_target(target, scale))
        sheet = int(self.model.body(SHEET).mocapid[0])
        self.data.mocap_pos[sheet] = T_base_sheet[:3, 3]
        mujoco.mju_mat2Quat(self.data.mocap_quat[sheet], T_base_sheet[:3, :3].ravel())
        mujoco.mj_forward(self.model, self.data)

    def hide_sheet(self) -> None:
        """Take the printed sheet away."""
        self.model.geom(SHEET).rgba[3] = 0.0

    def show_plate(self, target: Target, scale: float = 1.0) -> FloatArray:
        """Print a target, `scale` times too large, on the plate in the hand; `T_hand_target` `(4, 4)`.

        Raises `BaggieError` where it does not fit.
        """
        self._print(ARM + PLATE, target, scale, PLATE_SIZE_M, PLATE_TEXTURE)
        return T_HAND_PLATE @ T_sheet_target(target, scale)

    def hide_plate(self) -> None:
        """Take the printed plate out of the hand."""
        self.model.geom(ARM + PLATE).rgba[3] = 0.0

    def show_paddle(self, shown: bool) -> None:
        """Put the calibration paddle into the hand, or take it away."""
        self.model.geom(f"{ARM}paddle").rgba[3] = 1.0 if shown else 0.0

    # -- what gets bumped ---------------------------------------------------------------------------------------

    def bump_table(self, motion: PlanarPose) -> None:
        """Move the table's top for good, and bag, card and sheet with it; robot, camera and lamps stay.

        Turned about the base frame's origin and then shifted: what was at `pose` is at `motion @ pose`.
        """
        bump_table(self.model, self.data, motion, [bag for bag in (self._bag, self._second) if bag])
        self.update_fixed()

    def _print(
        self, name: str, target: Target, scale: float, size_m: tuple[float, float], shape: tuple[int, int]
    ) -> None:
        """Print a target on the sheet or plate of this name, unless it is on it already, and show it."""
        if self.printed.get(name) != (target, scale):
            paint(self.model, name, texture(target, size_m, shape, scale))
            self.printed[name] = (target, scale)
        self.model.geom(name).rgba[3] = 1.0
