"""gmsh meshes by meshio, and STEP files meshed by gmsh, which is GPL and only called where it is installed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from armflex.errors import MeshError, Place, UnsupportedError
from armflex.fem.mesh import FLAT, NOT_COMPUTED, SOLIDS, Draft, Mesh, text_lines
from armflex.storage.whole_file import scratch

KINDS = {"tetra": "C3D4", "tetra10": "C3D10", "hexahedron": "C3D8", "hexahedron20": "C3D20"}
"""meshio's name -> CalculiX's; the nodes of both stand in one order."""


def read_msh(path: Path, unit: str = "m") -> Mesh:
    """Read a gmsh mesh; physical groups are sets. See `inp.read_inp`."""
    try:
        import meshio
    except ImportError:
        raise UnsupportedError("a .msh file is read with meshio: pip install 'armflex[fem]'") from None
    draft = Draft(path, unit)
    try:
        found: Any = meshio.gmsh.read(path)
    except Exception as error:  # meshio raises whatever its parsers do
        opened = [(line, text.strip()) for line, text in enumerate(text_lines(path), 1) if text.startswith("$")]
        if opened and not opened[-1][1].startswith("$End"):
            draft.fail(f"{opened[-1][1]} does not end: is the file whole?", opened[-1][0])
        text = f"is no gmsh mesh that meshio reads ({type(error).__name__}: {error})"
        draft.fail(f"{text}: with physical groups, save what is in one alone")
    nodes, elements = (_numbered(path, section) for section in ("Nodes", "Elements"))
    for key, place in enumerate(found.points):
        number, line = next(nodes, (key + 1, 0))
        if not np.isfinite(place).all():
            draft.fail(f"the place of node {number} is not finite", line)
        draft.node(key, number, place, line)
    names = {(int(tag), int(size)): name for name, (tag, size) in found.field_data.items()}
    tags = found.cell_data.get("gmsh:physical", [[0] * len(cells) for cells in found.cells])
    for place, (cells, groups) in enumerate(zip(found.cells, tags, strict=True)):
        if (kind := KINDS.get(cells.type, cells.type)) not in (*SOLIDS, *FLAT):
            draft.fail(f"elements of the type {kind} are not computed: {NOT_COMPUTED}", next(elements, (0, 0))[1])
        first = len(draft.elements)
        for nodes, tag in zip(cells.data.tolist(), groups, strict=True):
            key = len(draft.elements)
            number, line = next(elements, (key + 1, 0))
            if min(nodes) < 0:
                draft.fail(f"element {number} names a node that is not there", line)
            draft.element(key, number, kind, nodes, line)
            if tag:
                draft.groups.setdefault(names.get((tag, cells.dim), f"group_{tag}"), []).append(key)
        for name in found.field_data.keys() & found.cell_sets.keys():  # of more groups than one, meshio's tags have one
            draft.groups.setdefault(name, []).extend((first + found.cell_sets[name][place]).tolist())
    return draft.mesh()


def _numbered(path: Path, section: str) -> Iterator[tuple[int, int]]:
    """Yield the number and the line of every node or element of a text file, in its order: meshio drops both."""
    lines = ["", *(line.strip() for line in text_lines(path))]
    version, kind, *_ = lines[lines.index("$MeshFormat") + 1].split()
    if kind != "0":  # binary
        return
    at, end = lines.index(f"${section}") + 1, lines.index(f"$End{section}")
    if not version.startswith("4"):
        yield from ((int(lines[line].split()[0]), line) for line in range(at + 1, end))
        return
    at += 1
    while at < end:  # a block; of nodes the numbers, and then as many places
        count = int(lines[at].split()[3])
        apart = count if section == "Nodes" else 0
        yield from ((int(lines[line].split()[0]), line + apart) for line in range(at + 1, at + 1 + count))
        at += 1 + count + apart


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
            if dimension == 2 and (own := gmsh.model.getEntityName(2, tag).rpartition("/")[2]):
                groups.setdefault((2, own), []).append(tag)
        for (dimension, name), tags in groups.items():
            gmsh.model.addPhysicalGroup(dimension, tags, name=name)
        for bound in ("Min", "Max"):
            gmsh.option.setNumber(f"Mesh.MeshSize{bound}", size)
        gmsh.model.mesh.generate(3)
        gmsh.model.mesh.setOrder(order)
        with scratch() as folder:
            gmsh.write(str(folder / f"{path.stem}.msh"))
            found = read_msh(folder / f"{path.stem}.msh")
    except MeshError:
        raise
    except Exception as error:  # gmsh raises plain exceptions
        raise MeshError(Place(path), f"gmsh cannot mesh it: {error}") from None
    finally:
        gmsh.finalize()
    return replace(found, path=path, lines=np.zeros_like(found.lines))
