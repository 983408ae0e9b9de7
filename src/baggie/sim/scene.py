"""Builds the MuJoCo model: the Franka arm, a table and all that lies on it, printed sheets, lamps and camera."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Literal

import mujoco
import numpy as np

from baggie.errors import BaggieError
from baggie.geometry import FloatArray, rigid
from baggie.sim.bag import SECOND_BAG, BagParameters, bag_xml
from baggie.sim.block import block_xml
from baggie.sim.cell import Cell
from baggie.sim.cup import CUP, CUP_OFFSET_M, fit_cup
from baggie.sim.distractors import Distractor, distractor_xml
from baggie.sim.targets import (
    PLATE,
    PLATE_SIZE_M,
    PLATE_TEXTURE,
    SHEET,
    SHEET_SIZE_M,
    SHEET_TEXTURE,
    add_printed,
)
from baggie.sim.textures import cloth, table_top
from baggie.types import Image
from baggie.vision.goal_card import CARD_COLOR

_MUJOCO = 4  # the first with soft bodies that take dents
TIMESTEP_S = 0.004  # 8 ms halve the time and lose a quarter of the grasps
TOOL_OFFSET_M = (
    0.1034  # from the hand's frame to the point between the fingertips (Franka's hand, data sheet)
)
TABLE_HEIGHT_M = 0.75
HOME = np.array([0.0, -0.5, 0.0, -2.2, 0.0, 1.7, 0.7853])  # a raised, bent elbow; the tool points down
FINGER_GAIN = 10_000.0  # N/m; the stock 100 N/m presses with 2 to 4 N and loses the bag
FINGER_DAMPING = 300.0
WRIST_DAMPING = (
    0.5  # of the file's; with all of it the tool may be 4 mm off, and swinging, when a motion is over
)
PADDLE_OFFSET_M = 0.09
PADDLE_RADIUS_M = 0.025
# In front of the fingertips as the paddle is; at yaw 0 upright in the overhead picture. With the arm stretched out, the
# hand would cover it if it were nearer, and it would leave the picture if it were further away.
T_HAND_PLATE = rigid([[0, 1, 0], [-1, 0, 0], [0, 0, 1]], [0.13, 0, 0])
CARD_SIZE_M = 0.13
_LARGEST_FILM = (1280, 720)
"""`(width, height)` pixels that there is room for, besides the camera's own pictures."""
ARM = "arm_"  # prefix of everything that belongs to the arm
Tool = Literal["hand", "cup"]

_WORLD = """
<mujoco model="baggie">
  <option timestep="{timestep}" integrator="discrete" solver="Newton" cone="pyramidal" impratio="10" tolerance="1e-6"/>
  <visual>
    <global offwidth="{widest}" offheight="{highest}"/>
    <quality shadowsize="1024" offsamples="0"/>
    <headlight ambient="{ambient} {ambient} {ambient}" diffuse="0.15 0.15 0.15" specular="0 0 0"/>
    <map znear="0.1" zfar="20"/>
  </visual>
  <asset>
    <texture name="room" type="skybox" builtin="gradient" width="128" height="128"
        rgb1="0.80 0.83 0.86" rgb2="0.55 0.58 0.62"/>
    <texture name="table" type="2d" builtin="flat" width="512" height="512" rgb1="1 1 1"/>
    <material name="table" texture="table" specular="0.1" shininess="0.2"/>{assets}
  </asset>
  <worldbody>
    <geom name="floor" type="plane" size="4 4 0.1" pos="0 0 -{table_height}" rgba="{floor} 1"
        contype="0" conaffinity="0"/>
    <geom name="table" type="plane" size="0 0 1" rgba="0 0 0 0" friction="0.8"/>
    <geom name="table_top" type="box" size="0.55 0.7 0.02" pos="0.4 0 -0.0201" material="table"
        contype="0" conaffinity="0"/>
    <body name="card" mocap="true" pos="0 0 -1">
      <geom name="card" type="box" size="{card} {card} 0.0004" rgba="{card_color} 1" contype="0" conaffinity="0"/>
    </body>
    <camera name="film" pos="1.40 -0.80 0.75" mode="targetbody" target="look_here" fovy="46"/>
    <body name="look_here" pos="0.40 0 0.20"/>
    {things}
  </worldbody>
</mujoco>
"""


_CLOTH = """
    <texture name="{name}" type="2d" builtin="flat" width="128" height="128" rgb1="1 1 1"/>
    <material name="{name}" texture="{name}" specular="0.05"/>"""


def build_model(
    cell: Cell,
    bag: BagParameters,
    second: BagParameters | None = None,
    distractors: Sequence[Distractor] = (),
) -> mujoco.MjModel:
    """The whole workcell as one model, about 160 degrees of freedom; a second bag adds as many again."""
    cloths, bags = _CLOTH.format(name="cloth"), bag_xml(bag)
    if second is not None:
        cloths += _CLOTH.format(name="second_cloth")
        bags += bag_xml(second, SECOND_BAG, "second_cloth")
    things = bags + "".join(distractor_xml(number, thing) for number, thing in enumerate(distractors))
    things += block_xml()
    scene = scene_spec(cell, cloths, things)
    model = scene.compile()
    rng = paint_table(model, cell)
    paint(model, "cloth", cloth(rng, bag))
    if second is not None:
        paint(model, "second_cloth", cloth(rng, second))
    return model


def scene_spec(cell: Cell, assets: str, things: str, tool: Tool = "hand") -> mujoco.MjSpec:
    """A cell's room, table, lamps, cameras and arm, to be compiled, with these things (XML) on the table.

    The arm's names have the prefix `ARM`. `assets`: the textures and materials (XML) of the things.
    """
    _require_mujoco()
    xml = _WORLD.format(
        timestep=TIMESTEP_S,
        ambient=cell.ambient,
        widest=max(_LARGEST_FILM[0], cell.lens.size[0]),
        highest=max(_LARGEST_FILM[1], cell.lens.size[1]),
        table_height=TABLE_HEIGHT_M,
        floor=" ".join(f"{value / 255:.3f}" for value in cell.floor_color),
        card=CARD_SIZE_M / 2,
        card_color=" ".join(f"{value / 255:.3f}" for value in CARD_COLOR),
        assets=assets,
        things=things,
    )
    scene = mujoco.MjSpec.from_string(xml)
    for number, light in enumerate(cell.lights):
        scene.worldbody.add_light(
            name=f"lamp{number}",
            pos=light.position,
            dir=light.direction,
            diffuse=[light.diffuse] * 3,
            castshadow=light.shadow,
        )
    _add_camera(scene, cell)
    # Within the room: further out it would widen the model's extent, and with it every depth buffer's near plane.
    sheet = scene.worldbody.add_body(name=SHEET, mocap=True, pos=[0.4, 0, -0.5])
    add_printed(scene, sheet, SHEET, SHEET_SIZE_M, SHEET_TEXTURE)
    with (
        warnings.catch_warnings()
    ):  # the arm's own integrator gives way to the scene's, which is what we want
        warnings.simplefilter("ignore")
        scene.attach(arm_spec(tool), prefix=ARM, frame=scene.worldbody.add_frame())
    return scene


def paint_table(model: mujoco.MjModel, cell: Cell) -> np.random.Generator:
    """Give the table its top; the stream it was drawn from, for what else the cell paints."""
    # Its own pattern, 0, does not change the stream: a seed is padded with zeros.
    rng = np.random.default_rng([0x7AB1E, cell.number, cell.table_pattern])
    paint(model, "table", table_top(rng, cell.table_color, cell.table_grain))
    return rng


def _require_mujoco() -> None:
    """Raise `BaggieError` where something else has had an older one installed."""
    if int(mujoco.__version__.split(".")[0]) < _MUJOCO:
        raise BaggieError(
            f"MuJoCo {_MUJOCO} is needed, and {mujoco.__version__} is installed here, which something else may need: "
            "give Baggie an environment of its own (python3 -m venv)"
        )


def arm_spec(tool: Tool = "hand") -> mujoco.MjSpec:
    """The FR3 as `franky-sim` ships it, with its hand or a suction cup, with what a real one has besides.

    Added: gravity compensation, a grip as firm as a Franka hand's, a tool site, a wrist force sensor, and what the hand
    can hold out in front of the tool, hidden until asked for: the calibration paddle (a coloured disk) and a printed
    plate. The tool site is between the fingertips or at the middle of the cup's rim, z out of the tool.
    """
    _require_mujoco()
    assets = Path(str(files("franky_sim"))) / "assets"
    spec = mujoco.MjSpec.from_file(str(assets / "fr3.xml"))
    spec.meshdir = str(assets / "meshes")
    spec.delete(spec.keys[0])
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
    hand = spec.body("hand")
    if tool == "cup":
        fit_cup(spec)
    for body in spec.bodies[1:]:
        body.gravcomp = 1.0
    for joint in (5, 6, 7):
        # As stiff as it is damped in the file, the light wrist never comes to rest at our time steps.
        spec.actuator(f"fr3_joint{joint}").biasprm[2] *= WRIST_DAMPING
    if tool == "hand":
        grip = spec.actuator("hand")
        # Position control of the mean finger opening (metres) with a force limit that `Fingers.set_force` moves.
        grip.gainprm[0] = FINGER_GAIN
        grip.biasprm[:3] = [0.0, -FINGER_GAIN, -FINGER_DAMPING]
        grip.ctrlrange = [0.0, 0.04]
        grip.inheritrange = 0.0
    hand.add_site(name="wrist", pos=[0, 0, 0])
    if tool == "hand":
        offset = TOOL_OFFSET_M
        hand.add_site(name="tool", pos=[0, 0, offset])
    else:
        offset = CUP_OFFSET_M
        spec.body(CUP).add_site(name="tool")
    hand.add_geom(
        name="paddle",
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        pos=[PADDLE_OFFSET_M, 0, offset],
        size=[PADDLE_RADIUS_M, 0.001, 0],
        rgba=[0.85, 0.05, 0.75, 0.0],
        contype=0,
        conaffinity=0,
        mass=0,
    )
    plate = add_printed(spec, hand, PLATE, PLATE_SIZE_M, PLATE_TEXTURE)
    plate.pos = T_HAND_PLATE[:3, 3] + [0, 0, offset]
    mujoco.mju_mat2Quat(plate.quat, T_HAND_PLATE[:3, :3].ravel())
    spec.add_sensor(
        name="wrist",
        type=mujoco.mjtSensor.mjSENS_FORCE,
        objtype=mujoco.mjtObj.mjOBJ_SITE,
        objname="wrist",
    )
    return spec


def _add_camera(scene: mujoco.MjSpec, cell: Cell) -> None:
    scene.worldbody.add_camera(
        name="top",
        pos=cell.camera_position,
        quat=camera_quaternion(cell.camera_rotation),
        fovy=np.rad2deg(cell.lens.render_fovy),
    )


def camera_quaternion(R_base_camera: FloatArray) -> FloatArray:
    """`(4,)`, w first: the turn of MuJoCo's camera, which looks along -z with y up; OpenCV's along +z with y down."""
    turned: FloatArray = R_base_camera @ np.diag([1.0, -1.0, -1.0])
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, turned.ravel())
    return quaternion


def paint(model: mujoco.MjModel, texture: str, picture: Image) -> None:
    """Put a picture `(H, W, 3)` in the place of a texture of that size."""
    start = model.tex_adr[model.texture(texture).id]
    model.tex_data[start : start + picture.size] = picture.ravel()
