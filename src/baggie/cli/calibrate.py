"""`baggie calibrate <what>` and `baggie workcell <what>`: one function for each, as thin as the verbs of `main.py`."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, subcommand

from baggie.cli.output import show
from baggie.commissioning.check import CheckOptions, check_calibration
from baggie.commissioning.hand_eye import HandEyeOptions, calibrate_hand_eye
from baggie.commissioning.image_to_robot import ImageToRobotOptions, calibrate_image_to_robot
from baggie.commissioning.intrinsics import IntrinsicsOptions, calibrate_intrinsics
from baggie.commissioning.new_workcell import NewWorkcellOptions, new_workcell, shown_workcell
from baggie.commissioning.robot_to_world import (
    CameraToWorldOptions,
    RobotToWorldOptions,
    calibrate_camera_to_world,
    calibrate_robot_to_world,
)


def intrinsics(options: IntrinsicsOptions, json: bool = False) -> None:
    """The camera's own matrix and lens distortion, from pictures of a board.

    Example: baggie calibrate intrinsics --from pictures --board charuco:7x5:0.030:0.021:DICT_4X4_50 --out camera.yaml

    Args:
        options: Where the pictures come from.
        json: Print the result as one JSON object.
    """
    _report(calibrate_intrinsics(options), json)


def image_to_robot(options: ImageToRobotOptions, json: bool = False) -> None:
    """From pixels straight to the robot's frame: the arm drives a marker over the workspace and looks.

    Example: baggie calibrate image-to-robot --intrinsics camera.yaml --out image-to-robot.yaml

    Args:
        options: Where the arm goes, and what it carries.
        json: Print the result as one JSON object.
    """
    _report(calibrate_image_to_robot(options), json)


def camera_to_world(options: CameraToWorldOptions, json: bool = False) -> None:
    """Where the camera is, from a target of known size that lies on the table.

    Example: baggie calibrate camera-to-world --intrinsics camera.yaml --out camera-to-world.yaml

    Args:
        options: What lies on the table.
        json: Print the result as one JSON object.
    """
    _report(calibrate_camera_to_world(options), json)


def robot_to_world(options: RobotToWorldOptions, json: bool = False) -> None:
    """Where the robot is, by touching points of the target on the table; with --camera-to-world, both composed.

    Example: baggie calibrate robot-to-world --camera-to-world camera-to-world.yaml --out robot-to-world.yaml

    Args:
        options: What is touched, and with what.
        json: Print the result as one JSON object.
    """
    _report(calibrate_robot_to_world(options), json)


def hand_eye(options: HandEyeOptions, json: bool = False) -> None:
    """Camera and hand together, from a board seen at many poses of the arm; live, or from a recording made elsewhere.

    Example: baggie calibrate hand-eye --from recording --out hand-eye.yaml

    Args:
        options: Where the views come from.
        json: Print the result as one JSON object.
    """
    _report(calibrate_hand_eye(options), json)


def check(options: CheckOptions, json: bool = False) -> None:
    """How far off a calibration is today: the arm visits points it was not made from, and touches a marker.

    Example: baggie calibrate check --map image-to-robot.yaml

    Args:
        options: What to check, and how.
        json: Print the result as one JSON object.
    """
    _report(check_calibration(options), json)


def _report(result: Mapping[str, Any], json: bool) -> None:
    """Warnings where nobody overlooks them, too."""
    for warning in result.get("warnings", ()):
        print(f"warning: {warning}", file=sys.stderr)
    show(result, json)


Calibration = (
    Annotated[Any, subcommand(name="intrinsics", constructor=intrinsics)]
    | Annotated[Any, subcommand(name="image-to-robot", constructor=image_to_robot)]
    | Annotated[Any, subcommand(name="camera-to-world", constructor=camera_to_world)]
    | Annotated[Any, subcommand(name="robot-to-world", constructor=robot_to_world)]
    | Annotated[Any, subcommand(name="hand-eye", constructor=hand_eye)]
    | Annotated[Any, subcommand(name="check", constructor=check)]
)


def calibrate(what: Calibration) -> None:
    """Calibrate a workcell step by step, and check that it still holds. Each can be stopped and goes on when repeated.

    Example: baggie calibrate intrinsics --from pictures --out camera.yaml
    """


def new(options: NewWorkcellOptions, json: bool = False) -> None:
    """Write a workcell file, from what you answer to a few questions.

    Example: baggie workcell new cell.yaml

    Args:
        options: Where to.
        json: Print where it is as one JSON object.
    """
    show(new_workcell(options), json)


def show_file(file: Positional[Path], json: bool = False) -> None:
    """Everything a workcell file says, and what follows from that or is left to the defaults.

    Example: baggie workcell show cell.yaml

    Args:
        file: The workcell file.
        json: Print it as one JSON object.
    """
    show(shown_workcell(file), json)


What = (
    Annotated[Any, subcommand(name="new", constructor=new)]
    | Annotated[Any, subcommand(name="show", constructor=show_file)]
)


def workcell(what: What) -> None:
    """Write down a workcell, or show what is written.

    Example: baggie workcell new cell.yaml
    """
