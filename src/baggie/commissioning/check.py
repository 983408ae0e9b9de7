"""`baggie calibrate check`: how far off a map from the picture to the robot is today."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from baggie import seeds
from baggie.calibration.files import REFERENCE_FILE
from baggie.calibration.image_to_robot.map import ImageToRobot, compare_maps
from baggie.calibration.image_to_robot.residuals import draw_comparison
from baggie.commissioning.image_to_robot import marker_finder, marker_middle, parse_marker, visit
from baggie.commissioning.session import Session, open_session
from baggie.errors import BaggieError, CalibrationError
from baggie.files import write_if_possible
from baggie.geometry import FloatArray, ToolPose, transform_points
from baggie.operator import Operator
from baggie.options.commissioning import CheckOptions
from baggie.pictures import read_picture
from baggie.robot.limits import MARGIN_M
from baggie.vision.targets import ArucoMarker, parse_target
from baggie.workcell.workcell import Watch, WorkcellSettings
from baggie.workcell.workcell_file import read_workcell_file

_TOUCH_Z_M = 0.02
_SPEED_M_S = 0.3
_HOVER_M = 0.15


def check_calibration(options: CheckOptions, *, operator: Operator | None = None) -> dict[str, Any]:
    """Measure and report, ready for JSON. Raises `CalibrationError` when the error is above the limit.

    The person at the terminal is told and asked, unless `operator` is given.
    """
    image_to_robot = ImageToRobot.load(options.map)
    if options.against is not None:
        return _compare(image_to_robot, options)
    with open_session(options, operator, prepared=options.prepared) as session:
        image_to_robot.camera.check(session.identity, str(options.map))
        result = check_live(session, image_to_robot, options)
    worst = max(result[name]["mean"] for name in ("held_out_mm", "touch_mm") if name in result)
    if worst > options.limit_mm:
        raise CalibrationError(
            f"{options.map} is off by {worst:.1f} mm on average, more than {options.limit_mm:g} mm; "
            "calibrate again: baggie calibrate image-to-robot"
        )
    return result


def check_live(session: Session, image_to_robot: ImageToRobot, options: CheckOptions) -> dict[str, Any]:
    """Background, held-out points, touches: each as far as the map and what is there allow."""
    session.assistant.clear_table()
    result: dict[str, Any] = {"map": str(options.map), "stated_std_mm": image_to_robot.std_mm}
    reference = options.map.with_suffix("") / REFERENCE_FILE
    if reference.exists():
        moved = Watch(read_picture(reference)).moved_px(session.look().color)
        result["background_moved_px"] = moved
    result["held_out_mm"] = _summary(_held_out(session, image_to_robot, options))
    touches = _touches(session, image_to_robot, options)
    if len(touches):
        result["touch_mm"] = _summary(touches)
    return result


def _held_out(session: Session, image_to_robot: ImageToRobot, options: CheckOptions) -> FloatArray:
    """`(N, 2)` metres: where the map says the marker in the hand is, less where the arm says it is."""
    cell, (find, marker) = session.workcell(), parse_marker(options.marker)
    session.assistant.hold(marker, "fix the marker to the hand, facing up")
    rng = seeds.generator(seeds.CALIBRATION, options.seed, 3)
    low, high = min(image_to_robot.heights_m), max(image_to_robot.heights_m)
    in_hand = np.array(options.marker_in_hand)
    area = replace(cell.settings.workspace, x_min=cell.settings.limits.workspace.x_min + in_hand[0])
    positions = np.array(
        [[*area.sample(rng, MARGIN_M), rng.uniform(low, high)] for _ in range(options.points)]
    )
    errors = []
    for number, hand, observation in visit(cell.arm, session.camera, positions, in_hand):
        found = find(observation.color)
        if found is not None:
            base = transform_points(hand, in_hand[None])[0]
            at = image_to_robot.at_height(base[2]) if image_to_robot.height_aware else image_to_robot
            error = at.to_robot(marker_middle(found, at.lens))[0] - base[:2]
            errors.append(error)
            session.say(f"point {number + 1} of {len(positions)}: {1000 * np.linalg.norm(error):.1f} mm off")
    session.assistant.put_away()
    if not errors:
        raise CalibrationError(
            f"the marker {options.marker} was seen at none of the points; is it in the hand?"
        )
    return np.array(errors)


def _touches(session: Session, image_to_robot: ImageToRobot, options: CheckOptions) -> FloatArray:
    """`(N, 2)` metres: how far the fingertips came down from the middle of a marker on the table."""
    cell, marker = session.workcell(), parse_target(options.table_marker)
    if not isinstance(marker, ArucoMarker):
        raise BaggieError(
            f"expected --table-marker aruco:DICTIONARY:NUMBER:SIZE, got {options.table_marker!r}"
        )
    if not image_to_robot.height_aware and abs(image_to_robot.height_m) > 0.005:
        session.say("the map is not good for the height of the table: nothing is touched")
        return np.zeros((0, 2))
    on_table = image_to_robot.at_height(0.0) if image_to_robot.height_aware else image_to_robot
    find = marker_finder(marker)
    errors, speed = [], cell.arm.at_most(_SPEED_M_S)
    for number in range(options.touches):
        session.assistant.lay(
            marker, f"touch {number + 1} of {options.touches}: lay the marker somewhere in the workspace"
        )
        found = find(session.look().color)
        if found is None:
            session.say("the marker on the table is not seen")
            continue
        x, y = on_table.to_robot(marker_middle(found, on_table.lens))[0]
        cell.arm.move_to(ToolPose(x, y, _HOVER_M), speed)
        cell.arm.move_to(ToolPose(x, y, _TOUCH_Z_M), speed)
        error = session.assistant.measure_touch("the fingertips are where the marker's middle should be")
        if error is not None:
            errors.append(error)
            session.say(f"touch {number + 1} of {options.touches}: {1000 * np.linalg.norm(error):.1f} mm off")
    session.assistant.put_away()
    cell.arm.park()
    return np.array(errors).reshape(-1, 2)


def _summary(errors: FloatArray) -> dict[str, float]:
    lengths = 1000 * np.linalg.norm(errors, axis=1)
    return {
        "mean": float(lengths.mean()),
        "rms": float(np.sqrt((lengths**2).mean())),
        "max": float(lengths.max()),
        "n": len(lengths),
    }


def _object_height_m(options: CheckOptions) -> float:
    """Of what the policy was taught with: what the workcell file says, where one is given."""
    if options.workcell == CheckOptions.workcell:
        return WorkcellSettings().object_size_m[2]
    return read_workcell_file(Path(options.workcell)).bag.height_m


def _compare(image_to_robot: ImageToRobot, options: CheckOptions) -> dict[str, Any]:
    against = Path(str(options.against))
    if against.is_dir():
        from baggie.policies import load_policy  # noqa: PLC0415 -- PyTorch takes its time to import
        from baggie.policies.keypoint.policy import KeypointPolicy, as_calibration  # noqa: PLC0415

        policy = load_policy(against)
        if not isinstance(policy, KeypointPolicy):
            raise BaggieError(
                f"{against} holds a {policy.name} policy, which knows no map; give a keypoint policy's run"
            )
        other = as_calibration(policy, _object_height_m(options) / 2)
    else:
        other = ImageToRobot.load(against)
    comparison = compare_maps(image_to_robot, other)
    picture = options.map.with_name(f"{options.map.stem}-against-{against.stem}.png")
    drawn = write_if_possible(picture, partial(draw_comparison, comparison))
    found = {"map": str(options.map), "against": str(against), **comparison.summary()}
    return {**found, "picture": str(picture)} if drawn else found
