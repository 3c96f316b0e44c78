"""Files are written whole, by one function, and keep the mode they had."""

import ast
import json
import os
import stat
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.small_arms import ROBOTS

import armflex
from armflex.errors import FileError
from armflex.storage.whole_file import together, write_whole, writing

PACKAGE = Path(armflex.__file__).parent
WRITERS = {"write_text", "write_bytes", "save_file", "tofile", "to_csv", "to_parquet", "dump", "hardlink_to"}
TAKES_A_STREAM = {"save", "savez", "savez_compressed", "savetxt", "savefig"}
MODULES = {"shutil", "tempfile"}
OS = {"open", "fdopen", "replace", "rename", "renames", "link", "symlink", "truncate", "mkfifo", "write"}


@pytest.fixture
def umask() -> Iterator[int]:
    before = os.umask(0o027)
    yield 0o027
    os.umask(before)


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


@pytest.mark.parametrize("kept", [0o600, 0o640, 0o644, 0o664, 0o755, 0o666])
def test_a_replaced_file_keeps_its_mode(tmp_path: Path, umask: int, kept: int) -> None:
    path = tmp_path / "o"
    path.write_text("old")
    path.chmod(kept)
    write_whole(path, b"new")
    assert path.read_bytes() == b"new" and mode(path) == kept
    write_whole(tmp_path / "fresh", b"new")
    assert mode(tmp_path / "fresh") == 0o666 & ~umask and len(list(tmp_path.iterdir())) == 2


def test_while_it_is_written_nobody_else_may_read_more(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, seen = tmp_path / "o", []
    path.write_text("old")
    path.chmod(0o600)
    monkeypatch.setattr(os, "replace", lambda new, old: (seen.append(mode(new)), os.rename(new, old)))
    monkeypatch.setattr(os, "chmod", lambda new, _: seen.append(mode(new)))
    write_whole(path, b"new")
    assert seen == [0o600, 0o600]


def test_what_fails_leaves_the_old_file_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "o"
    path.write_text("old")

    def fail(*_: object) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(FileError, match="o: cannot be written: disk full"):
        write_whole(path, b"new")
    assert path.read_text() == "old" and list(tmp_path.iterdir()) == [path]


def test_several_files_are_all_there_or_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is there before the end, nor after an error in the work, on the disk, or as they take their places."""
    (tmp_path / "old").write_text("old")
    before = {path.name: path.read_text() for path in tmp_path.iterdir()}

    def there() -> dict[str, str]:
        return {path.name: path.read_text() for path in tmp_path.iterdir() if not path.name.startswith(".")}

    def write(fail: bool = False) -> None:
        with together():
            write_whole(tmp_path / "new", b"1")
            with together():
                write_whole(tmp_path / "old", b"2")
            with writing(tmp_path / "last") as file:
                file.write(b"3")
            assert there() == before
            if fail:
                raise ValueError("of the work")

    with pytest.raises(ValueError, match="of the work"):
        write(fail=True)
    assert there() == before and len(list(tmp_path.iterdir())) == 1

    def refuse(*_: object) -> None:
        raise OSError("disk full")

    for function in ("fsync", "chmod", "replace", "link"):
        with monkeypatch.context() as patch:
            patch.setattr(os, function, refuse)
            if function == "link":  # a file system without links, and without room for a copy
                patch.setattr("shutil.copy2", refuse)
            with pytest.raises(FileError, match="cannot be written: disk full"):
                write()
        assert there() == before and len(list(tmp_path.iterdir())) == 1
    write()
    assert there() == {"new": "1", "old": "2", "last": "3"} and len(list(tmp_path.iterdir())) == 3


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_a_device_that_takes_nothing_leaves_all_files_as_they_were(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="/dev/full: cannot be written: No space left"), together():
        write_whole(tmp_path / "new", b"1")
        write_whole(Path("/dev/full"), b"2")
    assert not list(tmp_path.iterdir())


def test_a_link_is_followed_wherever_it_leads(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    real, link, far = tmp_path / "folder" / "real", tmp_path / "link", tmp_path / "far"
    link.symlink_to(Path("folder") / "real")
    far.symlink_to(link)
    for data in (b"first", b"second"):  # it ends nowhere at first
        write_whole(far, data)
        assert real.read_bytes() == data and far.is_symlink() and link.is_symlink() and not real.is_symlink()
    (tmp_path / "circle").symlink_to("circle")
    with pytest.raises(FileError, match="circle: cannot be written: Too many levels of symbolic links"):
        write_whole(tmp_path / "circle", b"new")
    assert (tmp_path / "circle").is_symlink()


def test_where_nothing_can_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").write_text("old")
    names = {"folder": "Is a directory", "none/o": "No such file", "file/o": "Not a directory", "x" * 300: "too long"}
    for name, reason in names.items():
        with pytest.raises(FileError, match=f"cannot be written: .*{reason}"):
            write_whole(tmp_path / name, b"new")
    with monkeypatch.context() as patch:  # whoever runs the tests may write everywhere
        patch.setattr(os, "access", lambda *_: False)
        with pytest.raises(FileError, match="file: cannot be written: it is write-protected"):
            write_whole(tmp_path / "file", b"new")
    assert (tmp_path / "file").read_text() == "old" and len(list(tmp_path.iterdir())) == 2
    longest = tmp_path / ("ä" * 120)
    assert write_whole(longest, b"new").read_bytes() == b"new"


def test_a_folder_that_may_not_be_written(tmp_path: Path) -> None:
    folder = tmp_path / "locked"
    folder.mkdir(mode=0o500)
    if os.access(folder, os.W_OK):
        pytest.skip("who runs the tests may write everywhere")
    with pytest.raises(FileError, match="cannot be written: Permission denied"):
        write_whole(folder / "o", b"new")


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/stdout").exists(), reason="no /dev/stdout")
@pytest.mark.parametrize("name", ["/dev/stdout", "out.txt"])
def test_our_own_output_is_not_replaced(tmp_path: Path, name: str) -> None:
    """What is written to stdout is there alone: what is said goes to stderr."""
    code = "from armflex.cli.main import main; main()"
    command = [sys.executable, "-c", code, "deflect", ROBOTS / "heavy_six" / "arm.toml", "--json", name]
    with (tmp_path / "out.txt").open("wb") as out:
        ran = subprocess.run(
            command,
            cwd=tmp_path,
            stdout=out,
            stderr=subprocess.PIPE,
            check=True,
            env=os.environ | {"PYTHONPATH": str(PACKAGE.parent)},
            timeout=600,
        )
    assert json.loads((tmp_path / "out.txt").read_text())["format"] == "armflex-deflect-1"
    assert b"The tip moves" in ran.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["out.txt"]


def calls(path: Path) -> Iterator[tuple[ast.Call, str, str, set[str]]]:
    """Yield every call in a module, the name called and what it is called on, and the names of streams in memory."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    memory = {
        target.id
        for node in ast.walk(tree)
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Call)
        for target in node.targets
        if isinstance(target, ast.Name) and ast.unparse(node.value.func).split(".")[-1] in ("BytesIO", "StringIO")
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            owner, _, name = ast.unparse(node.func).rpartition(".")
            yield node, name, owner, memory


def writes(node: ast.Call, name: str, owner: str, memory: set[str]) -> bool:
    """Return whether a call writes a file, as far as its name says; what goes nowhere, or to a stream, does not."""
    if owner == "os" and ("os.devnull" in ast.unparse(node) or "closefd=False" in ast.unparse(node)):
        return False
    if name in ("open", "ZipFile") and owner != "os":
        modes = [*node.args[0 if owner else 1 :][:1], *(one.value for one in node.keywords if one.arg == "mode")]
        return any(not isinstance(one, ast.Constant) or set(str(one.value)) & set("wax+") for one in modes)
    if name in TAKES_A_STREAM and owner:
        return not (node.args and isinstance(node.args[0], ast.Name) and node.args[0].id in memory)
    return name in WRITERS or owner.split(".")[0] in MODULES or (owner == "os" and name in OS)


BUILD = PACKAGE / "mechanics" / "engine" / "build.py"
"""Runs while the package is built, when nothing of it can be imported."""


@pytest.mark.slow
def test_every_writer_goes_through_one_function() -> None:
    found = {
        f"{path.relative_to(PACKAGE)}:{node.lineno} {owner}.{name}"
        for path in PACKAGE.rglob("*.py")
        for node, name, owner, memory in calls(path)
        if path.name not in ("whole_file.py", "read_file.py") and path != BUILD and writes(node, name, owner, memory)
    }
    assert not found
    assert "os.O_RDONLY" in (PACKAGE / "storage" / "read_file.py").read_text()
    assert sum(writes(*call) for call in calls(PACKAGE / "storage" / "whole_file.py")) >= 4, "nothing would be found"


@pytest.mark.slow
def test_every_figure_and_every_line_takes_text_as_it_is() -> None:
    """Only these make a figure, or print: in all others a name could be markup."""
    allowed = {
        "Figure": {"plotting.py", "show/report/svg.py"},
        "Console": {"cli/terminal.py"},
        "echo": {"cli/terminal.py"},
    }
    allowed |= {
        "print": {"mechanics/engine/build.py"},
        "secho": set(),
        "Template": {"show/view/meshcat_page.py"},
        "Environment": {"show/report/__init__.py"},
    }
    allowed |= {"rprint": set(), "Markup": set(), "from_markup": set(), "render_str": set()}
    for path in PACKAGE.rglob("*.py"):
        place = path.relative_to(PACKAGE).as_posix()
        for node, name, owner, _ in calls(path):
            plain = name == "print" and owner in ("console()", "self._out", "stream()", "out")
            assert plain or name not in allowed or place in allowed[name], f"{place}:{node.lineno} {name}"
