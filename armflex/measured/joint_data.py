"""A joint on a test bench or in FE analysis: loads in, deflections out. Units are part of every file."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from armflex.arguments import checked_kinds
from armflex.conventions import TWIST_NAMES, UNITS, WRENCH_NAMES, Array, finite_array, no_unit
from armflex.errors import Frame, NotFiniteError, Place, ShapeError, TableError, UnitError, did_you_mean, listing
from armflex.measured.table import Table, Tabular, read_table, split_header
from armflex.result import Result

KINDS = {
    **dict.fromkeys(WRENCH_NAMES[:3], "force"),
    **dict.fromkeys(WRENCH_NAMES[3:], "moment"),
    **dict.fromkeys(TWIST_NAMES[:3], "length"),
    **dict.fromkeys(TWIST_NAMES[3:], "angle"),
}

ONE_AXIS = {
    **dict.fromkeys(("moment", "torque"), "moment"),
    **dict.fromkeys(("rotation", "angle"), "angle"),
    "force": "force",
    **dict.fromkeys(("shift", "displacement"), "length"),
}
"""Columns of a bench that loads one axis and does not name it."""

LARGEST = 1e12
"""No bench loads or deflects by more of any SI unit; the square of anything within is far from overflowing."""
TOO_LARGE = "which no bench reaches"


@dataclass(frozen=True, repr=False)
class JointData(Result):
    """Loads and the deflections they gave.

    Attributes:
        loads: (N, k) [N, N m], k = 3 for forces only, 6 with moments.
        deflections: (N, k) [m, rad].
        units: Unit of each deflection column as the file has it.
        factors: (k,) of those units to SI.
        sha256: Of the file.
        path: Where it was read from: a file, or a data frame.
        covariates: Further columns, as text.

    Raises:
        ShapeError: Loads and deflections are not both (N, 3) or (N, 6), or there is not a unit for each column.
        ArrayTypeError, NotFiniteError: One holds something other than numbers up to 1e12.
    """

    loads: Array
    deflections: Array
    units: tuple[str, ...]
    factors: Array
    sha256: str
    path: Path | Frame
    covariates: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    FIELDS = ("table", "units", "sha256")
    ROWS = "table"

    @property
    def table(self) -> dict[str, Any]:
        """Loads [N, Nm], deflections [m, rad] and further columns, (N,) each."""
        loads = dict(zip(WRENCH_NAMES, self.loads.T, strict=False))
        return loads | dict(zip(TWIST_NAMES, self.deflections.T, strict=False)) | dict(self.covariates)

    def __post_init__(self) -> None:
        shape = np.shape(self.loads)
        if len(shape) != 2 or shape[1] not in (3, 6):
            raise ShapeError(f"loads: expected (rows, 3) or (rows, 6), got {shape}")
        for name in ("loads", "deflections"):
            values = finite_array(getattr(self, name), name, shape).astype(np.float64, copy=False)
            if np.abs(values).max(initial=0.0) > LARGEST:
                raise NotFiniteError(f"{name}: a number is beyond {LARGEST:g} of its SI unit")
            object.__setattr__(self, name, values)  # a list of rows is taken, too
        if len(self.units) != shape[1] or np.shape(self.factors) != shape[1:]:
            raise ShapeError(f"units {self.units} and factors {self.factors}: expected one for each of {shape[1]}")

    def __len__(self) -> int:
        return len(self.loads)

    @property
    def size(self) -> int:
        """Number of components, 3 or 6."""
        return self.loads.shape[1]


@checked_kinds
def read_joint_data(path: Tabular, read_as: Mapping[str, str] | None = None) -> JointData:
    """Read a joint_data.csv, or a data frame of the same columns.

    Args:
        path: The file or data frame: columns fx fy fz [mx my mz] and dx dy dz [rx ry rz], each with its
            unit as a suffix, or in brackets; names and units in capitals or small.
        read_as: Units to be read as others, such as {"mm": "um"}, where a header is probably wrong.

    Raises:
        TableError: A column is missing, misspelt or not numeric, or there are no more rows than components.
        UnitError: A column has no unit, or `read_as` names one that is not in the header or not of its kind.
    """
    table, read_as = read_table(path, KINDS, any_case=True), read_as or {}
    whole = {*WRENCH_NAMES[:3], *TWIST_NAMES[:3]} <= table.columns.keys()
    _refuse_one_axis(table if whole else read_table(path, KINDS | ONE_AXIS, any_case=True))
    others = [name for name in table.columns if name not in KINDS]
    for name in others:
        if (meant := _meant(name)) is not None:
            seen = f"expected: {listing(KINDS)}, the forces and shifts alone or all, each with its unit"
            text = f"unknown column {table.columns[name].header!r}, did you mean {meant!r}? ({seen})"
            raise table.fail(text)
    # Six components where there are moments and rotations, three where there is neither.
    given = [[name for name in names if name in table.columns] for names in (WRENCH_NAMES[3:], TWIST_NAMES[3:])]
    if any(given) and not all(given):
        has, lacks = ("moments", "rotations rx, ry, rz") if given[0] else ("rotations", "moments mx, my, mz")
        problem = (
            f"has no {lacks} beside the {has} {listing(given[0] + given[1])}: give both, or forces and shifts alone"
        )
        raise table.fail(problem)
    size = 6 if all(given) else 3
    loads, deflections = WRENCH_NAMES[:size], TWIST_NAMES[:size]
    table.require([*loads, *deflections])
    units = {name: _unit(table, name, read_as) for name in (*deflections, *loads)}
    written = list(dict.fromkeys(table.columns[name].unit for name in (*loads, *deflections)))
    for unit in read_as:
        if unit not in written:
            hint = did_you_mean(unit, written)
            raise UnitError(f"{Place(table.path, 1)}: no column is in {unit!r}{hint} (its units: {listing(written)})")
    if len(table) <= size:
        raise TableError(Place(table.path), f"has {len(table)} rows, {size} components need more")
    factors = {name: UNITS[KINDS[name]][unit] for name, unit in units.items()}
    return JointData(
        _matrix(table, loads, factors),
        _matrix(table, deflections, factors),
        tuple(units[name] for name in deflections),
        np.array([factors[name] for name in deflections]),
        table.sha256,
        table.path,
        {name: table.texts(name) for name in others},
    )


def as_joint_data(data: JointData | Tabular) -> JointData:
    """Return a bench table as it is, or what `read_joint_data` makes of a file or a data frame."""
    return data if isinstance(data, JointData) else read_joint_data(data)


def _one_axis(table: Table) -> tuple[str, str] | None:
    """Return the load and the deflection of a table that loads one axis alone, None of another table."""
    kinds = {name: (KINDS | ONE_AXIS)[name] for name in table.columns if name in KINDS | ONE_AXIS}
    both = [[name for name, kind in kinds.items() if kind in of] for of in (("force", "moment"), ("length", "angle"))]
    if all(len(names) > 1 for names in both):  # the other axes may stand there as zeros
        both = [[name for name in names if np.any(table.plain(name))] for names in both]
    if [len(names) for names in both] != [1, 1] or not all(table.columns[name].unit for (name,) in both):
        return None
    ((load,), (deflection,)) = both
    pairs: dict[str, str] = dict(zip(WRENCH_NAMES, TWIST_NAMES, strict=True))
    same = (kinds[load] == "moment") == (kinds[deflection] == "angle")
    return (load, deflection) if same and pairs.get(load, deflection) == deflection else None


def _refuse_one_axis(table: Table) -> None:
    """Raise `TableError` where a table loads one axis alone, saying what its compliance is and how to declare it."""
    if (found := _one_axis(table)) is None:
        return
    (pull, gives), (load, deflection) = (table.numbers(name) for name in found), found
    named = next((name for name in table.columns if name.lower() == "joint"), None)
    joints, said = np.array(table.texts(named) if named else ["NAME"] * len(table)), []
    for joint in dict.fromkeys(joints.tolist()):
        x, y = pull[joints == joint], gives[joints == joint]
        if len(set(x.tolist())) < 3:
            raise table.fail(f"has fewer than three different loads {found[0]!r} of joint {joint!r}")
        line, unscaled = np.polyfit(x, y, 1, cov="unscaled")
        std = float(np.sqrt(unscaled[0, 0] * np.sum((y - np.polyval(line, x)) ** 2) / (len(x) - 2)))
        if not (softness := float(line[0])) > 0.0:
            raise table.fail(f"{found[1]!r} of joint {joint!r} falls with {found[0]!r}: is a sign turned?")
        axes = [f"{softness:.5g}" if name == load else "0" for name in WRENCH_NAMES]
        how = f"compliance = [{', '.join(axes)}]"
        if load in ONE_AXIS:
            how = f"joint_stiffness = {1.0 / softness:.5g} (about the joint's own axis)"
        unit = "rad/Nm" if KINDS.get(deflection, ONE_AXIS.get(deflection)) == "angle" else "m/N"
        declared = f'[flexure.{joint}] joint = "{joint}", {how}, relative_std = {std / softness:.2g}'
        said.append(f"{softness:.5g} ± {std:.2g} {unit}: {declared}")
    text = f"loads one axis alone, {table.columns[found[0]].header!r} against {table.columns[found[1]].header!r}; train"
    raise table.fail(f"{text} needs all of {listing(WRENCH_NAMES, 12)}. In the arm.toml it is {'; '.join(said)}")


def _unit(table: Table, name: str, read_as: Mapping[str, str]) -> str:
    """Return the unit that a column is taken to be in."""
    column, units = table.columns[name], UNITS[KINDS[name]]
    if not column.unit:
        problem = f"column {name!r} has no unit; write one in the header, such as {name}_{next(iter(units))}"
        raise UnitError(f"{Place(table.path, 1)}: {problem}")
    unit = read_as.get(column.unit, column.unit)
    if unit not in units:
        raise UnitError(no_unit(unit, KINDS[name]))
    return unit


def _matrix(table: Table, names: tuple[str, ...], factors: Mapping[str, float]) -> Array:
    """Return columns as (N, k) in SI by factors which may not be those of the header."""
    with np.errstate(over="ignore"):  # what overflows is too large, and refused below
        again = np.array([factors[name] / table.columns[name].factor for name in names])
        values = table.matrix(names, TOO_LARGE) * again
    for row, column in np.argwhere(~(np.abs(values) <= LARGEST))[:1]:
        cell = table.columns[names[column]]
        raise table.fail(f"column {cell.header!r} is {cell.cells[row]!r}, {TOO_LARGE}", row)
    return values


def _meant(name: str) -> str | None:
    """Return the load or deflection that a column misspells, None for a covariate.

    The names have two letters, so most short words are near one: `day` is not `dy`. A slip is assumed where the unit
    fits, as in `mxx_Nm`, or where the letters are the same, as in `xd`.
    """
    base, unit = split_header(name)
    has_unit = any(unit in units for units in UNITS.values())
    stem = (base if has_unit else name).lower()
    if stem.partition("_")[0] in KINDS:
        return stem.partition("_")[0]
    near = difflib.get_close_matches(stem, KINDS, n=6, cutoff=0.5 if set(stem) in map(set, KINDS) else 0.66)
    fitting = (expected for expected in near if unit in UNITS[KINDS[expected]] or set(expected) == set(stem))
    return next(fitting, None)
