"""`baggie workcell <what>`: the file that describes a workcell."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, subcommand

from baggie.cli_output import show
from baggie.commissioning.new_workcell import NewWorkcellOptions, new_workcell
from baggie.commissioning.shown_workcell import shown_workcell


def new(options: NewWorkcellOptions, json: bool = False) -> None:
    """Write a workcell file, from what you answer to a few questions.

    Example: baggie workcell new cell.yaml

    Args:
        options: Where to.
        json: Print where it is as one JSON object.
    """
    show(new_workcell(options), json)


def show_file(file: Positional[Path], json: bool = False) -> None:
    """Everything a workcell file says, and what follows from that or is left to the defaults.

    Example: baggie workcell show cell.yaml

    Args:
        file: The workcell file.
        json: Print it as one JSON object.
    """
    show(shown_workcell(file), json)


What = (
    Annotated[Any, subcommand(name="new", constructor=new)]
    | Annotated[Any, subcommand(name="show", constructor=show_file)]
)


def workcell(what: What) -> None:
    """Write down a workcell, or show what is written.

    Example: baggie workcell new cell.yaml
    """
