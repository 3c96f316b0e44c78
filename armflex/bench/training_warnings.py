"""What is doubtful about a bench's table, and about a law that was learned from it."""

from __future__ import annotations

import numpy as np

from armflex.bench.cross_validation import wrenches
from armflex.bench.fitted import Fitted
from armflex.conventions import TWIST_NAMES, WRENCH_NAMES
from armflex.errors import Flag, LawError, listing
from armflex.laws.joint.linear import LinearLaw, softness
from armflex.laws.law import NOWHERE, Law
from armflex.measured.joint_data import JointData
from armflex.sampling.diagnostics import shortcomings

AGAINST = -0.5
"""Correlation of a deflection with its own load from which a sign is believed to be turned."""

ASYMMETRY = 3.0
"""Standard deviations that two entries of a compliance may differ by."""


def bench_doubts(data: JointData) -> tuple[Flag, ...]:
    """Return flags for rows that are there twice, deflections that never change, and turned signs.

    Raises:
        LawError: Nothing deflects, or the loads do negative work: a joint cannot give energy to what loads it.
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
    for load, twist, own, moved in zip(WRENCH_NAMES, TWIST_NAMES, data.loads.T, data.deflections.T, strict=False):
        length = float(np.linalg.norm(own) * np.linalg.norm(moved))
        along = float(own @ moved) / length if length else 0.0
        if along < AGAINST:
            text = f"{twist} goes against {load} (correlation {along:.2f}): is the sign of one of them turned?"
            flags.append(Flag("against_its_load", text))
    return tuple(flags)


def law_doubts(data: JointData, fitted: Fitted) -> tuple[Flag, ...]:
    """Return the doubts about what was found; the slope at the mean load stands for a compliance."""
    mean = wrenches(data.loads.mean(axis=0, keepdims=True))[0]
    slope = fitted.law.tangent(mean, NOWHERE)
    flags = softness(slope)
    if not slope[3:].any():
        text = "learned from forces and shifts alone: in an arm this joint does not turn under any load"
        flags = (*flags, Flag("does_not_turn", text))
    flags = (*flags, *_asymmetry(fitted.law))
    free = [name for name, one in fitted.parameters.items() if isinstance(one, dict) and one.get("determined") is False]
    if free:
        text = f"the loads do not determine {listing(free)}: left about as declared"
        flags = (*flags, Flag("not_identified", text))
    if problems := shortcomings(fitted.diagnostics):
        text = f"chains taken unconverged, as asked: {', '.join(problems)}"
        flags = (*flags, Flag("not_converged", text))
    return flags


def _asymmetry(law: Law) -> tuple[Flag, ...]:
    """Return a flag where two entries that Betti says are equal differ by more than their noise explains."""
    if not isinstance(law, LinearLaw) or law.fit is None:
        return ()
    size = len(law.fit.residual_std)
    compliance = law.compliance[:size, :size]
    variance = np.diagonal(law.fit.row_covariance, axis1=1, axis2=2)
    difference, deviation = np.abs(compliance - compliance.T), np.sqrt(variance + variance.T)
    excess = np.where(difference > 0.0, difference / np.maximum(deviation, 1e-300), 0.0)
    i, j = np.unravel_index(excess.argmax(), excess.shape)
    if excess[i, j] < ASYMMETRY:
        return ()
    one, other = (f"{TWIST_NAMES[a]} per {WRENCH_NAMES[b]} = {compliance[a, b]:.3g}" for a, b in ((i, j), (j, i)))
    text = f"{one} and {other} differ by {excess[i, j]:.1f} of their standard deviations; Betti has them equal"
    return (Flag("asymmetric", text),)
