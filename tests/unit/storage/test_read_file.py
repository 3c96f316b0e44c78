"""Files of a user are read where they are files, and no further than is allowed."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from support.small_arms import ROBOTS

from armflex import load_arm, read_measurements
from armflex.errors import FileError, InputError
from armflex.fem.read import read_mesh
from armflex.intake import intake
from armflex.storage.read_file import read_file, reading
from armflex.trajectory import read_trajectory

HEAVY = ROBOTS / "heavy_six"
posix = pytest.mark.skipif(os.name != "posix", reason="Windows has no such files")


def odd_files(folder: Path) -> dict[str, Path]:
    """Return what is no file, by what it is called."""
    os.mkfifo(folder / "pipe")
    (folder / "zero").symlink_to("/dev/zero")
    (folder / "folder").mkdir()
    return {"a named pipe": folder / "pipe", "a device": folder / "zero", "Is a directory": folder / "folder"}


@posix
def test_what_is_no_file_is_not_opened(tmp_path: Path) -> None:
    for kind, path in odd_files(tmp_path).items():
        with pytest.raises(OSError, match=kind):
            read_file(path, 100)


@posix
def test_no_reader_waits_or_fills_the_memory(tmp_path: Path) -> None:
    arm = load_arm(HEAVY / "arm.toml")
    for path in odd_files(tmp_path).values():
        suffixes = ("toml", "urdf", "csv", "msh", "inp", "c3d", "mcap")
        named = {suffix: path.with_name(f"{path.name}.{suffix}") for suffix in suffixes}
        for other in named.values():
            other.symlink_to(path)
        (tmp_path / "arm.toml").write_text(f'[robot]\nurdf = "{named["urdf"].name}"\ntip = "tool"\n')
        for read in (
            lambda: load_arm(named["toml"]),  # noqa: B023
            lambda: load_arm(named["urdf"]),  # noqa: B023
            lambda: load_arm(tmp_path / "arm.toml"),
            lambda: read_measurements(named["csv"], arm),  # noqa: B023
            lambda: read_trajectory(named["csv"], arm),  # noqa: B023
            lambda: read_mesh(named["msh"]),  # noqa: B023
            lambda: read_mesh(named["inp"]),  # noqa: B023
        ):
            with pytest.raises(FileError, match="cannot be read"):
                read()
    for suffix in ("csv", "c3d", "mcap"):
        with pytest.raises(InputError, match="cannot be read"):
            intake([tmp_path / f"zero.{suffix}"], 1e-4, {}, None, [])


@posix
def test_no_file_that_an_mjcf_names_is_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "m.stl")
    geom = '<worldbody><body name="a"><joint name="j"/><geom type="mesh" mesh="m"/></body></worldbody>'
    (tmp_path / "a.xml").write_text(f'<mujoco><asset><mesh name="m" file="m.stl"/></asset>{geom}</mujoco>')
    with pytest.raises(FileError, match=r"a.xml:1: <mesh file='m.stl'> cannot be read: it is a named pipe"):
        load_arm(tmp_path / "a.xml")


def test_no_more_is_read_than_is_allowed(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"x" * 101)
    assert len(read_file(tmp_path / "a", 101)) == 101
    with pytest.raises(OSError, match="larger than the 100 bytes"):
        read_file(tmp_path / "a", 100)


@posix
def test_a_file_that_says_another_size_is_bounded_too() -> None:
    if not Path("/proc/self/maps").exists():
        pytest.skip("there is no /proc")
    with pytest.raises(OSError, match="larger than the 10 bytes"), reading(Path("/proc/self/maps"), 10) as file:
        file.read()


@posix
def test_streams_of_the_shell_are_tables(tmp_path: Path) -> None:
    script = "import sys, armflex; from pathlib import Path; arm = armflex.load_arm(sys.argv[1]);"
    script += (
        "rows = armflex.read_measurements(Path('/dev/stdin'), arm, inputs_only=True); print(len(rows), rows.sha256)"
    )
    text, command = (HEAVY / "trajectory.csv").read_bytes(), [sys.executable, "-c", script, str(HEAVY / "arm.toml")]
    said = subprocess.run(command, input=text, capture_output=True, check=True, timeout=600).stdout.split()
    assert int(said[0]) == text.count(b"\n") - 1 and len(said[1]) == 64


def test_a_key_of_many_parts_is_refused_at_once(tmp_path: Path) -> None:
    key = ".".join(["a"] * 50_000)
    for text in (f"[{key}]", f"{key} = 1", f"x = {{ {key} = 1 }}", f'x = 1\n\n[["b".{key}]]'):
        (tmp_path / "arm.toml").write_text(f"{text}\n")
        with pytest.raises(FileError, match=rf"arm.toml:{text.count(chr(10)) + 1}: nested deeper than 32"):
            load_arm(tmp_path / "arm.toml")
