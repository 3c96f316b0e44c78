"""Imports point down only: a room imports from the rooms that stand before it, type-checking imports included."""

import ast
import re
from pathlib import Path

PACKAGE = Path(__file__).parents[2] / "armflex"
TESTS = Path(__file__).parents[1]

ROOMS = (
    *("errors", "arguments", "conventions", "version", "linear_gaussian", "result", "progress", "plugins"),
    *("parallel", "storage", "sampling"),
    *("bundled", "declaration", "plotting"),
    *("robot", "rows", "readings"),
    *("fem", "laws", "laws.effects"),
    "mechanics",
    *("parameters", "arm", "configurations", "files"),
    *("measured", "intake", "trajectory"),
    "estimate",
    *("bench", "plan", "track", "trace"),
    "tasks",
    "export",
    *("show.view", "show.report"),
    "testing",
    "schemas",
    "cli",
    "__main__",
)
"""From the ground up; a module belongs to the longest of these names that it begins with."""

TOP = "armflex"
"""The package itself, which imports everything."""

UPWARD = ("arm->armflex",)
"""Imports that point up today. None may be added; one that is gone must go from here."""


def room_of(module: str) -> str:
    """Return the room of a module, given without the package's name."""
    parts = module.split(".")
    names = (".".join(parts[:count]) for count in range(len(parts), 0, -1))
    return next((name for name in names if name in ROOMS), parts[0])


def imports() -> set[tuple[str, str]]:
    """Return (importing room, imported room) of every import anywhere in the package."""
    found = set()
    for path in PACKAGE.rglob("*.py"):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if parts == ("__init__",) or not isinstance(node, ast.Import | ast.ImportFrom):
                continue
            names = [alias.name for alias in node.names]
            modules = [node.module or ""] if isinstance(node, ast.ImportFrom) else names
            for package, _, module in (module.partition(".") for module in modules):
                if package == "armflex":
                    found.add((room_of(".".join(parts)), room_of(module) if module else TOP))
    return {(room, other) for room, other in found if room != other}


def test_every_room_has_its_place() -> None:
    modules = [path.relative_to(PACKAGE).with_suffix("").parts for path in PACKAGE.rglob("*.py")]
    rooms = {room_of(".".join(parts)) for parts in modules if parts[-1] != "__init__"}
    assert rooms == set(ROOMS)


def test_imports_point_down() -> None:
    up = {f"{room}->{other}" for room, other in imports() if (*ROOMS, TOP).index(other) > ROOMS.index(room)}
    assert up == set(UPWARD)


def test_the_table_of_rooms_is_the_tree() -> None:
    """CONTRIBUTING names every room and every module beside them once, in the order in which they may be imported."""
    text = (TESTS.parent / "CONTRIBUTING.md").read_text(encoding="utf-8")
    rows = [line.split("|")[1] for line in text.splitlines() if line.startswith("| `")]
    named = [name.strip("/").replace("/", ".") for row in rows for name in re.findall(r"`([^`]+)`", row)]
    tree = {path.stem for path in PACKAGE.iterdir() if path.is_dir() or path.suffix == ".py"}
    missing = {name for name in named if not (PACKAGE / name.replace(".", "/")).with_suffix(".py").exists()}
    assert {name for name in missing if not (PACKAGE / name.replace(".", "/")).is_dir()} == set()
    assert tree - {"__init__", "__main__", "__pycache__"} == {name.partition(".")[0] for name in named}
    places = [next(i for i, room in enumerate(ROOMS) if f"{room}.".startswith(f"{name}.")) for name in named]
    assert places == sorted(places)


def test_no_test_imports_a_test() -> None:
    """What tests share is in `support`; nor does anything there lean on a test or a study."""
    found = []
    for path in TESTS.rglob("*.py"):
        shared = path.parent.name == "support"
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [one.name for one in node.names] if isinstance(node, ast.Import | ast.ImportFrom) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            parts = {part for name in names for part in name.split(".")}
            if any(part.startswith("test_") for part in parts) or (shared and "studies" in parts):
                found.append(f"{path.relative_to(TESTS)}:{node.lineno}")
    assert found == []


def test_every_test_is_in_a_room() -> None:
    """Of the package in one folder, each part of it in the folder of its name; there is no other room for tests."""
    places = {path.parent.relative_to(TESTS).parts for path in TESTS.rglob("test_*.py")}
    assert {place[0] for place in places} == {"unit", "referee", "fuzz"}
    assert {place[1] for place in places if place[1:]} <= {path.name for path in PACKAGE.iterdir() if path.is_dir()}
