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
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from armflex.arm import Arm
from armflex.conventions import STANDARD_GRAVITY, Array, in_mm, said_of
from armflex.errors import FEW, ArmflexError, ConventionError, Flag
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
from armflex.estimate.view import LARGEST_MOTION, View, look, solved
from armflex.laws.joint.log_compliance import LOOSE
from armflex.linear_gaussian import LinearGaussian
from armflex.measured.data_flags import check_joint_units, in_other_units
from armflex.measured.measurements import Measurements
from armflex.mechanics.loop_rows import rigid_tips
from armflex.parameters import ABSURD, DOUBT, FRAMES, SEEN
from armflex.readings import Kind, Orientation, Position, Postures
from armflex.readings.instrument import ROUNDS, Instrument, rigid_fit
from armflex.rows.rows import levels

NAMED = -float(np.log(BY_CHANCE))
"""Logarithm of the odds at which a hypothesis is named."""

LOOKS = 20.0
"""Prior: readings of one instrument are worth as many independent ones, since what an arm lacks is in all of them."""

FINE_SHARE = 3e-5
"""Prior: part of the reach, of a radian and of g that an arm may be off by before conventions are thought of."""

ROWS_LOOKED_AT = 120
"""Tolerance: rows looked at; no convention hides in more. By a quarter of them, of each instrument, hypotheses are
ranked, and the likeliest judged."""


@dataclass(frozen=True, eq=False)
class Misfit:
    """How badly a campaign fits an arm within its priors; see the head of this module.

    Attributes:
        view: The rows, instruments placed and nothing else fitted.
        placed: Where the instrument stands there; the frames of sessions that have no first guess are left to [prior].
        cost: Minus the logarithm of the density, readings counted as so many.
        excess: (M, G) each reading's part of it beyond that of noise as stated, of every kind.
        ideal: What the cost would be if nothing were left but what is stated.
        left: (M, d) residuals with everything fitted, in their units.
        scatter: (G,) of what each kind read over what is stated.
        free: Whether anything but frames is free or learned.
    """

    view: View
    placed: Instrument
    cost: float
    excess: Array
    ideal: float
    left: Array
    scatter: Array
    free: bool

    @property
    def kinds(self) -> tuple[Kind, ...]:
        """What was read."""
        return self.view.readings.kinds

    @property
    def plausible(self) -> bool:
        """Whether noise and what an arm may lack explain the readings."""
        return self.cost - self.ideal < NAMED and not self.suspects

    @property
    def suspects(self) -> tuple[str | None, ...]:
        """Whose readings cost more than noise: sensors by name, '' for the tip's position, None its orientation."""
        far = self.excess.sum(axis=0) > NAMED
        far |= self.scatter < 1.0 / ABSURD  # stated in another unit
        names = [None if isinstance(kind, Orientation) and not kind.name else kind.name for kind in self.kinds]
        return tuple(name for name, is_far in zip(names, far.tolist(), strict=True) if is_far)

    def off(self, errors: Array, number: int = 0) -> float:
        """Return the median length of (M, d) errors of what one kind read, in its unit."""
        kind, place = self.view.readings.placed[number]
        read = np.isfinite(kind.sigma).any(axis=1)
        return float(np.median(np.linalg.norm(errors[read, place], axis=1))) if read.any() else 0.0

    def said(self, of: str, errors: Array | None = None) -> str:
        """Return how far off is what a hypothesis is about, in words: (M, d) errors, or the instruments placed."""
        turned = [i for i, kind in enumerate(self.kinds) if isinstance(kind, Orientation) and not kind.name]
        number = turned[0] if of == "orientation" and turned else 0
        return said_of(self.off(self.view.residual if errors is None else errors, number), self.kinds[number].shown_in)


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

    def meant(self, hypothesis: Misreading, rows: np.ndarray | None = None) -> Case:
        """Return the case as a hypothesis has it in (M,) own rows, in all where None."""
        after = hypothesis.rows(self.rows) if hypothesis.of_rows else hypothesis.rows(self.every).some(self.some)
        if rows is not None:
            place, old = rows[:, None], self.rows
            kinds = [
                replace(b, values=np.where(place, b.values, a.values), sigma=np.where(place, b.sigma, a.sigma))
                for a, b in zip(old.readings.kinds, after.readings.kinds, strict=True)
            ]
            names = zip(old.payload, after.payload, rows.tolist(), strict=True)
            payload = tuple(b if there else a for a, b, there in names)
            readings = replace(old.readings, kinds=tuple(kinds))
            after = replace(after, q=np.where(place, after.q, old.q), payload=payload, readings=readings)
        return replace(self, arm=hypothesis.arm or self.arm, rows=after)

    def only(self, chosen: np.ndarray) -> Case:
        """Return the case in (m,) of its rows."""
        return replace(self, rows=self.rows.some(chosen), some=self.some[chosen])

    def rests_as(self, other: Case) -> bool:
        """Return whether the arm rests in its rows as that of another case does."""
        parts = ("robot", "flexures", "payloads", "effects", "corrections")
        same = all(getattr(self.arm, name) is getattr(other.arm, name) for name in parts)
        return same and np.array_equal(self.rows.q, other.rows.q) and self.rows.payload == other.rows.payload


def misfit(
    case: Case,
    known: View | None = None,
    instrument: Instrument | None = None,
    rounds: int | None = None,
    placing: bool = False,
) -> Misfit:
    """Return how badly rows fit an arm.

    Args:
        case: Arm and rows.
        known: The same rows of an arm that rests in them as this one does, if any.
        instrument: Where it stands, near enough; it is placed where not given.
        rounds: Gauss and Newton's steps at most, which go on while something is gained; one where not given, but
            `ROUNDS` where only sensors read, which begin from further off.
        placing: Whether nothing but where the instrument and its target are is fitted.

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
    rounds, first, settled = rounds or (1 if campaign.positioned[rows].any() else ROUNDS), None, None
    for _ in range(rounds):
        now = realise(setup, blocks, values)
        near = line if first is None else solved(now, campaign, rows, allow_large=True)
        view = look(now, campaign, rows, line=near)
        first = first or view
        jacobian = np.zeros((*view.residual.shape, 0))
        jacobian = np.concatenate([jacobian, *(block.jacobian(view) for block in blocks)], axis=2)
        least = FINE_SHARE * view.readings.stacked(lambda kind, at=view.at: _whole(kind, at, arm.robot.reach))
        before, floor = settled, np.maximum(view.sigma, least)
        settled = _settled(jacobian, precision, values, view.residual, floor, view.readings.slices)
        values = moved_by(blocks, values, settled[0])
        if before is not None and before[1] - settled[1] < 1.0:
            break
    free = any(part.kind not in FRAMES for part in blocks) or any(part.learn is not None for part in arm.flexures)
    assert first is not None and settled is not None
    _, cost, excess, ideal, left, scatter = settled
    return Misfit(first, setup.instrument, cost, excess, ideal, left, scatter, free)


def _whole(kind: Kind, at: Postures, reach: float) -> Array:
    """Return (N, d) what is all of a reading: a radian, g, or what a shift as long as the arm reaches makes of it."""
    whole = {"rad": 1.0, "m/s^2": STANDARD_GRAVITY}.get(kind.unit)
    return reach * kind.by_shift(at) if whole is None else np.full(kind.values.shape, whole)


def _settled(
    jacobian: Array, precision: Array, start: Array, residual: Array, floor: Array, places: Sequence[slice]
) -> tuple[Array, float, Array, float, Array, Array]:
    """Return (P,) the step, then what `Misfit` has: cost, rows, ideal, left and scatter; by rounds of weights.

    Args:
        jacobian: (M, d, P) changes of the readings per parameter.
        precision: (P,) prior precisions, about values that are `start` (P,) less than those of the residual.
        start: See there.
        residual: (M, d) in their units.
        floor: (M, d) least standard deviations, infinite where nothing was read.
        places: Where each instrument's numbers stand among the d.
    """
    read, left, steps = np.isfinite(floor), residual / floor, jacobian / floor[:, :, None]
    of_kind = np.zeros((floor.shape[1], len(places)))  # which numbers are of which instrument
    for number, place in enumerate(places):
        of_kind[place, number] = 1.0
    count, squares = read @ of_kind, left**2 @ of_kind
    total = np.maximum(count.sum(axis=0), 1.0)
    worth, variance = LOOKS / np.maximum(total, LOOKS), np.ones(len(places))
    for number in np.flatnonzero(count.any(axis=0)):
        read_in = count[:, number] > 0.0
        variance[number] = max(float(np.median(squares[read_in, number] / count[read_in, number])), 1.0)
    values, whole = np.zeros(len(precision)), left
    for _ in range(ROUNDS):
        weights = (TAILS + count) / (TAILS + squares / variance)
        if len(precision):
            each = np.sqrt((worth * weights / variance) @ of_kind.T)
            flat = (steps * each[:, :, None]).reshape(-1, len(precision))
            values = LinearGaussian.of(flat, precision).solve(flat.T @ (whole * each).ravel() - precision * start)
            left = whole - steps @ values
            squares = left**2 @ of_kind
        near = (TAILS + count) / (TAILS + squares / variance)
        before, variance = variance, np.maximum((near * squares).sum(axis=0) / total, 1.0)
        if np.abs(np.log(variance / before)).max(initial=0.0) < EVEN:
            break
    whitened_by = np.where(read, floor, 1.0)
    sizes = np.log(whitened_by) @ of_kind

    def cost(squared: Array, variance: Array) -> Array:
        tails = 0.5 * (TAILS + count) * np.log1p(squared / variance / TAILS)
        return worth * (tails + sizes + 0.5 * count * np.log(variance))

    parts, held = cost(squares, variance), 0.5 * float((precision * (values + start) ** 2).sum())
    least = np.minimum(cost(count, np.ones(len(places))), parts)
    errors, small = np.where(read, left * whitened_by, 0.0), (weights * squares).sum(axis=0) / total
    return values, float(parts.sum()) + held, parts - least, float(least.sum()), errors, np.sqrt(small)


@dataclass(frozen=True)
class RankedMisreading:
    """A convention in which a campaign is plausible: how much the likelier, and how far off it then is, as said."""

    hypothesis: Misreading
    name: str
    gain: float
    then: str

    @property
    def said(self) -> str:
        """As the end of a sentence: the name, what is left then, and the remedy."""
        return f"{self.name}? Then they are {self.then} off: {self.hypothesis.remedy}"


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
    with suppress(ArmflexError):
        fitted = misfit(case)
        if not fitted.plausible:
            fitted = misfit(case, fitted.view, rounds=ROUNDS)  # nor is an arm accused that one step does not fit
    if fitted is not None and fitted.plausible and not in_other_units(case.every.q, arm).any():
        return ()
    named = _named(case, fitted, searched)
    if not named:
        check_joint_units(measurements.q, arm, measurements.places, units=measurements.units)
    elif (likeliest := named[0].hypothesis).of in arm.sensors and likeliest.slip is not None:
        text = f"{named[0].name}: {likeliest.remedy}"  # the others say where the arm is
        return (Flag("instrument_moved", text, about=likeliest.of),)
    begun = _begun(case, fitted)
    if named:
        said = "; or ".join(ranked.said for ranked in named)
        raise ConventionError(f"{begun}: {said}", [ranked.name for ranked in named])
    return () if fitted is None or keep else tuple(_implausible(fitted, begun, searched))


def _judged_rows(arm: Arm, measurements: Measurements, rows: np.ndarray, keep: bool) -> Case | None:
    """Return some of (M,) rows and what in them says anything of conventions, None where nothing does."""
    # Loads and frequencies say little of conventions.
    placed = tuple(_read(kind) for kind in measurements.readings.kinds if kind.by_motion)
    if not placed and measurements.readings.kinds:
        return None
    readings = replace(measurements.readings, kinds=placed)
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
    off, whose = _off_placed(case, of) or fitted.said(of), f" ({sensors})" if sensors else ""
    return f"{where}{of or 'reading'}s are {off} off the arm{whose}, further than [prior] explains"


def _implausible(fitted: Misfit, begun: str, searched: bool) -> Iterator[Flag]:
    """Yield flags about sensors far off with all that is free; raise where the tip is further off than any arm is."""
    reach, left = fitted.view.arm.robot.reach, fitted.off(fitted.left)
    if fitted.kinds[0].unit == "m" and left > outlier_limit(1) * LARGEST_MOTION * reach:
        text = f"{begun}, {in_mm(left)} of which is left with all that [prior] frees"
        text += ": no defect of an arm is so large, and no convention that is tried explains it"
        more = "check that rows and readings are of the same poses, the URDF this arm's, the tip the target's link"
        raise ConventionError(f"{text}; {more}, and for two conventions at once", [])
    for number, kind in enumerate(fitted.kinds):
        sought = searched and any(nuisance.anywhere for nuisance in kind.nuisances)  # stands where it is found to stand
        if kind.name and fitted.scatter[number] > ABSURD and not sought:
            off = said_of(fitted.off(fitted.left, number), kind.shown_in)
            text = f"{kind.title}: with all that [prior] and its declaration free, what it read is {off} off: "
            text += f"an effect is missing, or [instrument.{kind.name}] is not as declared"
            yield Flag("instrument_implausible", text, about=kind.name)


def _spread(count: int, most: int) -> np.ndarray:
    """Return so many numbers below a count at most, evenly spread."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(int))


def _read(kind: Kind) -> Kind:
    """Return a kind without coordinates of a point that were not read: those beside which others are in no unit."""
    return replace(kind, sigma=np.where(kind.read, kind.sigma, np.inf)) if isinstance(kind, Position) else kind


def _named(case: Case, fitted: Misfit | None, searched: bool) -> list[RankedMisreading]:
    """Return the hypotheses whose odds against the campaign as written are beyond `NAMED`, the likeliest first."""
    tried = list(_candidates(case, fitted))
    if fitted is not None and not fitted.free and not case.keep and not searched:
        more = "there is nothing to fit: give it joint_offset, compliance, tool or geometry, a standard deviation each"
        prior = replace(USUAL_PRIOR, session_target=case.arm.prior.session_target)
        tried.append((Misreading("[prior] frees nothing", more, arm=replace(case.arm, prior=prior)), None))
    named, meant = dict[str, RankedMisreading](), dict[str, tuple[Misreading, np.ndarray | None]]()

    def judged(
        hypothesis: Misreading, of_rows: np.ndarray | None, looked_at: np.ndarray | None = None
    ) -> tuple[float, Misfit | None, str]:
        """Return what a hypothesis is charged, how all rows fit then, or some at a glance, and in which it holds."""
        with suppress(ArmflexError):
            other, (words, charge) = case.meant(hypothesis, of_rows), _charge(case, hypothesis, of_rows)
            before = fitted.view if fitted is not None and other.rests_as(case) else None
            near = fitted.placed if fitted is not None and hypothesis.of == "loads" else None
            if looked_at is None:
                return charge, misfit(other, before, near), words
            return charge, misfit(other.only(looked_at), before and before.some(looked_at), near, rounds=1), words
        return np.inf, None, ""

    if len(tried) > 2 * FEW:
        read = (np.flatnonzero(np.isfinite(kind.sigma).any(axis=1)) for kind in case.rows.readings.kinds)
        looked_at = np.unique(np.concatenate([own[_spread(len(own), ROWS_LOOKED_AT // 4)] for own in read]))
        glances = (judged(*candidate, looked_at) for candidate in tried)
        costs = [np.inf if then is None else charge + then.cost for charge, then, _ in glances]
        tried = [tried[i] for i in np.argsort(costs, kind="stable")[: 2 * FEW].tolist()]
    for hypothesis, of_rows in tried:
        charge, then, words = judged(hypothesis, of_rows)
        if then is None:
            continue
        gain = (0.0 if fitted is None else fitted.cost) - then.cost
        if hypothesis.slip is not None and hypothesis.of not in case.arm.sensors:
            # An arm that slips as far explains as much.
            gain = min(gain, 0.5 * (hypothesis.slip / USUAL_PRIOR.geometry) ** 2)
        gain, name = gain - charge, f"{hypothesis.name}{words}"
        if hypothesis.whole and fitted is not None and then.off(then.left) > np.sqrt(DOUBT) * fitted.off(fitted.left):
            continue
        if (fitted is None or gain > NAMED) and (name not in named or named[name].gain < gain):
            named[name] = RankedMisreading(hypothesis, name, gain, then.said(hypothesis.of))
            meant[name] = hypothesis, of_rows
    ranked = sorted(named.values(), key=lambda candidate: -candidate.gain)
    likeliest = [candidate for candidate in ranked if candidate.gain > ranked[0].gain + np.log(DOUBT)][:FEW]
    return [
        replace(
            candidate, then=_off_placed(case.meant(*meant[candidate.name]), candidate.hypothesis.of) or candidate.then
        )
        for candidate in likeliest
    ]


def _off_placed(case: Case, of: str) -> str:
    """Return how far off is what a hypothesis is about with instrument and target placed, in words; '' unknown."""
    with suppress(ArmflexError):
        fitted = misfit(case, rounds=ROUNDS, placing=True)
        return fitted.said(of, fitted.left)
    return ""


def _charge(case: Case, hypothesis: Misreading, rows: np.ndarray | None) -> tuple[str, float]:
    """Return in which (M,) own rows a hypothesis holds, '' for all, and what it costs to think of it and to say so."""
    thought = NAMED * hypothesis.mistakes - LOOKS * hypothesis.volume * (1.0 if rows is None else float(rows.mean()))
    if rows is None:
        return "", thought
    sessions = case.sessions
    (first, *others), count = dict.fromkeys(sessions[rows].tolist()), len(set(sessions.tolist()))
    if not others and rows.sum() == (sessions == first).sum():
        return f" in session {first!r}", thought + float(np.log(count))
    share = float(np.clip(rows.mean(), 1.0 / len(rows), 1.0 - 1.0 / len(rows)))
    chosen = -LOOKS / 3.0 * (share * np.log(share) + (1.0 - share) * np.log(1.0 - share))
    return f" in some rows ({100.0 * share:.0f} %, the first {_place(case, int(np.argmax(rows)))})", thought + chosen


def _place(case: Case, row: int) -> str:
    return case.rows.places[row].short if case.rows.places else f"row {case.some[row]}"


def _candidates(case: Case, fitted: Misfit | None) -> Iterator[tuple[Misreading, np.ndarray | None]]:
    """Yield what is worth being judged: a hypothesis, and (M,) in which rows it holds, None for all."""
    suspects = ("",) if fitted is None else fitted.suspects
    every = list(misreadings(case.arm, case.every, suspects))
    moves = [] if fitted is None else list(_moves(case, fitted))
    yield from (
        (hypothesis, None)
        for hypothesis in _likeliest_turns(
            [hypothesis for hypothesis in every if hypothesis.of == "orientation"], case, fitted
        )
    )
    if set(suspects) - {None}:
        points = [hypothesis for hypothesis in every if hypothesis.of == "points"]
        tracked = bool(case.rows.positioned.all())
        if tracked:
            yield from ((hypothesis, None) for hypothesis in estimated(case.arm, case.every, case.some))
            yield from ((hypothesis, None) for hypothesis in (_apart(case, fitted) if fitted is not None else ()))
        yield from _first_look(points, case, fitted) if tracked else ((hypothesis, None) for hypothesis in points)
    for hypothesis in every + moves:
        if hypothesis.of == "loads" and set(suspects) - {None}:
            yield hypothesis, None
            if hypothesis.some and fitted is not None:
                rows = _rows_of(hypothesis, case, fitted)
                if rows.any():
                    yield hypothesis, rows
        elif hypothesis.slip is not None:
            yield hypothesis, None
    if fitted is not None:
        still = [hypothesis for hypothesis in every + moves if hypothesis.slip is None]
        yield from ((hypothesis, None) for hypothesis in _likeliest_readings(still, case, fitted))


def _apart(case: Case, fitted: Misfit) -> Iterator[Misreading]:
    """Yield that the target is at another place with each payload, or with each text of another column."""
    view, rows = fitted.view, case.rows
    texts = {"payload": rows.payload} | {
        name: column for name, column in rows.covariates.items() if isinstance(column, tuple) and levels(column)
    }
    place = view.foremost
    if fitted.kinds[0].name or not isinstance(fitted.kinds[0], Position):
        return
    blocks = [block for block in declared_blocks(view.setup, rows) if not case.keep or block.kind in FRAMES]
    jacobian = np.concatenate(
        [np.zeros((*view.residual.shape, 0)), *(block.jacobian(view) for block in blocks)], axis=2
    )
    axes = view.at.axes @ view.line.tip[:, :3, :3]
    read = np.isfinite(view.sigma[:, place]).all(axis=1)
    for column, texts_in in texts.items():
        first, *others = dict.fromkeys(texts_in)
        count = {name: texts_in.count(name) for name in (first, *others)}
        if not 0 < len(others) <= 2 * FEW or min(count.values()) < FEWEST_ROWS:
            continue
        which = np.array(texts_in)
        steps = [axes * (which == name)[:, None, None] for name in others]
        full = np.concatenate([jacobian[:, place], *steps], axis=2)[read] / view.sigma[read][:, place, None]
        precision = np.concatenate([*(block.prior**-2.0 for block in blocks), np.ones(3 * len(others))])
        flat = full.reshape(-1, len(precision))
        whole = (view.residual[read][:, place] / view.sigma[read][:, place]).ravel()
        values = LinearGaussian.of(flat, precision).solve(flat.T @ whole)
        shifts = dict(zip(others, values[-3 * len(others) :].reshape(-1, 3), strict=True))
        yield targets_apart(case.arm, column, texts_in, shifts)


def _first_look(
    points: Sequence[Misreading], case: Case, fitted: Misfit | None
) -> Iterator[tuple[Misreading, np.ndarray | None]]:
    """Yield the hypotheses that bring points nearest to their places, in all rows, in a session or in some rows.

    They move points by parts of the reach, and explain nothing where a rigid arm, nothing fitted, comes no nearer.
    """
    unknown, sessions, fixed = case.arm.measurement.frame != "base", case.sessions, case.arm.instrument or Instrument()

    def at(case: Case) -> Array:
        """Return (M, 2, 3) points of the rigid arm in the base, and where they were seen [m]."""
        return np.stack([fixed.in_base(rigid_tips(case.arm.loaded(None), case.rows.q)), case.rows.position], axis=1)

    def frame(pairs: Array, unknown: bool) -> tuple[Array, Array]:
        return rigid_fit(pairs[:, 0], pairs[:, 1])[:2] if unknown else (fixed.pose.rotation, fixed.pose.translation)

    def cost(pairs: Array, unknown: bool) -> float:
        off = _squares(pairs, *frame(pairs, unknown))
        least = max(float(np.median(off)) / 3.0, (FINE_SHARE * case.arm.robot.reach) ** 2)
        parts = 0.5 * (TAILS + 3.0) * np.log1p(off / least / TAILS) + 1.5 * np.log(least)
        return LOOKS / 3.0 * float(parts.mean())

    def nearer(here: Array, there: Array) -> np.ndarray:
        """Return (M,) which of the points are nearer to their places there, the instrument placed by the rest."""
        read_so, near = np.zeros(len(here), bool), frame(here, unknown)
        for _ in range(FEW):
            last, read_so = read_so, 4.0 * _squares(there, *near) < _squares(here, *near)
            if np.array_equal(read_so, last):
                break
            near = frame(np.where(read_so[:, None, None], there, here), unknown)
        return read_so

    here, names = at(case), list(dict.fromkeys(sessions.tolist()))
    before, looked = cost(here, unknown), list[tuple[float, int, Misreading, np.ndarray | None]]()
    odd = [name for name in names if fitted is None or fitted.excess[sessions == name].sum() > NAMED]
    masks_of_sessions = [sessions == name for name in odd if len(names) > 1]
    for hypothesis in points:
        other = case.meant(hypothesis)
        there, placed = at(other), other.arm.measurement.frame != "base"
        if placed == unknown and np.array_equal(here, there):
            yield hypothesis, None  # it moves no point
            continue
        price = cost(there, placed) + _charge(case, hypothesis, None)[1]
        looked.append((price, len(looked), hypothesis, None))
        masks = [*masks_of_sessions, nearer(here, there)] if hypothesis.some else []
        for mask in [mask for mask in masks if 0 < mask.sum() < len(mask)]:
            price = cost(np.where(mask[:, None, None], there, here), unknown)
            looked.append((price + _charge(case, hypothesis, mask)[1], len(looked), hypothesis, mask))
    looked.sort(key=lambda glance: glance[:2])
    yield from ((glance, mask) for price, _, glance, mask in looked[:FEW] if price < before)


def _squares(pairs: Array, turn: Array, shift: Array) -> Array:
    """Return the (M,) squared distances of (M, 2, 3) points from their places, turned and shifted."""
    return ((pairs[:, 1] - pairs[:, 0] @ turn.T - shift) ** 2).sum(axis=1)


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


def _likeliest_readings(every: Sequence[Misreading], case: Case, fitted: Misfit) -> Iterator[Misreading]:
    """Yield the hypotheses about sensors; of those about the axes of one those that bring its readings nearest."""
    looked: list[tuple[float, int, Misreading]] = []
    for hypothesis in (reading for reading in every if reading.of in case.arm.sensors):
        other = case.meant(hypothesis)
        pairs = zip(case.rows.readings.kinds, other.rows.readings.kinds, strict=True)
        changed = [i for i, (kind, new) in enumerate(pairs) if kind.values is not new.values and kind.name]
        errors = fitted.view.residual.copy()
        for i in changed:
            errors[:, fitted.view.readings.slices[i]] += other.rows.readings.kinds[i].values - fitted.kinds[i].values
        turned = len(changed) == 1 and isinstance(fitted.kinds[changed[0]], Orientation)
        if other.arm is not case.arm or len(changed) != 1 or turned or hypothesis.volume:
            yield hypothesis
        else:
            looked.append((fitted.off(errors, changed[0]), len(looked), hypothesis))
    for sensor in dict.fromkeys(glance.of for *_, glance in looked):  # each has its unit
        of_sensor = [glance for glance in looked if glance[2].of == sensor]
        yield from (glance for _, _, glance in sorted(of_sensor, key=lambda glance: glance[:2])[:FEW])


def _rows_of(hypothesis: Misreading, case: Case, fit_before: Misfit) -> np.ndarray:
    """Return (M,) in which rows a hypothesis about payloads holds: where less is left of the readings with it."""
    meant, fitted = case.meant(hypothesis), fit_before
    open_ = np.array(meant.rows.payload) != np.array(case.rows.payload)
    chosen, every, where = np.zeros(len(open_), bool), np.arange(len(open_)), fit_before.view.foremost
    for _ in range(FEW):
        with suppress(ArmflexError):
            fitted = misfit(case.meant(hypothesis, chosen), None, fit_before.placed) if chosen.any() else fit_before
            here, other = (look(fitted.view.setup, rows, every).residual for rows in (case.rows, meant.rows))
            now = np.where(chosen[:, None], other, here)
            sizes = [((fitted.left + each - now)[:, where] ** 2).sum(axis=1) for each in (here, other)]
            chosen = open_ & (sizes[1] < sizes[0])
            if LOOKS * 0.5 * np.log(sizes[0].sum() / np.minimum(*sizes).sum()) < NAMED and fitted is fit_before:
                return np.zeros_like(chosen)  # it cannot explain enough
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
            or fitted.excess[:, number].sum() < NAMED
        ):
            continue
        read = np.flatnonzero(np.isfinite(kind.sigma).all(axis=1))
        if away := kind.some(read).elsewhere(view.at.some(read)):
            yield elsewhere(case.arm, sensors[kind.name], f"{kind.title}: {away}")
        asked = [(kind.name, kind.title if kind.name else "the instrument", fitted.left[:, place], case.sessions)]
        if not kind.name:
            tip = np.einsum("nji,nj->ni", view.at.axes @ view.line.tip[:, :3, :3], fitted.left[:, place])
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
                start = _place(case, int(late[0]))
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


def check_scatter(fit: Fit) -> None:
    """Raise where readings scatter a hundred times as far as they state: nothing is to be written that rests on them.

    No arm lacks `ABSURD` times what an instrument is said to read that states `ABSURD` times too little.

    Raises:
        ConventionError: With the instrument, what it states and how it scatters.
    """
    for flag in wrong_sigma(fit):
        if flag.code == "scattered":
            raise ConventionError(flag.text, ["readings scatter"])
