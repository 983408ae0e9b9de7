"""The bean bag: a soft pillow as a MuJoCo flex."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from baggie.geometry import FloatArray

GRID = 7  # points along each side; 7 x 7 points on 4 x 4 x 1 cells is the coarsest that still drapes
NAME = "bag"


@dataclass(frozen=True)
class BagParameters:
    """What a bag is made of. The defaults are a 200 g bean bag of 12 cm that a hand would call soft."""

    length_m: float = 0.12
    """Along its own x."""
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
    """Contrast of the cloth's pattern, 0 for plain."""

    @property
    def thickness_m(self) -> float:
        """Thickness in the middle before it settles."""
        return 0.032 * self.fill

    @classmethod
    def random(cls, rng: np.random.Generator) -> BagParameters:
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


def pillow(bag: BagParameters) -> tuple[FloatArray, np.ndarray]:
    """Points `(P, 3)` metres about the bag's centre, and tetrahedra `(T, 4)`, of two sheets that meet in a seam."""
    grid = np.linspace(-1.0, 1.0, GRID)
    points: list[tuple[float, float, float]] = []
    index: dict[tuple[int, int, int], int] = {}
    for i, u in enumerate(grid):
        for j, v in enumerate(grid):
            half = 0.5 * bag.thickness_m * ((1 - u * u) * (1 - v * v)) ** 0.25
            sides = (-1, 1) if half > 0 else (0,)
            for side in sides:
                index[i, j, side] = len(points)
                points.append((u * bag.length_m / 2, v * bag.width_m / 2, side * half))

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


def _right_handed(points: FloatArray, tetrahedron: tuple[int, ...]) -> tuple[int, ...] | None:
    """The tetrahedron with positive volume; None when it is flat."""
    a, b, c, d = (points[k] for k in tetrahedron)
    volume = float(np.linalg.det(np.array([b - a, c - a, d - a])))
    if abs(volume) < 1e-12:
        return None
    p, q, r, s = tetrahedron
    return tetrahedron if volume > 0 else (p, r, q, s)


def bag_xml(bag: BagParameters) -> str:
    """The `flexcomp` element; the bag's centre starts at the origin."""
    points, tetrahedra = pillow(bag)
    texcoord = points[:, :2] / [bag.length_m, bag.width_m] + 0.5
    return f"""
    <flexcomp name="{NAME}" type="direct" dim="3" dof="trilinear" cellcount="4 4 1"
        mass="{bag.mass_kg}" radius="0.001" material="cloth"
        point="{_join(points)}" element="{_join(tetrahedra)}" texcoord="{_join(texcoord)}">
      <contact condim="3" friction="{bag.friction}" solref="0.01 1" selfcollide="none"/>
      <elasticity young="{bag.young_pa}" poisson="{bag.poisson}" damping="{bag.damping}"
          yield="{bag.yield_strain}"/>
    </flexcomp>"""


def _join(values: np.ndarray) -> str:
    return " ".join(f"{value:.6g}" for value in values.ravel())
