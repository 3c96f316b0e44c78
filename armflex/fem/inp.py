"""Abaqus and CalculiX input files: nodes, solids, sets, surfaces, materials; parts and instances flattened.

A small reader of our own: meshio's drops sections, surfaces, instances and line numbers. What is neither read here nor
known to be harmless is refused by name, or kept for CalculiX.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple, NoReturn

import numpy as np
from scipy.spatial.transform import Rotation

from armflex.conventions import Array
from armflex.errors import Flag, listing
from armflex.fem.mesh import (
    DEEPEST,
    EDGES,
    FACES,
    FLAT,
    MOST_LINES,
    NOT_COMPUTED,
    SOLIDS,
    Draft,
    Mesh,
    corners_of,
    words,
)

HARMLESS = words(
    """
    HEADING, PREPRINT, ASSEMBLY, END ASSEMBLY, END PART, END INSTANCE, AMPLITUDE, TIME POINTS, PHYSICAL CONSTANTS,
    FILTER, RESTART, SECTION CONTROLS, HOURGLASS STIFFNESS, ORIENTATION, EXPANSION, CONDUCTIVITY, SPECIFIC HEAT,
    LATENT HEAT, DAMPING, ELECTRICAL CONDUCTIVITY, MAGNETIC PERMEABILITY, INELASTIC HEAT FRACTION,
    JOULE HEAT FRACTION, DIFFUSIVITY, SOLUBILITY, DEPVAR, FAIL STRESS, FAIL STRAIN, SURFACE INTERACTION, FRICTION,
    SURFACE BEHAVIOR, CONTACT DAMPING, GAP CONDUCTANCE, GAP HEAT GENERATION, BOUNDARY, CLOAD, DLOAD, DSLOAD,
    INITIAL CONDITIONS, PREDEFINED FIELD, BASE MOTION, PSD-DEFINITION, SPECTRUM, STEP, END STEP, STATIC, FREQUENCY,
    BUCKLE, DYNAMIC, MODAL DYNAMIC, STEADY STATE DYNAMICS, RANDOM RESPONSE, RESPONSE SPECTRUM, COMPLEX FREQUENCY,
    VISCO, HEAT TRANSFER, COUPLED TEMPERATURE-DISPLACEMENT, SENSITIVITY, UNCOUPLED TEMPERATURE-DISPLACEMENT, GREEN,
    SUBSTRUCTURE GENERATE, RETAINED NODAL DOFS, SUBSTRUCTURE MATRIX OUTPUT, MATRIX GENERATE, MATRIX OUTPUT,
    ELEMENT MATRIX OUTPUT, SELECT CYCLIC SYMMETRY MODES, SELECT EIGENMODES, MODAL DAMPING, GLOBAL DAMPING, CONTROLS,
    SOLUTION TECHNIQUE, SOLVER CONTROLS, DIAGNOSTICS, BULK VISCOSITY, TEMPERATURE, FIELD, CFLUX, DFLUX, DSFLUX, FILM,
    SFILM, RADIATE, SRADIATE, FLUX, LOAD CASE, END LOAD CASE, CECURRENT, INERTIA RELIEF, OUTPUT, NODE OUTPUT,
    ELEMENT OUTPUT, CONTACT OUTPUT, ENERGY OUTPUT, MODAL OUTPUT, INCREMENTATION OUTPUT, RADIATION OUTPUT,
    SURFACE OUTPUT, INTEGRATED OUTPUT, INTEGRATED OUTPUT SECTION, FILE FORMAT, FILE OUTPUT, NODE PRINT, NODE FILE,
    EL PRINT, EL FILE, ELEMENT FILE, ELEMENT PRINT, CONTACT PRINT, CONTACT FILE, ENERGY PRINT, ENERGY FILE,
    MODAL PRINT, MODAL FILE, SECTION PRINT, SECTION FILE, FACE PRINT, MONITOR, PRINT, DESIGN VARIABLES,
    DESIGNVARIABLES, DESIGN RESPONSE, TRANSFORM
    """,
    ",",
)
"""Keywords that neither join, move, weigh nor shape solids: what a material has beside stiffness and density, loads,
what a step computes and what it prints."""

MAKING = words(
    "NGEN, NFILL, NCOPY, NMAP, ELGEN, ELCOPY, IMPERFECTION, IMPORT, SYMMETRIC MODEL GENERATION, PARAMETER", ","
)
"""Keywords that make or move nodes and elements, which nobody but the program of the file can follow."""

ORDER = {"SYSTEM": 0, "NODE": 0, "ELEMENT": 0, "SOLID SECTION": 2}
"""Keyword -> when it is read; all others are read between, in the file's order."""

MOST = 10_000_000
"""Numbers of a GENERATE."""

_SPLIT = re.compile(r"\s*,\s*")


class _Statement(NamedTuple):
    """A keyword with its parameters, its line, and its lines of data, each with its number."""

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
    """One draft, to which an instance adds its part's statements with its name before every number and set."""

    def __init__(self, path: Path, unit: str, springs: bool) -> None:
        self.draft, self.springs = Draft(path, unit), springs
        self.prefix, self.shift, self.turn = "", np.zeros(3), np.eye(3)
        self.systems: list[tuple[Array, Array]] = []
        self.surfaces: dict[str, list] = {}
        self.material, self.instances = "", False
        self.assembled: set[tuple[int, str]] = set()
        self.flags: dict[str, Flag] = {}
        self.beyond: list[tuple[str, int]] = []

    def fail(self, problem: str, line: int) -> NoReturn:
        self.draft.fail(problem, line)

    def mesh(self) -> Mesh:
        here = root = []
        begun = _Statement("", {}, 0, [])
        parts: dict[str, list[_Statement]] = {}
        instances: dict[str, tuple[list[_Statement], Array, Array]] = {}
        stepping = False
        for one in self.statements(self.draft.path):
            if one.keyword in ("PART", "INSTANCE"):
                begun = one
            stepping |= one.keyword == "STEP"
            if stepping:
                if one.keyword not in READERS and one.keyword not in HARMLESS and not self.springs:
                    self.fail(
                        f"*{one.keyword} in a *STEP is not computed here, and is not known to be harmless", one.line
                    )
            elif one.keyword == "PART":
                here = parts.setdefault(self.name(one, "NAME"), [])
            elif one.keyword == "INSTANCE":
                if (part := self.name(one, "PART")) not in parts:
                    known = listing(parts) or "none"
                    self.fail(f"*INSTANCE of a part {part!r} that is not there (parts: {known})", one.line)
                if more := sorted(one.parameters.keys() - {"NAME", "PART"}):
                    self.fail(f"*INSTANCE: {more[0]} is not read", one.line)
                here = list(parts[part])
                instances[f"{self.name(one, 'NAME')}."] = (here, *self.placed(one))
            elif one.keyword in ("END PART", "END INSTANCE"):
                here = root
            else:
                here.append(one)
        if here is not root:
            self.fail(f"*{begun.keyword} has no *END {begun.keyword}: is the file whole?", begun.line)
        whole = {f"{name}.": (own, np.zeros(3), np.eye(3)) for name, own in parts.items()}
        self.instances = bool(instances)
        for prefix, (own, shift, turn) in {**(instances or whole), "": (root, np.zeros(3), np.eye(3))}.items():
            self.prefix, self.shift, self.turn = prefix, shift, turn
            self.systems = []
            for one in sorted(own, key=lambda one: ORDER.get(one.keyword, 1)):
                self.read(one)
        self.draft.sets = self.surfaces | self.draft.sets
        return self.draft.mesh(self.flags.values(), self.beyond)

    def statements(self, path: Path, depth: int = 0) -> Iterator[_Statement]:
        """Yield the statements of a file and of those that it includes."""

        def parameters(given: list[str]) -> dict[str, str]:
            pairs = (one.partition("=") for one in given)
            return {" ".join(key.upper().split()): value.strip().strip("\"'") for key, _, value in pairs}

        now: _Statement | None = None
        unfinished = False
        for number, line in self.draft.text_lines(path):
            text = line.strip()
            if not text or text.startswith("**"):
                continue
            cells = _SPLIT.split(text.rstrip(", \t").lstrip("*"))
            if text.startswith("*"):
                if now is not None:
                    yield now
                unfinished = text.endswith(",")
                now = _Statement(" ".join(cells[0].upper().split()), parameters(cells[1:]), number, [])
                if now.keyword == "INCLUDE":
                    if depth >= DEEPEST or "INPUT" not in now.parameters:
                        self.fail("*INCLUDE needs INPUT=FILE, and at most five files include one another", number)
                    file = self.draft.beside(path, now.parameters["INPUT"], number)
                    yield from self.statements(file, depth + 1)
                    now = None
                elif "INPUT" in now.parameters and now.keyword in READERS:
                    file = self.draft.beside(path, now.parameters["INPUT"], number)
                    for line, row in self.draft.text_lines(file):
                        if row.strip() and not row.startswith("**"):
                            now.data.append((line, _SPLIT.split(row.strip().rstrip(", \t"))))
            elif now is None:
                self.fail(f"expected a keyword such as *NODE, got {text[:40]!r}", number)
            elif unfinished and ("=" in text or cells[0].upper() in ("GENERATE", "INTERNAL", "UNSORTED")):
                now.parameters.update(parameters(cells))  # a keyword goes on after a comma
                unfinished = text.endswith(",")
            else:
                now.data.append((number, cells))
                unfinished = False
        if now is not None:
            yield now

    def read(self, one: _Statement) -> None:
        """Take in one statement."""
        if one.keyword in READERS:
            reader, allowed = READERS[one.keyword]
            more = sorted(one.parameters.keys() - {*allowed.split(), "INTERNAL", ""})
            if more and one.keyword != "SURFACE":
                self.fail(f"*{one.keyword}: {more[0]} is not read (read: {listing(allowed.split())})", one.line)
            reader(self, one)
        elif one.keyword in MAKING or (one.keyword not in HARMLESS and not self.springs):
            text = "is not computed here, and is not known to be harmless (solids with a linear isotropic material are)"
            self.fail(f"*{one.keyword} {text}", one.line)
        elif one.keyword == "RESTART" and "READ" in one.parameters:
            self.fail("*RESTART, READ: the model is in another job's files", one.line)
        elif one.keyword not in HARMLESS:
            self.beyond.append((one.keyword, one.line))
        elif one.keyword in ("BOUNDARY", "CLOAD", "DLOAD", "DSLOAD", "INITIAL CONDITIONS"):
            text = f"*{one.keyword} (line {one.line % MOST_LINES}) is left out: --fixed says what is held"
            self.flags.setdefault(one.keyword, Flag("left_out", text))

    def name(self, one: _Statement, key: str) -> str:
        if not one.parameters.get(key):
            self.fail(f"*{one.keyword} needs {key}=NAME", one.line)
        return one.parameters[key].upper()

    def into(self, sets: dict[str, list], name: str) -> list[list]:
        """Return the lists of a set: in an instance its own, and that of all instances if the assembly has none."""
        key = id(sets), name.upper()
        if self.instances and not self.prefix and key not in self.assembled:
            self.assembled.add(key)
            sets.pop(name.upper(), None)
        return [sets.setdefault(one, []) for one in dict.fromkeys((name.upper(), f"{self.prefix}{name.upper()}"))]

    def node(self, one: _Statement) -> None:
        sets = self.into(self.draft.sets, one.parameters["NSET"]) if "NSET" in one.parameters else []
        if one.parameters.get("SYSTEM", "R").upper() != "R":
            self.fail("*NODE in cylindrical or spherical coordinates is not read", one.line)
        moves = [*self.systems, *[(self.shift, self.turn)] * bool(self.prefix)]
        for line, cells in one.data:
            (number,), place = self.draft.whole(line, cells[:1], 1), self.draft.numbers(line, cells, 2)[1:4]
            place = [*place, 0.0, 0.0][:3]
            for shift, turn in moves:
                place = turn @ place + shift
            self.draft.node(f"{self.prefix}{number}", number, place, line)
            if self.instances and not self.prefix:
                self.draft.references.add(f"{number}")
            for own in sets:
                own.append(f"{self.prefix}{number}")

    def new_system(self, one: _Statement) -> None:
        """Take in where the next nodes' origin is, and points on the x axis and above it in the plane x y."""
        values = [value for line, cells in one.data for value in self.draft.numbers(line, cells)]
        if len(values) not in (0, 3, 9):
            self.fail("*SYSTEM needs an origin, or it with a point on the x axis and one in the plane x y", one.line)
        origin, *ends = np.reshape(values or [0.0, 0.0, 0.0], (-1, 3))
        self.systems = [(origin, np.eye(3))]
        if ends:
            x, above = (end - origin for end in ends)
            z = np.cross(x, above)
            if not z.any():
                self.fail("*SYSTEM has three points on one line", one.line)
            axes = [axis / np.linalg.norm(axis) for axis in (x, np.cross(z, x), z)]
            self.systems = [(origin, np.column_stack(axes))]

    def element(self, one: _Statement) -> None:
        kind = self.name(one, "TYPE")
        sets = self.into(self.draft.groups, one.parameters["ELSET"]) if "ELSET" in one.parameters else []
        if (count := SOLIDS.get(kind) or FLAT.get(kind)) is None:
            if not self.springs:
                self.fail(f"elements of the type {kind} are not computed: {NOT_COMPUTED}", one.line)
            self.beyond.append((f"ELEMENT, TYPE={kind}", one.line))
            return
        if kind in FLAT:
            self.flags.setdefault(kind, Flag("left_out", f"elements {kind} without a section make sets alone"))
        waiting, begun = [], one.line
        for line, cells in [*one.data, (one.line, [])]:
            begun = begun if waiting else line
            waiting += self.draft.whole(line, cells)
            if len(waiting) > count + 1 or (waiting and not cells):
                self.fail(f"element {waiting[0]} has {len(waiting) - 1} nodes; a {kind} has {count}", begun)
            if len(waiting) == count + 1:
                key, nodes = f"{self.prefix}{waiting[0]}", [f"{self.prefix}{node}" for node in waiting[1:]]
                self.draft.element(key, waiting[0], kind, nodes, begun)
                for own in sets:
                    own.append(key)
                waiting = []

    def members(self, of: dict[str, list], one: _Statement, line: int, cells: list[str]) -> Iterator[str]:
        """Yield the keys of nodes or elements that numbers and names of sets, defined before, stand for."""
        known = self.draft.nodes if of is self.draft.sets else self.draft.elements
        before = f"{one.parameters['INSTANCE'].upper()}." if "INSTANCE" in one.parameters else self.prefix
        if "GENERATE" in one.parameters:
            first, last, step = [*self.draft.whole(line, cells), 1, 1, 1][:3]
            if len(cells) < 2 or step < 1 or (last - first) // step > MOST:
                self.fail(f"expected first, last, step, got {','.join(cells)}", line)
            yield from (f"{before}{number}" for number in range(first, last + 1, step) if f"{before}{number}" in known)
            return
        for cell in filter(None, cells):
            key = f"{before}{cell.upper()}".replace('"', "")
            if key in known:
                yield key
            elif key in of:
                yield from list(of[key])
            elif not self.springs:  # with them, elements that are CalculiX's alone are in no list
                self.fail(f"*{one.keyword} names {cell!r}, which is not there", line)

    def nset(self, one: _Statement) -> None:
        draft, name = self.draft, self.name(one, "NSET")
        found = [key for line, cells in one.data for key in self.members(draft.sets, one, line, cells)]
        if "ELSET" in one.parameters:  # the nodes of elements
            keys = self.members(draft.groups, one, one.line, [one.parameters["ELSET"]])
            found = [node for key in keys for node in draft.elements[key][2]]
        for own in self.into(draft.sets, name):
            own += found

    def elset(self, one: _Statement) -> None:
        name, groups = self.name(one, "ELSET"), self.draft.groups
        found = [key for line, cells in one.data for key in self.members(groups, one, line, cells)]
        for own in self.into(groups, name):
            own += found

    def surface(self, one: _Statement) -> None:
        draft, found, name = self.draft, [], self.name(one, "NAME")
        kind = one.parameters.get("TYPE", "ELEMENT").upper()
        if kind not in ("ELEMENT", "NODE") or one.parameters.keys() - {"NAME", "TYPE", "INTERNAL"}:
            draft.unread |= dict.fromkeys(
                (name, f"{self.prefix}{name}"), ("is a *SURFACE of a kind not read", one.line)
            )
            return
        for line, (what, *faces) in one.data:
            if kind == "NODE":
                found += self.members(draft.sets, one, line, [what])
                continue
            face = faces[0].upper() if faces else ""
            if not re.fullmatch(r"S[1-6]", face):
                text = f"is a *SURFACE of {what!r}, {face!r}: expected an element or a set of them and a face S1 to S6"
                draft.unread |= dict.fromkeys((name, f"{self.prefix}{name}"), (text, line))
                return
            for key in self.members(draft.groups, one, line, [what]):
                number, kind_of, nodes, _ = draft.elements[key]
                if kind_of in FLAT:
                    continue
                corners = corners_of(kind_of)
                if int(face[1]) > len(FACES[corners]):
                    self.fail(f"element {number} ({kind_of}) has no face {face}", line)
                own = set(FACES[corners][int(face[1]) - 1])
                middles = zip(nodes[corners:], EDGES[corners], strict=False)
                found += [*(nodes[i] for i in own), *(node for node, edge in middles if own.issuperset(edge))]
        for own in self.into(self.surfaces, name):
            own += found

    def new_material(self, one: _Statement) -> None:
        self.material = self.name(one, "NAME")
        self.draft.materials.setdefault(self.material, {})

    def elastic(self, one: _Statement) -> None:
        kind = one.parameters.get("TYPE", "ISO").upper()
        if not kind.startswith("ISO") or len(one.data) != 1 or len(one.data[0][1]) > 3 or not self.material:
            text = "one line of an isotropic *ELASTIC in a *MATERIAL is read: Young's modulus, Poisson's ratio"
            self.fail(text, one.line)
        young, poisson = self.draft.numbers(*one.data[0], 2)[:2]
        self.draft.material(self.material, one.line, young=young, poisson=poisson)

    def density(self, one: _Statement) -> None:
        if not one.data or not self.material:
            self.fail("*DENSITY needs a number and a *MATERIAL", one.line)
        values = [self.draft.numbers(line, cells, 1)[0] for line, cells in one.data]
        if min(values) < max(values):
            text = f"*DENSITY (line {one.line % MOST_LINES}) depends on the temperature: its first is that of the part"
            self.flags.setdefault("DENSITY", Flag("density", text))
        self.draft.material(self.material, one.line, density=values[0])

    def section(self, one: _Statement) -> None:
        keys = list(self.members(self.draft.groups, one, one.line, [self.name(one, "ELSET")]))
        self.draft.sections.append((keys, self.name(one, "MATERIAL"), one.line))

    def placed(self, one: _Statement) -> tuple[Array, Array]:
        """Return the (3,) shift and (3, 3) rotation of an instance."""
        shift = np.array(self.draft.numbers(*one.data[0], 3)[:3]) if one.data else np.zeros(3)
        if len(one.data) < 2:
            return shift, np.eye(3)
        x = np.array(self.draft.numbers(*one.data[1], 7)[:7])
        if not (axis := x[3:6] - x[:3]).any():
            self.fail("*INSTANCE is turned about an axis without length", one.line)
        turn = Rotation.from_rotvec(np.radians(x[6]) * axis / np.linalg.norm(axis)).as_matrix()
        return turn @ (shift - x[:3]) + x[:3], turn


READERS = {
    "SYSTEM": (_Reader.new_system, ""),
    "NODE": (_Reader.node, "NSET SYSTEM INPUT"),
    "ELEMENT": (_Reader.element, "TYPE ELSET INPUT"),
    "NSET": (_Reader.nset, "NSET ELSET GENERATE INSTANCE UNSORTED"),
    "ELSET": (_Reader.elset, "ELSET GENERATE INSTANCE UNSORTED"),
    "SURFACE": (_Reader.surface, "NAME"),
    "MATERIAL": (_Reader.new_material, "NAME DESCRIPTION RTOL"),
    "ELASTIC": (_Reader.elastic, "TYPE"),
    "DENSITY": (_Reader.density, ""),
    "SOLID SECTION": (_Reader.section, "ELSET MATERIAL ORIENTATION CONTROLS"),
}
"""Keyword -> what reads it, and the parameters that are read or harmless; a surface of further ones is left unread."""
