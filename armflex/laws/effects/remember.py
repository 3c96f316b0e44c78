"""What effects depend on: the columns that they ask for, and directions that the order of the rows must tell."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from armflex.errors import Flag, InputError, MissingCovariateError, did_you_mean, listing, naming
from armflex.laws.effects.effect import Effect, Manipulator
from armflex.rows import Rows
from armflex.rows.rows import APPROACH


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


def check_covariates(arm: Manipulator, given: Iterable[str]) -> None:
    """Raise `InputError` where somebody names a covariate that no effect of the arm depends on."""
    known = depended_on(arm)
    for name in given:
        if name not in known:
            hint = did_you_mean(name, known)
            raise InputError(f"no effect of this arm depends on {name!r}{hint} (they depend on: {listing(known)})")


def check_approaches(values: Mapping[str, float], joints: Sequence[str]) -> None:
    """Raise `InputError` where an `approach_<joint>` is of no joint, or is not -1, 0 or 1."""
    known = [f"{APPROACH}{joint}" for joint in joints]
    for name, value in values.items():
        if not name.startswith(APPROACH):
            continue
        if name not in known:
            raise InputError(f"no covariate {name!r}{did_you_mean(name, known)} (known: {listing(known)})")
        if value not in (-1.0, 0.0, 1.0):
            raise InputError(f"{name} is {value:g}, not -1, 0 or 1")


def derived_directions(arm: Manipulator, rows: Rows, asked: np.ndarray) -> tuple[Flag, ...]:
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
    """Return the flag about a direction that no column gives and some rows do not tell."""
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
        for name in effect.location.covariates:
            if name in columns and name in rows.derived:
                yield name, effect, rows.approach[:, columns[name]] == 0.0


def settled(arm: Manipulator, given: Mapping[str, float]) -> dict[str, float]:
    """Return covariates of a single configuration, lagged columns taken as settled where they are not given.

    Raises:
        InputError: No effect depends on one of them, or an `approach_<joint>` is no direction of a joint.
        MissingCovariateError: Such a column is not given either.
    """
    if given:
        check_approaches(given, arm.robot.joint_names)
        check_covariates(arm, given)
    known = dict(given)
    for effect in arm.effects:
        state, columns = effect.state, effect.location.covariates
        if state is None or not columns:
            continue
        if state not in known and columns[0] not in known:
            raise MissingCovariateError(columns[0], given, effect.name)
        known.setdefault(state, known.get(columns[0], 0.0))
    return known
