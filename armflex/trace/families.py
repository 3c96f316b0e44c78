"""Which kinds of effect a calibrated arm lacks: every kind at every drive at once, each with one size by the evidence.

A real machine is a little of everything at every drive. A family is one kind of it: its columns are what its laws do at
all drives, and all its amplitudes have one standard deviation, which is zero where the evidence has none for it
(`estimate.variance_components`). A smooth curve over a drive's position is a Gaussian process with a Matern 3/2 kernel:
sines over the recorded range and one length beyond it, each as variable as the kernel's spectrum says (Solin and Sarkka
2020, Statistics and Computing 30, 419-446), with several lengths, of which each has a size.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from armflex.conventions import TWIST_NAMES, Array
from armflex.estimate.fit import Fit
from armflex.estimate.held_out import errors_of, pose_folds
from armflex.estimate.variance_components import Components, MixedModel
from armflex.laws.effects.context import Context
from armflex.laws.effects.location import BASE, drive_axis
from armflex.laws.effects.shapes import ROUNDING
from armflex.linear_gaussian import LinearGaussian
from armflex.parameters import DOUBT
from armflex.robot.urdf import Joint
from armflex.rows.rows import APPROACH
from armflex.trace.projection import Projection, project
from armflex.trace.selection import MOST_TRIED


@dataclass(frozen=True, eq=False)
class Part:
    """What a family does at one place along one axis.

    Attributes:
        family: Which.
        site, axis: Where.
        shapes: (M, d, k) changes of the readings per amplitude.
        variances: (L, k) of its amplitudes, one row for each length that a curve has.
    """

    family: str
    site: str
    axis: str
    shapes: Array
    variances: Array


@dataclass(frozen=True)
class FamilyPlace:
    """How much a family does at one place.

    Attributes:
        site, axis: Where.
        rms: RMS over the rows of what it does to what is read foremost, in its unit.
    """

    site: str
    axis: str
    rms: float


@dataclass(frozen=True)
class FamilyFound:
    """A kind of effect that the evidence has.

    Attributes:
        name: Which.
        rms: RMS over the rows of what it does to what is read foremost, in its unit.
        evidence: Nats lost without it, the others as large as they then are.
        held_out_without: RMS of the error on held-out poses with all other families.
        places: What it does where, the most first.
    """

    name: str
    rms: float
    evidence: float
    held_out_without: float
    places: tuple[FamilyPlace, ...]


@dataclass(frozen=True)
class Families:
    """What kinds of effect a calibrated arm lacks.

    Attributes:
        found: Those with evidence, the most first.
        held_out: RMS of the error on held-out poses of the calibrated arm, and with all families, in the unit of what
            is read foremost; every row counts.
        noise: Standard deviation of the readings over that stated, if the rest is nothing else.
    """

    found: tuple[FamilyFound, ...]
    held_out: tuple[float, float]
    noise: float


def families_of(fit: Fit, context: Context, poses: np.ndarray) -> Families:
    """Return the kinds of effect that a calibrated arm lacks.

    Args:
        fit: The calibrated arm.
        context: The campaign as effects see it at that fit.
        poses: (M,) number of the pose of every fitted row.

    Raises:
        ConvergenceError: What families do is not finite.
    """
    parts = [part for part in _parts(fit, context, len(np.unique(poses))) if part.shapes.any()]
    return _Problem(fit, parts, pose_folds(poses)).families


class _Problem:
    """The linear problem of a fit with the columns of all families."""

    def __init__(self, fit: Fit, parts: Sequence[Part], folds: np.ndarray) -> None:
        self.fit, self.parts, self.folds = fit, parts, folds
        scale = fit.scale[:, :, None]
        none = np.empty((fit.view.residual.size, 0))
        self.columns = np.hstack([none, *((part.shapes * scale).reshape(len(none), -1) for part in parts)])
        ends = np.cumsum([0, *(part.shapes.shape[2] for part in parts)]).tolist()
        self.slices = [slice(first, last) for first, last in pairwise(ends)]
        # A component for each length of each family, over all its places.
        names = [(part.family, length) for part in parts for length in range(len(part.variances))]
        self.components = list(dict.fromkeys(names))
        variances = np.zeros((len(self.components), ends[-1]))
        for part, place in zip(parts, self.slices, strict=True):
            for length, spectrum in enumerate(part.variances):
                variances[self.components.index((part.family, length)), place] = spectrum
        self.projection = projection = _with_constants(fit)
        gram = self.columns.T @ projection.left_of(self.columns)
        score = self.columns.T @ projection.residual
        self.model = MixedModel(0.5 * (gram + gram.T), score, projection.objective, projection.freedom, variances)

    @cached_property
    def fitted(self) -> Components:
        """All families with the sizes that the evidence gives them."""
        return self.model.fitted()

    @property
    def families(self) -> Families:
        """What the evidence has."""
        found, names = list[FamilyFound](), list(dict.fromkeys(name for name, _ in self.components))
        amplitudes, least = self.fitted.amplitudes, -np.log(DOUBT)
        for name in names:
            own = [i for i, (family, _) in enumerate(self.components) if family == name]
            if not self.fitted.ratios[own].any() or self.fitted.lost_without(*own) < least:
                continue
            without = self.model.fitted(self.fitted.without(*own).ratios, MOST_TRIED)  # the others may take its place
            evidence = self.fitted.log_likelihood - without.log_likelihood
            if evidence < least:
                continue
            places = dict[tuple[str, str], Array]()
            for part, place in zip(self.parts, self.slices, strict=True):
                if part.family == name:
                    done = self.columns[:, place] @ amplitudes[place]
                    places[part.site, part.axis] = places.get((part.site, part.axis), 0.0) + done
            left = {place: self.projection.left_of(done) for place, done in places.items()}  # by what is fitted anyway
            sizes = [FamilyPlace(*place, self.rms(done)) for place, done in left.items()]
            sizes = tuple(sorted((size for size in sizes if size.rms > 0.0), key=lambda size: -size.rms))
            rms = self.rms(np.sum(list(left.values()), axis=0))
            found.append(FamilyFound(name, rms, evidence, self.held_out(without), sizes))
        found.sort(key=lambda family: -family.evidence)
        none = self.model.at(np.zeros(len(self.components)))
        return Families(tuple(found), (self.held_out(none), self.held_out(self.fitted)), self.fitted.noise)

    def rms(self, whitened: Array) -> float:
        """Return the RMS of what (n,) whitened errors are of what is read foremost, in its unit."""
        errors = np.zeros(self.fit.view.residual.shape)
        errors[:, self.fit.view.foremost] = errors_of(self.fit, whitened)
        return self.fit.view.rms(errors)

    def held_out(self, sizes: Components) -> float:
        """Return the RMS of the error of every row, predicted from the other folds with these sizes."""
        depth = self.fit.view.residual.shape[1]
        some = sizes.columns
        columns = np.hstack([self.projection.regressors, self.columns[:, some] * sizes.spread[some]])
        precision = np.concatenate([self.projection.precision, np.ones(len(some))])  # by the noise's variance
        data = self.projection.data
        gram, score = columns.T @ columns, columns.T @ data
        left = np.empty(len(data))
        for number in np.unique(self.folds):
            own = np.repeat(self.folds == number, depth)
            held = LinearGaussian(gram - columns[own].T @ columns[own] + np.diag(precision))
            left[own] = data[own] - columns[own] @ held.solve(score - columns[own].T @ data[own])
        return self.rms(left)


def _with_constants(fit: Fit) -> Projection:
    """Return the projection of a fit that also takes over any constant twist of any joint.

    Where links and zeros truly are is no family: what calibration was not allowed to move is not to be mistaken for it.
    """
    view, declared = fit.view, project(fit)
    twists = np.concatenate([view.to_twist(joint.name) for joint in view.arm.robot.moving], axis=2)
    moved = np.array([view.rms(twist) for twist in twists.transpose(2, 0, 1)]) / view.per_metre
    twists, moved = twists[:, :, moved > 0.0], moved[moved > 0.0]
    columns = (twists * fit.scale[:, :, None]).reshape(view.residual.size, -1)
    return replace(
        declared,
        regressors=np.hstack([declared.regressors, columns]),
        precision=np.concatenate([declared.precision, (moved / view.largest_motion) ** 2]),
    )


def _parts(fit: Fit, context: Context, poses: int) -> Iterator[Part]:
    """Yield what every family does at every place of a campaign with so many poses."""
    view, turning = fit.view, range(3, 6)
    # Lengths over which a drive's errors may change [rad], of sliding drives by how far they were driven; about other
    # axes the longer half, since bearings and links are smoother than gears.
    lengths = np.array([0.05, 0.15, 0.5, 1.5])
    positions = {joint.name: context.row.position(joint.name)[view.rows] for joint in context.robot.moving}
    driven = {name: values for name, values in positions.items() if np.ptp(values) > 0.0}
    along = {name: (values - values.mean()) / np.ptp(values) for name, values in driven.items()}
    recorded = {name: context.column(name)[view.rows] for name in context.recorded if name != "time"}
    recorded = {name: (x - x.mean()) / np.ptp(x) for name, x in recorded.items() if np.ptp(x) > 0.0}
    slides = [joint.name for joint in context.robot.moving if TWIST_NAMES.index(drive_axis(joint)) not in turning]
    for joint in context.robot.moving:
        twist, drive = view.to_twist(joint.name), TWIST_NAMES.index(drive_axis(joint))

        def part(family: str, axis: int, *factors: Array, variances: Array | None = None, joint: Joint = joint,
                 twist: Array = twist) -> Part:  # fmt: skip
            shapes = twist[:, :, [axis]] * np.column_stack(factors)[:, None, :]
            return Part(family, joint.name, TWIST_NAMES[axis], shapes,
                        np.ones((1, shapes.shape[2])) if variances is None else variances)  # fmt: skip

        if joint.name in driven:
            values = driven[joint.name]
            unit = 1.0 if drive in turning else float(np.ptp(values))
            shapes, spectra = _curve(values, unit * lengths, max(poses // 4, 4))
            yield part("curve of the drives", drive, shapes, variances=spectra)
            yield part("scale of the encoders", drive, values - values.mean())
            if drive in turning:
                yield part("eccentricity of the encoders", drive, np.sin(values), np.cos(values))
            shapes, spectra = _curve(values, unit * lengths[2:], max(poses // 8, 4))
            for axis in turning:
                if axis != drive:
                    yield part("curve about other axes", axis, shapes, variances=spectra)
        if f"{APPROACH}{joint.name}" in context.row.covariates:
            yield part("play by approach", drive, context.column(f"{APPROACH}{joint.name}")[view.rows])
        for name, share in recorded.items():
            for axis in range(6):
                yield part(f"by {name}", axis, share)
        load = view.load_at(joint.name)
        places = [along[name] for name in dict.fromkeys((joint.name, *slides)) if name in along]
        for axis in turning:
            moment = load[:, axis]
            largest = np.abs(moment).max()
            yield part("compliance", axis, load[:, 3:])
            if not largest > ROUNDING * np.abs(load).max():
                continue
            side = np.tanh(10.0 * moment / largest)  # a tenth of the load takes play to the other side
            yield part("play by load", axis, side)
            for name, share in recorded.items():
                yield part(f"compliance by {name}", axis, moment * share)
            if places:
                powers = [place**power for place in places for power in (1, 2)]
                yield part("compliance by position", axis, *(moment * power for power in powers))
                yield part("play by load and position", axis, *(side * place for place in places))
    twist, load = view.to_twist(BASE), view.load_at(BASE)
    for axis in turning:
        shapes = twist[:, :, [axis]] * load[:, None, 3:]
        yield Part("compliance", BASE, TWIST_NAMES[axis], shapes, np.ones((1, 3)))
    for name, share in recorded.items():
        for axis in range(6):
            shapes = twist[:, :, [axis]] * share[:, None, None]
            yield Part(f"by {name}", BASE, TWIST_NAMES[axis], shapes, np.ones((1, 1)))
    yield from _wandering(fit, context)


def _curve(values: Array, lengths: Array, most: int) -> tuple[Array, Array]:
    """Return (M, k) sines over (M,) positions, and the (L, k) variances that curves of (L,) lengths give them.

    The finest of them has three radians within the shortest length; there are so many at most.
    """
    middle, half = 0.5 * (values.min() + values.max()), 0.5 * np.ptp(values) + lengths.max()
    count = int(np.clip(2.0 * half * 3.0 / lengths.min() / np.pi, 1, most))
    waves = np.pi * np.arange(1, count + 1) / (2.0 * half)
    shapes = np.sin(waves * (values[:, None] - middle + half)) / np.sqrt(half)
    rates = np.sqrt(3.0) / lengths[:, None]
    return shapes, 4.0 * rates**3 / (rates**2 + waves**2) ** 2


def _wandering(fit: Fit, context: Context) -> Iterator[Part]:
    """Yield random walks in time: of the instrument's frame, anew in every session, and of every drive."""
    view = fit.view
    time = context.column("time")[view.rows] if context.timed else np.arange(len(view.rows), dtype=float)
    count = 32  # terms of Karhunen and Loeve: finer ones are noise
    rates = np.pi * (np.arange(1, count + 1) - 0.5)

    def walk(rows: np.ndarray) -> Array:
        share = (time - time[rows].min()) / (np.ptp(time[rows]) or 1.0)
        return np.sqrt(2.0) * np.sin(rates * share[:, None]) / rates * rows[:, None]

    sessions, every = np.array(view.sessions), np.ones(len(view.rows), dtype=bool)
    spans = {walked.tobytes(): walked for name in dict.fromkeys(view.sessions) if (walked := sessions == name).any()}
    for rows in (spans | {every.tobytes(): every}).values():
        for axis in range(3):
            shapes = view.by_frame[:, :, [axis]] * walk(rows)[:, None, :]
            yield Part("wandering of the instrument", BASE, TWIST_NAMES[axis], shapes, np.ones((1, count)))
    for joint in context.robot.moving:
        drive = drive_axis(joint)
        shapes = view.to_twist(joint.name)[:, :, [TWIST_NAMES.index(drive)]] * walk(every)[:, None, :]
        yield Part("wandering of the drives", joint.name, drive, shapes, np.ones((1, count)))
