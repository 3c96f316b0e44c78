"""Values inside laws that are not linear, refined beside a model: a hypothesis competes at its best.

Levenberg and Marquardt in what is smooth, amplitudes eliminated in every trial (variable projection, Golub and Pereyra
1973); every moment between two rows for what steps; every choice for what is chosen. A refined value is worth more
than the value of a grid that it began from, and costs the logarithm of how much narrower than the grid it is known
(Laplace's approximation).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from armflex.conventions import Array
from armflex.estimate.view import QUOTIENT_STEP
from armflex.laws.effects.effect import Inner, Search, Values
from armflex.laws.effects.slip_step import moments
from armflex.trace.hypotheses import Hypothesis
from armflex.trace.screen import Screen
from armflex.trace.selection import (
    BETTER,
    MOST_ROUNDS,
    MOST_TRIED,
    SCALES,
    Beside,
    Chosen,
    Model,
    Rival,
    log_likelihood,
    rivals,
    without,
)

MOMENTS = 12
"""Tolerance: every moment is tried within this part of all of them to either side of the grid's best."""


def refine(beside: Beside, near: Sequence[Rival]) -> None:
    """Add refined ones of hypotheses of a screen beside a model; beside the same others none is refined twice."""
    screen = beside.evidence
    assert isinstance(screen, Screen)
    screen.bank.reporter.step(f"refining beside {len(beside.model)} laws", 0, 0)
    others = frozenset(screen.groups[chosen.number].hypothesis.spot for chosen in beside.model)
    refined, odds = list[Hypothesis](), beside.odds.max(axis=1)
    on_grid = [group.hypothesis for group in screen.groups[: len(odds)]]

    def likeliest(spot: tuple, most: int) -> list[Hypothesis]:
        # Slopes have no prior.
        at_spot = [i for i, each in enumerate(on_grid) if each.spot == spot and each.prior > -np.inf]
        return [on_grid[i] for i in sorted(at_spot, key=lambda i: -odds[i])[:most]]

    def best(starts: Sequence[Hypothesis], tau: float) -> list[Hypothesis]:
        ends = [end for start in starts if (end := _Search(screen, beside, start, tau).best()) is not None]
        return [max(ends, key=lambda end: end[1])[0]] if ends else []

    for place, rival in enumerate(near):
        hypothesis = screen.groups[rival.chosen.number].hypothesis
        before = screen.refined.setdefault(hypothesis.spot, set())
        # Values that were refined beside others are near: they are refined again where a climb looks at them.
        if others not in before and (not before or place < MOST_TRIED // 2):
            before.add(others)
            in_space = hypothesis.one.law.search is Search.SPACE
            starts = likeliest(hypothesis.spot, MOST_TRIED) if in_space else [hypothesis]
            refined += best(starts, SCALES[rival.chosen.scale])
    screen.extend(refined)
    lead = screen.groups[int(beside.odds.max(axis=1).argmax())].hypothesis
    law, led = lead.one.law, others | {("led by", lead.spot)}
    if law.search is not Search.SPACE:
        return
    # A point of the grid is near the place from some links, and far from it from others.
    inner = tuple(
        value if parameter.spread is None or parameter.default is None else parameter.default
        for parameter, value in zip(law.inner, lead.one.inner, strict=True)
    )
    refined = list[Hypothesis]()
    for spot in dict.fromkeys(group.hypothesis.spot for group in screen.groups if group.hypothesis.one.law is law):
        before = screen.refined.setdefault(spot, set())
        if spot != lead.spot and led not in before:
            before.add(led)
            for start in likeliest(spot, 1):  # none where all that it may do moves nothing
                there = replace(start, one=replace(start.one, inner=inner))
                refined += best([start, there], SCALES[len(SCALES) // 2])
    screen.extend(refined)


def anchored_anew(beside: Beside) -> list[Model]:
    """Return models with one hypothesis more, or another, for which what is sought in space has its place anew.

    Beside a hose that is held by a wrong anchor what is missing explains little, since the anchor imitates it. What is
    most probable with the slopes of the anchor as further columns is added, and the hose refined beside it.
    """
    screen, longer = beside.evidence, list[tuple[float, Model]]()
    assert isinstance(screen, Screen)
    for i, chosen in enumerate(beside.model):
        hypothesis, others = screen.groups[chosen.number].hypothesis, without(beside.model, i)
        if hypothesis.one.law.search is not Search.SPACE:
            continue
        for rest in (others, *(without(others, j) for j in range(len(others)))):
            anew = rivals(screen.beside(rest), refine, lambda each, spot=hypothesis.spot: each.spot == spot)[:1]
            for whole in [screen.beside((*rest, rival.chosen)) for rival in anew]:
                for rival in rivals(_freed(screen, whole))[:2]:
                    if rival.chosen not in others:
                        longer.append((whole.log_posterior + rival.odds, (*rest, rival.chosen)))
    models = list[Model]()
    for _, rest in sorted(longer, key=lambda pair: -pair[0])[:MOST_TRIED]:
        models += [(*rest, rival.chosen) for rival in rivals(screen.beside(rest), refine)[:1]]
    return models


def _freed(screen: Screen, beside: Beside) -> Beside:
    """Return the problem beside a model and the slopes of its last hypothesis, each within a cell of its grid."""
    last = screen.groups[beside.model[-1].number].hypothesis
    if not last.one.fitted:
        return beside
    columns = screen.bank.made(last.one)
    slopes = _Search(screen, beside, last, 1.0).slopes(last.one.inner, columns, beside.amplitudes[-1], last.one.fitted)
    numbers = screen.hold((replace(last, prior=-np.inf), slope[:, None]) for slope in slopes.T)
    near = [int(np.abs(SCALES - 1.0 / max(float(screen.groups[i].scale[0]), 1e-12)).argmin()) for i in numbers]
    return screen.beside((*beside.model, *map(Chosen, numbers, near)))


@dataclass(frozen=True)
class _At:
    """A hypothesis with other inner values: log evidence, amplitudes and columns."""

    inner: Values
    value: float
    amplitudes: np.ndarray
    columns: Array


class _Search:
    """The search for one hypothesis's inner values."""

    def __init__(self, screen: Screen, beside: Beside, hypothesis: Hypothesis, tau: float) -> None:
        self.screen, self.beside, self.hypothesis, self.tau = screen, beside, hypothesis, tau
        self.law, self.start = hypothesis.one.law, hypothesis.one.inner
        self.known_left = screen.columns_of(beside.places)[1]

    def columns(self, inner: Values) -> Array:
        return self.screen.bank.made(replace(self.hypothesis.one, inner=inner))

    def reduced(self, columns: Array) -> tuple[Array, Array]:
        """Return information and score of (n, k) columns beside the model."""
        projection, beside = self.screen.projection, self.beside
        across = columns.T @ self.known_left @ beside.inverse.T
        information = projection.inside(columns) - across @ across.T
        return information, columns.T @ projection.residual - across @ beside.pull

    def held(self, columns: Array) -> Array:
        """Return the (k,) prior precisions of amplitudes of columns."""
        scale = self.screen.scale_of(columns)
        return 1.0 / (self.tau * np.where(scale > 0.0, scale, 1e-12)) ** 2

    def at(self, inner: Values) -> _At | None:
        columns = self.columns(inner)
        if not (np.isfinite(columns).all() and columns.any()):
            return None
        information, score = self.reduced(columns)
        held = self.held(columns)
        whole = information + np.diag(held)
        amplitudes = np.linalg.solve(whole, score)
        left = max(self.beside.left - float(score @ amplitudes), 1e-9 * self.beside.left)
        value = float(log_likelihood(left, self.screen.freedom))
        value -= 0.5 * float(np.linalg.slogdet(whole / np.sqrt(np.outer(held, held)))[1])
        for one, here in zip(self.law.inner, inner, strict=True):
            if one.spread is not None and one.default is not None:
                value -= 0.5 * ((here - one.default) / one.spread) ** 2
        return _At(inner, value - self.beyond(inner), amplitudes, columns)

    def best(self) -> tuple[Hypothesis, float] | None:
        """Return the hypothesis at its best inner values, and its log evidence there; None where it has those."""
        here = self.at(self.start)
        if here is None:
            return None
        for i, inner in enumerate(self.law.inner):
            usual = () if inner.default is None or not inner.tried else (inner.default,)
            for value in (*usual, *inner.tried, *self._moments(inner, here.inner[i])):
                trial = self.at(_with(here.inner, i, value))
                if trial is not None and trial.value > here.value:
                    here = trial
        one = replace(self.hypothesis.one, inner=here.inner)
        here, cost = self._climbed(here, one.fitted) if one.fitted else (here, 0.0)
        if here.inner == self.start:
            return None
        one = replace(self.hypothesis.one, inner=here.inner)
        chosen = sum(float(np.log(1.0 + len(inner.tried))) for inner in self.law.inner if inner.tried)
        prior = self.hypothesis.prior - cost - chosen - self.beyond(here.inner)
        return replace(self.hypothesis, one=one, prior=prior), here.value - cost

    def _moments(self, inner: Inner, value: float) -> list[float]:
        """Return the moments near a value at which something may have stepped."""
        if inner.smooth or not inner.polished or not np.isfinite(value):
            return []
        between = moments(self.screen.context.column("time")[self.screen.fit.view.rows])
        reach, middle = max(1, len(between) // MOMENTS), int(np.searchsorted(between, value))
        return between[max(0, middle - reach) : middle + reach + 1].tolist()

    @cached_property
    def _grids(self) -> tuple[Array, ...]:
        """Values of each grid in order, or their logarithms where all are positive."""
        grids = list[Array]()
        for inner in self.law.inner:
            values = {float(value) for value in inner.grid(self.hypothesis.one.location, self.screen.context)}
            kept = [value for value in values if np.isfinite(value) and (value > 0.0 or not inner.positive)]
            grids.append(np.log(np.sort(kept)) if inner.positive else np.sort(kept))
        return tuple(grids)

    @cached_property
    def cells(self) -> tuple[float, ...]:
        """Half the distance between two values of each grid, or of their logarithms where all are positive."""
        cells = list[float]()
        for inner, value, grid in zip(self.law.inner, self.start, self._grids, strict=True):
            alone = 0.3 if inner.positive else max(abs(value), 1.0) * 0.3
            half = 0.5 * float(np.median(np.diff(grid))) if len(grid) > 1 else alone
            cells.append(half if inner.spread is None else inner.spread)
        return tuple(cells)

    def beyond(self, inner: Values) -> float:
        """Return what values inside the law count against it for being beyond their grids [nats].

        The values of a grid share the probability of their law, and a value between two of them has as much of it as a
        cell. Beyond the last one it falls as Cauchy's distribution does. A play whose radius shrinks to nothing would
        else be as probable as one of a tenth of the load, and a compliance has a likelihood of its own.
        """
        cost = 0.0
        for i in self.hypothesis.one.fitted:
            if self.law.inner[i].spread is None and len(grid := self._grids[i]) > 1:
                at = np.log(inner[i]) if self.law.inner[i].positive else inner[i]
                cost += float(np.log1p((max(grid[0] - at, at - grid[-1], 0.0) / self.cells[i]) ** 2))
        return cost

    def _moved(self, inner: Values, free: Sequence[int], steps: np.ndarray) -> Values:
        """Return values inside the law moved by (f,) cells of their grids."""
        for i, step in zip(free, steps.tolist(), strict=True):
            inner = _with(inner, i, self.law.inner[i].moved(inner[i], self.cells[i] * step))
        return inner

    def slopes(self, inner: Values, columns: Array, amplitudes: Array, free: Sequence[int]) -> Array:
        """Return the (n, f) changes of what (n, k) columns explain with values inside the law, by cells of the grids.

        By one-sided quotients: half as many columns are made, and a step is checked by the evidence that it leads to.
        """
        steps = [self._moved(inner, free, step) for step in QUOTIENT_STEP * np.eye(len(free))]
        changes = [(self.columns(moved) - columns) @ amplitudes for moved in steps]
        return np.stack(changes, axis=1) / QUOTIENT_STEP

    def _climbed(self, here: _At, free: Sequence[int]) -> tuple[_At, float]:
        """Return the best values near some, and the log of how much less their posterior is than a cell of the grid."""
        inners, count = [self.law.inner[i] for i in free], len(here.amplitudes)
        damping, slopes, information = 1e-2, np.zeros((len(here.columns), 0)), None
        prior = np.array([float(one.spread is not None) for one in inners])  # of steps: a cell is its deviation
        for _ in range(MOST_ROUNDS):
            slopes = self.slopes(here.inner, here.columns, here.amplitudes, free)
            if not np.isfinite(slopes).all():
                return here, 0.0
            information, score = self.reduced(np.hstack([here.columns, slopes]))
            defaults = [(here.inner[i] - (one.default or 0.0)) / self.cells[i]
                        for one, i in zip(inners, free, strict=True)]  # fmt: skip
            score[count:] -= np.where(prior > 0.0, defaults, 0.0)
            held = np.concatenate([self.held(here.columns), prior + 1e-9 * np.diag(information)[count:]])
            own, damped = float(score[:count] @ here.amplitudes), np.diag(information) * (np.arange(len(held)) >= count)
            trial = None
            while trial is None:  # as long as a step promises anything
                values = np.linalg.solve(information + np.diag(held + damping * damped + 1e-300), score)
                if 0.5 * (float(score @ values) - own) < BETTER:
                    break
                trial = self.at(self._moved(here.inner, free, np.clip(values[count:], -2.0, 2.0)))
                if trial is None or trial.value <= here.value:
                    trial, damping = None, max(5.0 * damping, 1e-3)
            if trial is None:
                break
            gain, here, damping, information = trial.value - here.value, trial, damping / 5.0, None
            if gain < BETTER:
                break
        if information is None:  # of where the last step led
            information, _ = self.reduced(np.hstack([here.columns, slopes]))
        own = information[:count, :count] + np.diag(self.held(here.columns))
        across = information[count:, :count]
        inside = information[count:, count:] - across @ np.linalg.solve(own, across.T)
        noise = max(self.beside.left / self.screen.freedom, 1.0)
        return here, 0.5 * float(np.linalg.slogdet(np.eye(len(inside)) + inside / noise)[1])


def _with(inner: Values, place: int, value: float) -> Values:
    return (*inner[:place], value, *inner[place + 1 :])
