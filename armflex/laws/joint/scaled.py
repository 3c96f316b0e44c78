"""A linear law made softer or stiffer along its axes, as calibration does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from armflex.conventions import Array
from armflex.errors import LawError
from armflex.laws.joint.linear import LinearFit, LinearLaw
from armflex.laws.joint.position_dependent import PositionDependentLaw
from armflex.laws.law import Law


def scaled(law: Law, factor: Array) -> Law:
    """Return a linear law with C replaced by S C S, S = diag of (6,) factors.

    Raises:
        LawError: The law has no compliance to scale.
    """
    square = np.outer(factor, factor)
    if isinstance(law, LinearLaw):
        fit = None if law.fit is None else _scaled_fit(law.fit, square)
        return replace(law, compliance=law.compliance * square, fit=fit)
    if isinstance(law, PositionDependentLaw):
        return replace(law, coefficients=law.coefficients * square)
    raise LawError(f"a {type(law).__name__} has no compliance to scale")


def _scaled_fit(fit: LinearFit, square: Array) -> LinearFit:
    """Return what is not known of entries that are each times those of `square`; readings scatter as before."""
    size = len(fit.residual_std)
    rows = square[:size, :size]
    return replace(fit, row_covariance=fit.row_covariance * rows[:, :, None] * rows[:, None, :])
