"""Places that instruments write for a target that is lost: one rule for campaigns and for files of other programs."""

import numpy as np

from armflex.conventions import Array

HUGE = 1e15
"""A coordinate beyond this is a length in no unit: 1e15 um is the way to the moon and back. NDI writes -3.697314e28."""

FINER = 6
"""Places that are not whole, fewer than which say nothing of what an instrument writes."""

MOST_DECIMALS = 6

NINES = np.array([[float(f"{'9' * n}.{'9' * k}") for k in range(5)] for n in range(3, 11)])
"""(8, 5) what programs write for a missing number: 999, 999.9 .. 9999999999.9999, with either sign."""


def lost(places: Array) -> np.ndarray:
    """Return (N,) which of (N, 3) places, in any unit, are what instruments write for a target that is lost.

    Such is a place with a coordinate that is no number, none of any length (`HUGE`), or all nines from 9999 on; and
    one whose three coordinates are the same number, if that is 0 (Qualisys, Vicon, most drivers of ROS), all nines,
    whole where the others are not (-1, -32768), has two decimals less than they (-999.25), or comes more than once: no
    target is measured at exactly (c, c, c).
    """
    size = np.abs(places)
    gone = np.array(~(size < HUGE).all(axis=1) | np.isin(size, NINES[1:]).any(axis=1), dtype=bool)
    equal = ~gone & (places == places[:, :1]).all(axis=1)
    values, index, counts = np.unique(places[equal, 0], return_inverse=True, return_counts=True)
    finer = (places[~gone & ~equal] % 1.0 != 0.0).any(axis=1)
    whole = (values[index] % 1.0 == 0.0) & (2 * np.count_nonzero(finer) > max(len(finer), FINER))
    others = _decimals(places[~gone & ~equal]).max(axis=1)
    coarser = len(others) > FINER and _decimals(values[index]) + 2 <= np.quantile(others, 0.1, method="lower")
    gone[equal] = whole | coarser | (values[index] == 0.0) | np.isin(np.abs(values[index]), NINES) | (counts[index] > 1)
    return gone


def _decimals(values: Array) -> np.ndarray:
    """Return how many decimals numbers are written with, at most `MOST_DECIMALS`."""
    count = np.full(values.shape, MOST_DECIMALS)
    for decimals in range(MOST_DECIMALS - 1, -1, -1):
        count[np.abs(values - np.round(values, decimals)) <= 1e-9 * np.abs(values)] = decimals
    return count
