"""How far from the truth a lens is that was calibrated with a board that is not flat, beside mrcal and OpenCV.

    python benchmarks/bowed_boards.py --out runs/bowed-boards

Boards of four shapes, a camera of its own for each seed, rendered pictures, and everybody gets the same corners. Then
whether the stated uncertainty is honest, over smaller pictures of 100 cameras. mrcal is Debian's, by its commands in a
process of its own; without it its column is empty. The corners that were found are kept in OUT, again goes on. Writes
docs/results/bowed-boards.{json,md} and docs/results/bowed-boards-stated.{json,md}.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import cv2
import numpy as np
import tyro
from rich.progress import track
from scipy.stats import chi2

from baggie.calibration.files import CameraIdentity
from baggie.calibration.intrinsics.camera_calibration import CameraCalibration, import_intrinsics
from baggie.calibration.intrinsics.fit import fit_intrinsics
from baggie.calibration.intrinsics.views import BoardView
from baggie.geometry import FloatArray
from baggie.operator import Nobody, Operator
from baggie.processes import LocalProcesses
from baggie.results import provenance, write_results
from baggie.types import Image, Intrinsics
from baggie.vision.targets import TargetDetection, parse_target
from helpers.board_pictures import lens_error_px, random_pose, render_board

RESULTS = Path("docs/results")
CHESSBOARD, CHARUCO = "chessboard:10x7:0.025", "charuco:11x8:0.025:0.018:DICT_4X4_50"
SHAPES = {
    "flat": (0.0, 0.0),
    "bowed along": (0.001, 0.0),
    "bowed across": (0.0, -0.001),
    "bowed both ways": (0.001, 0.0005),
}
"""How far the middle is out of the plane, along and across, metres."""
OPENCVS = 4
"""Of so many cameras one is judged by OpenCV's own corners, too."""
NOISE = 2.0
"""Grey levels."""
LARGE, SMALL = (1280, 720, 900.0), (640, 480, 560.0)
"""Width, height, focal length, pixels."""
PICTURES = {LARGE: 20, SMALL: 12}
MRCAL = "mrcal-calibrate-cameras"


@dataclass(frozen=True)
class Options:
    """How much to render, and where to keep what was found in it."""

    seeds: int = 10
    """Cameras for each shape."""
    renderings: int = 100
    """Cameras, of all shapes in turn, by which the stated uncertainty is judged; of each kind of board."""
    out: Path = Path("runs/bowed-boards")
    """Folder of the corners that were found."""
    workers: int = 2
    """Processes."""


@dataclass(frozen=True)
class Task:
    """One camera and the pictures it takes of one board."""

    board: str
    shape: str
    seed: int
    size: tuple[int, int, float]

    @property
    def name(self) -> str:
        """Of its file."""
        return f"{self.board.split(':')[0]}-{self.size[0]}-{self.shape.replace(' ', '-')}-{self.seed}.npz"

    @property
    def by_opencv(self) -> bool:
        """Whether OpenCV's own corners are kept, too; its chessboard finder takes long."""
        return self.size == SMALL and self.board == CHESSBOARD and (self.seed // len(SHAPES)) % OPENCVS == 0

    @property
    def lens(self) -> Intrinsics:
        """The true one, drawn from the seed until its whole picture is seen by rays."""
        rng = np.random.default_rng([11, self.seed])
        while True:
            lens = self._drawn(rng)
            corners = np.array([[u, v] for u in (0.0, lens.width - 1) for v in (0.0, lens.height - 1)])
            if np.allclose(lens.project(np.c_[lens.rays(corners), np.ones(4)]), corners, atol=1e-3):
                return lens

    def _drawn(self, rng: np.random.Generator) -> Intrinsics:
        width, height, focal = self.size
        fx, fy = focal * rng.uniform(0.9, 1.1) * np.array([1.0, rng.uniform(0.998, 1.002)])
        cx, cy = np.array([width, height]) / 2 + rng.uniform(-0.015, 0.015, 2) * width
        k1, k2 = rng.uniform(-0.2, 0.1), rng.uniform(-0.05, 0.07)
        return Intrinsics(
            width,
            height,
            np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]),
            np.array([k1, k2, *rng.normal(0, 4e-4, 2), 0.0]),
        )


def main(options: Options) -> None:
    """Render what is missing, calibrate, and write the tables."""
    shaped = [Task(CHESSBOARD, shape, seed, LARGE) for shape in SHAPES for seed in range(options.seeds)]
    stated = [
        Task(board, list(SHAPES)[seed % len(SHAPES)], seed, SMALL)
        for board in (CHESSBOARD, CHARUCO)
        for seed in range(options.renderings)
    ]
    options.out.mkdir(parents=True, exist_ok=True)
    missing = [task for task in (*shaped, *stated) if not (options.out / task.name).exists()]
    for _ in track(
        LocalProcesses().stream(partial(open_worker, options.out), missing, options.workers, Nobody()),
        "cameras",
        total=len(missing),
    ):
        pass
    if shutil.which(MRCAL) is None:
        print(f"{MRCAL} is not installed: its column stays empty; apt install mrcal")
    rows = [compared(options.out, shape, options.seeds) for shape in track(SHAPES, "shapes")]
    written = write_results(
        RESULTS / "bowed-boards",
        f"Lenses from boards that are not flat: pixels off over the picture, {options.seeds} cameras each",
        rows,
        provenance(range(options.seeds)),
        SHAPES_NOTES,
    )
    rows = [
        judged(options.out, stated, CHESSBOARD, "pixels", "chessboard"),
        judged(options.out, stated, CHESSBOARD, "opencv", "chessboard, OpenCV's own"),
        judged(options.out, stated, CHARUCO, "pixels", "ChArUco board"),
    ]
    written += write_results(
        RESULTS / "bowed-boards-stated",
        f"Whether a lens's stated uncertainty is honest, over {options.renderings} cameras",
        rows,
        provenance(range(options.renderings)),
        STATED_NOTES,
    )
    print(*written, sep="\n")


SHAPES_NOTES = (
    "A chessboard of 10 x 7 corners, 25 mm apart, its middle 1 mm out of the plane (both ways: 1 and 0.5 mm), "
    f"{PICTURES[LARGE]} pictures of 1280 x 720 with blur and two grey levels of noise, a focal length of 810 to "
    "990 px. `px`: RMS over a grid of the whole picture, a rotation taken out; mean over the cameras and, in "
    "brackets, the worst. All have the same corners and, but for ours, which chooses its terms, five distortion terms."
)
STATED_NOTES = (
    f"{PICTURES[SMALL]} pictures of 640 x 480 each, the four shapes in turn. `in 95%`: how often the true lens lies in "
    "the region that is to hold it with 95% probability. `f off`: the focal length's error over its stated standard "
    "deviation, RMS; 1 is honest. `corners`: how far they are off the truth, RMS, and `noise` as the calibration has "
    "it from its pictures. The second line is of corners as `cv2.findChessboardCornersSB` leaves them: they err "
    "together, over whole boards, and a covariance of corners that err each by itself says too little."
)


# -- pictures --------------------------------------------------------------------------------------


def open_worker(folder: Path, _operator: Operator) -> Callable[[Task], Iterable[str]]:
    """What a process does with a camera."""
    cv2.setNumThreads(1)

    def run(task: Task) -> Iterable[str]:
        photograph(task, folder / task.name)
        yield task.name

    return run


def photograph(task: Task, path: Path) -> None:
    """Take pictures and keep what is found in them: ids, corners, OpenCV's own ones, and where they truly are."""
    board, lens, rng = parse_target(task.board), task.lens, np.random.default_rng([12, task.seed])
    blur = float(rng.uniform(0.5, 1.2))
    found: dict[str, FloatArray] = {}
    count = 0
    while count < PICTURES[task.size]:
        pose = random_pose(board, lens, rng)
        picture = render_board(board, pose, lens, rng, noise=NOISE, blur=blur, sag_m=SHAPES[task.shape])
        seen = board.detect(picture)
        if seen is None:
            continue
        surface = bent(board.points, SHAPES[task.shape])[seen.ids]
        found[f"ids-{count}"], found[f"pixels-{count}"] = seen.ids, seen.pixels
        if task.by_opencv:
            found[f"opencv-{count}"] = opencv_corners(picture, seen)
        found[f"true-{count}"] = lens.project(surface @ pose[:3, :3].T + pose[:3, 3])
        count += 1
    with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".npz", delete=False) as file:
        np.savez_compressed(file, **found)
    Path(file.name).replace(path)


def bent(points: FloatArray, sag_m: tuple[float, float]) -> FloatArray:
    """A board's corners, bowed."""
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    places = (2 * points[:, :2] - low - high) / (high - low)
    return np.c_[points[:, :2], (1 - places**2) @ np.array(sag_m)]


def opencv_corners(picture: Image, seen: TargetDetection) -> FloatArray:
    """As `cv2.findChessboardCornersSB` leaves them; those of `seen` where it finds none."""
    found, corners = cv2.findChessboardCornersSB(picture[:, :, 0], (10, 7), flags=cv2.CALIB_CB_ACCURACY)
    return np.asarray(corners, float).reshape(-1, 2) if found else seen.pixels


def views(folder: Path, task: Task, which: str = "pixels") -> list[TargetDetection]:
    """What was found in the pictures."""
    points = parse_target(task.board).points
    with np.load(folder / task.name) as found:
        ids = [found[f"ids-{i}"] for i in range(PICTURES[task.size])]
        return [TargetDetection(each, found[f"{which}-{i}"], points[each]) for i, each in enumerate(ids)]


# -- calibrations ----------------------------------------------------------------------------------


def ours(task: Task, seen: Sequence[TargetDetection]) -> CameraCalibration:
    """As `baggie calibrate intrinsics` does it."""
    named = [BoardView(f"{i:03d}", view) for i, view in enumerate(seen)]
    return fit_intrinsics(named, CameraIdentity("camera", *task.size[:2]), parse_target(task.board))


def opencv(task: Task, seen: Sequence[TargetDetection], released: bool) -> Intrinsics:
    """`cv2.calibrateCamera`, or `cv2.calibrateCameraRO` with every point of the board free but three."""
    points, pixels = ([getattr(v, of).astype(np.float32) for v in seen] for of in ("points", "pixels"))
    size = task.size[:2]
    if released:
        _, matrix, bent_by, *_ = cv2.calibrateCameraRO(points, pixels, size, 9, None, None)
    else:
        _, matrix, bent_by, *_ = cv2.calibrateCamera(points, pixels, size, None, None)
    return Intrinsics(*size, matrix, bent_by.ravel()[:5])


def mrcal(task: Task, seen: Sequence[TargetDetection]) -> Intrinsics:
    """mrcal's command, from a list of corners."""
    with tempfile.TemporaryDirectory() as folder:
        lines = ["# filename x y weight"]
        for number, view in enumerate(seen):
            lines += [f"frame{number:03d}.png {u:.6f} {v:.6f} 1" for u, v in view.pixels]
        Path(folder, "corners.vnl").write_text("\n".join(lines) + "\n")
        words = ["--corners-cache", "corners.vnl", "--corners-cache-has-weights", "--outdir", "."]
        words += ["--lensmodel", "LENSMODEL_OPENCV5", "--focal", str(task.size[2])]
        words += ["--imagersize", *map(str, task.size[:2]), "--object-spacing", "0.025"]
        words += ["--object-width-n", "10", "--object-height-n", "7", "frame*.png"]
        own = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
        subprocess.run([MRCAL, *words], cwd=folder, env=own, check=True, capture_output=True)
        return import_intrinsics(Path(folder, "camera-0.cameramodel"), "camera").intrinsics


# -- tables ----------------------------------------------------------------------------------------


def compared(folder: Path, shape: str, seeds: int) -> dict[str, object]:
    """One shape's line: everybody's error."""
    errors: dict[str, list[float]] = {}
    sags, focal = [], []
    for seed in range(seeds):
        task = Task(CHESSBOARD, shape, seed, LARGE)
        seen = views(folder, task)
        calibration = ours(task, seen)
        lenses = {"ours": calibration.intrinsics}
        if shutil.which(MRCAL):
            lenses["mrcal"] = mrcal(task, seen)
        lenses["calibrateCameraRO"] = opencv(task, seen, released=True)
        lenses["calibrateCamera, as if flat"] = opencv(task, seen, released=False)
        for name, lens in lenses.items():
            errors.setdefault(name, []).append(lens_error_px(lens, task.lens))
        assert calibration.sag is not None
        sags.append([calibration.sag.along_m, calibration.sag.across_m])
        focal.append(calibration.intrinsics.matrix[0, 0] / task.lens.matrix[0, 0] - 1)
    off_um = 1e6 * np.abs(np.array(sags) - SHAPES[shape]).max()
    return {
        "board": shape,
        **{f"{name}, px": f"{np.mean(each):.3f} ({np.max(each):.3f})" for name, each in errors.items()},
        "our f off, %": float(100 * np.sqrt(np.mean(np.square(focal)))),
        "sag off at most, μm": float(off_um),
    }


def judged(folder: Path, tasks: Sequence[Task], board: str, which: str, words: str) -> dict[str, object]:
    """One line on one kind of corners: how honest what is stated is."""
    own = [task for task in tasks if task.board == board and (which != "opencv" or task.by_opencv)]
    inside, off, corners, noise = [], [], [], []
    for task in track(own, words):
        seen, true = views(folder, task, which), views(folder, task, "true")
        calibration = ours(task, seen)
        inside.append(holds(calibration, task.lens))
        focal = calibration.intrinsics.matrix[0, 0] - task.lens.matrix[0, 0]
        off.append(focal / calibration.standard_deviations["fx_px"])
        corners.append(np.concatenate([s.pixels - t.pixels for s, t in zip(seen, true, strict=True)]))
        noise.append(calibration.corner_noise_px)
    flat = [each for each, task in zip(off, own, strict=True) if task.shape == "flat"]
    return {
        "corners of": words,
        "cameras": len(own),
        "in 95%": f"{np.mean(inside):.0%}",
        "f off, sd": float(np.sqrt(np.mean(np.square(off)))),
        "f off, sd, flat boards": float(np.sqrt(np.mean(np.square(flat)))),
        "corners, px": float(np.sqrt((np.concatenate(corners) ** 2).sum(axis=1).mean())),
        "noise, px": float(np.mean([each for each in noise if each is not None])),
    }


def holds(calibration: CameraCalibration, true: Intrinsics) -> bool:
    """Whether the true lens lies in the stated 95% region."""
    assert calibration.covariance is not None
    std = np.sqrt(np.diag(calibration.covariance))
    free = std > 0
    found, truly = (
        np.concatenate([lens.matrix[[0, 1, 0, 1], [0, 1, 2, 2]], lens.distortion])
        for lens in (calibration.intrinsics, true)
    )
    error = ((found - truly) / np.where(free, std, 1.0))[free]
    region = (calibration.covariance / np.outer(std, std).clip(1e-300))[np.ix_(free, free)]
    return bool(error @ np.linalg.solve(region, error) < chi2.ppf(0.95, free.sum()))


if __name__ == "__main__":
    main(tyro.cli(Options))
