"""The simulated workcell with blocks: a suction cup, three cameras with depth, and a task.

One simulated camera with depth, as a workcell has it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from baggie.cameras.camera import HeightMapCamera
from baggie.errors import CameraError
from baggie.geometry import Rectangle
from baggie.robot.limits import Limits
from baggie.sim.arm import BLOCK_HANDLING, SuctionArm
from baggie.sim.block_world import BlockWorld
from baggie.sim.cell import draw_cell
from baggie.sim.renderer import DepthRenderer
from baggie.tasks import Task, find_task
from baggie.tasks.demonstrator import next_action, varied_action
from baggie.tasks.layout import REACH
from baggie.tasks.scoring import RavensScore, strict_success
from baggie.types import Intrinsics, Observation, PickPlace
from baggie.vision.height_map import RAVENS_DEPTH_CAMERAS, DepthCamera
from baggie.workcell.simulated import MujocoWorkcell
from baggie.workcell.workcell import WorkcellSettings


class SimulatedDepthCamera:
    """A camera of a world; several share one renderer, whose owner closes it."""

    def __init__(self, camera: DepthCamera, renderer: DepthRenderer) -> None:
        self.name = f"simulated {camera.name} camera"
        self.size = camera.intrinsics.width, camera.intrinsics.height
        self.intrinsics: Intrinsics | None = camera.intrinsics
        self._camera = camera
        self._renderer = renderer
        self._rng = np.random.default_rng()

    def reseed(self, rng: np.random.Generator) -> None:
        """Draw noise from this stream from now on."""
        self._rng = rng

    def look(self) -> Observation:
        """Colour and depth of the world as it is now."""
        return self._renderer.look(self._camera, self._rng)


_FIRST = (0,)
"""Names the scene a workcell opens with."""
_STRAY_M = 0.01  # the arm is not quite where it was sent, at the workspace's edge too


class BlockWorkcell(MujocoWorkcell):
    """A workcell in MuJoCo for tasks with blocks; its pictures are height maps.

    `world`, `scene`, `score`, `demonstrate` and `strict_success` are for demonstrations and evaluation only.
    """

    def __init__(self, task: Task, cell: int = 0, pictures: bool = True) -> None:
        """Without `pictures` it needs no OpenGL, and `look` raises `CameraError`."""
        self.task = task
        cameras = RAVENS_DEPTH_CAMERAS if pictures else ()
        self.world: BlockWorld = BlockWorld(draw_cell(cell), task.blocks, task.fixtures, cameras)
        self._suction_arm = SuctionArm(self.world)
        self._renderer: DepthRenderer | None = None
        self._eyes: list[SimulatedDepthCamera] = []
        camera: HeightMapCamera | NoPictures = NoPictures()
        if pictures:
            lens = RAVENS_DEPTH_CAMERAS[0].intrinsics
            self._renderer = renderer = DepthRenderer(self.world, (lens.width, lens.height))
            self._eyes = [SimulatedDepthCamera(each, renderer) for each in cameras]
            name = f"simulated height map of cell {cell}"
            camera = HeightMapCamera(self._eyes, [each.T_base_camera for each in cameras], name=name)
        super().__init__(self._suction_arm, camera, _settings(task, cell))
        self.reset(_FIRST)

    def reset(self, seed: Sequence[int]) -> None:
        """A new scene of the task, the one these integers name; arm parked, nothing scored yet."""
        rng = np.random.default_rng(list(seed))
        for eye, stream in zip(self._eyes, rng.spawn(len(self._eyes)), strict=True):
            eye.reseed(stream)
        self.scene = self.task.draw(rng)
        self.score = RavensScore(self.scene.stages)
        self.world.reshape([*self.scene.blocks, *self.scene.fixtures])
        idle = {block.name for block in self.task.blocks} - set(self.scene.poses)
        self.world.reset(self.scene.poses, aside=idle)
        self._suction_arm.reset()
        self.arm.park()

    def demonstrate(self, rng: np.random.Generator | None = None) -> PickPlace | None:
        """What a demonstrator who knows where everything is does next; None when all is done, strictly.

        With a stream in the style of others, whose whims are drawn from it (`baggie.tasks.demonstrator`).
        """
        if rng is None:
            return next_action(self.scene.stages, self.world.poses())
        return varied_action(self.scene, self.world.poses(), rng)

    def count(self) -> float:
        """What Ravens rewards since the last call; call it after every pick and place. The sum is `score.total`."""
        return self.score.count(self.world.poses())

    def strict_success(self) -> bool:
        """Whether every block is in a slot of its own, upright, and stays there: two seconds pass if it looks so."""
        return strict_success(self.scene.stages, self.world)

    def close(self) -> None:
        """Free the OpenGL context."""
        if self._renderer is not None:
            self._renderer.close()


class NoPictures:
    """The camera of a workcell that was opened without any."""

    name = "no camera"
    size = (0, 0)
    intrinsics: Intrinsics | None = None

    def look(self) -> Observation:
        """Raises `CameraError`."""
        raise CameraError("expected a workcell with pictures, got one without; open it with pictures=True")


def _settings(task: Task, cell: int) -> WorkcellSettings:
    """The cup goes down to the table, over all of the grid that the arm reaches."""
    largest = max(task.blocks, key=lambda block: block.size_m)
    return WorkcellSettings(
        name=f"sim cell {cell}, {task.name}",
        workspace=REACH,
        limits=Limits(workspace=_wider(REACH), reach=Rectangle(0.15, 0.75, -0.50, 0.50), z_min_m=0.0),
        handling=BLOCK_HANDLING,
        object_color=largest.color,
        object_size_m=largest.size_m,
        object_symmetry=1,  # a cup picks it anywhere, so a plan's turn is carried out as it is said
    )


def _wider(area: Rectangle) -> Rectangle:
    return Rectangle(
        area.x_min - _STRAY_M, area.x_max + _STRAY_M, area.y_min - _STRAY_M, area.y_max + _STRAY_M
    )


def open_block_workcell(task: str, cell: int = 0, pictures: bool = True) -> BlockWorkcell:
    """The simulated workcell with this cell number and the task of this name, one of `baggie.tasks.TASKS`.

    Raises `BaggieError` where there is no such task.
    """
    return BlockWorkcell(find_task(task), cell, pictures)
