"""Numbers as people read them: a value with its standard uncertainty, in a unit that needs no powers of ten."""

from __future__ import annotations

import re

import numpy as np

from armflex.conventions import MILLI, RESOLUTION, SHOWN

PREFIXES = ((1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n"), (1e-12, "p"))
"""Factors of a numerator in metres or radians; metres beyond a few are never kilometres."""

SHARE = 0.05
"""Pure numbers below this are read as a share."""

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
    shown = re.sub(r"\^(\d)", lambda found: found[1].translate(_SUPERSCRIPT), _PLAIN.get(unit, unit))
    if unit in ("1", "1/K") and 0.0 < size < SHARE:
        return (1e-6, "ppm" + unit[1:]) if size < 1e-3 else (1e-2, "%" + unit[1:])
    if not _NUMERATOR.match(unit) or size == 0.0:
        return 1.0, shown
    for factor, prefix in PREFIXES:
        if size >= 0.1 * factor:
            return factor, prefix + shown
    return 1.0, shown


def millimetres(value: float | None, std: float | None = None, unit: str = "m") -> str:
    """Return an error in an SI unit as people read it, a length [m] in mm; a dash where there is none."""
    if value is None or not np.isfinite(value):
        return "–"
    name, factor = SHOWN[unit]
    return f"{with_std(factor * value, factor * std)} {name}" if std else f"{short(factor * value)} {name}"


def change(before: float, after: float, unit: str = "m") -> str:
    """Return two errors as '1.03 mm → 0.36 mm', with as many digits as it takes to distinguish them."""
    (name, factor), shown = SHOWN[unit], ["", ""]
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
