"""Proof that a loaded arm stays where it rests, from bounds that hold in every pose: no eigenvalues, no tangent.

Under its own weight an arm's tangent is `I + C G E`: C the laws', G the geometric stiffness, E the exponential's
derivative. If C G E is shorter than 1 in some norm, every eigenvalue of the tangent lies right of zero, so the
equilibrium is stable, and the fixed point `twist = law(load(twist))` is drawn to it.

G is the weight turning and shifting. Let M_i be the mass outboard of flexure i and S_i the sum of those masses times
their distances from it, at most. A small motion (dv, dr) of flexure j changes the load on flexure i by at most

    j at or inboard of i:  force g M_i |dr|,  moment g S_i |dr|             (all that i carries turns as one body)
    j outboard of i:       moment g M_j |dv| + g S_j |dr|                   (what j carries moves against i)

A dead force on a link is a weight more, and a dead moment, which has no arm, adds its size to g S. A force f that
follows its link, at most s away from the flexure with its moment m, is the same to a flexure that turns with all that
it carries; only what moves against the flexure changes its load:

    j outboard of i:       force f |dr|,  moment f |dv| + (f s + m) |dr|    (m, s of i)

What bodies need to be accelerated, where joints move with speeds v and accelerations a, turns and shifts likewise. Of
turning joints let d_l be by how much `sum |a| + 1.5 (sum |v|)^2`, the sums from the base to a joint, grows at joint l:
the angular acceleration and the square of the angular velocity of what is outboard add up to less than the sum of d.
So l adds at most d_l times the way from it to the acceleration of a body's centre, a slide `|a_l| + 2 |v_l| sum |v|`.
These are sums of products of at most three vectors, of four where a body's inertia is one: a turn of flexure j changes
each by as many times |dr|, once more in the axes of a flexure outboard of j; a shift changes one way in a product.

With the norms of C's blocks this bounds every 3 x 3 block of C G E, and `max_i (sum_j N_ij x_j) / x_i` bounds the
whole in the norm `max |part_i| / x_i`, whatever the positive x; the best x is the eigenvector of N. Distances are those
of a chain pulled straight, so the bound is a few times what it bounds. That is enough: arms are stiff.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.laws import Law
from armflex.laws.law import Ranges, block_norms
from armflex.mechanics.laws import LawStack
from armflex.mechanics.pinocchio_model import Load

NEAR = 2.0
"""A load factor below which the arm is called near buckling: it gives more than twice what is linear in its loads."""

SHARE = 1.0 / NEAR
"""Of the bound 1 that is used: what is proven to stay would stay under `NEAR` times its loads."""

BALL = 0.1
"""Largest shift [m] and turn [rad] of a flexure that the bound is made for."""


@dataclass(frozen=True, eq=False)
class StabilityBound:
    """How far weight and dead loads can soften an arm with one payload, wherever its joints are within their ranges.

    Attributes:
        change: (n, 2) bound of the change of each flexure's force [N] and moment [N m] where all move by `reference`.
        reference: (n, 2) the norm's shift [m] and turn [rad] of each flexure.
        parts: Of each flexure the laws that add up, each with (2, 2) bounds of its tangent's blocks, None without.
        compliance_bound: (n, 2, 2) sums of these.
        per_load: Link, and whether a load follows it -> (2, n, 2) `change` per force [1/N] and per moment [1/(N m)] at
            its origin.
        per_motion: (nq, n, 2) `change` per d of each joint [s^2, or s^2/m of a slide]; see above.
        turning: Of every joint whether it turns, and is no slide.
        ranges: Of the joints.
    """

    change: Array
    reference: Array
    parts: tuple[tuple[tuple[Law, Array | None], ...], ...]
    compliance_bound: Array
    per_load: Callable[[str, bool], Array]
    per_motion: Callable[[], Array]
    turning: tuple[bool, ...]
    ranges: Ranges

    @cached_property
    def proven(self) -> bool:
        """Whether nothing need be asked: the arm stays wherever it is."""
        return self.proven_while(None)

    def proven_while(self, motion: Array | None) -> bool:
        """Return whether that is so while joints have (2, nq) speeds and accelerations.

        It is a sum of what each takes of the bound at its worst flexure: quick, and sometimes less than is true.
        """
        taken, spin = self._taken, 0.0  # of all that turns inboard [rad/s]
        if motion is None or not taken <= 1.0:
            return taken <= 1.0
        for speed, acceleration, (share, turns) in zip(*np.abs(motion).tolist(), self._taken_by_motion, strict=True):
            squares = 1.5 * (2.0 * spin + speed) * speed if turns else 2.0 * spin * speed
            taken += share * (acceleration + squares)
            spin += speed if turns else 0.0
        return taken <= 1.0

    @cached_property
    def _taken(self) -> float:
        bounded = all(bound is not None for own in self.parts for _, bound in own)
        return float(self._worst(self.change)) if bounded else math.inf

    @cached_property
    def _taken_by_motion(self) -> list[tuple[float, bool]]:
        return list(zip(self._worst(self.per_motion()).tolist(), self.turning, strict=True))

    def _worst(self, change: Array) -> Array:
        """Return the (...) greatest shares of (..., n, 2) changes in what is proven to be harmless."""
        shares = (self.compliance_bound @ change[..., None])[..., 0] / (SHARE * self.reference)
        return shares.max(axis=(-2, -1), initial=0.0)

    def with_laws(self, stack: LawStack) -> StabilityBound:
        """Return the bound for the same arm with other laws."""
        parts, bound = _steepest(stack, self.ranges)
        return replace(self, parts=parts, compliance_bound=bound)

    def under(self, loads: Sequence[Load]) -> StabilityBound | None:
        """Return the bound under further loads; None where one depends on more than its axes, or is no number."""
        change = self.change
        for load in loads:
            if not (load.dead or load.follows):
                return None
            (force, moment), per_load = load.sizes, self.per_load(load.frame, load.follows)
            change = change + (force * per_load[0] + moment * per_load[1])
        found = replace(self, change=change) if loads else self
        return found if math.isfinite(change.sum()) else None

    def stays(self, wrenches: Array, tangent: Callable[[Law, Array], Array]) -> bool | np.ndarray:
        """Return (...) whether it is proven that the arm stays under (..., 6 n) loads on its flexures.

        Flexures must be within `BALL`, and joints within their ranges. `tangent` gives the (..., 6, 6) tangent of a law
        under its (..., 6) loads; asked are laws that have no bound, or whose bounds prove nothing.
        """
        whole: bool | np.ndarray = True
        for i, bound, laws, most in self._unknown:
            load = wrenches[..., 6 * i : 6 * i + 6]
            for law in laws:
                bound = bound + block_norms(tangent(law, load))
            share = bound.dot(self.change[i])
            if share.ndim > 1:
                whole = whole & np.all(share <= most, axis=-1)
            elif not (share[0] <= most[0] and share[1] <= most[1]):
                return False
        return whole

    @cached_property
    def _unknown(self) -> list[tuple[int, Array, list[Law], Array]]:
        """Flexures whose laws must be asked, with what is known of the others of its laws, and what it may come to."""
        found, taken = [], (self.compliance_bound @ self.change[..., None])[..., 0]
        fine = np.all(taken <= SHARE * self.reference, axis=1)  # their bounds prove what they have to
        for i, own in enumerate(self.parts):
            known = [bound for _, bound in own if bound is not None and fine[i]]
            if len(known) < len(own):
                laws = [law for law, bound in own if bound is None or not fine[i]]
                found.append((i, sum(known, np.zeros((2, 2))), laws, SHARE * self.reference[i]))
        return found


def bound_stability(
    model: pin.Model,
    joints: Sequence[int],
    stack: LawStack,
    ranges: Ranges,
    travel: Mapping[int, float],
    drives: Sequence[int],
    links: Callable[[str], tuple[int, Array]],
) -> StabilityBound:
    """Return the bound for a serial model under its own weight.

    Args:
        model: Of the arm with its payload, with flexures.
        joints: (n) Pinocchio joints of the flexures, in the order of the stack.
        stack: Laws of the flexures.
        ranges: Smallest and largest position of every joint that a law may depend on.
        travel: Pinocchio joint -> the most [m] that it moves what is outboard; flexures and turning joints left out.
        drives: Pinocchio joints in the order of positions.
        links: Link -> the Pinocchio joint that it moves with, and (3,) where its origin is on that [m].
    """
    gravity, places = float(np.linalg.norm(model.gravity.linear)), np.asarray(joints, dtype=int)
    steps = [float(np.linalg.norm(model.jointPlacements[i].translation)) for i in range(model.njoints)]
    steps = [step + travel.get(i, BALL if model.joints[i].nv == 6 else 0.0) for i, step in enumerate(steps)]
    along = np.cumsum(steps)
    mass = np.array([model.inertias[i].mass for i in range(model.njoints)])
    own = np.array([float(np.linalg.norm(model.inertias[i].lever)) for i in range(model.njoints)])
    weights = [gravity * mass[i:].sum() for i in joints]
    moments = [gravity * float(mass[i:] @ (along[i:] - along[i] + own[i:])) for i in joints]
    with np.errstate(over="ignore", invalid="ignore"):
        whole = _changes(places, np.array(weights), np.array(moments))
        parts, compliance_bound = _steepest(stack, ranges)
        # Laws without a bound are taken for as soft as the softest of the others: it is a norm that is chosen, no more.
        softest = compliance_bound.max(axis=0, initial=1e-12)
        given = np.maximum(compliance_bound, 1e-3 * softest)
        given[~compliance_bound.any(axis=(1, 2))] = softest
        # Shifts and turns in which the bound is near its least: the eigenvector of what bounds C G E.
        reference = np.ones((len(places), 2))
        for _ in range(30):
            reference = np.einsum("ipq,iqjr,jr->ip", given, whole, reference)
            reference = np.maximum(reference / reference.max(initial=1e-300), 1e-12)

        @cache
        def per_load(link: str, follows: bool) -> Array:
            joint, point = links(link)
            arms = np.where(places <= joint, along[joint] - along[places] + float(np.linalg.norm(point)), 0.0)
            carried = (places <= joint).astype(float)
            of = _changes_following if follows else _changes
            both = (of(places, carried, arms), of(places, 0.0 * carried, carried))
            return np.einsum("lipjq,jq->lip", both, reference)

        @cache
        def per_motion() -> Array:
            inertia = np.array([float(np.linalg.norm(body.inertia, 2)) for body in model.inertias.tolist()])
            changes = [_changes_moving(places, j, j not in travel, along, along + own, mass, inertia) for j in drives]
            return np.einsum("lipjq,jq->lip", np.array(changes).reshape(len(drives), *whole.shape), reference)

        change = np.einsum("ipjq,jq->ip", whole, reference)
    turning = tuple(joint not in travel for joint in drives)
    return StabilityBound(change, reference, parts, compliance_bound, per_load, per_motion, turning, ranges)


def _steepest(stack: LawStack, ranges: Ranges) -> tuple[tuple[tuple[tuple[Law, Array | None], ...], ...], Array]:
    """Return every flexure's laws with the bounds that they have, and (n, 2, 2) the bounds' sums."""
    parts = tuple(tuple((part, part.compliance_bound(ranges)) for part in law.parts) for law in stack.laws)
    known = [sum((bound for _, bound in own if bound is not None), np.zeros((2, 2))) for own in parts]
    return parts, np.array(known).reshape(-1, 2, 2)


def _changes(places: np.ndarray, weight: Array, moment: Array) -> Array:
    """Return (n, 2, n, 2) bounds of the change of forces and moments per shift and turn, coordinates of exp6.

    Args:
        places: (n,) Pinocchio joints of the flexures.
        weight: (n,) load outboard of each flexure [N].
        moment: (n,) the most that it can be times its distance [N m].
    """
    inboard = places[None, :] <= places[:, None]  # j at or inboard of i
    total = np.zeros((len(places), 2, len(places), 2))
    total[:, 0, :, 1] = np.where(inboard, weight[:, None], 0.0)
    total[:, 1, :, 0] = np.where(inboard, 0.0, weight[None, :])
    total[:, 1, :, 1] = np.where(inboard, moment[:, None], moment[None, :])
    return _per_coordinate(total)


def _changes_following(places: np.ndarray, force: Array, moment: Array) -> Array:
    """Return the same for a load that follows its link, (n,) force and moment at most on each flexure [N, N m]."""
    outboard = (places[None, :] > places[:, None]) & ((force > 0.0) | (moment > 0.0))[None, :]  # of i, and carrying it
    total = np.zeros((len(places), 2, len(places), 2))
    total[:, 0, :, 1] = total[:, 1, :, 0] = np.where(outboard, force[:, None], 0.0)
    total[:, 1, :, 1] = np.where(outboard, moment[:, None], 0.0)
    return _per_coordinate(total)


def _changes_moving(
    places: np.ndarray, joint: int, turns: bool, along: Array, ways: Array, mass: Array, inertia: Array
) -> Array:
    """Return the same for what accelerates a joint, per unit of d.

    Args:
        places: (n,) Pinocchio joints of the flexures.
        joint: Pinocchio joint that is accelerated.
        turns: Whether it turns.
        along, ways: (k,) distances of joints, and of the bodies' centres at most, from the base [m].
        mass, inertia: (k,) of the bodies [kg], and the greatest about their centres [kg m^2].
    """
    carried, arm = np.arange(len(mass)) >= joint, along[joint] if turns else 0.0
    turned = mass * carried * (np.maximum(ways - arm, 0.0) if turns else 1.0)  # mass times acceleration
    shifted = mass * carried * float(turns)  # per shift of what is between
    spun = inertia * carried * float(turns)
    both, outboard = np.maximum.outer(places, places), places[None, :] > places[:, None]

    def beyond(values: Array) -> Array:
        """Return (n, n) sums over what both flexures carry."""
        return np.cumsum(values[::-1])[::-1][both]

    def moments(values: Array, start: Array) -> Array:
        """Return the same of values times their way from a flexure."""
        return beyond(values * ways) - start * beyond(values)

    first, second = along[places][:, None], along[places][None, :]
    total = np.zeros((len(places), 2, len(places), 2))
    total[:, 0, :, 0], total[:, 0, :, 1] = beyond(shifted), 4.0 * beyond(turned)
    total[:, 1, :, 0] = moments(shifted, first) + outboard * beyond(turned)
    total[:, 1, :, 1] = 4.0 * moments(turned, first) + outboard * moments(turned, second) + 5.0 * beyond(spun)
    return _per_coordinate(total)


def _per_coordinate(total: Array) -> Array:
    """Return changes per shift and turn as per coordinates of exp6.

    Its derivative turns by no more than it is turned, and shifts what is turned by half the flexure's own shift.
    """
    total[..., 1] += 0.5 * BALL * total[..., 0]
    return total
