"""armflex train: a joint's table into a law."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click
import numpy as np
from click.core import ParameterSource

from armflex.bench.fit_linear import STRUCTURES
from armflex.bench.learners import CONCERNS, MODELS, SAMPLERS, Options, affordable_starts, rivals
from armflex.bench.training import CHOICE, TrainResult, train
from armflex.cli.options import Choice, Command, OutputPath, PathArgument, json_option, progress, show_flags, write_json
from armflex.cli.tables import complain, console, number, print_table
from armflex.conventions import TWIST_NAMES
from armflex.errors import InputError
from armflex.laws.declared import read_assembly
from armflex.laws.law_file import save_law
from armflex.measured.joint_data import read_joint_data


def learning_options(command: Callable) -> Callable:
    """Add what models are learned with, each option saying which models it concerns."""
    whole, chosen = click.IntRange, Choice
    for name, kind, default, text in reversed(
        [
            ("structure", chosen(STRUCTURES), "full", "Of the compliance"),
            ("features", str, "radial,magnitude", "What deflections are linear in beside the load; found looks for it"),
            ("neurons", whole(1, 200), 20, "In the hidden layer"),
            ("starts", whole(1, 100), 10, "Trainings, of which the best is kept"),
            ("prior", chosen(("evidence", "none")), "evidence", "none trains plainly, as the paper does"),
            ("sampler", chosen(SAMPLERS), None, "How a posterior is found"),
            ("seed", whole(0), 0, "Of everything random"),
            ("assembly", PathArgument, None, "TOML with nodes, sub-joints and beams"),
            ("module", str, None, "FILE.py:CLASS of your own torch.nn.Module, made without arguments; its code is run"),
        ]
    ):
        given = {"type": kind, "default": default, "show_default": True}
        command = click.option(f"--{name}", help=_help(name, text), **given)(command)
    text = _help("allow_unconverged", "Take a chain that has not converged")
    return click.option("--allow-unconverged", is_flag=True, help=text)(command)


def _help(option: str, text: str) -> str:
    return f"{text} ({', '.join(CONCERNS[option])})." if option in CONCERNS else f"{text}."


@click.command(cls=Command)
@click.argument("data_path", metavar="JOINT.csv", type=PathArgument)
@click.option("--model", type=Choice(MODELS), default="linear", show_default=True)
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
    """Learn a joint deformation model, with its error on rows it has not seen.

    JOINT.csv has loads fx fy fz [mx my mz] on the joint and deflections dx dy dz [rx ry rz], each column with its unit,
    such as fx_kN and dx_mm.
    """
    _check_concern(model)
    data = read_joint_data(data_path, dict(_pair(text) for text in read_as))
    if output.suffix != ".safetensors":
        raise InputError(f"{output}: a law is a .safetensors file; name it so")
    built = read_assembly(assembly) if assembly else None
    names = tuple(name.strip() for name in features.split(",") if name.strip())
    options = Options(features=names, assembly=built, **others)
    if model == "auto":
        tried = "; ".join(rival.name for rival in rivals(options))
        starts = f"from {affordable_starts(options, data.deflections.size)} of {options.starts} starts"
        complain(
            f"comparing on {len(data)} rows: {tried}, {starts}: as many as it has measured numbers for each neuron"
        )
    with progress("learning") as tick:
        result = train(data, model, structure, options, tick)
    print_training(result)
    show_flags(result.flags)
    save_law(result.trained, output)
    write_json(json_path, as_json(result))
    console().print(f'Written to {output}. In an arm.toml: model = "{result.trained.model}", file = "{output.name}"')


def _check_concern(model: str) -> None:
    """Raise where an option was given that the model has no use for."""
    context = click.get_current_context()
    for option, models in CONCERNS.items():
        given = context.get_parameter_source(option) is ParameterSource.COMMANDLINE
        if given and model not in models:
            name = option.replace("_", "-")
            raise InputError(f"--{name} does not concern --model {model} (it does: {', '.join(models)})")


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
    cells = [
        [name, *(number(value, 3) for value in rms), f"{result.seconds.get(name, 0.0):.2f}"]
        for name, rms in result.compared
    ]
    columns = ["model", *names, "took s"]
    if not result.seconds:
        cells, columns = [row[:-1] for row in cells], columns[:-1]
    print_table("Compared, held-out RMS on the same folds", columns, cells)
    if result.seconds:
        left = result.seconds[CHOICE]
        text = "a network is left there as soon as it cannot be chosen any more"
        console().print(f"Choosing anew in every fold, for the held-out error, took {left:.2f} s; {text}.")


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
    found = always | {"coverage_95": result.coverage_95} | more
    return {name: None if value is None else _finite([value])[0] for name, value in found.items()}


def _finite(values: Iterable[float]) -> list[float | None]:
    """Return numbers for JSON, null for one that is not finite: of a model that could not be fitted, a stuck chain."""
    return [value if isinstance(value, int) else float(value) if np.isfinite(value) else None for value in values]
