"""Types of entries of a person's YAML file, and what is wrong with one: the line, the entry, what may stand there."""

from __future__ import annotations

import inspect
import re
from dataclasses import is_dataclass
from pathlib import Path
from typing import Annotated, Any, get_args

import yaml
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, ValidationError

from baggie.files import compose_yaml

_FAR_M = 5.0
"""No table is so far from its robot, and no arm so long."""


class Section(BaseModel):
    """A section of the file: entries that are not known are refused, and so are numbers that are not finite."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def _in_digits(entry: Any) -> Any:
    """Whole numbers as they were written; of others, 1.10 say, nobody knows that any more."""
    return str(entry) if isinstance(entry, int) and not isinstance(entry, bool) else entry


def _near(metres: float) -> float:
    if not abs(metres) <= _FAR_M:
        raise ValueError(
            f"expected metres, at most {_FAR_M:g}, got {metres:g}; of millimetres, write a thousandth"
        )
    return metres


Words = Annotated[str, BeforeValidator(_in_digits)]
"""Text, perhaps of digits alone: a serial number, a name."""
Metres = Annotated[float, AfterValidator(_near)]


Place = tuple[int | str, ...]
"""The way to an entry, as pydantic names it: the kind of a section that comes in several is a part of it."""


def explain(path: Path, text: str, error: ValidationError, model: type[BaseModel]) -> str:
    """The first error in `text`, which `path` contains and `model` refused, as one line."""
    first = error.errors()[0]
    wrong = first["msg"].removeprefix("Value error, ")
    if not first["loc"] and (
        said := re.match(r"(\w+)\.(\w+) is ", wrong)
    ):  # entries that contradict each other
        return f"{path}, line {_find(text, said.groups())[0]}: {wrong}"
    of_no_kind = first["type"] == "union_tag_invalid"
    line, entry, node = _find(text, (*first["loc"], "kind") if of_no_kind else first["loc"])
    where = f"{path}, line {line}: {entry}"
    if of_no_kind:
        known, came = first["ctx"]["expected_tags"], first["ctx"]["tag"]
        return f"{where}: expected one of {known}, got {came!r}; change it"
    if first["type"] in {"extra_forbidden", "unexpected_keyword_argument"}:
        known = ", ".join(_entries(_section(model, first["loc"][:-1])))
        return f"{where}: there is no such entry; take it out, or give one of {known}"
    if first["type"] in {"missing", "value_error"}:  # what came is the whole section
        return f"{where}: {wrong}"
    came = first["input"]
    if not isinstance(came, str) and isinstance(node, yaml.ScalarNode):
        came = node.value  # as it was written
        return f"{where}: {wrong}, got {came}; {'put it in quotes' if first['type'] == 'string_type' else 'change it'}"
    return f"{where}: {wrong}, got {came!r}; change it"


def _find(text: str, place: Place) -> tuple[int, str, yaml.Node | None]:
    """Where an entry stands, from line 1, its name and its node; of one that is missing, where it should be."""
    node = compose_yaml(text)
    line, names = 1, []
    for position, part in enumerate(place):
        entry = None
        if isinstance(node, yaml.MappingNode):
            entry = next(((key, value) for key, value in node.value if key.value == str(part)), None)
        elif isinstance(node, yaml.SequenceNode) and isinstance(part, int) and part < len(node.value):
            entry = node.value[part], node.value[part]
        if entry is not None:
            line, node = entry[0].start_mark.line + 1, entry[1]
        if entry is not None or (position == len(place) - 1 and not _is_kind(node, part)):
            names.append(str(part))
    return line, ".".join(names) or "the file", node


def _is_kind(node: yaml.Node | None, part: int | str) -> bool:
    """Whether this part of a place is no entry of the section but its kind."""
    entries = node.value if isinstance(node, yaml.MappingNode) else []
    return any(key.value == "kind" and value.value == part for key, value in entries)


def _section(model: type, place: Place) -> type:
    """The model of the section at a place; a dataclass, perhaps."""
    kinds = [model]
    for part in place:
        if isinstance(part, int):
            continue  # an entry of a list: its models were found with the list
        of_kind = [each for each in kinds if str(part) in get_args(_annotation(each, "kind"))]
        kinds = of_kind or [found for each in kinds for found in _models(_annotation(each, str(part)))]
    return kinds[0]


def _entries(model: type) -> list[str]:
    return [*model.model_fields] if issubclass(model, BaseModel) else [*inspect.signature(model).parameters]


def _annotation(model: type, field: str) -> object:
    known = model.model_fields if issubclass(model, BaseModel) else {}
    return known[field].annotation if field in known else None


def _models(annotation: object) -> list[type]:
    """All models in an annotation, however deep in alternatives."""
    if inspect.isclass(annotation) and (issubclass(annotation, BaseModel) or is_dataclass(annotation)):
        return [annotation]
    return [model for part in get_args(annotation) for model in _models(part)]
