"""A campaign as the catalogue sees it: everything known in every driven row, and which columns are candidates."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from armflex.conventions import RESOLUTION, Array
from armflex.laws import Row
from armflex.laws.effects.location import LINK, TOOL, Here, Location, link_of, path_to, resolve, site_names
from armflex.laws.row import MASS
from armflex.robot import Robot
from armflex.rows import Driven, Rows
from armflex.rows.rows import HOLD, LEVEL_OF, POSE, ROW, TIME

if TYPE_CHECKING:
    from armflex.laws.effects.effect import Manipulator, Memory, Solved, Values

Known = TypeVar("Known", float, Array)

TEMPERATURE = re.compile(r"temp|^T$|^T_|deg_?c$|celsius", re.IGNORECASE)
"""Names of columns that count as a temperature."""

AXES_TURN = ("rx", "ry", "rz")
AXES = ("dx", "dy", "dz", *AXES_TURN)


@dataclass(frozen=True, eq=False)
class Records:
    """What decides where effects make sense: the robot, and the names of what is known beside its joints.

    Attributes:
        robot: The robot.
        recorded: Numeric columns that vary, which are candidates.
        moved: Joints whose position varies, None where no campaign says which.
        timed: Whether it is known when the rows were taken.
        levels: Candidates that are entries of a text column: 1 where the column has it, else 0.
        payloads: Those that weigh.
        sessions: In their order.
        springs: Their names.
        stars: Whether an instrument reads the direction of something far away.
    """

    robot: Robot
    recorded: tuple[str, ...] = ()
    moved: tuple[str, ...] | None = None
    timed: bool = False
    levels: tuple[str, ...] = ()
    payloads: tuple[str, ...] = ()
    sessions: tuple[str, ...] = ()
    springs: tuple[str, ...] = ()
    stars: bool = False

    @property
    def temperatures(self) -> tuple[str, ...]:
        """Candidates that are called a temperature."""
        return tuple(name for name in self.recorded if TEMPERATURE.search(name))

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints with a drive, and cylinders."""
        return self.robot.joint_names

    @property
    def positions(self) -> tuple[str, ...]:
        """Columns of joints' positions that are candidates: one that never moves is none."""
        return tuple(f"q_{joint}" for joint in (self.joints if self.moved is None else self.moved))

    def axes(self, joint: str) -> tuple[str, ...]:
        """Return along and about what something may give at a joint: a cylinder along itself alone."""
        return AXES[:1] if any(joint == cylinder.name for cylinder in self.robot.linkage.cylinders) else AXES

    @property
    def links(self) -> tuple[str, ...]:
        """Sites at the ends of the links that move, the tool's last."""
        jointed = self.robot.jointed
        moved = [joint for joint in jointed if any(name in jointed for name in path_to(joint, self.robot)[:-1])]
        return (*(LINK + joint.name for joint in moved), TOOL)

    @property
    def bodies(self) -> tuple[str, ...]:
        """Of these one for each link: several joints may hang on one."""
        return tuple({link_of(site, self.robot): site for site in reversed(self.links)}.values())[::-1]


@dataclass(frozen=True, eq=False)
class Context:
    """What is known in the N rows of a campaign, measured or not.

    Attributes:
        robot: The robot.
        row: Joint positions and every numeric column of all rows, in the order driven.
        recorded: Names of the numeric columns that vary, which are candidates.
        payloads: Name of each row's payload.
        sessions: Name of each row's session.
        wrenches: (N, 6) load on the structure at every site, local axes.
        box: (2, 3) lowest and highest coordinates that any link was at [m], base axes.
        pieces: Numbers of the rows of every campaign, between which nothing is remembered.
        springs: Names of the arm's springs.
        stars: Whether an instrument reads the direction of something far away.
    """

    robot: Robot
    row: Row
    recorded: tuple[str, ...]
    payloads: tuple[str, ...]
    sessions: tuple[str, ...]
    wrenches: Mapping[str, Array]
    box: Array
    pieces: tuple[np.ndarray, ...] = ()
    springs: tuple[str, ...] = ()
    stars: bool = False

    @cached_property
    def records(self) -> Records:
        """What decides where effects make sense."""
        columns = self.row.covariates
        levels = tuple(name for name, values in columns.items() if LEVEL_OF in name and varies(values))
        mass = columns.get(MASS, np.zeros(len(self.payloads)))
        payloads = sorted({name for name, kilograms in zip(self.payloads, mass, strict=True) if kilograms > 0.0})
        sessions = tuple(dict.fromkeys(self.sessions))
        moved = tuple(joint for joint in self.joints if varies(self.row.position(joint)))
        more = (tuple(payloads), sessions, self.springs, self.stars)
        return Records(self.robot, self.recorded, moved, self.timed, levels, *more)

    @property
    def timed(self) -> bool:
        """Whether it is known when the rows were taken."""
        return "time" in self.row.covariates

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """Moving joints of the chain."""
        return self.robot.joint_names

    @cached_property
    def sites(self) -> tuple[str, ...]:
        """All sites from base to tool."""
        return site_names(self.robot)

    @property
    def size(self) -> float:
        """Diagonal of `box` [m]."""
        return float(np.linalg.norm(np.ptp(self.box, axis=0)))

    def column(self, name: str) -> Array:
        """Return the (N,) values of a column or of a joint's position ('q_J')."""
        return self.row.column(name)

    def at_time(self, moment: float) -> Context:
        """Return the context as if all rows were at a moment [s]."""
        columns = {**self.row.covariates, TIME: np.full(len(self.payloads), moment)}
        return replace(self, row=replace(self.row, covariates=columns))

    def later(self, seconds: float) -> Context:
        """Return the context on a clock that is ahead."""
        if not seconds:
            return self
        columns = {**self.row.covariates, TIME: self.column(TIME) + seconds}
        return replace(self, row=replace(self.row, covariates=columns))

    def here(self, location: Location, arm: Manipulator) -> Here:
        """Return what is known about the arm at a location."""
        kept = self._heres.get(location)
        if kept is None or kept[0] is not arm:
            self._heres[location] = kept = (arm, resolve(location, arm.robot, arm.flexures))
        return kept[1]

    @cached_property
    def _heres(self) -> dict[Location, tuple[Manipulator, Here]]:
        return {}

    def row_at(self, view: Solved) -> Row:
        """Return what is known in a view's rows."""
        key = view.rows.tobytes()
        if key not in self._rows:
            self._rows[key] = self.row.some(view.rows)
        return self._rows[key]

    @cached_property
    def _rows(self) -> dict[bytes, Row]:
        return {}

    def remembered(self, memory: Memory, location: Location, inner: Values, view: Solved) -> Array:
        """Return the (N,) state of a memory at a location; one of a column is the same at every location, and kept."""
        here = self.here(location, view.arm)
        if not location.covariates:
            return memory.over(self.pieces, here, self.wrench(view, location.site), self.row, inner)
        key = (memory, location.covariates, inner)
        if key not in self._states:
            self._states[key] = memory.over(self.pieces, here, self.wrenches[location.site], self.row, inner)
        return self._states[key]

    @cached_property
    def _states(self) -> dict[tuple[Memory, tuple[str, ...], Values], Array]:
        return {}

    def wrench(self, view: Solved, site: str) -> Array:
        """Return the (N, 6) wrench at a site: the view's own where it has a row, else that of the context."""
        wrench = self.wrenches[site].copy()
        wrench[view.rows] = view.load_at(site)
        return wrench


def varies(values: Array) -> bool:
    """Return whether (N,) values differ by more than rounding: a shape over their range is none where they do not."""
    return bool(np.ptp(values) > RESOLUTION * max(float(np.abs(values).max()), 1e-9))


def survey(
    rows: Rows,
    arm: Manipulator,
    columns: Mapping[str, Array],
    wrenches: Mapping[str, Array],
    points: Array,
    stars: bool = False,
) -> Context:
    """Return the context of a campaign.

    Args:
        rows: All rows in the order driven.
        arm: The arm; its payloads' masses are candidates, too.
        columns: Everything known of the rows, (N,) each; see `known_rows`.
        wrenches: (N, 6) loads at every site.
        points: (..., 3) where links were, in the base [m].
        stars: Whether an instrument reads the direction of something far away.
    """
    hidden = {POSE, ROW, *(f"approach_{joint}" for joint in rows.joint_names)}
    candidates = [name for name in known_columns(rows, arm) if name not in hidden and LEVEL_OF not in name]
    recorded = tuple(name for name in candidates if varies(columns[name]))
    places = points.reshape(-1, 3)
    box = np.array([places.min(axis=0), places.max(axis=0)])
    index = {name: i for i, name in enumerate(rows.joint_names)}
    row = Row(rows.q, index, dict(columns))
    pieces = tuple(rows.pieces.values())
    return Context(
        arm.robot,
        row,
        recorded,
        rows.payload,
        rows.session,
        wrenches,
        box,
        pieces,
        tuple(spring.name for spring in arm.springs),
        stars,
    )


def begun_anew(arm: Manipulator, columns: Mapping[str, Known], none: Known) -> dict[str, Known]:
    """Return what is known, and `none` for how long a load has stood where effects depend on it and it is not."""
    needed = any(HOLD in effect.location.covariates for effect in arm.effects)
    return {HOLD: none, **columns} if needed else dict(columns)


def known_columns(rows: Driven, arm: Manipulator) -> dict[str, Array]:
    """Return everything that is known of rows by name, each payload's mass included, (N,) numbers each.

    An entry of a text column that effects depend on and these rows never have is 0 throughout.
    """
    keys = [payload if isinstance(payload, str) else id(payload) for payload in rows.payload]  # a payload has arrays
    weights = {key: arm.payload(payload).mass for key, payload in dict(zip(keys, rows.payload, strict=True)).items()}
    columns = begun_anew(arm, rows.known, np.zeros(len(rows.q))) | {MASS: np.array([weights[key] for key in keys])}
    asked = {name for effect in arm.effects for name in effect.location.covariates}
    if isinstance(rows, Rows) and POSE in asked:
        columns[POSE] = rows.pose_number.astype(float)
    if ROW in asked:
        columns[ROW] = np.arange(float(len(rows.q)))
    texts = {name.partition(LEVEL_OF)[0] for name in columns if LEVEL_OF in name}
    levels = {name for name in asked if LEVEL_OF in name}
    return {name: np.zeros(len(rows.q)) for name in levels if name.partition(LEVEL_OF)[0] in texts} | columns
