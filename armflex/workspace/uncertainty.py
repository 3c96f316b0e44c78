"""How uncertain the length of the tip's shift is: because of the joints' laws, and of what a campaign was fitted to."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from armflex.arm import Arm
from armflex.calibrate.spread import displacement_covariance
from armflex.conventions import Array
from armflex.deflection_batch import DeflectionBatch
from armflex.errors import Flag
from armflex.measurements import Measurements

AT_ONCE = 512
"""Rows that are linearised together: each takes some ten kilobytes."""


def length_sigma(
    arm: Arm, found: DeflectionBatch, payload: str, covariates: Mapping[str, float]
) -> tuple[Array, tuple[Flag, ...]]:
    """Return the (n,) standard uncertainty of the length of (n, 3) shifts, NaN where nobody states one, and doubts."""
    shift = found.displacement[:, :3]
    laws = None if found.covariance is None else found.covariance[:, :3, :3]
    fitted, flags = _fitted(arm, found.q, payload, covariates)
    parts = [part for part in (laws, fitted) if part is not None]
    if not parts:
        return np.full(len(shift), np.nan), flags
    return _along(shift, sum(parts[1:], parts[0])), flags


def _along(shift: Array, covariance: Array) -> Array:
    """Return (n,) standard deviations of the lengths of (n, 3) shifts; see `Deflection.sigma`."""
    length = np.linalg.norm(shift, axis=1)
    moves = length > 0.0
    along = shift / np.where(moves, length, 1.0)[:, None]
    variance = np.einsum("ni,nij,nj->n", along, covariance, along)
    return np.sqrt(np.where(moves, np.maximum(variance, 0.0), np.trace(covariance, axis1=1, axis2=2)))


def _fitted(arm: Arm, q: Array, payload: str, covariates: Mapping[str, float]) -> tuple[Array | None, tuple[Flag, ...]]:
    if arm.certainty is None:
        return None, ()
    parts, flags = [], ()
    for first in range(0, len(q), AT_ONCE):
        part, flags = displacement_covariance(arm, _rows(arm, q[first : first + AT_ONCE], payload, covariates))
        parts.append(part)
    return None if parts[0] is None else np.concatenate(parts), flags


def _rows(arm: Arm, q: Array, payload: str, covariates: Mapping[str, float]) -> Measurements:
    """Return configurations as rows of a campaign in which nothing was read."""
    count, blank = len(q), ("",) * len(q)
    given = {name: np.full(count, float(value)) for name, value in covariates.items()}
    return Measurements(
        joint_names=arm.joint_names,
        pose=tuple(map(str, range(count))),
        session=blank,
        payload=(payload,) * count,
        time=given.pop("time", np.zeros(count)),
        q=q,
        approach=np.stack([given.pop(f"approach_{name}", np.zeros(count)) for name in arm.joint_names], axis=1),
        measured=np.zeros(count, dtype=bool),
        position=np.zeros((count, 3)),
        rotation=None,
        sigma=np.ones((count, 3)),
        sigma_r=None,
        hold=given.pop("hold", None),
        covariates=given,
        places=(),
    )
