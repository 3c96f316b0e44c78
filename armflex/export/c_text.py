"""Names, numbers and tables as C has them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from armflex.errors import InputError
from armflex.export.quoting import c_string

KEYWORDS = (
    "auto break case char const continue default do double else enum extern float for goto if inline int long register "
    "restrict return short signed sizeof static struct switch typedef union unsigned void volatile while _Bool "
    "_Complex _Imaginary"
)

SMALLEST_CHANGE = Path(__file__).with_name("smallest_change.c")


def check_name(name: str) -> None:
    """Raise `InputError` where a name is no identifier of C."""
    if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", name) or name in KEYWORDS.split():
        raise InputError(f"--name {name!r} is no name in C: expected letters, digits and _, no keyword")


def c_table(declared: str, what: str, rows: Sequence[str]) -> str:
    comment = f" /* {what} */" if what else ""
    return f"static const {declared} = {{{comment}\n" + "\n".join(f"    {row}" for row in rows) + "\n};"


def c_names(declared: str, names: Iterable[str]) -> str:
    return f"const char *const {declared}[] = {{{', '.join([*map(c_string, names), 'NULL'])}}};"


def c_number(value: Any) -> str:
    """Return a number, or numbers in braces, so that C reads the same doubles; braces round a zero hold zeros alone."""
    if np.ndim(value) == 0:
        return repr(float(value) + 0.0)
    if not np.any(value):
        return "{" * np.ndim(value) + "0.0" + "}" * np.ndim(value)
    between = ",\n        " if np.shape(value) == (6, 6) else ", "
    return "{" + between.join(map(c_number, value)) + "}"
