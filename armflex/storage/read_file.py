"""Reading of files that a user names: regular files alone, and of each no more bytes than are allowed.

A device would fill the memory, a named pipe nobody writes to would be waited for, and the size that the system states
is 0 for both. What the shell hands over as a stream of this process, `/dev/stdin` and `<(command)`, is read as well.
"""

from __future__ import annotations

import errno
import hashlib
import io
import os
import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from armflex.errors import FileError, Place

MOST_BYTES = 500_000_000
"""Of a file of which nothing is known: meshes are the largest."""

OWN_STREAM = re.compile(r"/dev/stdin|(/dev/fd|/proc/(self|\d+)/fd)/\d+")

KINDS = (
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
    (stat.S_ISSOCK, "a socket"),
)


def read_file(path: Path, most: int) -> bytes:
    """Return all bytes of a file; raise as `reading`."""
    with reading(path, most) as file:
        return file.read()


def sha256_of(path: Path) -> str:
    """Return the digest of a file; raise `FileError` where it cannot be read."""
    try:
        return hashlib.sha256(read_file(path, MOST_BYTES)).hexdigest()
    except OSError as error:
        raise FileError(Place(path), f"cannot be read: {error.strerror or error}") from None


def check_file(path: Path, most: int) -> None:
    """Raise what `reading` would, for a library that opens the file by its name."""
    with reading(path, most):
        pass


@contextmanager
def reading(path: Path, most: int) -> Iterator[io.BufferedReader[Any]]:
    """Yield a file's bytes as a stream.

    Args:
        path: A regular file, or a stream of this process by its name.
        most: Bytes that it may have.

    Raises:
        OSError: There is no such file, it may not be read, is no file, or has more bytes; `strerror` says which.
    """
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
    handle = os.open(path, flags)  # which waits for no writer of a named pipe
    try:
        _check(path, handle, most)
    except OSError:
        os.close(handle)
        raise
    with os.fdopen(handle, "rb", buffering=0) as raw, io.BufferedReader(_Bounded(raw, path, most)) as file:
        yield file


def _check(path: Path, handle: int, most: int) -> None:
    there = os.fstat(handle)
    if stat.S_ISDIR(there.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if stat.S_ISREG(there.st_mode):
        if there.st_size > most:
            raise _too_large(path, most)
        return
    if not (stat.S_ISFIFO(there.st_mode) or os.isatty(handle)) or not OWN_STREAM.fullmatch(os.path.abspath(path)):
        kind = next((name for test, name in KINDS if test(there.st_mode)), "something else")
        raise OSError(errno.EINVAL, f"it is {kind}, expected a file", str(path))
    os.set_blocking(handle, True)


class _Bounded(io.RawIOBase):
    """A stream that ends in an error after so many bytes: some files have more than they say."""

    def __init__(self, raw: io.FileIO, path: Path, most: int) -> None:
        super().__init__()
        self._raw, self._path, self._most, self._count = raw, path, most, 0

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: memoryview) -> int:  # pyright: ignore[reportIncompatibleMethodOverride]
        count = self._raw.readinto(buffer) or 0
        self._count += count
        if self._count > self._most:
            raise _too_large(self._path, self._most)
        return count


def _too_large(path: Path, most: int) -> OSError:
    return OSError(errno.EFBIG, f"it is larger than the {most} bytes allowed", str(path))
