"""What was found in each cell of space, and how two such findings become one.

A single answer is a tally of one row, so that counting answers and joining tallies are the same thing. It takes the
place of a list of all answers: its size is that of the space reached, however many answers there were.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from armflex.conventions import Array

BITS = 21
"""Bits of a cell's number for each axis."""

SIDE = 1 << (BITS - 1)
"""Cells are numbered from -SIDE to SIDE - 1 along each axis."""


@dataclass(frozen=True, eq=False)
class Tally:
    """Rows of answers; once `joined`, one row for each of V cells, in the order of their numbers.

    Attributes:
        cell: (V,) number of the cell, see `cell_numbers`.
        configurations: (V,) how many had their rigid tip there.
        answered: (V,) how many answers there are, one for each configuration and payload.
        refused: (V, r) how many were refused for each of r reasons.
        total: (V,) sum of the displacements [m].
        worst: (V,) largest displacement [m], -inf where there is no answer.
        payload: (V,) number of the payload that it is of.
        q: (V, nq) its joint positions [rad or m].
        worst_of_draws: (V,) largest displacement of any drawn arm [m], inf where one has no answer, -inf where none
            were drawn.
    """

    cell: np.ndarray
    configurations: np.ndarray
    answered: np.ndarray
    refused: np.ndarray
    total: Array
    worst: Array
    payload: np.ndarray
    q: Array
    worst_of_draws: Array

    def __len__(self) -> int:
        return len(self.cell)


SUMMED = ("configurations", "answered", "refused", "total")
OF_WORST = ("cell", "worst", "payload", "q")


def joined(tallies: Sequence[Tally]) -> Tally:
    """Return one row for each cell that any of the tallies has; of equally bad answers the first is kept.

    The result depends on the order of the tallies in its last digits only, and not at all on where they were made.
    """
    parts = {field.name: np.concatenate([getattr(each, field.name) for each in tallies]) for field in fields(Tally)}
    if not len(parts["cell"]):
        return Tally(**parts)
    order = np.lexsort((-parts["worst"], parts["cell"]))  # stable
    parts = {name: values[order] for name, values in parts.items()}
    first = np.flatnonzero(np.diff(parts["cell"], prepend=parts["cell"][0] - 1))
    return Tally(
        **{name: np.add.reduceat(parts[name], first, axis=0) for name in SUMMED},
        **{name: parts[name][first] for name in OF_WORST},
        worst_of_draws=np.maximum.reduceat(parts["worst_of_draws"], first),
    )


def cell_numbers(points: Array, size: float) -> np.ndarray:
    """Return the (N,) number of the cell of edge `size` that each of (N, 3) points is in."""
    x, y, z = (np.floor(points / size).astype(np.int64) + SIDE).T
    return (x << 2 * BITS) | (y << BITS) | z


def cell_indices(numbers: np.ndarray) -> np.ndarray:
    """Return the (V, 3) index of cells along x, y and z: cell 0 0 0 has the origin as its lowest corner."""
    mask = (1 << BITS) - 1
    return np.stack([numbers >> 2 * BITS, (numbers >> BITS) & mask, numbers & mask], axis=1) - SIDE
