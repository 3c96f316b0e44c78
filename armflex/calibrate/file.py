"""[calibration] in an arm.toml: what a fit found, beside what was declared."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from armflex.calibrate.calibrate import Calibration
from armflex.conventions import Array
from armflex.whole_file import write_whole


def write_calibrated(declared: Path, calibration: Calibration, path: Path) -> Path:
    """Write the declared arm.toml with its comments, and a [calibration] table that `load_arm` applies.

    Args:
        declared: The arm.toml that was calibrated.
        calibration: What was found.
        path: The arm.toml to write; files named in it are named relative to its folder.
    """
    import tomlkit  # only when an arm is written

    document = tomlkit.parse(declared.read_text(encoding="utf-8-sig"))
    _move_files(document, declared.parent.resolve(), path.parent.resolve())
    document.pop("calibration", None)
    document.append("calibration", tomlkit.item(as_table(calibration)))
    return write_whole(path, tomlkit.dumps(document).encode())


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


def as_table(calibration: Calibration) -> dict[str, Any]:
    """Return the [calibration] table of a fit."""
    arm, instrument = calibration.arm, calibration.fit.setup.instrument
    pose = [*instrument.pose.translation.tolist(), *pin.log3(instrument.pose.rotation).tolist()]
    factors = {name: values.tolist() for name, values in _log_factors(calibration).items()}
    covariance = calibration.fit.covariance
    return {
        "measurements_sha256": calibration.measurements.sha256,
        "rows": len(calibration.fit.view.rows),
        "rms_m": calibration.rms,
        "instrument": pose,
        "target": instrument.target.tolist(),
        "joint_offset": dict(arm.corrections.joint_offset),
        "geometry": {name: values.tolist() for name, values in arm.corrections.geometry.items()},
        "compliance": factors,
        "sessions": {name: values.tolist() for name, values in instrument.sessions.items()},
        "parameters": [parameter.name for parameter in calibration.parameters],
        "covariance": [[float(f"{x:.6e}") for x in row[: i + 1]] for i, row in enumerate(covariance)],
    }


def _log_factors(calibration: Calibration) -> dict[str, Array]:
    """Return (6,) logarithms of the factors on every flexure's compliance axes."""
    found: dict[str, Array] = {}
    for block in calibration.fit.blocks:
        if block.name == "compliance":
            values = iter(calibration.fit.value("compliance"))
            for name, axes in zip(block.flexures, block.axes, strict=True):
                found[name] = np.zeros(6)
                found[name][list(axes)] = [next(values) for _ in axes]
    return found
