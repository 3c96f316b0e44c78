"""What a fit sees of a campaign at one state of the arm: readings, residuals, and how readings answer to tip motion."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pinocchio as pin

from armflex.arm import Arm, Setup
from armflex.conventions import STANDARD_GRAVITY, TWIST_NAMES, Array, said_of
from armflex.errors import ArmflexError
from armflex.laws.effects.context import Context, survey
from armflex.laws.effects.effect import Act, Effect, EffectLaw, Values
from armflex.laws.effects.in_arm import bending, directions
from armflex.laws.effects.location import Location, link_of, same_site, site_of
from armflex.measured.measurements import Measurements
from armflex.mechanics.history import known_rows
from armflex.mechanics.modes import DAMPING, modes_of
from armflex.mechanics.response import Response, respond
from armflex.mechanics.spring import Spring
from armflex.readings import Kind, Position, Postures, Readings
from armflex.readings.instrument import twist_per_value
from armflex.rows import Rows
from armflex.rows.rows import APPROACH
from armflex.rows.wrench import wrenches_in

MODES_MATCHED = 12
"""Tolerance: modes that a frequency is matched among."""

QUOTIENT_STEP = 1e-4
"""Tolerance: step of a difference quotient, relative to the prior standard deviation, else to the value."""

LARGEST_MOTION = 0.03
"""Prior: RMS of the tip's motion that is expected of a missing effect at most, by how far the arm reaches: one standard
deviation. An axis that is off by two degrees somebody sees."""


@dataclass(frozen=True)
class View:
    """Rows driven at one setup: a campaign's measured ones, or such as could be read.

    Attributes:
        setup: The state it was computed at.
        driven: All rows in the order driven.
        rows: (M,) numbers of those that are looked at.
        line: The linearised arm at those rows.
        readings: What was read in those rows, or is to be: d numbers each.
        residual: (M, d) measured minus predicted, in the units of the readings.
        sessions: Session of each row.
    """

    setup: Setup
    driven: Rows
    rows: np.ndarray
    line: Response
    readings: Readings
    residual: Array
    sessions: tuple[str, ...]

    def some(self, which: np.ndarray) -> View:
        """Return the view of (m,) of its rows, counted from 0, none of them twice."""
        line, readings = self.line.some(which), self.readings.some(which)
        sessions = tuple(self.sessions[i] for i in which)
        return View(self.setup, self.driven, self.rows[which], line, readings, self.residual[which], sessions)

    @cached_property
    def at(self) -> Postures:
        """What the instruments look at."""
        return postures(self.setup, self.line, self.driven, self.rows)

    @cached_property
    def context(self) -> Context:
        """What effects see of the rows driven."""
        if len(self.rows) < len(self.driven):
            return look(self.setup, self.driven, readings=Readings(len(self.driven))).context
        wrenches = {site: self.line.load_at(site) for site in self.line.sites}
        columns = known_rows(self.arm, self.driven, gravity_in(self.setup, self.sessions))
        stars = any(sensor.kind.far for sensor in self.arm.sensors.values())
        return survey(self.driven, self.arm, columns, wrenches, self.line.links[:, :, :3, 3], stars)

    @property
    def sigma(self) -> Array:
        """(M, d) one standard deviation of each number, in its unit; infinite where it was not read."""
        return self.readings.sigma

    @property
    def foremost(self) -> slice:
        """Where the numbers by which the size of an error is said stand among the d of a row: the tip's position."""
        return self.readings.foremost

    def rms(self, errors: Array) -> float:
        """Return the RMS of the 3-D position error [m] of (M, d) errors; without any of the `foremost` readings."""
        return foremost_rms(self.readings, errors)

    def at_target(self, error: float) -> str:
        """Return in a sentence how many mm an error of pictures is at what they show, '' of other readings.

        It is across the line of sight: pixels times distance by focal length, the median over what was read.
        """
        across = [
            1.0 / kind.by_shift(self.at)[np.isfinite(kind.sigma)] for kind in self.readings.kinds if kind.unit == "px"
        ]
        if self.readings.unit != "px" or not across:
            return ""
        size = error * float(np.median(np.concatenate(across)))
        return f"{said_of(error, 'px')} is {said_of(size, 'm')} at the target's distance."

    @property
    def whitened(self) -> Array:
        """(M, d) residual in standard deviations, dimensionless."""
        return self.residual / self.sigma

    @property
    def count(self) -> int:
        """Number of readings."""
        return sum(self.counts)

    @property
    def counts(self) -> tuple[int, ...]:
        """(G,) readings of each instrument: an orientation that was not read is none, nor is what cannot be wrong."""
        each = [(kind.name, int(np.isfinite(kind.sigma).sum()) - kind.exact) for kind in self.readings.kinds]
        return tuple(sum(count for name, count in each if name == instrument) for instrument in self.readings.names)

    @property
    def by_frame(self) -> Array:
        """(M, d, 6) changes of the readings per shift and rotation vector of the instrument's frame [m, rad]."""
        return self.readings.stacked(lambda kind: kind.by_frame(self.at))

    @property
    def by_session(self) -> Array:
        """(M, d, 6) changes of the readings per shift and rotation vector of the session's frame, as read [m, rad]."""
        back = {name: self.setup.instrument.session(name).inverse().action for name in set(self.sessions)}
        return self.by_frame @ np.array([back[name] for name in self.sessions]).reshape(-1, 6, 6)

    @property
    def by_scale(self) -> Array:
        """(M, d) changes of the readings, in their units, per share by which the instrument's scale is too long."""
        return self.readings.stacked(lambda kind: kind.by_scale(self.at))

    @property
    def by_target(self) -> Array:
        """(M, d, 3) changes of the readings per shift of the target in the tip frame [m]."""
        return self.readings.stacked(lambda kind: kind.by_target(self.at))

    @property
    def by_mounting(self) -> Array:
        """(M, d, 3) changes of the readings per rotation vector of the target on the tool, in tip axes [rad]."""
        return self.readings.stacked(lambda kind: kind.by_mounting(self.at))

    @property
    def by_gravity(self) -> Array:
        """(M, d, 3) changes of the readings per gravity in base axes, to which the arm gives [per m/s^2]."""
        change = self.answer(lambda line: line.gravity) + self.readings.stacked(lambda kind: kind.by_gravity(self.at))
        robot, size = self.arm.robot, QUOTIENT_STEP * STANDARD_GRAVITY
        for i, axis in enumerate(np.eye(3) if self.indirect else ()):
            heavier = replace(self.arm, robot=replace(robot, gravity=robot.gravity + size * axis))
            change[:, :, i] += self.quotient(replace(self.setup, arm=heavier), size)
        return change

    @property
    def by_shift(self) -> Array:
        """(M, d) changes of the readings, in their units, as what they see is shifted any way [per m]."""
        return self.readings.stacked(lambda kind: kind.by_shift(self.at))

    @property
    def largest_motion(self) -> float:
        """RMS of the tip's motion that is expected of a missing effect at most [m]; see `LARGEST_MOTION`."""
        return LARGEST_MOTION * float(np.linalg.norm(self.line.tip[:, :3, 3], axis=1).max())

    @property
    def per_metre(self) -> float:
        """How much the size of the foremost readings, see `rms`, changes as what they see is shifted [per m].

        It is 1 of all but pictures.
        """
        if self.readings.unit != "px":
            return 1.0
        return self.rms(self.by_shift[:, self.foremost]) / np.sqrt(3.0)  # the mean over directions

    def by_sensor(self, name: str, key: str = "") -> Array:
        """Return (M, d, K) changes of the readings per nuisance of a sensor, in their units; see `Kind.by_key`."""
        columns = np.zeros((*self.residual.shape, len(self.arm.sensors[name].std)))
        for kind, place in self.readings.placed:
            if kind.name == name:
                columns[:, place] = kind.by_key(self.at, key)
        return columns

    @property
    def arm(self) -> Arm:
        """The arm at this setup."""
        return self.setup.arm

    def load_at(self, site: str) -> Array:
        """Return the (M, 6) wrench on the structure at a site, local axes [N, Nm]."""
        return self.line.load_at(site)

    def pose_of(self, link: str) -> Array:
        """Return the (M, 4, 4) pose of a link in the base [m]."""
        return self.line.links[:, self.line.link_names.index(link)]

    def gravity(self, vectors: Array) -> Array:
        """Return (M, k, 3) what (k, 3) gravities of the arm are in the base axes of each row [m/s^2]."""
        turns = self.falls
        return (
            np.broadcast_to(vectors, (len(self.rows), *vectors.shape))
            if turns is None
            else vectors @ turns.swapaxes(1, 2)
        )

    @cached_property
    def falls(self) -> Array | None:
        """See `Setup.falls`."""
        return self.setup.falls(self.sessions)

    def jacobian(self, law: EffectLaw, location: Location, inner: Values, context: Context) -> Array:
        """Return (M, d, k) changes of the readings per unit of an effect's acting amplitudes, exact where zero."""
        direction = law.direction(context.here(location, self.arm), inner)
        if direction is not None:  # one number a row, times one answer of the readings
            shapes = law.shapes(location, inner, self, context)[list(location.terms)]
            return (self.to_twist(location.site) @ direction)[:, :, None] * shapes.T[:, None, :]
        return _products(self.per(law, location), law.features(location, inner, self, context))

    def effect_jacobian(self, effect: Effect, context: Context) -> Array:
        """Return (M, d, k) changes of the readings per unit of an effect's acting amplitudes at its values."""
        law, location = effect.law, effect.location
        if law.act is Act.FRAME:
            per = self.per(law, location) @ twist_per_value(np.array(effect.amplitudes))
            return _products(per, np.mean(effect.each(self, context), axis=0))
        each = [self.jacobian(law, location, effect.inner, clock) for clock in effect.clocks(context)]
        return each[0] if len(each) == 1 else np.mean(each, axis=0)

    def wandered(self) -> Array:
        """Return (K, M, d) changes of the readings by what wandered in a campaign, from its mean [m, rad].

        The sum of their squares is the variance of what no other day is known to have.
        """
        motions = [np.zeros((0, *self.residual.shape))]
        for effect in self.arm.effects:
            if len(effect.moments) > 1:
                twists = np.array([effect.acting @ change for change in effect.each(self, self.context)])
                twists = (twists - twists.mean(axis=0)) / np.sqrt(len(twists))
                motions.append((self.per(effect.law, effect.location) @ twists[..., None])[..., 0])
        return np.concatenate(motions)

    def per(self, law: EffectLaw, location: Location) -> Array:
        """Return (M, d, n) changes of the readings per unit of the features that a law has at a location."""
        if law.act is Act.TWIST:
            return self.to_twist(location.site)
        if law.act is Act.LOAD:
            return self.to_load(link_of(location.site, self.arm.robot))
        if law.act is Act.TENSION:
            return self.to_tension(next(spring for spring in self.arm.springs if spring.name == location.site))
        if law.act is Act.GRAVITY:
            return self.by_gravity
        if law.act is Act.SIGHT:
            return self.readings.stacked(lambda kind: kind.by_bend(self.at))
        return self.by_session if law.act is Act.FRAME else self.by_scale[:, :, None]

    def answer(self, motion: Callable[[Response], Array]) -> Array:
        """Return (M, d, k) changes of the readings for what of a response is a (M, 6, k) motion [m, rad]."""
        columns = None
        for place, link, seen in self.seen:
            part = seen @ motion(self.line.of(link))
            columns = np.zeros((*self.residual.shape, part.shape[2])) if columns is None else columns
            columns[:, place] += part
        return np.zeros((*self.residual.shape, motion(self.line).shape[2])) if columns is None else columns

    @cached_property
    def seen(self) -> tuple[tuple[slice, str | None, Array], ...]:
        """Which numbers see which link, and their (M, n, 6) change with its motion [m, rad]; None is the tip."""
        return tuple(
            (place, link, seen) for kind, place in self.readings.placed for link, seen in kind.jacobian(self.at).items()
        )

    @cached_property
    def indirect(self) -> tuple[tuple[Kind, slice, np.ndarray], ...]:
        """Kinds that answer to more than motions of links, where their numbers stand, and the (m,) rows they read."""
        placed = ((kind, place) for kind, place in self.readings.placed if not kind.by_motion)
        asked = ((kind, place, np.flatnonzero(np.isfinite(kind.sigma).any(axis=1))) for kind, place in placed)
        return tuple(triple for triple in asked if len(triple[2]))

    def quotient(self, after: Setup, size: float) -> Array:
        """Return (M, d) what `indirect` kinds read at another setup less at this, over a size; zero for other kinds.

        Loads and frequencies follow from the equilibrium as a whole, so they are asked of the other setup.
        """
        change = np.zeros(self.residual.shape)
        if not self.indirect:
            return change
        touched = np.unique(np.concatenate([rows for *_, rows in self.indirect]))
        driven = self.rows[touched]
        at = postures(after, solved(after, self.driven, driven), self.driven, driven)
        for kind, place, rows in self.indirect:
            touching, among = kind.some(rows), np.searchsorted(touched, rows)
            change[rows, place] = (
                touching.predicted(at.some(among)) - (touching.values - self.residual[rows, place])
            ) / size
        return change

    def quotients(self, key: object, setups: Iterable[tuple[Setup, float]]) -> Array:
        """Return (M, d, k) the `quotient` of every setup and size, kept for whoever asks by the same object."""
        if id(key) not in self._quotients:
            changes = [self.quotient(*setup) for setup in setups]
            self._quotients[id(key)] = key, np.stack(changes, axis=2)
        return self._quotients[id(key)][1]

    @cached_property
    def _quotients(self) -> dict[int, tuple[object, Array]]:
        return {}

    def effect_quotient(self, law: EffectLaw, location: Location, inner: Values, features: Array) -> Array:
        """Return (M, d, k) what `indirect` kinds change by per unit of an effect's acting amplitudes where it has none.

        A twist that no load changes shifts loads and frequencies to second order only: then it is zero.

        Args:
            law, location, inner: The effect.
            features: (M, k, n) what the law adds in the rows per unit, from which the step is chosen.
        """
        columns, small = np.zeros((*self.residual.shape, features.shape[1])), QUOTIENT_STEP * self.largest_motion
        if not self.indirect or not (law.loaded or law.act in (Act.LOAD, Act.TENSION)):
            return columns
        read = Readings(len(self.rows), (Position.unread(len(self.rows)),))
        at_tip = replace(self, readings=read, residual=np.zeros((len(self.rows), 3)))
        moved = at_tip.per(law, location) @ features.transpose(0, 2, 1)
        for column, term in enumerate(location.terms):
            length = at_tip.rms(moved[:, :, column])
            if not length > 0.0:
                continue
            size = small / max(length, small)
            amplitudes = np.zeros(len(law.amplitudes))
            amplitudes[term] = size
            effect = Effect(law, location, (*amplitudes.tolist(), *inner))
            with suppress(ArmflexError):  # no tangent to swing about at a kink: frequencies say nothing of it
                columns[:, :, column] = self.quotient(self.setup.with_effect(effect), size)
        return columns

    def to_twist(self, site: str) -> Array:
        """Return (M, d, 6) changes of the readings per twist added to what a site gives [m, rad]."""
        if site not in self._to_twist:
            place = site_of(site, self.setup.arm.robot)
            places = [i for i, flexure in enumerate(self.setup.arm.modelled) if same_site(flexure.site, place)]
            self._to_twist[site] = self.answer(lambda line: line.laws[:, :, places[-1]] if places else line.site(site))
        return self._to_twist[site]

    def at_random(self, twists: Sequence[tuple[str, str, float]]) -> Array:
        """Return (K, M, d) changes of the readings by a standard deviation of each of K random twists.

        Args:
            twists: Site, axis and standard deviation [m or rad] of each.
        """
        motions = [size * self.to_twist(site)[:, :, TWIST_NAMES.index(axis)] for site, axis, size in twists]
        return np.array(motions).reshape(-1, *self.residual.shape)

    @cached_property
    def _to_twist(self) -> dict[str, Array]:
        return {}

    def to_load(self, link: str) -> Array:
        """Return (M, d, 6) changes of the readings per wrench at a link's origin [N, Nm], base axes."""
        if link not in self._to_load:
            index = self.line.link_names.index(link)
            self._to_load[link] = self.answer(lambda line: line.link_loads[:, index])
        return self._to_load[link]

    def to_tension(self, spring: Spring) -> Array:
        """Return (M, d, 1) changes of the readings per tension between the ends of a spring [N]."""
        starts = [self._at(*end) for end in spring.ends]
        way = starts[1] - starts[0]
        pull: Array = way / np.linalg.norm(way, axis=1, keepdims=True)
        column: Array = np.zeros((*self.residual.shape, 1))
        for (link, _), start, force in zip(spring.ends, starts, (pull, -pull), strict=True):
            moment = np.cross(start - self.pose_of(link)[:, :3, 3], force)
            column += self.to_load(link) @ np.concatenate([force, moment], axis=1)[:, :, None]
        return column

    def length_of(self, spring: Spring) -> Array:
        """Return the (M,) distance of a spring's ends [m]."""
        first, second = (self._at(*end) for end in spring.ends)
        return np.linalg.norm(second - first, axis=1)

    def _at(self, link: str, point: Array) -> Array:
        """Return (M, 3) where a (3,) point of a link is, in the base [m]."""
        pose = self.pose_of(link)
        return pose[:, :3, :3] @ point + pose[:, :3, 3]

    @cached_property
    def _to_load(self) -> dict[str, Array]:
        return {}


def _products(per: Array, features: Array) -> Array:
    """Return (M, d, k) changes of the readings by (M, k, n) features, in half the time of small products of rows."""
    columns = np.empty((*per.shape[:2], features.shape[1]))
    for i in range(features.shape[1]):
        np.einsum("rdn,rn->rd", per, features[:, i], out=columns[:, :, i])
    return columns


def look(
    setup: Setup,
    rows: Rows,
    chosen: np.ndarray | None = None,
    readings: Readings | None = None,
    line: Response | None = None,
) -> View:
    """Return the view of some rows at one setup.

    Args:
        setup: Arm and instrument.
        rows: All rows in the order driven.
        chosen: (M,) numbers of those looked at; all of them when not given.
        readings: What was read in all rows, or would be; what the rows themselves have where it is not given.
        line: The linearised arm at those rows, where it is known.
    """
    chosen = np.arange(len(rows)) if chosen is None else chosen
    line = solved(setup, rows, chosen) if line is None else line
    sessions = tuple(rows.session[row] for row in chosen)
    if readings is None:
        readings = rows.readings if isinstance(rows, Measurements) else Readings(len(rows))
    read, at = readings.some(chosen), postures(setup, line, rows, chosen)
    return View(setup, rows, chosen, line, read, read.stacked(lambda kind: kind.residual(at)), sessions)


def solved(setup: Setup, rows: Rows, chosen: np.ndarray, allow_large: bool = False) -> Response:
    """Return the linearised arm at (M,) of some rows, by their numbers in the order driven; see `respond`."""
    arm, gravity = setup.arm, gravity_in(setup, rows.session)
    payloads = [rows.payload[row] for row in chosen]
    columns = {name: values[chosen] for name, values in known_rows(arm, rows, gravity).items()}
    gravity = None if gravity is None else gravity[chosen]
    wrenches = wrenches_in(rows.wrenches, chosen)
    return respond(arm, rows.q[chosen], payloads, columns, allow_large, wrenches, gravity)


def postures(setup: Setup, line: Response, rows: Rows, chosen: np.ndarray) -> Postures:
    """Return what instruments look at, of an arm that is solved in (M,) of some rows."""
    arm = setup.arm

    def pose(link: str | None) -> Array:
        return line.tip if link is None else line.links[:, line.link_names.index(link)]

    def swing(row: int) -> tuple[Array, Array]:
        modes = modes_of(line.equilibrium(row), MODES_MATCHED, DAMPING)
        return modes.frequencies, modes.shapes / np.sqrt(modes.masses)[:, None]

    def place(row: int) -> object:
        return rows.places[chosen[row]] if rows.places else f"row {chosen[row]}"

    q, approach = (
        {joint: values[:, i] for i, joint in enumerate(arm.joint_names)}
        for values in (line.row.q, rows.approach[chosen])
    )
    sessions = tuple(rows.session[row] for row in chosen)
    gravity = gravity_in(setup, sessions)
    gravity = arm.robot.gravity if gravity is None else gravity
    bend = bending(arm.effects, line.row, len(chosen))
    return Postures(
        pose, sessions, setup.instrument, arm.sensors, gravity, q, approach, line.load_at, swing, place, bend
    )


def gravity_in(setup: Setup, sessions: Sequence[str]) -> Array | None:
    """Return (N, 3) gravity in the base axes of each row [m/s^2], None where it is the arm's in all; see `falls`."""
    turns = setup.falls(sessions)
    return None if turns is None else turns @ setup.arm.robot.gravity


def unclear_shifts(setup: Setup, rows: Rows, readings: Readings) -> Array:
    """Return (K, N, d) by how much readings are off halfway where nothing says from which side a joint came [m, rad].

    One for each direction that effects derive from the order of the rows (`Effect.derived`), zero where the rows say so
    it: the joint came from either side, so it is the standard deviation of what is read, too.
    """
    effects = setup.arm.effects
    unclear = {name: unknown for name, effect, unknown in directions(effects, rows) if name in effect.derived}
    shifts = np.zeros((len(unclear), len(rows), readings.size))
    for shift, (name, unknown) in zip(shifts, unclear.items(), strict=True):
        open_rows, sides = np.flatnonzero(unknown), []
        joint = rows.joint_names.index(name.removeprefix(APPROACH))
        for side in (-1.0, 1.0) if len(open_rows) else ():
            approach = rows.approach.copy()
            approach[open_rows, joint] = side
            sides.append(look(setup, replace(rows, approach=approach), open_rows, readings=readings))
        if sides:  # of a link's motion, which is small: rotation vectors of what is read may differ by more than it
            for (place, link, before), (_, _, after) in zip(sides[0].seen, sides[1].seen, strict=True):
                here, there = (side.line.of(link).tip for side in sides)
                turns = [pin.log3(new @ old.T) for new, old in zip(there[:, :3, :3], here[:, :3, :3], strict=True)]
                motion = np.concatenate([there[:, :3, 3] - here[:, :3, 3], np.array(turns)], axis=1)
                shift[open_rows, place] += 0.25 * ((before + after) @ motion[:, :, None])[:, :, 0]
    return shifts


def foremost_rms(readings: Readings, errors: Array) -> float:
    """Return the RMS of (M, d) errors over the rows with foremost readings [m, rad]; see `Readings.row_squares`."""
    count = np.count_nonzero(readings.foremost_count)
    return float(np.sqrt(readings.row_squares(errors).sum() / max(count, 1)))
