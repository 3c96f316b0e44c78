"""The front door: a validated robot, and Pinocchio models of it, rigid or with flexures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import pinocchio as pin

from armflex.conventions import STANDARD_GRAVITY, Array, finite_array
from armflex.errors import Flag, JointLimitError, UnknownNameError, UrdfError, did_you_mean
from armflex.robot.formats import read_robot
from armflex.robot.plausible import check_faults, check_masses, check_motion, scope_of
from armflex.robot.urdf import MOVING, Joint, Link, Urdf, check_tree, find_chain

TCP = "tcp"
"""Link that a tool ends in, which no file has; numbered where one does."""


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

    def check_motion(self) -> None:
        """Raise `UrdfError` where inertial loads cannot be computed; see `armflex.robot.plausible.check_motion`."""
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
    def moving(self) -> tuple[Joint, ...]:
        """The chain's moving joints, in order."""
        return tuple(joint for joint in self.chain if joint.kind in MOVING)

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the chain's moving joints: the order of q."""
        return tuple(joint.name for joint in self.moving)

    @cached_property
    def lower(self) -> Array:
        """(nq,) lower limits [rad or m]."""
        return np.array([joint.lower for joint in self.moving])

    @cached_property
    def upper(self) -> Array:
        """(nq,) upper limits [rad or m]."""
        return np.array([joint.upper for joint in self.moving])

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
) -> Robot:
    """Read and validate a robot; nothing reaches Pinocchio before it has passed.

    Args:
        urdf: Path of a URDF, or of xacro, MJCF or SDF, see `armflex.robot.formats`, or what was read of another file;
            meshes are never opened.
        tip: Link whose motion is reported; the only leaf when not given.
        base: Link in whose frame results are meant; the root when not given. What lies above it is left out.
        gravity: (3,) in base axes [m/s^2]; standard gravity along -z when not given.
        strict: Refuse unknown tags on the chain, and motion with impossible inertias, instead of flagging them.
        allow_massless: Accept moving links without mass, with a flag.
        locked: Positions of moving joints off the chain [rad or m]; see `lock_side_joints` for those not given.
        tool: T_link_tool of a tool centre point that the file does not have, beyond the link `tip`: the tip is then a
            link of its own, "tcp", without mass.
        mount: (3, 3) how the base stands in a level world whose z is up; gravity follows where it is not given.

    Raises:
        UrdfError: The file is no robot that can be computed with, or the chain or what it carries cannot be read; file
            and line are named. What else is wrong with the file is among the robot's `flags`.
        UnknownNameError: `tip`, `base` or a locked joint does not exist.
        JointLimitError: A joint is locked outside its limits.
    """
    document = urdf if isinstance(urdf, Urdf) else read_robot(Path(urdf), strict)
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
    down = level if gravity is None else finite_array(gravity, "gravity", (3,))
    scope = scope_of(document, chain)
    found = check_faults(document, scope)
    held, mimics = lock_side_joints(document, base, chain, locked or {})
    flags = [*document.flags, *found, *check_masses(document, scope, allow_massless)]
    size = float(np.linalg.norm(down))
    if not 9.5 < size < 10.1:
        flags.append(Flag("gravity", f"gravity is {size:g} m/s^2, expected about {STANDARD_GRAVITY}"))
    elif mount is None and down[2] > 0.5 * size:
        text = f"gravity {down.tolist()} points along +z of the base: upside down on purpose?"
        flags.append(Flag("gravity", text))
    return Robot(document, base, chain[-1].child, chain, down, held, (*flags, *mimics), strict, stands, tool_joint)


def with_tool(urdf: Urdf, link: str, tool: pin.SE3) -> tuple[Urdf, str]:
    """Return a robot with a link more, fixed to another where a tool ends, and the name of the joint there."""
    taken = {*urdf.links, *urdf.joints}
    name = next(name for name in (TCP, *(f"{TCP}_{i}" for i in range(2, len(taken) + 3))) if name not in taken)
    place, axis, limits = urdf.links[link].place, np.array([1.0, 0.0, 0.0]), (-np.inf, np.inf, np.inf, np.inf)
    joint = Joint(name, "fixed", link, name, tool.translation, tool.rotation, axis, *limits, None, place)
    links = urdf.links | {name: Link(name, None, (), place)}
    return replace(urdf, links=links, joints=urdf.joints | {name: joint}), name


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
