"""Where the loaded arm comes to rest: `twist = law(load(twist))`, and whether it stays there.

The engine is asked, and where it does not answer, or an arm with loops moves, Pinocchio: Newton's method on the
flexures' exponential coordinates with its geometric stiffness, see `mechanism`. A fixed point cannot distinguish a
stable equilibrium from a buckled one: the bound of `certificate` can where the arm is stiff, the tangent
`I + C dτ/dtwist` everywhere.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

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
from armflex.mechanics.certificate import SHARE
from armflex.mechanics.loaded import LoadedArm
from armflex.mechanics.loop_rows import LoopSolver, solver_of
from armflex.mechanics.many_rows import OneChain
from armflex.mechanics.mechanism import Placed, Rest
from armflex.mechanics.pinocchio_model import LoadCase
from armflex.rows.wrench import Wrench

METHODS = ("exact", "newton")
MAX_ROTATION = 0.1
"""A flexure that turns further [rad] is outside what a compliance describes."""

RUNS_AWAY = np.errstate(over="ignore", invalid="ignore")
"""What runs away is refused, not warned of."""


Quick = OneChain | LoopSolver
"""From (nq,) positions, covariates and (2, nq) speeds and accelerations, None where it stands, to where the arm rests;
None where the reference must be asked."""


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """A solved arm.

    Attributes:
        loaded: The arm with its payload.
        case: Where its joints are and what acts.
        rest: Where it rests.
        method: How it was found: "exact", by the engine, or "newton".
        history: Largest residual before each step [m or rad]; the engine does not say.
        load_factor: See `load_factor`; infinite where it is known to be `NEAR` or more.
    """

    loaded: LoadedArm
    case: LoadCase
    rest: Rest
    method: str
    history: Sequence[float] = ()
    load_factor: float = math.inf

    @cached_property
    def row(self) -> Row:
        """What its laws may know."""
        return self.loaded.row(self.case.q, self.case.covariates)

    @cached_property
    def placed(self) -> Placed:
        """Where it rests in Pinocchio's order."""
        return self.loaded.mechanics.placed(self.case, self.row, self.rest)

    @cached_property
    def tangent(self) -> Array:
        """See `Mechanism.tangent`."""
        return self.loaded.mechanics.tangent(self.placed)


def check_method(method: str) -> None:
    """Raise `InputError` where a method is not known."""
    if method not in METHODS:
        raise InputError(f"method {method!r} is not known{did_you_mean(method, METHODS)} (known: {', '.join(METHODS)})")


def find_equilibrium(
    loaded: LoadedArm, case: LoadCase, method: str = "newton", allow_large: bool = False
) -> Equilibrium:
    """Return where the arm comes to rest.

    Args:
        loaded: The arm with its payload.
        case: Joint positions, motion, external wrenches and covariates.
        method: "newton", the reference, or "exact", the quickest that answers alike. Stability is checked.
        allow_large: Go on where a flexure turns by more than `MAX_ROTATION`.

    Raises:
        ConvergenceError: No equilibrium was found.
        UnstableEquilibriumError: One was found, but the arm would leave it.
        SmallDisplacementError: A flexure turned by more than `MAX_ROTATION`.
    """
    check_method(method)
    if method == "exact":
        rest = quick_of(loaded, case.wrenches)(case.q, case.covariates, case.motion)
        if rest is not None:
            return at_rest(loaded, case, rest)
    return _by_newton(loaded, case, allow_large)


def quick_of(loaded: LoadedArm, wrenches: tuple[Wrench, ...]) -> Quick:
    """Return this thread's engine under some loads: a function of (nq,) positions and covariates."""
    if loaded.tied:
        return solver_of(loaded, wrenches)
    one = getattr(loaded.kept, "one", None)
    if one is None:
        one = loaded.kept.one = OneChain(loaded)
    return one.under(wrenches)


def at_rest(loaded: LoadedArm, case: LoadCase, rest: Rest) -> Equilibrium:
    """Return the equilibrium that the engine found.

    Raises:
        UnstableEquilibriumError: The arm would leave it.
    """
    found = Equilibrium(loaded, case, rest, "exact")
    return found if rest.proven else replace(found, load_factor=_lasting(found.tangent))


@RUNS_AWAY
def _by_newton(loaded: LoadedArm, case: LoadCase, allow_large: bool) -> Equilibrium:
    """Return the equilibrium as the reference has it."""
    pushed = max((one.sizes[0] for one in case.wrenches if not one.hangs), default=0.0)
    loads = [f"a payload of {loaded.payload.mass:g} kg"] * bool(loaded.payload.mass)
    loads += [f"a force from outside of {pushed:.4g} N"] * bool(pushed)
    mechanics, under = loaded.mechanics, f" under {' and '.join(loads)}" if loads else ""
    rest, history = mechanics.rest(case, loaded.row(case.q, case.covariates), under)
    found = Equilibrium(loaded, case, rest, "newton", history)
    found = replace(found, load_factor=_lasting(found.tangent))
    if not allow_large:
        check_small(rest.twists, loaded.arm.stack.names)
    return found


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


@RUNS_AWAY
def check_small(twists: Array, names: tuple[str, ...]) -> None:
    """Raise `SmallDisplacementError` where one of (n, 6) twists turns by more than `MAX_ROTATION`."""
    turns = np.linalg.norm(twists[:, 3:], axis=1)
    if len(turns) and turns.max() > MAX_ROTATION:
        name, most = names[int(turns.argmax())], float(turns.max())
        text = f"flexure {name!r} turns by {most:.3g} rad, more than the {MAX_ROTATION} rad a compliance describes"
        text += ": is its compliance, or a load on it, in another unit?"
        raise SmallDisplacementError(text, twists)


def load_factor(tangent: Array) -> float:
    """Return how many times its loads an arm with a (6 n, 6 n) tangent carries before it buckles; 1 or less: it does.

    With K = C^-1 the tangent I + C G is similar to `I + C^1/2 G C^1/2`, the energy's Hessian, and G is in proportion to
    the loads: the arm, bent as it is, buckles where they are `1 / (1 - smallest eigenvalue)` times as large. That is a
    linear buckling analysis about the equilibrium. An arm that its loads stiffen does not buckle: infinite.
    """
    smallest = float(np.linalg.eigvals(tangent).real.min(initial=1.0))
    return 1.0 / (1.0 - smallest) if smallest < 1.0 else math.inf
