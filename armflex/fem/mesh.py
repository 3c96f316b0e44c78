"""A mesh as its file has it, in SI: nodes, solids, named sets, materials; and what is wrong with it, by line."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from armflex.conventions import Array
from armflex.errors import Flag, MeshError, Place, UnitError, UnknownNameError, listing

SOLIDS = {"C3D4": 4, "C3D10": 10, "C3D8": 8, "C3D20": 20, "C3D20R": 20}
"""Element type, by CalculiX's names -> its nodes."""

FACES = {
    4: ((0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)),
    8: ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
}
"""Corners of an element -> corners of its faces S1, S2 .., seen from outside against the clock."""

EDGES = {
    4: ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)),
    8: ((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)),
}
"""Corners of an element -> ends of the edges whose middles are its further nodes, in their order."""

OTHERS = "shells (S3, S4, S6, S8), beams, springs and wedges"
"""What meshes have and this room does not read."""

UNITS = {"m": (1.0, 1.0, 1.0), "mm": (1e-3, 1e6, 1e12)}
"""Unit of a mesh -> its factors to SI for lengths, stresses (N and mm: MPa) and densities (tonne/mm^3)."""

LONGEST = 200.0
"""No structure of an arm is longer [m]."""

MOST_BYTES = 500_000_000
"""Of a mesh's file."""

SHORTEST = 1e-3
"""Or as short [m]."""

YOUNG, DENSITY = (1e7, 2e12), (10.0, 3e4)
"""What solids have [Pa, kg/m^3]: rubber to diamond, foam to tungsten."""


@dataclass(frozen=True)
class Material:
    """An isotropic linear material.

    Attributes:
        young: Young's modulus [Pa].
        poisson: Poisson's ratio.
        density: [kg/m^3], None where nobody gave it: the part has then neither mass nor weight.
    """

    young: float
    poisson: float
    density: float | None = None

    def lame(self) -> tuple[float, float]:
        """Return Lame's two constants [Pa]."""
        shear = 0.5 * self.young / (1.0 + self.poisson)
        return 2.0 * shear * self.poisson / (1.0 - 2.0 * self.poisson), shear


@dataclass(frozen=True)
class Block:
    """Elements of one type and one material.

    Attributes:
        kind: Their type, a key of `SOLIDS`.
        ids: (E,) their numbers in the file.
        nodes: (E, k) rows of the mesh's nodes, in the order that CalculiX has.
        lines: (E,) where each stands in the file, 0 where that is not known.
        material: What they are made of, None where the file does not say.
        name: The element set that they belong to.
    """

    kind: str
    ids: np.ndarray
    nodes: np.ndarray
    lines: np.ndarray
    material: Material | None
    name: str = ""


@dataclass(frozen=True)
class Mesh:
    """A mesh.

    Attributes:
        path: Its file.
        points: (N, 3) places of the nodes [m].
        ids: (N,) their numbers in the file.
        lines: (N,) where each stands in the file, 0 where that is not known.
        blocks: Its elements.
        sets: Name -> (M,) rows of its nodes.
        flags: What the reader left out.
        beyond: Keywords, with their lines, of what this room does not compute and CalculiX does.
    """

    path: Path
    points: Array
    ids: np.ndarray
    lines: np.ndarray
    blocks: tuple[Block, ...]
    sets: Mapping[str, np.ndarray]
    flags: tuple[Flag, ...] = ()
    beyond: tuple[tuple[str, int], ...] = field(default=())

    def fail(self, problem: str, line: Any = 0) -> MeshError:
        """Return the error that names the file and a line."""
        return MeshError(Place(self.path, int(line)), problem)

    def nodes_of(self, name: str) -> np.ndarray:
        """Return the rows of a set's nodes; names of sets do not distinguish capitals.

        Raises:
            UnknownNameError: There is no such set.
            MeshError: It has no node.
        """
        known = {one.lower(): one for one in self.sets}
        if name.lower() not in known:
            raise UnknownNameError(f"set of {self.path.name}", name, self.sets)
        found = np.unique(self.sets[known[name.lower()]])
        if not len(found):
            raise self.fail(f"set {name!r} has no nodes")
        return found


def with_material(mesh: Mesh, young: float | None, poisson: float | None, density: float | None) -> Mesh:
    """Return the mesh of elements that all have a material; what is given [Pa, 1, kg/m^3] is that of all.

    Raises:
        MeshError: Elements have none, or one that no solid has.
    """
    flags, blocks = list(mesh.flags), []
    given = {"young": young, "poisson": poisson, "density": density}
    given = {name: value for name, value in given.items() if value is not None}
    for block in mesh.blocks:
        own = block.material
        if own is None and {"young", "poisson"} <= given.keys():
            own = Material(**given)
        elif own is None:
            where = f"element set {block.name!r}" if block.name else "the elements"
            text = f"{where} ({len(block.ids)} {block.kind}) have no material: give --young and --poisson"
            raise mesh.fail(text, block.lines[0])
        elif given:
            changed = [name for name, value in given.items() if getattr(own, name) not in (None, value)]
            flags += [Flag("material", f"{listing(changed)} of the file replaced by the one given")] * bool(changed)
            own = replace(own, **given)
        if not -1.0 < own.poisson < 0.5:
            raise mesh.fail(f"Poisson's ratio {own.poisson:g} of {block.name!r}: expected more than -1, less than 0.5")
        for text, value, (least, most), unit in (
            ("Young's modulus", own.young, YOUNG, "Pa"),
            ("density", own.density, DENSITY, "kg/m^3"),
        ):
            if value is not None and not least <= value <= most:
                text = f"{text} {value:g} {unit} of {block.name or block.kind!r}, expected {least:g} to {most:g}"
                raise mesh.fail(f"{text}: is the mesh in mm, N and tonnes (--unit mm)?", block.lines[0])
        blocks.append(replace(block, material=own))
    return replace(mesh, blocks=tuple(blocks), flags=tuple(dict.fromkeys(flags)))


def check_size(mesh: Mesh) -> None:
    """Raise `UnitError` where a mesh is longer or shorter than any structure of an arm."""
    size = float(np.linalg.norm(np.ptp(mesh.points, axis=0)))
    if not SHORTEST <= size <= LONGEST:
        other = "--unit mm" if size > LONGEST else "--unit m"
        text = f"the mesh is {size:g} m from corner to corner, expected {SHORTEST:g} to {LONGEST:g} m"
        raise UnitError(f"{mesh.path}: {text}: is another unit meant ({other})?")


def check_connected(mesh: Mesh, interfaces: Mapping[str, np.ndarray]) -> None:
    """Raise where nodes or parts are not connected, elements stand twice, or interfaces share nodes.

    Args:
        mesh: The mesh.
        interfaces: Name -> rows of nodes; the first is held.

    Raises:
        MeshError: Which node, set or part, and its line.
    """
    from scipy.sparse import coo_matrix  # here: an arm that names a part starts without scipy
    from scipy.sparse.csgraph import connected_components

    count = len(mesh.points)
    used = np.zeros(count, dtype=bool)
    for block in mesh.blocks:
        used[block.nodes] = True
    if not used.all():
        lost = np.flatnonzero(~used)
        text = f"node {mesh.ids[lost[0]]} belongs to no element"
        more = f" (nor do {len(lost) - 1} others)" if len(lost) > 1 else ""
        raise mesh.fail(f"{text}{more}: remove it, or mesh what it belongs to", mesh.lines[lost[0]])
    for block in mesh.blocks:
        _, first, same = np.unique(np.sort(block.nodes, axis=1), axis=0, return_index=True, return_inverse=True)
        twice = np.flatnonzero(first[same.ravel()] != np.arange(len(same.ravel())))
        if len(twice):
            text = f"elements {block.ids[first[same.ravel()[twice[0]]]]} and {block.ids[twice[0]]} have the same nodes"
            raise mesh.fail(f"{text}: the solid is counted twice", block.lines[twice[0]])
    names = list(interfaces)
    for place, name in enumerate(names):
        for other in names[:place]:
            shared = np.intersect1d(interfaces[name], interfaces[other])
            if len(shared):
                text = (
                    f"interfaces {other!r} and {name!r} share {len(shared)} nodes, the first is {mesh.ids[shared[0]]}"
                )
                raise mesh.fail(f"{text}: a node belongs to one interface", mesh.lines[shared[0]])
    for name, rows in interfaces.items():
        placed = mesh.points[rows] - mesh.points[rows].mean(axis=0)
        if len(rows) < 3 or np.linalg.matrix_rank(placed, tol=1e-9 * max(np.abs(placed).max(), 1e-300)) < 2:
            text = f"set {name!r} has {len(rows)} nodes on one line: an interface needs three that are not"
            raise mesh.fail(text, mesh.lines[rows[0]])
    pairs = [(np.repeat(b.nodes[:, :1], b.nodes.shape[1] - 1, 1).ravel(), b.nodes[:, 1:].ravel()) for b in mesh.blocks]
    rows, columns = (np.concatenate(side) for side in zip(*pairs, strict=True))
    parts, part = connected_components(coo_matrix((np.ones(len(rows), bool), (rows, columns)), (count, count)))
    held = np.unique(part[interfaces[names[0]]])
    if len(held) < parts:
        free = np.flatnonzero(~np.isin(part, held))
        alone = np.flatnonzero(part == part[free[0]])
        text = f"a part of {len(alone)} nodes, among them {mesh.ids[alone[0]]}, is not connected to {names[0]!r}"
        raise mesh.fail(f"{text}: nodes at one place are joined only where they are one node", mesh.lines[alone[0]])


def volume_error(mesh: Mesh, block: Block, worst: Iterable[int]) -> MeshError:
    """Return the error about elements of a block whose volume is not positive."""
    first, *more = list(worst)
    text = f"element {block.ids[first]} ({block.kind}) has no positive volume everywhere: inverted, or distorted"
    return mesh.fail(text + (f" (and {len(more)} others)" if more else ""), block.lines[first])


def text_lines(path: Path) -> Iterator[str]:
    """Yield the lines of a text file."""
    try:
        if path.stat().st_size > MOST_BYTES:
            raise MeshError(Place(path), f"is larger than the {MOST_BYTES} bytes allowed")
        with path.open(encoding="utf-8-sig", errors="replace") as file:
            yield from file
    except OSError as error:
        raise MeshError(Place(path), f"cannot be read: {error.strerror or error}") from None
