"""What is wrong with a YAML file: the line, the entry, what may stand there."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import get_args

import yaml
from pydantic import BaseModel, ValidationError

Place = tuple[int | str, ...]
"""The way to an entry, as pydantic names it."""


def explain(path: Path, text: str, error: ValidationError, model: type[BaseModel]) -> str:
    """The first error in `text`, which `path` contains and `model` refused, as one line."""
    first = error.errors()[0]
    place = first["loc"]
    entry = ".".join(str(part) for part in place) or "the file"
    where = f"{path}, line {_line(text, place)}: {entry}"
    if first["type"] != "extra_forbidden":
        return f"{where}: {first['msg']}, got {first['input']!r}; change it"
    known = ", ".join(_section(model, place[:-1]).model_fields)
    return f"{where}: there is no such entry; take it out, or give one of {known}"


def _line(text: str, place: Place) -> int:
    """Where an entry stands, from 1; of one that is missing, where it should be."""
    node = yaml.compose(text)
    line = 1
    for part in place:
        if isinstance(node, yaml.MappingNode):
            found = [(key, value) for key, value in node.value if key.value == str(part)]
            if not found:
                break
            key, node = found[0]
            line = key.start_mark.line + 1
        elif isinstance(node, yaml.SequenceNode) and isinstance(part, int) and part < len(node.value):
            node = node.value[part]
            line = node.start_mark.line + 1
    return line


def _section(model: type[BaseModel], place: Place) -> type[BaseModel]:
    for part in place:
        kinds = model.model_fields[str(part)].annotation if part in model.model_fields else None
        for kind in (kinds, *get_args(kinds)):
            if inspect.isclass(kind) and issubclass(kind, BaseModel):
                model = kind
    return model
