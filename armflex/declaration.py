"""One table of a TOML file: typed access by key, errors with file and line, unknown keys refused by name."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

from armflex.conventions import Array
from armflex.errors import ArmFileError, Place, did_you_mean, listing

_HEADER = re.compile(r"\s*\[{1,2}\s*([^\]]+?)\s*\]{1,2}")
_KEY = re.compile(r"\s*\"?([A-Za-z0-9_\-]+)\"?\s*=")


class Declaration:
    """A table under a dotted header such as 'flexure.A4'; every access marks its key as known.

    `tomllib` keeps no line numbers, so the line of a key is looked up in the text when an error needs it.
    """

    def __init__(self, table: dict[str, Any], header: str, path: Path, text: str) -> None:
        self.table = table
        self.header = header
        self.path = path
        self.text_lines = text.splitlines()
        self.known: set[str] = set()

    def place(self, key: str = "") -> Place:
        """Return the line of a key, or of the table's header, or the file when neither is found."""
        header, found = "", 0
        for number, line in enumerate(self.text_lines, 1):
            if match := _HEADER.match(line):
                header = match[1].replace('"', "").replace(" ", "")
            is_here = header == self.header
            if is_here and match and not found:
                found = number
            if match and key and header == self.under(key):
                return Place(self.path, number)
            if is_here and key and (match := _KEY.match(line)) and match[1] == key:
                return Place(self.path, number)
        return Place(self.path, found)

    def fail(self, key: str, problem: str) -> ArmFileError:
        """Return the error that says what is wrong with a key of this table."""
        where = f"[{self.header}] {key}" if self.header else key
        return ArmFileError(self.place(key), f"{where}: {problem}")

    def under(self, key: str) -> str:
        """Return the header of a table under this one."""
        return f"{self.header}.{key}" if self.header else key

    def has(self, key: str) -> bool:
        """Return whether a key is given, marking it as known."""
        self.known.add(key)
        return key in self.table

    def raw(self, key: str) -> Any:
        """Return a required value as TOML gives it."""
        if not self.has(key):
            raise ArmFileError(self.place(), f"[{self.header}] needs {key!r}")
        return self.table[key]

    def text(self, key: str, default: str | None = None) -> str:
        """Return a text, or `default` when absent and a default is given."""
        if default is not None and not self.has(key):
            return default
        value = self.raw(key)
        if not isinstance(value, str) or not value.strip():
            raise self.fail(key, f"expected a text, got {value!r}")
        return value

    def choice(self, key: str, options: tuple[str, ...], default: str | None = None) -> str:
        """Return one of `options`."""
        value = self.text(key, default)
        if value not in options:
            hint = did_you_mean(value, options)
            raise self.fail(key, f"{value!r} is not known{hint} (known: {listing(options)})")
        return value

    def flag(self, key: str) -> bool:
        """Return true or false; false when absent."""
        value = self.raw(key) if self.has(key) else False
        if not isinstance(value, bool):
            raise self.fail(key, f"expected true or false, got {value!r}")
        return value

    def number(self, key: str, default: float | None = None) -> float:
        """Return a finite number."""
        if default is not None and not self.has(key):
            return default
        return float(self._array(key, self.raw(key), ((),)))

    def numbers(self, key: str, *shapes: tuple[int, ...]) -> Array:
        """Return finite numbers of one of the given shapes."""
        return self._array(key, self.raw(key), shapes)

    def _array(self, key: str, value: Any, shapes: tuple[tuple[int, ...], ...]) -> Array:
        expected = " or ".join(" x ".join(map(str, shape)) + " numbers" if shape else "a number" for shape in shapes)
        try:
            array = np.asarray(value)
        except ValueError:
            raise self.fail(key, f"rows of different length, expected {expected}") from None
        if array.dtype.kind not in "fiu" or array.shape not in shapes:
            raise self.fail(key, f"expected {expected}, got {value!r}")
        if not np.isfinite(array.astype(float)).all():
            raise self.fail(key, f"not finite: {value!r}")
        return array.astype(float)

    def sub(self, key: str, value: Any | None = None, header: str | None = None) -> Declaration:
        """Return a sub-table as a declaration of its own."""
        table = self.raw(key) if value is None else value
        name = header or self.under(key)
        if not isinstance(table, dict):
            raise self.fail(key, f"expected a table [{name}], got {table!r}")
        return Declaration(table, name, self.path, "\n".join(self.text_lines))

    def subs(self, key: str) -> dict[str, Declaration]:
        """Return the tables [key.NAME] by name; empty when there are none."""
        if not self.has(key):
            return {}
        tables = self.sub(key)
        return {name: tables.sub(name) for name in tables.table}

    def array_of(self, key: str) -> list[Declaration]:
        """Return the tables of [[key]], in order; empty when there are none."""
        if not self.has(key):
            return []
        tables = self.raw(key)
        if not isinstance(tables, list):
            raise self.fail(key, f"expected tables [[{key}]]")
        return [self.sub(key, table, self.under(key)) for table in tables]

    def finish(self) -> None:
        """Raise `ArmFileError` for the first key that nobody asked for."""
        for key in self.table:
            if key not in self.known:
                hint = did_you_mean(key, self.known)
                raise self.fail(key, f"unknown key{hint} (known: {listing(sorted(self.known))})")


def read_toml(path: Path) -> Declaration:
    """Return a TOML file's root table; raise `ArmFileError` where it cannot be read or is not TOML."""
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise ArmFileError(Place(path), f"cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise ArmFileError(Place(path), "is not UTF-8 text") from None
    try:
        return Declaration(tomllib.loads(text), "", path, text)
    except tomllib.TOMLDecodeError as error:
        line = re.search(r"line (\d+)", str(error))
        raise ArmFileError(Place(path, int(line[1]) if line else 0), f"not valid TOML: {error}") from None
