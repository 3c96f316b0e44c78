"""An arm: a robot, the laws of its flexures, and the payloads it knows; the question is `arm.deflection(q)`.

A `Setup` is an arm and the instrument that looks at it.
"""

from __future__ import annotations

import math
import sys
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from html import escape
from typing import Any, TypedDict, Unpack, cast, overload

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from armflex.arguments import checked_init, checked_kinds
from armflex.conventions import LARGEST_POSITION, TWIST_NAMES, Array, cached_property, covariate_array, real_array
from armflex.declaration import Source
from armflex.errors import (
    ArmflexWarning,
    ArrayTypeError,
    Flag,
    InputError,
    JointLimitError,
    NotFiniteError,
    ShapeError,
    UnknownNameError,
    listing,
)
from armflex.laws.declared import Flexure as Flexure
from armflex.laws.effects.context import begun_anew
from armflex.laws.effects.effect import ChangeableModel, Effect
from armflex.laws.effects.in_arm import Pulling, pulling, with_twists
from armflex.mechanics.certificate import NEAR
from armflex.mechanics.deflection import Asked, Deflection, DeflectionBatch, deflect, deflect_batch, near_buckling
from armflex.mechanics.history import known_alone, remembering
from armflex.mechanics.laws import LawStack
from armflex.mechanics.loaded import NO_PAYLOAD, LoadedArm, Names, Payload
from armflex.mechanics.modes import Modes, modes_of
from armflex.mechanics.pinocchio_model import LoadCase
from armflex.mechanics.query import Prepared
from armflex.mechanics.spring import Spring
from armflex.parameters import (
    CARRIED,
    FRAME,
    MOUNTED,
    TARGET,
    ArmParameter,
    Certainty,
    ParameterKind,
    named,
    numbers_of,
    of_compliance,
    of_effect,
    of_law,
    of_masses,
    of_motions,
    of_offsets,
    of_sensor,
    of_springs,
    of_targets,
)
from armflex.readings.instrument import Instrument
from armflex.readings.sensor import Sensor
from armflex.robot import Corrections, Robot, Site
from armflex.robot.urdf import Joint
from armflex.rows.period import Period
from armflex.rows.wrench import Wrench

SOME_NEAR = (Flag("near_buckling", f"in some rows {NEAR:g} times the loads would make the arm buckle; see `flags`"),)
NO_HISTORY = "what effects remember is as after this load alone, put on once: of a path ask `check` or `predict`"

OneRow = Sequence[float] | np.ndarray[tuple[int], np.dtype[Any]]
ManyRows = Sequence[Sequence[float]] | np.ndarray[tuple[int, int], np.dtype[Any]]
"""Joint positions as a type checker distinguishes them; an array of unknown shape counts as one row."""


class DeflectionOptions(TypedDict, total=False):
    """What `Arm.deflection` is asked beside positions and payload, which says what the others are.

    Attributes:
        v, a: (nq,) or (N, nq) velocities and accelerations [rad/s or m/s, rad/s^2 or m/s^2].
        covariates: Numbers or (N,) by name, in SI units.
    """

    v: ArrayLike | None
    a: ArrayLike | None
    covariates: Mapping[str, ArrayLike] | None
    wrenches: Sequence[Wrench]
    method: str
    enforce_limits: bool
    allow_large: bool
    strict: bool
    jobs: int | None


TURN = 2.0 * np.pi
"""Position [rad] beyond which one that is outside the limits may be in degrees."""

SLACK = 1e-9
"""How far beyond a limit [rad or m] a joint may stand: rounding is no fault."""


@dataclass(frozen=True)
class Measurement:
    """The instrument: `frame` is "base" or "unknown", `gravity_in` is "base" or "measurement"."""

    frame: str = "unknown"
    gravity_in: str = "base"


@dataclass(frozen=True)
class Prior:
    """One standard deviation of what calibration may move; 0 keeps it fixed.

    Attributes:
        joint_offset: Every joint [rad or m].
        compliance: Every declared linear compliance, relative.
        young: One factor on the compliance of every part that `armflex fem` wrote and says no `young_std` of, relative.
        tool: The target's place in the tip frame [m].
        geometry: Every fixed transform of the chain [m and rad].
        mass: Mass of every link that moves, relative.
        payload_mass: Mass of every payload that a campaign carries, relative.
        spring: Rate of every linear spring, pressure of every gas spring, relative.
        spring_length: Free length of every linear spring [m].
        session_target: The target's place in the tip frame between sessions, in each of which it was mounted anew [m].
        session_translation: Instrument frame between sessions [m].
        session_rotation: Instrument frame between sessions [rad].
        each: Mean and standard deviation of single parameters by label, in their units, instead of 0 and the above; as
            sister arms have them, see `armflex.estimate.calibrations`. A parameter of 0 and 0 is fixed.
    """

    joint_offset: float = 0.0
    compliance: float = 0.0
    young: float = 0.0
    tool: float = 0.0
    geometry: float = 0.0
    mass: float = 0.0
    payload_mass: float = 0.0
    spring: float = 0.0
    spring_length: float = 0.0
    session_target: float = 0.0
    session_translation: float = 0.0
    session_rotation: float = 0.0
    each: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def of(self, parameter: ArmParameter) -> tuple[float, float]:
        """Return mean and standard deviation of a parameter of the arm itself, in its unit."""
        kind, name = parameter.group.kind, str(parameter.group.of)
        stds = {
            ParameterKind.OFFSET: self.joint_offset,
            ParameterKind.GEOMETRY: self.geometry,
            ParameterKind.MASS: self.payload_mass if name.startswith(CARRIED) else self.mass,
            ParameterKind.SPRING: self.spring_length if parameter.unit == "m" else self.spring,
            ParameterKind.COMPLIANCE: self.compliance,
        }
        return self.each.get(parameter.label, (0.0, stds.get(kind, 0.0)))


@checked_init
@dataclass(frozen=True, repr=False, eq=False)
class Arm:
    """A manipulator with joint compliance. Immutable: safe to share between threads.

    Attributes:
        robot: The validated robot.
        flexures: Where it gives and how, in order.
        payloads: What it may carry, by name; "none" always exists.
        payload_rating: Heaviest rated payload [kg], None when not stated.
        measurement: Frame in which campaigns of this arm are measured.
        prior: What calibration may move, one standard deviation each.
        corrections: Constant errors of the kinematics that calibration found; part of what makes the tip displaced.
        factors: Logarithms (6,), dimensionless, of what calibration found to be the factors on the axes of a flexure's
            compliance, by flexure; `flexures` have them already.
        masses: Logarithms of what calibration found to be the factors on masses and moments of inertia, by link, and by
            payload after `parameters.CARRIED`; `robot` and `payloads` have them already.
        instrument: Where the instrument stands that measured this arm, None when it was not calibrated.
        sensors: Instruments beside that one, by name, as declared and with what calibration found of them.
        effects: What it does beyond its flexures, as measurements showed.
        clock: When the campaigns were that it was fitted to, on whose clock effects of time hold; empty where their
            rows were not timed, or nobody says.
        certainty: How well everything that was fitted is known, None where nothing was, or where nobody says.
        flags: Flags about the arm as declared.
        damping_ratio: Damping of its vibrations over the critical one, None when not stated.
        springs: Between points of its links.
        source: The arm.toml that declares it, as it was read; None where nobody wrote one, or a preset was chosen.
    """

    robot: Robot
    flexures: tuple[Flexure, ...] = ()
    payloads: Mapping[str, Payload] = field(default_factory=dict)
    payload_rating: float | None = None
    measurement: Measurement = field(default_factory=Measurement)
    prior: Prior = field(default_factory=Prior)
    corrections: Corrections = field(default_factory=Corrections)
    factors: Mapping[str, Array] = field(default_factory=dict)
    masses: Mapping[str, float] = field(default_factory=dict)
    instrument: Instrument | None = None
    sensors: Mapping[str, Sensor] = field(default_factory=dict)
    effects: tuple[Effect, ...] = ()
    clock: tuple[Period, ...] = ()
    certainty: Certainty | None = None
    flags: tuple[Flag, ...] = ()
    damping_ratio: float | None = None
    springs: tuple[Spring, ...] = ()
    source: Source | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        places = [*(joint.name for joint in self.robot.places), *self.robot.linkage.closures]
        for flexure in self.flexures:
            if flexure.joint is not None and flexure.joint not in places:
                raise UnknownNameError("joint between base and tip", flexure.joint, places)
            if sum(other.name == flexure.name for other in self.flexures) > 1:
                raise InputError(f"two flexures are named {flexure.name!r}")
        for spring in self.springs:
            for link, _ in spring.ends:
                if link not in (links := self.robot.urdf.below(self.robot.base)):
                    raise UnknownNameError("link", link, sorted(links))

    def __getstate__(self) -> dict[str, object]:
        """Return what is declared; models are made again where the arm is sent."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def __repr__(self) -> str:
        """One line: an arm is too much to print."""
        joints, places = len(self.joint_names), len(self.flexures)
        ends = f"{self.robot.base} to {self.robot.tip}"
        return f"<Arm {self.robot.urdf.name!r}: {joints} joints, {places} flexures, {ends}>"

    def _repr_html_(self) -> str:
        rows = [
            (
                flexure.name,
                flexure.joint or "base",
                type(flexure.law).__name__,
                "yes" if flexure.law.uncertain else "no",
            )
            for flexure in self.flexures
        ]
        table = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows)
        head = "<tr><th>flexure</th><th>joint</th><th>law</th><th>uncertain</th></tr>"
        effects = "".join(f"<li>{escape(effect.title)}</li>" for effect in self.effects)
        return f"<p>{escape(repr(self)[1:-1])}</p><table>{head}{table}</table><ul>{effects}</ul>"

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the moving joints: the order of q."""
        return self.robot.joint_names

    @cached_property
    def flexure_names(self) -> tuple[str, ...]:
        """Names of the flexures, those that only effects make last: the order of wrenches and twists."""
        return tuple(flexure.name for flexure in self.modelled)

    @cached_property
    def link_names(self) -> tuple[str, ...]:
        """Names of the links at and beyond the base."""
        return self.loaded(None).links

    @cached_property
    def modelled(self) -> tuple[Flexure, ...]:
        """The flexures with what effects add to their laws, and those that only effects make."""
        return with_twists(self.flexures, self.effects, self.robot)

    @cached_property
    def sites(self) -> tuple[Site, ...]:
        """Where the flexures are, in the order of `flexure_names`."""
        return tuple(flexure.site for flexure in self.modelled)

    @cached_property
    def distributed(self) -> dict[int, Array]:
        """(12, 12) of every flexure that has an `inertia` [kg, kg m, kg m^2], by its number."""
        return {i: flexure.inertia for i, flexure in enumerate(self.modelled) if flexure.inertia is not None}

    @cached_property
    def pulls(self) -> tuple[Pulling, ...]:
        """Loads that effects put on links."""
        return pulling(self.effects, self.robot)

    @cached_property
    def names(self) -> Names:
        """Everything a result needs to say what it is about."""
        return Names(self.joint_names, self.flexure_names, self.robot.base, self.robot.tip)

    @cached_property
    def stack(self) -> LawStack:
        """All laws as one map."""
        return LawStack(self.flexure_names, tuple(flexure.law for flexure in self.modelled))

    def found(self, parameter: ArmParameter) -> float:
        """Return what calibration found of a parameter of the arm itself, in its unit."""
        kind, name = parameter.group.kind, str(parameter.group.of)
        if kind is ParameterKind.OFFSET:
            return self.corrections.joint_offset.get(name, 0.0)
        if kind is ParameterKind.MASS:
            return self.masses.get(name, 0.0)
        if kind is ParameterKind.SPRING:
            values = [value for spring in self.springs for value in spring.law.found]
            return dict(zip(of_springs(self.springs), values, strict=True)).get(parameter, 0.0)
        axis = TWIST_NAMES.index(str(parameter.name))
        values = (self.corrections.geometry if kind is ParameterKind.GEOMETRY else self.factors).get(name)
        return 0.0 if values is None else float(values[axis])

    @checked_kinds
    def named(self, labels: Sequence[str]) -> tuple[ArmParameter, ...]:
        """Return the parameters of the arm and its instrument that labels name; see `armflex.parameters.named`.

        In files from before effects of one name were numbered, those of the second have the name of the first.
        """
        sessions = self.instrument.sessions if self.instrument else ()
        parameters = [*FRAME, *of_motions(ParameterKind.SESSION, sessions), *MOUNTED, *TARGET, *of_offsets(self.robot)]
        parameters += of_targets(self.instrument.targets if self.instrument else ())
        parameters += of_motions(ParameterKind.GEOMETRY, self.robot.frames)
        parameters += [*of_masses(self.weighing), *of_springs(self.springs)]
        parameters += [parameter for sensor in self.sensors.values() for parameter in of_sensor(sensor, sensor.found)]
        for flexure in self.flexures:
            parameters += of_compliance(flexure.name)
            if flexure.learned:
                parameters += of_law(flexure.name, flexure.learned)
        pairs = [(parameter, parameter.label) for parameter in parameters]
        for effect, number in zip(self.effects, numbers_of(self.effects), strict=True):
            numbered, first = of_effect(effect, number), of_effect(effect, 1)
            pairs += [(parameter, parameter.label) for parameter in numbered]
            pairs += [(parameter, old.label) for parameter, old in zip(numbered, first, strict=True) if number > 1]
        return named(labels, pairs)

    def left(self, after: float = math.inf) -> Arm:
        """Return the arm as its campaigns left it, after a moment of their clock [s]; see `Afterwards`.

        Where nobody says when the campaign of an effect was, the effect stays on the clock of rows.
        """
        return self._with_effects(lambda effect: replace(effect, left=math.inf if effect.earlier else after, later=0.0))

    def on_clock(self, later: float = 0.0) -> Arm:
        """Return the arm as it was in its last campaigns, for rows whose clock is behind theirs by so much [s]."""
        return self._with_effects(lambda effect: effect if effect.earlier else replace(effect, left=None, later=later))

    def _with_effects(self, change: Callable[[Effect], Effect]) -> Arm:
        effects = tuple(
            change(effect) if effect.of_time and (self.clock or effect.earlier) else effect for effect in self.effects
        )
        return self if effects == self.effects else replace(self, effects=effects)

    @cached_property
    def weight(self) -> float:
        """Weight of everything that moves [N]."""
        return self.loaded(None).mass * float(np.linalg.norm(self.robot.gravity))

    @property
    def weighing(self) -> tuple[str, ...]:
        """Links that move and weigh, and payloads that weigh, after `parameters.CARRIED`."""
        links = (name for name in self.link_names if name != self.robot.base)
        inertials = {name: self.robot.urdf.links[name].inertial for name in links}
        carried = (CARRIED + name for name, payload in self.payloads.items() if payload.mass)
        return (*(name for name, inertial in inertials.items() if inertial and inertial.mass), *carried)

    def with_masses(self, logarithms: Mapping[str, float]) -> Arm:
        """Return the arm with factors on masses and moments of inertia, by their logarithms; see `masses`."""
        urdf, payloads = self.robot.urdf, dict(self.payloads)
        links, masses = dict(urdf.links), dict(self.masses)
        for name, value in logarithms.items():
            factor, masses[name] = math.exp(value), masses.get(name, 0.0) + value
            if name.startswith(CARRIED):
                body = payloads[name.removeprefix(CARRIED)]
                inertia = None if body.inertia is None else factor * np.asarray(body.inertia)
                payloads[name.removeprefix(CARRIED)] = replace(body, mass=factor * body.mass, inertia=inertia)
            elif (inertial := links[name].inertial) is not None:
                scaled = replace(inertial, mass=factor * inertial.mass, inertia=factor * inertial.inertia)
                links[name] = replace(links[name], inertial=scaled)
        robot = replace(self.robot, urdf=replace(urdf, links=links))
        return replace(self, robot=robot, payloads=payloads, masses=masses)

    @checked_kinds
    def payload(self, payload: str | Payload | None) -> Payload:
        """Return a payload by name; None and "none" mean nothing carried.

        Raises:
            UnknownNameError: No payload of that name.
            ArrayTypeError: It is neither a name nor a payload.
        """
        if isinstance(payload, Payload):
            return payload
        if not isinstance(payload, str | None):
            raise ArrayTypeError(f"payload: expected a name or a Payload, got {payload!r}")
        if payload is None or (payload == "none" and payload not in self.payloads):
            return NO_PAYLOAD
        if payload not in self.payloads:
            raise UnknownNameError("payload", payload, (*self.payloads, "none"))
        return self.payloads[payload]

    def new_payload(self, payload: Payload) -> tuple[Flag, ...]:
        """Return a flag where the arm was calibrated, and under other payloads alone; a weight names a nameless one."""
        seen = self.certainty.payloads if self.certainty is not None else ()
        names = [name for name, body in self.payloads.items() if body is payload]
        names = names or ["none" if not payload.mass else f"of {payload.mass:g} kg"]
        weightless = not payload.mass and any(name in self.payloads and not self.payloads[name].mass for name in seen)
        if not seen or weightless or not set(names).isdisjoint(seen):
            return ()
        text = f"payload {names[0]}: the arm was calibrated under {', '.join(seen)} alone, and sigma does not have in "
        return (Flag("new_payload", f"{text}it how far its laws are off under another load", about=names[0]),)

    @checked_kinds
    def position(self, **joints: float) -> Array:
        """Return q (nq,) [rad or m] with the named joints set and the others at zero.

        Where zero is outside a joint's limits it is in the middle between them, with a warning.
        """
        q = self.robot.home.copy()
        for joint, value in zip(self.robot.moving, q.tolist(), strict=True):
            if value and joint.name not in joints:
                limits = f"[{joint.lower:.6g}, {joint.upper:.6g}]"
                text = f"joint {joint.name!r}: 0 is outside its limits {limits}; it is taken at {value:.6g}"
                warn([Flag("not_at_zero", text)])
        for name, value in joints.items():
            if name not in self.joint_names:
                raise no_such_drive(self.robot, name, self.joint_names)
            q[self.joint_names.index(name)] = value
        return self.checked(q, "q")

    @checked_kinds
    def rigid_pose(self, q: ArrayLike, enforce_limits: bool = True) -> pin.SE3:
        """Return the tip pose of the rigid arm at q (nq,) [rad or m] in the base frame."""
        checked, _ = self.check_position(q, enforce_limits)
        return self.loaded(None).mechanics.rigid_tip_pose(checked)

    @overload
    def deflection(
        self, q: OneRow, payload: str | Payload | None = None, **options: Unpack[DeflectionOptions]
    ) -> Deflection: ...
    @overload
    def deflection(
        self, q: ManyRows, payload: str | Payload | Sequence[str] | None = None, **options: Unpack[DeflectionOptions]
    ) -> DeflectionBatch: ...
    @checked_kinds
    def deflection(
        self,
        q: ArrayLike,
        payload: str | Payload | Sequence[str] | None = None,
        *,
        v: ArrayLike | None = None,
        a: ArrayLike | None = None,
        covariates: Mapping[str, ArrayLike] | None = None,
        wrenches: Sequence[Wrench] = (),
        method: str = "exact",
        enforce_limits: bool = True,
        allow_large: bool = False,
        strict: bool = False,
        jobs: int | None = None,
    ) -> Deflection | DeflectionBatch:
        """Return what the loaded arm does at joint positions q.

        Args:
            q: (nq,) or (N, nq) joint positions in the order of `joint_names` [rad or m].
            payload: Name or object; for a batch also one name per row.
            v: Joint velocities like q, if inertial loads count [rad/s or m/s].
            a: Joint accelerations like q [rad/s^2 or m/s^2].
            covariates: What the arm's effects depend on, by name: a number, or one per row of a batch. A whole record
                will do: names that no effect depends on have no part. What effects remember of rows before is, where it
                is not given, as after this load alone, put on once: play hangs back, what warms up has.
            wrenches: Loads from outside at named links; of a batch each the same in all rows, or one for each.
            method: "exact" or "newton"; see `find_equilibrium`.
            enforce_limits: Refuse positions outside the joint limits instead of flagging them.
            allow_large: Flag rather than refuse flexures turning by more than 0.1 rad.
            strict: Refuse rather than flag loads beyond those that a trained law has seen.
            jobs: Processes that share a batch, -1 for one on each core; see `armflex.parallel`.

        Raises:
            ShapeError, ArrayTypeError, NotFiniteError, JointLimitError: q, v or a cannot be used.
            UnknownNameError: No such payload or link.
            UrdfError: v or a are given, and what moves has moments of inertia that no body has.
            MissingCovariateError: An effect depends on something that was not given.
            ConvergenceError, UnstableEquilibriumError, SmallDisplacementError: See `find_equilibrium`.
            ExtrapolationError: A trained law was asked beyond the loads it has seen, and `strict` holds.
        """
        positions = real_array(q, "q")
        single = positions.ndim != 2
        count, given = 0 if single else len(positions), covariates.items() if covariates else ()
        columns = {name: covariate_array(values, name, count) for name, values in given}
        columns = begun_anew(self, columns, np.zeros(count) if count else np.array(0.0)) if self.effects else columns
        wrenches = tuple([wrench.under(self.robot.gravity) for wrench in wrenches]) if wrenches else ()
        if v is not None or a is not None:
            self.robot.check_motion()
        if not single:
            case = LoadCase(positions, v, a, wrenches, columns)  # pyright: ignore[reportArgumentType] - checked there
            case = self._begun_alone(payload, case)
            batch = deflect_batch(self, payload, case, Asked(method, enforce_limits, allow_large, strict), jobs)
            warn(SOME_NEAR if (batch.found_factors < NEAR).any() else ())
            return batch
        if positions.ndim == 1 and self.within_limits(positions.tolist()):
            checked, flags = positions.copy(), ()
        else:
            checked, flags = self.check_position(positions, enforce_limits)
        loaded = self.loaded(payload)  # pyright: ignore[reportArgumentType] - refused there
        if v is not None or a is not None:
            v, a = v if v is None else self.checked(v, "v"), a if a is None else self.checked(a, "a")
        case = self._begun_alone(payload, LoadCase(checked, v, a, wrenches, columns))
        if case.covariates is not columns:
            flags = (*flags, Flag("no_history", NO_HISTORY))
        deflection = deflect(loaded, case, flags, method, allow_large)
        if deflection.solved.load_factor < NEAR:
            warn(near_buckling(deflection.solved.load_factor))
        if strict:
            deflection.check_seen()
        return deflection

    def _begun_alone(self, payload: str | Payload | Sequence[str] | None, case: LoadCase) -> LoadCase:
        """Return a case with what effects remember where it is not given; one that cannot be used is as it is."""
        if not remembering(self, case.covariates):
            return case
        fine = case.q.shape[-1:] == (len(self.joint_names),) and all(
            np.isfinite(values).all() for values in (case.q, case.v, case.a) if values is not None
        )
        return case._replace(covariates=known_alone(self, payload, case)) if fine else case

    def total_covariance(
        self,
        q: ArrayLike,
        payload: str | Payload | Sequence[str] | None = None,
        *,
        relative: bool = False,
        **options: Unpack[DeflectionOptions],
    ) -> Array | None:
        """Return the (6, 6) covariance of the tip's displacement at (nq,) positions; see `armflex.total_covariance`.

        Args:
            q: (nq,) or (N, nq) joint positions [rad or m]; of a batch it is (N, 6, 6).
            payload, options: As of `deflection`.
            relative: As of `armflex.total_covariance`.

        Raises:
            As `deflection`.
        """
        import armflex  # what a fit knows is asked of those who fit, who stand above an arm

        return armflex.total_covariance(self.deflection(cast(ManyRows, q), payload, **options), relative)

    @checked_kinds
    def prepared(
        self,
        payload: str | Payload | None = None,
        *,
        method: str = "exact",
        enforce_limits: bool = True,
        wrenches: Sequence[Wrench] = (),
    ) -> Prepared:
        """Return a function of q alone for a control loop, for one thread; see `Prepared`.

        Args:
            payload, method, enforce_limits, wrenches: As of `deflection`.

        Raises:
            UnknownNameError, InputError: No such payload, method or link.
        """
        pulled = tuple(wrench.under(self.robot.gravity) for wrench in wrenches)
        return Prepared(self.loaded(payload), method, enforce_limits, pulled)

    @checked_kinds
    def modes(
        self,
        q: OneRow,
        payload: str | Payload | None = None,
        *,
        covariates: Mapping[str, ArrayLike] | None = None,
        wrenches: Sequence[Wrench] = (),
        count: int = 6,
        enforce_limits: bool = True,
    ) -> Modes:
        """Return the slowest modes of vibration about the deflected pose, drives holding; see `mechanics.modes`.

        Args:
            q: (nq,) joint positions in the order of `joint_names` [rad or m].
            payload: Name or object; one without an inertia is a point.
            covariates, wrenches, enforce_limits: As of `deflection`.
            count: How many modes at most.

        Raises:
            InputError: The arm has no flexure, or nothing that moves has a mass; else as `deflection`.
            UrdfError: What moves has moments of inertia that no body has.
        """
        deflection = self.deflection(
            q, payload, covariates=covariates, wrenches=wrenches, enforce_limits=enforce_limits
        )
        return modes_of(deflection.solved, count, self.damping_ratio)

    @checked_kinds
    def check_position(self, q: ArrayLike, enforce_limits: bool = True) -> tuple[Array, tuple[Flag, ...]]:
        """Return q as (nq,) floats [rad or m] with the flags about it.

        Raises:
            ShapeError, ArrayTypeError, NotFiniteError: q is no finite (nq,) of sensible size.
            JointLimitError: q is outside the limits and `enforce_limits` holds.
        """
        array = real_array(q, "q")
        if array.ndim == 1 and self.within_limits(array.tolist()):
            return array.copy(), ()
        checked = self.checked(array, "q")
        outside = (checked < self.robot.lower - SLACK) | (checked > self.robot.upper + SLACK)
        further = np.maximum(self.robot.lower - checked, checked - self.robot.upper)
        beyond = [(self.robot.moving[i], float(checked[i]), float(further[i])) for i in np.flatnonzero(outside)]
        # The furthest, or that of those about which there is more to say.
        joint, value, excess = max(beyond, key=lambda joint: (bool(other_unit(*joint[:2])), joint[2]))
        text = outside_limits(joint, value)
        if enforce_limits:
            raise JointLimitError(text)
        return checked, (Flag("outside_limits", text, size=excess),)

    def within_limits(self, values: Sequence[float]) -> bool:
        """Return whether numbers are positions of all joints, each within its limits and of sensible size."""
        lower, upper = self.bounds
        if len(values) != len(lower):
            return False
        for least, value, most in zip(lower, values, upper):  # noqa: B905, SIM110 - as fast as can be
            if not least <= value <= most:
                return False
        return True

    @cached_property
    def bounds(self) -> tuple[list[float], list[float]]:
        """Least and largest positions of all joints that are within their limits and of sensible size."""
        lower, upper = self.robot.lower - SLACK, self.robot.upper + SLACK
        return np.maximum(lower, -LARGEST_POSITION).tolist(), np.minimum(upper, LARGEST_POSITION).tolist()

    def checked(self, values: ArrayLike, name: str) -> Array:
        """Return an (nq,) copy of a number for each joint [rad or m]; raise as `check_position` does but for limits."""
        array = real_array(values, name)
        expected = (len(self.joint_names),)
        if array.shape != expected:
            order = ", ".join(self.joint_names)
            raise ShapeError(f"{name}: expected shape {expected} in the order {order}, got {array.shape}")
        for joint, value in zip(self.joint_names, array.tolist(), strict=True):
            if not -LARGEST_POSITION <= value <= LARGEST_POSITION:
                raise NotFiniteError(f"{name} of joint {joint!r} is {value:g}, not a usable number")
        return array.copy()  # results are lazy; a caller's buffer must not change them

    @cached_property
    def joint_index(self) -> dict[str, int]:
        """Place of every joint in q."""
        return {name: i for i, name in enumerate(self.joint_names)}

    @checked_kinds
    def loaded(self, payload: str | Payload | None) -> LoadedArm:
        """Return the arm with a payload, whose models are kept; raises what `payload` does."""
        carried = self._carried.get(payload) if payload is None or isinstance(payload, str) else None
        if carried is not None:
            return carried
        body = self.payload(payload)
        key = (body.mass, tuple(body.com), None if body.inertia is None else tuple(body.inertia))
        carried = self._carried.get(key)
        if carried is None:
            # Payloads and names of them whose models are kept; objects made in a loop must not fill the memory
            if len(self._carried) >= 64:
                self._carried.clear()
            carried = self._carried[key] = LoadedArm(self, body)
        if payload is None or isinstance(payload, str):
            self._carried[payload] = carried
        return carried

    @cached_property
    def _carried(self) -> dict[tuple | str | None, LoadedArm]:
        return {}


@dataclass(frozen=True)
class Setup:
    """An arm and the instrument that looks at it: everything a fit may move."""

    arm: Arm
    instrument: Instrument

    def placed(self, pose: pin.SE3) -> Setup:
        """Return the setup with its instrument at another T_instrument_base [m].

        `Robot.gravity` is in base axes. Where gravity is known in the frame of a level instrument it follows that: it
        is turned by what the pose turns, whatever place it was turned to before.
        """
        arm, robot = self.arm, self.arm.robot
        if arm.measurement.gravity_in == "measurement":
            level = self.instrument.pose.rotation @ robot.gravity
            arm = replace(arm, robot=replace(robot, gravity=pose.rotation.T @ level))
        return Setup(arm, replace(self.instrument, pose=pose))

    def falls(self, sessions: Sequence[str]) -> Array | None:
        """Return (N, 3, 3) turns of gravity, as the arm has it, to the base axes of each row; None where it is as that.

        Between campaigns the base was moved: gravity that is known in the frame of a level instrument is then another
        one in the base, as the frame of the row's campaign has it.
        """
        instrument = self.instrument
        if self.arm.measurement.gravity_in != "measurement" or not instrument.campaigns:
            return None
        campaigns, here = [instrument.campaign(name) for name in sessions], instrument.pose.rotation
        if all(name in ("", instrument.campaigns[0]) for name in campaigns):
            return None
        frames = {name: instrument.frame(name).rotation if name else np.eye(3) for name in set(campaigns)}
        turned = {name: here.T @ frame.T @ here for name, frame in frames.items()}
        return np.array([turned[name] for name in campaigns]).reshape(-1, 3, 3)

    def with_effect(self, effect: Effect) -> Setup:
        """Return the setup with one more effect in it, and with what the effect changes of the model."""
        arm = self.arm
        model = effect.law.change(
            effect, ChangeableModel(arm.robot, arm.corrections, arm.payloads, arm.springs, self.instrument)
        )
        parts = {name: getattr(model, name) for name in ("robot", "corrections", "payloads", "springs")}
        return Setup(replace(arm, effects=(*arm.effects, effect), **parts), model.instrument)


def no_such_drive(robot: Robot, name: str, names: Iterable[str]) -> InputError:
    """Return the error about a joint that is none of the `names`: it has no drive, or the arm has no such joint."""
    return InputError(text) if (text := without_drive(robot, name)) else UnknownNameError("joint", name, names)


def without_drive(robot: Robot, name: str, prefix: str = "") -> str:
    """Return what is said where a joint without a drive is given, '' of any other; its drives are called `prefix`."""
    if name not in robot.linkage.free:
        return ""
    cylinders = [cylinder.name for cylinder in robot.linkage.cylinders]
    drives = listing(f"{prefix}{drive}" for drive in cylinders or robot.joint_names)
    drives += " (the length of the cylinder between its pins [m])" if cylinders else ""
    text = f"joint {name!r} has no drive, and its position follows from those that have one"
    return f"{text}: leave it out and give {drives}"


def outside_limits(joint: Joint, value: float) -> str:
    """Return what is said of a joint beyond its limits, in SI and in the unit that tables and drives have it in."""
    slides = joint.kind == "prismatic"
    here, there, factor = ("m", "mm", 1e-3) if slides else ("rad", "deg", TURN / 360)
    numbers = value, joint.lower, joint.upper
    (at, low, high), also = ([f"{number / size:.6g}" for number in numbers] for size in (1.0, factor))
    text = f"joint {joint.name!r} at {at} is outside its limits [{low}, {high}] {here}"
    return f"{text} ({also[0]} outside [{also[1]}, {also[2]}] {there}){other_unit(joint, value)}"


def other_unit(joint: Joint, value: float) -> str:
    """Return the question whether a position beyond a joint's limits is in degrees or mm, '' where it hardly is."""
    slides = joint.kind == "prismatic"
    far, factor, unit = (
        (10.0 * max(joint.upper - joint.lower, 1.0), 1e-3, "mm") if slides else (TURN, TURN / 360, "deg")
    )
    meant = abs(value) > far and joint.lower <= factor * value <= joint.upper
    return f": {unit}? Then say so, {value:.6g}{unit} or a column q_{joint.name}_{unit}" if meant else ""


warnings.filterwarnings("once", category=ArmflexWarning, append=True)


def warn(flags: Sequence[Flag]) -> None:
    """Raise each flag as a Python warning, once in a process, for those who do not look at `flags`.

    What other filters say of it goes before. It points at the line outside this package that asked, however deep the
    question was answered.
    """
    level, frame = 1, sys._getframe()
    while flags and frame and frame.f_globals.get("__name__", "").partition(".")[0] == __package__:
        level, frame = level + 1, frame.f_back
    for flag in flags:
        warnings.warn(str(flag), ArmflexWarning, stacklevel=level)
