"""Measured campaigns of an arm with one undeclared effect, two, or none, drawn by seed.

    drawn = draw("backlash", seed=3, arm="boom")
    truth = drawn.write(folder)             # arm.toml, train.csv, test.csv, truth.csv, truth.json

One run of stops over five sessions makes both tables: every stop is a row of both, in the order driven, because laws
with a memory need all of them. train.csv has positions at most stops of the training poses, test.csv at the stops of
poses that are held out; elsewhere x, y and z are empty.
"""

from __future__ import annotations

import json
import zlib
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import armflex.rows
from support.campaign_files import ARMS, declared_text, write_clean, write_rows
from support.plant import Array, Plant, Rows, State, apply, pose, turn
from support.undeclared import REFERENCE, Context, Effect, Nudged, Redraw
from support.undeclared_beyond import BEYOND
from support.undeclared_outside import CATALOGUE, LAGGING, UNNAMED, Maker

KINDS = tuple(CATALOGUE)
LAGGED = tuple(f"{name} lagged" for name in LAGGING)
OUTSIDE = tuple(UNNAMED)
NULLS = ("none", "none_restationed", "none_noisier", "none_quieter")
SEVERAL = tuple(f"{count} effects" for count in range(2, 7))
SIGMA = 2e-4  # m, as declared
NUDGE = 1e-4
SESSIONS, STOPS, UNREAD = 5, 460, 40
ONE, MANY = (
    (4e-4, 5e-3),
    (5e-4, 3e-3),
)  # m, how far an effect moves the readings: by itself, and where there are several
HOLDS, HOLD_SHARES = (30.0, 60.0, 120.0, 300.0, 900.0, 1800.0), (0.22, 0.22, 0.22, 0.18, 0.1, 0.06)


@dataclass(frozen=True)
class TrueEffect:
    """What was hidden, and how far it alone moves the measured points (3-D RMS over train.csv's readings) [m]."""

    name: str
    site: str
    axis: str | None
    covariates: tuple[str, ...]
    parameters: dict[str, float | str]
    raw_rms: float


@dataclass(frozen=True)
class Truth:
    kind: str
    seed: int
    arm: Path
    train: Path
    test: Path
    effects: tuple[TrueEffect, ...]
    clean: Array  # (stops, 3) noise-free readings, with the instrument's sessions
    held_out: Array  # (stops,) where test.csv has positions
    sigma: float  # m, true standard deviation per axis
    lost: Array  # (stops,) where a lost beam was read


@dataclass(frozen=True)
class Noise:
    """How the instrument errs."""

    sigma: float = SIGMA
    restationing: float = 2e-4
    heavy: bool = False

    def draw(self, rng: np.random.Generator, count: int) -> tuple[Array, Array]:
        """Return errors (N, 3) [m] and where the beam was lost."""
        if not self.heavy:
            return rng.normal(0.0, self.sigma, (count, 3)), np.zeros(count, bool)
        errors = self.sigma * rng.standard_t(3, (count, 3)) / np.sqrt(3.0)
        lost = rng.random(count) < 0.01
        far = np.exp(rng.uniform(np.log(5e-3), np.log(0.5), (count, 1))) * rng.normal(size=(count, 3))
        return errors + lost[:, None] * far, lost


@dataclass(frozen=True)
class Drawn:
    """A campaign before it is written."""

    kind: str
    seed: int
    arm: str
    plant: Plant
    rows: Rows
    effects: tuple[Effect, ...]
    raw_rms: tuple[float, ...]
    station: Array
    shifts: Array
    noise: Noise
    errors: Array
    lost: Array
    spare: int = 0  # stops at the end that nobody has driven yet

    def readings(self, effects: tuple[Effect, ...] | None = None) -> Array:
        """Noise-free readings (stops, 3) under the given effects, by default the true ones."""
        state = self.plant.relax(self.rows, self.effects if effects is None else effects)
        return read(self.plant, state, self.station, self.shifts)

    def orientations(self, sigma: float, share: float = 1.0) -> tuple[Array, Array]:
        """Rotation vectors (stops, 3) of a target turned on the tool, read with noise, and where they were read.

        Args:
            sigma: True standard deviation [rad].
            share: Of the measured stops at which they are read.
        """
        rng = np.random.default_rng([self.seed, 99])
        mounting = turn(rng.normal(0.0, 1.0, 3))
        tips = self.plant.relax(self.rows, self.effects).frames[:, -1]
        axes = (self.shifts[self.rows.session] @ self.station @ tips)[:, :3, :3] @ mounting
        seen = turn(rng.normal(0.0, sigma, (len(axes), 3))) @ axes
        return Rotation.from_matrix(seen).as_rotvec(), self.rows.measured & (rng.random(len(axes)) < share)

    def asked(self, rows: armflex.rows.Rows) -> Drawn:
        """Return the campaign with rows that were asked for driven at its next spare stops and read."""
        first, payloads = len(self.rows.q) - self.spare, [name for name, _, _ in ARMS[self.arm].payloads]
        there = slice(first, first + len(rows))
        carried = np.array([payloads.index(name if name in payloads else "empty") for name in rows.payload])
        _, mass, com = (np.array(some) for some in zip(*ARMS[self.arm].payloads, strict=True))
        given = {"q": rows.q, "payload": carried, "mass": mass[carried], "com": com[carried], "measured": True}
        given |= {"approach": rows.approach, "session": 1 + self.rows.session[first - 1]}
        given |= {} if rows.hold is None else {"hold": rows.hold}
        changed = {name: getattr(self.rows, name).copy() for name in given}
        for name, values in given.items():
            changed[name][there] = values
        return replace(self, rows=replace(self.rows, **changed), spare=self.spare - len(rows))

    def write(self, folder: Path, every: int = 1) -> Truth:
        """Write arm.toml (as declared), train.csv, test.csv, truth.csv and truth.json; no spare stops.

        With `every` so manieth of train.csv's readings alone is kept.
        """
        folder.mkdir(parents=True, exist_ok=True)
        arm, train, test = folder / "arm.toml", folder / "train.csv", folder / "test.csv"
        arm.write_text(declared_text(self.arm))
        driven = slice(len(self.rows.q) - self.spare)
        rows = Rows(**{one.name: getattr(self.rows, one.name)[driven] for one in fields(Rows)})
        clean, errors, names = self.readings()[driven], self.errors[driven], [j.name for j in self.plant.joints]
        payloads = [name for name, _, _ in ARMS[self.arm].payloads]
        kept = rows.measured & (np.cumsum(rows.measured) % every == 0)
        for path, shown in ((train, kept), (test, rows.held_out)):
            write_rows(path, rows, names, payloads, clean + errors, shown, SIGMA)
        write_clean(folder / "truth.csv", rows, clean)
        effects = tuple(
            TrueEffect(e.name, e.site, e.axis, e.covariates, e.tell(e.amplitude), raw)
            for e, raw in zip(self.effects, self.raw_rms, strict=True)
        )
        told = {"kind": self.kind, "seed": self.seed, "arm": self.arm, "sigma": self.noise.sigma}
        (folder / "truth.json").write_text(json.dumps({**told, "effects": [vars(e) for e in effects]}, indent=1) + "\n")
        held, sigma = rows.held_out, self.noise.sigma
        return Truth(self.kind, self.seed, arm, train, test, effects, clean, held, sigma, self.lost[driven])


def read(plant: Plant, state: State, station: Array, shifts: Array) -> Array:
    """What the instrument would read without noise."""
    seen = (1.0 + state.push.scale) * apply(station, plant.points(state))
    return apply(shifts[state.rows.session], seen) + state.push.shift


def draw(kind: str, seed: int, arm: str = "boom", size: float = 1.0, spare: int = 0, poses: int = 0) -> Drawn:
    """Draw a campaign.

    Args:
        kind: One of KINDS, LAGGED, OUTSIDE, NULLS, SEVERAL, "two", or of `BEYOND`.
        seed: The same seed gives the same campaign; another kind gives other poses, errors and noise as well.
        arm: "boom" or "six".
        size: Factor on the size of the effect.
        spare: Stops after the campaign for rows that are asked for.
        poses: So many, each driven to once and read, in place of those of the study; none is held out.
    """
    for attempt in range(50):
        rng = np.random.default_rng([seed, zlib.crc32(kind.encode()), sorted(ARMS).index(arm), attempt])
        try:
            return once(rng, kind, seed, arm, size, spare, poses)
        except Redraw:
            continue
    raise RuntimeError(f"{kind} cannot matter on this arm")


def once(
    rng: np.random.Generator, kind: str, seed: int, arm: str, size: float, spare: int = 0, poses: int = 0
) -> Drawn:
    """Draw machine, run, instrument, effects and noise; raise `Redraw` where the effect wanted cannot matter."""
    plant = true_machine(rng, arm)
    several = kind in SEVERAL
    rows = with_spare(run(rng, plant, arm, several, poses), spare)
    noise = noise_of(rng, kind)
    station = pose(rng.normal(0.0, 3.0, 3), turn(np.array([0.0, 0.0, rng.uniform(-3.0, 3.0)])))
    shifts = np.array(
        [pose(rng.normal(0.0, noise.restationing, 3), turn(rng.normal(0.0, 2e-5, 3))) for _ in range(SESSIONS)]
    )
    if spare:
        again = np.random.default_rng([seed, spare])
        later = [pose(again.normal(0.0, noise.restationing, 3), turn(again.normal(0.0, 2e-5, 3))) for _ in range(2)]
        shifts = np.concatenate([shifts, later])
    context = Context(rng, plant, rows, plant.relax(rows), SESSIONS)
    sizes = MANY if several else ONE
    found = [hide(context, name, station, shifts, size, sizes) for name in hidden(rng, kind)]
    errors, lost = noise.draw(rng, len(rows.q))
    effects, reached = tuple(e for e, _ in found), tuple(s for _, s in found)
    if several:
        try:
            plant.relax(rows, effects)
        except ArithmeticError as error:  # each comes to rest by itself
            raise Redraw from error
    return Drawn(kind, seed, arm, plant, rows, effects, reached, station, shifts, noise, errors, lost, spare)


def hidden(rng: np.random.Generator, kind: str) -> list[str]:
    """Names of what to hide."""
    if kind in NULLS:
        return []
    if kind in SEVERAL:  # no law twice
        names = {str(name).partition(" ")[0]: str(name) for name in rng.permutation([*KINDS, *LAGGED])}
        return list(names.values())[: int(kind.partition(" ")[0])]
    if kind != "two":
        return [kind]
    return [str(name) for name in rng.choice([*KINDS, *LAGGED], 2, replace=False)]


def noise_of(rng: np.random.Generator, kind: str) -> Noise:
    if kind == "none_restationed":
        return Noise(restationing=float(rng.uniform(1e-4, 3e-4)), heavy=True)
    return Noise(sigma={"none_noisier": 1.5 * SIGMA, "none_quieter": 0.5 * SIGMA}.get(kind, SIGMA))


def hide(
    context: Context, kind: str, station: Array, shifts: Array, size: float, between: tuple[float, float]
) -> tuple[Effect, float]:
    """Draw one effect and scale it until it alone moves the readings by the RMS wanted; return that, too."""
    name, _, lag = kind.partition(" ")
    maker = (CATALOGUE | UNNAMED | BEYOND)[name]
    context = replace(context, lagging=bool(lag))
    for _ in range(60):
        wanted = size * context.log(*between)
        before = context.rng.bit_generator.state
        try:
            effect = maker(context)
            found = scale(context, effect, wanted, station, shifts)
        except (Redraw, ArithmeticError):
            continue
        if effect.least * size <= effect.amplitude:
            effect.nearby = partial(nearby, maker, context, before, effect.amplitude)
            return effect, found
    raise Redraw


def nearby(maker: Maker, context: Context, before: dict, amplitude: float) -> list[Effect]:
    """Return an effect once for each of its continuous constants, that one moved by `NUDGE` of its range."""
    found: list[Effect] = []
    for which in range(20):
        rng = Nudged(before, which, NUDGE)
        with suppress(Redraw):
            one = replace(maker(replace(context, rng=rng)), amplitude=amplitude)
            if rng.left >= 0:  # there were not so many
                break
            found.append(one)
    return found


def scale(context: Context, effect: Effect, wanted: float, station: Array, shifts: Array) -> float:
    """Set the effect's amplitude; return the RMS reached, which a weak effect's limit may keep below what is wanted."""
    calm = read(context.plant, context.calm, station, shifts)
    effect.amplitude, reached = effect.trial, 0.0
    for _ in range(8):
        state = context.plant.relax(context.rows, [effect], context.calm, 1e-12)
        moved = (read(context.plant, state, station, shifts) - calm)[context.rows.measured]
        reached = float(np.sqrt((moved**2).sum(axis=1).mean()))
        if abs(reached / wanted - 1.0) < 1e-3 or (effect.weak and effect.amplitude == effect.limit):
            return reached
        effect.amplitude *= wanted / max(reached, 1e-30)
        if effect.amplitude > effect.limit:
            if not effect.weak:
                raise Redraw
            effect.amplitude = effect.limit
    raise Redraw


def true_machine(rng: np.random.Generator, arm: str) -> Plant:
    """The declared arm with the errors that calibration is told to expect."""
    plant = Plant.read_text(declared_text(arm))
    factors = {name: np.exp(rng.normal(0.0, 0.2, 6)) for name in plant.compliance}
    plant.compliance = {name: c * factors[name] for name, c in plant.compliance.items()}
    plant.offset = {j.name: float(rng.normal(0.0, 1e-3)) for j in plant.joints}
    plant.target = rng.normal(0.0, 5e-3, 3)
    return plant


def run(rng: np.random.Generator, plant: Plant, arm: str, several: bool = False, many: int = 0) -> Rows:
    """Draw poses and payloads, the order in which they were driven, and the weather."""
    trained, held = (int(rng.integers(*ends)) for ends in (((72, 177), (18, 45)) if several else ((60, 76), (16, 21))))
    trained, held = (many, 0) if many else (trained, held)
    lower = np.array([max(0.95 * j.lower, -2.8) for j in plant.joints])
    upper = np.array([min(0.95 * j.upper, 2.8 if j.kind != "prismatic" else np.inf) for j in plant.joints])
    poses = rng.uniform(lower, upper, (trained + held, len(lower)))
    if many:
        number, payload = np.arange(many), rng.integers(len(ARMS[arm].payloads), size=many)
    else:
        number, payload = visits(rng, len(poses), len(ARMS[arm].payloads), several).T
    q, stops = poses[number], len(number)
    session = np.arange(stops) * SESSIONS // stops
    hold, time = clock(rng, session)
    temperature = weather(rng, session, time)
    steam = 45.0 - 0.8 * (temperature - REFERENCE) + np.cumsum(rng.normal(0.0, 0.4, stops))
    held_out = number >= trained
    measured = ~held_out
    unread = 0 if many else UNREAD * stops // STOPS
    measured[rng.choice(np.flatnonzero(measured), unread, replace=False)] = False
    carried = ARMS[arm].payloads
    mass, com = np.array([m for _, m, _ in carried]), np.array([c for _, _, c in carried], float)
    came = approach(rng, q)
    return Rows(
        q,
        mass[payload],
        com[payload],
        came,
        number,
        session,
        payload,
        time,
        temperature,
        hold,
        steam,
        measured,
        held_out,
    )


def with_spare(rows: Rows, spare: int) -> Rows:
    """Return what was driven with stops after it, two hours later, that are not read; they stand as the last ones."""
    if not spare:
        return rows
    again = {one.name: getattr(rows, one.name)[-spare:] for one in fields(Rows)}
    none = np.zeros(spare, bool)
    again |= {"time": rows.time[-1] + 7200.0 + 600.0 * np.arange(spare), "measured": none, "held_out": none}
    again |= {"pose": rows.pose.max() + 1 + np.arange(spare)}
    return Rows(**{name: np.concatenate([getattr(rows, name), values]) for name, values in again.items()})


def visits(rng: np.random.Generator, poses: int, payloads: int, several: bool) -> Array:
    """Pose and payload of every stop: two or three payloads a pose (or one), each at least once, in random order."""
    counts, shares = ((1, 2, 3), (0.3, 0.4, 0.3)) if several else ((2, 3), (0.4, 0.6))
    pairs = [
        (number, int(payload))
        for number in range(poses)
        for payload in rng.choice(payloads, rng.choice(counts, p=shares), replace=False)
    ]
    again = rng.choice(len(pairs), max(9 * poses // 4 - len(pairs), 0) if several else STOPS - len(pairs))
    return rng.permutation(np.array(pairs + [pairs[i] for i in again]))


def clock(rng: np.random.Generator, session: Array) -> tuple[Array, Array]:
    """How long the load stood at every stop, and when it was read: about two days in all."""
    hold = np.round(rng.choice(HOLDS, len(session), p=HOLD_SHARES) * rng.uniform(0.9, 1.1, len(session)), 1)
    travel = rng.uniform(40.0, 120.0, len(session))
    pause = np.diff(session, prepend=0) * rng.uniform(3600.0, 3 * 3600.0, len(session))
    return hold, np.round(np.cumsum(hold + travel + pause), 1)


def weather(rng: np.random.Generator, session: Array, time: Array) -> Array:
    """Temperature: every session its own, with a slow drift."""
    level = rng.uniform(-6.0, 6.0, SESSIONS)[session]
    first = np.array([time[session == s][0] for s in range(SESSIONS)])[session]
    hours = (time - first) / 3600.0
    slope, swing = rng.uniform(-0.5, 0.5, SESSIONS)[session], rng.uniform(0.3, 1.0, SESSIONS)[session]
    period = rng.uniform(3.0, 8.0, SESSIONS)[session]
    return np.round(REFERENCE + level + slope * hours + swing * np.sin(2 * np.pi * hours / period), 3)


def approach(rng: np.random.Generator, q: Array) -> Array:
    """Sign of every joint's last motion; unknown to the reader before the first row, so drawn there."""
    came = np.sign(np.diff(q, axis=0, prepend=q[:1]))
    came[0] = rng.choice((-1.0, 1.0), q.shape[1])
    for k in range(1, len(q)):
        came[k] = np.where(came[k] == 0.0, came[k - 1], came[k])
    return came
