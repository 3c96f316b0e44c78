"""A composed joint fitted to what its tip node did: the compliances of its sub-joints, beams taken as declared.

Every diagonal compliance that a sub-joint holds is multiplied by a factor of its own; logarithms keep factors positive.
Sub-joints of the same starting compliance at mirrored places may differ for the tip only through the lever arms,
so factors have a wide prior about one, and its share shows in their uncertainty.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

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
    free: list[tuple[int, int]] = []
    declared: list[Array] = []
    for i, sub in enumerate(assembly.subjoints):
        if not isinstance(sub.law, LinearLaw):
            raise InputError(f"the sub-joint at {sub.node!r} is not linear: only linear ones are fitted")
        declared.append(sub.law.compliance)
        free += [(i, a) for a in sub.holds if a < assembly.components and sub.law.compliance[a, a] > 0.0]
    if loads.shape[1] > assembly.components:
        raise InputError("loads and deflections have 6 components, the assembly 3: expected components = 6 in its file")
    if deflections.size <= len(free):
        raise InputError(f"{deflections.size} readings do not determine {len(free)} compliances of sub-joints")

    def laws(logs: Array) -> list[LinearLaw]:
        """Return the sub-joints' laws with factors on their compliances; couplings have the root of both's product."""
        roots = np.ones((len(declared), 6))
        for (i, axis), value in zip(free, logs, strict=True):
            roots[i, axis] = np.exp(0.5 * value)
        return [LinearLaw(own * np.outer(root, root)) for own, root in zip(declared, roots, strict=True)]

    def joined(own: Sequence[LinearLaw]) -> StructuralLaw:
        """Return the assembly with these laws."""
        pairs = zip(assembly.subjoints, own, strict=True)
        return replace(assembly, subjoints=tuple(replace(sub, law=law) for sub, law in pairs))

    scatter = np.maximum(np.sqrt((deflections**2).mean(axis=0)), 1e-12)
    for _ in range(3):  # columns are weighed by their own scatter, which the fit before gives

        def errors(logs: Array, scatter: Array = scatter) -> Array:
            return np.append((deflections - predicted(joined(laws(logs)), loads)) / scatter, logs / WIDE)

        solved = least_squares(errors, np.zeros(len(free)))
        law = joined(laws(solved.x))
        residual = deflections - predicted(law, loads)
        freedom = max(len(loads) - len(free) / deflections.shape[1], 1.0)
        scatter = np.maximum(np.sqrt((residual**2).sum(axis=0) / freedom), 1e-9 * scatter)
    stds = np.sqrt(np.diag(np.linalg.inv(solved.jac.T @ solved.jac)))
    names = [f"{assembly.subjoints[i].node} C_{TWIST_NAMES[axis]}" for i, axis in free]
    if (stds > UNKNOWN).all():
        raise IdentifiabilityError("loads do not determine the compliances of the sub-joints", 0, np.inf, names)
    # The law states its sub-joints' uncertainty, the loads that they saw, and the scatter of the tip.
    shares = [[load for _, load in law.shares(wrench, NOWHERE)] for wrench in wrenches(loads)]
    fits, found, axes = laws(solved.x), {}, np.arange(6)
    for i, own in enumerate(fits):
        known = {axis: std for (place, axis), std in zip(free, stds.tolist(), strict=True) if place == i}
        rows = np.zeros((6, 6, 6))
        rows[axes, axes, axes] = [(known.get(axis, 0.0) * own.compliance[axis, axis]) ** 2 for axis in range(6)]
        seen = seen_loads(np.array([each[i] for each in shares]))
        fits[i] = replace(own, fit=LinearFit(rows, np.zeros(6), seen))
    for name, (i, axis), std in zip(names, free, stds.tolist(), strict=True):
        value = float(fits[i].compliance[axis, axis])
        found[name] = {"value": value, "relative_std": std, "determined": std <= UNKNOWN}
    return Fitted(replace(joined(fits), noise=np.pad(scatter, (0, 6 - len(scatter)))), found)
