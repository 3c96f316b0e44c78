"""Whether loads determine what is learned from them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from armflex.conventions import WRENCH_NAMES, Array
from armflex.errors import IdentifiabilityError

WORST_CONDITION = 1e6
"""Of columns of equal length; beyond it some mixture of them is as good as zero on all rows."""

ROUNDING = 1e-15
"""Part of the largest singular value below which a smallest one is none."""

TAKES_PART = 0.1
"""Share from which a column counts among those of a mixture."""


def check_span(loads: Array) -> None:
    """Raise `IdentifiabilityError` where (N, k) loads [N, Nm] do not tell their k components apart."""
    size = loads.shape[1]
    check_determined(loads, WRENCH_NAMES[:size], f"loads do not span their {size} components")


def check_determined(columns: Array, names: Sequence[str], problem: str) -> None:
    """Raise where some mixture of (N, P) columns is as good as zero on all rows, naming what takes part in it.

    Raises:
        IdentifiabilityError: With `problem`, the rank, the condition, and those of the P names.
    """
    scaled = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    _, values, directions = np.linalg.svd(scaled, full_matrices=False)
    lost = values * WORST_CONDITION <= values[0]
    if lost.any():
        free = np.abs(directions[lost]).max(axis=0) > TAKES_PART
        left = [name for name, each in zip(names, free, strict=True) if each]
        condition = float(values[0] / values[-1]) if values[-1] > ROUNDING * values[0] else np.inf
        raise IdentifiabilityError(problem, int((~lost).sum()), condition, left)
