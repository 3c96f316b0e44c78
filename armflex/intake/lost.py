"""What instruments write where they have no reading, and values that none can be: one rule for every file."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from armflex.conventions import NUMBER, Array
from armflex.errors import Place, TableError
from armflex.intake.sources import NO_READING, Cells, SourceTable, numbers

if TYPE_CHECKING:
    from armflex.intake.meanings import Meaning

THERE = r"valid(?:ity)?|(?:is[ _]?)?tracked|tracking(?:[ _]?state)?|visible|visibility|confidence|quality|found"
GONE = r"occluded|lost|missing|invalid|out[ _]?of[ _]?(?:view|range|volume)"
SEEN_BY = r"(?:num(?:ber)?[ _]?(?:of[ _]?)?)?(?:markers|cameras)(?:[ _]?(?:count|used|seen))?"
STATE = re.compile(
    rf"(?:.*[\W_])??(?:(?P<there>{THERE}|{SEEN_BY})|(?P<gone>{GONE})|state|status|flags?)", re.IGNORECASE
)
"""Header of a column that says whether the target was read, or was not."""

NO, YES = re.compile(r"0(?:\.0*)?|false|f|no|n", re.IGNORECASE), re.compile(r"1(?:\.0*)?|true|t|yes|y", re.IGNORECASE)
"""What such a column has."""

NOT_READ = re.compile(
    r"(?:.*\W)?(?:missing|lost|invalid|occluded|false|bad|disabled|too few markers|out of (?:volume|view|range)"
    r"|not (?:visible|found|tracked|valid)|no (?:target|signal|data))(?:\W.*)?",
    re.IGNORECASE,
)

HUGE = 1e15
"""A coordinate beyond this is a length in no unit: 1e15 um is the way to the moon and back. NDI writes -3.697314e28."""

NINES = np.array([[float(f"{'9' * n}.{'9' * k}") for k in range(5)] for n in range(3, 11)])
"""(8, 5) what programs write for a missing number: 999, 999.9 .. 9999999999.9999, with either sign."""


def lost(places: Array) -> np.ndarray:
    """Return (N,) which of (N, 3) places, in any unit, are what instruments write for a target that is lost.

    Such is a place with a coordinate that is no number, none of any length (`HUGE`), or all nines from 9999 on; and
    one whose three coordinates are the same number, if that is 0 (Qualisys, Vicon, most drivers of ROS), all nines, or
    comes more than once: no target is measured twice at exactly (c, c, c).
    """
    size = np.abs(places)
    gone = np.array(~(size < HUGE).all(axis=1) | np.isin(size, NINES[1:]).any(axis=1), dtype=bool)
    equal = ~gone & (places == places[:, :1]).all(axis=1)
    values, index, counts = np.unique(places[equal, 0], return_inverse=True, return_counts=True)
    gone[equal] = (values[index] == 0.0) | np.isin(np.abs(values[index]), NINES) | (counts[index] > 1)
    return gone


def without_lost(source: SourceTable, meant: Sequence[Meaning]) -> SourceTable:
    """Return a file whose coordinates and orientations are empty where its target was lost; a note says how often.

    Args:
        source: The file.
        meant: What its columns are; x, y and z among them, in any unit.

    Raises:
        TableError: The target is lost in every row.
    """
    at = {meaning.name: i for i, meaning in enumerate(meant) if meaning.kind in ("coordinate", "turn")}
    if not {"x", "y", "z"} <= set(at):
        return source
    cells = [source.columns[at[axis]] for axis in "xyz"]
    gone = lost(np.column_stack([numbers(cells) for cells in cells]))
    for one in cells:
        if not isinstance(one, np.ndarray):  # what is neither a number nor nothing is an error, found later
            gone &= [bool(NUMBER.fullmatch(cell) or NO_READING.fullmatch(cell)) for cell in one]
    for header, column in zip(source.header, source.columns, strict=True):
        if (match := STATE.fullmatch(header.strip())) and not isinstance(column, np.ndarray):
            said = (YES,) if match["gone"] else (NOT_READ, NO) if match["there"] else (NOT_READ,)
            gone |= [any(pattern.fullmatch(cell) for pattern in said) for cell in column]
    if not gone.any():
        return source
    if gone.all():
        raise TableError(Place(source.path), f"{source.part or 'the target'} is lost in every row")
    return emptied(source, meant, gone, "was lost")


def emptied(source: SourceTable, meant: Sequence[Meaning], gone: np.ndarray, why: str) -> SourceTable:
    """Return a file whose coordinates and orientations are empty in (N,) rows; a note says how many and why."""
    at = {meaning.name: i for i, meaning in enumerate(meant) if meaning.kind in ("coordinate", "turn")}
    cells = [source.columns[at[axis]] for axis in "xyz"]
    first = next((i for i in np.flatnonzero(gone).tolist() if any(str(column[i]) for column in cells)), None)
    columns: list[Cells] = list(source.columns)
    for i in at.values():
        column = columns[i]
        if isinstance(column, np.ndarray):
            columns[i] = np.where(gone, np.nan, column)
        else:
            columns[i] = tuple("" if none else cell for none, cell in zip(gone, column, strict=True))
    if first is None:  # cells that are empty say it themselves
        return replace(source, columns=tuple(columns))
    example = ", ".join(str(column[first]) for column in cells)
    text = f"{np.count_nonzero(gone)} of {len(gone)} rows of {source.title} have no reading"
    note = f"{text}: the target {why}, as in line {source.lines[first]} ({example})"
    return replace(source, columns=tuple(columns), notes=(*source.notes, note))
