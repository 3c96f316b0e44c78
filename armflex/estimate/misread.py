"""Whether a campaign says what its columns claim, or was written in another convention than the arm's.

Most first campaigns are wrong in a convention: two joints exchanged, a sign, a home position, a unit, Euler angles, a
target that somebody knocked. A fit then drives everything that is free to where it makes up for that. So before
anything is fitted, the readings are compared with what the arm and its priors can explain, as they are written and as
each of the `hypotheses` would have them. With the instrument placed, J the Jacobian of everything that [prior] frees
and r what is left of the readings, the cost of a campaign is minus the logarithm of

    max over t, s   N(t; 0, P)  prod over readings  student(r - J t; s)^k,      s >= what is stated, and `FINE`.

Each instrument has a scatter s of its own, so that one that is wrong does not spoil what the others say. What an arm
lacks is the same in many readings: they count as `LOOKS` independent ones, which is the power k. Tails are long
(Lange, Little and Taylor 1989): a lost beam is no convention, a session of them is. A hypothesis is named where the
logarithm of its odds against the campaign as written, its prior among them, is beyond `NAMED`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from armflex.arm import Arm
from armflex.conventions import STANDARD_GRAVITY, Array, in_mm, said_of
from armflex.errors import ArmflexError, ConventionError, Flag
from armflex.estimate.block import parameters_of
from armflex.estimate.blocks import declared_blocks, sensor_start
from armflex.estimate.fit import Fit, realise
from armflex.estimate.fit import moved as moved_by
from armflex.estimate.hypotheses import USUAL_PRIOR, Hypothesis, Written, elsewhere, hypotheses, moved
from armflex.estimate.placement import first_guess
from armflex.estimate.view import View, look
from armflex.linear_gaussian import LinearGaussian
from armflex.measured.measurements import Measurements
from armflex.mechanics.many_rows import rigid_tips
from armflex.parameters import FRAMES, ParameterKind
from armflex.readings import Kind, Orientation
from armflex.readings.instrument import Instrument, rigid_fit

NAMED = 12.0
"""Confidence: the logarithm of the odds at which a hypothesis is named, and by which the next best is out of it."""

LOOKS = 20.0
"""Prior: readings of one instrument are worth as many independent ones, since what an arm lacks is in all of them."""

FINE = 3e-5
"""Prior: part of the reach, of a radian and of g that an arm may be off by before conventions are thought of."""

SLIP = 1.5e-3
"""Prior: standard deviation of how far something on an arm slips [m, rad], which is a cause to be traced."""

GROSS = 0.05
"""Prior: part of the reach that is left by no arm: a beam of steel that bends so far stays bent."""

SCATTERED = 100.0
"""Prior: scatter over the stated standard deviation at which something is wrong, whatever it is."""

ABSURD = 10.0
"""Confidence: prior standard deviations beyond which a value is none that was thought of with that prior."""

TAILS = 4.0
"""Prior: degrees of freedom of the readings' distribution (Lange, Little and Taylor 1989)."""

NOTHING = 1e9
"""Tolerance: cost of an arm that has no equilibrium at all."""

STEPS = 3
"""Tolerance: Gauss and Newton's steps where nothing but sensors read, which begin from further off."""

MOST_ROWS, ROUNDS, STILL, MOST_TRIED, MOST_SAID = 120, 15, 0.02, 8, 3
"""Tolerances: rows looked at (no convention hides in more), rounds of weights and the change of log variances that ends
them, hypotheses judged after a first look, and said."""


@dataclass(frozen=True, eq=False)
class Misfit:
    """How badly a campaign fits an arm within its priors; see the head of this module.

    Attributes:
        view: The rows, instruments placed and nothing else fitted.
        cost: Minus the logarithm of the density, readings counted as so many.
        rows: (M, G) each reading's part of it beyond that of noise as stated, of every kind.
        ideal: What it would be if nothing were left but what is stated.
        left: (M, d) residuals with everything fitted, in their units.
        scatter: (G,) of what each kind read over what is stated.
        free: Whether anything but frames is free or learned.
    """

    view: View
    cost: float
    rows: Array
    ideal: float
    left: Array
    scatter: Array
    free: bool

    @property
    def excess_at_tip(self) -> float:
        """How much of the cost is not of noise, orientations left out."""
        kinds = enumerate(kind for kind, _ in self.view.readings.placed)
        return sum(float(self.rows[:, i].sum()) for i, kind in kinds if not isinstance(kind, Orientation) or kind.name)

    def excess_in(self, rows: np.ndarray) -> float:
        """Return the same of (M,) rows, of all that was read there."""
        return float(self.rows[rows].sum())

    @property
    def placed(self) -> float:
        """What is left of the foremost readings with the instrument placed, the median row's, in their unit."""
        return _median(self.view, self.view.residual)

    def said(self, of: str) -> str:
        """Return what is left of the foremost readings, or of the orientations that are asked about, in words."""
        turned = [(kind, place) for kind, place in self.view.readings.placed if isinstance(kind, Orientation)]
        if of != "orientation" or not turned:
            return said_of(self.placed, self.view.readings.unit)
        (kind, place), *_ = turned
        read = np.isfinite(kind.sigma).all(axis=1)
        return said_of(float(np.median(np.linalg.norm(self.view.residual[read, place], axis=1))), kind.unit)

    @cached_property
    def suspects(self) -> tuple[str, ...]:
        """The sensors that scatter beyond what is stated, '' for orientations of the tip's target."""
        pairs = enumerate(kind for kind, _ in self.view.readings.placed)
        far = [kind for number, kind in pairs if self.rows[:, number].sum() > NAMED]
        return tuple(kind.name for kind in far if kind.name or isinstance(kind, Orientation))


def _median(view: View, errors: Array) -> float:
    squares = view.readings.row_squares(errors)[view.readings.foremost_count > 0]
    return float(np.sqrt(np.median(squares))) if len(squares) else 0.0


def misfit(
    arm: Arm,
    measurements: Measurements,
    rows: np.ndarray,
    keep: bool,
    known: View | None = None,
    instrument: Instrument | None = None,
) -> Misfit:
    """Return how badly some rows of a campaign fit an arm.

    Args:
        arm: The arm as declared.
        measurements: The campaign.
        rows: (M,) numbers of the rows.
        keep: Whether nothing but frames is free.
        known: The same rows of an arm that rests in them as this one does, if any.
        instrument: Where it stands, near enough; it is placed where not given.

    Raises:
        ArmflexError: The arm has no equilibrium there, or the instrument cannot be placed.
    """
    setup, line = first_guess(arm, measurements, rows, None if known is None else known.line, instrument)
    begun = sensor_start(look(setup, measurements, rows, line=line))
    blocks = [one for one in declared_blocks(setup, measurements) if not keep or one.kind in FRAMES]
    values = np.array([begun.get(one, 0.0) for one in parameters_of(blocks)])
    precision = np.concatenate([np.zeros(0), *(block.prior**-2.0 for block in blocks)])
    size, first = {"m": arm.robot.reach, "rad": 1.0, "m/s^2": STANDARD_GRAVITY}, None
    for _ in range(1 if measurements.positioned[rows].any() else STEPS):
        view = look(realise(setup, blocks, values), measurements, rows, line=line if first is None else None)
        first = first or view
        jacobian = np.zeros((*view.residual.shape, 0))
        jacobian = np.concatenate([jacobian, *(block.jacobian(view) for block in blocks)], axis=2)
        least = view.readings.stacked(lambda kind: np.full(kind.values.shape, FINE * size[kind.unit]))
        places, floor = [place for _, place in view.readings.placed], np.maximum(view.sigma, least)
        step, *found = _settled(jacobian, precision, values, view.residual, floor, places)
        values = moved_by(blocks, values, step)
    free = any(one.kind not in FRAMES for one in blocks) or any(one.learn is not None for one in arm.flexures)
    assert first is not None
    return Misfit(first, *found, free)


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
    left, steps = residual / floor, jacobian / floor[:, :, None]
    count = np.array([np.isfinite(floor[:, place]).sum(axis=1) for place in places], dtype=float).T
    worth = LOOKS / np.maximum(count.sum(axis=0), LOOKS)

    def squares() -> Array:
        return np.array([(left[:, place] ** 2).sum(axis=1) for place in places]).T

    def spread(weights: Array) -> Array:
        return np.maximum((weights * squares()).sum(axis=0) / np.maximum(count.sum(axis=0), 1.0), 1.0)

    own = squares()
    variance = np.array(
        [max(float(np.median(one[read > 0.0] / read[read > 0.0])), 1.0) if read.any() else 1.0
         for one, read in zip(own.T, count.T, strict=True)]
    )  # fmt: skip
    values, whole = np.zeros(len(precision)), left
    for _ in range(ROUNDS):
        weights = (TAILS + count) / (TAILS + squares() / variance)
        each = np.zeros_like(left)
        for number, place in enumerate(places):
            each[:, place] = (worth[number] * weights[:, number] / variance[number])[:, None]
        if len(precision):
            flat = (steps * np.sqrt(each)[:, :, None]).reshape(-1, len(precision))
            score = flat.T @ (whole * np.sqrt(each)).ravel() - precision * start
            values = LinearGaussian.of(flat, precision).solve(score)
            left = whole - steps @ values
        before, variance = variance, spread((TAILS + count) / (TAILS + squares() / variance))
        if np.abs(np.log(variance / before)).max(initial=0.0) < STILL:
            break

    def cost(squared: Array, variance: Array) -> Array:
        sizes = np.where(np.isfinite(floor), np.log(np.where(np.isfinite(floor), floor, 1.0)), 0.0)
        scale = np.array([sizes[:, place].sum(axis=1) for place in places]).T + 0.5 * count * np.log(variance)
        return worth * (0.5 * (TAILS + count) * np.log1p(squared / variance / TAILS) + scale)

    parts, held = cost(squares(), variance), 0.5 * float((precision * (values + start) ** 2).sum())
    least = np.minimum(cost(count, np.ones(len(places))), parts)
    errors = np.where(np.isfinite(floor), left * np.where(np.isfinite(floor), floor, 0.0), 0.0)
    small = (weights * squares()).sum(axis=0) / np.maximum(count.sum(axis=0), 1.0)
    return values, float(parts.sum()) + held, parts - least, float(least.sum()), errors, np.sqrt(small)


@dataclass(frozen=True)
class Named:
    """A convention in which a campaign is plausible: how much the likelier, and how far off it then is, as said."""

    hypothesis: Hypothesis
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
    """Return flags about instruments that are implausible; raise where a campaign is, and is not in another convention.

    Args:
        arm: The arm as declared.
        measurements: The campaign.
        rows: (M,) numbers of the rows used.
        keep: Whether nothing but frames is fitted, so that [prior] need not free anything.
        searched: Whether what the arm lacks is looked for, which may be all that it lacks.

    Raises:
        ConventionError: With the hypotheses that make the campaign plausible, the likeliest first, and how to write
            each of them right; or errors larger than any arm's; or nothing that [prior] frees where readings are off.
    """
    if len(rows) > MOST_ROWS:
        rows = rows[np.unique(np.linspace(0, len(rows) - 1, MOST_ROWS).astype(int))]
    found = None
    with suppress(ArmflexError):
        found = misfit(arm, measurements, rows, keep)
    small = found is not None and found.scatter[:1].min(initial=1.0) < 1.0 / ABSURD  # stated in another unit
    if found is not None and found.cost - found.ideal < NAMED and not small:
        return ()
    named = _named(arm, measurements, rows, keep, searched, found)
    where = f"{measurements.places[rows[0]].file}: " if measurements.places and measurements.places[rows[0]] else ""
    if named and named[0].hypothesis.of in arm.sensors and named[0].hypothesis.slip is not None:
        text = f"{named[0].name}: {named[0].hypothesis.remedy}"  # the others say where the arm is
        return (Flag("instrument_moved", text, about=named[0].hypothesis.of),)
    if named:
        said = "; or ".join(one.said for one in named)
        raise ConventionError(f"{where}{_begun(found)}: {said}", [one.name for one in named])
    if found is None or keep:
        return ()
    off, left = found.placed, _median(found.view, found.left)
    if found.view.readings.unit == "m" and left > GROSS * arm.robot.reach:
        text = f"{where}readings are {in_mm(off)} off the arm, {in_mm(left)} with all that [prior] frees"
        text += ": no defect of an arm is so large, and no convention that is tried explains it"
        more = "check that rows and readings are of the same poses, the URDF this arm's, the tip the target's link"
        raise ConventionError(f"{text}; {more}, and for two conventions at once", [])
    far = [i for i, (kind, _) in enumerate(found.view.readings.placed) if kind.name and found.scatter[i] > ABSURD]
    return tuple(_implausible(found.view, found.view.readings.kinds[i]) for i in far)


def _begun(found: Misfit | None) -> str:
    if found is None:
        return "the arm has no equilibrium at these rows as they are declared"
    sensors = ", ".join(kind.title for kind in found.view.readings.kinds if kind.name and kind.name in found.suspects)
    off = f"readings are {said_of(found.placed, found.view.readings.unit)} off the arm"
    if not found.excess_at_tip and isinstance(found.view.readings.kinds[-1], Orientation):
        off = f"orientations are {found.said('orientation')} off the arm"
    return f"{off}{f' ({sensors})' if sensors else ''}, further than [prior] explains"


def _implausible(view: View, kind: Kind) -> Flag:
    """Return the flag about a sensor whose readings nothing explains."""
    read = np.flatnonzero(np.isfinite(kind.sigma).all(axis=1))
    off = float(np.median(np.linalg.norm(kind.some(read).residual(view.at.some(read)), axis=1)))
    text = (
        f"{kind.title}: what it read is {said_of(off, kind.unit)} off, further than its declaration and [prior] explain"
    )
    return Flag("instrument_implausible", f"{text}: is it where [instrument.{kind.name}] says?", about=kind.name)


def _named(
    arm: Arm, measurements: Measurements, rows: np.ndarray, keep: bool, searched: bool, found: Misfit | None
) -> list[Named]:
    """Return the hypotheses whose odds against the campaign as written are beyond `NAMED`, the likeliest first."""
    tried = list(_candidates(arm, measurements, rows, found, keep))
    if found is not None and not found.free and not keep and not searched:
        prior = replace(USUAL_PRIOR, session_target=arm.prior.session_target)
        more = (
            "there is nothing to fit: give it joint_offset, compliance, tool or geometry, one standard deviation each"
        )
        freed = Hypothesis("[prior] frees nothing", more, lambda arm, one: (replace(arm, prior=prior), one))
        tried.append((freed, None))
    cost, named = NOTHING if found is None else found.cost, dict[str, Named]()
    for hypothesis, some in tried:
        with suppress(ArmflexError):
            one, rewritten = _written(hypothesis, arm, measurements, some)
            near = found.view.setup.instrument if found is not None and hypothesis.of == "loads" else None
            same = _at_rest(arm, measurements, one, rewritten, found)
            other = misfit(one, rewritten, rows, keep, same, near)
            gain = cost - other.cost
            if (
                hypothesis.slip is not None and hypothesis.of not in arm.sensors
            ):  # an arm that slips as far explains as much
                gain = min(gain, 0.5 * (hypothesis.slip / SLIP) ** 2)
            gain -= hypothesis.prior + _choice(measurements, some, rows)
            if gain > NAMED:
                said, name = other.said(hypothesis.of), hypothesis.name
                name += _in_words(measurements, some, rows)
                if name not in named or named[name].gain < gain:
                    named[name] = Named(hypothesis, name, gain, said)
    ranked = sorted(named.values(), key=lambda one: -one.gain)
    return [one for one in ranked if one.gain > ranked[0].gain - NAMED / 4.0][:MOST_SAID]


def _written(hypothesis: Hypothesis, arm: Arm, measurements: Measurements, some: np.ndarray | None) -> Written:
    """Return the arm and the campaign as they were meant in (N,) some of the rows, in all where None."""
    one, rewritten = hypothesis.rewritten(arm, measurements)
    if some is None:
        return one, rewritten
    pairs = zip(measurements.readings.kinds, rewritten.readings.kinds, strict=True)
    kinds = tuple(
        replace(
            kind,
            values=np.where(some[:, None], other.values, kind.values),
            sigma=np.where(some[:, None], other.sigma, kind.sigma),
        )
        for kind, other in pairs
    )
    named = zip(measurements.payload, rewritten.payload, some.tolist(), strict=True)
    payload = tuple(new if own else old for old, new, own in named)
    q = np.where(some[:, None], rewritten.q, measurements.q)
    return one, replace(rewritten, q=q, payload=payload, readings=replace(measurements.readings, kinds=kinds))


def _at_rest(arm: Arm, measurements: Measurements, one: Arm, other: Measurements, found: Misfit | None) -> View | None:
    """Return the view of rows in which another arm rests as this one does, None where it may not."""
    same = all(getattr(arm, name) is getattr(one, name) for name in ("robot", "flexures", "payloads", "effects"))
    same = same and np.array_equal(measurements.q, other.q) and measurements.payload == other.payload
    return found.view if found is not None and same else None


def _choice(measurements: Measurements, some: np.ndarray | None, rows: np.ndarray) -> float:
    """Return what it costs to say in which rows a hypothesis holds: one of the sessions, or each row by itself."""
    if some is None:
        return 0.0
    sessions = np.array(measurements.session)
    if len(set(sessions[some])) == 1 and some.sum() == (sessions == sessions[some][0]).sum():
        return float(np.log(len(set(sessions))))
    share = float(np.clip(some[rows].mean(), 1e-3, 1.0 - 1e-3))
    return -LOOKS / 3.0 * (share * np.log(share) + (1.0 - share) * np.log(1.0 - share))


def _in_words(measurements: Measurements, some: np.ndarray | None, rows: np.ndarray) -> str:
    """Return in which rows a hypothesis holds, '' where in all."""
    if some is None:
        return ""
    own = rows[some[rows]]
    names = sorted({measurements.session[row] for row in own})
    if len(names) == 1 and some.sum() == measurements.session.count(names[0]):
        return f" in session {names[0]!r}"
    where = measurements.places[own[0]].short if measurements.places else f"row {own[0]}"
    return f" in some rows ({100.0 * len(own) / len(rows):.0f} %, the first {where})"


def _candidates(
    arm: Arm, measurements: Measurements, rows: np.ndarray, found: Misfit | None, keep: bool
) -> Iterator[tuple[Hypothesis, np.ndarray | None]]:
    """Yield what is worth being judged: a hypothesis, and (N,) in which rows it holds, None for all.

    Hypotheses that move points by parts of the reach have to bring them nearer to their places, rigid and nothing
    fitted, or they explain nothing: of many the most promising are judged.
    """
    suspects = ("",) if found is None else found.suspects
    every = list(hypotheses(arm, measurements, suspects))
    if found is not None:
        every += [one for one in _moves(measurements, rows, found)]
    tip = found is None or found.excess_at_tip > NAMED or found.scatter[:1].min(initial=1.0) < 1.0 / ABSURD
    tracked = bool(measurements.positioned[rows].all())
    turned = [one for one in every if one.of == "orientation"]
    yield from ((one, None) for one in _likeliest_turns(turned, arm, measurements, rows, found))
    points = [one for one in every if one.of == "points" and one.slip is None]
    if tip and tracked:
        yield from _first_look(points, arm, measurements, rows, found)
    elif tip:
        yield from ((one, None) for one in points)
    for one in every:
        if one.of == "loads" and tip:
            yield one, None
            if one.some and found is not None:
                for some in _rows_of(one, arm, measurements, rows, found, keep):
                    yield one, some
        elif one.of not in ("points", "loads", "orientation") or one.slip is not None:
            yield one, None


def _first_look(
    points: Sequence[Hypothesis], arm: Arm, measurements: Measurements, rows: np.ndarray, found: Misfit | None
) -> Iterator[tuple[Hypothesis, np.ndarray | None]]:
    """Yield the hypotheses about joints and positions that bring points nearest to their places, in all rows or some."""

    def at(arm: Arm, campaign: Measurements) -> tuple[Array, Array]:
        rigid, target = arm.loaded(None), (arm.instrument or Instrument()).target
        tips = rigid_tips(rigid.nominal or rigid.chain, campaign.q[rows])
        return tips[:, :3, 3] + tips[:, :3, :3] @ target, campaign.position[rows]

    def off(points: Array, seen: Array, unknown: bool) -> tuple[float, Array]:
        there = points
        if unknown:
            turn, shift, _ = rigid_fit(points, seen)
            there = points @ turn.T + shift
        elif arm.instrument is not None:
            there = arm.instrument.seen(points)
        squares = ((seen - there) ** 2).sum(axis=1)
        least = max(float(np.median(squares)) / 3.0, (FINE * arm.robot.reach) ** 2)
        parts = 0.5 * (TAILS + 3.0) * np.log1p(squares / least / TAILS) + 1.5 * np.log(least)
        return LOOKS / 3.0 * float(parts.mean()), squares

    unknown, here = arm.measurement.frame != "base", at(arm, measurements)
    before, squares = off(*here, unknown)
    sessions = np.array([measurements.session[row] for row in rows])
    names = [
        name for name in dict.fromkeys(sessions.tolist()) if found is None or found.excess_in(sessions == name) > NAMED
    ]
    names = names if len(set(sessions.tolist())) > 1 else []
    looked: list[tuple[float, int, Hypothesis, np.ndarray | None]] = []
    for hypothesis in points:
        one, rewritten = hypothesis.rewritten(arm, measurements)
        there, anywhere_ = at(one, rewritten), one.measurement.frame != "base"
        if one.measurement is arm.measurement and all(np.array_equal(a, b) for a, b in zip(here, there, strict=True)):
            yield hypothesis, None  # it moves no point: sigma, say
            continue
        looked.append((off(*there, anywhere_)[0] + hypothesis.prior, len(looked), hypothesis, None))
        masks = [(sessions == name, np.array(measurements.session) == name) for name in names]
        if hypothesis.some:
            own = np.zeros(len(rows), bool)
            now = squares
            for _ in range(3):  # which rows are nearer to their places when rewritten, instrument placed by the rest
                mixed = [np.where(own[:, None], b, a) for a, b in zip(here, there, strict=True)]
                fitted = rigid_fit(*mixed)[:2] if unknown else None
                now, then = (_squares(a, b, fitted, arm) for a, b in (here, there))
                own = 4.0 * then < now
            if 0 < own.sum() < len(rows):
                masks.append((own, np.isin(np.arange(len(measurements)), rows[own])))
        for own, whole in masks if hypothesis.some else ():
            mixed = [np.where(own[:, None], b, a) for a, b in zip(here, there, strict=True)]
            looked.append(
                (off(mixed[0], mixed[1], unknown)[0] + hypothesis.prior + 2.0, len(looked), hypothesis, whole)
            )
    looked.sort(key=lambda one: one[:2])
    yield from ((one, some) for cost, _, one, some in looked[:MOST_TRIED] if cost < before)


def _squares(points: Array, seen: Array, fitted: tuple[Array, Array] | None, arm: Arm) -> Array:
    """Return the (M,) squared distances of (M, 3) points from where they were seen [m^2]."""
    known = (arm.instrument or Instrument()).seen(points)
    there = known if fitted is None else points @ fitted[0].T + fitted[1]
    return ((seen - there) ** 2).sum(axis=1)


def _likeliest_turns(
    turned: Sequence[Hypothesis], arm: Arm, measurements: Measurements, rows: np.ndarray, found: Misfit | None
) -> list[Hypothesis]:
    """Return the hypotheses about orientations after which a target is turned on the tool alike in most rows."""
    if found is None or not turned:
        return []
    view, spread = found.view, []
    axes = view.at.axes @ view.line.tip[:, :3, :3]
    for hypothesis in turned:
        kind = hypothesis.rewritten(arm, measurements)[1].some(rows).readings.of(Orientation)
        assert kind is not None
        read = np.isfinite(kind.sigma).all(axis=1)
        mounted = axes[read].swapaxes(1, 2) @ Rotation.from_rotvec(kind.values[read]).as_matrix()
        left, _, right = np.linalg.svd(np.median(mounted, axis=0))
        spread.append(float(np.median(((mounted - left @ right) ** 2).sum(axis=(1, 2)))))
    return [turned[i] for i in np.argsort(spread, kind="stable")[: MOST_SAID + 1]]


def _rows_of(
    hypothesis: Hypothesis, arm: Arm, measurements: Measurements, rows: np.ndarray, found: Misfit, keep: bool
) -> Iterator[np.ndarray]:
    """Yield (N,) rows in which a hypothesis about loads may hold: where less is left of the readings with it."""
    open_ = np.flatnonzero(
        np.array(measurements.payload) != np.array(hypothesis.rewritten(arm, measurements)[1].payload)
    )
    open_ = np.isin(rows, open_)
    own, fitted = np.zeros(len(rows), bool), found
    for _ in range(3):
        some = np.isin(np.arange(len(measurements)), rows[own])
        flipped = np.isin(np.arange(len(measurements)), rows[open_ & ~own])
        with suppress(ArmflexError):
            here = _written(hypothesis, arm, measurements, some)
            there = _written(hypothesis, arm, measurements, some | flipped)
            if own.any():
                fitted = misfit(*here, rows, keep)
            setup = replace(fitted.view.setup, arm=replace(fitted.view.setup.arm, payloads=arm.payloads))
            other = look(setup, there[1], rows).residual - look(setup, here[1], rows).residual
            where = fitted.view.foremost
            back = look(setup, measurements, rows).residual - look(setup, here[1], rows).residual
            left = fitted.left[:, where]
            sizes = [((left + step[:, where]) ** 2).sum(axis=1) for step in (0.0 * other, other, back)]
            own = open_ & np.where(own, sizes[0] < sizes[2], sizes[1] < sizes[0])
        if not own.any():
            return
    yield np.isin(np.arange(len(measurements)), rows[own])


def _moves(measurements: Measurements, rows: np.ndarray, found: Misfit) -> Iterator[Hypothesis]:
    """Yield the likeliest hypothesis of each instrument, and of the target, that it was moved at some row.

    What is left of the readings, in the axes of what was moved, is then one constant before and another after.
    """
    view, sessions = found.view, np.array([measurements.session[row] for row in rows])
    for number, (kind, place) in enumerate(view.readings.placed):
        if isinstance(kind, Orientation) or found.rows[:, number].sum() < NAMED:
            continue
        read = np.isfinite(kind.sigma).all(axis=1)
        away = kind.some(np.flatnonzero(read)).elsewhere(view.at.some(np.flatnonzero(read)))
        if away is not None:
            yield elsewhere(view.arm.sensors[kind.name], f"{kind.title}: {away}")
        left = found.left[:, place]
        kinds = [(kind.name, kind.title if kind.name else "the instrument", left, sessions)]
        if not kind.name:
            tip = (view.at.axes @ view.line.tip[:, :3, :3]).swapaxes(1, 2)
            kinds.append(("target", "the target", np.einsum("nij,nj->ni", tip, left), np.zeros(len(rows))))
        for name, title, motion, within in kinds:
            if name and name != "target" and not len(view.arm.sensors[name].movable):
                continue
            best: tuple[float, np.ndarray, Array] | None = None
            for one in dict.fromkeys(within.tolist()):
                own = np.flatnonzero((within == one) & read)
                for k in range(3, len(own) - 2):
                    before, after = motion[own[:k]], motion[own[k:]]
                    step = np.median(after, axis=0) - np.median(before, axis=0)
                    gain = float(k * (len(own) - k) / len(own) * (step**2).sum())
                    if best is None or gain > best[0]:
                        best = gain, own[k:], step
            least = 0.0 if name in view.arm.sensors else NAMED
            if best is not None and 0.5 * (np.linalg.norm(best[2]) / SLIP) ** 2 > least:
                first, last = rows[best[1][0]], rows[best[1][-1]]
                whole = np.arange(len(measurements))
                late = (whole >= first) & ((whole <= last) | (name == "target"))
                if name != "target":
                    late &= np.array(measurements.session) == measurements.session[first]
                start = measurements.places[first].short if measurements.places else f"row {first}"
                yield from moved(name, title, start, late, best[2])


def beyond_priors(found: Fit) -> Iterator[Flag]:
    """Yield a flag where several fitted values are absurdly far outside their priors."""
    pulls = np.where(np.isfinite(found.prior), np.abs(found.values) / found.prior, 0.0)
    known = [one.group.kind is not ParameterKind.LAW for one in found.parameters]
    far = [int(i) for i in np.argsort(-pulls) if known[i] and pulls[i] > ABSURD]
    if len(far) > 1:
        said = ", ".join(f"{found.parameters[i].label} by {pulls[i]:.0f} prior standard deviations" for i in far[:3])
        text = f"{len(far)} values are absurdly far from what was declared ({said})"
        yield Flag("beyond_priors", f"{text}: units, conventions and priors are more likely wrong than the arm is")


def wrong_sigma(found: Fit, about: Sequence[Flag] = ()) -> Iterator[Flag]:
    """Yield flags about sensors whose stated standard deviation cannot be meant, by how they scatter.

    One scatters more than stated where the arm lacks something, too, but then so do others by as much.

    Args:
        found: The fit, each instrument weighed by its scatter.
        about: Flags on sensors that are implausible for another reason.
    """
    readings, suspects = found.view.readings, {flag.about for flag in about}
    for number, (name, scatter) in enumerate(zip(readings.names, found.scatters, strict=True)):
        others = [one for i, one in enumerate(found.scatters) if i != number]
        large = others and scatter > ABSURD * max(1.0, min(others))
        small = found.noises[number][1] >= ABSURD and scatter < 1.0 / ABSURD
        if name and name not in suspects and (large or small):
            kind = next(kind for kind in readings.kinds if kind.name == name)
            place = next(own for one, own in readings.placed if one is kind)
            stated = float(np.median(found.stated[:, place][np.isfinite(kind.sigma)]))
            seen = f"{said_of(stated, kind.unit)}, and its readings scatter by {said_of(scatter * stated, kind.unit)}"
            ask = "is it stated in the right unit, or does the arm lack what this instrument alone sees?"
            ask = ask if large else "is it stated in the right unit?"
            text = f"{kind.title}: its sigma is {seen}, {scatter:.2g} times as much: {ask}"
            yield Flag("sigma_implausible", text, about=name)


def scattered(found: Fit) -> tuple[Flag, ...]:
    """Return flags about instruments that scatter about a fit `SCATTERED` times as far as they state, or further."""
    flags = []
    for name, scatter in zip(found.view.readings.names, found.scatters, strict=True):
        if scatter > SCATTERED:
            kind, place = next((one, own) for one, own in found.view.readings.placed if one.name == name)
            stated = float(np.median(found.stated[:, place][np.isfinite(kind.sigma)]))
            text = f"{kind.title}: readings scatter by {said_of(scatter * stated, kind.unit)} about the fitted arm, "
            text += f"{scatter:.0f} times the {said_of(stated, kind.unit)} that they state"
            flags.append(Flag("scattered", f"{text}: sigma, or a convention, is wrong, or the arm lacks much"))
    return tuple(flags)


def check_scatter(found: Fit) -> None:
    """Raise `ConventionError` where readings are `scattered`, before anything is written that rests on them."""
    if flags := scattered(found):
        raise ConventionError(flags[0].text, ["readings scatter"])
