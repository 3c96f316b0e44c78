"""Public functions say which argument is of the wrong kind, instead of failing somewhere inside.

What a parameter's annotation says is compared with what was given, by the names of classes: no module is imported to
check what it declares, and names that are imported for type checkers alone mean the same. Arrays are not looked into;
`conventions.real_array` does that where they are used.
"""

from __future__ import annotations

import ast
import inspect
import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache, wraps
from numbers import Integral
from typing import Any, ParamSpec, TypeVar

import numpy as np

from armflex.errors import ArmflexError, ArrayTypeError, shown

P = ParamSpec("P")
T = TypeVar("T")

ANYTHING = ("Any", "object", "ArrayLike", "Array", "ndarray", "T")
"""Names that say nothing that could be checked here."""

PLAIN: dict[str, tuple[type | tuple[type, ...], str]] = {
    "float": ((float, int, np.floating, np.integer), "a number"),
    "int": (Integral, "a whole number"),
    "bool": ((bool, np.bool_), "True or False"),
    "str": (str, "text"),
    "None": (type(None), "None"),
    "Path": (os.PathLike, "a path"),
    "Tabular": ((str, os.PathLike), "the path of a table or a data frame"),
    "Mapping": (Mapping, "a mapping"),
    "dict": (Mapping, "a mapping"),
    "Sequence": ((Sequence, np.ndarray), "a sequence"),
    "tuple": (Sequence, "a sequence"),
    "Iterable": (Iterable, "a sequence"),
    "Callable": (Callable, "a function"),  # type: ignore[dict-item]
    "Progress": (Callable, "a function"),  # type: ignore[dict-item]
}
"""Name in an annotation -> what is accepted for it, and how a message says so."""


def checked_init(kind: type[T]) -> type[T]:
    """Return a class whose arguments are `checked_kinds`; of a dataclass, write it above the other decorator."""
    kind.__init__ = checked_kinds(kind.__init__)
    return kind


def checked_kinds(function: Callable[P, T]) -> Callable[P, T]:
    """Return a function that raises `ArrayTypeError`, naming the argument, where one is of another kind than declared.

    Arguments are looked at once the function has failed, so that control loops pay nothing, and only where it failed
    without a word of its own: what it says of an argument is nearer to the matter.

    Args:
        function: Its annotations are texts, as `from __future__ import annotations` leaves them.
    """
    parameters = inspect.signature(function).parameters.values()
    asked = {
        parameter.name: ast.parse(str(parameter.annotation), mode="eval").body
        for parameter in parameters
        if parameter.annotation is not inspect.Parameter.empty and parameter.kind is not inspect.Parameter.VAR_KEYWORD
    }
    order = [parameter.name for parameter in parameters if parameter.kind is inspect.Parameter.POSITIONAL_OR_KEYWORD]
    named = (parameter.annotation for parameter in parameters if parameter.kind is parameter.VAR_KEYWORD)
    each = next(named, "Any")  # of **joints: float
    others = ast.parse(str(each), mode="eval").body
    declared = {parameter.name for parameter in parameters}
    title = function.__qualname__.removesuffix(".__init__")

    def look(args: tuple, kwargs: Mapping[str, Any]) -> None:
        for name, value in (*zip(order, args, strict=False), *kwargs.items()):
            meant = asked.get(name, None if name in declared else others)
            if meant is not None and not _is(value, meant):
                wanted = " or ".join(_said(meant))
                raise ArrayTypeError(f"{title}: {name} is {shown(value, 60)}, expected {wanted}")

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> T:
        try:
            return function(*args, **kwargs)
        except (TypeError, AttributeError, ValueError, LookupError, StopIteration, OverflowError) as error:
            if not isinstance(error, ArmflexError):
                look(args, kwargs)
            raise

    return call


def _is(value: Any, wanted: ast.expr) -> bool:
    """Return whether a value is what an annotation says."""
    if isinstance(value, str) and "\0" in value and {"Path", "Tabular"} & set(map(_name, ast.walk(wanted))):
        return False  # no system has such a path
    if isinstance(wanted, ast.BinOp):
        return _is(value, wanted.left) or _is(value, wanted.right)
    if isinstance(wanted, ast.Constant):
        return value == wanted.value if isinstance(wanted.value, str) else value is wanted.value
    if not isinstance(wanted, ast.Subscript):
        return _is_a(value, _name(wanted))
    name, inner = _name(wanted.value), wanted.slice
    parts = inner.elts if isinstance(inner, ast.Tuple) else [inner]
    if name == "Literal":
        return any(_is(value, part) for part in parts)
    if not _is_a(value, name) or (isinstance(value, str) and name not in ANYTHING):
        return False
    # What can be gone through once is not gone through here.
    return name in ("Callable", "Iterable", *ANYTHING) or _holds(value, name, parts)


def _holds(value: Any, name: str, parts: list[ast.expr]) -> bool:
    """Return whether what is in a value is what the parts of an annotation say."""
    if isinstance(value, np.ndarray):
        return value.ndim == 1 and _holds(value.tolist(), name, parts)
    if isinstance(value, Mapping):
        return all(_is(key, parts[0]) and _is(item, parts[-1]) for key, item in value.items())
    if isinstance(value, Sequence):
        each = [part for part in parts if getattr(part, "value", None) is not ...]
        fixed = name == "tuple" and len(each) == len(parts)
        fits = not fixed or len(value) == len(each)
        return fits and all(_is(item, each[i if fixed else 0]) for i, item in enumerate(value))
    return True


def _is_a(value: Any, name: str) -> bool:
    if name in ANYTHING:
        return True
    if name in PLAIN:
        number = name in ("float", "int") and isinstance(value, bool | np.bool_)
        if name == "Tabular" and "DataFrame" in _lineage(type(value)):
            return True
        most = {"float": sys.float_info.max, "int": sys.maxsize}.get(name)
        huge = most is not None and isinstance(value, int) and abs(value) > most  # as Python's may be
        return isinstance(value, PLAIN[name][0]) and not number and not huge
    return name in _lineage(type(value))


@cache
def _lineage(kind: type) -> frozenset[str]:
    return frozenset(base.__name__ for base in kind.__mro__)


def _name(wanted: ast.AST) -> str:
    return wanted.attr if isinstance(wanted, ast.Attribute) else getattr(wanted, "id", "Any")


def _said(wanted: ast.expr) -> list[str]:
    """Return what an annotation asks for, in words."""
    if isinstance(wanted, ast.BinOp):
        return list(dict.fromkeys([*_said(wanted.left), *_said(wanted.right)]))
    if isinstance(wanted, ast.Constant):
        return [repr(wanted.value)]
    if isinstance(wanted, ast.Subscript):
        name = _name(wanted.value)
        parts = wanted.slice.elts if isinstance(wanted.slice, ast.Tuple) else [wanted.slice]
        if name == "Literal":
            return [word for part in parts for word in _said(part)]
        inner = " or ".join(_said(parts[-1] if name in ("Mapping", "dict") else parts[0]))
        said = PLAIN[name][1] if name in PLAIN else name
        return [said if name in ("Callable", "Iterable") else f"{said} of {inner}"]
    name = _name(wanted)
    return [PLAIN[name][1] if name in PLAIN else f"{'an' if name[0] in 'AEIOU' else 'a'} {name}"]
