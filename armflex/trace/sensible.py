"""Whether a candidate is possible at all: signs, and a joint that still gives the way it is pushed.

A compliance must stay positive semidefinite or the joint would make energy: a coupling needs compliance on both of its
axes, a law that softens must not turn around. Half of the rows must agree, because a polynomial fits them, not its end.
"""

from __future__ import annotations

import numpy as np

from armflex.conventions import Array
from armflex.estimate.fit import Fit
from armflex.laws.effects.effect import Act, Effect
from armflex.laws.effects.in_arm import BoundTwist
from armflex.laws.effects.location import resolve
from armflex.laws.effects.scene import Scene
from armflex.laws.joint.linear import SOFTEST
from armflex.trace.candidates import Candidate

ROWS = 15
"""Rows looked at."""

LARGEST_SHIFT, LARGEST_TURN = 0.05, 0.03
"""RMS of a twist [m, rad] beyond which it is no small effect any more."""

SOFT = 100.0
"""Times the softest joint of steel that is believed: what would have to give more is no compliance."""

SLACK = 2.0
"""Coupling over the most that two compliances allow: while it is missing, calibration bends them to make up for it."""


def sensible(candidate: Candidate, amplitudes: Array, fit: Fit, scene: Scene, present: bool = False) -> bool:
    """Return whether a candidate with these amplitudes is possible on the fitted arm, or is `present` in it."""
    law, location = candidate.law, candidate.location
    acting = [law.amplitudes[i] for i in location.terms]
    for amplitude, value in zip(acting, amplitudes.tolist(), strict=True):
        if (value < 0.0 and amplitude.positive) or abs(value) > amplitude.most:
            return False
    if not law.possible(candidate.effect(amplitudes), scene, fit.setup.arm):
        return False
    if law.act is not Act.TWIST:
        return True
    if not _is_small(law.features(location, candidate.inner, fit.view, scene), amplitudes):
        return False
    if law.remembers_load(location):
        return bool(_is_stiff(np.abs(amplitudes[0]) * resolve(location, fit.setup.arm.robot, ()).direction))
    if not law.loaded or law.memory is not None:
        return True
    return _gives(candidate.effect(amplitudes), fit, scene, present)


def _is_small(features: Array, amplitudes: Array) -> bool:
    """Return whether (M, k, 6) twists per amplitude make small twists: RMS over the rows."""
    sizes = np.sqrt((np.einsum("mka,k->ma", features, amplitudes) ** 2).mean(axis=0))
    return bool((sizes[:3] < LARGEST_SHIFT).all() and (sizes[3:] < LARGEST_TURN).all())


def _gives(effect: Effect, fit: Fit, scene: Scene, present: bool) -> bool:
    """Return whether in most rows the joint gives the way it is pushed, and no more than a joint can."""
    arm, view = fit.setup.arm, fit.view
    here = resolve(effect.location, arm.robot, arm.modelled)
    bound = BoundTwist(effect, resolve(effect.location, arm.robot, arm.flexures))
    some = np.unique(np.linspace(0, len(view.rows) - 1, ROWS).astype(int))
    wrenches, row = view.line.load_at(effect.location.site)[some], scene.row.some(view.rows[some])
    own = np.broadcast_to(bound.tangent(wrenches, row), (len(some), 6, 6))
    total = np.zeros((6, 6)) if here.base_law is None else here.base_law.tangent(wrenches, row)
    total = np.broadcast_to(total, own.shape) + (0.0 if present else own)
    good = _is_stiff(np.einsum("...ii->...i", own)) & (not effect.law.passive or _is_compliance(total))
    return bool(2 * good.sum() >= len(some))


def _is_stiff(own: Array) -> np.ndarray:
    """Return (...,) whether a (..., 6) compliance is no softer than a joint can be."""
    return np.all(own < SOFT * np.repeat(SOFTEST, 3), axis=-1)


def _is_compliance(tangents: Array) -> np.ndarray:
    """Return (R,) whether (R, 6, 6) derivatives of twist by wrench have a positive diagonal, couplings within it."""
    own = np.einsum("rii->ri", tangents)
    positive = (own >= -1e-9 * np.abs(own).max(axis=1, keepdims=True)).all(axis=1)
    held = np.maximum(own, 0.0)
    most = SLACK * np.sqrt(held[:, :, None] * held[:, None, :])
    coupled = np.abs(0.5 * (tangents + tangents.transpose(0, 2, 1))) - np.abs(own)[:, :, None] * np.eye(6)
    least = 1e-9 * np.abs(tangents).max(axis=(1, 2), keepdims=True)
    return positive & (coupled <= most + least).all(axis=(1, 2))
