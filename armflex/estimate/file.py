"""[calibration] and [[effect]] in an arm.toml: what a fit found, beside what was declared."""

from __future__ import annotations

import hashlib
import os
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.estimate.calibrate import Calibration
from armflex.estimate.fit import Fit
from armflex.estimate.law_table import law_tables
from armflex.estimate.learn import settled
from armflex.estimate.spread import EFFECT, RANDOM, certainty_of
from armflex.estimate.view import Setup
from armflex.files.certainty_table import LAYOUT
from armflex.files.effect_file import effect_table
from armflex.measured.measurements import Measurements
from armflex.storage.array_file import write_arrays
from armflex.storage.whole_file import remove, write_whole

if TYPE_CHECKING:
    from armflex.trace.result import Trace

MOST_ROWS = 150
"""Parameters from which on their covariance stands in a file of its own: as text it would take seconds to read."""


def write_calibrated(declared: Path, calibration: Calibration, path: Path) -> Path:
    """Write the declared arm.toml with its comments, and a [calibration] table that `load_arm` applies.

    Args:
        declared: The arm.toml that was calibrated.
        calibration: What was found.
        path: The arm.toml to write; files named in it are named relative to its folder.
    """
    return _write(
        declared,
        as_table(calibration.fit, calibration.measurements, calibration.fit.view.rows, calibration.rms),
        (),
        path,
    )


def write_traced(declared: Path, trace: Trace, path: Path) -> Path:
    """Write the declared arm.toml with its comments, [calibration], and an [[effect]] for everything that was found.

    What effects change in the model or the instrument is in their tables alone, so nothing is applied twice. What a
    search has found that still goes on is marked `unfinished` in [calibration].

    Args:
        declared: The arm.toml that was traced.
        trace: What was found.
        path: The arm.toml to write; files named in it are named relative to its folder.
    """
    table = as_table(trace.state.fit, trace.state.measurements, trace.rows, trace.rms)
    if trace.unfinished:
        table = {"unfinished": True, **table}
    return _write(declared, table, [effect_table(found.effect, _stated(found.std)) for found in trace.found], path)


def _stated(std: Mapping[str, float]) -> dict[str, float]:
    """Return the finite ones: [calibration] names what nothing determines."""
    return {name: value for name, value in std.items() if np.isfinite(value)}


def _write(declared: Path, calibration: dict[str, Any], effects: Sequence[dict[str, Any]], path: Path) -> Path:
    import tomlkit  # only when an arm is written

    document = tomlkit.parse(declared.read_text(encoding="utf-8-sig"))
    _move_files(document, declared.parent.resolve(), path.parent.resolve())
    document.pop("calibration", None)
    if effects and "effect" not in document:
        document.append("effect", tomlkit.aot())
    for effect in effects:
        document["effect"].append(_inline(effect))
    document.append("calibration", tomlkit.item(_with_covariance(calibration, path)))
    passing = _passing(path)
    written = write_whole(path, tomlkit.dumps(document).encode())
    for file in passing:
        if file.name != calibration_file(document):
            remove(file)
    return written


def calibration_file(document: Mapping[str, Any]) -> str | None:
    """Return the name of the file beside an arm.toml that holds its covariance, if any."""
    return document.get("calibration", {}).get("covariance_file")


def _passing(path: Path) -> list[Path]:
    """Return the file beside an unfinished arm.toml that holds its covariance: it goes with that arm.toml."""
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return []
    name = calibration_file(document)
    ours = isinstance(name, str) and name.startswith(f"{path.stem}.unfinished-") and Path(name).name == name
    return [path.with_name(name)] if name and ours else []


def _with_covariance(calibration: dict[str, Any], path: Path) -> dict[str, Any]:
    """Return the table with its covariance as rows of the lower triangle, or beside it in a file where it is large."""
    covariance = calibration["covariance"]
    if len(covariance) <= MOST_ROWS:
        rows = [_rounded(row[: i + 1]) for i, row in enumerate(covariance)]
        return calibration | {"covariance": rows}
    # The arm.toml that is there stays whole until the new one takes its place: it keeps its own covariance.
    passing = (
        f".unfinished-{hashlib.sha256(covariance.tobytes()).hexdigest()[:8]}" if calibration.get("unfinished") else ""
    )
    beside = path.with_suffix(f"{passing}.covariance.safetensors")
    written = write_arrays(beside, LAYOUT, {"covariance": covariance}, {"parameters": calibration["parameters"]})
    table = {key: value for key, value in calibration.items() if key != "covariance"}
    return table | {"covariance_file": beside.name, "covariance_sha256": written}


def _inline(effect: dict[str, Any]) -> Any:
    """Return a table whose own tables stand on one line each."""
    import tomlkit

    table = tomlkit.table()
    for key, value in effect.items():
        if isinstance(value, dict):
            line = tomlkit.inline_table()
            line.update(value)
            value = line
        table.append(key, value)
    return table


def _move_files(table: Any, old: Path, new: Path) -> None:
    """Rewrite the relative names under `urdf` and `file`, wherever they are."""
    for key, value in table.items():
        if key in ("urdf", "file") and isinstance(value, str):
            table[key] = Path(os.path.relpath(old / value, new)).as_posix()
        elif isinstance(value, dict):
            _move_files(value, old, new)
        elif isinstance(value, list):
            for item in (item for item in value if isinstance(item, dict)):
                _move_files(item, old, new)


def as_table(fit: Fit, measurements: Measurements, rows: np.ndarray, rms: float) -> dict[str, Any]:
    """Return the [calibration] table of a fit: the declared parameters' values, and all covariances as an array.

    Args:
        fit: The fit.
        measurements: The campaign.
        rows: (K,) numbers of the rows that the error is over.
        rms: RMS of the 3-D position error over them [m].
    """
    setup, certainty = _declared_part(fit), certainty_of(fit)
    instrument, corrections = setup.instrument, setup.arm.corrections
    pose = [*instrument.pose.translation.tolist(), *pin.log3(instrument.pose.rotation).tolist()]
    table = {
        "measurements_sha256": measurements.sha256,
        "rows": len(rows),
        "rms_m": rms,
        "instrument": pose,
        "target": instrument.target.tolist(),
        "scale": instrument.scale,
        "mounting": instrument.mounting.tolist(),
        "joint_offset": dict(corrections.joint_offset),
        "geometry": {name: values.tolist() for name, values in corrections.geometry.items()},
        "compliance": {name: values.tolist() for name, values in setup.arm.factors.items()},
        "sessions": {name: values.tolist() for name, values in instrument.sessions.items()},
    }
    if laws := law_tables(settled(setup.arm, fit)):
        table["law"] = laws
    if certainty.misfit:
        table["misfit_m"] = certainty.misfit
    if certainty.unexplained is not None:
        table["unexplained"] = dict(zip(("site", "axis", "std"), certainty.unexplained, strict=True))
    table["parameters"] = list(certainty.labels)
    if certainty.directions is not None:
        table["undetermined"] = [_rounded(row) for row in certainty.directions]
    table["covariance"] = certainty.covariance
    return table


def _rounded(values: Array) -> list[float]:
    return [float(f"{x:.10e}") for x in values.tolist()]


def _declared_part(fit: Fit) -> Setup:
    """Return the declared setup with the values of declared blocks alone; effects are written by themselves."""
    setup, start = fit.declared, 0
    for block in fit.blocks:
        count = len(block.labels)
        if not block.name.startswith((f"{EFFECT} ", f"{RANDOM} ")):
            setup = block.apply(setup, fit.values[start : start + count])
        start += count
    return setup
