"""Colours by hue, so that things can be told apart by it."""

from __future__ import annotations

import colorsys

import numpy as np

from baggie.errors import BaggieError
from baggie.seeds import first_fit

Color = tuple[int, int, int]
"""RGB, 0 to 255."""
Hues = tuple[tuple[float, float], ...]
"""Bands of hues, degrees; one that spans 0 ends above 360."""
ALL_HUES: Hues = ((0.0, 360.0),)
GOAL_CARD_HUE, PADDLE_HUE = 133.0, 307.0
"""Degrees: of the goal card and of the calibration paddle."""
APART = 60.0
"""Degrees between the hues of two things that are to be told apart by them."""
RESERVED_APART = 35.0
"""The same from a hue that is reserved."""


def hue_of(color: Color) -> float:
    """Degrees."""
    return 360.0 * colorsys.rgb_to_hsv(*(value / 255 for value in color))[0]


def rgb(hue: float, saturation: float, value: float) -> Color:
    """The colour with this hue (degrees), saturation and value (0 to 1)."""
    red, green, blue = colorsys.hsv_to_rgb(hue / 360.0 % 1.0, saturation, value)
    return round(255 * red), round(255 * green), round(255 * blue)


def hue_distance(a: float, b: float) -> float:
    """Degrees between two hues, at most 180."""
    return abs((a - b + 180.0) % 360.0 - 180.0)


def random_hue(
    rng: np.random.Generator,
    bands: Hues,
    unlike: float | None = None,
    reserved: tuple[float, ...] = (GOAL_CARD_HUE, PADDLE_HUE),
) -> float:
    """A hue from one of the bands, 60 degrees from `unlike` and 35 from the reserved ones.

    Raises `BaggieError` where the bands leave none.
    """

    def somewhere() -> float:
        low, high = bands[rng.integers(len(bands))]
        return float(rng.uniform(low, high)) % 360.0

    def apart(hue: float) -> bool:
        unlike_that = unlike is None or hue_distance(hue, unlike) >= APART
        return unlike_that and all(hue_distance(hue, other) >= RESERVED_APART for other in reserved)

    hue = first_fit(somewhere, apart)
    if hue is None:
        raise BaggieError(
            f"expected bands with a hue {APART:.0f} degrees from {unlike} and {RESERVED_APART:.0f} from each of "
            f"{reserved}, got {bands}; widen them"
        )
    return hue
