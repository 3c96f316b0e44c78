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
    """Read JOB.sti with JOB.mas, JOB.dof and JOB.inp, or NAME.mtx with NAME.mass.mtx and NAME.nodes.csv.

    The table of nodes has `node`, `x`, `y`, `z` and `set`, a row for each; the matrices have their three or six
    components in its order, and after six further ones of what no node moves by (modes of a Craig-Bampton part).

    Raises:
        MeshError: A file is missing, damaged, or does not fit the others; file and line.
    """
    length = UNITS[unit][0]
    if path.suffix.lower() == ".sti":
        mesh = read_inp(path.with_suffix(".inp"), unit, springs=True)
        row = {int(number): place for place, number in enumerate(mesh.ids)}
        listed = path.with_suffix(".dof")
        found = []
        for line, text in enumerate(text_lines(listed), 1):
            node, _, axis = text.strip().partition(".")
            if not (node.isdigit() and axis in ("1", "2", "3") and int(node) in row):
                more = "nodes of shells and beams are CalculiX's own"
                raise MeshError(Place(listed, line), f"{text.strip()!r} is no freedom of {mesh.path.name}: {more}")
            found.append((row[int(node)], int(axis) - 1))
        freedoms = np.array(found, dtype=int).reshape(-1, 2)
        pair: list[Any] = [_triangle(path.with_suffix(end), len(freedoms)) for end in (".sti", ".mas")]
    else:
        mesh = _nodes(path.with_suffix(".nodes.csv"), length)
        pair = [_market(path)]
        count, size = len(mesh.points), pair[0].shape[0]
        if (heavy := path.with_suffix(".mass.mtx")).exists():
            pair.append(_market(heavy))
            if pair[1].shape != pair[0].shape:
                raise MeshError(Place(heavy), f"is {pair[1].shape[0]} square, {path.name} is {size}")
        each = 6 if size >= 6 * count else 3
        if size != each * count and each == 3:
            raise MeshError(Place(path), f"is {size} square: {count} nodes have {3 * count} or {6 * count} components")
        places = np.arange(size)
        freedoms = np.column_stack([places // each, places % each])
        freedoms[each * count :] = MODAL, 0
    root = np.where((freedoms[:, 0] != MODAL) & (freedoms[:, 1] < 3), length**-0.5, length**0.5)
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


def _triangle(path: Path, size: int) -> Any:
    """Return a symmetric matrix of CalculiX's rows `i j value`."""
    try:
        rows = np.loadtxt(path, ndmin=2)
        i, j = rows[:, :2].astype(int).T - 1
        half = sparse.coo_array((rows[:, 2], (i, j)), (size, size)).tocsc()
    except (OSError, ValueError, IndexError) as error:
        raise MeshError(Place(path), f"is no matrix of {size} freedoms: {error}") from None
    return half + half.T - sparse.diags_array(half.diagonal())


def _market(path: Path) -> Any:
    """Return a symmetric matrix of a Matrix Market file."""
    try:
        found: Any = sparse.csc_array(io.mmread(path))
    except (OSError, ValueError) as error:
        raise MeshError(Place(path), f"is no Matrix Market file: {error}") from None
    if found.shape[0] != found.shape[1] or not np.isfinite(found.data).all():
        raise MeshError(Place(path), f"is {found.shape[0]} x {found.shape[1]}, expected a finite square matrix")
    if abs(found - found.T).max() > 1e-8 * abs(found).max():
        raise MeshError(Place(path), "is not symmetric")
    return 0.5 * (found + found.T)


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
