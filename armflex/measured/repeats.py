"""Noise told by repeats alone: no arm, no law, only readings of one pose under one payload that differ."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from armflex.conventions import Array
from armflex.errors import Flag
from armflex.measured.measurements import Measurements
from armflex.rows.poses import numbered, same_positions

REPEATED = 2e-5
"""Joint positions nearer than this [rad or m] repeat a pose: 0.2 mm at the end of a 10 m arm."""

LOST = 6.0
"""Robust standard deviations from its fellows beyond which a reading is a lost beam."""

DOUBTFUL = 1.5
"""Ratio of scatter to stated noise that is flagged, when the repeats are many enough to tell."""


@dataclass(frozen=True, eq=False)
class Scatter:
    """How far repeats lie apart.

    Attributes:
        sigma: (3,) pooled standard deviation of one reading along x, y, z [m].
        freedom: Degrees of freedom per axis; sigma is known to about 1 / sqrt(2 freedom) of itself.
        groups: Sets of repeats that it comes from.
        stated: (3,) root mean square of the stated standard deviations of the same readings [m].
        lost: Row numbers left out as lost beams.
    """

    sigma: Array
    freedom: int
    groups: int
    stated: Array
    lost: tuple[int, ...] = ()

    @property
    def ratio(self) -> Array:
        """(3,) scatter over stated noise."""
        return self.sigma / self.stated

    @property
    def uncertainty(self) -> float:
        """Relative standard uncertainty of sigma."""
        return float(1.0 / np.sqrt(2.0 * self.freedom))


@dataclass(frozen=True, eq=False)
class Repeats:
    """What repeats say about noise.

    Attributes:
        same_session: Repeats within a session: the floor below which no model can get.
        same_approach: Those of them that every joint approached from the same side; None where there are none.
        across_sessions: Means of a pose in different sessions, which differ by the sessions' frames as well; None
            where no pose was measured in two.
        flags: Doubt about the stated noise.
    """

    same_session: Scatter
    same_approach: Scatter | None
    across_sessions: Scatter | None
    flags: tuple[Flag, ...]


def repeats(measurements: Measurements, tolerance: float = REPEATED) -> Repeats | None:
    """Return the noise that repeated readings show, or None where nothing was repeated.

    Args:
        measurements: The campaign; rows share a pose when their joint positions do, whatever its name.
        tolerance: How near joint positions must be [rad or m].
    """
    place = same_positions(measurements.q, tolerance).tolist()
    held = list(zip(place, measurements.payload, strict=True))
    once = numbered(zip(held, measurements.session, strict=True))
    sides = (tuple(row) for row in measurements.approach.tolist())
    same_session = _scatter(measurements, once)
    if same_session is None:
        return None
    return Repeats(
        same_session,
        _scatter(measurements, numbered(zip(once.tolist(), sides, strict=True))),
        _between(measurements, numbered(held), once, same_session.lost),
        _flags(same_session),
    )


def _scatter(measurements: Measurements, labels: np.ndarray) -> Scatter | None:
    """Return the pooled scatter of measured rows that share a label."""
    sets = _sets(labels, measurements.measured)
    if not sets:
        return None
    lost = _lost(measurements.position, sets, _stated(measurements, np.concatenate(sets)))
    kept = [rows for rows in (np.setdiff1d(rows, lost) for rows in sets) if len(rows) > 1]
    if not kept:
        return None
    sigma, freedom = _pooled([measurements.position[rows] for rows in kept])
    return Scatter(sigma, freedom, len(kept), _stated(measurements, np.concatenate(kept)), tuple(lost.tolist()))


def _between(measurements: Measurements, held: np.ndarray, once: np.ndarray, lost: tuple[int, ...]) -> Scatter | None:
    """Return the scatter of each pose's session means about their common mean."""
    used = measurements.measured.copy()
    used[list(lost)] = False
    rows = np.flatnonzero(used)
    means = np.array([measurements.position[used & (once == label)].mean(axis=0) for label in np.unique(once[rows])])
    pose = np.array([held[once == label][0] for label in np.unique(once[rows])])
    sets = _sets(pose, np.ones(len(pose), dtype=bool)) if len(rows) else []
    if not sets:
        return None
    far = _lost(means, sets, _stated(measurements, rows))
    kept = [own for own in (np.setdiff1d(own, far) for own in sets) if len(own) > 1]
    if not kept:
        return None
    sigma, freedom = _pooled([means[own] for own in kept])
    again = rows[np.isin(once[rows], np.unique(once[rows])[far])]
    return Scatter(sigma, freedom, len(kept), _stated(measurements, rows), tuple(again.tolist()))


def _sets(labels: np.ndarray, used: np.ndarray) -> list[np.ndarray]:
    rows = np.flatnonzero(used)
    order = rows[np.argsort(labels[rows], kind="stable")]
    cuts = np.flatnonzero(np.diff(labels[order])) + 1
    return [own for own in np.split(order, cuts) if len(own) > 1]


def _lost(position: Array, sets: list[np.ndarray], stated: Array) -> np.ndarray:
    """Return rows further from their set's median than noise goes; of two that disagree nobody knows which is lost."""
    steps = np.concatenate([np.diff(position[rows], axis=0) for rows in sets])
    limit = _furthest(steps, stated)
    far = []
    for rows in sets:
        away = np.abs(position[rows] - np.median(position[rows], axis=0))
        # Half of their difference parts each of two rows from their median, with a deviation of sigma / sqrt 2.
        bound = limit / np.sqrt(2.0) if len(rows) == 2 else limit
        far += rows[(away > bound).any(axis=1)].tolist()
    return np.array(sorted(far), dtype=int)


def _furthest(steps: Array, stated: Array) -> Array:
    """Return (3,) deviations that are no noise, from (n, 3) differences of readings of one pose.

    The scale is their median, robust but poor when they are few: then the limit is wider, and never below what the
    stated noise allows. Readings rounded so coarsely that most repeats are equal have no scale: nothing is left out.
    """
    scale = np.median(np.abs(steps), axis=0) / (0.6745 * np.sqrt(2.0))
    limit = LOST * (1.0 + 5.0 / len(steps)) * np.maximum(scale, stated)
    return np.where(scale > 0.0, limit, np.inf)


def _pooled(sets: list[Array]) -> tuple[Array, int]:
    squares = sum(((values - values.mean(axis=0)) ** 2).sum(axis=0) for values in sets)
    freedom = sum(len(values) - 1 for values in sets)
    return np.sqrt(squares / freedom), freedom


def _stated(measurements: Measurements, rows: np.ndarray) -> Array:
    return np.sqrt((measurements.sigma[rows] ** 2).mean(axis=0))


def _flags(scatter: Scatter) -> tuple[Flag, ...]:
    """Return a flag where the stated noise is wrong by more than the repeats' own uncertainty leaves open."""
    ratio = float(np.sqrt((scatter.ratio**2).mean()))
    room = DOUBTFUL * (1.0 + 3.0 * scatter.uncertainty / np.sqrt(3.0))
    if 1.0 / room < ratio < room:
        return ()
    size, stated = (1e3 * np.sqrt((values**2).mean()) for values in (scatter.sigma, scatter.stated))
    text = f"repeats scatter by {size:.2g} mm per axis, {ratio:.2g} times the {stated:.2g} mm stated as sigma"
    return (Flag("stated_noise", text),)
