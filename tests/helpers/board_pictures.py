"""Pictures of a printed target as a camera with a known pose and lens would take them."""

from functools import lru_cache

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from baggie.geometry import FloatArray, rigid, transform_points
from baggie.types import Image, Intrinsics
from baggie.vision.targets import ArucoMarker, Charuco, Chessboard, Target, parse_target

SUBPIXELS = 4
"""Samples per pixel and axis."""
TABLE, WHITE = 120, 235
"""Grey levels of what lies around the print, and of its paper."""


def render_board(
    target: Target,
    T_camera_target: FloatArray,
    intrinsics: Intrinsics,
    rng: np.random.Generator,
    *,
    noise: float = 2.0,
    blur: float = 0.6,
    sag_m: tuple[float, float] = (0.0, 0.0),
) -> Image:
    """`(H, W, 3)`: the print with a white margin one square wide, before a grey table.

    Each pixel is the mean of 4 x 4 rays followed to the board. `blur` is the standard deviation of the optics'
    Gaussian in pixels, `noise` that of the sensor in grey levels. `sag_m`: how far the board's middle is out of the
    plane through its outermost corners, bowed along its rows and along its columns, away from who looks at it.
    """
    width, height = intrinsics.width, intrinsics.height
    square_m = _square_m(target)
    seen_px = SUBPIXELS * intrinsics.matrix[0, 0] * square_m / T_camera_target[2, 3]
    square_px = 10 * int(np.clip(np.ceil(seen_px / 10), 4, 40))
    texture, origin_px = _flat_picture(target.spec, square_px)
    per_m = square_px / square_m
    bow = _Bow(target, sag_m)
    edge = (_outline(texture) - origin_px) / per_m
    u, v, columns, rows = _frame(T_camera_target, intrinsics, np.c_[edge, bow.depth(edge)])
    rays = _rays(width, height, intrinsics.matrix.tobytes(), intrinsics.distortion.tobytes())
    rays = rays[v : v + rows + 2, u : u + columns + 2]  # one more pixel on each side
    places = per_m * bow.where(T_camera_target, rays) + origin_px - 0.5
    fine = cv2.resize(places, None, fx=SUBPIXELS, fy=SUBPIXELS, interpolation=cv2.INTER_LINEAR)
    fine = fine[SUBPIXELS:-SUBPIXELS, SUBPIXELS:-SUBPIXELS].astype(np.float32)
    border = {"borderMode": cv2.BORDER_CONSTANT, "borderValue": TABLE}
    samples = cv2.remap(texture, fine, None, cv2.INTER_LINEAR, **border)
    picture = np.full((height, width), TABLE, np.float64)
    picture[v : v + rows, u : u + columns] = samples.reshape(rows, SUBPIXELS, columns, SUBPIXELS).mean((1, 3))
    picture = cv2.GaussianBlur(picture, (0, 0), blur) if blur else picture
    picture = picture + rng.normal(0.0, noise, picture.shape)
    grey = np.clip(np.rint(picture), 0, 255).astype(np.uint8)
    return np.repeat(grey[:, :, None], 3, axis=2)


class _Bow:
    """A surface z = a (1 - x²) + b (1 - y²) in the target's frame, x and y from -1 to 1 between its corners."""

    def __init__(self, target: Target, sag_m: tuple[float, float]) -> None:
        low, high = target.points[:, :2].min(axis=0), target.points[:, :2].max(axis=0)
        self._middle, self._half, self._sag = (low + high) / 2, (high - low) / 2, np.array(sag_m)

    def depth(self, xy: FloatArray) -> FloatArray:
        """z of places `(..., 2)` on the print."""
        return (1 - ((xy - self._middle) / self._half) ** 2) @ self._sag

    def where(self, T_camera_target: FloatArray, rays: FloatArray) -> FloatArray:
        """`(..., 2)`: the print's x and y where rays (x/z, y/z) meet it, the roots of a quadratic in their length."""
        turn = T_camera_target[:3, :3]
        start = -turn.T @ T_camera_target[:3, 3]
        u, v = np.moveaxis(rays, -1, 0)
        x, y, z = (u * turn[0, k] + v * turn[1, k] + turn[2, k] for k in range(3))
        off = (start[:2] - self._middle) / self._half
        (across_x, across_y), sag = (x / self._half[0], y / self._half[1]), self._sag
        a = sag[0] * across_x**2 + sag[1] * across_y**2
        b = z + 2 * (sag[0] * off[0] * across_x + sag[1] * off[1] * across_y)
        c = start[2] - (1 - off**2) @ sag
        root = np.sqrt(np.maximum(b**2 - 4 * a * c, 0))  # below zero a ray passes by, beside the print
        length = -2 * c / (b + np.sign(b) * root)  # the nearer one, which a flat print has, too
        return np.stack([start[0] + length * x, start[1] + length * y], axis=-1)


def random_pose(
    target: Target, intrinsics: Intrinsics, rng: np.random.Generator, tilt: float = 0.6, near: float = 1.0
) -> FloatArray:
    """`T_camera_target` with all points of the target in the picture, tilted by up to `tilt` radians about each axis.

    At `near` 1 its longer side takes 0.3 to 0.8 of the picture's width; at 2 it is twice as near.
    """
    points = target.points
    size = np.array([intrinsics.width, intrinsics.height])
    extent = np.ptp(points, axis=0).max()
    while True:
        turn = Rotation.from_euler("zxy", [rng.normal(0, 0.3), *rng.uniform(-tilt, tilt, 2)]).as_matrix()
        distance = intrinsics.matrix[0, 0] * extent / (intrinsics.width * near * rng.uniform(0.3, 0.8))
        ray = np.append(intrinsics.rays(rng.uniform(0.1, 0.9, (1, 2)) * size)[0], 1.0)
        pose = rigid(turn, ray * distance - turn @ points.mean(axis=0))
        in_camera = transform_points(pose, points)
        if in_camera[:, 2].min() < 0.02:
            continue
        pixels = intrinsics.project(in_camera)
        if (pixels > 8).all() and (pixels < size - 9).all():
            return pose


def lens_error_px(lens: Intrinsics, true: Intrinsics) -> float:
    """Pixels (RMS) over the picture between two lenses, one turned to fit the other, as poses do."""
    u, v = np.meshgrid(np.linspace(0, true.width - 1, 24), np.linspace(0, true.height - 1, 14))
    pixels = np.stack([u, v], -1).reshape(-1, 2)
    rays, others = (np.c_[each.rays(pixels), np.ones(len(pixels))] for each in (true, lens))
    turn, _ = Rotation.align_vectors(*(r / np.linalg.norm(r, axis=1)[:, None] for r in (others, rays)))
    return float(np.sqrt(((lens.project(turn.apply(rays)) - pixels) ** 2).sum(axis=1).mean()))


def _square_m(target: Target) -> float:
    return target.size_m / 4 if isinstance(target, ArucoMarker) else target.square_m


@lru_cache(maxsize=8)
def _flat_picture(spec: str, square_px: int) -> tuple[np.ndarray, float]:
    """The print with its margin, and how many pixels from its edges the origin of the target's frame is."""
    target = parse_target(spec)
    if isinstance(target, Charuco):
        size = (target.columns * square_px, target.rows * square_px)
        flat, origin = target.board.generateImage(size, marginSize=0), square_px
    elif isinstance(target, Chessboard):
        # Where its two ends differ, its corners are counted from the white one.
        first = (target.columns + target.rows) % 2
        parity = np.add.outer(np.arange(target.rows + 1), first + np.arange(target.columns + 1)) % 2
        flat = np.kron(parity, np.full((square_px, square_px), 255)).astype(np.uint8)
        origin = 2 * square_px
    else:
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, target.dictionary))
        flat = cv2.aruco.generateImageMarker(dictionary, target.number, 4 * square_px)
        origin = 3 * square_px
    flat = cv2.copyMakeBorder(flat, *[square_px] * 4, cv2.BORDER_CONSTANT, value=255)
    return np.where(flat > 127, WHITE, 25).astype(np.uint8), float(origin)


def _outline(texture: np.ndarray) -> FloatArray:
    """`(N, 2)` places along its edges, pixels."""
    along = np.linspace(0, 1, 20)
    edge = np.concatenate([np.c_[along, 0 * along + k] for k in (0, 1)])
    return np.concatenate([edge, edge[:, ::-1]]) * texture.shape[::-1]


def _frame(
    T_camera_target: FloatArray, intrinsics: Intrinsics, outline: FloatArray
) -> tuple[int, int, int, int]:
    """The part of the picture that shows the print: first column and row, how many."""
    pixels = intrinsics.project(transform_points(T_camera_target, outline))
    size = np.array([intrinsics.width, intrinsics.height])
    low = np.clip(np.floor(pixels.min(axis=0)) - 3, 0, size - 1).astype(int)
    high = np.clip(np.ceil(pixels.max(axis=0)) + 4, low + 1, size).astype(int)
    return int(low[0]), int(low[1]), *(high - low).tolist()


@lru_cache(maxsize=4)
def _rays(width: int, height: int, matrix: bytes, distortion: bytes) -> np.ndarray:
    """`(H + 2, W + 2, 2)`: the ray (x/z, y/z) of each pixel, and of those just outside."""
    lens = Intrinsics(width, height, np.frombuffer(matrix).reshape(3, 3), np.frombuffer(distortion))
    v, u = np.mgrid[-1 : height + 1, -1 : width + 1].astype(float)
    return lens.rays(np.stack([u, v], axis=-1).reshape(-1, 2)).reshape(height + 2, width + 2, 2)
