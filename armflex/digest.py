"""A number that tells whether two objects say the same, in this process or another."""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import BuiltinFunctionType, FunctionType

import numpy as np
import pinocchio as pin

from armflex.errors import Flag, Place


def digest(value: object) -> str:
    """Return 16 hexadecimal digits of what an object says.

    Where a thing was read (`Path`, `Place`) and what was doubtful about it (`Flag`) are not part of what it says: a
    copy of an arm in another folder is the same arm. Objects of unknown kinds count as they would be sent to another
    process, which may tell apart what is the same, never the other way round.
    """
    found = hashlib.sha256()
    for piece in _pieces(value):
        found.update(len(piece).to_bytes(8, "little") + piece)
    return found.hexdigest()[:16]


def _pieces(value: object) -> Iterator[bytes]:
    if isinstance(value, Path | Place | Flag):
        return
    if value is None or isinstance(value, bool | int | float | complex | str | bytes | np.generic):
        yield repr(value.item() if isinstance(value, np.generic) else value).encode()
    elif isinstance(value, np.ndarray):
        yield f"{value.dtype.str} {value.shape}".encode()
        yield np.ascontiguousarray(value).tobytes()
    elif isinstance(value, pin.SE3):
        yield from _pieces(value.homogeneous)
    elif isinstance(value, FunctionType | BuiltinFunctionType):
        yield f"{value.__module__}.{value.__qualname__}".encode()
    else:
        yield from _parts(value)


def _parts(value: object) -> Iterator[bytes]:
    """Yield the pieces of an object that has parts."""
    yield type(value).__qualname__.encode()
    if isinstance(value, Mapping):
        for key in sorted(value, key=str):
            yield from _pieces((key, value[key]))
    elif isinstance(value, list | tuple):
        yield str(len(value)).encode()
        for each in value:
            yield from _pieces(each)
    elif is_dataclass(value) and not isinstance(value, type):
        for field in fields(value):
            yield from _pieces((field.name, getattr(value, field.name)))
    else:
        yield pickle.dumps(value, protocol=4)
