"""Whether a campaign says what its columns claim, or was written in another convention than the arm's.

Most first campaigns are wrong in a convention: two joints exchanged, a sign, a home position, a unit, Euler angles, a
target that somebody knocked. A fit then drives everything that is free to where it makes up for that. So before
anything is fitted, the readings are compared with what the arm and its priors can explain, as they are written and as
each of the `hypotheses` would have them. With the instrument placed, J the Jacobian of everything that [prior] frees
and r what is left of the readings, the cost of a campaign is minus the logarithm of

    max over t, s   N(t; 0, P)  prod over readings  student(r - J t; s)^k,      s >= what is stated, and `FINE_SHARE`.

Each instrument has a scatter s of its own, so that one that is wrong does not spoil what the others say. What an arm
lacks is the same in many readings: they count as `LOOKS` independent ones, which is the power k. Tails are long
(`TAILS`): a lost beam is no convention, a session of them is. A hypothesis is named where its odds against the campaign
as written, its prior among them, are a thousand to one (`NAMED`).

That is asked of a few: those that bring the points of a placed arm nearest (`SeenRows`), or explain most to first order
(`LinearCampaign`), of all that `misreadings` and `estimated` think of.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import compress

import numpy as np

from armflex.arm import Arm
from armflex.conventions import STANDARD_GRAVITY, Array, in_mm, said_of
from armflex.errors import FEW, ArmflexError, ClosureError, ConventionError, Flag, UnsupportedError
from armflex.estimate.block import parameters_of
from armflex.estimate.blocks import declared_blocks, sensor_start
from armflex.estimate.estimated import estimated
from armflex.estimate.fit import Fit, realise
from armflex.estimate.fit import moved as moved_by
from armflex.estimate.misreadings import (
    USUAL_PRIOR,
    Misreading,
    elsewhere,
    misreadings,
    moved,
    targets_apart,
)
from armflex.estimate.placement import FEWEST_ROWS, check_length, first_guess
from armflex.estimate.robust import BY_CHANCE, EVEN, TAILS, outlier_limit
from armflex.estimate.seen_rows import FINE_SHARE, SeenRows
from armflex.estimate.view import LARGEST_MOTION, View, look, solved
from armflex.laws.joint.log_compliance import LOOSE
from armflex.linear_gaussian import LinearGaussian
from armflex.measured.data_flags import check_joint_units, in_other_units
from armflex.measured.measurements import Measurements
from armflex.mechanics.loop_rows import rigid_tips
from armflex.parameters import ABSURD, DOUBT, FRAMES, SEEN
from armflex.readings import Kind, Orientation, Position
from armflex.readings.instrument import ROUNDS, Instrument
from armflex.rows.rows import levels

NAMED = -float(np.log(BY_CHANCE))
"""Logarithm of the odds at which a hypothesis is named."""

LOOKS = 20.0
"""Prior: readings of one instrument are worth as many independent ones, since what an arm lacks is in all of them."""

ROWS_LOOKED_AT = 120
"""Tolerance: rows looked at; no convention hides in more."""


@dataclass(frozen=True, eq=False)
class Explained:
    """What readings are explained to, once everything is fitted; see the head of this module.

    Attributes:
        step: (P,) of the parameters, in their units.
        cost: Minus the logarithm of the density, readings counted as so many.
        excess: (M, G) each reading's part of it beyond that of noise as stated, of every kind.
        ideal: What the cost would be if nothing were left but what is stated.
        left: (M, d) residuals with everything fitted, in their units.
        scatter: (G,) of what each kind read over what is stated.
    """

    step: Array
    cost: float
    excess: Array
    ideal: float
    left: Array
    scatter: Array


@dataclass(frozen=True, eq=False)
class LinearCampaign:
    """Readings of M rows, to first order in all that may be fitted to them.

    Attributes:
        jacobian: (M, d, P) changes of the readings per parameter.
        precision: (P,) prior precisions, about values that are `start` (P,) less than those of the residual.
        start: See there.
        residual: (M, d) in their units.
        floor: (M, d) least standard deviations, infinite where nothing was read.
        places: Where each instrument's numbers stand among the d.
    """

    jacobian: Array
    precision: Array
    start: Array
    residual: Array
    floor: Array
    places: Sequence[slice]

    def beside(self, columns: Array, precision: Array) -> LinearCampaign:
        """Return the same with (M, d, k) further changes of the readings, about zero with (k,) precisions."""
        jacobian, none = np.concatenate([self.jacobian, columns], axis=2), np.zeros(len(precision))
        precision, start = np.concatenate([self.precision, precision]), np.concatenate([self.start, none])
        return replace(self, jacobian=jacobian, precision=precision, start=start)

    def explained(self, change: Array | float = 0.0) -> Explained:
        """Return what is left of the readings where the arm moves them by (M, d) more, by rounds of weights."""
        read, left, steps = np.isfinite(self.floor), self.residual - change, self.jacobian
        of_kind = np.zeros((self.floor.shape[1], len(self.places)))  # which numbers are of which instrument
        for number, place in enumerate(self.places):
            of_kind[place, number] = 1.0
        left, steps = left / self.floor, steps / self.floor[:, :, None]
        count, squares = read @ of_kind, left**2 @ of_kind
        total = np.maximum(count.sum(axis=0), 1.0)
        worth, variance = LOOKS / np.maximum(total, LOOKS), np.ones(len(self.places))
        for number in np.flatnonzero(count.any(axis=0)):
            read_in = count[:, number] > 0.0
            variance[number] = max(float(np.median(squares[read_in, number] / count[read_in, number])), 1.0)
        values, whole, precision = np.zeros(len(self.precision)), left, self.precision
        for _ in range(ROUNDS):
            weights = (TAILS + count) / (TAILS + squares / variance)
            if len(precision):
                each = np.sqrt((worth * weights / variance) @ of_kind.T)
                flat = (steps * each[:, :, None]).reshape(left.size, len(precision))
                score = flat.T @ (whole * each).ravel() - precision * self.start
                values = LinearGaussian.of(flat, precision).solve(score)
                left = whole - steps @ values
                squares = left**2 @ of_kind
            near = (TAILS + count) / (TAILS + squares / variance)
            before, variance = variance, np.maximum((near * squares).sum(axis=0) / total, 1.0)
            if np.abs(np.log(variance / before)).max(initial=0.0) < EVEN:
                break
        whitened_by = np.where(read, self.floor, 1.0)
        sizes = np.log(whitened_by) @ of_kind

        def cost(squared: Array, variance: Array) -> Array:
            tails = 0.5 * (TAILS + count) * np.log1p(squared / variance / TAILS)
            return worth * (tails + sizes + 0.5 * count * np.log(variance))

        parts, held = cost(squares, variance), 0.5 * float((precision * (values + self.start) ** 2).sum())
        least = np.minimum(cost(count, np.ones(len(self.places))), parts)
        errors, scatter = np.where(read, left * whitened_by, 0.0), np.sqrt((weights * squares).sum(axis=0) / total)
        return Explained(values, float(parts.sum()) + held, parts - least, float(least.sum()), errors, scatter)


@dataclass(frozen=True, eq=False)
class Misfit:
    """How badly a campaign fits an arm within its priors.

    Attributes:
        view: The rows, instruments placed and nothing else fitted.
        placed: Where the instrument stands there; the frames of sessions that have no first guess are left to [prior].
        linear: The campaign to first order about what is fitted.
        explained: What that leaves.
        free: Whether anything but frames is free or learned.
    """

    view: View
    placed: Instrument
    linear: LinearCampaign
    explained: Explained
    free: bool

    @property
    def cost(self) -> float:
        """See `Explained`."""
        return self.explained.cost

    @property
    def kinds(self) -> tuple[Kind, ...]:
        """What was read."""
        return self.view.readings.kinds

    @property
    def plausible(self) -> bool:
        """Whether noise and what an arm may lack explain the readings."""
        return self.cost - self.explained.ideal < NAMED and not self.suspects

    @property
    def suspects(self) -> tuple[str | None, ...]:
        """Whose readings cost more than noise: sensors by name, '' for the tip's position, None its orientation."""
        far = self.explained.excess.sum(axis=0) > NAMED
        far |= self.explained.scatter < 1.0 / ABSURD  # stated in another unit
        names = [None if isinstance(kind, Orientation) and not kind.name else kind.name for kind in self.kinds]
        return tuple(name for name, is_far in zip(names, far.tolist(), strict=True) if is_far)

    @property
    def off(self) -> float:
        """Median length of what is left of the first of the kinds, in its unit."""
        return self.off_by(self.explained.left)

    def off_by(self, errors: Array, number: int = 0) -> float:
        """Return the median length of (M, d) errors of what one kind read, in its unit."""
        kind, place = self.view.readings.placed[number]
        read = np.isfinite(kind.sigma).any(axis=1)
        return float(np.median(np.linalg.norm(errors[read, place], axis=1))) if read.any() else 0.0

    def said(self, of: str, errors: Array) -> str:
        """Return how far off by (M, d) errors is what a hypothesis is about, in words."""
        turned = [i for i, kind in enumerate(self.kinds) if isinstance(kind, Orientation) and not kind.name]
        number = turned[0] if of == "orientation" and turned else 0
        return said_of(self.off_by(errors, number), self.kinds[number].shown_in)


@dataclass(frozen=True, eq=False)
class Case:
    """What is judged: an arm and some rows of its campaign, as written or as they may have been meant.

    Attributes:
        arm: The arm.
        rows: The rows.
        keep: Whether nothing but frames is free.
        every: The whole campaign, and `some` (M,) the numbers of the rows in it.
    """

    arm: Arm
    rows: Measurements
    keep: bool
    every: Measurements
    some: np.ndarray

    @property
    def sessions(self) -> np.ndarray:
        """(M,) session of every row."""
        return np.array(self.rows.session)

    def meant(self, hypothesis: Misreading) -> Case:
        """Return the case as a hypothesis has it in the rows in which it holds."""
        after = hypothesis.rows(self.rows) if hypothesis.of_rows else hypothesis.rows(self.every).some(self.some)
        if (rows := hypothesis.where) is not None:
            place, old = rows[:, None], self.rows
            kinds = [
                replace(b, values=np.where(place, b.values, a.values), sigma=np.where(place, b.sigma, a.sigma))
                for a, b in zip(old.readings.kinds, after.readings.kinds, strict=True)
            ]
            names = zip(old.payload, after.payload, rows.tolist(), strict=True)
            payload = tuple(b if there else a for a, b, there in names)
            readings = replace(old.readings, kinds=tuple(kinds))
            after = replace(after, q=np.where(place, after.q, old.q), payload=payload, readings=readings)
        # Loops are followed from where they were last: what one hypothesis asks would lead the next to another branch.
        arm = hypothesis.arm or (replace(self.arm) if self.arm.robot.linkage else self.arm)
        return replace(self, arm=arm, rows=after)

    def rests_as(self, other: Case) -> bool:
        """Return whether the arm rests in its rows as that of another case does."""
        parts = ("robot", "flexures", "payloads", "effects", "corrections")
        same = all(getattr(self.arm, name) is getattr(other.arm, name) for name in parts)
        return same and np.array_equal(self.rows.q, other.rows.q) and self.rows.payload == other.rows.payload

    def sees_otherwise(self, hypothesis: Misreading) -> bool:
        """Return whether joints, points or the arm are others in a hypothesis, not only what weighs them."""
        meant = self.meant(hypothesis).rows
        same = np.array_equal(self.rows.q, meant.q) and np.array_equal(self.rows.position, meant.position)
        return not same or hypothesis.arm is not None

    def place(self, row: int) -> str:
        """Return where a row is, for people."""
        return self.rows.places[row].short if self.rows.places else f"row {self.some[row]}"


def misfit(
    case: Case,
    known: View | None = None,
    instrument: Instrument | None = None,
    rounds: int | None = None,
    placing: bool = False,
    doubted: bool = False,
) -> Misfit:
    """Return how badly rows fit an arm.

    Args:
        case: Arm and rows.
        known: The same rows of an arm that rests in them as this one does, if any.
        instrument: Where it stands, near enough; it is placed where not given.
        rounds: Gauss and Newton's steps at most, which go on while something is gained; one where not given, but
            `ROUNDS` where only sensors read, which begin from further off.
        placing: Whether nothing but where the instrument and its target are is fitted.
        doubted: Whether steps go on only while they leave what is not plausible.

    Raises:
        ArmflexError: The arm has no equilibrium there, or the instrument cannot be placed.
    """
    arm, campaign, rows = case.arm, case.rows, np.arange(len(case.rows))
    # An arm that bends further than a compliance describes is refused later, and by that name.
    setup, line = first_guess(arm, campaign, rows, None if known is None else known.line, instrument, allow_large=True)
    begun = sensor_start(look(setup, campaign, rows, line=line))
    kinds = SEEN if placing else FRAMES
    blocks = [block for block in declared_blocks(setup, campaign) if not (case.keep or placing) or block.kind in kinds]
    values = np.array([begun.get(parameter, 0.0) for parameter in parameters_of(blocks)])
    # A declared compliance is often a guess: what it would explain is no other convention.
    rough = outlier_limit(1) * LOOSE
    stds = [np.maximum(block.prior, rough) if block.logarithmic else block.prior for block in blocks]
    precision = np.concatenate([np.zeros(0), *stds]) ** -2.0
    free = any(part.kind not in FRAMES for part in blocks) or any(part.learn is not None for part in arm.flexures)
    fitted: Misfit | None = None
    for _ in range(rounds or (1 if campaign.positioned[rows].any() else ROUNDS)):
        now = realise(setup, blocks, values)
        near = line if fitted is None else solved(now, campaign, rows, allow_large=True)
        view = look(now, campaign, rows, line=near)
        jacobian = np.zeros((*view.residual.shape, 0))
        jacobian = np.concatenate([jacobian, *(block.jacobian(view) for block in blocks)], axis=2)
        floor = np.maximum(view.sigma, least_sigma(view))
        linear = LinearCampaign(jacobian, precision, values, view.residual, floor, view.readings.slices)
        before, explained = fitted, linear.explained()
        fitted = Misfit(fitted.view if fitted else view, setup.instrument, linear, explained, free)
        values = moved_by(blocks, values, explained.step)
        gained = np.inf if before is None else before.cost - fitted.cost
        if gained < 1.0 or (doubted and before is None and fitted.plausible):
            break
    assert fitted is not None
    return fitted


def least_sigma(view: View) -> Array:
    """Return (M, d) what readings are off by before conventions are thought of: `FINE_SHARE` of all of each.

    All of it is a radian, g, or what a shift as long as the arm reaches makes of it.
    """

    def whole(kind: Kind) -> Array:
        size = {"rad": 1.0, "m/s^2": STANDARD_GRAVITY}.get(kind.unit)
        return view.arm.robot.reach * kind.by_shift(view.at) if size is None else np.full(kind.values.shape, size)

    return FINE_SHARE * view.readings.stacked(whole)


def check_conventions(
    arm: Arm, measurements: Measurements, rows: np.ndarray, keep: bool = False, searched: bool = False
) -> tuple[Flag, ...]:
    """Return flags about sensors that were moved or are implausible; raise where a campaign is in another convention.

    Args:
        arm: The arm as declared.
        measurements: The campaign.
        rows: (M,) numbers of the rows used.
        keep: Whether nothing but frames is fitted, so that [prior] need not free anything.
        searched: Whether what the arm lacks is looked for, which may be all that it lacks.

    Raises:
        TableError: A joint is far beyond its limits, and no unit explains it.
        ConventionError: With the hypotheses that make the campaign plausible, the likeliest first, and how to write
            each of them right; or errors larger than any arm's; or nothing that [prior] frees where readings are off;
            or touches without a length, see `check_length`.
    """
    check_length(arm, measurements.some(rows))
    case = _judged_rows(arm, measurements, rows, keep)
    if case is None:
        return ()
    fitted = None
    try:
        fitted = misfit(case, rounds=ROUNDS, doubted=True)  # nor is an arm accused that one step does not fit
    except UnsupportedError:  # no campaign of this arm is judged
        raise
    except ArmflexError:
        pass
    if fitted is not None and fitted.plausible and not in_other_units(case.every.q, arm).any():
        return ()
    named = _named(case, fitted, searched)
    if not named:
        check_joint_units(measurements.q, arm, measurements.places, units=measurements.units)
    elif (likeliest := named[0][0]).of in arm.sensors and likeliest.slip is not None:
        text = f"{likeliest.name}: {likeliest.remedy}"  # the others say where the arm is
        return (Flag("instrument_moved", text, about=likeliest.of),)
    if named:
        said = "; or ".join(f"{way.name}? Then they are {off} off: {way.remedy}" for way, off in named)
        raise ConventionError(f"{_begun(case, fitted)}: {said}", [way.name for way, _ in named])
    return () if fitted is None or keep else tuple(_implausible(case, fitted, searched))


def _judged_rows(arm: Arm, measurements: Measurements, rows: np.ndarray, keep: bool) -> Case | None:
    """Return some of (M,) rows and what in them says anything of conventions, None where nothing does."""
    # Loads and frequencies say little of conventions.
    placed = [kind for kind in measurements.readings.kinds if kind.by_motion]
    if not placed and measurements.readings.kinds:
        return None
    for i, kind in enumerate(placed):
        if isinstance(kind, Position):  # coordinates that were not read, beside which others are in no unit
            placed[i] = replace(kind, sigma=np.where(kind.read, kind.sigma, np.inf))
    readings = replace(measurements.readings, kinds=tuple(placed))
    measurements = replace(measurements, readings=readings, measured=measurements.measured & readings.read)
    rows = rows[measurements.measured[rows]]
    rows = rows[_spread(len(rows), ROWS_LOOKED_AT)] if len(rows) else rows
    return Case(arm, measurements.some(rows), keep, measurements, rows) if len(rows) else None


def _begun(case: Case, fitted: Misfit | None) -> str:
    """Return how far off the readings are as they are written, with the file."""
    where = f"{case.rows.places[0].file}: " if case.rows.places and case.rows.places[0] else ""
    if fitted is None:
        return f"{where}the arm has no equilibrium at these rows as they are declared"
    of = "orientation" if fitted.suspects == (None,) else ""
    sensors = ", ".join(kind.title for kind in fitted.kinds if kind.name and kind.name in fitted.suspects)
    off, whose = _off_placed(case, of) or fitted.said(of, fitted.view.residual), f" ({sensors})" if sensors else ""
    return f"{where}{of or 'reading'}s are {off} off the arm{whose}, further than [prior] explains"


def _implausible(case: Case, fitted: Misfit, searched: bool) -> Iterator[Flag]:
    """Yield flags about sensors far off with all that is free; raise where the tip is further off than any arm is."""
    reach, left = fitted.view.arm.robot.reach, fitted.off
    if fitted.kinds[0].unit == "m" and left > outlier_limit(1) * LARGEST_MOTION * reach:
        text = f"{_begun(case, fitted)}, {in_mm(left)} of which is left with all that [prior] frees"
        text += ": no defect of an arm is so large, and no convention that is tried explains it"
        more = "check that rows and readings are of the same poses, the URDF this arm's, the tip the target's link"
        raise ConventionError(f"{text}; {more}, and for two conventions at once", [])
    for number, kind in enumerate(fitted.kinds):
        sought = searched and any(nuisance.anywhere for nuisance in kind.nuisances)  # stands where it is found to stand
        if kind.name and fitted.explained.scatter[number] > ABSURD and not sought:
            off = said_of(fitted.off_by(fitted.explained.left, number), kind.shown_in)
            text = f"{kind.title}: with all that [prior] and its declaration free, what it read is {off} off: "
            text += f"an effect is missing, or [instrument.{kind.name}] is not as declared"
            yield Flag("instrument_implausible", text, about=kind.name)


def _spread(count: int, most: int) -> np.ndarray:
    """Return so many numbers below a count at most, evenly spread."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(int))


def _named(case: Case, fitted: Misfit | None, searched: bool) -> list[tuple[Misreading, str]]:
    """Return the hypotheses with odds beyond `NAMED`, the likeliest first, and how far off the readings then are."""
    tried = list(_candidates(case, fitted))
    if fitted is not None and not fitted.free and not case.keep and not searched:
        more = "there is nothing to fit: give it joint_offset, compliance, tool or geometry, a standard deviation each"
        prior = replace(USUAL_PRIOR, session_target=case.arm.prior.session_target)
        tried.append(Misreading("[prior] frees nothing", more, arm=replace(case.arm, prior=prior)))
    judged = dict[str, tuple[float, Misreading, str, Case]]()
    for gain, hypothesis, then, meant in filter(None, (_judged(case, fitted, candidate) for candidate in tried)):
        if hypothesis.name not in judged or judged[hypothesis.name][0] < gain:
            judged[hypothesis.name] = gain, hypothesis, then, meant
    ranked = sorted(judged.values(), key=lambda each: -each[0])
    likeliest = [each for each in ranked if each[0] > ranked[0][0] + np.log(DOUBT)][:FEW]
    return [(hypothesis, _off_placed(meant, hypothesis.of) or then) for _, hypothesis, then, meant in likeliest]


def _judged(case: Case, fitted: Misfit | None, hypothesis: Misreading) -> tuple[float, Misreading, str, Case] | None:
    """Return what is gained by a hypothesis, itself with its rows in its name, how far off the readings then are, in
    words, and the case as it has it; None where it is not named.
    """
    try:
        meant, (words, charge) = case.meant(hypothesis), _charge(case, hypothesis)
        before = fitted.view if fitted is not None and meant.rests_as(case) else None
        near = fitted.placed if fitted is not None and hypothesis.of == "loads" else None
        then = misfit(meant, before, near)
    except ArmflexError:
        return None
    gain = (0.0 if fitted is None else fitted.cost) - then.cost
    if hypothesis.slip is not None and hypothesis.of not in case.arm.sensors:
        # An arm that slips as far explains as much.
        gain = min(gain, 0.5 * (hypothesis.slip / USUAL_PRIOR.geometry) ** 2)
    if fitted is not None:
        little = hypothesis.whole and then.off > np.sqrt(DOUBT) * fitted.off
        if little or gain - charge <= NAMED:
            return None
    named = replace(hypothesis, name=f"{hypothesis.name}{words}")
    return gain - charge, named, then.said(hypothesis.of, then.view.residual), meant


def _off_placed(case: Case, of: str) -> str:
    """Return how far off is what a hypothesis is about with instrument and target placed, in words; '' unknown."""
    with suppress(ArmflexError):
        fitted = misfit(case, rounds=ROUNDS, placing=True)
        return fitted.said(of, fitted.explained.left)
    return ""


def _charge(case: Case, hypothesis: Misreading) -> tuple[str, float]:
    """Return in which rows a hypothesis holds, in words, and what it costs to think of it and to say so."""
    rows = hypothesis.where
    thought = NAMED * hypothesis.mistakes - LOOKS * hypothesis.volume * (1.0 if rows is None else float(rows.mean()))
    if rows is None:
        return "", thought
    sessions = case.sessions
    (first, *others), count = dict.fromkeys(sessions[rows].tolist()), len(set(sessions.tolist()))
    if not others and rows.sum() == (sessions == first).sum():
        return f" in session {first!r}", thought + float(np.log(count))
    share = float(np.clip(rows.mean(), 1.0 / len(rows), 1.0 - 1.0 / len(rows)))
    chosen = -LOOKS / 3.0 * (share * np.log(share) + (1.0 - share) * np.log(1.0 - share))
    return f" in some rows ({100.0 * share:.0f} %, the first {case.place(int(np.argmax(rows)))})", thought + chosen


def _candidates(case: Case, fitted: Misfit | None) -> Iterator[Misreading]:
    """Yield what is worth being judged."""
    suspects = ("",) if fitted is None else fitted.suspects
    every = list(misreadings(case.arm, case.every, suspects))
    every += [] if fitted is None else _moves(case, fitted)
    unmoved = [hypothesis for hypothesis in every if hypothesis.slip is None]
    yield from _likeliest_turns([hypothesis for hypothesis in unmoved if hypothesis.of == "orientation"], case, fitted)
    others = [hypothesis for hypothesis in unmoved if hypothesis.of in case.arm.sensors]
    if set(suspects) - {None}:
        points = [hypothesis for hypothesis in unmoved if hypothesis.of == "points"]
        others += [hypothesis for hypothesis in unmoved if hypothesis.of == "loads"]
        seen = _seen(case, fitted)
        if seen is not None:
            if len((largest := _of_one_session(seen, case)).q) >= 3 * FEW and not case.arm.robot.linkage:
                declared = {hypothesis.name for hypothesis in points}  # their remedies say more
                numbered = estimated(largest, case.every)
                yield from (hypothesis for hypothesis in numbered if hypothesis.name not in declared)
            yield from () if fitted is None else _apart(case, fitted)
            otherwise = [case.sees_otherwise(hypothesis) for hypothesis in points]
            yield from _nearest(list(compress(points, otherwise)), seen, case, fitted)
            others += [hypothesis for hypothesis, moves in zip(points, otherwise, strict=True) if not moves]
        else:
            yield from points
    yield from others if fitted is None else _first_order(others, case, fitted)
    yield from (hypothesis for hypothesis in every if hypothesis.slip is not None)


def _seen(case: Case, fitted: Misfit | None) -> SeenRows | None:
    """Return the rows of a case where the tip was seen in each, the arm bent as it is as written.

    None where it was not, or where loops do not close as they are written.
    """
    if not case.rows.positioned.all():
        return None
    try:
        tips = rigid_tips(case.arm.loaded(None), case.rows.q)
    except ClosureError:
        return None
    bent = np.zeros((len(tips), 3)) if fitted is None else (fitted.view.line.tip - tips)[:, :3, 3]
    tips[:, :3, 3] += bent
    return SeenRows(case.arm, case.rows.q, case.rows.position, case.some, bent, tips)


def _of_one_session(seen: SeenRows, case: Case) -> SeenRows:
    """Return some rows of the session that has most."""
    sessions = case.sessions
    first = max(dict.fromkeys(sessions.tolist()), key=lambda name: int((sessions == name).sum()))
    rows = np.flatnonzero(sessions == first)
    return seen.some(rows[_spread(len(rows), 20 * FEW)])


def _nearest(moving: Sequence[Misreading], seen: SeenRows, case: Case, fitted: Misfit | None) -> Iterator[Misreading]:
    """Yield the hypotheses that bring points nearest to their places, in all rows, in a session or in some rows.

    They move points by parts of the reach, and explain nothing where the arm, only placed, comes no nearer. One in
    which a loop does not close is none.
    """
    sessions = case.sessions
    of_session = [sessions == name for name in dict.fromkeys(sessions.tolist())]
    if fitted is not None:
        of_session = [rows for rows in of_session if fitted.explained.excess[rows].sum() > NAMED]
    thin = _spread(len(sessions), 20 * FEW)
    few, ways = seen.some(thin), list[tuple[Misreading, Array, Array, bool]]()
    for hypothesis in moving:
        meant = case.meant(hypothesis)
        with suppress(ClosureError):
            driven_so = hypothesis.arm is None and meant.rows.q is case.rows.q
            there, at = seen.tip if driven_so else seen.tips(meant.rows.q, meant.arm), meant.rows.position
            unknown = meant.arm.measurement.frame != "base"
            ways.append((hypothesis, there[thin], at[thin], unknown))
            for rows in (*of_session, seen.nearer(there, at)) if hypothesis.some else ():
                if 0 < rows.sum() < len(rows):
                    tips = np.where(rows[thin, None, None], there[thin], few.tip)
                    points = np.where(rows[thin, None], at[thin], few.at)
                    ways.append((replace(hypothesis, where=rows), tips, points, unknown))
    if not ways:
        return
    prices = np.array([_charge(case, way[0])[1] for way in ways])
    for unknown in {way[3] for way in ways}:
        alike = [number for number, way in enumerate(ways) if way[3] == unknown]
        tips, points = (np.array([ways[number][part] for number in alike]) for part in (1, 2))
        prices[alike] += LOOKS / 3.0 * few.cost(few.placed_tips(tips, points, unknown=unknown).left[:, 0])
    order = np.argsort(prices, kind="stable").tolist()
    # What a placed arm shows as well is told apart by what else was read: mirrored frames, say, by orientations.
    before = LOOKS / 3.0 * float(few.cost(few.placed(few.q[None]).left[0, 0]))
    limit = min(prices[order[min(FEW, len(order)) - 1]] + EVEN, before)
    yield from (ways[number][0] for number in order if prices[number] <= limit)


def _apart(case: Case, fitted: Misfit) -> Iterator[Misreading]:
    """Yield that the target is at another place with each payload, or with each text of another column."""
    view, rows = fitted.view, case.rows
    texts = {"payload": rows.payload} | {
        name: column for name, column in rows.covariates.items() if isinstance(column, tuple) and levels(column)
    }
    if fitted.kinds[0].name or not isinstance(fitted.kinds[0], Position):
        return
    by_target = view.by_target
    for column, texts_in in texts.items():
        first, *others = dict.fromkeys(texts_in)
        count = {name: texts_in.count(name) for name in (first, *others)}
        if not 0 < len(others) <= 2 * FEW or min(count.values()) < FEWEST_ROWS:
            continue
        which = np.array(texts_in)
        steps = np.concatenate([by_target * (which == name)[:, None, None] for name in others], axis=2)
        after = fitted.linear.beside(steps, np.ones(3 * len(others))).explained()
        shifts = dict(zip(others, after.step[-3 * len(others) :].reshape(-1, 3), strict=True))
        hypothesis = targets_apart(case.arm, column, texts_in, shifts)
        if after.cost + _charge(case, hypothesis)[1] < fitted.cost:
            yield hypothesis


def _first_order(others: Iterable[Misreading], case: Case, fitted: Misfit) -> Iterator[Misreading]:
    """Yield the hypotheses that explain most to first order, in all or some rows, of what each is about a few.

    They are of loads, softness, noise or the numbers of a sensor. One in which a sensor stands elsewhere or reads
    something else is yielded as it is: what is free of that sensor is another thing then.
    """
    view, priced = fitted.view, list[tuple[float, int, Misreading]]()
    for hypothesis in others:
        meant = case.meant(hypothesis)
        if meant.arm.sensors is not case.arm.sensors:
            yield hypothesis
            continue
        with suppress(ArmflexError):
            setup = replace(view.setup, arm=replace(meant.arm, sensors=view.arm.sensors))
            same = meant.rests_as(case)
            line = view.line if same else solved(setup, meant.rows, view.rows, allow_large=True)
            after = look(setup, meant.rows, line=line)
            change, floor = view.residual - after.residual, np.maximum(after.sigma, least_sigma(after))
            ways = [(change, hypothesis)]
            carrying = np.array(meant.rows.payload) != np.array(case.rows.payload)
            if hypothesis.some and (where := _rows_of(change, carrying, fitted)).any():
                ways.append((np.where(where[:, None], change, 0.0), replace(hypothesis, where=where)))
            for moved_by, way in ways:
                gain = fitted.cost - replace(fitted.linear, floor=floor).explained(moved_by).cost
                priced.append((_charge(case, way)[1] - gain, len(priced), way))
    ahead = Counter[str]()
    for price, _, hypothesis in sorted(priced, key=lambda entry: entry[:2]):
        ahead[hypothesis.of] += 1
        if price < 0.0 and ahead[hypothesis.of] <= FEW:
            yield hypothesis


def _likeliest_turns(turned: Sequence[Misreading], case: Case, fitted: Misfit | None) -> list[Misreading]:
    """Return the hypotheses about orientations after which a target is turned on the tool alike in most rows."""
    from scipy.spatial.transform import Rotation  # not needed to import the package

    spread = []
    for hypothesis in turned if fitted is not None else ():
        kind = case.meant(hypothesis).rows.readings.of(Orientation)
        assert kind is not None and fitted is not None
        read = np.isfinite(kind.sigma).all(axis=1)
        axes = (fitted.view.at.axes @ fitted.view.line.tip[:, :3, :3])[read]
        mounted = axes.swapaxes(1, 2) @ Rotation.from_rotvec(kind.values[read]).as_matrix()
        left, _, right = np.linalg.svd(np.median(mounted, axis=0))
        spread.append(float(np.median(((mounted - left @ right) ** 2).sum(axis=(1, 2)))))
    return [turned[i] for i in np.argsort(spread, kind="stable")[:FEW]]


def _rows_of(change: Array, carrying: np.ndarray, fitted: Misfit) -> np.ndarray:
    """Return (M,) in which of the rows that carry something else a hypothesis holds: where less is left with it."""
    chosen, where, after = np.zeros(len(carrying), bool), fitted.view.foremost, fitted.explained
    for number in range(FEW):
        here = after.left + np.where(chosen[:, None], change, 0.0)
        sizes = [(errors[:, where] ** 2).sum(axis=1) for errors in (here, here - change)]
        chosen = carrying & (sizes[1] < sizes[0])
        if number == 0 and LOOKS * 0.5 * np.log(sizes[0].sum() / np.minimum(*sizes).sum()) < NAMED:
            return np.zeros_like(chosen)  # it cannot explain enough
        after = fitted.linear.explained(np.where(chosen[:, None], change, 0.0))
    return chosen


def _moves(case: Case, fitted: Misfit) -> Iterator[Misreading]:
    """Yield that each instrument, and the target, was moved where it likeliest was, or stands somewhere else.

    What is left of the readings, in the axes of what was moved, is then one constant before and another after.
    """
    view, sensors = fitted.view, case.arm.sensors
    for number, (kind, place) in enumerate(view.readings.placed):
        # What was touched stands where it stood, and a socket that fits badly is no instrument that was moved. A camera
        # that was moved shows every picture otherwise: no constant is left of it.
        if (
            isinstance(kind, Orientation)
            or kind.texts is not None
            or kind.apart
            or fitted.explained.excess[:, number].sum() < NAMED
        ):
            continue
        read = np.flatnonzero(np.isfinite(kind.sigma).all(axis=1))
        if away := kind.some(read).elsewhere(view.at.some(read)):
            yield elsewhere(case.arm, sensors[kind.name], f"{kind.title}: {away}")
        left = fitted.explained.left[:, place]
        asked = [(kind.name, kind.title if kind.name else "the instrument", left, case.sessions)]
        if not kind.name:
            tip = np.einsum("nji,nj->ni", view.at.axes @ view.line.tip[:, :3, :3], fitted.explained.left[:, place])
            asked.append(("target", "the target", tip, np.zeros(len(tip))))
        for name, title, motion, within in asked:
            best, late, step = 0.0, np.zeros(0, int), np.zeros(kind.dimension)
            for session in dict.fromkeys(within.tolist()):
                own = read[within[read] == session]
                for k in range(3, len(own) - 2):
                    jump = np.median(motion[own[k:]], axis=0) - np.median(motion[own[:k]], axis=0)
                    gain = float(k * (len(own) - k) / len(own) * (jump**2).sum())
                    if gain > best:
                        best, late, step = gain, own[k:], jump
            far = name in sensors or 0.5 * (np.linalg.norm(step) / USUAL_PRIOR.geometry) ** 2 > NAMED
            if len(late) and far and (name not in sensors or len(sensors[name].movable)):
                rows = np.isin(np.arange(len(motion)), np.arange(late[0], late[-1] + 1)) & (within == within[late[0]])
                start = case.place(int(late[0]))
                yield from moved(case.arm, name, title, start, rows, step, case.rows.session)


def wrong_sigma(fit: Fit, about: Sequence[Flag] = (), searched: bool = False) -> Iterator[Flag]:
    """Yield flags about instruments whose stated standard deviation cannot be meant, by how they scatter about a fit.

    A sensor scatters more than stated where the arm lacks something, too, but then so do others by as much.

    Args:
        fit: The fit, each instrument weighed by its scatter.
        about: Flags on sensors that are implausible for another reason.
        searched: Whether what the arm lacks is looked for, which may be all that scatters.
    """
    readings, suspects = fit.view.readings, {flag.about for flag in about}
    for number, (name, scatter) in enumerate(zip(readings.names, fit.scatters, strict=True)):
        kind, place = next((each, where) for each, where in readings.placed if each.name == name)
        others = [value for i, value in enumerate(fit.scatters) if i != number]
        large = others and scatter > ABSURD * max(1.0, min(others))
        small = fit.noises[number][1] >= ABSURD and scatter < 1.0 / ABSURD
        stated = float(np.median(fit.stated[:, place][np.isfinite(kind.sigma)]))
        text = f"{kind.title}: its sigma is {said_of(stated, kind.shown_in)}, and its readings scatter by "
        text += f"{said_of(scatter * stated, kind.shown_in)}, {scatter:.2g} times as much"
        if scatter > ABSURD**2 and not searched:
            yield Flag("scattered", f"{text}: sigma or a convention is wrong, or the arm lacks much", about=name)
        if name and name not in suspects and (large or small):
            ask = "is it stated in the right unit, or does the arm lack what this instrument alone sees?"
            ask = ask if large else "is it stated in the right unit?"
            yield Flag("sigma_implausible", f"{text}: {ask}", about=name)


def check_scatter(fit: Fit, doubts: Sequence[Flag] = ()) -> None:
    """Raise where readings scatter a hundred times as far as they state: nothing is to be written that rests on them.

    No arm lacks `ABSURD` times what an instrument is said to read that states `ABSURD` times too little.

    Args:
        fit: The fit, each instrument weighed by its scatter.
        doubts: What would explain it.

    Raises:
        ConventionError: With the instrument, what it states and how it scatters.
    """
    for flag in wrong_sigma(fit):
        if flag.code == "scattered":
            raise ConventionError("; ".join([flag.text, *(doubt.text for doubt in doubts)]), ["readings scatter"])
