"""Named arrays of a declared layout in one file, with what is said about them and a digest of both.

The container is safetensors: a header of names, kinds, shapes and places, then the numbers. What armflex says of them
is strict JSON under one key of that header. Nothing is unpickled, and nothing is allocated for arrays before the header
was found to be what the layout declares and the SHA-256 of the bytes to be what it says.
"""

import hashlib
import json
import math
import stat
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from armflex.errors import FileError, Place
from armflex.storage.schema import Numbers, check_arrays, check_numbers, check_shapes, strict_json, typed
from armflex.storage.whole_file import write_whole

KEY = "armflex"
HEADER_BYTES = 8_000_000
"""What a header may be long: names of arrays, and what is said of them."""
KINDS = {"F64": "f8", "I64": "i8"}

Arrays = dict[str, np.ndarray]
About = dict[str, Any]


class ArrayFile(NamedTuple):
    """What a file says about its arrays, these, and the digest of both."""

    about: About
    arrays: Arrays
    digest: str


@dataclass(frozen=True)
class Layout:
    """What a kind of file holds.

    Attributes:
        what: Its name for people, with its article.
        format: Its name for programs, which ends in a version: "armflex-map-4".
        arrays: Every array; or what returns them from what is said beside.
        about: Name and type of everything that is said beside the arrays, see `typed`.
        sizes: What named sizes of arrays may be; or what returns that from what is said beside.
        anew: What to do where such a file cannot be used.
        most_bytes: How large it may be.
        error: Raised where it cannot be used.
    """

    what: str
    format: str
    arrays: Mapping[str, Numbers] | Callable[[About], Mapping[str, Numbers]]
    about: Mapping[str, Any] = field(default_factory=dict)
    sizes: Mapping[str, Collection[int]] | Callable[[About], Mapping[str, Collection[int]]] = field(
        default_factory=dict
    )
    anew: str = "make it anew"
    most_bytes: int = 256_000_000
    error: type[FileError] = FileError

    def of(self, about: About) -> tuple[Mapping[str, Numbers], Mapping[str, Collection[int]]]:
        """Return the arrays and the sizes that belong to what is said beside them."""
        arrays = self.arrays(about) if callable(self.arrays) else self.arrays
        return arrays, self.sizes(about) if callable(self.sizes) else self.sizes


def write_arrays(path: Path, layout: Layout, arrays: Mapping[str, np.ndarray], about: Mapping[str, Any]) -> str:
    """Write a file, whole or not at all, the same bytes for the same content; return the digest of that.

    Raises:
        FileError: Of the layout's type: the content is not what the layout declares, so that it could not be read
            again; or the file cannot be written.
    """
    try:
        said = json.dumps(dict(about), allow_nan=False)
        declared, sizes = layout.of(typed(layout.about, json.loads(said), "it"))
        laid = {name: np.asarray(values, order="C") for name, values in arrays.items()}
        laid = {name: values.astype(values.dtype.newbyteorder("<"), copy=False) for name, values in laid.items()}
        check_arrays(laid, declared, sizes)
    except (TypeError, ValueError) as error:
        raise layout.error(Place(path), f"{layout.what} was not written: {error}") from None
    content = {"format": layout.format, **about}
    digest = _digest(
        content, {name: (values.dtype.str, values.shape, (_bytes(values),)) for name, values in laid.items()}
    )
    text = json.dumps(content | {"digest": digest}, allow_nan=False, sort_keys=True)
    data = save(laid, metadata={KEY: text})  # several keys would come in any order
    if int.from_bytes(data[:8], "little") > HEADER_BYTES or len(data) > layout.most_bytes:
        raise layout.error(Place(path), f"{layout.what} was not written: {len(data)} bytes are more than could be read")
    write_whole(path, data)
    return digest


def read_arrays(path: Path, layout: Layout) -> ArrayFile:
    """Return what a file holds.

    Raises:
        FileError: Of the layout's type: the file is missing, no file, too large, damaged, of another format or of an
            earlier version, or holds something else than the layout declares. It says what was expected and what to do.
    """
    try:
        return _read(path, layout)
    except OSError as error:
        raise layout.error(Place(path), f"cannot be read: {error.strerror or error}; {layout.anew}") from None
    except ValueError as error:
        problem = str(error).partition("\n")[0]
        raise layout.error(Place(path), f"{problem}; {layout.anew}") from None


def _read(path: Path, layout: Layout) -> ArrayFile:
    there = path.stat()
    size = there.st_size
    if not stat.S_ISREG(there.st_mode):
        raise ValueError(f"is no file, expected {layout.what}")
    if size > layout.most_bytes:
        raise ValueError(f"is {size} bytes, more than the {layout.most_bytes} allowed for {layout.what}")
    with path.open("rb") as file:
        entries, content, start = _header(file, size)
        digest = _check_format(content, layout)
        about, declared = _expected(content, entries, layout)
        blocks = {
            name: (np.dtype(f"<{kind}").str, shape, _blocks(file, start + first, last - first))
            for name, (kind, shape, first, last) in entries.items()
        }
        if digest != _digest(content, blocks):
            raise ValueError("its SHA-256 is not that of its content: the file is damaged")
    try:
        with safe_open(path, framework="numpy") as opened:
            arrays = {name: opened.get_tensor(name) for name in declared if name in entries}
    except SafetensorError as error:
        raise ValueError(f"is no safetensors file that can be read: {error}") from None
    try:
        check_numbers(arrays, declared)
    except ValueError as error:
        raise ValueError(f"does not hold {layout.what}: {error}") from None
    return ArrayFile(about, arrays, digest)


def _header(file: BinaryIO, size: int) -> tuple[dict[str, tuple[str, tuple[int, ...], int, int]], About, int]:
    """Return kind, shape, first and last place of every array, what is said of them, and where the numbers begin."""
    length = int.from_bytes(file.read(8), "little")
    if size < 8 or length > min(size - 8, HEADER_BYTES):
        raise ValueError("is no safetensors file that can be read: its header is cut off or too long")
    try:
        header = strict_json(file.read(length).decode())
        text = header.pop("__metadata__", {}).get(KEY) if isinstance(header, dict) else None
        entries = (
            {name: _entry(name, entry, size - 8 - length) for name, entry in (header or {}).items()} if text else {}
        )
    except (ValueError, AttributeError, TypeError, KeyError) as error:
        raise ValueError(f"is no safetensors file that can be read: header: {error}") from None
    if not isinstance(text, str):
        raise ValueError(f"was not written by armflex: no {KEY!r} in its header")
    try:
        content = strict_json(text)
    except ValueError as error:
        raise ValueError(f"header {KEY!r} is not strict JSON: {error}") from None
    return entries, content, 8 + length


def _entry(name: str, entry: dict[str, Any], most: int) -> tuple[str, tuple[int, ...], int, int]:
    shape, (first, last) = typed(list[int], entry["shape"], name), typed(tuple[int, int], entry["data_offsets"], name)
    kind = KINDS.get(entry["dtype"])
    if kind is None:
        raise ValueError(f"{name!r} is {entry['dtype']!r}, expected {' or '.join(KINDS)}, 64-bit numbers")
    if min(shape, default=0) < 0 or not 0 <= first <= last <= most or last - first != 8 * math.prod(shape):
        raise ValueError(f"{name!r} of shape {shape} is not in bytes {first} to {last} of {most}")
    return kind, tuple(shape), first, last


def _check_format(content: Any, layout: Layout) -> str:
    """Take the digest out of what is said, and return it, where the format is the layout's."""
    stated = content.get("format") if isinstance(content, dict) else None
    if stated != layout.format:
        family = layout.format.rpartition("-")[0]
        if isinstance(stated, str) and stated.rpartition("-")[0] == family:
            raise ValueError(f"was made by another version: it has format {stated!r}, expected {layout.format!r}")
        raise ValueError(f"is not {layout.what}: expected format {layout.format!r}")
    digest = content.pop("digest", None)
    if not isinstance(digest, str):
        raise ValueError("has no SHA-256 of its content")
    return digest


def _expected(
    content: About, entries: Mapping[str, tuple[str, tuple[int, ...], int, int]], layout: Layout
) -> tuple[About, Mapping[str, Numbers]]:
    """Return what is said beside the arrays, and what these are declared to be, where their shapes are that."""
    try:
        about = typed(layout.about, {name: value for name, value in content.items() if name != "format"}, "it")
        declared, sizes = layout.of(about)
        check_shapes({name: entry[:2] for name, entry in entries.items()}, declared, sizes)
    except ValueError as error:
        raise ValueError(f"does not hold {layout.what}: {error}") from None
    return about, declared


def _digest(content: About, arrays: Mapping[str, tuple[str, tuple[int, ...], Any]]) -> str:
    """Return the SHA-256 of what is said and of every array: kind, shape and an iterable of its bytes."""
    whole = hashlib.sha256(json.dumps(content, sort_keys=True).encode())
    for name in sorted(arrays):
        kind, shape, blocks = arrays[name]
        whole.update(f"{name} {kind} {tuple(shape)} ".encode("utf-8", "surrogatepass"))
        for block in blocks:
            whole.update(block)
    return whole.hexdigest()


def _bytes(values: np.ndarray) -> memoryview:
    return values.reshape(-1).data.cast("B") if values.size else memoryview(b"")


def _blocks(file: BinaryIO, start: int, count: int) -> Iterator[bytes]:
    file.seek(start)
    while count > 0 and (block := file.read(min(1 << 20, count))):
        count -= len(block)
        yield block
