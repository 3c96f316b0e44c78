"""What the arm does if its joints' laws are others that are as likely: draws from what is known of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from armflex.batch.batch import check_positions, chunks
from armflex.batch.laws import BatchLaws
from armflex.batch.solver import BatchSolver, room_for
from armflex.conventions import Array, covariate_array, real_array
from armflex.errors import InputError, ShapeError, UnsupportedError, did_you_mean, naming
from armflex.statics.law_stack import LawStack
from armflex.statics.loads import Payload

if TYPE_CHECKING:
    from armflex.arm import Arm

METHODS = ("exact", "first_order")


def ensemble(
    arm: Arm,
    q: ArrayLike,
    payload: str | Payload | None = None,
    *,
    draws: int = 100,
    seed: int = 0,
    covariates: Mapping[str, ArrayLike] | None = None,
    method: str = "exact",
) -> Array:
    """Return the (draws, 6) or (draws, N, 6) displacements of the tip, each draw with one set of laws in all rows.

    Laws are drawn by `Law.draw`: compliances by their relative uncertainty or their fit's covariance, networks from
    their posterior. What is shared is computed once: where the rigid arm is, and the loads from which every draw comes
    to rest (to first order they are the same for all). On an arm that was calibrated or traced what was fitted is drawn
    as well, see `draw_arms`; each draw is then an arm of its own, and takes as long, also where an effect pulls at a
    link.

    Args:
        arm: The arm.
        q: (nq,) or (N, nq) joint positions [rad or m], within their limits.
        payload: Name or object.
        draws: How many.
        seed: Of the random numbers; the same laws are drawn for any q.
        covariates: What the arm's effects depend on: a number, or one per row.
        method: "exact" or "first_order"; see `find_equilibrium`.

    Raises:
        InputError: As `Arm.deflection`, or no such method; also where a draw has no equilibrium.
        UnsupportedError: A draw has no equilibrium that is proven stable, or see `draw_arms`.
    """
    from armflex.calibrate.draw import check_draws  # which imports this package

    draws, seed = check_draws(draws, seed)
    arm.loaded(payload)  # what is wrong with it is no draw's fault
    if method not in METHODS:
        raise InputError(f"method {method!r} is not known{did_you_mean(method, METHODS)} (known: {', '.join(METHODS)})")
    positions = real_array(q, "q")
    if positions.ndim not in (1, 2):
        raise ShapeError(f"q: expected shape (nq,) or (N, nq), got {positions.shape}")
    rows = check_positions(arm, np.atleast_2d(positions), enforce_limits=True)
    count = len(rows) if positions.ndim == 2 else 0
    known = {name: covariate_array(values, name, count) for name, values in (covariates or {}).items()}
    asked = (arm, rows, payload, known, method)
    plain = arm.certainty is None and not arm.pulls
    found = _by_laws(*asked, draws, seed) if plain else _by_arms(*asked, draws, seed)
    return found if positions.ndim == 2 else found[:, 0]


def _by_arms(
    arm: Arm, rows: Array, payload: str | Payload | None, known: dict[str, Array], method: str, draws: int, seed: int
) -> Array:
    """Return the (draws, N, 6) displacements of drawn arms, one after the other."""
    from armflex.calibrate.draw import draw_arms

    found = np.empty((draws, len(rows), 6))
    for number, drawn in enumerate(draw_arms(arm, draws, seed)):
        with naming(f"draw {number}"):
            found[number] = drawn.deflection(rows, payload, covariates=known, method=method).displacement
    return found


def _by_laws(
    arm: Arm, rows: Array, payload: str | Payload | None, known: dict[str, Array], method: str, draws: int, seed: int
) -> Array:
    """Return the (draws, N, 6) displacements of the same arm with drawn laws."""
    rng = np.random.default_rng(seed)
    stacks = [LawStack(arm.stack.names, tuple(law.draw(rng) for law in arm.stack.laws)) for _ in range(draws)]
    loaded = arm.loaded(payload)
    bounds = [None if loaded.softening is None else loaded.softening.with_laws(stack) for stack in stacks]
    solver = BatchSolver(loaded, method == "exact", draws * len(rows))
    found = np.empty((draws, len(rows), 6))
    for some in chunks(np.arange(len(rows)), solver.chunk):
        given = {name: values[some] if values.ndim else values for name, values in known.items()}
        row = loaded.row(rows[some], given)
        into = room_for(len(row.q), len(arm.modelled))
        start = solver.near(row, BatchLaws(arm.stack, row), loaded.softening)
        for number, stack in enumerate(stacks):
            if not solver.settle(row, BatchLaws(stack, row), bounds[number], into, start).all():
                with naming(f"draw {number}"):
                    raise UnsupportedError("the arm so drawn is too soft: it turns too far, or may not stay")
            found[number, some] = into[0]
    return found
