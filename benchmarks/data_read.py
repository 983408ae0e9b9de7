"""How fast recorded pictures are read, beside plain decoding of the same bytes and LeRobot's own reader.

    python benchmarks/data_read.py [DIR]

One thread each unless the row says otherwise. Without DIR, drawn attempts are recorded into a temporary
folder. Where lerobot can be imported (PYTHONPATH=src .venv-lerobot/bin/python benchmarks/data_read.py), its
row is there too.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("HF_HUB_OFFLINE", "1")
sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import cv2
import numpy as np
import pyarrow.parquet as pq

from baggie.data import Dataset, DatasetWriter, open_dataset
from baggie.data.lerobot import IMAGE
from helpers.synthetic import TASK, make_attempt

REPEATS = 9


def main() -> None:
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() as folder:
        root = Path(sys.argv[1]) if len(sys.argv) > 1 else record(Path(folder) / "drawn")
        dataset = open_dataset(root)
        width, height = dataset.settings.picture_size
        print(f"{len(dataset)} pictures of {width} x {height}; {REPEATS} rounds, interleaved; ms a picture")
        print(f"{'':<42}{'CPU':>8}{'clock:':>10}{'fastest':>9}{'slowest':>9}")
        print(f"{'reader':<42}{'median':>8}{'median':>10}")
        for name, seconds in measure(readers(dataset, root)).items():
            clock, cpu = np.array(seconds).T / len(dataset) * 1e3
            spread = f"{np.median(clock):>10.2f}{clock.min():>9.2f}{clock.max():>9.2f}"
            print(f"{name:<42}{np.median(cpu):>8.2f}{spread}")


def readers(dataset: Dataset, root: Path) -> dict[str, Callable[[], object]]:
    files = sorted(root.glob("data/*/*.parquet"))
    pngs = [pq.read_table(path)[IMAGE][0]["bytes"].as_py() for path in files]
    encoded = [np.frombuffer(png, np.uint8) for png in pngs]
    result: dict[str, Callable[[], object]] = {
        "cv2.imdecode of bytes in memory": lambda: [cv2.imdecode(png, cv2.IMREAD_COLOR) for png in encoded],
        "baggie, Dataset.colors": lambda: dataset.colors(threads=1),
        "baggie, Dataset.colors, two threads": lambda: dataset.colors(threads=2),
        "baggie, whole attempts (4 pictures each)": lambda: list(dataset),
    }
    try:
        import torch  # noqa: PLC0415
        from lerobot.datasets.lerobot_dataset import LeRobotDataset  # noqa: PLC0415
    except ImportError:
        return result
    torch.set_num_threads(1)
    theirs = LeRobotDataset("benchmark/attempts", root=root)
    result["LeRobotDataset[i]"] = lambda: [theirs[i][IMAGE] for i in range(len(theirs))]
    return result


def measure(readers: dict[str, Callable[[], object]]) -> dict[str, list[tuple[float, float]]]:
    """Seconds by the clock and of CPU of each round; interleaved, so that a busy moment hits all alike."""
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in readers}
    for turn in range(REPEATS + 1):
        for name, read in readers.items():
            clock, cpu = time.perf_counter(), time.process_time()
            read()
            if turn:  # the first warms up
                times[name].append((time.perf_counter() - clock, time.process_time() - cpu))
    return times


def record(root: Path, attempts: int = 40) -> Path:
    rng = np.random.default_rng(0)
    with DatasetWriter(root, task=TASK, robot_type="drawn") as writer:
        for i in range(attempts):
            writer.append(make_attempt(i, rng))
    return root


if __name__ == "__main__":
    main()
