"""What is asked of an arm at many configurations, and the answers of one chunk of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import product
from typing import Any
from uuid import uuid4

import numpy as np

from armflex.arm import Arm, ManyRows
from armflex.conventions import Array
from armflex.errors import (
    NO_ANSWER,
    ArmflexError,
    Flag,
)
from armflex.estimate.tip_uncertainty import length_sigma, tip_covariance
from armflex.tasks.workspace.tally import Tally, cell_numbers, joined


@dataclass(frozen=True, eq=False)
class Question:
    """An arm, what it carries, and how its answers are told apart.

    Attributes:
        arms: The arm, and others drawn from what is known of it.
        payloads: Names; "none" for nothing.
        voxel: Edge of a cell [m].
        options: Of `Arm.deflection`, covariates among them.
        token: Names this question among all that a worker ever gets.
    """

    arms: tuple[Arm, ...]
    payloads: tuple[str, ...]
    voxel: float
    options: Mapping[str, Any]
    token: str = field(default_factory=lambda: uuid4().hex)

    @property
    def arm(self) -> Arm:
        """The arm itself."""
        return self.arms[0]

    def __hash__(self) -> int:
        return hash(self.token)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Question) and other.token == self.token


@dataclass(frozen=True, eq=False)
class Answer:
    """What a chunk of configurations gave, and the doubts met."""

    tally: Tally
    flags: tuple[Flag, ...]


@lru_cache(maxsize=2)
def _kept(question: Question) -> tuple[Arm, ...]:
    """Return the arms as they first came here: their models are made already."""
    return question.arms


def answers(question: Question, q: Array) -> Answer:
    """Return the answers at (N, nq) configurations under every payload; doubts are about the arm itself."""
    flags: dict[str, Flag] = {}
    parts = []
    (arm, *_), drawn = _kept(question), _worst_of_draws(question, q)
    for number, payload in enumerate(question.payloads):
        for some, outcome in _outcomes(arm, payload, question.options, q, np.arange(len(q))):
            parts.append(_counted(outcome, q[some], question.voxel, number, drawn[some]))
            for flag in outcome.flags:
                flags.setdefault(flag.code, flag)
    return Answer(joined(parts), tuple(flags.values()))


def _worst_of_draws(question: Question, q: Array) -> Array:
    """Return the (N,) largest displacements of the drawn arms [m], inf where one has no answer."""
    found = np.full(len(q), -np.inf)
    for arm, payload in product(_kept(question)[1:], question.payloads):
        for some, outcome in _outcomes(arm, payload, question.options, q, np.arange(len(q))):
            found[some] = np.maximum(found[some], np.inf if outcome.reason else outcome.displacement)
    return found


@dataclass(frozen=True, eq=False)
class _Outcome:
    """Rows that were answered together, or one that was refused.

    Attributes:
        tip: (n, 3) where the rigid tip is [m].
        displacement: (n,) [m], -inf where refused.
        reason: Why it was refused, '' where it was not.
        flags: Doubts met.
    """

    tip: Array
    displacement: Array
    reason: str = ""
    flags: tuple[Flag, ...] = ()


def _outcomes(
    arm: Arm, payload: str, options: Mapping[str, Any], q: Array, rows: np.ndarray
) -> Iterator[tuple[np.ndarray, _Outcome]]:
    """Yield rows of q and their outcome; where one of them is refused, halves are asked until it stands alone."""
    try:
        some: ManyRows = q[rows]
        found = arm.deflection(some, payload, **options)
    except tuple(NO_ANSWER.values()) as error:
        if len(rows) == 1:
            yield rows, _refused(arm, q[rows[0]], error)
            return
        for half in np.array_split(rows, 2):
            yield from _outcomes(arm, payload, options, q, half)
        return
    flags = tuple(Flag(flag.code, flag.text.partition(": ")[2]) for flag in found.flags)  # without "row 7: "
    yield rows, _Outcome(found.rigid_pose[:, :3, 3], np.linalg.norm(found.displacement[:, :3], axis=1), flags=flags)


def _refused(arm: Arm, q: Array, error: ArmflexError) -> _Outcome:
    reason = next(name for name, kind in NO_ANSWER.items() if isinstance(error, kind))
    return _Outcome(arm.rigid_pose(q).translation[None], np.array([-np.inf]), reason)


def _counted(outcome: _Outcome, q: Array, voxel: float, number: int, drawn: Array) -> Tally:
    """Return a row for each outcome under a payload by number; a configuration is counted with the first payload.

    A drawn arm's worst counts where the arm itself has its tip: an offset that was drawn moves no answer elsewhere.
    """
    count, given = len(q), not outcome.reason
    refused = np.zeros((count, len(NO_ANSWER)), dtype=np.int64)
    if not given:
        refused[:, list(NO_ANSWER).index(outcome.reason)] = 1
    return Tally(
        cell=cell_numbers(outcome.tip, voxel),
        configurations=np.full(count, number == 0, dtype=np.int64),
        answered=np.full(count, given, dtype=np.int64),
        refused=refused,
        total=outcome.displacement if given else np.zeros(count),
        worst=outcome.displacement,
        payload=np.full(count, number, dtype=np.int64),
        q=q,
        worst_of_draws=drawn,
    )


def sigmas(question: Question, q: Array, payload: np.ndarray) -> tuple[Array, tuple[Flag, ...]]:
    """Return the (n,) standard uncertainties of displacements that were found, and doubts about them.

    Args:
        question: What was asked.
        q: (n, nq) configurations.
        payload: (n,) numbers of the payloads.
    """
    found, flags = np.full(len(q), np.nan), {}
    for number, name in enumerate(question.payloads):
        rows = np.flatnonzero(payload == number)
        if len(rows):
            found[rows], doubts = _sigmas(question, q[rows], name)
            flags |= {flag.code: flag for flag in doubts}
    return found, tuple(flags.values())


def _sigmas(question: Question, q: Array, payload: str) -> tuple[Array, tuple[Flag, ...]]:
    """Return (n,) uncertainties under one payload, NaN at the brink of what has an answer."""
    arm = _kept(question)[0]
    try:
        batch = arm.deflection(q, payload, **question.options)
        known = question.options["covariates"]
        covariance, flags = tip_covariance(arm, batch.q, (payload,) * len(q), known, batch.covariance)
    except tuple(NO_ANSWER.values()):
        if len(q) == 1:
            return np.array([np.nan]), ()
        halves = [_sigmas(question, half, payload) for half in np.array_split(q, 2)]
        return np.concatenate([half for half, _ in halves]), halves[0][1]
    if covariance is None:
        return np.full(len(q), np.nan), flags
    return length_sigma(batch.displacement[:, :3], covariance[:, :3, :3]), flags
