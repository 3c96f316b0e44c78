"""Arrays that people get or give say their shape and unit.

Looked at are the package's names, and the classes that their answers and fields are of: a function, method, property
or field whose annotation is an array names a shape such as `(n, 6)` and a unit such as `[m, rad]`, "dimensionless", or
the units of something else. Arrays of whole numbers and truth values (`np.ndarray`) have a shape alone.
"""

from __future__ import annotations

import functools
import inspect
import re
import sys
from collections.abc import Iterator

import armflex

LEAST = 0.95
"""Share of them that must."""

WITH_UNIT = re.compile(r"\b(?:Array|ArrayLike|OneRow|ManyRows)\b")
ARRAY = re.compile(rf"{WITH_UNIT.pattern}|\bnp\.ndarray\b")
SIZE = r"(?:\.\.\.|(?:\d+ )?(?:\w{1,4}|[a-z]+_[a-z]+)(?: (?:or|[-+*]) \w{1,4})?)"
SHAPE = re.compile(rf"\({SIZE}(?:,|(?:, {SIZE})+,?)\)")
UNIT = re.compile(r"\[[^\]]*(?:\b(?:m|mm|rad|mrad|N|Nm|kg|s|J|Hz)\b|°C)[^\]]*\]|\bdimensionless\b|\bunits?\b", re.I)


def public() -> Iterator[tuple[str, str, str]]:
    """Yield name, annotation and documentation of everything that has one."""
    own = [getattr(armflex, name) for name in armflex.__all__ if name != "__version__"]
    waiting, seen = [*own], set()
    while waiting:
        thing = waiting.pop(0)
        if thing in seen:
            continue
        seen.add(thing)
        if inspect.isclass(thing):
            waiting += [base for base in thing.__bases__ if base.__module__.startswith("armflex")]
            for name, said, text in _members(thing):
                waiting += _classes(said, thing) if thing in own else []
                yield f"{thing.__module__}.{thing.__qualname__}.{name}", said, text
        elif inspect.isfunction(thing):
            waiting += _classes(str(thing.__annotations__.get("return", "")), thing)
            yield f"{thing.__module__}.{thing.__qualname__}", _said(thing), inspect.getdoc(thing) or ""


def _members(thing: type) -> Iterator[tuple[str, str, str]]:
    for name, said in vars(thing).get("__annotations__", {}).items():
        if not name.startswith("_"):
            yield name, str(said), _entry(thing, name)
    for name, member in vars(thing).items():
        made = getattr(member, "fget", None) or getattr(member, "func", None) or getattr(member, "__func__", member)
        if inspect.isfunction(made) and not name.startswith("_"):
            own = [getattr(base, name, None) for base in thing.__mro__]
            yield name, _said(made), "\n".join(one.__doc__ or "" for one in own if one is not None)


def _said(function: object) -> str:
    return ", ".join(str(one) for one in getattr(function, "__annotations__", {}).values())


def _classes(said: str, near: object) -> list[type]:
    known = vars(sys.modules[near.__module__])
    found = [known.get(word) for word in re.findall(r"\w+", said)]
    return [one for one in found if inspect.isclass(one) and one.__module__.startswith("armflex")]


def _entry(thing: type, name: str) -> str:
    """Return what a class says of a field: among its attributes, or under it."""
    listed = re.search(
        rf"^ *(?:\w+, )*{name}(?:, \w+)*:(.*?)(?=^ *\w+(?:, \w+)*: |\Z)", thing.__doc__ or "", re.M | re.S
    )
    under = re.search(rf'^    {name}: .*\n    """(.*?)"""', _source(thing), re.M | re.S)
    return " ".join(one[1] for one in (listed, under) if one)


@functools.cache
def _source(thing: type) -> str:
    return inspect.getsource(thing)


def test_arrays_say_their_shape_and_unit() -> None:
    asked = [one for one in public() if ARRAY.search(one[1])]
    missing = {}
    for name, said, text in asked:
        lacks = [] if SHAPE.search(text) else ["shape"]
        lacks += ["unit"] if WITH_UNIT.search(said) and not UNIT.search(text) else []
        if lacks:
            missing[name] = " and ".join(lacks)
    for name, lacks in sorted(missing.items()):
        print(f"{name}: no {lacks}")
    assert len(asked) > 200
    assert 1.0 - len(missing) / len(asked) >= LEAST, f"{len(missing)} of {len(asked)} do not"
