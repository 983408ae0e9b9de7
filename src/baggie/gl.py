"""Finds a way to render off screen before MuJoCo looks for one."""

from __future__ import annotations

import os
import sys

from baggie.errors import BaggieError
from baggie.system_libraries import RENDERING, missing_for_rendering, remedy, rendering_backend

_NONE = "disable"  # MuJoCo's word

_opened_by: int | None = None
"""The process that has opened OpenGL: this one, or the one that it was forked from."""


def choose_backend() -> None:
    """Set `MUJOCO_GL` to a way to render whose libraries are there; of those it knows, if the user has chosen one.

    MuJoCo reads it when it is first imported, so this runs when `baggie.sim` is. Where there is no way MuJoCo is told
    so: it can then be imported all the same, and what draws no pictures works.
    """
    chosen = os.environ.get("MUJOCO_GL", "").lower()
    if sys.platform != "linux" or (chosen and chosen not in RENDERING):
        return
    backend = rendering_backend([chosen] if chosen else RENDERING)
    os.environ["MUJOCO_GL"] = backend or _NONE
    if backend:
        os.environ["PYOPENGL_PLATFORM"] = backend


def require_backend() -> None:
    """Raise `BaggieError` when nothing can render off screen."""
    if needs := missing_for_rendering():
        names = ", ".join(need.name for need in needs)
        raise BaggieError(f"rendering off screen needs {names}, not on this machine: {remedy(needs)}")
    if os.environ.get("MUJOCO_GL") == _NONE:
        raise BaggieError(
            f"MUJOCO_GL={_NONE} forbids to draw pictures; unset it, or say {' or '.join(RENDERING)}"
        )


def claim() -> None:
    """Say that this process is about to open OpenGL. Raises `BaggieError` in a copy of one that has opened it.

    A fork copies no threads, OpenGL's neither: it would wait for them for ever.
    """
    global _opened_by  # noqa: PLW0603 -- a fact about the process
    if _opened_by not in {None, os.getpid()}:
        raise BaggieError(
            "expected a process of its own to render in, got a fork of one that has rendered before, in which OpenGL "
            'never answers; start workers with context="spawn", or before the first picture is taken'
        )
    _opened_by = os.getpid()
