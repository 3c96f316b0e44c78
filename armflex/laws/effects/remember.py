"""What a row knows because of the rows before it: lagged temperatures, play, by the names that effects ask for."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.errors import Flag, InputError, MissingCovariateError, did_you_mean, listing, naming
from armflex.laws import Row
from armflex.laws.effects.law import Effect, TwistLaw
from armflex.laws.effects.scene import known_columns
from armflex.laws.effects.spot import resolve
from armflex.rows import Driven, Rows
from armflex.rows.rows import APPROACH

if TYPE_CHECKING:
    from armflex.arm import Arm
    from armflex.mechanics.deflection import Deflection


def known_rows(arm: Arm, rows: Driven) -> dict[str, Array]:
    """Return every (N,) column of rows by name, with the states that the arm's effects remember.

    A state that is among the columns already is taken as it is.

    Raises:
        MissingCovariateError: An effect with a memory needs a column that is not there.
    """
    known = known_columns(rows, arm)
    remembering = [
        effect
        for effect in arm.effects
        if isinstance(effect.law, TwistLaw)
        and effect.law.memory
        and effect.law.memory.name(effect.spot, effect.inner) not in known
    ]
    if not remembering:
        return known
    row = Row(rows.q, {name: i for i, name in enumerate(rows.joint_names)}, known)
    wrenches = _wrenches(arm, rows, known, remembering)
    states = {}
    for effect in remembering:
        memory = effect.law.memory
        here = resolve(effect.spot, arm.robot, arm.flexures)
        try:
            state = memory.remember(here, wrenches[effect.spot.site], row, effect.inner)
        except MissingCovariateError as error:
            raise MissingCovariateError(error.name, error.given, effect.name) from None
        states[memory.name(effect.spot, effect.inner)] = state
    return known | states


def remembers(arm: Arm) -> bool:
    """Return whether an arm has effects whose state depends on all the rows before."""
    return any(isinstance(effect.law, TwistLaw) and effect.law.memory for effect in arm.effects)


def depended_on(arm: Arm) -> tuple[str, ...]:
    """Return the names of all covariates that an arm's effects ask for; joint positions are known without."""
    names: dict[str, None] = {}
    for effect in arm.effects:
        names |= dict.fromkeys(name for name in effect.spot.covariates if not name.startswith("q_"))
        if isinstance(effect.law, TwistLaw) and effect.law.memory:
            names[effect.law.memory.name(effect.spot, effect.inner)] = None
    return tuple(names)


def check_covariates(arm: Arm, given: Iterable[str]) -> None:
    """Raise `InputError` where somebody names a covariate that no effect of the arm depends on."""
    known = depended_on(arm)
    for name in given:
        if name not in known:
            hint = did_you_mean(name, known)
            raise InputError(f"no effect of this arm depends on {name!r}{hint} (they depend on: {listing(known)})")


def derived_directions(arm: Arm, rows: Rows, asked: np.ndarray) -> tuple[Flag, ...]:
    """Return a flag for every direction that effects depend on and the order of the rows must tell.

    Args:
        arm: The arm with its effects.
        rows: All rows in the order driven.
        asked: Numbers of the rows whose answers count.

    Raises:
        MissingCovariateError: No row before an asked one tells where a joint came from, and the effect that asks was
            not found in rows like these; see `Effect.derived`.
    """
    flags: dict[str, Flag] = {}
    for name, asker, untold in directions(arm.effects, rows):
        unknown = asked[untold[asked]]
        if len(unknown) and name not in asker.derived:
            with naming(rows.places[unknown[0]] if rows.places else f"row {unknown[0]}"):
                raise MissingCovariateError(name, sorted(set(rows.known) - set(rows.derived)), asker.name)
        flags[name] = derived_direction(name, len(unknown))
    return tuple(flags.values())


def derived_direction(name: str, untold: int) -> Flag:
    """Return the doubt about a direction that no column gives and some rows do not tell."""
    text = f"{name} is not given: taken from how the rows before moved the joint"
    if untold:
        rows = "row does not tell it, and is" if untold == 1 else "rows do not tell it, and are"
        text += f"; {untold} {rows} taken as halfway"
    return Flag("approach_derived", text)


def without_direction(effects: Iterable[Effect], rows: Rows) -> np.ndarray:
    """Return (N,) rows in which no row before tells a direction that an effect depends on: none is taken for it."""
    return np.any([np.zeros(len(rows), dtype=bool), *(untold for _, _, untold in directions(effects, rows))], axis=0)


def directions(effects: Iterable[Effect], rows: Rows) -> Iterator[tuple[str, Effect, np.ndarray]]:
    """Yield every direction that was not recorded, the effect that asks for it, and (N,) where the rows do not tell."""
    columns = {f"{APPROACH}{joint}": i for i, joint in enumerate(rows.joint_names)}
    for effect in effects:
        for name in effect.spot.covariates:
            if name in columns and name in rows.derived:
                yield name, effect, rows.approach[:, columns[name]] == 0.0


def settled(arm: Arm, given: Mapping[str, float]) -> dict[str, float]:
    """Return covariates of a single configuration, lagged columns taken as settled where they are not given.

    Raises:
        InputError: No effect depends on one of them.
        MissingCovariateError: Such a column is not given either.
    """
    check_covariates(arm, given)
    known = dict(given)
    for effect in arm.effects:
        law, columns = effect.law, effect.spot.covariates
        if not isinstance(law, TwistLaw) or law.memory is None or not columns:
            continue
        state = law.memory.name(effect.spot, effect.inner)
        if state not in known and columns[0] not in known:
            raise MissingCovariateError(columns[0], given, effect.name)
        known.setdefault(state, known.get(columns[0], 0.0))
    return known


def _wrenches(arm: Arm, rows: Driven, known: Mapping[str, Array], effects: list[Effect]) -> dict[str, Array]:
    """Return (N, 6) loads at the sites of effects that remember loads, as they are without those effects."""
    count = len(rows.q)
    found = {effect.spot.site: np.zeros((count, 6)) for effect in effects}
    loaded = [effect.spot.site for effect in effects if not effect.spot.covariates]
    if loaded:
        # What a small effect does to the load that it remembers is of second order.
        plain = replace(arm, effects=tuple(effect for effect in arm.effects if effect not in effects))
        columns = [{name: values[i] for name, values in known.items()} for i in range(count)]
        asked = {"enforce_limits": False, "allow_large": True}
        solved = [
            plain.deflection(rows.q[i], rows.payload[i], covariates=columns[i], **rows.motion(i), **asked)
            for i in range(count)
        ]
        found |= {site: np.array([_load_beyond(one, plain, site) for one in solved]) for site in loaded}
    return found


def _load_beyond(found: Deflection, arm: Arm, joint: str) -> Array:
    """Return the (6,) wrench just outboard of a joint's flexures, where effects act."""
    load = pin.Force(found.joint_loads[arm.joint_names.index(joint)])
    for flexure, twist in zip(arm.modelled, found.twists, strict=True):
        if flexure.joint == joint and not flexure.before:
            load = pin.exp6(pin.Motion(twist)).actInv(load)
    return load.vector
