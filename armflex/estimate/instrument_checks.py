"""Whether what a sensor read is plausible for where it is declared to be, and whether it stayed where it was."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from armflex.conventions import said_of
from armflex.errors import ConventionError, Flag
from armflex.estimate.block import Block, parameters_of
from armflex.estimate.fit import Fit
from armflex.estimate.held_out import near
from armflex.estimate.view import View
from armflex.linear_gaussian import LinearGaussian
from armflex.measured.measurements import Measurements
from armflex.parameters import ParameterKind
from armflex.readings.chance import chi_squared

COARSE = {"m": 2e-3, "rad": 1e-3, "m/s^2": 1e-2}
"""What an arm may be off by, beyond its priors, before a sensor is suspected."""

IMPLAUSIBLE = 3.0
"""Typical reading, in standard deviations of all that is open, from which something else is wrong."""

BY_CHANCE = 1e-4
"""Probability at which a sensor that stayed seems to have moved, over all rows at which it may have."""

MOST_SPLITS = 100

FAR = 1.0
"""Prior standard deviation of how far a sensor was moved, in the units of its nuisances: what is not told stays."""


def suspected(
    declared: View, placed: Fit, blocks: tuple[Block, ...], otherwise: Callable[[], tuple[str, ...]]
) -> tuple[Flag, ...]:
    """Return flags about sensors whose readings are far off all that [prior] explains.

    Args:
        declared: The rows as everything is declared.
        placed: The fit of where instruments stand.
        blocks: All that is free.
        otherwise: Says in which other conventions of the arm and of its joints all readings are plausible.

    Raises:
        ConventionError: What they read is plausible in another unit, with other axes, from another place, or otherwise.
    """
    flags, places, free = [], declared.readings.placed, parameters_of(blocks)
    known, close = dict(zip(placed.parameters, placed.values.tolist(), strict=True)), near(placed.view)
    for kind, place in places:
        read = np.flatnonzero(np.isfinite(kind.sigma).all(axis=1))
        if not kind.name or not len(read):
            continue
        some = read[close[read, place].all(axis=1)]  # a lost beam says nothing about where an instrument is
        floor = np.maximum(kind.sigma[some], COARSE[kind.unit])
        residual = placed.view.residual[some, place] / floor
        jacobian = np.concatenate([block.jacobian(placed.view)[some, place] for block in blocks], axis=2)
        flat = (jacobian / floor[:, :, None]).reshape(residual.size, -1)
        prior = np.concatenate([block.prior for block in blocks])
        # Where instruments were placed alone they may have made up for the arm: all of it counts from what is declared.
        begun = np.array([known.get(one, 0.0) for one in free])
        values = LinearGaussian.of(flat, prior**-2.0).solve(flat.T @ residual.ravel() - prior**-2.0 * begun)
        left = np.abs(residual - (flat @ values).reshape(residual.shape))
        own = [i for i, one in enumerate(free) if one.group.kind is ParameterKind.SENSOR and np.isfinite(prior[i])]
        pulled = float(np.abs((values + begun)[own] / prior[own]).max(initial=0.0))
        if max(float(np.median(left)), pulled / IMPLAUSIBLE) < IMPLAUSIBLE:
            continue
        own, at = kind.some(read), declared.at.some(read)
        off = said_of(float(np.median(np.linalg.norm(own.residual(at), axis=1))), kind.unit)
        said = f"{kind.title}: what it read is {off} off, further than its declaration and [prior] explain"
        likely = own.implausible(at)
        if likely is None:
            place = own.elsewhere(at)
            reasons = (*(() if place is None else (place,)), *otherwise())
        else:
            reasons = (likely,)
        if reasons:
            raise ConventionError(f"{said}: {'; or '.join(reasons)}", reasons)
        flags.append(Flag("instrument_implausible", f"{said}: is it where [instrument.{kind.name}] says?"))
    return tuple(flags)


def moved(found: Fit, measurements: Measurements) -> Iterator[Flag]:
    """Yield flags about sensors that read otherwise from some row of a session on, as if they had been moved there.

    With X the change of the readings from a row on by all that may be open of a sensor, fitted beside everything else
    that is free, the sum of squares S falls by s'(X'X - W'W)^-1 s (see `linear_gaussian`); n log S is chi-squared.
    """
    whole, scale = found.residual @ found.residual, np.sqrt(found.weights) / found.view.sigma
    sessions, root = np.array(found.view.sessions), LinearGaussian(found.told).with_precision(found.precision).root
    for kind, place in found.view.readings.placed:
        if not kind.name:
            continue
        own = (kind.by_own(found.view.at) * scale[:, place, None])[:, :, found.view.arm.sensors[kind.name].movable]
        size, best = own.shape[2], (0.0, 0)
        if not size:
            continue
        starts = []
        for session in dict.fromkeys(found.view.sessions):
            read = np.flatnonzero(np.isfinite(kind.sigma).all(axis=1) & (sessions == session))
            least = size + 2
            starts += [(first, read) for first in read[least:-least][:: max(1, len(read) // MOST_SPLITS)].tolist()]
        for first, read in starts:
            after = np.zeros((*found.weights.shape, size))
            rows = read[read >= first]
            after[rows, place] = own[rows]
            flat = after.reshape(-1, size)
            into = root.T @ (found.regressors.T @ flat)
            score = flat.T @ found.residual
            left = flat.T @ flat - into.T @ into
            known = LinearGaussian(0.5 * (left + left.T)).with_precision(np.full(size, FAR**-2.0))
            gain = float(score @ known.solve(score))
            best = max(best, (gain, first))
        gain, first = best
        ratio = found.freedom * float(np.log(whole / max(whole - gain, 1e-12 * whole)))
        if starts and ratio > chi_squared(size, BY_CHANCE / len(starts)):
            row = int(found.view.rows[first])
            where = measurements.places[row] if measurements.places else f"row {row}"
            text = f"{kind.title} reads otherwise from {where} on, as if it had been moved there"
            yield Flag("instrument_moved", f"{text}: give the rows from there on a session of their own")
