"""Pictures in files, and how text comes into every figure: as it is, for `$` is a letter and begins no formula."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from armflex.errors import InputError
from armflex.storage.whole_file import write_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SUFFIXES = (".png", ".pdf", ".svg")

AS_IT_IS = {"text.parse_math": False, "text.usetex": False}
"""Names come from files. A text keeps what held where it was made, a figure what holds where it is written."""


@contextmanager
def styled(style: Mapping[str, object]) -> Iterator[None]:
    """Draw in a style while the context lasts, every text as it is."""
    import matplotlib as mpl

    whole: dict[Any, Any] = {**style, **AS_IT_IS}
    with mpl.rc_context(whole):
        yield


def check_ending(path: Path) -> None:
    """Raise `InputError` where a file's name does not end as that of a picture."""
    if path.suffix not in SUFFIXES:
        raise InputError(f"{path}: expected a name that ends in {', '.join(SUFFIXES)}")


@contextmanager
def picture(path: Path, width: float, height: float, dpi: float = 100.0) -> Iterator[Figure]:
    """Yield an empty figure [inch], and write what has been drawn there once the context ends.

    Raises:
        InputError: The path does not end in .png, .pdf or .svg.
        FileError: It cannot be written.
    """
    check_ending(path)
    from matplotlib.figure import Figure

    with styled({}):
        figure = Figure(figsize=(width, height), layout="constrained")
        yield figure
        file = BytesIO()
        figure.savefig(file, format=path.suffix[1:], dpi=dpi)
    write_whole(path, file.getvalue())
