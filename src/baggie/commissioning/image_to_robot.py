"""`baggie calibrate image-to-robot`: the arm drives itself over the workspace with a marker in its hand, and looks.

The arm takes a marker to known positions, the camera looks: what image-to-robot maps are fitted to.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from baggie import seeds
from baggie.calibration.files import REFERENCE_FILE, CameraIdentity, read_views_file
from baggie.calibration.image_to_robot.map import ImageToRobot, check_marker_offset
from baggie.calibration.image_to_robot.projection import MIN_POINTS_TWO_HEIGHTS
from baggie.calibration.image_to_robot.residuals import draw_residuals
from baggie.calibration.intrinsics.camera_calibration import CameraCalibration
from baggie.cameras.camera import Camera
from baggie.commissioning.session import Session, ViewFolder, open_session
from baggie.errors import BaggieError, CalibrationError, DataError, LimitError, ReachError
from baggie.files import write_if_possible
from baggie.geometry import FloatArray, Rectangle, ToolPose, hand_matrix, transform_points
from baggie.operator import Operator, progress
from baggie.options.commissioning import ImageToRobotOptions
from baggie.options.values import Point
from baggie.pictures import read_picture, write_picture
from baggie.robot.arm import Arm, hand_pose
from baggie.robot.limits import MARGIN_M, Limits
from baggie.types import Image, Intrinsics, Observation
from baggie.vision.color_mask import find_bag
from baggie.vision.targets import ArucoMarker, TargetDetection, parse_target
from baggie.workcell.workcell import Workcell, at_outline

YAW_RAD = 0.35
"""How far the hand is turned at each point, to one side or the other."""
_SPEED_M_S = 0.5

Find = Callable[[Image], FloatArray | None]
"""Where a picture shows a marker, pixels: its corners `(4, 2)`, or the middle of a blob `(1, 2)`; None for nowhere."""


def grid(
    workspace: Rectangle, margin: float, heights_m: tuple[float, ...], columns: int = 4, rows: int = 3
) -> FloatArray:
    """Positions spread evenly over the workspace less a margin, by lanes, at each height: `(N, 3)` metres."""
    xs = np.linspace(workspace.x_min + margin, workspace.x_max - margin, rows)
    ys = np.linspace(workspace.y_min + margin, workspace.y_max - margin, columns)
    lanes = [(x, y) for lane, x in enumerate(xs) for y in (ys if lane % 2 == 0 else ys[::-1])]
    return np.array([(x, y, z) for z in heights_m for x, y in lanes])


def visit(
    arm: Arm, camera: Camera, positions: FloatArray, marker_in_hand: FloatArray
) -> Iterator[tuple[int, FloatArray, Observation]]:
    """Take a marker to each of `positions` `(N, 3)` and look: its number, `T_base_hand` `(4, 4)` there, the picture.

    `marker_in_hand` `(3,)`: its middle in the tool's frame. The hand is turned one way and the other in turn, so that a
    marker that is not where it is said to be shows. Positions out of reach are passed over: what is missing shows in
    the count.
    """
    speed = min(_SPEED_M_S, arm.info.max_speed_m_s)
    for number, position in enumerate(positions):
        yaw = YAW_RAD if number % 2 else -YAW_RAD
        upright = hand_matrix(ToolPose(0.0, 0.0, 0.0, yaw))
        x, y, z = position - transform_points(upright, marker_in_hand[None])[0]
        try:
            arm.move_to(ToolPose(float(x), float(y), float(z), yaw), speed)
        except (LimitError, ReachError):
            continue
        yield number, hand_pose(arm), camera.look()


def color_finder(color: tuple[int, int, int]) -> Find:
    """Finds a blob of this RGB colour, as the published system does."""

    def find(image: Image) -> FloatArray | None:
        seen = find_bag(image, color)
        return None if seen is None else seen.center[None]

    return find


def marker_finder(marker: ArucoMarker) -> Find:
    """Finds an ArUco marker by its corners."""

    def find(image: Image) -> FloatArray | None:
        seen = marker.detect(image)
        return None if seen is None else seen.pixels

    return find


def marker_middle(found: FloatArray, lens: Intrinsics | None = None) -> FloatArray:
    """Where the middle of a marker appears that was found at `(4, 2)` or `(1, 2)` pixels: `(2,)` pixels.

    Its diagonals cross there, in every perspective. Where a lens bends them they do not: in the simulator's cells they
    cross a tenth of a pixel further out at the picture's edge, so the lens is undone where it is known.
    """
    if len(found) == 1:
        return np.asarray(found[0])
    a, b, c, d = np.c_[found if lens is None else lens.rays(found), np.ones(4)]
    crossing = np.cross(np.cross(a, c), np.cross(b, d))
    crossing = crossing / crossing[2]
    return np.asarray(crossing[:2] if lens is None else lens.project(crossing)[0])


def parse_marker(spec: str) -> tuple[Find, ArucoMarker | None]:
    """How to find what a person wrote, `aruco:DICTIONARY:NUMBER:SIZE` or `color:R,G,B`, and the marker if it is one.

    Raises `BaggieError` for anything else.
    """
    color = re.fullmatch(r"color:(\d+),(\d+),(\d+)", spec)
    if color is not None and max(map(int, color.groups())) <= 255:
        return color_finder((int(color[1]), int(color[2]), int(color[3]))), None
    marker = None if spec.startswith("color:") else parse_target(spec)
    if not isinstance(marker, ArucoMarker):
        raise BaggieError(
            f"expected a marker as aruco:DICTIONARY:NUMBER:SIZE (metres) or color:R,G,B, each at most 255, got {spec!r}"
        )
    return marker_finder(marker), marker


def calibrate_image_to_robot(
    options: ImageToRobotOptions, *, operator: Operator | None = None
) -> dict[str, Any]:
    """Calibrate and save; the result, ready for JSON. Raises `BaggieError`, or `KeyboardInterrupt` live.

    The person at the terminal is told and asked, unless `operator` is given.
    """
    if options.from_ is not None:
        result = _fit_folder(options.from_, options)
    else:
        with open_session(options, operator, prepared=options.prepared) as session:
            result = calibrate_image_to_robot_live(session, options)
    result.save(options.out)
    picture = options.out.with_suffix(".png")
    drawn = write_if_possible(picture, partial(draw_residuals, result))
    return {
        "calibration": str(options.out),
        **({"picture": str(picture)} if drawn else {}),
        **result.summary(),
        "next": check_command(options),
    }


def check_command(options: ImageToRobotOptions) -> str:
    """The command that checks the map in the same workcell, with the same marker in the hand."""
    words = ["baggie", "calibrate", "check"]
    if options.workcell != ImageToRobotOptions.workcell:
        words += ["--workcell", options.workcell]
    elif options.cell != ImageToRobotOptions.cell:
        words += ["--cell", str(options.cell)]
    words += ["--map", str(options.out)]
    if options.marker != ImageToRobotOptions.marker:
        words += ["--marker", options.marker]
    if options.marker_in_hand != ImageToRobotOptions.marker_in_hand:
        words += ["--marker-in-hand", *(f"{metres:g}" for metres in options.marker_in_hand)]
    return shlex.join(words)


def calibrate_image_to_robot_live(session: Session, options: ImageToRobotOptions) -> ImageToRobot:
    """Drive the marker over the grid; every point found is kept at once."""
    cell, (find, marker) = session.workcell(), parse_marker(options.marker)
    header = {
        "camera": session.identity.to_yaml(),
        "marker": options.marker,
        "heights_m": options.heights,
    }
    folder = ViewFolder(options.out.with_suffix(""), header)
    in_hand = np.array(options.marker_in_hand)
    wanted = grid(cell.settings.workspace, MARGIN_M, options.heights, options.columns, options.rows)
    wanted = _within_reach(wanted, in_hand, cell.settings.limits)
    visited = {view["point"] for view in folder.views}
    missing = np.array([number for number in range(len(wanted)) if number not in visited], int)
    session.assistant.clear_table()
    reference = folder.folder / REFERENCE_FILE
    if not reference.exists():  # what goes on must not forget where the camera stood when it was begun
        write_picture(reference, session.look().color)
    session.assistant.hold(
        marker, "fix the marker to the hand, facing up; nobody comes near the arm from now on"
    )
    try:
        with progress(session.operator, "driving over the workspace", len(wanted), len(visited)) as advance:
            for number, hand, observation in visit(cell.arm, session.camera, wanted[missing], in_hand):
                found = find(observation.color)
                words = f"point {missing[number] + 1} of {len(wanted)}: " + (
                    "no marker" if found is None else "found"
                )
                session.show(folder.folder, observation.color, _as_seen(found), words)
                if found is not None:
                    view = {"point": int(missing[number]), "T_base_hand": hand.tolist(), **_seen_at(found)}
                    folder.append(view, observation.color)
                advance()
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"interrupted after {len(folder)} of {len(wanted)} points; the same command again goes on"
        ) from None
    session.assistant.put_away()
    cell.arm.park()
    return _fit(folder.views, session.identity, options)


def _within_reach(positions: FloatArray, marker_in_hand: FloatArray, limits: Limits) -> FloatArray:
    """The positions moved in so far that the hand behind the marker stays within its limits near the table."""
    nearest = limits.workspace.x_min + marker_in_hand[0] + 0.005
    return np.column_stack([np.maximum(positions[:, 0], nearest), positions[:, 1:]])


def _as_seen(found: FloatArray | None) -> TargetDetection | None:
    if found is None:
        return None
    return TargetDetection(np.zeros(1, np.int64), marker_middle(found)[None], np.zeros((1, 3)))


def _seen_at(found: FloatArray) -> dict[str, Any]:
    """What a view says of a marker that was found: its middle as if the lens were none, and its corners."""
    corners = {"corners": found.tolist()} if len(found) == 4 else {}
    return {"pixel": marker_middle(found).tolist(), **corners}


def _fit_folder(folder: Path, options: ImageToRobotOptions) -> ImageToRobot:
    content = read_views_file(folder)
    try:
        camera = CameraIdentity.from_yaml(content["camera"])
    except (KeyError, TypeError, ValueError):
        raise DataError(f"expected `camera` with name, width and height in {folder}/views.json") from None
    find, _ = parse_marker(content.get("marker", options.marker))
    views = [view if "pixel" in view else _found(view, folder, find, camera) for view in content["views"]]
    return _fit([view for view in views if view], camera, options)


def _found(view: dict[str, Any], folder: Path, find: Find, camera: CameraIdentity) -> dict[str, Any]:
    picture = read_picture(folder / str(view.get("image")))
    height, width = picture.shape[:2]
    camera.check(CameraIdentity(camera.name, width, height), f"the recording {folder}")
    found = find(picture)
    return {} if found is None else {**view, **_seen_at(found)}


def _fit(views: list[dict[str, Any]], camera: CameraIdentity, options: ImageToRobotOptions) -> ImageToRobot:
    if not views:
        raise CalibrationError(
            f"the marker {options.marker} was seen in no picture; check that it is printed as written, faces the "
            "camera and is not covered by the hand"
        )
    try:
        found = [
            np.array(view["corners"], float).reshape(4, 2)
            if "corners" in view
            else np.array(view["pixel"], float).reshape(1, 2)
            for view in views
        ]
        hands = np.array([view["T_base_hand"] for view in views if "T_base_hand" in view], float).reshape(
            -1, 4, 4
        )
        robot = np.array([_marker(view, options.marker_in_hand) for view in views]).reshape(-1, 3)
    except (KeyError, TypeError, ValueError) as error:
        raise DataError(
            f"expected views with T_base_hand (or base) and pixel (or image), got {error!r}"
        ) from None
    lens = None if options.intrinsics is None else CameraCalibration.load(options.intrinsics, camera)
    known = lens.intrinsics if lens else None

    pictures = [str(view.get("image", "")) for view in views]

    def fit(robot: FloatArray, seen_through: Intrinsics | None, limit_mm: float) -> ImageToRobot:
        return ImageToRobot.fit(
            np.array([marker_middle(each, seen_through) for each in found]),
            robot,
            camera,
            intrinsics=known,
            intrinsics_covariance=lens.covariance if lens else None,
            limit_mm=limit_mm,
            pictures=pictures,
        )

    if len(hands) == len(views):
        check_marker_offset(lambda robot: fit(robot, known, np.inf), hands, np.array(options.marker_in_hand))
    fitted = fit(robot, known, options.limit_mm)
    if known is None and any(len(each) == 4 for each in found):
        # Now that the lens is known well enough to tell where middles are.
        fitted = fit(robot, fitted.lens, options.limit_mm)
    return fitted.at_height(options.map_height) if fitted.height_aware else fitted


def _marker(view: dict[str, Any], marker_in_hand: Point) -> FloatArray:
    """`(3,)` metres, base frame: the middle of the marker in one view."""
    if "base" in view:
        return np.array(view["base"], float).reshape(3)
    return np.asarray(transform_points(view["T_base_hand"], [marker_in_hand])[0])


MARKER_HEIGHTS_M = (0.07, 0.17)
"""Above the table while it is looked at; the lower, just clear of a bag that lies there, unless that is higher."""
_CLEAR_M = 0.04
"""Between the marker and what lies there."""


def calibrate_into(folder: Path, cell: Workcell, seed: int, watched: bool = True) -> None:
    """Calibrate a cell and keep all that belongs to it: the colour-mask policy with its map, and, where the cell is
    `watched`, the picture that a watch compares with.

    Raises `BaggieError` as `calibrate` does.
    """
    from baggie.policies.baselines import ColorMaskPolicy  # noqa: PLC0415 -- workers do without torch

    image_to_robot = calibrate(cell, seed)
    if watched:
        write_picture(folder / REFERENCE_FILE, cell.look().color)
    ColorMaskPolicy(image_to_robot, cell.settings.object_color).save(folder)  # last: where it is, all is


def calibrate(cell: Workcell, seed: int) -> ImageToRobot:
    """Fit the map from the picture to the robot, right at half the object's height, where its outline is.

    The workcell's own map where it has one; else the same cell and seed give the same map. Raises `BaggieError` when
    the marker is seen too seldom, or not where the arm says it is.
    """
    settings, camera = cell.settings, cell.camera
    known = cell.calibrations.image_to_robot
    if known is not None:
        return at_outline(known, settings)
    find = color_finder(settings.marker.color)
    in_hand = np.array([settings.marker.offset_m, 0.0, 0.0])
    cell.reset((seeds.CALIBRATION, seed))
    cell.show_paddle(True)
    low, high = MARKER_HEIGHTS_M
    raised = max(0.0, settings.object_size_m[2] + _CLEAR_M - low)
    places = grid(settings.workspace, MARGIN_M, (low + raised, high + raised))
    pixels, robot = [], []
    try:
        for _, T_base_hand, observation in visit(cell.arm, camera, places, in_hand):
            found = find(observation.color)
            if found is not None:
                pixels.append(marker_middle(found))
                robot.append(transform_points(T_base_hand, in_hand)[0])
    finally:
        cell.show_paddle(False)
    if len(pixels) < MIN_POINTS_TWO_HEIGHTS:
        raise BaggieError(
            f"expected to see the marker in most of {len(places)} places of the workspace, {settings.workspace}, "
            f"saw it in {len(pixels)}: see that the hand has it, or make the workspace smaller, within the arm's reach "
            "and the camera's view"
        )
    return ImageToRobot.fit(
        np.array(pixels),
        np.array(robot),
        cell.calibrated_camera,
        intrinsics=camera.intrinsics,
        height_m=settings.object_size_m[2] / 2,
    )
