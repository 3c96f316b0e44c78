"""The arm so far: what is declared, what was added to it, and the fit of everything together."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from armflex.arm import Setup
from armflex.conventions import Array
from armflex.estimate.block import Block, EffectBlock
from armflex.estimate.calibrate import Calibration
from armflex.estimate.fit import ROUGH, THOROUGH, Effort, Fit, fit, moved
from armflex.estimate.held_out import judged_by
from armflex.estimate.outliers import fit_without_lost, lost_among, without_lost
from armflex.estimate.pose_block import PoseBlock
from armflex.estimate.view import gravity_in, look
from armflex.laws.effects.context import Context, survey
from armflex.laws.effects.effect import Effect
from armflex.laws.effects.in_arm import without_direction
from armflex.measured.measurements import Measurements
from armflex.mechanics.history import known_rows
from armflex.mechanics.response import respond
from armflex.parameters import numbers_of
from armflex.progress import SILENT, Reporter
from armflex.rows.rows import POSE, ROW
from armflex.trace.families import NO_FAMILIES, Background, Sized, kinds_of
from armflex.trace.hypotheses import Hypothesis
from armflex.trace.projection import LEAST_SCATTER, Projection


@dataclass(frozen=True, eq=False)
class State:
    """A fit of the declared parameters, the effects added so far, and a random twist where a cause is unknown.

    Attributes:
        calibration: Before anything was added, lost beams and all.
        first: The same without lost beams.
        measurements: The campaign.
        rows: Rows in use: all of those asked for but lost beams, and rows without what an added effect depends on.
        lost: (A, G) which readings of those asked for, by instrument, are left out of their rows as lost beams.
        fit: Everything together.
        context: The campaign as the catalogue sees it, at this fit.
        known: Hypotheses that were added, with values inside their laws as they were chosen.
        effects: What they add, one each, in order.
        random: Random twist per pose, None where there is none.
        background: Families beside the effects.
        heed: Whether rows that are far off in company stay in use; see `lost_readings`.
        reporter: Hears what is being done.
    """

    calibration: Calibration
    first: Fit
    measurements: Measurements
    rows: np.ndarray
    lost: np.ndarray
    fit: Fit
    context: Context
    known: tuple[Hypothesis, ...] = ()
    effects: tuple[EffectBlock, ...] = ()
    random: PoseBlock | None = None
    background: Background = NO_FAMILIES
    heed: bool = True
    reporter: Reporter = SILENT

    @property
    def asked(self) -> np.ndarray:
        """(A,) rows that were to be used."""
        return self.calibration.fit.view.rows

    @property
    def declared(self) -> Setup:
        """Arm and instrument before any fit."""
        return self.first.declared

    @property
    def blocks(self) -> tuple[Block, ...]:
        """What is free beside what was added."""
        return self.first.blocks

    @cached_property
    def calibrated(self) -> Fit:
        """The calibration, fitted to the rows in use."""
        first = self.first
        if np.array_equal(self.rows, first.view.rows):
            return first
        return fit(first.declared, first.blocks, self.measurements, self.rows, first.values)

    @cached_property
    def judged(self) -> np.ndarray:
        """(M, d) which readings of the rows in use every error is over."""
        return judged_by(self.calibrated, self.fit)

    @cached_property
    def groups(self) -> np.ndarray:
        """(M,) pose number of every fitted row."""
        return np.unique(self.measurements.pose_number[self.rows], return_inverse=True)[1]

    @cached_property
    def undirected(self) -> np.ndarray:
        """(A,) which of the rows asked for do not say the direction that an added effect depends on.

        The search takes them as halfway, as what may be either; once the effect is there `predict` refuses such rows.
        """
        return without_direction([block.effect for block in self.effects], self.measurements)[self.asked]

    @property
    def sessions(self) -> tuple[str, ...]:
        """Session of every fitted row."""
        return tuple(self.measurements.session[row] for row in self.rows)

    def values_of(self, block: Block) -> Array:
        """Return the fitted values of one block."""
        return self.fit.values[self.fit.places(block)]

    @cached_property
    def fitted(self) -> tuple[Effect, ...]:
        """The added effects with the values that the fit gave them."""
        return tuple(block.at(self.values_of(block)) for block in self.effects)

    @cached_property
    def common(self) -> tuple[Effect, ...]:
        """Effects of families with the values that the fit gave them."""
        return tuple(block.at(self.values_of(block)) for block in self.background.effects)

    @property
    def residual(self) -> Array:
        """(M, d) measured minus predicted [m, rad]; random twists, whose values nobody can know, are not predicted."""
        view = self.fit.view
        random = 0.0 if self.random is None else self.random.jacobian(view) @ self.values_of(self.random)
        return view.residual + random

    @property
    def may_scatter(self) -> bool:
        """Whether a random twist may be set aside: none is, nor are families that have what nothing else explains."""
        return self.random is None and not self.background.names

    @cached_property
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """What was added, with values inside laws as they were fitted."""
        pairs = zip(self.known, self.fitted, strict=True)
        return tuple(replace(known, one=replace(known.one, inner=effect.inner)) for known, effect in pairs)

    @property
    def identity(self) -> tuple:
        """What distinguishes it from other states: laws and places, families, rows and readings in use, random twists.

        A state that differs in values alone is the same one.
        """
        twist = None if self.random is None else (self.random.site, self.random.axis)
        spots = frozenset(Counter(one.spot for one in self.known).items())
        return spots, self.background.names, self.rows.tobytes(), self.lost.tobytes(), twist

    @property
    def quiet(self) -> float:
        """Standard deviation of the readings over that stated where they scatter less, else 1.

        What is still missing is in it: they scatter no more than that. Priors are compared with it.
        """
        return float(np.clip(self.fit.noise, LEAST_SCATTER, 1.0))

    @cached_property
    def bare(self) -> Projection:
        """The projection of all that is fitted but the added effects, on the readings as they would be without them.

        By the scatter of the readings where that is less than was stated; see `quiet`.
        """
        return self.bare_without()

    def bare_without(self, *families: str) -> Projection:
        """Return `bare` as it is when some families are not there."""
        fitted, own = self.fit, [self.fit.places(block) for block in self.effects]
        acting = [at[: len(block.effect.location.terms)] for at, block in zip(own, self.effects, strict=True)]
        none = np.zeros(0, dtype=int)
        rest = np.setdiff1d(np.arange(len(fitted.values)), np.concatenate([none, *own]))
        some = np.sort(np.concatenate([rest, *acting]))
        # Linear in the amplitudes, so exact for them.
        values = np.zeros_like(fitted.values)
        values[some] = fitted.values[some]
        data = fitted.residual + fitted.regressors @ values
        family = np.full(len(fitted.values), "", dtype=object)
        family[self._common] = self.background.families
        rest = rest[~np.isin(family[rest], families)]
        common = family[rest] != ""
        # Sizes of families are by the noise, whatever that is.
        precision = fitted.precision[rest] * np.where(common, self.quiet**-2.0, 1.0)
        return Projection(
            fitted.regressors[:, rest] / self.quiet, precision, data / self.quiet, fitted.view.count, common
        )

    @property
    def _common(self) -> np.ndarray:
        """Places of what is of families among the values of the fit."""
        return np.concatenate([np.zeros(0, dtype=int), *map(self.fit.places, self.background.blocks)])

    @property
    def named(self) -> Projection:
        """The projection of all that is fitted but families, by the scatter that was stated."""
        fitted = self.fit
        kept = np.setdiff1d(np.arange(len(fitted.values)), self._common)
        data = fitted.residual + fitted.regressors @ fitted.values
        return Projection(fitted.regressors[:, kept], fitted.precision[kept], data, fitted.view.count)

    @cached_property
    def sized(self) -> Sized:
        """Families with the sizes that the evidence gives them beside the added effects."""
        return kinds_of(self.fit, self.context, self.groups).beside(self.named, self.background)


def begin(calibration: Calibration, reporter: Reporter = SILENT) -> State:
    """Return the state after a calibration `as_stated`: nothing added, lost beams left out."""
    fitted, whole, rows = calibration.fit, calibration.measurements, calibration.fit.view.rows
    none, context = np.zeros((len(rows), len(whole.readings.groups)), bool), context_at(fitted, whole)
    state = State(calibration, fitted, whole, rows, none, fitted, context, reporter=reporter)
    state = sorted_out(state, THOROUGH)
    return replace(state, first=state.fit)


def of_poses(state: State, count: int) -> State | None:
    """Return a calibrated state of so many of its poses, drawn by chance; None where it has not twice as many."""
    calibration, found = state.calibration, state.first
    pose = calibration.measurements.pose_number[state.asked]
    if len(every := np.unique(pose)) < 2 * count:
        return None
    rows = state.asked[np.isin(pose, np.random.default_rng(0).choice(every, count, replace=False))]
    near = found.view.some(np.flatnonzero(np.isin(found.view.rows, rows)))
    some = fit_without_lost(found.declared, found.blocks, calibration.measurements, found.values, near)
    return begin(replace(calibration, fit=some), state.reporter)


def with_all_of(state: State, found: State) -> State:
    """Return a calibrated state with all that was added to one of fewer rows, refitted; see `of_poses`.

    Raises:
        ArmflexError: The arm does not come to rest in all of them, or no fit is found.
    """
    effects = [replace(one, effect=one.effect.seen_in(state.context, state.rows)) for one in found.effects]
    after, start = replace(state, known=found.known, background=found.background), found.fit.values
    return sorted_out(refit(after, tuple(effects), found.random, start))


def sorted_out(state: State, effort: Effort = ROUGH) -> State:
    """Return the state with the question put anew of which readings are lost beams, refitted where the answer changed.

    While an effect is missing, readings that it moves may look lost; once it is there, others stand out that did not.
    Rows before a joint's first motion leave with the first effect that must know its direction.
    """
    (lost, gone), whole = lost_of(state, state.heed), state.calibration.measurements
    used = ~(gone | state.undirected)
    if np.array_equal(state.asked[used], state.rows) and np.array_equal(lost[used], state.lost[used]):
        return state
    lost &= used[:, None]
    left, _ = without_lost(whole, state.asked, lost)
    changed = replace(state, rows=state.asked[used], measurements=left, lost=lost)
    return refit(changed, state.effects, state.random, state.fit.values, effort)


def lost_of(state: State, heed: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return (A, G) which readings of the rows asked for are lost beams, and (A,) which rows hold nothing else.

    See `lost_readings`.
    """
    asked, whole = state.asked, state.calibration.measurements
    same = np.array_equal(asked, state.rows) and state.measurements is whole
    view = state.fit.view if same else look(state.fit.setup, whole, asked)
    lost = lost_among(view, whole, heed)
    read = [np.isfinite(whole.readings.sigma[asked][:, place]).any(axis=1) for place in whole.readings.groups]
    return lost, np.all(lost | ~np.array(read).T, axis=1)


def context_at(fitted: Fit, measurements: Measurements) -> Context:
    """Return the campaign as the catalogue sees it at a fit: loads at every site of every driven row."""
    arm, view = fitted.setup.arm, fitted.view
    gravity = gravity_in(fitted.setup, measurements.session)
    numbers = {POSE: measurements.pose_number.astype(float), ROW: np.arange(float(len(measurements)))}
    known = known_rows(arm, measurements, gravity) | numbers
    wrenches = {site: np.empty((len(measurements), 6)) for site in view.line.sites}
    lines, rest = [(view.rows, view.line)], np.setdiff1d(np.arange(len(measurements)), view.rows)
    if len(rest):
        given = {name: values[rest] for name, values in known.items()}
        some = measurements.some(rest)
        pull = None if gravity is None else gravity[rest]
        lines.append((rest, respond(arm, some.q, some.payload, given, wrenches=some.wrenches, gravity=pull)))
    for rows, line in lines:
        for site in wrenches:
            wrenches[site][rows] = line.load_at(site)
    return survey(measurements, arm, known, wrenches, view.line.links[:, :, :3, 3])


def with_random(state: State, random: PoseBlock | None) -> State:
    """Return the state with a random twist per pose (or without one) and everything refitted."""
    count = 0 if state.random is None else len(state.random.labels)
    start = state.fit.values[: len(state.fit.values) - count]
    added = np.zeros(0 if random is None else len(random.labels))
    return refit(state, state.effects, random, np.concatenate([start, added]))


def resized(state: State, effort: Effort) -> State:
    """Return the state with the families that the evidence has beside its effects, and their sizes; see `Background`.

    Raises:
        ArmflexError: The arm does not come to rest with them, or no fit is found.
    """
    background = state.sized.background
    if background.close_to(state.background):
        return state
    blocks, named, values = (*state.blocks, *state.effects), state.named, state.fit.values
    absorbed, count = named.absorbed(named.data - background.explained), sum(len(block.parameters) for block in blocks)
    start = moved(blocks, values[:count], absorbed[:count] - values[:count])
    start = np.concatenate([start, background.amplitudes, absorbed[count:]])
    return refit(replace(state, background=background), state.effects, state.random, start, effort)


def refit(
    state: State,
    effects: tuple[EffectBlock, ...],
    random: PoseBlock | None,
    start: Array,
    effort: Effort = ROUGH,
) -> State:
    """Return the state with these effects, everything fitted together and the campaign looked at again."""
    known = state.declared.arm.effects
    numbers = numbers_of((*known, *(block.effect for block in effects)))[len(known) :]
    effects = tuple(replace(block, number=number) for block, number in zip(effects, numbers, strict=True))
    common = state.background
    numbers = numbers_of((*known, *(block.effect for block in (*effects, *common.effects))))
    common = common.from_effect(len(known) + len(effects), numbers[len(known) + len(effects) :])
    blocks = (*state.blocks, *effects, *common.blocks, *(() if random is None else (random,)))
    fitted = fit(state.declared, blocks, state.measurements, state.rows, start, state.reporter.steps, effort)
    context = context_at(fitted, state.measurements)
    return replace(state, effects=effects, random=random, background=common, fit=fitted, context=context)
