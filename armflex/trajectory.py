"""Trajectories: joint positions over time, some of them via-points."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from armflex.arm import Arm
from armflex.conventions import Array
from armflex.errors import Flag, InputError, Place, ShapeError, TableError, did_you_mean
from armflex.laws.effects.context import MASS
from armflex.laws.effects.remember import check_approaches, check_covariates, derived_direction
from armflex.measured.table import check_payloads, joint_kinds, read_table, write_table
from armflex.mechanics.history import known_rows
from armflex.rows.rows import APPROACH, last_motion
from armflex.rows.wrench import Wrench

SHORTEST = 1e-9
"""No controller's rows follow each other sooner [s]; speeds over less may be beyond all numbers."""


class Points(NamedTuple):
    """Points of a path in any order.

    Attributes:
        time: (M,) [s].
        q: (M, nq) joint positions [rad or m].
        payload: Name of each one's payload.
        v, a: (M, nq) joint velocities [rad/s or m/s] and accelerations, None where the path is slow.
        covariates: Further columns by name, (M,) each in its own unit.
    """

    time: Array
    q: Array
    payload: Sequence[str]
    v: Array | None
    a: Array | None
    covariates: Mapping[str, Array]


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A path through joint space; between rows it is straight.

    Attributes:
        joint_names: Order of the columns of q.
        time: (N,) [s], increasing.
        q: (N, nq) joint positions [rad or m].
        payload: Name of what is carried from each row on.
        via: Name of the row where it is a via-point, else ''.
        v, a: (N, nq) joint velocities [rad/s or m/s] and accelerations where inertial loads count, else None.
        covariates: Further columns, (N,) each in its own unit; `approach_<joint>` is the direction of the way there.
        places: Where each row stands in a file, none where rows are not those of one.
        wrenches: Known loads from outside, the same in all rows or one for each of the N.
    """

    joint_names: tuple[str, ...]
    time: Array
    q: Array
    payload: tuple[str, ...]
    via: tuple[str, ...]
    v: Array | None = None
    a: Array | None = None
    covariates: Mapping[str, Array] = field(default_factory=dict)
    places: tuple[Place, ...] = ()
    wrenches: tuple[Wrench, ...] = ()

    def __post_init__(self) -> None:
        count = len(self.time)
        if count == 0 or self.q.shape != (count, len(self.joint_names)):
            raise ShapeError(f"trajectory q: expected ({count}, {len(self.joint_names)}), got {self.q.shape}")
        if len(self.payload) != count or len(self.via) != count:
            raise ShapeError(f"trajectory: expected {count} payload and via names")
        if count > 1 and not (np.diff(self.time) > 0.0).all():
            row = int(np.argmin(np.diff(self.time) > 0.0)) + 1
            raise InputError(f"trajectory: time does not increase at row {row} ({self.time[row]:g} s)")

    def __len__(self) -> int:
        return len(self.time)

    def between(self, segments: np.ndarray, fractions: Array) -> Points:
        """Return points at (M,) fractions, dimensionless, of the way from (M,) rows to the next, payloads as there."""

        def part(values: Array) -> Array:
            steps, there = fractions.reshape(-1, *[1] * (values.ndim - 1)), values[segments + 1]
            # At its end a stretch is at the next row to the last digit.
            return np.where(steps == 1.0, there, values[segments] + steps * (there - values[segments]))

        def known(name: str, values: Array) -> Array:
            # On the way to a row the joints move as they do when they get there.
            return values[segments + 1] if name.startswith(APPROACH) else part(values)

        return Points(
            part(self.time),
            part(self.q),
            [self.payload[i] for i in segments.tolist()],
            None if self.v is None else part(self.v),
            None if self.a is None else part(self.a),
            {name: known(name, values) for name, values in self.covariates.items()},
        )

    @property
    def known(self) -> dict[str, Array]:
        """Time [s], every further column, and the joints' last motion where no column gives it, (N,) each by name."""
        moved = last_motion(self.q)
        approach = {f"{APPROACH}{joint}": moved[:, i] for i, joint in enumerate(self.joint_names)}
        return {"time": self.time, **approach, **self.covariates}

    def asked(self, i: int) -> dict[str, Any]:
        """Return row i's motion and what else is known of it as `Arm.deflection` takes them."""
        known = {name: values[i] for name, values in self.covariates.items()}
        return {**self.motion(i), "covariates": {"time": self.time[i], **known}}

    def with_constants(self, arm: Arm, constants: Mapping[str, float]) -> Trajectory:
        """Return the trajectory in the arm's order of joints with further columns that are the same in every row.

        Raises:
            InputError: One is a column already, or no effect of the arm depends on it, or an `approach_` is not -1, 0
                or 1; or the joints are not the arm's.
        """
        check_approaches(constants, self.joint_names)
        for name in constants:
            if name in self.covariates or name == "time":
                raise InputError(f"covariate {name!r} is a column of the trajectory already")
        check_covariates(arm, constants)
        added = {name: np.full(len(self), float(value)) for name, value in constants.items()}
        return replace(self.for_arm(arm), covariates={**self.covariates, **added})

    def prepared(self, arm: Arm) -> Trajectory:
        """Return the trajectory in the arm's order of joints with everything that the arm's effects ask for.

        What depends on the rows before is worked out over the rows: the side from which a joint came, lagged
        temperatures, play.

        Raises:
            InputError: The joints are not the arm's.
            MissingCovariateError: A state needs a column that is not there.
        """
        ordered = self.for_arm(arm)
        if not arm.effects:
            return ordered
        known = known_rows(arm, ordered)
        # A payload's mass goes with the payload, and time with the rows.
        kept = {name: values for name, values in known.items() if name not in (MASS, "time")}
        return replace(ordered, covariates=kept)

    def derived_directions(self, arm: Arm) -> tuple[Flag, ...]:
        """Return a flag for every direction that the arm's effects depend on and no column gives."""
        moved = self.known
        asked = dict.fromkeys(name for effect in arm.effects for name in effect.location.covariates)
        names = [name for name in asked if name.startswith(APPROACH) and name not in self.covariates]
        return tuple(derived_direction(name, int((moved[name] == 0.0).sum())) for name in names)

    def motion(self, i: int) -> dict[str, Array | None]:
        """Return row i's (nq,) velocities [rad/s or m/s] and accelerations as `Arm.deflection` takes them."""
        return {"v": None if self.v is None else self.v[i], "a": None if self.a is None else self.a[i]}

    def for_arm(self, arm: Arm) -> Trajectory:
        """Return the trajectory with its columns in the arm's order of joints.

        Raises:
            InputError: The joints are not the arm's.
        """
        if self.joint_names == arm.joint_names:
            return self
        if sorted(self.joint_names) != sorted(arm.joint_names):
            raise InputError(
                f"trajectory of joints {', '.join(self.joint_names)}, the arm has {', '.join(arm.joint_names)}"
            )
        order = [self.joint_names.index(name) for name in arm.joint_names]
        moved = {name: None if x is None else x[:, order] for name, x in (("v", self.v), ("a", self.a))}
        return replace(self, joint_names=arm.joint_names, q=self.q[:, order], **moved)

    def with_midpoints(self, segments: np.ndarray) -> Trajectory:
        """Return the trajectory with a row inserted halfway along each segment marked in a (N - 1,) mask."""
        after = np.flatnonzero(segments) + 1

        def insert(values: Array, next_one: bool = False) -> Array:
            middle = values[after] if next_one else 0.5 * (values[after - 1] + values[after])
            return np.insert(values, after, middle, axis=0)

        payload, via = list(self.payload), list(self.via)
        for place in reversed(after.tolist()):
            payload.insert(place, payload[place - 1])
            via.insert(place, "")
        covariates = {name: insert(values, name.startswith(APPROACH)) for name, values in self.covariates.items()}
        v, a = (None if values is None else insert(values) for values in (self.v, self.a))
        time, q = insert(self.time), insert(self.q)
        return Trajectory(self.joint_names, time, q, tuple(payload), tuple(via), v, a, covariates)


def read_trajectory(path: str | Path, arm: Arm) -> Trajectory:
    """Read a trajectory.csv for an arm.

    Raises:
        TableError: A column is missing, misspelt or not numeric; time does not increase; a payload is unknown.
    """
    kinds = {"time": "time"} | joint_kinds(arm, "qva")
    table = read_table(path, kinds)
    names = {prefix: [f"{prefix}_{joint}" for joint in arm.joint_names] for prefix in "qva"}
    table.require(["time", *names["q"]])
    known = [*kinds, "payload", "via"]
    others = [name for name in table.columns if name not in known]
    for name in others:
        if misspelt(name, known) or name.startswith("q_"):
            hint = did_you_mean(name, known)
            raise TableError(Place(table.path, 1), f"unknown column {table.columns[name].header!r}{hint}")
    covariates = {name: table.numbers(name) for name in others}
    try:
        for name, values in covariates.items():
            for value in dict.fromkeys(values.tolist()):
                check_approaches({name: value}, arm.joint_names)
    except InputError as error:
        raise TableError(Place(table.path, 1), str(error)) from None
    if not len(table):
        raise TableError(Place(table.path), "has a header but no rows")
    payload = table.texts("payload") if "payload" in table.columns else ("none",) * len(table)
    check_payloads(table, payload, arm)
    time = table.numbers("time")
    slow = np.diff(time) >= SHORTEST
    if not slow.all():
        line = table.lines[int(np.argmin(slow)) + 1]
        raise TableError(Place(table.path, line), f"time does not increase, by {SHORTEST:g} s at least")
    moved: dict[str, Array | None] = {}
    for prefix in "va":
        given = any(name in table.columns for name in names[prefix])
        table.require(names[prefix] if given else ())
        moved[prefix] = table.matrix(names[prefix]) if given else None
    return Trajectory(
        arm.joint_names,
        time,
        table.matrix(names["q"]),
        tuple(name or "none" for name in payload),
        table.texts("via") if "via" in table.columns else ("",) * len(table),
        moved["v"],
        moved["a"],
        covariates=covariates,
        places=tuple(Place(table.path, line) for line in table.lines),
    )


def misspelt(name: str, known: Iterable[str]) -> bool:
    """Return whether a column's name is so near to one with a meaning that it is taken for a mistake."""
    return bool(difflib.get_close_matches(name.lower(), [one.lower() for one in known], n=1, cutoff=0.75))


def write_trajectory(trajectory: Trajectory, path: str | Path) -> Path:
    """Write a trajectory.csv, whole or not at all."""
    columns: dict[str, list] = {"time": trajectory.time.tolist()}
    for prefix, values in (("q", trajectory.q), ("v", trajectory.v), ("a", trajectory.a)):
        if values is not None:
            columns |= {f"{prefix}_{name}": values[:, i].tolist() for i, name in enumerate(trajectory.joint_names)}
    columns |= {"payload": list(trajectory.payload), "via": list(trajectory.via)}
    columns |= {name: values.tolist() for name, values in trajectory.covariates.items()}
    return write_table(path, columns)
