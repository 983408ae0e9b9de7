"""The arrows between rooms run one way, as docs/architecture.md draws them."""

import ast
from pathlib import Path

import baggie

ROOT = Path(baggie.__file__).parent
FLOORS = [
    {
        "errors",
        "extras",
        "files",
        "geometry",
        "grid",
        "import_errors",
        "pictures",
        "processes",
        "progress",
        "ranges",
        "seeds",
        "system_libraries",
        "terminal",
        "text_files",
        "types",
    },
    {"vision", "calibration", "sim"},
    {"policies", "data", "workcell"},
    {"collect", "commissioning", "lab", "learning", "evaluation"},
    {"cli", "cli_calibrate", "cli_output", "cli_workcell", "envs", "__main__", "__init__"},
]
FLOOR_OF = {room: floor for floor, rooms in enumerate(FLOORS) for room in rooms}


def room_of(path: Path) -> str:
    return path.relative_to(ROOT).parts[0].removesuffix(".py")


def imported_rooms(path: Path) -> set[str]:
    names = [
        node.module for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.ImportFrom)
    ]
    return {name.split(".")[1] for name in names if name and name.startswith("baggie.")}


def test_every_room_has_a_floor() -> None:
    assert {room_of(path) for path in ROOT.rglob("*.py")} == set(FLOOR_OF)


def test_no_file_imports_from_a_floor_above() -> None:
    upward = [
        f"{path.relative_to(ROOT)} imports {room}"
        for path in ROOT.rglob("*.py")
        for room in imported_rooms(path)
        if FLOOR_OF[room] > FLOOR_OF[room_of(path)]
    ]
    assert not upward
