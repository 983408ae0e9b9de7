"""Old names that documents once told people to import: they work for one more version, with a warning."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

MOVED = {
    "baggie.cameras.opening": "baggie.cameras",
    "baggie.data.ravens_agent": "baggie.ravens.adapters",
    "baggie.evaluation.metrics": "baggie.metrics",
    "baggie.evaluation.results": "baggie.results",
    "baggie.grid": "baggie.geometry",
    "baggie.lab.control": "baggie.lab.web",
    "baggie.policies.color_mask": "baggie.policies.baselines",
    "baggie.policies.contract": "baggie.policies.base",
    "baggie.policies.oracle": "baggie.policies.baselines",
    "baggie.policies.regression.policy": "baggie.policies.regression",
    "baggie.ravens.agent": "baggie.ravens.adapters",
    "baggie.ravens.convert": "baggie.ravens.adapters",
    "baggie.robot.python_devices": "baggie.robot.arm",
    "baggie.sim.arm_model": "baggie.robot.kinematics",
    "baggie.sim.blocks": "baggie.sim.objects",
    "baggie.sim.kinematics": "baggie.robot.kinematics",
    "baggie.tasks.scoring": "baggie.tasks.conditions",
    "baggie.vision.picture_files": "baggie.pictures",
    "baggie.workcell.arm": "baggie.robot.arm",
    "baggie.workcell.arm_contract": "baggie.robot.contract",
    "baggie.workcell.camera": "baggie.cameras.camera",
    "baggie.workcell.camera_contract": "baggie.cameras.camera",
    "baggie.workcell.cameras": "baggie.cameras",
    "baggie.workcell.cameras.opening": "baggie.cameras",
    "baggie.workcell.cameras.settings": "baggie.cameras.camera",
    "baggie.workcell.handling_rules": "baggie.robot.handling_rules",
    "baggie.workcell.limits": "baggie.robot.limits",
    "baggie.workcell.real": "baggie.workcell.config",
}

RENAMED = {"baggie.types": {"marked": "require_goal", "seen": "require_observation"}}
"""Names in modules."""


def renamed(module: str, name: str) -> Any:
    """Give what is meant by an old name in a module, as its `__getattr__` has to."""
    if (now := RENAMED[module].get(name)) is None:
        raise AttributeError(f"module {module!r} has no attribute {name!r}")
    _warn(f"{module}.{name}", f"{module}.{now}")
    return getattr(import_module(module), now)


def _warn(old: str, now: str) -> None:
    warnings.warn(f"{old} is now {now}; the old name ends with this version", FutureWarning, stacklevel=3)


class _OldName(Loader):
    """Gives the module that is meant by an old name."""

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        now = MOVED[spec.name]
        _warn(spec.name, now)
        module = import_module(now)
        self._spec = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        module.__spec__ = self._spec  # Python has set the old name's


class _OldNames(MetaPathFinder):
    """Finds the modules of `MOVED`."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        return ModuleSpec(fullname, _OldName()) if fullname in MOVED else None


def keep_old_names() -> None:
    """Let old names be imported."""
    sys.meta_path.insert(0, _OldNames())  # before what an earlier version may have left of its folders
