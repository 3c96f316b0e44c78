"""Parquet files as rows of text, so that they pass the same checks as CSV; pyarrow is imported only here."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from armflex.errors import Place, TableError
from armflex.printable import unprintable

MAX_CELLS = 20_000_000
"""Cells beyond which a file is refused unread: a few bytes of Parquet can stand for billions of equal rows."""


def is_parquet(path: Path) -> bool:
    """Return whether a file's name says that it is Parquet."""
    return path.suffix.lower() in (".parquet", ".pq")


def parquet_rows(path: Path) -> list[tuple[int, list[str]]]:
    """Return (line, cells) of the header and every row; lines count as if it were CSV, nulls are empty cells.

    Raises:
        TableError: pyarrow is missing, or the file is, or it is damaged, too large, or holds more than plain values.
    """
    table = _read(path)
    _refuse_nested(path, table.schema)
    columns = [[_text(value) for value in column.to_pylist()] for column in table.columns]
    body = [list(cells) for cells in zip(*columns, strict=True)]
    rows = list(enumerate([list(table.schema.names), *body], 1))
    for line, cells in rows:
        if found := unprintable("\t".join(cells)):
            raise TableError(Place(path, line), found[1])
    return rows


def _read(path: Path) -> Any:
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError:
        raise TableError(Place(path), "is Parquet, which needs pyarrow: pip install 'armflex[parquet]'") from None
    try:
        with parquet.ParquetFile(path) as file:
            cells = file.metadata.num_rows * file.metadata.num_columns
            if cells > MAX_CELLS:
                raise TableError(Place(path), f"holds {cells} cells, more than the {MAX_CELLS} allowed")
            return file.read()
    except (pa.ArrowException, OSError) as error:
        reason = getattr(error, "strerror", None) or str(error).splitlines()[0]
        raise TableError(Place(path), f"cannot be read as Parquet: {reason}") from None


def _refuse_nested(path: Path, schema: Any) -> None:
    from pyarrow import types

    for field in schema:
        if types.is_nested(field.type) or types.is_binary(field.type) or types.is_large_binary(field.type):
            raise TableError(Place(path, 1), f"column {field.name!r} holds {field.type}, expected numbers or text")


def _text(value: object) -> str:
    return "" if value is None else str(value)
