"""Names, numbers and tables as C has them."""

import re
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from armflex.arm import Arm
from armflex.conventions import LARGEST_POSITION, Array
from armflex.errors import InputError
from armflex.export.quoting import c_comment, c_string
from armflex.mechanics.engine.tables import ARRAYS, NUMBERS, Tables
from armflex.version import __version__

LENT = ("known", "bounds", "changes", "inertias", "motion")
"""Arrays that a controller has in memory of its own, or has no use for."""

KEYWORDS = (
    "auto break case char const continue default do double else enum extern float for goto if inline int long register "
    "restrict return short signed sizeof static struct switch typedef union unsigned void volatile while _Bool "
    "_Complex _Imaginary"
)


def check_name(name: str) -> None:
    """Raise `InputError` where a name is no identifier of C."""
    if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", name) or name in KEYWORDS.split():
        raise InputError(f"--name {name!r} is no name in C: expected letters, digits and _, no keyword")


def c_head(arm: Arm, functions: str, threads: str, bounds: Iterable[str]) -> str:
    """Return the comment that a file for a controller begins with.

    Args:
        arm: Whose tip it computes.
        functions: Their names, in words.
        threads: How many may ask at once.
        bounds: Lines that say how long a call takes at most, and how much stack.
    """
    lines = [
        f"The tip of the manipulator {arm.robot.urdf.name!r} as it flexes, and joint positions that make up for it.",
        "",
        f"Written by armflex {__version__}: do not edit, export it again. C99; needs math.h, string.h (link with -lm).",
        f"Base frame {arm.robot.base!r}, tip {arm.robot.tip!r}. Units are m, rad, kg, N, s. Numbers are IEEE doubles.",
        "It allocates nothing, calls itself nowhere, and changes no variable outside its functions: any number of",
        f"threads may ask at once{threads}. The covariates, where there are any, are read alone.",
        *bounds,
    ]
    return "\n".join([f"/* {functions}.", " *", *(f" * {c_comment(line)}".rstrip() for line in lines), " */"])


def c_limits(arm: Arm, moved: str) -> str:
    """Return the table of the lowest and highest position of every one of what is `moved`, in words."""
    ends = (np.clip(end, -LARGEST_POSITION, LARGEST_POSITION) for end in (arm.robot.lower, arm.robot.upper))
    limits = zip(arm.joint_names, *ends, strict=True)
    rows = [f"{c_number(pair)}, /* {c_comment(joint)} */" for joint, *pair in limits]
    return c_table("double limits[JOINTS][2]", f"lowest and highest position of every {moved} [rad or m]", rows)


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


def c_real(name: str, what: str, values: Array) -> str:
    """Return an array of numbers behind one another; C has none without length."""
    flat = values.ravel() if values.size else np.zeros(1)
    return _array(f"double {name}[{len(flat)}]", what, [c_number(value) for value in flat])


def c_whole(name: str, what: str, values: np.ndarray) -> str:
    """Return an array of whole numbers; C has none without length."""
    flat = [int(value) for value in values.ravel()] or [0]
    return _array(f"whole {name}[{len(flat)}]", what, [str(value) for value in flat])


def c_arms(name: str, described: Sequence[Tables]) -> list[str]:
    """Return tables of the engine as constants: an array of `arm`, and before it what they point to, each once."""
    tables, names, arms = [], {}, []
    for number, one in enumerate(described):
        fields = [f".{field} = {value}" for field in NUMBERS.split() if (value := getattr(one.struct, field))]
        for field in [field for field in ARRAYS.split() if field in one.arrays and field not in LENT]:
            array = one.arrays[field]
            printed = names.setdefault((field, array.shape, array.tobytes()), f"{name}_{field}_{number}")
            fields.append(f".{field} = {printed}")
            if printed.endswith(f"_{number}"):
                tables.append((c_whole if array.dtype.kind == "i" else c_real)(printed, "", array))
        arms.append("{" + ",\n        ".join(fields) + "},")
    return [*tables, c_table(f"arm {name}[{len(arms)}]", "see engine.h", arms)]


def _array(declared: str, what: str, parts: list[str]) -> str:
    lines, line = [], "   "
    for part in parts:
        if len(line) + len(part) > 110 and line.strip():
            lines.append(line)
            line = "   "
        line += f" {part},"
    comment = f" /* {what} */" if what else ""
    return "\n".join([f"static const {declared} = {{{comment}", *lines, line, "};"])
