"""Known forces in a table of rows: the columns `force_fx` .. `force_mz`, `force_frame`, `force_axes`, read once."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from armflex.arm import SLACK, Arm, outside_limits
from armflex.conventions import UNITS, WRENCH_NAMES, Array
from armflex.errors import Frame, InputError, Place, TableError, UnknownNameError, did_you_mean
from armflex.measured.table import Table, misspelt, read_table, split_header
from armflex.rows.branch import Branch, branches
from armflex.rows.wrench import Wrench

FORCES = tuple(f"force_{name}" for name in WRENCH_NAMES)
FORCE_KINDS = {name: "force" if name in FORCES[:3] else "moment" for name in FORCES}
"""Kind of quantity of each column that holds numbers, for `read_table`."""

FORCE_TEXTS = ("force_frame", "force_axes")
FORCE_AXES = {"base": "base", "link": "frame"}
"""As files name the axes, and as `Wrench` does."""

_A_LOAD = re.compile(r"(?:(f|force)|m|moment|torque)_?([xyz])", re.IGNORECASE)
"""What people call a component of a load."""


def called_as_load(name: str) -> str:
    """Return which of `FORCES` a column is called as people call it: fx, F_x, moment_z, forse_fz; '' where none."""
    base, unit = split_header(name)
    base = base if unit in {*UNITS["force"], *UNITS["moment"]} else name
    word, _, part = base.partition("_")
    if f"force_{part.lower()}" in FORCES and misspelt(word, ["force"]):
        return f"force_{part.lower()}"
    match = _A_LOAD.fullmatch(base)
    return f"force_{'f' if match[1] else 'm'}{match[2].lower()}" if match else ""


def check_load_names(table: Table, arm: Arm, names: Iterable[str]) -> None:
    """Raise `TableError` where a column without a meaning is called as people call a load, such as fx, F_x or moment_z.

    It would count as a covariate and load nothing. What an effect of the arm depends on is a covariate.
    """
    asked = {name for effect in arm.effects for name in effect.location.covariates}
    for name in (name for name in names if name not in asked):
        if meant := called_as_load(name):
            text = f"column {table.columns[name].header!r} is called as a load but would be a covariate"
            unit = "kN" if FORCE_KINDS[meant] == "force" else "kNm"
            wanted = f"a load from outside is {meant!r} (with a unit {meant}_{unit})"
            raise table.fail(f"{text}: {wanted}; what is no load needs another name")


class Unnamed(NamedTuple):
    """What loads rows that name none: a payload's name, and a load from outside that is the same in all, or None."""

    payload: str = "none"
    force: Wrench | None = None


UNLOADED = Unnamed()


def read_forces(table: Table, arm: Arm, unnamed: Wrench | None = None) -> tuple[Wrench, ...]:
    """Return the known loads from outside of a table's rows, for all N rows each, zero where a row has none.

    `force_fx` .. `force_mz` are in N and Nm, or as their headers say; a column that is not there is zero, and so is a
    row whose cells are all empty. `force_frame` names the link at whose origin it acts, the tip where it is empty, and
    `force_axes` whose axes they are: those of the `base` where it is empty, or of that `link`, with which it turns.

    Args:
        table: Read with `FORCE_KINDS` among its kinds.
        arm: The arm that is pulled at.
        unnamed: What pulls at it in rows whose cells are all empty.

    Returns:
        A wrench for every link and axes that occur; none where no row has a force.

    Raises:
        TableError: A cell is no number, a row has some of its numbers only, there is no such link, or no such axes;
            frame or axes are given without a force.
    """
    names = [name for name in FORCES if name in table.columns]
    texts = [name for name in FORCE_TEXTS if name in table.columns]
    if not names and unnamed is None:
        if texts:
            raise table.fail(f"has {texts[0]!r} but none of {FORCES[0]} .. {FORCES[-1]}")
        return ()
    there = table.given(names) if names else np.zeros(len(table), dtype=bool)
    loads = np.zeros((len(table), 6))
    for name in names:
        loads[:, FORCES.index(name)] = table.numbers_where(name, there)
    frames, axes = (
        [cell or default for cell in table.texts(name)] if name in texts else [default] * len(table)
        for name, default in zip(FORCE_TEXTS, (arm.robot.tip, "base"), strict=True)
    )
    if unnamed is not None:
        loads[~there] = np.concatenate([unnamed.force, unnamed.moment])
        default = next(name for name, meant in FORCE_AXES.items() if meant == unnamed.axes)
        frames, axes = np.where(there, [frames, axes], [[unnamed.frame], [default]]).tolist()
    for line, frame, axis in zip(table.lines, frames, axes, strict=True):
        if frame not in arm.link_names:
            problem = f"force_frame: {UnknownNameError('link', frame, arm.link_names)}"
        elif axis not in FORCE_AXES:
            problem = f"force_axes is {axis!r}, expected base or link{did_you_mean(axis, FORCE_AXES)}"
        else:
            continue
        raise TableError(Place(table.path, line), problem)
    wrenches, pairs = [], list(zip(frames, axes, strict=True))
    for pair in dict.fromkeys(pair for pair, load in zip(pairs, loads, strict=True) if load.any()):
        of_pair = np.where([[other == pair] for other in pairs], loads, 0.0)
        wrenches.append(Wrench(pair[0], of_pair[:, :3], of_pair[:, 3:], FORCE_AXES[pair[1]]))
    return tuple(wrenches)


def read_loads(table: Table, arm: Arm, unnamed: Wrench | None = None) -> tuple[Wrench, ...]:
    """Return what loads a table's rows beside their payloads: known forces, and branches whose joints have columns.

    `unnamed` is as of `read_forces`.

    Raises:
        TableError: As `read_forces`; a position off the chain is no number, beyond its joint's limits, or not where the
            joint that it mimics puts it; or its joint carries none of the chain, or moves what is read or pulled at.
    """
    forces, robot = read_forces(table, arm, unnamed), arm.robot
    given: dict[str, Array] = {}
    for name in (name for name in robot.locked if f"q_{name}" in table.columns):
        joint, header = robot.urdf.joints[name], table.columns[f"q_{name}"].header
        if joint.faults:
            raise joint.faults[0].error
        if robot.stem(name) is None:
            text = f"column {header!r}: joint {name!r} does not hang on the chain from {robot.base!r} to {robot.tip!r}"
            raise table.fail(f"{text}: leave it out")
        given[name] = table.numbers(f"q_{name}")
        outside = ~((given[name] >= joint.lower - SLACK) & (given[name] <= joint.upper + SLACK))
        for i in np.flatnonzero(outside)[:1]:
            text = outside_limits(joint, float(given[name][i]))
            raise table.fail(f"column {header!r}: {text}", i)
        moved = set(robot.urdf.below(joint.child))
        read = {f"[instrument.{sensor.name}]": {sensor.link, sensor.seen_from} for sensor in arm.sensors.values()}
        for what, links in {**read, "force_frame": {wrench.frame for wrench in forces}}.items():
            if there := sorted(link for link in links if link in moved):
                text = f"{what} is at {there[0]!r}, which joint {name!r} off the chain moves"
                raise table.fail(f"column {header!r}: {text}: that is not supported")
    if stray := robot.stray(given):
        raise table.fail(stray[1], stray[0])
    return (*forces, *branches(robot, given)) if given else forces


FAR = 20.0
"""Times the length of a table of forces beyond which a path makes its unit doubtful."""


@dataclass(frozen=True, eq=False)
class ForceTable:
    """A load from outside that depends on how far along its path the tool is, linear between the table's rows.

    Attributes:
        path: The file.
        s: (K,) lengths of path [m], increasing.
        wrenches: For all K rows each.
    """

    path: Path | Frame
    s: Array
    wrenches: tuple[Wrench, ...]

    @property
    def varies(self) -> bool:
        """Whether it matters where along the path the tool is."""
        return any(np.ptp(part, axis=0).any() for wrench in self.wrenches for part in (wrench.force, wrench.moment))

    def at(self, lengths: Array) -> tuple[Wrench, ...]:
        """Return the loads at (N,) lengths of path [m], for all N rows each.

        Raises:
            InputError: A length is outside the table; the first one is named.
        """
        slack = 1e-9 * max(1.0, float(np.abs(self.s).max()))
        outside = (lengths < self.s[0] - slack) | (lengths > self.s[-1] + slack)
        for i in np.flatnonzero(outside)[:1]:
            has = f"{self.path}: the table of forces goes from {self.s[0]:.6g} to {self.s[-1]:.6g} m"
            far = np.ptp(self.s) and lengths[-1] > FAR * np.ptp(self.s)
            more = ": is the unit of s right?" if far else ""
            raise InputError(f"{has}, row {i} is at {lengths[i]:.6g} m of the path{more}")

        def between(values: Array) -> Array:
            return np.column_stack([np.interp(lengths, self.s, column) for column in values.T])

        return tuple(Wrench(load.frame, between(load.force), between(load.moment), load.axes) for load in self.wrenches)

    def missed(self, lengths: Array) -> float:
        """Return the largest force [N] that loads linear between (N,) lengths [m] leave out: corners of the table."""
        inside = self.s[(self.s > lengths[0]) & (self.s < lengths[-1])]
        seen, most = np.unique(lengths), 0.0
        for exact, rows in zip(self.at(inside), self.at(seen), strict=True):
            taken = np.column_stack([np.interp(inside, seen, column) for column in rows.force.T])
            most = max(most, float(np.linalg.norm(exact.force - taken, axis=1).max(initial=0.0)))
        return most


def read_force_table(path: str | Path, arm: Arm) -> ForceTable:
    """Read a table of forces over the length of a path: `s` [m] from the path's first row on, and `force_*` columns.

    The columns are those of a trajectory.csv, see `read_forces`.

    Raises:
        TableError: A column is missing or unknown, `s` does not increase, or as `read_forces`.
    """
    table, columns = read_table(path, {"s": "length", **FORCE_KINDS}), ("s", *FORCES, *FORCE_TEXTS)
    table.require(["s"])
    check_load_names(table, arm, (name for name in table.columns if name not in columns))
    for name in table.columns:
        if name not in columns:
            hint = did_you_mean(name, columns)
            raise table.fail(f"unknown column {table.columns[name].header!r}{hint}")
    if not any(name in table.columns for name in FORCES):
        raise table.fail(f"has none of {FORCES[0]} .. {FORCES[-1]}")
    if not len(table):
        raise TableError(Place(table.path), "has a header but no rows")
    s = table.numbers("s")
    for i in np.flatnonzero(np.diff(s) <= 0.0)[:1]:
        raise table.fail("s does not increase", i + 1)
    return ForceTable(table.path, s, read_forces(table, arm))


def force_columns(wrenches: Sequence[Wrench], count: int) -> dict[str, list]:
    """Return loads on each of so many rows as columns of a table, none where there are none; see `read_forces`.

    Raises:
        InputError: Two of them act in one row at different links or in different axes, for which there are no columns.
    """
    loads, frames, axes = np.zeros((count, 6)), [""] * count, [""] * count
    hung = [wrench.positions.items() for wrench in wrenches if isinstance(wrench, Branch)]
    held = {f"q_{name}": np.broadcast_to(at, count).tolist() for positions in hung for name, at in positions}
    names = {meant: name for name, meant in FORCE_AXES.items()}
    for wrench in (wrench for wrench in wrenches if not wrench.hangs):
        load = np.broadcast_to(np.hstack([wrench.force, wrench.moment]), (count, 6))
        for i in np.flatnonzero(load.any(axis=1)).tolist():
            here = (wrench.frame, names[wrench.axes])
            if frames[i] and (frames[i], axes[i]) != here:
                text = f"at {frames[i]!r} in axes of the {axes[i]} and at {here[0]!r} in those of the {here[1]}"
                raise InputError(f"row {i} has two loads from outside, {text}: a table has columns for one")
            (frames[i], axes[i]), loads[i] = here, loads[i] + load[i]
    if not any(frames):
        return held
    columns: dict[str, list] = held | {name: loads[:, i].tolist() for i, name in enumerate(FORCES)}
    return columns | dict(zip(FORCE_TEXTS, (frames, axes), strict=True))
