"""The arm so far: what is declared, what was added to it, and the fit of everything together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from armflex.arm import Arm
from armflex.conventions import Array
from armflex.estimate.block import Block
from armflex.estimate.calibrate import Calibration
from armflex.estimate.effect_block import EffectBlock, amplitude_prior
from armflex.estimate.fit import ROUGH, THOROUGH, Effort, Fit, fit, moved
from armflex.estimate.view import look
from armflex.laws.effects.catalogue import EVERY
from armflex.laws.effects.effect import Effect
from armflex.laws.effects.remember import without_direction
from armflex.laws.effects.scene import Scene, survey
from armflex.measured.measurements import Measurements
from armflex.mechanics.history import known_rows
from armflex.mechanics.response import Response, respond
from armflex.parameters import numbers_of
from armflex.rows.rows import POSE
from armflex.setup import Setup
from armflex.trace.candidates import Bank, Candidate, bank, candidate_columns, candidates_of
from armflex.trace.lost import lost_beams
from armflex.trace.polish import Polished
from armflex.trace.pose_block import PoseBlock
from armflex.trace.projection import project
from armflex.trace.search import Round, search
from armflex.trace.sensible import sensible
from armflex.trace.telling import Tell, silent, tell_steps


@dataclass(frozen=True, eq=False)
class State:
    """A fit of the declared parameters, the effects added so far, and a random twist where a cause is unknown.

    Attributes:
        measurements: The campaign.
        asked: Rows that were to be used.
        rows: Those of them in use: all but lost beams, and rows that do not tell what an added effect depends on.
        declared: Arm and instrument before any fit.
        blocks: Declared blocks.
        effects: Added effects, in the order added.
        random: Random twist per pose, None where there is none.
        fit: All of them together.
        scene: The campaign as the catalogue sees it, at this fit.
        heed: Whether rows that are far off in company stay in use; see `lost_beams`.
        tell: Called with how far a search or a fit has come.
    """

    measurements: Measurements
    asked: np.ndarray
    rows: np.ndarray
    declared: Setup
    blocks: tuple[Block, ...]
    effects: tuple[EffectBlock, ...]
    random: PoseBlock | None
    fit: Fit
    scene: Scene
    heed: bool = True
    tell: Tell = silent

    @cached_property
    def groups(self) -> np.ndarray:
        """(M,) pose number of every fitted row."""
        return np.unique(self.measurements.pose_number[self.rows], return_inverse=True)[1]

    @cached_property
    def untold(self) -> np.ndarray:
        """(A,) which of the rows asked for do not tell the direction that an added effect depends on.

        The search takes them as halfway, as what may be either; once the effect is there `predict` refuses such rows.
        """
        return without_direction([block.effect for block in self.effects], self.measurements)[self.asked]

    @property
    def sessions(self) -> tuple[str, ...]:
        """Session of every fitted row."""
        return tuple(self.measurements.session[row] for row in self.rows)

    def uses(self, rows: np.ndarray) -> bool:
        """Return whether just these rows are in use."""
        return np.array_equal(rows, self.rows)

    def values_of(self, block: Block) -> Array:
        """Return the fitted values of one block."""
        return self.fit.values[self.fit.places(block)]

    def stds_of(self, block: Block) -> Array:
        """Return the standard uncertainties of one block's values."""
        return self.fit.posterior.std[self.fit.places(block)]

    @cached_property
    def looked(self) -> Round:
        """What the catalogue and free shapes could still explain."""
        return search(self.physical, self.groups)

    @cached_property
    def physical(self) -> Bank:
        """Every candidate that is physics rather than a free shape."""
        laws = (law for law in EVERY.values() if law.physical)
        return bank(candidates_of(laws, self.scene), self.fit, self.scene, self.tell)


def begin(calibration: Calibration, tell: Tell = silent) -> State:
    """Return the state after a calibration `as_stated`: nothing added, lost beams left out."""
    fitted, measurements = calibration.fit, calibration.measurements
    rows, scene = fitted.view.rows, scene_at(fitted, measurements)
    state = State(measurements, rows, rows, fitted.declared, fitted.blocks, (), None, fitted, scene, tell=tell)
    return sorted_out(state, THOROUGH)


def sorted_out(state: State, effort: Effort = ROUGH) -> State:
    """Return the state with the question put anew of which rows are lost beams, refitted where the answer changed.

    While an effect is missing, rows that it moves may look lost; once it is there, others stand out that did not. Rows
    before a joint's first motion leave with the first effect that must know its direction.
    """
    rows = state.asked[~(lost_rows(state, state.heed) | state.untold)]
    if state.uses(rows):
        return state
    return refit(replace(state, rows=rows), state.effects, state.random, state.fit.values, effort)


def lost_rows(state: State, heed: bool) -> np.ndarray:
    """Return which of the rows that were to be used are lost beams at a fit; see `lost_beams`."""
    asked, measurements = state.asked, state.measurements
    view = state.fit.view if len(state.rows) == len(asked) else look(state.fit.setup, measurements, asked)
    return lost_beams(view, [measurements.session[row] for row in asked], measurements.pose_number[asked], heed)


def fitted_to(fitted: Fit, measurements: Measurements, rows: np.ndarray) -> Fit:
    """Return the same fit to other rows of its campaign."""
    if np.array_equal(rows, fitted.view.rows):
        return fitted
    return fit(fitted.declared, fitted.blocks, measurements, rows, fitted.values)


def scene_at(fitted: Fit, measurements: Measurements) -> Scene:
    """Return the campaign as the catalogue sees it at a fit: loads at every site of every driven row."""
    arm, view = fitted.setup.arm, fitted.view
    known = known_rows(arm, measurements) | {POSE: measurements.pose_number.astype(float)}
    rest = np.setdiff1d(np.arange(len(measurements)), view.rows)
    wrenches = {site: np.empty((len(measurements), 6)) for site in view.line.sites}
    for rows, line in ((view.rows, view.line), (rest, _line(arm, measurements, known, rest))):
        if line is not None:
            for site in wrenches:
                wrenches[site][rows] = line.load_at(site)
    return survey(measurements, arm, known, wrenches, view.line.links[:, :, :3, 3])


def _line(arm: Arm, measurements: Measurements, known: Mapping[str, Array], rows: np.ndarray) -> Response | None:
    if not len(rows):
        return None
    given = {name: values[rows] for name, values in known.items()}
    return respond(arm, measurements.q[rows], [measurements.payload[row] for row in rows], given)


def add(state: State, found: Polished) -> State:
    """Return the state with a candidate added, or joined to the effect that it widens, and everything refitted."""
    values = _beginning(state, found)
    what = found.candidate.effect(found.amplitudes)
    derived = tuple(name for name in what.location.covariates if name in state.measurements.derived)
    what = replace(what, derived=derived)
    starts = [values[state.fit.places(block)] for block in state.effects]
    widened = [i for i, block in enumerate(state.effects) if _is_same_law(block.effect, what)]
    place = widened[0] if widened else len(starts)
    if widened:
        what = _joined(state.effects[place].at(starts[place]), what)
    prior = amplitude_prior(what, found.free, state.fit.view, state.scene)
    ordinal = len(state.declared.arm.effects) + place
    block = EffectBlock(what, found.free, state.scene, ordinal, prior)
    effects = (*state.effects[:place], block, *state.effects[place + 1 :])
    starts[place : place + 1] = [block.start]
    return refit(state, effects, state.random, _with_starts(state, values, starts))


def _beginning(state: State, found: Polished) -> Array:
    """Return values of what is fitted already, moved to make room for an effect."""
    change = candidate_columns(found.candidate, state.fit, state.scene) @ found.amplitudes
    return moved(state.fit.blocks, state.fit.values, -project(state.fit).absorbed(change))


def _is_same_law(one: Effect, other: Effect) -> bool:
    """Return whether two effects are one with more terms: same law and place, nothing searched between them."""
    places = [(effect.law.name, replace(effect.location, terms=())) for effect in (one, other)]
    return places[0] == places[1] and not one.law.inner


def _joined(one: Effect, other: Effect) -> Effect:
    """Return the sum of two effects of the same law and place."""
    terms = tuple(sorted({*one.location.terms, *other.location.terms}))
    values = tuple(a + b for a, b in zip(one.values, other.values, strict=True))
    return replace(one, location=replace(one.location, terms=terms), values=values)


def without(state: State, index: int) -> State:
    """Return the state with one effect taken out and everything refitted."""
    return _with(state, [block for i, block in enumerate(state.effects) if i != index])


def _with(state: State, kept: Sequence[EffectBlock]) -> State:
    """Return the state with some of its effects, in this order, everything refitted."""
    first = len(state.declared.arm.effects)
    effects = tuple(
        replace(block, effect=block.at(state.values_of(block)), ordinal=first + i) for i, block in enumerate(kept)
    )
    starts = [block.start for block in effects]
    return refit(state, effects, state.random, _with_starts(state, state.fit.values, starts))


def _with_starts(state: State, values: Array, starts: Sequence[Array]) -> Array:
    """Return the values of declared blocks and of the random twist, and between them where the effects start."""
    declared = sum(len(block.labels) for block in state.blocks)
    random = values[state.fit.places(state.random)] if state.random else np.zeros(0)
    return np.concatenate([values[:declared], *starts, random])


def with_random(state: State, random: PoseBlock | None) -> State:
    """Return the state with a random twist per pose (or without one) and everything refitted."""
    count = 0 if state.random is None else len(state.random.labels)
    start = state.fit.values[: len(state.fit.values) - count]
    added = np.zeros(0 if random is None else len(random.labels))
    return refit(state, state.effects, random, np.concatenate([start, added]))


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
    blocks = (*state.blocks, *effects, *(() if random is None else (random,)))
    tell = partial(tell_steps, state.tell)
    fitted = fit(state.declared, blocks, state.measurements, state.rows, start, tell, effort)
    scene = scene_at(fitted, state.measurements)
    return replace(state, effects=effects, random=random, fit=fitted, scene=scene)


def moved_to(state: State, index: int) -> State:
    """Return the state with its last effect at another place in the order."""
    order = list(range(len(state.effects) - 1))
    order.insert(index, len(state.effects) - 1)
    return _with(state, [state.effects[old] for old in order])


def information(state: State, limit: float) -> float:
    """Return n log J + k log n of a state: the smaller the better.

    J is what the fit reached, not what its linear problem promises. States are compared at one `limit` of lengths
    beyond which rows count less (`robust_limit`).
    """
    count = state.fit.view.count
    effects = [block.at(state.values_of(block)) for block in state.effects]
    searched = sum(Candidate(effect.law, effect.location, effect.inner).parameters for effect in effects)
    return count * float(np.log(max(state.fit.cost(limit), count))) + searched * float(np.log(count))


def stands(state: State) -> bool:
    """Return whether every effect is still possible with what the fit made of it."""
    for block in state.effects:
        effect = block.at(state.values_of(block))
        if not sensible(
            Candidate(effect.law, effect.location, effect.inner), effect.acting, state.fit, state.scene, present=True
        ):
            return False
    return True
