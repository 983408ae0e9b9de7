"""Random streams, kept apart: a scene of one can never be a scene of another, whatever the seed.

A stream's name goes first in the list of integers that seeds a generator, so `(EVALUATION, 7, 0)` and
`(COLLECTION, 7, 0)` share nothing. The values are arbitrary but fixed: changing one changes every recording.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, TypeVar

import numpy as np

T = TypeVar("T")

COLLECTION: Final = 0xC011EC7
"""Scenes in which demonstrations are collected: `(COLLECTION, seed, sitting)`."""
PLACES: Final = 0x97ACE5
"""Where the collector carries the object: `(PLACES, seed, sitting)`."""
STYLE: Final = 0x57E1E
"""What a demonstrator in the style of others chooses: `(STYLE, seed, demonstration, step)`."""
CALIBRATION: Final = 0xCA11B8
"""Scenes in which a cell is calibrated: `(CALIBRATION, seed)`."""
EVALUATION: Final = 0xE7A10A7E
"""Scenes in which policies are judged: `(EVALUATION, seed, episode)`."""
LAB: Final = 0x1AB
"""Scenes of the virtual lab: `(LAB, seed)`."""


def generator(*stream: int) -> np.random.Generator:
    """The generator of one stream: its name and then non-negative integers.

    >>> a, b = generator(COLLECTION, 0, 1), generator(COLLECTION, 0, 1)
    >>> a.random() == b.random()
    True
    """
    return np.random.default_rng(stream)


def first_fit(draw: Callable[[], T], fits: Callable[[T], bool], tries: int = 1000) -> T | None:
    """Draw until something fits: the first of at most so many tries, or None where none of them did.

    >>> stream = generator(COLLECTION, 0)
    >>> first_fit(lambda: stream.integers(6) + 1, lambda eyes: eyes == 6) == 6
    np.True_
    >>> first_fit(lambda: stream.integers(6) + 1, lambda eyes: eyes > 6) is None
    True
    """
    drawn = (draw() for _ in range(tries))
    return next((each for each in drawn if fits(each)), None)
