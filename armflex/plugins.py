"""Effects, joint laws, readings and exporters by name: those of armflex, and those of installed distributions.

A distribution adds one by an entry point of a group, see `GROUPS`. Nothing of it is imported before somebody asks for
its name.
"""

import re
from collections.abc import Callable, Iterator, Mapping, MutableMapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import EntryPoint, PackageNotFoundError, entry_points, version
from traceback import walk_tb
from typing import Any, TypeVar

from armflex.errors import PluginError

T = TypeVar("T")

GROUPS = ("armflex.effects", "armflex.laws", "armflex.readings", "armflex.exporters")

HERE = "armflex"
"""The distribution that everything else of a registry is of."""

VERSION = re.compile(r"(>=)?\s*(\d+(?:\.\d+)*)\S*")
"""What [requires] may say: a version, or the least one; what follows the numbers (rc1, +local) is not compared."""


@dataclass(frozen=True)
class Distribution:
    """An installed distribution.

    Attributes:
        name, version: As it calls itself.
    """

    name: str
    version: str


class Registry(MutableMapping[str, T]):
    """Objects of one kind by the names that files and commands use: armflex's first, then those of entry points.

    A program may enter more by `registry[name] = object`; they hold for its own process.
    """

    def __init__(self, group: str, bundled: Mapping[str, T], fault: Callable[[str, Any], str]) -> None:
        """Nothing is loaded yet.

        Args:
            group: Of the entry points, `armflex.effects`.
            bundled: What armflex has.
            fault: (name, object) -> what the object should have been, '' where it is right.
        """
        self.group, self._bundled, self._fault = group, dict(bundled), fault
        self._objects = dict[str, T]()

    def __getitem__(self, name: str) -> T:
        """Return what is called so.

        Raises:
            KeyError: Nothing is.
            PluginError: A distribution's object cannot be imported, is of another kind, or has a name that is taken.
        """
        if name not in self._objects:
            self._objects[name] = self._load(name)
        return self._objects[name]

    def _load(self, name: str) -> T:
        """Return what is called so where nobody asked for it before: a fault of another name is no fault of this."""
        points = [point for point in self._points if point.name == name]
        owners = [*([HERE] if name in self._bundled else ()), *(_owner(point).name for point in points)]
        if len(owners) > 1:
            raise PluginError(f"{self.group}: both {owners[0]} and {owners[1]} have {name!r}: uninstall one of them")
        if not points:
            return self._bundled[name]
        (point,), (owner,) = points, owners
        try:
            loaded = point.load()
        except Exception as error:
            text = f"{self.group}: {point.value!r} of {owner} cannot be imported: {type(error).__name__}: {error}"
            raise PluginError(text) from error
        if expected := self._fault(name, loaded):
            raise PluginError(f"{self.group}: {point.value!r} of {owner} is called {name!r}: {expected}")
        return loaded

    def __setitem__(self, name: str, value: T) -> None:
        self._objects[name] = value

    def __delitem__(self, name: str) -> None:
        del self._objects[name]

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys((*self.names(), *self._objects)))

    def __len__(self) -> int:
        return len(list(iter(self)))

    @contextmanager
    def entered(self, name: str, value: T) -> Iterator[None]:
        """Have an object under a name for a while, in place of what is called so otherwise."""
        before = self.get(name)
        self[name] = value
        try:
            yield
        finally:
            if before is None:
                del self[name]
            else:
                self[name] = before

    def names(self) -> tuple[str, ...]:
        """Return all names, without importing what they are of."""
        return tuple(dict.fromkeys((*self._bundled, *(point.name for point in self._points))))

    def distribution(self, name: str) -> Distribution | None:
        """Return which distribution a name is of, None of armflex's own and of unknown ones."""
        return next((_owner(point) for point in self._points if point.name == name), None)

    @cached_property
    def _points(self) -> list[EntryPoint]:
        """Entry points by distribution; metadata are read once."""
        return sorted(entry_points(group=self.group), key=lambda point: (_owner(point).name, point.name))


def _owner(point: EntryPoint) -> Distribution:
    metadata = point.dist
    if metadata is None:
        return Distribution("an unknown distribution", "0")
    return Distribution(metadata.name, metadata.version)


def blamed(error: Exception) -> str:
    """Return where in a plug-in an error was raised, and of which distribution that is; '' where in none.

    The innermost frame of a module counts that an entry point names, or of one in the same package.
    """
    owners = {
        point.value.partition(":")[0].partition(".")[0]: _owner(point).name
        for group in GROUPS
        for point in entry_points(group=group)
    }
    for frame, line in reversed([*walk_tb(error.__traceback__)]):
        package = str(frame.f_globals.get("__name__", "")).partition(".")[0]
        if package != HERE and package in owners:
            return f"{frame.f_code.co_filename}:{line}: {owners[package]} failed"
    return ""


def missing(name: str, wanted: str) -> str:
    """Return what is wrong with the installed version of a distribution, '' where it is as wanted.

    Args:
        name: Of the distribution.
        wanted: `VERSION` or `>=VERSION`.

    Raises:
        ValueError: `wanted` is neither.
    """
    match = VERSION.fullmatch(wanted.strip())
    if match is None:
        raise ValueError(f"expected a version such as '>=0.1', got {wanted!r}")
    try:
        installed = version(name)
    except PackageNotFoundError:
        return f"needs {name} {wanted}, which is not installed: install it from where {name} is kept"
    numbers = VERSION.fullmatch(installed)
    has = _numbers(numbers[2]) if numbers else ()
    enough = has >= _numbers(match[2]) if match[1] else has == _numbers(match[2])
    there = f"but {installed} is installed: install that from where {name} is kept"
    return "" if enough else f"needs {name} {wanted}, {there}"


def _numbers(text: str) -> tuple[int, ...]:
    """Return the numbers of a version without zeros at its end: 1.2 is 1.2.0."""
    return tuple(map(int, re.sub(r"(\.0+)+$", "", text).split(".")))
