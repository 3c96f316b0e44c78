"""Whether a machine can have an effect of a size at all.

Signs must be those of nature, and a joint must give the way it is pushed: a compliance must stay positive semidefinite
or the joint would make energy. A coupling needs compliance on both of its axes, a law that softens must not turn
around. Half of the rows must agree, because a polynomial fits them, not its end.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from armflex.conventions import Array
from armflex.laws.effects.context import Context
from armflex.laws.effects.effect import LEAST_WEIGHT, Act, DependsOn, Effect, Manipulator, Solved, full
from armflex.laws.effects.in_arm import BoundTwist
from armflex.laws.effects.location import resolve
from armflex.laws.joint.linear import SOFTEST

IMPLAUSIBLE = 3.0
"""Prior: times what is plausible of its law beyond which an effect is implausible."""

USUAL_SHIFT, USUAL_TURN, USUAL_SHARE = 0.02, 0.005, 0.1
"""Prior: RMS of a twist [m, rad], and of a force as a share of what the arm weighs (of its moment: at 1 m), that
machines have without anybody knowing."""

NO_EFFECT = 0.1
"""Prior: share of the size that machines have below which an effect is none."""

SOFTER = 100.0
"""Prior: times the softest joint of steel that is plausible: what would have to bend more is no compliance."""

COUPLING_SLACK = 2.0
"""Prior: coupling over the most that two compliances allow: while it is missing, calibration bends them to make
up for it."""

MOST_AGAINST = 0.1
"""Prior: part of what an axis gives over the rows that it may give against the load in some of them: a polynomial fits
most of a joint's travel, not its end, but a joint makes no energy."""

MOST_GIVE = 10.0
"""Prior: times what is plausible by which an axis gives under the largest load on its joint, either way."""


def unusual(effect: Effect, view: Solved, context: Context) -> float:
    """Return the mean square of an effect's size, over what machines have, where its amplitudes are random.

    Args:
        effect: With the standard deviations of its amplitudes.
        view: Rows of the campaign at the arm as it was fitted.
        context: The campaign.
    """
    law, location = effect.law, effect.location
    much = float(((effect.acting / np.array([law.amplitudes[i].usual for i in location.terms])) ** 2).sum())
    if law.act in (Act.TWIST, Act.LOAD):
        force = USUAL_SHARE * max(view.arm.weight, LEAST_WEIGHT)
        usual = np.repeat((USUAL_SHIFT, USUAL_TURN) if law.act is Act.TWIST else (force, force), 3)
        each = law.features(location, effect.inner, view, context) * effect.acting[:, None] / usual
        much = max(much, float((each**2).sum(axis=(1, 2)).mean()))
    if _is_given(effect) or law.remembers_load(location):
        single = (
            full(amplitudes, location, len(law.amplitudes)) + effect.inner for amplitudes in np.diag(effect.acting)
        )
        each = [_given(replace(effect, values=values), view, context) for values in single]
        much = max(much, float((np.array(each) ** 2).sum(axis=0).max()))
    return much


def size_prior(effects: Sequence[Effect], scales: Array, view: Solved, context: Context) -> Array:
    """Return the (T,) probability of each of some scales of an effect, by a Cauchy density of its size.

    What no reading distinguishes from it is as probable where both have sizes that machines have. One that is larger
    than that is less probable by as much as more than half of the density is lost.

    Args:
        effects: With the standard deviations of their amplitudes at scale 1: of the effect, and of what does the same.
        scales: (T,) evenly spaced in their logarithm, rising; smaller ones are as possible.
        view: Rows of the campaign at the arm as it was fitted.
        context: The campaign.
    """
    own, *others = (scales**2 * unusual(effect, view, context) for effect in effects)
    much = np.min([own, *others], axis=0)
    least = float(np.sqrt(much[0] / (1.0 + much[0])))
    smaller = np.log(max(least / NO_EFFECT, 1.0)) / np.log(scales[1] / scales[0])
    density = 1.0 / (1.0 + much)
    share = np.minimum(2.0 * (1.0 + much) / (1.0 + own), 1.0) if others else 1.0
    return share * density / (density.sum() + smaller)


def sensible(effect: Effect, view: Solved, context: Context, declared: Manipulator) -> bool:
    """Return whether an effect is possible beside those that the arm has already.

    Args:
        effect: With its values.
        view: Rows of the campaign at the arm as it was fitted.
        context: The campaign.
        declared: The arm as it was declared.
    """
    law, location, acting = effect.law, effect.location, effect.acting
    for amplitude, value in zip((law.amplitudes[i] for i in location.terms), acting.tolist(), strict=True):
        if (value < 0.0 and amplitude.positive) or abs(value) > amplitude.most:
            return False
    if not law.possible(effect, context, view.arm):  # it is in the fitted arm already
        return False
    features = law.features(location, effect.inner, view, context)
    if law.size(np.einsum("mkn,k->mn", features, acting), view.arm) > IMPLAUSIBLE:
        return False
    if law.act is not Act.TWIST:
        return True
    if law.remembers_load(location):
        return bool(_is_stiff(_following(effect, view)))
    return not _is_given(effect) or _gives(effect, view, context, declared)


def _is_given(effect: Effect) -> bool:
    """Return whether an effect is what a joint gives under its load, as it is in a row."""
    law = effect.law
    return law.act is Act.TWIST and law.loaded and law.memory is None


def _following(effect: Effect, view: Solved) -> Array:
    """Return (6,) by how much an effect that remembers load follows it where it slides on."""
    return np.abs(effect.acting[0] * resolve(effect.location, view.arm.robot, ()).direction)


def _given(effect: Effect, view: Solved, context: Context) -> Array:
    """Return (R, 6) by how much every axis would give in some rows, were the largest load on its joint along it.

    As a share of `MOST_GIVE` times what is plausible of the law.
    """
    arm, law, site = view.arm, effect.law, effect.location.site
    sampled, largest = _some(view), _largest(site, context)
    most = MOST_GIVE * np.repeat([law.plausible.shift, law.plausible.turn], 3)
    if law.remembers_load(effect.location):
        return np.broadcast_to(_following(effect, view) * largest / most, (len(sampled), 6))
    bound = BoundTwist(effect, resolve(effect.location, arm.robot, arm.flexures))
    row = context.row.some(view.rows[sampled])
    compliance = np.broadcast_to(bound.tangent(view.load_at(site)[sampled], row), (len(sampled), 6, 6))
    given = np.abs(np.einsum("rii->ri", compliance)) * largest
    if not bound.proportional:  # what is saturated gives less
        given = np.minimum(given, np.abs(bound.twist(np.broadcast_to(largest, given.shape), row)))
    return given / most


def _some(view: Solved) -> np.ndarray:
    """Return the numbers of the rows looked at."""
    # Rows looked at
    return np.unique(np.linspace(0, len(view.rows) - 1, 15).astype(int))


def _largest(site: str, context: Context) -> Array:
    """Return (6,) the largest force three times, and the largest moment."""
    return np.repeat(np.linalg.norm(context.wrenches[site].reshape(-1, 2, 3), axis=2).max(axis=0), 3)


def _gives(effect: Effect, view: Solved, context: Context, declared: Manipulator) -> bool:
    """Return whether in most rows the joint gives the way it is pushed, and no more than steel."""
    arm, law = view.arm, effect.law
    here = resolve(effect.location, arm.robot, arm.modelled)
    bound = BoundTwist(effect, resolve(effect.location, arm.robot, arm.flexures))
    sampled = _some(view)
    wrenches, row = view.load_at(effect.location.site)[sampled], context.row.some(view.rows[sampled])
    compliance = np.broadcast_to(bound.tangent(wrenches, row), (len(sampled), 6, 6))
    good = _is_stiff(np.abs(np.einsum("...ii->...i", compliance)))
    if law.depends_on is DependsOn.COMPLIANCE:  # the whole compliance has a positive diagonal, and couplings within it
        total = np.zeros((6, 6)) if here.base_law is None else here.base_law.tangent(wrenches, row)
        total = np.broadcast_to(total, compliance.shape) + compliance
        along = np.einsum("rii->ri", total)
        if not bound.proportional:  # a polynomial's slope turns around long before its twist does
            features = law.features(effect.location, effect.inner, view, context)[sampled]
            twists, loaded = np.einsum("mkn,k->mn", features, effect.acting), np.abs(wrenches) > 0.0
            slopes = np.divide(twists, wrenches, where=loaded, out=np.zeros_like(wrenches))
            along = along + np.where(loaded, slopes - np.einsum("rii->ri", compliance), 0.0)
        before = resolve(effect.location, arm.robot, declared.modelled).base_law
        if not (before is None or here.base_law is None):
            # While a law is missing calibration bends the compliance to make up for it: it had more before.
            more = before.tangent(wrenches, row) - here.base_law.tangent(wrenches, row)
            along = along + np.maximum(np.einsum("...ii->...i", more), 0.0)
        held = np.maximum(along, 0.0)
        # While a coupling is missing calibration bends the two compliances to make up for it.
        slack = 1.0 if bound.here.base_law is None else COUPLING_SLACK
        root = np.sqrt(held)
        coupled = np.abs(0.5 * (total + total.transpose(0, 2, 1))) * (1.0 - np.eye(6))
        least = 1e-9 * np.abs(total).max(axis=(1, 2), keepdims=True)
        against = np.maximum(-along, 0.0).sum(axis=0)
        if (against > MOST_AGAINST * held.sum(axis=0) + 1e-9 * np.abs(along).sum()).any():
            return False
        good &= (along >= -1e-9 * np.abs(along).max(axis=1, keepdims=True)).all(axis=1)
        good &= (coupled <= slack * root[:, :, None] * root[:, None, :] + least).all(axis=(1, 2))
        if bound.here.base_law is None:
            good &= np.linalg.eigvalsh(0.5 * (total + total.transpose(0, 2, 1)))[:, 0] >= -least[:, 0, 0]
    return bool(2 * good.sum() >= len(sampled))


def _is_stiff(compliance: Array) -> np.ndarray:
    """Return (...,) whether a (..., 6) compliance is no softer than a joint can be."""
    return np.all(compliance < SOFTER * np.repeat(SOFTEST, 3), axis=-1)
