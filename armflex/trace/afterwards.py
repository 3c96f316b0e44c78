"""What could not be told: effects that calibration hides, the least that would have shown, and what is left."""

from __future__ import annotations

import numpy as np
from scipy.special import fdtrc

from armflex.conventions import TWIST_NAMES
from armflex.estimate.view import position_rms
from armflex.measured.repeats import repeats
from armflex.parameters import ArmParameter
from armflex.trace.candidates import Bank
from armflex.trace.findings import Smallest, Unexplained, Unidentifiable, predictable_residual
from armflex.trace.localise import NOTICED, RandomTwist
from armflex.trace.search import Round
from armflex.trace.state import State

ALMOST = 1e-4
"""Share of a column's square below which what is left of it cannot be seen at any plausible size."""

SHOWN = 23.0
"""Gain at which an effect would have been accepted among thousands of candidates."""

STILL = 1e-12
"""Share of what an amplitude of 1 does to the readings at the place where it does most, below which it is rounding."""

UNLIKELY = 1e-4
"""Probability below which a residual larger than the repeats' scatter is no chance."""

LARGER = 2.0
"""Variance over that of repeats from which a residual without a place is told at all."""

AS_LIKELY = 3.0
"""Log-likelihood within which places are not told apart."""


def not_identifiable(looked: Round, state: State) -> tuple[Unidentifiable, ...]:
    """Return laws and sites of which fitted parameters take over all but nothing, with the parameter that does most."""
    bank, projection = looked.named.bank, looked.projection
    whole, inside = _left_over(looked)
    sizes = np.sqrt((projection.columns**2).sum(axis=0))
    found: dict[tuple[str, str], Unidentifiable] = {}
    added = {(block.effect.law.name, block.effect.location) for block in state.effects}
    for index, candidate in enumerate(bank.candidates):
        key = (candidate.law.name, candidate.location.place)
        if key in found or bank.sizes[index] != 1 or (candidate.law.name, candidate.location) in added:
            continue
        if whole[index] > 0.0 and inside[index] > ALMOST * whole[index]:
            continue
        still = whole[index] <= 0.0
        partner = None if still else _partner(bank.group(index)[:, 0], projection.columns, sizes, state)
        found[key] = Unidentifiable(*key, partner)
    return tuple(found.values())


def _partner(column: np.ndarray, columns: np.ndarray, sizes: np.ndarray, state: State) -> ArmParameter:
    """Return the fitted parameter whose column is most like one."""
    likeness = np.abs(columns.T @ column) / (np.maximum(sizes, 1e-300) * float(np.linalg.norm(column)))
    return state.fit.parameters[int(likeness.argmax())]


def smallest(looked: Round, state: State) -> tuple[Smallest, ...]:
    """Return for every law the range over its places of the tip motion (RMS) that would just have been accepted."""
    bank = looked.named.bank
    noise = max(1.0, looked.projection.objective / looked.projection.count)
    found: dict[str, list[float]] = {}
    single = np.flatnonzero(bank.sizes == 1)
    whole, inside = _left_over(looked)
    raw = _raw_rms(bank, state)
    for index in single:
        if inside[index] > ALMOST * whole[index]:
            size = float(np.sqrt(SHOWN * noise / inside[index]) * raw[index])
            found.setdefault(bank.candidates[index].law.name, []).append(size)
    return tuple(Smallest(name, min(sizes), max(sizes)) for name, sizes in found.items())


def _left_over(looked: Round) -> tuple[np.ndarray, np.ndarray]:
    """Return the (G,) squares of the first column of every named candidate, and what the fit leaves of them.

    Both are zero where a column is only rounding: an axis through the target moves it by 1e-17, not by nothing.
    """
    named = looked.sifted[0]
    whole, most = np.zeros(len(named.bank.candidates)), {}
    for groups, squares in named.squares:
        whole[groups] = squares[:, 0, 0]
    alike = [
        (one.law.name, one.location.turns, one.location.terms) for one in named.bank.candidates
    ]  # of the same units
    for kind, square in zip(alike, whole.tolist(), strict=True):
        most[kind] = max(square, most.get(kind, 0.0))
    moves = whole > STILL**2 * np.array([most[kind] for kind in alike])
    inside = whole - (named.seen[named.bank.starts[:-1]] ** 2).sum(axis=1)
    return np.where(moves, whole, 0.0), np.where(moves, inside, 0.0)


def _raw_rms(bank: Bank, state: State) -> np.ndarray:
    """Return the (G,) RMS of the 3-D motion of the target per unit of each group's first amplitude [m]."""
    fit, sizes = state.fit, np.zeros(len(bank.candidates))
    where = fit.view.positions
    scale = fit.view.sigma[:, where] / np.sqrt(fit.weights)[:, None]
    for part in bank.parts:
        first = np.isin(part.places, bank.starts[:-1])
        columns = part.columns[:, first].reshape(*fit.view.sigma.shape, -1)[:, where] * scale[:, :, None]
        sizes[part.groups] = np.sqrt((columns**2).sum(axis=1).mean(axis=0))
    return sizes


def unexplained(state: State, places: tuple[RandomTwist, ...]) -> Unexplained | None:
    """Return what is left above the noise without a cause, None when nothing is.

    Args:
        state: The final fit.
        places: Where a random twist would explain its residual, the likeliest first.
    """
    if state.random is not None:
        random = state.random
        left = predictable_residual(state) - state.fit.view.residual
        rms = position_rms(left)
        return Unexplained(random.site, random.axis, random.std, random.units[0], rms, random.alike)
    place = places[0]
    if place.ratio < NOTICED:
        return _beyond_repeats(state)
    unit = "m" if place.axis.startswith("d") else "rad"
    rms = place.std * _lever(state, place)
    return Unexplained(place.site, place.axis, place.std, unit, rms, as_likely(places))


def _beyond_repeats(state: State) -> Unexplained | None:
    """Return a residual without a place where it is larger than what repeats show, by an F test; else None."""
    known = repeats(state.measurements)
    if known is None:
        return None
    scatter, fit = known.same_session, state.fit
    noise = float((scatter.sigma**2).mean())
    squares = fit.view.residual[fit.weights >= 1.0, fit.view.positions] ** 2  # tails make a mean of squares anything
    freedom = max(squares.size - (fit.view.count - fit.freedom), 1.0)
    left = float(squares.sum()) / freedom
    if left < LARGER * noise or fdtrc(freedom, 3 * scatter.freedom, left / noise) > UNLIKELY:
        return None
    return Unexplained(None, None, None, None, float(np.sqrt(3.0 * (left - noise))))


def as_likely(places: tuple[RandomTwist, ...]) -> tuple[RandomTwist, ...]:
    """Return the places that the residual does not tell from the first."""
    return tuple(place for place in places[1:] if place.ratio > places[0].ratio - AS_LIKELY)


def _lever(state: State, place: RandomTwist) -> float:
    columns = state.fit.view.to_twist(place.site)[:, :3, TWIST_NAMES.index(place.axis)]
    return float(np.sqrt((columns**2).sum(axis=1).mean()))
