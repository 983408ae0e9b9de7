"""The bean bag: a soft pillow as a MuJoCo flex, and its body in a running simulation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from baggie.errors import BaggieError
from baggie.geometry import FloatArray, PlanarPose, planar_pose
from baggie.sim.objects import Pose, paint
from baggie.types import Image

if TYPE_CHECKING:
    import mujoco
    from scipy.spatial.transform import Rotation

GRID = 7  # points along each side; 7 x 7 points on 4 x 4 x 1 cells is the coarsest that still drapes
LONG_ASPECT = 1.2
"""How many times longer than wide a long bag is at least."""
FULL_HEIGHT_M = 0.03
"""How thick a bag with a fill of 1 is once it has settled."""
DROP_HEIGHT_M = 0.02
"""From where it settles when it is laid somewhere."""

Shape = Literal["square", "round", "long"]
Fabric = Literal["plain", "weave", "stripes", "checks", "dots"]


@dataclass(frozen=True)
class Bag:
    """A bean bag and what it is made of. The defaults are 200 g and 12 cm of what a hand would call soft."""

    length_m: float = 0.12
    """Along its own x: the long side of a long bag."""
    width_m: float = 0.12
    """Along its own y."""
    fill: float = 1.0
    """How full it is: 1 is 3.2 cm thick in the middle."""
    mass_kg: float = 0.2
    young_pa: float = 2500.0
    poisson: float = 0.2
    damping: float = 0.02
    yield_strain: float = 0.1
    """Beyond this strain it keeps the dent."""
    friction: float = 1.0
    color: tuple[int, int, int] = (196, 40, 44)
    """RGB of the cloth."""
    weave: float = 0.12
    """Contrast of the cloth's threads, mottle and seam; 0 for none of them."""
    shape: Shape = "square"
    fabric: Fabric = "weave"
    accent: tuple[int, int, int] = (118, 24, 26)
    """RGB of what is printed on stripes, checks and dots."""
    repeat_m: float = 0.03
    """After how much cloth the print repeats."""
    name: str = "bag"
    """Its own among all things on a table."""

    soft: ClassVar[bool] = True
    movable: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if self.shape == "long" and self.length_m < LONG_ASPECT * self.width_m:
            raise BaggieError(
                f"expected a long bag at least {LONG_ASPECT} times as long as wide, got {self.length_m:.3f} x "
                f"{self.width_m:.3f} m; make it longer or its shape square"
            )
        if self.shape == "round" and self.length_m != self.width_m:
            raise BaggieError(
                f"expected a round bag as long as wide, got {self.length_m:.3f} x {self.width_m:.3f} m; "
                "give both sides its diameter"
            )

    @property
    def symmetry(self) -> int:
        """How many times a turn it looks the same: 4 for a square, 2 for a long one; 0 means at any angle, round."""
        return {"square": 4, "long": 2, "round": 0}[self.shape]

    @property
    def size_m(self) -> tuple[float, float, float]:
        """Length, width and resting height."""
        return self.length_m, self.width_m, FULL_HEIGHT_M * self.fill

    @property
    def thickness_m(self) -> float:
        """Thickness in the middle before it settles."""
        return 0.032 * self.fill

    def assets(self) -> str:
        """The texture and the material of its cloth, XML."""
        return f"""
    <texture name="{self._cloth}" type="2d" builtin="flat" width="128" height="128" rgb1="1 1 1"/>
    <material name="{self._cloth}" texture="{self._cloth}" specular="0.05"/>"""

    def xml(self) -> str:
        """Its `flexcomp`, XML; its middle starts at the origin."""
        points, tetrahedra = pillow(self)
        texcoord = points[:, :2] / [self.length_m, self.width_m] + 0.5
        return f"""
    <flexcomp name="{self.name}" type="direct" dim="3" dof="trilinear" cellcount="4 4 1"
        mass="{self.mass_kg}" radius="0.001" material="{self._cloth}"
        point="{_join(points)}" element="{_join(tetrahedra)}" texcoord="{_join(texcoord)}">
      <contact condim="3" friction="{self.friction}" solref="0.01 1" selfcollide="none"/>
      <elasticity young="{self.young_pa}" poisson="{self.poisson}" damping="{self.damping}"
          yield="{self.yield_strain}"/>
    </flexcomp>"""

    def paint(self, model: mujoco.MjModel, rng: np.random.Generator) -> None:
        """Give its cloth a picture, drawn from a stream."""
        paint(model, self._cloth, cloth(rng, self))

    def bind(self, model: mujoco.MjModel, data: mujoco.MjData) -> SoftBody:
        """Find it in a world that has been built with it."""
        return SoftBody(model, data, self)

    @property
    def _cloth(self) -> str:
        return f"{self.name.replace(' ', '_')}_cloth"  # MuJoCo takes spaces for the end of a name

    @classmethod
    def random(cls, rng: np.random.Generator) -> Bag:
        """A bag of another size, stiffness, mass, fill, colour and cloth."""
        side = rng.uniform(0.105, 0.13)
        red, green, blue = rng.integers(20, 220, 3).tolist()
        return cls(
            length_m=side,
            width_m=side * rng.uniform(0.95, 1.05),
            fill=rng.uniform(0.9, 1.1),
            mass_kg=rng.uniform(0.15, 0.25),
            young_pa=rng.uniform(2000.0, 3000.0),
            friction=rng.uniform(0.9, 1.1),
            color=(red, green, blue),
            weave=rng.uniform(0.0, 0.2),
        )


def pillow(bag: Bag) -> tuple[FloatArray, np.ndarray]:
    """Points `(P, 3)` metres about the bag's centre, and tetrahedra `(T, 4)`, of two sheets that meet in a seam.

    A round bag is the square one with its grid mapped to a disc (elliptical grid mapping, Fong 2015, arXiv:1509.06344).
    """
    grid = np.linspace(-1.0, 1.0, GRID)
    points: list[tuple[float, float, float]] = []
    index: dict[tuple[int, int, int], int] = {}
    for i, u in enumerate(grid):
        for j, v in enumerate(grid):
            half = 0.5 * bag.thickness_m * ((1 - u * u) * (1 - v * v)) ** 0.25
            sides = (-1, 1) if half > 0 else (0,)
            for side in sides:
                index[i, j, side] = len(points)
                x, y = _on_disc(u, v) if bag.shape == "round" else (u, v)
                points.append((x * bag.length_m / 2, y * bag.width_m / 2, side * half))

    def vertex(i: int, j: int, side: int) -> int:
        return index.get((i, j, side), index.get((i, j, 0), -1))

    vertices = np.array(points)
    tetrahedra = []
    for i in range(GRID - 1):
        for j in range(GRID - 1):
            corners = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
            # Each quad is two prisms, each prism three tetrahedra. The diagonals run towards the bag's corners, so
            # that no corner is left without volume.
            outward = (2 * i + 2 - GRID) * (2 * j + 2 - GRID) >= 0
            for triangle in ((0, 1, 2), (0, 2, 3)) if outward else ((1, 2, 3), (1, 3, 0)):
                b0, b1, b2 = (vertex(*corners[k], -1) for k in triangle)
                t0, t1, t2 = (vertex(*corners[k], 1) for k in triangle)
                for tetrahedron in ((b0, b1, b2, t2), (b0, b1, t2, t1), (b0, t1, t2, t0)):
                    if len(set(tetrahedron)) == 4:  # at the seam prisms collapse
                        tetrahedra.append(_right_handed(vertices, tetrahedron))
    return vertices, np.array([t for t in tetrahedra if t is not None])


def _on_disc(u: float, v: float) -> tuple[float, float]:
    """The point of the square from -1 to 1 on the unit disc; the square's outline becomes the circle."""
    return u * (1 - v * v / 2) ** 0.5, v * (1 - u * u / 2) ** 0.5


def _right_handed(points: FloatArray, tetrahedron: tuple[int, ...]) -> tuple[int, ...] | None:
    """The tetrahedron with positive volume; None when it is flat."""
    a, b, c, d = (points[k] for k in tetrahedron)
    volume = float(np.linalg.det(np.array([b - a, c - a, d - a])))
    if abs(volume) < 1e-12:
        return None
    p, q, r, s = tetrahedron
    return tetrahedron if volume > 0 else (p, r, q, s)


def cloth(rng: np.random.Generator, bag: Bag, size: int = 128) -> Image:
    """A bag's cloth, `(size, size, 3)`, stretched over its length and width: threads or a print, a seam at the edge."""
    v, u = np.mgrid[:size, :size]
    threads = np.sin(u * 2 * np.pi / 8) * np.sin(v * 2 * np.pi / 8) if bag.fabric == "weave" else 0.0
    mottle = cv2.resize(rng.normal(size=(8, 8)), (size, size), interpolation=cv2.INTER_CUBIC)
    if bag.shape == "round":
        edge = size / 2 - np.hypot(u - (size - 1) / 2, v - (size - 1) / 2)
    else:
        edge = np.minimum(np.minimum(u, v), np.minimum(size - 1 - u, size - 1 - v))
    seam = -1.5 * np.exp(-(((edge - 8) / 2.0) ** 2))
    printed = _print(
        bag.fabric, u * bag.length_m / size / bag.repeat_m, v * bag.width_m / size / bag.repeat_m
    )
    color = np.where(printed[..., None], bag.accent, bag.color)
    picture = color * (1 + bag.weave * (0.5 * threads + 0.3 * mottle + seam)[..., None])
    return np.asarray(np.clip(picture, 0, 255), np.uint8)


def _print(fabric: Fabric, x: FloatArray, y: FloatArray) -> NDArray[np.bool_]:
    """Where on the cloth the accent's colour is; `x` and `y` in repeats of the print."""
    if fabric == "stripes":
        return np.asarray(y % 1 < 0.5)
    if fabric == "checks":
        return np.asarray((x % 1 < 0.5) ^ (y % 1 < 0.5))
    if fabric == "dots":
        return np.asarray(np.hypot(x % 1 - 0.5, y % 1 - 0.5) < 0.28)
    return np.zeros(np.shape(x), bool)


def _join(values: np.ndarray) -> str:
    return " ".join(f"{value:.6g}" for value in values.ravel())


class SoftBody:
    """A bag in a running simulation: the flex of its name."""

    settle_s = 1.0

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, bag: Bag) -> None:
        import mujoco  # noqa: PLC0415 -- things are plain data where nothing is simulated

        self._model, self._data = model, data
        flex = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_FLEX, bag.name)
        first = int(model.flex_nodeadr[flex])
        nodes = model.flex_nodebodyid[first : first + int(model.flex_nodenum[flex])]
        self._joints = np.array([model.body_jntadr[b] + np.arange(3) for b in nodes])
        self._home = model.body_pos[nodes].copy()
        start = int(model.flex_vertadr[flex])
        self._vertices = slice(start, start + int(model.flex_vertnum[flex]))
        self._dents = _plastic_state(model, flex)
        self._rest, _ = pillow(bag)

    @property
    def points(self) -> FloatArray:
        """`(P, 3)` metres: its surface points now."""
        return np.asarray(self._data.flexvert_xpos[self._vertices].copy())

    def pose(self) -> FloatArray:
        """`T_base_body` `(4, 4)`: `planar_pose` at the mean height of its points."""
        return self.planar_pose().upright(float(self.points[:, 2].mean()))

    def top_m(self) -> float:
        """Height of its highest point above the table."""
        return float(self._data.flexvert_xpos[self._vertices, 2].max())

    def bottom_m(self) -> float:
        """Height of its lowest point above the table."""
        return float(self._data.flexvert_xpos[self._vertices, 2].min())

    def planar_pose(self) -> PlanarPose:
        """Its true centre and yaw: the planar rigid motion that best explains where its points are (Kabsch)."""
        now = self.points[:, :2]
        center = now.mean(axis=0)
        rest = self._rest[:, :2]
        covariance = rest.T @ (now - center)
        yaw = np.arctan2(covariance[0, 1] - covariance[1, 0], covariance[0, 0] + covariance[1, 1])
        return PlanarPose(float(center[0]), float(center[1]), float(yaw))

    def put(self, pose: Pose, *, undented: bool, height_m: float = DROP_HEIGHT_M) -> None:
        """Lay it, at rest, without time passing; its dents stay unless `undented`.

        Flat, its centre `height_m` above the table, from where it settles; or with its middle at a pose `(4, 4)`.
        """
        if not isinstance(pose, PlanarPose):
            height_m, pose = float(pose[2, 3]), planar_pose(pose)
        c, s = np.cos(pose.yaw), np.sin(pose.yaw)
        turned = self._home @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
        self._data.qpos[self._positions] = turned + np.array([pose.x, pose.y, height_m]) - self._home
        self._data.qvel[self._velocities] = 0.0
        if undented:
            self._data.plastic[self._dents] = 0.0

    def carry_along(self, turn: Rotation, shift: FloatArray) -> None:
        """Move it as it is, turned about the base frame's origin and then shifted by `(3,)` metres."""
        nodes = self._home + self._data.qpos[self._positions]
        self._data.qpos[self._positions] = turn.apply(nodes) + shift - self._home
        self._data.qvel[self._velocities] = turn.apply(self._data.qvel[self._velocities])

    @property
    def _positions(self) -> np.ndarray:
        return np.asarray(self._model.jnt_qposadr[self._joints])

    @property
    def _velocities(self) -> np.ndarray:
        return np.asarray(self._model.jnt_dofadr[self._joints])


def _plastic_state(model: mujoco.MjModel, flex: int) -> slice:
    """Where in `data.plastic` the strains stand that stay in a flex; nowhere for one that yields to nothing."""
    start, ends = int(model.flex_plasticadr[flex]), (*model.flex_plasticadr, model.nplastic)
    return slice(0) if start < 0 else slice(start, int(min(end for end in ends if end > start)))
