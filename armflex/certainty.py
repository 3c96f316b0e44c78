"""How well the fitted parameters of an arm are known: what a calibration leaves behind for predictions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from armflex.conventions import Array
from armflex.errors import InputError
from armflex.parameters import ArmParameter, Group

CANCELLED = 1e-5
"""Share of what parameters do one by one that is left of it where they cancel each other."""


@dataclass(frozen=True, eq=False)
class Certainty:
    """Covariance of everything that a fit moved, effects included.

    Attributes:
        parameters: What was moved, in the fit's order.
        covariance: (P, P) posterior covariance in their units, of what is determined; inner parameters of effects by
            the logarithm.
        unexplained: Site, axis and standard deviation [m or rad] of a random twist that nobody can predict, None where
            there is none.
        directions: (k, P) directions, in the parameters' units, that neither the campaign nor a prior determined, None
            where there are none.
        misfit: Standard deviation of each coordinate [m] by which readings scattered beyond what they stated: what the
            arm lacks moves the tip so much.

    Raises:
        InputError: Two parameters have the same label.
    """

    parameters: tuple[ArmParameter, ...]
    covariance: Array
    unexplained: tuple[str, str, float] | None = None
    directions: Array | None = None
    misfit: float = 0.0

    def __post_init__(self) -> None:
        if len(set(self.labels)) < len(self.labels):  # a file could not tell them apart
            twice = next(label for label in self.labels if self.labels.count(label) > 1)
            raise InputError(f"two parameters are both named {twice!r}: rename a flexure or a node of its assembly")

    @cached_property
    def labels(self) -> tuple[str, ...]:
        """What files and reports call each parameter."""
        return tuple(parameter.label for parameter in self.parameters)

    @cached_property
    def groups(self) -> frozenset[Group]:
        """What anything is known of."""
        return frozenset(parameter.group for parameter in self.parameters)

    @cached_property
    def undetermined(self) -> tuple[str, ...]:
        """Labels of the parameters that have a part in an undetermined direction: their variance is infinite."""
        if self.directions is None:
            return ()
        return tuple(self.labels[i] for i in np.flatnonzero(self.directions.any(axis=0)))

    def leaves_open(self, jacobian: Array) -> Array:
        """Return (N, d) which of (N, d, P) changes per unit of a parameter go with an undetermined direction."""
        if self.directions is None:
            return np.zeros(jacobian.shape[:-1], dtype=bool)
        # What parameters do against each other cancels but for rounding, which is by the largest of the d numbers.
        size = (np.abs(jacobian) @ np.abs(self.directions.T)).max(axis=1, keepdims=True)
        return (np.abs(jacobian @ self.directions.T) > CANCELLED * size).any(axis=-1)

    def among(self, parameters: Sequence[ArmParameter]) -> Array | None:
        """Return the (k, k) covariance of k parameters in their units, None where it is not known of each."""
        places = {parameter: i for i, parameter in enumerate(self.parameters)}
        own = [places.get(parameter, -1) for parameter in parameters]
        return None if -1 in own else self.covariance[np.ix_(own, own)]

    def part(self, places: Sequence[int]) -> Certainty:
        """Return what is known of the parameters at some places, in this order."""
        parameters = tuple(self.parameters[i] for i in places)
        directions = None if self.directions is None else self.directions[:, places]
        if directions is not None:
            directions = directions[directions.any(axis=1)]
            directions = directions if len(directions) else None
        return Certainty(parameters, self.covariance[np.ix_(places, places)], self.unexplained, directions, self.misfit)

    def beside(self, other: Certainty) -> Certainty:
        """Return what is known of the parameters of both, as independent; what has no cause is as the other has it."""
        count, more = len(self.parameters), len(other.parameters)
        covariance = np.zeros((count + more,) * 2)
        covariance[:count, :count], covariance[count:, count:] = self.covariance, other.covariance
        padded = [
            np.pad(part.directions, ((0, 0), around))
            for part, around in ((self, (0, more)), (other, (count, 0)))
            if part.directions is not None
        ]
        directions = np.vstack(padded) if padded else None
        unexplained = other.unexplained or self.unexplained
        return Certainty((*self.parameters, *other.parameters), covariance, unexplained, directions, other.misfit)
