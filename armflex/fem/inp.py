"""Abaqus and CalculiX input files: nodes, solids, sets, surfaces, materials; parts and instances flattened.

A small reader of our own: meshio's drops sections, surfaces, instances and line numbers. What is neither read here nor
known to be harmless is refused by name, or kept for CalculiX.
"""

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
    LATENT HEAT, PLASTIC, CYCLIC HARDENING, RATE DEPENDENT, CREEP, SWELLING, ANNEAL TEMPERATURE, TENSILE FAILURE,
    SHEAR FAILURE, DAMAGE INITIATION, DAMAGE EVOLUTION, DAMAGE STABILIZATION, DAMPING, ELECTRICAL CONDUCTIVITY,
    MAGNETIC PERMEABILITY, INELASTIC HEAT FRACTION,
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
        for statement in self.statements(self.draft.path):
            if statement.keyword in ("PART", "INSTANCE"):
                begun = statement
            stepping |= statement.keyword == "STEP"
            if stepping:
                if statement.keyword not in READERS and statement.keyword not in HARMLESS and not self.springs:
                    self.fail(
                        f"*{statement.keyword} in a *STEP is not computed here, and is not known to be harmless",
                        statement.line,
                    )
                if statement.keyword == "BOUNDARY":
                    self.left_out(statement)
            elif statement.keyword == "PART":
                here = parts.setdefault(self.name(statement, "NAME"), [])
            elif statement.keyword == "INSTANCE":
                if (part := self.name(statement, "PART")) not in parts:
                    names = listing(parts) or "none"
                    self.fail(f"*INSTANCE of a part {part!r} that is not there (parts: {names})", statement.line)
                if more := sorted(statement.parameters.keys() - {"NAME", "PART"}):
                    self.fail(f"*INSTANCE: {more[0]} is not read", statement.line)
                here = list(parts[part])
                instances[f"{self.name(statement, 'NAME')}."] = (here, *self.placed(statement))
            elif statement.keyword in ("END PART", "END INSTANCE"):
                here = root
            else:
                here.append(statement)
        if here is not root:
            self.fail(f"*{begun.keyword} has no *END {begun.keyword}: is the file whole?", begun.line)
        whole = {f"{name}.": (statements, np.zeros(3), np.eye(3)) for name, statements in parts.items()}
        self.instances = bool(instances)
        for prefix, (statements, shift, turn) in {**(instances or whole), "": (root, np.zeros(3), np.eye(3))}.items():
            self.prefix, self.shift, self.turn = prefix, shift, turn
            self.systems = []
            for statement in sorted(statements, key=lambda statement: ORDER.get(statement.keyword, 1)):
                self.read(statement)
        self.draft.sets = self.surfaces | self.draft.sets
        return self.draft.mesh(self.flags.values(), self.beyond)

    def statements(self, path: Path, depth: int = 0) -> Iterator[_Statement]:
        """Yield the statements of a file and of those that it includes."""

        def parameters(given: list[str]) -> dict[str, str]:
            pairs = (pair.partition("=") for pair in given)
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

    def read(self, statement: _Statement) -> None:
        """Take in one statement."""
        if statement.keyword in READERS:
            reader, allowed = READERS[statement.keyword]
            more = sorted(statement.parameters.keys() - {*allowed.split(), "INTERNAL", ""})
            if more and statement.keyword != "SURFACE":
                self.fail(
                    f"*{statement.keyword}: {more[0]} is not read (read: {listing(allowed.split())})", statement.line
                )
            reader(self, statement)
        elif statement.keyword in MAKING or (statement.keyword not in HARMLESS and not self.springs):
            text = "is not computed here, and is not known to be harmless (solids with a linear isotropic material are)"
            self.fail(f"*{statement.keyword} {text}", statement.line)
        elif statement.keyword == "RESTART" and "READ" in statement.parameters:
            self.fail("*RESTART, READ: the model is in another job's files", statement.line)
        elif statement.keyword not in HARMLESS:
            self.beyond.append((statement.keyword, statement.line))
        elif statement.keyword in ("BOUNDARY", "CLOAD", "DLOAD", "DSLOAD", "INITIAL CONDITIONS"):
            self.left_out(statement)

    def left_out(self, statement: _Statement) -> None:
        text = f"*{statement.keyword} (line {statement.line % MOST_LINES}) is left out: --fixed says what is held"
        self.flags.setdefault(statement.keyword, Flag("left_out", text))

    def name(self, statement: _Statement, key: str) -> str:
        if not statement.parameters.get(key):
            self.fail(f"*{statement.keyword} needs {key}=NAME", statement.line)
        return statement.parameters[key].upper()

    def into(self, sets: dict[str, list], name: str) -> list[list]:
        """Return the lists of a set: in an instance its own, and that of all instances if the assembly has none."""
        key = id(sets), name.upper()
        if self.instances and not self.prefix and key not in self.assembled:
            self.assembled.add(key)
            sets.pop(name.upper(), None)
        return [sets.setdefault(key, []) for key in dict.fromkeys((name.upper(), f"{self.prefix}{name.upper()}"))]

    def node(self, statement: _Statement) -> None:
        sets = self.into(self.draft.sets, statement.parameters["NSET"]) if "NSET" in statement.parameters else []
        if statement.parameters.get("SYSTEM", "R").upper() != "R":
            self.fail("*NODE in cylindrical or spherical coordinates is not read", statement.line)
        moves = [*self.systems, *[(self.shift, self.turn)] * bool(self.prefix)]
        for line, cells in statement.data:
            (number,), place = self.draft.whole(line, cells[:1], 1), self.draft.numbers(line, cells, 2)[1:4]
            place = [*place, 0.0, 0.0][:3]
            for shift, turn in moves:
                place = turn @ place + shift
            self.draft.node(f"{self.prefix}{number}", number, place, line)
            if self.instances and not self.prefix:
                self.draft.references.add(f"{number}")
            for members in sets:
                members.append(f"{self.prefix}{number}")

    def new_system(self, statement: _Statement) -> None:
        """Take in where the next nodes' origin is, and points on the x axis and above it in the plane x y."""
        values = [value for line, cells in statement.data for value in self.draft.numbers(line, cells)]
        if len(values) not in (0, 3, 9):
            self.fail(
                "*SYSTEM needs an origin, or it with a point on the x axis and one in the plane x y", statement.line
            )
        origin, *ends = np.reshape(values or [0.0, 0.0, 0.0], (-1, 3))
        self.systems = [(origin, np.eye(3))]
        if ends:
            x, above = (end - origin for end in ends)
            z = np.cross(x, above)
            if not z.any():
                self.fail("*SYSTEM has three points on one line", statement.line)
            axes = [axis / np.linalg.norm(axis) for axis in (x, np.cross(z, x), z)]
            self.systems = [(origin, np.column_stack(axes))]

    def element(self, statement: _Statement) -> None:
        kind = self.name(statement, "TYPE")
        sets = self.into(self.draft.groups, statement.parameters["ELSET"]) if "ELSET" in statement.parameters else []
        if (count := SOLIDS.get(kind) or FLAT.get(kind)) is None:
            if not self.springs:
                self.fail(f"elements of the type {kind} are not computed: {NOT_COMPUTED}", statement.line)
            self.beyond.append((f"ELEMENT, TYPE={kind}", statement.line))
            return
        if kind in FLAT:
            self.flags.setdefault(kind, Flag("left_out", f"elements {kind} without a section make sets alone"))
        waiting, begun = [], statement.line
        for line, cells in [*statement.data, (statement.line, [])]:
            begun = begun if waiting else line
            waiting += self.draft.whole(line, cells)
            if len(waiting) > count + 1 or (waiting and not cells):
                self.fail(f"element {waiting[0]} has {len(waiting) - 1} nodes; a {kind} has {count}", begun)
            if len(waiting) == count + 1:
                key, nodes = f"{self.prefix}{waiting[0]}", [f"{self.prefix}{node}" for node in waiting[1:]]
                self.draft.element(key, waiting[0], kind, nodes, begun)
                for members in sets:
                    members.append(key)
                waiting = []

    def members(self, of: dict[str, list], statement: _Statement, line: int, cells: list[str]) -> Iterator[str]:
        """Yield the keys of nodes or elements that numbers and names of sets, defined before, stand for."""
        numbered = self.draft.nodes if of is self.draft.sets else self.draft.elements
        before = f"{statement.parameters['INSTANCE'].upper()}." if "INSTANCE" in statement.parameters else self.prefix
        if "GENERATE" in statement.parameters:
            first, last, step = [*self.draft.whole(line, cells), 1, 1, 1][:3]
            # Numbers of a GENERATE
            if len(cells) < 2 or step < 1 or (last - first) // step > 10_000_000:
                self.fail(f"expected first, last, step, got {','.join(cells)}", line)
            yield from (
                f"{before}{number}" for number in range(first, last + 1, step) if f"{before}{number}" in numbered
            )
            return
        for cell in filter(None, cells):
            key = f"{before}{cell.upper()}".replace('"', "")
            if key in numbered:
                yield key
            elif key in of:
                yield from list(of[key])
            elif not self.springs:  # with them, elements that are CalculiX's alone are in no list
                self.fail(f"*{statement.keyword} names {cell!r}, which is not there", line)

    def nset(self, statement: _Statement) -> None:
        draft, name = self.draft, self.name(statement, "NSET")
        nodes = [key for line, cells in statement.data for key in self.members(draft.sets, statement, line, cells)]
        if "ELSET" in statement.parameters:  # the nodes of elements
            keys = self.members(draft.groups, statement, statement.line, [statement.parameters["ELSET"]])
            nodes = [node for key in keys for node in draft.elements[key][2]]
        for members in self.into(draft.sets, name):
            members += nodes

    def elset(self, statement: _Statement) -> None:
        name, groups = self.name(statement, "ELSET"), self.draft.groups
        elements = [key for line, cells in statement.data for key in self.members(groups, statement, line, cells)]
        for members in self.into(groups, name):
            members += elements

    def surface(self, statement: _Statement) -> None:
        draft, surface_nodes, name = self.draft, [], self.name(statement, "NAME")
        kind = statement.parameters.get("TYPE", "ELEMENT").upper()
        if kind not in ("ELEMENT", "NODE") or statement.parameters.keys() - {"NAME", "TYPE", "INTERNAL"}:
            draft.unread |= dict.fromkeys(
                (name, f"{self.prefix}{name}"), ("is a *SURFACE of a kind not read", statement.line)
            )
            return
        for line, (what, *faces) in statement.data:
            if kind == "NODE":
                surface_nodes += self.members(draft.sets, statement, line, [what])
                continue
            face = faces[0].upper() if faces else ""
            if not re.fullmatch(r"S[1-6]", face):
                text = f"is a *SURFACE of {what!r}, {face!r}: expected an element or a set of them and a face S1 to S6"
                draft.unread |= dict.fromkeys((name, f"{self.prefix}{name}"), (text, line))
                return
            for key in self.members(draft.groups, statement, line, [what]):
                number, kind_of, nodes, _ = draft.elements[key]
                if kind_of in FLAT:
                    continue
                corners = corners_of(kind_of)
                if int(face[1]) > len(FACES[corners]):
                    self.fail(f"element {number} ({kind_of}) has no face {face}", line)
                corners_of_face = set(FACES[corners][int(face[1]) - 1])
                middles = zip(nodes[corners:], EDGES[corners], strict=False)
                surface_nodes += [
                    *(nodes[i] for i in corners_of_face),
                    *(node for node, edge in middles if corners_of_face.issuperset(edge)),
                ]
        for members in self.into(self.surfaces, name):
            members += surface_nodes

    def new_material(self, statement: _Statement) -> None:
        self.material = self.name(statement, "NAME")
        self.draft.materials.setdefault(self.material, {})

    def elastic(self, statement: _Statement) -> None:
        kind = statement.parameters.get("TYPE", "ISO").upper()
        if not kind.startswith("ISO") or len(statement.data) != 1 or len(statement.data[0][1]) > 3 or not self.material:
            text = "one line of an isotropic *ELASTIC in a *MATERIAL is read: Young's modulus, Poisson's ratio"
            self.fail(text, statement.line)
        young, poisson = self.draft.numbers(*statement.data[0], 2)[:2]
        self.draft.material(self.material, statement.line, young=young, poisson=poisson)

    def density(self, statement: _Statement) -> None:
        if not statement.data or not self.material:
            self.fail("*DENSITY needs a number and a *MATERIAL", statement.line)
        values = [self.draft.numbers(line, cells, 1)[0] for line, cells in statement.data]
        if min(values) < max(values):
            line = statement.line % MOST_LINES
            text = f"*DENSITY (line {line}) depends on the temperature: its first is that of the part"
            self.flags.setdefault("DENSITY", Flag("density", text))
        self.draft.material(self.material, statement.line, density=values[0])

    def section(self, statement: _Statement) -> None:
        keys = list(self.members(self.draft.groups, statement, statement.line, [self.name(statement, "ELSET")]))
        self.draft.sections.append((keys, self.name(statement, "MATERIAL"), statement.line))

    def placed(self, statement: _Statement) -> tuple[Array, Array]:
        """Return the (3,) shift and (3, 3) rotation of an instance."""
        shift = np.array(self.draft.numbers(*statement.data[0], 3)[:3]) if statement.data else np.zeros(3)
        if len(statement.data) < 2:
            return shift, np.eye(3)
        x = np.array(self.draft.numbers(*statement.data[1], 7)[:7])
        if not (axis := x[3:6] - x[:3]).any():
            self.fail("*INSTANCE is turned about an axis without length", statement.line)
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
