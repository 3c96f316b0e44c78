"""How uncertain the tip's displacement is: because of the joints' laws, and of what a campaign was fitted to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from armflex.arguments import checked_kinds
from armflex.arm import Arm, warn
from armflex.conventions import Array
from armflex.errors import Flag
from armflex.estimate.posterior import displacement_covariance, without_declared_uncertainty
from armflex.estimate.robust import ROWS_AT_ONCE
from armflex.laws.effects.in_arm import remembers
from armflex.mechanics.deflection import Deflection, DeflectionBatch
from armflex.mechanics.loaded import Payload
from armflex.rows import Rows
from armflex.rows.wrench import Wrench, wrenches_in

AT_REST = Flag("certainty_at_rest", "what was fitted is taken to be as uncertain as where the arm stands still")
"""For a moving arm."""

REMEMBERED = (
    Flag("certainty_of_memory", "an effect with a memory is taken to be as uncertain as if it began where it settles"),
)
"""For effects that lag, or depend on the rows before."""


@checked_kinds
def total_covariance(found: Deflection | DeflectionBatch, relative: bool = False) -> Array | None:
    """Return the covariance of the tip's displacement, of the laws and of what the arm was fitted to.

    `Deflection.covariance` is of the laws alone. On an arm that was calibrated or traced the fitted parameters have a
    covariance of their own, in which the declared uncertainty of fitted compliances is contained already: they are not
    counted twice. On other arms this is `Deflection.covariance`.

    Args:
        found: What `Arm.deflection` returned.
        relative: Whether the displacement is that of the campaign's target before its instrument, in which what only
            says where base and target stand cancels; in base axes all the same.

    Returns:
        (6, 6), or (N, 6, 6) of a batch, base axes [m, rad], None where nobody states an uncertainty. Flags about it are
        Python warnings.
    """
    covariance, flags = flagged_covariance(found, relative)
    warn(flags)
    return covariance


def flagged_covariance(
    deflection: Deflection | DeflectionBatch, relative: bool = False
) -> tuple[Array | None, tuple[Flag, ...]]:
    """Return `total_covariance` and the flags about it."""
    arm, case = cast(Arm, deflection.arm), deflection.case
    if arm.certainty is None:
        return deflection.covariance, ()
    certain = without_declared_uncertainty(arm)
    if isinstance(deflection, DeflectionBatch):
        laws = replace(deflection, arm=certain).covariance
        payloads = [_known_as(certain, certain.payload(deflection.payload(i))) for i in range(len(deflection.q))]
        case_arguments = (case.covariates, laws, case.wrenches, relative)
        covariance, flags = tip_covariance(certain, deflection.q, payloads, *case_arguments)
    else:
        solved = replace(deflection.solved, loaded=certain.loaded(deflection.payload))
        by_laws = replace(deflection, solved=solved).covariance
        laws, payloads = None if by_laws is None else by_laws[None], [_known_as(certain, deflection.payload)]
        case_arguments = (case.covariates, laws, case.wrenches, relative)
        covariance, flags = tip_covariance(certain, deflection.q[None], payloads, *case_arguments)
        covariance = None if covariance is None else covariance[0]
    return covariance, (*flags, AT_REST) if case.moves else flags


def _known_as(arm: Arm, payload: Payload) -> str | Payload:
    """Return the name of a payload, by which effects know it, where it has one."""
    return next((name for name, body in arm.payloads.items() if body is payload), payload)


def tip_covariance(
    arm: Arm,
    q: Array,
    payloads: Sequence[str | Payload],
    covariates: Mapping[str, ArrayLike],
    laws: Array | None,
    wrenches: Sequence[Wrench] = (),
    relative: bool = False,
) -> tuple[Array | None, tuple[Flag, ...]]:
    """Return the (N, 6, 6) covariance of the tip's displacement, base axes [m, rad], None where nobody states one.

    Args:
        arm: The arm; for one that was fitted `laws` are those of `without_declared_uncertainty`.
        q: (N, nq) joint positions [rad or m].
        payloads: What is carried in each row, or its name.
        covariates: What the arm's effects depend on, numbers or (N,) by name.
        laws: (N, 6, 6) covariance that the laws themselves give, None where none does.
        wrenches: Known loads from outside, the same in all rows or one for each.
        relative: See `total_covariance`.

    Returns:
        The covariance, and met about it.
    """
    if arm.certainty is None:
        return laws, ()
    columns = {name: np.broadcast_to(np.asarray(value, dtype=float), len(q)) for name, value in covariates.items()}
    derived = tuple(dict.fromkeys(name for effect in arm.effects for name in effect.derived))
    parts, met = [np.zeros((0, 6, 6))], dict.fromkeys(REMEMBERED if remembers(arm) else ())
    for chunk in (slice(first, first + ROWS_AT_ONCE) for first in range(0, len(q), ROWS_AT_ONCE)):
        given = {name: values[chunk] for name, values in columns.items()}
        # A direction of 0 is unknown: of effects that derive it, the joint came from either side.
        carried = cast(Sequence[str], payloads[chunk])  # one without a name may stand for itself here
        rows = Rows.of(arm.joint_names, q[chunk], carried, {"time": 0.0} | given, derived=derived)
        pulled = wrenches_in(wrenches, np.arange(len(q))[chunk])
        part, flags = displacement_covariance(arm, replace(rows, wrenches=pulled), relative)
        if part is None:
            return laws, flags
        parts.append(part)
        met |= dict.fromkeys(flags)
    fitted = np.concatenate(parts)
    return fitted if laws is None else laws + fitted, tuple(met)
