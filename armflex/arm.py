"""An arm: a robot, the laws of its flexures, and the payloads it knows; the question is `arm.deflection(q)`."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from armflex.arm_doubts import payload_doubts, sag_doubts, wrench_doubts
from armflex.certainty import Certainty
from armflex.conventions import LARGEST_POSITION, Array, covariate_array, real_array
from armflex.deflection import Deflection, DeflectionBatch, Names, stack_rows
from armflex.effects.in_arm import Pulling, pulling, with_twists
from armflex.effects.law import Effect
from armflex.equilibrium import LawStack, find_equilibrium
from armflex.errors import (
    ArmflexWarning,
    ArrayTypeError,
    ExtrapolationError,
    Flag,
    InputError,
    JointLimitError,
    NotFiniteError,
    ShapeError,
    UnknownNameError,
)
from armflex.flexure import Flexure as Flexure
from armflex.instrument import Instrument
from armflex.laws import Row
from armflex.loads import NO_PAYLOAD, Payload, Wrench
from armflex.mechanics import LoadCase, Mechanics
from armflex.prior import Measurement, Prior
from armflex.robot import Corrections, Robot, build_model

MAX_PAYLOADS = 64
"""Payloads whose models are kept; objects made in a loop must not fill the memory."""


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
        instrument: Where the instrument stands that measured this arm, None when it was not calibrated.
        effects: What it does beyond its flexures, as measurements showed.
        certainty: How well everything that was fitted is known, None where nothing was, or where nobody says.
        flags: Doubts about the arm as declared.
    """

    robot: Robot
    flexures: tuple[Flexure, ...] = ()
    payloads: Mapping[str, Payload] = field(default_factory=dict)
    payload_rating: float | None = None
    measurement: Measurement = field(default_factory=Measurement)
    prior: Prior = field(default_factory=Prior)
    corrections: Corrections = field(default_factory=Corrections)
    instrument: Instrument | None = None
    effects: tuple[Effect, ...] = ()
    certainty: Certainty | None = None
    flags: tuple[Flag, ...] = ()

    def __post_init__(self) -> None:
        known = [joint.name for joint in self.robot.chain]
        for flexure in self.flexures:
            if flexure.joint is not None and flexure.joint not in known:
                raise UnknownNameError("joint between base and tip", flexure.joint, known)
            if sum(other.name == flexure.name for other in self.flexures) > 1:
                raise InputError(f"two flexures are named {flexure.name!r}")

    def __getstate__(self) -> dict[str, object]:
        """Return what is declared; models are made again where the arm is sent."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def __repr__(self) -> str:
        """One line: an arm is too much to print."""
        joints, places = len(self.joint_names), len(self.flexures)
        ends = f"{self.robot.base} to {self.robot.tip}"
        return f"<Arm {self.robot.urdf.name!r}: {joints} joints, {places} flexures, {ends}>"

    def drive_shares(self, found: Deflection) -> Array:
        """Return the (nq,) load on every drive as a share of its effort limit, 0 where none is given."""
        shares = []
        for joint, load in zip(self.robot.moving, found.joint_loads, strict=True):
            part = load[:3] if joint.kind == "prismatic" else load[3:]
            shares.append(abs(float(joint.axis @ part)) / joint.effort)
        return np.array(shares)

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
        return tuple(self._mechanics_of(NO_PAYLOAD).flex.links)

    @cached_property
    def modelled(self) -> tuple[Flexure, ...]:
        """The flexures with what effects add to their laws, and those that only effects make."""
        return with_twists(self.flexures, self.effects, self.robot)

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

    @cached_property
    def weight(self) -> float:
        """Weight of everything that moves [N]."""
        model = self._mechanics_of(NO_PAYLOAD).rigid.model
        return float(pin.computeTotalMass(model) * np.linalg.norm(self.robot.gravity))

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

    def position(self, **joints: float) -> Array:
        """Return q (nq,) with the named joints set and the others at zero."""
        q = np.zeros(len(self.joint_names))
        for name, value in joints.items():
            if name not in self.joint_names:
                raise UnknownNameError("joint", name, self.joint_names)
            q[self.joint_names.index(name)] = value
        return self._checked(q, "q")

    def rigid_pose(self, q: ArrayLike, enforce_limits: bool = True) -> pin.SE3:
        """Return the tip pose of the rigid arm at q (nq,) in the base frame."""
        checked, _ = self.check_position(q, enforce_limits)
        return self._mechanics_of(NO_PAYLOAD).rigid_tip_pose(checked)

    def deflection(
        self,
        q: ArrayLike,
        payload: str | Payload | Sequence[str] | None = None,
        *,
        v: ArrayLike | None = None,
        a: ArrayLike | None = None,
        covariates: Mapping[str, ArrayLike] | None = None,
        wrenches: Sequence[Wrench] = (),
        method: str = "newton",
        enforce_limits: bool = True,
        allow_large: bool = False,
        strict: bool = False,
    ) -> Deflection | DeflectionBatch:
        """Return what the loaded arm does at joint positions q.

        Args:
            q: (nq,) or (N, nq) joint positions in the order of `joint_names` [rad or m].
            payload: Name or object; for a batch also one name per row.
            v: Joint velocities like q, if inertial loads count [rad/s or m/s].
            a: Joint accelerations like q [rad/s^2 or m/s^2].
            covariates: What the arm's effects depend on, by name: a number, or one per row of a batch.
            wrenches: Loads from outside at named links.
            method: "newton", "fixed_point" or "first_order"; see `find_equilibrium`.
            enforce_limits: Refuse positions outside the joint limits instead of flagging them.
            allow_large: Flag rather than refuse flexures turning by more than 0.1 rad.
            strict: Refuse rather than flag loads beyond those that a trained law has seen.

        Raises:
            ShapeError, ArrayTypeError, NotFiniteError, JointLimitError: q, v or a cannot be used.
            UnknownNameError: No such payload or link.
            MissingCovariateError: An effect depends on something that was not given.
            ConvergenceError, UnstableEquilibriumError, SmallDisplacementError: See `find_equilibrium`.
            ExtrapolationError: A trained law was asked beyond the loads it has seen, and `strict` holds.
        """
        options = {"method": method, "enforce_limits": enforce_limits, "allow_large": allow_large, "strict": strict}
        positions = real_array(q, "q").copy()
        count = len(positions) if positions.ndim == 2 else 0
        known = {name: covariate_array(values, name, count) for name, values in (covariates or {}).items()}
        if positions.ndim == 2:
            return self._batch(positions, payload, v, a, known, tuple(wrenches), options)
        motion = [None if values is None else self._checked(values, name) for values, name in ((v, "v"), (a, "a"))]
        return self._single(positions, payload, motion, known, tuple(wrenches), options)

    def _batch(
        self, q: Array, payload: object, v: object, a: object, known: dict[str, Array], wrenches: tuple, options: dict
    ) -> DeflectionBatch:
        count = len(q)
        payloads = [payload] * count if payload is None or isinstance(payload, (str, Payload)) else list(payload)
        if len(payloads) != count:
            raise ShapeError(f"payload: expected one name or {count}, got {len(payloads)}")
        motions = [[None] * count if x is None else self._rows(x, name, count) for x, name in ((v, "v"), (a, "a"))]
        rows = (
            self._single(
                q[i],
                payloads[i],
                [motions[0][i], motions[1][i]],
                {name: values[i] if values.ndim else values for name, values in known.items()},
                wrenches,
                options,
            )
            for i in range(count)
        )
        return stack_rows(q, rows, self.names)

    def _single(
        self, q: Array, payload: object, motion: list, known: dict[str, Array], wrenches: tuple, options: dict
    ) -> Deflection:
        checked, flags = self.check_position(q, options["enforce_limits"])
        body = self.payload(payload)
        flags = (*self.flags, *flags, *payload_doubts(self, body, motion[1] is not None))
        flags = (*flags, *wrench_doubts(self, wrenches))
        mechanics = self._mechanics_of(body)
        case = LoadCase(checked, motion[0], motion[1], (*wrenches, *self.pulls))
        row = Row(checked, self._joint_index, {"payload_mass": np.asarray(body.mass), **known})
        found = find_equilibrium(
            mechanics, self.stack, case, row, options["method"], allow_large=options["allow_large"]
        )
        pose, rigid = mechanics.tip_pose(found.configuration), mechanics.rigid_tip_pose(checked)
        displacement = displacement_between(rigid, pose)
        displacement.flags.writeable = False
        unseen = self.stack.doubts(found.wrenches, row)
        if options["strict"] and unseen:
            raise ExtrapolationError("; ".join(flag.text for flag in unseen))
        flags = (*flags, *sag_doubts(self, displacement), *unseen)
        return Deflection(
            checked, pose, rigid, displacement, self.names, body, flags, mechanics, self.stack, case, row, found
        )

    def check_position(self, q: ArrayLike, enforce_limits: bool = True) -> tuple[Array, tuple[Flag, ...]]:
        """Return q as (nq,) floats with the doubts about it.

        Raises:
            ShapeError, ArrayTypeError, NotFiniteError: q is no finite (nq,) of sensible size.
            JointLimitError: q is outside the limits and `enforce_limits` holds.
        """
        checked = self._checked(q, "q")
        outside = (checked < self.robot.lower - 1e-9) | (checked > self.robot.upper + 1e-9)
        if not outside.any():
            return checked, ()
        joint = self.robot.moving[int(outside.argmax())]
        value = checked[int(outside.argmax())]
        text = f"joint {joint.name!r} at {value:.6g} is outside its limits [{joint.lower:.6g}, {joint.upper:.6g}]"
        if enforce_limits:
            raise JointLimitError(text)
        return checked, (Flag("outside_limits", text),)

    def _checked(self, values: ArrayLike, name: str) -> Array:
        array = real_array(values, name)
        expected = (len(self.joint_names),)
        if array.shape != expected:
            order = ", ".join(self.joint_names)
            raise ShapeError(f"{name}: expected shape {expected} in the order {order}, got {array.shape}")
        bad = ~(np.abs(array) <= LARGEST_POSITION)
        if bad.any():
            joint = self.joint_names[int(bad.argmax())]
            raise NotFiniteError(f"{name} of joint {joint!r} is {array[int(bad.argmax())]:g}, not a usable number")
        return array.copy()  # results are lazy; a caller's buffer must not change them

    def _rows(self, values: object, name: str, count: int) -> list[Array]:
        array = real_array(values, name)
        if array.ndim != 2 or len(array) != count:
            raise ShapeError(f"{name}: expected shape ({count}, {len(self.joint_names)}), got {array.shape}")
        return [self._checked(row, name) for row in array]

    @cached_property
    def _joint_index(self) -> dict[str, int]:
        return {name: i for i, name in enumerate(self.joint_names)}

    @cached_property
    def _mechanics(self) -> dict[tuple, Mechanics]:
        return {}

    def _mechanics_of(self, payload: Payload) -> Mechanics:
        key = (payload.mass, tuple(payload.com), None if payload.inertia is None else tuple(payload.inertia))
        known = self._mechanics.get(key)
        if known is None:
            sites = [flexure.site for flexure in self.modelled]
            body = payload.body if payload.mass else None
            flex = build_model(self.robot, sites, body, self.corrections)
            known = Mechanics(build_model(self.robot, (), body), flex)
            if len(self._mechanics) >= MAX_PAYLOADS:
                self._mechanics.clear()
            self._mechanics[key] = known
        return known


def displacement_between(rigid: pin.SE3, flexed: pin.SE3) -> Array:
    """Return (6,) shift of the origin [m] and rotation vector of R_flexed R_rigid^T [rad], base axes."""
    return np.concatenate([flexed.translation - rigid.translation, pin.log3(flexed.rotation @ rigid.rotation.T)])


def warn(flags: Sequence[Flag]) -> None:
    """Raise each doubt as a Python warning, once, for those who do not look at `flags`."""
    for flag in flags:
        warnings.warn(str(flag), ArmflexWarning, stacklevel=3)
