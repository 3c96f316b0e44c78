"""The command line and files: what it reads it keeps, and whatever is no file is told in one line."""

import shutil
import sys
import warnings
from collections.abc import Iterator, Sequence
from itertools import combinations
from pathlib import Path

import pytest
from support.command_line import Run, fine
from support.small_arms import ROBOTS

from armflex import InputError
from armflex.cli.main import COMMANDS, Commands, main
from armflex.cli.main import armflex as group
from armflex.cli.options import OutputPath

TARM = ROBOTS / "tarm_like"
TABLE = TARM / "a4_table_1.csv"
FILES = {"arm.toml": TARM / "arm.toml", "robot.urdf": TARM / "robot.urdf", "rows.csv": TARM / "trajectory.csv"}
FILES |= {"paper_A4_um.safetensors": TARM / "paper_A4_um.safetensors", "joint.csv": TABLE}
FILES |= {"bar.inp": ROBOTS.parent / "tests" / "referee" / "calculix" / "c3d20.inp"}
READ = {
    "deflect": ["arm.toml"],
    "modes": ["arm.toml"],
    "predict": ["arm.toml", "rows.csv"],
    "check": ["arm.toml", "rows.csv", "--tolerance", "5mm"],
    "compensate": ["arm.toml", "rows.csv"],
    "calibrate": ["arm.toml", "rows.csv", "--points", "joint.csv"],
    "trace": ["arm.toml", "rows.csv", "--points", "joint.csv"],
    "report": ["arm.toml", "rows.csv", "--iso9283", "--points", "joint.csv"],
    "plan": ["arm.toml", "--after", "rows.csv", "--along", "joint.csv"],
    "intake": ["rows.csv", "--sigma", "0.1mm"],
    "rehearse": ["arm.toml", "--rows", "rows.csv"],
    "train": ["joint.csv", "--assembly", "arm.toml"],
    "fem": ["bar.inp", "--fixed", "ROOT", "--loaded", "TIP"],
    "map": ["arm.toml"],
    "view": ["arm.toml", "--traj", "rows.csv"],
    "prior": ["arm.toml"],
    "history": ["arm.toml"],
    "export": ["arm.toml", "--to", "urscript", "--traj", "rows.csv"],
}
NAMED = ["robot.urdf", "paper_A4_um.safetensors"]


def outputs_of(name: str) -> list[str]:
    """Return every option of a command that names a file to write."""
    command = Commands().get_command(None, name)
    return [one.opts[0] for one in command.params if isinstance(one.type, OutputPath)]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Enter a folder with every kind of input, and a link to each."""
    for name, source in FILES.items():
        shutil.copy(source, tmp_path / name)
        (tmp_path / f"link_{name}").symlink_to(tmp_path / name)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path.parent / "config"))
    return tmp_path


def refused(folder: Path, arguments: Sequence[str], complaint: str) -> None:
    """Run a command in this process, which is quicker; nothing may have changed."""
    before = {path: path.read_bytes() for path in folder.iterdir()}
    with pytest.raises(InputError, match=complaint):
        group.main(list(arguments), standalone_mode=False)
    assert {path: path.read_bytes() for path in folder.iterdir()} == before


@pytest.mark.parametrize("name", [name for name in COMMANDS if name not in ("demo", "schema")])
def test_no_command_writes_over_a_file_that_it_reads(folder: Path, name: str) -> None:
    options, inputs = outputs_of(name), [text for text in READ[name] if text in FILES]
    inputs += NAMED if "arm.toml" in inputs else []
    assert "--json" in options and inputs
    for option in options:
        others = [text for other in options if other != option for text in (other, f"new{other}")]
        for file in inputs:
            for spelt in (file, f"./{file}", f"link_{file}"):
                arguments = [name, *READ[name], *others, option, spelt]
                refused(folder, arguments, f"is an input of this command; name another file with {option}")


@pytest.mark.parametrize("name", [name for name in COMMANDS if name != "demo" and len(outputs_of(name)) > 1])
def test_no_command_writes_two_results_into_one_file(folder: Path, name: str) -> None:
    options = outputs_of(name)
    (folder / "there.json").write_text("kept")
    (folder / "other.json").symlink_to(folder / "there.json")
    for one, other in combinations(options, 2):
        rest = [text for option in options if option not in (one, other) for text in (option, f"new{option}")]
        for first, second in (("new", "new"), ("new", "./new"), ("there.json", "other.json")):
            refused(folder, [name, *READ[name], *rest, one, first, other, second], f"{one} and {other} are the same")


ENDINGS = {("-o", "train"): ".safetensors", ("-o", "map"): ".safetensors", ("--picture", "plan"): ".png"}
ENDINGS |= {("-o", "fem"): ".toml"}
ENDINGS |= {("--picture", "map"): ".png", ("--page", "map"): ".html"}
NO_INPUT = ["none", "none/none", "folder", "empty", "binary", "circle", "rows.csv/none", "x" * 300, "none.toml"]
NO_INPUT += ["none.urdf", "folder.urdf", "empty.toml", "none.parquet", "binary.parquet", "joint.csv", "unreadable"]
NO_OUTPUT = ["none/o", "folder", "circle", "rows.csv/o", "x" * 300]


@pytest.fixture
def odd(folder: Path) -> Path:
    """Add what is no file, holds nothing, or cannot be read even by who may read everything."""
    for name in ("folder", "folder.urdf"):
        (folder / name).mkdir()
    for name, content in (("empty", b""), ("empty.toml", b""), ("binary", bytes(range(256)))):
        (folder / name).write_bytes(content)
    (folder / "binary.parquet").write_bytes(bytes(range(256)))
    (folder / "circle").symlink_to("circle")
    (folder / "unreadable").symlink_to("/proc/self/mem" if Path("/proc/self/mem").exists() else "none")
    return folder


def odd_runs(name: str) -> Iterator[list[str]]:
    """Yield a command's arguments, each time with one odd input or output."""
    outputs = {option: f"new{option}{ENDINGS.get((option, name), '')}" for option in outputs_of(name)}
    given = READ[name]
    for place, text in enumerate(given):
        for other in NO_INPUT if text in FILES else ():
            if other not in given:
                others = [other if i == place else one for i, one in enumerate(given)]
                yield [name, *others, *(text for pair in outputs.items() for text in pair)]
    for option in outputs:
        for other in NO_OUTPUT:
            ending = "" if other in ("folder", "circle") else ENDINGS.get((option, name), "")
            pairs = (outputs | {option: other + ending}).items()
            yield [name, *given, *(text for pair in pairs for text in pair)]


@pytest.mark.parametrize("name", [name for name in COMMANDS if name not in ("demo", "schema")])
def test_whatever_is_no_file_is_told_in_one_line(
    odd: Path, name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)  # which the command line replaces
    before = {path: path.is_file() and path.read_bytes() for path in odd.iterdir() if path.name != "unreadable"}
    for arguments in odd_runs(name):
        monkeypatch.setattr(sys, "argv", ["armflex", *arguments])
        with pytest.raises(SystemExit) as ended:
            main()
        out, err = capsys.readouterr()
        said = [line for line in err.splitlines() if not line.startswith("warning: ")]
        assert ended.value.code == 2 and len(said) == 1 and said[0].startswith("error: "), (arguments, said)
        assert not out or arguments[0] == "train", arguments
        now = {path: path.is_file() and path.read_bytes() for path in odd.iterdir() if path.name != "unreadable"}
        assert now == before, arguments


def test_an_input_is_refused(armflex: Run, tmp_path: Path) -> None:
    (tmp_path / "in.csv").write_bytes(TABLE.read_bytes())
    result = fine(armflex("train", "in.csv", "-o", "o.safetensors", "--json", "in.csv"), 2)
    assert "in.csv is an input of this command; name another file with --json" in result.stderr
    assert (tmp_path / "in.csv").read_bytes() == TABLE.read_bytes() and not (tmp_path / "o.safetensors").exists()


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_a_fit_does_not_read_the_device_that_it_is_written_to(armflex: Run, tmp_path: Path) -> None:
    boom = ROBOTS / "tarm_like"
    (tmp_path / "rows.csv").write_text("\n".join((boom / "campaign.csv").read_text().splitlines()[:61]))
    asked = ("calibrate", boom / "measured.toml", "rows.csv", "-o", "/dev/full", "--json", "out.json")
    assert "/dev/full: cannot be written: No space left" in fine(armflex(*asked), 2).stderr
    assert not (tmp_path / "out.json").exists()


@pytest.mark.parametrize("file", ["traced.toml", "tarm_like/arm.toml", "tarm_like/campaign.csv"])
def test_a_demo_keeps_its_files_apart(folder: Path, file: str) -> None:
    (folder / "d").mkdir()
    (folder / "d" / "tarm_like").mkdir()
    with pytest.raises(InputError, match="is a file of the demonstration"):
        group.main(["demo", "-o", "d", "--json", f"d/{file}"], standalone_mode=False)
    assert not list((folder / "d" / "tarm_like").iterdir())


@pytest.mark.parametrize("name", ["calibrate", "trace", "plan"])
def test_commands_that_fit_take_a_doubtful_robot_with_lax_as_all_others_do(
    armflex: Run, tmp_path: Path, name: str
) -> None:
    for file, path in FILES.items():
        (tmp_path / file).write_bytes(path.read_bytes())
    text = (tmp_path / "robot.urdf").read_text()
    (tmp_path / "robot.urdf").write_text(text.replace("<axis", "<axle/><axis"))
    given = [name, "arm.toml", *(["--after"] if name == "plan" else []), "rows.csv", "-o", "out.toml"]
    assert "<axle> is not known inside <joint>" in fine(armflex(*given), 2).stderr
    without_readings = fine(armflex(*given, "--lax"), 2).stderr  # rows.csv holds none: the robot was taken
    assert "error: rows.csv" in without_readings


@pytest.mark.slow
def test_every_command_that_takes_a_robot_has_lax(armflex: Run) -> None:
    for name in READ.keys() - {"train", "fem", "intake", "prior", "history"}:
        assert "--lax" in fine(armflex(name, "--help")).stdout, name
