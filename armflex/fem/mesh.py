"""A mesh as its file has it, in SI: nodes, solids, named sets, materials; and what is wrong with it, by line."""

import io
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from os.path import isfile  # False, whatever is wrong with the name
from pathlib import Path
from sys import maxsize
from typing import Any, NoReturn

import numpy as np

from armflex.conventions import Array
from armflex.errors import Flag, InputError, MeshError, Place, UnitError, UnknownNameError, listing
from armflex.fem.part import MOST
from armflex.storage.read_file import reading

SOLIDS = {"C3D4": 4, "C3D10": 10, "C3D8": 8, "C3D20": 20, "C3D20R": 20}
"""Element type, by CalculiX's names -> its nodes, of which 4 or 8 are corners."""

FLAT = {
    **{"CPS3": 3, "CPS4": 4, "CPS6": 6, "CPS8": 8, "T3D2": 2, "T3D3": 3},  # by which gmsh writes faces and edges
    **{"CTRIA3": 3, "CTRIA6": 6, "CQUAD4": 4, "CQUAD8": 8},
    **{"vertex": 1, "line": 2, "line3": 3, "triangle": 3, "triangle6": 6, "quad": 4, "quad8": 8, "quad9": 9},
}
"""Faces and edges of solids, by .inp's, Nastran's and meshio's names -> their nodes: without a section they make sets
alone."""

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

NOT_COMPUTED = f"{', '.join(SOLIDS)} are computed; shells (S3, S4, S6, S8), beams, springs and wedges are not"

UNITS = {"m": (1.0, 1.0, 1.0), "mm": (1e-3, 1e6, 1e12)}
"""Unit of a mesh -> its factors to SI for lengths, stresses (N and mm: MPa) and densities (tonne/mm^3)."""

SHORTEST, LONGEST = 1e-3, 200.0
"""No structure of an arm is shorter or longer [m]."""


SOFT, INCOMPRESSIBLE = 1e8, 0.45
"""Tolerance: a solid that is softer [Pa] and has a smaller Poisson's ratio is no rubber: doubted."""

MOST_BYTES = 500_000_000
"""Of a mesh's file."""

DEEPEST = 5
"""Files that include one another."""

MOST_LINES = 10**9
"""Lines of a file; those of the n-th file that it includes are counted on from n times as many."""

YOUNG, DENSITY = (1e7, 2e12), (10.0, 3e4)
"""What solids have [Pa, kg/m^3]: rubber to diamond, foam to tungsten."""


_LENGTHS = {"mm": 1e-3, "mi": 1e-3, "in": 0.0254, "cm": 0.01, "ce": 0.01}
_SAID = re.compile(
    r"(?:\*\*|\$).*\b(?:length|units?)\b(?:[^:=(]{0,20}[:=(]\s*(?:\w+\s*[,;]\s*){0,3}?|\W*(?:(?:are|is|in)\s+)?)"
    r"(mm|millimet\w*|cm|centimet\w*|inch\w*|in(?=\s*(?:[,;]|$))|m|met\w*)\b(?!/)",
    re.IGNORECASE,
)
"""A comment that states the unit of lengths: `** Units: mm, N`; known by its first two letters."""

_EXPONENT = re.compile(r"(?<=[0-9.])(?:[dDeE]([+-]?)|([+-]))(?=\d+$)")


def words(text: str, sign: str | None = None) -> frozenset[str]:
    """Return the words of a text, or what stands between its signs."""
    return frozenset(" ".join(word.split()) for word in text.split(sign))


def corners_of(kind: str) -> int:
    """Return how many corners a solid has, a key of `FACES` and `EDGES`."""
    return 4 if SOLIDS[kind] in (4, 10) else 8


@dataclass(frozen=True)
class Material:
    """An isotropic linear material: Young's modulus [Pa], Poisson's ratio and density [kg/m^3].

    Without a density the part has neither mass nor weight.
    """

    young: float
    poisson: float
    density: float | None = None


@dataclass(frozen=True)
class ElementBlock:
    """Elements of one type and one material.

    Attributes:
        kind: Their type, a key of `SOLIDS`.
        ids: (E,) their numbers in the file.
        nodes: (E, k) rows of the mesh's nodes, in the order that CalculiX has.
        lines: (E,) where each stands in the file, 0 where that is not known.
        material: What they are made of, None where the file does not say.
        name: Of the material in the file.
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
        lines: (N,) where each stands in the file or in one that it includes, 0 where that is not known.
        blocks: Its elements.
        sets: Name -> (M,) rows of its nodes.
        flags: What the reader left out.
        beyond: Keywords, with their lines, of what this room does not compute and CalculiX does.
        included: Files that it includes, in the order of their lines; see `MOST_LINES`.
        unread: Name of a set that is not one of nodes -> why, and its line.
        held: Names of sets that the file holds always, whichever of its supports are asked for.
        supports: Name of each set that a support of the file holds -> its line.
    """

    path: Path
    points: Array
    ids: np.ndarray
    lines: np.ndarray
    blocks: tuple[ElementBlock, ...]
    sets: Mapping[str, np.ndarray]
    flags: tuple[Flag, ...] = ()
    beyond: tuple[tuple[str, int], ...] = ()
    included: tuple[Path, ...] = ()
    unread: Mapping[str, tuple[str, int]] = field(default_factory=dict)
    held: tuple[str, ...] = ()
    supports: Mapping[str, int] = field(default_factory=dict)

    @property
    def size(self) -> float:
        """From corner to corner [m]."""
        return float(np.linalg.norm(np.ptp(self.points, axis=0))) if len(self.points) else 0.0

    def place(self, line: Any) -> Place:
        """Return the file and the line in it."""
        file, line = divmod(int(line), MOST_LINES)
        return Place((self.path, *self.included)[file], line)

    def fail(self, problem: str, line: Any = 0) -> MeshError:
        """Return the error that names the file and a line."""
        return MeshError(self.place(line), problem)

    def nodes_of(self, name: str) -> np.ndarray:
        """Return the rows of a set's nodes; names of sets do not distinguish capitals. One of no nodes is refused."""
        names = {name.lower(): name for name in self.sets}
        if name.lower() not in names:
            for unread, (reason, line) in self.unread.items():
                if unread.lower() == name.lower():
                    raise self.fail(f"set {name!r} {reason}", line)
            raise UnknownNameError(f"set of {self.path.name}", name, self.sets)
        nodes = np.unique(self.sets[names[name.lower()]])
        if not len(nodes):
            raise self.fail(f"set {name!r} has no nodes")
        return nodes


@dataclass
class Draft:
    """What a reader gathers of a mesh, in any order, by keys that are unique in the file.

    Attributes:
        path: The file.
        unit: Of its numbers, a key of `UNITS`.
        nodes: Key -> number, place, line.
        elements: Key -> number, type, keys of its nodes, line.
        sets: Name -> keys of nodes.
        groups: Name -> keys of elements, whose nodes are a set.
        materials: Name -> what `Material` has, SI.
        sections: Keys of elements, the material that they are made of, line.
        references: Keys of nodes that may belong to no element, as those do that a set has alone.
        included, unread, flags, held, supports: See `Mesh`.
    """

    path: Path
    unit: str
    nodes: dict[Any, tuple[int, Any, int]] = field(default_factory=dict)
    elements: dict[Any, tuple[int, str, list, int]] = field(default_factory=dict)
    sets: dict[str, list] = field(default_factory=dict)
    groups: dict[str, list] = field(default_factory=dict)
    materials: dict[str, dict[str, float]] = field(default_factory=dict)
    sections: list[tuple[Iterable, str, int]] = field(default_factory=list)
    references: set = field(default_factory=set)
    included: list[Path] = field(default_factory=list)
    unread: dict[str, tuple[str, int]] = field(default_factory=dict)
    flags: list[Flag] = field(default_factory=list)
    held: tuple[str, ...] = ()
    supports: Mapping[str, int] = field(default_factory=dict)

    def fail(self, problem: str, line: int = 0) -> NoReturn:
        """Raise the error that names the file and a line."""
        file, line = divmod(line, MOST_LINES)
        raise MeshError(Place((self.path, *self.included)[file], line), problem)

    def beside(self, path: Path, name: str, line: int) -> Path:
        """Return the file that a line of another names, from the folder of that one."""
        if not isfile(file := path.parent / name.strip("\"' ")):
            self.fail(f"names the file {name[:80]!r}, which is not there", line)
        return file

    def text_lines(self, path: Path) -> Iterator[tuple[int, str]]:
        """Yield the lines of the file or of one that it includes, each with its number."""
        if included := path != self.path:
            self.included.append(path)
        for number, line in enumerate(text_lines(path), 1):
            if (match := _SAID.match(line)) and UNITS[self.unit][0] != _LENGTHS.get(match[1][:2].lower(), 1.0):
                text = f"{path}:{number} says {line.strip()[:60]!r}, and the mesh is read in {self.unit}"
                self.flags.append(Flag("unit", f"{text}: --unit mm, or scale it to m, if that is right"))
            yield MOST_LINES * len(self.included) * included + number, line

    def numbers(self, line: int, cells: Sequence[str], least: int = 1) -> list[float]:
        """Return numbers as Fortran writes them, 0 for empty cells."""
        try:
            values = [float(_EXPONENT.sub(r"E\1\2", cell.strip() or "0")) for cell in cells]
        except ValueError:
            values = []
        if len(values) < least or not np.isfinite(values).all():
            self.fail(f"expected {least} finite numbers, got {','.join(cells)[:60]!r}", line)
        return values

    def whole(self, line: int, cells: Sequence[str], least: int = 0) -> list[int]:
        """Return whole numbers, none for empty cells."""
        try:
            values = [int(cell) for cell in cells if cell.strip()]
        except ValueError:
            values = None
        if values is None or len(values) < least or any(abs(number) > maxsize for number in values):
            self.fail(f"expected whole numbers, got {','.join(cells)[:60]!r}", line)
        return values

    def node(self, key: Any, number: int, place: Any, line: int) -> None:
        """Add a node."""
        if key in self.nodes:
            self.fail(f"node {number} stands twice", line)
        self.nodes[key] = number, place, line

    def element(self, key: Any, number: int, kind: str, nodes: list, line: int) -> None:
        """Add an element by the keys of its nodes."""
        if key in self.elements:
            self.fail(f"element {number} stands twice", line)
        self.elements[key] = number, kind, nodes, line

    def material(self, name: str, line: int, **values: float) -> None:
        """Add what `Material` has, in the file's units; what stands twice is the same."""
        factors = {"young": UNITS[self.unit][1], "density": UNITS[self.unit][2]}
        before = self.materials.setdefault(name, {})
        for key, value in values.items():
            value *= factors.get(key, 1.0)
            if before.setdefault(key, value) != value:
                self.fail(f"material {name!r} stands twice, with {key} {before[key]:.6g} and {value:.6g} (SI)", line)

    def mesh(self, flags: Iterable[Flag] = (), beyond: Sequence[tuple[str, int]] = ()) -> Mesh:
        """Return the mesh.

        Raises:
            MeshError: An element or a section names what is not there, or what makes sets alone has a section.
        """
        made, rows, flags = {}, {key: row for row, key in enumerate(self.nodes)}, [*self.flags, *flags]
        if self.elements and not beyond:
            flags += self._without_references()
            rows = {key: row for row, key in enumerate(self.nodes)}
        for keys, material, line in self.sections:
            if material not in self.materials:
                materials = listing(self.materials) or "none"
                self.fail(f"a section of the material {material!r}, which is not there (known: {materials})", line)
            for key in keys:
                if self.materials[before := made.setdefault(key, material)] != self.materials[material]:
                    number = self.elements[key][0]
                    both = f"of the materials {before!r} and {material!r}"
                    self.fail(f"element {number} is in two sections, {both}", line)
        sorts: dict[tuple[str, str], list[tuple[int, list[int], int]]] = {}
        for key, (number, kind, nodes, line) in self.elements.items():
            if missing := [node for node in nodes if node not in rows]:
                name = str(missing[0]).rpartition(".")[2]
                self.fail(f"element {number} names node {name}, which is not there", line)
            if kind in FLAT:
                if key in made:
                    text = f"element {number} is a {kind} with a section, which is not computed"
                    self.fail(f"{text}: {NOT_COMPUTED}", line)
            else:
                sorts.setdefault((kind, made.get(key, "")), []).append((number, [rows[node] for node in nodes], line))
        blocks = []
        for (kind, name), several in sorts.items():
            ids, nodes, lines = (np.array(column) for column in zip(*several, strict=True))
            constants = self.materials.get(name, {})
            material = Material(**constants) if {"young", "poisson"} <= constants.keys() else None
            blocks.append(ElementBlock(kind, ids, nodes, lines, material, name))
        sets = {name: {node for key in keys for node in self.elements[key][2]} for name, keys in self.groups.items()}
        numbers, places, lines = zip(*self.nodes.values(), strict=True) if rows else ((), np.zeros((0, 3)), ())
        return Mesh(
            self.path,
            np.array(places, dtype=float) * UNITS[self.unit][0],
            np.array(numbers, dtype=int),
            np.array(lines, dtype=int),
            tuple(blocks),
            {name: np.array([rows[key] for key in keys], dtype=int) for name, keys in (sets | self.sets).items()},
            tuple(flags),
            tuple(beyond),
            tuple(self.included),
            self.unread,
            self.held,
            self.supports,
        )

    def _without_references(self) -> Iterator[Flag]:
        """Leave out reference points: nodes of no element that nothing joins to the solids. Yield what says so."""
        solid = {node for _, kind, nodes, _ in self.elements.values() if kind in SOLIDS for node in nodes}
        alone = {keys[0] for keys in self.sets.values() if len(set(keys)) == 1}
        points = (self.references | alone).intersection(self.nodes) - solid
        for name, keys in [*self.sets.items()]:
            self.sets[name] = [key for key in keys if key not in points]
            if keys and not self.sets[name]:
                number, _, line = self.nodes[keys[0]]
                self.unread[name] = f"is node {number} alone, which belongs to no element", line
                del self.sets[name]
        for key in points:
            number, _, line = self.nodes.pop(key)
            yield Flag("left_out", f"node {number} (line {line % MOST_LINES}) belongs to no element and is left out")


def with_material(mesh: Mesh, young: float | None, poisson: float | None, density: float | None) -> Mesh:
    """Return the mesh of elements that all have a material; what is given [Pa, 1, kg/m^3] is that of all.

    It is refused where there are no elements, or one has no material, or one that no solid has.
    """
    if not mesh.blocks and not mesh.beyond:
        raise mesh.fail(f"has no solid elements ({', '.join(SOLIDS)})")
    flags, blocks = list(mesh.flags), []
    given = {"young": young, "poisson": poisson, "density": density}
    given = {name: value for name, value in given.items() if value is not None}
    for block in mesh.blocks:
        material = block.material
        named = f"the {len(block.ids)} {block.kind}" + f" of {block.name!r}" * bool(block.name)
        if material is None and not {"young", "poisson"} <= given.keys():
            raise mesh.fail(f"{named} have no material: give --young and --poisson", block.lines[0])
        if material is not None and (
            changed := [name for name in given if getattr(material, name) not in (None, given[name])]
        ):
            flags.append(Flag("material", f"{listing(changed)} of the file replaced by the one given"))
        material = Material(**given) if material is None else replace(material, **given)
        if not -1.0 < material.poisson < 0.5:
            text, expected = f"Poisson's ratio {material.poisson:g}", "expected more than -1, less than 0.5"
            if "poisson" in given:
                raise InputError(f"--poisson: {text}: {expected}")
            raise mesh.fail(f"{text} of {named}: {expected}", block.lines[0])
        for name, text, (least, most), unit in (
            ("young", "Young's modulus", YOUNG, "Pa"),
            ("density", "density", DENSITY, "kg/m^3"),
        ):
            value = getattr(material, name)
            if value is not None and not least <= value <= most:
                expected = f"expected {least:g} to {most:g}"
                if name in given:
                    text = f"--{name}: {text} {value:g} {unit}, {expected}"
                    raise InputError(f"{text}: --{name} is in {unit} whatever the mesh's unit")
                text = f"{text} {value:g} {unit} of {named}, {expected}: is the mesh in mm, N and tonnes (--unit mm)?"
                raise mesh.fail(text, block.lines[0])
        if material.young < SOFT and material.poisson < INCOMPRESSIBLE:
            text = f"{mesh.path}: {named} are as soft as rubber ({material.young:g} Pa): is that in psi, or in MPa?"
            flags.append(Flag("soft_material", text))
        blocks.append(replace(block, material=material))
    # A part that is longer [m] is doubted: those of the longest booms are half as long
    if (size := mesh.size) > 30.0:
        text = f"{mesh.path}: the mesh is {size:.4g} m from corner to corner: is it in mm (--unit mm)?"
        flags.append(Flag("long_mesh", text))
    return replace(mesh, blocks=tuple(blocks), flags=tuple(dict.fromkeys(flags)))


def interfaces_of(mesh: Mesh, fixed: str, loaded: Sequence[str], whole: bool = True) -> dict[str, np.ndarray]:
    """Return the rows of the held set's nodes and of the loaded ones', of a mesh that nothing is wrong with.

    Args:
        mesh: The mesh.
        fixed: The set that is held.
        loaded: The sets that carry load.
        whole: Whether its elements are all that joins its nodes.

    Raises:
        InputError: There is no loaded set, more than `MOST`, or a set is named twice.
        UnitError: The mesh is longer or shorter than any structure of an arm.
        UnknownNameError: A set is not there.
        MeshError: Nodes or parts are not connected, elements stand twice, or interfaces share nodes; and the line.
    """
    from scipy.sparse import coo_matrix  # here: an arm that names a part starts without scipy
    from scipy.sparse.csgraph import connected_components

    def at_node(text: str, row: int, remedy: str) -> MeshError:
        return mesh.fail(f"{text % f'node {mesh.ids[row]}'}: {remedy}", mesh.lines[row])

    names = (fixed, *loaded)
    if not 1 <= len(loaded) <= MOST or len({name.lower() for name in names}) < len(names):
        raise InputError(f"expected one held set and 1 to {MOST} loaded ones, all different, got {listing(names)}")
    if not SHORTEST <= (size := mesh.size) <= LONGEST:
        other = "--unit mm" if size > LONGEST else "--unit m"
        text = f"the mesh is {size:g} m from corner to corner, expected {SHORTEST:g} to {LONGEST:g} m"
        raise UnitError(f"{mesh.path}: {text}: is another unit meant ({other})?")
    sets, count = {name: mesh.nodes_of(name) for name in names}, len(mesh.points)
    for name in mesh.held:
        if len(beyond := np.setdiff1d(mesh.sets.get(name, ()), sets[fixed])):
            text = (
                f"%s is held by its own line, with {len(mesh.sets[name])} of the set {name!r}, and is not in {fixed!r}"
            )
            raise at_node(text, beyond[0], f"hold {name!r}, or free the node in the file")
    if not whole:
        return sets
    lost = np.setdiff1d(np.arange(count), np.concatenate([block.nodes.ravel() for block in mesh.blocks]))
    if len(lost):
        more = f" (nor do {len(lost) - 1} others)" if len(lost) > 1 else ""
        raise at_node(f"%s belongs to no element{more}", lost[0], "remove it, or mesh what it belongs to")
    for block in mesh.blocks:
        _, first, same = np.unique(np.sort(block.nodes, axis=1), axis=0, return_index=True, return_inverse=True)
        twice = np.flatnonzero(first[same.ravel()] != np.arange(len(same.ravel())))
        if len(twice):
            text = f"elements {block.ids[first[same.ravel()[twice[0]]]]} and {block.ids[twice[0]]} have the same nodes"
            raise mesh.fail(f"{text}: the solid is counted twice", block.lines[twice[0]])
    for place, (name, rows) in enumerate(sets.items()):
        for other in names[:place]:
            shared = np.intersect1d(rows, sets[other])
            if len(shared):
                text = f"interfaces {other!r} and {name!r} share {len(shared)} nodes, the first is %s"
                raise at_node(text, shared[0], "a node belongs to one interface")
        placed = mesh.points[rows] - mesh.points[rows].mean(axis=0)
        if len(rows) < 3 or np.linalg.matrix_rank(placed, tol=1e-9 * max(np.abs(placed).max(), 1e-300)) < 2:
            text = f"set {name!r} has {len(rows)} nodes on one line, among them %s"
            raise at_node(text, rows[0], "an interface needs three that are not")
    pairs = [(np.repeat(b.nodes[:, :1], b.nodes.shape[1] - 1, 1).ravel(), b.nodes[:, 1:].ravel()) for b in mesh.blocks]
    rows, columns = (np.concatenate(side) for side in zip(*pairs, strict=True))
    _, part = connected_components(coo_matrix((np.ones(len(rows), bool), (rows, columns)), (count, count)))
    free = np.flatnonzero(~np.isin(part, part[sets[fixed]]))
    if len(free):
        text = f"a part of {np.sum(part == part[free[0]])} nodes, among them %s, is not connected to {fixed!r}"
        raise at_node(text, free[0], "nodes at one place are joined only where they are one node")
    return sets


def text_lines(path: Path) -> Iterator[str]:
    """Yield the lines of a text file."""
    try:
        with reading(path, MOST_BYTES) as file:
            yield from io.TextIOWrapper(file, encoding="utf-8-sig", errors="replace")
    except OSError as error:
        raise MeshError(Place(path), f"cannot be read: {error.strerror or error}") from None
