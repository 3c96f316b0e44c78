"""How long the whitened numbers of a row are by chance: the chi distribution of as many degrees of freedom."""

from __future__ import annotations

from functools import cache

RARE = 1e-3
"""Share of the rows that are farther off than `outlier_limit` by chance."""


@cache
def outlier_limit(size: int) -> float:
    """Return the whitened length of so many numbers beyond which they count less, to one decimal: 4.0 of three."""
    return round(chi_squared(size, RARE) ** 0.5, 1)


@cache
def median_length(size: int) -> float:
    """Return the median length of so many standard normal numbers, to three decimals."""
    return round(chi_squared(size, 0.5) ** 0.5, 3)


def chi_squared(size: int, probability: float) -> float:
    """Return what a chi-squared number of so many degrees of freedom exceeds with a probability."""
    from scipy.special import chdtri  # not needed to import the package

    return float(chdtri(size, probability))
