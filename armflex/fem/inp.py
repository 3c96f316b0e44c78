"""Abaqus and CalculiX input files: nodes, solids, sets, surfaces, materials; parts and instances flattened.

A small reader of our own: meshio's drops sections, surfaces, instances and line numbers. What changes the stiffness of
a model and is not read here is refused by name, or kept for CalculiX; what is only a load or an output is left out.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn

import numpy as np
from scipy.spatial.transform import Rotation

from armflex.conventions import Array
from armflex.errors import Flag, MeshError, Place
from armflex.fem.mesh import EDGES, FACES, OTHERS, SOLIDS, UNITS, Block, Material, Mesh, text_lines

BEYOND = (
    *("TIE", "EQUATION", "MPC", "RIGID BODY", "COUPLING", "DISTRIBUTING COUPLING", "KINEMATIC COUPLING"),
    *("CONTACT PAIR", "SPRING", "GAP", "DASHPOT", "PLASTIC", "HYPERELASTIC", "ORIENTATION", "TRANSFORM"),
    *("BEAM SECTION", "SHELL SECTION", "MEMBRANE SECTION", "KINEMATIC", "DISTRIBUTING", "CYCLIC SYMMETRY MODEL"),
)
"""Keywords that change how a model gives, which a linear mesh of solids does not have."""

FLAT = {"CPS3": 3, "CPS4": 4, "CPS6": 6, "CPS8": 8, "T3D2": 2, "T3D3": 3}
"""Elements by which gmsh writes faces and edges of solids -> their nodes; without a section they make sets alone."""

NODES = {**SOLIDS, **FLAT}

DEEPEST = 5
"""Files that include one another."""

_SPLIT = re.compile(r"\s*,\s*")


@dataclass
class _Part:
    """What one *Part, or a flat file, has gathered; numbers are the file's."""

    nodes: dict[int, tuple[float, ...]] = field(default_factory=dict)
    lines: dict[int, int] = field(default_factory=dict)
    elements: dict[int, tuple[str, tuple[int, ...], int]] = field(default_factory=dict)
    nsets: dict[str, list[int | str]] = field(default_factory=dict)
    elsets: dict[str, list[int | str]] = field(default_factory=dict)
    surfaces: dict[str, list[tuple[int | str, str]]] = field(default_factory=dict)
    sections: list[tuple[str, str, int]] = field(default_factory=list)
    begun: dict[str, int] = field(default_factory=dict)  # line of each set of nodes


def _parameters(given: list[str]) -> dict[str, str]:
    """Return a keyword's parameters by name in capitals."""
    pairs = (one.partition("=") for one in given)
    return {key.strip().upper(): value.strip().strip('"') for key, _, value in pairs}


@dataclass(frozen=True)
class _Statement:
    """A keyword with its parameters and its lines of data, each with the number of its line."""

    keyword: str
    parameters: dict[str, str]
    line: int
    data: list[tuple[int, list[str]]]


def read_inp(path: Path, unit: str = "m", springs: bool = False) -> Mesh:
    """Read an .inp file's model; steps are left out.

    Args:
        path: The file.
        unit: A key of `mesh.UNITS`.
        springs: Whether what only CalculiX computes may stand there; see `Mesh.beyond`.

    Raises:
        MeshError: It cannot be read, is damaged, or has what is not computed here; file and line.
    """
    return _Reader(path, unit, springs).mesh()


class _Reader:
    def __init__(self, path: Path, unit: str, springs: bool) -> None:
        self.path, self.springs = path, springs
        self.length, self.stress, self.density = UNITS[unit]
        self.root = self.now = _Part()
        self.parts: dict[str, _Part] = {}
        self.instances: dict[str, tuple[str, Array, Array]] = {}
        self.materials: dict[str, dict[str, float]] = {}
        self.material = ""
        self.flags: dict[str, Flag] = {}
        self.beyond: list[tuple[str, int]] = []

    def fail(self, problem: str, line: int) -> NoReturn:
        raise MeshError(Place(self.path, line), problem)

    def statements(self, path: Path, depth: int = 0) -> Iterator[_Statement]:
        """Yield the statements of a file and of those that it includes."""
        now: _Statement | None = None
        unfinished = False
        for number, line in enumerate(text_lines(path), 1):
            text = line.strip()
            if not text or text.startswith("**"):
                continue
            if not text.startswith("*"):
                if now is None:
                    self.fail(f"expected a keyword such as *NODE, got {text[:40]!r}", number)
                if unfinished and "=" in text:  # a keyword goes on after a comma
                    now.parameters.update(_parameters(_SPLIT.split(text.rstrip(", \t"))))
                    continue
                now.data.append((number, _SPLIT.split(text.rstrip(", \t"))))
                unfinished = False
                continue
            if now is not None:
                yield now
            word, *given = _SPLIT.split(text[1:].strip().rstrip(","))
            parameters, unfinished = _parameters(given), text.endswith(",")
            now = _Statement(" ".join(word.upper().split()), parameters, number, [])
            if now.keyword == "INCLUDE":
                if depth >= DEEPEST or "INPUT" not in parameters:
                    self.fail("*INCLUDE needs INPUT=FILE, and at most five files include one another", number)
                yield from self.statements(path.parent / parameters["INPUT"], depth + 1)
                now = None
        if now is not None:
            yield now

    def mesh(self) -> Mesh:
        for one in self.statements(self.path):
            if one.keyword == "STEP":
                break
            self.read(one)
        return self.flattened()

    def read(self, one: _Statement) -> None:
        """Take in one statement."""
        if one.keyword in READERS:
            READERS[one.keyword](self, one)
        elif one.keyword in BEYOND:
            self.not_computed(one.keyword, one.line)
        elif one.keyword in ("BOUNDARY", "CLOAD", "DLOAD", "INITIAL CONDITIONS"):
            text = f"*{one.keyword} (line {one.line}) is left out: --fixed says what is held"
            self.flags.setdefault(one.keyword, Flag("left_out", text))

    def not_computed(self, keyword: str, line: int) -> None:
        if not self.springs:
            self.fail(f"*{keyword} is not computed here (solids with a linear isotropic material alone are)", line)
        self.beyond.append((keyword, line))

    def integers(self, one: _Statement) -> Iterator[tuple[int, list[int]]]:
        for line, cells in one.data:
            try:
                yield line, [int(cell) for cell in cells if cell]
            except ValueError:
                self.fail(f"expected whole numbers, got {','.join(cells)[:60]!r}", line)

    def numbers(self, line: int, cells: list[str], least: int) -> list[float]:
        try:
            found = [float(cell.replace("D", "E").replace("d", "e")) if cell else 0.0 for cell in cells]
        except ValueError:
            self.fail(f"expected numbers, got {','.join(cells)[:60]!r}", line)
        if len(found) < least or not np.isfinite(found).all():
            self.fail(f"expected {least} finite numbers, got {','.join(cells)[:60]!r}", line)
        return found

    def name(self, one: _Statement, key: str) -> str:
        if not one.parameters.get(key):
            self.fail(f"*{one.keyword} needs {key}=NAME", one.line)
        return one.parameters[key].upper()

    def node(self, one: _Statement) -> None:
        self.now.begun.setdefault(one.parameters.get("NSET", "").upper(), one.line)
        own = self.now.nsets.setdefault(one.parameters["NSET"].upper(), []) if "NSET" in one.parameters else []
        if one.parameters.get("SYSTEM", "R").upper() != "R":
            self.fail("*NODE in cylindrical or spherical coordinates is not read", one.line)
        for line, cells in one.data:
            values = self.numbers(line, cells, 2)
            number = int(values[0])
            if number != values[0] or number in self.now.nodes:
                text = "stands twice" if number in self.now.nodes else "is no whole number"
                self.fail(f"node {values[0]:g} {text}", line)
            self.now.nodes[number] = (*values[1:4], 0.0, 0.0)[:3]
            self.now.lines[number] = line
            own.append(number)

    def element(self, one: _Statement) -> None:
        kind = self.name(one, "TYPE")
        own = self.now.elsets.setdefault(one.parameters["ELSET"].upper(), []) if "ELSET" in one.parameters else []
        if kind not in NODES:
            if not self.springs:
                text = f"elements of the type {kind} are not computed: {', '.join(SOLIDS)} are, {OTHERS} are not"
                self.fail(text, one.line)
            self.beyond.append((f"ELEMENT, TYPE={kind}", one.line))
            return
        waiting: list[int] = []
        begun = one.line
        for line, cells in self.integers(one):
            begun = begun if waiting else line
            waiting += cells
            if len(waiting) <= NODES[kind]:
                continue
            number, *nodes = waiting
            if len(nodes) != NODES[kind] or number in self.now.elements:
                wrong = "stands twice" if number in self.now.elements else f"has {len(nodes)} nodes"
                self.fail(f"element {number} {wrong}; a {kind} has {NODES[kind]}", begun)
            self.now.elements[number] = (kind, tuple(nodes), begun)
            own.append(number)
            waiting = []
        if waiting:
            self.fail(f"element {waiting[0]} has {len(waiting) - 1} nodes; a {kind} has {NODES[kind]}", begun)

    def set_of(self, one: _Statement, key: str) -> None:
        of = self.now.nsets if key == "NSET" else self.now.elsets
        place = f"{one.parameters['INSTANCE'].upper()}." if "INSTANCE" in one.parameters else ""
        found = of.setdefault(self.name(one, key), [])
        for line, cells in one.data:
            if "GENERATE" in one.parameters:
                first, last, step = (*(int(x) for x in self.numbers(line, cells, 2)), 1)[:3]
                if step < 1 or (last - first) // step > 10_000_000:
                    self.fail(f"expected first, last, step, got {','.join(cells)}", line)
                found += [f"{place}{n}" if place else n for n in range(first, last + 1, step)]
                continue
            for cell in filter(None, cells):
                number = int(cell) if cell.isdigit() else None
                found.append(number if number is not None and not place else f"{place}{cell.upper()}")

    def nset(self, one: _Statement) -> None:
        self.now.begun.setdefault(self.name(one, "NSET"), one.line)
        if "ELSET" in one.parameters:  # the nodes of elements
            found = self.now.nsets.setdefault(self.name(one, "NSET"), [])
            found.append(f"@{one.parameters['ELSET'].upper()}")
        else:
            self.set_of(one, "NSET")

    def elset(self, one: _Statement) -> None:
        self.set_of(one, "ELSET")

    def surface(self, one: _Statement) -> None:
        found = self.now.surfaces.setdefault(self.name(one, "NAME"), [])
        by_nodes = one.parameters.get("TYPE", "ELEMENT").upper() == "NODE"
        for line, cells in one.data:
            face = "NODE" if by_nodes else (cells[1].upper() if len(cells) > 1 else "")
            if not by_nodes and not re.fullmatch(r"S[1-6]", face):
                self.fail(
                    f"expected an element or a set of them and a face S1 to S6, got {','.join(cells)[:60]!r}", line
                )
            found.append((int(cells[0]) if cells[0].isdigit() else cells[0].upper(), face))

    def new_material(self, one: _Statement) -> None:
        self.material = self.name(one, "NAME")
        self.materials[self.material] = {}

    def elastic(self, one: _Statement) -> None:
        kind = one.parameters.get("TYPE", "ISO").upper()
        if not kind.startswith("ISO") or len(one.data) != 1 or not self.material:
            self.fail(
                "one line of an isotropic *ELASTIC in a *MATERIAL is read: Young's modulus, Poisson's ratio", one.line
            )
        young, poisson = self.numbers(*one.data[0], 2)[:2]
        self.materials[self.material] |= {"young": young * self.stress, "poisson": poisson}

    def density_of(self, one: _Statement) -> None:
        if not one.data or not self.material:
            self.fail("*DENSITY needs a number and a *MATERIAL", one.line)
        self.materials[self.material]["density"] = self.numbers(*one.data[0], 1)[0] * self.density

    def section(self, one: _Statement) -> None:
        self.now.sections.append((self.name(one, "ELSET"), self.name(one, "MATERIAL"), one.line))

    def part(self, one: _Statement) -> None:
        self.now = self.parts.setdefault(self.name(one, "NAME"), _Part())

    def end(self, one: _Statement) -> None:
        self.now = self.root

    def instance(self, one: _Statement) -> None:
        shift, turn = np.zeros(3), np.eye(3)
        if one.data:
            shift = np.array(self.numbers(*one.data[0], 3)[:3])
        if len(one.data) > 1:
            x = np.array(self.numbers(*one.data[1], 7)[:7])
            if not (axis := x[3:6] - x[:3]).any():
                self.fail("*INSTANCE is turned about an axis without length", one.line)
            turn = Rotation.from_rotvec(np.radians(x[6]) * axis / np.linalg.norm(axis)).as_matrix()
            shift = turn @ (shift - x[:3]) + x[:3]
        part = self.name(one, "PART")
        if part not in self.parts:
            self.fail(
                f"*INSTANCE of a part {part!r} that is not there (parts: {', '.join(self.parts) or 'none'})", one.line
            )
        self.instances[self.name(one, "NAME")] = (part, shift, turn)

    def flattened(self) -> Mesh:
        """Return all instances of all parts as one mesh."""
        pieces = [("", self.root, np.zeros(3), np.eye(3))]
        pieces += [(f"{name}.", self.parts[part], shift, turn) for name, (part, shift, turn) in self.instances.items()]
        if self.parts and not self.instances:
            pieces += [(f"{name}.", part, np.zeros(3), np.eye(3)) for name, part in self.parts.items()]
        rows: dict[str, int] = {}
        points, ids, lines = [], [], []
        elements: dict[str, tuple[str, list[int], int, int]] = {}
        made: dict[str, tuple[str, int]] = {}
        sets: dict[str, set[int]] = {}
        for prefix, part, shift, turn in pieces:
            for number, place in part.nodes.items():
                rows[f"{prefix}{number}"] = len(points)
                points.append(turn @ np.array(place) + shift if prefix else place)
                ids.append(number)
                lines.append(part.lines[number])
            for number, (kind, nodes, line) in part.elements.items():
                try:
                    own = [rows[f"{prefix}{node}"] for node in nodes]
                except KeyError as missing:
                    self.fail(f"element {number} names node {missing.args[0].split('.')[-1]}, which is not there", line)
                elements[f"{prefix}{number}"] = (kind, own, number, line)
        for prefix, part, _, _ in pieces:
            for elset, material, line in part.sections:
                if material not in self.materials:
                    known = ", ".join(self.materials) or "none"
                    self.fail(f"*SOLID SECTION of a material {material!r} that is not there (known: {known})", line)
                for key in self.members(part, prefix, elset, "elsets", line):
                    made[key] = (material, line)
            for name in part.nsets:
                own = sets.setdefault(name, set())
                for key in self.members(part, prefix, name, "nsets", part.begun[name]):
                    if key in rows:
                        own.add(rows[key])
                    elif key in elements:
                        own.update(elements[key][1])
                    elif not self.springs:  # with them, elements that are CalculiX's alone are in no list
                        self.fail(f"set {name!r} names {key!r}, which is not there", part.begun[name])
            for name in part.elsets.keys() - part.nsets.keys():  # whose nodes are the set
                keys = self.members(part, prefix, name, "elsets", 0)
                sets.setdefault(name, set()).update(*(elements[key][1] for key in keys if key in elements))
            for name, faces in part.surfaces.items():
                sets.setdefault(name, set()).update(self.faces(part, prefix, faces, rows, elements))
        if not self.springs and all(kind in FLAT for kind, *_ in elements.values()):
            self.fail(f"has no solid elements ({', '.join(SOLIDS)})", 0)
        groups: dict[tuple[str, str], list[tuple[int, list[int], int]]] = {}
        for key, (kind, nodes, number, line) in elements.items():
            if kind in FLAT:
                if key in made:
                    self.fail(f"element {number} is a {kind} with a section, which is not computed", line)
                self.flags.setdefault(kind, Flag("left_out", f"elements {kind} without a section make sets alone"))
                continue
            groups.setdefault((kind, made.get(key, ("", 0))[0]), []).append((number, nodes, line))
        blocks = []
        for (kind, material), found in groups.items():
            numbers, nodes, at = zip(*found, strict=True)
            known = self.materials.get(material, {})
            own = Material(**known) if {"young", "poisson"} <= known.keys() else None
            blocks.append(Block(kind, np.array(numbers), np.array(nodes), np.array(at), own, material))
        return Mesh(
            self.path,
            np.array(points, dtype=float) * self.length,
            np.array(ids),
            np.array(lines),
            tuple(blocks),
            {name: np.array(sorted(found), dtype=int) for name, found in sets.items()},
            tuple(self.flags.values()),
            tuple(self.beyond),
        )

    def members(self, part: _Part, prefix: str, name: str, of: str, line: int, depth: int = 0) -> Iterator[str]:
        """Yield the keys of a set's nodes or elements, sets within sets resolved."""
        known = getattr(part, of)
        if depth > DEEPEST:
            self.fail(f"set {name!r} contains itself", line)
        if name not in known:
            self.fail(f"names a set {name!r} that is not there (known: {', '.join(known) or 'none'})", line)
        for one in known[name]:
            if isinstance(one, int):
                yield f"{prefix}{one}"
            elif one.startswith("@"):
                yield from self.members(part, prefix, one[1:], "elsets", line, depth + 1)
            elif one in known:
                yield from self.members(part, prefix, one, of, line, depth + 1)
            elif "." in one:
                instance, _, rest = one.partition(".")
                if rest.isdigit():
                    yield one
                else:
                    inside = self.parts[self.instances[instance][0]] if instance in self.instances else _Part()
                    yield from self.members(inside, f"{instance}.", rest, of, line, depth + 1)
            else:
                self.fail(f"set {name!r} names {one!r}, which is not there", line)

    def faces(
        self,
        part: _Part,
        prefix: str,
        faces: list[tuple[int | str, str]],
        rows: dict[str, int],
        elements: dict[str, tuple[str, list[int], int, int]],
    ) -> Iterator[int]:
        """Yield the rows of the nodes of a surface."""
        for what, face in faces:
            if face == "NODE":
                keys = [f"{prefix}{what}"] if isinstance(what, int) else self.members(part, prefix, what, "nsets", 0)
                yield from (rows[key] for key in keys if key in rows)
                continue
            keys = [f"{prefix}{what}"] if isinstance(what, int) else self.members(part, prefix, what, "elsets", 0)
            for key in keys:
                if key in elements and elements[key][0] in SOLIDS:
                    kind, nodes, number, line = elements[key]
                    corners = 4 if SOLIDS[kind] in (4, 10) else 8
                    if int(face[1]) > len(FACES[corners]):
                        self.fail(f"element {number} ({kind}) has no face {face}", line)
                    own = set(FACES[corners][int(face[1]) - 1])
                    middles = nodes[corners:]
                    yield from (nodes[i] for i in own)
                    yield from (n for n, e in zip(middles, EDGES[corners], strict=False) if own.issuperset(e))


READERS = {
    "NODE": _Reader.node,
    "ELEMENT": _Reader.element,
    "NSET": _Reader.nset,
    "ELSET": _Reader.elset,
    "SURFACE": _Reader.surface,
    "MATERIAL": _Reader.new_material,
    "ELASTIC": _Reader.elastic,
    "DENSITY": _Reader.density_of,
    "SOLID SECTION": _Reader.section,
    "PART": _Reader.part,
    "END PART": _Reader.end,
    "INSTANCE": _Reader.instance,
}
