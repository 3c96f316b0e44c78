"""A natural frequency, as a ring-down or a hammer blow at a standing pose shows it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from armflex.conventions import Array
from armflex.declaration import Declaration
from armflex.errors import InputError, naming
from armflex.readings.kind import Kind
from armflex.readings.postures import Postures
from armflex.robot import Robot


@dataclass(frozen=True)
class Swing:
    """Which mode an instrument reads; rows may name another.

    Attributes:
        mode: Its number, 1 is the slowest; None where it is not declared.
        axis: (3,) direction in the tip frame along which the mode moves the tip most; None where it is not declared.
    """

    mode: int | None = None
    axis: Array | None = None


@dataclass(frozen=True, eq=False)
class Frequency(Kind):
    """(N, 1) natural frequency of one mode [Hz].

    The mode is that which the row names, else that which the instrument names, else that which moves the tip most along
    the instrument's axis after a blow along it, else that with the nearest frequency.

    Attributes:
        mode: (N,) number of the mode, 1 is the slowest; 0 where the row does not name one, None where none does.
    """

    mode: Array | None = None

    dimension = 1
    unit, quantity = "Hz", "frequency"
    channels = ("",)
    beside = ("mode",)
    by_motion = False
    positive = True

    @classmethod
    def declared(cls, table: Declaration, robot: Robot) -> dict[str, Any]:
        """Return the tip, and which mode is meant."""
        number, axis = None, None
        if table.has("mode"):
            value = table.number("mode")
            number = int(value)
            if number != value or number < 1:
                raise table.fail("mode", f"expected the number of a mode, 1 is the slowest, got {value:g}")
        if table.has("axis"):
            axis = table.numbers("axis", (3,))
            if not np.linalg.norm(axis) > 0.0:
                raise table.fail("axis", "expected a direction in the tip frame, got zeros")
            axis = axis / np.linalg.norm(axis)
        return {"link": robot.tip, "about": Swing(number, axis)}

    def some(self, rows: np.ndarray) -> Frequency:
        return replace(super().some(rows), mode=None if self.mode is None else self.mode[rows])

    def ideal(self, at: Postures) -> Array:
        matched = np.zeros(self.values.shape)
        for row in np.flatnonzero(np.isfinite(self.sigma[:, 0])).tolist():
            with naming(at.place(row)):
                matched[row] = self._matched(at, row)
        return matched

    def _matched(self, at: Postures, row: int) -> float:
        """Return the frequency of the mode that a row reads [Hz]; raise where the arm has no such mode."""
        about, (frequencies, shapes) = at.about(self.name, Swing), at.swing(row)
        read, number = float(self.values[row, 0]), 0 if self.mode is None else int(self.mode[row])
        number = number or about.mode or 0
        modes_listed = ", ".join(f"{frequency:.4g}" for frequency in frequencies)
        if number:
            if number > len(frequencies):
                has = f"the arm has {len(frequencies)}: {modes_listed} Hz"
                raise InputError(f"{self.name}: there is no mode {number}; {has}")
            return float(frequencies[number - 1])
        if about.axis is not None:
            along = np.abs(shapes[:, :3] @ at.pose(None)[row, :3, :3] @ about.axis)
            if not along.max() > 0.0:
                raise InputError(f"{self.name}: none of the modes ({modes_listed} Hz) moves the tip along its axis")
            return float(frequencies[int(along.argmax())])
        if not read:
            return float(frequencies[0])  # still to be taken: what rings longest
        away = np.abs(np.log(frequencies / read))
        # Logarithm of the ratio up to which a frequency is matched to the nearest mode where nothing names the mode
        if away.min() > 0.3:
            text = f"{self.name} reads {read:.4g} Hz, and no mode is near: the arm has {modes_listed} Hz"
            raise InputError(f"{text}; name the mode in a column {self.name}_mode, or `axis` of the instrument")
        return float(frequencies[int(away.argmin())])
