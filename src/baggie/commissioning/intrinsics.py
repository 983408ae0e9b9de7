"""`baggie calibrate intrinsics`: a camera's own matrix and lens, from pictures of a board."""

from __future__ import annotations

from functools import partial
from typing import Any

from baggie.calibration.intrinsics.camera_calibration import (
    CameraCalibration,
    draw_corner_errors,
    import_intrinsics,
)
from baggie.calibration.intrinsics.fit import (
    BoardView,
    calibrate_intrinsics_from,
    fit_intrinsics,
    is_new,
    next_view,
)
from baggie.commissioning.session import Session, ViewFolder, open_session
from baggie.errors import CalibrationError, CameraError
from baggie.files import write_if_possible
from baggie.operator import Operator
from baggie.options.commissioning import IntrinsicsOptions
from baggie.pictures import read_picture
from baggie.vision.targets import parse_target

MAX_LOOKS = 400
"""Pictures looked at before giving up on a board that is never shown where it is needed."""


def calibrate_intrinsics(options: IntrinsicsOptions, *, operator: Operator | None = None) -> dict[str, Any]:
    """Calibrate and save; the result, ready for JSON. Raises `BaggieError`, or `KeyboardInterrupt` live.

    The person at the terminal is told and asked, unless `operator` is given.
    """
    if options.factory is not None:
        calibration = import_intrinsics(options.factory, options.name or options.factory.stem)
    elif options.from_ is not None:
        name = options.name or options.from_.resolve().stem
        calibration = calibrate_intrinsics_from(options.from_, parse_target(options.board), name)
    else:
        with open_session(options, operator) as session:
            calibration = calibrate_intrinsics_live(session, options)
    calibration.save(options.out)
    result: dict[str, Any] = {"calibration": str(options.out), **calibration.summary()}
    if calibration.views:
        picture = options.out.with_suffix(".png")
        if write_if_possible(picture, partial(draw_corner_errors, calibration)):
            result["picture"] = str(picture)
    result["next"] = "baggie calibrate camera-to-world, image-to-robot or hand-eye, with --intrinsics " + str(
        options.out
    )
    return result


def calibrate_intrinsics_live(session: Session, options: IntrinsicsOptions) -> CameraCalibration:
    """Take pictures of the board until they cover view, tilt and distance; each is kept at once."""
    target = parse_target(options.board)
    folder = ViewFolder(
        options.out.with_suffix(""), {"board": target.spec, "camera": session.identity.to_yaml()}
    )
    views = []
    for view in folder.views:
        seen = target.detect(read_picture(folder.folder / view["image"]))
        if seen is not None:
            views.append(BoardView(view["image"], seen))
    if views:
        session.say(f"going on with the {len(views)} pictures in {folder.folder}")
    try:
        for _ in range(MAX_LOOKS):
            hint = next_view(views, session.identity, target)
            if hint is None:
                break
            session.assistant.show(target, hint)
            try:
                picture = session.camera.look().color
            except CameraError:
                if not views:
                    raise
                break  # a video is over, or the cable came off: what was seen may be enough
            seen = target.detect(picture)
            session.show(folder.folder, picture, seen, f"{len(views)} pictures. {hint}")
            if seen is not None and is_new(views, seen):
                folder.append({}, picture)
                views.append(BoardView(folder.views[-1]["image"], seen))
                session.say(f"picture {len(views)}: {len(seen.ids)} corners")
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"interrupted with {len(views)} pictures in {folder.folder}; the same command again goes on"
        ) from None
    if not views:
        raise CalibrationError(
            f"no board {target.spec} was seen: {target.why_not(session.camera.look().color)}"
        )
    session.assistant.put_away()
    return fit_intrinsics(views, session.identity, target)
