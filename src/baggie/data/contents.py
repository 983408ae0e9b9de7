"""What a writer remembers of the attempts on disk."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from baggie.data import lerobot
from baggie.data.record import Record
from baggie.data.statistics import FeatureStats, RunningStats, pixel_stats
from baggie.errors import DataError
from baggie.types import Attempt

DONE = 1 - 1e-6
"""What an episode earns when its task is done, but for rounding: six times a sixth is less than 1."""


class Contents:
    """Ids, episodes, and statistics of numbers and pixels; of the last episode, which may grow, all frames."""

    def __init__(self, numbers: pa.Table) -> None:
        """Start from the numbers of the records on disk, in LeRobot's order."""
        self.attempt_ids: set[int] = set()
        self.episodes: dict[int, int] = {}
        """How many attempts of each episode there are, in the order in which they were begun."""
        self.frames: Sequence[lerobot.Frame] = []
        """Of the last of LeRobot's episodes."""
        self.last: int = -1
        """LeRobot's number of that episode."""
        self.histogram = np.zeros((3, 256), np.int64)
        """Of that episode's pictures: how many pixels have each value."""
        self._growing: int | None = None
        self._earned = 0.0
        pictures = numbers["histogram"].combine_chunks().flatten().to_numpy(zero_copy_only=False)
        histograms = pictures.reshape(-1, 3, 256)
        frames = [
            self._count(record, histogram)
            for record, histogram in zip(
                numbers.drop_columns("histogram").to_pylist(), histograms, strict=True
            )
        ]
        self._numbers = RunningStats(frames, lerobot.DTYPES)
        self._pixels = histograms.sum(axis=0, dtype=np.int64)

    def add(self, record: Record, histogram: NDArray[np.int32]) -> lerobot.Frame:
        """Count one attempt more, of whose picture this is the histogram `(3, 256)`; its frame."""
        frame = self._count(record, histogram)
        self._numbers.add(frame)
        self._pixels += histogram
        return frame

    def _count(self, record: Record, histogram: NDArray[np.int32]) -> lerobot.Frame:
        """Add to everything but the statistics of the whole."""
        episode, step, reward = record["episode"], record["step"], record["reward"]
        if step == 0:
            self.last, self.frames, self._earned = record["episode_index"], [], 0.0
            self.histogram = np.zeros((3, 256), np.int64)
        self._earned += reward or 0.0
        # Of those that were given up, no frame is done: whether another attempt follows is not known in time.
        done = episode is None or self._earned >= DONE
        frame = lerobot.frame_of(record, len(self.attempt_ids), done)
        self.frames = [*self.frames, frame]
        self.histogram = self.histogram + histogram
        self.attempt_ids.add(record["attempt_id"])
        self._growing = episode
        if episode is not None:
            self.episodes[episode] = step + 1
        return frame

    def episode_for(self, attempt: Attempt) -> int:
        """LeRobot's number of the episode that an attempt goes into: the last one, or a new one.

        Raises DataError when it is out of order.
        """
        episode, step = attempt.episode, attempt.step
        if episode is None:
            if step != 0:
                raise DataError(
                    f"attempt {attempt.attempt_id}: expected step 0 of an attempt that stands alone, got {step}; "
                    "say which episode it belongs to"
                )
            return self.last + 1
        if episode < 0:
            raise DataError(
                f"attempt {attempt.attempt_id}: expected an episode of 0 or more, got {episode}; count from 0"
            )
        expected = self.episodes.get(episode, 0)
        if step != expected:
            raise DataError(
                f"attempt {attempt.attempt_id}: expected step {expected} of episode {episode}, got {step}; "
                "record the attempts of an episode one after the other, from step 0 on"
            )
        if step > 0 and episode != self._growing:
            raise DataError(
                f"attempt {attempt.attempt_id}: expected episode {episode} to be the last one recorded, got another "
                "one's attempts between its own; record the attempts of an episode one after the other"
            )
        return self.last if step else self.last + 1

    def stats(self) -> dict[str, FeatureStats]:
        """The content of `stats.json`."""
        return {lerobot.IMAGE: pixel_stats(self._pixels, len(self.attempt_ids)), **self._numbers.stats()}
