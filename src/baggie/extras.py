"""What only some users need: the command that installs it, true for whoever has Baggie from a checkout or a wheel."""

from __future__ import annotations

import shlex
import sys
from importlib.metadata import PackageNotFoundError, requires
from pathlib import Path

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
