"""`train`: a joint's table into a law, with the error it has on rows it has not seen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from armflex.conventions import Array
from armflex.errors import Flag, UnknownNameError
from armflex.joint_data import JointData
from armflex.laws.law import Law
from armflex.laws.law_file import TrainedLaw
from armflex.laws.linear import LinearLaw, softness
from armflex.learning.choose import Compared, assess, chosen, compare
from armflex.learning.held_out import HeldOut, hold_out, predicted, random_folds, single_folds
from armflex.learning.learners import MODELS, Options, learner, rivals
from armflex.learning.model import Diagnostics, Fitted
from armflex.version import __version__

LEAVE_ONE_OUT_LIMIT = 500
FOLDS = 10

SLOW = ("neural", "bayesian", "structural")
"""Models that are held out by folds beyond a few rows: each fit takes a while."""

FEW = 25


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
        flags: Doubts: softer than any steel joint, asymmetric, a network that is not worth its weights.
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


def train(
    data: JointData, model: str = "linear", structure: str = "full", options: Options | None = None
) -> TrainResult:
    """Return a joint deformation model learned from a table of loads and deflections.

    Args:
        data: See `read_joint_data`.
        model: "linear", "polynomial", "structural", "neural", "bayesian", or "auto": all compared, the plainest taken
            that is within one standard error of the best.
        structure: Of a linear model: "full", "symmetric" or "diagonal".
        options: Everything else that models are learned with; see `Options`.

    Raises:
        UnknownNameError: No such model or option.
        InputError: The loads do not determine the model.
        ConvergenceError: A chain has not converged and `allow_unconverged` is not set.
    """
    if model not in MODELS:
        raise UnknownNameError("joint deformation model to train", model, MODELS)
    options = replace(options or Options(), structure=structure)
    if model == "auto":
        return _choose(data, options)
    learn = learner(model, options)
    fitted = learn(data.loads, data.deflections, options.seed)
    held = hold_out(learn, data, _folds(data, model, options.seed), options.seed)
    plain = _plainer(data, model, options)
    return _result(data, model, fitted, held, options, plain)


def _folds(data: JointData, model: str, seed: int) -> np.ndarray:
    if len(data) <= (FEW if model in SLOW else LEAVE_ONE_OUT_LIMIT):
        return single_folds(len(data))
    return random_folds(len(data), FOLDS, seed)


def _plainer(data: JointData, model: str, options: Options) -> tuple[Compared, ...]:
    """Return how models without weights do beside a network, nothing beside other models."""
    if model not in ("neural", "bayesian"):
        return ()
    return compare([rival for rival in rivals(options) if rival.model != "neural"], data, options.seed)


def _choose(data: JointData, options: Options) -> TrainResult:
    among = rivals(options)
    compared = compare(among, data, options.seed)
    best = among[chosen(compared)]
    fitted = best.learner(data.loads, data.deflections, options.seed)
    held, count = assess(among, data, options.seed)
    parameters = {**fitted.parameters, "chosen": best.name, "chosen_in_folds": count}
    return _result(data, best.model, replace(fitted, parameters=parameters), held, options, compared)


def _result(
    data: JointData, model: str, fitted: Fitted, held: HeldOut, options: Options, others: Sequence[Compared]
) -> TrainResult:
    train_rms = _rms(data.deflections - predicted(fitted.law, data.loads)) / data.factors
    held_out_rms = held.rms / data.factors
    compared = tuple((one.name, one.rms / data.factors) for one in others) or ((model, held_out_rms),)
    metadata = _provenance(data, options, train_rms, held_out_rms, held.how)
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
        (*_doubts(fitted.law), *_worth(model, held, others)),
    )


def _rms(residual: Array) -> Array:
    return np.sqrt((residual**2).mean(axis=0))


def _doubts(law: Law) -> tuple[Flag, ...]:
    if not isinstance(law, LinearLaw):
        return ()
    flags = softness(law.compliance)
    skew = np.abs(law.compliance - law.compliance.T).max()
    if skew > 1e-9 * np.abs(law.compliance).max():
        flags = (*flags, Flag("asymmetric", f"fitted compliance is not symmetric, by up to {skew:.3g} m/N (Betti)"))
    return flags


def _worth(model: str, held: HeldOut, others: Sequence[Compared]) -> tuple[Flag, ...]:
    """Return a flag where a model without weights does as well as a network, by the mean of the columns' ratios."""
    plain = [one for one in others if one.model != "neural" and np.isfinite(one.squares).all()]
    networks = [one.rms for one in others if one.model == "neural"]
    if model in ("neural", "bayesian"):
        networks = [held.rms]
    if not plain or not networks or not np.isfinite(networks[0]).all():
        return ()
    best = min(plain, key=lambda one: float(np.log(one.rms).mean()))
    ratio = float(np.exp(np.log(networks[0] / best.rms).mean()))
    if ratio < 0.95:
        return ()
    text = f"a network is not worth its weights here: {ratio:.2f} times the held-out error of {best.name!r}"
    return (Flag("not_worth_its_weights", text),)


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
