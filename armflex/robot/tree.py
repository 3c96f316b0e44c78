"""The kinematic tree: is it one, and which joints lead from the base to the tip."""

from __future__ import annotations

from armflex.errors import Place, UnknownNameError, UrdfError, listing
from armflex.robot.elements import MOVING, Joint
from armflex.robot.urdf import Urdf


def check_tree(urdf: Urdf) -> str:
    """Return the root link of a URDF whose joints form one tree.

    Raises:
        UrdfError: A joint names a missing link, joins a link to itself, gives a link a second parent or closes
            a loop; there is no root or more than one.
    """
    parent_joint: dict[str, Joint] = {}
    for joint in urdf.joints.values():
        _check_ends(urdf, joint)
        if joint.child in parent_joint:
            first = parent_joint[joint.child].name
            raise UrdfError(joint.place, f"link {joint.child!r} has two parent joints, {first!r} and {joint.name!r}")
        parent_joint[joint.child] = joint
    _check_loops(urdf, parent_joint)
    roots = [name for name in urdf.links if name not in parent_joint]
    if len(roots) > 1:
        raise UrdfError(Place(urdf.path), f"has {len(roots)} root links, expected one: {listing(roots)}")
    return roots[0]


def _check_ends(urdf: Urdf, joint: Joint) -> None:
    for end, link in (("parent", joint.parent), ("child", joint.child)):
        if link not in urdf.links:
            missing = UnknownNameError("link", link, urdf.links)
            raise UrdfError(joint.place, f"joint {joint.name!r}, {end}: {missing}")
    if joint.parent == joint.child:
        raise UrdfError(joint.place, f"joint {joint.name!r} joins link {joint.parent!r} to itself")


def _check_loops(urdf: Urdf, parent_joint: dict[str, Joint]) -> None:
    rooted: set[str] = set()
    for start in urdf.links:
        path: list[str] = []
        link = start
        while link in parent_joint and link not in rooted:
            if link in path:
                loop = " -> ".join(reversed(path[path.index(link) :]))
                raise UrdfError(parent_joint[link].place, f"joints form a loop: {loop}")
            path.append(link)
            link = parent_joint[link].parent
        rooted.update(path)


def joints_by_parent(urdf: Urdf) -> dict[str, list[Joint]]:
    """Return every link's child joints, in file order."""
    children: dict[str, list[Joint]] = {name: [] for name in urdf.links}
    for joint in urdf.joints.values():
        children[joint.parent].append(joint)
    return children


def links_below(urdf: Urdf, link: str) -> frozenset[str]:
    """Return a link and all that descend from it."""
    children, stack, below = joints_by_parent(urdf), [link], set()
    while stack:
        below.add(name := stack.pop())
        stack.extend(joint.child for joint in children[name])
    return frozenset(below)


def find_chain(urdf: Urdf, base: str, tip: str) -> tuple[Joint, ...]:
    """Return the joints from link `base` to link `tip`, fixed ones included, in order.

    Raises:
        UnknownNameError: No such link.
        UrdfError: `tip` does not descend from `base`, or nothing moves between them, a joint of the chain cannot be
            read or mimics another.
    """
    for name in (base, tip):
        if name not in urdf.links:
            raise UnknownNameError("link", name, urdf.links)
    parent_joint = {joint.child: joint for joint in urdf.joints.values()}
    chain: list[Joint] = []
    link = tip
    while link != base:
        if link not in parent_joint:
            raise UrdfError(urdf.links[tip].place, f"tip {tip!r} does not descend from base {base!r}")
        chain.append(parent_joint[link])
        link = parent_joint[link].parent
    chain.reverse()
    for joint in chain:
        if joint.faults:
            raise joint.faults[0].error
    if not any(joint.kind in MOVING for joint in chain):
        raise UrdfError(urdf.links[tip].place, f"no joint moves between base {base!r} and tip {tip!r}")
    _refuse_mimics(urdf, chain)
    return tuple(chain)


def _refuse_mimics(urdf: Urdf, chain: list[Joint]) -> None:
    for joint in chain:
        if joint.mimic and joint.kind in MOVING:
            master, factor, offset = joint.mimic
            if master not in urdf.joints:
                missing = UnknownNameError("joint", master, urdf.joints)
                raise UrdfError(joint.place, f"joint {joint.name!r}, mimic: {missing}")
            raise UrdfError(
                joint.place,
                f"joint {joint.name!r} of the chain mimics {master!r}, which is not supported: remove the <mimic> tag "
                f"and give its position as a column of its own, q_{joint.name} = {factor:g} q_{master} + {offset:g}",
            )


def tips_by_depth(urdf: Urdf, base: str) -> list[str]:
    """Return the links that may be a tip, those with most moving joints between them and `base` first.

    Among equals the ends come first, then the file's order. Chains with a mimic joint are passed by: their ends are
    fingers, not tools. Those with a joint that cannot be read end before it.
    """
    depth = {base: 0}
    children = joints_by_parent(urdf)
    stack = [base]
    while stack:
        link = stack.pop()
        for joint in children[link]:
            if not (joint.faults or (joint.mimic and joint.kind in MOVING)):
                depth[joint.child] = depth[link] + (joint.kind in MOVING)
                stack.append(joint.child)
    inner = {link for link in depth if any(joint.child in depth for joint in children[link])}
    return sorted((link for link in urdf.links if link in depth), key=lambda link: (-depth[link], link in inner))


def default_tip(urdf: Urdf, base: str) -> str:
    """Return the only leaf link below `base`; raise `UrdfError` listing the leaves when there are several."""
    children = joints_by_parent(urdf)
    stack, leaves = [base], []
    while stack:
        link = stack.pop()
        below = [joint.child for joint in children[link]]
        stack.extend(below)
        if not below:
            leaves.append(link)
    if len(leaves) > 1:
        raise UrdfError(
            Place(urdf.path), f"name the tip link with tip= or --tip, there are {len(leaves)} ends: {listing(leaves)}"
        )
    return leaves[0]
