"""Finds an off-screen OpenGL library before MuJoCo looks for one."""

from __future__ import annotations

import ctypes.util
import os

from baggie.errors import BaggieError

_LIBRARIES = {"egl": "EGL", "osmesa": "OSMesa"}

_opened_by: int | None = None
"""The process that has opened OpenGL: this one, or the one that it was forked from."""


def choose_backend() -> None:
    """Set `MUJOCO_GL` to a backend whose library is there, unless the user has chosen one.

    MuJoCo reads it when it is first imported, so this runs when `baggie.sim` is.
    """
    if not os.environ.get("MUJOCO_GL"):
        for backend, library in _LIBRARIES.items():
            if ctypes.util.find_library(library):
                os.environ["MUJOCO_GL"] = os.environ["PYOPENGL_PLATFORM"] = backend
                return


def require_backend() -> None:
    """Raise `BaggieError` when nothing can render off screen."""
    chosen = os.environ.get("MUJOCO_GL", "")
    wanted = {chosen: _LIBRARIES[chosen]} if chosen in _LIBRARIES else _LIBRARIES
    if not any(ctypes.util.find_library(library) for library in wanted.values()):
        names = " or ".join(f"lib{library}" for library in wanted.values())
        raise BaggieError(
            f"rendering off screen needs {names}, and it is not on this machine; install one with: "
            "apt-get install libegl1 libgl1-mesa-dri (or libosmesa6)"
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
