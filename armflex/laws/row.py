"""What is known where a law is asked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from armflex.conventions import Array
from armflex.errors import MissingCovariateError
from armflex.rows.rows import APPROACH

MASS = "payload_mass"
"""Column of the mass of what is carried [kg], which every row has, as it has directions: nobody gives it."""


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
            given = (column for column in self.covariates if column != MASS and not column.startswith(APPROACH))
            raise MissingCovariateError(name, given)
        return self.covariates[name]

    def has(self, name: str) -> bool:
        """Return whether there is a column, or a joint's position, of a name."""
        return name in self.covariates or (name.startswith("q_") and name[2:] in self.joint_index)

    def column(self, name: str) -> Array:
        """Return the (...,) values of a column, or of a joint's position ('q_J')."""
        if name.startswith("q_") and name[2:] in self.joint_index:
            return self.position(name[2:])
        return self.covariate(name)

    def some(self, index: int | np.ndarray) -> Row:
        """Return one of N rows, or some of them; what all rows share stays as it is."""
        columns = {name: values[index] if np.ndim(values) else values for name, values in self.covariates.items()}
        return Row(self.q[index] if self.q.ndim > 1 else self.q, self.joint_index, columns)

    def repeated(self, count: int) -> Row:
        """Return N rows where a leading axis may have been left at 1 or out."""
        columns = {
            name: np.broadcast_to(values, (count, *np.shape(values)[1:])) if np.ndim(values) else values
            for name, values in self.covariates.items()
        }
        q = np.broadcast_to(self.q, (count, *self.q.shape[1:])) if self.q.ndim > 1 else self.q
        return Row(q, self.joint_index, columns)

    def widened(self) -> Row:
        """Return the row(s) with another axis, along which several loads of each are asked about."""
        columns = {name: np.asarray(values)[..., None] for name, values in self.covariates.items()}
        return Row(self.q[..., None, :], self.joint_index, columns)


NOWHERE = Row(np.zeros(0), {})
"""Where no law is asked that depends on more than the load, such as on a bench, which has no joint positions."""
