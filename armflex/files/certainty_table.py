"""How well the parameters of a calibrated arm are known, as its file says it.

`parameters` names what the rows of `covariance` are of: block and parameter, 'compliance A4 ry'. An effect's are
'effect LAW SITE AXIS PARAMETER'; where the file has several [[effect]]s of one law, site and axis, those from the
second on have their number before the parameter, in the order of the file: 'effect gear_harmonic A2 rz #2 k'.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np

from armflex.arm import Arm
from armflex.certainty import Certainty
from armflex.conventions import TWIST_NAMES, Array
from armflex.declaration import Declaration
from armflex.errors import FileError, did_you_mean, listing
from armflex.laws.effects.location import site_names
from armflex.linear_gaussian import covariance_fault
from armflex.parameters import ParameterKind
from armflex.storage.array_file import Layout, read_arrays, write_arrays
from armflex.storage.schema import Numbers

MOST_ROWS = 150
"""Parameters from which on their covariance stands in a file of its own: as text it would take seconds to read."""

BLOCKS = tuple(kind.value for kind in ParameterKind if kind is not ParameterKind.UNEXPLAINED)
"""What the name of every fitted parameter begins with."""

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


def certainty_table(certainty: Certainty) -> dict[str, Any]:
    """Return what of [calibration] says how well the parameters are known, the covariance as an array."""
    table: dict[str, Any] = {}
    if certainty.misfit:
        table["misfit_m"] = certainty.misfit
    if certainty.unexplained is not None:
        table["unexplained"] = dict(zip(("site", "axis", "std"), certainty.unexplained, strict=True))
    table["parameters"] = list(certainty.labels)
    if certainty.directions is not None:
        table["undetermined"] = [_rounded(row) for row in certainty.directions]
    return table | {"covariance": certainty.covariance}


def with_covariance(table: dict[str, Any], path: Path) -> dict[str, Any]:
    """Return [calibration] as the file at `path` is to have it: its covariance as rows of the lower triangle.

    A large one is written to a file beside it.
    """
    covariance = table["covariance"]
    if len(covariance) <= MOST_ROWS:
        return table | {"covariance": [_rounded(row[: i + 1]) for i, row in enumerate(covariance)]}
    # The arm.toml that is there stays whole until the new one takes its place: it keeps its own covariance.
    digest = hashlib.sha256(covariance.tobytes()).hexdigest()[:8]
    passing = f".unfinished-{digest}" if table.get("unfinished") else ""
    beside = path.with_suffix(f"{passing}.covariance.safetensors")
    written = write_arrays(beside, LAYOUT, {"covariance": covariance}, {"parameters": table["parameters"]})
    others = {key: value for key, value in table.items() if key != "covariance"}
    return others | {"covariance_file": beside.name, "covariance_sha256": written}


def _rounded(values: Array) -> list[float]:
    return [float(f"{x:.10e}") for x in values.tolist()]


def read_certainty(table: Declaration, arm: Arm) -> Certainty | None:
    """Return the covariance of the fitted parameters; None where it is not given.

    Args:
        table: [calibration].
        arm: With everything that its file declares, effects and learned laws, too: parameters are looked up in it. One
            that it has no more (another preset) is kept as what it is called.
    """
    if not all([table.has("parameters"), table.has("covariance") or table.has("covariance_file")]):
        return None
    labels = table.texts("parameters")
    if len(set(labels)) < len(labels):
        raise table.fail("parameters", "a parameter is named twice")
    for label in labels:
        if not any(label.startswith(f"{block} ") and label != f"{block} " for block in BLOCKS):
            hint = did_you_mean(label.partition(" ")[0], BLOCKS)
            raise table.fail("parameters", f"{label!r} is no parameter of a fit{hint} (they begin: {listing(BLOCKS)})")
    key = "covariance_file" if table.has("covariance_file") else "covariance"
    covariance = _from_file(table, labels) if key == "covariance_file" else _from_rows(table, labels)
    directions = None
    if table.has("undetermined"):  # directions that nothing determined
        given = table.raw("undetermined")
        lengths = [len(labels)] * len(given) if isinstance(given, list) else []
        expected = f"rows of {len(labels)} finite numbers, one for each of the parameters"
        directions = np.array(table.ragged("undetermined", lengths, expected))
        directions = directions if len(directions) else None
    known = np.ones(len(labels), dtype=bool) if directions is None else ~directions.any(axis=0)
    if (known & (np.diag(covariance) == 0.0)).any():
        label = labels[int((known & (np.diag(covariance) == 0.0)).argmax())]
        raise table.fail(key, f"the variance of {label!r} is zero, which no campaign leaves")
    misfit, unexplained = table.std("misfit_m", 0.0), None
    if table.has("unexplained"):
        part = table.sub("unexplained")
        site, axis = part.choice("site", site_names(arm.robot)), part.choice("axis", TWIST_NAMES)
        unexplained = site, axis, part.std("std")
        part.finish()
    return Certainty(arm.named(labels), covariance, unexplained, directions, misfit)


def _from_rows(table: Declaration, labels: tuple[str, ...]) -> Array:
    """Return a covariance given as the lower triangle's rows."""
    expected = f"{len(labels)} rows of 1, 2, ... finite numbers, one for each of the parameters"
    rows = table.ragged("covariance", range(1, len(labels) + 1), expected)
    covariance = np.zeros((len(labels), len(labels)))
    for i, row in enumerate(rows):
        covariance[i, : i + 1] = covariance[: i + 1, i] = row
    if fault := covariance_fault(covariance):
        raise table.fail("covariance", fault)
    return covariance


def _from_file(table: Declaration, labels: tuple[str, ...]) -> Array:
    """Return a covariance from the safetensors file beside the arm.toml, whose layout says that it must be one."""
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
