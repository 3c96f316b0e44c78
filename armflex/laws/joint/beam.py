"""Straight uniform beams, and condensed meshes, between two nodes: stiffness in the axes of the structure.

Euler-Bernoulli bending, as in the paper's eq. (7) and any text on matrix structural analysis.
"""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.errors import LawError


@dataclass(frozen=True)
class Section:
    """Material and cross-section of a beam: E, G [Pa], A [m^2], Iy, Iz, J [m^4]; y and z are the section's axes."""

    E: float
    G: float
    A: float
    Iy: float
    Iz: float
    J: float

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not value > 0.0:
                raise LawError(f"beam section: {name} is {value:g}, expected more than 0")


@dataclass(frozen=True)
class Beam:
    """A beam between two named nodes.

    Attributes:
        start: Node at its local x = 0.
        end: Node at x = L.
        section: Material and cross-section.
        up: (3,) direction in the structure's axes that the local z axis is nearest to.
    """

    start: str
    end: str
    section: Section
    up: Array


@dataclass(frozen=True, eq=False)
class MeshedBeam:
    """A condensed mesh between two named nodes.

    Attributes:
        start: Node at its held interface.
        end: Node at its loaded one.
        compliance: (6, 6) at the end, the start held, in the structure's axes [m/N, rad/Nm and mixed].
    """

    start: str
    end: str
    compliance: Array


def stiffness(beam: Beam | MeshedBeam, start: Array, end: Array, components: int) -> Array:
    """Return the (2 k, 2 k) stiffness of a beam from `start` to `end` [m] in structure axes, k = `components`.

    With six components the ends translate and turn; with three they only translate and their rotations are held,
    which is the form of the paper's eqs (1) and (7): axial EA/L, lateral 12 E I / L^3.

    Raises:
        LawError: The beam has no length, or `up` is along it.
    """
    kept = np.arange(12).reshape(2, 6)[:, :components].ravel()
    if isinstance(beam, MeshedBeam):
        apart = np.hstack([-pin.SE3(np.eye(3), start - end).action, np.eye(6)])  # motion of the end beside the start's
        return (apart.T @ np.linalg.solve(beam.compliance, apart))[np.ix_(kept, kept)]
    length = float(np.linalg.norm(end - start))
    if length < 1e-9:
        raise LawError(f"beam {beam.start!r} to {beam.end!r} has no length")
    x = (end - start) / length
    y = np.cross(beam.up, x)
    if np.linalg.norm(y) < 1e-6 * np.linalg.norm(beam.up) or not beam.up.any():
        raise LawError(f"beam {beam.start!r} to {beam.end!r}: 'up' is parallel to the beam")
    y /= np.linalg.norm(y)

    section, k = beam.section, np.zeros((12, 12))  # in beam axes, each node linear first: u v w, turns about x y z
    for i, spring in ((0, section.E * section.A), (3, section.G * section.J)):
        k[np.ix_((i, i + 6), (i, i + 6))] = spring / length * np.array([[1.0, -1.0], [-1.0, 1.0]])
    # A positive turn about y lowers w where a positive turn about z raises v, hence the sign.
    for dofs, inertia, sign in (((1, 5, 7, 11), section.Iz, 1.0), ((2, 4, 8, 10), section.Iy, -1.0)):
        s, far, near = sign * 6.0 * length, 2.0 * length**2, 4.0 * length**2
        bending = [[12.0, s, -12.0, s], [s, near, -s, far], [-12.0, -s, 12.0, -s], [s, far, -s, near]]
        k[np.ix_(dofs, dofs)] = section.E * inertia / length**3 * np.array(bending)
    turned = np.kron(np.eye(4), np.column_stack([x, y, np.cross(x, y)]))
    return (turned @ k @ turned.T)[np.ix_(kept, kept)]
