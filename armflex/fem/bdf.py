"""Nastran bulk data: GRID, CTETRA, CHEXA, PSOLID, MAT1, and sets as SET in the case control or as SPC1.

meshio reads the elements, not the sets, properties and materials; so the cards are read here, in small, large and free
fields.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from armflex.errors import Flag
from armflex.fem.mesh import FLAT, NOT_COMPUTED, Draft, Mesh, text_lines

KINDS = {"CTETRA": {4: "C3D4", 10: "C3D10"}, "CHEXA": {8: "C3D8", 20: "C3D20"}}
"""Card -> number of its nodes -> type of its element."""

NOT_READ = ("CBAR", "CBEAM", "CROD", "CELAS", "CBUSH", "CPENTA", "CPYRAM", "RBE", "CONM")
"""Beginnings of cards that change how a model gives."""

UPWARD = [*range(12), 16, 17, 18, 19, 12, 13, 14, 15]
"""Nodes of a CHEXA of twenty -> those of a C3D20: the edges upward come before those of the top."""

MOST = 10_000_000
"""Numbers of a THRU."""

_SET = re.compile(r"SET\s+(\w+)\s*=\s*(.*)", re.I)


def read_bdf(path: Path, unit: str = "m") -> Mesh:
    """Read a Nastran file; see `inp.read_inp`.

    Raises:
        MeshError: It cannot be read, is damaged, or has what is not computed here; file and line.
    """
    draft, at, properties, flags = Draft(path, unit), {}, [], [Flag("no_end", f"{path} has no ENDDATA: is it whole?")]

    def add_nodes(name: str, cells: list[str], line: int) -> None:
        words, found = iter([cell for cell in cells if cell.strip()]), []
        for word in words:
            if thru := bool(found) and word.strip().upper() == "THRU":
                word = next(words, "")
            (last,) = draft.whole(line, [word], 1)
            if thru and last - found[-1] > MOST:
                draft.fail(f"THRU {last} is too far from {found[-1]}", line)
            found += range(found[-1] + 1, last + 1) if thru else [last]
        draft.sets.setdefault(name, []).extend(found)
        at.setdefault(name, line)

    for line, (word, *cells) in _cards(path):
        cells += [""] * 8
        if match := _SET.match(word):
            add_nodes(match[1].upper(), re.split(r"[\s,]+", match[2].strip()), line)
        elif word == "GRID":
            if cells[1].strip() not in ("", "0"):
                draft.fail("GRID in a coordinate system of its own is not read", line)
            (one,) = draft.whole(line, cells[:1], 1)
            draft.node(one, one, draft.numbers(line, cells[2:5]), line)
        elif word in KINDS or word in FLAT:
            one, part = draft.whole(line, [cells[0], cells[1].strip() or cells[0]], 2)
            own = draft.whole(line, cells[2 : 2 + FLAT.get(word, 20)])  # of faces thickness and angle come after
            if (kind := KINDS[word].get(len(own)) if word in KINDS else word) is None:
                draft.fail(f"{word} {one} has {len(own)} nodes, expected {' or '.join(map(str, KINDS[word]))}", line)
            draft.element(one, one, kind, [own[i] for i in UPWARD] if kind == "C3D20" else own, line)
            draft.groups.setdefault(f"{'PID' if word in FLAT else 'PSOLID'}{part}", []).append(one)
        elif word in ("PSOLID", "PSHELL", "PCOMP"):
            name = f"{'PSOLID' if word == 'PSOLID' else 'PID'}{cells[0].strip()}"
            properties.append((name, word, cells[1].strip(), line))
        elif word == "MAT1":
            young, shear, poisson, mass = draft.numbers(line, cells[1:5])
            if not young or not (shear or cells[3].strip()):
                draft.fail("MAT1 needs E, and G or NU", line)
            poisson = poisson if cells[3].strip() else 0.5 * young / shear - 1.0
            draft.material(cells[0].strip(), young=young, poisson=poisson, **{"density": mass} if mass else {})
        elif word == "SPC1":
            add_nodes(f"SPC{cells[0].strip()}", cells[2:], line)
        elif word.startswith(NOT_READ):
            draft.fail(f"{word} is not computed: {NOT_COMPUTED}", line)
        elif word == "ENDDATA":
            flags = []
    for name, word, material, line in properties:
        if word == "PSOLID":
            draft.sections.append((draft.groups.get(name, ()), material, line))
        elif name in draft.groups:
            draft.fail(f"{word} makes shells of {name}, which are not computed: {NOT_COMPUTED}", line)
    for name, line in at.items():
        if missing := [node for node in draft.sets[name] if node not in draft.nodes]:
            draft.fail(f"set {name!r} names node {missing[0]}, which is not there", line)
    return draft.mesh(flags)


def _cards(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield the line and the fields of every card, continued ones whole; a SET is one field."""
    begun, waiting = 0, []
    for number, line in enumerate(text_lines(path), 1):
        text = line.split("$")[0].rstrip()
        if not text.strip():
            continue
        if waiting and _SET.match(waiting[0]) and waiting[0].endswith(","):
            waiting = [waiting[0] + text]
            continue
        if _SET.match(text.strip()):
            cells = [text.strip()]
        elif "," in text:
            cells = [*(cell.strip() for cell in text.split(",")), *[""] * 8][:9]
        else:
            wide = 16 if "*" in text[:8] else 8
            cells = [text[:8].strip(), *(text[i : i + wide].ljust(wide) for i in range(8, 72, wide))]
        if waiting and text[0] in " +*,":
            waiting += cells[1:]
            continue
        if waiting:
            yield begun, waiting
        begun, waiting = number, [cells[0].rstrip("*").upper(), *cells[1:]]
    if waiting:
        yield begun, waiting
