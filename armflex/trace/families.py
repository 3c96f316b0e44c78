"""Families: every kind of effect at every drive at once, each with one size by the evidence.

A real machine is a little of everything at every drive. A family is one kind of it: its columns are what its laws do at
all drives, and all its amplitudes have one standard deviation, which is zero where the evidence has none for it
(`estimate.variance_components`). A smooth curve over a drive's position is a Gaussian process with a Matern 3/2 kernel:
sines over the recorded range and one length beyond it, each as variable as the kernel's spectrum says (Solin and Sarkka
2020, Statistics and Computing 30, 419-446), with several lengths, of which each has a size.

Families that are worth their prior probability are the background of names: their amplitudes are in every fit of the
arm, with their sizes as priors, and what a name is worth is worth beside them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.linalg import cholesky, solve, solve_triangular

from armflex.conventions import RESOLUTION, TWIST_NAMES, Array
from armflex.estimate.block import Block, EffectBlock
from armflex.estimate.fit import Fit
from armflex.estimate.held_out import errors_of, pose_folds
from armflex.estimate.pose_block import Walk
from armflex.estimate.robust import EVEN
from armflex.estimate.variance_components import Components, MixedModel
from armflex.laws.effects.backlash import BACKLASH
from armflex.laws.effects.base_compliance import BASE_COMPLIANCE
from armflex.laws.effects.candidate import Candidate
from armflex.laws.effects.compliance import COMPLIANCE
from armflex.laws.effects.context import AXES_TURN, Context
from armflex.laws.effects.cross_coupling import CROSS_COUPLING
from armflex.laws.effects.drive_curve import DRIVE_CURVE, MOST_SINES
from armflex.laws.effects.effect import TwistLaw
from armflex.laws.effects.encoder_eccentricity import ENCODER_ECCENTRICITY
from armflex.laws.effects.encoder_scale import ENCODER_SCALE
from armflex.laws.effects.friction_windup import FRICTION_WINDUP
from armflex.laws.effects.guide import GUIDES
from armflex.laws.effects.hysteresis import HYSTERESIS
from armflex.laws.effects.location import BASE, LINK, Location, drive_axis
from armflex.laws.effects.shapes import PAIRS, ROUNDING
from armflex.laws.effects.unnamed import LINE, LINE_COMPLIANCE, LINE_PLAY
from armflex.laws.effects.wandering import BASE_WANDERING, DRIVE_WANDERING, WALK_TERMS, walk_at, walk_terms
from armflex.linear_gaussian import squared
from armflex.mechanics.loop_rows import rigid_tips
from armflex.parameters import DOUBT
from armflex.robot.urdf import Joint
from armflex.rows.rows import APPROACH, TIME, Rows
from armflex.trace.bank import Bank
from armflex.trace.hypotheses import EFFECTS, FAMILIAL
from armflex.trace.projection import LEAST_INFORMED, LEAST_SCATTER, Projection
from armflex.trace.selection import MOST_TRIED, SCALES, WITHIN


@dataclass(frozen=True, eq=False)
class Member:
    """What a family does at one place along one axis.

    Attributes:
        family: Which.
        acts: A law there, or a walk in time.
        variances: (L, k) of its amplitudes, one row for each length that a curve has.
    """

    family: str
    acts: Candidate | Walk
    variances: Array

    @property
    def place(self) -> tuple[str, str]:
        """Site and axis."""
        where = self.acts if isinstance(self.acts, Walk) else self.acts.location
        return where.site, str(where.axis)

    def block(self, std: Array, context: Context, rows: Rows, fitted: np.ndarray) -> EffectBlock | Walk | None:
        """Return it as a block of a fit to (M,) rows of a campaign, with (k,) standard deviations; 0 of what is left
        out.
        """
        some = np.flatnonzero(std)
        if not len(some):
            return None
        if isinstance(self.acts, Walk):
            return replace(self.acts, std=std[some], waves=self.acts.waves[:, some])
        terms = tuple(self.acts.location.terms[i] for i in some.tolist())
        acts = replace(self.acts, location=replace(self.acts.location, terms=terms))
        derived = tuple(name for name in acts.location.covariates if name in rows.derived)
        effect = replace(acts.effect(np.zeros(len(terms))), derived=derived).seen_in(context, fitted)
        return EffectBlock(effect, (), context, 0, std[some])


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
    """What kinds of effect an arm lacks.

    Attributes:
        found: Those with evidence, the most first.
        held_out: RMS of the error on held-out poses without any family, and with all, in the unit of what is read
            foremost; every row counts.
        noise: Standard deviation of the readings over that stated, if the rest is nothing else.
    """

    found: tuple[FamilyFound, ...]
    held_out: tuple[float, float]
    noise: float


@dataclass(frozen=True, eq=False)
class Background:
    """Families in a fit: effects of the arm, and walks in time that stay behind in the campaign.

    Attributes:
        names: Of the families.
        effects: What is in the arm from then on.
        walks: What wanders.
        of: Family of each of those, effects first.
        amplitudes: Where a fit starts, behind one another.
        explained: (n,) what they explain of the whitened readings there.
        price: What it costs to have chosen one among all families [nats].
        ratios: Variance of each component by the noise's, see `Kinds.components`.
    """

    names: tuple[str, ...] = ()
    effects: tuple[EffectBlock, ...] = ()
    walks: tuple[Walk, ...] = ()
    of: tuple[str, ...] = ()
    amplitudes: Array = field(default_factory=lambda: np.zeros(0))
    explained: Array = field(default_factory=lambda: np.zeros(0))
    price: float = 0.0
    ratios: Mapping[tuple[str, int], float] = field(default_factory=dict)

    @property
    def blocks(self) -> tuple[Block, ...]:
        """All of it."""
        return (*self.effects, *self.walks)

    @property
    def charge(self) -> float:
        """What it costs to have chosen these [nats]."""
        return self.price * len(self.names)

    @property
    def families(self) -> tuple[str, ...]:
        """(P,) family of each amplitude."""
        return tuple(name for name, block in zip(self.of, self.blocks, strict=True) for _ in block.parameters)

    def close_to(self, other: Background) -> bool:
        """Return whether another has the same families with almost the same sizes."""
        if self.families != other.families:
            return False
        sizes = (np.concatenate([np.zeros(0), *(block.prior for block in one.blocks)]) for one in (self, other))
        return bool(np.all(np.abs(np.log(np.divide(*sizes))) <= EVEN))

    def without(self, *gone: str) -> Background:
        """Return the others without some families."""
        own = np.isin(np.array(self.families, dtype=object), gone)
        kept = [name not in gone for name in self.of]
        effects, walks = (
            tuple(block for block, stays in zip(blocks, flags, strict=True) if stays)
            for blocks, flags in ((self.effects, kept[: len(self.effects)]), (self.walks, kept[len(self.effects) :]))
        )
        return replace(
            self,
            names=tuple(name for name in self.names if name not in gone),
            effects=effects,
            walks=walks,
            of=tuple(name for name in self.of if name not in gone),
            amplitudes=self.amplitudes[~own],
        )

    def from_effect(self, first: int, numbers: Sequence[int]) -> Background:
        """Return the same as the effects of an arm from one on, with which each is of its name."""
        pairs = enumerate(zip(self.effects, numbers, strict=True), first)
        effects = tuple(replace(block, ordinal=place, number=number) for place, (block, number) in pairs)
        return replace(self, effects=effects)


NO_FAMILIES = Background()


@dataclass(frozen=True, eq=False)
class Kinds:
    """The columns of all families at a fit.

    Attributes:
        fit: Where.
        context: The campaign as effects see it there.
        parts: What each family does at each place.
        columns: (n, K) what that does to the whitened readings.
        folds: (M,) fold of every row.
    """

    fit: Fit
    context: Context
    parts: tuple[Member, ...]
    columns: Array
    folds: np.ndarray

    @cached_property
    def slices(self) -> list[slice]:
        """Columns of each part."""
        ends = np.cumsum([0, *(part.variances.shape[1] for part in self.parts)]).tolist()
        return [slice(first, last) for first, last in pairwise(ends)]

    @cached_property
    def components(self) -> list[tuple[str, int]]:
        """Each length of each family, over all its places."""
        return list(dict.fromkeys((part.family, i) for part in self.parts for i in range(len(part.variances))))

    @cached_property
    def variances(self) -> Array:
        """(C, K) of each column's amplitude per unit of a component's."""
        found = np.zeros((len(self.components), self.columns.shape[1]))
        for part, place in zip(self.parts, self.slices, strict=True):
            for length, spectrum in enumerate(part.variances):
                found[self.components.index((part.family, length)), place] = spectrum
        return found

    @property
    def names(self) -> list[str]:
        """All families."""
        return list(dict.fromkeys(name for name, _ in self.components))

    def of(self, name: str) -> list[int]:
        """Return the components of a family."""
        return [i for i, (family, _) in enumerate(self.components) if family == name]

    def beside(self, projection: Projection, near: Background) -> Sized:
        """Return the families' sizes beside what a projection has fitted, which also takes any constant twist.

        Where links and zeros truly are is no family: what calibration was not allowed to move is not to be mistaken
        for it. They are sought from those of a background that may be `near`.
        """
        projection = self._with_constants(projection)
        gram = projection.inside(self.columns)
        score = self.columns.T @ projection.residual
        square = projection.objective + projection.freedom * LEAST_SCATTER**2
        model = MixedModel(gram, score, square, projection.freedom, self.variances, LEAST_INFORMED)
        ratios = np.array([near.ratios.get(part, 0.0) for part in self.components])
        return Sized(self, projection, model, model.at(ratios))

    def _with_constants(self, projection: Projection) -> Projection:
        view = self.fit.view
        twists = np.concatenate([view.to_twist(joint.name) for joint in view.arm.robot.moving], axis=2)
        moved = np.array([view.rms(twist) for twist in twists.transpose(2, 0, 1)]) / view.per_metre
        twists, moved = twists[:, :, moved > 0.0], moved[moved > 0.0]
        columns = (twists * self.fit.scale[:, :, None]).reshape(view.residual.size, -1)
        return projection.with_columns(columns, (moved / view.largest_motion) ** 2)


def kinds_of(fit: Fit, context: Context, poses: np.ndarray) -> Kinds:
    """Return the columns of all families at a fit.

    Args:
        fit: Of the arm.
        context: The campaign as effects see it there.
        poses: (M,) number of the pose of every fitted row.
    """
    bank, parts, columns = Bank((), fit, context), list[Member](), [np.empty((fit.view.residual.size, 0))]
    for part in _parts(fit, context):
        if isinstance(part.acts, Walk):
            own = (part.acts.columns(fit.view) * fit.scale[:, :, None]).reshape(fit.view.residual.size, -1)
        else:
            own = bank.made(part.acts)
        if own.any():
            parts.append(part)
            columns.append(own)
    return Kinds(fit, context, tuple(parts), np.hstack(columns), pose_folds(poses))


@dataclass(frozen=True, eq=False)
class Sized:
    """Families with the sizes that the evidence gives them beside what else is fitted.

    Attributes:
        kinds: The families.
        projection: What else is fitted.
        model: The linear problem.
        begun: Sizes near which those are sought; all zero where none are known.
    """

    kinds: Kinds
    projection: Projection
    model: MixedModel
    begun: Components

    @cached_property
    def fitted(self) -> Components:
        """The sizes.

        Raises:
            ConvergenceError: What families do is not finite.
        """
        return self.model.fitted_near(self.begun) if self.begun.ratios.any() else self.model.fitted()

    @property
    def families(self) -> Families:
        """What the evidence has."""
        found, least = list[FamilyFound](), -np.log(DOUBT)
        amplitudes = self.fitted.amplitudes
        for name in self.kinds.names:
            own = self.kinds.of(name)
            if not self.fitted.ratios[own].any() or self.fitted.lost_without(*own) < least:
                continue
            without = self.without(name, self.fitted)
            evidence = self.fitted.log_likelihood - without.log_likelihood
            if evidence < least:
                continue
            places = dict[tuple[str, str], Array]()
            for part, place in zip(self.kinds.parts, self.kinds.slices, strict=True):
                if part.family == name:
                    done = self.kinds.columns[:, place] @ amplitudes[place]
                    places[part.place] = places.get(part.place, 0.0) + done
            left = {place: self.projection.left_of(done) for place, done in places.items()}  # by what is fitted anyway
            sizes = [FamilyPlace(*place, self.rms(done)) for place, done in left.items()]
            sizes = tuple(sorted((size for size in sizes if size.rms > 0.0), key=lambda size: -size.rms))
            rms = self.rms(np.sum(list(left.values()), axis=0))
            found.append(FamilyFound(name, rms, evidence, self.held_out(without), sizes))
        found.sort(key=lambda family: -family.evidence)
        none = self.model.at(np.zeros(len(self.kinds.components)))
        return Families(tuple(found), (self.held_out(none), self.held_out(self.fitted)), self.fitted.noise)

    @cached_property
    def _fewer(self) -> dict[tuple[str, Components], Components]:
        return {}

    def without(self, name: str, sizes: Components) -> Components:
        """Return the sizes of the others without a family, in whose place they may step."""
        if (name, sizes) not in self._fewer:
            self._fewer[name, sizes] = self.model.fitted(sizes.without(*self.kinds.of(name)), MOST_TRIED)
        return self._fewer[name, sizes]

    @cached_property
    def background(self) -> Background:
        """The families that are worth their prior probability beside all others, as blocks of a fit.

        The least is left out first, and the others take its place as far as they can.
        """
        kinds, sizes = self.kinds, self.fitted
        price = -np.log(EFFECTS * FAMILIAL / len(kinds.names) / len(SCALES))
        while there := [name for name in kinds.names if sizes.ratios[kinds.of(name)].any()]:
            lost = {name: sizes.lost_without(*kinds.of(name)) for name in there}
            least = min(there, key=lost.__getitem__)
            fewer = sizes.without(*kinds.of(least))
            if lost[least] > price:  # as long as the others may not take its place: no step gains more than the first
                beside = {name: sizes.without(*kinds.of(name)) for name in there if lost[name] < 4.0 * WITHIN}
                likely = [name for name, rest in beside.items() if lost[name] < price + MOST_TRIED * rest.promised]
                every = [self.without(name, sizes) for name in likely]
                fewer = max(every, key=lambda one: one.log_likelihood, default=None)
                if fewer is None or sizes.log_likelihood - fewer.log_likelihood > price:
                    break
            sizes = self.model.fitted(fewer)
        std, amplitudes = sizes.spread, sizes.amplitudes
        effects, walks = list[tuple[str, EffectBlock, Array]](), list[tuple[str, Walk, Array]]()
        for part, place in zip(kinds.parts, kinds.slices, strict=True):
            block = part.block(std[place], kinds.context, kinds.fit.view.driven, kinds.fit.view.rows)
            own = amplitudes[place][std[place] > 0.0]
            if isinstance(block, Walk):
                walks.append((part.family, block, own))
            elif block is not None:
                effects.append((part.family, block, own))
        return Background(
            tuple(there),
            tuple(block for _, block, _ in effects),
            tuple(block for _, block, _ in walks),
            tuple(family for family, *_ in (*effects, *walks)),
            np.concatenate([np.zeros(0), *(own for *_, own in (*effects, *walks))]),
            kinds.columns @ amplitudes,
            price,
            {one: ratio for one, ratio in zip(kinds.components, sizes.ratios.tolist(), strict=True) if ratio > 0.0},
        )

    def doubted(self, background: Background) -> tuple[str, ...]:
        """Return the families of a background that a resample may do without."""
        sizes = self._as(background)
        return tuple(name for name in background.names if sizes.lost_without(*self.kinds.of(name)) < 4.0 * WITHIN)

    def together(self, name: str, background: Background) -> tuple[Array, np.ndarray]:
        """Return the (n, K) whitened columns of a family for amplitudes of one size, and (K,) the place of each.

        Its lengths are to one another as in a background, as they usually are where that has none of them.
        """
        lengths = self.kinds.of(name)
        ratios = self._as(background).ratios[lengths]
        std = np.sqrt((ratios if ratios.any() else self.model.usual[lengths]) @ self.model.variances[lengths])
        places = np.repeat(
            np.array([part.place[0].removeprefix(LINK) for part in self.kinds.parts], dtype=object),
            [part.variances.shape[1] for part in self.kinds.parts],
        )
        return self.kinds.columns[:, std > 0.0] * std[std > 0.0], places[std > 0.0]

    def _as(self, background: Background) -> Components:
        """Return the sizes that a background has."""
        return self.model.at(np.array([background.ratios.get(part, 0.0) for part in self.kinds.components]))

    def rms(self, whitened: Array) -> float:
        """Return the RMS of what (n,) whitened errors are of what is read foremost, in its unit."""
        fit = self.kinds.fit
        errors = np.zeros(fit.view.residual.shape)
        errors[:, fit.view.foremost] = errors_of(fit, whitened)
        return fit.view.rms(errors)

    @cached_property
    def _columns(self) -> tuple[Array, Array]:
        """(n, P + k) columns of what is fitted anyway and of families that are there, and their products."""
        columns = np.hstack([self.projection.regressors, self.kinds.columns[:, self.fitted.columns]])
        return columns, squared(columns)

    def held_out(self, sizes: Components) -> float:
        """Return the RMS of the error of every row, predicted from the other folds with these sizes.

        Errors of a fold's readings are what all readings leave of them, by (1 - H)^-1 with their part H of the hat
        matrix (Cook and Weisberg 1982, "Residuals and Influence in Regression", 2.2).
        """
        columns, gram = self._columns
        fixed, depth = self.projection.precision, self.kinds.fit.view.residual.shape[1]
        scale = np.append(np.ones(len(fixed)), sizes.spread[self.fitted.columns])
        some = np.flatnonzero(scale)
        precision = np.append(fixed, np.ones(len(scale) - len(fixed)))[some]  # by the noise's variance
        known = gram[np.ix_(some, some)] * scale[some] * scale[some, None] + np.diag(precision)
        unit = 1.0 / np.sqrt(np.where(np.diag(known) > 0.0, np.diag(known), 1.0))
        known = known * unit * unit[:, None] + RESOLUTION * np.eye(len(unit))
        root = cholesky(known, lower=True, check_finite=False)
        half = solve_triangular(root, (columns[:, some] * (scale[some] * unit)).T, lower=True, check_finite=False)
        left = self.projection.data - half.T @ (half @ self.projection.data)
        for number in np.unique(self.kinds.folds):
            own = np.flatnonzero(np.repeat(self.kinds.folds == number, depth))
            rest = (1.0 + ROUNDING) * np.eye(len(own)) - squared(half[:, own])
            left[own] = solve(rest, left[own], assume_a="pos", check_finite=False)
        return self.rms(left)


def _parts(fit: Fit, context: Context) -> Iterator[Member]:
    """Yield what every family does at every place of a campaign."""
    view, records = fit.view, context.records
    # Lengths over which a drive's errors may change [rad], of sliding drives by how far they were driven; about other
    # axes the longer half, since bearings and links are smoother than gears.
    lengths = np.array([0.05, 0.15, 0.5, 1.5])
    positions = {joint.name: context.row.position(joint.name)[view.rows] for joint in context.robot.moving}
    driven = {name: values for name, values in positions.items() if np.ptp(values) > 0.0}
    recorded = {name: context.column(name)[view.rows] for name in context.recorded if name != "time"}
    recorded = {name: x for name, x in recorded.items() if np.ptp(x) > 0.0}
    slides = [joint.name for joint in context.robot.moving if drive_axis(joint) not in AXES_TURN]
    tubes = {(location.site, location.axis): location for location in GUIDES.places(records)}

    def by_column(law: str, site: str, name: str, x: Array) -> Iterator[Member]:
        for axis in records.axes(site) if site in records.joints else (*TWIST_NAMES,):
            location = Location(site, axis, (name,))
            yield Member(law, Candidate(LINE, location, (float(x.mean()),)), np.full((1, 1), np.ptp(x) ** -2.0))

    for joint in context.robot.moving:
        drive, own = drive_axis(joint), f"q_{joint.name}"
        axes = [axis for axis in AXES_TURN if axis in records.axes(joint.name)]
        if joint.name in driven:
            yield from _over_position(joint, driven[joint.name], lengths, axes)
        if (approach := f"{APPROACH}{joint.name}") in context.row.covariates:
            location = Location(joint.name, drive, (approach,))
            yield Member("play by approach", Candidate(BACKLASH, location, ()), np.full((1, 1), 4.0))
            acts = Candidate(FRICTION_WINDUP, replace(location, terms=(1,)), ())
            yield Member("friction wind-up", acts, np.ones((1, 1)))
        for name, x in recorded.items():
            yield from by_column(f"by {name}", joint.name, name, x)
        load = view.load_at(joint.name)
        where = [name for name in dict.fromkeys((joint.name, *slides)) if name in driven]
        for i, j in PAIRS if len(axes) == 3 else ():
            location = Location(joint.name, AXES_TURN[i], partner=AXES_TURN[j])
            yield Member("compliance", Candidate(CROSS_COUPLING, location, ()), np.ones((1, 1)))
        for axis in axes:
            moment = load[:, TWIST_NAMES.index(axis)]
            largest = float(np.abs(moment).max())
            if not largest > ROUNDING * np.abs(load).max():
                continue
            yield Member("compliance", Candidate(COMPLIANCE, Location(joint.name, axis), ()), np.ones((1, 1)))
            # Slips at small and at large changes of the load make a loop of any width (Iwan 1966, "A
            # distributed-element model for hysteresis", Journal of Applied Mechanics 33).
            for share in (0.05, 0.2):
                acts = Candidate(HYSTERESIS, Location(joint.name, axis), (share * float(np.ptp(moment)),))
                yield Member("hysteresis", acts, np.ones((1, 1)))
            play = Location(joint.name, axis, (own,))
            inner = (0.0, 0.1 * largest)  # a tenth of the load takes play to the other side
            yield Member("play by load", Candidate(LINE_PLAY, play, inner), np.ones((1, 1)))
            if joint.name in driven and (guides := tubes.get((joint.name, axis))) is not None:
                x = driven[joint.name]
                acts = Candidate(GUIDES, guides, (largest, float(x.min()), float(x.max())))
                yield Member("play in the guides", acts, np.full((1, len(guides.terms)), np.ptp(x) ** 2.0))
            for name, x in recorded.items():
                location = Location(joint.name, axis, (name,))
                acts = Candidate(LINE_COMPLIANCE, location, (float(x.mean()),))
                yield Member(f"compliance by {name}", acts, np.full((1, 1), np.ptp(x) ** -2.0))
            for name in where:
                x = driven[name]
                middle, span = float(x.mean()), float(np.ptp(x))
                location = Location(joint.name, axis, (f"q_{name}",), (0, 1))
                acts = Candidate(LINE_COMPLIANCE, location, (middle,))
                yield Member("compliance by position", acts, np.array([[span**-2.0, span**-4.0]]))
                acts = Candidate(LINE_PLAY, replace(location, terms=(1,)), (middle, inner[1]))
                yield Member("play by load and position", acts, np.full((1, 1), span**-2.0))
    base = Candidate(BASE_COMPLIANCE, Location(BASE, terms=(1, 2, 3, 4, 5, 6)), ())
    yield Member("compliance", base, np.ones((1, 6)))
    for name, x in recorded.items():
        yield from by_column(f"by {name}", BASE, name, x)
    yield from _wandering(fit, context)
    yield from _lagging(fit, context)


def _over_position(joint: Joint, values: Array, lengths: Array, axes: Sequence[str]) -> Iterator[Member]:
    """Yield what is a function of a drive's (M,) positions alone."""
    drive, own = drive_axis(joint), (f"q_{joint.name}",)
    unit = 1.0 if drive in AXES_TURN else float(np.ptp(values))
    yield Member("curve of the drives", *_curve(joint.name, drive, values, unit * lengths))
    yield Member(
        "scale of the encoders", Candidate(ENCODER_SCALE, Location(joint.name, drive, own), ()), np.ones((1, 1))
    )
    if drive in AXES_TURN:
        acts = Candidate(ENCODER_ECCENTRICITY, Location(joint.name, drive, own, (0, 1)), ())
        yield Member("eccentricity of the encoders", acts, np.ones((1, 2)))
    for axis in axes:
        if axis != drive:
            acts = _curve(joint.name, axis, values, unit * lengths[2:])
            yield Member("curve about other axes", *acts)


def _curve(site: str, axis: str, values: Array, lengths: Array) -> tuple[Candidate, Array]:
    """Return sines over (M,) positions, and the (L, k) variances that curves of (L,) lengths give them.

    The finest of them has three radians within the shortest length, however few poses there are: where a curve ends
    before the band of a gear does, a part of that band is named as a wave, another one in each half of a campaign.
    """
    middle, half = 0.5 * (values.min() + values.max()), 0.5 * np.ptp(values) + lengths.max()
    count = int(np.clip(2.0 * half * 3.0 / lengths.min() / np.pi, 1, MOST_SINES))
    waves = np.pi * np.arange(1, count + 1) / (2.0 * half)
    rates = np.sqrt(3.0) / lengths[:, None]
    location = Location(site, axis, (f"q_{site}",), tuple(range(count)))
    acts = Candidate(DRIVE_CURVE, location, (float(middle - half), float(middle + half)))
    return acts, 4.0 * rates**3 / (rates**2 + waves**2) ** 2 / half


def _wandering(fit: Fit, context: Context) -> Iterator[Member]:
    """Yield random walks in time: of the instrument's frame, anew in every session, and of every drive.

    Those through a whole campaign with a clock are effects of the arm on that clock; others stay behind in it.
    """
    view, every = fit.view, len(context.row.q)
    # Campaigns have clocks of their own: of several together it is the order of their rows.
    timed = context.timed and len(context.pieces) < 2
    order = context.column(TIME) if timed else np.arange(float(every))
    ends = float(order.min()), float(order.max())
    sizes = np.ones((1, WALK_TERMS))

    def walk(site: str, axis: str, rows: np.ndarray, session: str = "") -> Walk:
        share, waves = (order - order[rows].min()) / (np.ptp(order[rows]) or 1.0), np.zeros((every, WALK_TERMS))
        waves[rows] = walk_terms(share[rows])
        waves[rows] -= waves[rows].mean(axis=0)  # what stays beside it is as it was on average
        return Walk(site, axis, np.ones(WALK_TERMS), waves, session)

    def whole(law: TwistLaw, site: str, axis: str) -> Candidate | Walk:
        clocked = timed and ends[0] < ends[1]
        return Candidate(law, walk_at(site, axis), ends) if clocked else walk(site, axis, view.rows)

    sessions = np.array(view.sessions)
    for axis in TWIST_NAMES[:3]:
        yield Member("wandering of the instrument", whole(BASE_WANDERING, BASE, axis), sizes)
        for session in dict.fromkeys(view.sessions) if len(set(view.sessions)) > 1 else ():
            rows = view.rows[sessions == session]
            yield Member("wandering of the instrument", walk(BASE, axis, rows, session), sizes)
    for joint in context.robot.moving:
        yield Member("wandering of the drives", whole(DRIVE_WANDERING, joint.name, drive_axis(joint)), sizes)


def _lagging(fit: Fit, context: Context) -> Iterator[Member]:
    """Yield what is read a share of the way behind: towards where the tip was in the row before, along every axis.

    An instrument that averages is, and an arm that has not come to rest.
    """
    tips = rigid_tips(fit.view.arm.loaded(None), context.row.q)[:, :3, 3]
    behind = np.zeros_like(tips)
    for rows in context.pieces:
        behind[rows[1:]] = tips[rows[:-1]] - tips[rows[1:]]
    for axis, way in zip(TWIST_NAMES, behind.T, strict=False):
        walk = Walk(BASE, axis, np.ones(1), way[:, None], words="behind")
        yield Member("lag of the instrument", walk, np.ones((1, 1)))
