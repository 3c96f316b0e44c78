"""Files that are there whole or not at all, also when the writer is interrupted."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from armflex.errors import FileError, Place


def write_whole(path: Path, data: bytes) -> Path:
    """Write a file through a temporary one beside it; return the path. A device or a pipe is written to as it is.

    Raises:
        FileError: The path is a folder, or its folder does not exist or cannot be written.
    """
    try:
        if path.exists() and not path.is_file():
            path.write_bytes(data)
        else:
            _replace(path.resolve(), data)
    except OSError as error:
        raise FileError(Place(path), f"cannot be written: {error.strerror or error}") from None
    return path


def remove(path: Path) -> None:
    """Remove a file that nobody needs any more; raise `FileError` where that is not possible."""
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise FileError(Place(path), f"cannot be removed: {error.strerror or error}") from None


def _replace(path: Path, data: bytes) -> None:
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except BaseException:
        os.unlink(temporary)
        raise
