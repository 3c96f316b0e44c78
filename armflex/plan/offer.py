"""Rows that could be measured: spread over all that may be asked of the arm, or near rows that are good already."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from armflex.arm import Arm
from armflex.configurations import Configurations
from armflex.conventions import Array
from armflex.errors import NO_ANSWER, InputError, listing
from armflex.estimate.spread import scene_of
from armflex.estimate.view import View, look
from armflex.laws.effects.scene import Scene
from armflex.mechanics.history import known_rows
from armflex.readings import Position, unread
from armflex.rows import Rows
from armflex.rows.rows import APPROACH
from armflex.setup import Setup

OVERSHOOT = 0.02
"""Share of its range by which a joint goes past a pose to come back to it from the wanted side."""

FEW = 32
"""Rows that are tried first: where the arm can hold none of them, it is no use to try the others."""

FLOOR = "below_floor"
"""Why a row is not offered whose tip would be too low; other reasons are those of `map`."""


@dataclass(frozen=True, eq=False)
class Reach:
    """What may be asked of an arm.

    Attributes:
        arm: The arm.
        lower, upper: (nq,) joint positions [rad or m].
        payloads: What may be carried.
        approached: Joints whose approach is chosen, because an effect depends on it; kept clear of their limits.
        levels: Values that can be set of what effects depend on, by name.
        session: The session in which the rows will be measured.
        sigma: (3,) standard deviation of a position read [m].
        floor: Lowest height of the tip in the base frame [m].
    """

    arm: Arm
    lower: Array
    upper: Array
    payloads: tuple[str, ...]
    approached: tuple[str, ...]
    levels: Mapping[str, tuple[float, ...]]
    session: str
    sigma: Array
    floor: float = -np.inf

    @property
    def clearance(self) -> Array:
        """(nq,) what every joint keeps from its limits, so that it can come from either side [rad or m]."""
        chosen = np.isin(self.arm.joint_names, self.approached)
        return np.where(chosen, OVERSHOOT * (self.upper - self.lower), 0.0)

    def rows(self, box: Array) -> Rows:
        """Return the unread rows at (N, b) points of the unit cube: joints, payload, approaches, levels in turn."""
        joints = len(self.lower)
        low, high = self.lower + self.clearance, self.upper - self.clearance
        picked = [_picked(box[:, joints + i], choices) for i, choices in enumerate(self._choices)]
        names = [*(f"{APPROACH}{joint}" for joint in self.approached), *self.levels]
        given = {name: values.astype(float) for name, values in zip(names, picked[1:], strict=True)}
        q = np.clip(low + (high - low) * box[:, :joints], low, high)  # rounding may go past the end
        return rows_at(self.arm, q, tuple(picked[0].tolist()), given, self.session)

    @property
    def width(self) -> int:
        """Number of things that are chosen for a row."""
        return len(self.lower) + len(self._choices)

    @property
    def _choices(self) -> list[Sequence]:
        return [self.payloads, *((-1.0, 1.0) for _ in self.approached), *self.levels.values()]


def _picked(share: Array, choices: Sequence) -> np.ndarray:
    """Return which of some choices (N,) shares from 0 to 1 stand for."""
    return np.array(choices)[np.minimum((share * len(choices)).astype(int), len(choices) - 1)]


def rows_at(arm: Arm, q: Array, payload: tuple[str, ...], given: Mapping[str, Array], session: str = "") -> Rows:
    """Return (N, nq) joint positions, and what else is known, as rows at which nothing was read yet.

    An effect with a memory is taken where it settles.
    """
    given = {**_settled(arm, given, len(q)), **given}
    pose = [f"offer {i}" for i in range(len(q))]
    return Rows.of(arm.joint_names, q, payload, given, pose, session, () if "time" in given else ("time",))


def _settled(arm: Arm, given: Mapping[str, Array], count: int) -> dict[str, Array]:
    """Return the states that effects remember, as they settle: a lagging column at its value, play at rest."""
    states = {}
    for effect in arm.effects:
        if not effect.remembers:
            continue
        columns = effect.location.covariates
        state = given.get(columns[0], np.zeros(count)) if columns else np.zeros(count)
        states[effect.state] = state
    return states


@dataclass(frozen=True, eq=False)
class Offer:
    """Rows that the arm can hold.

    Attributes:
        box: (N, b) where each is in the unit cube of what may be asked.
        rows: The rows.
        view: What the instrument would see of them.
        scene: The same as effects see them.
        dropped: How many others were left out, by reason.
    """

    box: Array
    rows: Rows
    view: View
    scene: Scene
    dropped: Counter[str] = field(default_factory=Counter)

    def with_sigma(self, sigma: Array) -> Offer:
        """Return the same rows read with another (3,) standard deviation [m]."""
        return replace(self, view=replace(self.view, readings=unread(len(self.rows), Position, sigma=sigma)))

    def seen_by(self, setup: Setup) -> Offer:
        """Return the same rows as another arm or instrument has them."""
        view = look(setup, self.rows, np.arange(len(self.rows)), readings=self.view.readings)
        return replace(self, view=view, scene=scene_of(view, self.rows))


def spread(reach: Reach, setup: Setup, count: int, seed: int) -> Offer:
    """Return up to `count` rows spread evenly over all that may be asked, `count` a power of two.

    Raises:
        InputError: The arm can hold none of them.
    """
    unit = np.zeros(reach.width), np.ones(reach.width)
    box = next(Configurations(*unit, count, seed, count).chunks([True]))
    _held(setup.arm, reach.rows(box[:FEW]))  # an arm too soft for anything says so at once
    return _offer(reach, setup, box)


def around(reach: Reach, setup: Setup, box: Array, width: float, each: int, rng: np.random.Generator) -> Offer:
    """Return (n, b) rows that are held already, and `each` near every one of them: some of what is chosen, changed."""
    near = np.repeat(box, each, axis=0)
    step = rng.normal(0.0, width, near.shape) * (rng.random(near.shape) < 0.5)
    near = np.clip(near + step, 0.0, 1.0)
    fresh = rng.random(near.shape) < width / 2.0  # a payload or an approach has no neighbours
    fresh[:, : len(reach.lower)] = False
    near = np.where(fresh, rng.random(near.shape), near)
    return _offer(reach, setup, np.vstack([box, near]))


def _offer(reach: Reach, setup: Setup, box: Array) -> Offer:
    rows = reach.rows(box)
    held, dropped = _held(setup.arm, rows)
    rows = rows.some(held)
    readings = unread(len(held), Position, sigma=reach.sigma)
    view = look(setup, rows, np.arange(len(held)), readings=readings)
    high = view.line.tip[:, 2, 3] >= reach.floor
    dropped[FLOOR] += int((~high).sum())
    if not high.any():
        highest = float(view.line.tip[:, 2, 3].max())
        raise InputError(
            f"no tip of {len(high)} is above the floor at {reach.floor:g} m; the highest is {highest:.3g} m"
        )
    if not high.all():
        held, rows, readings = held[high], rows.some(np.flatnonzero(high)), readings.some(np.flatnonzero(high))
        view = look(setup, rows, np.arange(len(held)), readings=readings)
    return Offer(box[held], rows, view, scene_of(view, rows), +dropped)


def _held(arm: Arm, rows: Rows) -> tuple[np.ndarray, Counter[str]]:
    """Return the numbers of the rows that have a stable equilibrium, and how many have not, by reason.

    Raises:
        InputError: None has.
    """
    known, dropped = known_rows(arm, rows), Counter[str]()

    def asked(some: np.ndarray) -> list[np.ndarray]:
        """Where one row is refused, halves are asked until it stands alone."""
        given = {name: values[some] for name, values in known.items()}
        try:
            arm.deflection(rows.q[some], [rows.payload[i] for i in some], covariates=given, enforce_limits=False)
        except tuple(NO_ANSWER.values()) as error:
            if len(some) == 1:
                dropped[next(name for name, kind in NO_ANSWER.items() if isinstance(error, kind))] += 1
                return []
            return [part for half in np.array_split(some, 2) for part in asked(half)]
        return [some]

    held = asked(np.arange(len(rows)))
    if not held:
        reasons = listing(f"{count} {reason.replace('_', ' ')}" for reason, count in dropped.items())
        raise InputError(f"no row can be measured: of {len(rows)} offered {reasons}")
    return np.concatenate(held), dropped
