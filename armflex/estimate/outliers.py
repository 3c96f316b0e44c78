"""Readings that no fit believes: lost beams, and pairs of readings that stand in each other's row.

What moves the arm moves it for a while, or whenever it is in a pose: such readings are far off in company, and may be
an effect. One that stands alone is a lost beam, and is left out: it, not its row, in which others may have read well.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from armflex.conventions import Array
from armflex.errors import Place
from armflex.estimate.robust import instrument_weights, outlier_limit
from armflex.estimate.view import View
from armflex.measured.measurements import Measurements

LOST = 0.1
"""Confidence: robust weight below which a reading may be a lost beam, at forty standard deviations or more."""

DOUBTED = 0.5
"""Confidence: robust weight below which a reading speaks for its neighbours: they are far off for one reason."""

NEAR = (-2, -1, 1, 2)
"""Tolerance: steps in time to a reading's neighbours."""

FELLOWS = 2
"""Tolerance: neighbours in time, or other readings of the pose, that are far off too where it does not stand alone."""

MOST = 0.1
"""Prior: share of the readings that lost beams are at most; where more stand alone, it is the model that is wrong."""


@dataclass(frozen=True)
class Outlier:
    """What the fit excludes of a row: its place, its error [m, or `unit`], and what became of it.

    `instrument` is the sensor that read it, '' the instrument at the tip; `fellow`
    is the row whose reading stands there, of two that are exchanged.
    """

    row: int
    place: Place | None
    error_m: float
    kind: str = "counted less"
    instrument: str = ""
    unit: str = "m"
    fellow: str = ""


def lost_readings(view: View, sessions: Sequence[str], poses: np.ndarray, heed: bool = True) -> np.ndarray:
    """Return (M, G) which readings of every instrument are lost beams.

    Args:
        view: The campaign at a fit, rows in the order driven.
        sessions: Session of every row.
        poses: (M,) number of every row's pose.
        heed: Whether what is far off in company stays, as long as some effect may still explain it.
    """
    weights = instrument_weights(view)
    far, lost = weights < DOUBTED, weights < LOST
    if heed:
        count, row, session = len(far), np.arange(len(far)), np.unique(sessions, return_inverse=True)[1]
        beside = np.zeros(far.shape, dtype=int)  # neighbours in time, in the same session, that are far off
        for step in NEAR:
            other = np.clip(row + step, 0, count - 1)
            beside += far[other] & ((session[other] == session) & (other == row + step))[:, None]
        # Enough other readings of the same pose are far off, and half of them.
        others = (np.bincount(poses)[poses] - 1)[:, None]
        alike = np.array([np.bincount(poses, one)[poses] for one in far.T.astype(float)]).T - far
        lost &= (beside < FELLOWS) & ((alike < FELLOWS) | (2 * alike < others))
    return lost & (lost.mean(axis=0) <= MOST)


def exchanged(view: View, far: np.ndarray) -> dict[tuple[int, int], int]:
    """Return by (row, instrument) the row whose reading stands there, where two readings stand in each other's row.

    Args:
        view: The campaign at a fit; rows are counted from 0.
        far: (M, G) readings that are far off.
    """
    found: dict[tuple[int, int], int] = {}
    for number, place in enumerate(view.readings.groups):
        own = next(kind for kind, where in view.readings.placed if where.start == place.start)
        values, left = own.values, view.residual[:, place.start : place.start + own.dimension]
        sigma, limit = view.sigma[:, place.start : place.start + own.dimension], outlier_limit(own.dimension)
        rest = np.linalg.norm(left[~far[:, number]] / sigma[~far[:, number]], axis=1)
        limit *= max(float(np.median(rest)) if len(rest) else 1.0, 1.0)
        for i in np.flatnonzero(far[:, number]).tolist():
            for j in np.flatnonzero(far[:, number]).tolist():
                crossed = (values[j] - values[i] + left[i]) / sigma[j], (values[i] - values[j] + left[j]) / sigma[i]
                if i != j and max(np.linalg.norm(one) for one in crossed) < limit:
                    found[i, number] = j
    return found


def outliers_of(view: View, far: np.ndarray, measurements: Measurements, kind: str) -> Iterator[Outlier]:
    """Yield the (M, G) readings that are far off, the worst of every instrument first; pairs are called exchanged.

    Args:
        view: The campaign at a fit.
        far: Which readings those are.
        measurements: The campaign.
        kind: What became of them.
    """
    pairs, places = exchanged(view, far), measurements.places
    for number, group in enumerate(view.readings.groups):
        own = next(one for one, place in view.readings.placed if place.start == group.start)
        error: Array = np.linalg.norm(view.residual[:, group.start : group.start + own.dimension], axis=1)
        some = np.flatnonzero(far[:, number])
        for i in some[np.argsort(-error[some])].tolist():
            row, said, fellow = int(view.rows[i]), kind, ""
            if (i, number) in pairs:
                other = int(view.rows[pairs[i, number]])
                said = "exchanged"
                fellow = f"line {places[other].line}" if places else f"row {other}"
            place = places[row] if places else None
            yield Outlier(row, place, float(error[i]), said, own.name, own.unit, fellow)
