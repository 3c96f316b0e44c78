"""[[effect]] in an arm.toml: what an arm does beyond its flexures, read and written by the catalogue's names.

`derived = ["approach_A2"]` says that what wrote the effect took a direction that it depends on from how the rows before
moved the joint, because no column gave it: the same is then done wherever rows do not give it.

Where a law makes sense on an arm is asked of the law itself: it lists its locations as if everything had been recorded,
and a table must name one of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from armflex.declaration import Declaration
from armflex.errors import ArmFileError, did_you_mean, listing
from armflex.laws.effects.catalogue import CATALOGUE, SHAPES
from armflex.laws.effects.effect import Effect, EffectLaw, Inner, full
from armflex.laws.effects.location import BASE, TOOL, Location
from armflex.laws.effects.scene import AXES, Records
from armflex.rows.rows import APPROACH

if TYPE_CHECKING:
    from armflex.arm import Arm

UNNAMED = "unnamed"
TEMPERATURE = "temperature"
"""Column of a law that depends on a temperature, where a table names none."""


def read_effect(table: Declaration, arm: Arm) -> Effect:
    """Return the effect that a [[effect]] table declares.

    Args:
        table: Its keys name, shape, site, axis, partner, covariates, derived, parameters and std.
        arm: The arm, its payloads included.

    Raises:
        ArmFileError: A law, site, axis, partner, covariate or parameter is unknown to the arm or the law, or missing;
            what is derived is no direction that the effect depends on; a number is not finite, or below zero where
            that makes no sense.
    """
    law = _law(table)
    locations = _partnered(table, law, _on_axis(table, law, _on_site(table, law, _spots(table, law, arm))))
    values = _parameters(table, law)
    terms = tuple(i for i, amplitude in enumerate(law.amplitudes) if amplitude.name in values)
    location = _acting(table, law, locations, terms)
    location = replace(location, covariates=_covariates(table, law, location, arm))
    inner = tuple(_inner(table, inner, values) for inner in law.inner)
    amplitudes = np.array([values[law.amplitudes[i].name] for i in terms])
    _check_std(table, values)
    derived = _derived(table, law, location)
    table.finish()
    return Effect(law, location, full(amplitudes, location, len(law.amplitudes)) + inner, derived)


def effect_table(effect: Effect, std: Mapping[str, float] | None = None) -> dict[str, Any]:
    """Return the [[effect]] table of an effect, with the standard uncertainty of its values where known."""
    name, shape = names_of(effect.law)
    table: dict[str, Any] = {"name": name}
    if shape:
        table["shape"] = shape
    table["site"] = effect.location.place
    if effect.location.axis:
        table["axis"] = effect.location.axis
    if effect.location.partner:
        table["partner"] = effect.location.partner
    if effect.location.covariates:
        table["covariates"] = list(effect.location.covariates)
    if effect.derived:
        table["derived"] = list(effect.derived)
    table["parameters"] = effect.named
    if std:
        table["std"] = dict(std)
    return table


def names_of(law: EffectLaw) -> tuple[str, str]:
    """Return a law's name in files, and its shape where it is unnamed, else ''."""
    return (UNNAMED, law.shape) if law.shape else (law.name, "")


def _law(table: Declaration) -> EffectLaw:
    name = table.text("name")
    if name == UNNAMED:
        return SHAPES[table.choice("shape", tuple(SHAPES))]
    if name not in CATALOGUE:
        known = (*CATALOGUE, UNNAMED)
        raise table.fail("name", f"no effect {name!r}{did_you_mean(name, known)} (known: {listing(known, 40)})")
    return CATALOGUE[name]


def _spots(table: Declaration, law: EffectLaw, arm: Arm) -> list[Location]:
    """Return every place of a law on an arm; a shape without a name is possible everywhere."""
    if law.shape:
        every = tuple(range(len(law.amplitudes)))
        return [Location(site, axis, (), every) for site in (BASE, *arm.joint_names, TOOL) for axis in AXES]
    # A file cannot know which sessions there will be, so any will do.
    locations = locations_on(law, arm, table.text("partner") if law.of_session else "")
    if law.symmetric:  # either axis may come first
        locations += [replace(location, axis=location.partner, partner=str(location.axis)) for location in locations]
    return locations


def locations_on(law: EffectLaw, arm: Arm, session: str = "") -> list[Location]:
    """Return every place of a law of the catalogue on an arm, as if everything had been recorded.

    There are two sessions, and a payload beside those of the arm: with a single one there would be no choice between it
    and all of them.
    """
    payloads = ("", *sorted(name for name in arm.payloads if name != "none")) if arm.payloads else ()
    columns = ("time", "hold", TEMPERATURE)
    sessions = (session, f"{session}'")
    return list(law.places(Records(arm.robot, columns, timed=True, payloads=payloads, sessions=sessions)))


def _on_site(table: Declaration, law: EffectLaw, locations: Sequence[Location]) -> list[Location]:
    site = table.text("site")
    places = _unique(location.place for location in locations)
    if site not in places:
        text = f"{site!r} is no place for {_called(law)} on this arm{did_you_mean(site, places)}"
        raise table.fail("site", f"{text} (possible: {listing(places)})")
    return [location for location in locations if location.place == site]


def _on_axis(table: Declaration, law: EffectLaw, locations: Sequence[Location]) -> list[Location]:
    """Return the locations on the axis that a table names; all where it names none."""
    axes = _unique(location.axis for location in locations if location.axis)
    if not table.has("axis"):
        return list(locations)
    axis = table.text("axis")
    if not axes:
        raise table.fail("axis", f"{_called(law)} takes no axis")
    if axis not in axes:
        text = f"{_called(law)} has no axis {axis!r} there{did_you_mean(axis, axes)}"
        raise table.fail("axis", f"{text} (possible: {listing(axes)})")
    return [location for location in locations if location.axis == axis]


def _partnered(table: Declaration, law: EffectLaw, locations: Sequence[Location]) -> list[Location]:
    partners = _unique(location.partner for location in locations)
    partner = table.text("partner") if table.has("partner") else ""
    if partner in partners:
        return [location for location in locations if location.partner == partner]
    known = [name for name in partners if name]
    if not known:
        raise table.fail("partner", f"{_called(law)} takes no partner")
    if not partner:
        raise ArmFileError(table.place(), f"[effect] {_called(law)} needs 'partner', one of {listing(known)}")
    raise table.fail("partner", f"no {partner!r}{did_you_mean(partner, known)} (possible: {listing(known)})")


def _parameters(table: Declaration, law: EffectLaw) -> dict[str, float]:
    """Return the given parameters by name."""
    given = table.sub("parameters")
    amplitudes = [amplitude.name for amplitude in law.amplitudes]
    known = [*amplitudes, *(inner.name for inner in law.inner)]
    for name in given.table:
        if name not in known:
            text = f"{_called(law)} has no parameter {name!r}{did_you_mean(name, known)}"
            raise table.fail("parameters", f"{text} (known: {listing(known, 30)})")
    values = {name: given.number(name) for name in given.table}
    if not any(name in values for name in amplitudes):
        one = "" if len(amplitudes) == 1 else "one or more of "
        raise table.fail("parameters", f"{_called(law)} needs {one}{listing(amplitudes)}")
    for amplitude in law.amplitudes:
        if amplitude.positive and values.get(amplitude.name, 0.0) < 0.0:
            raise table.fail("parameters", f"{amplitude.name} is {values[amplitude.name]:g}, expected 0 or more")
    return values


def _inner(table: Declaration, inner: Inner, values: Mapping[str, float]) -> float:
    if inner.name not in values and inner.default is None:
        raise table.fail("parameters", f"{inner.name!r} [{inner.unit.format(m='m', w='N')}] is missing")
    value = values.get(inner.name, inner.default or 0.0)
    least = "0 or more" if inner.default == 0.0 else "more than 0"
    if inner.positive and (value < 0.0 or (value == 0.0 and least == "more than 0")):
        raise table.fail("parameters", f"{inner.name} is {value:g}, expected {least}")
    return value


def _acting(table: Declaration, law: EffectLaw, locations: Sequence[Location], terms: tuple[int, ...]) -> Location:
    """Return the one location at which the given amplitudes act."""
    fitting = [replace(location, terms=terms) for location in locations if set(terms) <= set(location.terms)]
    if not fitting:
        given = listing(law.amplitudes[i].name for i in terms)
        raise table.fail("parameters", f"{given} do not act together there; give each its own [[effect]]")
    axes = _unique(location.axis for location in fitting)
    if len(axes) > 1 and None not in axes:
        raise ArmFileError(table.place(), f"[effect] {_called(law)} needs 'axis', one of {listing(map(str, axes))}")
    return next(location for location in fitting if len(axes) == 1 or location.axis is None)


def _covariates(table: Declaration, law: EffectLaw, location: Location, arm: Arm) -> tuple[str, ...]:
    given = table.texts("covariates") if table.has("covariates") else None
    wanted = _wanted(law, location)
    if given is None and wanted:
        kind = "a column" if wanted == 1 and law.shape else f"{wanted} columns"
        if not law.shape:
            return location.covariates
        raise ArmFileError(table.place(), f"[effect] {_called(law)} needs 'covariates', {kind} that it depends on")
    if given is None or (not wanted and given == location.covariates):
        return location.covariates
    if len(given) != wanted:
        asked = f"{wanted} of any name" if wanted else listing(map(repr, location.covariates))
        raise table.fail("covariates", f"{_called(law)} depends on {asked}, got {listing(map(repr, given))}")
    for name in given:
        _check_column(table, name, arm)
    return given


def _derived(table: Declaration, law: EffectLaw, location: Location) -> tuple[str, ...]:
    """Return the directions that the order of the rows stands in for."""
    derived = table.texts("derived") if table.has("derived") else ()
    known = [name for name in location.covariates if name.startswith(APPROACH)]
    for name in derived:
        if name not in known:
            text = f"{_called(law)} depends on no direction {name!r} there{did_you_mean(name, known)}"
            raise table.fail("derived", f"{text} (it depends on: {listing(known)})")
    return derived


def _wanted(law: EffectLaw, location: Location) -> int:
    """Return how many columns of any name a law takes: a temperature, or what a shape depends on."""
    return law.columns if law.shape else int(location.covariates == (TEMPERATURE,))


def _check_column(table: Declaration, name: str, arm: Arm) -> None:
    """Raise where a column's name is that of a joint's which the arm does not have."""
    for prefix in ("q_", APPROACH):
        if name.startswith(prefix) and name.removeprefix(prefix) not in arm.joint_names:
            known = [f"{prefix}{joint}" for joint in arm.joint_names]
            text = f"the arm has no {name!r}{did_you_mean(name, known)} (known: {listing(known)})"
            raise table.fail("covariates", text)
    if not name.strip():
        raise table.fail("covariates", "a column needs a name")


def _check_std(table: Declaration, values: Mapping[str, float]) -> None:
    if not table.has("std"):
        return
    given = table.sub("std")
    for name in given.table:
        if name not in values:
            raise table.fail("std", f"of {name!r}, which is no parameter{did_you_mean(name, values)}")
        if given.number(name) < 0.0:
            raise table.fail("std", f"of {name} is {given.number(name):g}, expected 0 or more")


def _called(law: EffectLaw) -> str:
    return " ".join(part for part in names_of(law) if part)


def _unique(values: Iterable[Any]) -> list[Any]:
    return list(dict.fromkeys(values))
