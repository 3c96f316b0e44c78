"""One arm with many sets of laws, in many rows."""

from __future__ import annotations

import numpy as np

from armflex.conventions import Array
from armflex.errors import UnsupportedError, naming
from armflex.mechanics.laws import LawStack, RowLaws
from armflex.mechanics.loads import Payload
from armflex.mechanics.many_rows import AT_ONCE, RowSolver, Solution, chunks
from armflex.mechanics.structure import Structure


def draw_laws(
    arm: Structure,
    rows: Array,
    payload: str | Payload | None,
    known: dict[str, Array],
    method: str,
    draws: int,
    seed: int,
) -> Array:
    """Return the (draws, N, 6) displacements of the tip [m, rad] of the same arm with laws drawn by `Law.draw`.

    What is shared is computed once: where the rigid arm is, and the loads from which every draw comes to rest.

    Args:
        arm: The arm, at whose links nothing pulls.
        rows: (N, nq) joint positions [rad or m], within their limits.
        payload: Name or object.
        known: What the arm's effects depend on: numbers, or (N,) of them.
        method: "exact" or "first_order".
        draws: How many.
        seed: Of the random numbers.

    Raises:
        UnsupportedError: A draw has no equilibrium that is proven stable.
    """
    rng = np.random.default_rng(seed)
    stacks = [LawStack(arm.stack.names, tuple(law.draw(rng) for law in arm.stack.laws)) for _ in range(draws)]
    loaded, exact = arm.loaded(payload), method == "exact"
    bounds = [None if loaded.stability_bound is None else loaded.stability_bound.with_laws(stack) for stack in stacks]
    solver, found = RowSolver(loaded, exact), np.empty((draws, len(rows), 6))
    for some in chunks(np.arange(len(rows)), AT_ONCE):
        given = {name: values[some] if values.ndim else values for name, values in known.items()}
        row = loaded.row(rows[some], given)
        into, rooms = Solution.empty(len(row.q), len(arm.sites)), solver.rooms(len(row.q))
        solver.solve(row, RowLaws(arm.stack, row), into, rooms)
        for number, stack in enumerate(stacks):
            laws = RowLaws(stack, row)
            fine = solver.solve(row, laws, into, rooms, ready=True)
            if not (solver.proven(row, laws, into, bounds[number], fine) if exact else fine).all():
                with naming(f"draw {number}"):
                    raise UnsupportedError("the arm so drawn is too soft: it turns too far, or may not stay")
            found[number, some] = into.displacement
    return found
