"""One table of a TOML file: typed access by key, errors with file and line, unknown keys refused by name."""

from __future__ import annotations

import difflib
import re
import tomllib
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from armflex.conventions import LARGEST, UNITS, Array, no_unit, unprintable
from armflex.errors import ArmFileError, Flag, Place, did_you_mean, listing, shown
from armflex.storage.read_file import read_file

_TOKEN = re.compile(
    r'"""(?:\\.|[^\\])*?"""|"(?:\\.|[^"\\\n])*"|'
    r"'''.*?'''|'[^'\n]*'|"
    r"#[^\n]*|\n|[\[\]{}=,]|[^\s\"'#\[\]{}=,]+",
    re.DOTALL,
)
"""Strings and comments whole, so that no bracket or sign in them counts; then line ends, marks, and words."""

_DECIMAL_COMMA = re.compile(r"[=\[,\s]([-+]?[0-9]+),([0-9]+)\s*(?=[],}#]|$)")
"""Two numbers without a blank between them, which may have been meant as one."""

MAX_BYTES = 64_000_000
MAX_DEPTH = 32
"""Tables and lists inside one another; an arm has a quarter of them."""

DEEP = re.compile(r"""(?:^|[\[{,])[ \t]*(?:(?:[\w-]+|"[^"\n]*"|'[^'\n]*')[ \t]*\.[ \t]*){32}""", re.MULTILINE)
"""A dotted key of more parts than there may be."""

LARGEST_INTEGER = 2**63
"""TOML's integers have 64 bits; `tomllib` would take longer ones."""

Keys = tuple[str | int, ...]
"""Way from a file's root to a value: names of tables and keys, places in arrays of tables."""


@dataclass(eq=False)
class Source:
    """A TOML file's text. `tomllib` keeps no line numbers, so they are found here, once an error needs one.

    `flags` are about what it declares and the files that it names, as those who read them add them.
    """

    path: Path
    text: str
    flags: list[Flag] = field(default_factory=list, repr=False)

    def digested(self) -> str:
        """Return nothing: where an arm was read, and with what comments, is no part of what it says."""
        return ""

    def place(self, keys: Keys) -> Place:
        """Return the line of a value or of the nearest table around it; the file when there is none."""
        while keys and keys not in self.lines:
            keys = keys[:-1]
        return Place(self.path, self.lines.get(keys, 0))

    def comma_in(self, line: int) -> str:
        """Return the question whether a line has a decimal comma, '' where it has none."""
        comma = _DECIMAL_COMMA.search(self.text.split("\n")[line - 1]) if line else None
        return "" if comma is None else f": a decimal comma? TOML has points, {comma[1]}.{comma[2]}"

    @cached_property
    def lines(self) -> dict[Keys, int]:
        """Line of every table header and key."""
        lines: dict[Keys, int] = {}
        counts: dict[Keys, int] = {}
        table: Keys = ()
        for words, line in _statements(self.text):
            if words[0] == "[":
                is_array = words[1] == "["
                table = _opened(_names(words), is_array, counts)
                lines.setdefault(table, line)
            elif "=" in words:
                lines.setdefault((*table, *_names(words[: words.index("=")])), line)
        return lines


def _statements(text: str) -> Iterator[tuple[list[str], int]]:
    """Yield the words of every header and of every key with its value, and the line where it starts."""
    words: list[str] = []
    line, start, depth = 1, 1, 0
    for match in _TOKEN.finditer(text + "\n"):
        word = match[0]
        if word == "\n" and depth == 0 and words:
            yield words, start
            words = []
        elif word != "\n" and word[0] != "#":
            start = start if words else line
            words.append(word)
            depth += (word in ("[", "{")) - (word in ("]", "}"))
        line += word.count("\n")


def _names(words: list[str]) -> list[str]:
    names: list[str] = []
    for word in words:
        if word[0] in "\"'":
            names.append(tomllib.loads(f"name = {word}")["name"])
        elif word not in ("[", "]"):
            names.extend(name for name in word.split(".") if name)
    return names


def _opened(names: list[str], is_array: bool, counts: dict[Keys, int]) -> Keys:
    """Return the way to the table that a header opens; a name of an array means its last table."""
    keys: Keys = ()
    for i, name in enumerate(names):
        keys = (*keys, name)
        if is_array and i == len(names) - 1:
            counts[keys] = counts.get(keys, 0) + 1
        if keys in counts:
            keys = (*keys, counts[keys] - 1)
    return keys


@dataclass(eq=False)
class Declaration:
    """A table such as [flexure.A4]; every access marks its key as known."""

    table: dict[str, Any]
    keys: Keys
    source: Source
    known: set[str] = field(default_factory=set)

    @property
    def path(self) -> Path:
        """The file."""
        return self.source.path

    @property
    def header(self) -> str:
        """The dotted header, empty for the file's root."""
        return ".".join(key for key in self.keys if isinstance(key, str))

    def place(self, key: str = "") -> Place:
        """Return the line of a key, or of the table's header where the key is not given, or the file."""
        return self.source.place((*self.keys, key) if key else self.keys)

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
            problem = f"[{self.header}] needs {key!r}" if self.keys else f"needs a table [{key}]"
            near = difflib.get_close_matches(key, self.table.keys() - self.known, n=1, cutoff=0.75)
            raise ArmFileError(self.place(*near), f"{problem}; is {near[0]!r} meant to be it?" if near else problem)
        return self.table[key]

    def text(self, key: str, default: str | None = None) -> str:
        """Return a text, or `default` when absent and a default is given."""
        if default is not None and not self.has(key):
            return default
        value = self.raw(key)
        if not isinstance(value, str) or not value.strip() or "\0" in value:
            raise self.fail(key, f"expected a text, got {shown(value)}")
        return value

    def texts(self, key: str) -> tuple[str, ...]:
        """Return a list of texts."""
        value = self.raw(key)
        if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
            raise self.fail(key, f"expected texts in a list, got {shown(value)}")
        return tuple(value)

    def choice(
        self, key: str, options: Collection[str], default: str | None = None, problem: str = "{!r} is not known"
    ) -> str:
        """Return one of `options`; `problem` is what is said of anything else."""
        value = self.text(key, default)
        if value not in options:
            hint = did_you_mean(value, options)
            raise self.fail(key, f"{problem.format(value)}{hint} (known: {listing(options)})")
        return value

    def flag(self, key: str) -> bool:
        """Return true or false; false when absent."""
        value = self.raw(key) if self.has(key) else False
        if not isinstance(value, bool):
            raise self.fail(key, f"expected true or false, got {shown(value)}")
        return value

    def number(self, key: str, default: float | None = None) -> float:
        """Return a finite number up to `LARGEST`."""
        if default is not None and not self.has(key):
            return default
        return float(self._array(key, self.raw(key), ((),)))

    def quantity(self, key: str, kind: str, default: float = 0.0) -> float:
        """Return a number in SI, or `default`; the key may end in a unit of its kind, as a table's header: `d_mm`."""
        given = [name for name in self.table if name == key or name.startswith(f"{key}_")]
        self.known |= {key, *given}
        if not given:
            return default
        if len(given) > 1:
            raise self.fail(given[1], f"stands beside {given[0]!r}: give one of them")
        unit = given[0].removeprefix(key).removeprefix("_")
        if unit and unit not in UNITS[kind]:
            raise self.fail(given[0], no_unit(unit, kind))
        return UNITS[kind].get(unit, 1.0) * self.number(given[0])

    def std(self, key: str, default: float | None = None) -> float:
        """Return a number that is not below 0."""
        value = self.number(key, default)
        if value < 0.0:
            raise self.fail(key, f"a standard deviation cannot be negative, got {value:g}")
        return value

    def numbers(self, key: str, *shapes: tuple[int, ...]) -> Array:
        """Return finite numbers up to `LARGEST`, of one of the given shapes."""
        return self._array(key, self.raw(key), shapes)

    def ragged(self, key: str, lengths: Sequence[int], expected: str) -> list[Array]:
        """Return rows of finite numbers up to the square of `LARGEST`, as covariances may be.

        Args:
            key: The key, which must be given.
            lengths: How many each row has.
            expected: What the rows are, for who gave others.
        """
        rows = self.raw(key)
        if not isinstance(rows, list) or [len(row) if isinstance(row, list) else -1 for row in rows] != list(lengths):
            raise self.fail(key, f"expected {expected}")
        return [self._array(key, row, ((length,),), LARGEST**2) for row, length in zip(rows, lengths, strict=True)]

    def _array(self, key: str, value: Any, shapes: tuple[tuple[int, ...], ...], most: float = LARGEST) -> Array:
        expected = " or ".join(" x ".join(map(str, shape)) + " numbers" if shape else "a number" for shape in shapes)
        try:
            array = np.asarray(value)
        except ValueError:
            raise self.fail(key, f"rows of different length, expected {expected}") from None
        if array.dtype.kind not in "fiu" or array.shape not in shapes or _has_bool(value):
            hint = self.source.comma_in(self.place(key).line) if array.ndim else ""
            raise self.fail(key, f"expected {expected}, got {shown(value)}{hint}")
        array = array.astype(float)
        if not np.isfinite(array).all():
            raise self.fail(key, f"not finite: {shown(value)}")
        if np.abs(array).max(initial=0.0) > most:
            raise self.fail(key, f"beyond {most:g}, which nothing is in SI units: {shown(value)}")
        return array

    def sub(self, key: str) -> Declaration:
        """Return a sub-table as a declaration of its own."""
        table = self.raw(key)
        if not isinstance(table, dict):
            raise self.fail(key, f"expected a table [{self.under(key)}], got {shown(table)}")
        return Declaration(table, (*self.keys, key), self.source)

    def part(self, key: str) -> Declaration:
        """Return a sub-table, an empty one when absent."""
        return self.sub(key) if self.has(key) else Declaration({}, (*self.keys, key), self.source)

    def subs(self, key: str) -> dict[str, Declaration]:
        """Return the tables [key.NAME] by name; empty when there are none."""
        tables = self.part(key)
        return {name: tables.sub(name) for name in tables.table}

    def by_name(self, *shape: int) -> dict[str, Array]:
        """Return finite numbers of one shape under every key of this table."""
        return {name: self.numbers(name, shape) for name in self.table}

    def among(self, names: Collection[str], problem: str) -> None:
        """Raise `ArmFileError` for the first key that is none of some names; `problem` is what is said of it."""
        for key in [key for key in self.table if key not in names]:
            raise self.fail(key, f"{problem.format(key)}{did_you_mean(key, names)}")

    def array_of(self, key: str) -> list[Declaration]:
        """Return the tables of [[key]], in order; empty when there are none."""
        if not self.has(key):
            return []
        tables = self.raw(key)
        if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
            raise self.fail(key, f"expected tables [[{self.under(key)}]]")
        return [Declaration(table, (*self.keys, key, i), self.source) for i, table in enumerate(tables)]

    def finish(self) -> None:
        """Raise `ArmFileError` for the first key that nobody asked for."""
        for key in self.table:
            if key not in self.known:
                hint = did_you_mean(key, self.known)
                raise self.fail(key, f"unknown key{hint} (known: {listing(sorted(self.known))})")


def _has_bool(value: Any) -> bool:
    """Return whether true or false stands among numbers, where numpy would take it for 1 or 0."""
    return any(map(_has_bool, value)) if isinstance(value, list) else isinstance(value, bool)


def read_toml(path: Path) -> Declaration:
    """Return a TOML file's root table.

    Raises:
        ArmFileError: It cannot be read, is not TOML, larger than `MAX_BYTES` or nested deeper than `MAX_DEPTH`, or
            holds an integer of more than 64 bits.
    """
    try:
        text = read_file(path, MAX_BYTES).decode("utf-8-sig")
    except OSError as error:
        raise ArmFileError(Place(path), f"cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise ArmFileError(Place(path), "is not UTF-8 text: save it as UTF-8") from None
    source = Source(path, text)
    if deep := DEEP.search(text):  # which tomllib reads in a time that grows with the square of its parts
        where = Place(path, text.count("\n", 0, deep.end()) + 1)
        raise ArmFileError(where, f"nested deeper than {MAX_DEPTH} tables or lists")
    try:
        root = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        line_text = re.search(r"line (\d+)", str(error))
        line = int(line_text[1]) if line_text else 0
        raise ArmFileError(Place(path, line), f"not valid TOML: {error}{source.comma_in(line)}") from None
    except RecursionError:
        raise ArmFileError(Place(path), f"nested deeper than {MAX_DEPTH} tables or lists") from None
    except ValueError:  # Python's own limit on the digits of an integer
        raise ArmFileError(Place(path), "not valid TOML: an integer has more than 64 bits") from None
    _check_values(root, source)
    return Declaration(root, (), source)


def _check_values(root: dict[str, Any], source: Source) -> None:
    """Raise where a file is nested too deeply, holds a longer integer than TOML has, or text that cannot be shown."""
    # Iterative: dotted keys nest without the parser's own stack.
    stack: list[tuple[Any, Keys]] = [(root, ())]
    while stack:
        value, keys = stack.pop()
        if len(keys) > MAX_DEPTH:
            raise ArmFileError(source.place(keys), f"nested deeper than {MAX_DEPTH} tables or lists")
        if isinstance(value, int) and not -LARGEST_INTEGER <= value < LARGEST_INTEGER:
            raise ArmFileError(source.place(keys), "not valid TOML: an integer has more than 64 bits")
        for word in [*(value if isinstance(value, dict) else ()), *([value] if isinstance(value, str) else ())]:
            if bad := unprintable(word):
                at = (*keys, word) if isinstance(value, dict) else keys
                raise ArmFileError(source.place(at), f"{word!r} {bad[1]}")
        inside = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
        stack.extend((item, (*keys, key)) for key, item in inside)
