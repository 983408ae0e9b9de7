"""What a dataset was collected with: fixed when it is begun, checked when it is continued."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from baggie.data.files import broken, read_json
from baggie.data.layout import Layout
from baggie.errors import DataError

_LATER = frozenset({"workcell"})
"""What older recordings do not say of how they were collected: it is taken to be the same."""
_ANY_ROBOT = frozenset({"python", "lerobot"})
"""What older recordings say of an arm of one's own or LeRobot's: its name is taken to be the same."""
FORMAT = "baggie-attempts-1"
"""The layout of `attempts/`; changes when a reader of the old one would misread the new."""


@dataclass(frozen=True)
class DatasetSettings:
    """What is the same for all attempts of a dataset."""

    task: str
    """The instruction in words."""
    robot_type: str
    picture_size: tuple[int, int]
    """`(width, height)` of the recorded pictures, pixels."""
    collection: Mapping[str, Any]
    """The collector's own settings: seed, cell, colour of the object, ... as JSON has them."""

    @classmethod
    def make(
        cls, task: str, robot_type: str, picture_size: tuple[int, int], collection: Mapping[str, Any]
    ) -> DatasetSettings:
        """Settings as they read back from disk. Raises DataError where JSON cannot hold them."""
        try:
            plain = json.loads(json.dumps(dict(collection)))
        except TypeError as error:
            raise DataError(f"a dataset's collection settings must be JSON: {error}") from None
        width, height = picture_size
        return cls(task, robot_type, (int(width), int(height)), plain)

    def to_json(self) -> dict[str, Any]:
        """The content of `collection.json`."""
        return {"format": FORMAT, **asdict(self)}

    @classmethod
    def read(cls, layout: Layout) -> DatasetSettings:
        """The settings of a dataset on disk. Raises DataError where there is none."""
        _check_is_dataset(layout)
        content = read_json(layout.collection)
        if not isinstance(content, dict) or content.get("format") != FORMAT:
            raise DataError(
                f"{layout.root} is written in another format than {FORMAT}: "
                "read it with the version of baggie that wrote it"
            )
        try:
            size = tuple(content["picture_size"])
            return cls.make(content["task"], content["robot_type"], (size[0], size[1]), content["collection"])
        except (KeyError, IndexError, TypeError):
            raise broken(layout.collection, "is damaged") from None

    def check_same(self, other: DatasetSettings, root: Path) -> None:
        """Raise DataError saying what differs from `other`, the settings asked for now."""
        mine, theirs = _flat(self), _flat(other)
        for key in sorted(mine.keys() | theirs.keys()):
            recorded, asked = mine.get(key), theirs.get(key)
            older = (key in _LATER and key not in mine) or (key == "robot_type" and recorded in _ANY_ROBOT)
            if recorded != asked and not older:
                raise DataError(
                    f"{root} was recorded with {key} = {recorded!r}, not {asked!r}: "
                    "go on with the same settings, or record into another folder"
                )


def _flat(settings: DatasetSettings) -> dict[str, Any]:
    fixed = {"task": settings.task, "robot_type": settings.robot_type, "picture_size": settings.picture_size}
    return {**settings.collection, **fixed}


def _check_is_dataset(layout: Layout) -> None:
    if layout.collection.exists():
        return
    root = layout.root
    if not root.exists():
        raise DataError(
            f"there is no dataset at {root}: the folder does not exist; `baggie collect` makes one"
        )
    if layout.info.exists():
        raise DataError(
            f"{root} is a LeRobot dataset without `attempts/`: baggie reads only what it recorded itself; "
            "give the folder the recording was made in"
        )
    raise DataError(f"{root} holds no dataset; `baggie collect --out {root}` makes one")
