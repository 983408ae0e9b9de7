"""Build the MuJoCo model: the arm with its hand or a suction cup, a table and all that lies on it, lamps and camera."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from typing import Literal

import mujoco
import numpy as np

from baggie.errors import BaggieError
from baggie.geometry import FloatArray, rigid
from baggie.options.values import CARD_COLOR
from baggie.robot.franka.models import TOOL_OFFSET_M, links, require_mujoco
from baggie.sim.cell import Cell, table_top
from baggie.sim.objects import CUP_RADIUS_M, SceneObject, paint
from baggie.sim.printed import (
    PLATE,
    PLATE_SIZE_M,
    PLATE_TEXTURE,
    SHEET,
    SHEET_SIZE_M,
    SHEET_TEXTURE,
    add_printed,
)
from baggie.sim.variety import Distractor, distractor_xml
from baggie.types import Intrinsics
from baggie.vision.height_map import DepthCamera

CUP_OFFSET_M = 0.17
"""From the hand's frame to the middle of the cup's rim: what is wide stays above a pyramid of three 4 cm blocks."""
CUP = "cup"
"""The name of its body, whose frame is at the rim's middle, z out of the cup."""
# The cup springs back along the stem, as spring plungers do: the heavy arm cannot stop within the lip's millimetre.
_TRAVEL_M = 0.01
_PRELOAD_N = 4.0
_SPRING_N_M = 400.0
_DAMPING_NS_M = 6.0
_LIP_FRICTION = 0.05
_SERVO_DAMPING = 0.4  # of the file's
_CUP_HEIGHT_M = 0.012
_STEM_RADIUS_M = 0.005
_HOUSING_M = (0.031, 0.05)  # radius and height; the flange's width
_RUBBER = (0.12, 0.12, 0.13, 1.0)
_METAL = (0.62, 0.63, 0.65, 1.0)
_DETAILED_GROUP, _HULL_GROUP = 2, 3  # as in `fr3.xml`: what is drawn, and what touches


def fit_cup(spec: mujoco.MjSpec) -> None:
    """Take the hand off the arm and put a sprung cup on a stem there; the body keeps its name, `hand`, and its mass."""
    spec.delete(spec.actuator("hand"))
    for tendon in spec.tendons:
        spec.delete(tendon)
    for equality in spec.equalities:
        spec.delete(equality)
    for finger in ("left_finger", "right_finger"):
        spec.delete(spec.body(finger))
    for joint in range(1, 8):
        # Damped near critically, not three times as much: the arm is within a millimetre when a fast motion is over.
        spec.actuator(f"fr3_joint{joint}").biasprm[2] *= _SERVO_DAMPING
    hand = spec.body("hand")
    for geom in hand.geoms:
        spec.delete(geom)
    stem_end = CUP_OFFSET_M - _CUP_HEIGHT_M
    radius, height = _HOUSING_M
    _add_cylinder(hand, "housing", radius, (0.0, height), _METAL)
    _add_cylinder(hand, "stem", _STEM_RADIUS_M, (height, stem_end), _METAL)
    cup = hand.add_body(name=CUP, pos=[0, 0, CUP_OFFSET_M], mass=0.02, inertia=[4e-6] * 3)
    cup.add_joint(
        name=CUP,
        type=mujoco.mjtJoint.mjJNT_SLIDE,
        axis=[0, 0, 1],
        range=[-_TRAVEL_M, 0.0],
        limited=True,
        stiffness=[_SPRING_N_M, 0, 0],
        springref=_PRELOAD_N / _SPRING_N_M,
        damping=[_DAMPING_NS_M, 0, 0],
        solref_limit=[0.008, 1.0],
    )
    lip = _add_cylinder(cup, CUP, CUP_RADIUS_M, (-_CUP_HEIGHT_M, 0.0), _RUBBER)
    # The lip gives way sideways; by rigid friction the arm would drag a block along as it sets down and lifts off.
    lip.friction[0], lip.priority = _LIP_FRICTION, 1


def _add_cylinder(
    body: mujoco.MjsBody,
    name: str,
    radius_m: float,
    ends_m: tuple[float, float],
    color: tuple[float, float, float, float],
) -> mujoco.MjsGeom:
    """A massless cylinder along the body's z axis, once to be seen and once, the one returned, to be touched."""
    start, end = ends_m
    for group, touches in ((_DETAILED_GROUP, 0), (_HULL_GROUP, 1)):
        geom = body.add_geom(
            name=name if touches else f"{name}_seen",
            type=mujoco.mjtGeom.mjGEOM_CYLINDER,
            pos=[0, 0, (start + end) / 2],
            size=[radius_m, (end - start) / 2, 0],
            rgba=color,
            group=group,
            contype=touches,
            conaffinity=touches,
            mass=0,
        )
    return geom


TIMESTEP_S = 0.004  # 8 ms halve the time and lose a quarter of the grasps
_CREEP_M_S = 0.01
_SOFT_TOLERANCE = 1e-4  # of the solver; with less, soft things are no better
TABLE_HEIGHT_M = 0.75
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
BLOCK = "block"
MAX_BLOCK_HEIGHT_M = 0.20
BLOCK_HALF_M = (0.05, 0.05, MAX_BLOCK_HEIGHT_M / 2)
BLOCK_AWAY = (0.4, 0.0, -0.5)
"""Under the table, within the room."""
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


def build_model(
    cell: Cell,
    things: Sequence[SceneObject],
    tool: Tool = "hand",
    distractors: Sequence[Distractor] = (),
    cameras: Sequence[DepthCamera] = (),
) -> mujoco.MjModel:
    """The whole workcell as one model; each bag adds some 80 degrees of freedom to the arm's.

    `cameras`: besides the cell's own.
    """
    lying = "".join(distractor_xml(number, each) for number, each in enumerate(distractors))
    bodies = "".join(thing.xml() for thing in things) + lying + (block_xml() if tool == "hand" else "")
    scene = scene_spec(cell, "".join(thing.assets() for thing in things), bodies, tool)
    # What rests on the table stands still and costs nothing; on a fixture, a mocap body, MuJoCo lets none sleep.
    scene.option.enableflags |= mujoco.mjtEnableBit.mjENBL_SLEEP
    if any(thing.soft for thing in things):
        scene.option.sleep_tolerance = _CREEP_M_S  # what is soft never comes quite to rest
        scene.option.tolerance = _SOFT_TOLERANCE
    else:
        # Round friction cones: blocks do not creep, and cheaper.
        scene.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    _add_depth_cameras(scene, cameras)
    if tool == "cup":
        _add_seals(scene, [thing.name for thing in things if thing.movable])
    model = scene.compile()
    rng = paint_table(model, cell)
    for thing in things:
        thing.paint(model, rng)
    return model


def scene_spec(cell: Cell, assets: str, things: str, tool: Tool = "hand") -> mujoco.MjSpec:
    """A cell's room, table, lamps, cameras and arm, to be compiled, with these things (XML) on the table.

    The arm's names have the prefix `ARM`. `assets`: the textures and materials (XML) of the things.
    """
    require_mujoco()
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


def arm_spec(tool: Tool = "hand") -> mujoco.MjSpec:
    """The FR3 as `franky-sim` ships it, with its hand or a suction cup, with what a real one has besides.

    Added: gravity compensation, a grip as firm as a Franka hand's, a tool site, a wrist force sensor, and what the hand
    can hold out in front of the tool, hidden until asked for: the calibration paddle (a coloured disk) and a printed
    plate. The tool site is between the fingertips or at the middle of the cup's rim, z out of the tool.
    """
    spec = links()
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
        for finger in ("left_finger", "right_finger"):
            _square_finger(spec.body(finger))
        grip = spec.actuator("hand")
        # Position control of the mean finger opening (metres) with a force limit that `Fingers.set_force` moves.
        grip.gainprm[0] = FINGER_GAIN
        grip.biasprm[:3] = [0.0, -FINGER_GAIN, -FINGER_DAMPING]
        grip.ctrlrange = [0.0, 0.04]
        grip.inheritrange = 0.0
    hand.add_site(name="wrist", pos=[0, 0, 0])
    offset = TOOL_OFFSET_M
    if tool == "cup":
        offset = CUP_OFFSET_M
        spec.delete(spec.site("tool"))
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


_FINGER_M = (
    ((-0.0090, 0.0094, 0.0360), (0.0090, 0.0144, 0.0539)),
    ((-0.0091, 0.0080, 0.0193), (0.0091, 0.0157, 0.0360)),
    ((-0.0105, 0.0025, 0.0000), (0.0105, 0.0263, 0.0193)),
)
"""Corners of the boxes that a finger touches with: its tip, its middle and its foot, in its own frame."""


def _square_finger(finger: mujoco.MjsBody) -> None:
    """Let boxes touch in place of a finger's mesh: its thousand points are searched anew for each fold of cloth."""
    for geom in finger.geoms:
        if geom.type == mujoco.mjtGeom.mjGEOM_MESH:
            geom.contype = geom.conaffinity = 0
    for low, high in np.array(_FINGER_M):
        finger.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=(low + high) / 2,
            size=(high - low) / 2,
            group=_HULL_GROUP,
            mass=0,
        )


def block_xml() -> str:
    """The body, away for now. It stands as deep in the table as it is too high."""
    x, y, z = BLOCK_AWAY
    size = " ".join(f"{half:g}" for half in BLOCK_HALF_M)
    return f"""
    <body name="{BLOCK}" mocap="true" pos="{x:g} {y:g} {z:g}">
      <geom name="{BLOCK}" type="box" size="{size}" rgba="0.78 0.76 0.72 0" friction="1"/>
    </body>"""


def _add_depth_cameras(scene: mujoco.MjSpec, cameras: Sequence[DepthCamera]) -> None:
    """Give a scene these cameras. Raises `BaggieError` for lenses that MuJoCo has none of."""
    for camera in cameras:
        _check_lens(camera)
        focal_length = camera.intrinsics.matrix[1, 1]
        scene.worldbody.add_camera(
            name=camera.name,
            pos=camera.T_base_camera[:3, 3],
            quat=camera_quaternion(camera.T_base_camera[:3, :3]),
            fovy=float(np.rad2deg(2 * np.arctan(camera.intrinsics.height / 2 / focal_length))),
        )


def _check_lens(camera: DepthCamera) -> None:
    """Raise unless the lens has square pixels, the principal point in the picture's middle, no distortion."""
    lens: Intrinsics = camera.intrinsics
    focal_length = lens.matrix[0, 0]
    ideal = [[focal_length, 0, (lens.width - 1) / 2], [0, focal_length, (lens.height - 1) / 2], [0, 0, 1]]
    if not np.allclose(lens.matrix, ideal) or np.any(lens.distortion):
        raise BaggieError(
            f"expected the camera {camera.name!r} to have square pixels, its principal point in the middle and no "
            f"distortion, got the matrix {lens.matrix.tolist()} and distortion {lens.distortion.tolist()}; the "
            "simulator renders no other"
        )


def _add_seals(scene: mujoco.MjSpec, blocks: Iterable[str]) -> None:
    """Give a scene one weld for every block, off until the cup seals on it."""
    for block in blocks:
        scene.add_equality(
            name=seal_of(block),
            type=mujoco.mjtEq.mjEQ_WELD,
            objtype=mujoco.mjtObj.mjOBJ_BODY,
            name1=ARM + CUP,
            name2=block,
            active=False,
            solref=[0.01, 1.0],
        )


def seal_of(thing: str) -> str:
    """Name of the weld between the cup and a thing."""
    return f"seal_{thing}"


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
