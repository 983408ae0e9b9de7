"""An arm of one's own, found by its dotted name."""

from __future__ import annotations

import importlib
import inspect
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from baggie.errors import BaggieError
from baggie.workcell.arm import Arm, ArmInfo


def open_python_arm(factory: str, options: Mapping[str, Any], folder: Path) -> Arm:
    """What `factory` makes of `options`: `"my_lab.my_arm:open_arm"`, a function or class in a module.

    The module is looked for where Python looks, then in `folder`. Raises `BaggieError` when it cannot be imported, does
    not take these options, or makes no `Arm`; whatever the factory itself raises is passed on.
    """
    module_name, _, name = factory.partition(":")
    if str(folder.resolve()) not in sys.path:
        sys.path.append(str(folder.resolve()))
    try:
        module = importlib.import_module(module_name)
    except Exception as error:
        reason = f"{type(error).__name__}: {' '.join(str(error).split())}"
        raise BaggieError(
            f"the arm's factory {factory!r} cannot be imported ({reason}); expected module:function, the "
            f"module installed here or in {folder.resolve()}"
        ) from error
    make = getattr(module, name, None)
    if not callable(make):
        raise BaggieError(
            f"the module {module_name} has no function or class {name!r}; give the arm's factory"
        )
    try:
        inspect.signature(make).bind(**options)
    except TypeError as error:
        raise BaggieError(
            f"{factory} takes {inspect.signature(make)}, not {', '.join(options) or 'nothing'} ({error}); "
            "change the options below `arm`"
        ) from None
    arm = make(**options)
    if not isinstance(arm, Arm) or not isinstance(arm.info, ArmInfo):
        lacking = [
            name for name in (*Arm.__annotations__, *vars(Arm)) if name[0] != "_" and not hasattr(arm, name)
        ]
        wrong = f"lacks {', '.join(lacking)}" if lacking else "has an `info` that is no ArmInfo"
        raise BaggieError(
            f"{factory} made a {type(arm).__name__}, which is no Arm: it {wrong}; see baggie/workcell/arm.py"
        )
    return arm
