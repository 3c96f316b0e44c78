"""The links and joints of a robot's file as they are met, whatever its format: they become those of a URDF."""

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.errors import Flag, Place, UrdfError
from armflex.robot.urdf import MAX_LINKS, RESERVED, WIDEST, Fault, Inertial, Joint, Link, Urdf

FREE = (-np.inf, np.inf, np.inf, np.inf)
"""Lower and upper limit, effort and velocity of a joint of which nothing is said."""


class FileTree:
    """The links and joints of a file as they are met."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.links: dict[str, Link] = {}
        self.joints: dict[str, Joint] = {}
        self.flags: list[Flag] = []
        self.gravity: tuple[float, float, float] | None = None
        self.declared: dict[str, Any] = {}

    def link(self, name: str, inertial: Inertial | None, line: int = 0, between: bool = False) -> None:
        """Add a link."""
        place = Place(self.path, line)
        if name in self.links:
            raise UrdfError(place, f"second link named {name!r}; the first is at {self.links[name].place}")
        if len(self.links) >= MAX_LINKS:
            raise UrdfError(Place(self.path), f"has more than the {MAX_LINKS} links allowed")
        self.links[name] = Link(name, inertial, (), place, between=between)

    def joint(
        self,
        name: str,
        kind: str,
        ends: tuple[str, str],
        at: pin.SE3,
        rest: pin.SE3,
        axis: Array,
        limits: tuple[float, float, float, float] = FREE,
        line: int = 0,
        problem: str = "",
        mimic: tuple[str, float, float] | None = None,
    ) -> None:
        """Add a joint from a parent's to a child's link: its frame in the parent's, the child's frame in its own.

        A `problem` is an error only where the joint is one of the chain.
        """
        place, (parent, child) = Place(self.path, line), ends
        if name in self.joints:
            raise UrdfError(place, f"second joint named {name!r}; the first is at {self.joints[name].place}")
        if RESERVED.fullmatch(name):
            raise UrdfError(place, f"joint {name!r}: this name is taken by the mechanics, choose another")
        if limits[0] > limits[1]:
            raise UrdfError(place, f"joint {name!r}: lower limit {limits[0]:g} exceeds upper limit {limits[1]:g}")
        if kind == "revolute" and WIDEST < max(abs(limits[0]), abs(limits[1])) < np.inf:
            text = f"joint {name!r}: limits {limits[0]:g} to {limits[1]:g} rad exceed two turns: degrees?"
            self.flags.append(Flag("limit_in_degrees", f"{place}: {text}"))
        faults = (Fault(UrdfError(place, problem), "chain", "it is held as it stands"),) if problem else ()
        if kind == "fixed" or problem:
            at, rest = at * rest, pin.SE3.Identity()
        between = child
        if not rest.isIdentity(1e-12):
            between = f"{child}/{name}"
            self.link(between, None, line, between=True)
            self.joint(f"{name}/{child}", "fixed", (between, child), rest, pin.SE3.Identity(), axis, FREE, line)
        pose = (at.translation.copy(), at.rotation.copy())
        self.joints[name] = Joint(name, kind, parent, between, *pose, axis, *limits, mimic, place, faults)

    def robot(self, name: str) -> Urdf:
        """Return all of them.

        Raises:
            UrdfError: There is none.
        """
        if not self.links:
            raise UrdfError(Place(self.path), f"{name!r} has no links")
        shared = {"translated": True, "gravity": self.gravity, "declared": self.declared}
        return Urdf(name, self.path, self.links, self.joints, tuple(self.flags), **shared)


def rotation_of(quaternion: Array) -> Array:
    """Return the (3, 3) rotation of w x y z."""
    w, vector = float(quaternion[0]), quaternion[1:]
    size = float(np.linalg.norm(vector))
    return pin.exp3(2.0 * np.arctan2(size, w) * (vector / size if size else np.eye(3)[0]))
