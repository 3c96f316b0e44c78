"""Masses and inertias: refuse the impossible where it bears on the chain, flag the unlikely.

Pinocchio reads a missing or garbled mass as 0 kg and takes any inertia matrix; what it would compute from them is
wrong without a word, so they are refused here. What a load comes from, mass and centre of mass, counts on the chain and
on whatever it carries; the rest of the file counts for nothing. Moments of inertia have no part in an arm at rest:
impossible ones are flagged, and refused where the arm is asked to move with them.

What is fixed to a moving link weighs and turns with it as one body, so it is the sum that must be possible: files of
good robots fix sensors and frames to their links with the inertia of a point, or with none worth the name.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.errors import Flag, Place, UrdfError
from armflex.robot.urdf import MOVING, Inertial, Joint, Link, Urdf, Visual

DENSITY_BAND = (20.0, 23000.0)
"""kg/m^3 of the drawn volume: from a sheet-metal box to solid tungsten."""

MASS_RATIO = 400.0
"""A link this many times lighter or heavier than the median suggests tonnes or grams."""


@dataclass(frozen=True)
class Scope:
    """What of a file a chain depends on.

    Attributes:
        chain: Links of the chain but for the base.
        carried: These and all that hangs on them: what loads a place between base and tip.
    """

    chain: frozenset[str]
    carried: frozenset[str]


def scope_of(urdf: Urdf, chain: Sequence[Joint]) -> Scope:
    """Return what of a file a chain depends on."""
    return Scope(frozenset(joint.child for joint in chain), frozenset(urdf.below(chain[0].child)))


def check_faults(urdf: Urdf, scope: Scope) -> tuple[Flag, ...]:
    """Return a flag for everything that cannot be read and does not matter to the chain, saying what is done instead.

    Raises:
        UrdfError: A link of the chain cannot be read, or what weighs of one that it carries.
    """
    flags = []
    met = [("link", link.name, link.name in scope.chain, link) for link in urdf.links.values()]
    met += [("joint", joint.child, False, joint) for joint in urdf.joints.values()]
    for kind, link, on_chain, owner in met:
        for fault in owner.faults:
            if on_chain or (fault.matters == "carried" and link in scope.carried):
                raise fault.error
            problem = f"{kind} {owner.name!r} is off the chain: {fault.error.problem}; {fault.instead}"
            flags.append(Flag("off_the_chain", f"{fault.error.place}: {problem}"))
    return tuple(flags)


def check_masses(urdf: Urdf, scope: Scope, allow_massless: bool) -> tuple[Flag, ...]:
    """Return the flags about masses and inertias of a checked tree.

    Raises:
        UrdfError: A moving body of the chain has no mass (unless `allow_massless`, or it is a mere crossing of axes),
            the CoM of what the chain carries lies more than ten link lengths away.
    """
    flags: list[Flag] = []
    moving = [joint for joint in urdf.joints.values() if joint.kind in MOVING]
    moved = {joint.child for joint in moving}
    for link in urdf.links.values():
        if (inertial := link.inertial) is None:
            continue
        if inertial.mass > 0.0:
            flags += _check_link(urdf, link, inertial, link.name in scope.carried)
        elif link.name in moved and link.name in scope.chain and not allow_massless:
            raise UrdfError(inertial.place, f"link {link.name!r}: mass is {inertial.mass:g} kg, expected more than 0")
        elif inertial.inertia.any():  # a frame written as a link: real files fix them to others
            text = f"{inertial.place}: link {link.name!r} has an inertia but no mass; it is left out"
            flags.append(Flag("massless_inertia", text))
    masses = {}
    for joint in moving:
        link, (masses[joint.child], inertia) = urdf.links[joint.child], _body(urdf, joint.child)
        if masses[link.name] and (link.inertial is None or (inertia != link.inertial.inertia).any()):
            flags += _check_inertia(f"{link.name} and what is fixed to it", inertia, link.place)
        elif not (masses[link.name] or link.between):
            text = f"link {link.name!r} moves with joint {joint.name!r} but has no <inertial>, so no weight"
            ends = urdf.children[link.name]
            # Where two axes of one joint cross there is but a place: nothing of it could weigh.
            crossing = not link.visuals and len(ends) == 1 and ends[0].kind in MOVING and not ends[0].origin.any()
            if link.name in scope.chain and not (allow_massless or crossing):
                raise UrdfError(link.place, f"{text}; give it one, or set allow_massless = true if that is meant")
            flags.append(Flag("massless", f"{link.place}: {text}"))
    median = float(np.median([mass for mass in masses.values() if mass] or [1.0]))
    for name, mass in masses.items():
        if mass and not median / MASS_RATIO < mass < median * MASS_RATIO:
            text = f"{urdf.links[name].place}: link {name!r} is {mass:g} kg, the median is {median:g} kg"
            flags.append(Flag("implausible_mass", text))
    return tuple(flags)


def _check_link(urdf: Urdf, link: Link, inertial: Inertial, carried: bool) -> list[Flag]:
    """Return the flags about one body; raise where the CoM of one that is carried is far beyond it."""
    flags, where, mass = _check_inertia(link.name, inertial.inertia, inertial.place), inertial.place, inertial.mass
    # The roots are taken first, because masses may be next to nothing.
    gyration = float(np.sqrt(max(np.trace(inertial.inertia), 0.0) / 2.0) / np.sqrt(mass))
    # A length that the link's CoM should not exceed much: its joints, travel, shapes, or 2 % of the robot.
    whole = sum(float(np.linalg.norm(joint.origin)) for joint in urdf.joints.values())
    near = [
        float(np.linalg.norm(joint.origin))
        + (max(abs(joint.lower), abs(joint.upper)) if joint.kind == "prismatic" else 0.0)
        for joint in urdf.joints.values()
        if link.name in (joint.parent, joint.child)
    ]
    shapes = [float(np.linalg.norm(visual.pose[:3, 3])) + max(visual.size) for visual in link.visuals]
    size = max(0.02 * whole, min(gyration, whole), *near, *shapes, 1e-3)
    distance = float(np.linalg.norm(inertial.origin))
    text = f"link {link.name!r}: CoM is {distance:.4g} m from the link frame, the link's size is {size:.3g} m"
    if distance > 10.0 * size and carried:
        raise UrdfError(where, f"{text}: millimetres?")
    if distance > 4.0 * size:
        flags.append(Flag("com_outside", f"{where}: {text}"))
    volume = sum(map(_volume, link.visuals))
    density = mass / volume if volume else 1000.0
    if not DENSITY_BAND[0] <= density <= DENSITY_BAND[1] or gyration > 5.0 * size:
        text = f"link {link.name!r}: {mass:g} kg over {volume:.3g} m^3, radius of gyration {gyration:.3g} m"
        flags.append(Flag("implausible_mass", f"{where}: {text}: tonnes or grams?"))
    return flags


def _volume(visual: Visual) -> float:
    size = visual.size
    if visual.kind == "box":
        return size[0] * size[1] * size[2]
    if visual.kind == "cylinder":
        return np.pi * size[0] ** 2 * size[1]
    return 4.0 / 3.0 * np.pi * size[0] ** 3 if visual.kind == "sphere" else 0.0


def _check_inertia(name: str, inertia: Array, place: Place) -> list[Flag]:
    problem = _impossible(inertia)
    text = f"{place}: link {name!r}: {problem}; an arm at rest does not depend on them"
    return [Flag("impossible_inertia", text)] if problem else []


def _impossible(inertia: Array, least: float = 0.0) -> str:
    """Return what no body's (3, 3) inertia is; a `least` share of the largest moment may be missing to a needle's 0."""
    moments = np.linalg.eigvalsh(inertia)
    text = f"principal moments {', '.join(f'{m:.4g}' for m in moments)} kg m^2 "
    if moments[0] < -least * moments[2] or (least == 0.0 and moments[0] == 0.0):
        return text + "are not all positive"
    if moments[2] > (moments[0] + moments[1]) * (1.0 + 1e-6):
        return text + "break the triangle inequality (no body has them)"
    return ""


def check_motion(urdf: Urdf, scope: Scope, chain: Sequence[Joint], held: Mapping[str, float], strict: bool) -> None:
    """Refuse what an arm at rest does not depend on: moments of inertia.

    Links that side joints hold to a link of the chain turn with it as one body, and that is what must be possible.

    Raises:
        UrdfError: A body that moves with the chain has moments that no body has (taken as they are when not `strict`),
            negative ones, or none that can be read.
    """
    for link in (urdf.links[name] for name in urdf.links if name in scope.carried):
        for fault in link.faults:
            if fault.matters == "moved":
                raise fault.error
        inertial = link.inertial
        if (
            inertial
            and inertial.mass > 0.0
            and (
                # A moment about a link axis that is negative by more than rounding Pinocchio cannot hold.
                np.diag(inertial.turned).min() < -1e-9 * np.abs(inertial.inertia).max()
            )
        ):
            raise UrdfError(inertial.place, f"link {link.name!r}: {_impossible(inertial.inertia)}")
    ends = {joint.name for joint in chain if joint.kind in MOVING}
    for joint in chain:
        if joint.name in ends and strict:
            _, inertia = _body(urdf, joint.child, ends, held)
            if problem := _impossible(inertia, 1e-6):
                whole = f"link {joint.child!r} and what it carries up to the next joint of the chain"
                raise UrdfError(urdf.links[joint.child].place, f"{whole}: {problem}; v= and a= need possible ones")


def _body(
    urdf: Urdf, link: str, ends: Collection[str] | None = None, held: Mapping[str, float] | None = None
) -> tuple[float, Array]:
    """Return the mass [kg] and the inertia about the common CoM [kg m^2] of a link with all that is fixed to it.

    With `ends` what moves hangs on it too, `held` where it is, up to the joints of these names.
    """
    parts, stack = [], [(link, pin.SE3.Identity())]
    while stack:
        name, place = stack.pop()
        inertial = urdf.links[name].inertial
        if inertial and inertial.mass > 0.0:
            turn = place.rotation @ inertial.rotation
            parts.append((inertial.mass, place * inertial.origin, turn @ inertial.inertia @ turn.T))
        for joint in urdf.children[name]:
            if joint.kind not in MOVING if ends is None else joint.name not in ends:
                there = pin.SE3(joint.rotation, joint.origin) * joint.motion((held or {}).get(joint.name, 0.0))
                stack.append((joint.child, place * there))
    mass = sum(part[0] for part in parts)
    center = sum(part[0] * part[1] for part in parts) / (mass or 1.0)
    inertia = np.zeros((3, 3))
    for own, position, about in parts:
        arm = pin.skew(position - center)
        inertia += about - own * arm @ arm
    return mass, inertia
