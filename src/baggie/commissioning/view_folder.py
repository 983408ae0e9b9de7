"""A folder of pictures and what goes with each: what a calibration is made from, kept so that it can be made again."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from baggie.calibration.files import VIEWS_FILE, read_views_file
from baggie.errors import CalibrationError
from baggie.files import write_text
from baggie.types import Image
from baggie.vision.picture_files import write_picture


class ViewFolder:
    """Pictures `000.png`, `001.png`, ... and `views.json`, which lists them with what is known of each.

    A view is in `views.json` once its picture is on the disk, so an interruption loses at most the one being taken. A
    folder that was begun under other conditions (`header`) is refused.
    """

    def __init__(self, folder: Path, header: Mapping[str, Any]) -> None:
        """Open the folder, or begin it. Raises `DataError`, `CalibrationError`."""
        self.folder = folder
        self._header = json.loads(json.dumps(dict(header)))
        self.views: list[dict[str, Any]] = []
        path = folder / VIEWS_FILE
        if path.exists():
            self.views = self._resume(path)

    def append(self, view: Mapping[str, Any], picture: Image | None = None) -> None:
        """Keep a view; its picture, if there is one, under the name `view["image"]` gets here."""
        entry = dict(view)
        if picture is not None:
            entry["image"] = f"{len(self.views):03d}.png"
            write_picture(self.folder / entry["image"], picture)
        self.views.append(entry)
        write_text(
            self.folder / VIEWS_FILE, json.dumps({**self._header, "views": self.views}, indent=1) + "\n"
        )

    def __len__(self) -> int:
        return len(self.views)

    def _resume(self, path: Path) -> list[dict[str, Any]]:
        content = read_views_file(self.folder)
        for key, value in self._header.items():
            if content.get(key) != value:
                raise CalibrationError(
                    f"{path} was begun with {key} {content.get(key)!r}, not {value!r}; go on as it was begun, "
                    "or remove the folder to start again"
                )
        return list(content["views"])
