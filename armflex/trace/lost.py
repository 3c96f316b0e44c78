"""Which readings are lost beams: far off by themselves, where an effect would move its neighbours as well."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from armflex.estimate.fit import huber_weights
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
        # Enough neighbours in time, in the same session, are far.
        count, row, session = len(far), np.arange(len(far)), np.unique(sessions, return_inverse=True)[1]
        beside = np.zeros(count, dtype=int)
        for step in NEAR:
            other = np.clip(row + step, 0, count - 1)
            beside += far[other] & (session[other] == session) & (other == row + step)
        # Enough other readings of the same pose are far, and half of them.
        others, alike = np.bincount(poses)[poses] - 1, np.bincount(poses, far)[poses] - far
        lost &= (beside < FELLOWS) & ((alike < FELLOWS) | (2 * alike < others))
    return lost & (lost.mean() <= MOST)
