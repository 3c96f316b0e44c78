"""Paths that leave little swing: the same path, timed otherwise, by input shaping along it.

The way along the path, s(t), is convolved with impulses whose sizes add up to one: s'(t) = sum of A_i s(t - t_i). The
path through joint space stays what it is, via-points included, and no joint goes faster than it did. Half a period of a
mode after an impulse another of the right size cancels what the first one left. For each mode that swings, at the
damping ratio z and the damped period T, with K = exp(-pi z / sqrt(1 - z^2)) and V = 5 %:

    ZV    (1, K)                               Singer and Seering, J. Dyn. Syst. Meas. Control 112, 1990
    ZVD   (1, 2 K, K^2)                        the same: also the derivative by the frequency is zero
    EI    (1 + V, 2 (1 - V) K, (1 + V) K^2)    Singhose, Seering and Singer, J. Mech. Des. 116, 1994

at 0, T/2 (and T), over their sum. Shapers of several modes are convolved with each other. Where that takes longer than
is allowed the way between is driven faster, as far as the joints' speed limits permit. Of all shapers that fit, the one
is taken that leaves least if the frequencies are up to a tenth lower or higher than the model's.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from itertools import pairwise, product

import numpy as np

from armflex.arguments import checked_kinds
from armflex.arm import Arm
from armflex.conventions import Array, number
from armflex.errors import Flag, InputError, naming
from armflex.measured.table import Tabular
from armflex.mechanics.modes import Modes
from armflex.result import Result
from armflex.tasks.settle import FURTHER, envelope, modes_at, on_the_way, stops
from armflex.trajectory import Trajectory, as_trajectory

KINDS = {"ZV": (1.0, 1.0), "ZVD": (1.0, 2.0, 1.0), "EI": (1.05, 1.9, 1.05)}
"""Sizes of the impulses without damping, in any unit."""

SLOWER = 1.3
"""How many times as long a motion may take unless asked otherwise."""

WRONG = (0.9, 1.0, 1.1)
"""Prior: a model's frequencies are right to a tenth, as with stiffness or payload a tenth off."""

LEAST = 1e-6
"""Tolerance: rows nearer to each other [s] are one."""

ENOUGH = 0.05
"""Share of the swing before: of the shapers that leave less, the shortest is taken."""


@dataclass(frozen=True)
class CalmMotion:
    """One motion of a path, from rest to rest.

    Attributes:
        via: Name of the via-point that it ends at, or ''.
        shaper: Kind and frequency [Hz] for each mode, as 'ZVD 1.04 Hz'; '' where the motion is left as it is.
        times, sizes: (k,) impulses [s], dimensionless, in order.
        duration_s: Before and after [s].
        speedup: How many times as fast the way between is driven.
        swing_m: Largest swing of the tip after it, all modes together: before, after, and after if the frequencies are
            a tenth off [m].
    """

    via: str
    shaper: str
    times: Array
    sizes: Array
    duration_s: tuple[float, float]
    speedup: float
    swing_m: tuple[float, float, float]


@dataclass(frozen=True, repr=False)
class Calmed(Result):
    """A path that leaves little swing.

    Attributes:
        trajectory: The path, timed otherwise.
        motions: From rest to rest, in order.
        flags: Motions that no shaper calms to `ENOUGH`, that go beyond a speed limit, or end with another payload;
            where the damping comes from.
    """

    FIELDS = ("motions", "flags")
    ROWS = "motions"

    trajectory: Trajectory
    motions: tuple[CalmMotion, ...]
    flags: tuple[Flag, ...]


@checked_kinds
def calm(
    arm: Arm, trajectory: Trajectory | Tabular, slower: float = SLOWER, covariates: Mapping[str, float] | None = None
) -> Calmed:
    """Return the same path, timed so that the tip swings little where it stops.

    The drives stop at rows that are followed by one with the same joint positions, and at the end; at corners of the
    path through joint space, too, where less would not do. Each motion between stops takes at most `slower` times as
    long; a stop lasts as long as before.

    Args:
        arm: The arm; its `damping_ratio` is that of every mode.
        trajectory: Rows with their times; between rows the joints go along a line.
        slower: How many times as long a motion may take, at least 1.
        covariates: What the arm's effects depend on and no column gives.

    Raises:
        InputError: `slower` is below 1, the path states speeds, a row cannot be used, or what moves has no mass.
    """
    if not slower >= 1.0:
        raise InputError(f"slower must be at least 1, got {slower}")
    given = as_trajectory(trajectory, arm).for_arm(arm)
    path = given.with_constants(
        arm, {name: value for name, value in (covariates or {}).items() if name not in given.covariates}
    )
    if path.v is not None or path.a is not None:
        raise InputError("the path states v_ or a_ columns, which another timing makes wrong: leave them out")
    motions, flags, shift, rows = [], dict[str, Flag](), 0.0, [_MotionRows(path.time[:1], np.zeros(1), path.via[:1])]
    moves = (np.diff(path.q, axis=0) != 0.0).any(axis=1)  # stretches: all the time the drives move, or stand
    ends = [0, *(np.flatnonzero(moves[1:] != moves[:-1]) + 1).tolist(), len(path) - 1]
    for first, last in pairwise(ends):
        motion_rows = [
            _MotionRows(path.time[first : last + 1], np.arange(first, last + 1.0), path.via[first : last + 1])
        ]
        if (path.q[first + 1 : last + 1] != path.q[first]).any():
            motion_rows, made, met = _calmed(arm, path, motion_rows[0], slower)
            motions += made
            flags |= {flag.text: flag for flag in met}
        for piece in motion_rows:
            rows.append(piece.later(shift, 1))
            before = path.time[int(piece.place[-1])] - path.time[int(piece.place[0])]
            shift += float(piece.time[-1] - piece.time[0] - before)
    time, place = (np.concatenate([getattr(piece, name) for piece in rows]) for name in ("time", "place"))
    whole = _MotionRows(time, place, tuple(name for piece in rows for name in piece.via))
    return Calmed(_as_path(given, whole), tuple(motions), tuple(flags.values()))


def impulses(kind: str, frequency: float, damping: float) -> tuple[Array, Array]:
    """Return the (k,) times [s] and sizes of a shaper's impulses, see the head of this module.

    Args:
        kind: Of `KINDS`.
        frequency: Natural frequency of the mode [Hz].
        damping: Its damping ratio, below 1.
    """
    root = np.sqrt(1.0 - damping**2)
    sizes = np.array(KINDS[kind]) * np.exp(-np.pi * damping / root) ** np.arange(len(KINDS[kind]))
    return np.arange(len(sizes)) * 0.5 / (frequency * root), sizes / sizes.sum()


@dataclass(frozen=True)
class _Law:
    """How far along its way a motion is: a law of time, shaped.

    Attributes:
        base: (N,) times of the motion's rows [s], from 0 on, before they are shaped.
        way: (N,) how far along each is.
        times, sizes: (k,) impulses.
    """

    base: Array
    way: Array
    times: Array
    sizes: Array

    @cached_property
    def changes(self) -> tuple[Array, Array]:
        """(M,) times at which the speed along the way changes [s], and how far along the motion is then."""
        at = np.unique(np.add.outer(self.base, self.times))
        parts = zip(self.times, self.sizes, strict=True)
        return at, np.minimum(
            sum(size * np.interp(at - time, self.base, self.way) for time, size in parts), self.way[-1]
        )

    def reached(self, places: Array) -> Array:
        """Return the times at which places along the way are reached [s]."""
        at, there = self.changes
        there, first = np.unique(there, return_index=True)
        return np.interp(places, there, at[first])


def _calmed(
    arm: Arm, path: Trajectory, whole: _MotionRows, slower: float
) -> tuple[list[_MotionRows], list[CalmMotion], list[Flag]]:
    """Return a motion from rest to rest with the timing that leaves least, what it leaves, and flags.

    What a corner leaves no timing along the way cancels: where that is too much the drives stop there, too.
    """
    rows, motion, modes = _shaped(arm, path, whole, slower)
    way = np.diff(path.q[whole.place.astype(int)], axis=0)
    way /= np.linalg.norm(way, axis=1)[:, None]
    # Cosine of the turn between two stretches of the way below which a row is a corner.
    corners = np.flatnonzero((way[1:] * way[:-1]).sum(axis=1) < 0.95) + 1
    if motion.swing_m[2] > ENOUGH * motion.swing_m[0] and len(corners):
        parts = [whole.some(slice(a, b + 1)) for a, b in pairwise([0, *corners.tolist(), len(whole.time) - 1])]
        shaped = [_shaped(arm, path, part, slower) for part in parts]
        if sum(shaped_motion.swing_m[2] for _, shaped_motion, _ in shaped) < motion.swing_m[2]:
            flags = [flag for _, shaped_motion, modes in shaped for flag in (*modes.flags, *_left(shaped_motion))]
            rows, made = [part for part, _, _ in shaped], [part for _, part, _ in shaped]
            return rows, made, [*flags, *_beyond(arm, path, whole, rows)]
    return [rows], [motion], [*modes.flags, *_left(motion), *_beyond(arm, path, whole, [rows])]


def _shaped(arm: Arm, path: Trajectory, given: _MotionRows, slower: float) -> tuple[_MotionRows, CalmMotion, Modes]:
    """Return a motion from rest to rest with the timing that leaves least, what it leaves, and the modes at its end."""
    q = path.q[given.place.astype(int)]
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(q, axis=0), axis=1))])
    count = 1 + int(np.ceil(way[-1] / FURTHER))
    spread = np.interp(np.linspace(0.0, way[-1], count), way, given.place)
    nodes = _as_path(path, _MotionRows(np.interp(spread, given.place, given.time), spread, ("",) * count)).prepared(arm)
    if len(nodes) > 1 and nodes.payload[-1] != nodes.payload[-2]:  # of what is picked up there, see `_calmed`
        nodes = replace(nodes, payload=(*nodes.payload[:-1], nodes.payload[-2]))
    asked = cache(partial(modes_at, arm, nodes))
    base, last = given.time - given.time[0], count - 1

    def swing(law: _Law, factor: float = 1.0) -> float:
        """Return the largest shift of the tip [m], all modes together; frequencies are a factor of the model's."""
        rows = _on_rows(given, law)
        driven = _as_path(path, replace(rows, time=factor * rows.time))  # what swings faster has more time for as much
        driven = replace(driven, payload=(*driven.payload[:-1], nodes.payload[-1]))
        node = np.rint(np.interp(rows.place, given.place, way) / way[-1] * last).astype(int).tolist()
        only_last = [False] * (len(driven) - 1) + [True]
        ((_, modes, size, speed),) = stops(
            driven, only_last, lambda row, payload, loaded: asked(node[row], payload, node[loaded])
        )
        return float(envelope(modes, size, speed).sum())

    unshaped = _Law(base, way, np.zeros(1), np.ones(1))
    before, whole = swing(unshaped), float(base[-1])
    speeds = np.abs(np.diff(q, axis=0) / np.diff(base)[:, None]).max(axis=0)
    limits = np.array([joint.velocity for joint in arm.robot.moving])
    fastest = max(1.0, float((limits[speeds > 0.0] / speeds[speeds > 0.0]).min(initial=np.inf)))
    first, final = (asked(node, nodes.payload[node], node)[0] for node in (0, last))
    many = min(len(first.frequencies), len(final.frequencies), 3)  # slowest modes that may have a shaper of their own
    frequencies = np.sqrt(first.frequencies[:many] * final.frequencies[:many]).tolist()
    tried = _shapers(unshaped, frequencies, float(final.damping_ratios[0]), slower, fastest)
    best = (before, whole, 1.0, "", unshaped)
    for duration, speedup, name, law in sorted(tried, key=lambda trial: trial[0]):
        worst = 0.0
        for factor in WRONG:
            worst = max(worst, swing(law, factor)) if worst < best[0] else worst
        best = (worst, duration, speedup, name, law) if worst < best[0] else best
        if best[0] <= ENOUGH * before:
            break
    worst, duration, speedup, name, law = best
    shifts = (before, swing(law), worst)
    motion = CalmMotion(given.via[-1], name, law.times, law.sizes, (whole, duration), speedup, shifts)
    return _on_rows(given, law) if name else given, motion, final


def _shapers(
    unshaped: _Law, frequencies: Sequence[float], damping: float, slower: float, fastest: float
) -> Iterator[tuple[float, float, str, _Law]]:
    """Yield the laws that shapers of every kind make of each mode: duration, how much faster they are driven, a name.

    A motion takes up to `slower` times as long, and is driven up to `fastest` times as fast.
    """
    whole = float(unshaped.base[-1])
    for kinds in product(("", *KINDS), repeat=len(frequencies)):
        chosen = [(kind, frequency) for kind, frequency in zip(kinds, frequencies, strict=True) if kind]
        times, sizes = unshaped.times, unshaped.sizes
        for kind, frequency in chosen:
            more, others = impulses(kind, frequency, damping)
            times, sizes = np.add.outer(times, more).ravel(), np.multiply.outer(sizes, others).ravel()
        left, order = slower * whole - float(times.max()), np.argsort(times)
        if chosen and left > 0.0 and whole / left <= fastest:
            speedup = max(1.0, whole / left)
            name = ", ".join(f"{kind} {frequency:.3g} Hz" for kind, frequency in chosen)
            law = _Law(unshaped.base / speedup, unshaped.way, times[order], sizes[order])
            yield whole / speedup + float(times.max()), speedup, name, law


@dataclass(frozen=True)
class _MotionRows:
    """Rows of a new path by where they are on the old one.

    Attributes:
        time: (M,) [s].
        place: (M,) number of the old row, with the share of the way to the next behind the point.
        via: Names of via-points.
    """

    time: Array
    place: Array
    via: tuple[str, ...]

    def later(self, shift: float, first: int) -> _MotionRows:
        """Return the rows from a number on, some time later [s]."""
        return replace(self.some(slice(first, None)), time=self.time[first:] + shift)

    def some(self, rows: slice) -> _MotionRows:
        """Return some of the rows."""
        return _MotionRows(self.time[rows], self.place[rows], self.via[rows])


def _as_path(path: Trajectory, rows: _MotionRows) -> Trajectory:
    """Return rows as a path of their own."""
    return path if len(path) == 1 else on_the_way(path, rows.time, rows.place, rows.via)


def _on_rows(given: _MotionRows, law: _Law) -> _MotionRows:
    """Return a motion with a row wherever its speed changes, and one for each of its own rows."""
    times, there = law.changes
    every, places = np.concatenate([law.reached(law.way), times]), np.concatenate([law.way, there])
    names, kept = [*given.via, *[""] * len(times)], [0]
    for i in np.argsort(every, kind="stable")[1:].tolist():
        if every[i] - every[kept[-1]] > LEAST:
            kept.append(i)
        elif names[i]:
            kept[-1] = i
    place = np.interp(places[kept], law.way, given.place)
    return _MotionRows(given.time[0] + every[kept], place, tuple(names[i] for i in kept))


def _left(motion: CalmMotion) -> tuple[Flag, ...]:
    """Return the flag about a motion that is left as it is, or swings after it more than a shaper should leave."""
    where, (before, _, worst) = f"the motion to {motion.via}" if motion.via else "a motion", motion.swing_m
    if motion.shaper and worst <= ENOUGH * before:
        return ()
    if motion.shaper:
        text = f"{where} leaves {worst / before:.0%} of its swing where all frequencies are a tenth off"
        return (Flag("partly_calmed", f"{text}: no shaper within the time and the joints' speed limits leaves less"),)
    text = f"{where} stays as it is: no shaper within the time and the joints' speed limits leaves less swing"
    return (Flag("not_calmed", text),)


def _beyond(arm: Arm, path: Trajectory, given: _MotionRows, rows: list[_MotionRows]) -> Iterator[Flag]:
    """Yield flags about a motion: beyond a speed limit as before, and a load that swings however it is timed."""
    shares = np.vstack([_as_path(path, piece).speed_shares(arm) for piece in rows]).max(axis=0)
    name, fast = f"the motion to {given.via[-1]}" if given.via[-1] else "a motion", int(np.argmax(shares))
    if shares[fast] > 1.0 + LEAST:
        text = f"{name} drives {arm.joint_names[fast]} at {shares[fast]:.3g} times its speed limit, as the path has it"
        yield Flag("speed_limit", text)
    row = int(given.place[-1])
    carried, taken = path.payload[max(row - 1, 0)], path.payload[row]
    if carried != taken:
        with naming(path.where(row)):
            asked = path.prepared(arm).asked(row)
            tips = [arm.deflection(path.q[row], payload, **asked).displacement[:3] for payload in (carried, taken)]
        text = f"{name} ends with payload {taken} instead of {carried}: the tip springs by"
        size = float(np.linalg.norm(tips[1] - tips[0]))
        yield Flag("springs", f"{text} {number(1e3 * size, 3)} mm there, however the motion is timed")
