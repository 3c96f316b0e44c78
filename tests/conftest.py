"""Before the first test: the compiled kernel, and where fixtures come from."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

pytest.register_assert_rewrite("support")
pytest_plugins = ("support.fixtures", "support.stage", "support.traced_backlash", "support.tracking")


def pytest_configure(config: pytest.Config) -> None:
    """Compile the kernel once, before the workers start: they would each, and code compiled apart rounds otherwise."""
    if not hasattr(config, "workerinput"):
        code = "from armflex.mechanics.rows import kernel; kernel().compile_everything()"
        subprocess.run([sys.executable, "-c", code], cwd=Path(__file__).parents[1], check=True)
