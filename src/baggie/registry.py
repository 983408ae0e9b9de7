"""What there is by name, ours and that of other installed packages; each is imported when it is first asked for.

A package adds to a group by an entry point: in its pyproject.toml, `[project.entry-points."baggie.policies"]` and below
it `mine = "my_package.module:MyPolicy"`. An arm or a camera of one's own may be
named by its module.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import sys
import warnings
from collections.abc import Mapping
from functools import cached_property
from importlib.abc import InspectLoader
from importlib.machinery import PathFinder
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from baggie.errors import BaggieError, BaggieWarning, in_a_line

if TYPE_CHECKING:
    from baggie.cameras.camera import CameraEntry
    from baggie.robot.arm import ArmEntry
    from baggie.tasks.task import Task

T = TypeVar("T")


def named(name: str) -> Any:
    """The object of a dotted name, `module:attribute`, imported. Raises `ImportError` or `AttributeError`."""
    return pkgutil.resolve_name(name)


def made_by(factory: str, options: Mapping[str, Any], folder: Path, what: str) -> Any:
    """What the function or class `module:name` makes of options; `what` it is called in an error, such as `arm`.

    The module is looked for where Python looks, then in `folder`. Raises `BaggieError` when it cannot be imported or
    does not take these options; whatever the factory itself raises is passed on.
    """
    module_name, _, name = factory.partition(":")
    if str(folder.resolve()) not in sys.path:
        sys.path.append(str(folder.resolve()))
    try:
        module = importlib.import_module(module_name)
    except Exception as error:
        raise BaggieError(
            f"the {what}'s factory {factory!r} cannot be imported ({in_a_line(error)}); expected module:function, the "
            f"module installed here or in {folder.resolve()}"
        ) from error
    make = getattr(module, name, None)
    if not callable(make):
        raise BaggieError(
            f"the module {module_name} has no function or class {name!r}; give the {what}'s factory"
        )
    try:
        inspect.signature(make).bind(**options)
    except TypeError as error:
        raise BaggieError(
            f"{factory} takes {inspect.signature(make)}, not {', '.join(options) or 'nothing'} ({error}); "
            f"change the options below `{what}`"
        ) from None
    return make(**options)


def lacking(device: object, protocol: type) -> str:
    """What of a protocol it has not, in words; nothing where it has all."""
    names = [*protocol.__annotations__, *(name for name in vars(protocol) if name[0] != "_")]
    missing = [name for name in names if not hasattr(device, name)]
    return f"lacks {', '.join(missing)}" if missing else ""


class Registry(Generic[T]):
    """Objects by name: `own` ones, `module:attribute` each, and those of a group of entry points."""

    def __init__(self, group: str, own: Mapping[str, str], noun: str) -> None:
        """`noun`: what one of them is called in an error, such as `policy`."""
        self.group = group
        self._own = own
        self._noun = noun
        self._found: dict[str, T] = {}

    def names(self) -> list[str]:
        """All there are, ours first; nothing is imported for it. Warns, once, of a name taken twice."""
        return [*self._own, *self._others]

    def __contains__(self, name: object) -> bool:
        return name in self._own or name in self._others

    def __getitem__(self, name: str) -> T:
        """The object of this name, imported. Raises `BaggieError` where there is none.

        One of another package that cannot be imported is left out from then on, with a warning.
        """
        self._import(name)
        if name not in self._found:
            article = "an" if self._noun[0] in "aeiou" else "a"
            raise BaggieError(
                f"expected {article} {self._noun} among {', '.join(self.names())}, got {name!r}"
            )
        return self._found[name]

    def source_of(self, name: str) -> str:
        """The source of the module that holds it, empty where there is none to be found; nothing is imported."""
        where = self._own[name] if name in self._own else self._others[name].value
        module, path, source = "", None, ""
        for part in where.partition(":")[0].split("."):
            module = f"{module}.{part}".removeprefix(".")
            found = PathFinder.find_spec(module, path)
            if found is None or not isinstance(found.loader, InspectLoader):
                return ""
            source, path = found.loader.get_source(module) or "", found.submodule_search_locations
        return source

    def all(self) -> dict[str, T]:
        """All that can be imported, by name."""
        for name in self.names():
            self._import(name)
        return {name: self._found[name] for name in self.names()}

    def _import(self, name: str) -> None:
        """Keep the object of this name, if there is one; another package's may be left out."""
        if name in self._found:
            return
        if name in self._own:
            self._found[name] = named(self._own[name])
        elif name in self._others:
            self._import_other(name, self._others[name])

    def _import_other(self, name: str, point: EntryPoint) -> None:
        try:
            self._found[name] = point.load()
        except Exception as error:  # whatever somebody else's module may raise
            del self._others[name]
            why = " ".join(str(error).split()) or type(error).__name__
            warnings.warn(
                f"the {self._noun} {name!r} of {_whose(point)} is left out: {point.value} cannot be imported ({why})",
                BaggieWarning,
                stacklevel=4,
            )

    @cached_property
    def _others(self) -> dict[str, EntryPoint]:
        others: dict[str, EntryPoint] = {}
        for point in entry_points(group=self.group):
            if point.name in self._own or point.name in others:
                kept = "Baggie's" if point.name in self._own else f"that of {_whose(others[point.name])}"
                warnings.warn(
                    f"the {self._noun} {point.name!r} of {_whose(point)} is left out: {kept} goes by that name",
                    BaggieWarning,
                    stacklevel=4,
                )
            else:
                others[point.name] = point
        return others


def _whose(point: EntryPoint) -> str:
    return point.dist.name if point.dist is not None else point.value


TASKS: Registry[Task] = Registry(
    "baggie.tasks",
    {
        "bag-place": "baggie.tasks.bag_place:BAG_PLACE",
        "bag-stack": "baggie.tasks.bag_stacks:BAG_STACK",
        "bag-tower": "baggie.tasks.bag_stacks:BAG_TOWER",
        "bag-pyramid": "baggie.tasks.bag_stacks:BAG_PYRAMID",
        "bag-layers": "baggie.tasks.bag_stacks:BAG_LAYERS",
        "bag-unstack": "baggie.tasks.bag_stacks:BAG_UNSTACK",
        "block-pyramid": "baggie.tasks.block_pyramid:BLOCK_PYRAMID",
        "place-red-in-green": "baggie.tasks.place_red_in_green:PLACE_RED_IN_GREEN",
        "align-box-corner": "baggie.tasks.align_box_corner:ALIGN_BOX_CORNER",
        "block-insertion": "baggie.tasks.block_insertion:BLOCK_INSERTION",
    },
    "task",
)
"""What has to be done: a new one is a file and a line here, or an entry point of another package."""

ARMS: Registry[type[ArmEntry]] = Registry(
    "baggie.arms",
    {
        "sim": "baggie.workcell.workcell_file:SimulatedEntry",
        "replay": "baggie.workcell.workcell_file:ReplayEntry",
        "franka": "baggie.robot.franka:FrankaEntry",
        "lerobot": "baggie.robot.lerobot:LeRobotEntry",
        "python": "baggie.robot.arm:PythonArmEntry",
    },
    "arm",
)
"""What a workcell file says of an arm, by the `kind` that it gives there."""

CAMERAS: Registry[type[CameraEntry]] = Registry(
    "baggie.cameras",
    {
        "sim": "baggie.workcell.workcell_file:SimulatedCameraEntry",
        "opencv": "baggie.cameras:OpenCVSettings",
        "realsense": "baggie.cameras:RealSenseSettings",
        "orbbec": "baggie.cameras:OrbbecSettings",
        "k4a": "baggie.cameras:AzureKinectSettings",
        "python": "baggie.cameras:PythonCameraEntry",
    },
    "camera",
)
"""What a workcell file says of a camera, likewise."""
