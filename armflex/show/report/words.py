"""Effects and places in plain words, and numbers as people read them: with their uncertainty, in a handy unit."""

import platform
import re

import numpy as np
import pinocchio

from armflex.conventions import MILLI, RESOLUTION, Shown, shown_in
from armflex.laws.effects.catalogue import EVERY
from armflex.laws.effects.effect import Effect, Words
from armflex.laws.effects.location import BASE, LINK, TOOL
from armflex.parameters import numbered
from armflex.version import __version__

_PINOCCHIO: str = pinocchio.__version__  # pyright: ignore[reportAttributeAccessIssue]
MADE_WITH = f"armflex {__version__}, Pinocchio {_PINOCCHIO}, NumPy {np.__version__}, Python {platform.python_version()}"
"""Versions of what a page was made with."""

PREFIXES = ((1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n"), (1e-12, "p"))
"""Factors of a numerator in metres or radians; metres beyond a few are never kilometres."""


_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_NUMERATOR = re.compile(r"(rad|m)(?=$|/| per )")
_PLAIN = {"1": "", "as recorded": "", "degC": "°C", "deg": "°"}


def measure(value: float, std: float | None, unit: str) -> str:
    """Return a value with its standard uncertainty and unit, such as '1.003 ± 0.013 mrad'.

    Args:
        value, std: In the unit; std None or zero where none is known, which is then said by its absence.
        unit: As laws and blocks name it: 'rad', 'm/N', '1/K', '1', ...
    """
    size = max(abs(value), std or 0.0)
    if unit in ("m", "rad") and size < RESOLUTION:
        return f"0 {unit}"
    factor, unit = scaled(size, unit)
    value, std, size = value / factor, None if std is None else std / factor, size / factor
    power = 0 if size == 0.0 or 1e-3 <= size < 1e5 else int(np.floor(np.log10(size)))
    value, std = value / 10.0**power, None if std is None else std / 10.0**power
    text = with_std(value, std).replace("-", "−")
    if power:
        text = f"({text})" if "±" in text else text
        text += " × 10" + str(power).translate(_SUPERSCRIPT)
    return f"{text} {unit}".strip()


def with_std(value: float, std: float | None) -> str:
    """Return 'value ± std' with one digit of the uncertainty, two where it begins with 1 or 2; three digits without."""
    if not std or not np.isfinite(std):
        return f"{value:.3g}"
    power = int(np.floor(np.log10(std)))
    places = max(0, -power + (std < 3.0 * 10.0**power))
    return f"{value:z.{places}f} ± {std:.{places}f}"


def scaled(size: float, unit: str) -> tuple[float, str]:
    """Return a factor and the unit that it makes of one: 1e-3 and 'mrad' for a size of 0.002 rad."""
    shown = re.sub(r"\^(\d)", lambda match: match[1].translate(_SUPERSCRIPT), _PLAIN.get(unit, unit))
    # Pure numbers below this are read as a share
    if unit in ("1", "1/K") and 0.0 < size < 0.05:
        return (1e-6, "ppm" + unit[1:]) if size < 1e-3 else (1e-2, "%" + unit[1:])
    if not _NUMERATOR.match(unit) or size == 0.0:
        return 1.0, shown
    for factor, prefix in PREFIXES:
        if size >= 0.1 * factor:
            return factor, prefix + shown
    return 1.0, shown


def millimetres(value: float | None, std: float | None = None, unit: str | Shown = "m") -> str:
    """Return an error in an SI unit as people read it, a length [m] in mm; a dash where there is none."""
    if value is None or not np.isfinite(value):
        return "–"
    name, factor = shown_in(unit)
    return f"{with_std(factor * value, factor * std)} {name}" if std else f"{short(factor * value)} {name}"


def change(before: float, after: float, unit: str | Shown = "m") -> str:
    """Return two errors as '1.03 mm → 0.36 mm', with as many digits as it takes to distinguish them."""
    (name, factor), shown = shown_in(unit), ["", ""]
    for places in (2, 3, 4):
        shown = [f"{factor * value:.{places}f}" for value in (before, after)]
        if shown[0] != shown[1]:
            break
    return f"{shown[0]} {name} → {shown[1]} {name}"


def short(value: float) -> str:
    """Return a number with as many digits as its size deserves, such as 0.36, 1.03, 12.4, 120; rounding as 0."""
    if abs(value) < MILLI:
        return "0"
    places = max(0, 2 - max(0, int(np.floor(np.log10(abs(value))))))
    return f"{value:.{places}f}" if abs(value) >= 0.1 else f"{value:#.2g}"


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
    axis = f" ({location.axis})" if location.axis else ""
    partner = f" with {location.partner}" if location.partner else ""
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
