"""Effects and places in plain words."""

from __future__ import annotations

from armflex.laws.effects.catalogue import EVERY
from armflex.laws.effects.effect import Effect, Words
from armflex.laws.effects.location import BASE, LINK, TOOL
from armflex.parameters import numbered

SITES = {BASE: "the base", TOOL: "the tool", LINK + TOOL: "the last link"}


def words(effect: str) -> Words:
    """Return the words for a law; of one that is not in the catalogue, its name."""
    return EVERY[effect].words if effect in EVERY else Words(effect.replace("_", " "), "", "")


def site_words(site: str) -> str:
    """Return a site in words: 'A5', 'the link ending at A5', 'the base'."""
    if site in SITES:
        return SITES[site]
    return f"the link ending at {site.removeprefix(LINK)}" if site.startswith(LINK) else site


def called(effect: Effect, number: int = 1) -> str:
    """Return an effect in words: 'backlash at A5 (rz)'; an unnamed one says which column it depends on.

    `number` is which of its name it is in the arm, see `numbers_of`: the second ends in #2.
    """
    title = effect.law.words.title
    if not effect.law.physical:
        shape, columns = title.removeprefix("unnamed "), " and ".join(effect.location.covariates)
        title = f"an unnamed effect (a {shape} in {columns})"
    location = effect.location
    axis, partner = (
        f" ({location.axis})" if location.axis else "",
        f" with {location.partner}" if location.partner else "",
    )
    return f"{title} at {site_words(location.site)}{axis}{partner}{numbered(number)}"


def units_of(effect: Effect) -> dict[str, str]:
    """Return the unit of every value by name; one per unit of a column says which column."""
    location = effect.location
    column = location.covariates[-1] if location.covariates else "its column"
    units = [unit.replace("per recorded", f"per unit of {column}") for unit in effect.units]
    return dict(zip(effect.named, units, strict=True))


def labelled(effect: Effect, number: int = 1) -> str:
    """Return an effect in as few words as distinguish it from its hypotheses: law, place, number, terms, columns."""
    law, location = effect.law, effect.location
    terms = [law.amplitudes[i].name for i in location.terms]
    which = f" [{' '.join(terms)}]" if 0 < len(terms) < len(law.amplitudes) else ""
    against = f" ~ {', '.join(location.covariates)}" if law.shape else ""
    return f"{effect.name}{numbered(number)}{which}{against}"


def joined(parts: list[str]) -> str:
    """Return parts as a sentence lists them: 'a, b and c'."""
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"
