"""The boom as a frame of Euler-Bernoulli beams in space with springs at its joints: linear, banded, our own.

Links are beams so stiff that they do not count, because the boom's links are rigid; what gives are the springs between
two nodes at every joint. Nodes follow each other along the arm, so the stiffness is a band of eleven subdiagonals.
Loads act where they did before the arm sagged: this is the textbook's answer, of first order.
"""

from collections.abc import Callable

import numpy as np
from boom import Boom
from scipy.linalg import cho_solve_banded, cholesky_banded

from armflex.conventions import Array

RIGID = 1e5
"""How much stiffer than the stiffest spring that is which must not give."""
BAND = np.arange(12)[:, None] - np.arange(12)  # of an element: how far below the diagonal each entry is


def frame_assembled(boom: Boom) -> Callable[[], Array]:
    """Return a call that assembles, factors and solves; it returns the tip's (3,) position [m]."""
    return lambda: frame_solved(boom)()


def frame_solved(boom: Boom) -> Callable[[], Array]:
    """Return the solution alone, for loads on a frame that is factored already."""
    band, load, tip = frame(boom)
    factor = cholesky_banded(band, lower=True)
    return lambda: tip + cho_solve_banded((factor, True), load)[-6:-3]


def frame(boom: Boom) -> tuple[Array, Array, Array]:
    """Return the (12, 6 n) lower band of the stiffness, the (6 n,) loads, and the straight arm's tip (3,)."""
    frames = straight_frames(boom)
    ends = [pose[:3, 3] for pose in frames[1:]]
    slide, hinge = stiffest(boom)
    count = 2 * len(boom.stations)
    band, load = np.zeros((12, 6 * count)), np.zeros(6 * count)
    for i, station in enumerate(boom.stations):
        rotation, start = frames[i][:3, :3], 12 * i
        add(band, spring(station.compliance, rotation, slide, hinge), start - 6)
        add(band, beam(ends[i] - frames[i][:3, 3], slide, hinge), start)
        weight = station.mass * boom.gravity
        load[start : start + 6] = [*weight, *np.cross(rotation @ station.com, weight)]
    return band, load, ends[-1]


def straight_frames(boom: Boom) -> list[Array]:
    """Return the (4, 4) poses of the stations with every spring straight, the tip's last."""
    frames = [np.eye(4)]
    for station in boom.stations:
        frames.append(frames[-1] @ station.placement)
    tip = np.eye(4)
    tip[:3, 3] = boom.tip
    return [*frames[1:], frames[-1] @ tip]


def stiffest(boom: Boom) -> tuple[float, float]:
    """Return the stiffness of what must not give: along [N/m] and about [Nm/rad]."""
    given = np.array([station.compliance for station in boom.stations])
    return tuple(RIGID / part[part > 0.0].min() for part in (given[:, :3], given[:, 3:]))


def spring(compliance: Array, rotation: Array, slide: float, hinge: float) -> Array:
    """Return the (12, 12) stiffness of six springs between two nodes at one place, in base axes."""
    rigid = np.repeat([slide, hinge], 3)
    local = np.divide(1.0, compliance, out=rigid, where=compliance > 0.0)
    turn = np.kron(np.eye(2), rotation)
    return np.kron([[1.0, -1.0], [-1.0, 1.0]], turn @ np.diag(local) @ turn.T)


def beam(along: Array, slide: float, hinge: float) -> Array:
    """Return the (12, 12) stiffness of an Euler-Bernoulli beam of that direction and length, in base axes.

    Axial, torsional and bending stiffness are given as EA / L, and GJ / L = EI / L.
    """
    length = float(np.linalg.norm(along))
    x = along / length
    y = np.cross([0.0, 0.0, 1.0] if abs(x[2]) < 0.9 else [1.0, 0.0, 0.0], x)
    y /= np.linalg.norm(y)
    turn = np.kron(np.eye(4), np.array([x, y, np.cross(x, y)]))
    return turn.T @ beam_along_x(length, slide, hinge) @ turn


def beam_along_x(length: float, axial: float, bending: float) -> Array:
    """Return the textbook's (12, 12) matrix, nodes as dx dy dz rx ry rz."""
    k = np.zeros((12, 12))
    k[np.ix_([0, 6], [0, 6])] = axial * np.array([[1, -1], [-1, 1]])
    k[np.ix_([3, 9], [3, 9])] = bending * np.array([[1, -1], [-1, 1]])
    for places, side in (([1, 5, 7, 11], length), ([2, 4, 8, 10], -length)):
        k[np.ix_(places, places)] = (bending / length**2) * np.array(
            [
                [12, 6 * side, -12, 6 * side],
                [6 * side, 4 * side**2, -6 * side, 2 * side**2],
                [-12, -6 * side, 12, -6 * side],
                [6 * side, 2 * side**2, -6 * side, 4 * side**2],
            ]
        )
    return k


def add(band: Array, element: Array, start: int) -> None:
    """Add an element whose twelve coordinates begin at `start`; those before 0 or past the end stand on the ground."""
    first = max(0, -start)
    rows, columns = np.nonzero((BAND >= 0) & (np.arange(12) >= first) & (np.arange(12)[:, None] >= first))
    band[BAND[rows, columns], start + columns] += element[rows, columns]
