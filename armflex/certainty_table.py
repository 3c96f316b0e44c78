"""How well the parameters of a calibrated arm are known, as its file says it."""

from __future__ import annotations

import numpy as np

from armflex.arm import Arm
from armflex.certainty import Certainty
from armflex.conventions import TWIST_NAMES, Array
from armflex.declaration import Declaration
from armflex.effects.spot import site_names
from armflex.errors import FileError
from armflex.storage.array_file import Layout, read_arrays
from armflex.storage.schema import Numbers

LAYOUT = Layout(
    "the covariance of a calibrated arm",
    "armflex-covariance-1",
    {"covariance": Numbers(("parameters", "parameters"), covariance=True)},
    {"parameters": tuple[str, ...]},
    lambda about: {"parameters": (len(about["parameters"]),)},
    anew="calibrate the arm anew",
    most_bytes=130_000_000,
)
"""Of 4000 parameters at most, so that it is proven positive within seconds."""


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
    if not table.has("covariance_sha256"):
        raise table.fail("covariance_file", f"was made by an earlier version, without its SHA-256: {LAYOUT.anew}")
    digest = table.text("covariance_sha256")
    try:
        found = read_arrays(path, LAYOUT)
    except FileError as error:
        raise table.fail("covariance_file", f"{path.name} {error.problem}") from None
    if found.digest != digest or found.about["parameters"] != labels:
        problem = f"{path.name} is not the file that was written with this table: {LAYOUT.anew}"
        raise table.fail("covariance_file", problem)
    return found.arrays["covariance"]


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
