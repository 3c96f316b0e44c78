"""What a row knows because of the rows before it: lagged temperatures, play, by the names that effects ask for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from armflex.conventions import Array
from armflex.effects.law import Effect, TwistLaw
from armflex.effects.scene import known_columns
from armflex.effects.spot import resolve
from armflex.laws import Row

if TYPE_CHECKING:
    from armflex.arm import Arm
    from armflex.measurements import Measurements


def known_rows(arm: Arm, measurements: Measurements) -> dict[str, Array]:
    """Return every (N,) column of a campaign by name, with the states that the arm's effects remember.

    Raises:
        MissingCovariateError: An effect with a memory needs a column that was not recorded.
    """
    known = known_columns(measurements, arm)
    remembering = [effect for effect in arm.effects if isinstance(effect.law, TwistLaw) and effect.law.memory]
    if not remembering:
        return known
    index = {name: i for i, name in enumerate(measurements.joint_names)}
    row = Row(measurements.q, index, known)
    wrenches = _wrenches(arm, measurements, known, remembering)
    for effect in remembering:
        memory = effect.law.memory
        here = resolve(effect.spot, arm.robot, arm.flexures)
        known[memory.name(effect.spot)] = memory.remember(here, wrenches[effect.spot.site], row, effect.inner)
    return known


def _wrenches(
    arm: Arm, measurements: Measurements, known: Mapping[str, Array], effects: list[Effect]
) -> dict[str, Array]:
    """Return (N, 6) loads at the sites of effects that remember loads, as they are without those effects."""
    count, nothing = len(measurements), np.zeros((len(measurements), 6))
    found = {effect.spot.site: nothing for effect in effects}
    loaded = [effect.spot.site for effect in effects if not effect.spot.covariates]
    if loaded:
        # What a small effect does to the load that it remembers is of second order.
        plain = replace(arm, effects=tuple(effect for effect in arm.effects if effect not in effects))
        columns = [{name: values[i] for name, values in known.items()} for i in range(count)]
        solved = [
            plain.deflection(q, payload, covariates=given, enforce_limits=False, allow_large=True).joint_loads
            for q, payload, given in zip(measurements.q, measurements.payload, columns, strict=True)
        ]
        loads = np.array(solved)
        found |= {site: loads[:, arm.joint_names.index(site)] for site in loaded}
    return found
