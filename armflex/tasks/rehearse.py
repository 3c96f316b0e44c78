"""What poses and instruments could show on an arm, before anybody drives them.

The campaign is simulated: the arm as declared, its free parameters drawn from [prior], the instruments' stated noise.
One effect at a time is hidden in it, of a size that moves the target by as much as is asked for, or less where no
machine has so much. The exact posterior over all hypotheses (`armflex.trace`) then says with what probability the
effect would get its own name, and which other name it would get.

It is the linear problem of one missing effect: values inside a law are those of the search's grid, and no other effect
is missing. A campaign that fails here fails on the machine.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Any

import numpy as np
from scipy.special import logsumexp

from armflex.arguments import checked_kinds
from armflex.arm import Arm, Setup, warn
from armflex.conventions import Array
from armflex.errors import Flag, InputError, listing
from armflex.estimate import calibrate
from armflex.estimate.view import look
from armflex.files.effect_file import place_json
from armflex.laws.effects.catalogue import EVERY
from armflex.laws.effects.location import Location
from armflex.measured.measurements import Measurements, as_measurements
from armflex.measured.table import Tabular
from armflex.plan.drive import RUN_UP
from armflex.plan.planning import READING, plan
from armflex.readings import Kind, Position, Readings, TouchingSensor
from armflex.readings.instrument import Instrument
from armflex.result import Result, record
from armflex.rows import Rows
from armflex.rows.rows import last_motion
from armflex.trace.probabilities import CREDIBLE
from armflex.trace.screen import UNIT_MOTION, Screen
from armflex.trace.search import standing
from armflex.trace.state import begin

ROWS, DRAWS = 60, 3
"""Rows that are planned where none are given, and campaigns that are simulated of each effect."""


@dataclass(frozen=True)
class Rehearsed:
    """One effect at one place, hidden in simulated campaigns.

    Attributes:
        effect: Name of its law.
        location: Where it acts.
        title: Both, in words.
        size: How far it moves the target [m], RMS over the rows; 0 where these rows do not show it at all.
        named: Mean probability of its own name.
        within: Share of the campaigns whose credible set of 95 % holds it.
        nothing: Mean probability that nothing is missing.
        confused: Names of other effects with the mean probability of each, the likeliest first.
    """

    effect: str
    location: Location
    title: str
    size: float
    named: float
    within: float
    nothing: float
    confused: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True, repr=False, eq=False)
class Rehearsal(Result):
    """What a campaign could show.

    Attributes:
        rows: The rows, in the order driven.
        sigma: Standard deviation of a position read [m].
        size: How far a hidden effect moves the target at most [m], RMS.
        effects: Every effect that was hidden, in the order of the catalogue.
    """

    ROWS = "effects"

    def content(self) -> dict[str, Any]:
        """Return what of each effect would be named."""
        effects = [
            place_json(EVERY[effect.effect], effect.location)
            | record(effect, "nothing", probability="named", in_credible_set="within", size_m="size")
            | {"confused_with": [{"name": title, "probability": chance} for title, chance in effect.confused]}
            for effect in self.effects
        ]
        return record(self, rows="read", sigma_m="sigma", size_m="size") | {"effects": effects}

    rows: Rows
    sigma: float
    size: float
    effects: tuple[Rehearsed, ...]

    @property
    def read(self) -> int:
        """How many rows are read."""
        return int(self.rows.measured.sum())

    @property
    def laws(self) -> tuple[tuple[str, tuple[Rehearsed, ...]], ...]:
        """The effects of each law, the law that is hardest to name first."""
        grouped = [(name, tuple(effects)) for name, effects in groupby(self.effects, key=lambda effect: effect.effect)]
        return tuple(sorted(grouped, key=lambda pair: float(np.mean([effect.named for effect in pair[1]]))))


@checked_kinds
def rehearse(
    arm: Arm,
    rows: Measurements | Tabular | None = None,
    *,
    sigma: float = READING,
    size: float = 1e-3,
    draws: int = DRAWS,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Rehearsal:
    """Return with what probability effects would get their right names from a campaign that is still to be driven.

    Args:
        arm: The arm as declared; all instruments that it declares are read, and a tracker at the target.
        rows: The rows: a table as for `predict`; 60 rows as `plan` chooses them where not given.
        sigma: Standard deviation of a position read [m].
        size: How far each effect moves the target [m], RMS over the rows.
        draws: Campaigns simulated of each effect.
        seed: Of the draws.
        progress: Called with (effects done, effects in all).

    Raises:
        InputError: A number is out of its range, or [prior] frees nothing and no rows are given.
        IdentifiabilityError: The rows do not determine where the instrument stands.
    """
    for name, value in (("sigma", sigma), ("size", size)):
        if not 0.0 < value < 1.0:
            raise InputError(f"{name} is {value:g} m, expected more than 0 and less than 1 m")
    for name, value, least in (("draws", draws, 1), ("seed", seed, 0)):
        if value < least:
            raise InputError(f"{name} is {value}, expected {least} or more")
    unseen = [
        name for name, sensor in arm.sensors.items() if not (sensor.foreseen or isinstance(sensor, TouchingSensor))
    ]
    unknown = [f"[instrument.{name}]" for name in unseen]
    if unknown:
        text = "may be anywhere, and is not read: give anchor, mounting, board_at, board_turn and focal with their _std"
        warn(
            [
                Flag(
                    "instrument_anywhere",
                    f"{listing(unknown)} {text}, or rehearse with the arm file that pictures gave",
                )
            ]
        )
    rng = np.random.default_rng(seed)
    if rows is None:
        driven = plan(arm, ROWS, sigma=sigma, seed=seed).rows
        driven = replace(driven, approach=last_motion(driven.q))
    else:
        driven = as_measurements(rows, arm, True)
    campaign = simulated(arm, driven, sigma, rng)
    screen = standing(begin(calibrate(arm, campaign, as_stated=True, anyway=True))).screen
    places, rehearsed = Places.of(screen, rng), list[Rehearsed]()
    for number in places.hidden:
        rehearsed.append(_rehearsed(screen, places, number, size, draws, rng))
        if progress is not None:
            progress(len(rehearsed), len(places.hidden))
    return Rehearsal(campaign, sigma, size, tuple(rehearsed))


def simulated(arm: Arm, rows: Rows, sigma: float, rng: np.random.Generator) -> Measurements:
    """Return the campaign that an arm without further effects would give, all instruments read, positions to sigma [m].

    Rows are what is driven; one whose pose begins with `to ` is not read.
    """
    bare = Rows.__dataclass_fields__
    rows = Rows(**{name: getattr(rows, name) for name in bare})
    read = np.array([not pose.startswith(RUN_UP) for pose in rows.pose])
    kinds: list[Kind] = [Position.unread(len(rows), sigma)]
    kinds += [sensor.unread(len(rows)) for sensor in arm.sensors.values() if sensor.foreseen]
    rows = replace(rows, measured=read)
    at = look(Setup(arm, arm.instrument or Instrument()), rows, readings=Readings(len(rows), tuple(kinds))).at
    taken = []
    for kind in Readings(len(rows), tuple(kinds)).within_range(at).kinds:
        there = np.where(read[:, None], kind.sigma, np.inf)
        noise = np.where(np.isfinite(there), there, 0.0) * rng.standard_normal(kind.values.shape)
        taken.append(replace(kind, values=np.where(np.isfinite(there), kind.predicted(at) + noise, 0.0), sigma=there))
    return Measurements.of(rows, Readings(len(rows), tuple(taken)))


@dataclass(frozen=True, eq=False)
class Places:
    """Laws and places of a screen's hypotheses.

    Attributes:
        number: (H + 1,) which law and place each hypothesis is of; last that of nothing.
        titles: What each is called.
        hidden: Numbers of the hypotheses that are hidden: one for every named law and place, drawn from the grid.
    """

    number: np.ndarray
    titles: tuple[str, ...]
    hidden: tuple[int, ...]

    @staticmethod
    def of(screen: Screen, rng: np.random.Generator) -> Places:
        """Return those of a screen."""
        hypotheses = [group.hypothesis for group in screen.groups]
        spots = {spot: i for i, spot in enumerate(dict.fromkeys(hypothesis.spot for hypothesis in hypotheses))}
        number = np.array([*(spots[hypothesis.spot] for hypothesis in hypotheses), len(spots)])
        titles = {hypothesis.spot: hypothesis.one.name for hypothesis in hypotheses}
        named = [i for i, hypothesis in enumerate(hypotheses) if hypothesis.one.law.physical]
        grouped: dict[int, list[int]] = {}
        for i in named:
            grouped.setdefault(int(number[i]), []).append(i)
        hidden = tuple(int(rng.choice(alike)) for alike in grouped.values())
        return Places(number, (*(titles[spot] for spot in spots), "nothing"), hidden)


def _rehearsed(
    screen: Screen, places: Places, number: int, size: float, draws: int, rng: np.random.Generator
) -> Rehearsed:
    """Return what simulated campaigns say of one hidden hypothesis."""
    group, projection = screen.groups[number], screen.projection
    candidate, place = group.hypothesis.one, int(places.number[number])
    what = (candidate.law.name, candidate.location, candidate.name)
    columns = screen.columns(group.places)
    read = np.isfinite(screen.fit.view.sigma).ravel()
    mean, within, sizes = np.zeros(len(places.titles)), 0, []
    for _ in range(draws):
        direction = rng.standard_normal(len(candidate.location.terms))
        direction = np.abs(direction) if group.hypothesis.positive else direction
        scaled = direction / np.linalg.norm(direction)
        moved = UNIT_MOTION * float(np.sqrt(((columns @ scaled) ** 2).sum() / screen.unit))
        if not 0.0 < moved < np.inf:
            return Rehearsed(*what, 0.0, 0.0, 0.0, 1.0)
        scaled, moved = scaled * size / moved, size
        # Share of the size asked for down to which a size that machines have is sought
        while screen.charge(number, group.scale * scaled) > 0.0 and moved > 1e-2 * size:
            scaled, moved = 0.5 * scaled, 0.5 * moved
        sizes.append(moved)
        drawn = projection.regressors @ _drawn(projection.precision, rng)
        noise = np.where(read, rng.standard_normal(len(read)), 0.0)
        chances = _posterior(screen, places, columns @ scaled + drawn + noise)
        within += float(chances[chances > chances[place]].sum()) < CREDIBLE
        mean += chances / draws
    best = [i for i in np.argsort(-mean).tolist() if i not in (place, len(mean) - 1)]
    # Mean probability below which another name is not reported
    confused = tuple((places.titles[i], float(mean[i])) for i in best[:3] if mean[i] > 1e-3)
    return Rehearsed(*what, float(np.mean(sizes)), float(mean[place]), within / draws, float(mean[-1]), confused)


def _drawn(precision: Array, rng: np.random.Generator) -> Array:
    """Return (P,) values of the fitted parameters drawn from their priors, 0 where there is none."""
    priced = precision > 0.0
    return np.where(priced, rng.standard_normal(len(precision)) / np.sqrt(np.where(priced, precision, 1.0)), 0.0)


def _posterior(screen: Screen, places: Places, readings: Array) -> Array:
    """Return the (S + 1,) probabilities of all laws and places, last: of nothing, given (n,) whitened readings."""
    projection = screen.projection
    left = float(readings @ projection.left_of(readings))
    evidence = screen.with_readings(screen.scores_of(readings[:, None])[:, 0], left)
    beside = evidence.beside(())
    logs: Array = np.asarray(logsumexp(beside.odds, axis=1))
    # Of the likeliest hypotheses so many have their size compared with what machines have
    for number in np.argsort(-logs)[:12].tolist():
        scale = int(beside.odds[number].argmax())
        logs[number] -= screen.charge(number, beside.amplitudes_of(number, scale))
    weights = np.exp(np.append(logs, 0.0) - max(float(logs.max()), 0.0))
    chances = np.zeros(len(places.titles))
    np.add.at(chances, places.number, weights / weights.sum())
    return chances


def summary(effects: Sequence[Rehearsed]) -> tuple[float, float, float, str]:
    """Return of several effects the mean probability of the right name, the share within the credible sets, the mean
    probability of nothing, and the name that they are most often confused with.
    """
    chances: dict[str, float] = {}
    for effect in effects:
        for name, chance in effect.confused:
            chances[name] = chances.get(name, 0.0) + chance
    most = max(chances.items(), key=lambda pair: pair[1], default=("", 0.0))
    figures = [float(np.mean([getattr(effect, what) for effect in effects])) for what in ("named", "within", "nothing")]
    return figures[0], figures[1], figures[2], most[0] if most[1] / len(effects) >= 0.01 else ""
