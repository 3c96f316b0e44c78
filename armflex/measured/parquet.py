"""Parquet files as rows of text, so that they pass the same checks as CSV; pyarrow is imported only here."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from armflex.conventions import unprintable
from armflex.errors import Place, TableError
from armflex.storage.read_file import check_file

MAX_CELLS = 20_000_000
"""Cells beyond which a file is refused unread: a few bytes of Parquet can stand for billions of equal rows."""

MAX_BYTES = 200_000_000
"""Of a file's columns unpacked, as it says itself."""

SUFFIXES = (".parquet", ".pq")


def parquet_rows(path: Path, most: int | None = None) -> Iterator[tuple[int, list[str]]]:
    """Yield (line, cells) of the header and every row; lines count as if it were CSV, nulls are empty cells.

    Args:
        path: The file.
        most: Rows that are held in memory at a time, all where not given.

    Raises:
        TableError: pyarrow is missing, or the file is, or it is damaged or too large, holds more than plain values, or
            text that is not UTF-8.
    """
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError:
        raise TableError(Place(path), "is Parquet, which needs pyarrow: pip install 'armflex[parquet]'") from None
    try:
        check_file(path, MAX_BYTES)
        with parquet.ParquetFile(path) as file:
            texts = _check(path, file)
            count = file.metadata.num_rows
        # Texts as numbered entries: a long one in every row is held once.
        with parquet.ParquetFile(path, read_dictionary=texts) as file:
            names = file.schema_arrow.names
            yield 1, _printable(path, 1, [names])[0]
            line = 2
            for batch in file.iter_batches(most or max(count, 1)):
                columns = [_cells(path, name, batch.column(i)) for i, name in enumerate(names)]
                for cells in _printable(path, line, [list(cells) for cells in zip(*columns, strict=True)]):
                    yield line, cells
                    line += 1
    except UnicodeDecodeError:
        raise TableError(Place(path), "holds text, or a name, that is not UTF-8") from None
    except (pa.ArrowException, OSError) as error:
        reason = getattr(error, "strerror", None) or (str(error).splitlines() or ["damaged"])[0]
        raise TableError(Place(path), f"cannot be read as Parquet: {reason}") from None


def _printable(path: Path, line: int, rows: list[list[str]]) -> list[list[str]]:
    """Return rows from a line on; raise `TableError` at the first cell that cannot be shown."""
    fine: set[str] = set()  # a long text may stand in every row and be held once: it is looked at once
    for number, cells in enumerate(rows, line):
        for cell in cells:
            if cell not in fine and (bad := unprintable(cell)):
                raise TableError(Place(path, number), bad[1])
        fine.update(cells)
    return rows


def _check(path: Path, file: Any) -> list[str]:
    """Return the columns of text; raise `TableError` where a file is too large or holds more than plain values."""
    from pyarrow import types

    metadata, texts = file.metadata, []
    cells = metadata.num_rows * metadata.num_columns
    size = sum(metadata.row_group(i).total_byte_size for i in range(metadata.num_row_groups))
    if cells > MAX_CELLS:
        raise TableError(Place(path), f"holds {cells} cells, more than the {MAX_CELLS} allowed")
    if size > MAX_BYTES:
        raise TableError(Place(path), f"holds {size} bytes, more than the {MAX_BYTES} allowed")
    plain = ("null", "boolean", "integer", "floating", "decimal", "temporal", "string", "large_string")
    for field in file.schema_arrow:
        kind = field.type.value_type if types.is_dictionary(field.type) else field.type
        if not any(getattr(types, f"is_{name}")(kind) for name in plain):
            raise TableError(Place(path, 1), f"column {field.name!r} holds {field.type}, expected numbers or text")
        if types.is_string(kind) or types.is_large_string(kind):
            texts.append(field.name)
    return texts


def _cells(path: Path, name: str, column: Any) -> list[str]:
    from pyarrow import types

    try:
        if types.is_dictionary(column.type):
            entries = [_text(value) for value in column.dictionary.to_pylist()]
            return ["" if i is None else entries[i] for i in column.indices.to_pylist()]
        return [_text(value) for value in column.to_pylist()]
    except UnicodeDecodeError:
        raise
    except (ValueError, OverflowError) as error:  # dates before the year 1 or after 9999
        raise TableError(Place(path, 1), f"column {name!r} holds {column.type} out of range: {error}") from None


def _text(value: object) -> str:
    return "" if value is None else str(value)
