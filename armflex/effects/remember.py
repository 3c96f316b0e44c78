"""What a row knows because of the rows before it: lagged temperatures, play, by the names that effects ask for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.effects.law import Effect, TwistLaw
from armflex.effects.scene import Driven, known_columns
from armflex.effects.spot import resolve
from armflex.errors import MissingCovariateError
from armflex.laws import Row

if TYPE_CHECKING:
    from armflex.arm import Arm
    from armflex.deflection import Deflection


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


def settled(arm: Arm, given: Mapping[str, float]) -> dict[str, float]:
    """Return covariates of a single configuration, lagged columns taken as settled where they are not given.

    Raises:
        MissingCovariateError: Such a column is not given either.
    """
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
