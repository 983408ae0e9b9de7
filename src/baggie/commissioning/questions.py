"""What may be answered to questions about a workcell."""

from __future__ import annotations

import math
from typing import Any

from pydantic import BaseModel, ValidationError, create_model

from baggie.operator import Answer, Parse
from baggie.workcell.workcell_file import Bounds


def entry(model: type[BaseModel], name: str) -> Parse[Any]:
    """What this entry of a file may be, by the rules of its reader."""
    field = model.model_fields[name]
    assert field.annotation is not None
    alone: type[BaseModel] = create_model("Alone", answer=(field.annotation, field))

    def parse(answer: str) -> Any:
        try:
            return alone.model_validate({"answer": answer}).model_dump(mode="json")["answer"]
        except ValidationError as error:
            raise _in_words(error) from None

    return parse


def _in_words(error: ValidationError) -> ValueError:
    return ValueError(error.errors()[0]["msg"].removeprefix("Value error, "))


def word(answer: str) -> str:
    """Anything without spaces."""
    if len(answer.split()) != 1:
        raise ValueError("expected one word")
    return answer


def number(answer: str) -> float:
    """A finite number."""
    value = float(answer)
    if not math.isfinite(value):
        raise ValueError("expected a finite number")
    return value


def several(parse: Parse[Answer], count: int | None = None) -> Parse[list[Answer]]:
    """So many, or any number of them, apart by spaces or commas."""

    def parse_all(answer: str) -> list[Answer]:
        words = answer.replace(",", " ").split()
        if count is not None and len(words) != count:
            raise ValueError(f"expected {count} of them, apart by spaces")
        return [parse(one) for one in words]

    return parse_all


def bounds(answer: str) -> list[float]:
    """Two numbers, the lower one first: what a workspace's bounds may be."""
    low, high = several(number, 2)(answer)
    try:
        return list(Bounds(x=(low, high)).x)
    except ValidationError as error:
        raise _in_words(error) from None


def color(answer: str) -> list[int]:
    """Red, green, blue of 255."""
    values = several(int, 3)(answer)
    if not all(0 <= value <= 255 for value in values):
        raise ValueError("expected three numbers of 0 to 255")
    return values


def spaced(values: tuple[Any, ...]) -> str:
    """A default of several, as a person would type it."""
    return " ".join(f"{value:g}" if isinstance(value, float) else str(value) for value in values)
