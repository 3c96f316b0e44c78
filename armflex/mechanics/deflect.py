"""One question to an arm with a payload, from joint positions that were checked to a `Deflection`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from armflex.conventions import Array
from armflex.errors import ConvergenceError, ExtrapolationError, Flag
from armflex.mechanics.deflection import Deflection, Solved
from armflex.mechanics.doubts import payload_doubts, wrench_doubts
from armflex.mechanics.equilibrium import SMALL, check_method, check_small, find_equilibrium
from armflex.mechanics.loaded import LoadedArm
from armflex.mechanics.loads import Wrench
from armflex.mechanics.pinocchio_model import LoadCase
from armflex.mechanics.solver import Solver


class Asked(NamedTuple):
    """How a question is to be answered; see `Arm.deflection`."""

    method: str = "exact"
    enforce_limits: bool = True
    allow_large: bool = False
    strict: bool = False


def deflect(
    loaded: LoadedArm,
    q: Array,
    flags: tuple[Flag, ...],
    covariates: dict[str, Array],
    asked: Asked,
) -> Deflection:
    """Return what the arm does at (nq,) positions under its own weight; `flags` are the doubts about them."""
    doubts = (*loaded.flags, *flags) if flags else loaded.flags
    # Beyond its limits a joint may be farther out than the proof of stability knows of.
    first_order, exact = asked.method == "first_order", asked.method == "exact" and not flags
    if loaded.arm.pulls or not (first_order or exact):
        return _general(loaded, q, None, covariates, asked, doubts)
    solver = loaded.solver
    straight = solver.straight(q)
    if loaded.laws.others:
        solver.know(loaded.row(q, covariates))
    if first_order:
        motion, torque = solver.first_order(straight)
        if not motion.dot(motion) < SMALL:
            check_motion(loaded, motion, asked.allow_large)
        found = Deflection(q, Solved(loaded, straight, motion, torque, "first_order", (), doubts, covariates))
    else:
        settled = settle(loaded, solver, straight)
        if settled is None:
            return _general(loaded, q, None, covariates, asked, doubts)
        motion, history = settled
        found = Deflection(q, Solved(loaded, straight, motion, None, "fixed_point", history, doubts, covariates))
    return _unless_unseen(found) if asked.strict else found


def deflect_moving(
    loaded: LoadedArm,
    q: Array,
    flags: tuple[Flag, ...],
    covariates: dict[str, Array],
    asked: Asked,
    motion: list[Array | None],
    wrenches: tuple[Wrench, ...],
) -> Deflection:
    """Return what the arm does in motion, with v and a of (nq,) or None, or under loads from outside."""
    arm = loaded.arm
    carried = payload_doubts(arm, loaded.payload, motion[1] is not None)
    doubts = (*arm.flags, *flags, *carried, *wrench_doubts(arm, wrenches))
    return _general(loaded, q, LoadCase(q, *motion, (*wrenches, *arm.pulls)), covariates, asked, doubts)


def settle(loaded: LoadedArm, solver: Solver, straight: Array) -> tuple[Array, list[float]] | None:
    """Return motion and squared residuals of an equilibrium that is proven stable; None where Newton must be asked."""
    softening = loaded.softening
    if softening is None:
        return None
    found = solver.settle(straight)
    if found is None or not found[0].dot(found[0]) < SMALL:
        return None
    if not softening.proven:
        # What is affine gives the same under every load, so they need not be known.
        torque = solver.torque(solver.bent(straight, found[0])) if solver.curved else found[0]
        if not softening.stays(-torque[loaded.mechanics.flex.flexure_v], solver.tangent):
            return None
    return found


def check_motion(loaded: LoadedArm, motion: Array, allow_large: bool) -> None:
    """Raise where a (nv,) motion is not finite, or a flexure turns too far though that is not allowed."""
    if not np.isfinite(motion).all():
        raise ConvergenceError("the loads or the laws give no finite twists", ())
    if not allow_large:
        check_small(motion[loaded.mechanics.flex.flexure_v], loaded.arm.stack.names)


def _general(
    loaded: LoadedArm, q: Array, case: LoadCase | None, covariates: dict[str, Array], asked: Asked, doubts: tuple
) -> Deflection:
    check_method(asked.method)
    mechanics, row = loaded.mechanics, loaded.row(q, covariates)
    found = find_equilibrium(
        mechanics, loaded.arm.stack, case or loaded.case(q), row, asked.method, allow_large=asked.allow_large
    )
    motion, torque = np.zeros((2, mechanics.flex.model.nv))
    motion[mechanics.flex.flexure_v], torque[mechanics.flex.flexure_v] = found.twists, -found.wrenches
    how = (found.method, np.square(found.history), doubts, covariates, case, found.tangent)
    kept = Solved(loaded, found.straight, motion, torque, *how)
    result = Deflection(q, kept)
    return _unless_unseen(result) if asked.strict else result


def _unless_unseen(found: Deflection) -> Deflection:
    """Return what was found; raise `ExtrapolationError` where a trained law was asked beyond its loads."""
    if found.unseen:
        raise ExtrapolationError("; ".join(flag.text for flag in found.unseen))
    return found
