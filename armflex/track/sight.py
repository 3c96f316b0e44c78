"""What a reading says of the parameters, at the point where the arm is linearised: a calibration's view of one row."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from armflex.conventions import TWIST_NAMES
from armflex.estimate.block import Block
from armflex.estimate.view import look, untold_shifts
from armflex.laws.effects.remember import derived_directions
from armflex.readings import Position
from armflex.setup import Setup
from armflex.track.estimate import Seen
from armflex.track.reading import Reading, as_row


@dataclass(frozen=True)
class Sight:
    """How readings are seen.

    Attributes:
        setup: Arm and instrument.
        blocks: What is tracked.
        unexplained: A twist without a cause: site, axis and size.
        beside: Standard deviation of the position beside the reading's own [m].
    """

    setup: Setup
    blocks: Sequence[Block]
    unexplained: tuple[str, str, float] | None = None
    beside: float = 0.0

    def __call__(self, reading: Reading) -> Seen:
        """Return a reading in standard deviations.

        Raises:
            InputError: q, the position or a standard deviation is no number of its kind; see `Arm.check_position`.
            UnknownNameError, MissingCovariateError: No such payload; an effect depends on what is not given.
            ConvergenceError, UnstableEquilibriumError: See `find_equilibrium`.
        """
        row = as_row(reading, self.setup.arm)
        derived_directions(self.setup.arm, row, np.arange(1))
        view = look(self.setup, row, np.arange(1))
        columns = np.concatenate([block.columns(view) for block in self.blocks], axis=2)[0]
        noise = np.diag(view.sigma[0] ** 2)
        noise[view.positions, view.positions] += self.beside**2 * np.eye(Position.dimension)
        if self.unexplained is not None:
            site, axis, size = self.unexplained
            along = size * view.to_twist(site)[0, :, TWIST_NAMES.index(axis)]
            noise += np.outer(along, along)
        shifts = untold_shifts(self.setup, row, row.readings)[:, 0]
        noise += shifts.T @ shifts
        factor = np.linalg.cholesky(noise)
        whitened = np.ascontiguousarray(np.linalg.solve(factor, columns))
        return Seen(np.linalg.solve(factor, view.residual[0]), whitened)
