"""Files that are there whole or not at all, also when the writer is interrupted; several of them all, or none."""

import os
import secrets
import shutil
import stat
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from armflex.errors import FileError, Place


@dataclass
class _Staged:
    """What was written and is not yet in its place.

    Attributes:
        files: Temporary file and place of each.
        streams: Path of each pipe, device or own stream, the number of an own one, and what goes there.
    """

    files: list[tuple[Path, Path]] = field(default_factory=list)
    streams: list[tuple[Path, int | None, IO[bytes]]] = field(default_factory=list)


STDOUT = Path("/dev/stdout")
"""This process's output stream, also where the system has no such file."""

_staged: ContextVar[_Staged | None] = ContextVar("staged", default=None)


def write_whole(path: Path, data: bytes) -> Path:
    """Write a file as `writing` does; return the path."""
    with writing(path) as file:
        file.write(data)
    return path


@contextmanager
def together() -> Iterator[None]:
    """Put all files that are written inside in their places once the block ends well, and none where it does not.

    Until then each stands beside its place, on the disk. Pipes and devices are served before any file is replaced. A
    file that cannot be replaced puts those back that were. A block inside another one is a part of it.

    Raises:
        FileError: As `writing`.
    """
    if _staged.get() is not None:
        yield
        return
    staged = _Staged()
    begun = _staged.set(staged)
    try:
        try:
            yield
        finally:
            _staged.reset(begun)
        for path, number, content in staged.streams:
            with _naming(path):
                _send(path, number, content)
        _replace(staged.files)
    finally:
        for temporary, _ in staged.files:
            temporary.unlink(missing_ok=True)
        for _, _, content in staged.streams:
            content.close()


@contextmanager
def writing(path: Path) -> Iterator[IO[bytes]]:
    """Yield a stream whose bytes are the file once the block ends well, and nowhere where it ends in an error.

    They go through a temporary file beside it; inside `together` it takes its place with all others. A file that is
    replaced leaves its mode to the new one, a new one has the mode of any file that this process creates. Links are
    followed. What is no file is written to as it is, when the block has ended: a pipe, a device, and also the process's
    own output and error stream, whatever they have been sent to, by whichever name.

    Raises:
        FileError: The path is a folder or a write-protected file, or its folder does not exist or cannot be written.
    """
    with together(), _naming(path):
        there, staged = _status(path), _staged.get()
        assert staged is not None
        if is_replaced(path):
            with _beside(Path(os.path.realpath(path)), there, staged) as file:
                yield file
        else:
            with ExitStack() as closed_after_an_error:
                # Bytes for a pipe or a device that are held in memory until there are more.
                whole = closed_after_an_error.enter_context(tempfile.SpooledTemporaryFile(1 << 24))
                yield whole
                staged.streams.append((path, None if there is None else _own_stream(there), whole))
                closed_after_an_error.pop_all()


@contextmanager
def scratch(**files: str) -> Iterator[Path]:
    """Give a folder with some text files for another program to work in; it is gone once the block ends.

    Args:
        files: Text by the file's name, of which the last underscore stands for the dot.
    """
    with tempfile.TemporaryDirectory() as folder:
        for name, text in files.items():
            (Path(folder) / ".".join(name.rsplit("_", 1))).write_text(text, encoding="utf-8")
        yield Path(folder)


def is_replaced(path: Path) -> bool:
    """Return whether `write_whole` makes a new file in the path's folder, which must then be writable."""
    there = _status(path)
    return there is None or (stat.S_ISREG(there.st_mode) and _own_stream(there) is None)


def is_stdout(path: Path) -> bool:
    """Return whether what is written to a path goes to this process's output stream."""
    there = _status(path)
    return there is not None and _own_stream(there) == 1


def _status(path: Path) -> os.stat_result | None:
    """Return what stands at the end of a path and its links, None where there is nothing yet."""
    try:
        return os.fstat(1) if path == STDOUT else path.stat()
    except FileNotFoundError:
        return None


def _own_stream(there: os.stat_result) -> int | None:
    """Return which of this process's streams a file is, 1 or 2, None where it is neither."""
    for number in (1, 2):
        try:
            if os.path.samestat(there, os.fstat(number)):
                return number
        except OSError:  # it has been closed
            continue
    return None


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Raise what the system refuses inside as a `FileError` about a path."""
    try:
        yield
    except OSError as error:
        raise FileError(Place(path), f"cannot be written: {error.strerror or error}") from None


def _send(path: Path, number: int | None, content: IO[bytes]) -> None:
    """Write to a pipe or a device, or to this process's own stream of a number."""
    if number is not None:
        for stream in (sys.stdout, sys.stderr):
            if stream is not None:
                stream.flush()  # what was said before comes first
    content.seek(0)
    # A stream opened anew by its name would be written over from its beginning where it is a file.
    with open(path if number is None else number, "wb", closefd=number is None) as file:
        shutil.copyfileobj(content, file)


@contextmanager
def _beside(path: Path, there: os.stat_result | None, staged: _Staged) -> Iterator[IO[bytes]]:
    """Yield a stream into a temporary file beside a path, which is staged once the block ends well."""
    if there is not None and not os.access(path, os.W_OK):
        raise PermissionError(0, "it is write-protected")
    # Mode of a new file, of which the system takes off the process's umask
    mode = 0o666 if there is None else stat.S_IMODE(there.st_mode) & 0o777
    temporary = _temporary(path)
    # Never readable by more than the file itself, not even while it is empty.
    handle = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), mode)
    try:
        with os.fdopen(handle, "wb") as file:
            yield file
            file.flush()
            os.fsync(handle)  # a disk may find out only now that it is full
        if there is not None:
            os.chmod(temporary, mode)
    except BaseException:
        os.unlink(temporary)
        raise
    staged.files.append((temporary, path))


def _temporary(path: Path) -> Path:
    # Letters of a file's name that a temporary one beside it repeats: the whole of it could be too long with more
    return path.with_name(f".{path.name[:40]}.{secrets.token_hex(4)}")


def _replace(files: list[tuple[Path, Path]]) -> None:
    """Put every temporary file in its place, or leave all places as they were."""
    kept: dict[Path, Path] = {}
    done: list[Path] = []
    try:
        for path in [place for _, place in files if place.exists()] if len(files) > 1 else ():
            kept[path] = _temporary(path)
            with _naming(path):
                try:
                    os.link(path, kept[path])
                except OSError:  # a file system without links
                    shutil.copy2(path, kept[path])
        for temporary, path in files:
            with _naming(path):
                os.replace(temporary, path)
            done.append(path)
    except BaseException:
        for path in done:
            os.replace(kept[path], path) if path in kept else path.unlink(missing_ok=True)
        raise
    finally:
        for path in kept.values():
            path.unlink(missing_ok=True)
