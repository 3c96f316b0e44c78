"""Masses and inertias: refuse the impossible, flag the unlikely.

Pinocchio reads a missing or garbled mass as 0 kg and takes any inertia matrix; what it would compute from them is
wrong without a word, so they are refused here.

What is fixed to a moving link weighs and turns with it as one body, so it is the sum that must be possible: files of
good robots fix sensors and frames to their links with the inertia of a point, or with none worth the name.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.errors import Flag, Place, UrdfError
from armflex.robot.elements import MOVING, Inertial, Joint, Link, Visual
from armflex.robot.tree import joints_by_parent
from armflex.robot.urdf import Urdf

DENSITY_BAND = (20.0, 23000.0)
"""kg/m^3 of the drawn volume: from a sheet-metal box to solid tungsten."""

MASS_RATIO = 400.0
"""A link this many times lighter or heavier than the median suggests tonnes or grams."""


def check_masses(urdf: Urdf, strict: bool, allow_massless: bool) -> tuple[Flag, ...]:
    """Return the doubts about masses and inertias of a checked tree.

    Raises:
        UrdfError: A mass is not positive, a moving body has none (unless `allow_massless`), the inertia of a moving
            link, alone or with what is fixed to it, is not positive definite or breaks the triangle inequality (a
            flag when not `strict`, unless negative), a CoM lies more than ten link lengths away.
    """
    flags: list[Flag] = []
    for link in urdf.links.values():
        if link.inertial:
            flags += _check_inertial(urdf, link, link.inertial, strict, allow_massless)
    flags += _check_bodies(urdf, strict, allow_massless)
    return (*flags, *_check_median(urdf))


def _check_inertial(urdf: Urdf, link: Link, inertial: Inertial, strict: bool, allow_massless: bool) -> list[Flag]:
    moves = any(joint.child == link.name and joint.kind in MOVING for joint in urdf.joints.values())
    if inertial.mass < 0.0 or (inertial.mass == 0.0 and moves and not allow_massless):
        raise UrdfError(inertial.place, f"link {link.name!r}: mass is {inertial.mass:g} kg, expected more than 0")
    if inertial.mass == 0.0:  # a frame written as a link: real files fix them to others
        text = f"{inertial.place}: link {link.name!r} has an inertia but no mass; it is left out"
        return [Flag("massless_inertia", text)] if inertial.inertia.any() else []
    size = _size(urdf, link, inertial)
    return [
        *_check_inertia(link.name, inertial.inertia, inertial.place, moves, strict),
        *_check_com(link, inertial, size),
        *_check_density(link, inertial, size),
    ]


def _check_inertia(name: str, inertia: Array, place: Place, moves: bool, strict: bool) -> list[Flag]:
    moments = np.linalg.eigvalsh(inertia)
    text = f"link {name!r}: principal moments {', '.join(f'{m:.4g}' for m in moments)} kg m^2 "
    problem = ""
    if moments[0] <= 0.0:
        problem = text + "are not all positive"
    elif moments[2] > (moments[0] + moments[1]) * (1.0 + 1e-6):
        problem = text + "break the triangle inequality (no body has them)"
    negative = np.diag(inertia).min() < 0.0  # Pinocchio cannot hold these
    if problem and (negative or (strict and moves)):
        raise UrdfError(place, problem)
    return [Flag("impossible_inertia", f"{place}: {problem}")] if problem else []


def _check_com(link: Link, inertial: Inertial, size: float) -> list[Flag]:
    distance = float(np.linalg.norm(inertial.origin))
    text = f"link {link.name!r}: CoM is {distance:.4g} m from the link frame, the link's size is {size:.3g} m"
    if distance > 10.0 * size:
        raise UrdfError(inertial.place, f"{text}: millimetres?")
    return [Flag("com_outside", f"{inertial.place}: {text}")] if distance > 4.0 * size else []


def _check_density(link: Link, inertial: Inertial, size: float) -> list[Flag]:
    volume = sum(map(_volume, link.visuals))
    density = inertial.mass / volume if volume else 1000.0
    gyration = float(np.sqrt(np.trace(inertial.inertia) / 2.0 / inertial.mass))
    if DENSITY_BAND[0] <= density <= DENSITY_BAND[1] and gyration <= 5.0 * size:
        return []
    text = f"link {link.name!r}: {inertial.mass:g} kg over {volume:.3g} m^3, radius of gyration {gyration:.3g} m"
    return [Flag("implausible_mass", f"{inertial.place}: {text}: tonnes or grams?")]


def _volume(visual: Visual) -> float:
    size = visual.size
    if visual.kind == "box":
        return size[0] * size[1] * size[2]
    if visual.kind == "cylinder":
        return np.pi * size[0] ** 2 * size[1]
    return 4.0 / 3.0 * np.pi * size[0] ** 3 if visual.kind == "sphere" else 0.0


def _size(urdf: Urdf, link: Link, inertial: Inertial) -> float:
    """Return a length that the link's CoM should not exceed much: its joints, travel, shapes, or 2 % of the robot."""
    gyration = np.sqrt(max(np.trace(inertial.inertia), 0.0) / 2.0 / inertial.mass)
    whole = sum(float(np.linalg.norm(joint.origin)) for joint in urdf.joints.values())
    near = [_extent(joint) for joint in urdf.joints.values() if link.name in (joint.parent, joint.child)]
    shapes = [float(np.linalg.norm(visual.pose[:3, 3])) + max(visual.size) for visual in link.visuals]
    return max(0.02 * whole, min(float(gyration), whole), *near, *shapes, 1e-3)


def _extent(joint: Joint) -> float:
    travel = max(abs(joint.lower), abs(joint.upper)) if joint.kind == "prismatic" else 0.0
    return float(np.linalg.norm(joint.origin)) + travel


def _check_bodies(urdf: Urdf, strict: bool, allow_massless: bool) -> list[Flag]:
    flags = []
    for joint in urdf.joints.values():
        if joint.kind not in MOVING:
            continue
        link, mass, inertia = urdf.links[joint.child], *_body(urdf, joint.child)
        if not mass:
            flags.append(_massless(link, joint, allow_massless))
        elif link.inertial is None or (inertia != link.inertial.inertia).any():
            flags += _check_inertia(f"{link.name} and what is fixed to it", inertia, link.place, True, strict)
    return flags


def _massless(link: Link, joint: Joint, allow_massless: bool) -> Flag:
    text = f"link {link.name!r} moves with joint {joint.name!r} but has no <inertial>, so no weight"
    if not allow_massless:
        raise UrdfError(link.place, f"{text}; give it one, or set allow_massless = true if that is meant")
    return Flag("massless", f"{link.place}: {text}")


def _body(urdf: Urdf, link: str) -> tuple[float, Array]:
    """Return the mass [kg] and the inertia about the common CoM [kg m^2] of a link with all that is fixed to it."""
    children = joints_by_parent(urdf)
    parts, stack = [], [(link, pin.SE3.Identity())]
    while stack:
        name, place = stack.pop()
        inertial = urdf.links[name].inertial
        if inertial and inertial.mass > 0.0:
            turn = place.rotation @ inertial.rotation
            parts.append((inertial.mass, place * inertial.origin, turn @ inertial.inertia @ turn.T))
        fixed = [joint for joint in children[name] if joint.kind == "fixed"]
        stack.extend((joint.child, place * pin.SE3(joint.rotation, joint.origin)) for joint in fixed)
    return _sum_of(parts)


def _sum_of(parts: list[tuple[float, Array, Array]]) -> tuple[float, Array]:
    mass = sum(part[0] for part in parts)
    center = sum(part[0] * part[1] for part in parts) / (mass or 1.0)
    inertia = np.zeros((3, 3))
    for own, position, about in parts:
        arm = pin.skew(position - center)
        inertia += about - own * arm @ arm
    return mass, inertia


def _check_median(urdf: Urdf) -> list[Flag]:
    moved = {joint.child for joint in urdf.joints.values() if joint.kind in MOVING}
    masses = {name: _body(urdf, name)[0] for name in moved}
    median = float(np.median([mass for mass in masses.values() if mass] or [1.0]))
    return [
        Flag("implausible_mass", f"{urdf.links[name].place}: link {name!r} is {mass:g} kg, the median is {median:g} kg")
        for name, mass in masses.items()
        if mass and not median / MASS_RATIO < mass < median * MASS_RATIO
    ]
