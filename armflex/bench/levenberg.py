"""Levenberg-Marquardt with the paper's damping schedule (its eq. (19) and the paragraph below it)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from scipy.linalg import get_lapack_funcs

from armflex.conventions import Array

(dposv,) = get_lapack_funcs(("posv",))


@dataclass(frozen=True)
class Damping:
    """How the combination coefficient mu changes.

    The paper prints "10e-5" for its floor, which is 1e-4 as written and probably 1e-5 as meant.

    Attributes:
        start: First mu.
        factor: What mu is divided by after a step that helped and multiplied by after one that did not.
        floor: mu does not go below this.
        ceiling: Beyond this no step helps and the search ends.
        relative: Whether mu multiplies the diagonal of J^T J (Marquardt) instead of the identity (the paper).
    """

    start: float = 1e-3
    factor: float = 10.0
    floor: float = 1e-5
    ceiling: float = 1e10
    relative: bool = False


ROUNDING = 1e-12
"""Part of the largest diagonal entry that keeps a matrix positive definite in 64 bits."""

PAPER = Damping()
RELATIVE = Damping(start=1e-2, floor=1e-10, relative=True)


@dataclass(frozen=True)
class Point:
    """A sum of squares at one place.

    Attributes:
        weights: (P,) where it was asked for, or better ones where an objective can find some of them exactly.
        cost: Half the sum of squares.
        rest: What the objective can use again for its derivatives.
    """

    weights: Array
    cost: float
    rest: Any


class Objective(Protocol):
    """A sum of squares, and what Gauss and Newton need of it."""

    @property
    def solved(self) -> int:
        """How many weights, the last ones, `evaluate` finds by itself, so that they need no damping."""
        ...

    def evaluate(self, weights: Array) -> Point:
        """Return the cost at (P,) weights."""
        ...

    def normal(self, point: Point) -> tuple[Array, Array]:
        """Return the (P,) gradient J^T e and the (P, P) matrix J^T J, of which the lower triangle is read."""
        ...


@dataclass(frozen=True)
class Minimum:
    """Where a search ended.

    Attributes:
        weights: (P,).
        cost: Half the sum of squares there.
        costs: The cost at the start and after every step tried, never rising.
        mu: The combination coefficient that the next step would have had.
        converged: Whether it ended because nothing was to be gained any more.
    """

    weights: Array
    cost: float
    costs: Array
    mu: float
    converged: bool


def minimise(
    objective: Objective, start: Array, iterations: int = 200, tolerance: float = 0.0, damping: Damping = PAPER
) -> Minimum:
    """Return a local minimum of a sum of squares.

    Args:
        objective: See `Objective`.
        start: (P,) first weights.
        iterations: Most steps to try.
        tolerance: Ends after three helpful steps in a row that each gained less than this part of the cost.
        damping: Schedule of mu.
    """
    here, mu, small = objective.evaluate(start), damping.start, 0
    costs, normal = [here.cost], objective.normal(here)
    while len(costs) <= iterations and mu <= damping.ceiling and small < 3:
        trial = objective.evaluate(here.weights - damped_step(*normal, mu, damping.relative, objective.solved))
        if trial.cost < here.cost:
            small = small + 1 if here.cost - trial.cost < tolerance * here.cost else 0
            here, mu = trial, max(mu / damping.factor, damping.floor)
            normal = objective.normal(here)
        else:
            mu *= damping.factor
        costs.append(here.cost)
    ended = small == 3 or mu > damping.ceiling
    return Minimum(here.weights, here.cost, np.array(costs), mu, ended)


def damped_step(gradient: Array, matrix: Array, mu: float, relative: bool = False, solved: int = 0) -> Array:
    """Return (J^T J + mu D)^-1 J^T e, nan where that is singular to rounding.

    Args:
        gradient: (P,) J^T e.
        matrix: (P, P) J^T J; its lower triangle is read.
        mu: See `Damping`.
        relative: Whether D is the diagonal of J^T J rather than the identity.
        solved: Number of last weights for which D is nothing but what rounding asks for.
    """
    damped, diagonal = matrix.copy(), matrix.diagonal()
    added = mu * diagonal if relative else np.full(len(matrix), mu)
    if solved:
        added[-solved:] = ROUNDING * diagonal[-solved:].max()
    damped.flat[:: len(damped) + 1] += added
    _, step, info = dposv(damped.T, gradient, lower=0, overwrite_a=1)  # transposed: LAPACK's own order, no copy
    return step if info == 0 else np.full_like(gradient, np.nan)  # nan is below no cost: mu grows
