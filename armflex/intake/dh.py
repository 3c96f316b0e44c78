"""A table of Denavit-Hartenberg parameters, as data sheets and programs have it, as an arm file."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from armflex.conventions import UNITS, Array
from armflex.errors import ManyErrors, Place, TableError
from armflex.intake.meanings import BRACKETS, Ask
from armflex.intake.sources import Source, numbers
from armflex.measured.points import LENGTHS

PARAMETERS = {
    "theta": r"(?:theta|θ|th|ϑ)(?:_?(?:i|0|off(?:set)?))?",
    "d": r"d(?:_?i)?",
    "a": r"(?:a|r)(?:_?i|_?\(?i ?- ?1\)?)?",
    "alpha": r"(?:alpha|α|al)(?:_?i|_?\(?i ?- ?1\)?)?",
}
BEFORE = re.compile(r"(?:alpha|α|a)_?\(?i ?- ?1\)?")
"""How a column is called of a row in Craig's, the modified form: it belongs to the link before."""

UPRIGHT = "gravity = [0.0, 0.0, -9.81]     # m/s^2: the base stands upright"

RIGHT = 2.0 * np.pi
"""No angle of a row is beyond this [rad]: numbers beyond it are degrees."""


@dataclass(frozen=True, eq=False)
class DhTable:
    """Rows of an arm, base to tip.

    Attributes:
        rows: (n, 4) theta [rad], d [m], a [m] and alpha [rad].
        form: "standard" or "modified".
        taken: (column, what it is, unit, why) of each column that counts.
    """

    rows: Array
    form: str
    taken: tuple[tuple[str, str, str, str], ...]

    def lines(self, joints: Sequence[str]) -> list[str]:
        """Return [robot] of an arm file, its joints named as in the log."""
        lines = [
            "[robot]",
            f'dh = "{self.form}"',
            UPRIGHT,
            "",
        ]
        lines.append("[robot.joint]")
        for name, (theta, d, a, alpha) in zip(joints, self.rows, strict=True):
            angles = (float(np.round(np.degrees(one), 9)) + 0.0 for one in (theta, alpha))
            lengths = (float(np.round(1e3 * one, 9)) + 0.0 for one in (d, a))
            (theta, alpha), (d, a) = angles, lengths
            lines.append(f"{name} = {{ theta_deg = {theta!r}, d_mm = {d!r}, a_mm = {a!r}, alpha_deg = {alpha!r} }}")
        return lines


def is_dh(source: Source) -> bool:
    """Return whether a table has a, alpha and d or theta among its columns."""
    found = set(_columns(source))
    return {"a", "alpha"} <= found and bool(found & {"d", "theta"})


def read_dh(source: Source, form: str | None, ask: Ask | None) -> DhTable:
    """Return the rows of a table of DH parameters.

    Args:
        source: The table.
        form: "standard" or "modified", None where its columns have to say it.
        ask: Asks where it is open.

    Raises:
        TableError: A cell is no number.
        ManyErrors: A unit or the form are open.
    """
    found, path = _columns(source), source.path
    rows, taken, open_units = np.zeros((len(source.lines), 4)), list[tuple[str, str, str, str]](), list[str]()
    for i, name in enumerate(PARAMETERS):
        if name not in found:
            continue
        at, unit = found[name]
        values = numbers(source.columns[at])
        if (bad := np.flatnonzero(~np.isfinite(values))).size:
            place = Place(path, source.lines[bad[0]])
            raise TableError(place, f"{source.header[at]!r} is {source.columns[at][bad[0]]!r}, expected a number")
        known, why = (LENGTHS if name in "da" else UNITS["angle"]), "its header"
        if unit not in known:
            others = [
                numbers(source.columns[place]) for key, (place, _) in found.items() if (key in "da") == (name in "da")
            ]
            largest = max(float(np.abs(one).max()) for one in others)
            if name not in "da" and largest > RIGHT:
                unit, why = "deg", f"a value of {largest:g} is no angle in rad"
            elif name in "da" and largest > 20.0:
                unit, why = "mm", f"a value of {largest:g} is no length of an arm in m"
            elif ask is not None:
                choices = ("mm", "m") if name in "da" else ("deg", "rad")
                unit, why = ask(f"{path.name}: in which unit is {source.header[at]!r}?", choices), "as answered"
            else:
                example = f"{name} [{'mm' if name in 'da' else 'deg'}]"
                open_units.append(f"{path}: the unit of {source.header[at]!r} is open: write it as {example!r}")
                continue
        rows[:, i] = values * known[unit]
        taken.append((source.header[at], f"DH {name}", unit, why))
    why = "asked for"
    if form is None and any(BEFORE.fullmatch(_bare(name)[0]) for name in source.header):
        form, why = "modified", "a and alpha are of the link before"
    if form is None and ask is not None:
        form, why = (
            ask(f"{path.name}: standard (distal) or modified (Craig) DH?", ("standard", "modified")),
            "as answered",
        )
    if form is None:
        open_units.append(f"{path}: standard (distal) or modified (Craig) DH is open: --dh standard or --dh modified")
    if form is None or open_units:
        raise ManyErrors(open_units)
    return DhTable(rows, form, (*taken, ("(rows)", f"{form} DH", "", why)))


def arm_text(robot: Sequence[str], tip: str, declare: str, tracked: bool) -> str:
    """Return an arm file: what a first calibration frees, and the instruments beside the first target.

    Args:
        robot: Lines of [robot].
        tip: Its last link.
        declare: Tables of instruments, "TIP" for the link that they are on.
        tracked: Whether the first target is read. Arms that only a camera reads are printed, or hobby servos.
    """
    offset, geometry = ("0.01", "1e-3") if tracked else ("0.05", "2e-3")
    lines = [
        *(*robot, "", "[prior]                          # one standard deviation of what calibration may move"),
        *(f"joint_offset = {offset}              # rad", f"geometry = {geometry}                  # m and rad"),
        *(["tool = 0.3                       # m, the target's place in the tip frame"] if tracked else []),
    ]
    return "\n".join([*lines, *(["", declare.replace("TIP", tip)] if declare else [])]) + "\n"


def _bare(header: str) -> tuple[str, str]:
    """Return a column's name and its unit, '' where the header has none."""
    text = header.strip()
    unit = ""
    if match := BRACKETS.fullmatch(text):
        if not re.fullmatch(r"i ?- ?1", match[2].strip()):
            text, unit = match[1], match[2].lower().replace("°", "deg").replace("degrees", "deg")
    elif text.rpartition("_")[2].lower() in {*LENGTHS, *UNITS["angle"]} and "_" in text:
        text, _, unit = text.rpartition("_")
    return text.strip().lower(), unit.lower()


def _columns(source: Source) -> dict[str, tuple[int, str]]:
    """Return where each parameter's column is, and its unit."""
    found: dict[str, tuple[int, str]] = {}
    for i, header in enumerate(source.header):
        word, unit = _bare(header)
        for name, pattern in PARAMETERS.items():
            if re.fullmatch(pattern, word) and name not in found:
                found[name] = i, unit
    return found
