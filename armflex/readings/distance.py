"""The distance of a point on the arm from an anchor: a draw wire, a ball bar, an interferometer's beam."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from armflex.conventions import Array
from armflex.declaration import Declaration
from armflex.errors import ArmFileError
from armflex.readings.end import shifted
from armflex.readings.kind import FURTHEST, Ends, Kind, link_in
from armflex.readings.postures import Postures
from armflex.readings.sensor import ANCHOR, POINT, SCALE, Nuisance, zero_of
from armflex.robot import Robot

ANYWHERE, FALL = 5.0, 5.0
"""Standard deviation [m] of an anchor that may be anywhere, and how much better one elsewhere must fit to be named."""

ELSEWHERE, BEYOND = 0.05, 3.0
"""How far from where it is declared [m], and in its standard deviations, an anchor must be to be somewhere else."""

UNKNOWN = ", where the wire begins [m]; of one that nobody measured write [0, 0, 0] and anchor_std = 2.0"
"""What is said where the anchor is left out: it is found from as far away as its standard deviation says."""


@dataclass(frozen=True, eq=False)
class Distance(Kind):
    """(N, 1) lengths [m]: from the anchor, in the base or on another link, to the point; the zero added."""

    dimension = 1
    unit, quantity = "m", "length"
    channels = ("",)
    nuisances = (ANCHOR, zero_of(("",), "m", "length_offset"), POINT, SCALE)

    @classmethod
    def declared(cls, table: Declaration, robot: Robot) -> dict[str, Any]:
        """Return the link, and that which the anchor is on."""
        link = link_in(table, "link", robot)
        other = link_in(table, "anchor_link", robot, link) if table.has("anchor_link") else None
        return {"link": link, "seen_from": other}

    @classmethod
    def stated(cls, nuisance: Nuisance, table: Declaration, robot: Robot) -> tuple[Array, float]:
        """Return what is declared; an anchor has to be, and not beyond all reach."""
        if nuisance is ANCHOR:
            try:
                away = float(np.linalg.norm(table.numbers("anchor", (3,))))
            except ArmFileError as error:
                raise error if table.has("anchor") else ArmFileError(error.place, f"{error.problem}{UNKNOWN}") from None
            if away > robot.reach + FURTHEST:
                text = f"is {away:.3g} m from the base, and the arm reaches {robot.reach:.3g} m"
                raise table.fail("anchor", f"{text}: millimetres?")
        return super().stated(nuisance, table, robot)

    def ideal(self, at: Postures) -> Array:
        return at.line(self.name)[2][:, None]

    def ends(self, at: Postures) -> Ends:
        """Return point and anchor: what moves along the wire lengthens it."""
        end, eye, _, towards = at.line(self.name)
        return {"end": (end, shifted(towards[:, None])), "eye": (eye, shifted(-towards[:, None]))}

    def start(self, at: Postures) -> Array:
        """Return anchor and zero as the lengths have them, lost ones counting less; see `Kind.start`.

        Circles about points of one plane meet on both sides of it: the search begins at the declared anchor, and at
        its image in the plane that fits the points best, and the better end is taken, by readings and prior together.
        """
        sensor = at.sensors[self.name]
        free = np.flatnonzero(sensor.std[:4])
        read = np.flatnonzero(np.isfinite(self.sigma[:, 0]))
        deviation = np.zeros(len(sensor.std))
        # Standard deviation of an anchor or a zero [m] up to which a fit finds it from where it is declared
        if len(read) <= len(free) or sensor.std[:4].max(initial=0.0) < 0.02:
            return deviation
        from scipy.optimize import least_squares  # not needed to import the package

        reading, here = self.some(read), at.some(read)
        size = np.maximum(reading.sigma, 1e-3)  # standard deviation of a length [m] while nothing else is fitted yet

        def where(step: Array) -> Postures:
            values = np.zeros(len(sensor.std))
            values[free] = step
            return replace(here, sensors={self.name: replace(sensor, found={"": values})})

        def errors(step: Array) -> Array:
            off = (reading.values - reading.predicted(where(step))) / size
            return np.append(off, step / sensor.std[free])

        def slopes(step: Array) -> Array:
            return np.vstack([-reading.by_own(where(step))[:, 0, free] / size, np.diag(1.0 / sensor.std[free])])

        frame = here.end(self.name, "eye").pose  # as the anchor's link sees the points
        points = np.einsum("nij,ni->nj", frame[:, :3, :3], here.end(self.name).place - frame[:, :3, 3])
        middle = points.mean(axis=0)
        normal = np.linalg.svd(points - middle, full_matrices=False)[2][-1]
        image = -2.0 * ((sensor.declared[:3] - middle) @ normal) * normal
        ends = []
        for step in (np.zeros(4), np.append(image, 0.0)):
            # A fit goes on from it. SciPy infers the type of `jac` from its default, a word.
            ends.append(least_squares(errors, step[free], slopes, loss="soft_l1", ftol=1e-5))  # pyright: ignore[reportArgumentType]
        deviation[free] = min(ends, key=lambda end: end.cost).x
        return deviation

    def elsewhere(self, at: Postures) -> str | None:
        sensor = at.sensors[self.name]
        # Wherever the anchor may be, its zero as declared.
        free = np.concatenate([np.full(3, ANYWHERE), sensor.std[3:]])
        deviation = self.start(replace(at, sensors={self.name: replace(sensor, std=free)}))
        there = replace(at, sensors={self.name: replace(sensor, found={"": deviation})})
        off, left = (float(np.median(np.abs(self.residual(postures)))) for postures in (at, there))
        away = np.linalg.norm(deviation[:3])
        if FALL * left < off and away > max(ELSEWHERE, BEYOND * float(np.linalg.norm(sensor.std[:3]))):
            place = ", ".join(f"{value:.3g}" for value in sensor.declared[:3] + deviation[:3])
            where = f"[{place}], {away:.2g} m from the declared one"
            return f"the lengths fit {off / left:.0f} times better from an anchor at {where}"
        return None
