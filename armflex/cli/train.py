"""armflex train: a joint's table into a law."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import numpy as np

from armflex.cli.options import OutputPath, PathArgument, json_option, keep_inputs, show_flags, write_json
from armflex.cli.tables import console, number, print_table
from armflex.conventions import TWIST_NAMES
from armflex.errors import InputError
from armflex.joint_data import read_joint_data
from armflex.laws.law_file import save_law
from armflex.learning.linear import STRUCTURES
from armflex.learning.train import MODELS, TrainResult, train


@click.command()
@click.argument("data_path", metavar="JOINT.csv", type=PathArgument)
@click.option("--model", type=click.Choice(MODELS), default="linear", show_default=True)
@click.option("--structure", type=click.Choice(STRUCTURES), default="full", show_default=True)
@click.option("--read-as", multiple=True, metavar="mm=um", help="Take one unit of the header for another.")
@click.option("-o", "--output", required=True, type=OutputPath(), help="Law to write (.safetensors).")
@json_option
def command(
    data_path: Path,
    model: str,
    structure: str,
    read_as: tuple[str, ...],
    output: Path,
    json_path: Path | None,
) -> None:
    """A joint deformation model, with its error on rows it has not seen."""
    keep_inputs(output)
    data = read_joint_data(data_path, dict(_pair(text) for text in read_as))
    if output.suffix != ".safetensors":
        raise InputError(f"{output}: a law is a .safetensors file; name it so")
    result = train(data, model, structure)
    print_training(result)
    show_flags(result.flags)
    write_json(json_path, as_json(result))
    save_law(result.trained, output)
    console().print(f"Written to {output}.")


def _pair(text: str) -> tuple[str, str]:
    written, equals, meant = text.partition("=")
    if not equals:
        raise InputError(f"--read-as: {text!r} is not of the form mm=um")
    return written.strip(), meant.strip()


def print_training(result: TrainResult) -> None:
    """Print the error per deflection column and the compliance in its units."""
    columns = ["deflection", "unit", "training RMS", f"held-out RMS ({result.held_out})"]
    rows = zip(TWIST_NAMES, result.units, result.train_rms, result.held_out_rms, strict=False)
    cells = [[name, unit, number(train, 3), number(held, 3)] for name, unit, train, held in rows]
    print_table(f"{result.trained.model}, {result.parameters['structure']}, {result.rows} rows", columns, cells)
    compliance = np.array(result.parameters["compliance"])
    print_table(
        "Compliance [m/N, rad/Nm and mixed]",
        ["", *(f"per {name}" for name in ("fx", "fy", "fz", "mx", "my", "mz")[: len(compliance)])],
        [[name, *(f"{x:.4g}" for x in row)] for name, row in zip(TWIST_NAMES, compliance, strict=False)],
    )


def as_json(result: TrainResult) -> dict[str, Any]:
    """Return a training for programs; errors in the file's own units."""
    units = list(dict.fromkeys(result.units))
    held_out = result.held_out_rms.tolist()
    return {
        "format": "armflex-train-1",
        "model": result.trained.model,
        "rows": result.rows,
        "unit": units[0] if len(units) == 1 else units,
        "train_rms": result.train_rms.tolist(),
        "held_out_rms": held_out,
        "held_out": result.held_out,
        "parameters": dict(result.parameters),
        "diagnostics": {"rhat_max": None, "ess_min": None, "coverage_95": None},
        "compared": [{"model": result.trained.model, "held_out_rms": held_out}],
        "flags": [str(flag) for flag in result.flags],
    }
