"""gmsh meshes by meshio, and STEP files meshed by gmsh, which is GPL and only called where it is installed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from armflex.errors import MeshError, Place, UnsupportedError
from armflex.fem.mesh import OTHERS, UNITS, Block, Mesh
from armflex.storage.whole_file import scratch

SOLIDS = {"tetra": "C3D4", "tetra10": "C3D10", "hexahedron": "C3D8", "hexahedron20": "C3D20"}
"""meshio's name -> CalculiX's; the nodes of both stand in one order."""

FLAT = ("vertex", "line", "line3", "triangle", "triangle6", "quad", "quad8")
"""What surfaces, edges and points of a mesh are made of: they give sets their nodes, and nothing else."""


def read_msh(path: Path, unit: str = "m") -> Mesh:
    """Read a gmsh mesh; physical groups are sets. See `inp.read_inp`."""
    try:
        import meshio
    except ImportError:
        raise UnsupportedError("a .msh file is read with meshio: pip install 'armflex[fem]'") from None
    try:
        found: Any = meshio.gmsh.read(path)
    except Exception as error:  # meshio raises whatever its parsers do
        raise MeshError(
            Place(path),
            f"is no gmsh mesh that meshio reads: {str(error) or type(error).__name__}"
            " (with physical groups, save what is in one alone)",
        ) from None
    names = {(int(tag), int(size)): name for name, (tag, size) in found.field_data.items()}
    tags = found.cell_data.get("gmsh:physical", [np.zeros(len(cells.data), dtype=int) for cells in found.cells])
    sizes = {"vertex": 0, "line": 1, "line3": 1, "triangle": 2, "triangle6": 2, "quad": 2, "quad8": 2}
    sets: dict[str, list[np.ndarray]] = {}
    blocks: dict[tuple[str, str], list[np.ndarray]] = {}
    for cells, groups in zip(found.cells, tags, strict=True):
        if cells.type not in (*SOLIDS, *FLAT):
            raise MeshError(Place(path), f"elements of the type {cells.type} are not computed ({OTHERS} are not)")
        for group in np.unique(groups):
            own = np.asarray(cells.data)[groups == group]
            name = names.get((int(group), sizes.get(cells.type, 3)), f"group_{group}" if group else "")
            if name:
                sets.setdefault(name, []).append(np.unique(own))
            if cells.type in SOLIDS:
                blocks.setdefault((SOLIDS[cells.type], name), []).append(own)
    if not blocks:
        raise MeshError(Place(path), f"has no solid elements ({', '.join(SOLIDS)})")
    numbered, made = 1, []
    for (kind, name), several in blocks.items():
        nodes = np.vstack(several).astype(int)
        ids = np.arange(numbered, numbered + len(nodes))
        numbered += len(nodes)
        made.append(Block(kind, ids, nodes, np.zeros(len(nodes), dtype=int), None, name))
    points = np.asarray(found.points, dtype=float)[:, :3] * UNITS[unit][0]
    if not np.isfinite(points).all():
        raise MeshError(Place(path), "a node's place is not finite")
    if max(int(block.nodes.max()) for block in made) >= len(points):
        raise MeshError(Place(path), "an element names a node that is not there")
    ids, lines = np.arange(1, len(points) + 1), np.zeros(len(points), dtype=int)
    groups_of = {name: np.unique(np.concatenate(rows)) for name, rows in sets.items()}
    return Mesh(path, points, ids, lines, tuple(made), groups_of)


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
        for dimension, kind in ((3, "solid"), (2, "face")):
            for _, tag in gmsh.model.getEntities(dimension):
                gmsh.model.addPhysicalGroup(dimension, [tag], name=f"{kind}_{tag}")
                named = gmsh.model.getEntityName(dimension, tag).rpartition("/")[2]
                if named and dimension == 2:
                    gmsh.model.addPhysicalGroup(dimension, [tag], name=named)
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
    return replace(found, path=path)
