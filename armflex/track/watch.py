"""Has a law changed, which one, and how sure is that? Asked over the last readings, of which one alone proves nothing.

A cumulated sum of the innovations' squares (Page 1954) says when to look. Then every law is a hypothesis: that its
parameters jumped, by an amount of the size that is expected of it, just before the sum began to rise. Its evidence is
the density of the readings since an earlier estimate (Willsky and Jones 1976, with the jump integrated out). In every
hypothesis, also that nothing changed, a reading that all others contradict counts as lost.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from armflex.conventions import Array
from armflex.estimate.robust import outlier_limit
from armflex.parameters import ArmParameter, ParameterKind
from armflex.readings import Position
from armflex.result import Result
from armflex.track.estimate import Estimate, LinearisedReading, recentred
from armflex.track.reading import Reading
from armflex.track.state_space import Changeable

WINDOW = 8
"""An earlier estimate is kept from 8 to 16 readings back."""

SLACK, GATE = 1.5, 16.0
"""What the sum leaves out of each squared innovation beside its expectation, and where it says to look: further than
one reading can raise it."""

LOST = 8.0
"""What a lost reading costs: -log density of one so far off that one in a thousand is."""

RARE = 1e-4
"""How often a law is expected to change: once in ten thousand readings."""

SURE, CLEAR = 0.99, 0.95
"""Probability that something changed, and that it was this law, from which on a change is announced."""

FEWEST, MOST = 3, 10
"""Readings after a change before it can be announced, and after which it is whether or not one law stands out."""

LONGEST = 48
"""Readings after which nothing is unsettled."""


@dataclass(frozen=True, repr=False, eq=False)
class Change(Result):
    """A law that changed.

    Attributes:
        parameters: (k,) what changed: all of one group.
        probability: That it was this one, among all laws and no change at all.
        reading: Number of the reading after which it was announced, the first being 1.
        since: Number of the first reading after the change, as far as is known.
        size: (k,) by how much [m, rad], against what was known of the arm before: joint offsets, geometry, tool and
            instrument in m and rad, learned laws in parts of what was declared; of compliances the logarithm of the
            factor that they became larger by (0.18 is 20 %).
        std: (k,) one standard deviation of each [m, rad].
        others: What else it may have been, with probabilities above one in a hundred.
    """

    parameters: tuple[ArmParameter, ...]
    probability: float
    reading: int
    since: int
    size: Array
    std: Array
    others: tuple[tuple[str, float], ...] = ()

    FIELDS = ("name", "probability", "reading", "since", "labels", "size", "std", "others")
    ROWS = "table"

    @property
    def table(self) -> dict[str, Any]:
        """What changed, by column."""
        return {"label": self.labels, "size": self.size, "std": self.std}

    @property
    def name(self) -> str:
        """The law, as `Tracker.groups` names it: 'compliance A4', 'joint_offset A2', 'instrument', ..."""
        return self.parameters[0].group.name

    @property
    def labels(self) -> tuple[str, ...]:
        """What changed, as `Tracker.labels` names it."""
        return tuple(parameter.label for parameter in self.parameters)

    def __repr__(self) -> str:
        """One line: what changed, how sure that is, and by how much; compliances in percent."""
        parts = []
        for parameter, size, std in zip(self.parameters, self.size, self.std, strict=True):
            unit = ""
            if parameter.group.kind is ParameterKind.COMPLIANCE:
                size, std, unit = 100.0 * np.expm1(size), 100.0 * np.exp(size) * std, " %"
            parts.append(f"{parameter.name or ''} {size:+.3g} ± {std:.2g}{unit}".strip())
        return f"<Change: {self.name} since reading {self.since}, {self.probability:.3%} sure: {', '.join(parts)}>"


@dataclass(frozen=True, eq=False)
class Anchor:
    """An earlier estimate: how many readings it knows, and the clock up to which drift is in it."""

    estimate: Estimate
    count: int
    drifted: float


@dataclass(frozen=True, eq=False)
class DetectedChange:
    """The most probable hypothesis: what changed, the place in the window where it begins, and what it says."""

    what: Changeable
    start: int
    probability: float
    size: Array
    std: Array
    others: tuple[tuple[str, float], ...]
    lost: list[bool]


@dataclass
class Watch:
    """The last readings, an estimate from before them, and how surprising they were.

    Attributes:
        first: From before all readings of the window.
        later: From before its ninth, which will take the first one's place.
        window: Readings since the first anchor, 16 at most, 48 while unsettled.
        weights: What each of them counted.
        total: Cumulated sum of squared innovations beyond what is expected.
        rising: Place in the window from which on it has not been zero.
        unsettled: Readings in a row that have yet to be predicted before a change is accepted. Until then what was
            expected was so wide that a gross reading may have counted as true: those of the window are judged
            again, each by all others, after every reading.
        part: Part of their residuals by which they are judged then; see `contradicted`.
        readings: Those of the window while unsettled, to be looked at anew where the arm is linearised elsewhere.
    """

    first: Anchor
    later: Anchor
    window: list[LinearisedReading] = field(default_factory=list)
    weights: list[float] = field(default_factory=list)
    total: float = 0.0
    rising: int = 0
    unsettled: int = FEWEST
    part: float = 1.0
    readings: list[Reading] = field(default_factory=list)

    def restart(self, anchor: Anchor) -> None:
        """Forget all readings; from here on it is another matter."""
        self.first = self.later = anchor
        self.window, self.weights, self.total, self.rising, self.unsettled = [], [], 0.0, 0, FEWEST
        self.part, self.readings = 1.0, []

    def turn(self, now: Anchor) -> None:
        """Before every eighth reading: let the later anchor be the first and those before it go; `now` is the later."""
        if len(self.window) > 2 * WINDOW:
            self.restart(now)
            self.unsettled = 0
        elif len(self.window) == 2 * WINDOW:
            self.first, self.window, self.weights = self.later, self.window[WINDOW:], self.weights[WINDOW:]
            self.rising = max(0, self.rising - WINDOW)
        self.later = now

    @property
    def turning(self) -> bool:
        """Whether `turn` is due."""
        size = len(self.window)
        return size == WINDOW or size >= (LONGEST if self.unsettled else 2 * WINDOW)

    def add(self, seen: LinearisedReading, weight: float, distance: float) -> bool:
        """Take in a reading and its distance from what was expected; return whether to look for a change."""
        if self.total == 0.0:
            self.rising = len(self.window)
        self.window.append(seen)
        self.weights.append(weight)
        self.readings = []
        size = len(seen.residual)
        self.total = max(0.0, self.total + min(distance, outlier_limit(size)) ** 2 - size - SLACK)
        return self.total > GATE and len(self.window) - self.rising >= FEWEST

    def add_unsettled(self, reading: Reading, seen: LinearisedReading, weight: float, expected_variance: float) -> None:
        """Take in a reading, and how wide it was expected; see `estimate.posterior`."""
        self.window.append(seen)
        self.weights.append(weight)
        self.readings.append(reading)
        # Variance of what is expected of a reading, by that of its noise, below which it counts as predicted.
        self.unsettled = self.unsettled - 1 if expected_variance < 1.0 and self.part == 1.0 else FEWEST

    def recentre(self, step: Array, factor: Array) -> None:
        """Take in that the arm is linearised elsewhere; see `recentred`."""
        self.window = [
            LinearisedReading(seen.residual - seen.jacobian @ step, seen.jacobian * factor) for seen in self.window
        ]
        self.first = replace(self.first, estimate=recentred(self.first.estimate, step, factor))
        self.later = replace(self.later, estimate=recentred(self.later.estimate, step, factor))


def seek(watch: Watch, before: Estimate, changeables: Sequence[Changeable]) -> DetectedChange | None:
    """Return the change that the window shows, None where it shows none or not yet which.

    Args:
        watch: The window.
        before: The estimate before its first reading, what has drifted since included.
        changeables: What may have changed.
    """
    task = _task(watch.window, before)
    plain = task.explained(task.inverse)
    # A change may begin where the sum rises, and where readings begin to be lost to the end.
    last, kept = len(plain.lost) - FEWEST, np.flatnonzero(~plain.lost)
    run = int(kept[-1]) + 1 if len(kept) else 0
    weights: dict[str | None, float] = {None: -plain.cost}
    best: dict[str, tuple[Changeable, _Explained, int]] = {}
    for start in sorted({min(watch.rising, last), min(run, last)}):
        for what in task.promising(changeables, start):
            jump = task.jump(what, start)
            through = task.inverse @ jump
            inner = np.eye(len(what.places)) + jump.T @ through
            inverse = task.inverse - through @ np.linalg.solve(inner, through.T)
            explained = task.explained(inverse, float(np.linalg.slogdet(inner)[1]))
            weight, name = np.log(RARE) - explained.cost, what.group.name
            if weight > weights.get(name, -np.inf):
                weights[name], best[name] = weight, (what, explained, start)
    # It is announced where it is sure that there was one, and clear which.
    total = np.logaddexp.reduce(list(weights.values()))
    shares = {name: float(np.exp(weight - total)) for name, weight in weights.items()}
    name = max(best, key=lambda group: shares[group])
    what, explained, start = best[name]
    clear = shares[name] >= CLEAR or len(task.errors) - start >= MOST
    if shares[None] > 1.0 - SURE or not clear:
        return None
    through_root = task.jump(what, start).reshape(*task.errors.shape, -1) * ~explained.lost[:, None, None]
    through_root = through_root.reshape(-1, len(what.places))
    size = what.sizes * (through_root.T @ explained.pulls)
    left = np.eye(len(what.places)) - through_root.T @ explained.inverse @ through_root
    others = sorted(
        ((group, p) for group, p in shares.items() if group and group != name and p > 0.01), key=lambda x: -x[1]
    )
    std = what.sizes * np.sqrt(np.maximum(np.diag(left), 0.0))
    return DetectedChange(what, start, shares[name], size, std, tuple(others), explained.lost.tolist())


def contradicted(window: Sequence[LinearisedReading], before: Estimate) -> tuple[list[bool], float]:
    """Return which readings of a window the others and the estimate `before` them contradict, if nothing changed.

    Where that is most of them it is the arm that is linearised too far away, and not the readings that are wrong: they
    are judged as if they were noisier, until most agree. The second number is the part of their residuals that is left.
    """
    part = 1.0
    while True:
        task = _task([fainter(seen, part) for seen in window], before)
        lost = task.explained(task.inverse).lost
        # Part of its residual below which a reading counts for nothing.
        if lost.sum() <= max(1, len(lost) // 2) or part < 1e-5:
            return lost.tolist(), part
        part *= 0.5


def fainter(seen: LinearisedReading, part: float) -> LinearisedReading:
    """Return a reading by larger standard deviations."""
    return seen if part == 1.0 else LinearisedReading(part * seen.residual, part * seen.jacobian)


@dataclass(frozen=True, eq=False)
class _Explained:
    """How a hypothesis explains the window: its cost (-log density), V^-1 and V^-1 e of what is not lost, and that."""

    cost: float
    inverse: Array
    pulls: Array
    lost: np.ndarray


@dataclass(frozen=True, eq=False)
class _Task:
    """The window's positions in standard deviations: (n, 3, P) columns, (n, 3) errors and V^-1 (3 n, 3 n) without a
    change, with the logarithm of V's determinant."""

    jacobian: Array
    errors: Array
    inverse: Array
    log_volume: float

    def promising(self, changeables: Sequence[Changeable], start: int) -> list[Changeable]:
        """Return what says most if it jumped before the reading at `start`, as if no reading were lost."""
        through_root = self.jacobian.copy()
        through_root[:start] = 0.0
        through_root = through_root.reshape(len(self.inverse), -1)
        through = self.inverse @ through_root
        inner, pull = through_root.T @ through, through.T @ self.errors.ravel()
        gains = []  # logarithm of how much more probable a jump makes the errors
        for what in changeables:
            information, sizes = inner[np.ix_(what.places, what.places)], what.sizes
            factor = np.linalg.cholesky(np.eye(len(sizes)) + information * np.outer(sizes, sizes))
            along = np.linalg.solve(factor, sizes * pull[what.places])
            gains.append(float(0.5 * along @ along - np.log(np.diag(factor)).sum()))
        # Laws that are weighed with lost readings left out; the others explain the readings too badly.
        return [changeables[i] for i in np.argsort(gains)[:-9:-1]]

    def jump(self, what: Changeable, start: int) -> Array:
        """Return the (3 n, k) change of the errors per expected size of a jump before the reading at `start`."""
        through_root = self.jacobian[:, :, what.places] * what.sizes
        through_root[:start] = 0.0
        return through_root.reshape(-1, len(what.places))

    def explained(self, inverse: Array, more_volume: float = 0.0) -> _Explained:
        """Return the cost with V^-1 given, leaving out one reading after the other that all the rest contradict."""
        count, size = self.errors.shape
        lost, errors, inverse = np.zeros(count, dtype=bool), self.errors.ravel().copy(), inverse.copy()
        for _ in range(count + 1):
            pulls = inverse @ errors
            blocks = inverse.reshape(count, size, count, size)[np.arange(count), :, np.arange(count)]
            parts = pulls.reshape(count, size)
            # What a reading is off from where all others have it, squared: the block of V^-1 is that distance's metric.
            far = (parts * np.linalg.solve(blocks, parts[:, :, None])[:, :, 0]).sum(axis=1)
            worst = int(far.argmax())
            if not far[worst] > 2.0 * LOST:
                break
            here = slice(size * worst, size * (worst + 1))
            inverse -= inverse[:, here] @ np.linalg.solve(blocks[worst], inverse[here])
            inverse[here], inverse[:, here], inverse[here, here], errors[here] = 0.0, 0.0, np.eye(size), 0.0
            lost[worst] = True
        cost = 0.5 * (errors @ pulls + self.log_volume + more_volume) + LOST * lost.sum()
        return _Explained(float(cost), inverse, pulls, lost)


def _task(window: Sequence[LinearisedReading], before: Estimate) -> _Task:
    size = min(Position.dimension, *(len(seen.residual) for seen in window))  # which all of them have
    jacobian = np.array([seen.jacobian[:size] for seen in window])
    errors = np.array([seen.residual[:size] for seen in window]) - jacobian @ before.values
    through_root = jacobian.reshape(-1, len(before.values)) @ before.root
    volume = np.eye(len(through_root)) + through_root @ through_root.T
    return _Task(jacobian, errors, np.asarray(np.linalg.inv(volume), float), float(np.linalg.slogdet(volume)[1]))
