"""The distance of a point on the arm from an anchor: a draw wire, a ball bar, an interferometer's beam."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from armflex.conventions import Array
from armflex.readings.kind import Kind, point_of
from armflex.readings.postures import Postures
from armflex.readings.sensor import ANCHOR, POINT, SCALE, Nuisance

NEAR = 0.02
"""Standard deviation of an anchor or a zero [m] up to which a fit finds it from where it is declared."""

ANYWHERE, FALL = 5.0, 5.0
"""Standard deviation [m] of an anchor that may be anywhere, and how much better one elsewhere must fit to be named."""

ELSEWHERE, BEYOND = 0.05, 3.0
"""How far from where it is declared [m], and in its standard deviations, an anchor must be to be somewhere else."""

COARSE = 1e-3
"""Standard deviation of a length [m] while nothing else is fitted yet."""


@dataclass(frozen=True, eq=False)
class Distance(Kind):
    """(N, 1) lengths [m]: from the anchor, in the base or on another link, to the point; the zero added."""

    dimension = 1
    unit, quantity = "m", "length"
    channels = ("",)
    nuisances = (ANCHOR, Nuisance("length_offset", ("",), "m"), POINT, SCALE)

    def _ends(self, at: Postures) -> tuple[Array, Array, Array, Array, Array | None]:
        """Return lengths (N,) [m], directions (N, 3) from anchor to point, (N, 3, 6) changes of both ends with their
        links' motions, that of the anchor None in the base.
        """
        sensor = at.sensors[self.name]
        there, moved = point_of(at, sensor.link, at.of(self.name, "point"))
        here, carried = at.of(self.name, "anchor"), None
        if sensor.seen_from is not None:
            here, carried = point_of(at, sensor.seen_from, here)
        length = np.maximum(np.linalg.norm(there - here, axis=1), 1e-12)
        return length, (there - here) / length[:, None], there, moved, carried

    def predicted(self, at: Postures) -> Array:
        length = self._ends(at)[0][:, None]
        return (1.0 + at.of(self.name, "scale")) * length + at.of(self.name, "length_offset")

    def jacobian(self, at: Postures) -> Mapping[str | None, Array]:
        """Return (N, 1, 6): what moves along the wire lengthens it."""
        sensor, (_, towards, _, moved, carried) = at.sensors[self.name], self._ends(at)
        towards = ((1.0 + at.of(self.name, "scale")) * towards)[:, None]
        found: dict[str | None, Array] = {sensor.link: towards @ moved}
        if carried is not None:
            found[sensor.seen_from] = found.get(sensor.seen_from, 0.0) - towards @ carried
        return found

    def by_own(self, at: Postures) -> Array:
        sensor, (length, towards, _, _, _) = at.sensors[self.name], self._ends(at)
        along = ((1.0 + at.of(self.name, "scale")) * towards)[:, None]
        anchor = along if sensor.seen_from is None else along @ at.pose(sensor.seen_from)[:, :3, :3]
        point, one = along @ at.pose(sensor.link)[:, :3, :3], np.ones((len(length), 1, 1))
        return np.concatenate([-anchor, one, point, length[:, None, None]], axis=2)

    def start(self, at: Postures) -> Array:
        """Return anchor and zero as the lengths have them, lost ones counting less; see `Kind.start`.

        Circles about points of one plane meet on both sides of it: the search begins at the declared anchor, and at
        its image in the plane that fits the points best, and the better end is taken, by readings and prior together.
        """
        sensor = at.sensors[self.name]
        free = np.flatnonzero(sensor.std[:4])
        read = np.flatnonzero(np.isfinite(self.sigma[:, 0]))
        found = np.zeros(len(sensor.std))
        if len(read) <= len(free) or sensor.std[:4].max(initial=0.0) < NEAR:
            return found
        from scipy.optimize import least_squares  # not needed to import the package

        own, here = self.some(read), at.some(read)
        there = point_of(here, sensor.link, here.of(self.name, "point"))[0]
        if sensor.seen_from is not None:  # as the anchor's link sees the points
            frame = here.pose(sensor.seen_from)
            there = np.einsum("nij,ni->nj", frame[:, :3, :3], there - frame[:, :3, 3])
        declared, size = sensor.declared[:4], np.maximum(own.sigma[:, 0], COARSE)

        def errors(step: Array) -> Array:
            values = declared.copy()
            values[free] += step
            length = np.linalg.norm(there - values[:3], axis=1) + values[3]
            return np.concatenate([(own.values[:, 0] - length) / size, step / sensor.std[free]])

        def slopes(step: Array) -> Array:
            off = there - declared[:3] - np.bincount(free, step, 4)[:3]
            towards = off / np.maximum(np.linalg.norm(off, axis=1), 1e-12)[:, None]
            by_value = np.column_stack([towards, np.full(len(off), -1.0)])[:, free] / size[:, None]
            return np.concatenate([by_value, np.diag(1.0 / sensor.std[free])])

        begun, middle = [declared[:3]], there.mean(axis=0)
        normal = np.linalg.svd(there - middle, full_matrices=False)[2][-1]
        begun.append(declared[:3] - 2.0 * ((declared[:3] - middle) @ normal) * normal)
        ends = []
        for anchor in begun:
            step = (np.append(anchor, declared[3]) - declared)[free]
            # A fit goes on from it. SciPy infers the type of `jac` from its default, a word.
            ends.append(least_squares(errors, step, slopes, loss="soft_l1", ftol=1e-5))  # pyright: ignore[reportArgumentType]
        found[free] = min(ends, key=lambda end: end.cost).x
        return found

    def elsewhere(self, at: Postures) -> str | None:
        sensor = at.sensors[self.name]
        # Wherever the anchor may be, its zero as declared.
        free = np.concatenate([np.full(3, ANYWHERE), sensor.std[3:]])
        found = self.start(replace(at, sensors={self.name: replace(sensor, std=free)}))
        there = replace(at, sensors={self.name: replace(sensor, found={"": found})})
        off, left = (float(np.median(np.abs(self.residual(one)))) for one in (at, there))
        away = np.linalg.norm(found[:3])
        if FALL * left < off and away > max(ELSEWHERE, BEYOND * float(np.linalg.norm(sensor.std[:3]))):
            place = ", ".join(f"{value:.3g}" for value in sensor.declared[:3] + found[:3])
            where = f"[{place}], {away:.2g} m from the declared one"
            return f"the lengths fit {off / left:.0f} times better from an anchor at {where}"
        return None
