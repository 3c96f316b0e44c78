"""[link.NAME]: a link that bends, by a part that `armflex fem` condensed.

The link is held where its joint ends and gives at the joint that it carries, which are the part's two interfaces. One
flexure stands there, and what of the link's weight bends it hangs behind that: the condensed weight is that of a body
of a mass m_e, whose place follows from its moments (half the mass, a sixth of the length inboard, of a uniform beam).
The condensed mass differs from that of the two bodies; `modes` adds the difference.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from armflex.arm import Flexure
from armflex.declaration import Declaration
from armflex.errors import Flag, did_you_mean, listing
from armflex.fem.part import Drawing
from armflex.laws.declared import NEAR, read_meshed
from armflex.laws.joint.meshed import MeshedLaw
from armflex.mechanics.spring import Spring
from armflex.robot import Robot
from armflex.robot.urdf import Inertial, Joint, Link


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
    part, turn = read_meshed(table)
    mesh = pin.SE3(turn, table.numbers("xyz", (3,)) if table.has("xyz") else np.zeros(3))
    table.finish()
    tip, joint = pin.SE3(turn, mesh * part.origin), ends[0]
    length = float(np.linalg.norm(part.origin - part.fixed_origin))
    if (apart := float(np.linalg.norm(tip.translation - joint.origin))) > NEAR * length:
        text = f"{part.loaded[0]!r} is at {np.round(tip.translation, 4).tolist()} of the link, {apart:.3g} m from joint"
        text += f" {joint.name!r} at {np.round(joint.origin, 4).tolist()}"
        raise table.fail("file", f"{text}: say with xyz and rpy where the mesh is, or mesh the link up to the joint")
    inertial, mass, flags = robot.urdf.links[name].inertial, float(np.trace(part.weight[:3])) / 3.0, []
    if apart > 1e-3:
        text = f"the mesh of link {name!r} ends {apart * 1e3:.3g} mm from joint {joint.name!r}, and the gap is taken as"
        flags.append(Flag("mesh_gap", f"{text} rigid: move the mesh with xyz and rpy, or mesh the link to the joint"))
    placed = pin.SE3(joint.rotation, joint.origin)
    at_joint = placed.actInv(tip)
    drawing = Drawing(table.path.parent / table.text("file"), part, at_joint)
    law = MeshedLaw(part.seen_from(at_joint), part.young_std, drawing)
    if inertial is None or mass <= 0.0:
        text = f"link {name!r} does not bend under its own weight: its part or its link has no mass"
        flags.append(Flag("weightless", text))
        return _ended(robot, joint, inertial, None), Flexure(name, f"{name}:end", law), tuple(flags)
    # Share by which the masses of a link in the robot's file and in its mesh may differ without a flag.
    if abs(inertial.mass - part.mass) > 0.02 * part.mass:
        text = f"link {name!r} weighs {inertial.mass:g} kg in {robot.urdf.path.name} and {part.mass:g} kg in its mesh"
        flags.append(Flag("link_mass", f"{text}: the former counts, distributed as the latter"))
    moments = part.weight[3:] / mass  # of a body at r the matrix of r x, whose skew part r is read from
    centre = mesh * (part.origin + 0.5 * pin.unSkew(moments - moments.T))
    whole = pin.Inertia(inertial.mass, inertial.origin, inertial.turned)
    # Share of a link's mass that its end has at most
    end = pin.Inertia(min(mass / part.mass, 0.999) * inertial.mass, centre, np.zeros((3, 3)))
    rest = pin.Inertia.FromDynamicParameters(whole.toDynamicParameters() - end.toDynamicParameters())
    sizes, axes = np.linalg.eigh(rest.inertia)
    rest.inertia = (axes * sizes.clip(0.0)) @ axes.T  # two bodies at these places may already have more than the link
    # What moves with the root and with the tip beside these two bodies.
    total, first, second = (placed.actInv(body).matrix() for body in (whole, rest, end))
    back, share = at_joint.inverse().action, inertial.mass / part.mass
    between = share * back.T @ np.hstack([part.weight, part.spin]) @ back - second
    bent = share * back.T @ part.mass_matrix @ back - second
    inertia = np.block([[total - first - second, between.T], [between, bent]])
    bodies = (
        replace(inertial, mass=rest.mass, origin=rest.lever, rotation=np.eye(3), inertia=rest.inertia),
        Inertial(end.mass, placed.actInv(centre), joint.rotation.T, np.zeros((3, 3)), inertial.place, True, True),
    )
    return _ended(robot, joint, *bodies), Flexure(name, f"{name}:end", law, inertia=inertia), tuple(flags)


def pins_off_root(bent: Sequence[Flexure], robot: Robot, springs: Sequence[Spring]) -> Iterator[Flag]:
    """Yield a flag about each pin of a loop, a cylinder or a spring that stands between the ends of a link that bends.

    The link's one flexure is at its end, so the pin rides on the root as if nothing bent between them.
    """
    ends = {flexure.name: robot.urdf.joints[f"{flexure.name}:end"].origin for flexure in bent}
    for tie in (*robot.linkage.loops, *robot.linkage.cylinders, *springs):
        both = (tie.link, tie.at), (tie.to, tie.at_to)
        for link, point in (end for end in both if end[0] in ends):
            length = float(np.linalg.norm(ends[link]))
            # Share of a link's length within which a pin is at its root: the share of the link whose bending it may
            # misplace
            if (along := float(point @ ends[link]) / length) > 0.01 * length:
                text = f"the pin of {tie.name!r} is {along:.3g} m from the root of link {link!r}, {along / length:.0%}"
                text += " along it, and the link bends behind its pins alone: what bends before this one is taken as"
                text += f" unheld, and the sag is wrong; split link {link!r} and its mesh in two at the pin"
                yield Flag("pin_off_root", text)


def _ended(robot: Robot, joint: Joint, rest: Inertial | None, end: Inertial | None) -> Robot:
    """Return a robot whose link, before a joint that it carries, ends in one more link; `rest` stays with it."""
    urdf, name = robot.urdf, f"{joint.parent}:end"
    link = replace(urdf.links[joint.parent], inertial=rest)
    fixed = replace(joint, name=name, kind="fixed", child=name, mimic=None, lower=-np.inf, upper=np.inf)
    moved = replace(joint, parent=name, origin=np.zeros(3), rotation=np.eye(3))
    joints = {}
    for key, part in urdf.joints.items():
        if key == joint.name:
            joints[name] = fixed
        joints[key] = moved if key == joint.name else part
    links = urdf.links | {link.name: link, name: Link(name, end, (), link.place)}
    chain = tuple(step for hinge in robot.chain for step in ((fixed, moved) if hinge.name == joint.name else (hinge,)))
    return replace(robot, urdf=replace(urdf, links=links, joints=joints), chain=chain)
