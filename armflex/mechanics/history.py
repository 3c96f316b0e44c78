"""What a row knows because of the rows before it: lagged temperatures, play, by the names that effects ask for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.errors import MissingCovariateError
from armflex.laws import Row
from armflex.laws.effects.context import known_columns
from armflex.laws.effects.effect import Effect
from armflex.laws.effects.location import resolve
from armflex.mechanics.deflection import Asked, Deflection, deflect_batch
from armflex.mechanics.loaded import Structure
from armflex.mechanics.pinocchio_model import LoadCase
from armflex.mechanics.response import respond
from armflex.rows import Driven, Rows


def known_rows(arm: Structure, rows: Driven, gravity: Array | None = None) -> dict[str, Array]:
    """Return every (N,) column of rows by name, with the states that the arm's effects remember.

    A state that is among the columns already is taken as it is. `gravity` is (N, 3) in base axes [m/s^2] where it is
    not that of the arm in all rows.

    Raises:
        MissingCovariateError: An effect with a memory needs a column that is not there.
    """
    known = known_columns(rows, arm)
    remembering = [effect for effect in arm.effects if effect.state not in (None, *known)]
    if not remembering:
        return known
    row = Row(rows.q, {name: i for i, name in enumerate(rows.joint_names)}, known)
    wrenches = _wrenches(arm, rows, known, remembering, gravity)
    states, pieces = {}, tuple(rows.pieces.values()) if isinstance(rows, Rows) else ()
    for effect in remembering:
        here = resolve(effect.location, arm.robot, arm.flexures)
        try:
            assert effect.law.memory is not None
            load = wrenches[effect.location.site]
            states[effect.state] = effect.law.memory.over(pieces, here, load, row, effect.inner)
        except MissingCovariateError as error:
            raise MissingCovariateError(error.name, error.given, effect.name) from None
    return known | states


def _wrenches(
    arm: Structure, rows: Driven, known: Mapping[str, Array], effects: Sequence[Effect], gravity: Array | None
) -> dict[str, Array]:
    """Return (N, 6) loads at the sites of effects that remember loads, as they are without those effects."""
    found = {effect.location.site: np.zeros((len(rows.q), 6)) for effect in effects}
    loaded = [effect.location.site for effect in effects if effect.law.remembers_load(effect.location)]
    if not loaded:
        return found
    # What a small effect does to the load that it remembers is of second order.
    as_dataclass: Any = arm
    plain = replace(as_dataclass, effects=tuple(effect for effect in arm.effects if effect not in effects))
    motion = [rows.motion(i) for i in range(len(rows.q))]
    if not any(value is not None for one in motion for value in one.values()):
        asked: dict[str, Any] = {"allow_large": True, "gravity": gravity, "ask": ("wrenches",)}
        line = respond(plain, rows.q, rows.payload, known, wrenches=rows.wrenches, **asked)
        return found | {site: line.load_at(site) for site in loaded}
    v, a = (None if motion[0][name] is None else np.array([one[name] for one in motion]) for name in ("v", "a"))
    asked = Asked(enforce_limits=False, allow_large=True)
    pulled = tuple(one.under(arm.robot.gravity) for one in rows.wrenches)
    solved = deflect_batch(plain, rows.payload, LoadCase(rows.q, v, a, pulled, known), asked)
    ones = [solved.row(i) for i in range(len(rows.q))]
    return found | {site: np.array([_load_beyond(one, plain, site) for one in ones]) for site in loaded}


def _load_beyond(found: Deflection, arm: Structure, joint: str) -> Array:
    """Return the (6,) wrench just outboard of a joint's flexures, where effects act."""
    load = pin.Force(found.joint_loads[arm.joint_names.index(joint)])
    for site, twist in zip(arm.sites, found.twists, strict=True):
        if site.joint == joint and not site.before:
            load = pin.exp6(pin.Motion(twist)).actInv(load)
    return load.vector
