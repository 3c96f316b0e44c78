"""What a command found is on the disk before it says so, all files of it or none."""

import contextlib
import errno
import io
import os
import warnings
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from support.command_line import fine, run_here
from support.small_arms import ROBOTS, joint, link, robot, write

from armflex import load_arm
from armflex.cli.main import COMMANDS
from armflex.cli.main import armflex as group
from armflex.robot.robot import Corrections

ARM = """\
[robot]
urdf = "robot.urdf"
tip = "tip"
gravity = [0.0, 0.0, -9.81]
[payload.p]
mass = 5.0
com = [0.0, 0.0, 0.0]
[flexure.B]
joint = "B"
compliance = [0, 0, 0, 0, 1e-5, 0]
[measurement]
frame = "base"
[prior]
joint_offset = 1e-2
"""
TABLE = ROBOTS / "tarm_like" / "a4_table_1.csv"
MESH = ROBOTS.parent / "tests" / "referee" / "calculix" / "c3d20.inp"
GIVEN = {
    "deflect": ["arm.toml"],
    "modes": ["arm.toml"],
    "predict": ["arm.toml", "rows.csv", "-o", "o.csv"],
    "check": ["arm.toml", "path.csv", "--tolerance", "1m"],
    "compensate": ["arm.toml", "path.csv", "-o", "o.csv"],
    "calibrate": ["arm.toml", "rows.csv", "-o", "o.toml", "--report", "o.html"],
    "trace": ["arm.toml", "rows.csv", "-o", "o.toml", "--report", "o.html"],
    "report": ["arm.toml", "rows.csv", "--iso9283", "-o", "o.html"],
    "plan": ["arm.toml", "--rows", "2", "-o", "o.csv", "--picture", "o.png"],
    "rehearse": ["arm.toml", "--rows", "rows.csv", "--draws", "1"],
    "train": [TABLE, "-o", "o.safetensors", "--picture", "o.png"],
    "fem": [MESH, "--fixed", "ROOT", "--loaded", "TIP", "-o", "o.toml"],
    "map": ["arm.toml", "--rows", "64", "-o", "o.csv", "--picture", "o.png", "--page", "o.html"],
    "export": ["arm.toml", "--to", "sheet", "-o", "o.csv"],
    "view": ["arm.toml", "-o", "o.html"],
}
"""Every command but `demo`, which writes as it goes on, and those that tests of their own hold."""

LATER = {"intake": ["path.csv", "-o", "o.csv"]}
"""How every column was taken is said before anything is written."""

WORK = {"plan": "plan", "train": "train", "map": "map_workspace", "report": "iso9283", "trace": "trace"}
"""What takes long in a command, and writes nothing."""

BESIDE = {"fem": ("o.surface.safetensors",)}
"""Files that a command writes beside those that it is asked for."""


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with an arm of two joints, a campaign with repeats, and a path."""
    folder = tmp_path_factory.mktemp("job")
    parts = link("base"), link("upper", 8.0, (0.3, 0, 0)), link("fore", 4.0, (0.3, 0, 0)), link("tip")
    parts += joint("A", "base", "upper"), joint("B", "upper", "fore", (0.7, 0, 0), axis=(0, 1, 0))
    write(folder, robot(*parts, joint("T", "fore", "tip", (0.6, 0, 0), kind="fixed")))
    arm = load_arm(write(folder, ARM, "arm.toml"))
    rng = np.random.default_rng(0)
    q = np.repeat(rng.uniform(-1.0, 1.0, (6, 2)), 5, axis=0)
    truth = replace(arm, corrections=Corrections(joint_offset={"B": 5e-3}))
    tips = truth.deflection(q).pose[:, :3, 3] + rng.normal(0.0, 1e-4, (30, 3))
    cells = np.column_stack([np.repeat(np.arange(6), 5), np.arange(30), q, tips, np.full(30, 1e-4)])
    np.savetxt(folder / "rows.csv", cells, delimiter=",", header="pose,time,q_A,q_B,x,y,z,sigma", comments="")
    np.savetxt(folder / "path.csv", cells[::5, 1:4], delimiter=",", header="time,q_A,q_B", comments="")
    return folder


def written(job: Path, folder: Path) -> dict[str, str]:
    """Return what stands in a folder beside the inputs of a job, and temporary files with it."""
    names = {path.name for path in job.iterdir()}
    return {path.name: path.read_text(errors="replace") for path in folder.iterdir() if path.name not in names}


class Full(io.TextIOBase):
    """An output that takes nothing: a full disk, or a reader who has gone."""

    def write(self, text: str) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.fixture
def folder(job: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for path in job.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)  # which the command line replaces
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_every_command_is_asked() -> None:
    assert [*GIVEN] == [name for name in COMMANDS if name in GIVEN]
    assert {*COMMANDS} - {*GIVEN} <= {"demo", "history", "intake", "prior", "schema"}


@pytest.mark.slow
@pytest.mark.parametrize("name", GIVEN)
@pytest.mark.filterwarnings("ignore:tolerance:armflex.ArmflexWarning")
def test_what_was_found_is_on_the_disk_before_it_is_said(job: Path, folder: Path, name: str) -> None:
    given = [name, *map(str, GIVEN[name]), "--json", "o.json"]
    outputs = {"o.json", *(text for text in given if text.startswith("o.")), *BESIDE.get(name, ())}
    with contextlib.redirect_stdout(Full()), pytest.raises(OSError, match="No space left"):
        group.main(given, standalone_mode=False)
    assert {*written(job, folder)} == outputs


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name, given in (GIVEN | LATER).items() if "-o" in map(str, given)])
def test_where_one_file_cannot_take_its_place_none_does(
    job: Path, folder: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whichever it is, be there an old one or not."""
    given = [name, *map(str, (GIVEN | LATER)[name]), "--json", "o.json"]
    outputs = sorted({"o.json", *(text for text in given if text.startswith("o.")), *BESIDE.get(name, ())})
    for output in outputs[::2]:
        (folder / output).write_text("old")
    if name in WORK:  # what is found is written several times
        module, made = import_module(f"armflex.cli.{name}_command"), []
        work = getattr(module, WORK[name])
        monkeypatch.setattr(
            module, WORK[name], lambda *a, **b: made[0] if made else made.append(work(*a, **b)) or made[0]
        )
    before, replace_file = written(job, folder), os.replace
    for refused in outputs:

        def refuse(source: Path, place: Path, refused: str = refused) -> None:
            if place.name == refused and source.read_text(errors="replace") != "old":
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            replace_file(source, place)

        with monkeypatch.context() as patch:
            patch.setattr(os, "replace", refuse)
            result = fine(run_here(folder, *given), 2)
        assert f"{refused}: cannot be written: No space left on device" in result.stderr
        assert {key: text for key, text in written(job, folder).items() if "checkpoint" not in key} == before
