"""The arm as one file of C99 for a controller."""

from __future__ import annotations

import re

from armflex.arm import Arm
from armflex.errors import InputError, UnsupportedError
from armflex.export.exported import Exported

KEYWORDS = (
    "auto break case char const continue default do double else enum extern float for goto if inline int long register "
    "restrict return short signed sizeof static struct switch typedef union unsigned void volatile while"
)


def export(arm: Arm, name: str = "arm") -> Exported:
    """Return the arm as C; see FORMATS for what it declares.

    Args:
        arm: The arm.
        name: What every name with external linkage begins with.

    Raises:
        InputError: The name is no identifier of C.
        UnsupportedError: Something in the arm cannot be said in C; it is named.
    """
    if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", name) or name in KEYWORDS.split():
        raise InputError(f"--name {name!r} is no name in C: expected letters, digits and _, no keyword")
    raise UnsupportedError("this version writes no C yet")
