"""The wheel holds what the package needs where no checkout is: robots, pages, and the mark of a typed package."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
BUILD = "import sys, hatchling.build; print(hatchling.build.build_wheel(sys.argv[1]))"
ASK = """
import armflex, armflex.show.report, armflex.show.view
arm = armflex.load_arm(armflex.bundled_robot("heavy_six") / "arm.toml")
print(armflex.__file__, arm.robot.urdf.path, arm.deflection(arm.position()).displacement[2], sep="\\n")
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the wheel without a network, in a process of its own."""
    pytest.importorskip("hatchling", reason="the build backend is not installed")
    folder = tmp_path_factory.mktemp("wheel")
    built = subprocess.run(
        [sys.executable, "-c", BUILD, folder], cwd=ROOT, capture_output=True, text=True, check=True, timeout=600
    )
    return folder / built.stdout.splitlines()[-1]


def kept(folder: Path) -> set[str]:
    """Return the files of a folder that belong to it, by their places in it."""
    found = (path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
    return {path.as_posix() for path in found if "__pycache__" not in path.parts}


def test_it_holds_everything_that_the_package_and_the_robots_are(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as file:
        names = set(file.namelist())
    assert {f"armflex/{name}" for name in kept(ROOT / "armflex")} <= names
    assert {f"armflex/bundled/{name}" for name in kept(ROOT / "robots")} <= names
    assert "armflex/py.typed" in names and {name for name in names if name.endswith(".html")}
    assert {name.partition("/")[0] for name in names if ".dist-info/" not in name} == {"armflex"}


@pytest.mark.slow
def test_a_bundled_arm_is_loaded_from_it(wheel: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(wheel) as file:
        file.extractall(tmp_path)
    given = {**os.environ, "PYTHONPATH": str(tmp_path)}
    said = subprocess.run(
        [sys.executable, "-c", ASK], cwd=tmp_path, env=given, capture_output=True, text=True, timeout=600
    )
    assert said.returncode == 0, said.stderr
    package, urdf, sag = said.stdout.splitlines()
    assert Path(package).is_relative_to(tmp_path) and Path(urdf).is_relative_to(tmp_path)
    assert float(sag) < -1e-4
