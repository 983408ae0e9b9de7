"""The terminal: whether a person is at it, and what that person answers."""

from __future__ import annotations

import os
import sys

from rich.console import Console


def is_attended() -> bool:
    """Whether somebody can answer: standard input is a terminal, and this process is not in its background."""
    if sys.stdin is None or not sys.stdin.isatty():
        return False
    try:
        return os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except (AttributeError, OSError):  # Windows; a terminal that controls another session
        return True


def ask(console: Console, question: str) -> str:
    """What is typed in answer to a question, up to Enter. Raises `EOFError` at the end of input."""
    console.print("[bold]→[/]", end=" ")
    return console.input(f"{question} ", markup=False).strip()
