"""Look into a recording: its numbers, one attempt, all pictures on one sheet.

Shows what is recorded of an attempt, and how to get at it: all numbers at once as arrays, or one attempt whole, with
its pictures. Needs the recording that `make demo` leaves behind.

Prints how it went, and draws all attempts, before and after, onto `runs/examples/contact-sheet.png`:

    130 attempts, 128 succeeded, failed: {'missed-grasp': 2}
    the fingers held 17.3 mm of bag on average
    attempt 5: picked at (0.412, -0.083), placed at (0.560, 0.204), tries: 1, success
    of 640 x 360 pixels; the bag's box before: [(214, 120), (263, 118), (265, 168), (216, 170)]
    drawn: runs/examples/contact-sheet.png
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import baggie
from baggie.data import contact_sheet, inspect_dataset

RECORDING = Path("demo/recording")
SHEET = Path("runs/examples/contact-sheet.png")


def main() -> None:
    """Say and draw what is there."""
    if not RECORDING.is_dir():
        sys.exit(f"error: no recording in {RECORDING}; make one first: make demo")
    told = inspect_dataset(RECORDING)  # what `baggie inspect --json` prints
    print(f"{told['attempts']} attempts, {told['succeeded']} succeeded, failed: {told['failed']}")

    recording = baggie.open_dataset(RECORDING)
    numbers = recording.numbers()  # columns by name, a row for each attempt; no picture is read
    held = np.array([failure is None for failure in recording.failures])
    print(f"the fingers held {1000 * numbers['grasp_width_m'][held].mean():.1f} mm of bag on average")

    attempt = recording[5]  # reads one, with its pictures
    pick, place = attempt.outcome.executed.pick, attempt.outcome.executed.place
    print(
        f"attempt {attempt.attempt_id}: picked at ({pick.x:.3f}, {pick.y:.3f}), "
        f"placed at ({place.x:.3f}, {place.y:.3f}), tries: {attempt.outcome.tries}, "
        f"{attempt.outcome.failure or 'success'}"
    )
    width, height = attempt.before.size
    box = [(round(u), round(v)) for u, v in attempt.box_before.tolist()]
    print(f"of {width} x {height} pixels; the bag's box before: {box}")
    print(f"drawn: {contact_sheet(RECORDING, SHEET, columns=4)}")


if __name__ == "__main__":
    main()
