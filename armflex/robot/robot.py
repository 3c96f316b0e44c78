"""The front door: a robot file in, a validated robot out, or an error that names file and line.

*Masses and inertias*: the impossible is refused where it bears on the chain, the unlikely flagged. Pinocchio reads a
missing or garbled mass as 0 kg and takes any inertia matrix; what it would compute from them is wrong without a word.
What a load comes from, mass and centre of mass, counts on the chain and on whatever it carries; the rest of the file
counts for nothing. Moments of inertia have no part in an arm at rest: impossible ones are flagged, and refused where
the arm is asked to move with them. What is fixed to a moving link weighs and turns with it as one body, so it is the
sum that must be possible: files of good robots fix sensors and frames to their links with the inertia of a point, or
with none worth the name.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from armflex.conventions import STANDARD_GRAVITY, Array, finite_array
from armflex.errors import Flag, JointLimitError, Place, UnknownNameError, UrdfError, did_you_mean, listing
from armflex.robot.formats import is_xacro, read_other
from armflex.robot.linkage import Linkage
from armflex.robot.urdf import FARTHEST, MOVING, Inertial, Joint, Link, Urdf, Visual, parse_xml, read_urdf

TCP = "tcp"
"""Link that a tool ends in, which no file has; numbered where one does."""

DENSITY_BAND = (20.0, 23000.0)
"""kg/m^3 of the drawn volume: from a sheet-metal box to solid tungsten."""

MILLIMETRES = 10.0
"""How many times the arm's reach a length is that must be in millimetres; one beyond the reach itself is doubted."""


MASS_RATIO = 400.0
"""A link this many times lighter or heavier than the median suggests tonnes or grams."""


@dataclass(frozen=True)
class Robot:
    """A validated robot: the chain from `base` to `tip`, and what hangs on it.

    Attributes:
        urdf: The file as data.
        base: Link in whose frame q, loads and results are meant.
        tip: Link whose motion is reported.
        chain: Joints from base to tip, fixed ones included.
        gravity: (3,) in base axes [m/s^2].
        locked: Positions of the moving joints off the chain, which weigh but do not move [rad or m].
        flags: What is doubtful about the file.
        strict: Whether impossible inertias are refused where the arm is asked to move.
        mount: (3, 3) how the base stands in a level world, whose z is up; the unit matrix where nobody says.
        tool_joint: Name of the fixed joint beyond the declared tip link that leads to `tip`, None without a tool.
        linkage: What is joined once more, and the joints without a drive.
    """

    urdf: Urdf
    base: str
    tip: str
    chain: tuple[Joint, ...]
    gravity: Array
    locked: Mapping[str, float] = field(default_factory=dict)
    flags: tuple[Flag, ...] = ()
    strict: bool = True
    mount: Array = field(default_factory=lambda: np.eye(3))
    tool_joint: str | None = None
    linkage: Linkage = field(default_factory=Linkage)

    def check_motion(self) -> None:
        """Raise `UrdfError` where inertial loads cannot be computed; see `check_motion`."""
        if self._stuck:
            raise self._stuck

    @cached_property
    def _stuck(self) -> UrdfError | None:
        try:
            check_motion(self.urdf, scope_of(self.urdf, self.chain), self.chain, self.locked, self.strict)
        except UrdfError as error:
            return error
        return None

    @cached_property
    def points(self) -> bool:
        """Whether masses of links are points: moments of inertia were not declared."""
        inertials = (link.inertial for link in self.urdf.links.values() if link.inertial is not None)
        return any(inertial.point and not inertial.distributed for inertial in inertials)

    @cached_property
    def pointlike(self) -> tuple[str, ...]:
        """Names of the links with a mass and no moments of inertia."""
        inertials = {name: link.inertial for name, link in self.urdf.links.items() if link.inertial is not None}
        concentrated = {name: inertial for name, inertial in inertials.items() if not inertial.distributed}
        return tuple(name for name, inertial in concentrated.items() if inertial.mass and not inertial.inertia.any())

    @cached_property
    def jointed(self) -> tuple[Joint, ...]:
        """The joints that move, the chain's first: driven, passive and following ones."""
        return tuple(joint for joint in self.places if joint.kind in MOVING)

    @cached_property
    def places(self) -> tuple[Joint, ...]:
        """The joints where something may give: those of the chain, in order, and those beside it that move."""
        return (*self.chain, *self.linkage.beside)

    @cached_property
    def swept(self) -> tuple[Joint, ...]:
        """The joints of the chain that move, in order: those without a drive are among them."""
        return tuple(joint for joint in self.chain if joint.kind in MOVING)

    @cached_property
    def frames(self) -> tuple[str, ...]:
        """Names of all that a frame of a link places: the joints that move, and the pins of loops and cylinders."""
        return (*(joint.name for joint in self.jointed), *self.linkage.pins)

    @cached_property
    def moving(self) -> tuple[Joint, ...]:
        """The driven joints, the chain's first, in order; cylinders last."""
        driven = (joint for joint in self.jointed if joint.name not in self.linkage.free)
        return (*driven, *(cylinder.joint for cylinder in self.linkage.cylinders))

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the driven joints: the order of q."""
        return tuple(joint.name for joint in self.moving)

    @cached_property
    def lower(self) -> Array:
        """(nq,) lower limits [rad or m]."""
        return np.array([joint.lower for joint in self.moving])

    @cached_property
    def upper(self) -> Array:
        """(nq,) upper limits [rad or m]."""
        return np.array([joint.upper for joint in self.moving])

    def stem(self, joint: str) -> str | None:
        """Return the link of the chain that a joint off the chain hangs on, None where it hangs on none."""
        on_chain, link = {self.base, *(joint.child for joint in self.chain)}, self.urdf.joints[joint].parent
        above = {joint.child: joint.parent for joint in self.urdf.joints.values()}
        while link not in on_chain and link in above:
            link = above[link]
        return link if link in on_chain else None

    def side_positions(self, given: Mapping[str, ArrayLike]) -> dict[str, Array]:
        """Return given () or (N,) positions of joints off the chain [rad or m], and of what mimics one of them."""
        positions = {name: np.array(at, dtype=float) for name, at in given.items()}
        while more := {name: at for name, at in self._followers(positions).items() if name not in positions}:
            positions |= more
        return positions

    def stray(self, given: Mapping[str, ArrayLike]) -> tuple[int, str] | None:
        """Return the first row of `side_positions` with a joint elsewhere than what it mimics puts it, and a text."""
        at = self.side_positions(given)
        for name, wanted in self._followers(at).items():
            # To which positions are mostly shown and written down [rad or m]: 0.01 degrees, 0.1 mm
            for i in np.flatnonzero(np.abs(at[name] - wanted) > 1e-4)[:1]:
                actual, there = np.ravel(at[name])[i], np.ravel(wanted)[i]
                master = self.urdf.joints[name].mimic[0]  # type: ignore[index]
                text = f"joint {name!r} is at {actual:.6g}, but mimics {master!r}, which puts it at {there:.6g}"
                return int(i), f"{text}: leave it out"
        return None

    def _followers(self, at: Mapping[str, Array]) -> dict[str, Array]:
        """Return where the joints off the chain that mimic some belong, those being at () or (N,) positions."""
        joints = [self.urdf.joints[name] for name in self.locked]
        return {
            joint.name: np.clip(joint.mimic[1] * at[joint.mimic[0]] + joint.mimic[2], joint.lower, joint.upper)
            for joint in joints
            if joint.mimic and joint.mimic[0] in at
        }

    @cached_property
    def home(self) -> Array:
        """(nq,) positions [rad or m] where none are asked for: 0 where the limits allow it, else their middle."""
        nearest = np.clip(0.0, self.lower, self.upper)
        bounded = (nearest != 0.0) & np.isfinite(self.lower) & np.isfinite(self.upper)
        nearest[bounded] = 0.5 * self.lower[bounded] + 0.5 * self.upper[bounded]
        return nearest

    @cached_property
    def reach(self) -> float:
        """Length of the chain from its first turning joint to the tip [m]."""
        turning = next((i for i, joint in enumerate(self.chain) if joint.kind in ("revolute", "continuous")), 0)
        return float(sum(np.linalg.norm(joint.origin) for joint in self.chain[turning + 1 :]))

    def times_reach(self, length: float) -> float:
        """Return how many times as long as the arm reaches a length [m] is: one of a rod may be, `MILLIMETRES` is not.

        Small arms count as a metre.
        """
        return length / max(self.reach, 1.0)


@dataclass(frozen=True)
class Site:
    """Where something gives: outboard of a joint's motion, in its child frame; the base when `joint` is None.

    With `before` it is the end of the link that the joint ends: inboard of the joint's motion, in its origin frame.
    """

    name: str
    joint: str | None
    before: bool = False


@dataclass(frozen=True)
class Corrections:
    """Constant errors of the kinematics, found by calibration.

    Attributes:
        joint_offset: What each joint's true position exceeds the reported one by [rad or m].
        geometry: (6,) twist of each joint's origin frame, in its own axes, or of a pin's on its link, in the link's
            [m, rad]; see `Linkage.pins`.
        bodies: (4,) extra mass of a link [kg], and how far its centre of mass is from the declared one [m].
    """

    joint_offset: Mapping[str, float] = field(default_factory=dict)
    geometry: Mapping[str, Array] = field(default_factory=dict)
    bodies: Mapping[str, Array] = field(default_factory=dict)

    @property
    def move(self) -> bool:
        """Whether the rigid arm stands elsewhere than without them."""
        return any(self.joint_offset.values()) or any(np.any(twist) for twist in self.geometry.values())

    def body(self, link: str, inertial: Inertial | None) -> pin.Inertia | None:
        """Return the true body of a link, None for one without mass."""
        extra = self.bodies.get(link, np.zeros(4))
        nominal = pin.Inertia.Zero()
        if inertial is not None:
            # Pinocchio wants exact symmetry and no negative diagonal: rounding would break both, and
            # `Robot.check_motion` refuses what is negative by more.
            turned = inertial.turned
            np.fill_diagonal(turned, np.diag(turned).clip(0.0))
            nominal = pin.Inertia(inertial.mass, inertial.origin, turned)
        mass = nominal.mass + float(extra[0])
        if mass <= 0.0:
            return None
        return pin.Inertia(mass, nominal.lever + extra[1:], nominal.inertia)

    def frame(self, joint: Joint) -> pin.SE3:
        """Return the true origin frame of a joint in its nominal one."""
        return pin.exp6(pin.Motion(np.asarray(self.geometry.get(joint.name, np.zeros(6)))))

    def zero(self, joint: Joint) -> pin.SE3:
        """Return the true zero of a moving joint in its origin frame."""
        return joint.motion(self.joint_offset.get(joint.name, 0.0))


def load_robot(
    urdf: str | Path | Urdf,
    tip: str | None = None,
    base: str | None = None,
    gravity: Array | None = None,
    *,
    strict: bool = True,
    allow_massless: bool = False,
    locked: Mapping[str, float] | None = None,
    tool: pin.SE3 | None = None,
    mount: Array | None = None,
    loops: bool = False,
    xacro_arguments: Mapping[str, str] | None = None,
) -> Robot:
    """Read and validate a robot; nothing reaches Pinocchio before it has passed.

    Args:
        urdf: Path of a URDF, or of xacro or MJCF, see `armflex.robot.formats`, or what was read of another file;
            meshes are never opened.
        tip: Link whose motion is reported; the only leaf when not given.
        base: Link in whose frame results are meant; the root when not given. What lies above it is left out.
        gravity: (3,) in base axes [m/s^2]; when not given that of an MJCF, else standard gravity along -z.
        strict: Refuse unknown tags on the chain, and motion with impossible inertias, instead of flagging them.
        allow_massless: Accept moving links without mass, with a flag.
        locked: Positions of moving joints off the chain [rad or m]; see `lock_side_joints` for those not given.
        tool: T_link_tool of a tool centre point that the file does not have, beyond the link `tip`: the tip is then a
            link of its own, "tcp", without mass.
        mount: (3, 3) how the base stands in a level world whose z is up; gravity follows where it is not given.
        loops: Whether whoever asks makes loops and springs of those that an MJCF declares; they are refused otherwise.
        xacro_arguments: By name, where they are to be others than the file's own.

    Raises:
        UrdfError: The file is no robot that can be computed with, or the chain or what it carries cannot be read; file
            and line are named. What else is wrong with the file is among the robot's `flags`.
        UnknownNameError: `tip`, `base` or a locked joint does not exist.
        JointLimitError: A joint is locked outside its limits.
    """
    if isinstance(urdf, Urdf):
        document = urdf
    else:
        path = Path(urdf)
        element = parse_xml(path)
        if element.tag in ("mujoco", "sdf") or is_xacro(path, element):
            document = read_other(path, element, strict, loops, xacro_arguments)
        else:
            document = read_urdf(path, strict, element)
            if xacro_arguments:
                raise UrdfError(Place(path), f"is no xacro file, and has no arguments ({listing(xacro_arguments)})")
    root = check_tree(document)
    base = base or root
    if base not in document.links:
        raise UnknownNameError("link", base, document.links)
    chain = find_chain(document, base, tip or None)
    tool_joint = None
    if tool is not None:
        document, tool_joint = with_tool(document, chain[-1].child, tool)
        chain = (*chain, document.joints[tool_joint])
    stands = np.eye(3) if mount is None else finite_array(mount, "mount", (3, 3))
    level = stands.T @ np.array([0.0, 0.0, -STANDARD_GRAVITY])
    turned, moving = document.turned(base)
    if mount is None and document.gravity is not None and moving is None:
        level = turned.T @ np.array(document.gravity)
    down = level if gravity is None else finite_array(gravity, "gravity", (3,))
    scope = scope_of(document, chain)
    faults = check_faults(document, scope)
    held, mimics = lock_side_joints(document, base, chain, locked or {})
    flags = [*document.flags, *faults, *check_origins(document), *check_masses(document, scope, allow_massless)]
    size = float(np.linalg.norm(down))
    if not 9.5 < size < 10.1:
        flags.append(Flag("gravity", f"gravity is {size:g} m/s^2, expected about {STANDARD_GRAVITY}"))
    elif mount is None and down[2] > 0.5 * size:
        text = f"gravity {down.tolist()} points along +z of the base: upside down on purpose?"
        flags.append(Flag("gravity", text))
    following = following_of(document, chain)
    linkage = Linkage(followers=following)
    flags = (*flags, *mimics)
    return Robot(document, base, chain[-1].child, chain, down, held, flags, strict, stands, tool_joint, linkage)


def with_tool(urdf: Urdf, link: str, tool: pin.SE3) -> tuple[Urdf, str]:
    """Return a robot with a link more, fixed to another where a tool ends, and the name of the joint there."""
    taken = {*urdf.links, *urdf.joints}
    name = next(name for name in (TCP, *(f"{TCP}_{i}" for i in range(2, len(taken) + 3))) if name not in taken)
    place, axis, limits = urdf.links[link].place, np.array([1.0, 0.0, 0.0]), (-np.inf, np.inf, np.inf, np.inf)
    joint = Joint(name, "fixed", link, name, tool.translation, tool.rotation, axis, *limits, None, place)
    links = urdf.links | {name: Link(name, None, (), place)}
    return replace(urdf, links=links, joints=urdf.joints | {name: joint}), name


def check_tree(urdf: Urdf) -> str:
    """Return the root link of a URDF whose joints form one tree.

    Raises:
        UrdfError: A joint names a missing link, joins a link to itself, gives a link a second parent or closes
            a loop; there is no root or more than one.
    """
    parents: dict[str, Joint] = {}
    for joint in urdf.joints.values():
        for end, link in (("parent", joint.parent), ("child", joint.child)):
            if link not in urdf.links:
                missing = UnknownNameError("link", link, urdf.links)
                raise UrdfError(joint.place, f"joint {joint.name!r}, {end}: {missing}")
        if joint.parent == joint.child:
            raise UrdfError(joint.place, f"joint {joint.name!r} joins link {joint.parent!r} to itself")
        first = parents.setdefault(joint.child, joint).name
        if first != joint.name:
            raise UrdfError(joint.place, f"link {joint.child!r} has two parent joints, {first!r} and {joint.name!r}")
    try:
        TopologicalSorter({child: [joint.parent] for child, joint in parents.items()}).prepare()
    except CycleError as error:
        loop = error.args[1][1:]
        raise UrdfError(parents[loop[0]].place, f"joints form a loop: {' -> '.join(loop)}") from None
    roots = [name for name in urdf.links if name not in parents]
    if len(roots) > 1:
        raise UrdfError(Place(urdf.path), f"has {len(roots)} root links, expected one: {listing(roots)}")
    return roots[0]


def find_chain(urdf: Urdf, base: str, tip: str | None) -> tuple[Joint, ...]:
    """Return the joints from link `base` to link `tip`, fixed ones included, in order.

    Args:
        urdf: A checked tree.
        base: Link that the chain begins at.
        tip: Link that it ends at; the only leaf below `base` when not given.

    Raises:
        UnknownNameError: No such link.
        UrdfError: `tip` is one of several, does not descend from `base`, or nothing moves between them; a joint of the
            chain cannot be read, or follows none of it.
    """
    if tip is None:
        leaves = [link for link in urdf.below(base) if not urdf.children[link]]
        if len(leaves) > 1:
            text = f"name the tip link with tip= or --tip, there are {len(leaves)} ends: {listing(leaves)}"
            raise UrdfError(Place(urdf.path), text)
        tip = leaves[0]
    if tip not in urdf.links:
        raise UnknownNameError("link", tip, urdf.links)
    chain: list[Joint] = []
    link = tip
    while link != base:
        if link not in urdf.parents:
            raise UrdfError(urdf.links[tip].place, f"tip {tip!r} does not descend from base {base!r}")
        chain.insert(0, urdf.parents[link])
        link = urdf.parents[link].parent
    for joint in chain:
        if joint.faults:
            raise joint.faults[0].error
    if not any(joint.kind in MOVING for joint in chain):
        raise UrdfError(urdf.links[tip].place, f"no joint moves between base {base!r} and tip {tip!r}")
    following_of(urdf, chain)
    return tuple(chain)


def following_of(urdf: Urdf, chain: Sequence[Joint]) -> dict[str, tuple[str, float, float]]:
    """Return the joints of a chain that follow others of it by <mimic>: whom, by what factor and from what offset.

    One that follows no joint that moves with the chain, or itself, is refused.
    """
    moving = {joint.name: joint for joint in chain if joint.kind in MOVING}
    mimics = {name: joint.mimic for name, joint in moving.items() if joint.mimic}
    for name, (master, factor, offset) in mimics.items():
        if master not in urdf.joints:
            missing = UnknownNameError("joint", master, urdf.joints)
            raise UrdfError(moving[name].place, f"joint {name!r}, mimic: {missing}")
        if master not in moving:
            text = f"joint {name!r} of the chain mimics {master!r}, which is not one that moves between base and tip: "
            remedy = f"remove that and give a column of its own, q_{name} = {factor:g} q_{master} + {offset:g}"
            raise UrdfError(moving[name].place, text + remedy)
        way = [name]
        while way[-1] in mimics:
            way.append(mimics[way[-1]][0])
            if way[-1] in way[:-1]:
                raise UrdfError(moving[name].place, f"joint {name!r} mimics itself: {' mimics '.join(way)}")
    return mimics


def lock_side_joints(
    urdf: Urdf, base: str, chain: tuple[Joint, ...], locked: Mapping[str, float]
) -> tuple[dict[str, float], tuple[Flag, ...]]:
    """Return the position of every moving joint off the chain [rad or m], and the flags: they weigh but do not move.

    Each is held as asked; else, where it mimics another such joint, as that one says; else at zero or the nearest
    limit. A joint that mimics one of the chain should move with it, as a counterweight does, so it is flagged.

    Raises:
        UnknownNameError: A joint to be locked is not off the chain.
        JointLimitError: A joint is locked outside its limits.
        UrdfError: A joint is locked that cannot be read.
    """
    on_chain, weighing = {joint.name for joint in chain}, set(urdf.below(base))
    side = {joint.name: joint for joint in urdf.joints.values() if joint.kind in MOVING and joint.name not in on_chain}
    for name in locked:
        if name not in side:
            raise UnknownNameError("joint off the chain", name, side)
    asked = {}
    for name, value in locked.items():
        joint = side[name]
        if joint.faults:
            raise joint.faults[0].error
        asked[name] = float(finite_array(value, f"locked {name}", ()))
        if not joint.lower <= asked[name] <= joint.upper:
            limits = f"[{joint.lower:g}, {joint.upper:g}]"
            raise JointLimitError(f"joint {name!r} is locked at {asked[name]:g}, outside its limits {limits}")
    held, flags = {}, []
    for name, joint in side.items():
        wanted = _wanted(urdf, side, asked, joint)
        held[name] = float(np.clip(wanted or 0.0, joint.lower, joint.upper))
        if wanted != held[name] and joint.mimic and joint.child in weighing:
            master = joint.mimic[0]
            missing = "" if master in urdf.joints else f", which is no joint{did_you_mean(master, urdf.joints)}"
            text = f"joint {name!r} off the chain mimics {master!r}{missing} but is held at {held[name]:g}, "
            text += "and its weight with it; name it in [robot.locked] if that is meant"
            flags.append(Flag("locked_mimic", f"{joint.place}: {text}"))
    return held, tuple(flags)


def _wanted(urdf: Urdf, side: Mapping[str, Joint], asked: Mapping[str, float], joint: Joint) -> float | None:
    """Return where a joint wants to be, None where that depends on the chain or on itself."""
    factor, offset = 1.0, 0.0
    for _ in range(len(side) + 1):
        if joint.name in asked:
            return factor * asked[joint.name] + offset
        if joint.name not in side:
            return offset if joint.kind == "fixed" else None
        if joint.mimic is None:
            return factor * float(np.clip(0.0, joint.lower, joint.upper)) + offset
        master, multiplier, shift = joint.mimic
        if master not in urdf.joints:
            return None
        joint, factor, offset = urdf.joints[master], factor * multiplier, factor * shift + offset
    return None


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
    """Return a flag for all that cannot be read and does not matter to the chain, saying what is done then."""
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


def check_origins(urdf: Urdf) -> Iterator[Flag]:
    """Yield the flags about joints further from their parent links than those of robots in metres, in any format."""
    for joint in urdf.joints.values():
        if (distance := float(np.linalg.norm(joint.origin))) > FARTHEST:
            text = f"joint {joint.name!r}: origin is {distance:g} m from its parent link: millimetres?"
            yield Flag("origin_in_millimetres", f"{joint.place}: {text}")


def check_masses(urdf: Urdf, scope: Scope, allow_massless: bool) -> tuple[Flag, ...]:
    """Return the flags about masses and inertias of a checked tree.

    Raises:
        UrdfError: A moving body of the chain has no mass (unless `allow_massless`, or it is a mere crossing of axes),
            the CoM of what the chain carries lies more than ten link lengths away.
    """
    flags: list[Flag] = []
    impossible: dict[str, str] = {}
    moving = [joint for joint in urdf.joints.values() if joint.kind in MOVING]
    moved = {joint.child for joint in moving}
    for link in urdf.links.values():
        if (inertial := link.inertial) is None:
            continue
        if inertial.mass > 0.0:
            flags += _check_link(urdf, link, inertial, link.name in scope.carried)
            if not inertial.point and (problem := _impossible(inertial.inertia)):
                impossible[link.name] = f"{inertial.place}: link {link.name!r}: {problem}"
        elif link.name in moved and link.name in scope.chain and not allow_massless:
            text = f"link {link.name!r}: mass is {inertial.mass:g} kg, expected more than 0"
            raise UrdfError(inertial.place, text + ("" if inertial.mass else "; or set allow_massless = true"))
        elif inertial.inertia.any():  # a frame written as a link: real files fix them to others
            text = f"{inertial.place}: link {link.name!r} has an inertia but no mass; it is left out"
            flags.append(Flag("massless_inertia", text))
    masses = {}
    for joint in moving:
        link, (masses[joint.child], inertia) = urdf.links[joint.child], _body(urdf, joint.child)
        if masses[link.name] and (link.inertial is None or (inertia != link.inertial.inertia).any()):
            if link.name not in impossible and inertia.any() and (problem := _impossible(inertia)):
                impossible[link.name] = f"{link.place}: link {link.name!r} and what is fixed to it: {problem}"
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
    if impossible:
        (_, text), *others = impossible.items()
        likewise = f"; likewise {listing(name for name, _ in others)}" if others else ""
        text += f"{likewise}; where an arm rests does not depend on them, how it moves does"
        flags.append(Flag("impossible_inertia", text))
    return tuple(flags)


def _check_link(urdf: Urdf, link: Link, inertial: Inertial, carried: bool) -> list[Flag]:
    """Return the flags about one body; raise where the CoM of one that is carried is far beyond it."""
    where, mass = inertial.place, inertial.mass
    flags = []
    # The roots are taken first, because masses may be next to nothing.
    gyration = float(np.sqrt(max(np.trace(inertial.inertia), 0.0) / 2.0) / np.sqrt(mass))
    # A length that the link's CoM should not exceed much: its joints, travel, shapes, or 2 % of the robot.
    whole = sum(float(np.linalg.norm(joint.origin)) for joint in urdf.joints.values())
    body = {link.name}  # with what is fixed to it
    while (
        fixed := {joint.child for joint in urdf.joints.values() if joint.kind == "fixed" and joint.parent in body}
        - body
    ):
        body |= fixed
    near = [
        float(np.linalg.norm(joint.origin))
        + (max(abs(joint.lower), abs(joint.upper)) if joint.kind == "prismatic" else 0.0)
        for joint in urdf.joints.values()
        if joint.parent in body or joint.child == link.name
    ]
    shapes = [float(np.linalg.norm(visual.pose[:3, 3])) + max(visual.size) for visual in link.visuals]
    size = max(0.02 * whole, min(gyration, whole or gyration), *near, *shapes, 1e-3)
    distance = float(np.linalg.norm(inertial.origin))
    text = f"link {link.name!r}: CoM is {distance:.4g} m from the link frame, the link's size is {size:.3g} m"
    if distance > max(10.0 * size, whole) and carried:
        raise UrdfError(where, f"{text}: millimetres?")
    if distance > 4.0 * size:
        doubt = ": millimetres?" if distance > 10.0 * size else ""
        flags.append(Flag("com_outside", f"{where}: {text}{doubt}"))
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


def _impossible(inertia: Array, least: float = 0.0) -> str:
    """Return what no body's (3, 3) inertia is; a `least` share of the largest moment may be missing to a needle's 0."""
    moments = np.linalg.eigvalsh(inertia)
    moments[np.abs(moments) < 1e-12 * np.abs(moments).max()] = 0.0  # rounding
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
                raise UrdfError(urdf.links[joint.child].place, f"{whole}: {problem}; motion needs possible ones")


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
    if len(parts) == 1:  # its own CoM is that of all but for rounding
        return mass, parts[0][2]
    for weight, position, about in parts:
        arm = pin.skew(position - center)
        inertia += about - weight * arm @ arm
    return mass, inertia
