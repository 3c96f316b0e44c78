"""What starting imports: packages that take as long as all the rest are left until they are needed.

Times are not asserted here; `python tests/benchmarks/startup.py` prints them.
"""

from __future__ import annotations

import subprocess
import sys

import pytest

HEAVY = {
    *("torch", "matplotlib", "meshcat", "jinja2", "arviz", "arviz_stats", "nutpie", "pandas", "pyarrow", "scipy"),
    *("joblib", "dask", "mujoco", "numba"),
}
IMPORT = "import armflex"
HELP = "from armflex.cli.main import main\ntry:\n    main()\nexcept SystemExit as end:\n    assert not end.code"
REPORT = "\nimport sys\nprint('imported:', *{name.partition('.')[0] for name in sys.modules})"


def imported(code: str, *arguments: str) -> set[str]:
    """Return the packages that a new Python has imported after running the code."""
    run = [sys.executable, "-c", code + REPORT, *arguments]
    text = subprocess.run(run, check=True, capture_output=True, text=True).stdout
    return set(text.splitlines()[-1].split()[1:])


@pytest.mark.parametrize("arguments", [(), ("--help",), ("deflect", "--help"), ("--version",)])
def test_nothing_heavy_is_imported_until_needed(arguments):
    found = imported(HELP if arguments else IMPORT, *arguments)
    assert {"armflex", "pinocchio"} <= found
    assert not found & HEAVY


def test_linear_algebra_of_a_command_has_one_thread_unless_told_otherwise(monkeypatch):
    """Threads of matrices this small wait for each other; SciPy is not loaded yet when a command says so."""
    code = HELP + "\nimport os, sys\nprint('imported:', os.environ['OPENBLAS_NUM_THREADS'], 'scipy' in sys.modules)"
    for asked, expected in ((None, "1"), ("3", "3")):
        monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
        if asked:
            monkeypatch.setenv("OPENBLAS_NUM_THREADS", asked)
        run = [sys.executable, "-c", code, "train", "--help"]
        text = subprocess.run(run, check=True, capture_output=True, text=True).stdout
        assert text.splitlines()[-1] == f"imported: {expected} False"
