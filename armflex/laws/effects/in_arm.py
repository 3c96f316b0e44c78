"""Effects at work in an arm: twists join the law of a flexure, loads pull on links.

What they depend on is asked here, too: the columns of rows, and directions that follow from the order of the rows.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import cast

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.errors import Flag, InputError, MissingCovariateError, did_you_mean, listing, naming
from armflex.laws import Law, Row
from armflex.laws.declared import Flexure
from armflex.laws.effects.context import Known, begun_anew
from armflex.laws.effects.effect import Act, Afterwards, Effect, LoadLaw, Manipulator, SightLaw, TwistLaw, Values
from armflex.laws.effects.location import Here, link_of, resolve, same_site, site_of
from armflex.laws.law import Composed, Ranges, WithoutParameters
from armflex.laws.terms import UNITS, Factor, Neurons, Term, Terms
from armflex.robot import Robot
from armflex.rows import Rows
from armflex.rows.rows import APPROACH, HOLD, TIME


@dataclass(frozen=True)
class BoundTwist(WithoutParameters):
    """An effect's twist at its place on one arm.

    It has no parameters of its own: an effect is moved, and known, as a block of a fit.
    """

    effect: Effect
    here: Here

    @cached_property
    def law(self) -> TwistLaw:
        """What the effect does."""
        return cast(TwistLaw, self.effect.law)

    def twist(self, wrench: Array, row: Row) -> Array:
        """Return the (..., 6) twist; raise `MissingCovariateError` where the row lacks what the effect needs."""
        if self.known_terms is not None or self.law.basis is None:
            return super().twist(wrench, row)
        try:
            return np.array(self.effect.amplitudes) @ self.law.basis(self.here, wrench, row, self.effect.inner)
        except MissingCovariateError as error:
            raise MissingCovariateError(error.name, error.given, self.effect.name) from None

    def weight(self, factors: Sequence[Factor], row: Row) -> Array | float:
        """Return the product of factors; raise `MissingCovariateError` where the row lacks what the effect needs."""
        try:
            return super().weight(factors, row)
        except MissingCovariateError as error:
            raise MissingCovariateError(error.name, error.given, self.effect.name) from None

    def terms(self) -> Terms:
        """Return the terms of the effect's law times its amplitudes."""
        if self.law.joined is not None:
            together = self.law.joined(self.here, self.effect.amplitudes, self.effect.inner)
            return [timed for term in together for timed in _timed(term, self.effect)]
        sized = zip(self.effect.amplitudes, self.law.terms_of(self.here, self.effect.inner), strict=True)
        return [
            amplitude_term
            for value, each in sized
            if value
            for term in each
            for amplitude_term in _timed(term.times(value), self.effect)
        ]

    @cached_property
    def proportional(self) -> bool:
        """Whether the twist is a compliance times the load, at given positions and covariates."""
        terms = self.known_terms
        return terms is not None and all(term.linear and term.loaded for term in terms)

    def compliance_bound(self, ranges: Ranges) -> Array | None:
        """Return zero where the effect does not depend on the load."""
        terms = self.known_terms
        return None if terms is None or any(term.loaded for term in terms) else np.zeros((2, 2))


def _timed(term: Term | Neurons, effect: Effect) -> Terms:
    """Return a term of an effect as it is in rows: at the effect's moments, or by the clock of the rows."""
    over = [factor for factor in term.factors if factor.column == TIME]
    if not over or not (effect.moments or effect.later):
        return [term]
    bare = replace(term, factors=tuple(factor for factor in term.factors if factor.column != TIME))
    if effect.moments:
        moments = np.array(effect.moments)
        return [bare.times(float(np.mean(np.prod([factor.of(moments) for factor in over], axis=0))))]
    terms = []
    for pairs in product(*(factor.later(effect.later) for factor in over)):
        shares, factors = zip(*pairs, strict=True)
        terms.append(bare.times(float(np.prod(shares)), *factors))
    return terms


@dataclass(frozen=True)
class SumOfLaws(Composed):
    """Laws under one load, whose twists add up: a flexure's, if it has one, and what effects add to it.

    The calibration's covariance says how well effects are known.
    """

    laws: tuple[Law, ...]

    def with_laws(self, laws: Sequence[Law]) -> SumOfLaws:
        return SumOfLaws(tuple(laws))

    def shares(self, wrench: Array, row: Row) -> list[tuple[Array, Array]]:
        return [(UNITS, wrench)] * len(self.laws)

    @property
    def parts(self) -> tuple[Law, ...]:
        return tuple(part for law in self.laws for part in law.parts)

    def twist(self, wrench: Array, row: Row) -> Array:
        return sum((law.twist(wrench, row) for law in self.laws[1:]), self.laws[0].twist(wrench, row))

    def tangent(self, wrench: Array, row: Row) -> Array:
        return sum((law.tangent(wrench, row) for law in self.laws[1:]), self.laws[0].tangent(wrench, row))

    def by_effects(self, wrench: Array, row: Row) -> tuple[str, Array]:
        """Return where effects act, and their (..., 6) part of the twist [m, rad]; '' where they have the place alone.

        A flexure's own part is the rest.
        """
        own, *parts = self.laws
        if isinstance(own, BoundTwist):
            return "", np.zeros(wrench.shape)
        sites = [part.effect.location.site for part in parts if isinstance(part, BoundTwist)]
        return sites[0], sum((part.twist(wrench, row) for part in parts), np.zeros(wrench.shape))


def with_twists(flexures: Sequence[Flexure], effects: Sequence[Effect], robot: Robot) -> tuple[Flexure, ...]:
    """Return the flexures as they are with effects: laws extended, and a flexure of its own where there was none."""
    modelled = list(flexures)
    bound: dict[str, list[BoundTwist]] = {}
    for effect in effects:
        if effect.law.act is Act.TWIST and not effect.law.changes_model:
            here = resolve(effect.location, robot, flexures)
            bound.setdefault(effect.location.site, []).append(BoundTwist(effect, here))
    for site, parts in bound.items():
        place = site_of(site, robot)
        at_place = [i for i, flexure in enumerate(modelled) if same_site(flexure.site, place)]
        if at_place:
            old = modelled[at_place[-1]]
            modelled[at_place[-1]] = replace(old, law=SumOfLaws((old.law, *parts)))
        else:
            modelled.append(Flexure(f"effects at {site}", place.joint, SumOfLaws(tuple(parts)), place.before))
    return tuple(modelled)


def excess(row: Row, name: str, low: float, high: float) -> Array:
    """Return by how much of a range from low to high a column is beyond it, below zero where it is within."""
    values = row.column(name)
    return np.maximum(low - values, values - high) / max(high - low, 1e-9 * max(abs(low), abs(high)), 1e-300)


def beyond_seen(effects: Sequence[Effect], row: Row) -> dict[int, list[Flag]]:
    """Return flags about the rows in which columns are beyond those that effects were found in, by the row's number.

    Args:
        effects: Of the arm.
        row: One row, numbered 0, or N rows.
    """
    flags_of: dict[int, list[Flag]] = {}
    for effect in effects:
        for name, low, high in effect.ranges:
            values, size = np.atleast_1d(row.column(name)), np.atleast_1d(excess(row, name, low, high))
            # Part of the range in which an effect was found, by which a column may be beyond it and nothing is said
            for i in np.flatnonzero(size > 0.05).tolist():
                text = f"{name} = {values[i]:.4g} is outside the {low:.4g} to {high:.4g} it was found in"
                text += "" if effect.law.physical else ", where it is no law: the arm without it may be nearer there"
                flag = Flag("extrapolating", f"{effect.title}: {text}", f"{effect.title} {name}", float(size[i]))
                flags_of.setdefault(i, []).append(flag)
    return flags_of


@dataclass(frozen=True)
class Pulling:
    """A load effect as an arm carries it."""

    frame: str
    law: LoadLaw
    here: Here
    amplitudes: Values
    inner: Values

    dead = follows = False
    sizes = (np.inf, np.inf)

    def at(self, pose: Array) -> Array:
        """Return the (..., 6) wrench at the link's origin [N, Nm], base axes, for (..., 4, 4) poses of it."""
        return np.array(self.amplitudes) @ self.law.pull(self.here, pose, self.inner)

    def change(self, pose: Array) -> Array:
        """Return the (..., 6, 6) change per motion of the link [m, rad], by central differences."""
        ends = [self.at(_moved(pose, side * MOVE)) for side in (1.0, -1.0)]
        return np.swapaxes((ends[0] - ends[1]) / (2.0 * MOVE), -1, -2)


MOVE = 1e-6


def _moved(pose: Array, size: float) -> Array:
    """Return (..., 6, 4, 4) poses after a small step along each axis and about it, base axes."""
    moved = np.repeat(pose[..., None, :, :], 6, axis=-3)
    for axis, unit in enumerate(np.eye(3)):
        moved[..., axis, axis, 3] += size
        moved[..., 3 + axis, :3, :3] += size * pin.skew(unit) @ pose[..., :3, :3]
    return moved


def pulling(effects: Sequence[Effect], robot: Robot) -> tuple[Pulling, ...]:
    """Return the loads that effects put on links."""
    return tuple(
        Pulling(
            link_of(effect.location.site, robot),
            cast(LoadLaw, effect.law),
            resolve(effect.location, robot, ()),
            effect.amplitudes,
            effect.inner,
        )
        for effect in effects
        if effect.law.act is Act.LOAD and not effect.law.changes_model
    )


def bending(effects: Sequence[Effect], row: Row, count: int) -> Array:
    """Return (N, 2) or (1, 2) by how much effects bend lines of sight in N rows; see `Postures.bend`."""
    bends = [effect.law.bend(effect, row) for effect in effects if isinstance(effect.law, SightLaw)]
    return np.zeros((1, 2)) + sum(np.broadcast_to(bend, (count, 2)) for bend in bends)


def remembers(arm: Manipulator) -> bool:
    """Return whether an arm has effects whose state depends on all the rows before."""
    return any(effect.law.memory for effect in arm.effects)


def depended_on(arm: Manipulator) -> tuple[str, ...]:
    """Return the names of all covariates that an arm's effects ask for; joint positions are known without."""
    names: dict[str, None] = {}
    for effect in arm.effects:
        names |= dict.fromkeys(name for name in effect.location.covariates if not name.startswith("q_"))
        if effect.state:
            names[effect.state] = None
    return tuple(names)


OF_TIME = ("as_left", "begins_anew", "clock_unknown")
"""Codes of the flags of `about_time`."""

OWN_CLOCK = "rows of its campaign's own clock: --as-in CAMPAIGN.csv, or dates in 'time'"


def about_time(
    arm: Manipulator, given: Iterable[str], time: Array | None = None, dated: bool = False
) -> tuple[Flag, ...]:
    """Return flags about an arm whose effects depend on time, where that changes what it does.

    Args:
        arm: The arm.
        given: Names of what is known of the rows.
        time: (N,) their own time [s], None where they have none.
        dated: Whether it is known how that is to the campaigns of the arm, so that steps are as they were then.
    """
    left, anew, unknown, given = list[str](), list[str](), list[str](), set(given)
    for effect in arm.effects:
        if effect.moments and effect.law.afterwards is not Afterwards.STAYS:
            left.append(f"{effect.title} is not carried on, which widens sigma")
        elif effect.moments and not dated and _changes(effect, arm, time):
            left.append(f"{effect.title} stays")
        elif effect.of_time and not effect.moments and (effect.span is None or not arm.clock):
            unknown.append(effect.title)
        if HOLD in effect.location.covariates and HOLD not in given:
            anew.append(f"{effect.title} without a column {HOLD!r}: its load has just been put on")
        elif effect.remembers and not effect.law.remembers_load(effect.location) and TIME not in given:
            anew.append(f"{effect.title} without a column {TIME!r}: it has settled")
    flags = []
    if left:
        flags.append(Flag("as_left", f"the arm is meant as it was left: {listing(left, 4)} ({OWN_CLOCK})"))
    if anew:
        flags.append(Flag("begins_anew", listing(anew, 4)))
    if unknown:
        text = (
            f"the arm file does not say when {listing(unknown, 4)} was found: {TIME!r} of the rows counts as its clock"
        )
        flags.append(Flag("clock_unknown", text))
    return tuple(flags)


def _changes(effect: Effect, arm: Manipulator, time: Array | None) -> bool:
    """Return whether a step would be another one at (N,) times of its campaign's clock than as it was left."""
    if time is None:
        return True
    terms = cast(TwistLaw, effect.law).terms(resolve(effect.location, arm.robot, arm.flexures), effect.inner)
    over = {factor for each in terms for term in each for factor in term.factors if factor.column == TIME}
    return any((factor.of(time) != factor.of(np.array(effect.moments[0]))).any() for factor in over)


def check_covariates(arm: Manipulator, given: Iterable[str]) -> None:
    """Raise `InputError` where somebody names a covariate that no effect of the arm depends on."""
    columns = depended_on(arm)
    for name in given:
        if name not in columns:
            hint = did_you_mean(name, columns)
            raise InputError(f"no effect of this arm depends on {name!r}{hint} (they depend on: {listing(columns)})")


def check_approaches(values: Mapping[str, float], joints: Sequence[str]) -> None:
    """Raise `InputError` where an `approach_<joint>` is of no joint, or is not -1, 0 or 1."""
    columns = [f"{APPROACH}{joint}" for joint in joints]
    for name, value in values.items():
        if not name.startswith(APPROACH):
            continue
        if name not in columns:
            raise InputError(f"no covariate {name!r}{did_you_mean(name, columns)} (known: {listing(columns)})")
        if value not in (-1.0, 0.0, 1.0):
            raise InputError(f"{name} is {value:g}, not -1, 0 or 1")


def derived_directions(arm: Manipulator, rows: Rows, asked: np.ndarray) -> tuple[Flag, ...]:
    """Return a flag for every direction that effects depend on and that follows from the order of the rows.

    Args:
        arm: The arm with its effects.
        rows: All rows in the order driven.
        asked: Numbers of the rows whose answers count.

    Raises:
        MissingCovariateError: No row before an asked one says where a joint came from, and the effect that asks was
            not found in rows like these; see `Effect.derived`.
    """
    flags: dict[str, Flag] = {}
    for name, asker, unclear in directions(arm.effects, rows):
        unknown = asked[unclear[asked]]
        if len(unknown) and name not in asker.derived:
            with naming(rows.places[unknown[0]] if rows.places else f"row {unknown[0]}"):
                remedy = ": no row before moves that joint. Give the column, of -1, 0 or 1, or rows that drive there"
                raise MissingCovariateError(name, sorted(set(rows.known) - set(rows.derived)), asker.name, remedy)
        flags[name] = derived_direction(name, len(unknown))
    return tuple(flags.values())


def derived_direction(name: str, unclear: int) -> Flag:
    """Return the flag about a direction that no column gives and some rows leave open."""
    text = f"{name} is not given: taken from how the rows before moved the joint"
    if unclear:
        rows = "row does not determine it, and is" if unclear == 1 else "rows do not determine it, and are"
        text += f"; {unclear} {rows} taken as halfway"
    return Flag("approach_derived", text)


def without_direction(effects: Iterable[Effect], rows: Rows) -> np.ndarray:
    """Return (N,) rows in which no row before says a direction that an effect depends on: it counts as none."""
    return np.any([np.zeros(len(rows), dtype=bool), *(unclear for _, _, unclear in directions(effects, rows))], axis=0)


def directions(effects: Iterable[Effect], rows: Rows) -> Iterator[tuple[str, Effect, np.ndarray]]:
    """Yield every direction that was not recorded, the effect that asks for it, and (N,) where it stays open."""
    columns = {f"{APPROACH}{joint}": i for i, joint in enumerate(rows.joint_names)}
    for effect in effects:
        for name in effect.location.covariates:
            if name in columns and name in rows.derived:
                yield name, effect, rows.approach[:, columns[name]] == 0.0


def settled_covariates(arm: Manipulator, given: Mapping[str, float]) -> dict[str, float]:
    """Return covariates of a single configuration, lagged columns taken as settled where they are not given.

    Raises:
        InputError: No effect depends on one of them, or an `approach_<joint>` is no direction of a joint.
        MissingCovariateError: Such a column is not given either.
    """
    if given:
        check_approaches(given, arm.robot.joint_names)
        check_covariates(arm, given)
    return {**begun_anew(arm, {}, 0.0), **settled(arm, given)}


def settled(arm: Manipulator, known: Mapping[str, Known]) -> dict[str, Known]:
    """Return what is known with columns that lag, taken as settled where they are not given.

    Raises:
        MissingCovariateError: Such a column is not given either.
    """
    columns = dict(known)
    for effect in arm.effects:
        state, own = effect.state, effect.location.covariates
        if state is None or not own or state in columns:
            continue
        if own[0] not in columns:
            raise MissingCovariateError(own[0], known, effect.name)
        columns[state] = columns[own[0]]
    return columns
