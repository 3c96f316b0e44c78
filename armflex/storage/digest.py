"""A number that says whether two objects say the same, in this process or another."""

import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import partial
from operator import attrgetter
from pathlib import PurePath
from types import BuiltinFunctionType, CodeType, FunctionType, MethodType
from typing import Any

import numpy as np
import pinocchio as pin

from armflex.errors import DigestError, Flag, Place


def digest(value: object) -> str:
    """Return 16 hexadecimal digits of what an object says.

    Where a thing was read (`Path`, `Place`) and what was doubtful about it (`Flag`) are not part of what it says: a
    copy of an arm in another folder is the same arm. Numbers, texts, arrays, mappings, sequences, sets, enumerations,
    dataclasses and poses are identified by what they hold, functions by their name, those without one by their code. An
    object of another class says what its method `digested` returns.

    Raises:
        DigestError: An object, or a part of it, is none of these.
    """
    hasher = hashlib.sha256()
    for piece in _pieces(value, ()):
        hasher.update(len(piece).to_bytes(8, "little") + piece)
    return hasher.hexdigest()[:16]


def _pieces(value: object, around: tuple[int, ...]) -> Iterator[bytes]:
    """Yield what a value says; `around` are the identities of all that it is a part of."""
    if isinstance(value, PurePath | Place | Flag):
        return
    if id(value) in around:
        raise DigestError(f"a {type(value).__qualname__} holds itself, and has no digest")
    around = (*around, id(value))
    if value is None or value is Ellipsis or isinstance(value, bool | int | float | complex | str | bytes | np.generic):
        yield repr(value.item() if isinstance(value, np.generic) else value).encode("utf-8", "surrogatepass")
    elif isinstance(value, np.ndarray) and not value.dtype.hasobject:
        yield f"{value.dtype.str} {value.shape}".encode()
        yield value.tobytes()
    elif isinstance(value, pin.SE3):
        yield from _pieces(value.homogeneous, around)
    elif isinstance(value, type | BuiltinFunctionType) or (isinstance(value, FunctionType) and "<" not in _name(value)):
        yield _name(value).encode()
    else:
        yield _name(type(value)).encode()
        parts = _parts(value)
        yield str(len(parts)).encode()
        for part in parts:
            yield from _pieces(part, around)


def _parts(value: Any) -> tuple:
    """Return the parts of an object that has some."""
    if hasattr(value, "digested") and not isinstance(value, type):
        return (value.digested(),)
    for kinds, parts in PARTS:
        if isinstance(value, kinds):
            return tuple(parts(value))
    if is_dataclass(value):
        return tuple((field.name, getattr(value, field.name)) for field in fields(value))
    text = f"a {_name(type(value))} has no digest: expected numbers, texts, arrays, mappings, sequences, dataclasses"
    raise DigestError(f"{text} of such, or an object with a method `digested` that returns one of these")


def _inside(function: FunctionType) -> tuple:
    """Return the parts of a lambda, or of a function made by another one."""
    inside = tuple(cell.cell_contents for cell in function.__closure__ or ())
    return (function.__module__, function.__code__, function.__defaults__, function.__kwdefaults__, inside)


PARTS: tuple[tuple[Any, Callable[[Any], Iterable[Any]]], ...] = (
    (Mapping, lambda value: ((key, value[key]) for key in sorted(value, key=str))),
    (list | tuple, tuple),
    (set | frozenset, lambda value: sorted(map(digest, value))),
    (Enum, lambda value: (value.name,)),
    (FunctionType, _inside),
    (CodeType, attrgetter("co_code", "co_names", "co_varnames", "co_consts")),
    (partial, attrgetter("func", "args", "keywords")),
    (MethodType, attrgetter("__func__", "__self__")),
)
"""Type -> the parts of its values; the first that fits counts."""


def _name(value: type | FunctionType | BuiltinFunctionType) -> str:
    return f"{value.__module__}.{value.__qualname__}"
