"""Static condensation of a mesh onto its interfaces (Guyan 1965): stiffness, mass, weight, natural frequencies."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import scipy.sparse as sparse
from scipy.linalg import eigh
from scipy.sparse import linalg

from armflex.conventions import Array
from armflex.errors import Flag, OutOfMemoryError
from armflex.fem.cholesky import CholeskyFactor
from armflex.fem.matrices import MODAL, Matrices, of_mesh
from armflex.fem.mesh import FACES, MOST_LINES, Mesh, corners_of, interfaces_of
from armflex.fem.part import Part
from armflex.storage.read_file import sha256_of

MODES = 6
"""Natural frequencies that are found."""


Tick = Callable[[str, int, int | None], None]


def condense(
    structure: Mesh | Matrices,
    fixed: str,
    loaded: Sequence[str],
    interface: str = "rigid",
    young_std: float = 0.0,
    tick: Tick | None = None,
) -> Part:
    """Return a mesh condensed onto sets of its nodes.

    With K and M of the free nodes and E their loads per load on the interfaces, the compliance is C = E' K^-1 E, the
    shapes K^-1 E C^-1 carry the mass, and the own weight moves the interfaces as the loads C^-1 E' K^-1 M g do.

    Args:
        structure: A mesh, whose elements have a material, or finished matrices.
        fixed: The set that is held.
        loaded: The sets that carry load.
        interface: "rigid" or "average", see `Part`.
        young_std: Relative standard uncertainty of the compliance.
        tick: Is given what is done, how far, of how much.

    Raises:
        MeshError: The mesh is broken, or free to move though its nodes are connected.
        UnitError: Its size is that of another unit.
        UnknownNameError: A set is not there.
    """
    said, loaded = tick or (lambda *_: None), tuple(loaded)
    matrices, mesh = (structure, structure.mesh) if isinstance(structure, Matrices) else (None, structure)
    sets = interfaces_of(mesh, fixed, loaded, whole=matrices is None)
    if matrices is None:
        matrices = of_mesh(mesh, lambda done, total: said("assembling elements", done, total))
    origins = np.array([mesh.points[sets[name]].mean(axis=0) for name in loaded])
    free, reduced, entry = _interfaces(matrices, sets, origins, interface)
    rigid = matrices.rigid(origins[0])
    moved = matrices.mass @ rigid
    stiffness, inner = ((reduced.T @ matrix @ reduced).tocsc() for matrix in (matrices.stiffness, matrices.mass))
    nodes = matrices.freedoms[free, 0]
    places = np.full((stiffness.shape[0], 3), np.nan)
    places[: len(nodes)] = np.where(nodes[:, None] == MODAL, np.nan, mesh.points[nodes])
    loads, size = np.hstack([entry.toarray(), reduced.T @ moved]), 6 * len(loaded)
    solver, moves = _solved(mesh, fixed, stiffness, places, loads, said)
    compliance = entry.T @ moves[:, :size]
    compliance = 0.5 * (compliance + compliance.T)
    shapes = np.linalg.solve(compliance, moves[:, :size].T).T
    carried_rigid, inner_mass = rigid.T @ moved, shapes.T @ (inner @ shapes)
    mass, arm, inertia = _inertia(carried_rigid)
    flags, frequencies = [*mesh.flags, *_not_held(mesh, fixed, sets[fixed])], np.zeros(0)
    if mass > 0.0:
        said("natural frequencies", 0, None)
        frequencies = _frequencies(stiffness, inner, solver)
    else:
        flags.append(Flag("no_density", "no density is known: the part has neither mass, weight nor frequencies"))
    stiff = {block.kind for block in mesh.blocks} & {"C3D4", "C3D8"}
    flags += [Flag("stiff_elements", f"{kind} are too stiff in bending; C3D10 or C3D20 are not") for kind in stiff]
    carried = np.linalg.solve(compliance, entry.T @ moves[:, size:])
    return Part(
        mesh=mesh.path.name,
        sha256=sha256_of(mesh.path),
        fixed=fixed,
        fixed_origin=mesh.points[sets[fixed]].mean(axis=0),
        loaded=loaded,
        origins=origins,
        interface=interface,
        compliance=compliance,
        mass=mass,
        com=origins[0] + arm,
        inertia=0.5 * (inertia + inertia.T),
        mass_matrix=0.5 * (inner_mass + inner_mass.T),
        weight=carried[:, :3],
        spin=carried[:, 3:],
        frequencies_hz=frequencies,
        young_std=young_std,
        nodes=len(mesh.points),
        flags=tuple(dict.fromkeys(flags)),
        surface=_surface(mesh, np.asarray(reduced @ shapes)) if mesh is structure and len(loaded) == 1 else None,
    )


def _inertia(rigid: Array) -> tuple[float, Array, Array]:
    """Return mass [kg], centre [m] and inertia about it [kg m^2] of a rigid body with a (6, 6) mass matrix."""
    mass, first = float(rigid[0, 0]), rigid[3:, :3]  # the skew matrix of the centre's place, times mass
    arm = np.array([first[2, 1], first[0, 2], first[1, 0]]) / mass if mass else np.zeros(3)
    return mass, arm, rigid[3:, 3:] - mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))


def _not_held(mesh: Mesh, fixed: str, rows: np.ndarray) -> Iterator[Flag]:
    """Yield a flag about each support of the file that holds more than the (M,) rows of nodes that are held."""
    for name, line in mesh.supports.items():
        others = np.setdiff1d(mesh.sets.get(name, ()), rows)
        if name.lower() != fixed.lower() and (name in mesh.unread or len(others)):
            text = (
                f"{name} (line {line % MOST_LINES}) holds what {fixed!r} does not, and is left out: --fixed says what "
            )
            yield Flag("left_out", f"{text}is held")


def _solved(
    mesh: Mesh, fixed: str, stiffness: Any, places: Array, loads: Array, said: Tick
) -> tuple[CholeskyFactor, Array]:
    """Return the factor of a stiffness, and how all moves under loads; refuse one under which something is free."""
    try:
        solver = CholeskyFactor(stiffness, places, lambda done, total: said("factorising the stiffness", done, total))
    except np.linalg.LinAlgError:
        raise mesh.fail("is free to move: its stiffness is singular") from None
    except MemoryError:
        raise OutOfMemoryError(f"{mesh.path}: the stiffness of {len(mesh.points)} nodes has no room") from None
    moves = solver.solve(loads)
    left = np.linalg.norm(stiffness @ moves - loads, axis=0)
    # Share of a load that the solution may leave: more of it means that something is free to move.
    if not np.isfinite(moves).all() or (left > 1e-6 * np.linalg.norm(loads, axis=0).clip(1e-300)).any():
        text = f"is free to move though {fixed!r} is held: parts that share an edge or a node alone are hinged"
        raise mesh.fail(text)
    return solver, moves


def _interfaces(
    matrices: Matrices, sets: dict[str, np.ndarray], origins: Array, interface: str
) -> tuple[np.ndarray, Any, Any]:
    """Return the freedoms that are unknowns, the (N, n) map from these and those of rigid interfaces to all, and the
    (n, 6 m) loads on them per interface's load; the first set is held."""
    place: Any = sparse.eye_array(len(matrices.freedoms), format="csc")
    (held, *moving), names = [matrices.at(rows) for rows in sets.values()], list(sets)[1:]
    moved = []
    for name, freedoms, origin in zip(names, moving, origins, strict=True):
        body = matrices.rigid(origin)[freedoms]
        if np.linalg.matrix_rank(body) < 6:
            raise matrices.mesh.fail(f"set {name!r} has too few freedoms to carry every load: are they held already?")
        each = body if interface == "rigid" else body @ np.linalg.inv(body.T @ body)
        moved.append(place[:, freedoms] @ sparse.csc_array(each))
    gone = np.concatenate([held, *moving] if interface == "rigid" else [held])
    free = np.setdiff1d(np.arange(len(matrices.freedoms)), gone)
    if interface == "average":
        return free, place[:, free], place[:, free].T @ sparse.hstack(moved, "csc")
    count, size = len(free), 6 * len(moving)
    entry = sparse.eye_array(count + size, size, k=-count, format="csc")
    return free, sparse.hstack([place[:, free], *moved], "csc"), entry


def _frequencies(stiffness: Any, mass: Any, solver: Any) -> Array:
    """Return the lowest natural frequencies [1/s]; of what has fewer masses than modes, as many as there are."""
    size = stiffness.shape[0]
    # Unknowns whose frequencies are found from dense matrices
    if size <= 500:
        inverse = eigh(mass.toarray(), stiffness.toarray(), eigvals_only=True)[::-1][:MODES]
        return 1.0 / np.sqrt(inverse[inverse > 1e-12 * inverse[0]]) / (2.0 * np.pi)
    operator: Any = linalg.LinearOperator  # whose __new__ and __init__ the checker takes for one
    back = operator((size, size), matvec=solver.solve, dtype=float)
    start = np.ones(size)
    squares = linalg.eigsh(stiffness, MODES, mass, sigma=0.0, OPinv=back, return_eigenvectors=False, v0=start)
    return np.sort(np.sqrt(np.maximum(squares, 0.0))) / (2.0 * np.pi)


def _surface(mesh: Mesh, shapes: Array) -> dict[str, np.ndarray]:
    """Return the arrays of `SURFACE` of a mesh whose N nodes move by (3 N, 6) shapes per twist of its interface.

    Triangles are rows of the points, seen from outside against the clock.
    """
    triangles = []
    for corners, faces in FACES.items():
        sides = [b.nodes[:, face] for b in mesh.blocks if corners_of(b.kind) == corners for face in faces]
        if sides:
            every = np.vstack(sides)
            _, first, times = np.unique(np.sort(every, axis=1), axis=0, return_index=True, return_counts=True)
            outer = every[first[times == 1]]  # a face of two elements is inside
            triangles += [outer[:, [0, i, i + 1]] for i in range(1, every.shape[1] - 1)]
    kept, numbers = np.unique(np.vstack(triangles), return_inverse=True)
    moves = shapes.reshape(-1, 3, 6)[kept]
    return {"points": mesh.points[kept], "triangles": numbers.reshape(-1, 3).astype("i8"), "shapes": moves}
