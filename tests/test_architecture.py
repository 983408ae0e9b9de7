"""The arrows between rooms and files run one way, as docs/architecture.md draws them."""

import ast
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import baggie

ROOT = Path(baggie.__file__).parent
ROOMS = [
    *(
        "moved",
        "system_libraries",
        "errors",
        "registry",
        "gymnasium_ids",
        "options",
        "gl",
        "files",
        "entries",
        "geometry",
        "pictures",
        "types",
        "metrics",
    ),
    *("results", "operator", "processes", "seeds"),
    *(
        "vision",
        "calibration",
        "cameras",
        "robot",
        "sim",
        "tasks",
        "data",
        "policies",
        "workcell",
        "ravens",
        "lab",
    ),
    *("commissioning", "collect", "learning", "evaluation", "report", "envs", "cli", "__main__"),
]
"""From the ground up: a room knows those before it."""


def modules() -> dict[str, Path]:
    """Every module's file, by its name."""
    files = sorted(ROOT.rglob("*.py"))
    return {
        ".".join(("baggie", *f.relative_to(ROOT).with_suffix("").parts)).removesuffix(".__init__"): f
        for f in files
    }


def imports_of(tree: ast.AST) -> Iterator[ast.Import | ast.ImportFrom]:
    """All that a module imports, at its top or later, but for what only a type checker sees."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.Import | ast.ImportFrom):
            yield node
        elif not (isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test)):
            yield from imports_of(node)


def imported(source: str, known: set[str]) -> set[str]:
    """Which of the known modules a source imports, however it is written."""
    found = set()
    for node in imports_of(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        else:
            assert not node.level, "imports are absolute here"
            inside = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= inside & known
            if inside - known:  # names of the module itself
                found.add(node.module or "")
    return found & known


def arrows() -> dict[str, set[str]]:
    """What each module imports."""
    known = set(modules())
    return {name: imported(path.read_text(), known) - {name} for name, path in modules().items()}


def room_of(module: str) -> str:
    return module.split(".")[1] if "." in module else "baggie"


def test_every_room_is_in_its_place() -> None:
    assert {room_of(module) for module in modules()} - {"baggie"} == set(ROOMS)


def test_a_room_knows_only_those_below_it() -> None:
    height = {room: number for number, room in enumerate(ROOMS)}
    upward = [
        f"{module} imports {other}"
        for module, others in arrows().items()
        for other in others
        if module != "baggie" and (other == "baggie" or height[room_of(other)] > height[room_of(module)])
    ]
    assert not upward


def test_only_an_operator_speaks_to_a_person_and_the_command_prints_what_comes_back() -> None:
    speaking = {
        module
        for module, path in modules().items()
        for node in imports_of(ast.parse(path.read_text()))
        if {"rich.console", "rich.progress", "rich.status"}
        & {*(alias.name for alias in node.names), getattr(node, "module", None)}
    }
    assert {room_of(module) for module in speaking} <= {"operator", "cli"}


def test_no_files_import_each_other_in_a_circle() -> None:
    try:
        TopologicalSorter(arrows()).prepare()
    except CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("import baggie.b", {"baggie.b"}),
        ("from baggie import b", {"baggie.b"}),
        ("from baggie.b import name", {"baggie.b"}),
        ("from baggie import b, name", {"baggie", "baggie.b"}),
        ("def f():\n    from baggie.b import name", {"baggie.b"}),
        ("if TYPE_CHECKING:\n    import baggie.b", set()),
    ],
)
def test_no_import_goes_unseen(source: str, expected: set[str]) -> None:
    assert imported(source, {"baggie", "baggie.b"}) == expected


def test_no_test_is_imported() -> None:
    """What tests share is in helpers/."""
    files = sorted(Path(__file__).parent.rglob("*.py"))
    tests = {path.stem for path in files if path.stem.startswith("test_")}
    assert not [f"{path} imports {test}" for path in files for test in imported(path.read_text(), tests)]


def test_files_and_folders_are_of_a_size_to_be_read() -> None:
    files = list(modules().values())
    assert len(files) <= 200
    assert not [path for path in files if len(path.read_text().splitlines()) > 400]
    folders = {path.parent for path in files}
    assert not [folder for folder in folders if len(list(folder.glob("*.py"))) > 20]


def test_mujoco_is_told_how_to_render_before_it_is_imported() -> None:
    """Python runs a package's own file before any module in it."""
    untold = [
        module
        for module, path in modules().items()
        if any(line.startswith(("import mujoco", "import mink")) for line in path.read_text().splitlines())
        and "choose_backend()" not in (ROOT / room_of(module) / "__init__.py").read_text()
    ]
    assert not untold
