"""Files that are there whole or not at all, also when the writer is interrupted."""

from __future__ import annotations

import os
import secrets
import shutil
import stat
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from armflex.errors import FileError, Place

ANYBODY = 0o666
"""Mode of a new file, of which the system takes off the process's umask."""

KEPT = 1 << 24
"""Bytes for a pipe or a device that are held in memory until there are more."""

LONGEST = 40
"""Letters of a file's name that a temporary one beside it repeats: the whole of it could be too long with more."""


def write_whole(path: Path, data: bytes) -> Path:
    """Write a file as `writing` does; return the path."""
    with writing(path) as file:
        file.write(data)
    return path


@contextmanager
def writing(path: Path) -> Iterator[IO[bytes]]:
    """Yield a stream whose bytes are the file once the block ends well, and nowhere where it ends in an error.

    They go through a temporary file beside it. A file that is replaced leaves its mode to the new one, a new one has
    the mode of any file that this process creates. Links are followed. What is no file is written to as it is, when the
    block has ended: a pipe, a device, and also this process's own output and error stream, whatever they have been sent
    to, by whichever name.

    Raises:
        FileError: The path is a folder or a write-protected file, or its folder does not exist or cannot be written.
    """
    try:
        there = _status(path)
        stream = _replacing(Path(os.path.realpath(path)), there) if is_replaced(path) else _into(path, there)
        with stream as file:
            yield file
    except OSError as error:
        raise FileError(Place(path), f"cannot be written: {error.strerror or error}") from None


def remove(path: Path) -> None:
    """Remove a file that nobody needs any more; raise `FileError` where that is not possible."""
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise FileError(Place(path), f"cannot be removed: {error.strerror or error}") from None


def is_replaced(path: Path) -> bool:
    """Return whether `write_whole` makes a new file in the path's folder, which must then be writable."""
    there = _status(path)
    return there is None or (stat.S_ISREG(there.st_mode) and _own_stream(there) is None)


def _status(path: Path) -> os.stat_result | None:
    """Return what stands at the end of a path and its links, None where there is nothing yet."""
    try:
        return path.stat()
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
def _into(path: Path, there: os.stat_result | None) -> Iterator[IO[bytes]]:
    number = None if there is None else _own_stream(there)
    with tempfile.SpooledTemporaryFile(KEPT) as whole:
        yield whole
        if number is not None:
            for stream in (sys.stdout, sys.stderr):
                if stream is not None:
                    stream.flush()  # what was said before comes first
        whole.seek(0)
        # A stream opened anew by its name would be written over from its beginning where it is a file.
        with open(path if number is None else number, "wb", closefd=number is None) as file:
            shutil.copyfileobj(whole, file)


@contextmanager
def _replacing(path: Path, there: os.stat_result | None) -> Iterator[IO[bytes]]:
    if there is not None and not os.access(path, os.W_OK):
        raise PermissionError(0, "it is write-protected")
    mode = ANYBODY if there is None else stat.S_IMODE(there.st_mode) & 0o777
    temporary = path.with_name(f".{path.name[:LONGEST]}.{secrets.token_hex(4)}")
    # Never readable by more than the file itself, not even while it is empty.
    handle = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), mode)
    try:
        with os.fdopen(handle, "wb") as file:
            yield file
        if there is not None:
            os.chmod(temporary, mode)
        os.replace(temporary, path)
    except BaseException:
        os.unlink(temporary)
        raise
