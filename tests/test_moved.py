"""What documents once told people to import still works."""

import importlib
import sys

import pytest

from baggie.moved import MOVED, RENAMED


@pytest.mark.parametrize("old", MOVED)
def test_an_old_name_is_the_new_module_and_says_so(old: str) -> None:
    sys.modules.pop(old, None)
    with pytest.warns(FutureWarning, match=f"{old} is now {MOVED[old]}"):
        module = importlib.import_module(old)
    assert module is importlib.import_module(MOVED[old])
    assert module.__spec__ is not None
    assert module.__spec__.name == MOVED[old]


@pytest.mark.parametrize(
    ("module", "old", "now"), [(module, *names) for module in RENAMED for names in RENAMED[module].items()]
)
def test_an_old_name_in_a_module_is_the_new_one_and_says_so(module: str, old: str, now: str) -> None:
    with pytest.warns(FutureWarning, match=f"{module}.{old} is now {module}.{now}"):
        found = getattr(importlib.import_module(module), old)
    assert found is getattr(importlib.import_module(module), now)
    with pytest.raises(AttributeError, match="no attribute 'never_there'"):
        importlib.import_module(module).never_there  # noqa: B018
