"""`train`: a joint's table into a law, with its error on held-out rows, and what is doubtful about both."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from armflex.arguments import checked_kinds
from armflex.bench.cross_validation import FOLDS as CHOICE_FOLDS
from armflex.bench.cross_validation import (
    OUTER,
    REPEATS,
    HeldOutFolds,
    ModelScore,
    assess,
    chosen,
    compare,
    hold_out,
    negligible,
    random_folds,
)
from armflex.bench.fitted import NOWHERE, Fitted, check_span, predicted, wrenches
from armflex.bench.learners import MODELS, Options, affordable_starts, candidates, learner
from armflex.conventions import TWIST_NAMES, WRENCH_NAMES, Array
from armflex.errors import Flag, InputError, LawError, UnknownNameError, listing
from armflex.laws.joint.linear import LinearLaw, softness
from armflex.laws.law import Law
from armflex.laws.law_file import TrainedLaw
from armflex.measured.joint_data import JointData, as_joint_data
from armflex.measured.table import Tabular
from armflex.progress import Progress
from armflex.result import Result, record
from armflex.sampling.diagnostics import Diagnostics, shortcomings
from armflex.version import __version__

FOLDS = 10

NETWORKS = ("neural", "bayesian", "torch")
"""Models with weights, beside which those without are shown."""

SLOW = (*NETWORKS, "structural")
"""Models that are held out by folds beyond a few rows: each fit takes a while."""

FEW = 25

CHAIN_FOLDS = 5
"""Of a model that chains are run for: each fit takes seconds to a minute."""


AGAIN = 3
"""Fits of a network in a choice anew, of six that it may take: it is mostly left before."""

CHOICE = "the choice anew in every fold"


@dataclass(frozen=True, repr=False)
class TrainResult(Result):
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
        compared: Every model that was compared, with its (k,) held-out error per column in the file's unit.
        flags: Flags: about the table, softer than any steel joint, asymmetric, compliances that the loads do not
            determine, chains that have not converged, a network that is not worth its weights.
        seconds: How long each model that was compared took, and the choice anew in every fold; of "auto" alone.
    """

    ROWS = "table"

    def content(self) -> dict[str, Any]:
        """Return the training as docs/train.md has it; errors in the file's own unit."""
        # Two diagnostics and the coverage always stand there; what else there is the sampler that ran adds.
        sampled = {name: value for name, value in asdict(self.diagnostics).items() if value is not None}
        always = dict.fromkeys(("rhat_max", "ess_min")) | record(self, "coverage_95")
        return {
            **record(self, "rows units train_rms held_out_rms held_out parameters flags", model="trained.model"),
            "unit": self.units[0] if len({*self.units}) == 1 else None,
            "diagnostics": always | sampled,
            "compared": self.table,
        }

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

    @property
    def table(self) -> list[dict[str, Any]]:
        """Held-out error of every model that was compared, by column of the file, in the file's unit."""
        return [{"model": name, "held_out_rms": errors} for name, errors in self.compared]


@checked_kinds
def train(
    data: JointData | Tabular,
    model: str = "linear",
    structure: str = "full",
    options: Options | None = None,
    progress: Progress | None = None,
) -> TrainResult:
    """Return a joint deformation model learned from a table of loads and deflections.

    Args:
        data: See `read_joint_data`.
        model: "linear", "polynomial", "structural", "neural", "bayesian", "torch" (layers of your own, see
            `Options.module`), or "auto": all compared, the plainest taken that is within one
            standard error of the best.
        structure: Of a linear model: "full", "symmetric" or "diagonal".
        options: Everything else that models are learned with; see `Options`.
        progress: Called with (steps done, steps in all).

    Raises:
        UnknownNameError: No such model or option.
        InputError: The loads do not determine the model, or the table cannot be that of a joint.
        ConvergenceError: A chain has not converged and `allow_unconverged` is not set.
    """
    data = as_joint_data(data)
    if not isinstance(data, JointData):
        raise InputError(f"expected JointData, such as read_joint_data gives, got {type(data).__name__}")
    if model not in MODELS:
        raise UnknownNameError("joint deformation model to train", str(model), MODELS)
    options = replace(options or Options(), structure=structure)
    flags, seconds, seed = bench_flags(data), {}, options.seed
    if model == "auto":
        check_span(data.loads)  # else the first candidate's first fold would be blamed
        among = candidates(options)
        each, anew = REPEATS * min(CHOICE_FOLDS, len(data)), min(OUTER, len(data))
        # Fits of a plain model that take as long as one training of a network, about
        network = 10 * affordable_starts(options, data.deflections.size)
        total = each * (len(among) - 1 + network) + anew * AGAIN * network
        plain, slow, again = map(_counting(progress, total), (1, network, AGAIN * network))
        compared = compare(among[:-1], data, seed, step=plain) + compare(among[-1:], data, seed, step=slow)
        best = among[chosen(compared, negligible(data.deflections))]
        model, fitted = best.model, best.learner(data.loads, data.deflections, seed)
        began = time.perf_counter()
        held, times = assess(among, data, seed, again)
        seconds = {candidate.name: candidate.seconds for candidate in compared} | {CHOICE: time.perf_counter() - began}
        fitted = replace(fitted, parameters={**fitted.parameters, "chosen": best.name, "chosen_in_folds": times})
    else:
        learn, folds = learner(model, options), _folds(data, model, options)
        # What models without weights do is shown beside a network.
        plain = [other for other in candidates(options) if other.model != "neural"] if model in NETWORKS else []
        step = _counting(progress, 1 + len(np.unique(folds)) + REPEATS * min(CHOICE_FOLDS, len(data)) * len(plain))(1)
        fitted = learn(data.loads, data.deflections, seed)
        step()
        held = hold_out(learn, data, folds, seed, step)
        if model == "torch":  # its weights say nothing of what they leave open
            module: Any = fitted.law
            fitted = replace(fitted, law=replace(module, noise=held.rms))
        compared = compare(plain, data, seed, step=step)
    errors = (data.deflections - predicted(fitted.law, data.loads)) / data.factors
    train_rms, held_out_rms = np.sqrt((errors**2).mean(axis=0)), held.rms / data.factors
    return TrainResult(
        trained=TrainedLaw(fitted.law, model, _metadata(data, options, fitted, held, train_rms)),
        rows=len(data),
        units=data.units,
        train_rms=train_rms,
        held_out_rms=held_out_rms,
        held_out=held.how,
        coverage_95=held.coverage,
        parameters=fitted.parameters,
        diagnostics=fitted.diagnostics,
        compared=tuple((candidate.name, candidate.rms / data.factors) for candidate in compared)
        or ((model, held_out_rms),),
        flags=(*flags, *law_flags(data, fitted), *_worth(model, held, compared, negligible(data.deflections))),
        seconds=seconds,
    )


def _metadata(data: JointData, options: Options, fitted: Fitted, held: HeldOutFolds, rms: Array) -> dict[str, Any]:
    """Return what a law's file says of how it was trained; `rms` (k,) is in the table's units."""
    plain_options = asdict(replace(options, assembly=None, module=None))
    given = {key: value for key, value in plain_options.items() if value is not None}
    metadata = {
        "armflex": __version__,
        "numpy": np.__version__,
        "data": data.path.name,
        "sha256": data.sha256,
        "rows": len(data),
        "units": list(data.units),
        "options": {key: list(value) if isinstance(value, tuple) else value for key, value in given.items()},
        "structure": options.structure,
        "train_rms": rms.tolist(),
        "held_out_rms": (held.rms / data.factors).tolist(),
        "held_out": held.how,
    }
    # What the sampler says of itself, nothing where none ran; null for what is not finite.
    said = {key: value for key, value in asdict(fitted.diagnostics).items() if value is not None and key != "seconds"}
    if said:
        metadata["diagnostics"] = {name: value if np.isfinite(value) else None for name, value in said.items()}
    return metadata


def _counting(progress: Progress | None, total: int) -> Callable[[int], Callable[..., None]]:
    """Return what makes, of a size, what reports the progress of one more step of that size each time it is called."""
    done = 0

    def sized(size: int) -> Callable[..., None]:
        def step(*seen: object) -> None:
            nonlocal done
            done += size
            if progress:
                progress(done, total)

        return step

    return sized


def _folds(data: JointData, model: str, options: Options) -> np.ndarray:
    if model == "bayesian" and options.sampler in ("nuts", "metropolis"):
        return random_folds(len(data), CHAIN_FOLDS, options.seed)
    if len(data) <= (FEW if model in SLOW else 500):
        return np.arange(len(data))
    return random_folds(len(data), FOLDS, options.seed)


def bench_flags(data: JointData) -> tuple[Flag, ...]:
    """Return flags for rows that are there twice, deflections that never change, and turned signs.

    `LawError` is raised where nothing deflects, or loads do negative work: a joint cannot give energy to what loads it.
    """
    if not data.deflections.any():
        raise LawError("every deflection is 0: there is nothing to learn")
    work = (data.loads * data.deflections).sum(axis=1)
    if work.sum() < 0.0:
        text = f"loads do negative work on the deflections in {int((work < 0.0).sum())} of {len(data)} rows"
        raise LawError(f"{text}: expected the load ON the structure, not its reaction")
    flags = []
    first = np.unique(np.hstack([data.loads, data.deflections]), axis=0, return_index=True)[1]
    again = np.setdiff1d(np.arange(len(data)), first)
    if len(again):
        text = f"{len(again)} rows repeat an earlier one to the last digit, first data row {again[0] + 1}; each counts"
        flags.append(Flag("duplicate_rows", f"{text}, and a row held out is known from its copy"))
    for name, unit, factor, values in zip(TWIST_NAMES, data.units, data.factors, data.deflections.T, strict=False):
        if (values == values[0]).all():
            text = f"{name} is {values[0] / factor:g} {unit} on every row: a sensor that was not connected?"
            flags.append(Flag("constant_column", text))
    for load, twist, pushed, moved in zip(WRENCH_NAMES, TWIST_NAMES, data.loads.T, data.deflections.T, strict=False):
        length = float(np.linalg.norm(pushed) * np.linalg.norm(moved))
        along = float(pushed @ moved) / length if length else 0.0
        # Correlation of a deflection with its own load from which a sign counts as turned
        if along < -0.5:
            text = f"{twist} goes against {load} (correlation {along:.2f}): is the sign of one of them turned?"
            flags.append(Flag("against_its_load", text))
    return tuple(flags)


def law_flags(data: JointData, fitted: Fitted) -> tuple[Flag, ...]:
    """Return the flags about what was found; the slope at the mean load stands for a compliance."""
    slope = fitted.law.tangent(wrenches(data.loads.mean(axis=0, keepdims=True))[0], NOWHERE)
    flags = list(softness(slope))
    if not slope[3:].any():
        text = "learned from forces and shifts alone: in an arm this joint does not turn under any load"
        flags.append(Flag("does_not_turn", text))
    if text := _asymmetry(fitted.law):
        flags.append(Flag("asymmetric", text))
    free = [
        name
        for name, parameter in fitted.parameters.items()
        if isinstance(parameter, dict) and parameter.get("determined") is False
    ]
    if free:
        flags.append(Flag("not_identified", f"the loads do not determine {listing(free)}: left about as declared"))
    if problems := shortcomings(fitted.diagnostics):
        flags.append(Flag("not_converged", f"chains taken unconverged, as asked: {', '.join(problems)}"))
    return tuple(flags)


def _asymmetry(law: Law) -> str:
    """Return which two entries that Betti says are equal differ by more than their noise explains, '' for none."""
    if not isinstance(law, LinearLaw) or law.fit is None:
        return ""
    size = len(law.fit.residual_std)
    compliance = law.compliance[:size, :size]
    variance = np.diagonal(law.fit.row_covariance, axis1=1, axis2=2)
    difference, deviation = np.abs(compliance - compliance.T), np.sqrt(variance + variance.T)
    excess = np.where(difference > 0.0, difference / np.maximum(deviation, 1e-300), 0.0)
    i, j = np.unravel_index(excess.argmax(), excess.shape)
    entry, other = (f"{TWIST_NAMES[a]} per {WRENCH_NAMES[b]} = {compliance[a, b]:.3g}" for a, b in ((i, j), (j, i)))
    text = f"{entry} and {other} differ by {excess[i, j]:.1f} of their standard deviations; Betti has them equal"
    return text if excess[i, j] >= 3.0 else ""  # standard deviations that two entries of a compliance may differ by


def _worth(model: str, held: HeldOutFolds, others: Sequence[ModelScore], least: Array) -> tuple[Flag, ...]:
    """Return a flag where a model without weights does as well as a network, by the mean of the columns' ratios."""
    plain = [candidate for candidate in others if candidate.model != "neural" and np.isfinite(candidate.squares).all()]
    networks = [held.rms] if model in NETWORKS else [other.rms for other in others if other.model == "neural"]
    if not plain or not networks or not np.isfinite(networks[0]).all():
        return ()
    best = min(plain, key=lambda candidate: float(np.log(np.maximum(candidate.rms, least)).mean()))
    ratio = float(np.exp(np.log(np.maximum(networks[0], least) / np.maximum(best.rms, least)).mean()))
    if ratio < 0.95:
        return ()
    text = f"a network does not improve on a plainer model here: {ratio:.2f} times the held-out error of {best.name!r}"
    return (Flag("not_worth_its_weights", text),)
