"""The kinematics of any arm, from the MJCF or URDF file that its maker publishes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from baggie.errors import BaggieError
from baggie.geometry import FloatArray, rigid


def load_arm_model(
    path: Path,
    joints: Sequence[str],
    *,
    tool: str,
    tool_xyz_m: Sequence[float] = (0.0, 0.0, 0.0),
    tool_rpy_rad: Sequence[float] = (0.0, 0.0, 0.0),
    base_z_m: float = 0.0,
) -> mujoco.MjModel:
    """The bare chain of an arm, with a site "tool", as `Kinematics` wants it.

    The file's world, raised by `base_z_m`, is the robot's base frame: an arm on a pedestal is so high above the table.
    `joints`: the hinges that move; every other one (the gripper's) stays at zero. `tool`: a site, body or link of the
    file. The tool, whose frame is that of `geometry.hand_matrix`, sits in its frame at `tool_xyz_m`, turned by
    `tool_rpy_rad` (about the fixed axes x, y, z in this order, as in URDF). Shapes are left out, so meshes need not be
    there. Raises `BaggieError` when the file cannot be read or has no such joint or tool.
    """
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise BaggieError(f"{path} is no model of an arm ({reason}); give its MJCF or URDF file") from None
    spec.compiler.fusestatic = False  # or URDF links without a joint, a tool's frame among them, are gone
    known = [joint.name for joint in spec.joints]
    for name in joints:
        if name not in known:
            raise BaggieError(f"{path} has no joint {name!r}; it has {', '.join(known) or 'none'}")
    _strip(spec, joints)
    body, T_body_frame = _frame(spec, tool, path)
    for root in spec.worldbody.bodies:
        root.pos[2] += base_z_m
    T_frame_tool = rigid(Rotation.from_euler("xyz", tool_rpy_rad).as_matrix(), tool_xyz_m)
    T_body_tool = T_body_frame @ T_frame_tool
    for site in list(spec.sites):
        spec.delete(site)
    body.add_site(name="tool", pos=T_body_tool[:3, 3], quat=_quaternion(T_body_tool[:3, :3]))
    try:
        return spec.compile()
    except ValueError as error:
        raise BaggieError(f"{path} is no model of an arm: {' '.join(str(error).split())}") from None


def _strip(spec: mujoco.MjSpec, joints: Sequence[str]) -> None:
    """Leave bodies, sites and these joints."""
    for parts in (
        spec.keys,
        spec.actuators,
        spec.sensors,
        spec.equalities,
        spec.tendons,
        spec.pairs,
        spec.excludes,
        spec.geoms,
        spec.meshes,
        spec.materials,
        spec.textures,
        spec.cameras,
        spec.lights,
        [joint for joint in spec.joints if joint.name not in joints],
    ):
        for part in list(parts):
            spec.delete(part)
    spec.compiler.boundmass = spec.compiler.boundinertia = (
        1e-3  # motion is not simulated; mass is not asked for
    )


def _frame(spec: mujoco.MjSpec, name: str, path: Path) -> tuple[mujoco.MjsBody, FloatArray]:
    """The body that carries a site or is a link, and the pose `(4, 4)` of that frame in the body's."""
    site = spec.site(name)
    if site is not None:
        rotation = Rotation.from_quat(site.quat, scalar_first=True).as_matrix()
        return site.parent, rigid(rotation, site.pos)
    body = spec.body(name)
    if body is None:
        frames = [each.name for each in (*spec.sites, *spec.bodies) if each.name]
        raise BaggieError(f"{path} has no site, body or link {name!r}; it has {', '.join(frames)}")
    return body, np.eye(4)


def _quaternion(rotation: FloatArray) -> FloatArray:
    """`(4,)`, w first."""
    return np.asarray(Rotation.from_matrix(rotation).as_quat(scalar_first=True), float)
