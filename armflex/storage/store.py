"""A folder that keeps finished pieces of long work, so that it goes on from where it was interrupted."""

from __future__ import annotations

import json
import stat
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from armflex.errors import FileError, Place, listing
from armflex.parallel import in_order
from armflex.storage.array_file import HEADER_BYTES, About, Arrays, Layout, read_arrays, write_arrays
from armflex.storage.digest import digest
from armflex.storage.schema import strict_json
from armflex.storage.whole_file import write_whole

MANIFEST = "manifest.json"
"""What a folder is of."""

SUFFIX = ".safetensors"

Piece = TypeVar("Piece")


@dataclass(frozen=True)
class PieceForm(Generic[Piece]):
    """How a piece of work becomes a file.

    Attributes:
        layout: What the file holds.
        described: Returns what is said of a piece, and its arrays.
        made: Returns the piece again from what is said of it, its name under `piece`, and its arrays; raises
            `ValueError` where there is no such one.
    """

    layout: Layout
    described: Callable[[Piece], tuple[Mapping[str, Any], Mapping[str, np.ndarray]]]
    made: Callable[[About, Arrays], Piece]


@dataclass(frozen=True)
class Store(Generic[Piece]):
    """A folder of pieces that belong to one work; each file is there whole or not at all, and says which it is."""

    folder: Path
    form: PieceForm[Piece]
    work: str

    def path(self, name: str) -> Path:
        """Return the file of a piece."""
        return self.folder / f"{name}{SUFFIX}"

    def has(self, name: str) -> bool:
        """Return whether a piece is there."""
        return self.path(name).exists()

    def read(self, name: str) -> Piece:
        """Return a piece; raise `FileError` where its file is damaged, or that of another piece or another work."""
        path, layout = self.path(name), self._layout
        about, arrays, _ = read_arrays(path, layout)
        if (about["work"], about["piece"]) != (self.work, name):
            raise FileError(Place(path), f"is a piece of other work, or another piece, expected {name}; {layout.anew}")
        try:
            return self.form.made(about, arrays)
        except ValueError as error:
            raise FileError(Place(path), f"does not hold {layout.what}: {error}; {layout.anew}") from None

    def write(self, name: str, piece: Piece) -> None:
        """Write a piece."""
        about, arrays = self.form.described(piece)
        write_arrays(self.path(name), self._layout, arrays, {**about, "work": self.work, "piece": name})

    def resumed(
        self, names: Sequence[str], tasks: Callable[[list[bool]], Iterable[Callable[[], Piece]]], jobs: int | None
    ) -> Generator[Piece, None, None]:
        """Yield every piece in order: read where it is kept, else made, and kept.

        Args:
            names: Of the pieces.
            tasks: Returns the tasks that make those pieces for which it is given True.
            jobs: See `in_order`.
        """
        missing = [not self.has(name) for name in names]
        with closing(in_order(tasks(missing), jobs)) as made:
            for name, wanted in zip(names, missing, strict=True):
                if not wanted:
                    yield self.read(name)
                    continue
                piece = next(made)
                self.write(name, piece)
                yield piece

    @property
    def _layout(self) -> Layout:
        about = {**self.form.layout.about, "work": str, "piece": str}
        return replace(self.form.layout, about=about, anew="delete it, and it is computed again")


def open_store(folder: Path, manifest: Mapping[str, object], form: PieceForm[Piece]) -> Store[Piece]:
    """Return the pieces kept in a folder, which is made where there is none.

    Args:
        folder: Of this work alone.
        manifest: What the work depends on, by name; whatever JSON can hold.
        form: How a piece becomes a file.

    Raises:
        FileError: The folder holds other work, whose differences are named, or something else, or cannot be written.
    """
    try:
        folder.mkdir(exist_ok=True)
        there = {path.name for path in folder.iterdir()}
    except OSError as error:
        raise FileError(Place(folder), f"cannot be a folder of chunks: {error.strerror}") from None
    if MANIFEST in there:
        _compare(folder / MANIFEST, json.loads(json.dumps(manifest)))
        for half in folder.glob(f".*{SUFFIX}.*"):  # whoever wrote it was killed
            half.unlink(missing_ok=True)
    elif any(not name.startswith(".") for name in there):
        raise FileError(Place(folder), f"is not empty and holds no {MANIFEST}: expected a new folder")
    else:
        write_whole(folder / MANIFEST, (json.dumps(manifest, indent=1) + "\n").encode())
    return Store(folder, form, digest(json.loads(json.dumps(manifest))))


def _compare(path: Path, manifest: Mapping[str, object]) -> None:
    """Raise `FileError` where a manifest is not this one."""
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode) or status.st_size > HEADER_BYTES:
            raise ValueError(f"it is no file of at most {HEADER_BYTES} bytes")
        there = strict_json(path.read_bytes().decode())
        if not isinstance(there, dict):
            raise ValueError("it names nothing")
    except (OSError, ValueError) as error:
        raise FileError(Place(path), f"is damaged ({error}): name another folder") from None
    differ = [
        f"{_short(name)} is {_short(there.get(name))} there and {_short(manifest.get(name))} here"
        for name in dict.fromkeys((*manifest, *there))
        if name not in manifest or name not in there or json.dumps(there[name]) != json.dumps(manifest[name])
    ]
    if differ:
        raise FileError(Place(path), f"belongs to other work ({listing(differ)}): name another folder")


def _short(value: object) -> str:
    text = str(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
