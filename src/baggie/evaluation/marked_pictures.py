"""What an evaluation shows: planned and true places marked in pictures, heat maps over them, short videos."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import imageio_ffmpeg
import numpy as np
from numpy.typing import NDArray

from baggie.files import write_bytes, written_whole
from baggie.geometry import FloatArray, PlanarPose
from baggie.types import LAYER_M, Goal, Image, Observation, PickPlace, Plan
from baggie.vision.draw import paint_goal
from baggie.workcell.workcell import Workcell

PLANNED = (255, 64, 160)
"""Magenta, for what a policy wants: neither bags (red), goals (green) nor tables are so."""
TRUE = (255, 255, 255)
HEAT = ((255, 190, 0), (0, 220, 255), (190, 110, 255), (140, 255, 90))
"""One colour for each heat map of a plan, in their order."""

_H264 = ["-crf", "26", "-preset", "medium", "-movflags", "+faststart", "-threads", "1", "-f", "mp4"]
_HEIGHT = 360
_COLUMN = 180


@dataclass(frozen=True)
class Mark:
    """Where something was planned (or ended), and where it is (or should be): pixels (u, v), each `(2,)`."""

    name: str
    planned: FloatArray
    true: FloatArray


@dataclass(frozen=True)
class Region:
    """The part of a camera's picture worth showing, pixels; right and bottom are the first outside."""

    left: int
    top: int
    right: int
    bottom: int

    @classmethod
    def around(cls, points: FloatArray, size: tuple[int, int], margin: float = 0.08) -> Region:
        """What holds all finite `points` `(N, 2)` of a picture of `(width, height)`, and some margin."""
        points = points[np.isfinite(points).all(axis=1)]
        if len(points) == 0:
            return cls(0, 0, *size)
        low, high = points.min(axis=0), points.max(axis=0)
        spare = margin * (high - low).max()
        left, top = np.clip(np.floor(low - spare), 0, np.array(size) - 1).astype(int).tolist()
        right, bottom = np.clip(np.ceil(high + spare) + 1, 1, size).astype(int).tolist()
        return cls(left, top, right, bottom)

    @property
    def scale(self) -> float:
        """From the camera's pixels to those shown."""
        return _HEIGHT / (self.bottom - self.top)

    def cut(self, image: Image) -> Image:
        """The part, 360 pixels high."""
        part = image[self.top : self.bottom, self.left : self.right]
        size = (round(part.shape[1] * self.scale), _HEIGHT)
        method = cv2.INTER_AREA if self.scale < 1 else cv2.INTER_CUBIC
        return np.asarray(cv2.resize(part, size, interpolation=method), np.uint8)

    def to_shown(self, point: FloatArray) -> FloatArray:
        """Where a pixel (u, v) of the camera's picture appears, `(2,)`."""
        return _scaled(np.asarray(point, float) - [self.left, self.top], self.scale)


def marked(image: Image, region: Region, marks: Sequence[Mark]) -> Image:
    """A part of the picture with marks, and a close-up of each beside it, three times larger.

    Planned places are magenta crosses, true ones white rings.
    """
    whole = region.cut(image)
    for mark in marks:
        _draw(whole, region.to_shown(mark.planned), region.to_shown(mark.true), radius=7)
    height = _HEIGHT // len(marks)
    tiles = [_close_up(image, mark, 3 * region.scale, (_COLUMN, height)) for mark in marks]
    return np.hstack([whole, np.vstack(tiles)])


def _close_up(image: Image, mark: Mark, scale: float, size: tuple[int, int]) -> Image:
    """A tile of `(width, height)` pixels around the true place."""
    shift = (np.array(size) - 1) / 2 - _scaled(mark.true, scale)
    # Pixel centres are at integers: a picture scaled by s has its pixel (u, v) at s (u + 1/2) - 1/2.
    matrix = np.array([[scale, 0, (scale - 1) / 2 + shift[0]], [0, scale, (scale - 1) / 2 + shift[1]]])
    warped = cv2.warpAffine(image, matrix, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    tile = np.asarray(warped, np.uint8)
    _draw(tile, _scaled(mark.planned, scale) + shift, _scaled(mark.true, scale) + shift, radius=12)
    _write(tile, mark.name, (10, 24))
    tile[:, :3] = 24
    tile[-3:] = 24
    return tile


def heat_over(image: Image, region: Region, views: Mapping[str, NDArray[np.float32]]) -> Image:
    """Heat maps `(h, w)` in [0, 1] of the whole picture, each in its own colour, over a darkened part."""
    small = region.cut(image)
    canvas = 0.45 * np.repeat(cv2.cvtColor(small, cv2.COLOR_RGB2GRAY)[..., None], 3, axis=2).astype(
        np.float32
    )
    for view, color in zip(views.values(), HEAT, strict=False):
        peak = float(view.max())
        height, width = image.shape[:2]
        whole = cv2.resize(np.asarray(view, np.float32), (width, height))
        part = whole[region.top : region.bottom, region.left : region.right]
        heat = cv2.resize(part, (small.shape[1], small.shape[0]))
        # The square root shows the weak parts too: where else the policy had thought of.
        alpha = np.sqrt(np.clip(heat / peak if peak > 0 else heat, 0, 1))[..., None]
        canvas = canvas * (1 - alpha) + np.array(color, np.float32) * alpha
    picture = np.ascontiguousarray(canvas.round().astype(np.uint8))
    for row, (name, color) in enumerate(zip(views, HEAT, strict=False)):
        _write(picture, name, (10, 24 + 22 * row), color)
    return picture


def arrow(image: Image, start: FloatArray, end: FloatArray) -> Image:
    """A copy of a picture with an arrow in it, in the colour of what is planned; `start`, `end`: pixels (u, v)."""
    drawn = image.copy()
    a, b = (tuple(_fixed(np.asarray(point)).tolist()) for point in (start, end))
    for color, width in (((0, 0, 0), 4), (PLANNED, 2)):
        cv2.circle(drawn, a, 5 * 16, color, width, cv2.LINE_AA, shift=4)
        cv2.arrowedLine(drawn, a, b, color, width, cv2.LINE_AA, shift=4, tipLength=0.08)
    return drawn


def save_jpeg(path: Path, image: Image) -> None:
    """Write a JPEG of `(H, W, 3)` RGB, whole or not at all. Raises `WriteError`."""
    write_bytes(path, jpeg(image))


def jpeg(image: Image) -> bytes:
    """What a JPEG file of `(H, W, 3)` RGB holds."""
    ok, content = cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, 85])
    assert ok
    return bytes(content.tobytes())


def save_mp4(path: Path, frames: Sequence[Image], fps: float = 20) -> None:
    """Frames `(H, W, 3)` of one size, even in both directions, as an H.264 MP4 every browser plays.

    Written whole or not at all. Raises `WriteError`.
    """
    height, width = frames[0].shape[:2]
    with written_whole(path) as partial:
        writer = imageio_ffmpeg.write_frames(
            str(partial),
            (width, height),
            fps=fps,
            codec="libx264",
            pix_fmt_out="yuv420p",
            quality=None,
            macro_block_size=2,
            output_params=_H264,
        )
        writer.send(None)
        for frame in frames:
            writer.send(np.ascontiguousarray(frame))
        writer.close()


def _draw(image: Image, planned: FloatArray, true: FloatArray, radius: int) -> None:
    (pu, pv), (tu, tv) = planned, true
    arms = [((pu - radius, pv), (pu + radius, pv)), ((pu, pv - radius), (pu, pv + radius))]
    for width, dark in ((4, True), (2, False)):  # a dark border keeps both readable on any ground
        ring, cross = ((0, 0, 0), (0, 0, 0)) if dark else (TRUE, PLANNED)
        center = tuple(_fixed(np.array([tu, tv])).tolist())
        cv2.circle(image, center, radius * 16, ring, width, cv2.LINE_AA, shift=4)
        for a, b in arms:
            start, end = (tuple(_fixed(np.array(point)).tolist()) for point in (a, b))
            cv2.line(image, start, end, cross, width, cv2.LINE_AA, shift=4)


def _write(image: Image, text: str, at: tuple[int, int], color: tuple[int, int, int] = TRUE) -> None:
    for shade, width in (((0, 0, 0), 3), (color, 1)):
        cv2.putText(image, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.5, shade, width, cv2.LINE_AA)


def _scaled(point: FloatArray, factor: float) -> FloatArray:
    return np.asarray((np.asarray(point, float) + 0.5) * factor - 0.5)


def _fixed(points: FloatArray) -> NDArray[np.int32]:
    """Coordinates in sixteenths of a pixel, as OpenCV draws them with `shift=4`."""
    return np.round(np.clip(points, -1e4, 1e4) * 16).astype(np.int32)


_WHITE_M = 0.15
"""What is as high as a pyramid of three rows is white."""


def shaded(height: NDArray[np.float32]) -> Image:
    """Heights `(H, W)` metres as shades of grey, the table dark: `(H, W, 3)`."""
    shades = 30 + 225 * np.clip(height / _WHITE_M, 0, 1)
    return np.repeat(shades.astype(np.uint8)[..., None], 3, axis=2)


def backdrop(seen: Observation) -> Image:
    """What heat maps are laid over, `(H, W, 3)`: the heights, where they are known, else the picture."""
    return seen.color if seen.height is None else shaded(seen.height)


def save_map(path: Path, seen: Observation) -> None:
    """The colours of a height map."""
    save_jpeg(path, _whole(seen).cut(seen.color))


def save_step(path: Path, cell: Workcell, seen: Observation, plan: Plan) -> None:
    """The plan as an arrow from pick to place over the colours, and beside it its heat maps over the heights.

    A plan without heat maps is shown alone.
    """
    whole = _whole(seen)
    start, end = _ends(cell, seen, plan.action)
    shown = [arrow(whole.cut(seen.color), whole.to_shown(start), whole.to_shown(end))]
    if plan.views:
        shown.append(heat_over(backdrop(seen), whole, plan.views))
    save_jpeg(path, np.hstack(shown))


def _ends(cell: Workcell, seen: Observation, action: PickPlace) -> FloatArray:
    """`(2, 2)`: where pick and place appear in a picture."""
    if seen.grid is not None:
        return seen.grid.to_pixels([action.pick.xy, action.place.xy])
    ends = ((action.pick, action.pick_on_m), (action.place, action.place_on_m))
    return np.array([cell.outline(pose, round((on_m or 0.0) / LAYER_M)).mean(axis=0) for pose, on_m in ends])


def _whole(seen: Observation) -> Region:
    return Region(0, 0, *seen.size)


@dataclass(frozen=True)
class EpisodeScene:
    """Where the bag should end, was when the last plan was made, and did end, in the cell it was in."""

    cell: Workcell
    goal: PlanarPose
    bag: PlanarPose
    final: PlanarPose

    def pixel(self, pose: PlanarPose) -> FloatArray:
        """`(2,)`: where the middle of a bag there appears."""
        return np.asarray(self.cell.outline(pose).mean(axis=0))

    def region(self, size: tuple[int, int]) -> Region:
        """The part of the picture in which bags can lie."""
        area = self.cell.settings.workspace
        corners = [PlanarPose(x, y) for x in (area.x_min, area.x_max) for y in (area.y_min, area.y_max)]
        return Region.around(np.vstack([self.cell.outline(corner) for corner in corners]), size)


def save_pictures(
    stem: Path,
    scene: EpisodeScene,
    *,
    before: tuple[Observation, Goal | None, Plan | None],
    after: Observation,
) -> None:
    """Write `STEM-before.jpg`, `STEM-after.jpg`, and `STEM-heat.jpg` where the plan has heat maps.

    `before` is the picture the last plan was made from, the goal in it, and the plan. After, the outline is that of a
    bag right on the goal, however the goal had been given.
    """
    seen, goal, plan = before
    region = scene.region(after.size)
    shown = seen.color if goal is None else paint_goal(seen.color, goal)
    if plan is not None:
        poses = zip(
            ("pick", "place"), (plan.action.pick, plan.action.place), (scene.bag, scene.goal), strict=True
        )
        marks = [Mark(name, scene.pixel(ours), scene.pixel(true)) for name, ours, true in poses]
        save_jpeg(stem.with_name(stem.name + "-before.jpg"), marked(shown, region, marks))
        if plan.views:
            save_jpeg(stem.with_name(stem.name + "-heat.jpg"), heat_over(seen.color, region, plan.views))
    else:
        save_jpeg(stem.with_name(stem.name + "-before.jpg"), region.cut(shown))
    end = Mark("end", scene.pixel(scene.final), scene.pixel(scene.goal))
    outlined = paint_goal(after.color, Goal(scene.cell.outline(scene.goal), "outline"))
    save_jpeg(stem.with_name(stem.name + "-after.jpg"), marked(outlined, region, [end]))
