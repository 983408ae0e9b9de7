"""Blocks and fixtures of another size or colour in a model that is built already: building one takes a second."""

from __future__ import annotations

import mujoco
import numpy as np

from baggie.errors import BaggieError
from baggie.sim.blocks import Block, Fixture


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
