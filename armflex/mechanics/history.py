"""What a row knows because of the rows before it: lagged temperatures, play, by the names that effects ask for."""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.errors import MissingCovariateError, did_you_mean
from armflex.laws import Row
from armflex.laws.effects.context import known_columns
from armflex.laws.effects.effect import Effect
from armflex.laws.effects.in_arm import settled
from armflex.laws.effects.location import resolve
from armflex.mechanics.deflection import Asked, Deflection, deflect_batch
from armflex.mechanics.loaded import NO_PAYLOAD, Payload, Structure
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
    effects = [effect for effect in arm.effects if effect.state not in (None, *known)]
    if not effects:
        return known
    motion = [rows.motion(i) for i in range(len(rows.q))]
    rates = ([each.get(name) for each in motion] for name in ("v", "a"))
    v, a = (np.array(values) if values and values[0] is not None else None for values in rates)
    pieces = tuple(rows.pieces.values()) if isinstance(rows, Rows) else ()
    case = LoadCase(rows.q, v, a, tuple(rows.wrenches), known)
    return known | _states(arm, rows.payload, case, effects, pieces, gravity)


def known_alone(arm: Structure, payload: str | Payload | Sequence[str] | None, case: LoadCase) -> dict[str, Array]:
    """Return what is known in (nq,) or (N, nq) positions that nothing went before, with the states of effects.

    Each load is put on once, from nothing, and what follows a temperature has settled.

    Raises:
        MissingCovariateError: An effect with a memory needs a column that is not there, or its state is misspelt.
    """
    known = set(case.covariates)
    unasked = sorted(known - {name for effect in arm.effects for name in effect.location.covariates})
    for effect in remembering(arm, known):
        if known.issuperset(effect.location.covariates) and did_you_mean(str(effect.state), unasked):
            raise MissingCovariateError(str(effect.state), case.covariates, effect.name)
    given = settled(arm, case.covariates)
    if not (effects := remembering(arm, given)):
        return given
    single, count = case.q.ndim == 1, len(np.atleast_2d(case.q))
    columns = {name: np.broadcast_to(values, (count,)) for name, values in given.items()}
    v, a = (None if values is None else np.atleast_2d(values) for values in (case.v, case.a))
    payloads = (NO_PAYLOAD if payload is None else payload,) if isinstance(payload, str | Payload | None) else payload
    apart = tuple(np.arange(count)[:, None])
    rows = LoadCase(np.atleast_2d(case.q), v, a, case.wrenches, columns)
    states = _states(arm, payloads, rows, effects, apart, None)
    return {**given, **{name: values[0] if single else values for name, values in states.items()}}


def remembering(arm: Structure, known: Container[str]) -> list[Effect]:
    """Return the effects that remember a state that is not known."""
    return [effect for effect in arm.effects if effect.remembers and str(effect.state) not in known]


def _states(
    arm: Structure,
    payloads: Sequence[str | Payload],
    case: LoadCase,
    effects: Sequence[Effect],
    pieces: Sequence[np.ndarray],
    gravity: Array | None,
) -> dict[str, Array]:
    """Return the (N,) states that effects remember in rows, in each of some pieces as if nothing had gone before."""
    row, states = Row(case.q, arm.joint_index, case.covariates), dict[str, Array]()
    wrenches = _wrenches(arm, payloads, case, effects, gravity)
    for effect in effects:
        here = resolve(effect.location, arm.robot, arm.flexures)
        try:
            assert effect.law.memory is not None and effect.state is not None
            load = wrenches[effect.location.site]
            states[effect.state] = effect.law.memory.over(pieces, here, load, row, effect.inner)
        except MissingCovariateError as error:
            raise MissingCovariateError(error.name, error.given, effect.name) from None
    return states


def _wrenches(
    arm: Structure,
    payloads: Sequence[str | Payload],
    case: LoadCase,
    effects: Sequence[Effect],
    gravity: Array | None,
) -> dict[str, Array]:
    """Return (N, 6) loads at the sites of effects that remember loads, as they are without those effects."""
    loads = {effect.location.site: np.zeros((len(case.q), 6)) for effect in effects}
    loaded = [effect.location.site for effect in effects if effect.law.remembers_load(effect.location)]
    if not loaded:
        return loads
    # What a small effect does to the load that it remembers is of second order.
    as_dataclass: Any = arm
    plain = replace(as_dataclass, effects=tuple(effect for effect in arm.effects if effect not in effects))
    if not case.moves:
        asked: dict[str, Any] = {"allow_large": True, "gravity": gravity, "ask": ("wrenches",)}
        line = respond(plain, case.q, payloads, case.covariates, wrenches=case.wrenches, **asked)
        return loads | {site: line.load_at(site) for site in loaded}
    pulled = tuple(wrench.under(arm.robot.gravity) for wrench in case.wrenches)
    together: Any = payloads if len(payloads) > 1 else payloads[0]
    solved = deflect_batch(
        plain, together, case._replace(wrenches=pulled), Asked(enforce_limits=False, allow_large=True)
    )
    deflections = [solved.row(i) for i in range(len(case.q))]
    return loads | {site: np.array([_load_beyond(each, plain, site) for each in deflections]) for site in loaded}


def _load_beyond(found: Deflection, arm: Structure, joint: str) -> Array:
    """Return the (6,) wrench just outboard of a joint's flexures, where effects act."""
    load = pin.Force(found.joint_loads[arm.joint_names.index(joint)])
    for site, twist in zip(arm.sites, found.twists, strict=True):
        if site.joint == joint and not site.before:
            load = pin.exp6(pin.Motion(twist)).actInv(load)
    return load.vector
