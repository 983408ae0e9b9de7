"""The running simulation of the arm and what lies on the table: any number of objects, soft and rigid.

There are printed sheets, a firm block for an arm to feel, and a table top that can be knocked, too.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from baggie.errors import BaggieError
from baggie.geometry import FloatArray, PlanarPose, invert_transform
from baggie.sim.arm_world import FINE, ArmWorld, Stepping, Suction, upward_touch
from baggie.sim.bag import Bag
from baggie.sim.cell import Cell
from baggie.sim.objects import Block, Body, Fixture, Pose, RigidBody, SceneObject, paint, reshape
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
from baggie.sim.renderer import HIDDEN_GROUP
from baggie.sim.scene import (
    ARM,
    BLOCK,
    BLOCK_AWAY,
    BLOCK_HALF_M,
    T_HAND_PLATE,
    Tool,
    build_model,
)
from baggie.sim.variety import Distractor
from baggie.vision.height_map import DepthCamera
from baggie.vision.targets import Target

COARSE = Stepping(0.008)
"""Good where nothing but the table touches what lies on it."""
SOFT_AT_REST = Stepping(0.008, mujoco.mjtSolver.mjSOL_CG)
"""What no hand is near: conjugate gradients are as good for it as Newton's method, and cheaper."""
SOFT = Stepping(0.006, iterations=3)
"""What a hand squeezes: with more iterations its cloth chatters, by hundreds of newtons, and slips out of the hand."""
PERIOD_S = 0.008
"""Between two looks at the seal of a cup."""
HAND_CLEARANCE_M, CUP_CLEARANCE_M = 0.03, 0.02  # further than the hand moves in one control period
FINGERTIP_M = 0.009  # how far the fingers reach beyond the tool point
ASIDE_X_M, ASIDE_SPACING_M = -1.0, 0.3  # where things wait that play no part, behind the robot


class World(ArmWorld):
    """The arm and what lies on the table."""

    def __init__(
        self,
        cell: Cell,
        things: Sequence[SceneObject] = (Bag(),),
        tool: Tool = "hand",
        distractors: Sequence[Distractor] = (),
        cameras: Sequence[DepthCamera] = (),
    ) -> None:
        """`cameras`: for `DepthRenderer`. Raises `BaggieError` where two things have the same name."""
        self.things = {thing.name: thing for thing in things}
        if len(self.things) < len(things):
            names = [thing.name for thing in things]
            raise BaggieError(f"expected a name of its own for everything on the table, got {names}")
        self.distractors = tuple(distractors)
        super().__init__(cell, build_model(cell, things, tool, distractors, cameras))
        self.bodies: dict[str, Body] = {
            name: thing.bind(self.model, self.data) for name, thing in self.things.items()
        }
        self.movable = [name for name, thing in self.things.items() if thing.movable]
        self._block = FirmBlock(self.model, self.data) if tool == "hand" else None
        self.suction = Suction(self.model, self.data, self.movable) if tool == "cup" else None
        self._geoms = {n: b.geoms for n, b in self.bodies.items() if isinstance(b, RigidBody)}
        self._soft = any(thing.soft for thing in things)
        places = np.linspace(-0.3, 0.3, len(self.movable)) if len(self.movable) > 1 else [0.0]
        self.reset({name: PlanarPose(0.5, float(y)) for name, y in zip(self.movable, places, strict=True)})

    # -- time ---------------------------------------------------------------------------------------------------

    def advance(self, seconds: float) -> None:
        """Let physics run; what a cup holds too loosely for what pulls at it is lost within `PERIOD_S`."""
        if self.suction is None:
            super().advance(seconds)
            return
        for _ in range(max(round(seconds / PERIOD_S), 1)):
            super().advance(min(seconds, PERIOD_S))
            self.suction.check()

    def advance_awake(self, seconds: float) -> None:
        """Let physics run, and nothing sleep meanwhile: what would fall, slide or sink does so."""
        with self._awake():
            self.advance(seconds)

    def _stepping(self, seconds: float) -> Stepping:
        """Coarse as long as the tool, and what it carries, is well above whatever it could touch."""
        if self.suction:
            return COARSE if seconds >= COARSE.longest_s and self._cup_is_clear() else FINE
        if self._soft:
            return SOFT_AT_REST if self._hand_is_clear() else SOFT
        return COARSE if self._hand_is_clear() else FINE

    def _hand_is_clear(self) -> bool:
        fingertips = self.data.site_xpos[self._tool_site, 2] - FINGERTIP_M
        block = [self._block.height_m] if self._block else []
        highest = max([*(self.bodies[name].top_m() for name in self.movable), *block], default=0.0)
        return bool(fingertips - highest > HAND_CLEARANCE_M)

    def _cup_is_clear(self) -> bool:
        """Whether the cup, or what hangs from it, is well above the highest of what does not."""
        held = self.suction.held if self.suction else None
        lowest = self.data.site_xpos[self._tool_site, 2]
        if held is not None:
            lowest = self.bodies[held].bottom_m()
        highest = max((self.bodies[name].top_m() for name in self.movable if name != held), default=0.0)
        return bool(lowest - max(highest, 0.0) >= CUP_CLEARANCE_M)

    @property
    def block(self) -> FirmBlock:
        """The firm block for a hand to feel; away until it is laid. Raises `BaggieError` where the arm has no hand."""
        if self._block is None:
            raise BaggieError("expected an arm with a hand, to feel a firm block, got one with a suction cup")
        return self._block

    # -- things -------------------------------------------------------------------------------------------------

    def reset(self, poses: Mapping[str, Pose], aside: Collection[str] = ()) -> None:
        """Arm home, tool empty, everything at its pose, at rest, undented; fixtures without one go under the table.

        `aside`: what plays no part; unseen, it waits behind the robot. Raises `BaggieError` where anything else that
        can be moved has no pose, or a pose nothing.
        """
        poses = {**poses, **self._aside(aside)}
        if not set(self.movable) <= set(poses) <= set(self.things):
            raise BaggieError(
                f"expected poses of all of {sorted(self.movable)} and at most of "
                f"{sorted(set(self.things) - set(self.movable))} besides, got poses of {sorted(poses)}"
            )
        self._reset_arm()
        if self._block is not None:
            self._block.take_away()
        if self.suction is not None:
            self.suction.off()
        for name, geoms in self._geoms.items():
            if name in self.movable:
                self.model.geom_group[geoms] = HIDDEN_GROUP if name in aside else 0
        for name, pose in poses.items():
            self.bodies[name].put(pose, undented=True)
        mujoco.mj_forward(self.model, self.data)
        self.advance(max((body.settle_s for body in self.bodies.values()), default=0.0))

    def reshape(self, things: Iterable[SceneObject]) -> None:
        """Give what has the names of these rigid things their sizes, weights and colours; `reset` has to follow.

        Raises `BaggieError` where nothing has this name, or what is of several boxes is not of those it was built of.
        """
        for thing in things:
            if thing.name not in self.things:
                raise BaggieError(f"expected one of {[*self.things]}, got {thing.name!r}")
            if not isinstance(thing, Block | Fixture):
                raise BaggieError(f"expected a rigid thing, got {thing.name!r}, which takes another world")
            reshape(self.model, self.data, thing)
            self.things[thing.name] = thing
            self.bodies[thing.name] = thing.bind(self.model, self.data)

    def put(self, name: str, pose: Pose, *, undented: bool = False) -> None:
        """Put a thing somewhere, at rest, without time passing; dents stay unless `undented`.

        Raises `BaggieError` where nothing has this name.
        """
        if name not in self.things:
            raise BaggieError(f"expected one of {[*self.things]}, got {name!r}")
        self.bodies[name].put(pose, undented=undented)
        mujoco.mj_forward(self.model, self.data)

    def pose(self, name: str) -> FloatArray:
        """`T_base_body` `(4, 4)` of a thing now."""
        return self.bodies[name].pose()

    def poses(self) -> dict[str, FloatArray]:
        """Poses `T_base_body` `(4, 4)` of all objects now, by name."""
        return {name: body.pose() for name, body in self.bodies.items()}

    def planar_pose(self, name: str) -> PlanarPose:
        """Where a thing's middle is above the table, and which way its x axis points there."""
        return self.bodies[name].planar_pose()

    def _aside(self, names: Collection[str]) -> dict[str, PlanarPose]:
        return {
            name: PlanarPose(ASIDE_X_M, ASIDE_SPACING_M * number) for number, name in enumerate(sorted(names))
        }

    # -- card and printed sheets --------------------------------------------------------------------------------

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
        bump_table(self.model, self.data, motion, [self.bodies[name] for name in self.movable])
        self.update_fixed()

    def _print(
        self, name: str, target: Target, scale: float, size_m: tuple[float, float], shape: tuple[int, int]
    ) -> None:
        """Print a target on the sheet or plate of this name, unless it is on it already, and show it."""
        if self.printed.get(name) != (target, scale):
            paint(self.model, name, texture(target, size_m, shape, scale))
            self.printed[name] = (target, scale)
        self.model.geom(name).rgba[3] = 1.0


def bump_table(
    model: mujoco.MjModel, data: mujoco.MjData, motion: PlanarPose, bodies: Sequence[Body]
) -> None:
    """Move the top for good, and with it the bodies, the card and the sheet: what was at `pose` is at `motion @ pose`.

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
    for body in bodies:
        body.carry_along(turn, shift)


class FirmBlock:
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
        """Lay the block with its middle at this place, its top at this height, metres; its sides stay along x and y."""
        self.pose, self.height_m = pose, height_m
        self._put((pose.x, pose.y, height_m - BLOCK_HALF_M[2]))

    def take_away(self) -> None:
        """Take the block off the table."""
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
