"""Threads of a new process that need the compiled engine at once: none of them stands still."""

from __future__ import annotations

import ast
from pathlib import Path

from support.cold import COLD, cold_processes


def test_no_cold_process_stands_still(tmp_path: Path) -> None:
    """Before the engine was one thread's to import, two of three predictions did; `tests/studies/cold.py` runs more."""
    names = ["predict", *COLD]
    assert list(cold_processes(names, tmp_path, together=3, seconds=600)) == [(name, "") for name in names]


def test_every_process_that_is_waited_for_has_a_limit() -> None:
    """One that stands still is a failure, and not the end of the suite."""
    root, found = Path(__file__).parents[2], []
    for path in (*root.glob("tests/**/*.py"), *root.glob("examples/*.py")):
        calls = [node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)]
        for call in (call for call in calls if ast.unparse(call.func) == "subprocess.run"):
            if "timeout" not in [keyword.arg for keyword in call.keywords]:
                found.append(f"{path.relative_to(root)}:{call.lineno}")
    assert found == []
