"""Proof that a loaded arm stays where it rests, from bounds that hold in every pose: no eigenvalues, no tangent.

Under its own weight an arm's tangent is `I + C G E`: C the laws', G the geometric stiffness, E the exponential's
derivative. If C G E is shorter than 1 in some norm, every eigenvalue of the tangent lies right of zero, so the
equilibrium is stable, and the fixed point `twist = law(load(twist))` is drawn to it.

G is the weight turning and shifting. Let M_i be the mass outboard of flexure i and S_i the sum of those masses times
their distances from it, at most. A small motion (dv, dr) of flexure j changes the load on flexure i by at most

    j at or inboard of i:  force g M_i |dr|,  moment g S_i |dr|             (all that i carries turns as one body)
    j outboard of i:       moment g M_j |dv| + g S_j |dr|                   (what j carries moves against i)

A dead force on a link is a weight more, and a dead moment adds its size to g S.

With the norms of C's blocks this bounds every 3 x 3 block of C G E, and `max_i (sum_j N_ij x_j) / x_i` bounds the
whole in the norm `max |part_i| / x_i`, whatever the positive x; the best x is the eigenvector of N. Distances are those
of a chain pulled straight, so the bound is a few times what it bounds. That is enough: arms are stiff.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.laws import Law
from armflex.laws.law import Ranges, block_norms
from armflex.mechanics.laws import LawStack

SHARE = 0.9
"""Of the bound 1 that is used, so that rounding is no part of the proof."""

BALL = 0.1
"""Largest shift [m] and turn [rad] of a flexure that the bound is made for."""


@dataclass(frozen=True, eq=False)
class Softening:
    """How far the weight can soften an arm with one payload, wherever its joints are within their ranges.

    Attributes:
        answer: (n, 2) bound of the change of each flexure's force [N] and moment [N m] where all move by `reference`.
        reference: (n, 2) the norm's shift [m] and turn [rad] of each flexure.
        known: (n, 2, 2) bounds of the tangents' blocks of the laws that have such bounds, summed.
        unknown: Flexures whose laws have not, or whose bounds prove nothing, with the laws that must be asked.
        ranges: Of the joints.
    """

    answer: Array
    reference: Array
    known: Array
    unknown: tuple[tuple[int, tuple[Law, ...]], ...]
    ranges: Ranges

    @cached_property
    def proven(self) -> bool:
        """Whether nothing need be asked: the arm stays wherever it is."""
        return not self.unknown

    @cached_property
    def _most(self) -> Array:
        """(n, 2) what the bound may be."""
        return SHARE * self.reference

    def with_laws(self, stack: LawStack) -> Softening:
        """Return the bound for the same arm with other laws."""
        return _judged(self.answer, self.reference, stack, self.ranges)

    def stays(self, wrenches: Array, tangent: Callable[[Law, Array], Array]) -> bool | np.ndarray:
        """Return (...) whether it is proven that the arm stays under (..., 6 n) loads on its flexures.

        Flexures must be within `BALL`, and joints within their ranges. `tangent` gives the (..., 6, 6) tangent of one
        of the `unknown` laws under its (..., 6) loads.
        """
        whole: bool | np.ndarray = True
        for i, laws in self.unknown:
            load = wrenches[..., 6 * i : 6 * i + 6]
            bound = self.known[i]
            for law in laws:
                bound = bound + block_norms(tangent(law, load))
            whole = whole & (bound @ self.answer[i] <= self._most[i]).all(axis=-1)
        return whole


def bound_softening(
    model: pin.Model,
    joints: Sequence[int],
    stack: LawStack,
    ranges: Ranges,
    travel: Mapping[int, float],
    dead: Sequence[tuple[int, Array, Array]] = (),
) -> Softening:
    """Return the bound for a serial model under its own weight and dead loads.

    Args:
        model: Of the arm with its payload, with flexures.
        joints: (n) Pinocchio joints of the flexures, in the order of the stack.
        stack: Laws of the flexures.
        ranges: Smallest and largest position of every joint that a law may depend on.
        travel: Pinocchio joint -> the most [m] that it moves what is outboard; flexures and turning joints left out.
        dead: Of every load the Pinocchio joint that it moves with, (3,) where on that [m], and the (6,) wrench.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # laws of no sense are judged by what comes of them
        answers = _answers(model, joints, travel, dead)
        reference = _reference(_known(stack, ranges), answers)
        return _judged(np.einsum("ipjq,jq->ip", answers, reference), reference, stack, ranges)


def _known(stack: LawStack, ranges: Ranges) -> Array:
    """Return (n, 2, 2) summed bounds of the laws that have them."""
    bounds = [[part.steepest(ranges) for part in law.parts] for law in stack.laws]
    return np.array([sum((b for b in own if b is not None), np.zeros((2, 2))) for own in bounds]).reshape(-1, 2, 2)


def _judged(answer: Array, reference: Array, stack: LawStack, ranges: Ranges) -> Softening:
    """Return the bound in one norm, with what it leaves to be asked."""
    known, unknown = _known(stack, ranges), []
    fine = (np.einsum("ipq,iq->ip", known, answer) <= SHARE * reference).all(axis=1)
    for i, law in enumerate(stack.laws):
        bounds = [(part, part.steepest(ranges)) for part in law.parts]
        asked = tuple(part for part, bound in bounds if bound is None or not fine[i])
        if asked:
            unknown.append((i, asked))
            known[i] = sum((bound for part, bound in bounds if bound is not None and fine[i]), np.zeros((2, 2)))
    return Softening(answer, reference, known, tuple(unknown), ranges)


def _answers(
    model: pin.Model,
    joints: Sequence[int],
    travel: Mapping[int, float],
    dead: Sequence[tuple[int, Array, Array]],
) -> Array:
    """Return (n, 2, n, 2) bounds of the change of forces and moments per shift and turn, coordinates of exp6."""
    weight, moment = _outboard(model, joints, travel, dead)
    places = np.asarray(joints, dtype=int)
    inboard = places[None, :] <= places[:, None]  # j at or inboard of i
    total = np.zeros((len(places), 2, len(places), 2))
    total[:, 0, :, 1] = np.where(inboard, weight[:, None], 0.0)
    total[:, 1, :, 0] = np.where(inboard, 0.0, weight[None, :])
    total[:, 1, :, 1] = np.where(inboard, moment[:, None], moment[None, :])
    # exp6's derivative turns by no more than it is turned, and shifts what is turned by half the flexure's own shift.
    total[..., 1] += 0.5 * BALL * total[..., 0]
    return total


def _outboard(
    model: pin.Model,
    joints: Sequence[int],
    travel: Mapping[int, float],
    dead: Sequence[tuple[int, Array, Array]],
) -> tuple[Array, Array]:
    """Return (n,) load outboard of each flexure [N] and the most that it can be times its distance [N m].

    A dead moment turns against the flexures that it loads, but has no arm.
    """
    gravity = float(np.linalg.norm(model.gravity.linear))
    steps = [float(np.linalg.norm(model.jointPlacements[i].translation)) for i in range(model.njoints)]
    steps = [step + travel.get(i, BALL if model.joints[i].nv == 6 else 0.0) for i, step in enumerate(steps)]
    along = np.cumsum(steps)
    mass = np.array([model.inertias[i].mass for i in range(model.njoints)])
    own = np.array([float(np.linalg.norm(model.inertias[i].lever)) for i in range(model.njoints)])
    weights = [gravity * mass[i:].sum() for i in joints]
    moments = [gravity * float(mass[i:] @ (along[i:] - along[i] + own[i:])) for i in joints]
    for joint, point, wrench in dead:
        force, moment, lever = (float(np.linalg.norm(part)) for part in (wrench[:3], wrench[3:], point))
        for number, i in enumerate(joints):
            if i <= joint:
                weights[number] += force
                moments[number] += force * float(along[joint] - along[i] + lever) + moment
    return np.array(weights), np.array(moments)


def _reference(known: Array, answers: Array) -> Array:
    """Return (n, 2) shifts and turns in which the bound is near its least: the eigenvector of what bounds C G E."""
    # Laws without a bound are taken for as soft as the softest of the others: it is a norm that is chosen, no more.
    softest = known.max(axis=0, initial=1e-12)
    given = np.maximum(known, 1e-3 * softest)
    given[~known.any(axis=(1, 2))] = softest
    shape = np.ones(answers.shape[:2])
    for _ in range(30):
        shape = np.einsum("ipq,iqjr,jr->ip", given, answers, shape)
        shape = np.maximum(shape / shape.max(initial=1e-300), 1e-12)
    return shape
