"""armflex train: a joint's table into a law."""

import runpy
import traceback
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click
import numpy as np
from click.core import ParameterSource

from armflex.bench.fit_linear import STRUCTURES
from armflex.bench.learners import CONCERNS, MODELS, SAMPLERS, Options, affordable_starts, candidates
from armflex.bench.training import CHOICE, TrainResult, train
from armflex.cli import options
from armflex.cli.terminal import complain, number, print_table, progress, say
from armflex.conventions import TWIST_NAMES, WRENCH_NAMES
from armflex.errors import InputError, Place, UnknownNameError
from armflex.laws.declared import read_assembly
from armflex.laws.law_file import save_law
from armflex.measured.joint_data import read_joint_data
from armflex.plotting import check_ending
from armflex.storage.whole_file import together


def learning_options(command: Callable) -> Callable:
    """Add what models are learned with, each option saying which models it concerns."""
    whole, chosen = click.IntRange, options.Choice
    for name, kind, default, text in reversed(
        [
            ("structure", chosen(STRUCTURES), "full", "Form of the compliance"),
            ("features", str, "radial,magnitude", "Features in which deflections are linear; found: search for them"),
            ("neurons", whole(1, 200), 20, "Neurons in the hidden layer"),
            ("starts", whole(1, 100), 10, "Number of trainings, of which the best is kept"),
            ("prior", chosen(("evidence", "none")), "evidence", "none: plain training, as in the paper"),
            ("sampler", chosen(SAMPLERS), None, "How the posterior is found"),
            ("seed", whole(0), 0, "Seed of everything random"),
            ("assembly", options.InputPath, None, "TOML with nodes, sub-joints and beams"),
            ("module", str, None, "FILE.py:CLASS of your own torch.nn.Sequential; its code is run"),
        ]
    ):
        given = {"type": kind, "default": default, "show_default": True}
        concerned = f" ({', '.join(CONCERNS[name])})" if name in CONCERNS else ""
        command = click.option(f"--{name}", help=f"{text}{concerned}.", **given)(command)
    text = f"Write the law even if its Markov chain has not converged ({', '.join(CONCERNS['allow_unconverged'])})."
    return click.option("--allow-unconverged", is_flag=True, help=text)(command)


@click.command(cls=options.Command)
@click.argument("data_path", metavar="JOINT.csv", type=options.InputPath)
@click.option("--model", type=options.Choice(MODELS), default="linear", show_default=True)
@learning_options
@click.option("--read-as", multiple=True, metavar="mm=um", help="Read one unit of the header as another.")
@click.option("-o", "--output", required=True, type=options.OutputPath(), help="Law to write (.safetensors).")
@click.option("--picture", type=options.OutputPath(), help="Picture: law, bands, posterior, residuals, errors.")
def command(
    data_path: Path,
    model: str,
    structure: str,
    features: str,
    assembly: Path | None,
    module: str | None,
    read_as: tuple[str, ...],
    output: Path,
    picture: Path | None,
    **others: Any,
) -> None:
    """Learn a joint deformation model, with its error on held-out rows.

    JOINT.csv has loads fx fy fz [mx my mz] on the joint and deflections dx dy dz [rx ry rz], each column with its unit,
    such as fx_kN and dx_mm.
    """
    context = click.get_current_context()
    for option, models in CONCERNS.items():
        given = context.get_parameter_source(option) is ParameterSource.COMMANDLINE
        if given and model not in models:
            name = option.replace("_", "-")
            raise InputError(f"--{name} does not concern --model {model} (it does: {', '.join(models)})")
    meant = [text.partition("=") for text in read_as]
    for text, (_, equals, _) in zip(read_as, meant, strict=True):
        if not equals:
            raise InputError(f"--read-as: {text!r} is not of the form mm=um")
    data = read_joint_data(data_path, {written.strip(): unit.strip() for written, _, unit in meant})
    if picture is not None:
        check_ending(picture)
    if output.suffix != ".safetensors":
        raise InputError(f"{output}: a law is a .safetensors file; name it so")
    built = read_assembly(assembly) if assembly else None
    names = tuple(name.strip() for name in features.split(",") if name.strip())
    how = Options(features=names, assembly=built, module=module_of(module) if module else None, **others)
    if model == "auto":
        tried = "; ".join(candidate.name for candidate in candidates(how))
        starts = f"from {affordable_starts(how, data.deflections.size)} of {how.starts} starts"
        slow = "which takes most of the time: minutes on hundreds of rows"
        complain(f"comparing on {len(data)} rows: {tried}, {starts}, one for each measured number per neuron, {slow}")
    with progress("learning") as tick:
        result = train(data, model, structure, how, tick)
    with together():
        save_law(result.trained, output)
        if picture is not None:
            from armflex.show.view.law_curves import draw_training  # draws

            draw_training(result, data, picture)
        options.conclude(result.content, result.flags)
    print_training(result)
    say(f"Written to {output}. In an arm.toml:", f'model = "{result.trained.model}"', f'file = "{output.name}"')


def module_of(text: str) -> Callable[[], Any]:
    """Return what makes the module that FILE.py:CLASS names; runs that file, and raises where it has none."""
    name, _, called = text.rpartition(":")
    if not name.endswith(".py") or not called.isidentifier():
        raise InputError(f"--module {text!r}: expected FILE.py:CLASS")
    path = Path(name).resolve()

    def guarded(run: Callable[[], Any]) -> Any:
        try:
            return run()
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
        except SyntaxError as error:
            raise InputError(f"{Place(Path(error.filename or path), error.lineno or 0)}: {error.msg}") from None
        except (Exception, SystemExit) as error:
            frames = traceback.extract_tb(error.__traceback__)
            lines = [frame.lineno or 0 for frame in frames if frame.filename == str(path)]
            raise InputError(f"{Place(path, max(lines[-1:], default=0))}: {type(error).__name__}: {error}") from None

    code = guarded(lambda: runpy.run_path(str(path)))
    if not callable(make := code.get(called)):
        classes = [key for key, value in code.items() if callable(value) and not key.startswith("_")]
        raise UnknownNameError(f"class in {path}", called, classes)
    return lambda: guarded(make)


def print_training(result: TrainResult) -> None:
    """Print the error per deflection column, every model that was compared, and what was found."""
    detail = result.parameters.get("chosen") or result.parameters.get("structure", "")
    called = f"{result.trained.model}{f', {detail}' if detail else ''}"
    columns = ["deflection", "unit", "training RMS", f"held-out RMS ({result.held_out})"]
    rows = zip(TWIST_NAMES, result.units, result.train_rms, result.held_out_rms, strict=False)
    cells = [[name, unit, number(train, 3), number(held, 3)] for name, unit, train, held in rows]
    print_table(f"{called}, {result.rows} rows", columns, cells)
    if len(result.compared) > 1:
        timed = ["took s"] if result.seconds else []
        cells = [
            [name, *(number(value, 3) for value in rms), *(f"{result.seconds.get(name, 0.0):.2f}" for _ in timed)]
            for name, rms in result.compared
        ]
        columns = ["model", *TWIST_NAMES[: len(result.units)], *timed]
        print_table("Compared, held-out RMS on the same folds", columns, cells)
        if timed:
            say(
                f"Selecting the model anew in every fold, for the held-out error, took {result.seconds[CHOICE]:.2f} s; "
                "a network is not fitted further there once it cannot be selected."
            )
    if "compliance" in result.parameters:
        compliance = np.array(result.parameters["compliance"])
        print_table(
            "Compliance (m/N, rad/Nm and mixed)",
            ["", *(f"per {name}" for name in WRENCH_NAMES[: len(compliance)])],
            [[name, *(f"{x:.4g}" for x in row)] for name, row in zip(TWIST_NAMES, compliance, strict=False)],
        )
    sampled = {name: value for name, value in asdict(result.diagnostics).items() if value is not None}
    if sampled:
        say("Sampler: " + ", ".join(f"{name} {number(value, 4)}" for name, value in sampled.items()))
    if result.coverage_95 is not None:
        say(f"{result.coverage_95:.0%} of held-out numbers lie inside their 95 % band.")
