"""Pictures and goals at the size a policy was trained on."""

from __future__ import annotations

from baggie.errors import BaggieError
from baggie.types import Goal, Image, Observation, seen
from baggie.vision.draw import check_goal


def as_trained(observation: Observation, goal: Goal, size: tuple[int, int]) -> tuple[Image, Goal]:
    """Picture and goal at `size` (width, height), that of the training pictures.

    Raises `BaggieError` when the goal leaves the picture, or the picture has another shape than those.
    """
    (width, height), (to_width, to_height) = seen(observation).size, size
    check_goal(goal, (width, height))
    if abs(width * to_height - height * to_width) > max(to_width, to_height):
        raise BaggieError(
            f"this policy was trained on pictures of {to_width} x {to_height} pixels, but got one of {width} x "
            f"{height}: it belongs to another camera; train one for this one"
        )
    color = Observation(observation.color).resized(to_width, to_height).color
    return color, goal.scaled(to_width / width, to_height / height)
