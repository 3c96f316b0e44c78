"""The arm so far: what is declared, what was added to it, and the fit of everything together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from armflex.arm import Arm
from armflex.calibrate.blocks import Block
from armflex.calibrate.calibrate import Calibration
from armflex.calibrate.effect_block import EffectBlock, shy_prior
from armflex.calibrate.fit import ROUGH, Fit, fit
from armflex.calibrate.view import Setup
from armflex.conventions import Array
from armflex.effects.remember import known_rows
from armflex.effects.scene import Scene, survey
from armflex.linearise import Linearisation, Linearizer
from armflex.measurements import Measurements
from armflex.trace.candidates import candidate_columns
from armflex.trace.polish import Polished
from armflex.trace.pose_block import PoseBlock
from armflex.trace.projection import project
from armflex.trace.search import Round, search

LOST = 0.1
"""Robust weight below which a reading is a lost beam and left out: no effect is forty standard deviations long."""


@dataclass(frozen=True, eq=False)
class State:
    """A fit of the declared parameters, the effects added so far, and a random twist where a cause is unknown.

    Attributes:
        measurements: The campaign.
        rows: Measured rows in use.
        declared: Arm and instrument before any fit.
        blocks: Declared blocks.
        effects: Added effects, in the order added.
        random: Random twist per pose, None where there is none.
        fit: All of them together.
        scene: The campaign as the catalogue sees it, at this fit.
    """

    measurements: Measurements
    rows: np.ndarray
    declared: Setup
    blocks: tuple[Block, ...]
    effects: tuple[EffectBlock, ...]
    random: PoseBlock | None
    fit: Fit
    scene: Scene

    @cached_property
    def groups(self) -> np.ndarray:
        """(M,) pose number of every fitted row."""
        names = [self.measurements.pose[row] for row in self.rows]
        return np.unique(names, return_inverse=True)[1]

    @property
    def sessions(self) -> tuple[str, ...]:
        """Session of every fitted row."""
        return tuple(self.measurements.session[row] for row in self.rows)

    def values_of(self, block: Block) -> Array:
        """Return the fitted values of one block."""
        return self.fit.values[self.fit.places(block)]

    def stds_of(self, block: Block) -> Array:
        """Return the standard uncertainties of one block's values."""
        return np.sqrt(np.diag(self.fit.covariance)[self.fit.places(block)])

    @cached_property
    def looked(self) -> Round:
        """What the catalogue and free shapes could still explain."""
        return search(self.fit, self.scene, self.groups)


def begin(calibration: Calibration) -> State:
    """Return the state after calibration: nothing added, lost beams left out."""
    fitted = calibration.fit
    lost = fitted.weights < LOST
    if lost.any():
        rows = fitted.view.rows[~lost]
        fitted = fit(fitted.declared, fitted.blocks, calibration.measurements, rows, fitted.values)
    scene = scene_at(fitted, calibration.measurements)
    return State(calibration.measurements, fitted.view.rows, fitted.declared, fitted.blocks, (), None, fitted, scene)


def scene_at(fitted: Fit, measurements: Measurements) -> Scene:
    """Return the campaign as the catalogue sees it at a fit: loads at every site of every driven row."""
    arm, view = fitted.setup.arm, fitted.view
    known = known_rows(arm, measurements)
    rest = np.setdiff1d(np.arange(len(measurements)), view.rows)
    wrenches = {site: np.empty((len(measurements), 6)) for site in view.line.sites}
    for rows, line in ((view.rows, view.line), (rest, _line(arm, measurements, known, rest))):
        for site in wrenches if line is not None else ():
            wrenches[site][rows] = line.load_at(site)
    return survey(measurements, arm, known, wrenches, view.line.links[:, :, :3, 3])


def _line(arm: Arm, measurements: Measurements, known: Mapping[str, Array], rows: np.ndarray) -> Linearisation | None:
    if not len(rows):
        return None
    given = {name: values[rows] for name, values in known.items()}
    return Linearizer(arm).rows(measurements.q[rows], [measurements.payload[row] for row in rows], given)


def add(state: State, found: Polished) -> State:
    """Return the state with a candidate added and everything refitted."""
    absorbed, start = _beginning(state, found)
    what = found.candidate.effect(found.amplitudes)
    prior = shy_prior(what, found.free, state.fit.view, state.scene)
    ordinal = len(state.declared.arm.effects) + len(state.effects)
    effect = EffectBlock(what, found.free, state.scene, ordinal, prior)
    return refit(state, (*state.effects, effect), state.random, np.concatenate([start, effect.start, absorbed]))


def _beginning(state: State, found: Polished) -> tuple[Array, Array]:
    """Return starting values of the random twist and of everything else, moved to make room for the effect."""
    projection = project(state.fit)
    values = state.fit.values - projection.absorbed(
        candidate_columns(found.candidate, state.fit, state.scene) @ found.amplitudes
    )
    count = 0 if state.random is None else len(state.random.labels)
    return values[len(values) - count :], values[: len(values) - count]


def without(state: State, index: int) -> State:
    """Return the state with one effect taken out and everything refitted."""
    return _with(state, [block for i, block in enumerate(state.effects) if i != index])


def _with(state: State, kept: Sequence[EffectBlock]) -> State:
    """Return the state with some of its effects, in this order, everything refitted."""
    first = len(state.declared.arm.effects)
    effects = tuple(
        replace(block, effect=block.at(state.values_of(block)), ordinal=first + i) for i, block in enumerate(kept)
    )
    base = sum(len(block.labels) for block in state.blocks)
    start = np.concatenate([state.fit.values[:base], *(block.start for block in effects)])
    random = state.values_of(state.random) if state.random else np.zeros(0)
    return refit(state, effects, state.random, np.concatenate([start, random]))


def with_random(state: State, random: PoseBlock | None) -> State:
    """Return the state with a random twist per pose (or without one) and everything refitted."""
    count = 0 if state.random is None else len(state.random.labels)
    start = state.fit.values[: len(state.fit.values) - count]
    added = np.zeros(0 if random is None else len(random.labels))
    return refit(state, state.effects, random, np.concatenate([start, added]))


def refit(state: State, effects: tuple[EffectBlock, ...], random: PoseBlock | None, start: Array) -> State:
    """Return the state with these effects, everything fitted together and the campaign looked at again."""
    blocks = (*state.blocks, *effects, *(() if random is None else (random,)))
    fitted = fit(state.declared, blocks, state.measurements, state.rows, start, effort=ROUGH)
    scene = scene_at(fitted, state.measurements)
    return replace(state, effects=effects, random=random, fit=fitted, scene=scene)


def moved_to(state: State, index: int) -> State:
    """Return the state with its last effect at another place in the order."""
    order = list(range(len(state.effects) - 1))
    order.insert(index, len(state.effects) - 1)
    return _with(state, [state.effects[old] for old in order])


def information(state: State) -> float:
    """Return n log J + k log n of a state: the smaller the better."""
    projection = project(state.fit)
    searched = sum(len(block.labels) for block in state.effects)
    return projection.count * float(np.log(projection.objective)) + searched * float(np.log(projection.count))
