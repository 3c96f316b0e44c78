"""armflex calibrate: fit what [prior] frees to a campaign."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import numpy as np

from armflex.cli.learned import laws_json, print_laws
from armflex.cli.options import (
    Command,
    OutputPath,
    PathArgument,
    declared_arm,
    json_option,
    keep_option,
    points_options,
    progress,
    show_flags,
    write_json,
)
from armflex.cli.tables import console, number, print_table
from armflex.conventions import RESOLUTION
from armflex.errors import InputError, enough_memory
from armflex.estimate import Calibration, calibrate
from armflex.estimate.calibrate import write_calibrated
from armflex.estimate.identify import Parameter
from armflex.estimate.sample import sample_laws
from armflex.measured.measurements import read_measurements
from armflex.measured.point_export import PointExport
from armflex.parameters import Kind
from armflex.sampling.diagnostics import FEWEST_DRAWS

SCATTERED = 1.5
"""Scatter over the stated noise from which an arm is said to lack something."""


@click.command(cls=Command)
@click.argument("arm_path", metavar="ARM", type=PathArgument)
@click.argument("measurements_path", metavar="MEAS.csv", type=PathArgument)
@click.option("-o", "--output", required=True, type=OutputPath(), help="Calibrated arm.toml to write.")
@click.option(
    "--sample", type=click.IntRange(FEWEST_DRAWS), help="Draws per chain: learned laws by NUTS, too (minutes)."
)
@click.option("--all", "show_all", is_flag=True, help="List every parameter, also the unremarkable.")
@keep_option
@points_options
@json_option
def command(
    arm_path: Path,
    measurements_path: Path,
    output: Path,
    sample: int | None,
    show_all: bool,
    keep: bool,
    points: PointExport | None,
    json_path: Path | None,
) -> None:
    """Fit what [prior] frees, on the deflected arm, and say what the data cannot tell."""
    arm = declared_arm(arm_path, "calibrate", keep)
    if sample and keep:
        raise InputError("--keep keeps laws as an earlier campaign taught them: leave out --sample, or --keep")
    if sample and not any(flexure.learn for flexure in arm.flexures):
        raise InputError(f"{arm_path}: no flexure has learn = true: there is no law for --sample")
    measurements = read_measurements(measurements_path, arm, points=points)
    with enough_memory(f"{len(measurements)} rows"), progress("calibrating") as tick:
        found = calibrate(arm, measurements, progress=tick, keep=keep)
    samples = None
    if sample:
        with progress("sampling") as tick:
            samples = sample_laws(found.fit, sample, progress=tick)
    print_calibration(found, show_all)
    print_laws(found, samples)
    show_flags((*measurements.flags, *found.flags))
    write_json(json_path, as_json(found) | {"laws": laws_json(found, samples)})
    write_calibrated(arm_path, found, output)
    console().print(f"Written to {output}.")


def print_calibration(found: Calibration, show_all: bool = False) -> None:
    """Print the error before and after, what was found, and what the data cannot tell."""
    rows = len(found.fit.view.rows)
    columns = ["", "RMS mm", "poses held out mm"]
    held_out = found.held_out or (None, None)
    figures = [
        ["declared, instrument placed", found.declared_rms, held_out[0]],
        ["calibrated", found.rms, held_out[1]],
        ["stated noise", found.noise_rms, None],
    ]
    cells = [[name, *("-" if rms is None else number(rms * 1e3) for rms in pair)] for name, *pair in figures]
    print_table(f"3-D position error over {rows} rows", columns, cells)
    chosen = found.parameters if show_all else _remarkable(found)
    if chosen:
        columns = ["parameter", "value", "± std", "unit", "prior deviations", "the data say"]
        print_table("Parameters" if show_all else "Moved most, against their priors", columns, map(_cells, chosen))
    blind = [p for p in found.undetermined if p.kind is not Kind.LAW]
    if blind:
        columns = ["not told from its prior", "can be exchanged for"]
        cells = [[p.name, ", ".join(p.trades_against) or "moves the readings too little"] for p in blind[:12]]
        more = f" (12 of {len(blind)})" if len(blind) > 12 else ""
        print_table(f"What these data cannot determine{more}", columns, cells)
    if not found.fit.blocks:
        console().print("Nothing was fitted: [prior] frees nothing.")
    if found.scatter > SCATTERED:
        text = (
            f"The readings scatter {found.scatter:.2g} times as much as stated, and were weighed by that: something is"
        )
        console().print(f"{text} missing, which what was fitted may make up for. `armflex trace` looks for it.")
    for outlier in found.outliers[:5]:
        console().print(f"outlier: {outlier.place}, {number(outlier.error_m * 1e3, 3)} mm off")


def _remarkable(found: Calibration) -> list[Parameter]:
    known = [p for p in found.parameters if np.isfinite(p.prior) and p.kind is not Kind.LAW]
    return sorted(known, key=lambda parameter: -abs(parameter.pull))[:8]


def _cells(parameter: Parameter) -> list[str]:
    pull = number(parameter.pull, 2) if np.isfinite(parameter.prior) else "-"
    says = "wrong as declared" if parameter.surprising else "this" if parameter.determined else "nothing"
    least = RESOLUTION if parameter.unit in ("m", "rad") else 0.0
    value, std = number(parameter.value, 4, least), number(parameter.std, 2, least)
    return [parameter.name, value, std, parameter.unit, pull, says]


def as_json(found: Calibration) -> dict[str, Any]:
    """Return a calibration for programs; RMS in mm like that of trace."""
    return {
        "format": "armflex-calibrate-1",
        "rows": len(found.fit.view.rows),
        "noise_rms_mm": found.noise_rms * 1e3,
        "noise_over_stated": found.scatter,
        "rms_mm": {"declared": found.declared_rms * 1e3, "calibrated": found.rms * 1e3},
        "held_out_rms_mm": None
        if found.held_out is None
        else dict(zip(("declared", "calibrated"), (1e3 * rms for rms in found.held_out), strict=True)),
        "parameters": [
            {
                "name": p.name,
                "value": p.value,
                "std": p.std if np.isfinite(p.std) else None,
                "unit": p.unit,
                "prior": p.prior if np.isfinite(p.prior) else None,
                "determined": p.determined,
            }
            for p in found.parameters
        ],
        "findings": [p.name for p in found.findings],
        "not_identifiable": [
            {"parameter": p.name, "trades_against": list(p.trades_against)} for p in found.undetermined
        ],
        "flags": [str(flag) for flag in found.flags],
        "outliers": [{"row": o.row, "place": str(o.place), "error_mm": o.error_m * 1e3} for o in found.outliers],
    }
