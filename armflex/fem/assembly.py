"""Stiffness and mass of a mesh: scikit-fem's shape functions and quadratures, all elements of a block at once.

The elements are CalculiX's, and stiffness and mass are summed over the points that it has: one in a C3D4, four in a
C3D10, 27 in a C3D20, eight in a C3D20R and a C3D8. scikit-fem's own forms loop over pairs of shape functions, and its
20-node brick has a trilinear geometry; so the sum over points is a matrix product here.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.sparse import coo_array, csc_array

from armflex.conventions import Array
from armflex.errors import UnsupportedError
from armflex.fem.mesh import EDGES, Mesh, corners_of

AT_ONCE = 4096
"""Elements whose matrices are held in memory together."""

_TET = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
_HEX = np.array([[x, y, z] for z in (0.0, 1.0) for x, y in ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))])


def rule(kind: str) -> tuple[Array, Array, Array]:
    """Return an element type's (Q, k) shape functions at its points of integration, their (Q, k, 3) derivatives in the
    reference element, and the (Q,) weights of the points."""
    try:
        from skfem import element as elements
        from skfem.quadrature import get_quadrature
    except ImportError:
        raise UnsupportedError("a mesh is assembled with scikit-fem: pip install 'armflex[fem]'") from None
    corners = _TET if kind in ("C3D4", "C3D10") else _HEX
    made: Any
    made, degree = {
        "C3D4": (elements.ElementTetP1, 1),
        "C3D10": (elements.ElementTetP2, 2),
        "C3D8": (elements.ElementHex1, 2),
        "C3D20": (elements.ElementHexS2, 5),
        "C3D20R": (elements.ElementHexS2, 2),
    }[kind]
    element = made()
    places = element.doflocs
    wanted = np.vstack([corners, [corners[list(edge)].mean(axis=0) for edge in EDGES[len(corners)]]])[: len(places)]
    order = [int(np.abs(places - place).sum(axis=1).argmin()) for place in wanted]

    points, weights = get_quadrature(element.refdom, degree)
    values = [element.lbasis(points, i) for i in order]
    return np.array([v for v, _ in values]).T, np.array([g for _, g in values]).transpose(2, 0, 1), weights


def assembled(mesh: Mesh, tick: Callable[[int, int | None], None] | None = None) -> tuple[Any, Any]:
    """Return the (3 N, 3 N) stiffness [N/m] and the (N, N) mass [kg] of a mesh, x y z of node after node.

    The mass of x, y and z alike is that of a node.

    Raises:
        MeshError: An element's volume is not positive; file and line.
    """
    count, done = len(mesh.points), 0
    stiffness, mass = csc_array((3 * count, 3 * count)), csc_array((count, count))

    def summed(blocks: Array, places: np.ndarray, size: int) -> Any:
        each = places.shape[1]
        rows, columns = np.repeat(places, each, axis=1).ravel(), np.tile(places, (1, each)).ravel()
        return coo_array((blocks.ravel(), (rows, columns)), (size, size)).tocsc()

    for block in mesh.blocks:
        (shapes, slopes, parts), corners, material = rule(block.kind), corners_of(block.kind), block.material
        _, straight, _ = rule("C3D4" if corners == 4 else "C3D8")
        assert material is not None
        shear = 0.5 * material.young / (1.0 + material.poisson)
        first = 2.0 * shear * material.poisson / (1.0 - 2.0 * material.poisson)
        for start in range(0, len(block.ids), AT_ONCE):
            nodes = block.nodes[start : start + AT_ONCE]
            points, each = mesh.points[nodes], nodes.shape[1]
            volumes, gradients = _at_points(points, slopes)
            # Middles of edges may hide that corners are exchanged.
            least = np.hstack([volumes, _at_points(points[:, :corners], straight)[0]]).min(axis=1)
            if len(bad := start + np.flatnonzero(least <= 0.0)):
                more = f" (and {len(bad) - 1} others)" if len(bad) > 1 else ""
                text = f"element {block.ids[bad[0]]} ({block.kind}) has no positive volume everywhere{more}"
                raise mesh.fail(f"{text}: inverted, or distorted", block.lines[bad[0]])
            weights = volumes * parts
            scaled = (gradients * np.sqrt(weights)[..., None, None]).reshape(*weights.shape, -1)
            pairs = (np.swapaxes(scaled, 1, 2) @ scaled).reshape(len(points), each, 3, each, 3)
            ke = shear * np.swapaxes(pairs, 2, 4)
            along = shear * np.einsum("eicjc->eij", pairs)
            for axis in range(3):
                ke[:, :, axis, :, axis] += along
            ke += first * pairs
            me = (material.density or 0.0) * np.einsum("qi,qj,eq->eij", shapes, shapes, weights)
            dofs = (3 * nodes[..., None] + np.arange(3)).reshape(len(nodes), -1)
            stiffness = stiffness + summed(ke.reshape(len(points), 3 * each, 3 * each), dofs, 3 * count)
            mass = mass + summed(me, nodes, count)
            done += len(nodes)
            if tick:
                tick(done, sum(len(block.ids) for block in mesh.blocks))
    return stiffness, mass


def _at_points(points: Array, reference: Array) -> tuple[Array, Array]:
    """Return the (E, Q) volumes and (E, Q, k, 3) gradients [1/m] of (E, k, 3) elements at points of the reference."""
    jacobian = np.einsum("eka,qkb->eqab", points, reference)
    volumes = np.linalg.det(jacobian)
    if (volumes <= 0.0).any():
        return volumes, np.zeros((*volumes.shape, points.shape[1], 3))
    return volumes, np.einsum("qkb,eqba->eqka", reference, np.linalg.inv(jacobian))
