"""What of an arm can be uncertain: parameters that are distinct as objects, not by what they are called.

A label such as 'compliance A4 ry' is made where a file or a report is written. Where a file is read it is looked up
among those of the arm, see `named`; no label is taken apart. A `Certainty` says how well the fitted ones are known.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cached_property

import numpy as np

from armflex.conventions import TWIST_NAMES, Array
from armflex.errors import FEW, Flag, InputError, UnknownNameError
from armflex.laws import Law
from armflex.laws.declared import Flexure
from armflex.laws.effects.effect import Act, Effect
from armflex.linear_gaussian import depend_on
from armflex.mechanics.spring import Spring
from armflex.readings.sensor import Sensor
from armflex.robot import Robot


class ParameterKind(StrEnum):
    """What parameters are of, by what their labels begin with."""

    INSTRUMENT = "instrument"
    SESSION = "session_frame"
    MOUNTING = "mounting"
    TOOL = "tool"
    TARGET = "session_target"
    SENSOR = "sensor"
    OFFSET = "joint_offset"
    GEOMETRY = "geometry"
    MASS = "mass"
    SPRING = "spring"
    COMPLIANCE = "compliance"
    LAW = "law"
    EFFECT = "effect"
    UNEXPLAINED = "unexplained"


OF_SESSION = (ParameterKind.SESSION, ParameterKind.TARGET)
"""Those of one session alone."""

FRAMES = (ParameterKind.INSTRUMENT, *OF_SESSION, ParameterKind.MOUNTING, ParameterKind.SENSOR)
"""Those of one campaign alone: frames, and how targets were mounted, that nothing says will be the same in the next."""

SEEN = (*FRAMES, ParameterKind.TOOL)
"""Those that change what is read, not where the tip is."""


@dataclass(frozen=True)
class ParameterGroup:
    """What changes as a whole: a frame, a joint's zero, a flexure's law, an effect.

    Attributes:
        kind: What it is.
        of: Session, joint, flexure, or an effect's name and number; None where there is only one.
        moves: Whether it moves the tip, rather than what is read of it.
    """

    kind: ParameterKind
    of: str | None = None
    moves: bool = field(default=True, compare=False)

    @property
    def name(self) -> str:
        """As a report has it: 'compliance A4', 'effect gear_harmonic A2 rz #2', 'tool'."""
        return str(self.kind) if self.of is None else f"{self.kind} {self.of}"

    @property
    def block(self) -> str:
        """Name of what a report has in one: all of a kind, but every effect by itself."""
        return self.name if self.kind in (ParameterKind.EFFECT, ParameterKind.UNEXPLAINED) else str(self.kind)


@dataclass(frozen=True)
class ArmParameter:
    """One number of an arm, or of the instrument that looks at it, that a fit may move.

    Attributes:
        group: What it is of.
        name: Which number of it: an axis, a law's or an effect's parameter; None where there is only one.
        unit: Of what a fit moves: '1' of a logarithm.
    """

    group: ParameterGroup
    name: str | None = None
    unit: str = field(default="1", compare=False)

    @cached_property
    def label(self) -> str:
        """What files and reports call it: 'compliance A4 ry'."""
        return self.group.name if self.name is None else f"{self.group.name} {self.name}"

    @property
    def rest(self) -> str:
        """Its label without the block's name: 'A4 ry'."""
        return self.label.removeprefix(f"{self.group.block} ")


def of_motions(
    kind: ParameterKind, names: Iterable[str | None] = (None,), axes: Sequence[str] = TWIST_NAMES
) -> tuple[ArmParameter, ...]:
    """Return the axes of a small motion [m, rad] of every thing of a kind."""
    groups = (ParameterGroup(kind, name, kind not in SEEN) for name in names)
    return tuple(ArmParameter(group, axis, "m" if axis[0] == "d" else "rad") for group in groups for axis in axes)


FRAME = of_motions(ParameterKind.INSTRUMENT)
"""Shift and rotation vector of the instrument's frame."""

TARGET = of_motions(ParameterKind.TOOL, axes=TWIST_NAMES[:3])
"""The measured point in the tip frame."""

MOUNTED = of_motions(ParameterKind.MOUNTING, axes=TWIST_NAMES[3:])
"""How the target is turned on the tool."""


def of_targets(sessions: Iterable[str], size: int = 6) -> tuple[ArmParameter, ...]:
    """Return the shift [m] of a target that was mounted anew in every session, of six numbers its turn [rad] too."""
    return of_motions(ParameterKind.TARGET, (name or None for name in sessions), TWIST_NAMES[:size])


def of_sensor(sensor: Sensor, sessions: Iterable[str]) -> tuple[ArmParameter, ...]:
    """Return what a campaign has to find of a sensor, in every session anew; '' is one that holds for all."""
    return tuple(
        ArmParameter(
            ParameterGroup(ParameterKind.SENSOR, f"{sensor.name} {session}".strip(), moves=False), *sensor.labels[i]
        )
        for session in sessions
        for i in sensor.free_in(session).tolist()
    )


def of_offsets(robot: Robot) -> tuple[ArmParameter, ...]:
    """Return the constant error of every joint's position."""
    joints = ((joint.name, "m" if joint.kind == "prismatic" else "rad") for joint in robot.moving)
    return tuple(ArmParameter(ParameterGroup(ParameterKind.OFFSET, name), unit=unit) for name, unit in joints)


CARRIED = "payload "
"""Before the name of a payload whose mass is meant, else it is a link's."""


def of_masses(names: Iterable[str]) -> tuple[ArmParameter, ...]:
    """Return the logarithmic factors on the masses of links, and of payloads that are named after `CARRIED`."""
    return tuple(ArmParameter(ParameterGroup(ParameterKind.MASS, name)) for name in names)


def of_springs(springs: Iterable[Spring]) -> tuple[ArmParameter, ...]:
    """Return what calibration may find of springs; see `mechanics.spring`."""
    pairs = [
        (ParameterGroup(ParameterKind.SPRING, spring.name), parameter)
        for spring in springs
        for parameter in spring.law.parameters
    ]
    return tuple(ArmParameter(group, *parameter) for group, parameter in pairs)


def of_compliance(flexure: str) -> tuple[ArmParameter, ...]:
    """Return the logarithmic factors on the axes of a flexure's compliance."""
    return tuple(ArmParameter(ParameterGroup(ParameterKind.COMPLIANCE, flexure), axis) for axis in TWIST_NAMES)


def of_law(flexure: str, law: Law, kind: ParameterKind = ParameterKind.LAW) -> tuple[ArmParameter, ...]:
    """Return the parameters of a flexure's law that was learned, or is scaled (`ParameterKind.COMPLIANCE`)."""
    return tuple(ArmParameter(ParameterGroup(kind, flexure), parameter.name) for parameter in law.parameters)


def fitted_group(flexure: Flexure) -> ParameterGroup:
    """Return what a fit of a flexure's law finds anything of."""
    return ParameterGroup(ParameterKind.LAW if flexure.learned else ParameterKind.COMPLIANCE, flexure.name)


def of_effect(effect: Effect, number: int) -> tuple[ArmParameter, ...]:
    """Return the parameters of an effect: acting amplitudes, then all inner ones, positive ones as logarithms.

    `number` is which of its name it is in an arm, see `numbers_of`.
    """
    moves = effect.law.act not in (Act.FRAME, Act.SCALE, Act.SIGHT)
    group, law = ParameterGroup(ParameterKind.EFFECT, f"{effect.name}{numbered(number)}", moves), effect.law
    units = dict(zip(effect.named, effect.units, strict=True))
    amplitudes = tuple(
        ArmParameter(group, amplitude.name, units[amplitude.name])
        for amplitude in (law.amplitudes[i] for i in effect.location.terms)
    )
    return amplitudes + tuple(
        ArmParameter(group, inner.name, "1" if inner.positive else units.get(inner.name, inner.unit))
        for inner in law.inner
    )


def numbers_of(effects: Sequence[Effect]) -> tuple[int, ...]:
    """Return for each of an arm's effects which of its name (law, site and axis) it is, in their order, from 1 on.

    A joint may have several harmonics, and a name has nothing else to distinguish them.
    """
    names = [effect.name for effect in effects]
    return tuple(names[: i + 1].count(name) for i, name in enumerate(names))


def numbered(number: int) -> str:
    """Return how a number ends an effect's name: ' #2', and nothing for the first."""
    return f" #{number}" if number > 1 else ""


def named(labels: Iterable[str], labelled: Sequence[tuple[ArmParameter, str]]) -> tuple[ArmParameter, ...]:
    """Return the parameters that labels name; one that is not known stays what it is called, of no arm's part.

    Args:
        labels: As files have them.
        labelled: Parameters with what they may be called. Where several have one name the label means one of the group
            that was named last, else the first that was not named yet.
    """
    called: dict[str, list[ArmParameter]] = {}
    for parameter, label in labelled:
        called.setdefault(label, []).append(parameter)
    parameters: list[ArmParameter] = []
    for label in labels:
        candidates = called.get(label, [])
        if len(candidates) > 1:
            last = parameters[-1].group if parameters else None
            candidates = [parameter for parameter in candidates if parameter.group == last] or [
                parameter for parameter in candidates if parameter not in parameters
            ]
        if not candidates:
            kind = next((kind for kind in ParameterKind if label.startswith(f"{kind} ")), None)
            if kind is None:
                raise UnknownNameError("parameter", label, called)
            candidates = [ArmParameter(ParameterGroup(kind, label.removeprefix(f"{kind} ")))]
        parameters.append(candidates[0])
    return tuple(parameters)


ABSURD = 10.0
"""Confidence: prior standard deviations beyond which a value is none that was thought of when the prior was written."""

MISSING = 1.5
"""Confidence: scatter over the stated noise from which an effect is reported missing."""

DOUBT = 0.05
"""Confidence: probability from which it is in question whether something is so; of two, with odds of 20 it is not."""


def beyond_priors(pulls: Mapping[str, float]) -> Iterator[Flag]:
    """Yield a flag where values are more than `ABSURD` prior standard deviations from what was declared.

    Args:
        pulls: Size of each value in prior standard deviations, by label.
    """
    far = sorted((label for label, pull in pulls.items() if pull > ABSURD), key=lambda label: -pulls[label])
    if far:
        worst = ", ".join(f"{label} by {pulls[label]:.0f} prior standard deviations" for label in far[:FEW])
        text = f"{len(far)} value{'s are' if len(far) > 1 else ' is'} absurdly far from what was declared ({worst})"
        text += ": units, conventions and priors are more likely wrong than the arm is"
        yield Flag("beyond_priors", text, far[0], pulls[far[0]])


@dataclass(frozen=True, eq=False)
class Certainty:
    """Covariance of everything that a fit moved, effects included.

    Attributes:
        parameters: What was moved, in the fit's order.
        covariance: (P, P) posterior covariance in their units, of what is determined; inner parameters of effects by
            the logarithm.
        unexplained: Site, axis and standard deviation [m or rad] of every random twist that nobody can predict.
        directions: (k, P) directions, in the parameters' units, that neither the campaign nor a prior determined, None
            where there are none.
        misfit: Standard deviation of each coordinate [m] by which readings scattered beyond what they stated, or poses
            held out from a trace beyond what its fit states (`held_out.excess`): what the arm lacks, or what was
            selected wrongly, moves the tip so much.
        design_effect: How many readings informed on the parameters as much as one that is independent of the others
            would; the covariance has it in it. See `held_out.design_effect`.
        payloads: Names of those under which it was read, empty where nobody says.

    Raises:
        InputError: Two parameters have the same label.
    """

    parameters: tuple[ArmParameter, ...]
    covariance: Array
    unexplained: tuple[tuple[str, str, float], ...] = ()
    directions: Array | None = None
    misfit: float = 0.0
    design_effect: float = 1.0
    payloads: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if len(set(self.labels)) < len(self.labels):  # a file could not distinguish them
            twice = next(label for label in self.labels if self.labels.count(label) > 1)
            raise InputError(f"two parameters are both named {twice!r}: rename a flexure or a node of its assembly")

    @cached_property
    def labels(self) -> tuple[str, ...]:
        """What files and reports call each parameter."""
        return tuple(parameter.label for parameter in self.parameters)

    @cached_property
    def groups(self) -> frozenset[ParameterGroup]:
        """What anything is known of."""
        return frozenset(parameter.group for parameter in self.parameters)

    @cached_property
    def undetermined(self) -> tuple[str, ...]:
        """Labels of the parameters that have a part in an undetermined direction: their variance is infinite."""
        if self.directions is None:
            return ()
        return tuple(self.labels[i] for i in np.flatnonzero(self.directions.any(axis=0)))

    def leaves_open(self, jacobian: Array) -> Array:
        """Return (N, d) which of (N, d, P) changes per unit of a parameter depend on an undetermined direction."""
        if self.directions is None:
            return np.zeros(jacobian.shape[:-1], dtype=bool)
        return depend_on(jacobian, self.directions)

    def among(self, parameters: Sequence[ArmParameter]) -> Array | None:
        """Return the (k, k) covariance of k parameters in their units, None where it is not known of each."""
        places = {parameter: i for i, parameter in enumerate(self.parameters)}
        rows = [places.get(parameter, -1) for parameter in parameters]
        return None if -1 in rows else self.covariance[np.ix_(rows, rows)]

    def part(self, places: Sequence[int]) -> Certainty:
        """Return what is known of the parameters at some places, in this order."""
        parameters = tuple(self.parameters[i] for i in places)
        directions = None if self.directions is None else self.directions[:, places]
        if directions is not None:
            directions = directions[directions.any(axis=1)]
            directions = directions if len(directions) else None
        covariance = self.covariance[np.ix_(places, places)]
        return replace(self, parameters=parameters, covariance=covariance, directions=directions)

    def beside(self, other: Certainty) -> Certainty:
        """Return what is known of the parameters of both, as independent; what has no cause is as the other has it."""
        count, more = len(self.parameters), len(other.parameters)
        covariance = np.zeros((count + more,) * 2)
        covariance[:count, :count], covariance[count:, count:] = self.covariance, other.covariance
        padded = [
            np.pad(part.directions, ((0, 0), around))
            for part, around in ((self, (0, more)), (other, (count, 0)))
            if part.directions is not None
        ]
        directions = np.vstack(padded) if padded else None
        unexplained = other.unexplained or self.unexplained
        parameters = (*self.parameters, *other.parameters)
        payloads = tuple(dict.fromkeys((*self.payloads, *other.payloads)))
        return Certainty(parameters, covariance, unexplained, directions, other.misfit, other.design_effect, payloads)
