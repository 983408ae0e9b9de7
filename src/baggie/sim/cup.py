"""A suction cup on a stem, in the place of the arm's hand."""

from __future__ import annotations

import mujoco

CUP_OFFSET_M = 0.17
"""From the hand's frame to the middle of the cup's rim: what is wide stays above a pyramid of three 4 cm blocks."""
CUP_RADIUS_M = 0.01
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
