"""What `gymnasium.make` knows of Baggie. Gymnasium takes its time to import, so it is told once somebody imports it."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType

from baggie.registry import TASKS


def register_environments() -> None:
    """Let Gymnasium make our environments: at once where it is imported already, else as soon as it is."""
    if "gymnasium" in sys.modules:
        _register(sys.modules["gymnasium"])
    else:
        sys.meta_path.insert(0, _Gymnasium())


def _register(gymnasium: ModuleType) -> None:
    for task in TASKS.names():
        gymnasium.register(id_of(task), entry_point="baggie.envs:TaskEnv", kwargs={"task": task})


def id_of(task: str) -> str:
    """What Gymnasium calls a task: `baggie/BagPlace-v0` for `bag-place`."""
    return f"baggie/{''.join(word.capitalize() for word in task.split('-'))}-v0"


class _Gymnasium(MetaPathFinder):
    """Finds Gymnasium as the other finders do, and has it told when it has been run."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname != "gymnasium":
            return None
        others = (each for each in sys.meta_path if each is not self)
        found = (each.find_spec(fullname, path, target) for each in others)
        spec = next((each for each in found if each is not None), None)
        if spec is None or spec.loader is None:
            return spec
        run = spec.loader.exec_module

        def run_and_register(module: ModuleType) -> None:
            run(module)
            _register(module)

        spec.loader.exec_module = run_and_register  # type: ignore[method-assign]  # of this one loader
        return spec
