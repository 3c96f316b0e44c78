"""What a joint deformation model is: a load in, a small twist out, at one place of the arm."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from armflex.conventions import Array
from armflex.errors import Flag, LawError, MissingCovariateError

Ranges = Mapping[str, tuple[float, float]]
"""Moving joints of a chain: lowest and highest position [rad or m]."""


@dataclass(frozen=True)
class Row:
    """What is known where a law is asked: joint positions and, by name, whatever else was given.

    Attributes:
        q: (..., nq) joint positions [rad or m].
        joint_index: Place of each joint in `q`.
        covariates: Further known numbers, each a scalar or (...,).
    """

    q: Array
    joint_index: Mapping[str, int]
    covariates: Mapping[str, Array] = field(default_factory=dict)

    def position(self, joint: str) -> Array:
        """Return the (...,) position of a joint [rad or m]."""
        return self.q[..., self.joint_index[joint]]

    def covariate(self, name: str) -> Array:
        """Return what was given by a name; raise `MissingCovariateError` where it was not."""
        if name not in self.covariates:
            raise MissingCovariateError(name, self.covariates)
        return self.covariates[name]

    def some(self, index: int | np.ndarray) -> Row:
        """Return one of N rows, or some of them; what all rows share stays as it is."""
        known = {name: values[index] if np.ndim(values) else values for name, values in self.covariates.items()}
        return Row(self.q[index] if self.q.ndim > 1 else self.q, self.joint_index, known)

    def spread(self, count: int) -> Row:
        """Return N rows where a leading axis may have been left at 1 or out."""
        known = {
            name: np.broadcast_to(values, (count, *np.shape(values)[1:])) if np.ndim(values) else values
            for name, values in self.covariates.items()
        }
        q = np.broadcast_to(self.q, (count, *self.q.shape[1:])) if self.q.ndim > 1 else self.q
        return Row(q, self.joint_index, known)

    def widened(self) -> Row:
        """Return the row(s) with another axis, along which several loads of each are asked about."""
        known = {name: np.asarray(values)[..., None] for name, values in self.covariates.items()}
        return Row(self.q[..., None, :], self.joint_index, known)


class Law(Protocol):
    """A joint deformation model. Wrench [N, Nm] is the load on the structure and twist [m, rad] the motion it gives,
    both linear first and in the flexure's own axes. To inherit from this class gives the answers of a law that was not
    trained."""

    def twist(self, wrench: Array, row: Row) -> Array:
        """Return the (..., 6) twist under a (..., 6) wrench."""
        ...

    def tangent(self, wrench: Array, row: Row) -> Array:
        """Return the (..., 6, 6) derivative of the twist with respect to the wrench."""
        ...

    def covariance(self, wrench: Array, row: Row) -> Array | None:
        """Return the (6, 6) covariance of the twist, or None when the law carries no uncertainty."""
        ...

    @property
    def parts(self) -> tuple[Law, ...]:
        """Laws whose twists add up to this one's."""
        return (self,)

    def affine(self, row: Row) -> tuple[Array, Array] | None:
        """Return the (..., 6) twist without load and the (..., 6, 6) compliance, None where the law is curved."""
        return None

    def steepest(self, ranges: Ranges) -> Array | None:
        """Return (2, 2) bounds of the tangent's 3 x 3 blocks, by their 2-norm, None where none is known.

        They hold under every load, and wherever the joints are within their ranges.
        """
        return None

    def draw(self, rng: np.random.Generator) -> Law:
        """Return a law drawn from what is known of this one: its parameters, not the scatter of single readings."""
        return self

    @property
    def trained(self) -> bool:
        """Whether the law knows the loads that it was trained on, so that `doubts` is worth asking."""
        return False

    def doubts(self, wrench: Array, row: Row) -> tuple[Flag, ...]:
        """Return what is doubtful about the answer to a (6,) wrench: loads beyond those trained on."""
        return ()


def check_ordered(loads: Array) -> None:
    """Raise `LawError` where the first of two rows, the smallest loads seen, is not below the second."""
    if (loads[0] > loads[1]).any():
        raise LawError("the smallest loads are not below the largest")


HALVES = np.repeat(np.eye(2), 3, axis=1)
"""(2, 6) linear and angular coordinates."""


def block_norms(tangent: Array) -> Array:
    """Return the (..., 2, 2) Frobenius norms of the 3 x 3 blocks of (..., 6, 6) matrices: bounds of their 2-norms."""
    return np.sqrt(HALVES @ (tangent * tangent) @ HALVES.T)


def embed(block: Array) -> Array:
    """Return a 3 x 3 force-to-translation block as 6 x 6 with zeros elsewhere (a 6 x 6 is returned as it is)."""
    if block.shape[-1] == 6:
        return block
    whole = np.zeros((6, 6))
    whole[:3, :3] = block
    return whole
