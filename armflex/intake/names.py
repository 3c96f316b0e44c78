"""Names of rows in two files: which are of one another, as far as that is certain.

Programs write one name in many ways: P1, p1, P01, Pt_1, A::Main::P1, 1, 1.0. Names are compared as they are; then
without capitals, separators and leading zeros; then by what counts in them, where all of a file have the same words.
"""

import re
from collections.abc import Hashable, Sequence
from typing import NamedTuple

PARTS = re.compile(r"\d+|[^\W\d_]+")
"""Words and numbers of a name."""

COUNT = re.compile(r"\d+(?:\.\d*)?(?:e\+?\d{1,2})?", re.IGNORECASE)
"""A count, which may have gone through a spreadsheet: 12, 12.0, 1.2e+01."""


class Pairing(NamedTuple):
    """What (N,) `rows` and (M,) `points` are called by: those of equal keys are of one another.

    `numbered` says whether only the numbers in their names are compared.
    """

    rows: list[Hashable]
    points: list[Hashable]
    numbered: bool

    @property
    def shared(self) -> set[Hashable]:
        """Keys that both have."""
        return set(self.rows) & set(self.points)


def paired_names(rows: Sequence[str], points: Sequence[str], by_number: bool = True) -> Pairing | None:
    """Return by what most names of two files are of one another, None where that is not certain of any.

    Names of which only the numbers agree are compared where `by_number` says so.
    """
    spelt = tuple([tuple(_parts(name)) for name in names] for names in map(_whole, (rows, points)))
    tried = [Pairing(list(rows), list(points), False), Pairing(list(spelt[0]), list(spelt[1]), False)]
    counts = [_counts(keys) for keys in spelt]
    if by_number and counts[0] is not None and counts[1] is not None and _one_series(counts[0], counts[1]):
        tried.append(Pairing(list(counts[0][1]), list(counts[1][1]), True))
    best, most = None, 0
    for pairing in tried:
        pairs = ((pairing.rows, rows), (pairing.points, points))
        unique = all(len(set(keys)) == len(set(names)) for keys, names in pairs)
        shared = sum(key in pairing.shared for key in pairing.rows)
        if unique and shared > most and not _shifted(pairing, *counts):
            best, most = pairing, shared
    return best


def is_resorted(names: Sequence[str]) -> bool:
    """Return whether names count, and not upwards: measured, or sorted by a program, in an order of their own."""
    counts = _counts([tuple(_parts(name)) for name in _whole(names)])
    return counts is not None and len(set(counts[1])) == len(names) and counts[1] != sorted(counts[1])


def _whole(names: Sequence[str]) -> list[str]:
    """Return names, as whole numbers where all are."""
    counted = all(COUNT.fullmatch(name) and float(name).is_integer() for name in names)
    return [f"{float(name):.0f}" for name in names] if counted else list(names)


def _parts(name: str) -> list[str | int]:
    return [int(part) if part.isdecimal() else part for part in PARTS.findall(name.casefold())]


def _counts(keys: Sequence[tuple[str | int, ...]]) -> tuple[tuple[str | int, ...], list[tuple[int, ...]]] | None:
    """Return what all names of a file have alike, and the numbers of each that are not; None where words differ."""
    columns = list(zip(*keys, strict=False))
    if len({len(key) for key in keys}) != 1:
        return None
    varying = [i for i, column in enumerate(columns) if len(set(column)) > 1]
    if len(keys) == 1 or not varying:
        varying = [i for i, column in enumerate(columns) if isinstance(column[0], int)][-1:]
    if not varying or any(isinstance(part, str) for i in varying for part in columns[i]):
        return None
    alike = tuple(column[0] for i, column in enumerate(columns) if i not in varying)
    return alike, [tuple(int(key[i]) for i in varying) for key in keys]


def _one_series(
    rows: tuple[tuple[str | int, ...], list[tuple[int, ...]]],
    points: tuple[tuple[str | int, ...], list[tuple[int, ...]]],
) -> bool:
    """Return whether the numbers of names that differ otherwise are counted alike: one file has all of the other's.

    What both count in may have a number of its own, as of a station, but not two different ones.
    """
    of_all = [[part for part in alike if isinstance(part, int)] for alike, _ in (rows, points)]
    given = set(rows[1]), set(points[1])
    return (of_all[0] == of_all[1] or not all(of_all)) and (given[0] <= given[1] or given[1] <= given[0])


def _shifted(
    pairing: Pairing,
    rows: tuple[tuple[str | int, ...], list[tuple[int, ...]]] | None,
    points: tuple[tuple[str | int, ...], list[tuple[int, ...]]] | None,
) -> bool:
    """Return whether two files may count alike from different starts, so that equal numbers are of other rows."""
    if rows is None or points is None:
        return False
    first, last = (tuple(of(numbers) for _, numbers in (rows, points)) for of in (min, max))
    zeros = ((0,) in rows[1]) != ((0,) in points[1])
    moved = (first[0] < first[1] and last[0] < last[1]) or (first[0] > first[1] and last[0] > last[1])
    named = not pairing.numbered and any(isinstance(part, str) for part in (*rows[0], *points[0]))
    return (zeros and moved) if named else (zeros or moved)
