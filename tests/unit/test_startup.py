"""What starting imports: packages that take as long as all the rest are left until they are needed.

Times are not asserted here; `python tests/benchmarks/startup.py` prints them.
"""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import armflex

HEAVY = {
    *("torch", "matplotlib", "jinja2", "arviz", "arviz_stats", "nutpie", "pandas", "pyarrow", "scipy"),
    *("joblib", "dask", "mujoco"),
}
IMPORT = "import armflex\narmflex.load_arm\nassert callable(armflex.trace)"
HELP = "from armflex.cli.main import main\ntry:\n    main()\nexcept SystemExit as end:\n    assert not end.code"
REPORT = "\nimport sys\nprint('imported:', *{name.partition('.')[0] for name in sys.modules})"


def imported(code: str, *arguments: str) -> set[str]:
    """Return the packages that a new Python has imported after running the code."""
    run = [sys.executable, "-c", code + REPORT, *arguments]
    text = subprocess.run(run, check=True, capture_output=True, text=True, timeout=600).stdout
    return set(text.splitlines()[-1].split()[1:])


@pytest.mark.slow
@pytest.mark.parametrize("arguments", [(), ("deflect", "--help")])
def test_nothing_heavy_is_imported_until_needed(arguments):
    found = imported(HELP if arguments else IMPORT, *arguments)
    assert "armflex" in found
    assert not found & HEAVY


def test_an_arm_is_loaded_and_asked_without_what_fits_one():
    code = """
import sys, warnings
import armflex
arm = armflex.load_arm(armflex.bundled_robot("tarm_like") / "arm.toml")
arm.deflection(arm.position(), "none")
print("imported:", *{name.split(".")[1] for name in sys.modules if name.startswith("armflex.")})
"""
    run = [sys.executable, "-W", "ignore", "-c", code]
    rooms = set(
        subprocess.run(run, check=True, capture_output=True, text=True, timeout=600).stdout.splitlines()[-1].split()[1:]
    )
    assert {"arm", "files", "mechanics"} <= rooms
    assert not rooms & {"estimate", "bench", "trace", "plan", "track", "tasks", "show", "sampling"}


def test_the_package_has_for_people_what_it_has_for_type_checkers():
    """Names are imported when they are asked for; a type checker reads them where the package imports them for it."""
    tree = ast.parse(Path(armflex.__file__).read_text(encoding="utf-8"))
    (block,) = (node for node in tree.body if isinstance(node, ast.If))
    told = {alias.name: node.module for node in block.body for alias in node.names}
    assert told == armflex.EXPORTS and set(told) < set(dir(armflex)) and set(told) < set(armflex.__all__)
    for name, module in told.items():
        assert getattr(armflex, name) is getattr(sys.modules[module], name)


@pytest.mark.slow
def test_a_function_stays_one_when_the_package_of_its_name_is_imported():
    code = """
import armflex.trace.search, armflex.plan.design_model
import armflex
print("imported:", armflex.trace.__name__, callable(armflex.trace), callable(armflex.plan))
"""
    text = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True, timeout=600).stdout
    assert text.split()[1:] == ["trace", "True", "True"]


@pytest.mark.slow
def test_linear_algebra_of_a_command_has_one_thread_unless_told_otherwise(monkeypatch):
    """Threads of matrices this small wait for each other; SciPy is not loaded yet when a command says so."""
    code = HELP + "\nimport os, sys\nprint('imported:', os.environ['OPENBLAS_NUM_THREADS'], 'scipy' in sys.modules)"
    for asked, expected in ((None, "1"), ("3", "3")):
        monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
        if asked:
            monkeypatch.setenv("OPENBLAS_NUM_THREADS", asked)
        run = [sys.executable, "-c", code, "train", "--help"]
        text = subprocess.run(run, check=True, capture_output=True, text=True, timeout=600).stdout
        assert text.splitlines()[-1] == f"imported: {expected} False"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("module", "command", "code", "said"),
    [("armflex", "--help", 0, "deflect"), ("armflex.cli.main", "deflct", 2, "did you mean 'deflect'")],
)
def test_the_command_line_is_a_module_too(module, command, code, said):
    run = subprocess.run([sys.executable, "-m", module, command], capture_output=True, text=True, timeout=600)
    assert run.returncode == code and said in run.stdout + run.stderr
