"""Whether readings are those of this arm, and enough to place the instrument: the one thing without a prior."""

from __future__ import annotations

import numpy as np

from armflex.arm import Arm
from armflex.conventions import TWIST_NAMES, Array
from armflex.errors import IdentifiabilityError
from armflex.measured.axes import check_axes
from armflex.measured.measurements import Measurements
from armflex.readings.instrument import Instrument, fit_frame
from armflex.readings.kind import rigid_motion

COARSEST = 0.05
"""Standard uncertainty of the instrument's orientation [rad] beyond which the data do not determine it."""


def check_readings(arm: Arm, points: Array, measurements: Measurements, rows: np.ndarray) -> None:
    """Raise where readings cannot be those of an arm, or cannot tell where the instrument stands.

    Args:
        arm: The arm as declared.
        points: (M, 3) its nominal target in the base frame [m] at each of the rows.
        measurements: The campaign.
        rows: (M,) numbers of the rows used.

    Raises:
        AxesError: Axes of the measured positions are swapped or reversed.
        UnitError: All positions are in another unit.
        IdentifiabilityError: The instrument's frame is unknown, and poses are alike or on one line.
    """
    unknown = arm.measurement.frame != "base"
    pose = None if unknown else (arm.instrument or Instrument()).pose
    places = [measurements.places[row] for row in rows] if measurements.places else ()
    up = -arm.robot.gravity if np.any(arm.robot.gravity) else None
    check_axes(points, measurements.position[rows], places, pose, up)
    if unknown:
        frame = fit_frame(points, measurements.position[rows])
        seen = points @ frame.rotation.T + frame.translation
        check_enough(seen, measurements.sigma[rows])


def check_enough(points: Array, sigma: Array) -> None:
    """Raise where poses all alike, or on one line, leave the instrument's orientation open.

    Everything else that a calibration frees has a prior; what data say nothing about stays there and is named.
    Orientations that were read do not count: how the target is turned on the tool is not known either.

    Args:
        points: (N, 3) nominal target in instrument axes [m].
        sigma: (N, 3) standard deviations of the readings [m].

    Raises:
        IdentifiabilityError: With rank, condition and names of what is left free.
    """
    jacobian = rigid_motion(points - points.mean(axis=0)) / sigma[:, :, None]
    # About their centre points always tell a shift; a turn must be known to better than COARSEST.
    turns = np.linalg.svd(COARSEST * jacobian.reshape(-1, 6)[:, 3:], full_matrices=False)
    known = turns.S >= 1.0
    if not known.all():
        free = (turns.Vh[~known] ** 2).sum(axis=0) > 0.1
        names = [f"instrument {TWIST_NAMES[3 + axis]}" for axis in np.flatnonzero(free)]
        alike = "are all alike" if not known.any() else "lie on one line"
        condition = float(np.linalg.cond(jacobian.reshape(-1, 6)))
        text = f"{len(points)} measured points {alike}: they cannot tell how the instrument stands"
        raise IdentifiabilityError(text, 3 + int(known.sum()), condition, names)
