"""What instruments write where they have no reading, and values that none can be: one rule for every file."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from armflex.conventions import NUMBER
from armflex.errors import Place, TableError, listing, shown
from armflex.intake.sources import NO_READING, Cells, Source, SourceTable, numbers
from armflex.measured.lost_places import lost

if TYPE_CHECKING:
    from armflex.intake.meanings import Meaning

SEEN_BY = r"(?:num(?:ber)?[ _]?(?:of[ _]?)?)?(?:markers|cameras)(?:[ _]?(?:count|used|seen))?"
KINDS = {
    "there": r"g[üu]ltig(?:keit)?|valid[eo]|a[ck]tiv[eo]?|enabled?|used?|included?|present|detected|valid(?:ity)?"
    r"|(?:is[ _]?)?tracked|tracking(?:[ _]?state)?|visible|visibility|confidence|quality|found"
    rf"|lock(?:ed)?|ok|measured|reliable|{SEEN_BY}",
    "gone": r"outliers?|ausrei(?:ß|ss)er|excluded?|deleted?|removed|ignored?|masked|ung[üu]ltig|verdeckt|occluded"
    r"|lost|missing|invalid|stale|broken|reject(?:ed)?|out[ _]?of[ _]?(?:view|range|volume)"
    r"|(?:err(?:or)?|fault)(?:[ _]?(?:code|flag|state|status|id|no|nr|number))?",
    "open": r"state|status(?:[ _]?code)?|flags?|solution|beam|health",
}
"""Headers of columns that say whether the target was read, by what a number other than 0 says there."""
STATE = re.compile(
    r"(?:is[ _]?|.*[\W_])??(?:" + "|".join(f"(?P<{kind}>{words})" for kind, words in KINDS.items()) + ")", re.I
)

READ = re.compile(
    r"ok(?:ay)?|good|valid|fix(?:ed)?|locked|measured|tracked|tracking|pass(?:ed)?|visible|found|reliable|stable|normal"
    r"|in[ _]range|no[ _]error|i\.? ?o\.?",
    re.IGNORECASE,
)
NOT_READ = re.compile(
    r"(?:.*\W)?(?:missing|lost|invalid|occluded|false|bad|disabled|stale|too few markers|broken|interrupted|blocked"
    r"|out[ _]of[ _](?:volume|view|range)|not[ _](?:visible|found|tracked|valid|measured|ok|locked)"
    r"|no[ _](?:target|signal|data|reading|fix|lock))(?:\W.*)?"
    r"|nok|n\.? ?i\.? ?o\.?|fail(?:ed|ure)?|error|fault|break|none|reject(?:ed)?"
    r"|un(?:locked|tracked|stable|reliable)|timeout|searching",
    re.IGNORECASE,
)
NO = re.compile(r"0(?:\.0*)?|false|f|no|n|nein|non|falsch|faux|off", re.IGNORECASE)
YES = re.compile(r"1(?:\.0*)?|true|t|yes|y|ja|j|oui|s[iíì]|wahr|vrai|on", re.IGNORECASE)
"""What cells say of a reading: words of instruments, and of flags that are named after one of two states."""

MOST_STATES = 8
"""A column with more different cells is no state."""


def without_lost(source: Source, meant: Sequence[Meaning], counted: bool = True) -> Source:
    """Return a file whose coordinates and orientations are empty where its target was lost; a note says how often.

    Columns of states are `counted` where they are of the instrument, and not of a controller that has one of its own.

    Raises:
        TableError: The target is lost in every row, or a column of states does not say in which.
    """
    at = {meaning.name: i for i, meaning in enumerate(meant) if meaning.kind in ("coordinate", "turn")}
    if not {"x", "y", "z"} <= set(at):
        return source
    cells = [source.columns[at[axis]] for axis in "xyz"]
    gone = lost(np.column_stack([numbers(cells) for cells in cells]))
    for one in cells:
        if not isinstance(one, np.ndarray):  # what is neither a number nor nothing is an error, found later
            gone &= [bool(NUMBER.fullmatch(cell) or NO_READING.fullmatch(cell)) for cell in one]
    for meaning, column in zip(meant, source.columns, strict=True):
        if meaning.kind in ("covariate", "unused", "kept") and not isinstance(column, np.ndarray):
            gone |= _unread(source, meaning, column, counted)
    if not gone.any():
        return source
    if gone.all():
        raise TableError(Place(source.path), f"{source.part or 'the target'} is lost in every row")
    return emptied(source, meant, gone, "was lost")


def _unread(source: SourceTable, meaning: Meaning, cells: Sequence[str], counted: bool) -> np.ndarray:
    """Return (N,) where a column says that nothing was read; raise where its states do not say which are readings."""
    asked = meaning.why == "as asked"
    match = STATE.fullmatch((meaning.name if asked else meaning.column).strip()) if meaning.name else None
    kind = match.lastgroup if match else ""
    said = {cell: _is_read(kind, cell) for cell in {*cells}}
    words = not any(map(NUMBER.fullmatch, cells)) and {said[cell] for cell in said if cell} == {True, False}
    answers = {bool(YES.fullmatch(cell)) for cell in said if YES.fullmatch(cell) or NO.fullmatch(cell)}
    plain = meaning.kind == "covariate" and answers == {True, False} and len({*said} - {""}) == 2
    flagged = counted and plain and not asked and len(cells) > MOST_STATES  # yes and no of something that has no name
    usual = Counter(cells).most_common(1)[0][0]
    remark = counted and not (asked or kind or words) and False in said.values() and said[usual] is not False
    if not (kind or words or flagged or remark):
        return np.zeros(len(cells), dtype=bool)
    few = remark or 1 < len(said) <= MOST_STATES
    if few and asked and kind and said[usual] is not False and not any(map(NUMBER.fullmatch, filter(None, said))):
        said = {cell: cell == usual if read is None else read for cell, read in said.items()}  # what was asked to be so
    unknown = [i for i, cell in enumerate(cells) if cell and said[cell] is (False if remark else None)]
    if counted and few and unknown:
        row = unknown[0] if remark else next(i for i, cell in enumerate(cells) if cell != usual)
        name, place = meaning.column, Place(source.path, source.lines[row])
        text = f"{name!r} is {shown(cells[row], 20)} here and {shown(usual, 20)} in most rows: is that a reading?"
        if any(form.fullmatch(cell) for form in (NUMBER, YES, NO) for cell in said if cell):
            text += f" --take '{name}=valid' if 0 is none, '{name}=error' if only 0 is one, '{name}=unused' if all are"
        else:
            others = listing(repr(cell) for cell in dict.fromkeys(cells[i] for i in unknown) if cell != usual)
            text += f" --take '{name}=valid' if {others} is none, '{name}=unused' if all are readings"
        raise TableError(place, f"{text}; else empty x y z of what is none")
    return np.array([said[cell] is False and (few or kind != "gone" or not NUMBER.fullmatch(cell)) for cell in cells])


def _is_read(kind: str | None, cell: str) -> bool | None:
    """Return whether a cell of a column of states says that a target was read; None where it does not say."""
    if NUMBER.fullmatch(cell) or YES.fullmatch(cell) or NO.fullmatch(cell):
        none = bool(NO.fullmatch(cell))
        return {"there": not (none or cell.startswith("-")), "gone": none}.get(kind or "")
    if READ.fullmatch(cell) or (kind == "gone" and cell.lower() in ("", "none")):
        return True
    return False if NOT_READ.fullmatch(cell) else None


def emptied(source: Source, meant: Sequence[Meaning], gone: np.ndarray, why: str) -> Source:
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
