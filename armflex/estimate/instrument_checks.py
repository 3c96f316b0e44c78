"""Whether what a sensor read is plausible for where it is declared to be, and whether it stayed where it was."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import permutations, product

import numpy as np
import pinocchio as pin

from armflex.arm import Setup
from armflex.conventions import SHOWN, STANDARD_GRAVITY, Array, said_of
from armflex.errors import ArmflexError, ConventionError, Flag
from armflex.estimate.block import Block, parameters_of
from armflex.estimate.blocks import sensor_start
from armflex.estimate.fit import Fit
from armflex.estimate.misread import ALIKE, DROP, explained
from armflex.estimate.robust import chi_squared
from armflex.estimate.view import View, postures
from armflex.linear_gaussian import LinearGaussian
from armflex.measured.measurements import Measurements
from armflex.parameters import ParameterKind
from armflex.readings import Kind, Position, Readings
from armflex.readings.acceleration import OPPOSITE, Acceleration
from armflex.readings.instrument import fit_frame
from armflex.readings.sensor import Sensor

COARSE = {"m": 2e-3, "rad": 1e-3, "m/s^2": 1e-2}
"""What an arm may be off by, beyond its priors, before a sensor is suspected."""

IMPLAUSIBLE = 3.0
"""Typical reading, in standard deviations of all that is open, from which something else is wrong."""

ABSURD = 10.0
"""Prior standard deviations beyond which a value is none that was thought of when the prior was written."""

UNMEANT = 10.0
"""Scatter over the stated standard deviation, or its inverse, from which that is rather a mistake than a bad day."""

FEWEST = 10.0
"""Degrees of freedom from which readings tell that they scatter less than they state."""

EVEN = 0.1
"""Misfit below which one explanation is as good as another: what is left is far below what an arm may be off by."""

MOST_SAID = 3
"""Explanations that are named."""

MOST = 0.5
"""Part of what a sensor reads beyond its stated noise that a step must explain to be what happened to it."""

ALL = 0.9
"""The same of a sensor that is where its declaration does not have it: being moved is then all that is wrong."""

TRIED = {
    "m": {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "inches": 0.0254},
    "rad": {"rad": 1.0, "degrees": np.pi / 180.0, "mm/m": 1e-3},
    "m/s^2": {"m/s^2": 1.0, "g": STANDARD_GRAVITY, "mm/s^2": 1e-3, "mg": 1e-3 * STANDARD_GRAVITY},
}
"""SI unit -> unit that numbers may have been written in, or taken for -> factor to SI."""

BY_CHANCE = 1e-4
"""Probability at which a sensor that stayed seems to have moved, over all rows at which it may have."""

MOST_SPLITS = 100

FAR = 1.0
"""Prior standard deviation of how far a sensor was moved, in the units of its nuisances: what is not told stays."""


@dataclass(frozen=True)
class _Way:
    """Another meaning of what sensors read, or of where they are.

    Attributes:
        said: What would be meant, and how to write it; {} is how many times better it fits.
        sensors: The sensors as they were then declared.
        values: By name the (N, d) numbers that were then read, in their unit.
        changes: In how many things it differs; of what explains as much the simplest is meant.
    """

    said: str
    sensors: Mapping[str, Sensor] = field(default_factory=dict)
    values: Mapping[str, Array] = field(default_factory=dict)
    changes: int = 1


@dataclass(frozen=True)
class _Off:
    """How far readings are off what is declared and all that [prior] explains, beyond what an arm may lack.

    Attributes:
        misfit: See `misread`.
        typical: The median reading, in standard deviations.
        own, pulled: The largest value of a sensor's own, and of any parameter, in prior standard deviations.
    """

    misfit: float
    typical: float
    own: float
    pulled: float

    @property
    def plausible(self) -> bool:
        """Whether nothing is wrong with it."""
        return max(self.typical, self.own / IMPLAUSIBLE) < IMPLAUSIBLE

    @property
    def absurd(self) -> bool:
        """Whether the readings fit only where the arm is no longer what it was declared to be."""
        return self.pulled > ABSURD and self.misfit > 1.0


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
        ConventionError: What they read is plausible in another unit, with other axes, from another place or link, as
            those of another sensor, or otherwise.
    """
    flags = []
    start = replace(declared, setup=replace(declared.setup, instrument=placed.setup.instrument))
    for kind in declared.readings.kinds:
        read = np.flatnonzero(np.isfinite(kind.sigma).all(axis=1))
        if not kind.name or not len(read):
            continue
        found = _off(start, (kind.name,), blocks)
        if found.plausible and not found.absurd:
            continue
        at, own = declared.at.some(read), kind.some(read)
        off = said_of(float(np.median(np.linalg.norm(own.residual(at), axis=1))), kind.unit)
        said = f"{kind.title}: what it read is {off} off, further than its declaration and [prior] explain"
        # Units come first: what they explain, another place may make up for.
        in_unit = _explaining(_units(kind), start, kind.name, found, blocks)
        explaining = in_unit or _explaining(_meanings(kind, declared), start, kind.name, found, blocks)
        best = min((misfit for misfit, _ in explaining), default=0.0)
        alike = [way for misfit, way in explaining if misfit < ALIKE * max(best, EVEN)]
        least = min((way.changes for way in alike), default=0)
        better = f"{np.sqrt(found.misfit / max(best, 1e-12)):.3g}"
        reasons = tuple(way.said.replace("{}", better) for way in alike if way.changes == least)[:MOST_SAID]
        if not in_unit:
            elsewhere = None if reasons else own.elsewhere(at)
            reasons += () if elsewhere is None else (elsewhere,)
            reasons += () if found.plausible else otherwise()
        if reasons:
            raise ConventionError(f"{said}: {'; or '.join(reasons)}", reasons)
        if not found.plausible:
            text = f"{said}: is it where [instrument.{kind.name}] says?"
            flags.append(Flag("instrument_implausible", text, about=kind.name))
    return tuple(flags)


def _off(declared: View, names: tuple[str, ...], blocks: Sequence[Block], way: _Way | None = None) -> _Off:
    """Return how far off is what some sensors read, as declared or as it would otherwise be meant.

    The arm is where it is declared to be, the sensors where their readings have them. The frame of targets that are all
    there is to tell it is placed anew.
    """
    setup, kinds, way = declared.setup, [], way or _Way("")
    setup = replace(setup, arm=replace(setup.arm, sensors={**setup.arm.sensors, **way.sensors}))
    framed = any(kind.framed for kind in declared.readings.kinds if kind.name in names)
    placing = framed and any(block.kind is ParameterKind.INSTRUMENT for block in blocks)
    placing = placing and declared.readings.of(Position) is None
    for kind in declared.readings.kinds:
        if kind.name in names or (placing and kind.framed):
            kinds.append(replace(kind, values=way.values.get(kind.name, kind.values)))
    readings = Readings(len(declared.rows), tuple(kinds))

    def seen(setup: Setup) -> View:
        at = postures(setup, declared.line, declared.sessions)
        return replace(
            declared, setup=setup, readings=readings, residual=readings.stacked(lambda one: one.residual(at))
        )

    view = seen(setup)
    if placing:
        view = seen(setup.placed(pin.SE3.Identity()))
        own = [(kind, np.isfinite(kind.sigma).all(axis=1)) for kind in kinds if kind.framed]
        points = np.concatenate([kind.predicted(view.at)[read] for kind, read in own])
        view = seen(setup.placed(fit_frame(points, np.concatenate([kind.values[read] for kind, read in own]))))
    begun = sensor_start(view)
    setup = view.setup
    for block in blocks:
        if block.kind is ParameterKind.SENSOR and all(one in begun for one in block.parameters):
            setup = block.apply(setup, np.array([begun[one] for one in block.parameters]))
    view = seen(setup)
    read = np.flatnonzero(np.isfinite(view.sigma).any(axis=1))
    floor = np.concatenate([np.maximum(kind.sigma, COARSE[kind.unit]) for kind in kinds], axis=1)[read]
    jacobian = np.concatenate([block.jacobian(view) for block in blocks], axis=2)[read]
    free, prior = parameters_of(blocks), np.concatenate([block.prior for block in blocks])
    start = np.array([begun.get(one, 0.0) for one in free])
    misfit, left, values = explained(jacobian / floor[:, :, None], prior**-2.0, view.residual[read] / floor, start)
    known, sensors = np.isfinite(prior), [one.group.kind is ParameterKind.SENSOR for one in free]
    pulls = np.where(known, np.abs(values) / np.where(known, prior, 1.0), 0.0)
    # Of several numbers of a row each counts that was read.
    typical = float(np.median(np.abs(left)[np.isfinite(floor)]))
    return _Off(misfit, typical, float(pulls[sensors].max(initial=0.0)), float(pulls.max(initial=0.0)))


def _explaining(
    ways: Iterable[_Way], start: View, name: str, found: _Off, blocks: Sequence[Block]
) -> list[tuple[float, _Way]]:
    """Return the ways in which what a sensor read is plausible, with their misfits, the least first.

    Args:
        ways: What else may be meant.
        start: The rows as everything is declared, instruments where they were placed.
        name: The sensor.
        found: How far it is off as declared.
        blocks: All that is free.
    """
    explaining = []
    for way in ways:
        names = (name, *(other for other in way.values if other != name))
        before = found if len(names) == 1 else _off(start, names, blocks)
        with suppress(ArmflexError):
            after = _off(start, names, blocks, way)
            if after.plausible and not after.absurd and DROP * after.misfit < before.misfit:
                explaining.append((after.misfit, way))
    return sorted(explaining, key=lambda pair: pair[0])


def _units(kind: Kind) -> Iterator[_Way]:
    """Yield the units in which a sensor may have read its numbers."""
    units, factors = TRIED[kind.unit], set[float]()
    for header, unit in permutations(units, 2):
        factor = units[unit] / units[header]
        if round(np.log(factor), 6) not in factors:
            factors.add(round(np.log(factor), 6))
            text = f"it fits {{}} times better in {unit}, not {header} (write the unit into the header)"
            yield _Way(text, values={kind.name: factor * kind.values})


def _meanings(kind: Kind, declared: View) -> Iterator[_Way]:
    """Yield what else but a unit may be meant by what a sensor read, or of where it is."""
    name, sensor = kind.name, declared.arm.sensors[kind.name]
    if isinstance(kind, Acceleration):
        text = f"it reads the opposite: write {OPPOSITE[sensor.sign < 0.0]} into its declaration"
        yield _Way(text, sensors={name: replace(sensor, sign=-sensor.sign)})
    places = range(kind.dimension)
    for order, signs in product(permutations(places), product((1.0, -1.0), repeat=kind.dimension)):
        away = [kind.channels[i] for i in places if order[i] != i]
        turned = [kind.channels[i] or "its sign" for i in places if signs[i] < 0.0]
        if away or turned:
            words = [f"{' and '.join(away)} {'swapped' if len(away) == 2 else 'exchanged in turn'}"] if away else []
            words += [f"{' and '.join(turned)} reversed"] if turned else []
            text, values = f"it fits {{}} times better with {', '.join(words)}", kind.values[:, list(order)] * signs
            yield _Way(text, values={name: values}, changes=len(away) // 2 + len(turned))
    for other in declared.readings.kinds:
        if other.name and other.name != name and type(other) is type(kind):
            text = f"its columns and those of {other.name} are exchanged (exchange their headers)"
            yield _Way(text, values={name: other.values, other.name: kind.values})
    for link in declared.line.link_names if sensor.shaft is None else ():
        if link not in (sensor.link, sensor.seen_from):
            text = f'it is on {link!r} (write link = "{link}")'
            yield _Way(text, sensors={name: replace(sensor, link=link)})


def beyond_priors(found: Fit) -> Iterator[Flag]:
    """Yield a flag where several fitted values are absurdly far outside their priors."""
    pulls = np.where(np.isfinite(found.prior), np.abs(found.values) / found.prior, 0.0)
    known = [one.group.kind is not ParameterKind.LAW for one in found.parameters]
    far = [int(i) for i in np.argsort(-pulls) if known[i] and pulls[i] > ABSURD]
    if len(far) > 1:
        told = ", ".join(f"{found.parameters[i].label} by {pulls[i]:.0f} prior standard deviations" for i in far[:3])
        text = f"{len(far)} values are absurdly far from what was declared ({told})"
        yield Flag("beyond_priors", f"{text}: units, conventions and priors are more likely wrong than the arm is")


def wrong_sigma(found: Fit, about: Sequence[Flag] = ()) -> Iterator[Flag]:
    """Yield flags about sensors whose stated standard deviation cannot be meant, by how they scatter.

    One scatters more than stated where the arm lacks something, too, but then so do others by as much.

    Args:
        found: The fit, each instrument weighed by its scatter.
        about: Flags on sensors that are implausible for another reason.
    """
    readings, suspects = found.view.readings, {flag.about for flag in about}
    for number, (name, scatter) in enumerate(zip(readings.names, found.scatters, strict=True)):
        others = [one for i, one in enumerate(found.scatters) if i != number]
        large = others and scatter > UNMEANT * max(1.0, min(others))
        freedom = found.noises[number][1]
        small = freedom >= FEWEST and scatter < 1.0 / UNMEANT
        if name and name not in suspects and (large or small):
            kind = next(kind for kind in readings.kinds if kind.name == name)
            read = np.isfinite(kind.sigma)
            place = next(own for one, own in readings.placed if one is kind)
            stated = float(np.median(found.stated[:, place][read]))
            unit, factor = SHOWN[kind.unit]
            seen = f"{stated * factor:.3g} {unit}, and its readings scatter by {scatter * stated * factor:.3g} {unit}"
            text = f"{kind.title}: its sigma is {seen}, {scatter:.2g} times as much"
            ask = "is it stated in the right unit, or does the model lack an effect that only this instrument observes?"
            yield Flag(
                "sigma_implausible", f"{text}: {ask if large else 'is it stated in the right unit?'}", about=name
            )


def moved_sensors(found: Fit, measurements: Measurements, about: Sequence[Flag] = ()) -> Iterator[Flag]:
    """Yield flags about sensors that read otherwise from some row of a session on, as if they had been moved there.

    The step must be beyond chance and the stated noise, and most of what the sensor reads beyond that noise: whatever
    else is wrong leaves residuals that some step explains a little of.

    With X the change of the readings from a row on by all that may be open of a sensor, fitted beside everything else
    that is free, the sum of squares S falls by s'(X'X - W'W)^-1 s (see `linear_gaussian`); n log S is chi-squared.

    Args:
        found: The fit, each instrument weighed by its scatter.
        measurements: Its campaign.
        about: Flags on sensors that are implausible, of which a step must explain `ALL`.
    """
    names, suspects = found.view.readings.names, {one.about for one in about}
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
        chance = chi_squared(size, BY_CHANCE / max(len(starts), 1))
        factor = found.factors[names.index(kind.name)] if found.factors else 1.0
        whitened = found.residual.reshape(found.weights.shape)[:, place]
        beyond = float((whitened**2).sum()) - found.noises[names.index(kind.name)][1] / factor**2
        most = ALL if kind.name in suspects else MOST
        if starts and ratio > chance and gain * factor**2 > chance and gain > most * beyond:
            row = int(found.view.rows[first])
            where = measurements.places[row] if measurements.places else f"row {row}"
            text = f"{kind.title} reads otherwise from {where} on, as if it had been moved there"
            text = f"{text}: give the rows from there on a session of their own"
            yield Flag("instrument_moved", text, about=kind.name)
