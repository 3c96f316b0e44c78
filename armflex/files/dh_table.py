"""[robot] dh: a robot by its Denavit-Hartenberg parameters instead of a URDF.

A row's transform is, in the standard (distal) and the modified (proximal, Craig) form,

    Rz(theta) Tz(d) Tx(a) Rx(alpha) Ry(beta)        Tx(a) Rx(alpha) Ry(beta) Rz(theta) Tz(d)

with the joint's position added to theta, or to d where it slides; beta is Hayati's and mostly absent. These are the
rows that `armflex export --to sheet` writes.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pinocchio as pin

from armflex.conventions import RESOLUTION
from armflex.declaration import Declaration
from armflex.errors import ArmFileError, Flag, Place, listing
from armflex.parameters import ParameterKind, of_motions
from armflex.robot.robot import Robot
from armflex.robot.urdf import FARTHEST, RESERVED, Inertial, Joint, Link, Urdf

FORMS = ("standard", "modified")
FLANGE = "flange"
"""The frame of the last row, and the tip where none is named."""


def read_dh(table: Declaration) -> Urdf:
    """Return the robot of the rows [robot.joint], base to tip; links are base, link1, link2 ... and flange.

    The frame of a link is where its joint is: the joint moves along its z. Links weigh where they are given a mass.

    Raises:
        ArmFileError: A row has no such parameter, or a number that is none of its kind.
    """
    form = table.choice("dh", FORMS)
    rows = table.subs("joint")
    if not rows:
        raise ArmFileError(table.place("dh"), "[robot] dh needs a table [robot.joint] with a row for every joint")
    place, z = Place(table.path, table.place("joint").line), np.array([0.0, 0.0, 1.0])
    links, joints, before = {"base": Link("base", None, (), place)}, {}, pin.SE3.Identity()
    bodies = [_body(row) for row in rows.values()]
    for number, (name, row) in enumerate(rows.items(), 1):
        if name == FLANGE or RESERVED.fullmatch(name):
            text = "is the joint of the last frame" if name == FLANGE else "is taken by the mechanics"
            raise ArmFileError(row.place(), f"joint {name!r}: this name {text}, choose another")
        kind = row.choice("kind", ("revolute", "prismatic"), "revolute")
        theta, d, across = _row(row)
        along = pin.SE3(pin.exp3(theta * z), d * z)
        origin = before * along if form == "standard" else across * along
        before = across if form == "standard" else pin.SE3.Identity()
        lower, upper = _limits(row, kind)
        row.finish()
        if np.isinf(lower) and kind == "revolute":
            kind = "continuous"
        parent, child = (f"link{number - 1}" if number > 1 else "base"), f"link{number}"
        links[child] = Link(child, bodies[number - 1], (), row.place(), between=not any(bodies))
        pose, limits = (origin.translation, origin.rotation), (lower, upper, np.inf, np.inf)
        joints[name] = Joint(name, kind, parent, child, *pose, z, *limits, None, row.place())
    links[FLANGE] = Link(FLANGE, None, (), place)
    end = (f"link{len(rows)}", FLANGE, before.translation, before.rotation, z, -np.inf, np.inf, np.inf, np.inf)
    joints[FLANGE] = Joint(FLANGE, "fixed", *end, None, place)
    near, length = _slid(joints)
    if length > FARTHEST:
        size, name, key = max(
            (abs(row.quantity(key, "length")), name, key) for name, row in rows.items() for key in "da"
        )
        raise rows[name].fail(key, f"{size:g} m is farther than any joint: in millimetres, write {key}_mm")
    flags: tuple[Flag, ...] = ()
    if not any(bodies):
        flags += (Flag("weightless", f"{place}: no joint of [robot.joint] has a mass, so only payloads weigh"),)
    if length < 0.5 * sum(float(np.linalg.norm(joint.origin)) for joint in joints.values()):
        slid = [name for name, shift in near.items() if abs(shift) > length]
        text = f"d of {listing(slid)} cancel, as of axes nearly parallel to the next, over {length:.3g} m of arm"
        flags += (Flag("slid", f"{place}: {text}; their frames are taken along the axes to where these pass it"),)
        form, joints = "", {name: _at(joint, joints, near) for name, joint in joints.items()}
        for name, shift in near.items():
            link = links[joints[name].child]
            if (body := link.inertial) is not None:
                links[link.name] = replace(link, inertial=replace(body, origin=body.origin - shift * z))
    return Urdf(table.path.stem, table.path, links, joints, flags, translated=True, dh=form)


def _limits(row: Declaration, kind: str) -> tuple[float, float]:
    """Return the limits of a joint [rad or m], infinite where it has none."""
    of_kind = "length" if kind == "prismatic" else "angle"
    lower, upper = (row.quantity(key, of_kind, end) for key, end in (("lower", -np.inf), ("upper", np.inf)))
    if not lower < upper:
        raise row.fail("upper", f"expected more than lower, {lower:g}, got {upper:g}")
    if np.isinf(lower) != np.isinf(upper):
        missing, given = ("lower", "upper") if np.isinf(lower) else ("upper", "lower")
        raise row.fail(missing, f"is not given, but {given} is: give both limits, or none for a joint without")
    return lower, upper


def _slid(joints: Mapping[str, Joint]) -> tuple[dict[str, float], float]:
    """Return how far along its axis [m] each turning joint is nearest to the one before, and the chain's length then.

    A frame may be anywhere along the axis that its joint turns about: d of two axes that are nearly parallel cancel.
    """
    shifts, before, length, point = dict[str, float](), pin.SE3.Identity(), 0.0, np.zeros(3)
    for name, joint in joints.items():
        here = before * pin.SE3(joint.rotation, joint.origin)
        if joint.kind in ("revolute", "continuous"):
            shifts[name] = float(here.rotation[:, 2] @ (point - here.translation))
        there = here.translation + shifts.get(name, 0.0) * here.rotation[:, 2]
        length, point, before = length + float(np.linalg.norm(there - point)), there, here
    return shifts, length


def _at(joint: Joint, joints: Mapping[str, Joint], shifts: Mapping[str, float]) -> Joint:
    """Return a joint with its frame, and that of the joint before, so far along their axes [m]."""
    back = next((shifts.get(name, 0.0) for name, inner in joints.items() if inner.child == joint.parent), 0.0)
    origin = joint.origin + shifts.get(joint.name, 0.0) * joint.rotation[:, 2] - [0.0, 0.0, back]
    return replace(joint, origin=origin)


def in_other_form(robot: Robot) -> Robot:
    """Return a robot of rows of one form as if their numbers were those of the other, with the names of its joints."""
    form = next(other for other in FORMS if other != robot.urdf.dh)
    rows = list(robot.urdf.joints.values())
    rows = rows[: [joint.name for joint in rows].index(FLANGE) + 1]
    ends, count = [pin.SE3(joint.rotation, joint.origin) for joint in rows], len(rows) - 1
    if robot.urdf.dh == "standard":  # what stands before a joint is its own theta and d, after the row before it
        across = [_across(end) for end in ends[1:count]] + [ends[count]]
        along = [ends[0], *(part.inverse() * end for part, end in zip(across[:-1], ends[1:count], strict=True))]
        origins = [part * other for part, other in zip(across, along, strict=True)] + [pin.SE3.Identity()]
    else:
        across = [_across(end) for end in ends[:count]]
        along = [part.inverse() * end for part, end in zip(across, ends[:count], strict=True)]
        before = [pin.SE3.Identity(), *across]
        origins = [part * other for part, other in zip(before, [*along, pin.SE3.Identity()], strict=True)]
    moved = {
        joint.name: replace(joint, origin=origin.translation, rotation=origin.rotation)
        for joint, origin in zip(rows, origins, strict=True)
    }
    urdf = replace(robot.urdf, joints=robot.urdf.joints | moved, dh=form)
    return replace(robot, urdf=urdf, chain=tuple(urdf.joints[joint.name] for joint in robot.chain))


def in_dh_words(robot: Robot) -> dict[str, tuple[str, float]]:
    """Return by label of a geometry parameter the row's number that it is, 'alpha of J2', and the sign between them.

    A twist of a joint's frame in its own axes is theta and d of its row about and along z. About and along x and y it
    is a, alpha and beta of the row that ends before these where the joint's own theta is a number of right angles, and
    for angles its d is 0: else it is several of them at once, and has no entry. Empty for a robot of no such rows.
    """
    words: dict[str, tuple[str, float]] = {}
    joints = list(robot.urdf.joints.values()) if robot.urdf.dh else []
    rows = joints[: next((i for i, joint in enumerate(joints) if joint.name == FLANGE), 0)]  # a tool is none of them
    for number, joint in enumerate(rows):
        end = pin.SE3(joint.rotation, joint.origin)
        first = number == 0 and robot.urdf.dh == "standard"
        across = pin.SE3.Identity() if first else _across(end)
        along, straight = across.inverse() * end, abs(across.rotation[0, 2]) < RESOLUTION  # of no beta
        of_row = {"dz": ("d", joint.name, 1.0), "rz": ("theta", joint.name, 1.0)}
        before = joint.name if robot.urdf.dh == "modified" else rows[number - 1].name
        for axis, letter in () if first else enumerate("xy"):
            there = np.round(along.rotation[:, axis], 9)
            x, y = float(there[0]), float(there[1])
            at_once = abs(along.translation[2]) > RESOLUTION
            if abs(x) == 1.0 and straight:
                of_row |= {f"d{letter}": ("a", before, x)} | ({} if at_once else {f"r{letter}": ("alpha", before, x)})
            elif abs(y) == 1.0 and not at_once:
                of_row[f"r{letter}"] = ("beta", before, y)
        named = {axis: (f"{key} of {name}", sign) for axis, (key, name, sign) in of_row.items()}
        every = of_motions(ParameterKind.GEOMETRY, (joint.name,))
        words |= {parameter.label: named[parameter.name] for parameter in every if parameter.name in named}
    return words


def first_row(urdf: Urdf, joint: Joint) -> tuple[float, float] | None:
    """Return theta [rad] and d [m] of a joint's row as declared; None of one that is not the first of such rows."""
    if not urdf.dh or joint.name != next(iter(urdf.joints)):
        return None
    end = pin.SE3(joint.rotation, joint.origin)
    along = end if urdf.dh == "standard" else _across(end).inverse() * end
    return float(np.arctan2(along.rotation[1, 0], along.rotation[0, 0])), float(along.translation[2])


def _across(end: pin.SE3) -> pin.SE3:
    """Return Tx(a) Rx(alpha) Ry(beta) of Tx(a) Rx(alpha) Ry(beta) Rz(theta) Tz(d)."""
    z = end.rotation[:, 2]
    turn = pin.exp3(np.array([np.arctan2(-z[1], z[2]), 0.0, 0.0]))
    turn = turn @ pin.exp3(np.array([0.0, np.arctan2(z[0], np.hypot(z[1], z[2])), 0.0]))
    along = end.translation[1:] @ z[1:] / max(float(z[1:] @ z[1:]), 1e-300)  # d, whose share of x is no a
    return pin.SE3(turn, np.array([end.translation[0] - along * z[0], 0.0, 0.0]))


def _row(row: Declaration) -> tuple[float, float, pin.SE3]:
    """Return theta [rad], d [m], and the pose that a, alpha and beta make."""
    angles, lengths = ({key: row.quantity(key, kind) for key in keys.split()} for kind, keys in PARAMETERS.items())
    for key, value in angles.items():
        if abs(value) > 2.0 * np.pi:
            raise row.fail(key, f"{value:g} rad exceeds a full turn: in degrees, write {key}_deg")
    turn = pin.exp3(np.array([angles["alpha"], 0.0, 0.0])) @ pin.exp3(np.array([0.0, angles["beta"], 0.0]))
    return angles["theta"], lengths["d"], pin.SE3(turn, np.array([lengths["a"], 0.0, 0.0]))


PARAMETERS = {"angle": "theta alpha beta", "length": "d a"}


def _body(row: Declaration) -> Inertial | None:
    """Return what a link weighs, all of it at its centre of mass."""
    mass = row.number("mass", 0.0)
    com = row.numbers("com", (3,)) if row.has("com") else np.zeros(3)
    if row.has("com") and not row.has("mass"):
        raise row.fail("com", "stands without the mass whose centre it is: give mass, too")
    if mass < 0.0:
        raise row.fail("mass", f"is {mass:g} kg, expected more than 0")
    return Inertial(mass, com, np.eye(3), np.zeros((3, 3)), row.place("mass"), point=True) if mass else None
