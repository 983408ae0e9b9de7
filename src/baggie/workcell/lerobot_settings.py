"""What a person writes down about a LeRobot robot, so that it can be moved in metres."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from baggie.workcell.entries import Metres, Section, Words

Triple = tuple[float, float, float]


class LeRobotJoint(Section):
    """One joint, as the robot and as the model have it."""

    name: Words
    """The robot's: it reads and takes `NAME.pos`."""
    model: Words = ""
    """The model's name for it; the same unless given."""
    sign: Literal[1, -1] = 1
    """-1 where the robot counts the other way round."""
    zero_deg: float | None = None
    """The model's angle where the robot reads 0; unless given 0, or with normalised units the middle of its range."""

    @property
    def model_name(self) -> str:
        """In the MJCF or URDF file."""
        return self.model or self.name


def _name_alone(entry: Any) -> Any:
    return {"name": entry} if isinstance(entry, str) else entry


_SO101 = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")


class LeRobotSettings(Section):
    """Model, scales and speeds. The defaults fit an SO-101, where they can."""

    model: Path
    """Its MJCF or URDF file, of which only joints and frames are used."""
    tool: Words = "gripper_frame_link"
    """The site, body or link that moves with the hand."""
    tool_xyz_m: tuple[Metres, Metres, Metres] = (0.0, 0.0, 0.0)
    """From that frame to the point between the fingertips."""
    tool_rpy_deg: Triple = (0.0, 0.0, 0.0)
    """From that frame to the hand's: z along the fingers, y the way they open. Fixed axes x, y, z, as in URDF."""
    base_z_m: Metres = 0.0
    """How high above the table the model's world is: the height of a pedestal."""
    joints: tuple[Annotated[LeRobotJoint, BeforeValidator(_name_alone)], ...] = tuple(
        LeRobotJoint(name=name) for name in _SO101
    )
    """From the base to the wrist; a name alone will do."""
    units: Literal["degrees", "normalized"] = "degrees"
    """Of the joints' positions: degrees, or -100 to 100 over the range that the model gives them."""
    gripper: Words = "gripper"
    widths: tuple[tuple[float, Metres], ...] = ((0.0, 0.0), (100.0, 0.07))
    """Pairs of a gripper position and the metres between the fingertips there, from closed to open."""
    park: tuple[float, ...]
    """Where the joints are out of the camera's view, the tool pointing down; in the robot's units."""
    clear_z_m: float = Field(0.06, gt=0)
    """Parking begins with a straight rise to this height."""

    speed: float = Field(0.1, gt=0, le=1)
    """The share of every speed that it really goes at: as slow as this until a person has watched it work."""
    joint_speed_deg_s: float = Field(120.0, gt=0)
    """The fastest a joint may ever turn."""
    rate_hz: float = Field(30.0, gt=0, le=500)
    """Targets sent a second. No step between two of them is larger than a joint may turn in that time."""
    max_lag_deg: float = Field(20.0, gt=0)
    """A joint that is so far behind what it was sent is held by something: the motion ends."""
    lag_s: float = Field(0.15, ge=0)
    """How late the joints follow when nothing holds them."""
    feel_m_s: float = Field(0.05, gt=0)
    """The fastest it lowers: the lag of free joints, which touch has to exceed, grows with speed."""
    stiffness_n_m: float = Field(300.0, gt=0)
    """Newtons with which the tool presses for each metre that it is held above where it was sent."""
    grip_n: float = Field(1.0, gt=0)
    """Newtons with which the fingers squeeze for each unit of position that they are held open."""
    max_grip_n: float = Field(20.0, gt=0)

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if len(self.park) != len(self.joints):
            raise ValueError(f"park needs {len(self.joints)} numbers, one a joint, got {len(self.park)}")
        pairs = list(zip(self.widths, self.widths[1:], strict=False))
        if not pairs or not all(a < b and v < w for (a, v), (b, w) in pairs):
            raise ValueError(f"widths needs two or more pairs, both numbers rising, got {self.widths}")
        return self
