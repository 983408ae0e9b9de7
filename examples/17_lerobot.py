"""LeRobot reads our recording: it is a LeRobotDataset v3.0 as it stands.

Shows a recording through LeRobot's own reader and PyTorch's `DataLoader`: any policy of LeRobot trains on it. Nothing
is converted, and nothing goes to a hub. Needs LeRobot 0.6.1, which wants Python 3.12 and an environment of its own
(`make lerobot` builds one in .venv-lerobot), and the recording that `make demo` leaves behind.

    .venv-lerobot/bin/python examples/17_lerobot.py

Prints what LeRobot sees of it:

    130 episodes, 130 frames
    a batch: observation.images.top (8, 3, 360, 640), observation.state (8, 8), action (8, 6)
    the first action: pick (0.412, -0.083), place (0.560, 0.204)
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

os.environ["HF_HUB_OFFLINE"] = "1"  # before LeRobot is imported: all is here

RECORDING = Path("demo/recording")


def main() -> None:
    """One batch, and the first action."""
    if not RECORDING.is_dir():
        sys.exit(f"error: no recording in {RECORDING}; make one first: make demo")
    try:
        from lerobot.datasets.lerobot_dataset import (  # type: ignore[import-not-found]  # noqa: PLC0415
            LeRobotDataset,
        )
    except ImportError:
        sys.exit("error: LeRobot is not here; make lerobot builds .venv-lerobot, whose Python to use")
    from torch.utils.data import DataLoader  # noqa: PLC0415 -- LeRobot's, not ours

    dataset = LeRobotDataset("local/bags", root=RECORDING)
    print(f"{dataset.num_episodes} episodes, {dataset.num_frames} frames")
    batch = next(iter(DataLoader(dataset, batch_size=8)))
    keys = ("observation.images.top", "observation.state", "action")
    print("a batch:", ", ".join(f"{key} {tuple(batch[key].shape)}" for key in keys))
    pick_x, pick_y, _, place_x, place_y, _ = dataset[0]["action"].tolist()
    print(f"the first action: pick ({pick_x:.3f}, {pick_y:.3f}), place ({place_x:.3f}, {place_y:.3f})")


if __name__ == "__main__":
    main()
