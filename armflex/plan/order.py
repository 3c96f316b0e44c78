"""In what order to drive chosen rows: conditions and payloads changed as rarely as can be, then little motion.

Nearest neighbours, then pieces of the way turned round as long as that shortens it (2-opt; Croes 1958).
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import numpy as np

from armflex.conventions import Array


def driving_order(q: Array, groups: Sequence[Hashable], start: Array, span: Array) -> list[int]:
    """Return the numbers of (N, nq) rows in the order to drive them.

    Args:
        q: Joint positions [rad or m].
        groups: What every row shares with those that are driven without a change between; in order of appearance.
        start: (nq,) where the arm stands before [rad or m].
        span: (nq,) way of every joint that counts as one [rad or m].
    """
    order: list[int] = []
    here = start / span
    for group in dict.fromkeys(groups):
        members = [i for i, one in enumerate(groups) if one == group]
        places = q[members] / span
        way = _shortened(places, here, _nearest(places, here))
        order += [members[i] for i in way]
        here = q[order[-1]] / span
    return order


def motion(q: Array, start: Array, span: Array) -> float:
    """Return the way that all joints together make over (N, nq) rows, in units of `span`."""
    return float(np.abs(np.diff(np.vstack([start, q]) / span, axis=0)).sum())


def _nearest(places: Array, here: Array) -> list[int]:
    left, way = list(range(len(places))), []
    while left:
        nearest = min(left, key=lambda i: float(np.abs(places[i] - here).sum()))
        way.append(nearest)
        left.remove(nearest)
        here = places[nearest]
    return way


def _shortened(places: Array, here: Array, way: list[int]) -> list[int]:
    """Return the way with pieces turned round until none is worth turning; it ends wherever it likes."""
    every = np.vstack([here, places])
    far = np.abs(every[:, None] - every[None]).sum(axis=2)
    stops = [0, *(i + 1 for i in way)]
    better = True
    while better:
        better = False
        for first in range(1, len(stops) - 1):
            for last in range(first + 1, len(stops)):
                if _turned(far, stops, first, last) < -1e-9:
                    stops[first : last + 1] = stops[first : last + 1][::-1]
                    better = True
    return [i - 1 for i in stops[1:]]


def _turned(far: Array, stops: Sequence[int], first: int, last: int) -> float:
    """Return what the way grows by when the piece from `first` to `last` is driven backwards."""
    before, begin, end = stops[first - 1], stops[first], stops[last]
    change = far[before, end] - far[before, begin]
    if last + 1 < len(stops):
        change += far[begin, stops[last + 1]] - far[end, stops[last + 1]]
    return float(change)
