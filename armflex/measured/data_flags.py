"""What is wrong, or only strange, about the rows of a campaign, as far as the table alone shows.

A wrong unit in some rows is an error that names them. A lost beam is not: a reading a metre off is left to the robust
fit, which lists it. The two differ in size, by a factor of a thousand against a part of the distance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from armflex.arm import Arm
from armflex.conventions import LOGGED_ANGLES, LOGGED_LENGTHS, NUMBER, STANDARD_GRAVITY, UNITS, Array
from armflex.errors import FEW, Flag, Place, TableError, listing
from armflex.files.effect_file import TEMPERATURE
from armflex.measured.lost_places import lost
from armflex.measured.orientation_names import QUATERNIONS, ROUNDED, TURNED, TURNS_BY, bare, by_stem, ends
from armflex.measured.table import Table, asked_columns, is_nearly, other_joints
from armflex.mechanics.loaded import FORCE_BAND
from armflex.robot.urdf import Joint
from armflex.rows.rows import MOST_LEVELS, levels, mostly_numbers

if TYPE_CHECKING:
    from armflex.measured.measurements import Measurements

GAP = 30.0
"""Ratio of neighbouring distances, once sorted, that parts rows of one unit from rows of another."""

THOUSANDFOLD = (200.0, 5000.0)
"""Ratio of the two parts' medians that is mm against m."""

FURTHEST = 200.0
"""Distance [m] that no instrument reads on an arm."""

MOVED = 0.3
"""Travel, as written, beyond which a joint of a table is one that moves: 0.3 rad is much, 0.3 deg is little."""

BESIDE = 0.01
"""Tolerance: part of the arm's weight from which what hangs beside the chain is asked where it stands."""

TURNS = 4.0 * np.pi
"""How far beyond its limits [rad] a joint position is in degrees rather than out of its range."""


TURN_OFF = 0.3
"""Tolerance: how far outside its limits [rad] some value of a column is before it is asked whether it is a turn off."""

SEAM = 1e-3
"""Tolerance: rounding at the ends of one turn [rad]."""

GAP_BY_CHANCE = 1e-3
"""Confidence: probability below which a gap in a column is no chance of where poses were."""


def check_one_unit(
    lengths: Array, rows: np.ndarray, places: Sequence[Place], columns: Sequence[str] = ("x", "y", "z")
) -> None:
    """Raise `TableError` naming the rows, of those numbered, that were written in mm among rows in m or vice versa."""
    seen = lengths[rows]
    for name, values in ((" ".join(columns), seen), *((axis, seen[:, [i]]) for i, axis in enumerate(columns))):
        odd = _other_unit(values)
        if len(odd):
            odd_places = [places[i] for i in rows[odd].tolist()]
            lines = listing((str(place.line) for place in odd_places), 10)
            text = f"{name}: {len(odd_places)} of {len(rows)} rows are about 1000 times as large or small as the others"
            raise TableError(odd_places[0], f"{text} (lines {lines}): mm among m?")


def check_not_lost(places: Array, q: Array, rows: np.ndarray, at: Sequence[Place]) -> None:
    """Raise `TableError` naming rows with the place that an instrument writes where it reads none, again and again.

    Not where most rows are there: a target may be put to one place on purpose.

    Args:
        places: (N, 3) [m].
        q: (N, nq) positions [rad or m].
        rows: Numbers of the rows that were read.
        at: Where the rows are.
    """
    gone = rows[lost(places[rows])]
    if 1 < len(gone) < 0.5 * len(rows) and np.ptp(q[gone], axis=0).any():
        lines, place = listing((str(at[i].line) for i in gone.tolist()), 10), listing(f"{x:g}" for x in places[gone[0]])
        text = f"x, y, z are {place} here, as instruments write where they read nothing: leave the cells empty"
        raise TableError(at[int(gone[0])], f"{text} ({len(gone)} of {len(rows)} rows, lines {lines})")


def _other_unit(values: Array) -> np.ndarray:
    """Return the numbers of the minority of (M, d) values that a factor of a thousand sets apart; mostly none.

    No arm reaches the large ones, or the small ones are spread out just as they are, but smaller: readings of one place
    near the frame's origin are small as well, yet all alike.
    """
    size, none = np.maximum(np.linalg.norm(values, axis=1), 1e-9), np.zeros(0, dtype=int)
    order = np.sort(size)
    steps = order[1:] / order[:-1]
    if len(size) < 3 or steps.max() < GAP:
        return none
    large = size > order[int(steps.argmax())]
    if not THOUSANDFOLD[0] < np.median(size[large]) / np.median(size[~large]) < THOUSANDFOLD[1]:
        return none
    if np.median(size[large]) <= FURTHEST:
        if values.shape[1] == 1 or min(large.sum(), (~large).sum()) < 3:
            return none
        spread = [np.sqrt(values[part].var(axis=0).sum()) for part in (large, ~large)]
        if not 100.0 < spread[0] / max(spread[1], 1e-12) < 1e4:
            return none
    return np.flatnonzero(large if large.sum() <= (~large).sum() else ~large)


def check_joint_units(
    q: Array, arm: Arm, places: Sequence[Place], column: str = "q", units: Mapping[str, str] | None = None
) -> None:
    """Raise `TableError` naming the first row whose joint position is far beyond any limit: degrees, or mm.

    Args:
        q: (N, nq) positions [rad or m].
        arm: The arm.
        places: Where the rows are, none where nobody says.
        column: How the columns begin.
        units: Units that the headers state, by column.
    """
    beyond = in_other_units(q, arm)
    for index in np.flatnonzero(beyond.any(axis=0))[:1].tolist():
        joint, far = arm.robot.moving[index], np.flatnonzero(beyond[:, index])
        straight, name = joint.kind == "prismatic", f"{column}_{joint.name}"
        unit, other = ("m", "mm") if straight else ("rad", "deg")
        stated = (units or {}).get(name, "")
        size = UNITS["length" if straight else "angle"].get(stated, 1.0)
        written = q[:, index] / size
        room = 0.1 * (joint.upper - joint.lower)

        def within(factor: float, values: Array = written, joint: Joint = joint, room: float = room) -> bool:
            return bool(((factor * values > joint.lower - room) & (factor * values < joint.upper + room)).all())

        fitting = [unit for unit, size in (LOGGED_LENGTHS if straight else LOGGED_ANGLES).items() if within(size)]
        usual = UNITS["length" if straight else "angle"][other]
        if not stated and not in_other_units(np.where(np.arange(q.shape[1]) == index, usual * q, 0.0), arm).any():
            hint = f"{other}? Then name the column {name}_{other}"
        else:
            hint = f"in {' or '.join(fitting[:FEW]) or 'counts of an encoder'}? Then convert it to {stated or unit}"
        where = f"limits {joint.lower / size:.3g} to {joint.upper / size:.3g}; {len(far)} rows"
        text = f"{name} is {written[far[0]]:.6g} {stated or unit} ({where}): {hint}"
        raise TableError(places[far[0]] if places else Place(Path(f"row {far[0]}")), text)


def turned_back(q: Array, arm: Arm) -> tuple[Array, Flag | None]:
    """Return (N, nq) positions [rad or m] on the branch that their joints hold, and the flag about columns on another.

    Controllers count from 0 to 360 degrees, or from -180 to 180: a joint within its limits then shows a full turn more
    or less. Where limits leave more than one branch open, a column is cut at its widest gap instead of amid its values.
    """
    full, turns, open_ = 2.0 * np.pi, np.zeros(q.shape), list[tuple[int, float, float, bool]]()
    robot = arm.robot
    for index, joint in enumerate(robot.moving):
        low, high = float(q[:, index].min(initial=0.0)), float(q[:, index].max(initial=0.0))
        start = next((begin for begin in (0.0, -np.pi) if low >= begin - SEAM and high <= begin + full + SEAM), None)
        if joint.kind == "prismatic" or start is None:
            continue
        lower, upper = float(robot.lower[index]), float(robot.upper[index])
        if upper - lower < full:
            back = np.round((0.5 * (lower + upper) - q[:, index]) / full)  # the branch nearest to the limits
            there = q[:, index] + full * back
            if max(high - upper, lower - low) > TURN_OFF > max(there.max() - upper, lower - there.min()):
                turns[:, index] = back
            continue
        at = np.unique(np.round(q[:, index], 3))
        gaps = np.diff(at)
        if len(gaps) and full - float(at[-1] - at[0]) < 0.25 * gaps.max():
            cut = int(gaps.argmax())
            by_chance = len(at) * (1.0 - float(gaps[cut]) / full) ** (len(at) - 1)
            open_.append((index, start, float(at[cut]) + 0.5 * float(gaps[cut]), by_chance < GAP_BY_CHANCE))
    counted = bool(turns.any()) or any(sure for *_, sure in open_)
    for index, start, cut, sure in open_:
        if counted and (start == 0.0 or sure):
            late = q[:, index] > cut
            back = -1.0 * late if start == 0.0 or late.sum() <= (~late).sum() else 1.0 * ~late
            there = q[:, index] + full * back
            if (there >= robot.lower[index]).all() and (there <= robot.upper[index]).all():
                turns[:, index] = back
    if not turns.any():
        return q, None
    of_rows = {robot.moving[i].name: count for i, count in enumerate(np.count_nonzero(turns, axis=0)) if count}
    names = listing(f"q_{name} in {count} of {len(q)} rows" for name, count in of_rows.items())
    text = (
        f"{names}: a full turn (360 deg) away from where the joint is, as of a log that counts within one turn: taken"
    )
    text += " on the branch that its limits hold, or that has no gap"
    return q + full * turns, Flag("full_turn", text)


def unit_flags(table: Table, arm: Arm) -> tuple[Flag, ...]:
    """Return the flag about columns in degrees whose numbers are those of radians: that is asked, not known.

    They are where no turning joint would leave a few degrees about zero, while radians would fill some of its limits.
    """
    names = [f"q_{joint.name}" for joint in arm.robot.moving if joint.kind != "prismatic"]
    if not names or any(name not in table.columns or table.columns[name].unit != "deg" for name in names):
        return ()
    written = np.degrees(table.matrix(names))
    limits = [(joint.lower, joint.upper) for joint in arm.robot.moving if joint.kind != "prismatic"]
    lower, upper = np.array(limits).T
    inside = ((written >= lower) & (written <= upper)).all() and np.abs(written).max(initial=0.0) <= 2.0 * np.pi
    if not inside or np.count_nonzero(np.ptp(written, axis=0) > MOVED) < min(2, len(names)):
        return ()
    most = f"{np.abs(written).max():.3g}"
    text = f"no joint is beyond {most} deg, and as radians all are within their limits: radians? Then take _deg from"
    return (Flag("radians", f"{Place(table.path, 1)}: {text} the headers of {names[0]} .. {names[-1]}"),)


def unread_orientation(columns: Mapping[str, object]) -> list[str]:
    """Return those of some columns by name that are an orientation as others write it, most likely; none where none is.

    Angles and a matrix are known by their names, a quaternion by four names and its length.
    """
    called = {bare(name): name for name in columns}
    for names in (words.split() for words in TURNS_BY):
        if called.keys() >= set(names):
            return [called[name] for name in names]
    for stem, parts in by_stem(columns).items():
        if (axes := ends(parts)) in QUATERNIONS:
            squares = [np.square(part) for part in map(columns.get, parts.values()) if isinstance(part, np.ndarray)]
            if len(squares) == 4 and np.isclose(sum(squares), 1.0, atol=2.0 * ROUNDED).all():
                return [parts[axis] for axis in axes[1:] + axes[0]]
        elif axes == "xyz" and TURNED.fullmatch(stem):
            return [parts[axis] for axis in axes]
    return []


def in_other_units(q: Array, arm: Arm) -> np.ndarray:
    """Return (N, nq) where joint positions are far beyond any limit."""
    span = arm.robot.upper - arm.robot.lower
    straight = np.array([joint.kind == "prismatic" for joint in arm.robot.moving])
    room = np.where(straight, 10.0 * np.maximum(span, 1.0), TURNS)
    return np.isfinite(span) & ((q > arm.robot.upper + room) | (q < arm.robot.lower - room))


def table_flags(table: Table, measurements: Measurements, arm: Arm) -> tuple[Flag, ...]:
    """Return the flags about rows that were read: covariates misspelt or no candidates, their order, repetitions."""
    flags = []
    if others := other_joints(table, arm):
        text = f"{listing(others)} {'is' if len(others) == 1 else 'are'} of no joint of this arm, and left out"
        flags.append(Flag("other_joint", f"{Place(table.path, 1)}: {text}"))
    for name in measurements.covariates if TEMPERATURE not in measurements.covariates else ():
        if is_nearly(name, TEMPERATURE) and name not in asked_columns(arm):
            text = f"column {name!r} is read as a covariate: did you mean {TEMPERATURE!r}?"
            flags.append(Flag("covariate_name", f"{Place(table.path, 1)}: {text}"))
    for name, cells in measurements.covariates.items():
        if not isinstance(cells, tuple) or levels(cells):
            continue
        if mostly_numbers(cells):
            odd = [i for i, cell in enumerate(cells) if not NUMBER.fullmatch(cell)]
            lines = listing((str(table.lines[i]) for i in odd), 10)
            text = f"{len(odd)} of {len(cells)} cells are no numbers (lines {lines}), so it is not searched as a cause"
            flags.append(Flag("covariate_gaps", f"column {name!r}: {text}"))
        else:
            text = f"{len(set(cells))} different texts, over {MOST_LEVELS}, so it is not searched as a cause"
            flags.append(Flag("covariate_text", f"column {name!r}: {text}"))
    back, again = np.flatnonzero(np.diff(measurements.time) < 0.0) + 1, duplicates(measurements)
    if len(back):
        text = f"time goes back at {len(back)} rows, first at {measurements.places[back[0]]}; kept as is"
        flags.append(Flag("time_unordered", text))
    if len(again):
        first = measurements.places[again[0]]
        text = f"{len(again)} rows repeat an earlier one to the last digit, first {first}; each counts"
        flags.append(Flag("duplicate_rows", text))
    return tuple(flags)


def force_flags(measurements: Measurements, arm: Arm) -> tuple[Flag, ...]:
    """Return the flag about forces that are many times the arm's weight, at the first such row."""
    most, flags = FORCE_BAND * arm.weight, []
    for wrench in measurements.wrenches if most else ():
        size = np.linalg.norm(np.broadcast_to(wrench.force, (len(measurements), 3)), axis=1)
        if size.max(initial=0.0) > most:
            row = int((size > most).argmax())
            text = f"{size[row]:.3g} N at {wrench.frame!r} is over {FORCE_BAND:g} times the arm's weight: kN or kgf?"
            flags.append(Flag("large_force", f"{measurements.places[row]}: {text} ({int((size > most).sum())} rows)"))
    return tuple(flags)


def branch_flags(table: Table, arm: Arm) -> tuple[Flag, ...]:
    """Return the flag about joints beside the chain without a column, which move what weighs."""
    robot, held = arm.robot, []
    for name in (name for name in robot.locked if f"q_{name}" not in table.columns):
        joint = robot.urdf.joints[name]
        bodies = [robot.urdf.links[link].inertial for link in robot.urdf.below(joint.child)]
        weight = STANDARD_GRAVITY * sum(body.mass for body in bodies if body)
        if not joint.mimic and weight > BESIDE * arm.weight and robot.stem(name) not in (None, robot.base):
            held.append(f"q_{name}")
    text = f"no column {listing(held)}: what hangs there beside the chain weighs, and stands as [robot] locked says"
    return (Flag("branch_held", f"{Place(table.path, 1)}: {text}"),) if held else ()


def duplicates(measurements: Measurements) -> np.ndarray:
    """Return the numbers of measured rows that repeat an earlier one to the last digit, time and covariates included.

    Where the file gives no time, `time` counts rows and is not compared.
    """
    optional = [measurements.hold, None if "time" in measurements.derived else measurements.time]
    numbers = [measurements.q, *(part for kind in measurements.readings.kinds for part in (kind.values, kind.sigma))]
    numbers += [values.reshape(len(measurements), -1) for values in optional if values is not None]
    numbers += [values[:, None] for values in measurements.covariates.values() if not isinstance(values, tuple)]
    numbers.append(measurements.load_number[:, None])
    texts = [measurements.session]
    if measurements.pose != tuple(str(i) for i in range(len(measurements))):
        texts.append(measurements.pose)
    texts += [values for values in measurements.covariates.values() if isinstance(values, tuple)]
    rows = np.hstack(numbers)
    seen: set[tuple] = set()
    again = []
    for i in np.flatnonzero(measurements.measured):
        key = (rows[i].tobytes(), *(values[i] for values in texts))
        if key in seen:
            again.append(i)
        seen.add(key)
    return np.array(again, dtype=int)
