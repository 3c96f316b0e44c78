"""One reading of the tip, as a controller has it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from numbers import Real

import numpy as np
from numpy.typing import ArrayLike

from armflex.arguments import checked_kinds
from armflex.arm import Arm
from armflex.conventions import Array, finite_array, real_array
from armflex.errors import InputError, UnknownNameError
from armflex.measured.measurements import Measurements
from armflex.readings import Kind, Orientation, Position, Readings
from armflex.rows import Rows
from armflex.rows.rows import APPROACH
from armflex.rows.wrench import Wrench, check_rows, wrenches_in


@dataclass(frozen=True, eq=False)
class Reading:
    """Where the tip's target was seen, or what other instruments read, with the arm standing still.

    Attributes:
        q: (nq,) the controller's joint positions [rad or m].
        position: (3,) of the target [m], in the frame that the arm was calibrated in: the instrument's, or the base's
            where `[measurement]` says so; None where none was read.
        sigma: Its standard deviation, one number or (3,) [m].
        payload: Name of what was carried.
        session: The instrument's setup; with another name its frame is uncertain anew.
        time: [s], where drift is by time; None where it is by readings.
        rotation: (3,) rotation vector of the target [rad], None where none was read.
        sigma_r: Its standard deviation [rad].
        covariates: What the arm's effects depend on, by name.
        sensors: What other instruments of the arm read, by name: (d,) numbers, or one, in their SI unit.
        wrenches: Known loads from outside, each the same in all rows [N, Nm].
    """

    q: ArrayLike
    position: ArrayLike | None = None
    sigma: float | ArrayLike = 1.0
    payload: str = "none"
    session: str = "session"
    time: float | None = None
    rotation: ArrayLike | None = None
    sigma_r: float | None = None
    covariates: Mapping[str, float] = field(default_factory=dict)
    sensors: Mapping[str, ArrayLike] = field(default_factory=dict)
    wrenches: Sequence[Wrench] = ()

    @property
    def size(self) -> int:
        """How many numbers were read."""
        kinds = [*([] if self.position is None else [Position]), *([] if self.rotation is None else [Orientation])]
        return sum(kind.dimension for kind in kinds) + sum(np.size(values) for values in self.sensors.values())

    @classmethod
    @checked_kinds
    def of(cls, measurements: Measurements, row: int, timed: bool = False) -> Reading:
        """Return a row of a campaign, with its time if wanted; a direction that no row before says is not given."""
        columns = {name: float(values[row]) for name, values in measurements.known.items()}
        rotation, sigma_r = measurements.rotation, measurements.sigma_r
        if rotation is not None and sigma_r is not None and np.isfinite(sigma_r[row]):
            turned = rotation[row], float(sigma_r[row])
        else:
            turned = None, None
        read = {kind.name: kind for kind in measurements.readings.kinds if np.isfinite(kind.sigma[row]).all()}
        seen = measurements.positioned[row]
        return cls(
            measurements.q[row],
            measurements.position[row] if seen else None,
            measurements.sigma[row] if seen else 1.0,
            measurements.payload[row],
            measurements.session[row],
            float(measurements.time[row]) if timed else None,
            *turned,
            {name: value for name, value in columns.items() if value or name not in measurements.derived},
            {name: kind.values[row] for name, kind in read.items() if name},
            wrenches_in(measurements.wrenches, row),
        )


SIGMA = 1e-9, 10.0
"""Least and greatest standard deviation of a position [m]: outside it is in another unit, or a mistake."""


def number(value: object, name: str) -> float:
    """Return a real number of any kind as a float; raise `InputError` naming it where it is none."""
    if isinstance(value, bool) or not isinstance(value, Real):
        raise InputError(f"{name}: expected a number, got {value!r}")
    return float(value)


def sensible(sigma: float | Array, name: str) -> None:
    """Raise `InputError` where a standard deviation of a position is none."""
    least, most = SIGMA
    if not ((np.asarray(sigma) >= least) & (np.asarray(sigma) <= most)).all():
        raise InputError(f"{name}: expected a standard deviation from {least:g} to {most:g} m, got {sigma}")


def spread_of(reading: Reading) -> float | Array:
    """Return the standard deviation of the position, a number or (3,) [m].

    Raises:
        InputError: It is no sensible one, or the orientation has none.
    """
    if reading.rotation is not None and not 0.0 < number(reading.sigma_r, "sigma_r") < np.inf:
        raise InputError(f"sigma_r: expected a positive number [rad], got {reading.sigma_r!r}")
    if type(reading.sigma) is float and SIGMA[0] <= reading.sigma <= SIGMA[1]:
        return reading.sigma
    sigma = real_array(reading.sigma, "sigma")
    if sigma.shape not in ((), (3,)):
        raise InputError(f"sigma: expected one or three numbers [m], got {reading.sigma!r}")
    sensible(sigma, "sigma")
    return sigma if sigma.ndim else float(sigma)


def as_row(reading: Reading, arm: Arm) -> Measurements:
    """Return a campaign of this reading alone.

    Raises:
        InputError, UnknownNameError, ShapeError: See `spread_of` and `Arm.check_position`; no such instrument, or no
            such link, or a load is for other rows.
    """
    q, sigma = arm.check_position(reading.q)[0], spread_of(reading)
    given = {**reading.covariates, "time": reading.time or 0.0}
    # What the reading does not state and no order of rows stands in for.
    unknown = [name for joint in arm.joint_names if (name := f"{APPROACH}{joint}") not in reading.covariates]
    unknown += ["time"] if reading.time is None else []
    row = Rows.of(arm.joint_names, q[None], (reading.payload,), given, ("pose",), reading.session, tuple(unknown))
    kinds: list[Kind] = []
    if reading.position is not None:
        position = finite_array(reading.position, "position", (Position.dimension,))[None]
        kinds.append(Position(position, np.broadcast_to(sigma, position.shape)))
    elif not reading.sensors:
        raise InputError("neither a position nor what another instrument read: there is no reading")
    if reading.rotation is not None:
        rotation = finite_array(reading.rotation, "rotation", (Orientation.dimension,))[None]
        kinds.append(Orientation(rotation, np.full(rotation.shape, reading.sigma_r, dtype=float)))
    if unknown := [name for name in reading.sensors if name not in arm.sensors]:
        raise UnknownNameError("instrument", unknown[0], arm.sensors)
    for sensor in [sensor for name, sensor in arm.sensors.items() if name in reading.sensors]:
        values, size = np.atleast_1d(reading.sensors[sensor.name]), sensor.unread(1).dimension
        values = finite_array(values, sensor.name, (size,))[None]
        kinds.append(sensor.kind(values, np.full(values.shape, sensor.sigma), sensor.name))
    for wrench in reading.wrenches:
        if not isinstance(wrench, Wrench):
            raise InputError(f"wrenches: expected loads from outside, such as armflex.Wrench, got {wrench!r}")
        if wrench.frame not in arm.link_names:
            raise UnknownNameError("link", wrench.frame, arm.link_names)
    check_rows(reading.wrenches, None)
    return Measurements.of(replace(row, wrenches=tuple(reading.wrenches)), Readings(1, tuple(kinds)))
