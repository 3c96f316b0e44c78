"""Rows that could be measured: spread over all that may be asked of the arm, or near rows that are good already."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from armflex.arm import Arm, Setup
from armflex.configurations import Configurations
from armflex.conventions import Array
from armflex.errors import ArmflexError, InputError, listing, no_answer
from armflex.estimate.view import View, look
from armflex.mechanics.deflection import DeflectionBatch
from armflex.mechanics.history import known_rows
from armflex.parallel import in_halves
from armflex.readings import Kind, Position, Readings, Touch, TouchingSensor, touched
from armflex.rows import Rows
from armflex.rows.rows import APPROACH

OVERSHOOT = 0.02
"""Share of its range by which a joint goes past a pose to come back to it from the wanted side."""

FEW = 32
"""Rows that are tried first: where the arm can hold none of them, it is no use to try the others."""

STEPS, STRIDE, GAP, DAMPING = 30, 0.3, 1e-6, 1e-6
"""Tolerances: steps of the arm onto a contact, the longest of a joint [rad, m], what gap is left [m], and the damping
as a share of the reach squared."""

FLOOR, COLUMN, CONTACT, UNREAD = "below_floor", "in_base_column", "off_contact", "nothing_to_read"
"""Why a row is not offered in which a link or the payload would be too low, or in the arm's own column, or no
instrument reads anything, such as a board that is not in the picture; other reasons are those of `map`."""

BATCHES, ENOUGH = 8, 0.25
"""How many times as many rows are looked at where few are read, and which share of those asked for is enough."""

THICK = 0.08
"""Radius of the base's column as a part of the arm's reach: pedestals of arms of 0.9 m to 3 m have 0.07 to 0.1."""


STILL_WITHIN = 0.02
"""What moves by less [m] over the rows offered is where it is by its sag alone."""


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
        floor: Lowest height of any link, target or payload in the base frame [m]; None for that of the base, 0, unless
            the arm hangs below it in every row.
        read: Names of the instruments that are read; '' is the one at the tip.
        sigmas: By instrument (n,) standard deviations of its numbers, in their units, where a campaign determined them.
        blank: What is recorded with the readings, by name: a file of rows leaves it open.
    """

    arm: Arm
    lower: Array
    upper: Array
    payloads: tuple[str, ...]
    approached: tuple[str, ...]
    levels: Mapping[str, tuple[float, ...]]
    session: str
    sigma: Array
    floor: float | None = None
    read: tuple[str, ...] = ("",)
    sigmas: Mapping[str, Array] = field(default_factory=dict)
    blank: tuple[str, ...] = ()

    def unread(self, rows: Rows) -> Readings:
        """Return what is to be read in rows."""
        count = len(rows)
        kinds: list[Kind] = [Position.unread(count, self.sigma)] if "" in self.read else []
        for sensor in (sensor for name, sensor in self.arm.sensors.items() if name in self.read):
            sigma = self.sigmas.get(sensor.name, sensor.sigma)
            if not isinstance(sensor, TouchingSensor):
                kinds.append(sensor.unread(count, sigma))
            else:
                each = np.full((count, 1), np.median(sigma))
                kinds += touched(sensor.name, tuple(map(str, rows.covariates[sensor.name])), each, sensor.sockets)
        return Readings(count, tuple(kinds))

    @property
    def touching(self) -> dict[str, tuple[str, ...]]:
        """Sockets that may be touched, by instrument: those whose places are known or were found."""
        sensors = [sensor for name, sensor in self.arm.sensors.items() if name in self.read]
        return {
            sensor.name: tuple(dict.fromkeys((*sensor.sockets.place, *filter(None, sensor.found))))
            for sensor in sensors
            if isinstance(sensor, TouchingSensor)
        }

    @property
    def choices(self) -> list[Sequence]:
        """What else is chosen for a row, one of some each: payload, approaches, levels."""
        return [
            self.payloads, *((-1.0, 1.0) for _ in self.approached), *self.levels.values(), *self.touching.values()
        ]  # fmt: skip

    def rows(self, box: Array) -> Rows:
        """Return the unread rows at (N, b) points of the unit cube: joints, then `choices` in turn."""
        joints = len(self.lower)
        # What is to come from either side keeps clear of its limits.
        chosen = np.isin(self.arm.joint_names, self.approached)
        clearance = np.where(chosen, OVERSHOOT * (self.upper - self.lower), 0.0)
        low, high = self.lower + clearance, self.upper - clearance
        payload, *picked = (
            np.array(options)[np.minimum((share * len(options)).astype(int), len(options) - 1)]
            for share, options in zip(box.T[joints:], self.choices, strict=True)
        )
        names = [*(f"{APPROACH}{joint}" for joint in self.approached), *self.levels, *self.touching]
        chosen_of = dict(zip(names, picked, strict=True))
        sockets = {name: tuple(chosen_of.pop(name).tolist()) for name in self.touching}
        given = {name: values.astype(float) for name, values in chosen_of.items()}
        q = np.clip(low + (high - low) * box[:, :joints], low, high)  # rounding may go past the end
        rows = rows_at(self.arm, q, tuple(payload.tolist()), given, self.session)
        return replace(rows, covariates={**rows.covariates, **sockets})


def on_contact(reach: Reach, setup: Setup, rows: Rows) -> tuple[Rows, np.ndarray]:
    """Return rows with the arm moved until its point is in the socket of each, and (N,) whether it came there.

    Newton's steps with the least motion of the joints, damped, none longer than `STRIDE`, within the limits.
    """
    if not reach.touching:
        return rows, np.ones(len(rows), dtype=bool)
    off = np.full(len(rows), np.inf)
    for _ in range(STEPS):
        view = look(setup, rows, readings=reach.unread(rows))
        gap = np.where(np.isfinite(view.sigma), view.residual, 0.0)
        places = [place for kind, place in view.readings.placed if isinstance(kind, Touch)]
        off = np.linalg.norm(np.concatenate([gap[:, place] for place in places], axis=1), axis=1)
        if (off < GAP).all():
            break
        per = np.where(np.isfinite(view.sigma)[:, :, None], view.answer(lambda line: line.joints), 0.0)
        there = np.concatenate([np.arange(place.start, place.stop) for place in places])
        per, gap = per[:, there], gap[:, there]
        square = per @ per.transpose(0, 2, 1) + DAMPING * reach.arm.robot.reach**2 * np.eye(len(there))
        step = np.einsum("ndq,nd->nq", per, np.linalg.solve(square, gap[:, :, None])[:, :, 0])
        step *= np.minimum(1.0, STRIDE / np.maximum(np.abs(step).max(axis=1), STRIDE))[:, None]
        rows = replace(rows, q=np.clip(rows.q + step, reach.lower, reach.upper))
    return rows, off < GAP


def rows_at(arm: Arm, q: Array, payload: tuple[str, ...], given: Mapping[str, Array], session: str = "") -> Rows:
    """Return (N, nq) joint positions, and what else is known, as rows at which nothing was read yet.

    An effect with a memory is taken where it settles: a lagging column at its value, play at rest.
    """
    of_state = {effect.state: effect.location.covariates[:1] for effect in arm.effects if effect.remembers}
    settled = {str(state): given.get("".join(column), np.zeros(len(q))) for state, column in of_state.items()}
    given = {**settled, **given}
    pose = [f"offer {i}" for i in range(len(q))]
    return Rows.of(arm.joint_names, q, payload, given, pose, session, () if "time" in given else ("time",))


@dataclass(frozen=True, eq=False)
class Offer:
    """Rows that the arm can hold.

    Attributes:
        box: (N, b) where each is in the unit cube of what may be asked.
        view: What the instrument would see of them, and what effects do.
        dropped: How many others were left out, by reason.
    """

    box: Array
    view: View
    dropped: Counter[str]

    @property
    def rows(self) -> Rows:
        """The rows."""
        return self.view.driven

    def read_by(self, reach: Reach, setup: Setup) -> Offer:
        """Return the same rows read by other instruments, or with other standard deviations; the arm is the same."""
        readings = reach.unread(self.rows)
        view = look(setup, self.rows, readings=readings, line=self.view.line)
        return replace(self, view=replace(view, readings=readings.within_range(view.at)))

    def seen_by(self, setup: Setup) -> Offer:
        """Return the same rows as another arm or instrument has them."""
        return replace(self, view=look(setup, self.rows, readings=self.view.readings))


def spread_evenly(reach: Reach, setup: Setup, count: int, seed: int) -> Offer:
    """Return up to `count` rows, a power of two, spread evenly over all that may be asked; raise where none is held."""
    width = len(reach.lower) + len(reach.choices)
    box = next(Configurations(np.zeros(width), np.ones(width), count, seed, count).chunks())
    _held(setup.arm, reach.rows(box[:FEW]))  # an arm too soft for anything says so at once
    offer = _offer(reach, setup, box)
    boxes = [offer.box]
    for batch in range(1, BATCHES if offer.dropped[UNREAD] else 0):
        if sum(map(len, boxes)) >= ENOUGH * count:
            break
        more = next(Configurations(np.zeros(width), np.ones(width), count, seed + batch, count).chunks())
        boxes.append(_offer(reach, setup, more).box)
    return offer if len(boxes) == 1 else _offer(reach, setup, np.vstack(boxes))


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
    """Return those of (N, b) rows that the arm can hold above the floor and beside its own column; raise for none."""
    rows, there = on_contact(reach, setup, reach.rows(box))
    if not there.any():
        names = listing(dict.fromkeys(socket for sockets in reach.touching.values() for socket in sockets))
        raise InputError(f"the arm reaches none of the sockets {names} from {len(box)} configurations")
    box, rows = box[there], rows.some(np.flatnonzero(there))
    held, dropped = _held(setup.arm, rows)
    dropped[CONTACT] += int((~there).sum())
    rows = rows.some(held)
    readings = reach.unread(rows)
    view = look(setup, rows, readings=readings)
    lowest, clear = _clearances(setup.arm, rows, view)
    floor = reach.floor
    if floor is None:
        floor = 0.0 if (lowest >= 0.0).any() else -np.inf
    high, beside = lowest >= floor, clear >= THICK * setup.arm.robot.reach
    dropped[FLOOR] += int((~high).sum())
    dropped[COLUMN] += int((high & ~beside).sum())
    if not high.any():
        text = f"nothing of {len(held)} rows is above the floor at {floor:g} m"
        raise InputError(f"{text}; the highest is {float(lowest.max()):.3g} m")
    seen = view.readings.within_range(view.at).read
    dropped[UNREAD] += int((high & beside & ~seen).sum())
    able = np.flatnonzero(high & beside & seen)
    if not len(able) and (high & beside).any():
        text = "instruments read nothing in any of the rows that were offered: is a board where no camera looks?"
        raise InputError(f"{text} Plan with --after pictures of it, or declare where both are")
    if not len(able):
        raise InputError(f"every one of {int(high.sum())} rows has a link or the payload in the arm's own base column")
    if len(able) < len(held):
        held, rows = held[able], rows.some(able)
        view = look(setup, rows, readings=readings.some(able))
    view = replace(view, readings=view.readings.within_range(view.at))
    return Offer(box[held], view, +dropped)


def _clearances(arm: Arm, rows: Rows, view: View) -> tuple[Array, Array]:
    """Return (N,) the height of the lowest part of the arm in the base, and how far it stays off its own column [m].

    The arm is taken as lines between the origins of its links, from those to the targets and instruments on them, and
    to its payload's centre of mass. What no pose lifts or lowers counts for no floor. The column goes from the base to
    the last link that no pose moves; what begins in it, as an upper arm does, is not in its way.
    """
    places = dict(zip(view.line.link_names, view.line.links.transpose(1, 0, 2, 3)[:, :, :3, 3], strict=True))
    ends = [(joint.parent, joint.child) for joint in arm.robot.urdf.joints.values() if joint.child in places]
    lines = [(places[link], places[other]) for link, other in ends if link in places]
    tip, loads = view.line.tip, [arm.payload(name) for name in rows.payload]
    com = np.array([load.com * (load.mass > 0.0) for load in loads])
    lines.append((tip[:, :3, 3], tip[:, :3, 3] + np.einsum("nij,nj->ni", tip[:, :3, :3], com)))
    for name in ("", *(name for name, sensor in arm.sensors.items() if sensor.link in view.line.link_names)):
        # What touches a socket is as low as the socket is.
        if not isinstance(arm.sensors.get(name), TouchingSensor):
            end = view.at.end(name)
            lines.append((end.pose[:, :3, 3], end.place))
    # Points looked at along every link
    share = np.linspace(0.0, 1.0, 5)[:, None, None]
    lowest, clear = np.full(len(tip), np.inf), np.full(len(tip), np.inf)

    still = [joint.child for joint in arm.robot.chain if np.ptp(places[joint.child], axis=0).max() < STILL_WITHIN]
    top = places[still[-1]].mean(axis=0) if still else np.zeros(3)
    axis, radius = top / max(float(top @ top), 1e-12), THICK * arm.robot.reach
    for start, other in lines:
        points = start + share * (other - start)  # (ALONG, N, 3)
        if np.ptp(points[..., 2], axis=1).max() > STILL_WITHIN:
            lowest = np.minimum(lowest, points[..., 2].min(axis=0))
        off = np.linalg.norm(points - np.clip(points @ axis, 0.0, 1.0)[..., None] * top, axis=2)
        if off[0].max() > radius and off[-1].max() > radius and np.ptp(off[0]) > STILL_WITHIN:
            clear = np.minimum(clear, off.min(axis=0))
    return lowest, clear


def _held(arm: Arm, rows: Rows) -> tuple[np.ndarray, Counter[str]]:
    """Return the numbers of the rows with a stable equilibrium, and how many have none, by reason; raise for none."""
    columns, dropped = known_rows(arm, rows), Counter[str]()

    def deflected(picked: np.ndarray) -> DeflectionBatch:
        here, given = rows.some(picked), {name: values[picked] for name, values in columns.items()}
        return arm.deflection(here.q, here.payload, covariates=given, wrenches=here.wrenches, enforce_limits=False)

    def asked(picked: np.ndarray) -> list[np.ndarray]:
        parts = []
        for part, answer in in_halves(deflected, picked):
            if isinstance(answer, ArmflexError):
                dropped[no_answer(answer)] += 1
            else:
                parts.append(part)
        return parts

    held: list[np.ndarray] = []
    for payload in dict.fromkeys(rows.payload):
        carrying = np.array([i for i, name in enumerate(rows.payload) if name == payload])
        before = +dropped
        first, others = asked(carrying[:FEW]), carrying[FEW:]
        if len(others) and first:
            held += asked(others)
        elif len(others):  # too heavy wherever it was tried: each of the others would take long to say the same
            dropped[(dropped - before).most_common(1)[0][0]] += len(others)
        held += first
    if not held:
        reasons = listing(f"{count} {reason.replace('_', ' ')}" for reason, count in dropped.items())
        raise InputError(f"no row can be measured: of {len(rows)} offered {reasons}")
    return np.sort(np.concatenate(held)), dropped
