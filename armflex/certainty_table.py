"""How well the parameters of a calibrated arm are known, as its file says it.

`parameters` names what the rows of `covariance` are of: block and parameter, 'compliance A4 ry'. An effect's are
'effect LAW SITE AXIS PARAMETER'; where the file has several [[effect]]s of one law, site and axis, those from the
second on have their number before the parameter, in the order of the file: 'effect gear_harmonic A2 rz #2 k'.
"""

from __future__ import annotations

import numpy as np
from safetensors import SafetensorError, safe_open

from armflex.arm import Arm
from armflex.certainty import Certainty
from armflex.conventions import TWIST_NAMES, Array
from armflex.declaration import Declaration
from armflex.effects.spot import site_names


def read_certainty(table: Declaration, arm: Arm) -> Certainty | None:
    """Return the covariance of the fitted parameters; None where it is not given."""
    if not all([table.has("parameters"), table.has("covariance") or table.has("covariance_file")]):
        return None
    labels = table.texts("parameters")
    if len(set(labels)) < len(labels):
        raise table.fail("parameters", "a parameter is named twice")
    covariance = _from_file(table, labels) if table.has("covariance_file") else _from_rows(table, labels)
    if (np.diag(covariance) < 0.0).any():
        raise table.fail("covariance", "a variance is negative")
    misfit = table.number("misfit_m", 0.0)
    if misfit < 0.0:
        raise table.fail("misfit_m", f"a standard deviation cannot be negative, got {misfit:g}")
    return Certainty(labels, covariance, _unexplained(table, arm), _directions(table, len(labels)), misfit)


def _from_rows(table: Declaration, labels: tuple[str, ...]) -> Array:
    """Return a covariance given as the lower triangle's rows."""
    rows = table.table["covariance"]
    expected = f"{len(labels)} rows of 1, 2, ... finite numbers, one for each of the parameters"
    if not isinstance(rows, list) or [len(row) if isinstance(row, list) else 0 for row in rows] != _counts(labels):
        raise table.fail("covariance", f"expected {expected}")
    covariance = np.zeros((len(labels), len(labels)))
    for i, row in enumerate(rows):
        if not all(isinstance(x, int | float) and np.isfinite(x) for x in row):
            raise table.fail("covariance", f"row {i + 1}: expected {expected}")
        covariance[i, : i + 1] = covariance[: i + 1, i] = row
    return covariance


def _from_file(table: Declaration, labels: tuple[str, ...]) -> Array:
    """Return a covariance from the safetensors file beside the arm.toml."""
    path = table.path.parent / table.text("covariance_file")
    try:
        with safe_open(path, framework="numpy") as file:
            if file.get_slice("covariance").get_shape() != [len(labels)] * 2:
                raise table.fail("covariance_file", f"{path.name}: expected one number for every two of the parameters")
            covariance = file.get_tensor("covariance")
    except (SafetensorError, OSError) as error:
        raise table.fail("covariance_file", f"{path.name} cannot be read: {error}") from None
    if covariance.dtype != np.float64 or not np.isfinite(covariance).all():
        raise table.fail("covariance_file", f"{path.name}: expected finite 64-bit floats")
    return covariance


def _directions(table: Declaration, count: int) -> Array | None:
    """Return the (k, count) directions that nothing determined; None where there are none."""
    if not table.has("undetermined"):
        return None
    rows = table.table["undetermined"]
    if not isinstance(rows, list) or not all(isinstance(row, list) and _are_numbers(row, count) for row in rows):
        raise table.fail("undetermined", f"expected rows of {count} finite numbers, one for each of the parameters")
    return np.array(rows, dtype=float) if rows else None


def _are_numbers(row: list, count: int) -> bool:
    return len(row) == count and all(isinstance(x, int | float) and np.isfinite(x) for x in row)


def _counts(labels: tuple[str, ...]) -> list[int]:
    return list(range(1, len(labels) + 1))


def _unexplained(table: Declaration, arm: Arm) -> tuple[str, str, float] | None:
    if not table.has("unexplained"):
        return None
    part = table.sub("unexplained")
    site, axis = part.choice("site", site_names(arm.robot)), part.choice("axis", TWIST_NAMES)
    size = part.number("std")
    part.finish()
    if size < 0.0:
        raise part.fail("std", f"a standard deviation cannot be negative, got {size:g}")
    return site, axis, size
