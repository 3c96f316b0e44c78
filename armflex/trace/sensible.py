"""Whether a candidate is possible at all: signs, and a joint that still gives the way it is pushed.

A compliance must stay positive semidefinite or the joint would make energy: a coupling needs compliance on both of its
axes, a law that softens must not turn around. Half of the rows must agree, because a polynomial fits them, not its end.
"""

from __future__ import annotations

import numpy as np

from armflex.calibrate.fit import Fit
from armflex.conventions import Array
from armflex.effects.in_arm import BoundTwist
from armflex.effects.law import TwistLaw
from armflex.effects.scene import Scene
from armflex.effects.spot import resolve
from armflex.laws import Row
from armflex.trace.candidates import Candidate

ROWS = 15
"""Rows looked at."""

LARGEST_SHIFT, LARGEST_TURN = 0.05, 0.03
"""RMS of a twist [m, rad] beyond which it is no small effect any more."""

SLACK = 2.0
"""Coupling over the most that two compliances allow: while it is missing, calibration bends them to make up for it."""

FREE = ("even_in_load", "friction_windup")
"""Laws that are no compliance: their way does not follow the load's, but nothing or the side one came from."""


def sensible(candidate: Candidate, amplitudes: Array, fit: Fit, scene: Scene) -> bool:
    """Return whether a candidate with these amplitudes is possible on the fitted arm."""
    acting = [candidate.law.amplitudes[i] for i in candidate.spot.terms]
    for amplitude, value in zip(acting, amplitudes.tolist(), strict=True):
        if (value < 0.0 and amplitude.positive) or abs(value) > amplitude.most:
            return False
    law = candidate.law
    if not isinstance(law, TwistLaw):
        return True
    if not _is_small(law.features(candidate.spot, candidate.inner, fit.view, scene), amplitudes):
        return False
    return not law.loaded or law.memory is not None or law.name in FREE or _gives(candidate, amplitudes, fit, scene)


def _is_small(features: Array, amplitudes: Array) -> bool:
    """Return whether (M, k, 6) twists per amplitude make small twists: RMS over the rows."""
    sizes = np.sqrt((np.einsum("mka,k->ma", features, amplitudes) ** 2).mean(axis=0))
    return bool((sizes[:3] < LARGEST_SHIFT).all() and (sizes[3:] < LARGEST_TURN).all())


def _gives(candidate: Candidate, amplitudes: Array, fit: Fit, scene: Scene) -> bool:
    arm, view = fit.setup.arm, fit.view
    here = resolve(candidate.spot, arm.robot, arm.modelled)
    bound = BoundTwist(candidate.effect(amplitudes), resolve(candidate.spot, arm.robot, arm.flexures))
    some = np.unique(np.linspace(0, len(view.rows) - 1, ROWS).astype(int))
    wrenches = view.line.load_at(candidate.spot.site)
    good = []
    for i in some:
        row = _one(scene.row, int(view.rows[i]))
        total = bound.tangent(wrenches[i], row)
        if here.base_law is not None:
            total = total + here.base_law.tangent(wrenches[i], row)
        good.append(_is_compliance(total))
    return 2 * sum(good) >= len(good)


def _one(row: Row, index: int) -> Row:
    return Row(row.q[index], row.joint_index, {name: values[index] for name, values in row.covariates.items()})


def _is_compliance(tangent: Array) -> bool:
    """Return whether a (6, 6) derivative of twist by wrench has a positive diagonal and couplings within its means."""
    own = np.diag(tangent)
    if (own < -1e-9 * np.abs(own).max(initial=0.0)).any():
        return False
    most = np.sqrt(np.outer(np.maximum(own, 0.0), np.maximum(own, 0.0)))
    coupled = np.abs(0.5 * (tangent + tangent.T)) - np.diag(np.abs(own))
    return bool((coupled <= SLACK * most + 1e-9 * np.abs(tangent).max(initial=0.0)).all())
