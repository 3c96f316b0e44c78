"""[[effect]] in an arm.toml: what an arm does beyond its flexures, read and written by the catalogue's names.

`derived = ["approach_A2"]` says that what wrote the effect took a direction that it depends on from how the rows before
moved the joint, because no column gave it: the same is then done wherever rows do not give it.

Where a law makes sense on an arm is asked of the law itself: it lists its locations as if everything had been recorded,
and a table must name one of them.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from armflex.arm import Arm
from armflex.declaration import Declaration
from armflex.errors import ArmFileError, did_you_mean, listing
from armflex.laws.effects.catalogue import CATALOGUE, SHAPES
from armflex.laws.effects.context import AXES, Records
from armflex.laws.effects.effect import Afterwards, Effect, EffectLaw, full
from armflex.laws.effects.location import BASE, TOOL, Location
from armflex.result import record
from armflex.rows.rows import APPROACH

UNNAMED = "unnamed"
TEMPERATURE = "temperature"
"""Column of a law that depends on a temperature, where a table names none."""


def read_effect(table: Declaration, arm: Arm) -> Effect:
    """Return the effect that a [[effect]] table declares.

    Args:
        table: Its keys name, shape, site, axis, partner, covariates, derived, seen, earlier, parameters and std.
        arm: The arm, its payloads included.

    Raises:
        ArmFileError: A law, site, axis, partner, covariate or parameter is unknown to the arm or the law, or missing;
            what is derived, or seen, is nothing that the effect depends on; a number is not finite, or below zero where
            that makes no sense.
    """
    name = table.text("name")
    if name not in (*CATALOGUE, UNNAMED):
        names = (*CATALOGUE, UNNAMED)
        raise table.fail("name", f"no effect {name!r}{did_you_mean(name, names)} (known: {listing(names, 40)})")
    law = SHAPES[table.choice("shape", tuple(SHAPES))] if name == UNNAMED else CATALOGUE[name]
    called = " ".join(part for part in names_of(law) if part)
    locations, values = _locations(table, law, called, arm), _values(table, law, called)

    terms = tuple(i for i, amplitude in enumerate(law.amplitudes) if amplitude.name in values)
    fitting = [replace(location, terms=terms) for location in locations if set(terms) <= set(location.terms)]
    if not fitting:
        given = listing(law.amplitudes[i].name for i in terms)
        raise table.fail("parameters", f"{given} do not act together there; give each its own [[effect]]")
    axes = _unique(location.axis for location in fitting)
    if len(axes) > 1 and None not in axes:
        raise ArmFileError(table.place(), f"[effect] {called} needs 'axis', one of {listing(map(str, axes))}")
    location = next(location for location in fitting if len(axes) == 1 or location.axis is None)
    location = replace(location, covariates=_covariates(table, law, called, location, arm))

    inner = _inner(table, law, values)
    std = table.part("std")
    for name, value in std.by_name().items():
        if name not in values:
            raise table.fail("std", f"of {name!r}, which is no parameter{did_you_mean(name, values)}")
        if value < 0.0:
            raise table.fail("std", f"of {name} is {value:g}, expected 0 or more")
    derived = table.texts("derived") if table.has("derived") else ()
    directions = [name for name in location.covariates if name.startswith(APPROACH)]
    for name in [name for name in derived if name not in directions]:
        text = f"{called} depends on no direction {name!r} there{did_you_mean(name, directions)}"
        raise table.fail("derived", f"{text} (it depends on: {listing(directions)})")
    seen = _seen(table.part("seen"), called, location.covariates)
    earlier = table.flag("earlier")
    if earlier and "time" not in [name for name, _, _ in seen]:
        text = "of a campaign before the last: [effect.seen] must have its first and last moment, time = [FIRST, LAST]"
        raise table.fail("earlier", text)
    table.finish()
    amplitudes = np.array([values[law.amplitudes[i].name] for i in terms])
    sizes = (*full(amplitudes, location, len(law.amplitudes)), *inner)
    return Effect(law, location, sizes, derived, tuple(seen), np.inf if earlier else None, earlier=earlier)


def _seen(ranges: Declaration, called: str, columns: Sequence[str]) -> tuple[tuple[str, float, float], ...]:
    """Return the range of each column in which an effect was found."""
    for name, (low, high) in (by_name := ranges.by_name(2)).items():
        if name not in columns:
            text = f"{called} depends on no {name!r} there{did_you_mean(name, columns)}"
            raise ranges.fail(name, f"{text} (it depends on: {listing(columns)})")
        if low > high:
            raise ranges.fail(name, f"expected the smaller first, got {low:g} and {high:g}")
    return tuple((name, float(low), float(high)) for name, (low, high) in by_name.items())


def _inner(table: Declaration, law: EffectLaw, values: Mapping[str, float]) -> list[float]:
    """Return the inner parameters of a law, each within its sign."""
    inner = []
    for parameter in law.inner:
        if parameter.name not in values and parameter.default is None:
            raise table.fail(
                "parameters", f"{parameter.name!r} [{parameter.unit.format(m='m', w='N', over='rad or N')}] is missing"
            )
        value = values.get(parameter.name, parameter.default or 0.0)
        if parameter.positive and (value < 0.0 or (value == 0.0 and not parameter.may_be_zero)):
            least = "0 or more" if parameter.may_be_zero else "more than 0"
            raise table.fail("parameters", f"{parameter.name} is {value:g}, expected {least}")
        inner.append(value)
    return inner


def effect_table(effect: Effect, std: Mapping[str, float] | None = None) -> dict[str, Any]:
    """Return the [[effect]] table of an effect, with the standard uncertainty of its values where known."""
    (name, shape), location = names_of(effect.law), effect.location
    table = {"name": name, "shape": shape, "site": location.place, "axis": location.axis, "partner": location.partner}
    table |= {"covariates": list(location.covariates), "derived": list(effect.derived)}
    table |= {"seen": {name: [low, high] for name, low, high in effect.seen}}
    table |= {"earlier": effect.earlier, "parameters": effect.named, "std": dict(std or {})}
    return {key: value for key, value in table.items() if value or key == "parameters"}


def names_of(law: EffectLaw) -> tuple[str, str]:
    """Return a law's name in files, and its shape where it is unnamed, else ''."""
    return (UNNAMED, law.shape) if law.shape else (law.name, "")


def place_json(law: EffectLaw, location: Location) -> dict[str, Any]:
    """Return which law acts where; `shape` and `partner` only where there is one."""
    name, shape = names_of(law)
    place = {"effect": name} | record(location, "axis covariates", site="place")
    return place | ({"shape": shape} if shape else {}) | ({"partner": location.partner} if location.partner else {})


def locations_on(law: EffectLaw, arm: Arm, session: str = "", recorded: Iterable[str] = ()) -> list[Location]:
    """Return every place of a law of the catalogue on an arm, as if everything had been recorded.

    There are two sessions, and a payload beside those of the arm: with a single one there would be no choice between it
    and all of them. Columns of other names than armflex's own are those of `recorded`.
    """
    payloads = ("", *sorted(name for name in arm.payloads if name != "none")) if arm.payloads else ()
    columns = tuple(dict.fromkeys(("time", "hold", TEMPERATURE, *recorded)))
    more = {"payloads": payloads, "sessions": (session, f"{session}'"), "springs": tuple(o.name for o in arm.springs)}
    more["stars"] = True
    return list(law.places(Records(arm.robot, columns, timed=True, **more)))


def _locations(table: Declaration, law: EffectLaw, called: str, arm: Arm) -> list[Location]:
    """Return the places of a law on an arm that have the table's site, and the axis and partner that it names."""
    if law.shape and not law.physical:  # a free shape is possible everywhere
        every = tuple(range(len(law.amplitudes)))
        locations = [Location(site, axis, (), every) for site in (BASE, *arm.joint_names, TOOL) for axis in AXES]
    else:  # a file cannot know which sessions there will be, so any will do
        recorded = table.texts("covariates") if table.has("covariates") else ()
        locations = locations_on(law, arm, table.text("partner") if law.afterwards is Afterwards.OVER else "", recorded)
    if law.symmetric:  # either axis may come first
        locations += [replace(location, axis=location.partner, partner=str(location.axis)) for location in locations]

    places = _unique(location.place for location in locations)
    if not places and not table.has("covariates"):
        raise table.fail("site", f"{called} has no place on this arm without `covariates`, the columns it depends on")
    site = table.choice("site", places, problem=f"{{!r}} is no place for {called} on this arm")
    locations = [location for location in locations if location.place == site]

    if table.has("axis"):
        axes = _unique(location.axis for location in locations if location.axis)
        if not axes:
            raise table.fail("axis", f"{called} takes no axis")
        axis = table.choice("axis", axes, problem=f"{called} has no axis {{!r}} there")
        locations = [location for location in locations if location.axis == axis]

    partner, partners = table.text("partner", ""), _unique(location.partner for location in locations)
    possible = [name for name in partners if name]
    if partner not in partners:
        if not possible:
            raise table.fail("partner", f"{called} takes no partner")
        if not partner:
            raise ArmFileError(table.place(), f"[effect] {called} needs 'partner', one of {listing(possible)}")
        raise table.fail("partner", f"no {partner!r}{did_you_mean(partner, possible)} (possible: {listing(possible)})")
    return [location for location in locations if location.partner == partner]


def _values(table: Declaration, law: EffectLaw, called: str) -> dict[str, float]:
    """Return the given parameters by name."""
    given, amplitudes = table.sub("parameters"), [amplitude.name for amplitude in law.amplitudes]
    names = [*amplitudes, *(inner.name for inner in law.inner)]
    for name in given.table:
        if name not in names:
            text = f"{called} has no parameter {name!r}{did_you_mean(name, names)}"
            raise table.fail("parameters", f"{text} (known: {listing(names, 30)})")
    values = {name: given.number(name) for name in given.table}
    if not any(name in values for name in amplitudes):
        wanted = "" if len(amplitudes) == 1 else "one or more of "
        raise table.fail("parameters", f"{called} needs {wanted}{listing(amplitudes)}")
    # A fit may take away from what is declared beside it, or end a little below zero: then it has a deviation.
    for amplitude in law.amplitudes if not table.has("std") else ():
        if amplitude.positive and values.get(amplitude.name, 0.0) < 0.0:
            raise table.fail("parameters", f"{amplitude.name} is {values[amplitude.name]:g}, expected 0 or more")
    return values


def _covariates(table: Declaration, law: EffectLaw, called: str, location: Location, arm: Arm) -> tuple[str, ...]:
    """Return the columns that the effect depends on: a temperature, or those of a shape, may have any name."""
    given = table.texts("covariates") if table.has("covariates") else None
    wanted = law.columns if law.shape else int(location.covariates == (TEMPERATURE,))
    if given is None and wanted and law.shape:
        kind = "a column" if wanted == 1 else f"{wanted} columns"
        raise ArmFileError(table.place(), f"[effect] {called} needs 'covariates', {kind} that it depends on")
    if given is None or (not wanted and given == location.covariates):
        return location.covariates
    if len(given) != wanted:
        asked = f"{wanted} of any name" if wanted else listing(map(repr, location.covariates))
        raise table.fail("covariates", f"{called} depends on {asked}, got {listing(map(repr, given))}")
    for name in given:
        for prefix in ("q_", APPROACH):
            if name.startswith(prefix) and name.removeprefix(prefix) not in arm.joint_names:
                columns = [f"{prefix}{joint}" for joint in arm.joint_names]
                text = f"the arm has no {name!r}{did_you_mean(name, columns)} (known: {listing(columns)})"
                raise table.fail("covariates", text)
        if not name.strip():
            raise table.fail("covariates", "a column needs a name")
    return given


def _unique(values: Iterable[Any]) -> list[Any]:
    return list(dict.fromkeys(values))
