"""[link.NAME]: a link that bends, by a part that `armflex fem` condensed.

The link is held where its joint ends and gives at the joint that it carries, which are the part's two interfaces. One
flexure stands there, and what of the link's weight bends it hangs behind that: the condensed weight is that of a body
of a mass m_e, whose place follows from its moments (half the mass, a sixth of the length inboard, of a uniform beam).
The condensed mass differs from that of the two bodies; `modes` adds the difference.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin

from armflex.arm import Flexure
from armflex.conventions import Array
from armflex.declaration import Declaration
from armflex.errors import Flag, did_you_mean, listing
from armflex.fem.part import Part, read_part
from armflex.fem.surface import Drawing, surface_path
from armflex.laws.declared import NEAR
from armflex.laws.joint.meshed import MeshedLaw
from armflex.robot import Robot
from armflex.robot.urdf import Inertial, Joint, Link

HEAVIER = 0.02
"""Share by which the masses of a link in the robot's file and in its mesh may differ without a flag."""


def read_link(name: str, table: Declaration, robot: Robot) -> tuple[Robot, Flexure, tuple[Flag, ...]]:
    """Return the robot with a link that ends in one more link, and the flexure between them.

    Args:
        name: The link, between two joints of the chain.
        table: Its `file`, and the place of the mesh in the link's frame: `xyz` [m], `rpy` [rad].
        robot: The robot so far.

    Raises:
        ArmFileError: There is no such link, nothing hangs on it, or the part does not end where its joint is.
    """
    ends = [joint for joint in robot.chain if joint.parent == name]
    if not ends or not any(joint.child == name for joint in robot.chain):
        inside = [joint.child for joint in robot.chain[:-1]]
        hint = did_you_mean(name, inside)
        raise table.fail("file", f"no link {name!r} between two joints of the chain{hint} (known: {listing(inside)})")
    path = table.path.parent / table.text("file")
    part = read_part(path)
    loaded, *more = part.loaded
    if more:
        raise table.fail("file", f"has {1 + len(more)} loaded interfaces ({listing(part.loaded)}), a link one")
    shift, turn = (table.numbers(key, (3,)) if table.has(key) else np.zeros(3) for key in ("xyz", "rpy"))
    table.finish()
    mesh, joint = pin.SE3(pin.rpy.rpyToMatrix(turn), shift), ends[0]
    tip = mesh * part.origin
    length = float(np.linalg.norm(part.origin - part.fixed_origin))
    if (apart := float(np.linalg.norm(tip - joint.origin))) > NEAR * length:
        text = f"{loaded!r} is at {np.round(tip, 4).tolist()} of the link, {apart:.3g} m from joint"
        text += f" {joint.name!r} at {np.round(joint.origin, 4).tolist()}"
        raise table.fail("file", f"{text}: say with xyz and rpy where the mesh is")
    at_joint = pin.SE3(joint.rotation, joint.origin).inverse() * pin.SE3(mesh.rotation, tip)
    compliance = at_joint.action @ part.compliance @ at_joint.action.T
    split, flags = _split(robot, name, part, mesh)
    inertia, own = None, robot.urdf.links[name].inertial
    if own is not None and split[0] is not None and split[1] is not None:
        place, back = pin.SE3(joint.rotation, joint.origin).action, np.linalg.inv(at_joint.action)
        whole, rest, end = (
            place.T @ pin.Inertia(one.mass, one.origin, one.turned).matrix() @ place for one in (own, *split) if one
        )
        turning, bent = (
            back.T @ (own.mass / part.mass * one) @ back
            for one in (np.hstack([part.weight, part.spin]), part.mass_matrix)
        )
        inertia = np.block([[whole - rest - end, (turning - end).T], [turning - end, bent - end]])
    law = MeshedLaw(0.5 * (compliance + compliance.T), part.young_std)
    drawing = Drawing(surface_path(path), part.sha256, part.origin, at_joint)
    flexure = Flexure(name, f"{name}:end", law, inertia=inertia, drawing=drawing)
    return _ended(robot, joint, split, f"{name}:end"), flexure, flags


Bodies = tuple[Inertial | None, Inertial | None]
"""Of a link and of its end."""


def _split(robot: Robot, name: str, part: Part, mesh: pin.SE3) -> tuple[Bodies, tuple[Flag, ...]]:
    """Return the bodies of a link and of its end, both in the link's frame, and what is doubtful about them."""
    own = robot.urdf.links[name].inertial
    mass = float(np.trace(part.weight[:3])) / 3.0
    if own is None or mass <= 0.0:
        text = f"link {name!r} does not bend under its own weight: its part or its link has no mass"
        return (own, None), (Flag("weightless", text),)
    share = min(mass / part.mass, 1.0)
    flags = ()
    if abs(own.mass - part.mass) > HEAVIER * part.mass:
        text = f"link {name!r} weighs {own.mass:g} kg in {robot.urdf.path.name} and {part.mass:g} kg in its mesh"
        flags = (Flag("link_mass", f"{text}: the former counts, distributed as the latter"),)
    moments = part.weight[3:] / mass  # of a body at r the matrix of r x, whose skew part r is read from
    arm = 0.5 * np.array([moments[2, 1] - moments[1, 2], moments[0, 2] - moments[2, 0], moments[1, 0] - moments[0, 1]])
    place, end = mesh * (part.origin + arm), share * own.mass
    rest = own.mass - end
    com = (own.mass * own.origin - end * place) / rest

    def far(mass: float, lever: Array) -> Array:
        return mass * (lever @ lever * np.eye(3) - np.outer(lever, lever))

    sizes, axes = np.linalg.eigh(own.turned - far(end, place - own.origin) - far(rest, com - own.origin))
    inertia = (axes * sizes.clip(0.0)) @ axes.T  # two bodies at these places may already have more than the link
    first = Inertial(rest, com, np.eye(3), inertia, own.place, own.point)
    return (first, Inertial(end, place, np.eye(3), np.zeros((3, 3)), own.place, True)), flags


def _ended(robot: Robot, joint: Joint, bodies: Bodies, name: str) -> Robot:
    """Return a robot whose link, before a joint that it carries, ends in a link of its own with a body."""
    urdf, placed = robot.urdf, pin.SE3(joint.rotation, joint.origin)
    body = bodies[1]
    if body is not None:
        body = replace(body, origin=placed.actInv(body.origin), rotation=joint.rotation.T)
    link = replace(urdf.links[joint.parent], inertial=bodies[0])
    fixed = replace(joint, name=name, kind="fixed", child=name, mimic=None, lower=-np.inf, upper=np.inf)
    moved = replace(joint, parent=name, origin=np.zeros(3), rotation=np.eye(3))
    joints = {}
    for key, one in urdf.joints.items():
        if key == joint.name:
            joints[name] = fixed
        joints[key] = moved if key == joint.name else one
    links = urdf.links | {link.name: link, name: Link(name, body, (), link.place)}
    chain = tuple(step for one in robot.chain for step in ((fixed, moved) if one.name == joint.name else (one,)))
    return replace(robot, urdf=replace(urdf, links=links, joints=joints), chain=chain)
