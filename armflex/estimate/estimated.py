"""Conventions with a number in them, which the readings say: a unit, a zero, a coupling, a rail, a second tool.

A family of conventions rewrites joint positions as q A + b, with A and b of one or two numbers. The rigid arm is
placed with its target free; where the numbers leave least of the readings they are refined, and then named by the
nearest unit, zero or ratio that people use. What is yielded is a hypothesis like every other: `misread` judges it.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import permutations, product

import numpy as np

from armflex.conventions import LOGGED_ANGLES, LOGGED_LENGTHS, RESOLUTION, ROUND, UNITS, Array
from armflex.errors import FEW, listing
from armflex.estimate.misreadings import USUAL_PRIOR, Misreading, joints_as
from armflex.estimate.seen_rows import SeenRows
from armflex.estimate.view import LARGEST_MOTION
from armflex.measured.measurements import Measurements
from armflex.readings import Position

HEADERS = {"degrees": "deg", "mrad": "mrad", "mm": "mm", "cm": "cm", "um": "um"}
"""Units that a header can state."""


Called = tuple[Array, str, str, int]
Map = Callable[[Array], tuple[Array, Array]]
"""Numbers -> A (nq, nq) and b (nq,): q A + b is meant."""


@dataclass(frozen=True, eq=False)
class Family:
    """Conventions that differ in one or two numbers.

    Attributes:
        map: See there.
        starts: Numbers to begin from.
        named: Of refined numbers, those that people use within such a part of them, the name, the remedy, and the
            mistakes that it takes; None where nobody uses such numbers.
    """

    map: Map
    starts: Sequence[Array]
    named: Callable[[Array, float], Called | None]


@dataclass(frozen=True, eq=False)
class FittedFamily:
    """A family at the numbers that readings give it, what it then costs, and the convention that this is."""

    family: Family
    numbers: Array
    cost: float
    misreading: Misreading

    @property
    def by(self) -> Array:
        """(nq, nq) A of the positions that are meant, q A + b."""
        return self.family.map(self.numbers)[0]

    @property
    def shift(self) -> Array:
        """(nq,) b of them."""
        return self.family.map(self.numbers)[1]


def estimated(seen: SeenRows, every: Measurements) -> Iterator[Misreading]:
    """Yield the conventions that bring a campaign's positions near those of the rigid arm.

    Args:
        seen: The rows of one session to look at, a few of them.
        every: The whole campaign.
    """
    with np.errstate(all="ignore"):
        yield from _rails(seen, every)
        yield from _columns(seen, every)


def _columns(seen: SeenRows, every: Measurements) -> Iterator[Misreading]:
    """Yield the likeliest of the families, each refined, and of several at once where one alone leaves much."""
    left = seen.placed(seen.q[None]).left[0, 0]
    if _is_near(seen, left):
        return
    before = float(seen.cost(left))
    units = {joint.name: every.units.get(f"q_{joint.name}", "") for joint in seen.arm.robot.moving}
    families = _fitted(seen, [*_scales(seen, units), *_couplings(seen), *_homes(seen)], before)
    yield from (fitted.misreading for fitted in families)
    for _ in range(FEW - 1):
        if not families:
            return
        first = families[0]
        after = replace(seen, q=seen.q @ first.by + first.shift)
        if _is_near(seen, seen.placed(after.q[None]).left[0, 0]):
            return
        further = _fitted(after, [*_couplings(after), *_homes(after)], first.cost)
        # What one alone is estimated at makes up for the other.
        pairs = _fitted(seen, [_both(first, other) for other in further], first.cost)
        yield from (fitted.misreading for fitted in pairs[:1])


def _is_near(seen: SeenRows, left: Array) -> bool:
    """Return whether what is left (M, 3) is no more than an arm lacks [m]."""
    return float(np.median(np.linalg.norm(left, axis=1))) < USUAL_PRIOR.joint_offset * seen.arm.robot.reach


def _both(first: FittedFamily, other: FittedFamily) -> Family:
    """Return the family of two, the second one of positions that the first has rewritten."""
    apart = len(first.numbers)

    def map_(numbers: Array) -> tuple[Array, Array]:
        (by, shift), (more, further) = first.family.map(numbers[:apart]), other.family.map(numbers[apart:])
        return by @ more, shift @ more + further

    def named(numbers: Array, alike: float) -> Called | None:
        name_first, last = first.family.named(numbers[:apart], alike), other.family.named(numbers[apart:], alike)
        if name_first is None or last is None:
            return None
        both = np.concatenate([name_first[0], last[0]])
        return both, f"{name_first[1]}, and {last[1]}", f"{name_first[2]}; {last[2]}", name_first[3] + last[3]

    return Family(map_, [np.concatenate([first.numbers, other.numbers])], named)


def _fitted(seen: SeenRows, families: Sequence[Family], before: float) -> list[FittedFamily]:
    """Return the likeliest families refined, the best first."""
    from scipy.optimize import least_squares  # not needed to import the package

    def left(family: Family, numbers: Array) -> Array:
        by, shift = family.map(numbers)
        return seen.placed((seen.q @ by + shift)[None]).left[0, 0]

    begun = [(number, place) for number, family in enumerate(families) for place in range(len(family.starts))]
    q = [seen.q @ by + shift for by, shift in (families[i].map(families[i].starts[place]) for i, place in begun)]
    costs = seen.cost(seen.placed(np.array(q)).left[:, 0]).tolist() if q else []
    looked = [(cost, *start) for cost, start in zip(costs, begun, strict=True)]
    likely, fits = dict[int, int](), list[FittedFamily]()
    for cost, number, place in sorted(looked):
        if cost < before - 1.0 and len(likely) < 2 * FEW:
            likely.setdefault(number, place)
    for number, place in likely.items():
        family, start = families[number], families[number].starts[place]
        size, scale = np.maximum(np.abs(start), 0.1), max(float(np.median(np.abs(left(family, start)))), RESOLUTION)

        def errors(numbers: Array, family: Family = family, size: Array = size, scale: float = scale) -> Array:
            return left(family, numbers * size).ravel() / scale

        refined = size * least_squares(errors, start / size, loss="soft_l1", diff_step=1e-5, max_nfev=20).x
        least = float(seen.cost(left(family, refined)))
        for alike in (10.0 * ROUND, ROUND):  # what else is wrong in the campaign bends the numbers
            if (called := family.named(refined, alike)) is None:
                continue
            numbers, name, remedy, mistakes = called
            by, shift = family.map(numbers)
            if (cost := float(seen.cost(left(family, numbers)))) < least + 1.0 or alike == ROUND:
                hypothesis = Misreading(name, remedy, joints_as(by, shift), mistakes=mistakes, whole=True)
                fits.append(FittedFamily(family, numbers, cost, hypothesis))
                break
    return sorted(fits, key=lambda fitted: fitted.cost + fitted.misreading.mistakes)[:FEW]


def _steps(travel: float, least: float, most: float) -> list[Array]:
    """Return units in which a joint travels so far, a ninth apart: refining goes on from there."""
    return [np.array([step]) for step in np.geomspace(least, most, 40) / max(travel, RESOLUTION)]


def _diagonal(which: np.ndarray, gain: Array | float = 1.0, zero: Array | float = 0.0) -> Map:
    """Return the map of some of the joints to q times a number and a gain, from a zero."""
    return lambda numbers: (np.diag(np.where(which, gain * numbers[0], 1.0)), np.where(which, zero, 0.0))


def _scales(seen: SeenRows, units: dict[str, str]) -> Iterator[Family]:
    """Yield the families of a unit, with a zero: of all turning joints, of each joint alone, of parts of the limits."""
    robot, spread = seen.arm.robot, np.ptp(seen.q, axis=0)
    turns = np.array([joint.kind != "prismatic" for joint in robot.moving])
    turned = (0.1, 7.0)  # rad that the most travelled joint of a campaign travels
    if turns.sum() > 1 and spread[turns].max() > RESOLUTION:
        head = next(units[joint.name] for joint, is_turn in zip(robot.moving, turns, strict=True) if is_turn)
        steps = _steps(float(spread[turns].max()), *turned)
        yield from _together(seen, turns, steps, head)
        yield from _counted(seen, turns, steps, head)
    for i in np.flatnonzero(spread >= RESOLUTION):
        joint = robot.moving[i]
        travel = joint.upper - joint.lower if np.isfinite([joint.lower, joint.upper]).all() else 2.0
        most = 3.0 * max(travel, LARGEST_MOTION)
        steps = _steps(float(spread[i]), *(turned if turns[i] else (most / 100.0, most)))
        name = partial(_named_unit, f"q_{joint.name}", units[joint.name], bool(turns[i]))
        yield Family(_diagonal(np.arange(len(turns)) == i), steps, name)


def _named_unit(column: str, head: str, turns: bool, numbers: Array, alike: float) -> Called:
    """Return the convention that one column is in another unit than `head`."""
    by = UNITS["angle" if turns else "length"].get(head, 1.0)
    value, unit = _unit(numbers[0] * by, LOGGED_ANGLES if turns else LOGGED_LENGTHS, alike)
    by_hand = f"convert it: {value / by:.9g} {column} {head or ('rad' if turns else 'm')}"
    return np.array([value / by]), f"{column} is in {unit}", _header(unit, column, head) or by_hand, 1


TURNING = "the turning joints are"


def _together(seen: SeenRows, turns: np.ndarray, steps: Sequence[Array], head: str) -> Iterator[Family]:
    """Yield the families of one unit of all turning joints, from zero, the limits or their middle, and of parts."""
    robot, names = seen.arm.robot, [joint.name for joint in seen.arm.robot.moving]
    written = UNITS["angle"].get(head, 1.0)

    def of_unit(zero: Array | float, words: str, more: str) -> Family:
        def named(numbers: Array, alike: float) -> Called:
            value, unit = _unit(numbers[0] * written, LOGGED_ANGLES, alike)
            value /= written
            remedy = _header(unit, "q_...", head) or f"convert them: q = {value:.9g} q {head or 'rad'}"
            wrong = [f"in {unit}"] if abs(value - 1.0) > ROUND else []
            remedy = "; ".join(part for part in (remedy if wrong else "", more) if part)
            wrong += [words] if words else []
            return np.array([value]), f"{TURNING} {', '.join(wrong)}", remedy, max(len(wrong), 1)

        return Family(_diagonal(turns, zero=zero), steps, named)

    yield of_unit(0.0, "", "")
    if not np.isfinite([robot.lower[turns], robot.upper[turns]]).all():
        return
    limited = np.isfinite(robot.lower) & np.isfinite(robot.upper)
    lower, upper = np.where(limited, robot.lower, -1.0), np.where(limited, robot.upper, 1.0)
    middle, half = 0.5 * (lower + upper), 0.5 * (upper - lower)
    for zero, what, least in ((middle, "the middle of their limits", ROUND), (lower, "their lower limits", -1.0)):
        shifts = [f"{by:+.4g} to q_{name}" for name, by in zip(names, zero, strict=True) if abs(by) > least]
        if (np.abs(zero[turns]) > least).any():
            yield of_unit(zero, f"counted from {what}", f"add {listing(shifts)} [rad]")
    for zero, low in ((middle, -1.0), (lower, 0.0)):
        whole = 1.0 if low else 2.0

        def named(numbers: Array, alike: float, low: float = low, whole: float = whole) -> Called | None:
            round_ = 10.0 ** round(np.log10(abs(whole / numbers[0])))
            if abs(round_ / (whole / numbers[0]) - 1.0) > ROUND:
                return None
            text = f"{TURNING} parts of their limits, {low * round_:g} to {round_:g}"
            parts = f"(q {-low * round_:+g}) / {round_ - low * round_:g}"
            return np.array([whole / round_]), text, f"convert them: q = lower + (upper - lower) {parts}", 1

        yield Family(_diagonal(turns, half, zero), [step * 0.5 / np.median(half[turns]) for step in steps], named)


def _counted(seen: SeenRows, turns: np.ndarray, steps: Sequence[Array], head: str) -> Iterator[Family]:
    """Yield the family of counts from a zero that all turning joints have in common."""
    written, centre = UNITS["angle"].get(head, 1.0), float(np.median(seen.q[:, turns]))
    if abs(centre) <= ROUND * np.ptp(seen.q, axis=0)[turns].max():
        return

    def from_count(numbers: Array) -> tuple[Array, Array]:
        scale, zero = numbers
        return np.diag(np.where(turns, scale, 1.0)), np.where(turns, -scale * zero, 0.0)

    def named(numbers: Array, alike: float) -> Called:
        value, unit = _unit(numbers[0] * written, LOGGED_ANGLES, alike)
        zero = _round_zero(numbers[1] / written, 2.0 * np.pi / value)
        remedy = f"convert them: q = {value / written:.9g} (q - {zero:.6g}) {head or 'rad'}"
        return np.array([value / written, zero * written]), f"{TURNING} in {unit}, with zero at {zero:.6g}", remedy, 2

    yield Family(from_count, [np.array([step[0], centre]) for step in steps], named)


def _couplings(seen: SeenRows) -> Iterator[Family]:
    """Yield the families in which a joint is counted with a part of another one's position."""
    robot, count = seen.arm.robot, seen.q.shape[1]
    turning = [i for i, joint in enumerate(robot.moving) if joint.kind != "prismatic"]
    for i, j in permutations(turning, 2):
        master, other = robot.moving[i].name, robot.moving[j].name

        def map_(numbers: Array, i: int = i, j: int = j) -> tuple[Array, Array]:
            by = np.eye(count)
            by[i, j] = numbers[0]
            return by, np.zeros(count)

        def named(
            numbers: Array, alike: float, one: str = master, other: str = other, beside: bool = turning[1:3] == [i, j]
        ) -> Called:
            share = float(numbers[0])
            share = next(
                (ratio for ratio in (1.0, -1.0, 0.5, -0.5, 2.0, -2.0) if abs(share / ratio - 1.0) < alike), share
            )
            part = "" if abs(share) == 1.0 else f"{abs(share):.4g} "
            how = "taken off" if share > 0.0 else "added"
            sum_ = f"{other} = q_{other} {'+' if share > 0.0 else '-'} {part}q_{one}"
            note = ", as in Fanuc's J2/J3 coupling" if beside and share == 1.0 else ""
            note = ", the opposite of Fanuc's J2/J3 coupling" if beside and share == -1.0 else note
            text = f"q_{other} is counted with {part}q_{one} {how} ({sum_}{note})"
            return np.array([share]), text, f"write {sum_} into the column", 1

        yield Family(map_, [np.array([share]) for share in (1.0, -1.0, 0.5, -0.5)], named)


def _homes(seen: SeenRows) -> Iterator[Family]:
    """Yield the families in which one turning joint's zero is somewhere else, its sign as it is or turned."""
    robot, count = seen.arm.robot, seen.q.shape[1]
    for (i, joint), sign in product(enumerate(robot.moving), (1.0, -1.0)):
        if joint.kind == "prismatic":
            continue
        by = np.diag(np.where(np.arange(count) == i, sign, 1.0))

        def map_(numbers: Array, i: int = i, by: Array = by) -> tuple[Array, Array]:
            return by, np.where(np.arange(count) == i, numbers[0], 0.0)

        def named(numbers: Array, alike: float, name: str = joint.name, turned: bool = sign < 0.0) -> Called:
            degrees = (float(np.degrees(numbers[0])) + 180.0) % 360.0 - 180.0
            near = 5.0 * round(degrees / 5.0)
            degrees = near if abs(degrees - near) < np.degrees(ROUND) and (near or turned) else round(degrees, 1)
            wrong, remedy = [f"the sign of q_{name} is turned"] * turned, [f"turn the signs of q_{name}"] * turned
            if degrees or not turned:
                wrong.append(f"the home position of {name} is {degrees:+g} degrees from the URDF's")
                remedy.append(f"add {degrees:+g} degrees to q_{name}, or turn the joint's origin in the URDF")
            mistakes = turned + 2 * bool(degrees or not turned)
            return np.array([np.radians(degrees)]), " and ".join(wrong), ", then ".join(remedy), mistakes

        near = (-8, -4, -2, 2, 4, 8)  # each nearer to what it may be than 0 is
        degrees = [*range(-165, 181, 15)] if sign < 0.0 else [*range(-165, 0, 15), *near, *range(15, 181, 15)]
        yield Family(map_, [np.radians([degree]) for degree in degrees], named)


def _unit(value: float, units: dict[str, float], alike: float) -> tuple[float, str]:
    """Return a unit's value [rad or m] and its name, of the nearest that people use, else the value as it is."""
    name = min(units, key=lambda unit: abs(np.log(units[unit] / abs(value))))
    if abs(units[name] / value - 1.0) < alike:
        return units[name], name
    if units is LOGGED_LENGTHS or not 1e-9 < abs(value) < np.pi / 200.0:  # finer than any encoder's, or coarser
        return value, f"a unit of {value:.4g} {'m' if units is LOGGED_LENGTHS else 'rad'}"
    count = 2.0 * np.pi / value
    power, digits = 2.0 ** round(np.log2(abs(count))), float(f"{abs(count):.2g}")
    near = min((power, digits), key=lambda whole: abs(np.log(whole / abs(count))))
    near = near if abs(near / abs(count) - 1.0) < ROUND else round(abs(count))
    return 2.0 * np.pi / near, f"ticks, {near:g} a turn"


def _round_zero(zero: float, count: float) -> float:
    """Return the share of a turn's `count` that a zero is at, if it is one, else the zero as it is."""
    share = round(8.0 * zero / count) / 8.0
    return share * count if abs(zero - share * count) < ROUND / (2.0 * np.pi) * count else zero


def _header(unit: str, column: str, written: str) -> str:
    """Return the remedy of a unit that a header states, '' where it states none."""
    if written and unit in ("radians", "m"):
        return f"take _{written} from the header"
    return f"write {column}_{HEADERS[unit]} into the header" if unit in HEADERS and not written else ""


def _rails(seen: SeenRows, every: Measurements) -> Iterator[Misreading]:
    """Yield that the arm rides on a rail whose place is in a column of numbers, or on two or three of them."""
    numbers = {name: values for name, values in every.covariates.items() if not isinstance(values, tuple)}
    before = seen.placed(seen.q[None])
    base = float(seen.cost(before.left[0, 0]))
    looked = list[tuple[float, str]]()
    for name, values in numbers.items():
        column = values[seen.rows][:, None]
        if np.ptp(column) > RESOLUTION * max(1.0, float(np.abs(column).max())):
            looked.append((float(seen.cost(seen.placed(seen.q[None], column - column.mean()).left[0, 0])), name))
    looked = [pair for pair in sorted(looked) if pair[0] < base - 0.1][:FEW]
    chosen: list[str] = []
    placed, cost = before, base
    for _, name in looked:
        columns = np.column_stack(
            [numbers[column][seen.rows] - numbers[column][seen.rows].mean() for column in (*chosen, name)]
        )
        other = seen.placed(seen.q[None], columns)
        if (nearer := float(seen.cost(other.left[0, 0]))) < cost - 0.3:
            chosen, placed, cost = [*chosen, name], other, nearer
    if not chosen:
        return
    said, steps = [], []
    for name, step in zip(chosen, placed.shifts[0, 0], strict=True):
        size = float(np.linalg.norm(step))
        value, unit = _unit(max(size, 1e-300), LOGGED_LENGTHS, ROUND)
        travel = size * float(np.ptp(numbers[name][seen.rows]))
        if unit not in LOGGED_LENGTHS or travel < LARGEST_MOTION * seen.arm.robot.reach:
            return
        along = ", ".join(f"{part:g}" for part in np.round(placed.turn[0, 0].T @ step / size, 3) + 0.0)
        said.append(f"column {name} moves the arm by 1 {unit} per unit along ({along}) of its base")
        steps.append(step / size * value)
    offset = [float(numbers[name][seen.rows].mean()) for name in chosen]

    def back(rows: Measurements) -> Measurements:
        places = [np.asarray(rows.covariates[name]) - mean for name, mean in zip(chosen, offset, strict=True)]
        ridden = sum(np.outer(place, step) for place, step in zip(places, steps, strict=True))
        position = rows.readings.of(Position)
        kinds = tuple(
            replace(kind, values=kind.values - ridden) if kind is position else kind for kind in rows.readings.kinds
        )
        return replace(rows, readings=replace(rows.readings, kinds=kinds))

    text = f"the arm stands on a rail: {listing(said)}"
    remedy = f"declare it in the URDF, a prismatic joint below the base, and call {listing(chosen)} q_ and its name"
    yield Misreading(text, remedy, back, whole=True)
