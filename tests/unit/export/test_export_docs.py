"""The commands of docs/export.md run as they stand there, and write what they say."""

import re
import shlex
import shutil
from pathlib import Path

import pytest
from support.command_line import fine, run_here
from support.small_arms import ROBOTS

TEXT = (ROBOTS.parent / "docs" / "export.md").read_text()
BLOCKS = re.findall(r"```console\n(.*?)```", TEXT, re.S)
COMMANDS = [line for block in BLOCKS for line in re.sub(r"\\\n\s*", "", block).splitlines()]


def test_every_format_has_an_example() -> None:
    from armflex.cli.export_command import FORMATS

    shown = {shlex.split(line)[shlex.split(line).index("--to") + 1] for line in COMMANDS}
    assert set(FORMATS) - shown <= {"c"}


@pytest.mark.slow
@pytest.mark.parametrize("line", COMMANDS)
def test_examples_run(line: str, tmp_path: Path) -> None:
    given = ("arm.toml", "robot.urdf", "trajectory.csv")
    for name in given:
        shutil.copy(ROBOTS / "heavy_six" / name, tmp_path / name)
    program, *arguments = shlex.split(line)
    assert program == "armflex"
    fine(run_here(tmp_path, *arguments))
    written = {path.name for path in tmp_path.iterdir()} - set(given)
    assert written == ({arguments[arguments.index("-o") + 1]} if "-o" in arguments else set())
