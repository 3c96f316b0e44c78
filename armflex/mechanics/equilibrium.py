"""Where the loaded arm comes to rest: `twist = law(load(twist))`, and whether it stays there.

The heart of the package, hence our own: a fixed point, which stiff arms are drawn to in a few steps, and Newton on the
flexures' exponential coordinates with Pinocchio's geometric stiffness. A fixed point cannot distinguish a stable
equilibrium from a buckled one: the bound of `certificate` can where the arm is stiff, the tangent `I + C dτ/dtwist`
everywhere.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.errors import (
    ConvergenceError,
    InputError,
    SmallDisplacementError,
    UnstableEquilibriumError,
    did_you_mean,
)
from armflex.mechanics.certificate import SHARE, StabilityBound
from armflex.mechanics.loaded import LoadedArm
from armflex.mechanics.loop_rows import solver_of
from armflex.mechanics.mechanism import Mechanism
from armflex.mechanics.pinocchio_model import LoadCase, integrate

METHODS = ("exact", "newton")
TOLERANCE = 1e-12
"""Largest residual of an equilibrium, of any flexure coordinate [m, rad]."""
MAX_NEWTON = 50
POLISHED = 0.01
"""One more step is made where the residual is not this far below the tolerance: a lever of metres magnifies it."""
MAX_ROTATION = 0.1
"""A flexure that turns further [rad] is outside what a compliance describes."""

SMALL = MAX_ROTATION * MAX_ROTATION
"""Sum of the squares of all shifts [m] and turns [rad] below which no flexure can have turned too far."""
FARTHEST = 1e60
"""Squared length of a first step beyond which there is no equilibrium to be found, only numbers that overflow."""
STEPS = 24
CONVERGED = TOLERANCE * TOLERANCE
"""Squared length of the last step, at most."""
NEXT = 4e-30
"""Squared length of the step after it, were it to shrink as the last one did: a lever of metres magnifies it."""
SLOWEST = 0.1
"""Where a squared step is not shorter than this part of the one before it, Newton is quicker."""


class Equilibrium(NamedTuple):
    """A solved arm, in the order and signs of Pinocchio's flexible model.

    Attributes:
        loaded: The arm with its payload.
        case: Where its joints are and what acts.
        rigid: (nq_model,) configuration [m, rad] with flexures at zero.
        motion: (nv,) exponential coordinates of the flexures, zero for joints [m, rad].
        torque: (nv,) generalized torque: minus the loads on the flexures [N, Nm]; None for that of the motion.
        method: How it was found.
        history: Squared length of the residual before each step [m^2 or rad^2].
        tangent: (6 n, 6 n) in units of the twists, where stability was checked with it.
        load_factor: See `load_factor`; infinite where it is known to be `NEAR` or more.
        displacement: (6,) of the tip where it was found with the rest, see `Deflection.displacement`.
    """

    loaded: LoadedArm
    case: LoadCase
    rigid: Array
    motion: Array
    torque: Array | None
    method: str
    history: Sequence[float]
    tangent: Array | None = None
    load_factor: float = math.inf
    displacement: Array | None = None


def check_method(method: str) -> None:
    """Raise `InputError` where a method is not known."""
    if method not in METHODS:
        raise InputError(f"method {method!r} is not known{did_you_mean(method, METHODS)} (known: {', '.join(METHODS)})")


def find_equilibrium(
    loaded: LoadedArm, case: LoadCase, method: str = "newton", allow_large: bool = False, within: bool = False
) -> Equilibrium:
    """Return where the arm comes to rest.

    Args:
        loaded: The arm with its payload.
        case: Joint positions, motion, external wrenches and covariates.
        method: "newton", the reference, or "exact", the quickest that answers alike. Stability is checked.
        allow_large: Go on where a flexure turns by more than `MAX_ROTATION`.
        within: Whether the joints are within their limits: stability may be known without the tangent.

    Raises:
        ConvergenceError: No equilibrium was found.
        UnstableEquilibriumError: One was found, but the arm would leave it.
        SmallDisplacementError: A flexure turned by more than `MAX_ROTATION`.
    """
    mechanics = loaded.mechanics
    loops = isinstance(mechanics, Mechanism)
    check_method(method)
    if mechanics.ties is not None and method == "exact" and not case.moves:
        solver = solver_of(loaded, case.wrenches)
        if found := solver.one(loaded.row(case.q, case.covariates)):
            parts = solver.model(found, 0, case.q)
            return Equilibrium(loaded, case, *parts, "fixed_point", (), None, math.inf, found.displacement[0].copy())
    if loops:
        return _of_mechanism(mechanics, loaded, case, allow_large)
    laws = mechanics.laws
    if laws.changing:
        laws.know(loaded.row(case.q, case.covariates))
    rigid, load, law = mechanics.rigid_configuration(case.q), mechanics.load(case), laws.motion
    # To look for what runs away takes as long as a quarter of a step. Laws that are not curved do not under the weight,
    # nor under loads of a size that a quantity may have.
    weight, found = load is mechanics.weight, None
    tame = laws.tame and not laws.curved and (weight or (not case.moves and loaded.outside(case.wrenches).moderate))
    if method == "exact":
        ask = _fixed_point if tame else _watched_fixed_point
        motion, sizes = ask(law, load, mechanics.model, rigid)
        if motion is not None:
            found = Equilibrium(loaded, case, rigid, motion, None, "fixed_point", sizes)
    found = found or _newton(loaded, case, rigid, load)
    bound = loaded.stability_bound
    if within and bound is not None and found.motion.dot(found.motion) < SMALL:
        known = weight and tame and bound.proven
        if known or _proven(bound, found, load):
            return found
    found = _checked(found, load)
    # Not a number is not small, either; `vdot` says nothing of what overflows.
    size = found.motion.dot(found.motion) if tame else np.vdot(found.motion, found.motion)
    if not allow_large and not size < SMALL:
        if not np.isfinite(found.motion).all():
            raise ConvergenceError("the loads or the laws give no finite twists", ())
        check_small(found.motion[mechanics.flex.flexure_v], loaded.arm.stack.names)
    return found


def _of_mechanism(mechanics: Mechanism, loaded: LoadedArm, case: LoadCase, allow_large: bool) -> Equilibrium:
    """Return where a mechanism comes to rest: by Newton's method, on all of it together."""
    row = loaded.row(case.q, case.covariates)
    if mechanics.laws.changing:
        mechanics.laws.know(row)
    rigid, motion, torque, history, tangent = mechanics.rest(case, row)
    factor, squares = _lasting(tangent), np.square(history).tolist()
    if not allow_large:
        check_small(motion[mechanics.flex.flexure_v], loaded.arm.stack.names)
    return Equilibrium(loaded, case, rigid, motion, torque, "newton", squares, None, factor)


RUNS_AWAY = np.errstate(over="ignore", invalid="ignore")
"""What runs away is refused, not warned of."""


def _fixed_point(
    law: Callable[[Array], Array],
    load: Callable[[Array], Array],
    model: pin.Model,
    rigid: Array,
) -> tuple[Array | None, list[float]]:
    """Return the motion at rest, None where the steps do not shrink quickly, and the squared lengths of the steps.

    Args:
        law: Torques to motions.
        load: Configurations to torques.
        model: Of the arm.
        rigid: Its configuration where it is not deflected.
    """
    motion = law(load(rigid))
    before = motion.dot(motion)
    sizes = [before]
    if not before < FARTHEST:
        return None, sizes
    for _ in range(STEPS):
        moved = law(load(integrate(model, rigid, motion)))
        step = moved - motion
        size = step.dot(step)
        sizes.append(size)
        if size <= CONVERGED and size * size <= NEXT * before:
            return moved, sizes
        if not size < SLOWEST * before:  # not a number is not, either
            break
        motion, before = moved, size
    return None, sizes


_watched_fixed_point = RUNS_AWAY(_fixed_point)


@RUNS_AWAY
def _newton(loaded: LoadedArm, case: LoadCase, rigid: Array, load: Callable[[Array], Array]) -> Equilibrium:
    """Return the equilibrium by Newton's method with damped steps."""
    mechanics, places = loaded.mechanics, loaded.mechanics.flex.flexure_v

    def residual(motion: Array) -> tuple[Array, Array, float]:
        torque = load(mechanics.flexed(rigid, motion))
        left = motion - mechanics.laws.motion(torque)
        largest = float(np.abs(left).max(initial=0.0))
        return left, torque, largest if np.isfinite(largest) else np.inf

    motion, polished = np.zeros(mechanics.model.nv), False
    left, torque, largest = residual(motion)
    history = [largest]
    for _ in range(MAX_NEWTON):
        if largest <= TOLERANCE and (polished or largest <= POLISHED * TOLERANCE):
            return Equilibrium(loaded, case, rigid, motion, torque, "newton", np.square(history).tolist())
        polished = largest <= TOLERANCE
        tangent = tangent_of(Equilibrium(loaded, case, rigid, motion, torque, "newton", ()))
        try:
            step = np.linalg.solve(tangent, left[places])
        except np.linalg.LinAlgError:
            raise ConvergenceError("the tangent is singular: the arm is about to buckle", history) from None
        # The step is halved until the residual shrinks or is given up; exp6 wraps around at a turn of pi, and a step
        # must not get there.
        before, start, factor = largest, motion, min(1.0, 1.0 / max(1e-300, float(np.abs(step).max(initial=0.0))))
        for _ in range(8):
            motion = start.copy()
            motion[places] -= factor * step
            left, torque, largest = residual(motion)
            if largest < before or before < 1e-11:
                break
            factor *= 0.5
        history.append(largest)
    pushed = max((one.sizes[0] for one in case.wrenches if not one.hangs), default=0.0)
    loads = [f"a payload of {loaded.payload.mass:g} kg"] * bool(loaded.payload.mass)
    loads += [f"a force from outside of {pushed:.4g} N"] * bool(pushed)
    under = f" under {' and '.join(loads)}" if loads else ""
    raise ConvergenceError(f"the equilibrium did not converge{under}", history)


def _proven(bound: StabilityBound, found: Equilibrium, load: Callable[[Array], Array]) -> bool:
    """Return whether the bound under the arm's weight proves that it stays where it was found, within its limits."""
    loaded, laws, wrenches = found.loaded, found.loaded.mechanics.laws, found.case.wrenches
    if found.case.moves:
        return False
    if wrenches:
        if loaded.outside(wrenches).proven:
            return True
        under = bound.under(wrenches)
        if under is None:
            return False
        bound = under
    if bound.proven:
        return True
    # What is affine gives the same under every load, so they need not be known.
    torque = load(integrate(loaded.flex.model, found.rigid, found.motion)) if laws.bent else found.motion
    return bool(bound.stays(-torque[loaded.flex.flexure_v], laws.tangent))


@RUNS_AWAY
def _checked(found: Equilibrium, load: Callable[[Array], Array]) -> Equilibrium:
    """Return the equilibrium with its tangent, from which it is known to be stable."""
    if found.torque is None:  # once more, so that loads and twists are each other's to the last digit
        mechanics = found.loaded.mechanics
        torque = load(mechanics.flexed(found.rigid, found.motion))
        found = found._replace(motion=mechanics.laws.motion(torque), torque=torque)
    tangent = tangent_of(found)
    return found._replace(tangent=tangent, load_factor=_lasting(tangent))


def _lasting(tangent: Array) -> float:
    """Return the load factor of a tangent, infinite where it is far from buckling; raise where the arm would leave."""
    factor = math.inf
    if not np.isfinite(tangent).all():
        raise ConvergenceError("the loads or the laws give no finite twists", ())
    if np.linalg.norm(tangent - np.eye(len(tangent))) > SHARE:  # which else bounds every eigenvalue's distance from 1
        factor = load_factor(tangent)
    if factor <= 1.0:
        text = f"the arm would not stay where its loads balance: it buckles under {factor:.4g} times its loads"
        raise UnstableEquilibriumError(text, 1.0 - 1.0 / factor)
    return factor


def tangent_of(found: Equilibrium) -> Array:
    """Return the (6 n, 6 n) tangent `I + C dτ/dtwist` at an equilibrium."""
    loaded, mechanics = found.loaded, found.loaded.mechanics
    configuration, places = mechanics.flexed(found.rigid, found.motion), mechanics.flex.flexure_v
    torque = found.torque if found.torque is not None else mechanics.load(found.case)(configuration)
    compliance = loaded.arm.stack.tangent(-torque[places], loaded.row(found.case.q, found.case.covariates))
    geometric = mechanics.stiffness(configuration, found.case)[mechanics.flexures]
    return np.eye(len(places)) + compliance @ geometric @ mechanics.exponential_jacobian(found.rigid, found.motion)


@RUNS_AWAY
def check_small(twists: Array, names: tuple[str, ...]) -> None:
    """Raise `SmallDisplacementError` where a flexure turned by more than `MAX_ROTATION`."""
    turns = np.linalg.norm(twists.reshape(-1, 6)[:, 3:], axis=1)
    if len(turns) and turns.max() > MAX_ROTATION:
        name, most = names[int(turns.argmax())], float(turns.max())
        text = f"flexure {name!r} turns by {most:.3g} rad, more than the {MAX_ROTATION} rad a compliance describes"
        text += ": is its compliance, or a load on it, in another unit?"
        raise SmallDisplacementError(text, twists.reshape(-1, 6))


def load_factor(tangent: Array) -> float:
    """Return how many times its loads an arm with a (6 n, 6 n) tangent carries before it buckles; 1 or less: it does.

    With K = C^-1 the tangent I + C G is similar to `I + C^1/2 G C^1/2`, the energy's Hessian, and G is in proportion to
    the loads: the arm, bent as it is, buckles where they are `1 / (1 - smallest eigenvalue)` times as large. That is a
    linear buckling analysis about the equilibrium. An arm that its loads stiffen does not buckle: infinite.
    """
    smallest = float(np.linalg.eigvals(tangent).real.min(initial=1.0))
    return 1.0 / (1.0 - smallest) if smallest < 1.0 else math.inf
