"""What a file must hold, declared: the arrays by shape, kind and bounds, and what JSON says beside them by type."""

import json
import types
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, fields, is_dataclass
from math import isfinite
from types import MappingProxyType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from armflex.conventions import covariance_fault
from armflex.errors import did_you_mean, listing, shown

LARGEST = 1e50
"""Numbers beyond this count as a mistake: products of six of them are finite. What must be positive is no smaller
than its inverse."""

ROUNDING = 1e-8
"""See `covariance_fault`: numbers that are kept as they are lose less than those written as text."""


@dataclass(frozen=True)
class Numbers:
    """An array of a file.

    Attributes:
        shape: Sizes of the axes; a name stands for a size that is the same wherever it stands.
        kind: "f8" or "i8", 64-bit floats or whole numbers.
        least, most: Bounds of every element.
        beside: What an element may be beside: NaN, inf, -inf.
        covariance: Whether the last two axes are those of covariances: symmetric and positive semidefinite.
        optional: Whether it may be left out.
    """

    shape: tuple[int | str, ...]
    kind: Literal["f8", "i8"] = "f8"
    least: float = -LARGEST
    most: float = LARGEST
    beside: tuple[float, ...] = ()
    covariance: bool = False
    optional: bool = False


def check_shapes(
    arrays: Mapping[str, tuple[str, tuple[int, ...]]],
    declared: Mapping[str, Numbers],
    sizes: Mapping[str, Collection[int]],
) -> None:
    """Raise `ValueError` where arrays, given by kind and shape alone, are not those declared.

    Args:
        arrays: Kind and shape of every array, by name.
        declared: What is expected.
        sizes: What named sizes may be; one that is not here may be any.
    """
    for name in arrays:
        if name not in declared:
            hint = did_you_mean(name[:100], declared)
            raise ValueError(f"{shown(name, 60)} is not expected{hint} (expected: {listing(declared)})")
    size_of: dict[str, int] = {}
    for name, numbers in declared.items():
        if name not in arrays:
            if numbers.optional:
                continue
            raise ValueError(f"{name!r} is missing")
        kind, shape = arrays[name]
        if kind != numbers.kind or len(shape) != len(numbers.shape):
            raise ValueError(f"{name!r} is {kind} {shape}, expected {numbers.kind} {_shown(numbers.shape, size_of)}")
        for size, expected in zip(shape, numbers.shape, strict=True):
            allowed = sizes.get(expected, (size,)) if isinstance(expected, str) else (expected,)
            if size not in allowed or (isinstance(expected, str) and size_of.setdefault(expected, size) != size):
                choice = (
                    "" if len(allowed) != 2 or isinstance(allowed, range) else f", {expected} one of {tuple(allowed)}"
                )
                raise ValueError(f"{name!r} has shape {shape}, expected {_shown(numbers.shape, size_of)}{choice}")


def check_numbers(arrays: Mapping[str, np.ndarray], declared: Mapping[str, Numbers]) -> None:
    """Raise `ValueError` where elements of arrays of the declared shapes are not finite, beyond their bounds, or are
    no covariance."""
    for name, values in arrays.items():
        numbers = declared[name]
        with np.errstate(invalid="ignore"):
            good = (values >= numbers.least) & (values <= numbers.most)
            for other in numbers.beside:
                good |= np.isnan(values) if np.isnan(other) else values == other
        if not good.all():
            place = np.unravel_index(int(np.argmin(good)), values.shape)
            where = f"{name!r}{[int(i) for i in place]}" if values.ndim else repr(name)
            raise ValueError(f"{where} is {values[place]:g}, expected {_bounds(numbers)}")
        matrices = values.reshape(-1, *values.shape[-2:]) if numbers.covariance else ()
        if any(covariance_fault(matrix, ROUNDING) for matrix in matrices):
            raise ValueError(f"{name!r} is no covariance: not symmetric, or some variance would be negative")


def check_arrays(
    arrays: Mapping[str, np.ndarray], declared: Mapping[str, Numbers], sizes: Mapping[str, Collection[int]]
) -> None:
    """Raise `ValueError` where arrays are not those declared, see `check_shapes` and `check_numbers`."""
    check_shapes({name: (values.dtype.str[1:], values.shape) for name, values in arrays.items()}, declared, sizes)
    check_numbers(arrays, declared)


def strict_json(text: str) -> Any:
    """Return what JSON says; raise `ValueError` where it names a number that is none, a key twice, or is too deep."""
    try:
        return json.loads(text, parse_constant=_constant, parse_float=_float, object_pairs_hook=_once_each)
    except RecursionError:
        raise ValueError("it is too deep") from None


Makers = Mapping[Any, Callable[[Any], Any]]
"""By type what makes one of a value of JSON, or raises `ValueError`."""


def typed(expected: Any, value: Any, where: str, makers: Makers = MappingProxyType({})) -> Any:
    """Return a value of JSON as what was expected.

    Args:
        expected: A type: `str`, `bool`, `int`, `float`, `X | Y | None`, `list[X]`, `tuple[X, Y]`, `tuple[X, ...]`,
            `dict[str, X]`, a `Literal` of texts or a dataclass of such; a mapping from every key to what its value
            must be; or `Any`.
        value: What JSON said.
        where: Its name, for errors.
        makers: Of other types, or of these in another way.

    Raises:
        ValueError: It is of another type, a key is missing or unknown, or a number is beyond `LARGEST`.
    """
    origin, parts = get_origin(expected), get_args(expected)
    if isinstance(expected, Mapping):
        return _record(expected, value, where, makers)
    if makers and expected in makers:
        try:
            return makers[expected](value)
        except ValueError as error:
            raise ValueError(f"{where}: {error}") from None
    if isinstance(expected, type) and is_dataclass(expected):
        hints = get_type_hints(expected)
        return expected(**_record({field.name: hints[field.name] for field in fields(expected)}, value, where, makers))
    if origin in (Union, types.UnionType):
        return _any_of(parts, value, where, makers)
    if origin is Literal and value not in [part for part in parts if isinstance(value, str)]:
        raise ValueError(f"{where} is {shown(value, 60)}, which is not known{did_you_mean(str(value)[:100], parts)}")
    if origin is dict and isinstance(value, dict):
        return {typed(str, key, where): typed(parts[1], part, f"{where}.{key}", makers) for key, part in value.items()}
    fixed = origin is tuple and parts[-1] is not ...
    if origin in (list, tuple) and isinstance(value, list) and (not fixed or len(parts) == len(value)):
        pairs = enumerate(zip(parts if fixed else parts[:1] * len(value), value, strict=True))
        return origin(typed(kind, part, f"{where}[{i}]", makers) for i, (kind, part) in pairs)
    is_plain = isinstance(expected, type) and expected in _PLAIN and _PLAIN[expected](value)
    if expected is Any or origin is Literal or is_plain:
        number: Any = value
        return float(number) if expected is float else number
    name = expected.__name__ if get_origin(expected) is None else str(expected).partition("[")[0]
    raise ValueError(f"{where} is {shown(value, 60)}, expected {name}")


def _record(expected: Mapping[str, Any], value: Any, where: str, makers: Makers) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise ValueError(f"{where} is {shown(value, 60)}, expected {listing(expected)}")
    for name in sorted(expected.keys() ^ value.keys()):
        problem = "is missing" if name in expected else f"is not expected{did_you_mean(name[:100], expected)}"
        raise ValueError(f"{where}: {shown(name, 60)} {problem}")
    return {name: typed(each, value[name], f"{where}.{name}", makers) for name, each in expected.items()}


def _any_of(parts: tuple[Any, ...], value: Any, where: str, makers: Makers) -> Any:
    problems = []
    for part in parts:
        try:
            return None if part is type(None) and value is None else typed(part, value, where, makers)
        except ValueError as error:
            problems.append(error)
    raise problems[0] if len(parts) == 2 and parts[1] is type(None) else ValueError(f"{where} is {shown(value, 60)}")


def _is_text(value: Any) -> bool:
    try:
        return isinstance(value, str) and value.encode() is not None
    except UnicodeEncodeError:  # half a character
        return False


_PLAIN = {
    str: _is_text,
    bool: lambda value: isinstance(value, bool),
    int: lambda value: type(value) is int and abs(value) < 2**63,
    float: lambda value: type(value) in (int, float) and abs(value) <= LARGEST,
}


def _constant(name: str) -> None:
    raise ValueError(f"{name} in it is no number")


def _float(text: str) -> float:
    if not isfinite(value := float(text)):
        raise ValueError(f"{text} in it is no finite number")
    return value


def _once_each(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table = dict(pairs)
    if len(table) < len(pairs):
        raise ValueError("a key is there twice")
    return table


def _shown(shape: tuple[int | str, ...], sizes: Mapping[str, int]) -> str:
    return f"({', '.join(str(sizes.get(size, size) if isinstance(size, str) else size) for size in shape)})"


def _bounds(numbers: Numbers) -> str:
    if numbers.least == -LARGEST:
        return "a finite number" if numbers.most == LARGEST else f"{numbers.most:g} at most"
    return f"{numbers.least:g} or more" if numbers.most == LARGEST else f"{numbers.least:g} to {numbers.most:g}"
