"""What entries of a person's file may be."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict

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
