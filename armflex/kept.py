"""A folder that keeps finished pieces of long work, so that it goes on from where it was interrupted."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable, Mapping
from io import BytesIO
from pathlib import Path
from typing import TypeVar

import numpy as np

from armflex.conventions import Array
from armflex.errors import FileError, Place, listing
from armflex.whole_file import write_whole

MANIFEST = "map.json"
"""Also where the work is no map: folders that are there already have it."""

Manifest = Mapping[str, object]
Piece = TypeVar("Piece")


def open_kept(folder: Path, manifest: Manifest) -> None:
    """Make a folder, or see that it belongs to this work.

    Args:
        folder: Of this work alone.
        manifest: What the work depends on, by name; whatever JSON can hold.

    Raises:
        FileError: The folder holds other work, whose differences are named, or something else, or cannot be written.
    """
    try:
        folder.mkdir(exist_ok=True)
        kept = {path.name for path in folder.iterdir()}
    except OSError as error:
        raise FileError(Place(folder), f"cannot be a folder of chunks: {error.strerror}") from None
    if MANIFEST in kept:
        _compare(folder / MANIFEST, json.loads(json.dumps(manifest)))
        for half in folder.glob(".*.npz.*"):  # whoever wrote it was killed
            half.unlink(missing_ok=True)
    elif any(not name.startswith(".") for name in kept):
        raise FileError(Place(folder), f"is not empty and holds no {MANIFEST}: expected a new folder")
    else:
        write_whole(folder / MANIFEST, (json.dumps(manifest, indent=1) + "\n").encode())


def read_piece(path: Path, read: Callable[[Mapping[str, Array]], Piece]) -> Piece:
    """Return what `read` makes of a file's arrays; raise `FileError` where it is damaged."""
    try:
        with np.load(path, allow_pickle=False) as file:
            return read(file)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise FileError(Place(path), f"is damaged ({error}): delete it, and it is computed again") from None


def write_piece(path: Path, arrays: Mapping[str, object]) -> None:
    """Write a file of arrays, whole or not at all."""
    file = BytesIO()
    np.savez(file, **arrays)
    write_whole(path, file.getvalue())


def _compare(path: Path, manifest: Manifest) -> None:
    try:
        there = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise FileError(Place(path), f"is damaged ({error}): name another folder") from None
    names = dict.fromkeys((*manifest, *there))
    differ = [_difference(name, there, manifest) for name in names if there.get(name) != manifest.get(name)]
    if differ:
        raise FileError(Place(path), f"belongs to other work ({listing(differ)}): name another folder")


def _difference(name: str, there: Manifest, here: Manifest) -> str:
    return f"{name} is {there.get(name)} there and {here.get(name)} here"
