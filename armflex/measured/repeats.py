"""Noise estimated from repeats alone: no arm, no law, only readings of one pose under one payload that differ."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from armflex.arguments import checked_kinds
from armflex.conventions import Array
from armflex.errors import Flag
from armflex.measured.measurements import Measurements
from armflex.result import Result
from armflex.rows.rows import numbered, same_positions

REPEATED = 2e-5
"""Joint positions nearer than this [rad or m] repeat a pose: 0.2 mm at the end of a 10 m arm."""


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
        """(3,) scatter over stated noise, dimensionless."""
        return self.sigma / self.stated

    @property
    def uncertainty(self) -> float:
        """Relative standard uncertainty of sigma."""
        return float(1.0 / np.sqrt(2.0 * self.freedom))


@dataclass(frozen=True, repr=False, eq=False)
class Repeats(Result):
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

    FIELDS = ("same_session", "same_approach", "across_sessions", "flags")
    ROWS = "table"

    @property
    def table(self) -> list[dict[str, Any]]:
        """A row for each kind of repeats there is: its pooled standard deviations [m] and degrees of freedom."""
        kinds = {name: getattr(self, name) for name in ("same_session", "same_approach", "across_sessions")}
        return [
            {
                "repeats": name,
                "sigma": scatter.sigma,
                "stated": scatter.stated,
                "freedom": scatter.freedom,
                "groups": scatter.groups,
            }
            for name, scatter in kinds.items()
            if scatter is not None
        ]


@checked_kinds
def repeats(measurements: Measurements, tolerance: float = REPEATED) -> Repeats | None:
    """Return the noise that repeated readings show, or None where nothing was repeated.

    Args:
        measurements: The campaign; rows share a pose when their joint positions do, whatever its name.
        tolerance: How near joint positions must be [rad or m].
    """
    rows = np.flatnonzero(measurements.positioned)
    if not len(rows):
        return None
    place = same_positions(measurements.q, tolerance).tolist()
    held = numbered(zip(place, measurements.load_number.tolist(), strict=True))
    once = numbered(zip(held.tolist(), measurements.session, strict=True))
    sides = (tuple(row) for row in measurements.approach.tolist())
    position, sigma = measurements.position, measurements.sigma
    same_session = _scatter(position, once, rows, sigma)
    if same_session is None:
        return None
    same_approach = _scatter(position, numbered(zip(once.tolist(), sides, strict=True)), rows, sigma)
    kept = np.setdiff1d(rows, same_session.lost)
    labels, first, back = np.unique(once[kept], return_index=True, return_inverse=True)
    means = np.array([position[kept[back == i]].mean(axis=0) for i in range(len(labels))])
    stated = np.broadcast_to(_stated(sigma[kept]), means.shape)
    across = _scatter(means, held[kept[first]], np.arange(len(labels)), stated)
    if across is not None:
        again = kept[np.isin(back, across.lost)]
        across = replace(across, stated=_stated(sigma[kept]), lost=tuple(again.tolist()))
    # The stated noise is wrong where it is by more than the repeats' own uncertainty leaves open.
    flags, ratio = (), float(np.sqrt((same_session.ratio**2).mean()))
    # Ratio of scatter to stated noise that is flagged, when the repeats are enough to determine it.
    room = 1.5 * (1.0 + 3.0 * same_session.uncertainty / np.sqrt(3.0))
    if not 1.0 / room < ratio < room:
        size, said = (1e3 * np.sqrt((values**2).mean()) for values in (same_session.sigma, same_session.stated))
        text = f"repeats scatter by {size:.2g} mm per axis, {ratio:.2g} times the {said:.2g} mm stated as sigma"
        flags = (Flag("stated_noise", text),)
    return Repeats(same_session, same_approach, across, flags)


def _scatter(position: Array, labels: np.ndarray, rows: np.ndarray, sigma: Array) -> Scatter | None:
    """Return the pooled scatter of (N, 3) positions that share a label, None where none do but for lost ones."""
    order = rows[np.argsort(labels[rows], kind="stable")]
    sets = [alike for alike in np.split(order, np.flatnonzero(np.diff(labels[order])) + 1) if len(alike) > 1]
    if not sets:
        return None
    lost = _lost(position, sets, _stated(sigma[np.concatenate(sets)]))
    kept = [alike for alike in (np.setdiff1d(alike, lost) for alike in sets) if len(alike) > 1]
    if not kept:
        return None
    squares = sum(((position[alike] - position[alike].mean(axis=0)) ** 2).sum(axis=0) for alike in kept)
    freedom = sum(len(alike) - 1 for alike in kept)
    stated = _stated(sigma[np.concatenate(kept)])
    return Scatter(np.sqrt(squares / freedom), freedom, len(kept), stated, tuple(lost.tolist()))


def _lost(position: Array, sets: list[np.ndarray], stated: Array) -> np.ndarray:
    """Return rows further from their set's median than noise goes; of two that disagree either may be the lost one.

    The scale is the median of the differences of readings of one pose, robust but poor when they are few: then the
    limit is wider, and never below what the stated noise allows. Readings rounded so coarsely that most repeats are
    equal have no scale: nothing is left out.
    """
    steps = np.concatenate([np.diff(position[rows], axis=0) for rows in sets])
    scale = np.median(np.abs(steps), axis=0) / (0.6745 * np.sqrt(2.0))
    # Robust standard deviations from its fellows beyond which a reading is a lost beam.
    limit = np.where(scale > 0.0, 6.0 * (1.0 + 5.0 / len(steps)) * np.maximum(scale, stated), np.inf)
    far = []
    for rows in sets:
        away = np.abs(position[rows] - np.median(position[rows], axis=0))
        # Half of their difference parts each of two rows from their median, with a deviation of sigma / sqrt 2.
        bound = limit / np.sqrt(2.0) if len(rows) == 2 else limit
        far += rows[(away > bound).any(axis=1)].tolist()
    return np.array(sorted(far), dtype=int)


def _stated(sigma: Array) -> Array:
    return np.sqrt((sigma**2).mean(axis=0))
