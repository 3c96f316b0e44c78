"""How uncertain the tip's displacement is: because of the joints' laws, and of what a campaign was fitted to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from armflex.arm import Arm
from armflex.calibrate.spread import displacement_covariance
from armflex.conventions import Array
from armflex.effects.law import TwistLaw
from armflex.errors import Flag
from armflex.measured.measurements import Measurements

AT_ONCE = 512
"""Rows that are linearised together: each takes some ten kilobytes."""

AT_REST = Flag(
    "certainty_at_rest", "what was fitted is taken to be as uncertain as where the arm stands under its own weight"
)
"""For a moving arm, or one under loads from outside."""

REMEMBERED = (
    Flag("certainty_of_memory", "an effect with a memory is taken to be as uncertain as if it began where it settles"),
)
"""For effects that lag, or depend on the rows before."""


def tip_covariance(
    arm: Arm, q: Array, payloads: Sequence[str], covariates: Mapping[str, ArrayLike], laws: Array | None
) -> tuple[Array | None, tuple[Flag, ...]]:
    """Return the (N, 6, 6) covariance of the tip's displacement, base axes [m, rad], None where nobody states one.

    Args:
        arm: The arm; for one that was fitted `laws` are those of `without_declared_doubt`.
        q: (N, nq) joint positions [rad or m].
        payloads: Name of what is carried in each row.
        covariates: What the arm's effects depend on, numbers or (N,) by name.
        laws: (N, 6, 6) covariance that the laws themselves give, None where none does.

    Returns:
        The covariance, and doubts about it.
    """
    if arm.certainty is None:
        return laws, ()
    known = {name: np.broadcast_to(np.asarray(value, dtype=float), len(q)) for name, value in covariates.items()}
    parts = [np.zeros((0, 6, 6))]
    for some in (slice(first, first + AT_ONCE) for first in range(0, len(q), AT_ONCE)):
        given = {name: values[some] for name, values in known.items()}
        part, flags = displacement_covariance(arm, _rows(arm, q[some], payloads[some], given))
        if part is None:
            return laws, flags
        parts.append(part)
    fitted = np.concatenate(parts)
    return fitted if laws is None else laws + fitted, REMEMBERED if _remembers(arm) else ()


def _remembers(arm: Arm) -> bool:
    return any(isinstance(effect.law, TwistLaw) and effect.law.memory is not None for effect in arm.effects)


def length_sigma(vectors: Array, covariance: Array) -> Array:
    """Return (n,) standard deviations of the lengths of (n, 3) vectors, to first order; see `Deflection.sigma`."""
    length = np.linalg.norm(vectors, axis=1)
    moves = length > 0.0
    along = vectors / np.where(moves, length, 1.0)[:, None]
    variance = np.einsum("ni,nij,nj->n", along, covariance, along)
    return np.sqrt(np.where(moves, np.maximum(variance, 0.0), np.trace(covariance, axis1=1, axis2=2)))


def _rows(arm: Arm, q: Array, payloads: Sequence[str], covariates: Mapping[str, Array]) -> Measurements:
    """Return configurations as rows of a campaign in which orientations count and nothing was read."""
    count, blank = len(q), ("",) * len(q)
    given = dict(covariates)
    return Measurements(
        joint_names=arm.joint_names,
        pose=tuple(map(str, range(count))),
        session=blank,
        payload=tuple(payloads),
        time=given.pop("time", np.zeros(count)),
        q=q,
        approach=np.stack([given.pop(f"approach_{name}", np.zeros(count)) for name in arm.joint_names], axis=1),
        measured=np.zeros(count, dtype=bool),
        position=np.zeros((count, 3)),
        rotation=np.zeros((count, 3)),
        sigma=np.ones((count, 3)),
        sigma_r=np.ones(count),
        hold=given.pop("hold", None),
        covariates=given,
        places=(),
    )
