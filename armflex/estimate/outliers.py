"""Readings that no fit believes: lost beams, and pairs of readings that stand in each other's row.

What moves the arm moves it for a while, or whenever it is in a pose: such readings are far off in company, and may be
an effect. One that stands alone is a lost beam, and is left out: it, not its row, in which others may have read well.
So are two that stand in each other's place, whatever is beside them.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from armflex.arm import Setup
from armflex.conventions import Array, Shown, shown_in
from armflex.errors import ConvergenceError, Place
from armflex.estimate.block import Block
from armflex.estimate.fit import ROUGH, THOROUGH, Fit, fit
from armflex.estimate.robust import instrument_weights, outlier_limit
from armflex.estimate.view import View, look
from armflex.measured.measurements import Measurements
from armflex.parameters import ABSURD
from armflex.progress import Progress
from armflex.readings.instrument import ROUNDS

DOUBTED = 0.5
"""Confidence: robust weight below which a reading says nothing about a model, and speaks for its neighbours: they are
far off for one reason."""

FELLOWS = 2
"""Tolerance: readings of the pose, or of as many in time to either side, that are far off too where one does not stand
alone."""

MOST_LOST = 0.1
"""Prior: share of the readings that lost beams are at most; where more stand alone, it is the model that is wrong."""


@dataclass(frozen=True)
class Outlier:
    """What the fit excludes of a row: its place, its error [m, or `unit`], and what became of it.

    `instrument` is the sensor that read it, '' the instrument at the tip; `fellow`
    is the row, or in the same row the instrument, whose reading stands there, of two that are exchanged; `shown` is of
    the kind of reading.
    """

    row: int
    place: Place | None
    error_m: float
    kind: str = "counted less"
    instrument: str = ""
    unit: str = "m"
    fellow: str = ""
    shown: Shown | None = None

    @property
    def shown_in(self) -> Shown:
        """The unit in which people are shown its error, and its factor."""
        return self.shown or shown_in(self.unit)


def lost_readings(view: View, sessions: Sequence[str], poses: np.ndarray, heed: bool = True) -> np.ndarray:
    """Return (M, G) which readings of every instrument are lost beams, `ABSURD` times as far off as noise makes any.

    Args:
        view: The campaign at a fit, rows in the order driven.
        sessions: Session of every row.
        poses: (M,) number of every row's pose.
        heed: Whether what is far off in company stays, as long as some effect may still explain it.
    """
    weights = instrument_weights(view)
    far, lost, paired = weights < DOUBTED, weights * ABSURD < 1.0, np.zeros(weights.shape, dtype=bool)
    if lost.any():
        paired[tuple(np.transpose([*exchanged(view, far)]).reshape(2, -1).astype(int))] = True
        paired &= lost
        far, lost = far & ~paired, lost & ~paired
    if heed:
        count, row, session = len(far), np.arange(len(far)), np.unique(sessions, return_inverse=True)[1]
        beside = np.zeros(far.shape, dtype=int)  # neighbours in time, in the same session, that are far off
        for step in (*range(-FELLOWS, 0), *range(1, FELLOWS + 1)):
            other = np.clip(row + step, 0, count - 1)
            beside += far[other] & ((session[other] == session) & (other == row + step))[:, None]
        # Enough other readings of the same pose are far off, and half of them.
        others = (np.bincount(poses)[poses] - 1)[:, None]
        alike = np.array([np.bincount(poses, column)[poses] for column in far.T.astype(float)]).T - far
        lost &= (beside < FELLOWS) & ((alike < FELLOWS) | (2 * alike < others))
    return paired | (lost & (lost.mean(axis=0) <= MOST_LOST))


def lost_among(view: View, measurements: Measurements, heed: bool = True) -> np.ndarray:
    """Return (M, G) which readings of a campaign's rows in a view are lost beams; see `lost_readings`."""
    sessions = [measurements.session[row] for row in view.rows]
    return lost_readings(view, sessions, measurements.pose_number[view.rows], heed)


def without_lost(measurements: Measurements, rows: np.ndarray, lost: np.ndarray) -> tuple[Measurements, np.ndarray]:
    """Return a campaign in which (M, G) lost readings of (M,) rows were not made, and (M,) which rows hold others."""
    kept = np.ones((len(measurements), measurements.readings.size), bool)
    for column, place in zip(lost.T, measurements.readings.groups, strict=True):
        kept[rows[column], place] = False
    left = measurements if kept.all() else replace(measurements, readings=measurements.readings.where(kept))
    return left, np.any(np.isfinite(left.readings.sigma[rows]), axis=1)


def fit_without_lost(
    declared: Setup,
    blocks: Sequence[Block],
    measurements: Measurements,
    start: Array | None,
    near: View,
    progress: Progress | None = None,
) -> Fit:
    """Return a fit in which lost beams and exchanged readings have no part; its view has them, as all others.

    They are found before the rest is asked to settle. However little a reading a metre off counts, it pulls as hard as
    one at the limit does, and where that pull turns with every step none is right for long.

    Args:
        declared, blocks, measurements, start, progress: See `fit`.
        near: The rows to use, where it is first asked which readings are lost.

    Raises:
        As `fit`.
    """
    used, lost = near.rows, lost_among(near, measurements)
    effort, failed, fitted = ROUGH if lost.any() else THOROUGH, None, None
    for number in range(ROUNDS):
        rest, kept = without_lost(measurements, used, lost)
        try:
            fitted, failed = fit(declared, blocks, rest, used[kept], start, progress, effort), None
        except ConvergenceError as error:
            fitted, failed = fit(declared, blocks, rest, used[kept], start, progress, ROUGH), error
        if lost.any():
            fitted = replace(fitted, view=look(fitted.setup, measurements, used))
        again = lost_among(fitted.view, measurements)
        again |= lost & (number >= FELLOWS)  # from then on none comes back
        if np.array_equal(again, lost) and effort is THOROUGH:
            break
        lost, start, effort = again, fitted.values, THOROUGH
    if failed is not None:
        raise failed
    assert fitted is not None
    return fitted


def exchanged(view: View, far: np.ndarray) -> dict[tuple[int, int], tuple[int, int]]:
    """Return by (row, instrument) where a reading belongs, for pairs that stand in each other's place.

    That is another row of the same instrument, or another instrument of the same kind in the same row.

    Args:
        view: The campaign at a fit; rows are counted from 0.
        far: (M, G) readings that are far off.
    """
    swaps: dict[tuple[int, int], tuple[int, int]] = {}
    foremost = {place.start: kind for kind, place in view.readings.placed}
    groups = [(foremost[column.start], slice(column.start, column.start + foremost[column.start].dimension))
              for column in view.readings.groups]  # fmt: skip
    limits = []
    for number, (kind, place) in enumerate(groups):
        near = ~far[:, number]
        rest = np.linalg.norm(view.residual[near, place] / view.sigma[near, place], axis=1)
        limits.append(outlier_limit(kind.dimension) * max(float(np.median(rest)) if len(rest) else 1.0, 1.0))
    # In the order of rows and instruments, each pair once.
    for (i, group), (j, other) in combinations(np.argwhere(far).tolist(), 2):
        (kind, place), (second, elsewhere) = groups[group], groups[other]
        if group != other and (i != j or type(kind) is not type(second)):
            continue
        apart = second.values[j] - kind.values[i]
        crossed = (
            np.linalg.norm((apart + view.residual[i, place]) / view.sigma[j, elsewhere]),
            np.linalg.norm((view.residual[j, elsewhere] - apart) / view.sigma[i, place]),
        )
        if max(crossed) < min(limits[group], limits[other]):
            swaps |= {(i, group): (j, other), (j, other): (i, group)}
    return swaps


def outliers_of(view: View, far: np.ndarray, measurements: Measurements, kind: str) -> Iterator[Outlier]:
    """Yield the (M, G) readings that are far off, the worst of every instrument first; pairs are called exchanged.

    Args:
        view: The campaign at a fit.
        far: Which readings those are.
        measurements: The campaign.
        kind: What became of them.
    """
    pairs, places, named = exchanged(view, far), measurements.places, view.readings.names
    for number, group in enumerate(view.readings.groups):
        each = next(kind_read for kind_read, place in view.readings.placed if place.start == group.start)
        error: Array = np.linalg.norm(view.residual[:, group.start : group.start + each.dimension], axis=1)
        rows = np.flatnonzero(far[:, number])
        for i in rows[np.argsort(-error[rows])].tolist():
            row, said, fellow = int(view.rows[i]), kind, ""
            if (i, number) in pairs:
                (j, second), said = pairs[i, number], "exchanged"
                there = int(view.rows[j])
                fellow = f"line {places[there].line}" if places else f"row {there}"
                fellow = fellow if j != i else named[second] or "x y z"
            place = places[row] if places else None
            yield Outlier(row, place, float(error[i]), said, each.name, each.unit, fellow, each.shown)


def outlier_json(outlier: Outlier) -> dict[str, Any]:
    """Return which reading is an outlier, by which instrument, and the one that it was exchanged with."""
    names = {"instrument": outlier.instrument, "exchanged_with": outlier.fellow}
    return {"row": outlier.row, "place": str(outlier.place)} | {name: value for name, value in names.items() if value}
