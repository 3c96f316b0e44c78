"""A composed joint fitted to what its tip node did: the compliances of its sub-joints, beams taken as declared.

Every diagonal compliance that a sub-joint holds is multiplied by a factor of its own; logarithms keep factors positive.
Sub-joints of the same starting compliance at mirrored places may differ for the tip only through the lever arms,
so factors have a wide prior about one, and its share shows in their uncertainty.
"""

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
    for sub in assembly.subjoints:
        if not isinstance(sub.law, LinearLaw):
            raise InputError(f"the sub-joint at {sub.node!r} is not linear: only linear ones are fitted")
    if loads.shape[1] > assembly.components:
        raise InputError("loads and deflections have 6 components, the assembly 3: expected components = 6 in its file")
    freed = assembly.learned({})
    assert freed is not None
    free = [(i, TWIST_NAMES.index(parameter.name)) for i, law in enumerate(freed.laws) for parameter in law.parameters]
    if deflections.size <= len(free):
        raise InputError(f"{deflections.size} readings do not determine {len(free)} compliances of sub-joints")
    scatter = np.maximum(np.sqrt((deflections**2).mean(axis=0)), 1e-12)
    for _ in range(3):  # columns are weighed by their own scatter, which the fit before gives

        def errors(logs: Array, scatter: Array = scatter) -> Array:
            return np.append((deflections - predicted(freed.at(logs), loads)) / scatter, logs / WIDE)

        solved = least_squares(errors, np.zeros(len(free)))
        law = freed.at(solved.x)
        residual = deflections - predicted(law, loads)
        freedom = max(len(loads) - len(free) / deflections.shape[1], 1.0)
        scatter = np.maximum(np.sqrt((residual**2).sum(axis=0) / freedom), 1e-9 * scatter)
    assert isinstance(law, StructuralLaw)
    stds = np.sqrt(np.diag(np.linalg.inv(solved.jac.T @ solved.jac)))
    names = [f"{assembly.subjoints[i].node} C_{TWIST_NAMES[axis]}" for i, axis in free]
    if (stds > UNKNOWN).all():
        raise IdentifiabilityError("loads do not determine the compliances of the sub-joints", 0, np.inf, names)
    # The law states its sub-joints' uncertainty, the loads that they saw, and the scatter of the tip.
    shares = [[load for _, load in law.shares(wrench, NOWHERE)] for wrench in wrenches(loads)]
    fits, parameters, axes = list[LinearLaw](), {}, np.arange(6)
    for i, fitted_law in enumerate(law.laws):
        assert fitted_law.constant is not None
        std_by_axis = {axis: std for (place, axis), std in zip(free, stds.tolist(), strict=True) if place == i}
        rows = np.zeros((6, 6, 6))
        rows[axes, axes, axes] = [
            (std_by_axis.get(axis, 0.0) * fitted_law.constant[axis, axis]) ** 2 for axis in range(6)
        ]
        seen = seen_loads(np.array([each[i] for each in shares]))
        fits.append(LinearLaw(fitted_law.constant, fit=LinearFit(rows, np.zeros(6), seen)))
    for name, (i, axis), std in zip(names, free, stds.tolist(), strict=True):
        value = float(fits[i].compliance[axis, axis])
        parameters[name] = {"value": value, "relative_std": std, "determined": std <= UNKNOWN}
    return Fitted(replace(assembly.with_laws(fits), noise=np.pad(scatter, (0, 6 - len(scatter)))), parameters)
