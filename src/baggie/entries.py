"""Types of entries of a person's YAML file, and what is wrong with one: the line, the entry, what may stand there."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, is_dataclass
from pathlib import Path
from typing import Annotated, Any, get_args

import yaml
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    GetCoreSchemaHandler,
    ValidationError,
)
from pydantic_core import CoreSchema, PydanticKnownError, core_schema

from baggie.errors import BaggieError
from baggie.files import compose_yaml, parse_yaml
from baggie.registry import Registry

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


@dataclass(frozen=True)
class OfKind:
    """Reads a section by the model that is registered for its `kind`, and is imported only then."""

    registry: Registry[type[Any]]
    in_full: Callable[[Any], Any]
    """Makes a section of what was written for short."""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """What pydantic asks for."""
        schema = core_schema.no_info_plain_validator_function(self._read)
        return core_schema.nullable_schema(schema) if type(None) in get_args(source) else schema

    def model_of(self, written: object) -> type[BaseModel]:
        """The model of a section. Raises `PydanticKnownError` for what is none, or of no kind that there is."""
        section = self.in_full(written)
        if isinstance(section, BaseModel):
            return type(section)
        if not isinstance(section, Mapping):
            raise PydanticKnownError("model_attributes_type")
        if "kind" not in section:
            raise PydanticKnownError("union_tag_not_found", {"discriminator": "'kind'"})
        kind = str(section["kind"])
        try:
            model: type[BaseModel] = self.registry[kind]
        except BaggieError:
            known = ", ".join(map(repr, self.registry.names()))
            raise PydanticKnownError(
                "union_tag_invalid", {"discriminator": "'kind'", "tag": kind, "expected_tags": known}
            ) from None
        return model

    def _read(self, written: object) -> BaseModel:
        return self.model_of(written).model_validate(self.in_full(written))


Place = tuple[int | str, ...]
"""The way to an entry, as pydantic names it."""


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
        known = ", ".join(_entries(_section(model, first["loc"][:-1], parse_yaml(text, path))))
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
        if entry is not None or position == len(place) - 1:
            names.append(str(part))
    return line, ".".join(names) or "the file", node


def _section(model: type, place: Place, written: Any) -> type:
    """The model of the section at a place in what was `written`; a dataclass, perhaps."""
    for part in place:
        written = written[part]
        if isinstance(part, int):
            continue  # an entry of a list: its model was found with the list
        field = model.model_fields[part]  # type: ignore[attr-defined]
        of_kind = next((each for each in field.metadata if isinstance(each, OfKind)), None)
        model = of_kind.model_of(written) if of_kind else _models(field.annotation)[0]
    return model


def _entries(model: type) -> list[str]:
    return [*model.model_fields] if issubclass(model, BaseModel) else [*inspect.signature(model).parameters]


def _models(annotation: object) -> list[type]:
    """All models in an annotation, however deep in alternatives."""
    if inspect.isclass(annotation) and (issubclass(annotation, BaseModel) or is_dataclass(annotation)):
        return [annotation]
    return [model for part in get_args(annotation) for model in _models(part)]
