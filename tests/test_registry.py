"""Names of objects, ours and other packages'."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from importlib.metadata import entry_points
from pathlib import Path

import pytest

from baggie.errors import BaggieError, BaggieWarning
from baggie.registry import ARMS, CAMERAS, Registry
from baggie.workcell.workcell_file import read_workcell_file

OWN = {"square": "fractions:Fraction", "round": "decimal:Decimal"}
Install = Callable[..., None]


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """Installs a package with a module's source and entry points by name, for the duration of a test."""
    before = set(sys.modules)

    def made(name: str, source: str, group: str = "baggie.shapes", **points: str) -> None:
        folder = tmp_path / name
        info = folder / f"{name}-1.0.dist-info"
        info.mkdir(parents=True)
        (folder / f"{name}.py").write_text(source)
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
        lines = [f"{point} = {name}:{attribute}" for point, attribute in points.items()]
        (info / "entry_points.txt").write_text("\n".join([f"[{group}]", *lines, ""]))
        monkeypatch.syspath_prepend(folder)

    yield made
    for name in set(sys.modules) - before:
        del sys.modules[name]


def shapes() -> Registry[type]:
    return Registry("baggie.shapes", OWN, "shape")


def test_ours_are_imported_when_they_are_asked_for() -> None:
    from fractions import Fraction

    registry = Registry[type]("baggie.shapes", OWN | {"not-there": "no_such_module:Thing"}, "shape")
    assert registry.names() == ["square", "round", "not-there"]
    assert registry["square"] is registry["square"] is Fraction
    with pytest.raises(ModuleNotFoundError, match="no_such_module"):  # a fault of ours is not hidden
        registry["not-there"]


def test_an_unknown_name_is_one_line_with_the_known_ones() -> None:
    with pytest.raises(BaggieError, match="expected a shape among square, round, got 'oval'") as error:
        shapes()["oval"]
    assert "\n" not in str(error.value)
    assert "oval" not in shapes()
    with pytest.raises(BaggieError, match="expected an oval among round, got 'egg'"):
        Registry[type]("baggie.ovals", {"round": OWN["round"]}, "oval")["egg"]
    assert "round" in shapes()


def test_those_of_other_packages_are_known_and_imported_late(install: Install) -> None:
    install("ovals", "class Oval: pass", oval="Oval")
    registry = shapes()
    assert registry.names() == ["square", "round", "oval"]
    assert "ovals" not in sys.modules
    assert registry["oval"].__module__ == "ovals"


def test_a_source_is_read_and_nothing_is_imported(install: Install) -> None:
    install("ovals", "class Egg: pass\n", oval="Egg")
    (registry := shapes()).names()
    assert registry.source_of("oval") == "class Egg: pass\n"
    assert "class Fraction" in registry.source_of("square")
    assert Registry[type]("baggie.shapes", {"deep": "no.such.module:Thing"}, "shape").source_of("deep") == ""
    assert "ovals" not in sys.modules


@pytest.mark.parametrize(
    ("source", "why"),
    [
        ("import no_such_module", "No module named 'no_such_module'"),
        ("raise RuntimeError('two\\nlines')", "two lines"),
        ("", "has no attribute 'Oval'"),
    ],
)
def test_a_broken_one_is_left_out_with_one_line(install: Install, source: str, why: str) -> None:
    install("ovals", source, oval="Oval")
    registry = shapes()
    with (
        pytest.warns(BaggieWarning, match=f"the shape 'oval' of ovals is left out: .*{why}") as said,
        pytest.raises(BaggieError, match="expected a shape among square, round, got 'oval'"),
    ):
        registry["oval"]
    assert len(said) == 1
    assert "\n" not in str(said[0].message)
    assert registry.names() == ["square", "round"]


def test_of_two_with_one_name_ours_wins_and_it_is_said_once(install: Install) -> None:
    from fractions import Fraction

    install("ovals", "class Oval: pass", square="Oval")
    registry = shapes()
    with pytest.warns(
        BaggieWarning, match="the shape 'square' of ovals is left out: Baggie's goes by"
    ) as said:
        assert registry.names() == registry.names() == ["square", "round"]
    assert len(said) == 1
    assert registry["square"] is Fraction


def test_of_two_other_packages_the_first_wins(install: Install) -> None:
    install("ovals", "class Oval: pass", oval="Oval")
    install("eggs", "class Egg: pass", oval="Egg")
    registry = shapes()
    with pytest.warns(BaggieWarning, match="the shape 'oval' of ovals is left out: that of eggs goes by"):
        assert registry.names() == ["square", "round", "oval"]
    assert registry["oval"].__name__ == "Egg"


@pytest.mark.parametrize("registry", [ARMS, CAMERAS], ids=["arm", "camera"])
def test_a_broken_driver_is_one_warning_and_no_kind_that_a_file_may_name(
    install: Install, registry: Registry[type], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    what = registry.group.removeprefix("baggie.").removesuffix("s")
    install("ovals", "import no_such_module", registry.group, oval="Oval")
    installed = {point.name: point for point in entry_points(group=registry.group)}
    monkeypatch.setitem(vars(registry), "_others", installed)
    path = tmp_path / "cell.yaml"
    path.write_text(f"{what}: {{kind: oval}}\n")
    with (
        pytest.warns(
            BaggieWarning, match=f"the {what} 'oval' of ovals is left out: .*no_such_module"
        ) as said,
        pytest.raises(BaggieError, match=rf"line 1: {what}\.kind: expected one of 'sim', .*, got 'oval'"),
    ):
        read_workcell_file(path)
    assert len(said) == 1
