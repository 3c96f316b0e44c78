"""Finished matrices instead of elements: CalculiX's .sti and .mas, Abaqus' and Matrix Market's .mtx, Craig-Bampton."""

import csv
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from scipy import io, sparse

from armflex.conventions import Array
from armflex.errors import MeshError, Place
from armflex.fem.assembly import assembled
from armflex.fem.inp import read_inp
from armflex.fem.mesh import UNITS, Draft, Mesh, text_lines

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
        return np.where((nodes == MODAL)[:, None], 0.0, each[nodes, axes])


def rigid_motion(arms: Array) -> Array:
    """Return the (3 M, 6) motion of points at (M, 3) arms [m] from a body's origin by the body's twist."""
    turned = -np.cross(arms[:, None], np.eye(3)).transpose(0, 2, 1)  # omega x r, a column for each of omega
    return np.concatenate([np.broadcast_to(np.eye(3), turned.shape), turned], axis=2).reshape(-1, 6)


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
        job_name = path.stem[: len(job)]
        mesh = read_inp(path.with_name(f"{job_name}.inp"), unit, True)
        heavy = path.with_name(f"{job_name}_MASS{number}.mtx")
    else:
        mesh = _nodes(listed, unit)
    files = [path, heavy] if heavy.exists() or path.suffix.lower() == ".sti" else [path]
    if next(text_lines(path), "").startswith("%%MatrixMarket"):
        pair, freedoms = _market(files, len(mesh.points))
    else:
        pair, freedoms = _triangles(files, mesh)
    root = np.where((freedoms[:, 0] != MODAL) & (freedoms[:, 1] < 3), UNITS[unit][0] ** -0.5, UNITS[unit][0] ** 0.5)
    scaling = sparse.diags_array(root)  # N and mm: a stiffness in N/mm and a mass in t scale alike
    stiffness, *more = ((scaling @ matrix @ scaling).tocsc() for matrix in pair)
    mass = more[0] if more else sparse.csc_array(stiffness.shape)
    return Matrices(replace(mesh, path=path), stiffness, mass, freedoms)


def _triangles(files: list[Path], mesh: Mesh) -> tuple[list[Any], np.ndarray]:
    """Return the symmetric matrices of files of rows, a triangle or the square, and their freedoms.

    CalculiX's are `i j value`, whose freedoms are in JOB.dof; Abaqus' name them. What Abaqus holds is left out.
    """
    by_calculix = files[0].suffix.lower() == ".sti"
    listed = files[0].with_suffix(".dof") if by_calculix else files[0]
    if by_calculix:
        names = [line.strip() for line in text_lines(listed)]
        wrong = [place for place, name in enumerate(names, 1) if not re.fullmatch(r"\d+\.[1-6]", name)]
        if wrong:
            raise MeshError(Place(listed, wrong[0]), f"expected NODE.COMPONENT, got {names[wrong[0] - 1]!r}")
        keys = np.array([int(name.replace(".", "")) for name in names])  # a node's number, then the component's digit
        tables = [_rows(file, None, "i j value") for file in files]
        ends = [table[:, :2].astype(int) - 1 for table in tables]
    else:
        tables = [_rows(file, ",", "node, component, node, component, value") for file in files]
        named = [(10 * table[:, [0, 2]] + table[:, [1, 3]]).astype(int) for table in tables]
        keys = np.setdiff1d(named[0], named[0][tables[0][:, 4] >= HELD])
        ends = [np.where(np.isin(entry, keys), np.searchsorted(keys, entry), -1) for entry in named]
        kept = [(rows >= 0).all(axis=1) for rows in ends]
        tables, ends = (
            [listed[mask] for listed, mask in zip(several, kept, strict=True)] for several in (tables, ends)
        )
    nodes, axes = np.divmod(keys, 10)
    if len(lost := np.flatnonzero(~np.isin(nodes, mesh.ids) | (axes < 1) | (axes > 6))):
        text = f"'{nodes[lost[0]]}.{axes[lost[0]]}' is no freedom of {mesh.path.name}"
        text += ": nodes of shells and beams are CalculiX's own" * by_calculix
        raise MeshError(Place(listed, int(lost[0]) + 1 if by_calculix else 0), text)
    order, size, matrices = np.argsort(mesh.ids), len(keys), []
    for file, table, pairs in zip(files, tables, ends, strict=True):
        if len(pairs) and not 0 <= pairs.min() <= pairs.max() < size:
            raise MeshError(Place(file), f"is no matrix of {size} freedoms: it names {pairs.max() + 1}")
        _, first = np.unique(pairs.min(axis=1) * size + pairs.max(axis=1), return_index=True)
        half = sparse.coo_array((table[first, -1], np.sort(pairs[first], axis=1).T), (size, size)).tocsc()
        matrices.append(half + half.T - sparse.diags_array(half.diagonal()))
    return matrices, np.column_stack([order[np.searchsorted(mesh.ids, nodes, sorter=order)], axes - 1])


def _rows(path: Path, sign: str | None, cells: str) -> Array:
    """Return the finite numbers of a file, in rows of such cells apart by a sign; lines of keywords are left out."""
    count = len(cells.split())

    def read() -> Iterator[float]:
        for line, text in enumerate(text_lines(path), 1):
            if not text.strip() or text[0] == "*":
                continue
            try:
                row = [float(cell) for cell in text.split(sign)]
            except ValueError:
                row = []
            if len(row) != count or not all(map(isfinite, row)):
                hint = " (FORMAT=MATRIX INPUT)" * bool(sign)
                raise MeshError(Place(path, line), f"expected rows `{cells}`{hint}, got {text.strip()[:60]!r}")
            yield from row

    return np.fromiter(read(), float).reshape(-1, count)


def _market(files: list[Path], count: int) -> tuple[list[Any], np.ndarray]:
    """Return the symmetric matrices of Matrix Market files, and their freedoms."""
    matrices: list[Any] = []
    for file in files:
        try:
            matrices.append(sparse.csc_array(io.mmread(file)))
        except (OSError, ValueError) as error:
            raise MeshError(Place(file), f"is no Matrix Market file: {error}") from None
        matrix, size = matrices[-1], matrices[0].shape[0]
        if matrix.shape != (size, size) or not np.isfinite(matrix.data).all():
            raise MeshError(Place(file), f"is {matrix.shape[0]} x {matrix.shape[1]}, expected {size} square and finite")
        if abs(matrix - matrix.T).max() > 1e-8 * abs(matrix).max():
            raise MeshError(Place(file), "is not symmetric")
    each = 6 if size >= 6 * count else 3
    if size != each * count and each == 3:
        raise MeshError(Place(files[0]), f"is {size} square: {count} nodes have {3 * count} or {6 * count} components")
    freedoms = np.column_stack(np.divmod(np.arange(size), each))
    freedoms[each * count :] = MODAL, 0
    return [0.5 * (matrix + matrix.T) for matrix in matrices], freedoms


def _nodes(path: Path, unit: str) -> Mesh:
    """Return the nodes and sets of a table."""
    draft = Draft(path, unit)
    header, *rows = [*csv.reader(text_lines(path))] or [[]]
    if [cell.strip() for cell in header] != list(COLUMNS):
        draft.fail(f"expected the columns {','.join(COLUMNS)}", 1)
    for line, cells in enumerate(rows, 2):
        if len(cells) != len(COLUMNS) or not all(cell.strip() for cell in cells[:4]):
            draft.fail(f"expected {','.join(COLUMNS)}, got {','.join(cells)[:60]!r}", line)
        (number,) = draft.whole(line, cells[:1])
        draft.node(number, number, draft.numbers(line, cells[1:4], 3), line)
        if name := cells[4].strip():
            draft.sets.setdefault(name, []).append(number)
    return draft.mesh()
