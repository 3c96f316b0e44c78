"""Finished matrices instead of elements: CalculiX's .sti and .mas, Matrix Market's .mtx, Craig-Bampton parts."""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy import io, sparse

from armflex.conventions import Array
from armflex.errors import MeshError, Place
from armflex.fem.assembly import assembled
from armflex.fem.inp import read_inp
from armflex.fem.mesh import UNITS, Mesh, text_lines

SUFFIXES = (".sti", ".mtx")
COLUMNS = ("node", "x", "y", "z", "set")
MODAL = -1

HELD = 1e36
"""What Abaqus writes on the diagonal of a freedom that is held."""


@dataclass(frozen=True, eq=False)
class Matrices:
    """Stiffness and mass of what has nodes.

    Attributes:
        mesh: Its nodes and sets.
        stiffness, mass: (n, n) sparse, SI.
        freedoms: (n, 2) row of the node and component 0 to 5 of its twist; row `MODAL` of what no node moves by.
    """

    mesh: Mesh
    stiffness: Any
    mass: Any
    freedoms: np.ndarray

    def at(self, rows: np.ndarray) -> np.ndarray:
        """Return the places of the freedoms of nodes."""
        return np.flatnonzero(np.isin(self.freedoms[:, 0], rows))

    def rigid(self, origin: Array) -> Array:
        """Return the (n, 6) motion of all freedoms by a body's twist at an (3,) origin [m]."""
        nodes, axes = self.freedoms.T
        each = np.zeros((len(self.mesh.points), 6, 6))
        each[:, :3] = rigid_motion(self.mesh.points - origin).reshape(-1, 3, 6)
        each[:, 3:, 3:] = np.eye(3)
        found = each[nodes, axes]
        found[nodes == MODAL] = 0.0
        return found


def of_mesh(mesh: Mesh, tick: Callable[[int, int | None], None] | None = None) -> Matrices:
    """Return the matrices of a mesh of solids."""
    stiffness, mass = assembled(mesh, tick)
    nodes, axes = np.divmod(np.arange(3 * len(mesh.points)), 3)
    return Matrices(mesh, stiffness, sparse.kron(mass, sparse.eye_array(3), "csc"), np.column_stack([nodes, axes]))


def read_matrices(path: Path, unit: str = "m") -> Matrices:
    """Read matrices, and the nodes that they are of.

    CalculiX's JOB.sti stands beside JOB.mas, JOB.dof and JOB.inp, Abaqus' JOB_STIF2.mtx beside JOB_MASS2.mtx and
    JOB.inp, and any other NAME.mtx, of Abaqus' rows or Matrix Market's, beside NAME.mass.mtx and NAME.nodes.csv.

    The table of nodes has `node`, `x`, `y`, `z` and `set`, a row for each. Matrix Market's matrices have their three or
    six components in its order, and after six further ones of what no node moves by (modes of a Craig-Bampton part).

    Raises:
        MeshError: A file is missing, damaged, or does not fit the others; file and line.
    """
    job, abaqus, number = path.stem.upper().rpartition("_STIF")
    listed, heavy = path.with_suffix(".nodes.csv"), path.with_suffix(".mass.mtx")
    if path.suffix.lower() == ".sti":
        mesh, heavy = read_inp(path.with_suffix(".inp"), unit, springs=True), path.with_suffix(".mas")
    elif abaqus and not listed.exists():
        own = path.stem[: len(job)]
        mesh, heavy = read_inp(path.with_name(f"{own}.inp"), unit, True), path.with_name(f"{own}_MASS{number}.mtx")
    else:
        mesh = _nodes(listed, UNITS[unit][0])
    files = [path, heavy] if heavy.exists() or path.suffix.lower() == ".sti" else [path]
    if next(text_lines(path), "").startswith("%%MatrixMarket"):
        pair, freedoms = _market(files, len(mesh.points))
    else:
        pair, freedoms = _triangles(files, mesh)
    root = np.where((freedoms[:, 0] != MODAL) & (freedoms[:, 1] < 3), UNITS[unit][0] ** -0.5, UNITS[unit][0] ** 0.5)
    scaling = sparse.diags_array(root)  # N and mm: a stiffness in N/mm and a mass in t scale alike
    stiffness, *more = ((scaling @ one @ scaling).tocsc() for one in pair)
    mass = more[0] if more else sparse.csc_array(stiffness.shape)
    return Matrices(replace(mesh, path=path), stiffness, mass, freedoms)


def rigid_motion(arms: Array) -> Array:
    """Return the (3 M, 6) motion of points at (M, 3) arms [m] from a body's origin by the body's twist."""
    found = np.zeros((len(arms), 3, 6))
    found[:, :, :3] = np.eye(3)
    x, y, z = arms.T
    found[:, 0, 4], found[:, 0, 5], found[:, 1, 3] = z, -y, -z
    found[:, 1, 5], found[:, 2, 3], found[:, 2, 4] = x, y, -x
    return found.reshape(-1, 6)


def _triangles(files: list[Path], mesh: Mesh) -> tuple[list[Any], np.ndarray]:
    """Return the symmetric matrices of files of rows: CalculiX's `i j value`, whose freedoms are in JOB.dof, or Abaqus'
    `node, component, node, component, value`; and their freedoms. Abaqus' freedoms that are held are left out.
    """
    calculix = files[0].suffix.lower() == ".sti"
    sign, cells = (None, "i j value") if calculix else (",", "node, component, node, component, value")
    tables = []
    for file in files:
        lines = [(line, text) for line, text in enumerate(text_lines(file), 1) if not text.startswith("*")]
        try:
            tables.append(np.loadtxt([text for _, text in lines], ndmin=2, delimiter=sign))
            if tables[-1].shape[1] != len(cells.split()) or not np.isfinite(tables[-1]).all():
                raise ValueError
        except ValueError:
            wrong = [line for line, text in lines if text.strip() and not _finite(text.split(sign), len(cells.split()))]
            text = f"expected rows `{cells}`" + " (FORMAT=MATRIX INPUT)" * (not calculix)
            raise MeshError(Place(file, wrong[0] if wrong else 0), text) from None
    if calculix:
        names = [tuple(line.strip().partition(".")[::2]) for line in text_lines(files[0].with_suffix(".dof"))]
    else:
        stiff = tables[0]
        held = {tuple(row[:2]) for row in stiff[stiff[:, 4] >= HELD].astype(int).tolist()}
        names = sorted(
            {*map(tuple, stiff[:, :2].astype(int).tolist()), *map(tuple, stiff[:, 2:4].astype(int).tolist())}
        )
        names = [name for name in names if name not in held]
    row, freedoms = {str(number): place for place, number in enumerate(mesh.ids.tolist())}, []
    for line, (node, axis) in enumerate(names, 1):
        if str(node) not in row or str(axis) not in "123456":
            place = Place(files[0].with_suffix(".dof"), line) if calculix else Place(files[0])
            text = f"'{node}.{axis}' is no freedom of {mesh.path.name}: nodes of shells and beams are CalculiX's own"
            raise MeshError(place, text if calculix else text.partition(":")[0])
        freedoms.append((row[str(node)], int(axis) - 1))
    found, size = [], len(names)
    at = {name: place for place, name in enumerate(names)}
    for file, table in zip(files, tables, strict=True):
        pairs = table[:, :-1].astype(int)
        if calculix:
            ends = pairs - 1
        else:
            ends = np.array([[at.get((a, b), -1), at.get((c, d), -1)] for a, b, c, d in pairs.tolist()]).reshape(-1, 2)
            table, ends = table[(ends >= 0).all(axis=1)], ends[(ends >= 0).all(axis=1)]
        if len(ends) and (ends.min() < 0 or ends.max() >= size):
            raise MeshError(Place(file), f"is no matrix of {size} freedoms: it names {ends.max() + 1}")
        ends, first = np.unique(np.sort(ends, axis=1), axis=0, return_index=True)  # one triangle of a square
        half = sparse.coo_array((table[first, -1], (ends[:, 0], ends[:, 1])), (size, size)).tocsc()
        found.append(half + half.T - sparse.diags_array(half.diagonal()))
    return found, np.array(freedoms, dtype=int).reshape(-1, 2)


def _finite(cells: list[str], count: int) -> bool:
    """Return whether cells are as many finite numbers."""
    try:
        return len(cells) == count and bool(np.isfinite([float(cell) for cell in cells]).all())
    except ValueError:
        return False


def _market(files: list[Path], count: int) -> tuple[list[Any], np.ndarray]:
    """Return the symmetric matrices of Matrix Market files, and their freedoms."""
    found: list[Any] = []
    for file in files:
        try:
            found.append(sparse.csc_array(io.mmread(file)))
        except (OSError, ValueError) as error:
            raise MeshError(Place(file), f"is no Matrix Market file: {error}") from None
        one, size = found[-1], found[0].shape[0]
        if one.shape != (size, size) or not np.isfinite(one.data).all():
            raise MeshError(Place(file), f"is {one.shape[0]} x {one.shape[1]}, expected {size} square and finite")
        if abs(one - one.T).max() > 1e-8 * abs(one).max():
            raise MeshError(Place(file), "is not symmetric")
    each = 6 if size >= 6 * count else 3
    if size != each * count and each == 3:
        raise MeshError(Place(files[0]), f"is {size} square: {count} nodes have {3 * count} or {6 * count} components")
    freedoms = np.column_stack(np.divmod(np.arange(size), each))
    freedoms[each * count :] = MODAL, 0
    return [0.5 * (one + one.T) for one in found], freedoms


def _nodes(path: Path, length: float) -> Mesh:
    """Return the nodes and sets of a table."""
    rows: list[list[str]] = list(csv.reader(text_lines(path)))
    if not rows or [cell.strip() for cell in rows[0]] != list(COLUMNS):
        raise MeshError(Place(path, 1), f"expected the columns {','.join(COLUMNS)}")
    ids, points, sets = [], [], {}
    for line, cells in enumerate(rows[1:], 2):
        try:
            number, *place = (float(cell) for cell in cells[:4])
            if not np.isfinite(place).all() or len(cells) != len(COLUMNS) or int(number) in ids:
                raise ValueError
        except ValueError:
            text = f"expected a number of its own, three finite numbers and a set, got {','.join(cells)[:60]!r}"
            raise MeshError(Place(path, line), text) from None
        if name := cells[4].strip():
            sets.setdefault(name, []).append(len(ids))
        ids.append(int(number))
        points.append(place)
    lines = np.arange(2, len(ids) + 2)
    groups = {name: np.array(own) for name, own in sets.items()}
    return Mesh(path, np.array(points) * length, np.array(ids), lines, (), groups)
