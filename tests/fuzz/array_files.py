"""How a file of arrays is spoilt: its bytes, and its content with a digest that is made to agree."""

import copy
import hashlib
import json
import struct
from typing import Any

import numpy as np
from harness import hostile, mutated_bytes, mutated_tree
from hypothesis import strategies as st

Content = tuple[dict[str, Any], dict[str, np.ndarray]]
"""What is said, and the arrays."""


class Spoilt(bytes):
    """A file, which is too long to be shown whole."""

    def __repr__(self) -> str:
        return f"<{len(self)} bytes: {bytes(self[:60])!r}...>"


KINDS = {"<f8": "F64", "<i8": "I64", "<f4": "F32", "<i4": "I32", "|b1": "BOOL", "|u1": "U8"}


def packed(content: Content, claim: dict[str, Any] | None = None) -> bytes:
    """Return a file with this content and the digest of it; `claim` takes the place of parts of the header."""
    said, arrays = content
    said = {name: value for name, value in said.items() if name != "digest"}
    whole = hashlib.sha256(json.dumps(said, sort_keys=True).encode())
    header, place = {}, 0
    for name, values in sorted(arrays.items()):
        whole.update(f"{name} {values.dtype.str} {values.shape} ".encode() + values.tobytes())
        ends = [place, place := place + values.nbytes]
        header[name] = {"dtype": KINDS[values.dtype.str], "shape": list(values.shape), "data_offsets": ends}
    header |= claim or {}
    header["__metadata__"] = {"armflex": json.dumps(said | {"digest": whole.hexdigest()}, sort_keys=True)}
    text = json.dumps(header).encode()
    return struct.pack("<Q", len(text)) + text + b"".join(values.tobytes() for _, values in sorted(arrays.items()))


def unpacked(data: bytes) -> Content:
    """Return the content of a file."""
    (length,) = struct.unpack("<Q", data[:8])
    header = json.loads(data[8 : 8 + length])
    said = json.loads(header.pop("__metadata__")["armflex"])
    kinds, arrays = {name: kind for kind, name in KINDS.items()}, {}
    for name, entry in header.items():
        first, last = (8 + length + place for place in entry["data_offsets"])
        arrays[name] = np.frombuffer(data[first:last], kinds[entry["dtype"]]).reshape(entry["shape"])
    return said, arrays


def spoilt(seed: bytes) -> st.SearchStrategy[Spoilt]:
    """Return a file with its bytes, numbers, arrays, text or header spoilt; all but the first with a right digest."""
    return st.one_of(
        mutated_bytes(seed), _with_arrays(seed), _with_arrays(seed), _with_text(seed), _with_claims(seed)
    ).map(Spoilt)


@st.composite
def _with_text(draw: st.DrawFn, seed: bytes) -> bytes:
    said, arrays = unpacked(seed)
    return packed((draw(mutated_tree(said)), arrays))


@st.composite
def _with_arrays(draw: st.DrawFn, seed: bytes) -> bytes:
    """Spoil numbers, kinds or shapes of one or two arrays."""
    said, arrays = unpacked(seed)
    for _ in range(draw(st.integers(1, 2))):
        if arrays:
            name = draw(st.sampled_from(sorted(arrays)))
            how = draw(
                st.sampled_from(("number", "number", "number", "all", "sign", "kind", "shape", "drop", "rename"))
            )
            values = arrays.pop(name).copy()
            if how == "rename":
                name += "x"
            if how != "drop":
                arrays[name] = _spoilt(draw, values, how)
    return packed((said, arrays))


def _spoilt(draw: st.DrawFn, values: np.ndarray, how: str) -> np.ndarray:
    if values.dtype.str not in ("<f8", "<i8"):  # spoilt before
        return values
    bad = draw(st.sampled_from((np.nan, np.inf, -np.inf, 1e308, -1e308, 1e30, -1.0, 0.0, 2.0, 1e-300, -1e-9)))
    if values.dtype.kind == "i":
        bad = draw(st.sampled_from((-1, 0, 1, 7, 2**31, 2**62, -(2**63))))
    if how == "number" and values.size:
        flat = values.reshape(-1)
        flat[draw(st.integers(0, values.size - 1))] = bad
    elif how == "all":
        values[...] = bad
    elif how == "sign":
        values = np.negative(values)
    elif how == "kind":
        with np.errstate(all="ignore"):
            values = values.astype(draw(st.sampled_from(("<f4", "<i4", "|b1", "|u1", "<i8", "<f8"))))
    elif how == "shape":
        ways = (values[:0], values[None], values[..., None], values.reshape(-1), np.concatenate([values, values]))
        values = ways[draw(st.integers(0, len(ways) - 1))] if values.ndim else values[None]
    return np.ascontiguousarray(values)


@st.composite
def _with_claims(draw: st.DrawFn, seed: bytes) -> bytes:
    """Let the header claim other shapes, places or kinds than there are, terabytes among them."""
    content = unpacked(seed)
    name = draw(st.sampled_from(sorted(content[1])))
    values = content[1][name]
    entry: dict[str, Any] = {"dtype": "F64", "shape": list(values.shape), "data_offsets": [0, values.nbytes]}
    huge = draw(st.sampled_from(([2**40], [2**31, 2**31], [2**62, 2**62, 0], [-1], [1] * 1000, [0, 2**50])))
    ends = draw(st.sampled_from(([0, 2**43], [2**63, 0], [-8, 8], [0, 0], [0], [0, 8, 16], [0.0, 8.0], [True, 8])))
    part, value = draw(
        st.sampled_from((("shape", huge), ("data_offsets", ends), ("dtype", "O"), ("dtype", "BF16"), ("dtype", "U8")))
    )
    entry[part] = value
    if draw(st.booleans()):
        entry[draw(st.sampled_from(("shape", "dtype", "data_offsets")))] = draw(hostile())
    try:
        return packed(copy.deepcopy(content), {name: entry})
    except ValueError:  # a number that JSON has not
        return packed(content, {name: {}})
