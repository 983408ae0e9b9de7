"""Pictures and goals at the size a policy was trained on."""

from __future__ import annotations

from baggie.errors import BaggieError
from baggie.pictures import same_shape
from baggie.types import Goal, Image, Observation, seen
from baggie.vision.draw import check_goal


def check_camera(size: tuple[int, int], camera_size: tuple[int, int]) -> None:
    """Raise `BaggieError` where pictures of `size` are of another shape than those the training's camera took."""
    (width, height), (own_width, own_height) = size, camera_size
    if not same_shape(size, camera_size):
        raise BaggieError(
            f"this policy was trained on pictures of {own_width} x {own_height} pixels, but got one of {width} x "
            f"{height}: it belongs to another camera; train one for this one"
        )


def as_trained(
    observation: Observation, goal: Goal, size: tuple[int, int], camera_size: tuple[int, int]
) -> tuple[Image, Goal]:
    """Picture and goal at `size` (width, height), that of the training pictures.

    Those are pictures of `camera_size` resized, squeezed where their shape is another. Raises `BaggieError` when the
    goal leaves the picture, or the picture is neither one of the training's size nor of the camera's shape.
    """
    (width, height), (to_width, to_height) = seen(observation).size, size
    check_goal(goal, (width, height))
    if (width, height) != size:
        check_camera((width, height), camera_size)
    color = Observation(observation.color).resized(to_width, to_height).color
    return color, goal.scaled(to_width / width, to_height / height)
