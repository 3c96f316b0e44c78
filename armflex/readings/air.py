"""How the air bends a line of sight that comes from outside it: a star stands higher than it would in vacuum.

    R = A tan z + B tan^3 z    at the zenith distance z at which it is seen

with A and B of the air at the place (Green, Spherical Astronomy, 1985, eq. 4.31; refractivity of the IAG 1999 for
light, of Rueger 2002 beyond 100 um; scale height of Stone 1996; water vapour of Gill 1982 and Crane 1976), as in SOFA's
iauRefco.
"""

from dataclasses import dataclass

import numpy as np

from armflex.conventions import Array
from armflex.declaration import Declaration

STEEPEST = 0.05
"""Cosine of the zenith distance, 87 degrees, below which the series is that of this one."""

BOUNDS = {"pressure_hPa": (0.0, 1200.0), "temperature_C": (-100.0, 70.0), "humidity": (0.0, 1.0),
          "wavelength_um": (0.1, 1e6)}  # fmt: skip
"""Of the numbers that declare it; beyond them one is in another unit."""

DEFAULTS = {"humidity": 0.0, "wavelength_um": 0.55}


@dataclass(frozen=True)
class Air:
    """The air where an instrument stands.

    Its humidity is relative, 0 to 1; the wavelength [um] is of what is observed.
    """

    pressure_hPa: float
    temperature_C: float
    humidity: float = DEFAULTS["humidity"]
    wavelength_um: float = DEFAULTS["wavelength_um"]

    @property
    def constants(self) -> tuple[float, float]:
        """A and B [rad]."""
        pressure, celsius, kelvin = self.pressure_hPa, self.temperature_C, self.temperature_C + 273.15
        vapour = 0.0
        if pressure > 0.0:
            saturated = 10.0 ** ((0.7859 + 0.03477 * celsius) / (1.0 + 0.00412 * celsius))
            saturated *= 1.0 + pressure * (4.5e-6 + 6e-10 * celsius**2)
            vapour = self.humidity * saturated / (1.0 - (1.0 - self.humidity) * saturated / pressure)
        height = 4.4474e-6 * kelvin
        if self.wavelength_um > 100.0:  # wavelength [um] from which water vapour counts as for radio waves
            refractivity = (77.6890e-6 * pressure - (6.3938e-6 - 0.375463 / kelvin) * vapour) / kelvin
            height -= 0.0074 * vapour * height
        else:
            square = self.wavelength_um**2
            light = 77.53484e-6 + (4.39108e-7 + 3.666e-9 / square) / square
            refractivity = (light * pressure - 11.2684e-6 * vapour) / kelvin
        return refractivity * (1.0 - height), -refractivity * (height - 0.5 * refractivity)


def bending(a: Array | float, b: float, cosine: Array) -> tuple[Array, Array]:
    """Return A tan z + B tan^3 z [rad] and its change with z, for (N,) cosines of the zenith distance as it is seen."""
    near, cosine = cosine > STEEPEST, np.maximum(cosine, STEEPEST)
    tangent = np.sqrt(np.maximum(1.0 - cosine**2, 0.0)) / cosine
    slope = np.where(near, (a + 3.0 * b * tangent**2) / cosine**2, 0.0)
    return a * tangent + b * tangent**3, slope


def read_air(table: Declaration) -> Air:
    """Return the air that `refraction = { pressure_hPa = .., temperature_C = .. }` declares; raise of what is none."""
    air = {name: table.number(name, DEFAULTS.get(name)) for name in BOUNDS}
    for name, (low, high) in BOUNDS.items():
        if not low <= air[name] <= high:
            raise table.fail(name, f"expected {low:g} to {high:g}, got {air[name]:g}")
    table.finish()
    return Air(**air)
