"""`train`: a joint's table into a law, with the error it has on rows it has not seen."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import count
from typing import Any

import numpy as np

from armflex.bench.cross_validation import HeldOut, hold_out, predicted, random_folds
from armflex.bench.fitted import Fitted
from armflex.bench.learners import MODELS, Options, learner, rivals
from armflex.bench.model_choice import FOLDS as RIVAL_FOLDS
from armflex.bench.model_choice import OUTER, REPEATS, Compared, assess, chosen, compare, negligible
from armflex.bench.span import check_span
from armflex.bench.training_warnings import bench_doubts, law_doubts
from armflex.conventions import Array
from armflex.errors import Flag, InputError, UnknownNameError
from armflex.laws.law_file import TrainedLaw
from armflex.measured.joint_data import JointData
from armflex.sampling.diagnostics import Diagnostics
from armflex.version import __version__

LEAVE_ONE_OUT_LIMIT = 500
FOLDS = 10

NETWORKS = ("neural", "bayesian", "torch")
"""Models with weights, beside which those without are shown."""

SLOW = (*NETWORKS, "structural")
"""Models that are held out by folds beyond a few rows: each fit takes a while."""

FEW = 25

CHOICE = "the choice anew in every fold"
Progress = Callable[[int, int], None]

CHAIN_FOLDS = 5
"""Of a model that chains are run for: each fit takes seconds to a minute."""


@dataclass(frozen=True)
class TrainResult:
    """A trained law and how far to trust it.

    Attributes:
        trained: The law with its provenance, ready to be saved.
        rows: Number of rows used.
        units: Unit of each deflection column, as the file has it.
        train_rms, held_out_rms: (k,) error of each column in that unit.
        held_out: How rows were held out.
        coverage_95: Share of held-out numbers inside their 95 % band, None where a law carries no uncertainty.
        parameters: What was found, by name.
        diagnostics: Of the sampler, if one ran.
        compared: Every model that was compared, with its held-out error per column in the file's unit.
        flags: Doubts: about the table, softer than any steel joint, asymmetric, compliances that the loads do not
            determine, chains that have not converged, a network that is not worth its weights.
        seconds: How long each model that was compared took, and the choice anew in every fold; of "auto" alone.
    """

    trained: TrainedLaw
    rows: int
    units: tuple[str, ...]
    train_rms: Array
    held_out_rms: Array
    held_out: str
    coverage_95: float | None
    parameters: Mapping[str, Any]
    diagnostics: Diagnostics
    compared: tuple[tuple[str, Array], ...]
    flags: tuple[Flag, ...]
    seconds: Mapping[str, float] = field(default_factory=dict)


def train(
    data: JointData,
    model: str = "linear",
    structure: str = "full",
    options: Options | None = None,
    progress: Progress | None = None,
) -> TrainResult:
    """Return a joint deformation model learned from a table of loads and deflections.

    Args:
        data: See `read_joint_data`.
        model: "linear", "polynomial", "structural", "neural", "bayesian", "torch" (a module of your own, see
            `Options.module`, whose code is run), or "auto": all compared, the plainest taken that is within one
            standard error of the best.
        structure: Of a linear model: "full", "symmetric" or "diagonal".
        options: Everything else that models are learned with; see `Options`.
        progress: Called with (steps done, steps in all).

    Raises:
        UnknownNameError: No such model or option.
        InputError: The loads do not determine the model, or the table cannot be that of a joint.
        ConvergenceError: A chain has not converged and `allow_unconverged` is not set.
    """
    if not isinstance(data, JointData):
        raise InputError(f"expected JointData, such as read_joint_data gives, got {type(data).__name__}")
    if model not in MODELS:
        raise UnknownNameError("joint deformation model to train", str(model), MODELS)
    options = replace(options or Options(), structure=structure)
    doubts = bench_doubts(data)
    if model == "auto":
        return _choose(data, options, doubts, progress)
    learn = learner(model, options)
    fitted = learn(data.loads, data.deflections, options.seed)
    folds = _folds(data, model, options)
    held = hold_out(learn, data, folds, options.seed, _counting(progress, len(np.unique(folds))))
    if model == "torch":  # its weights say nothing of what they leave open
        module: Any = fitted.law
        fitted = replace(fitted, law=replace(module, noise=held.rms))
        doubts = (*doubts, _runs(fitted))
    plain = _plainer(data, model, options)
    return _result(data, model, fitted, held, options, plain, doubts)


def _counting(progress: Progress | None, total: int) -> Callable[..., None]:
    """Return what tells the progress of one more step each time that it is called."""
    done = count(1)

    def step(*seen: object) -> None:
        if progress:
            progress(next(done), total)

    return step


def _folds(data: JointData, model: str, options: Options) -> np.ndarray:
    if model in ("linear", "bayesian") and options.sampler in ("nuts", "metropolis"):
        return random_folds(len(data), CHAIN_FOLDS, options.seed)
    if len(data) <= (FEW if model in SLOW else LEAVE_ONE_OUT_LIMIT):
        return np.arange(len(data))
    return random_folds(len(data), FOLDS, options.seed)


def _plainer(data: JointData, model: str, options: Options) -> tuple[Compared, ...]:
    """Return how models without weights do beside a network, nothing beside other models."""
    if model not in NETWORKS:
        return ()
    return compare([rival for rival in rivals(options) if rival.model != "neural"], data, options.seed)


def _choose(data: JointData, options: Options, doubts: tuple[Flag, ...], progress: Progress | None) -> TrainResult:
    check_span(data.loads)  # else the first rival's first fold would be blamed
    among = rivals(options)
    step = _counting(progress, REPEATS * min(RIVAL_FOLDS, len(data)) * len(among) + min(OUTER, len(data)))
    compared = compare(among, data, options.seed, step=step)
    best = among[chosen(compared, negligible(data.deflections))]
    fitted = best.learner(data.loads, data.deflections, options.seed)
    began = time.perf_counter()
    held, times = assess(among, data, options.seed, step)
    seconds = {one.name: one.seconds for one in compared} | {CHOICE: time.perf_counter() - began}
    parameters = {**fitted.parameters, "chosen": best.name, "chosen_in_folds": times}
    found = _result(data, best.model, replace(fitted, parameters=parameters), held, options, compared, doubts)
    return replace(found, seconds=seconds)


def _result(
    data: JointData,
    model: str,
    fitted: Fitted,
    held: HeldOut,
    options: Options,
    others: Sequence[Compared],
    doubts: tuple[Flag, ...],
) -> TrainResult:
    errors = data.deflections - predicted(fitted.law, data.loads)
    train_rms = np.sqrt((errors**2).mean(axis=0)) / data.factors
    held_out_rms = held.rms / data.factors
    compared = tuple((one.name, one.rms / data.factors) for one in others) or ((model, held_out_rms),)
    metadata = _provenance(data, options, train_rms, held_out_rms, held.how) | _sampled(fitted.diagnostics)
    return TrainResult(
        TrainedLaw(fitted.law, model, metadata),
        len(data),
        data.units,
        train_rms,
        held_out_rms,
        held.how,
        held.coverage,
        fitted.parameters,
        fitted.diagnostics,
        compared,
        (*doubts, *law_doubts(data, fitted), *_worth(model, held, others, negligible(data.deflections))),
    )


def _sampled(diagnostics: Diagnostics) -> dict[str, Any]:
    """Return what the sampler says of itself for a file, nothing where none ran; null for what is not finite."""
    said = {name: value for name, value in asdict(diagnostics).items() if value is not None and name != "seconds"}
    finite = {name: value if np.isfinite(value) else None for name, value in said.items()}
    return {"diagnostics": finite} if finite else {}


def _worth(model: str, held: HeldOut, others: Sequence[Compared], least: Array) -> tuple[Flag, ...]:
    """Return a flag where a model without weights does as well as a network, by the mean of the columns' ratios."""
    plain = [one for one in others if one.model != "neural" and np.isfinite(one.squares).all()]
    networks = [one.rms for one in others if one.model == "neural"]
    if model in NETWORKS:
        networks = [held.rms]
    if not plain or not networks or not np.isfinite(networks[0]).all():
        return ()
    best = min(plain, key=lambda one: float(np.log(np.maximum(one.rms, least)).mean()))
    ratio = float(np.exp(np.log(np.maximum(networks[0], least) / np.maximum(best.rms, least)).mean()))
    if ratio < 0.95:
        return ()
    text = f"a network is not worth its weights here: {ratio:.2f} times the held-out error of {best.name!r}"
    return (Flag("not_worth_its_weights", text),)


def _runs(fitted: Fitted) -> Flag:
    """Return what to know of a law that is code of the user's own."""
    text = f"to load this law runs the Python code of {fitted.parameters['module']}, which must stay as and where it is"
    text = f"{text}; take such laws from people you trust alone. A control loop takes about a millisecond for it"
    return Flag("runs_code", text)


def _provenance(data: JointData, options: Options, train_rms: Array, held_out_rms: Array, how: str) -> dict[str, Any]:
    asked = {key: value for key, value in asdict(replace(options, assembly=None)).items() if value is not None}
    return {
        "armflex": __version__,
        "numpy": np.__version__,
        "data": data.path.name,
        "sha256": data.sha256,
        "rows": len(data),
        "units": list(data.units),
        "options": {key: list(value) if isinstance(value, tuple) else value for key, value in asked.items()},
        "structure": options.structure,
        "train_rms": train_rms.tolist(),
        "held_out_rms": held_out_rms.tolist(),
        "held_out": how,
    }
