"""What every result can do: a line in a terminal, a table in a notebook, plain values and a data frame for programs."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from operator import attrgetter
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from armflex.errors import Flag, UnsupportedError

if TYPE_CHECKING:
    import pandas

SHOWN = 12
"""Rows of a table in a notebook."""

LEFT_OUT = object()
"""What stands for something that has no plain form, as an arm or a fit."""


class Result:
    """A result that shows itself; a class says what of it is shown.

    Attributes:
        FIELDS: Names of the fields and properties that `to_dict` has, where `content` does not say more.
        ROWS: Which of its attributes is a table: a sequence with a row each, or columns by name.
    """

    FIELDS: ClassVar[tuple[str, ...]] = ()
    ROWS: ClassVar[str] = ""

    def content(self) -> dict[str, Any]:
        """Return what programs get of the result, by name; a name says the unit of what is not SI."""
        return record(self, " ".join(self.FIELDS))

    def to_dict(self) -> dict[str, Any]:
        """Return `content` in plain values, as strict JSON takes them: None for what is not finite."""
        return plain(self.content())

    def to_frame(self) -> pandas.DataFrame:
        """Return the table as a pandas data frame, SI units; numbers of a vector stand in columns of their own.

        Raises:
            UnsupportedError: pandas is not installed.
        """
        try:
            import pandas
        except ImportError:
            raise UnsupportedError("a data frame needs pandas: pip install pandas") from None
        return pandas.DataFrame(self._table())

    def _table(self) -> dict[str, list[Any]]:
        """Return the columns of the table."""
        table = plain(getattr(self, self.ROWS)) if self.ROWS else {}
        if isinstance(table, dict):
            return table
        rows = [flat for row in table for flat in [_flat(row)]]
        return {name: [row.get(name) for row in rows] for name in dict.fromkeys(name for row in rows for name in row)}

    def __repr__(self) -> str:
        """One line: numbers as they are, lists by their length."""
        said = [f"{name}={_brief(value)}" for name, value in self.to_dict().items()]
        return f"<{type(self).__name__}: {', '.join(said)}>"

    def _repr_html_(self) -> str:
        table = self._table()
        rows = list(zip(*table.values(), strict=True))
        cells = "".join(
            f"<tr>{''.join(f'<td>{html.escape(_brief(cell))}</td>' for cell in row)}</tr>" for row in rows[:SHOWN]
        )
        head = "".join(f"<th>{html.escape(name)}</th>" for name in table)
        more = f"<p>and {len(rows) - SHOWN} more</p>" if len(rows) > SHOWN else ""
        return f"<p>{html.escape(repr(self)[1:-1])}</p><table><tr>{head}</tr>{cells}</table>{more}"


def record(result: object, names: str = "", **renamed: str) -> dict[str, Any]:
    """Return attributes of an object: some by their names, others, or attributes of these, under another name."""
    paths = {name: name for name in names.split()} | renamed
    return {name: attrgetter(path)(result) for name, path in paths.items()}


def scaled(errors: Any, factor: float) -> Any:
    """Return an error, or errors by name, in another unit; None where there are none."""
    if isinstance(errors, dict):
        return {name: scaled(value, factor) for name, value in errors.items()}
    return None if errors is None else errors * factor


def plain(value: Any) -> Any:
    """Return a value as JSON has it; dataclasses by their fields, `LEFT_OUT` for what has no plain form."""
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, Flag):
        return str(value)
    if isinstance(value, Result):
        return value.to_dict()
    if isinstance(value, Mapping):
        pairs = ((str(key), plain(item)) for key, item in value.items())
        return {key: item for key, item in pairs if item is not LEFT_OUT}
    if isinstance(value, Sequence):
        return [item for item in map(plain, value) if item is not LEFT_OUT]
    if is_dataclass(value) and all(plain(getattr(value, field.name)) is not LEFT_OUT for field in fields(value)):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    return LEFT_OUT


def _flat(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return a row with the numbers of its lists by themselves."""
    flat: dict[str, Any] = {}
    for name, value in row.items():
        inside = enumerate(value) if isinstance(value, list) else value.items() if isinstance(value, dict) else None
        flat |= {name: value} if inside is None else {f"{name}_{key}": item for key, item in inside}
    return flat


def _brief(value: Any) -> str:
    """Return a value in a word: numbers with four digits, what is long by its length."""
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list | dict) and (len(value) > 3 or any(isinstance(part, list | dict) for part in value)):
        return f"{len(value)} values"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{name}: {_brief(part)}" for name, part in value.items()) + "}"
    return "[" + ", ".join(map(_brief, value)) + "]" if isinstance(value, list) else str(value)
