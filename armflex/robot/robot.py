"""The front door: a validated robot, and Pinocchio models of it, rigid or with flexures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from armflex.conventions import STANDARD_GRAVITY, Array, finite_array
from armflex.errors import Flag, UnknownNameError, UrdfError
from armflex.robot.elements import MOVING, Joint
from armflex.robot.locking import lock_side_joints
from armflex.robot.plausible import check_faults, check_masses, check_motion, scope_of
from armflex.robot.tree import check_tree, default_tip, find_chain
from armflex.robot.urdf import Urdf, read_urdf


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
    """

    urdf: Urdf
    base: str
    tip: str
    chain: tuple[Joint, ...]
    gravity: Array
    locked: Mapping[str, float] = field(default_factory=dict)
    flags: tuple[Flag, ...] = ()
    strict: bool = True

    def check_motion(self) -> None:
        """Raise `UrdfError` where inertial loads cannot be computed; see `armflex.robot.plausible.check_motion`."""
        if self._stuck:
            raise self._stuck

    @cached_property
    def _stuck(self) -> UrdfError | None:
        scope = scope_of(self.urdf, self.base, self.chain)
        try:
            check_motion(self.urdf, scope, self.chain, self.locked, self.strict)
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
        """(nq,) positions where none are asked for: 0 where the limits allow it, else the middle between them."""
        inside = (self.lower <= 0.0) & (self.upper >= 0.0)
        nearest = np.clip(0.0, self.lower, self.upper)
        bounded = np.isfinite(self.lower) & np.isfinite(self.upper)
        middle = np.where(
            bounded, 0.5 * np.where(bounded, self.lower, 0.0) + 0.5 * np.where(bounded, self.upper, 0.0), 0
        )
        return np.where(inside, 0.0, np.where(bounded, middle, nearest))

    @cached_property
    def reach(self) -> float:
        """Length of the chain from its first turning joint to the tip [m]."""
        turning = next((i for i, joint in enumerate(self.chain) if joint.kind in ("revolute", "continuous")), 0)
        return float(sum(np.linalg.norm(joint.origin) for joint in self.chain[turning + 1 :]))


def load_robot(
    urdf: str | Path,
    tip: str | None = None,
    base: str | None = None,
    gravity: Array | None = None,
    *,
    strict: bool = True,
    allow_massless: bool = False,
    locked: Mapping[str, float] | None = None,
) -> Robot:
    """Read and validate a URDF; nothing reaches Pinocchio before it has passed.

    Args:
        urdf: Path of the file; meshes are never opened.
        tip: Link whose motion is reported; the only leaf when not given.
        base: Link in whose frame results are meant; the root when not given. What lies above it is left out.
        gravity: (3,) in base axes [m/s^2]; standard gravity along -z when not given.
        strict: Refuse unknown tags on the chain, and motion with impossible inertias, instead of flagging them.
        allow_massless: Accept moving links without mass, with a flag.
        locked: Positions of moving joints off the chain [rad or m]; see `lock_side_joints` for those not given.

    Raises:
        UrdfError: The file is no robot that can be computed with, or the chain or what it carries cannot be read; file
            and line are named. What else is wrong with the file is among the robot's `flags`.
        UnknownNameError: `tip`, `base` or a locked joint does not exist.
        JointLimitError: A joint is locked outside its limits.
    """
    document = read_urdf(Path(urdf), strict)
    root = check_tree(document)
    base = base or root
    if base not in document.links:
        raise UnknownNameError("link", base, document.links)
    chain = find_chain(document, base, tip or default_tip(document, base))
    down = np.array([0.0, 0.0, -STANDARD_GRAVITY]) if gravity is None else finite_array(gravity, "gravity", (3,))
    scope = scope_of(document, base, chain)
    found = check_faults(document, scope)
    held, doubts = lock_side_joints(document, base, chain, locked or {})
    masses = check_masses(document, scope, allow_massless)
    flags = (*document.flags, *found, *masses, *check_gravity(down), *doubts)
    return Robot(document, base, chain[-1].child, chain, down, held, flags, strict)


def check_gravity(gravity: Array) -> tuple[Flag, ...]:
    """Return a flag where gravity is not about 9.81 m/s^2 downwards in the base frame."""
    size = float(np.linalg.norm(gravity))
    if not 9.5 < size < 10.1:
        return (Flag("gravity", f"gravity is {size:g} m/s^2, expected about {STANDARD_GRAVITY}"),)
    if gravity[2] > 0.5 * size:
        return (Flag("gravity", f"gravity {gravity.tolist()} points along +z of the base: upside down on purpose?"),)
    return ()
