"""Which rows were taken in the same pose: what is split for validation is poses, never rows."""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from typing import TYPE_CHECKING

import numpy as np

from armflex.conventions import Array
from armflex.errors import InputError

if TYPE_CHECKING:
    from armflex.rows.rows import Rows

SAME_POSE = 1e-3
"""Joint positions nearer than this [rad or m] are one pose: a fit that saw one of them has seen the other."""


def pose_groups(rows: Rows, tolerance: float = SAME_POSE) -> np.ndarray:
    """Return (N,) integers from 0 in order of appearance, equal for rows of one pose, whatever they carried.

    Rows share a pose when they share its name, or when their joint positions differ by less than `tolerance`
    [rad or m]: names alone would let a pose that was measured twice under two names into both sides of a split.
    """
    by_place = same_positions(rows.q, tolerance)
    if len(by_place) == 1:
        return by_place
    return _joined(by_place, numbered(rows.pose))


def leaked(train: Rows, test: Rows, tolerance: float = SAME_POSE) -> np.ndarray:
    """Return the (k,) row numbers of `test` whose joint positions `train` has, within `tolerance` [rad or m], as well.

    Raises:
        InputError: The two are of different joints.
    """
    if train.joint_names != test.joint_names:
        raise InputError(f"joints {', '.join(train.joint_names)} against {', '.join(test.joint_names)}")
    labels = same_positions(np.vstack([train.q, test.q]), tolerance)
    return np.flatnonzero(np.isin(labels[len(train) :], labels[: len(train)]))


def same_positions(q: Array, tolerance: float) -> np.ndarray:
    """Return (N,) labels of (N, nq) joint positions; chains of neighbours within `tolerance` share one."""
    if len(q) == 1:  # a controller asks reading by reading
        return np.zeros(1, dtype=int)
    # np.unique sorts by the first column: with the most varied joint there, few rows are near each other in it.
    order = np.argsort([-len(np.unique(column)) for column in q.T], kind="stable")
    unique, back = np.unique(q[:, order], axis=0, return_inverse=True)
    parent = np.arange(len(unique))
    for i, row in enumerate(unique):
        end = np.searchsorted(unique[:, 0], row[0] + tolerance, side="right")
        near = i + np.flatnonzero((np.abs(unique[i:end] - row) <= tolerance).all(axis=1))
        roots = [_root(parent, int(k)) for k in near]
        parent[roots] = min(roots)
    return numbered(_root(parent, i) for i in back.ravel().tolist())


def numbered(values: Iterable[Hashable]) -> np.ndarray:
    """Return an integer for each value, from 0 in order of appearance."""
    seen: dict[Hashable, int] = {}
    return np.array([seen.setdefault(value, len(seen)) for value in values], dtype=int)


def _root(parent: np.ndarray, i: int) -> int:
    while parent[i] != i:
        i = int(parent[i])
    return i


def _joined(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the finest labels that are equal wherever either of two are."""
    joined = first.copy()
    while True:
        before = joined.copy()
        for labels in (second, first):
            lowest = np.full(labels.max(initial=-1) + 1, len(joined))
            np.minimum.at(lowest, labels, joined)
            joined = lowest[labels]
        if (joined == before).all():
            return numbered(joined.tolist())
