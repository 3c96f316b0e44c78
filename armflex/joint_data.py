"""A joint on a test bench or in FE analysis: loads in, deflections out. Units are part of every file."""

from __future__ import annotations

import difflib
import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from armflex.conventions import TWIST_NAMES, UNITS, WRENCH_NAMES, Array
from armflex.errors import Place, TableError, UnitError, did_you_mean
from armflex.table import Table, read_table

KINDS = {
    **dict.fromkeys(WRENCH_NAMES[:3], "force"),
    **dict.fromkeys(WRENCH_NAMES[3:], "moment"),
    **dict.fromkeys(TWIST_NAMES[:3], "length"),
    **dict.fromkeys(TWIST_NAMES[3:], "angle"),
}


@dataclass(frozen=True)
class JointData:
    """Loads and the deflections they gave.

    Attributes:
        loads: (N, k) [N, N m], k = 3 for forces only, 6 with moments.
        deflections: (N, k) [m, rad].
        units: Unit of each deflection column as the file has it.
        factors: (k,) of those units to SI.
        sha256: Of the file.
        path: Where it was read from.
        covariates: Further columns, as text.
    """

    loads: Array
    deflections: Array
    units: tuple[str, ...]
    factors: Array
    sha256: str
    path: Path
    covariates: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.loads)

    @property
    def size(self) -> int:
        """Number of components, 3 or 6."""
        return self.loads.shape[1]


def read_joint_data(path: str | Path, read_as: Mapping[str, str] | None = None) -> JointData:
    """Read a joint_data.csv.

    Args:
        path: Columns fx fy fz [mx my mz] and dx dy dz [rx ry rz], each with its unit as a suffix.
        read_as: Units to be taken for others, such as {"mm": "um"}, where a header is believed to be wrong.

    Raises:
        TableError: A column is missing, misspelt or not numeric, or there are fewer rows than components.
        UnitError: A column has no unit.
    """
    table = read_table(path, KINDS)
    has_rotation = any(name in table.columns for name in (*WRENCH_NAMES[3:], *TWIST_NAMES[3:]))
    size = 6 if has_rotation else 3
    loads, deflections = WRENCH_NAMES[:size], TWIST_NAMES[:size]
    table.require([*loads, *deflections])
    others = _covariates(table)
    units, factors = _units(table, deflections, read_as or {})
    _units(table, loads, read_as or {})
    if len(table) <= size:
        raise TableError(Place(table.path), f"has {len(table)} rows, {size} components need more")
    written = np.array([table.columns[name].factor for name in deflections])
    return JointData(
        table.matrix(loads),
        table.matrix(deflections) * (factors / written),
        units,
        factors,
        hashlib.sha256(table.path.read_bytes()).hexdigest(),
        table.path,
        others,
    )


def _units(table: Table, names: tuple[str, ...], read_as: Mapping[str, str]) -> tuple[tuple[str, ...], Array]:
    units, factors = [], []
    for name in names:
        column, known = table.columns[name], UNITS[KINDS[name]]
        if not column.unit:
            example = f"{name}_{next(iter(known))}"
            raise UnitError(f"{table.path}: column {name!r} has no unit; write one in the header, such as {example}")
        unit = read_as.get(column.unit, column.unit)
        if unit not in known:
            raise UnitError(f"{unit!r} is no unit of {KINDS[name]}{did_you_mean(unit, known)} ({', '.join(known)})")
        units.append(unit)
        factors.append(known[unit])
    return tuple(units), np.array(factors)


def _covariates(table: Table) -> dict[str, tuple[str, ...]]:
    others = [name for name in table.columns if name not in KINDS]
    for name in others:
        if (meant := _meant(name)) is not None:
            header = table.columns[name].header
            raise TableError(Place(table.path, 1), f"unknown column {header!r}, did you mean {meant!r}?")
    return {name: table.texts(name) for name in others}


def _meant(name: str) -> str | None:
    """Return the load or deflection that a column misspells, None for a covariate.

    The names have two letters, so most short words are near one: `day` is not `dy`. A slip is believed where the unit
    fits, as in `mxx_Nm`, or where the letters are the same, as in `xd`.
    """
    base, _, unit = name.rpartition("_")
    has_unit = any(unit in units for units in UNITS.values())
    stem = (base if has_unit else name).lower()
    if stem.partition("_")[0] in KINDS:
        return stem.partition("_")[0]
    near = difflib.get_close_matches(stem, KINDS, n=6, cutoff=0.5 if set(stem) in map(set, KINDS) else 0.66)
    fitting = (known for known in near if unit in UNITS[KINDS[known]] or set(known) == set(stem))
    return next(fitting, None)
