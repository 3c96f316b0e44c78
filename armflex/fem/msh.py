"""gmsh meshes, and STEP files by gmsh, which is GPL and only called where it is installed.

What a binary file has becomes the rows that a text has, so that one reader judges both.
"""

import re
import struct
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from armflex.errors import MeshError, Place, UnsupportedError, did_you_mean, listing
from armflex.fem.mesh import FLAT, MOST_BYTES, NOT_COMPUTED, SOLIDS, Draft, Mesh
from armflex.storage.read_file import read_file
from armflex.storage.whole_file import scratch

KINDS = {"tetra": "C3D4", "tetra10": "C3D10", "hexahedron": "C3D8", "hexahedron20": "C3D20"}
"""Name of a type -> CalculiX's."""

TYPES = (
    *("", "line", "triangle", "quad", "tetra", "hexahedron", "wedge", "pyramid", "line3", "triangle6", "quad9"),
    *("tetra10", "hexahedron27", "wedge18", "pyramid14", "vertex", "quad8", "hexahedron20", "wedge15", "pyramid13"),
)
"""gmsh's number of a type -> its name."""

ORDERS = {"C3D10": [*range(8), 9, 8], "C3D20": [*range(9), 11, 13, 9, 16, 18, 19, 17, 10, 12, 14, 15]}
"""Type -> places of its nodes in gmsh's order."""

READ = ("MeshFormat", "PhysicalNames", "Entities", "Nodes", "Elements")
"""Sections that are read."""

HARMLESS = ("Comments", "Comment", "Periodic", "NodeData", "ElementData", "ElementNodeData", "InterpolationScheme")
"""Sections of remarks, results, and of which nodes of a mesh correspond."""

OPTIONS = {
    "ParametricNodes": "Mesh.SaveParametric = 0",
    **dict.fromkeys(("PartitionedEntities", "GhostElements"), "Mesh.NbPartitions = 0, or unpartition the mesh"),
}
"""Section that is not read -> what makes gmsh write the mesh without it."""

Row = tuple[int, str]
"""A line that is not empty, and its number; 0 in a binary file."""


def read_msh(path: Path, unit: str = "m") -> Mesh:
    """Read a gmsh mesh; physical groups are sets. See `inp.read_inp`."""
    draft = Draft(path, unit)
    rows = ((line, text.strip()) for line, text in draft.text_lines(path) if text.strip())
    start = next(((line, next(rows, (0, ""))[1]) for line, text in rows if text == "$MeshFormat"), (0, ""))
    version, binary, *_ = [*start[1].split(), "", ""]
    if not start[0]:
        draft.fail("is no gmsh mesh: it has no $MeshFormat")
    if not (version.startswith("2") or version == "4.1"):  # gmsh's own 4.0 says 4
        draft.fail(f"version {version!r} of gmsh's format is not read: in gmsh Mesh.MshFileVersion = 4.1")
    sections = _sections(draft) if binary == "0" else _Binary(draft, start[1]).sections
    _take_in(draft, sections, apart=not version.startswith("2"))
    return draft.mesh()


def _sections(draft: Draft) -> dict[str, list[Row]]:
    """Return the sections of a text by name, each with the line that begins it first."""
    sections: dict[str, list[Row]] = {}
    name, begun = "", 0
    for line, text in draft.text_lines(draft.path):
        text = text.strip()
        if name and text == f"$End{name}":
            name = ""
        elif name and text.startswith("$") and not name.startswith("Comment"):
            draft.fail(f"${name} of line {begun} ends with $End{name}, got {text[:40]!r}: is the file whole?", line)
        elif name:
            if text and name in READ:
                sections[name].append((line, text))
        elif text.startswith("$"):
            name, begun = _begin(draft, sections, line, text), line
        elif text:
            draft.fail(f"expected a section such as $Nodes, got {text[:40]!r}", line)
    if name:
        draft.fail(f"${name} does not end: is the file whole?", begun)
    return sections


def _begin(draft: Draft, sections: dict[str, list[Row]], line: int, text: str) -> str:
    """Add a section by the line that begins it; return its name."""
    name = text[1:]
    if name in OPTIONS:
        draft.fail(f"{text} is not read: in gmsh {OPTIONS[name]}", line)
    if name not in (*READ, *HARMLESS):
        hint = did_you_mean(name, READ) or f" (known: {listing((*READ, *HARMLESS))})"
        draft.fail(f"no section of a gmsh mesh is called {text[:40]}{hint}", line)
    if name in READ and name in sections:
        draft.fail(f"{text} stands twice", line)
    sections[name] = [(line, text)]
    return name


class _Binary:
    """The sections of a binary file as rows of a text, each with the line that begins it first.

    Source: gmsh's reference manual, "MSH file format", of version 4.1, and of 2 (legacy).
    """

    def __init__(self, draft: Draft, form: str) -> None:
        self.draft, self.at, self.order = draft, 0, "<"
        try:
            self.data = read_file(draft.path, MOST_BYTES)
        except OSError as error:
            draft.fail(f"cannot be read: {error.strerror or error}")
        version, _, *size = form.split()
        if size != ["8"]:
            draft.fail(f"has numbers of {' '.join(size) or 'no'} bytes, expected 8")
        self.sections: dict[str, list[Row]] = {}
        while text := self.line():
            if not text.startswith("$"):
                draft.fail(f"expected a section such as $Nodes, got {text[:40]!r}")
            name = _begin(draft, self.sections, 0, text)
            if name == "MeshFormat":
                self.line()
                self.order = {1: "<", 1 << 24: ">"}.get(self.take("i")[0][0], "")
                if not self.order:
                    draft.fail("does not say in which order its bytes are: is the file whole?")
            elif name in ("Nodes", "Elements", "Entities"):
                read = getattr(self, f"{name.lower()}_{'2' if version.startswith('2') else '4'}", None)
                self.sections[name] += [] if read is None else ((0, text) for text in read())
            else:
                content, _, after = self.data[self.at :].partition(f"$End{name}".encode())
                rows = content.decode("utf-8", "replace").splitlines() if name in READ else ()
                self.sections[name] += [(0, row.strip()) for row in rows if row.strip()]
                self.at = len(self.data) - len(after) - len(name) - 4 if after else len(self.data)
            if (end := self.line()) != f"$End{name}":
                end = f", got {end[:40]!r}" if end.isascii() and end.isprintable() and end else ""
                draft.fail(f"${name} does not end with $End{name} after what its counts state{end}: is the file whole?")

    def line(self) -> str:
        """Return the next line that is not empty, '' where there is none."""
        text = ""
        while not text and self.at < len(self.data):
            end = self.data.find(b"\n", self.at) + 1 or len(self.data)
            text, self.at = self.data[self.at : end].decode("utf-8", "replace").strip(), end
        return text

    def take(self, form: str, count: int = 1) -> list[tuple]:
        """Return so many times the next numbers, in the form of `struct`."""
        size = struct.calcsize(self.order + form)
        if count < 0 or size * count > len(self.data) - self.at:
            name = [*self.sections][-1]
            text = f"${name} has fewer than the {count} rows of {size} bytes that it states: is the file whole?"
            self.draft.fail(text)
        start, self.at = self.at, self.at + size * count
        return [*struct.iter_unpack(self.order + form, self.data[start : self.at])]

    def stated(self) -> int:
        """Return a count that stands in a line of text."""
        return self.draft.whole(0, [self.line()], 1)[0]

    def nodes_2(self) -> Iterator[str]:
        yield str(count := self.stated())
        yield from _texts(self.take("i3d", count))

    def elements_2(self) -> Iterator[str]:
        yield str(count := self.stated())
        while count > 0 and not self.data.startswith(b"\n$End", self.at):
            ((kind, several, tags),) = self.take("3i")
            count -= max(several, 1)
            width = _shape(self.draft, 0, kind)[1]
            for number, *more in self.take(f"{1 + max(tags, 0) + width}i", several):
                yield " ".join(map(str, [number, kind, tags, *more]))

    def entities_4(self) -> Iterator[str]:
        (counts,) = self.take("4Q")
        yield from _texts([counts])
        for dimension, count in enumerate(counts):
            for _ in range(count):
                ((tag, *box, groups),) = self.take("i6dQ" if dimension else "i3dQ")
                yield " ".join(map(str, [tag, *box, groups, *(tag for (tag,) in self.take("i", groups))]))
                self.take("i", self.take("Q")[0][0] if dimension else 0)

    def nodes_4(self) -> Iterator[str]:
        def rows(dimension: int, parametric: int, count: int) -> list[tuple]:
            width = 3 + max(dimension, 0) * bool(parametric)  # parameters of a curve or a surface beside the place
            return [*self.take("Q", count), *self.take(f"{width}d", count)]

        return self.blocks(lambda block: rows(block[0], block[2], block[3]))

    def elements_4(self) -> Iterator[str]:
        return self.blocks(lambda block: self.take(f"{1 + _shape(self.draft, 0, block[2])[1]}Q", block[3]))

    def blocks(self, rows_of: Callable[[tuple], list[tuple]]) -> Iterator[str]:
        """Yield the counts of a section, and every block's four numbers with its rows behind them."""
        (counts,) = self.take("4Q")
        yield from _texts([counts])
        for _ in range(counts[0]):
            (block,) = self.take("3iQ")
            yield from _texts([block, *rows_of(block)])


def _texts(rows: list[tuple]) -> Iterator[str]:
    return (" ".join(map(str, row)) for row in rows)


def _shape(draft: Draft, line: int, kind: int) -> tuple[str, int]:
    """Return the type of elements that gmsh has a number for, and of how many nodes each is."""
    name = TYPES[kind] if 0 < kind < len(TYPES) else f"number {kind}"
    if (shape := KINDS.get(name, name)) not in (*SOLIDS, *FLAT):
        remedy = " (in gmsh Mesh.SecondOrderIncomplete = 1)" * (name == "hexahedron27")
        draft.fail(f"elements of the type {name} are not computed{remedy}: {NOT_COMPUTED}", line)
    return shape, SOLIDS.get(shape) or FLAT[shape]


class _MeshLines:
    """The rows of a section, of which counts in it say how many there are."""

    def __init__(self, draft: Draft, rows: list[Row]) -> None:
        self.draft, self.rows, self.at = draft, rows, 1
        self.name = rows[0][1]

    def take(self, count: int, of: str) -> list[Row]:
        """Return the next rows."""
        taken = self.rows[self.at : self.at + count]
        if len(taken) < count or count < 0:
            text = f"{self.name} has {len(self.rows) - self.at} rows where {count} {of} are stated: is the file whole?"
            self.draft.fail(text, self.rows[min(self.at, len(self.rows)) - 1][0])
        self.at += count
        return taken

    def whole(self, of: str, least: int) -> list[int]:
        """Return the whole numbers of the next row, at least so many."""
        ((line, text),) = self.take(1, of)
        return self.draft.whole(line, text.split(), least)

    def end(self, stated: int, counted: int, of: str) -> None:
        """Refuse rows that no count states."""
        if self.at < len(self.rows) or stated != counted:
            line = self.rows[self.at][0] if self.at < len(self.rows) else self.rows[0][0]
            counted += len(self.rows) - self.at
            self.draft.fail(f"{self.name} states {stated} {of} and has {counted}", line)

    def blocks(self, of: str, apart: bool) -> Iterator[tuple[int, int, int, int, int]]:
        """Yield a line and four whole numbers of every block, the last its count; version 2 has one, of a count."""
        head, counted = self.whole("counts", 1 + apart), 0
        stated = head[apart]
        for _ in range(head[0] if apart else 1):
            first, second, third, count, *_ = self.whole("blocks", 4) if apart else (0, 0, 0, stated)
            yield self.rows[self.at - 1][0], first, second, third, count
            counted += count
        self.end(stated, counted, of)


def _take_in(draft: Draft, sections: dict[str, list[Row]], apart: bool) -> None:
    """Take in the sections of a version 4.1, whose blocks have their rows `apart`, or of 2."""
    for name in ("Nodes", "Elements"):
        if name not in sections:
            draft.fail(f"has no ${name}: is the file whole?")
    names: dict[tuple[int, int], str] = {}
    if "PhysicalNames" in sections:
        rows = _MeshLines(draft, sections["PhysicalNames"])
        (stated, *_) = rows.whole("numbers", 1)
        for line, text in rows.take(stated, "names"):
            if (match := re.fullmatch(r'(\d)\s+(\d+)\s+"(.*)"', text)) is None:
                draft.fail(f'expected dimension, tag, "name", got {text[:40]!r}', line)
            names[int(match[1]), int(match[2])] = match[3]
        rows.end(stated, stated, "names")
    groups = _entities(draft, sections["Entities"]) if apart and "Entities" in sections else None
    rows = _MeshLines(draft, sections["Nodes"])
    for begun, _, _, parametric, count in rows.blocks("nodes", apart):
        if parametric:
            draft.fail(f"parametric nodes are not read: in gmsh {OPTIONS['ParametricNodes']}", begun)
        numbers = rows.take(count, "nodes") if apart else []
        for place, (line, text) in enumerate(rows.take(count, "nodes")):
            cells = [*(numbers[place][1].split() if apart else ()), *text.split()]
            if len(cells) != 4:
                draft.fail(f"expected a node's number and three coordinates, got {' '.join(cells)[:60]!r}", line)
            (key,) = draft.whole(line, cells[:1], 1)
            draft.node(key, key, draft.numbers(line, cells[1:], 3), line)
    rows = _MeshLines(draft, sections["Elements"])
    stood: dict[tuple[int, ...], tuple[int, set[int]]] = {}
    for begun, dimension, entity, kind, count in rows.blocks("elements", apart):
        tags = [] if groups is None else groups.get((dimension, entity))
        if tags is None:
            draft.fail(f"elements of the entity {dimension} {entity}, which is not in $Entities", begun)
        for line, text in rows.take(count, "elements"):
            again, (number, *cells) = False, draft.whole(line, text.split(), 2 if apart else 4)
            if not apart:  # type, count of tags, tags of which the first is physical, nodes
                kind, more, *cells = cells
                (tag, entity), cells = [*cells[:more], 0, 0][:2], cells[more:]
                tags, (first, groups_of) = [tag], stood.setdefault((kind, entity, *cells), (number, set()))
                again = bool(groups_of) and tag not in groups_of  # in several groups an element stands once for each
                number = first if again else number
                groups_of.add(tag)
            shape, size = _shape(draft, line, kind)
            if len(cells) != size:
                draft.fail(f"element {number} has {len(cells)} nodes; a {shape} has {size}", line)
            if not again:
                draft.element(number, number, shape, [cells[i] for i in ORDERS.get(shape, range(size))], line)
            dimension = 3 if shape in SOLIDS else 0 if shape == "vertex" else 1 if shape.startswith("line") else 2
            for tag in filter(None, map(abs, tags)):
                draft.groups.setdefault(names.get((dimension, tag), f"group_{tag}"), []).append(number)


def _entities(draft: Draft, section: list[Row]) -> dict[tuple[int, int], list[int]]:
    """Return the physical tags of every entity, by its dimension and tag."""
    rows, physical = _MeshLines(draft, section), {}
    counts = rows.whole("numbers", 4)[:4]
    for dimension, count in enumerate(counts):
        box = 3 if dimension == 0 else 6
        for line, text in rows.take(count, "entities"):
            cells = text.split()
            tag, size, *tags = draft.whole(line, [*cells[:1], *cells[1 + box :]], 2)
            physical[dimension, tag] = tags[:size]
    rows.end(sum(counts), sum(counts), "entities")
    return physical


def mesh_step(path: Path, size: float, order: int = 2) -> Mesh:
    """Mesh a STEP file with gmsh into tetrahedra; sets are its faces, `face_1` on, and what its entities are named.

    Args:
        path: The file.
        size: Of the elements [m].
        order: 2 for C3D10, 1 for C3D4.

    Raises:
        UnsupportedError: gmsh is not installed.
        MeshError: gmsh cannot read or mesh it.
    """
    try:
        import gmsh
    except ImportError:
        raise UnsupportedError("a STEP file is meshed with gmsh (GPL): pip install gmsh") from None
    except OSError as error:  # its wheel needs libraries of the system
        raise UnsupportedError(f"gmsh is installed and cannot be loaded: {error}") from None
    if not path.is_file():
        raise MeshError(Place(path), "cannot be read: there is no such file")
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setString("Geometry.OCCTargetUnit", "M")  # the file knows its own unit
        gmsh.model.add(path.stem)
        gmsh.model.occ.importShapes(str(path))
        gmsh.model.occ.synchronize()
        groups: dict[tuple[int, str], list[int]] = {}
        for dimension, tag in [*gmsh.model.getEntities(3), *gmsh.model.getEntities(2)]:
            groups[dimension, f"{'solid' if dimension == 3 else 'face'}_{tag}"] = [tag]
            if dimension == 2 and (group := gmsh.model.getEntityName(2, tag).rpartition("/")[2]):
                groups.setdefault((2, group), []).append(tag)
        for (dimension, name), tags in groups.items():
            gmsh.model.addPhysicalGroup(dimension, tags, name=name)
        for bound in ("Min", "Max"):
            gmsh.option.setNumber(f"Mesh.MeshSize{bound}", size)
        gmsh.model.mesh.generate(3)
        gmsh.model.mesh.setOrder(order)
        with scratch() as folder:
            gmsh.write(str(folder / f"{path.stem}.msh"))
            mesh = read_msh(folder / f"{path.stem}.msh")
    except MeshError:
        raise
    except Exception as error:  # gmsh raises plain exceptions
        raise MeshError(Place(path), f"gmsh cannot mesh it: {error}") from None
    finally:
        gmsh.finalize()
    return replace(mesh, path=path, lines=np.zeros_like(mesh.lines))
