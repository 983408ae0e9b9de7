"""Errors a user can act on: each says what was expected, what came, and what to do next.

A package that cannot be imported is explained, with the command that installs what only some users need, true for
whoever has Baggie from a checkout or a wheel.
"""

from __future__ import annotations

import shlex
import sys
from importlib.metadata import PackageNotFoundError, requires
from pathlib import Path

from baggie.system_libraries import providers, remedy


class BaggieError(Exception):
    """Something could not be done; the message is one line fit for `error: ...` on a terminal."""


class UsageError(BaggieError):
    """What was asked is out of range, or does not go together; nothing was begun."""


class LimitError(BaggieError):
    """A motion would have left the workcell's limits; nothing was sent to the arm."""


class ReachError(BaggieError):
    """The arm cannot reach a pose, or did not get there."""


class ArmError(BaggieError):
    """The arm does not do what it is told: not found, link lost, stopped, or in an error that needs a person."""


class StuckError(ArmError):
    """An arm that only a person can, or may, set going again: nothing tries it any further by itself."""


class CameraError(BaggieError):
    """The camera gave no (fresh) picture."""


class DataError(BaggieError):
    """A file of a recording or a checkpoint is missing, cut off, or of another kind than asked for."""


class WriteError(DataError):
    """A file cannot be written: the disk is full, or it may only be read."""


class CalibrationError(BaggieError):
    """A calibration that cannot be trusted, or is of another camera; nothing was saved or used."""


class BumpedError(BaggieError):
    """The camera or the table is no longer where it was when the workcell was calibrated."""


class UnsureError(BaggieError):
    """A plan is less sure than the workcell asks for; nothing has moved."""


class NobodyError(BaggieError):
    """A person has to answer, and nobody is there."""


class BaggieWarning(UserWarning):
    """Something a user should know that stops nothing; the message is one line fit for `warning: ...` on a terminal."""


_RUINED_MUJOCO = (
    "MuJoCo here is not whole, as pip leaves it when version 4 replaces a version 3. Give Baggie an environment of "
    "its own (python3 -m venv), or repair this one: pip install --force-reinstall --no-deps mujoco mujoco-core "
    "mujoco-studio (what needs MuJoCo 3 there, such as robosuite 1.5.2, stops working then)"
)


def in_a_line(error: Exception) -> str:
    """Kind and words of an error that somebody else's code raised, on one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"


def explained(error: ImportError) -> BaggieError | None:
    """One line on a library of the system that is missing, or on MuJoCo without its core; None for anything else."""
    text = str(error)
    if needs := list(providers(text)):
        names = ", ".join(need.name for need in needs)
        return BaggieError(f"{names} is not on this machine: {remedy(needs)}")
    if "mujoco" in text.lower() or (error.name or "").startswith("mujoco"):
        return BaggieError(_RUINED_MUJOCO)
    return None


_CHECKOUT = Path(__file__).parents[2]


def pip_install(*words: str) -> str:
    """The command that installs into this environment, whether or not it is the shell's."""
    return shlex.join([sys.executable, "-m", "pip", "install", *words])


def install_extra(extra: str) -> str:
    """The command that installs what an extra of Baggie's, such as `franka`, asks for."""
    try:
        wanted = [requirement.partition(";") for requirement in requires("baggie") or ()]
    except PackageNotFoundError:  # its source is on the path, and nothing is installed
        return pip_install(f"{_CHECKOUT}[{extra}]")
    return pip_install(*(package for package, _, when in wanted if f'extra == "{extra}"' in when))
