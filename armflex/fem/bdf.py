"""Nastran bulk data: GRID, CTETRA, CHEXA, PSOLID, MAT1, and sets as SET in the case control or as SPC1.

meshio reads the elements, not the sets, properties and materials; so the cards are read here, in small, large and free
fields.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import NoReturn

import numpy as np

from armflex.errors import MeshError, Place
from armflex.fem.mesh import OTHERS, UNITS, Block, Material, Mesh, text_lines

SOLIDS = {("CTETRA", 4): "C3D4", ("CTETRA", 10): "C3D10", ("CHEXA", 8): "C3D8", ("CHEXA", 20): "C3D20"}
CARDS = {"CTETRA": (4, 10), "CHEXA": (8, 20)}
FLAT = {"CTRIA3": 3, "CTRIA6": 6, "CQUAD4": 4, "CQUAD8": 8}
"""Faces of solids -> their nodes; without a PSHELL they make the set `PID<property>`."""

NOT_READ = ("CBAR", "CBEAM", "CROD", "CELAS", "CBUSH", "CPENTA", "CPYRAM", "RBE", "CONM")
"""Beginnings of cards that change how a model gives."""

ORDER = {20: (*range(12), 16, 17, 18, 19, 12, 13, 14, 15)}
"""Nodes of a CHEXA -> those of a C3D20: the edges upward come before those of the top."""

_SET = re.compile(r"SET\s+(\w+)\s*=\s*(.*)", re.I)


def read_bdf(path: Path, unit: str = "m") -> Mesh:
    """Read a Nastran file; see `inp.read_inp`.

    Raises:
        MeshError: It cannot be read, is damaged, or has what is not computed here; file and line.
    """
    length, stress, density = UNITS[unit]

    def fail(problem: str, line: int) -> NoReturn:
        raise MeshError(Place(path, line), problem)

    def number(cell: str, line: int) -> float:
        text = re.sub(r"(?<=[0-9.])([+-]\d+)$", r"E\1", cell.strip().upper().replace("D", "E"))
        try:
            value = float(text) if text else 0.0
        except ValueError:
            fail(f"expected a number, got {cell!r}", line)
        return value if np.isfinite(value) else fail(f"{cell!r} is not finite", line)

    def whole(cell: str, line: int) -> int:
        return int(cell) if cell.strip().isdigit() else fail(f"expected a whole number, got {cell!r}", line)

    def listed(cells: list[str], line: int) -> list[int]:
        found: list[int] = []
        words = [cell for cell in cells if cell.strip()]
        while words:
            word = words.pop(0)
            if word.upper() == "THRU" and found and words:
                last = whole(words.pop(0), line)
                if last - found[-1] > 10_000_000:
                    fail(f"THRU {last} is too far from {found[-1]}", line)
                found += range(found[-1] + 1, last + 1)
            else:
                found.append(whole(word, line))
        return found

    nodes: dict[int, list[float]] = {}
    at: dict[int, int] = {}
    elements: dict[int, tuple[str, int, list[int], int]] = {}
    solids: dict[int, tuple[int, int]] = {}
    materials: dict[int, Material] = {}
    named: dict[str, list[int]] = {}
    faces: dict[int, tuple[str, int]] = {}
    shells: set[int] = set()
    for line, card in _cards(path):
        word, cells = card[0], [*card[1:], *[""] * 8]
        if match := _SET.match(word):
            named[match[1].upper()] = listed(re.split(r"[\s,]+", match[2].strip()), line)
        elif word == "GRID":
            if cells[1].strip() not in ("", "0"):
                fail("GRID in a coordinate system of its own is not read", line)
            if (one := whole(cells[0], line)) in nodes:
                fail(f"node {one} stands twice", line)
            nodes[one], at[one] = [number(cell, line) for cell in cells[2:5]], line
        elif word in CARDS:
            own = [whole(cell, line) for cell in cells[2:] if cell.strip()]
            if len(own) not in CARDS[word]:
                fail(f"{word} {cells[0]} has {len(own)} nodes, expected {' or '.join(map(str, CARDS[word]))}", line)
            if (one := whole(cells[0], line)) in elements:
                fail(f"element {one} stands twice", line)
            elements[one] = (word, whole(cells[1] or cells[0], line), own, line)
        elif word in FLAT:
            made_of = whole(cells[1] or cells[0], line)
            faces.setdefault(made_of, (word, line))
            named.setdefault(f"PID{made_of}", []).extend(whole(cell, line) for cell in cells[2 : 2 + FLAT[word]])
        elif word in ("PSHELL", "PCOMP"):
            shells.add(whole(cells[0], line))
        elif word == "PSOLID":
            solids[whole(cells[0], line)] = (whole(cells[1], line), line)
        elif word == "MAT1":
            young, shear, poisson, mass = (number(cell, line) for cell in cells[1:5])
            if not young or not (cells[2].strip() or cells[3].strip()):
                fail("MAT1 needs E, and G or NU", line)
            poisson = poisson if cells[3].strip() else 0.5 * young / shear - 1.0
            materials[whole(cells[0], line)] = Material(young * stress, poisson, mass * density or None)
        elif word == "SPC1":
            named.setdefault(f"SPC{cells[0].strip()}", []).extend(listed(cells[2:], line))
        elif word.startswith(NOT_READ):
            fail(f"{word} is not computed: {', '.join(CARDS)} are, {OTHERS} are not", line)
    for made_of in shells & faces.keys():
        word, line = faces[made_of]
        fail(f"{word} with a PSHELL is not computed: {', '.join(CARDS)} are, {OTHERS} are not", line)
    rows = {one: row for row, one in enumerate(nodes)}
    groups: dict[tuple[str, int], list[tuple[int, list[int], int]]] = {}
    for one, (word, made_of, own, line) in elements.items():
        if missing := [node for node in own if node not in rows]:
            fail(f"element {one} names node {missing[0]}, which is not there", line)
        own = [own[i] for i in ORDER.get(len(own), range(len(own)))]
        groups.setdefault((SOLIDS[word, len(own)], made_of), []).append((one, [rows[n] for n in own], line))
    if not groups:
        fail("has no solid elements (CTETRA, CHEXA)", 0)
    blocks = []
    for (kind, made_of), found in groups.items():
        numbers, own, lines = (np.array(column) for column in zip(*found, strict=True))
        if made_of in solids and solids[made_of][0] not in materials:
            fail(f"PSOLID {made_of} names the material {solids[made_of][0]}, which is not there", solids[made_of][1])
        material = materials[solids[made_of][0]] if made_of in solids else None
        blocks.append(Block(kind, numbers, own, lines, material, f"PSOLID{made_of}"))
    for name, own in named.items():
        if missing := [node for node in own if node not in rows]:
            fail(f"set {name!r} names node {missing[0]}, which is not there", 0)
    points = np.array(list(nodes.values())) * length
    sets = {name: np.array([rows[node] for node in own], dtype=int) for name, own in named.items()}
    return Mesh(path, points, np.array(list(nodes)), np.array(list(at.values())), tuple(blocks), sets)


def _cards(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield the line and the fields of every card, continued ones whole; a SET is one field."""
    begun, waiting = 0, []
    for number, line in enumerate(text_lines(path), 1):
        text = line.split("$")[0].rstrip()
        if not text.strip():
            continue
        if waiting and waiting[0].upper().startswith("SET") and waiting[0].rstrip().endswith(","):
            waiting = [waiting[0] + text]
            continue
        if "," in text and not _SET.match(text.strip()):
            cells = [cell.strip() for cell in text.split(",")]
            more, cells = cells[0] == "" or cells[0][0] in "+*", [cells[0].rstrip("*"), *cells[1:9]]
        elif _SET.match(text.strip()):
            more, cells = False, [text.strip()]
        else:
            wide = 16 if "*" in text[:8] else 8
            cells = [text[:8].strip().rstrip("*"), *(text[i : i + wide] for i in range(8, min(len(text), 72), wide))]
            cells += [""] * ((64 // wide) + 1 - len(cells))
            more = text[0] in " +*"
        if more and waiting:
            waiting += cells[1:]
            continue
        if waiting:
            yield begun, waiting
        begun, waiting = number, [cells[0].upper(), *cells[1:]]
    if waiting:
        yield begun, waiting
