"""What a plan is asked for, checked, and what may be asked of the arm for it."""

from __future__ import annotations

import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from armflex.arm import Arm
from armflex.configurations import drawn_range
from armflex.conventions import Array
from armflex.errors import Flag, InputError, did_you_mean, listing
from armflex.laws.effects.effect import Effect
from armflex.laws.effects.scene import TEMPERATURE
from armflex.measured.measurements import Measurements
from armflex.plan.design_model import Before
from armflex.plan.offer import Reach
from armflex.plan.rivals import needed
from armflex.trajectory import Trajectory

MOST_ROWS = 500

COARSEST = 0.01
"""Standard deviation of a position read, as a share of the arm's reach, beyond which it is no measurement."""

READING = 2e-4
"""Standard deviation of a position read [m] where nobody says: a laser tracker some metres away."""


@dataclass(frozen=True)
class Question:
    """What `plan` was asked, but for the arm; see there."""

    rows: int
    along: Trajectory | None
    between: tuple[str, str] | None
    payloads: Sequence[str] | None
    covariates: Mapping[str, Sequence[float]]
    sigma: float | None
    floor: float
    seed: int


def check(asked: Question) -> None:
    """Raise `InputError` where a number is out of its range, or two goals are asked for."""
    try:
        count = operator.index(asked.rows)
    except TypeError:
        raise InputError(f"rows is {asked.rows!r}, expected a whole number") from None
    if not 1 <= count <= MOST_ROWS:
        raise InputError(f"rows is {count}, expected 1 to {MOST_ROWS}")
    if asked.along is not None and asked.between:
        raise InputError("a plan is for a trajectory or for two effects, not for both")
    if asked.sigma is not None and not 0.0 < asked.sigma < np.inf:
        raise InputError(f"sigma is {asked.sigma:g} m, expected more than 0")
    if np.isnan(asked.floor):
        raise InputError("floor is not a number")
    for name, values in asked.covariates.items():
        if not len(values) or not np.isfinite(values).all():
            raise InputError(f"covariate {name!r}: expected the values that can be set, got {list(values)}")


def reach_of(before: Before, asked: Question, effects: Sequence[Effect]) -> tuple[Reach, tuple[Flag, ...]]:
    """Return what may be asked of the arm, and doubts."""
    arm = before.setup.arm
    columns = _columns(arm, asked, effects)
    lower, upper, doubts = drawn_range(arm)
    approached = [name for name in arm.joint_names if f"approach_{name}" in columns]
    levels = {name: tuple(float(x) for x in dict.fromkeys(values)) for name, values in asked.covariates.items()}
    kept = [effect.title for effect in arm.effects if effect.remembers]
    if kept:
        text = f"{listing(kept)} depends on the rows before: kept as it is, where it settles"
        doubts = (*doubts, Flag("memory_settled", text))
    session = _new_session(before.campaign)
    payloads = _payloads(arm, asked.payloads)
    sigma = sigma_of(before, asked.sigma)
    if sigma.max() > COARSEST * arm.robot.reach:
        text = f"sigma is {sigma.max():.3g} m, more than {COARSEST:.0%} of the arm's reach of {arm.robot.reach:.3g} m"
        raise InputError(f"{text}: is it in another unit?")
    return Reach(arm, lower, upper, payloads, tuple(approached), levels, session, sigma, asked.floor), doubts


def _columns(arm: Arm, asked: Question, effects: Sequence[Effect]) -> tuple[str, ...]:
    """Return the columns that effects depend on, and raise where values for one are missing, or given for no one."""
    every = (*arm.effects, *effects)
    columns = needed(every)
    settable = [name for name in columns if not name.startswith("approach_")]
    for name in asked.covariates:
        if name not in settable:
            hint = did_you_mean(name, settable)
            raise InputError(f"no effect depends on {name!r}{hint} (values can be set of: {listing(settable)})")
    for effect in every:
        for name in needed([effect]):
            if name not in asked.covariates and not name.startswith("approach_"):
                example = "10,35" if TEMPERATURE.search(name) else "LOW,HIGH"
                text = f"{effect.title} depends on {name!r}: give values of it that can be set"
                raise InputError(f"{text}, such as --covariates {name}={example}")
    return columns


def _new_session(campaign: Measurements | None) -> str:
    known = () if campaign is None else campaign.session
    name = "planned"
    while name in known:
        name += "'"
    return name


def _payloads(arm: Arm, names: Sequence[str] | None) -> tuple[str, ...]:
    """Return what may be carried: where nobody says, all that is declared, and nothing where none of it is nothing."""
    if names is not None:
        if not names or len(set(names)) < len(names):
            raise InputError(f"payloads {list(names)}: expected one name or several different ones")
        for name in names:
            arm.payload(name)
        return tuple(names)
    empty = any(payload.mass == 0.0 for payload in arm.payloads.values())
    return (*arm.payloads, *(() if empty else ("none",)))


def sigma_of(before: Before, sigma: float | None) -> Array:
    """Return (3,) the standard deviation of a position read [m]: as asked, as was found, or that of a tracker."""
    if sigma is not None:
        return np.full(3, sigma)
    if before.campaign is None:
        return np.full(3, READING)
    return before.noise * np.median(before.campaign.sigma[before.campaign.measured], axis=0)
