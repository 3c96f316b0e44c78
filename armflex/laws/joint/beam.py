"""Straight uniform beams between two nodes: stiffness matrices in the axes of the structure.

Euler-Bernoulli bending, as in the paper's eq. (7) and any text on matrix structural analysis.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

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


def stiffness(beam: Beam, start: Array, end: Array, components: int) -> Array:
    """Return the (2 k, 2 k) stiffness of a beam from `start` to `end` [m] in structure axes, k = `components`.

    With six components the ends translate and turn; with three they only translate and their rotations are held,
    which is the form of the paper's eqs (1) and (7): axial EA/L, lateral 12 E I / L^3.
    """
    axes, length = _axes(beam, start, end)
    section = beam.section
    if components == 3:
        block = axes @ np.diag(_translation_stiffness(section, length)) @ axes.T
        return np.block([[block, -block], [-block, block]])
    rotate = np.kron(np.eye(4), axes)
    return rotate @ _frame_stiffness(section, length) @ rotate.T


def _axes(beam: Beam, start: Array, end: Array) -> tuple[Array, float]:
    length = float(np.linalg.norm(end - start))
    if length < 1e-9:
        raise LawError(f"beam {beam.start!r} to {beam.end!r} has no length")
    x = (end - start) / length
    y = np.cross(beam.up, x)
    if np.linalg.norm(y) < 1e-6 * np.linalg.norm(beam.up) or not beam.up.any():
        raise LawError(f"beam {beam.start!r} to {beam.end!r}: 'up' is parallel to the beam")
    y /= np.linalg.norm(y)
    return np.column_stack([x, y, np.cross(x, y)]), length


def _translation_stiffness(section: Section, length: float) -> Array:
    bending = 12.0 * section.E / length**3
    return np.array([section.E * section.A / length, bending * section.Iz, bending * section.Iy])


def _frame_stiffness(section: Section, length: float) -> Array:
    """(12, 12) in beam axes, each node linear first: u v w and rotations about x y z."""
    k = np.zeros((12, 12))
    _add_spring(k, 0, 6, section.E * section.A / length)
    _add_spring(k, 3, 9, section.G * section.J / length)
    _add_bending(k, (1, 5, 7, 11), section.E * section.Iz, length, 1.0)
    _add_bending(k, (2, 4, 8, 10), section.E * section.Iy, length, -1.0)
    return k


def _add_spring(k: Array, i: int, j: int, value: float) -> None:
    k[np.ix_((i, j), (i, j))] += value * np.array([[1.0, -1.0], [-1.0, 1.0]])


def _add_bending(k: Array, dofs: tuple[int, ...], flexural: float, length: float, sign: float) -> None:
    # A positive turn about y lowers w where a positive turn about z raises v, hence the sign.
    s = sign * 6.0 * length
    block = np.array(
        [
            [12.0, s, -12.0, s],
            [s, 4.0 * length**2, -s, 2.0 * length**2],
            [-12.0, -s, 12.0, -s],
            [s, 2.0 * length**2, -s, 4.0 * length**2],
        ]
    )
    k[np.ix_(dofs, dofs)] += flexural / length**3 * block
