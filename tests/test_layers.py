"""What the mechanics may import: what stands below them, nothing that knows an arm's file, its effects or its fit."""

from __future__ import annotations

import ast
from pathlib import Path

import armflex

PACKAGE = Path(armflex.__file__).parent
BELOW = {"conventions", "errors", "laws", "mechanics", "parallel", "robot", "storage"}


def test_mechanics_import_only_what_stands_below():
    """Imports inside functions and those for the type checker alone included."""
    found = set()
    for path in (PACKAGE / "mechanics").glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            found |= {name.split(".")[1] for name in names if name.startswith("armflex.")}
    assert found and found <= BELOW
