"""A support that lifts off its stop: nothing up to an angle of a drive or a load, from there on a line.

    twist = slope max(0, x - start) + flexure x

of an axis of a joint's link. x is the position of the drive that tilts the link, or a force there along another axis: a
mirror is lifted off its hard points where an air support takes more of its weight than it has. `flexure` is what bends
beside it in proportion to the force, of either sign: a tube whose counterweight or optics wins rises with its weight.
The partner says what x is, and from which side: `q` or `-q` of the drive, `fx` to `fz` or `-fx` to `-fz`.
"""

from collections.abc import Iterable

import numpy as np

from armflex.conventions import WRENCH_NAMES, Array
from armflex.laws.effects.context import AXES, AXES_TURN, Context, Records
from armflex.laws.effects.effect import (
    Amplitude,
    DependsOn,
    Effect,
    Inner,
    Manipulator,
    Plausible,
    TwistLaw,
    Values,
    Words,
)
from armflex.laws.effects.location import Here, Location, drive_axis, path_to
from armflex.laws.effects.shapes import on_axis, own_column
from armflex.laws.terms import Curve, Factor, Of, Term, part, powers, straight
from armflex.robot import Robot
from armflex.robot.urdf import MOVING, Joint

SHARES = (0.25, 0.5, 0.75)
"""Of the range that was measured: where a search for the start begins."""

UPRIGHT = 0.999
"""Tolerance: cosine of an axis to gravity from which on it stands upright: 2.6 degrees."""

LEAST = 0.05
"""Tolerance: share of the rows that must be on either side of the start: else it is a line, or nothing."""


def _places(records: Records) -> list[Location]:
    """Return drives whose angle is a tilt, of telescopes all that turn, and forces across the axes of their links.

    A telescope is balanced: its weight is a force without a moment. Another arm's stop feels the moment, which follows
    from the force and the position and which `stiffening` is over: there the stop is at an angle.
    """
    locations = []
    for joint in records.robot.moving:
        if records.axes(joint.name) != AXES:
            continue
        drive = drive_axis(joint)
        if joint.kind != "prismatic" and (records.stars or _tilts(joint, records.robot)):
            locations += [Location(joint.name, drive, (f"q_{joint.name}",), (0,), side) for side in ("q", "-q")]
        for axis in AXES_TURN if records.stars else ():
            for force in (name for name in WRENCH_NAMES[:3] if name[1] != axis[1]):
                locations += [Location(joint.name, axis, (), (1,), force)]
                locations += [
                    Location(joint.name, axis, (), terms, side + force)
                    for side in ("", "-")
                    for terms in ((0,), (0, 1))
                ]
    return locations


def _tilts(joint: Joint, robot: Robot) -> bool:
    """Return whether the angle of a drive alone says how far what it carries is tilted: a support feels its weight.

    It turns about an axis that does not stand upright, and whatever turns between it and the base stands upright.
    """
    turn, tilting = np.eye(3), list[bool]()
    for inboard in path_to(joint, robot):
        turn = turn @ inboard.rotation
        along = abs(float(turn @ inboard.axis @ robot.gravity))
        tilting.append(
            inboard.kind in MOVING
            and inboard.kind != "prismatic"
            and along < UPRIGHT * float(np.linalg.norm(robot.gravity))
        )
    return tilting[-1] and not any(tilting[:-1])


def _way(partner: str) -> tuple[float, Array]:
    """Return the sign of x, and the (6,) part of the load that it is; zeros of an angle."""
    name = partner.removeprefix("-")
    unit = np.eye(6)[WRENCH_NAMES.index(name)] if name in WRENCH_NAMES else np.zeros(6)
    return (-1.0 if partner.startswith("-") else 1.0), unit


def _x(location: Location, context: Context) -> Array:
    """Return (N,) x in the rows of a campaign."""
    sign, way = _way(location.partner)
    return sign * (
        context.column(location.covariates[0]) if location.covariates else context.wrenches[location.site] @ way
    )


def _starts(location: Location, context: Context) -> Iterable[float]:
    x = _x(location, context)
    return x.min() + np.ptp(x) * np.array(SHARES if 0 in location.terms else SHARES[:1])


def _is_met(effect: Effect, context: Context, arm: Manipulator) -> bool:
    """Return whether rows are on either side of the start."""
    beyond = float((_x(effect.location, context) > effect.inner[0]).mean())
    return 0 not in effect.location.terms or LEAST <= beyond <= 1.0 - LEAST


def _terms(here: Here, inner: Values) -> list[list[Term]]:
    (sign, way), axis, start = _way(here.location.partner), here.direction, inner[0]
    bends = [straight(np.outer(axis, sign * way))]
    if here.location.covariates:
        column = own_column(here)
        rising = Term(axis, factors=(*powers(column, 1, start), Factor(Of.STEP, column, (start,))))
        falling = [Term(-axis, factors=powers(column, 1, -start)),
                   Term(axis, factors=(*powers(column, 1, -start), Factor(Of.STEP, column, (-start,))))]  # fmt: skip
        return [[rising] if sign > 0.0 else falling, bends]
    return [[Term(axis, features=(part(sign * way, Curve.RAMP, -start),))], bends]


SUPPORT_LIFT = TwistLaw(
    name="support_lift",
    words=Words(
        "support lifts off",
        "a support leaves its stop beyond an angle or a load, and what it carries tilts from there on",
        "slope · max(0, x − start) + flexure · x",
    ),
    instead="put a dial gauge between the part and its stop, and move the drive through its range",
    plausible=Plausible(0.001, 0.003, "what is lifted off its stop moves by tenths of a millimetre"),
    places=_places,
    amplitudes=(Amplitude("slope", "rad/{over}"), Amplitude("flexure", "rad/{over}")),
    terms=_terms,
    direction=on_axis,
    inner=(Inner("start", "{over}", _starts, positive=False),),
    possible=_is_met,
    depends_on=DependsOn.LOAD,
)
