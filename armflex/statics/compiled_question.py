"""The question of `Prepared` in machine code, where numba is installed."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pinocchio as pin

from armflex.conventions import Array, covariate_array
from armflex.errors import MissingCovariateError
from armflex.laws import Law, Row
from armflex.laws.network import NetworkLaw
from armflex.robot import build_model
from armflex.statics.loaded import LoadedArm

Answer = tuple[Array, Array, Array]
"""(nq,) joint positions, (n, 6) twists or the (nv,) motion of which they are part, (6,) displacement."""

Quick = Callable[[Array, dict[str, float]], Answer | None]
"""From (nq,) positions and covariates; None where the general way must be gone, or what is wrong said."""

FLOAT = np.dtype(float)


def compiled_question(loaded: LoadedArm, exact: bool) -> Quick | None:
    """Return the question in machine code, None where there is none for an arm's laws, or no proof that it stays."""
    from armflex.batch.laws import BatchLaws  # which imports the statics of one configuration
    from armflex.batch.solver import compiled

    functions = compiled() if not exact or _provable(loaded) else None
    if functions is None:
        return None
    bounds, joints, flexures = np.array(loaded.arm.bounds), len(loaded.arm.joint_names), len(loaded.flexure_joints)
    stack, middle = loaded.arm.stack, bounds.mean(axis=0)
    changing = tuple((i, law) for i, _, law in loaded.laws.others if not isinstance(law, NetworkLaw))
    if not all(_affine(law, loaded.row(middle, {})) for _, law in changing):
        return None
    same = [(i, law) for i, law in stack.parts if not any(law is other for _, other in changing)]
    laws = BatchLaws(stack, loaded.row(middle[None], {}), same).numbers
    room, hidden = functions.room_for(flexures, lanes=1)[0], np.empty(len(laws[2]))
    known, answer, shape = (*loaded.chain.numbers, *laws, bounds, room, hidden, exact), functions.answer_one, (joints,)
    take = _taker(loaded, changing, laws[0][0], laws[1][0], exact) if changing else None

    def quick(q: Array, covariates: dict[str, float]) -> Answer | None:
        if q.shape != shape or q.dtype != FLOAT or (not take(q, covariates) if take else covariates):
            return None
        here, twists, displacement = q.copy(), np.empty((flexures, 6)), np.empty(6)
        return (here, twists, displacement) if answer(*known, here, twists, displacement) else None

    answer(*known, middle, np.empty((flexures, 6)), np.empty(6))  # compiled now, not in the loop
    return quick if loaded.nominal is None else _from_nominal(loaded, quick)


def _provable(loaded: LoadedArm) -> bool:
    """Return whether it can be proven that the arm stays without knowing its loads."""
    softening = loaded.softening
    if softening is None:
        return False
    return not any(isinstance(law, NetworkLaw) for _, laws in softening.unknown for law in laws)


def _affine(law: Law, row: Row) -> bool:
    """Return whether a law is affine in the load wherever it is known what it depends on."""
    try:
        return law.affine(row) is not None
    except MissingCovariateError:
        return True


def _taker(
    loaded: LoadedArm, changing: Sequence[tuple[int, Law]], compliance: Array, offset: Array, exact: bool
) -> Callable[[Array, dict[str, float]], bool]:
    """Return what takes in laws that are others at every position, or with every covariate, where they are affine.

    It puts them into the (n, 6, 6) compliance and (n, 6) offset that compiled code reads, and returns whether it could,
    and whether the arm then is sure to stay.
    """
    softer, shifted = compliance.copy(), offset.copy()
    softening = loaded.softening if exact and not loaded.softening.proven else None
    tangents: dict[int, Array] = {}
    unloaded = np.zeros(offset.size)

    def tangent(law: Law, load: Array) -> Array:
        known = tangents.get(id(law))
        return law.tangent(load, None) if known is None else known

    def take(q: Array, covariates: dict[str, float]) -> bool:
        row = loaded.row(q, {name: covariate_array(value, name, 0) for name, value in covariates.items()})
        np.copyto(compliance, softer)
        np.copyto(offset, shifted)
        for i, law in changing:
            affine = law.affine(row)
            if affine is None:
                return False
            offset[i] += affine[0]
            compliance[i] += affine[1]
            tangents[id(law)] = affine[1]
        return softening is None or softening.stays(unloaded, tangent)

    return take


def _from_nominal(loaded: LoadedArm, quick: Quick) -> Quick:
    """Return the question whose displacements are from where the controller has the rigid arm, not from where it is."""
    true, nominal = build_model(loaded.arm.robot, (), None, loaded.arm.corrections), loaded.mechanics.rigid
    datas = (true.model.createData(), nominal.model.createData())
    here, there = datas[0].oMf[true.tip], datas[1].oMf[nominal.tip]
    origin, turn, nominal_origin, back = here.translation, here.rotation, there.translation, there.rotation.T

    def moved(q: Array, covariates: dict[str, float]) -> Answer | None:
        found = quick(q, covariates)
        if found is None:
            return None
        displacement = found[2]
        pin.framesForwardKinematics(true.model, datas[0], found[0])
        pin.framesForwardKinematics(nominal.model, datas[1], found[0])
        displacement[:3] += origin - nominal_origin
        displacement[3:] = pin.log3(pin.exp3(displacement[3:]).dot(turn).dot(back))
        return found

    return moved
