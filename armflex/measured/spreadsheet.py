"""Excel workbooks as rows of text, so that they pass the same checks as CSV; openpyxl is imported only here."""

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from zipfile import ZipFile

from armflex.conventions import unprintable
from armflex.errors import Place, TableError, listing
from armflex.storage.read_file import check_file

SUFFIXES = (".xlsx", ".xlsm")

MAX_BYTES = 400_000_000
"""Of a workbook's parts unpacked, as it says itself."""


def sheet_rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield (row, cells) of every row of the one sheet that holds something; of a formula what it gave when saved.

    Raises:
        TableError: openpyxl is missing, or the file is, or it is damaged or too large; it has several sheets that hold
            something, a formula without a value, or text that cannot be shown.
    """
    try:
        from openpyxl import load_workbook
    except ImportError:
        text = "is an Excel workbook, which needs openpyxl: pip install 'armflex[excel]'; or save it as CSV UTF-8"
        raise TableError(Place(path), text) from None
    try:
        check_file(path, MAX_BYTES)
        with ZipFile(path) as parts:
            size = sum(part.file_size for part in parts.infolist())
        if size > MAX_BYTES:
            raise TableError(Place(path), f"holds {size} bytes, more than the {MAX_BYTES} allowed")
        books = (closing(load_workbook(path, read_only=True, data_only=only)) for only in (True, False))
        with next(books) as values, next(books) as formulas:
            full = [sheet for sheet in values.worksheets if any(any(row) for row in sheet.iter_rows(values_only=True))]
            if len(full) != 1:
                names = listing(sheet.title for sheet in full)
                raise TableError(Place(path), f"has {len(full)} sheets that hold something ({names}), expected one")
            width = 0
            pairs = zip(full[0].iter_rows(), formulas[full[0].title].iter_rows(), strict=True)
            for number, (cells, sources) in enumerate(pairs, 1):
                texts = []
                for cell, source in zip(cells, sources, strict=True):
                    if cell.value is None and source.data_type == "f":
                        text = f"formula {source.value} has no value: save the workbook in Excel"
                        raise TableError(Place(path, number), text)
                    value = cell.value
                    texts.append("" if value is None else repr(value) if isinstance(value, float) else str(value))
                if bad := next(filter(None, map(unprintable, texts)), None):
                    raise TableError(Place(path, number), bad[1])
                if any(map(str.strip, texts)):
                    width = width or max(i for i, text in enumerate(texts, 1) if text.strip())
                    shorter = not any(map(str.strip, texts[width:]))  # cells that only have a colour
                    yield number, [*texts, *[""] * (width - len(texts))][: width if shorter else None]
    except OSError as error:
        raise TableError(Place(path), f"cannot be read: {error.strerror or error}") from None
    except TableError:
        raise
    except Exception as error:  # of a damaged file, from whatever depth: zlib, XML, a style without a colour
        problem = " ".join(str(error).split()) or type(error).__name__
        raise TableError(Place(path), f"cannot be read as an Excel workbook: {problem}") from None
