"""[joint.NAME], [[loop]] and [cylinder.NAME]: what makes a mechanism of a tree of links."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from armflex.conventions import Array
from armflex.declaration import Declaration
from armflex.errors import Flag, did_you_mean, listing
from armflex.files.spring_table import positive, read_ends
from armflex.laws.declared import Flexure
from armflex.laws.joint.linear import LinearLaw, declared_std, read_compliance
from armflex.laws.joint.oil_column import OilColumn
from armflex.mechanics.mechanism import ASSEMBLED, Closing, gaping
from armflex.mechanics.pinocchio_model import build_model
from armflex.mechanics.ties import Ties
from armflex.robot import Corrections, Robot
from armflex.robot.linkage import KINDS, Cylinder, Linkage, Loop
from armflex.robot.urdf import MOVING, Joint

SAME = 1e-6
"""Distance [m] within which two points are one."""


def read_linkage(root: Declaration, robot: Robot, held: Sequence[str]) -> tuple[Robot, tuple[Flexure, ...]]:
    """Return a robot with its loops, cylinders and joints without a drive, and the flexures of pins and cylinders.

    Args:
        root: The arm.toml.
        robot: The robot, with every link that the arm.toml makes.
        held: Joints that [robot.locked] names: they do not move, whatever they hang on.

    Raises:
        ArmFileError: A name, a point or a number cannot be meant, a loop joins what it must not, closes nowhere, or
            says what another one says.
    """
    joints, loops = root.subs("joint"), root.array_of("loop")
    cylinders = root.subs("cylinder")
    if not (joints or loops or cylinders):
        return robot, ()
    passive, driven = {}, []
    for name, table in joints.items():
        joint = _joint(name, table, robot, held)
        if table.flag("passive"):
            passive[name] = table.number("q0") if table.has("q0") else None
        else:
            driven.append(name)
        if joint.mimic is not None:
            raise table.fail("passive", f"joint {name!r} mimics {joint.mimic[0]!r}, so it has its position from there")
        table.finish()
    names: dict[str, Declaration] = {}
    read = tuple(_loop(table, *read_ends(table, robot)) for table in loops)
    pistons = tuple(_cylinder(name, table, *read_ends(table, robot)) for name, table in cylinders.items())
    for closure, table in zip((*read, *pistons), (*loops, *cylinders.values()), strict=True):
        if closure.name in names or closure.name in robot.urdf.joints:
            raise table.fail(
                "name", f"{closure.name!r} is the name of another loop, cylinder or joint: choose another one"
            )
        names[closure.name] = table
    links = [link for closure in (*read, *pistons) for link in (closure.link, closure.to)]
    links += [robot.urdf.joints[name].child for name in (*passive, *driven)]
    beside = _beside(robot, links, held)
    mimics = {joint.name: joint.mimic for joint in beside if joint.mimic is not None and joint.name not in passive}
    followers = {**robot.linkage.followers, **mimics}
    linkage = Linkage(passive, beside, read, pistons, followers)
    masters = [joint.name for joint in (*robot.chain, *beside) if joint.kind in MOVING]
    for name, (master, _, _) in followers.items():
        if master not in masters:
            text = f"joint {name!r} mimics {master!r}, which is no joint that moves with the chain or a loop"
            raise root.fail("loop", f"{text} (known: {listing(masters)})")
    locked = {name: at for name, at in robot.locked.items() if name not in {joint.name for joint in beside}}
    flags = tuple(f for f in robot.flags if f.code != "locked_mimic" or not any(repr(j.name) in f.text for j in beside))
    robot = replace(robot, linkage=linkage, locked=locked, flags=flags)
    robot = replace(robot, linkage=replace(linkage, loops=_checked(root, robot, names)))
    flexures = [_gives(closure, names[closure.name]) for closure in (*read, *pistons)]
    for table in names.values():
        table.finish()
    return robot, tuple(flexure for flexure in flexures if flexure is not None)


def _joint(name: str, table: Declaration, robot: Robot, held: Sequence[str]) -> Joint:
    moving = [joint.name for joint in robot.urdf.joints.values() if joint.kind in MOVING and joint.name not in held]
    if name not in moving:
        hint = did_you_mean(name, moving)
        raise table.fail("passive", f"[joint.{name}]: no joint {name!r} that moves{hint} (known: {listing(moving)})")
    return robot.urdf.joints[name]


def _beside(robot: Robot, links: Sequence[str], held: Sequence[str]) -> tuple[Joint, ...]:
    """Return the joints off the chain that carry some links, in the order of the robot's file."""
    on_chain, joints = {joint.name for joint in robot.chain}, set()
    for link in links:
        while link != robot.base and link in robot.urdf.parents:
            joint = robot.urdf.parents[link]
            if joint.kind in MOVING and joint.name not in on_chain and joint.name not in held:
                if joint.faults:
                    raise joint.faults[0].error
                joints.add(joint.name)
            link = joint.parent
    return tuple(joint for name, joint in robot.urdf.joints.items() if name in joints)


def _loop(table: Declaration, first: tuple[str, Array], second: tuple[str, Array]) -> Loop:
    kind = table.choice("kind", KINDS)
    axis = np.array([0.0, 0.0, 1.0])
    if kind in ("revolute", "cylindrical"):
        axis = table.numbers("axis", (3,))
        if not (length := float(np.linalg.norm(axis))) > SAME:
            raise table.fail("axis", f"is {axis.tolist()}, which has no direction")
        axis = axis / length
    elif table.has("axis"):
        raise table.fail("axis", f"a {kind} loop has none")
    return Loop(table.text("name"), *first, *second, kind, axis, np.eye(3))


def _cylinder(name: str, table: Declaration, first: tuple[str, Array], second: tuple[str, Array]) -> Cylinder:
    lower, upper = positive(table, "lower", "m"), positive(table, "upper", "m")
    if not lower < upper:
        raise table.fail("upper", f"is {upper:g} m, expected more than the lower {lower:g} m")
    effort = positive(table, "effort", "N") if table.has("effort") else np.inf
    return Cylinder(name, *first, *second, lower, upper, effort, table.place())


def _checked(root: Declaration, robot: Robot, names: Mapping[str, Declaration]) -> tuple[Loop, ...]:
    """Return the loops with the axes of `link` in `to`, as they are where the points meet near the zero pose.

    Loops that no joint moves, that say the same, or that close nowhere are refused; so are joints that nothing holds.
    """
    linkage, flex = robot.linkage, build_model(robot)
    model, data = flex.model, flex.model.createData()
    points = replace(linkage, loops=tuple(replace(loop, kind="spherical") for loop in linkage.loops))
    ties = Ties(model, data, points)
    _check_held(root, robot, names, ties)
    free, closing = np.array([at or 0.0 for at in linkage.free.values()]), Closing(robot, flex, ties, Corrections())
    lower, upper = (
        np.append(limit, np.full(len(free), end)) for limit, end in ((robot.lower, -np.inf), (robot.upper, np.inf))
    )

    from scipy.optimize import least_squares  # only where a file with loops is read

    def gaps(at: Array) -> Array:
        q, others = np.split(at, [len(robot.lower)])
        return closing.gaps(q, closing.configuration(q, others))[0]

    start = np.clip(np.append(robot.home, free), lower, upper)
    best = least_squares(gaps, start, bounds=(lower - 1e-9, upper + 1e-9))
    if np.abs(best.fun).max() > ASSEMBLED:
        error = gaping(ties, best.fun, "closes nowhere within the limits of the drives")
        raise names.get(error.loop, root).fail("at", str(error))
    met = closing.configuration(robot.home, closing.nearest(robot.home, free))
    ties.place(met)
    loops = []
    for loop, tie in zip(linkage.loops, ties.loops, strict=True):
        first, second = (end.turn @ end.axes for end in tie.ends)
        loops.append(replace(loop, turn_to=second.T @ first))
    ties = Ties(model, data, replace(linkage, loops=tuple(loops)))
    ties.place(met)
    said = [(name, {end.joint for end in tie.ends}, tie.place()[1])
            for name, tie in zip(linkage.joined, ties.joined, strict=True)]  # fmt: skip
    for (other, there, twists), (name, joints, way) in combinations(said, 2):
        rank = np.linalg.matrix_rank(np.concatenate([way, twists]), SAME)
        if joints == there and rank == max(len(way), len(twists)):
            raise names[name].fail("at", f"{name!r} says what {other!r} says: leave one of them out")
    return tuple(loops)


def _check_held(root: Declaration, robot: Robot, names: Mapping[str, Declaration], ties: Ties) -> None:
    """Raise where a loop or a cylinder holds nothing that moves, or a passive joint is held by none."""
    linkage, model, held = robot.linkage, ties.model, set[int]()
    for name, tie in zip(linkage.joined, ties.joined, strict=True):
        first, second = (end.joint for end in tie.ends)
        closure = next(closure for closure in (*linkage.loops, *linkage.cylinders) if closure.name == name)
        text = f"{name!r} joins {closure.link!r} to {closure.to!r}"
        if first == second:
            raise names[name].fail("to", f"{text}, which no joint moves against each other")
        between = set(model.supports[first]) ^ set(model.supports[second])
        if not any(model.getJointId(joint) in between for joint in linkage.free):
            driven = [joint for joint in robot.joint_names if model.getJointId(joint) in between]
            drives = f"and {listing(driven)} between them {'has a drive' if len(driven) == 1 else 'have drives'}"
            remedy = f"a joint that it holds is passive: [joint.{driven[-1]}] passive = true"
            raise names[name].fail("to", f"{text}, {drives}: {remedy}")
        held |= between
    for name in [name for name in linkage.passive if model.getJointId(name) not in held]:
        text = f"joint {name!r} is passive, but no loop or cylinder is around it: nothing would hold it"
        raise root.subs("joint")[name].fail("passive", text)


def _gives(closure: Loop | Cylinder, table: Declaration) -> Flexure | None:
    """Return the flexure of a pin or a cylinder, None of one that does not give."""
    if isinstance(closure, Loop):
        compliant = table.has("compliance")
        law = LinearLaw(read_compliance(table), declared_std(table)) if compliant else None
        return law and Flexure(closure.name, closure.name, law)
    if table.has("bulk_modulus") or table.has("bore"):
        if table.has("stiffness"):
            raise table.fail("stiffness", "stands beside a bore, from which it follows: give one of them")
        bore, rod = positive(table, "bore", "m"), table.number("rod", 0.0)
        if not 0.0 <= rod < bore:
            raise table.fail("rod", f"is {rod:g} m thick, expected 0 m or more and less than the bore, {bore:g} m")
        if bore > closure.lower:
            text = f"its bore of {bore:g} m is more than its shortest length, {closure.lower:g} m"
            text = f"cylinder {closure.name!r}: {text}"
            table.source.flags.append(Flag("long", f"{text}: millimetres? Taken as metres"))
        dead = table.number("dead_volume", 0.0)
        if dead < 0.0:
            raise table.fail("dead_volume", f"expected 0 m^3 or more, got {dead:g}")
        areas = 0.25 * np.pi * bore**2, 0.25 * np.pi * (bore**2 - rod**2)
        modulus = positive(table, "bulk_modulus", "Pa")
        oil = OilColumn(closure.name, areas, closure.lower, closure.upper, dead, modulus, declared_std(table))
        return Flexure(closure.name, closure.name, oil)
    if table.has("stiffness"):
        softness = 1.0 / positive(table, "stiffness", "N/m")
        return Flexure(closure.name, closure.name, LinearLaw(np.diag([softness, 0, 0, 0, 0, 0.0]), declared_std(table)))
    return None
