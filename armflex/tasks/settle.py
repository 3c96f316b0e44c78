"""How long a tip swings after each via-point, for the motion as it is planned.

Drives move as the rows say, straight from row to row, so their speeds jump at rows. Loads from outside change evenly
from row to row, and the place of rest with them; a payload changes at a row. The arm is taken as linear about
the poses that it passes: it is where it would rest, plus modes that swing about that. A jump of the speeds changes the
speed of each mode. From row to row each mode decays by itself. At another pose the motion of the flexures is split into
the modes that it has there (modal superposition: Clough and Penzien, Dynamics of Structures, 2nd ed. 1993, ch. 12).
Loads that follow from the speed itself (centrifugal, Coriolis) are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from armflex.arguments import checked_kinds
from armflex.arm import Arm
from armflex.conventions import Array
from armflex.errors import Flag, InputError, naming, worst_of
from armflex.measured.table import Tabular
from armflex.mechanics.modes import Modes, modes_of
from armflex.result import Result
from armflex.rows.wrench import wrenches_in
from armflex.trajectory import Trajectory, as_trajectory

FURTHER = 0.02
"""Tolerance: way of any joint [rad or m] after which the modes are computed anew; motions are cut into such ways."""


SAMPLES = 1024
"""Of a decay that are looked at together."""


@dataclass(frozen=True)
class Settling:
    """The swing after one via-point, if the drives stop there.

    Attributes:
        name: The via-point's.
        time: When it is reached [s].
        settle_s: Time from then on until the tip stays within the tolerance of where it comes to rest [s].
        peak_m: Largest distance of the tip from there [m].
        frequency_hz: Of the slowest mode that is excited [Hz], None where none is.
        flexure: The one that this mode bends most, by energy; None where none is.
    """

    name: str
    time: float
    settle_s: float
    peak_m: float
    frequency_hz: float | None
    flexure: str | None


@dataclass(frozen=True, repr=False)
class SettlingReport(Result):
    """How long a tip swings after each via-point.

    Attributes:
        within_m: The tolerance [m].
        via_points: In order.
        flags: Flags met on the way.
    """

    FIELDS = ("within_m", "via_points", "flags")
    ROWS = "via_points"

    within_m: float
    via_points: tuple[Settling, ...]
    flags: tuple[Flag, ...]


@checked_kinds
def settle(
    arm: Arm, trajectory: Trajectory | Tabular, within: float, covariates: Mapping[str, float] | None = None
) -> SettlingReport:
    """Return how long the tip swings after each via-point; all rows and the last one, where none is named.

    Args:
        arm: The arm; its `damping_ratio` is that of every mode.
        trajectory: Rows with their times; between rows the joints go straight.
        within: Distance from rest up to which the tip counts as settled [m].
        covariates: What the arm's effects depend on and no column gives.

    Raises:
        InputError: `within` is not positive, a row cannot be used, or what moves has no mass.
    """
    if not within > 0.0:
        raise InputError(f"within must be positive, got {within} m")
    path, named = _finely(as_trajectory(trajectory, arm).with_constants(arm, covariates or {}).prepared(arm))
    met: dict[tuple[str, str], Flag] = {}
    settled = []
    for row, modes, size, speed in stops(path, named, partial(modes_at, arm, path)):
        settled.append(_settling(arm, path.via[row], float(path.time[row]), modes, size, speed, within))
        met = worst_of([*met.values(), *modes.flags])
    return SettlingReport(within, tuple(settled), tuple(met.values()))


@dataclass(frozen=True)
class ModesAt:
    """The slowest modes at one via-point.

    Attributes:
        name: The via-point's, or "row" with its number where the path names none.
        time: When it is reached [s].
        payload: What is carried there.
        frequencies: (m,) [Hz], ascending.
        stiffest: (m,) of each mode the flexure whose stiffness gains most frequency.
        flags: What is doubtful about them.
    """

    name: str
    time: float
    payload: str
    frequencies: Array
    stiffest: tuple[str, ...]
    flags: tuple[Flag, ...]


@checked_kinds
def modes_along(
    arm: Arm, trajectory: Trajectory | Tabular, covariates: Mapping[str, float] | None = None, count: int = 6
) -> tuple[ModesAt, ...]:
    """Return the modes at each via-point, at all rows where none is named, while the drives hold the arm there.

    Args:
        arm: The arm.
        trajectory: The path.
        covariates: What the arm's effects depend on and no column gives.
        count: Most modes of each.

    Raises:
        InputError: A row cannot be used, or what moves has no mass.
    """
    path = as_trajectory(trajectory, arm).with_constants(arm, covariates or {}).prepared(arm)
    rows = [i for i, name in enumerate(path.via) if name] or range(len(path))
    points = []
    for row in rows:
        modes, _ = modes_at(arm, path, row, path.payload[row], row)
        stiffest = tuple(modes.names.flexures[int(i)] for i in modes.sensitivities[:count].argmax(axis=1))
        name, time = path.via[row] or f"row {row}", float(path.time[row])
        points.append(ModesAt(name, time, path.payload[row], modes.frequencies[:count], stiffest, modes.flags))
    return tuple(points)


def stops(
    path: Trajectory, named: Sequence[bool], asked: Callable[[int, str, int], tuple[Modes, Array]]
) -> Iterator[tuple[int, Modes, Array, Array]]:
    """Yield rows with the modes there and their (m,) sizes and speeds [1, 1/s], if the drives stop there.

    Args:
        path: Rows with their times; between rows the joints go along a line.
        named: (N,) which rows are asked about.
        asked: (row, payload, row whose loads from outside act) -> the modes about a row, and the (6 n,) twists at rest;
            see `modes_at`.
    """
    pushed_by = [wrench for wrench in path.wrenches if wrench.rows is not None]
    pushed_by = np.hstack(
        [np.zeros((len(path), 0)), *(np.hstack([wrench.force, wrench.moment]) for wrench in pushed_by)]
    )
    pushing = (np.diff(pushed_by, axis=0) != 0.0).any(axis=1)  # loads change on the way to the next row
    steps = np.diff(path.time)[:, None]
    speeds = np.vstack([np.zeros(path.q.shape[1]), np.diff(path.q, axis=0) / steps, np.zeros(path.q.shape[1])])
    modes, at = None, -1
    bent, moving = np.zeros(0), np.zeros(0)  # of the flexures, from where they would rest [m, rad], and their speed
    drift = np.zeros(0)  # speed of the rest by the loads from outside [m/s, rad/s]
    for row in range(len(path)):
        if row:
            assert modes is not None
            bent, moving = _decayed(modes, bent, moving, float(path.time[row] - path.time[row - 1]))
        same = row and path.payload[row] == path.payload[at]
        if modes is None or not same or np.abs(path.q[row] - path.q[at]).max() > FURTHER or named[row]:
            after, twists = asked(row, path.payload[row], row)
            if row and not same:  # what is picked up or put down leaves the arm where the other load had it
                bent = bent + asked(row, path.payload[row - 1], row)[1] - twists
            modes, at = after, row
        assert modes.drives is not None and modes.momenta is not None
        if not len(bent):
            bent = moving = drift = np.zeros(modes.momenta.shape[1])
        moving = moving + drift
        if named[row]:
            yield row, modes, modes.momenta @ bent, modes.drives @ -speeds[row] + modes.momenta @ moving
        drift = np.zeros(len(drift))
        if row < len(pushing) and pushing[row]:
            there = (asked(row, path.payload[row], loaded)[1] for loaded in (row, row + 1))
            drift = -np.subtract(*there) / float(steps[row, 0])
        moving = moving - drift
        pushed = modes.drives @ (speeds[row + 1] - speeds[row])
        moving = moving + pushed @ modes.twists.reshape(len(pushed), -1)


def _finely(path: Trajectory) -> tuple[Trajectory, list[bool]]:
    """Return a path with rows as far apart as modes hold, and which rows are via-points; the last, where none is."""
    asked = [bool(name) for name in path.via] if any(path.via) else [False] * (len(path) - 1) + [True]
    parts = np.maximum(np.ceil(np.abs(np.diff(path.q, axis=0)).max(axis=1) / FURTHER), 1.0).astype(int)
    if not len(parts) or parts.max() == 1:
        return path, asked
    rows_at = np.concatenate([[0], np.cumsum(parts)])  # where the rows stand
    place = np.interp(np.arange(rows_at[-1] + 1), rows_at, np.arange(len(path)))
    via, named = [""] * len(place), [False] * len(place)
    for row, here in enumerate(rows_at.tolist()):
        via[here], named[here] = path.via[row], asked[row]
    return on_the_way(path, np.interp(place, np.arange(len(path)), path.time), place, tuple(via)), named


def on_the_way(path: Trajectory, time: Array, place: Array, via: tuple[str, ...]) -> Trajectory:
    """Return rows of a path at other times as a path of their own.

    Args:
        path: Two rows or more.
        time: (M,) of the new rows [s].
        place: (M,) number of the old row each is at, with the share of the way to the next behind the point.
        via: Names of via-points.
    """
    segments = np.clip(place.astype(int), 0, len(path) - 2)
    points = path.between(segments, place - segments)
    payload = tuple(path.payload[int(here)] for here in place)  # at its end a stretch is at the next row
    loads = {"covariates": points.covariates, "wrenches": points.wrenches, "target": points.target}
    loads["tolerance"] = points.tolerance
    places = tuple(path.places[int(here)] for here in place) if path.places else ()
    return Trajectory(path.joint_names, time, points.q, payload, via, places=places, **loads)


def modes_at(arm: Arm, path: Trajectory, row: int, payload: str, loaded: int) -> tuple[Modes, Array]:
    """Return the modes about a row with a payload and another row's loads, and the (6 n,) twists at rest [m, rad]."""
    columns = {"time": path.time[row], **{name: values[row] for name, values in path.covariates.items()}}
    with naming(path.where(row)):
        pushed = wrenches_in(path.wrenches, loaded)
        rest = arm.deflection(path.q[row], payload, covariates=columns, wrenches=pushed)
        # Slowest modes that are followed; faster ones are hardly excited and decay sooner.
        return modes_of(rest.solved, 8, arm.damping_ratio, driven=True), rest.twists.ravel()


def _decayed(modes: Modes, bent: Array, moving: Array, time: float) -> tuple[Array, Array]:
    """Return what (6 n,) deviations of the flexures and their speeds are after a time [s] of free decay."""
    assert modes.momenta is not None
    shapes = modes.twists.reshape(len(modes.frequencies), -1)
    now = _swung(modes, modes.momenta @ bent, modes.momenta @ moving, np.array([time]))
    return now[0][0] @ shapes, now[1][0] @ shapes


def _swung(modes: Modes, size: Array, speed: Array, times: Array) -> tuple[Array, Array]:
    """Return the (T, m) sizes of modes and their speeds at (T,) times after they had some [1, 1/s]."""
    natural = 2.0 * np.pi * modes.frequencies
    rate, turned = natural * modes.damping_ratios, natural * np.sqrt(1.0 - modes.damping_ratios**2)
    first, second = size, (speed + rate * size) / turned
    fading, phase = np.exp(-np.outer(times, rate)), np.outer(times, turned)
    cosine, sine = np.cos(phase), np.sin(phase)
    sizes = fading * (first * cosine + second * sine)
    return sizes, fading * turned * (second * cosine - first * sine) - rate * sizes


def _settling(arm: Arm, name: str, time: float, modes: Modes, size: Array, speed: Array, within: float) -> Settling:
    """Return the swing of a tip whose modes have (m,) sizes and speeds when the drives stop."""
    reach = envelope(modes, size, speed)
    excited = reach > 0.1 * within  # share of the tolerance from which on a mode counts as excited
    last, peak = _swing(arm, modes, size, speed, within)
    if not excited.any():
        return Settling(name, time, 0.0, peak, None, None)
    slowest = int(np.flatnonzero(excited)[0])
    flexure = arm.flexure_names[int(modes.sensitivities[slowest].argmax())]
    return Settling(name, time, last, peak, float(modes.frequencies[slowest]), flexure)


def envelope(modes: Modes, size: Array, speed: Array) -> Array:
    """Return the (m,) largest shift of the tip [m] by each mode, from its size and its speed [1, 1/s]."""
    natural, shifts = 2.0 * np.pi * modes.frequencies, np.linalg.norm(modes.shapes[:, :3], axis=1)
    return shifts * np.hypot(size, (speed + natural * modes.damping_ratios * size) / natural)


def _swing(arm: Arm, modes: Modes, size: Array, speed: Array, within: float) -> tuple[float, float]:
    """Return the time after which the tip stays within a distance [s], and the largest distance [m] that it has.

    It is followed until all envelopes together are within that distance and within the largest that was met: modes of
    nearly one frequency are farthest off together long after the drives stop.
    """
    reach, rates = envelope(modes, size, speed), 2.0 * np.pi * modes.frequencies * modes.damping_ratios
    moving = reach > 1e-6 * reach.sum()  # share of all modes' envelopes below which a mode does not move the tip
    if not moving.any():
        return 0.0, 0.0
    # Samples in a period of the fastest mode that is followed
    step, period = 1.0 / (24 * float(modes.frequencies[moving][-1])), 1.0 / float(modes.frequencies[0])
    last, peak, begun = 0.0, 0.0, 0
    while begun * step < period or reach @ np.exp(-rates * begun * step) > min(within, peak):
        if begun > 200_000:  # of a decay: what would take more is of a damping that no arm has
            longer = "a wider tolerance" if arm.damping_ratio else "[robot] damping_ratio, or a wider tolerance"
            text = f"the swing lasts longer than {begun * step:.3g} s with a damping ratio of"
            raise InputError(f"{text} {float(modes.damping_ratios[0]):.3g}: state {longer}")
        times = step * np.arange(begun, begun + SAMPLES, dtype=float)
        away = np.linalg.norm(_swung(modes, size, speed, times)[0] @ modes.shapes[:, :3], axis=1)
        outside = np.flatnonzero(away > within)
        last = float(times[outside[-1]]) + step if len(outside) else last
        peak, begun = max(peak, float(away.max())), begun + SAMPLES
    return last, peak
