"""A composed joint fitted to what its tip node did: the compliances of its sub-joints, beams taken as declared.

Every diagonal compliance that a sub-joint holds is multiplied by a factor of its own; logarithms keep factors positive.
Sub-joints of the same starting compliance at mirrored places may be told apart by the tip only through the lever arms,
so factors have a wide prior about one, and its share shows in their uncertainty.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from armflex.bench.fitted import NOWHERE, Fitted, predicted, seen_loads, wrenches
from armflex.conventions import TWIST_NAMES, Array
from armflex.errors import IdentifiabilityError, InputError
from armflex.laws.joint.linear import LinearFit, LinearLaw
from armflex.laws.joint.structural import StructuralLaw

WIDE = 3.0
"""Prior standard deviation of a factor's logarithm: a sub-joint within a factor of 400 of the declared one."""

UNKNOWN = 0.9 * WIDE
"""From here on a factor's deviation is the prior's: the data say nothing of that compliance."""


def fit_structural(loads: Array, deflections: Array, assembly: StructuralLaw) -> Fitted:
    """Return the assembly with its sub-joints' compliances fitted.

    Args:
        loads: (N, k) at the assembly's tip node [N, Nm].
        deflections: (N, k) of the tip node [m, rad].
        assembly: Nodes, beams, and sub-joints with starting compliances, all linear.

    Raises:
        InputError: A sub-joint is not linear, the assembly answers no moments but was given some, or there are no more
            readings than compliances.
        IdentifiabilityError: The loads determine none of the compliances.
    """
    free = _free(assembly)
    if loads.shape[1] > assembly.components:
        raise InputError("loads and deflections have 6 components, the assembly 3: expected components = 6 in its file")
    if deflections.size <= len(free):
        raise InputError(f"{deflections.size} readings do not determine {len(free)} compliances of sub-joints")
    scatter = np.maximum(np.sqrt((deflections**2).mean(axis=0)), 1e-12)
    for _ in range(3):  # columns are weighed by their own scatter, which the fit before gives

        def errors(logs: Array, scatter: Array = scatter) -> Array:
            residual = (deflections - predicted(_with(assembly, free, logs), loads)) / scatter
            return np.concatenate([residual.ravel(), logs / WIDE])

        solved = least_squares(errors, np.zeros(len(free)))
        residual = deflections - predicted(_with(assembly, free, solved.x), loads)
        freedom = max(len(loads) - len(free) / deflections.shape[1], 1.0)
        scatter = np.maximum(np.sqrt((residual**2).sum(axis=0) / freedom), 1e-9 * scatter)
    covariance = np.linalg.inv(solved.jac.T @ solved.jac)
    stds = np.sqrt(np.diag(covariance))
    names = [f"{assembly.subjoints[i].node} C_{TWIST_NAMES[axis]}" for i, axis in free]
    if (stds > UNKNOWN).all():
        raise IdentifiabilityError("loads do not determine the compliances of the sub-joints", 0, np.inf, names)
    law = _certain(_with(assembly, free, solved.x), free, stds, loads, scatter)
    linear: list[Any] = [sub.law for sub in law.subjoints]
    compliances = [float(linear[i].compliance[axis, axis]) for i, axis in free]
    found = {
        name: {"value": value, "relative_std": std, "determined": std <= UNKNOWN}
        for name, value, std in zip(names, compliances, stds.tolist(), strict=True)
    }
    return Fitted(law, found)


def _free(assembly: StructuralLaw) -> list[tuple[int, int]]:
    """Return (sub-joint, axis) of every compliance that may be fitted."""
    places = []
    for i, sub in enumerate(assembly.subjoints):
        if not isinstance(sub.law, LinearLaw):
            raise InputError(f"the sub-joint at {sub.node!r} is not linear: only linear ones are fitted")
        places += [(i, a) for a in sub.holds if a < assembly.components and sub.law.compliance[a, a] > 0.0]
    return places


def _with(assembly: StructuralLaw, free: Sequence[tuple[int, int]], logs: Array) -> StructuralLaw:
    """Return the assembly with factors on its compliances; couplings go by the root of both."""
    roots = np.ones((len(assembly.subjoints), 6))
    for (i, axis), value in zip(free, logs, strict=True):
        roots[i, axis] = np.exp(0.5 * value)
    linear: list[Any] = [sub.law for sub in assembly.subjoints]
    subjoints = [
        replace(sub, law=LinearLaw(law.compliance * np.outer(root, root)))
        for sub, law, root in zip(assembly.subjoints, linear, roots, strict=True)
    ]
    return replace(assembly, subjoints=tuple(subjoints))


def _certain(
    law: StructuralLaw, free: Sequence[tuple[int, int]], stds: Array, loads: Array, scatter: Array
) -> StructuralLaw:
    """Return the law with its sub-joints' uncertainty, the loads that they saw, and the scatter of the tip."""
    at_subjoints = [[load for _, load in law.shares(wrench, NOWHERE)] for wrench in wrenches(loads)]
    relative = np.zeros((len(law.subjoints), 6))
    for (i, axis), std in zip(free, stds, strict=True):
        relative[i, axis] = std
    subjoints = []
    for i, sub in enumerate(law.subjoints):
        linear: Any = sub.law
        rows, axes = np.zeros((6, 6, 6)), np.arange(6)
        rows[axes, axes, axes] = (relative[i] * np.diag(linear.compliance)) ** 2
        fit = LinearFit(rows, np.zeros(6), seen_loads(np.array([one[i] for one in at_subjoints])))
        subjoints.append(replace(sub, law=replace(linear, fit=fit)))
    return replace(law, subjoints=tuple(subjoints), noise=np.pad(scatter, (0, 6 - len(scatter))))
