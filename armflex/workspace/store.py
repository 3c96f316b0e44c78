"""Finished chunks of a map in a folder, so that an interrupted one goes on from where it was."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from io import BytesIO
from pathlib import Path

import numpy as np

from armflex.errors import FileError, Flag, Place, listing
from armflex.whole_file import write_whole
from armflex.workspace.question import Answer
from armflex.workspace.tally import Tally

MANIFEST = "map.json"
Manifest = Mapping[str, object]


@dataclass(frozen=True)
class Store:
    """A folder of chunks that belong to one map; each file is there whole or not at all."""

    folder: Path

    def has(self, number: int, count: int) -> bool:
        """Return whether a chunk of so many configurations is there."""
        return self._path(number, count).exists()

    def read(self, number: int, count: int) -> Answer:
        """Return a chunk; raise `FileError` where its file is damaged."""
        path = self._path(number, count)
        try:
            with np.load(path, allow_pickle=False) as file:
                tally = Tally(**{field.name: file[field.name] for field in fields(Tally)})
                flags = tuple(Flag(**flag) for flag in json.loads(str(file["flags"])))
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
            raise FileError(Place(path), f"is damaged ({error}): delete it, and it is computed again") from None
        return Answer(tally, flags)

    def write(self, number: int, count: int, answer: Answer) -> None:
        """Write a chunk."""
        file = BytesIO()
        flags = json.dumps([asdict(flag) for flag in answer.flags])
        np.savez(file, flags=flags, **{field.name: getattr(answer.tally, field.name) for field in fields(Tally)})
        write_whole(self._path(number, count), file.getvalue())

    def _path(self, number: int, count: int) -> Path:
        return self.folder / f"chunk-{number:07d}-{count}.npz"


def open_store(folder: Path, manifest: Manifest) -> Store:
    """Return the store in a folder, which is made where there is none.

    Args:
        folder: Of this map alone.
        manifest: What the map depends on, by name; whatever JSON can hold.

    Raises:
        FileError: The folder holds another map, whose differences are named, or something else, or cannot be written.
    """
    try:
        folder.mkdir(exist_ok=True)
        kept = {path.name for path in folder.iterdir()}
    except OSError as error:
        raise FileError(Place(folder), f"cannot be a folder of chunks: {error.strerror}") from None
    if MANIFEST in kept:
        _compare(folder / MANIFEST, json.loads(json.dumps(manifest)))
        for half in folder.glob(".chunk-*"):  # whoever wrote it was killed
            half.unlink(missing_ok=True)
    elif any(not name.startswith(".") for name in kept):
        raise FileError(Place(folder), f"is not empty and holds no {MANIFEST}: expected a new folder")
    else:
        write_whole(folder / MANIFEST, (json.dumps(manifest, indent=1) + "\n").encode())
    return Store(folder)


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
