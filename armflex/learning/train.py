"""`train`: a joint's table into a law, with the error it has on rows it has not seen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from armflex.conventions import Array
from armflex.errors import Flag, InputError, UnknownNameError
from armflex.joint_data import JointData
from armflex.laws.law_file import TrainedLaw
from armflex.laws.linear import LinearLaw, softness
from armflex.learning.linear import FittedCompliance, fit_compliance
from armflex.version import __version__

MODELS = ("linear",)
LEAVE_ONE_OUT_LIMIT = 500
FOLDS = 10


@dataclass(frozen=True)
class TrainResult:
    """A trained law and how far to trust it.

    Attributes:
        trained: The law with its provenance, ready to be saved.
        rows: Number of rows used.
        units: Unit of each deflection column, as the file has it.
        train_rms, held_out_rms: (k,) error of each column in that unit.
        held_out: How rows were held out.
        parameters: Fitted numbers by name, in the file's units.
        flags: Doubts: softer than any steel joint, asymmetric.
    """

    trained: TrainedLaw
    rows: int
    units: tuple[str, ...]
    train_rms: Array
    held_out_rms: Array
    held_out: str
    parameters: Mapping[str, Any]
    flags: tuple[Flag, ...]


def train(data: JointData, model: str = "linear", structure: str = "full") -> TrainResult:
    """Return a joint deformation model learned from a table of loads and deflections.

    Args:
        data: See `read_joint_data`.
        model: "linear".
        structure: "full", "symmetric" or "diagonal".

    Raises:
        UnknownNameError: No such model.
        InputError: The loads do not determine the model.
    """
    if model not in MODELS:
        raise UnknownNameError("joint deformation model to train", model, MODELS)
    fitted = fit_compliance(data.loads, data.deflections, structure)
    law = fitted.law(data.loads)
    left_out, how = held_out_residuals(data, structure)
    train_rms = _rms(data.deflections - data.loads @ fitted.compliance.T) / data.factors
    held_out_rms = _rms(left_out) / data.factors
    metadata = _provenance(data, structure, train_rms, held_out_rms, how)
    parameters = {"structure": structure, "compliance": fitted.compliance.tolist(), "unit": "m/N, rad/Nm"}
    trained = TrainedLaw(law, model, metadata)
    return TrainResult(trained, len(data), data.units, train_rms, held_out_rms, how, parameters, _doubts(law))


def held_out_residuals(data: JointData, structure: str) -> tuple[Array, str]:
    """Return the (N, k) residual of every row from a fit without it (or without its tenth), and the method's name."""
    single = len(data) <= LEAVE_ONE_OUT_LIMIT
    fold = np.arange(len(data)) if single else np.random.default_rng(0).permutation(len(data)) % FOLDS
    residual = np.empty_like(data.deflections)
    for label in np.unique(fold):
        out = fold == label
        fitted = _fit_without(data, out, structure)
        residual[out] = data.deflections[out] - data.loads[out] @ fitted.compliance.T
    return residual, "leave-one-out" if single else f"{FOLDS}-fold"


def _fit_without(data: JointData, out: Array, structure: str) -> FittedCompliance:
    try:
        return fit_compliance(data.loads[~out], data.deflections[~out], structure)
    except InputError as error:
        text = f"the held-out error needs more rows: without data row {int(out.argmax()) + 1}, {error}"
        raise InputError(text) from None


def _rms(residual: Array) -> Array:
    return np.sqrt((residual**2).mean(axis=0))


def _doubts(law: LinearLaw) -> tuple[Flag, ...]:
    flags = softness(law.compliance)
    skew = np.abs(law.compliance - law.compliance.T).max()
    if skew > 1e-9 * np.abs(law.compliance).max():
        flags = (*flags, Flag("asymmetric", f"fitted compliance is not symmetric, by up to {skew:.3g} m/N (Betti)"))
    return flags


def _provenance(data: JointData, structure: str, train_rms: Array, held_out_rms: Array, how: str) -> dict[str, Any]:
    return {
        "armflex": __version__,
        "data": data.path.name,
        "sha256": data.sha256,
        "rows": len(data),
        "units": list(data.units),
        "structure": structure,
        "train_rms": train_rms.tolist(),
        "held_out_rms": held_out_rms.tolist(),
        "held_out": how,
    }
