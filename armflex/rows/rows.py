"""Rows: what an arm was commanded and what was recorded beside it, whether or not anything was read there.

Which of them were taken in the same pose is decided here, too: what is split for validation is poses, never rows.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from armflex.conventions import NUMBER, Array
from armflex.errors import InputError, Place
from armflex.rows.wrench import Wrench, wrenches_in

STILL = 1e-9
"""Joints that move by less [rad or m] from row to row stand still: rounding turns no joint round."""

POSE, ROW = "pose_number", "row_number"
"""Columns that number the poses and the rows; for random twists, not candidates, and not among what is known of rows by
itself."""

TIME = "time"
"""Column of when a row was, on the clock of its table [s]."""

HOLD = "hold"
"""Column of how long the load has stood [s]."""

APPROACH = "approach_"
"""Begins the name of a column that says from which side a joint came: 1 upwards, -1 downwards, 0 neither."""

LEVEL_OF = "="
"""Parts a text column's name from one of its entries in the name of a column that says where it has that entry."""

MOST_LEVELS = 12
"""Different entries of a text column up to which each may be a cause of its own."""

SomeRows = TypeVar("SomeRows", bound="Rows")


class Driven(Protocol):
    """Rows in the order driven: a campaign, or a trajectory."""

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Order of the columns of q."""
        ...

    @property
    def q(self) -> Array:
        """(N, nq) joint positions."""
        ...

    @property
    def payload(self) -> tuple[str, ...]:
        """Name of each row's payload."""
        ...

    @property
    def wrenches(self) -> Sequence[Wrench]:
        """Known loads from outside, the same in all rows or one for each of them."""
        ...

    @property
    def known(self) -> dict[str, Array]:
        """(N,) each: time where it was recorded, every numeric column, and `approach_<joint>`."""
        ...

    def motion(self, i: int) -> dict[str, Array | None]:
        """Return row i's (nq,) velocities [rad/s or m/s] and accelerations [rad/s^2 or m/s^2], for `Arm.deflection`."""
        ...


@dataclass(frozen=True, eq=False, kw_only=True)
class Rows:
    """One configuration per row, in the order driven.

    Attributes:
        joint_names: Order of the columns of q.
        pose, session, payload: Names of each row; a missing column is one session, and every row a pose of its own.
        time: (N,) [s], the row number where none is given, which no effect may then depend on.
        q: (N, nq) controller's joint positions [rad or m].
        approach: (N, nq) direction each joint last moved in, dimensionless: -1 or +1; 0 where none is known.
        measured: (N,) True where something was read, or is to be.
        hold: (N,) time the load has stood [s], None when not recorded.
        covariates: Every other column: (N,) numbers in the column's unit, or text per row.
        places: File and line of each row, none where rows are not those of a file.
        derived: Columns that were not given but follow from the order of the rows: `time`, `approach_<joint>`.
        wrenches: Known loads from outside, the same in all rows or one for each of the N.
        campaign: Name of each row's where several were joined, else none; no memory goes from one to the next.
    """

    joint_names: tuple[str, ...]
    pose: tuple[str, ...]
    session: tuple[str, ...]
    payload: tuple[str, ...]
    time: Array
    q: Array
    approach: Array
    measured: np.ndarray
    hold: Array | None = None
    covariates: Mapping[str, Array | tuple[str, ...]] = field(default_factory=dict)
    places: tuple[Place, ...] = ()
    derived: tuple[str, ...] = ()
    wrenches: tuple[Wrench, ...] = ()
    campaign: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        joint_names: tuple[str, ...],
        q: Array,
        payload: Sequence[str],
        given: Mapping[str, ArrayLike],
        pose: Sequence[str] | None = None,
        session: str = "",
        derived: tuple[str, ...] = (),
    ) -> Rows:
        """Return rows of (N, nq) joint positions with what is known of them, all of them to be read.

        Args:
            joint_names: Order of the columns of q.
            q: (N, nq) joint positions [rad or m].
            payload: What is carried in each.
            given: Numbers or (N,) by name: `time`, `hold`, `approach_<joint>` (0 where not given) and covariates.
            pose: Name of each row's pose, its number where none is given.
            session: Of all of them.
            derived: What was not given, see `Rows.derived`.
        """
        count = len(q)
        columns = {name: np.broadcast_to(np.asarray(values, dtype=float), count) for name, values in given.items()}
        approach = [columns.pop(f"{APPROACH}{joint}", np.zeros(count)) for joint in joint_names]
        return Rows(
            joint_names=joint_names,
            pose=tuple(map(str, range(count))) if pose is None else tuple(pose),
            session=(session,) * count,
            payload=tuple(payload),
            time=columns.pop("time", np.arange(count, dtype=float)),
            q=q,
            approach=np.stack(approach, axis=1),
            measured=np.ones(count, dtype=bool),
            hold=columns.pop("hold", None),
            covariates=columns,
            derived=derived,
        )

    def __len__(self) -> int:
        return len(self.time)

    @property
    def known(self) -> dict[str, Array]:
        """Everything that is known of the rows by name, (N,) numbers each in the column's unit, text by its levels.

        `column=level` is 1 where a column says so, else 0; see `levels`.
        """
        columns: dict[str, Array] = {} if "time" in self.derived else {"time": self.time}
        if self.hold is not None:
            columns["hold"] = self.hold
        columns |= {name: values for name, values in self.covariates.items() if isinstance(values, np.ndarray)}
        for name, cells in self.covariates.items():
            if isinstance(cells, tuple):
                columns |= level_columns(name, cells, levels(cells))
        columns |= {f"{APPROACH}{joint}": self.approach[:, i] for i, joint in enumerate(self.joint_names)}
        return columns

    def levelled(self: SomeRows) -> SomeRows:
        """Return the rows with the levels of text columns in their place: what some of them know is then as of all."""
        if all(isinstance(values, np.ndarray) for values in self.covariates.values()):
            return self
        kept = {name: values for name, values in self.covariates.items() if isinstance(values, np.ndarray)}
        return replace(self, covariates=kept | {name: v for name, v in self.known.items() if LEVEL_OF in name})

    @cached_property
    def pose_number(self) -> np.ndarray:
        """(N,) number of every row's pose, by name or by where the joints stand; see `pose_groups`."""
        return pose_groups(self)

    @cached_property
    def load_number(self) -> np.ndarray:
        """(N,) number of what loads every row: equal where the payload and all known forces are."""
        parts = [part for wrench in self.wrenches if wrench.rows for part in (wrench.force, wrench.moment)]
        pulled = np.hstack([np.zeros((len(self), 0)), *parts])
        return numbered(zip(self.payload, map(tuple, pulled.tolist()), strict=True))

    @cached_property
    def pieces(self) -> dict[str, np.ndarray]:
        """Numbers of the rows of every campaign, '' where there is one."""
        names = np.array(self.campaign or ("",) * len(self))
        return {name: np.flatnonzero(names == name) for name in dict.fromkeys(names.tolist())}

    def motion(self, i: int) -> dict[str, Array | None]:
        """Return no (nq,) velocities [rad/s or m/s] and accelerations [rad/s^2 or m/s^2]: rows stand still."""
        return {}

    def some(self: SomeRows, rows: np.ndarray | Sequence[int]) -> SomeRows:
        """Return the rows of (M,) numbers, in their order."""
        return replace(self, **self._some(np.asarray(rows, dtype=int)))

    def _some(self, rows: np.ndarray) -> dict[str, Any]:
        """Return the fields of some rows."""

        def taken(values: Any) -> Any:
            return values[rows] if isinstance(values, np.ndarray) else tuple(values[row] for row in rows)

        names = ("pose", "session", "payload", "time", "q", "approach", "measured")
        return {name: taken(getattr(self, name)) for name in names} | {
            "hold": None if self.hold is None else self.hold[rows],
            "covariates": {name: taken(values) for name, values in self.covariates.items()},
            "places": taken(self.places) if self.places else (),
            "wrenches": wrenches_in(self.wrenches, rows),
            "campaign": taken(self.campaign) if self.campaign else (),
        }


def levels(cells: Sequence[str]) -> tuple[str, ...]:
    """Return the different entries of a text column; none where they are too many, or numbers with gaps."""
    names = sorted(set(cells))
    return () if len(names) > MOST_LEVELS or mostly_numbers(cells) else tuple(names)


def mostly_numbers(cells: Sequence[str]) -> bool:
    """Return whether most cells of a text column are numbers."""
    return 2 * sum(bool(NUMBER.fullmatch(cell)) for cell in cells) > len(cells)


def last_motion(q: Array, before: tuple[Array, Array] | None = None) -> Array:
    """Return the (N, nq) sign of each joint's last change over rows of (N, nq) positions, 0 before the first.

    `before` is the row that goes before them: its (nq,) positions and what is returned of it.
    """
    start, motion = (q[:1], np.zeros((1, q.shape[1]))) if before is None else (part[None] for part in before)
    step = np.diff(q, axis=0, prepend=start)
    moved = np.vstack([motion, np.where(np.abs(step) > STILL, np.sign(step), 0.0)])
    last = np.maximum.accumulate(np.where(moved != 0.0, np.arange(len(moved))[:, None], 0), axis=0)
    return np.take_along_axis(moved, last, axis=0)[1:]


def level_columns(name: str, cells: Sequence[str], of: Sequence[str]) -> dict[str, Array]:
    """Return (N,) columns that say where a text column has which of its levels, 1 or 0."""
    return {f"{name}{LEVEL_OF}{level}": np.array([float(cell == level) for cell in cells]) for level in of}


SAME_POSE = 1e-3
"""Joint positions nearer than this [rad or m] are one pose: a fit that saw one of them has seen the other."""


def pose_groups(rows: Rows, tolerance: float = SAME_POSE) -> np.ndarray:
    """Return (N,) integers from 0 in order of appearance, equal for rows of one pose, whatever they carried.

    Rows share a pose when they share its name, or when their joint positions differ by less than `tolerance`
    [rad or m]: names alone would let a pose that was measured twice under two names into both sides of a split.
    """
    by_place = same_positions(rows.q, tolerance)
    if len(by_place) < 2:
        return by_place
    from scipy.sparse import coo_array  # not needed by a controller
    from scipy.sparse.csgraph import connected_components

    by_name = numbered(rows.pose) + by_place.max() + 1
    links = coo_array((np.ones(len(by_place)), (by_place, by_name)), shape=(by_name.max() + 1,) * 2)
    return numbered(connected_components(links, directed=False)[1][by_place].tolist())


def leaked(train: Rows, test: Rows, tolerance: float = SAME_POSE) -> np.ndarray:
    """Return the (k,) row numbers of `test` whose joint positions `train` has, within `tolerance` [rad or m], as well.

    Raises:
        InputError: The two are of different joints.
    """
    if train.joint_names != test.joint_names:
        raise InputError(f"joints {', '.join(train.joint_names)} against {', '.join(test.joint_names)}")
    labels = same_positions(np.vstack([train.q, test.q]), tolerance)
    return np.flatnonzero(np.isin(labels[len(train) :], labels[: len(train)]))


def same_positions(q: Array, tolerance: float) -> np.ndarray:
    """Return (N,) labels of (N, nq) joint positions; chains of neighbours within `tolerance` share one."""
    if len(q) == 1:  # a controller asks reading by reading
        return np.zeros(1, dtype=int)
    # np.unique sorts by the first column: with the most varied joint there, few rows are near each other in it.
    order = np.argsort([-len(np.unique(column)) for column in q.T], kind="stable")
    unique, back = np.unique(q[:, order], axis=0, return_inverse=True)
    parent = np.arange(len(unique))
    for i, row in enumerate(unique):
        end = np.searchsorted(unique[:, 0], row[0] + tolerance, side="right")
        near = i + np.flatnonzero((np.abs(unique[i:end] - row) <= tolerance).all(axis=1))
        roots = [_root(parent, int(k)) for k in near]
        parent[roots] = min(roots)
    return numbered(_root(parent, i) for i in back.ravel().tolist())


def numbered(values: Iterable[Hashable]) -> np.ndarray:
    """Return an integer for each value, from 0 in order of appearance."""
    seen: dict[Hashable, int] = {}
    return np.array([seen.setdefault(value, len(seen)) for value in values], dtype=int)


def _root(parent: np.ndarray, i: int) -> int:
    while parent[i] != i:
        i = int(parent[i])
    return i
