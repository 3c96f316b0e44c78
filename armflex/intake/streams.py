"""Where an arm stood still in a recording, what was read there, and how far apart two clocks are."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import pairwise

import numpy as np

from armflex.conventions import Array
from armflex.errors import FEW, InputError, listing
from armflex.intake.sources import Cells, Source, numbers

DENSE = 0.25
"""Median step [s] up to which rows are samples of a recording, and not one row for each pose."""

SLOWEST = 2.0
"""Median step [s] up to which rows still are samples, where standing and moving are both seen over several rows."""

FEWEST = 20
"""Fewer rows are no recording."""

APART = 0.01
"""Positions of a joint [rad or m] that differ by more contradict each other: twice the step of a 10-bit encoder."""

FASTEST = 15.0
"""No joint of an arm is faster [rad/s or m/s]."""

WRAPS = 0.3
"""A step within so much [rad] of a full turn is a controller's that counts within one."""

NEAR = 0.25
"""Tolerance: by which part of the time between two rows a point may be off the time after its row that is usual."""

PUNCTUAL, ENOUGH = 0.1, 6
"""Tolerance: part of the scatter with the clocks as they are below which that at another difference of them is no
chance, of so many points."""

TRIED = 40
"""Differences of two clocks that are tried, those between most pairs of a row and a point."""

DISPUTED = 6.0
"""Tolerance: so many times their scatter two places of a target are apart that are not one: a swing is within four."""

MOST_SOURCES = 4
"""So many sources of one place are distinguished."""

TURNS = 0.03
"""Tolerance: a joint that turned by so much [rad] moved its target by more than a digit of its place."""

HELD = 10
"""Rows that are equal to the last digit: fewer are chance."""

TIMES = 3
"""So many contradictions are a second source; one alone may be a glitch."""

STEP = 0.02
"""Of the grid [s] on which motion is looked at: an arm does not start and stop within it."""

STILL = {"rad": 3e-3, "m": 1e-3}
"""What changes by no more within `STANDS` stands: twice the step of a 12-bit encoder, thrice the noise of a motion
capture, half of the way of an arm that moves at one degree, or 2 mm, a second."""

STANDS = 0.5
"""An arm that stands does so for this long [s]."""

SWINGS = 5e-3
"""Tolerance: so far [m] from the middle of a dwell a target still is that of an arm that swings, not another one."""

SETTLES = 0.2
"""What is read within this time [s] after a motion is left out where the arm stands twice as long: it still swings."""

ALIKE = 0.5
"""Correlation of two motions from which they are of one arm."""

RIVAL = 0.75
"""Tolerance: share of the best correlation that the right one has at least, as a target is not as fast as joints are.
Of 146 recordings of 4 to 13 motions, most of them in part, three had less, and nine less than 0.9."""

AGREE = 0.1
"""Tolerance: clocks that differ by less [s] agree. A rival is so by chance in one of some dozens of files: half of
what is asked for (`DISTINCT`)."""

MOST_STANDS = 200
"""So many stands are compared with one another."""

FLOOR = 0.02
"""Tolerance: share of the variance of speeds that a target which swings and is sampled leaves at the right lag."""

DISTINCT = 5.0
"""Log-likelihood ratio from which one difference of two clocks is accepted rather than another, one number a motion."""


def is_dense(time: Array, values: Array, unit: str) -> bool:
    """Return whether (N, d) values in `unit` at these times [s] are samples of a recording."""
    if len(time) < FEWEST or not np.isfinite(step := np.median(np.diff(np.sort(time)))):
        return False
    return bool(0.0 < step <= DENSE or (DENSE < step <= SLOWEST and is_sampled(time, values, unit)))


def is_sampled(time: Array, values: Array, unit: str) -> bool:
    """Return whether something stands and moves in (N, d) values in `unit` at these times [s], over many rows each.

    In a list of poses each differs from the one before, or is there several times without a way between them.
    """
    if len(time) < FEWEST or len(dwells(time, values, unit)) < 2:
        return False
    steps = np.abs(np.diff(values[np.argsort(time, kind="stable")], axis=0)).max(axis=1) > STILL[unit]
    starts = np.count_nonzero(np.diff(np.concatenate([[False], steps]).astype(int)) > 0)
    return bool(np.count_nonzero(steps) >= 2 * starts)


def spread(time: Array) -> Array:
    """Return times at which the samples of a clock that repeats its stamps were taken: evenly until the next stamp."""
    order = np.argsort(time, kind="stable")
    stamps, first, counts = np.unique(time[order], return_index=True, return_counts=True)
    if len(stamps) in (1, len(time)) or not np.isfinite(stamps[-1]):
        return time
    widths = np.diff(stamps)
    step, usual = float(np.median(widths)), int(np.median(counts))
    widths = np.minimum(np.append(widths, step), step)  # a pause is none of the samples before it
    places, sizes = np.arange(len(time)) - np.repeat(first, counts), counts.copy()
    places[: counts[0]] += max(usual - counts[0], 0)  # a recording begins and ends within a stamp
    sizes[[0, -1]] = np.maximum(counts[[0, -1]], usual)
    moments = np.empty(len(time))
    moments[order] = time[order] + np.repeat(widths / sizes, counts) * places
    return moments


def aligned(series: Mapping[str, tuple[Array, Array]]) -> tuple[Array, dict[str, Array]]:
    """Return all times (N,) of several series [s], ascending, and each there, linear between its own (M,) samples.

    What is there all the time at one value has it always; another series is not a number before its first and after its
    last sample, and within a pause in which it changed.
    """
    time = np.unique(np.concatenate([stamps for stamps, _ in series.values()]))
    return time, {name: between(time, stamps, values) for name, (stamps, values) in series.items()}


def between(time: Array, stamps: Array, values: Array) -> Array:
    """Return one of the series of `aligned`, of (M,) times in any order, at (N,) times [s]."""
    if np.ptp(values) == 0.0:
        return np.full(len(time), values[0])
    order = np.argsort(stamps, kind="stable")
    stamps, values = stamps[order], values[order]
    there = np.interp(time, stamps, values, left=np.nan, right=np.nan)
    pauses = (np.diff(stamps) > max(STANDS, 5.0 * float(np.median(np.diff(stamps))))) & (np.diff(values) != 0.0)
    for i in np.flatnonzero(pauses):
        there[(time > stamps[i]) & (time < stamps[i + 1])] = np.nan
    return there


def two_sources(time: Array, values: Array, unit: str) -> tuple[int, int] | None:
    """Return two of (N, d) samples in a unit of `STILL` that two sources must have written; None where one wrote all.

    A joint jumps away and back again and again, see `_jumps`. Or, in most spans of time in which nothing else moves,
    values change to and fro between two, or among up to `MOST_SOURCES`, that are further apart than `DISPUTED` times
    the scatter about them, and than neighbours of a coarse encoder or of few digits, or its dither.
    """
    order = np.argsort(time, kind="stable")
    for column in values.T if unit == "rad" else ():
        read = order[np.isfinite(column[order])]
        if (at := _jumps(time[read], column[read])) is not None:
            return int(read[at - 1]), int(read[at])
    order = order[np.isfinite(values[order]).all(axis=1)]
    digits = np.array([np.diff(np.unique(column)).min(initial=np.inf) for column in values[order].T])
    still, pairs = 0, list[tuple[int, int]]()
    spans = np.split(order, np.flatnonzero(np.diff(np.floor(time[order] / STANDS))) + 1)
    for rows in spans if len(order) else ():
        moved = values[rows] - values[rows].mean(axis=0)
        if not (splits := list(_split(moved))):
            still += bool(np.abs(moved).max() < STILL[unit])
            continue
        scatter = np.inf
        for source in splits:
            means = np.array([moved[source == i].mean(axis=0) for i in range(int(source.max()) + 1)])
            scatter = float(np.sqrt(((moved - means[source]) ** 2).sum(axis=1).mean()))
            apart = np.abs(means[:, None] - means)[np.triu_indices(len(means), 1)]
            turns = np.flatnonzero(np.diff(source))
            far = np.linalg.norm(apart, axis=1).min() > max(DISPUTED * scatter, 0.1 * STILL[unit])
            if len(turns) >= TIMES and far and (apart > 1.5 * digits).any(axis=1).all():
                pairs.append((int(rows[turns[0]]), int(rows[turns[0] + 1])))
                break
        still += scatter < STILL[unit]
    return pairs[0] if len(pairs) >= max(TIMES, still / 2) else None


def _jumps(time: Array, values: Array) -> int | None:
    """Return the first of (N,) samples of a joint [rad] that jumps away from those around it, where several do.

    Each time it is between two neighbours that agree, or faster than any joint turns. Times ascend.
    """
    step, gap = np.diff(unwrapped(values)), np.diff(time)
    back = (step[1:] * step[:-1] < 0.0) & (np.abs(step[1:] + step[:-1]) < 0.2 * np.abs(step[:-1]))
    back &= (np.abs(step[:-1]) > APART) & (gap[1:] + gap[:-1] < DENSE)
    jumps = np.flatnonzero((np.abs(step) > APART) & (np.abs(step) > FASTEST * np.maximum(gap, 1e-3)))
    there, again = step[jumps[:-1]], step[jumps[1:]]
    returns = (there * again < 0.0) & (np.abs(there + again) < 0.3 * np.abs(there))
    if np.count_nonzero(back) >= TIMES:
        return int(back.argmax()) + 1
    return int(jumps[:-1][returns][0]) + 1 if np.count_nonzero(returns) >= TIMES else None


def _split(moved: Array) -> Iterator[np.ndarray]:
    """Yield (N,) which of 2, 3 .. groups each of (N, d) values is in: each time the widest one is cut at its gap.

    It ends where a group would have fewer than `TIMES`.
    """
    source = np.zeros(len(moved), dtype=int)
    for number in range(1, MOST_SOURCES):
        squares = [((moved[source == i] - moved[source == i].mean(axis=0)) ** 2).sum() for i in range(number)]
        rows = np.flatnonzero(source == int(np.argmax(squares)))
        along = moved[rows] @ np.linalg.svd(moved[rows] - moved[rows].mean(axis=0), full_matrices=False)[2][0]
        steps = np.sort(along)
        upper = along > steps[int(np.diff(steps).argmax())] if len(rows) > 1 else np.zeros(len(rows), dtype=bool)
        if min(np.count_nonzero(upper), np.count_nonzero(~upper)) < TIMES:
            return
        source = source.copy()
        source[rows[upper]] = number
        yield source


def unwrapped(values: Array) -> Array:
    """Return (N,) positions of a joint without the full turns by which a controller that counts within one jumps."""
    steps = np.diff(values)
    turns = np.round(steps / (2.0 * np.pi))
    turns[~(np.abs(steps - 2.0 * np.pi * turns) < WRAPS)] = 0.0
    return values - 2.0 * np.pi * np.concatenate([[0.0], np.cumsum(turns)])


def never_there(time: Array, values: Array) -> np.ndarray:
    """Return (N,) which rows of (N, n) joint positions [rad or m] are noughts that a driver has before it is asked.

    All joints are at 0 in them, and are there or leave there faster than any joint moves. Times (N,) ascend [s].
    """
    zero = (values == 0.0).all(axis=1)
    edges = np.flatnonzero(np.diff(zero.astype(int)))
    steps = np.abs(values[edges + 1] - values[edges]).max(axis=1)
    jumps = edges[(steps > APART) & (steps > FASTEST * np.maximum(time[edges + 1] - time[edges], 1e-3))]
    runs = np.cumsum(np.concatenate([[0], np.diff(zero.astype(int)) != 0]))
    return zero & np.isin(runs, np.concatenate([runs[jumps], runs[jumps + 1]]))


def held(places: Array, time: Array, spans: Array, joints: Array) -> np.ndarray:
    """Return (N,) which (N, 3) places are the last one again, of an instrument that holds it where it reads none.

    Such are rows that are equal over `HELD` and more, of a target that is otherwise not at one place twice while the
    arm stands, in (K, 2) spans: noise sees to that. Without noise they are those at which one of (N, n) joints [rad or
    m] has turned since the first of them. Times (N,) ascend [s].
    """
    same = np.concatenate([[False], (np.diff(places, axis=0) == 0.0).all(axis=1)])
    run = np.cumsum(~same)
    lasts = np.bincount(run)[run] >= HELD
    index = np.searchsorted(spans[:, 0], time, "right") - 1
    fresh = (index >= 0) & (time <= spans[index, 1]) & ~lasts & np.isfinite(places).all(axis=1)
    usual = np.median(np.bincount(index[fresh], minlength=len(spans)))
    noisy = usual >= HELD and np.count_nonzero(same & fresh) < 0.05 * np.count_nonzero(fresh)
    turned = (np.abs(joints - joints[np.flatnonzero(~same)[run - 1]]) > TURNS).any(axis=1)
    return lasts & same & (noisy | turned)


def repeated(places: Array, joints: Array) -> np.ndarray:
    """Return (N,) which (N, 3) places are the last one again, to the last digit, though (N, n) joints moved since.

    An instrument that holds its last value where its beam is lost writes such rows: from the first on, all until the
    place changes, also those of a pose that is read twice. None are where most rows are such: there the target is put
    into the same few places on purpose. Rows are in the order in which they were read.
    """
    there = np.flatnonzero(np.isfinite(places).all(axis=1))
    same = (np.diff(places[there], axis=0, prepend=np.nan) == 0.0).all(axis=1)
    moved = same & (np.abs(np.diff(joints[there], axis=0, prepend=np.nan)) > STILL["rad"]).any(axis=1)
    moves, run = np.cumsum(moved), np.cumsum(~same) - 1
    gone = np.zeros(len(places), dtype=bool)
    gone[there] = same & (moves > moves[~same][run]) if len(there) else False
    return gone & (2 * np.count_nonzero(gone) < len(gone))


def dwells(time: Array, values: Array, unit: str) -> Array:
    """Return (K, 2) first and last time [s] of each stretch in which no (N, d) value in a unit of `STILL` moves."""
    from scipy.ndimage import maximum_filter1d, minimum_filter1d  # only where something was recorded

    if not (np.isfinite(values).all(axis=1) & np.isfinite(time)).any():
        return np.zeros((0, 2))
    grid, moved = _gridded(time, values)
    size = max(round(STANDS / STEP), 1)
    span = maximum_filter1d(moved, size, axis=0) - minimum_filter1d(moved, size, axis=0)
    still = np.concatenate([[False], (span <= STILL[unit]).all(axis=1), [False]])
    edges = np.flatnonzero(np.diff(still.astype(int))).reshape(-1, 2)
    spans = []
    for first, last in edges:
        first, last = max(first - size // 2, 0), min(last - 1 + size // 2, len(grid) - 1)
        start, end = grid[first], grid[last]
        creeps = np.ptp(moved[first : last + 1], axis=0).max() > 3.0 * STILL[unit]
        if end - start >= STANDS and not creeps:
            spans.append((start + (SETTLES if end - start >= 2.0 * SETTLES + STANDS else 0.0), end - 0.5 * SETTLES))
    return np.array(spans).reshape(-1, 2)


def unsteady(time: Array, places: Array, spans: Array) -> np.ndarray:
    """Return (N,) which (N, 3) places [m] are far from the target's in their dwell, all of one in which it moves on.

    Far is beyond `SWINGS` and six times the distance that is usual. Dwells are (K, 2) first and last times [s].
    """
    gone, away, usual = np.zeros(len(time), dtype=bool), list[tuple[np.ndarray, Array]](), list[float]()
    for start, end in spans:
        rows = np.flatnonzero((time >= start) & (time <= end) & np.isfinite(places).all(axis=1))
        if len(rows):
            off = np.linalg.norm(places[rows] - np.median(places[rows], axis=0), axis=1)
            away.append((rows, off))
            usual.append(float(np.median(off)))
    for rows, off in away:
        far = off > max(SWINGS, 6.0 * float(np.median(usual)))
        gone[rows] = far if 2 * np.count_nonzero(far) < len(far) else True
    return gone


def reduced(source: Source, time: Array, spans: Array, shift: float) -> Source:
    """Return a recording as one row for each span: means of numbers, the middle of texts; spans without samples empty.

    `shift` is how much its clock is ahead of that of the spans [s].

    Raises:
        InputError: The recording has no sample in any span.
    """
    order = np.argsort(time, kind="stable")
    sorted_time = time[order]
    ends = [(np.searchsorted(sorted_time, a), np.searchsorted(sorted_time, b, "right")) for a, b in spans + shift]
    rows_in = [order[a:b] for a, b in ends]
    if not any(len(rows) for rows in rows_in):
        raise InputError(f"{source.path}: nothing was recorded while the arm stood: were both recorded at once?")
    columns: list[Cells] = []
    for cells in source.columns:
        values = numbers(cells)
        if np.isfinite(values).any():
            means = [values[rows][np.isfinite(values[rows])] for rows in rows_in]
            columns.append(np.array([read.mean() if len(read) else np.nan for read in means]))
        else:
            columns.append(tuple(str(cells[rows[len(rows) // 2]]) if len(rows) else "" for rows in rows_in))
    lines = tuple(source.lines[rows[0]] if len(rows) else 0 for rows in rows_in)
    return replace(source, lines=lines, columns=tuple(columns), spans=spans)


def offset(time: Array, values: Array, other: Array, place: Array) -> tuple[float, float]:
    """Return how much [s] the clock of a tracker is ahead of that of the joints, and the standard uncertainty of that.

    It is the lag at which both move alike.

    Speeds, and not positions, are correlated: their roots, so that a fast motion does not outweigh the others. Motions
    that take about equally long look alike at several lags. There the target's squared speed is a sum of those of the
    joints, too, and the squared distance of two places one of how far each joint turned between them.

    Args:
        time: (N,) of joint positions (N, n) `values`.
        other: (M,) of places (M, 3).

    Raises:
        InputError: They move alike at no lag, or at several.
    """
    from scipy.signal import correlate, find_peaks

    grids = [_gridded(time, values), _gridded(other, place)]
    speeds, squares = [], []
    for _, moved in grids:
        size = max(round(0.1 / STEP), 1)
        squares.append((moved[size:] - moved[:-size]) ** 2)
        slow = np.sqrt(squares[-1].sum(axis=1))
        root = np.sqrt(slow / max(np.quantile(slow, 0.95), 1e-12))
        speeds.append(np.minimum(root, 2.0) - np.minimum(root, 2.0).mean())
    match = correlate(speeds[1], speeds[0], method="fft")
    match /= max(float(np.sqrt((speeds[0] ** 2).sum() * (speeds[1] ** 2).sum())), 1e-12)
    best = int(match.argmax())
    if match[best] < ALIKE * np.sqrt(min(map(len, speeds)) / max(map(len, speeds))):
        text = "do not move alike at any difference of their clocks"
        raise InputError(f"joints and target {text} (correlation {match[best]:.2f}): is it the target of this arm?")
    rivals = np.union1d(find_peaks(match, RIVAL * match[best], distance=round(STANDS / STEP))[0], [best])
    if len(rivals) > 1:
        motions = int(np.count_nonzero(np.diff((speeds[0] > 0.0).astype(int)) > 0))
        seen = max(motions * min(1.0, len(speeds[1]) / len(speeds[0])), 1.0)
        stands = np.round((dwells(time, values, "rad").mean(axis=1) - grids[0][0][0]) / STEP).astype(int)
        ways = [*pairwise(_poses(grids[0][1], stands))]
        # A motion again says no more, and how long it takes only where that is not as long as before.
        unlike = len({*ways}) / max(len(ways), 1)
        uneven = len({*zip(ways, np.diff(stands).tolist(), strict=True)}) / max(len(ways), 1)
        lags, target = rivals.astype(int) - len(speeds[0]) + 1, squares[1].sum(axis=1)
        there = [min(len(target), len(speeds[0]) + lag) - max(lag, 0) for lag in lags.tolist()]
        left = [max(_left(squares[0], target, lag, round(unlike * motions)), 1e-12) for lag in lags.tolist()]
        apart = np.array([_left_between(grids[0][1], grids[1][1], stands, lag) for lag in lags.tolist()])
        # And how long motions and pauses take, also of those of the target beyond the joints' times.
        size = float((speeds[0] ** 2).sum())
        within = [float((speeds[0][max(-lag, 0) : len(target) - lag] ** 2).sum()) / size for lag in lags.tolist()]
        lasts = 0.5 * uneven * seen * np.log(np.maximum(1.0 - match[rivals] ** 2 / np.array(within), FLOOR))
        as_written = np.abs(grids[1][0][0] - grids[0][0][0] + lags * STEP) < AGREE
        independent = np.maximum(unlike * motions * np.array(there) / len(speeds[0]) - values.shape[1], 0.0)
        doubt = 0.5 * independent * np.log(left) + 0.5 * apart[:, 1] * apart[:, 0] + lasts - 0.5 * DISTINCT * as_written
        best, (first, second) = int(rivals[doubt.argmin()]), np.sort(doubt)[:2]
        if second - first < DISTINCT:
            start = grids[1][0][0] - grids[0][0][0]
            alike = listing(f"{start + lags[i] * STEP:+.2f} s" for i in np.argsort(doubt)[:FEW])
            text = f"joints and target move alike at several differences of their clocks, {alike}: record uneven"
            raise InputError(f"{text} pauses, or put the times of one file right by that which is true")
    before, at, after = (float(match[min(max(best + i, 0), len(match) - 1)]) for i in (-1, 0, 1))
    bend = before - 2.0 * at + after
    fine = 0.5 * (before - after) / bend if bend < 0.0 else 0.0
    lag = best - (len(speeds[0]) - 1)
    stands = dwells(time, values, "rad").mean(axis=1) if len(time) else np.zeros(0)
    motion = np.searchsorted(stands, grids[0][0][: len(speeds[0])])
    shift = grids[1][0][0] - grids[0][0][0] + (lag + fine) * STEP
    return float(shift), STEP * _lag_std(speeds[0], speeds[1], lag, fine, motion)


def _lag_std(first: Array, second: Array, lag: int, fine: float, motion: np.ndarray) -> float:
    """Return the standard uncertainty of the lag, in steps, at which (N,) and (M,) speeds are most alike.

    There the slopes of the correlation add up to nothing over all motions. How much each slope is, which is a number of
    its own, says how well the sum is known, and the bend of the correlation what that is as a lag.

    Args:
        first, second: Speeds.
        lag: Steps by which the second is later, about which `fine` is found.
        fine: The rest of it.
        motion: (N,) number of the motion that each step of `first` is of.
    """
    rows = np.arange(max(0, 1 - lag), min(len(first), len(second) - lag - 1))
    before, at, after = (np.bincount(motion[rows], first[rows] * second[rows + lag + i]) for i in (-1, 0, 1))
    bend = before - 2.0 * at + after
    slope = (0.5 * (after - before) + fine * bend)[np.bincount(motion[rows]) > 0]
    if len(slope) < 2 or not bend.sum() < 0.0:
        return np.inf
    return float(np.sqrt(len(slope) / (len(slope) - 1) * (slope**2).sum()) / -bend.sum())


def _left(joints: Array, target: Array, lag: int, motions: int) -> float:
    """Return which share of the variance of (M,) squared speeds the (N, n) of joints leave, so many steps before.

    Each of as many `motions` as are in the part that both have is one number, and each joint a parameter.
    """
    start, end = max(lag, 0), min(len(target), len(joints) + lag)
    about, segment = joints[start - lag : end - lag], target[start:end] - target[start:end].mean()
    about = about - about.mean(axis=0)
    left = segment - about @ np.linalg.lstsq(about, segment, rcond=None)[0]
    freedom = max(1.0 - joints.shape[1] * len(joints) / max(motions * len(segment), 1), 0.1)
    return float(left @ left) / max(float(segment @ segment), 1e-300) / freedom


def _left_between(joints: Array, places: Array, stands: np.ndarray, lag: int) -> tuple[float, int]:
    """Return by which share, as a logarithm, joints leave how far apart (M, 3) places are, so many steps before.

    Between each two of `stands`, numbers of rows of (N, n) joints, a place is further for each joint that turned.

    Returns:
        The logarithm, 0 where the two have too few stands in common; and how many numbers say it: three a stand of
        other positions but those of a pose of all, and a part of the distance for each joint, and one more.
    """
    rows = stands[(stands + lag >= 0) & (stands + lag < len(places))][:MOST_STANDS]
    seen = max(3 * len({*_poses(joints, rows)}) - 6, 1)
    freedom = 1.0 - (joints.shape[1] + 1) / seen
    if freedom < 0.2:
        return 0.0, 0
    first, second = np.triu_indices(len(rows), 1)
    apart = ((places[rows + lag][first] - places[rows + lag][second]) ** 2).sum(axis=1)
    turned = np.column_stack([1.0 - np.cos(joints[rows][first] - joints[rows][second]), np.ones(len(first))])
    rest = apart - turned @ np.linalg.lstsq(turned, apart, rcond=None)[0]
    share = float(rest @ rest) / max(float(((apart - apart.mean()) ** 2).sum()), 1e-300)
    return float(np.log(max(share / freedom, FLOOR))), seen - joints.shape[1] - 1


def _poses(joints: Array, stands: np.ndarray) -> list[int]:
    """Return the number of the first of some rows of (N, n) joints [rad] that has the same positions, for each."""
    there = joints[stands]
    return [int((np.abs(there - q).max(axis=1) <= STILL["rad"]).argmax()) for q in there]


def paired(spans: Array, times: Array) -> tuple[np.ndarray, float]:
    """Return (M,) which of (K, 2) spans each time [s] is in, -1 for none, and the difference found of their clocks.

    Clocks as they are, where that puts most times into spans of their own; else the difference that puts most there.
    """

    def placed(shift: float) -> np.ndarray:
        at = times - shift
        near = np.clip(np.searchsorted(spans[:, 0], at, "right") - 1, 0, len(spans) - 1)
        return np.where((at >= spans[near, 0]) & (at <= spans[near, 1]), near, -1)

    def score(shift: float) -> int:
        rows = placed(shift)
        return len(set(rows[rows >= 0].tolist()))

    most = min(len(times), len(spans))
    if score(0.0) > 0.9 * most:
        return placed(0.0), 0.0
    tried = np.unique((times[:, None] - spans.mean(axis=1)).ravel().round(2))
    scores = np.array([score(shift) for shift in tried])
    good = tried[scores == scores.max()]
    apart = any(b - a > float(np.median(spans[:, 1] - spans[:, 0])) for a, b in pairwise(good))
    if scores.max() <= 0.9 * most or apart:
        return placed(0.0), 0.0
    shift = float(np.median(good))
    return placed(shift), shift


def nearest(rows: Array, points: Array) -> tuple[np.ndarray, float]:
    """Return (M,) which of (N,) rows each point is of, -1 for none, and the difference found of their clocks [s].

    A point belongs to the row that is nearest to it, as far from it as the points usually are. Clocks are as they are
    where points are then near their rows; else, and where points are then scattered `1 / PUNCTUAL` times less, at the
    difference at which most rows have a point, equally far.

    Raises:
        InputError: Several differences do equally well.
    """
    order = np.argsort(rows, kind="stable")
    ordered = rows[order]
    step = float(np.median(np.diff(ordered))) if len(rows) > 1 else 1.0
    middles, room = 0.5 * (ordered[1:] + ordered[:-1]), NEAR * step

    def placed(shift: float) -> tuple[np.ndarray, float, int, float]:
        near = np.searchsorted(middles, points - shift)
        left = points - shift - ordered[near]
        usual = float(np.median(left))
        within = np.abs(left - usual) <= room
        spread = float(np.median(np.abs(left - usual)[within])) if within.any() else np.inf
        return np.where(within, order[near], -1), usual, len(set(near[within].tolist())), spread

    most = min(len(rows), len(points))
    assigned, usual, count, scatter = placed(0.0)
    near = abs(usual) <= room and count > 0.9 * most
    apart = (points[:, None] - ordered).ravel()
    tried = list[float]()
    for start in (0.0, 0.5):
        _, bins, counts = np.unique(np.floor(apart / room + start), return_inverse=True, return_counts=True)
        tried += [float(np.median(apart[bins == i])) for i in np.argsort(counts)[::-1][:TRIED]]
    best, *others = sorted(((-count, spread, shift) for shift in tried for _, _, count, spread in (placed(shift),)))
    if near and (most < ENOUGH or -best[0] < count or best[1] >= PUNCTUAL * scatter):
        return assigned, 0.0
    if -best[0] <= 0.9 * most:
        return (assigned, 0.0) if abs(usual) <= room else (np.full(len(points), -1), 0.0)
    rival = next((shift for count, spread, shift in others
                  if abs(shift - best[2]) > room and count == best[0] and spread <= 2.0 * best[1] + 0.05 * step),
                 None)  # fmt: skip
    if rival is not None:
        text = f"their clocks may be {best[2]:+.4g} s or {rival:+.4g} s apart, as rows are {step:.4g} s apart evenly"
        raise InputError(f"{text}: which point is of which row is not certain, give both the same names")
    return placed(best[2])[0], best[2]


def _gridded(time: Array, values: Array) -> tuple[Array, Array]:
    """Return times [s] in steps of `STEP` and values (M, d) there, linear between samples."""
    order = np.argsort(time, kind="stable")
    time, values = time[order], values[order]
    whole = np.isfinite(values).all(axis=1) & np.isfinite(time)
    grid = np.arange(time[whole][0], time[whole][-1] + STEP, STEP)
    return grid, np.column_stack([np.interp(grid, time[whole], column[whole]) for column in values.T])
