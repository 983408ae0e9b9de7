"""What can lie on the table: what every object promises, and the rigid ones, which are made of boxes.

Rigid objects take another size and colour in a model that is built already: building one takes a second.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Protocol

import numpy as np

from baggie.errors import BaggieError
from baggie.geometry import FloatArray, PlanarPose, planar_pose, rigid
from baggie.types import Image

if TYPE_CHECKING:
    import mujoco
    from scipy.spatial.transform import Rotation

Pose = PlanarPose | FloatArray
"""Flat on the table, or `T_base_body` `(4, 4)`."""
Size = tuple[float, float, float]
Color = tuple[int, int, int]

WOOD_KG_M3 = 600.0
CUP_RADIUS_M = 0.01
"""Of the suction cup that carries blocks."""
# Stacks stand still on contacts that are as stiff as steps of 4 ms allow, without friction that creeps.
_CONTACT = 'friction="0.8 0.005 0.0001" solref="0.01 1" solimp="0.95 0.99 0.001" condim="3"'


class Body(Protocol):
    """An object in a running simulation."""

    settle_s: float
    """Seconds after which it lies still where it was put."""

    def pose(self) -> FloatArray:
        """`T_base_body` `(4, 4)` now; of a soft one, the upright motion that explains its points best."""
        ...

    def planar_pose(self) -> PlanarPose:
        """Where its middle is above the table, and which way its x axis points there."""
        ...

    def top_m(self) -> float:
        """Height of its highest point above the table."""
        ...

    def bottom_m(self) -> float:
        """Height of its lowest point above the table."""
        ...

    def put(self, pose: Pose, *, undented: bool) -> None:
        """Lay it somewhere, at rest, without time passing; the dents of a soft one stay unless `undented`."""
        ...

    def carry_along(self, turn: Rotation, shift: FloatArray) -> None:
        """Move it with the table: turned about the base frame's origin and then shifted by `(3,)` metres."""
        ...


class SceneObject(Protocol):
    """What a person would name: a bag, a block, a stand."""

    @property
    def name(self) -> str:
        """Its name, unique among all on a table."""
        ...

    @property
    def soft(self) -> bool:
        """Whether it gives way."""
        ...

    @property
    def movable(self) -> bool:
        """Whether it can be picked up."""
        ...

    def assets(self) -> str:
        """Its textures and materials, XML."""
        ...

    def xml(self) -> str:
        """Its body, XML."""
        ...

    def paint(self, model: mujoco.MjModel, rng: np.random.Generator) -> None:
        """Give its textures their pictures."""
        ...

    def bind(self, model: mujoco.MjModel, data: mujoco.MjData) -> Body:
        """Find it in a world that has been built with it."""
        ...


def paint(model: mujoco.MjModel, texture: str, picture: Image) -> None:
    """Put a picture `(H, W, 3)` in the place of a texture of that size."""
    start = model.tex_adr[model.texture(texture).id]
    model.tex_data[start : start + picture.size] = picture.ravel()


@dataclass(frozen=True)
class Part:
    """One box of several that are one thing."""

    size_m: Size
    color: Color
    """RGB."""
    position_m: Size
    """Of its middle, in the thing's frame."""


@dataclass(frozen=True)
class Block:
    """A solid box that moves freely; its frame is at its middle."""

    name: str
    size_m: Size = (0.04, 0.04, 0.04)
    color: Color = (200, 60, 50)
    """RGB."""
    density: float = WOOD_KG_M3
    """kg/m³."""
    more: tuple[Part, ...] = ()
    """Further boxes that are one body with it, none inside another; all as high as it is."""

    soft: ClassVar[bool] = False
    movable: ClassVar[bool] = True

    @property
    def parts(self) -> tuple[Part, ...]:
        """All its boxes, itself first."""
        return Part(self.size_m, self.color, (0.0, 0.0, 0.0)), *self.more

    @property
    def mass_kg(self) -> float:
        """What it weighs."""
        return float(self.density * sum(np.prod(part.size_m) for part in self.parts))

    def assets(self) -> str:
        """Give none: it has one colour a box."""
        return ""

    def xml(self) -> str:
        """A free body of its name, its joint's and its first geom's too."""
        more = "".join(
            f"""
      <geom {_box(part.size_m, part.color)} pos="{_numbers(part.position_m)}" density="{self.density}" {_CONTACT}/>"""
            for part in self.more
        )
        return f"""
    <body name="{self.name}">
      <freejoint name="{self.name}"/>
      <geom name="{self.name}" {_box(self.size_m, self.color)} density="{self.density}" {_CONTACT}/>{more}
    </body>"""

    def paint(self, model: mujoco.MjModel, rng: np.random.Generator) -> None:
        """Paint nothing: it has no texture."""

    def bind(self, model: mujoco.MjModel, data: mujoco.MjData) -> RigidBody:
        """Find it in a world that has been built with it."""
        return RigidBody(model, data, self)


@dataclass(frozen=True)
class Fixture:
    """Boxes that are one rigid body and give way to nothing; its frame is at the middle of what lies on the table."""

    name: str
    parts: tuple[Part, ...]

    soft: ClassVar[bool] = False
    movable: ClassVar[bool] = False

    def assets(self) -> str:
        """Give none: it has one colour a box."""
        return ""

    def xml(self) -> str:
        """A body of its name that moves only when it is put somewhere, at first under the table."""
        geoms = "".join(
            f"""
      <geom {_box(part.size_m, part.color)} pos="{_numbers(part.position_m)}" {_CONTACT}/>"""
            for part in self.parts
        )
        return f"""
    <body name="{self.name}" mocap="true" pos="0.4 0 -0.4">{geoms}
    </body>"""

    def paint(self, model: mujoco.MjModel, rng: np.random.Generator) -> None:
        """Paint nothing: it has no texture."""

    def bind(self, model: mujoco.MjModel, data: mujoco.MjData) -> RigidBody:
        """Find it in a world that has been built with it."""
        return RigidBody(model, data, self)


def stand(
    name: str = "stand",
    colors: tuple[Color, Color, Color] = ((70, 70, 70), (130, 130, 130), (190, 190, 190)),
    plate_m: Size = (0.04, 0.04, 0.005),
) -> Fixture:
    """Three plates in a row along y, each in a shade (RGB) of its own, so that a picture shows which way it lies."""
    places = [(0.0, (number - 1) * plate_m[1], plate_m[2] / 2) for number in range(3)]
    return Fixture(name, tuple(Part(plate_m, color, at) for color, at in zip(colors, places, strict=True)))


def distance_m(thing: Block | Fixture, points: FloatArray) -> FloatArray:
    """`(N,)` metres from points `(N, 2)`, in the thing's frame, to what it covers seen from above; 0 upon it."""
    beside = [
        np.abs(points - np.array(part.position_m[:2])) - np.array(part.size_m[:2]) / 2 for part in thing.parts
    ]
    return np.asarray(np.linalg.norm(np.maximum(beside, 0.0), axis=-1).min(axis=0))


def extent_m(thing: Block | Fixture) -> FloatArray:
    """`(2, 2)` metres: the lowest and the highest x and y of what it covers seen from above, in its frame."""
    middles = np.array([part.position_m[:2] for part in thing.parts])
    halves = np.array([part.size_m[:2] for part in thing.parts]) / 2
    return np.array([(middles - halves).min(axis=0), (middles + halves).max(axis=0)])


def reach_m(thing: Block | Fixture) -> float:
    """The radius of the disc about its frame's origin that holds it, seen from above; metres."""
    return float(np.linalg.norm(np.abs(extent_m(thing)).max(axis=0)))


def _box(size_m: Size, color: Color) -> str:
    half = [side / 2 for side in size_m]
    return f'type="box" size="{_numbers(half)}" rgba="{_numbers([value / 255 for value in color])} 1"'


def _numbers(values: Size | list[float]) -> str:
    return " ".join(f"{value:.6f}" for value in values)


class RigidBody:
    """A block or a fixture in a running simulation."""

    settle_s = 0.1

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, thing: Block | Fixture) -> None:
        self._model, self._data = model, data
        self.thing = thing
        self.geoms = _geoms(model, thing.name)
        """Numbers of its boxes in the model; looked up once, as every step asks how high it reaches."""

    def pose(self) -> FloatArray:
        """`T_base_body` `(4, 4)` now."""
        from scipy.spatial.transform import Rotation  # noqa: PLC0415 -- tasks are listed without it

        position, quaternion = self._place()
        return rigid(Rotation.from_quat(quaternion, scalar_first=True).as_matrix(), position)

    def planar_pose(self) -> PlanarPose:
        """Where its middle is above the table, and which way its x axis points there."""
        return planar_pose(self.pose())

    def top_m(self) -> float:
        """A height above the table that no point of it is above."""
        heights = self._data.geom_xpos[self.geoms, 2] + self._model.geom_rbound[self.geoms]
        return float(heights.max())

    def bottom_m(self) -> float:
        """A height above the table that no point of it is below."""
        return float((self._data.geom_xpos[self.geoms, 2] - self._model.geom_rbound[self.geoms]).min())

    def put(self, pose: Pose, *, undented: bool = True) -> None:
        """Lay it somewhere, at rest, without time passing; it takes no dents."""
        from scipy.spatial.transform import Rotation  # noqa: PLC0415 -- as above

        position, quaternion = self._place()
        T = self._standing(pose) if isinstance(pose, PlanarPose) else np.asarray(pose, float)
        position[:] = T[:3, 3]
        quaternion[:] = Rotation.from_matrix(T[:3, :3]).as_quat(scalar_first=True)
        if self.thing.movable:
            dof = int(self._model.joint(self.thing.name).dofadr[0])
            self._data.qvel[dof : dof + 6] = 0.0

    def carry_along(self, turn: Rotation, shift: FloatArray) -> None:
        """Move it with the table: turned about the base frame's origin and then shifted by `(3,)` metres."""
        self.put(rigid(turn.as_matrix(), shift) @ self.pose())

    def _standing(self, pose: PlanarPose) -> FloatArray:
        from scipy.spatial.transform import Rotation  # noqa: PLC0415 -- as above

        height = self.thing.size_m[2] / 2 if isinstance(self.thing, Block) else 0.0
        turn = Rotation.from_euler("z", pose.yaw).as_matrix()
        return rigid(turn, [pose.x, pose.y, height])

    def _place(self) -> tuple[FloatArray, FloatArray]:
        """Position `(3,)` and quaternion `(4,)`, w first, to read and to write."""
        name = self.thing.name
        if self.thing.movable:
            start = int(self._model.joint(name).qposadr[0])
            return self._data.qpos[start : start + 3], self._data.qpos[start + 3 : start + 7]
        body = int(self._model.body(name).mocapid[0])
        return self._data.mocap_pos[body], self._data.mocap_quat[body]


def reshape(model: mujoco.MjModel, data: mujoco.MjData, thing: Block | Fixture) -> None:
    """Make what has this name look and weigh as if the model had been built with it.

    `data` is used up: reset it afterwards. Raises `BaggieError` for what is of several boxes, or a fixture, and of
    others than it was built of; its colours may differ.
    """
    geoms = _geoms(model, thing.name)
    if isinstance(thing, Block) and len(geoms) == len(thing.parts) == 1:
        _resize(model, data, thing, geoms[0])
    else:
        _check_parts(model, thing, geoms)
    for geom, part in zip(geoms, thing.parts, strict=True):
        model.geom_rgba[geom, :3] = np.array(part.color) / 255


def _resize(model: mujoco.MjModel, data: mujoco.MjData, block: Block, geom: int) -> None:
    import mujoco  # noqa: PLC0415 -- things are plain data where nothing is simulated

    body = model.body(block.name).id
    half = np.array(block.size_m) / 2
    mass = block.mass_kg
    if np.allclose(model.geom_size[geom], half, atol=1e-9) and np.isclose(model.body_mass[body], mass):
        return
    model.geom_size[geom] = half
    model.geom_rbound[geom] = np.linalg.norm(half)
    model.geom_aabb[geom, 3:] = half
    model.bvh_aabb[model.body_bvhadr[body], 3:] = half
    model.body_mass[body] = mass
    # A solid box about its middle; the frame of its inertia is the body's own, whichever axis is longest.
    model.body_inertia[body] = mass / 3 * (np.sum(half**2) - half**2)
    mujoco.mj_setConst(model, data)  # what follows from masses


def _check_parts(model: mujoco.MjModel, thing: Block | Fixture, geoms: list[int]) -> None:
    built = [2 * model.geom_size[geom] for geom in geoms]
    wanted = [part.size_m for part in thing.parts]
    if len(built) != len(wanted) or not np.allclose(built, wanted, atol=2e-6):
        raise BaggieError(
            f"expected {thing.name!r} of the boxes it was built of, {np.round(built, 6).tolist()} m, got "
            f"{wanted}; only its colours may change"
        )


def _geoms(model: mujoco.MjModel, name: str) -> list[int]:
    start = int(model.body(name).geomadr[0])
    return list(range(start, start + int(model.body(name).geomnum[0])))
