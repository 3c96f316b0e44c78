"""Which readings are lost beams: far off by themselves, where an effect would move its neighbours as well."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from armflex.estimate.robust import huber_weights
from armflex.estimate.view import View

LOST = 0.1
"""Robust weight below which a reading may be a lost beam: forty standard deviations or more."""

FAR = 0.5
"""Robust weight below which a reading speaks for its neighbours: they are far for one reason."""

NEAR = (-2, -1, 1, 2)
"""Steps in time to a reading's neighbours."""

FELLOWS = 2
"""Neighbours in time, or other readings of the pose, that must be far too for a reading not to stand alone."""

MOST = 0.1
"""Share of the readings that lost beams are at most; where more stand alone, it is the model that is wrong."""


def lost_beams(view: View, sessions: Sequence[str], poses: np.ndarray, heed: bool = True) -> np.ndarray:
    """Return (M,) which readings are lost beams.

    What moves the arm moves it for a while, or whenever it is in a pose: such readings are far in company, and stay.

    Args:
        view: The campaign at a fit, rows in the order driven.
        sessions: Session of every row.
        poses: (M,) number of every row's pose.
        heed: Whether what is far in company stays, as long as some effect may still explain it.
    """
    weights = huber_weights(view)
    far = weights < FAR
    lost = weights < LOST
    if heed:
        lost &= ~_in_a_run(far, np.unique(sessions, return_inverse=True)[1]) & ~_in_a_pose(far, poses)
    return lost & (lost.mean() <= MOST)


def _in_a_run(far: np.ndarray, sessions: np.ndarray) -> np.ndarray:
    """Return (M,) whether enough neighbours in time, in the same session, are far."""
    count, row = len(far), np.arange(len(far))
    beside = np.zeros(count, dtype=int)
    for step in NEAR:
        other = np.clip(row + step, 0, count - 1)
        beside += far[other] & (sessions[other] == sessions) & (other == row + step)
    return beside >= FELLOWS


def _in_a_pose(far: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """Return (M,) whether enough other readings of the same pose are far: two, and half of them."""
    others = np.bincount(poses)[poses] - 1
    beside = np.bincount(poses, far)[poses] - far
    return (beside >= FELLOWS) & (2 * beside >= others)
