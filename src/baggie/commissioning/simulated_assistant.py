"""The person beside the simulated workcell.

The person beside a virtual lab, through its control channel.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from baggie import seeds
from baggie.calibration.point_registration import T_world_target
from baggie.errors import BaggieError
from baggie.geometry import FloatArray, PlanarPose, invert_transform, rigid, transform_points
from baggie.lab.web import LabControl
from baggie.seeds import first_fit
from baggie.sim.cell import Cell
from baggie.vision.targets import ArucoMarker, Target
from baggie.workcell.simulated import SimulatedWorkcell

ASIDE = PlanarPose(0.20, 0.55)
"""Where the bag waits: out of the workspace, out of the arm's way."""
TOUCH_STD_M = 0.0003
"""How exactly somebody leads a pointed probe onto a printed corner, for each axis."""
PROBE_M = 0.03
"""How far the probe in the gripper reaches beyond the tool point."""
BLOCK_M = 0.04
"""High is the firm block."""
_TRIES = 200
_COLUMNS, _ROWS = 5, 4
"""Parts of the picture a board is shown in, one after the other."""


class SimulatedAssistant:
    """Does in the world what `Assistant` asks for; draws where and how from the cell's own stream of calibrations."""

    def __init__(self, cell: SimulatedWorkcell, seed: int) -> None:
        self._cell = cell
        self._rng = seeds.generator(seeds.CALIBRATION, seed, 1)
        self._shown = 0
        self._seed = seed
        self._laid = ""
        self.T_base_target: FloatArray = np.eye(4)
        """Where the target that lies on the table truly is."""

    def show(self, target: Target, words: str) -> None:
        """The board at a random distance and tilt, in another part of the picture each time."""
        self._cell.show_target(target, board_in_view(self._cell.world.cell, target, self._shown, self._rng))
        self._shown += 1

    def clear_table(self) -> None:
        """Put the bag aside."""
        self._cell.lay_aside(ASIDE)
        self._cell.world.advance(0.5)

    def lay(self, target: Target, words: str) -> None:
        """Flat on the table, about upright in the picture: a marker anywhere, a board in the middle, where it stays.

        That is, the same cell and seed always find the board at the same place.
        """
        rng = (
            self._rng
            if isinstance(target, ArucoMarker)
            else seeds.generator(seeds.CALIBRATION, self._seed, 4)
        )
        x, y = rng.uniform(0.47, 0.53), rng.uniform(-0.03, 0.03)
        if isinstance(target, ArucoMarker):
            x, y = self._cell.settings.workspace.sample(rng, 0.04)
        self.lay_at(target, PlanarPose(float(x), float(y), float(rng.uniform(-0.2, 0.2) - np.pi / 2)))

    def lay_at(self, target: Target, pose: PlanarPose) -> None:
        """At a pose, as `lying` has it."""
        self._laid, self.T_base_target = target.spec, lying(target, pose)
        self._cell.show_target(target, self.T_base_target)

    def hold(self, target: Target | None, words: str) -> None:
        """On the plate in front of the fingertips, or the paddle that the collector uses."""
        self._cell.hold_target(target)
        self._cell.show_paddle(target is None)

    def lay_firm(self, heights_m: tuple[float, float], words: str) -> float | None:
        """The block, under the hand, and the bag out of its way."""
        self.clear_table()
        self._cell.world.block.lay(self._cell.arm.pose().planar, BLOCK_M)
        return BLOCK_M

    def confirm(self, question: str) -> bool | None:
        """Nobody looks."""
        return None

    def clock(self) -> float:
        """Simulated."""
        return self._cell.clock()

    def lead_to(self, T_base_hand: FloatArray | None, words: str) -> None:
        """There, as exactly as the joints can."""
        assert T_base_hand is not None
        self._cell.lead_hand(T_base_hand)

    def touch(self, target: Target, point: FloatArray, words: str) -> None:
        """The tip of the probe, held straight down, onto the point, as steadily as a hand can."""
        if self._laid != target.spec:
            self.lay(target, "")
        T_base_world = self.T_base_target @ invert_transform(T_world_target(target))
        x, y = np.rint(1000 * point[:2]).astype(
            int
        )  # each point has a stream of its own, whenever it is touched
        noise = seeds.generator(seeds.CALIBRATION, self._seed, 5, int(x), int(y)).normal(0.0, TOUCH_STD_M, 3)
        tip = transform_points(T_base_world, point[None])[0] + noise
        self._cell.lead_hand(rigid(np.diag([1.0, -1.0, -1.0]), tip + np.array([0.0, 0.0, PROBE_M])))

    def measure_touch(self, words: str) -> FloatArray | None:
        """The true distance."""
        return self._cell.arm.pose().xyz[:2] - transform_points(self.T_base_target, np.zeros((1, 3)))[0, :2]

    def put_away(self) -> None:
        """Out of hand and view."""
        self._cell.world.block.take_away()
        self._cell.hold_target(None)
        self._cell.show_paddle(False)
        self._cell.hide_target()


def board_in_view(cell: Cell, target: Target, part: int, rng: np.random.Generator) -> FloatArray:
    """`T_base_target` `(4, 4)` of a board held above the table and before the camera, at random, most of it in view.

    `part` counts: each is another part of the picture. Raises `BaggieError` where the camera sees no such board.
    """
    column, row = part % _COLUMNS, part // _COLUMNS % _ROWS

    def somewhere() -> FloatArray:
        pixel = (np.array([column, row]) + rng.uniform(0.1, 0.9, 2)) / [_COLUMNS, _ROWS] * cell.lens.size
        ray = np.append(cell.lens.intrinsics.rays(pixel[None])[0], 1.0)
        roll, *tilt = *rng.uniform(-20, 20, 1), *rng.uniform(-40, 40, 2)
        rotation = Rotation.from_euler("zxy", [roll, *tilt], degrees=True).as_matrix()
        middle = rotation @ target.points.mean(axis=0)
        T_camera_target = rigid(rotation, ray * rng.uniform(0.28, 0.55) - middle)
        return invert_transform(cell.T_camera_base) @ T_camera_target

    def in_view(T_base_target: FloatArray) -> bool:
        points = transform_points(T_base_target, target.points)
        pixels = cell.project(points)
        inside = ((pixels > 5) & (pixels < np.array(cell.lens.size) - 5)).all(axis=1)
        return bool(points[:, 2].min() > 0.08 and inside.mean() > 0.6)

    T_base_target = first_fit(somewhere, in_view, _TRIES)
    if T_base_target is None:
        raise BaggieError(
            f"expected a camera that sees most of {target.spec} 28 to 55 cm before it and 8 cm above the table, in "
            f"column {column}, row {row} of its picture, got cell {cell.number}; take a smaller board"
        )
    return T_base_target


def lying(target: Target, pose: PlanarPose) -> FloatArray:
    """`T_base_target` `(4, 4)` of a target flat on the table, face up, the middle of its points at `pose`."""
    c, s = np.cos(pose.yaw), np.sin(pose.yaw)
    rotation = np.array([[c, s, 0.0], [s, -c, 0.0], [0.0, 0.0, -1.0]])
    middle = target.points.mean(axis=0) * [1.0, 1.0, 0.0]  # however it sags, its corners are on the table
    return rigid(rotation, np.array([pose.x, pose.y, 0.0]) - rotation @ middle)


class LabAssistant:
    """Does in the lab what `Helper` asks for. Raises `BaggieError` where no lab answers."""

    def __init__(self, control: LabControl) -> None:
        self._control = control

    def hold(self, target: Target | None, words: str) -> None:
        """The paddle, whatever it is to be."""
        self._control.show_paddle(True)

    def lay_firm(self, heights_m: tuple[float, float], words: str) -> float | None:
        """The block, under the hand, and all bags out of its way."""
        tool = self._control.truth()["tool"]
        self._control.lay_aside(ASIDE)
        self._control.lay_block(PlanarPose(tool["x"], tool["y"]), BLOCK_M)
        return BLOCK_M

    def confirm(self, question: str) -> bool | None:
        """Nobody looks."""
        return None

    def clock(self) -> float:
        """The lab's, which is not the wall clock's on a busy computer."""
        return float(self._control.truth()["time"])

    def put_away(self) -> None:
        """Out of hand and off the table; bags stay aside."""
        self._control.show_paddle(False)
        self._control.take_block_away()
