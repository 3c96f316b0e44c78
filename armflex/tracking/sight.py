"""What a reading says of the parameters, at the point where the arm is linearised.

The quick way asks the solver of `Arm.prepared` and Pinocchio once each; the careful one is a calibration's own view of
a campaign of one row. Residuals agree to some 1e-8 m and columns to some thousandths (see `quick`), which changes an
estimate by as little of its standard deviation. The careful way is gone where an arm has effects, a law that is not
proportional to the load, a reading has an orientation, or what is tracked has no quick columns (geometry).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from armflex.calibrate.arm_blocks import ComplianceBlock, OffsetBlock
from armflex.calibrate.blocks import Block
from armflex.calibrate.instrument_blocks import FrameBlock, MountingBlock, TargetBlock
from armflex.calibrate.law_block import LawBlock
from armflex.calibrate.view import Setup, look, untold_shifts
from armflex.conventions import TWIST_NAMES
from armflex.effects.remember import derived_directions
from armflex.readings import Position
from armflex.statics.linearise import Linearizer
from armflex.tracking.estimate import Seen
from armflex.tracking.quick import Quick, middle_of
from armflex.tracking.reading import Reading, as_row

QUICK = FrameBlock | MountingBlock | TargetBlock | OffsetBlock | ComplianceBlock | LawBlock


class Sight:
    """A setup and its blocks, ready to be asked about readings; for one thread."""

    def __init__(
        self, setup: Setup, blocks: Sequence[Block], unexplained: tuple[str, str, float] | None, beside: float
    ) -> None:
        self._setup, self._blocks, self._unexplained = setup, blocks, unexplained
        self._able = unexplained is None and _quick_enough(setup, blocks)
        self._quick: dict[str, Quick] = {}
        self._linearizer, self._beside = Linearizer(setup.arm), beside

    def prepare(self, payload: str) -> None:
        """Make what the quick way needs for a payload, and compile it where nobody on this machine did before."""
        if self._able and payload not in self._quick:
            self._quick[payload] = Quick(self._setup, self._blocks, payload, self._beside)

    def __call__(self, reading: Reading) -> Seen:
        """Return a reading in standard deviations.

        Raises:
            InputError: q, the position or a standard deviation is no number of its kind; see `Arm.check_position`.
            UnknownNameError, MissingCovariateError: No such payload; an effect depends on what is not given.
            ConvergenceError, UnstableEquilibriumError: See `find_equilibrium`.
        """
        if self._able and reading.rotation is None:
            self.prepare(reading.payload)
            found = self._quick[reading.payload](reading)
            if found is not None:
                return found
        return carefully(self._setup, self._blocks, reading, self._unexplained, self._beside, self._linearizer)


def carefully(
    setup: Setup,
    blocks: Sequence[Block],
    reading: Reading,
    unexplained: tuple[str, str, float] | None = None,
    beside: float = 0.0,
    linearizer: Linearizer | None = None,
) -> Seen:
    """Return a reading as a calibration sees it; a direction that it derives and nothing tells makes it less certain.

    Args:
        setup: Arm and instrument.
        blocks: What is tracked.
        reading: The reading.
        unexplained: A twist without a cause: site, axis and size.
        beside: Standard deviation of the position beside the reading's own [m].
        linearizer: Of the setup's arm, with the models that it has made.
    """
    row = as_row(reading, setup.arm)
    derived_directions(setup.arm, row, np.arange(1))
    view = look(setup, row, np.arange(1), linearizer=linearizer)
    columns = np.concatenate([block.columns(view) for block in blocks], axis=2)[0]
    noise = np.diag(view.sigma[0] ** 2)
    noise[view.positions, view.positions] += beside**2 * np.eye(Position.dimension)
    if unexplained is not None:
        site, axis, size = unexplained
        along = size * view.to_twist(site)[0, :, TWIST_NAMES.index(axis)]
        noise += np.outer(along, along)
    shifts = untold_shifts(setup, row, row.readings)[:, 0]
    noise += shifts.T @ shifts
    factor = np.linalg.cholesky(noise)
    whitened = np.ascontiguousarray(np.linalg.solve(factor, columns))
    return Seen(np.linalg.solve(factor, view.residual[0]), whitened)


def _quick_enough(setup: Setup, blocks: Sequence[Block]) -> bool:
    arm = setup.arm
    if arm.effects or arm.pulls or not all(isinstance(block, QUICK) for block in blocks):
        return False
    if any(isinstance(block, FrameBlock) and block.level for block in blocks):
        return False
    row = middle_of(arm)
    return all(law.affine(row) is not None for law in arm.stack.laws)
