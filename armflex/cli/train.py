"""armflex train: a joint's table into a law."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click
import numpy as np

from armflex.cli.options import OutputPath, PathArgument, json_option, keep_inputs, show_flags, write_json
from armflex.cli.tables import console, number, print_table
from armflex.conventions import TWIST_NAMES
from armflex.errors import InputError
from armflex.joint_data import read_joint_data
from armflex.laws.declared import read_assembly
from armflex.laws.law_file import save_law
from armflex.learning.learners import MODELS, SAMPLERS, Options
from armflex.learning.linear import STRUCTURES
from armflex.learning.train import TrainResult, train


def learning_options(command: Callable) -> Callable:
    """Add what models are learned with."""
    for option in reversed(
        [
            click.option("--structure", type=click.Choice(STRUCTURES), default="full", show_default=True),
            click.option("--features", default="radial,magnitude", show_default=True, help="Of a polynomial model."),
            click.option("--neurons", type=click.IntRange(1, 200), default=20, show_default=True),
            click.option("--starts", type=click.IntRange(1, 100), default=10, show_default=True),
            click.option("--prior", type=click.Choice(("evidence", "none")), default="evidence", show_default=True),
            click.option("--sampler", type=click.Choice(SAMPLERS), help="How a posterior is found."),
            click.option("--seed", type=int, default=0, show_default=True),
            click.option("--allow-unconverged", is_flag=True, help="Take a chain that has not converged."),
            click.option("--assembly", type=PathArgument, help="TOML with the structural model's nodes and beams."),
        ]
    ):
        command = option(command)
    return command


@click.command()
@click.argument("data_path", metavar="JOINT.csv", type=PathArgument)
@click.option("--model", type=click.Choice(MODELS), default="linear", show_default=True)
@learning_options
@click.option("--read-as", multiple=True, metavar="mm=um", help="Take one unit of the header for another.")
@click.option("-o", "--output", required=True, type=OutputPath(), help="Law to write (.safetensors).")
@json_option
def command(
    data_path: Path,
    model: str,
    structure: str,
    features: str,
    assembly: Path | None,
    read_as: tuple[str, ...],
    output: Path,
    json_path: Path | None,
    **others: Any,
) -> None:
    """A joint deformation model, with its error on rows it has not seen."""
    keep_inputs(output)
    data = read_joint_data(data_path, dict(_pair(text) for text in read_as))
    if output.suffix != ".safetensors":
        raise InputError(f"{output}: a law is a .safetensors file; name it so")
    names = tuple(name.strip() for name in features.split(",") if name.strip())
    built = read_assembly(assembly) if assembly else None
    result = train(data, model, structure, Options(features=names, assembly=built, **others))
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
    """Print the error per deflection column, every model that was compared, and what was found."""
    columns = ["deflection", "unit", "training RMS", f"held-out RMS ({result.held_out})"]
    rows = zip(TWIST_NAMES, result.units, result.train_rms, result.held_out_rms, strict=False)
    cells = [[name, unit, number(train, 3), number(held, 3)] for name, unit, train, held in rows]
    print_table(f"{_called(result)}, {result.rows} rows", columns, cells)
    if len(result.compared) > 1:
        _print_compared(result)
    if "compliance" in result.parameters:
        _print_compliance(np.array(result.parameters["compliance"]))
    sampled = {name: value for name, value in asdict(result.diagnostics).items() if value is not None}
    if sampled:
        console().print("Sampler: " + ", ".join(f"{name} {number(value, 4)}" for name, value in sampled.items()))
    if result.coverage_95 is not None:
        console().print(f"{result.coverage_95:.0%} of held-out numbers lie inside their 95 % band.")


def _called(result: TrainResult) -> str:
    detail = result.parameters.get("chosen") or result.parameters.get("structure", "")
    return f"{result.trained.model}{f', {detail}' if detail else ''}"


def _print_compared(result: TrainResult) -> None:
    names = TWIST_NAMES[: len(result.units)]
    cells = [[name, *(number(value, 3) for value in rms)] for name, rms in result.compared]
    print_table("Compared, held-out RMS on the same folds", ["model", *names], cells)


def _print_compliance(compliance: np.ndarray) -> None:
    print_table(
        "Compliance (m/N, rad/Nm and mixed)",
        ["", *(f"per {name}" for name in ("fx", "fy", "fz", "mx", "my", "mz")[: len(compliance)])],
        [[name, *(f"{x:.4g}" for x in row)] for name, row in zip(TWIST_NAMES, compliance, strict=False)],
    )


def as_json(result: TrainResult) -> dict[str, Any]:
    """Return a training for programs; errors in the file's own units."""
    units = list(dict.fromkeys(result.units))
    return {
        "format": "armflex-train-1",
        "model": result.trained.model,
        "rows": result.rows,
        "unit": units[0] if len(units) == 1 else units,
        "train_rms": result.train_rms.tolist(),
        "held_out_rms": result.held_out_rms.tolist(),
        "held_out": result.held_out,
        "parameters": dict(result.parameters),
        "diagnostics": _diagnostics(result),
        "compared": [{"model": name, "held_out_rms": _finite(rms)} for name, rms in result.compared],
        "flags": [str(flag) for flag in result.flags],
    }


def _diagnostics(result: TrainResult) -> dict[str, float | None]:
    """Return what always stands there, and what the sampler that ran adds."""
    sampled = asdict(result.diagnostics)
    always = {"rhat_max": sampled.pop("rhat_max"), "ess_min": sampled.pop("ess_min")}
    more = {name: value for name, value in sampled.items() if value is not None}
    return always | {"coverage_95": result.coverage_95} | more


def _finite(values: np.ndarray) -> list[float | None]:
    """Return numbers for JSON, null where a model could not be fitted."""
    return [float(value) if np.isfinite(value) else None for value in values]
