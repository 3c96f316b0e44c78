"""Where the loaded arm comes to rest: `twist = law(wrench(twist))`, and whether it stays there.

The heart of the package, hence our own: Newton on the flexures' exponential coordinates with Pinocchio's geometric
stiffness, a fixed point and a first-order answer where speed matters more. A fixed point cannot tell a stable
equilibrium from a buckled one, the tangent `I + C dτ/dtwist` can.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from armflex.conventions import Array
from armflex.errors import (
    ConvergenceError,
    InputError,
    SmallDisplacementError,
    UnstableEquilibriumError,
    did_you_mean,
)
from armflex.laws import Row
from armflex.mechanics.laws import LawStack
from armflex.mechanics.pinocchio_model import LoadCase, Mechanics

METHODS = ("newton", "fixed_point", "first_order", "exact")
TOLERANCE = 1e-12
"""Largest residual of an equilibrium, of any flexure coordinate [m, rad]."""
MAX_NEWTON = 50
MAX_FIXED_POINT = 200
POLISHED = 0.01
"""One more step is made where the residual is not this far below the tolerance: a lever of metres magnifies it."""
GROWTH = 1e6
"""By which a squared step may be longer than the one before where only the fixed point is asked."""
MAX_ROTATION = 0.1
"""A flexure that turns further [rad] is outside what a compliance describes."""

SMALL = MAX_ROTATION * MAX_ROTATION
"""Sum of the squares of all shifts [m] and turns [rad] below which no flexure can have turned too far."""
STEPS = 24
CONVERGED = TOLERANCE * TOLERANCE
"""Squared length of the last step, at most."""
NEXT = 4e-30
"""Squared length of the step after it, were it to shrink as the last one did: a lever of metres magnifies it."""
SLOWEST = 0.1
"""Where a squared step is not shorter than this part of the one before it, Newton is quicker."""


@dataclass(frozen=True)
class Equilibrium:
    """A solved arm.

    Attributes:
        twists: (6 n,) exponential coordinates of the flexures [m, rad].
        wrenches: (6 n,) loads on the flexures in their local axes [N, Nm].
        straight: Configuration with flexures at zero.
        configuration: Configuration at the solution.
        method: How it was found.
        history: Largest residual before each step [m or rad].
        tangent: (6 n, 6 n) tangent at the solution, where stability was checked with it.
    """

    twists: Array
    wrenches: Array
    straight: Array
    configuration: Array
    method: str
    history: tuple[float, ...]
    tangent: Array | None = None


def find_equilibrium(
    mechanics: Mechanics,
    stack: LawStack,
    case: LoadCase,
    row: Row,
    method: str = "newton",
    tolerance: float = TOLERANCE,
    allow_large: bool = False,
) -> Equilibrium:
    """Return where the arm comes to rest.

    Args:
        mechanics: Models of the arm with its payload.
        stack: Laws of its flexures.
        case: Joint positions, motion and external wrenches.
        row: What the laws may know.
        method: "newton", "fixed_point" (which does not settle an arm that its load stiffens much), "exact" (whichever
            of them is quicker), all with the tangent checked, or "first_order" (loads of the undeflected arm).
        tolerance: Largest residual of any flexure coordinate [m, rad].
        allow_large: Go on where a flexure turns by more than `MAX_ROTATION`.

    Raises:
        ConvergenceError: No equilibrium was found.
        UnstableEquilibriumError: One was found, but the arm would leave it.
        SmallDisplacementError: A flexure turned by more than `MAX_ROTATION`.
    """
    check_method(method)
    problem = _Problem(mechanics, stack, case, row, mechanics.straight(case))
    if method == "first_order":
        solved = _first_order(problem)
    else:
        solved = SOLVERS[method](problem, tolerance)
        tangent = tangent_of(mechanics, stack, case, row, solved)
        check_stable(tangent)
        solved = replace(solved, tangent=tangent)
    if not allow_large:
        check_small(solved.twists, stack.names)
    return solved


def check_method(method: str) -> None:
    """Raise `InputError` where a method is not known."""
    if method not in METHODS:
        raise InputError(f"method {method!r} is not known{did_you_mean(method, METHODS)} (known: {', '.join(METHODS)})")


@dataclass(frozen=True)
class _Problem:
    mechanics: Mechanics
    stack: LawStack
    case: LoadCase
    row: Row
    straight: Array

    def residual(self, twists: Array) -> tuple[Array, Array, Array]:
        """Return twists - law(loads), the loads, and the configuration."""
        configuration = self.mechanics.bent(self.straight, twists)
        wrenches = self.mechanics.loads(configuration, self.case)
        return twists - self.stack.twists(wrenches, self.row), wrenches, configuration

    def tangent(self, twists: Array, wrenches: Array, configuration: Array) -> Array:
        """Return the (6 n, 6 n) derivative of the residual with respect to the twists."""
        turning = self.mechanics.turning(self.straight, configuration, twists, self.case)
        return np.eye(len(twists)) + self.stack.tangent(wrenches, self.row) @ turning

    def solved(self, twists: Array, wrenches: Array, method: str, history: Sequence[float]) -> Equilibrium:
        configuration = self.mechanics.bent(self.straight, twists)
        return Equilibrium(twists, wrenches, self.straight, configuration, method, tuple(history))


def _first_order(problem: _Problem) -> Equilibrium:
    wrenches = problem.mechanics.loads(problem.straight, problem.case)
    twists = problem.stack.twists(wrenches, problem.row)
    return problem.solved(twists, wrenches, "first_order", ())


def fixed_point(
    law: Callable[[Array], Array],
    load: Callable[[Array], Array],
    rigid: Array,
    most: int = STEPS,
    slow: float = SLOWEST,
) -> tuple[Array | None, list[float]]:
    """Return the twists at rest, None where the steps do not shrink quickly, and the squared lengths of the steps.

    Args:
        law: Loads to twists.
        load: Twists to loads.
        rigid: Loads on the undeflected arm.
        most: Steps at most.
        slow: Part of the squared step before it that a squared step must be shorter than.
    """
    twists = law(rigid)
    before = twists.dot(twists)
    sizes = [before]
    for _ in range(most):
        moved = law(load(twists))
        step = moved - twists
        size = step.dot(step)
        sizes.append(size)
        if size <= CONVERGED and size * size <= NEXT * before:
            return moved, sizes
        if not size < slow * before:  # not a number is not, either
            break
        twists, before = moved, size
    return None, sizes


def _exact(problem: _Problem, tolerance: float) -> Equilibrium:
    found, _ = _settled(problem, STEPS, SLOWEST)
    return found or _newton(problem, tolerance)


def _fixed_point(problem: _Problem, tolerance: float) -> Equilibrium:
    found, history = _settled(problem, MAX_FIXED_POINT - 1, GROWTH)
    if found is None:
        raise ConvergenceError("the fixed point did not converge; Newton may", history)
    return found


def _settled(problem: _Problem, most: int, slow: float) -> tuple[Equilibrium | None, list[float]]:
    """Return what the fixed point comes to, and the lengths of its steps."""
    mechanics, case, row = problem.mechanics, problem.case, problem.row

    def law(wrenches: Array) -> Array:
        return problem.stack.twists(wrenches, row)

    def load(twists: Array) -> Array:
        return mechanics.loads(mechanics.bent(problem.straight, twists), case)

    twists, sizes = fixed_point(law, load, mechanics.loads(problem.straight, case), most, slow)
    history = np.sqrt(sizes).tolist()
    if twists is None:
        return None, history
    # Once more, so that loads and twists are each other's to the last digit.
    residual, wrenches, _ = problem.residual(twists)
    return problem.solved(twists - residual, wrenches, "fixed_point", history), history


def _newton(problem: _Problem, tolerance: float) -> Equilibrium:
    twists = np.zeros(len(problem.mechanics.flex.flexure_v))
    state = problem.residual(twists)
    history = [_largest(state[0])]
    polished = False
    for _ in range(MAX_NEWTON):
        within = history[-1] <= tolerance
        if within and (polished or history[-1] <= POLISHED * tolerance):
            return problem.solved(twists, state[1], "newton", history)
        polished = within
        try:
            step = np.linalg.solve(problem.tangent(twists, state[1], state[2]), state[0])
        except np.linalg.LinAlgError:
            raise ConvergenceError("the tangent is singular: the arm is about to buckle", history) from None
        twists, state = _damped(problem, twists, step, history[-1])
        history.append(_largest(state[0]))
    raise ConvergenceError("the equilibrium did not converge", history)


SOLVERS = {"newton": _newton, "fixed_point": _fixed_point, "exact": _exact}


def _damped(problem: _Problem, twists: Array, step: Array, before: float) -> tuple[Array, tuple[Array, Array, Array]]:
    """Return the next twists and their residual: the step, halved until the residual shrinks or is given up."""
    # exp6 wraps around at a turn of pi; a step must not get there.
    factor = min(1.0, 1.0 / max(1e-300, float(np.abs(step).max())))
    for _ in range(8):
        trial = twists - factor * step
        state = problem.residual(trial)
        if _largest(state[0]) < before or before < 1e-11:
            break
        factor *= 0.5
    return trial, state


def _largest(residual: Array) -> float:
    largest = float(np.abs(residual).max()) if len(residual) else 0.0
    return largest if np.isfinite(largest) else np.inf


def tangent_of(mechanics: Mechanics, stack: LawStack, case: LoadCase, row: Row, equilibrium: Equilibrium) -> Array:
    """Return the (6 n, 6 n) tangent `I + C dτ/dtwist` at an equilibrium."""
    problem = _Problem(mechanics, stack, case, row, equilibrium.straight)
    return problem.tangent(equilibrium.twists, equilibrium.wrenches, equilibrium.configuration)


def check_small(twists: Array, names: tuple[str, ...]) -> None:
    """Raise `SmallDisplacementError` where a flexure turned by more than `MAX_ROTATION`."""
    turns = np.linalg.norm(twists.reshape(-1, 6)[:, 3:], axis=1)
    if len(turns) and turns.max() > MAX_ROTATION:
        name, most = names[int(turns.argmax())], float(turns.max())
        text = f"flexure {name!r} turns by {most:.3g} rad, more than the {MAX_ROTATION} rad a compliance describes"
        raise SmallDisplacementError(text, twists.reshape(-1, 6))


def check_stable(tangent: Array) -> None:
    """Raise `UnstableEquilibriumError` unless all eigenvalues of the tangent lie in the right half plane.

    With K = C^-1 the tangent is similar to `I + C^1/2 G C^1/2`, so this is the energy's Hessian being positive.
    """
    stiffening = tangent - np.eye(len(tangent))
    if np.linalg.norm(stiffening) < 1.0:  # bounds every eigenvalue's distance from 1
        return
    smallest = float(np.linalg.eigvals(tangent).real.min())
    if smallest <= 0.0:
        raise UnstableEquilibriumError("the arm would not stay where its loads balance: it buckles", smallest)
