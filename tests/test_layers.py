"""Imports point down only: a room imports from the rooms that stand before it, type-checking imports included."""

from __future__ import annotations

import ast
from pathlib import Path

PACKAGE = Path(__file__).parent.parent / "armflex"

ROOMS = (
    *("errors", "conventions", "printable", "version", "covariance", "linear_gaussian"),
    *("whole_file", "digest", "parallel", "storage"),
    *("bundled", "declaration", "picture"),
    *("robot", "prior", "rows", "readings"),
    *("laws", "flexure", "effects"),
    "mechanics",
    *("certainty", "arm", "certainty_table", "calibration_table", "arm_file"),
    *("measured", "trajectory"),
    *("calibrate", "tip_uncertainty"),
    *("learning", "plan", "tracking", "trace"),
    *("correction", "compensate_doubts", "check", "compensate", "predict", "workspace"),
    *("view", "report"),
    "cli",
)
"""From the ground up."""

UPWARD = (
    "arm_file->calibrate",
    "calibrate->learning",
    "calibrate->trace",
    "calibration_table->calibrate",
    "certainty_table->calibrate",
    "compensate_doubts->compensate",
    "effects->arm",
    "effects->calibrate",
    "effects->mechanics",
    "plan->workspace",
    "workspace->view",
)
"""Imports that point up today. None may be added; one that is gone must go from here."""


def imports() -> set[tuple[str, str]]:
    """Return (importing room, imported room) of every import anywhere in the package."""
    found = set()
    for path in PACKAGE.rglob("*.py"):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if parts != ("__init__",) and isinstance(node, ast.ImportFrom) and node.module:
                module = node.module.split(".")
                if module[0] == "armflex" and len(module) > 1 and module[1] != parts[0]:
                    found.add((parts[0], module[1]))
    return found


def test_every_room_has_its_place() -> None:
    rooms = {path.stem for path in PACKAGE.iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()}
    assert rooms - {"__init__"} == set(ROOMS)


def test_imports_point_down() -> None:
    up = {f"{room}->{other}" for room, other in imports() if ROOMS.index(other) > ROOMS.index(room)}
    assert up == set(UPWARD)
