"""Printed sheets in the simulator: thin boards with a picture on them that lies where it should to the micrometre."""

from __future__ import annotations

import mujoco
import numpy as np

from baggie.errors import BaggieError
from baggie.geometry import FloatArray, rigid
from baggie.types import Image
from baggie.vision.targets import Target, pattern

SHEET, PLATE = "sheet", "plate"
# Of geoms, their meshes, materials and textures alike. Sizes are (width, height), metres: A3, and what a hand can hold.
SHEET_SIZE_M = (0.420, 0.297)
PLATE_SIZE_M = (0.12, 0.09)
# (rows, columns): some three to five times as fine as the camera sees them. Powers of two: the renderer halves textures
# again and again, and seen from afar a picture of any other size is stretched, by up to a thousandth.
SHEET_TEXTURE = (1024, 2048)
PLATE_TEXTURE = (512, 512)
PAPER_RGB = (0.8, 0.8, 0.8)
"""How light paper is: in the brightest cell it stays just below what saturates the camera."""
_THICKNESS_M = 0.0005
_INK = 26  # of 255: black print is not quite black


def add_printed(
    spec: mujoco.MjSpec,
    body: mujoco.MjsBody,
    name: str,
    size_m: tuple[float, float],
    shape: tuple[int, int],
) -> mujoco.MjsGeom:
    """Give a body a printed board, hidden for now: no mass, touches nothing.

    Its frame is as a target's: the origin in the middle of the print, x right, y down, z into the paper.
    """
    rows, columns = shape
    spec.add_texture(
        name=name,
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
        rgb1=[1, 1, 1],
        width=columns,
        height=rows,
    )
    material = spec.add_material(name=name, specular=0, shininess=0)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])  # from the print's top left corner clockwise
    front = np.c_[(square - 0.5) * size_m, np.zeros(4)]
    back = np.c_[(square - 0.5) * size_m, np.full(4, _THICKNESS_M)]
    quads = [[3, 2, 1, 0], [4, 5, 6, 7], *([k, (k + 1) % 4, (k + 1) % 4 + 4, k + 4] for k in range(4))]
    faces = np.array([[[a, b, c], [a, c, d]] for a, b, c, d in quads])
    picture = np.zeros_like(faces)  # the back and the sides have the colour of the print's corner: paper
    picture[0] = faces[0]
    spec.add_mesh(
        name=name,
        uservert=np.r_[front, back].ravel(),
        userface=faces.ravel(),
        usertexcoord=square.ravel(),
        userfacetexcoord=picture.ravel(),
    )
    return body.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=name,
        material=name,
        rgba=[*PAPER_RGB, 0.0],
        contype=0,
        conaffinity=0,
        mass=0,
    )


def texture(target: Target, size_m: tuple[float, float], shape: tuple[int, int], scale: float = 1.0) -> Image:
    """A target in the middle of a sheet of `size_m` (width, height), as a picture of `shape` (rows, columns).

    Each pixel has the exact mean of what is under it. Raises `BaggieError` where the target, printed `scale` times too
    large, does not fit.
    """
    drawing = pattern(target)
    if (scale * drawing.size > np.array(size_m) + 1e-9).any():
        raise BaggieError(
            f"{target.spec} is {_mm(scale * drawing.size)} mm, and the sheet it is to be shown on {_mm(size_m)} mm; "
            "take smaller squares or fewer"
        )
    in_sheet = scale * (drawing.black.reshape(-1, 2, 2) - drawing.middle) + np.array(size_m) / 2
    corners = in_sheet / size_m * shape[::-1]
    ink = np.zeros(shape)
    for (left, top), (right, bottom) in corners:
        rows, by_row = _covered(top, bottom)
        columns, by_column = _covered(left, right)
        ink[rows, columns] += np.outer(by_row, by_column)
    grey = np.round(255 - (255 - _INK) * ink).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=2)


def T_sheet_target(target: Target, scale: float = 1.0) -> FloatArray:
    """`(4, 4)`: where the frame of a target printed `scale` times too large is, for the sheet with it in its middle."""
    return rigid(np.eye(3), [*(-scale * pattern(target).middle), 0.0])


def _covered(start: float, end: float) -> tuple[slice, FloatArray]:
    """The pixels that the interval from `start` to `end` reaches into, and how much of each it covers.

    Pixel k is from k to k + 1.
    """
    pixels = np.arange(int(np.floor(start + 1e-6)), int(np.ceil(end - 1e-6)))
    covered = np.minimum(pixels + 1, end) - np.maximum(pixels, start)
    return slice(pixels[0], pixels[-1] + 1), covered


def _mm(size_m: FloatArray | tuple[float, float]) -> str:
    return " x ".join(f"{1000 * float(side):.0f}" for side in size_m)
