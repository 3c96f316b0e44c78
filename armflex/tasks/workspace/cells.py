"""What is asked of an arm at many configurations, and what was found in each cell of space.

A single answer is a tally of one row, so that counting answers and joining tallies are the same thing. It takes the
place of a list of all answers: its size is that of the space reached, however many answers there were.
"""

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from itertools import product
from typing import Any
from uuid import uuid4

import numpy as np

from armflex.arm import Arm, ManyRows
from armflex.conventions import Array
from armflex.errors import NO_ANSWER, ArmflexError, ClosureError, Flag, no_answer
from armflex.estimate.tip_uncertainty import tip_covariance
from armflex.mechanics.deflection import DeflectionBatch, length_sigma
from armflex.mechanics.loop_rows import closing_drives
from armflex.parallel import in_halves

BITS = 21
"""Bits of a cell's number for each axis."""

SIDE = 1 << (BITS - 1)
"""Cells are numbered from -SIDE to SIDE - 1 along each axis."""


@dataclass(frozen=True, eq=False)
class Tally:
    """Rows of answers; once `joined`, one row for each of V cells, in the order of their numbers.

    Attributes:
        cell: (V,) number of the cell, see `cell_numbers`.
        configurations: (V,) how many had their rigid tip there.
        answered: (V,) how many answers there are, one for each configuration and payload.
        refused: (V, r) how many were refused for each of r reasons.
        total: (V,) sum of the displacements [m].
        worst: (V,) largest displacement [m], -inf where there is no answer.
        payload: (V,) number of the payload that it is of.
        q: (V, nq) its joint positions [rad or m].
        worst_of_draws: (V,) largest displacement of any drawn arm [m], inf where one has no answer, -inf where none
            were drawn.
    """

    cell: np.ndarray
    configurations: np.ndarray
    answered: np.ndarray
    refused: np.ndarray
    total: Array
    worst: Array
    payload: np.ndarray
    q: Array
    worst_of_draws: Array

    def __len__(self) -> int:
        return len(self.cell)


SUMMED = ("configurations", "answered", "refused", "total")
OF_WORST = ("cell", "worst", "payload", "q")


def joined(tallies: Sequence[Tally]) -> Tally:
    """Return one row for each cell that any of the tallies has; of equally bad answers the first is kept.

    The result depends on the order of the tallies in its last digits only, and not at all on where they were made.
    """
    parts = {field.name: np.concatenate([getattr(each, field.name) for each in tallies]) for field in fields(Tally)}
    if not len(parts["cell"]):
        return Tally(**parts)
    order = np.lexsort((-parts["worst"], parts["cell"]))  # stable
    parts = {name: values[order] for name, values in parts.items()}
    first = np.flatnonzero(np.diff(parts["cell"], prepend=parts["cell"][0] - 1))
    return Tally(
        **{name: np.add.reduceat(parts[name], first, axis=0) for name in SUMMED},
        **{name: parts[name][first] for name in OF_WORST},
        worst_of_draws=np.maximum.reduceat(parts["worst_of_draws"], first),
    )


def cell_numbers(points: Array, size: float) -> np.ndarray:
    """Return the (N,) number of the cell of edge `size` that each of (N, 3) points is in."""
    x, y, z = (np.floor(points / size).astype(np.int64) + SIDE).T
    return (x << 2 * BITS) | (y << BITS) | z


def cell_indices(numbers: np.ndarray) -> np.ndarray:
    """Return the (V, 3) index of cells along x, y and z: cell 0 0 0 has the origin as its lowest corner."""
    mask = (1 << BITS) - 1
    return np.stack([numbers >> 2 * BITS, (numbers >> BITS) & mask, numbers & mask], axis=1) - SIDE


@dataclass(frozen=True, eq=False)
class MapQuestion:
    """An arm, what it carries, and how its answers are distinguished.

    Attributes:
        arms: The arm, and others drawn from what is known of it.
        payloads: Names; "none" for nothing.
        voxel: Edge of a cell [m].
        options: Of `Arm.deflection`, covariates among them.
        rows: Configurations under all payloads, of the whole question: one engine answers all of them.
        token: Names this question among all that a worker ever gets.
    """

    arms: tuple[Arm, ...]
    payloads: tuple[str, ...]
    voxel: float
    options: Mapping[str, Any]
    rows: int
    token: str = field(default_factory=lambda: uuid4().hex)

    @property
    def arm(self) -> Arm:
        """The arm itself."""
        return self.arms[0]

    def __hash__(self) -> int:
        return hash(self.token)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, MapQuestion) and other.token == self.token


@dataclass(frozen=True, eq=False)
class Answer:
    """What a chunk of configurations gave, and the flags met."""

    tally: Tally
    flags: tuple[Flag, ...]


@lru_cache(maxsize=2)
def _kept(question: MapQuestion) -> tuple[Arm, ...]:
    """Return the arms as they first came here: their models are made already."""
    return question.arms


def answers(question: MapQuestion, q: Array) -> Answer:
    """Return the answers at (N, nq) configurations under every payload; flags are about the arm itself.

    A configuration is counted with the first payload. A drawn arm's worst counts where the arm itself has its tip: an
    offset that was drawn moves no answer elsewhere.
    """
    (arm, *others), parts = _kept(question), []
    flags: dict[tuple[str, str], Flag] = {}
    worst = np.full(len(q), -np.inf)
    for other, payload in product(others, question.payloads):
        for rows, _, displacement, reason, _ in _outcomes(other, payload, question.options, q):
            worst[rows] = np.maximum(worst[rows], np.inf if reason else displacement)
    reasons = list(NO_ANSWER)
    for number, payload in enumerate(question.payloads):
        for rows, tip, displacement, reason, met in _outcomes(arm, payload, question.options, q):
            counted = np.zeros((len(rows), 1 + len(reasons)), dtype=np.int64)
            counted[:, reasons.index(reason) if reason else -1] = 1
            tally = Tally(
                cell=cell_numbers(tip, question.voxel),
                configurations=np.full(len(rows), number == 0, dtype=np.int64),
                answered=counted[:, -1],
                refused=counted[:, :-1],
                total=np.zeros(len(rows)) if reason else displacement,
                worst=displacement,
                payload=np.full(len(rows), number, dtype=np.int64),
                q=q[rows],
                worst_of_draws=worst[rows],
            )
            parts.append(tally)
            for flag in met:
                flags.setdefault(flag.kind, flag)
    return Answer(joined(parts), tuple(flags.values()))


Outcome = tuple[np.ndarray, Array, Array, str, tuple[Flag, ...]]
"""Numbers of rows answered together, or of one that was refused, (n, 3) rigid tips [m], (n,) displacements [m], -inf
where refused, why it was, '' where it was not, and the flags met."""


def _outcomes(arm: Arm, payload: str, options: Mapping[str, Any], q: Array) -> Iterator[Outcome]:
    """Yield what becomes of rows of q."""

    def asked(rows: np.ndarray) -> DeflectionBatch:
        asked_for: ManyRows = q[rows]
        return arm.deflection(asked_for, payload, **options)

    for rows, answer in in_halves(asked, _swept(arm, q)):
        if not isinstance(answer, ArmflexError):
            flags = tuple(
                replace(flag, text=flag.text.partition(": ")[2]) for flag in answer.flags
            )  # without "row 7: "
            yield rows, answer.rigid_pose[:, :3, 3], np.linalg.norm(answer.displacement[:, :3], axis=1), "", flags
        elif not isinstance(answer, ClosureError):  # there the loops let no drive come
            yield rows, arm.rigid_pose(q[rows[0]]).translation[None], np.array([-np.inf]), no_answer(answer), ()


def _swept(arm: Arm, q: Array) -> np.ndarray:
    """Return (N,) numbers of the rows of (N, nq) q in the order of a sweep: to and fro along each joint in turn.

    A mechanism is followed from row to row, and a row far from the one before it takes many steps. Only those joints
    count that move what closes its loops.
    """
    q = q[:, closing_drives(arm.loaded(None))] if arm.robot.linkage else q[:, :0]
    if not q.shape[1]:
        return np.arange(len(q))
    strips = np.ceil(len(q) ** (1.0 / q.shape[1]))
    shares = (q - q.min(axis=0)) / np.maximum(np.ptp(q, axis=0), np.finfo(float).tiny)
    levels = np.minimum(np.floor(shares * strips), strips - 1.0)
    levels[:, -1] = shares[:, -1]
    back = np.cumsum(levels[:, :-1], axis=1) % 2.0 == 1.0
    levels[:, 1:] *= np.where(back, -1.0, 1.0)
    return np.lexsort(levels.T[::-1])


def sigmas(question: MapQuestion, q: Array, payload: np.ndarray) -> tuple[Array, tuple[Flag, ...]]:
    """Return the (n,) standard uncertainties of displacements found at (n, nq) q with payloads by number; and flags.

    They are NaN at the brink of what has an answer, where nobody states any, and where they have no end.
    """
    arm, sigma, flags = _kept(question)[0], np.full(len(q), np.nan), dict[tuple[str, str], Flag]()
    columns, pulled = question.options["covariates"], question.options["wrenches"]

    def asked(rows: np.ndarray) -> tuple[Array | float, tuple[Flag, ...]]:
        positions, name = q[rows], question.payloads[payload[rows[0]]]
        batch = arm.deflection(positions, name, **question.options)
        covariance, met = tip_covariance(arm, batch.q, (name,) * len(rows), columns, batch.covariance, pulled)
        return np.nan if covariance is None else length_sigma(batch.displacement[:, :3], covariance[:, :3, :3]), met

    for carrying in (np.flatnonzero(payload == number) for number in range(len(question.payloads))):
        for rows, answer in in_halves(asked, carrying[_swept(arm, q[carrying])]) if len(carrying) else ():
            if not isinstance(answer, ArmflexError):
                sigma[rows], met = answer
                flags |= {flag.kind: flag for flag in met}
    return np.where(np.isinf(sigma), np.nan, sigma), tuple(flags.values())


def frequencies(question: MapQuestion, q: Array, payload: np.ndarray) -> Array:
    """Return the (n,) first natural frequencies [Hz] at (n, nq) q with payloads by number, NaN at an answer's brink."""
    arm, lowest = _kept(question)[0], np.full(len(q), np.nan)
    loads = {name: question.options[name] for name in ("covariates", "wrenches")}
    for i, (row, number) in enumerate(zip(q, payload.tolist(), strict=True)):
        with contextlib.suppress(*NO_ANSWER.values()):
            lowest[i] = arm.modes(row, question.payloads[number], count=1, **loads).frequencies[0]
    return lowest
