"""Finished chunks of a map in a folder, so that an interrupted one goes on from where it was."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from armflex.conventions import Array
from armflex.errors import Flag
from armflex.kept import Manifest, open_kept, read_piece, write_piece
from armflex.workspace.question import Answer
from armflex.workspace.tally import Tally


@dataclass(frozen=True)
class Store:
    """A folder of chunks that belong to one map; each file is there whole or not at all."""

    folder: Path

    def has(self, number: int, count: int) -> bool:
        """Return whether a chunk of so many configurations is there."""
        return self._path(number, count).exists()

    def read(self, number: int, count: int) -> Answer:
        """Return a chunk; raise `FileError` where its file is damaged."""
        return read_piece(self._path(number, count), _answer)

    def write(self, number: int, count: int, answer: Answer) -> None:
        """Write a chunk."""
        flags = json.dumps([asdict(flag) for flag in answer.flags])
        arrays = {field.name: getattr(answer.tally, field.name) for field in fields(Tally)}
        write_piece(self._path(number, count), {"flags": flags, **arrays})

    def _path(self, number: int, count: int) -> Path:
        return self.folder / f"chunk-{number:07d}-{count}.npz"


def _answer(arrays: Mapping[str, Array]) -> Answer:
    tally = Tally(**{field.name: arrays[field.name] for field in fields(Tally)})
    return Answer(tally, tuple(Flag(**flag) for flag in json.loads(str(arrays["flags"]))))


def open_store(folder: Path, manifest: Manifest) -> Store:
    """Return the store in a folder of a map's own, which is made where there is none; raises as `open_kept`."""
    open_kept(folder, manifest)
    return Store(folder)
