"""What hangs beside the chain and moves: the weight of branches where rows say that their joints are."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from armflex.conventions import STANDARD_GRAVITY, Array
from armflex.robot import Robot
from armflex.rows.wrench import Wrench


@dataclass(frozen=True, kw_only=True)
class Branch(Wrench):
    """The weight of what hangs on a link of the chain, less what it is where the model holds it; see `branches`.

    It is as a load from outside, but turns with its link as a weight does: it has a potential. The model's own weight
    is that of the branch with its joints where `Robot.locked` has them.

    Attributes:
        force: Zero.
        moment: (3,) or (N, 3) mass times the shift of its centre, in the link's axes [kg m]: what gravity turns by.
        robot: Of which it is a part.
        positions: Of the joints that are given, and of those that follow them, (N,) each or numbers [rad or m].
        gravity: (3,) in base axes [m/s^2]; an arm puts its own there, see `under`.
    """

    robot: Robot
    positions: Mapping[str, Array]
    gravity: Array = field(default_factory=lambda: np.array([0.0, 0.0, -STANDARD_GRAVITY]))

    hangs = True

    @property
    def sizes(self) -> tuple[float, float]:  # pyright: ignore[reportIncompatibleVariableOverride] - cached there
        """Of force [N] and moment [N m], the greatest of all rows."""
        largest = np.linalg.norm(self.moment.reshape(-1, 3), axis=1).max(initial=0.0)
        return 0.0, float(largest * np.linalg.norm(self.gravity))

    def under(self, gravity: Array) -> Branch:
        return replace(self, gravity=gravity)

    def each(self, of: Callable[[Array], Array]) -> Branch:
        if self.rows is None:
            return self
        return _hung(self.robot, self.frame, {name: of(at) for name, at in self.positions.items()}, self.gravity)

    def some(self, rows: int | slice | np.ndarray) -> Branch:
        at = {name: values[rows] for name, values in self.positions.items()}
        return replace(self, force=self.force[rows], moment=self.moment[rows], positions=at)

    def at(self, pose: Array) -> Array:
        moment = np.cross((pose[..., :3, :3] @ self.moment[..., None])[..., 0], self.gravity)
        return np.concatenate([np.zeros(moment.shape), moment], axis=-1)

    def change(self, pose: Array) -> Array:
        """Return the (..., 6, 6) change per motion of the link [m, rad]; its angular part alone is not zero."""
        turned = (pose[..., :3, :3] @ self.moment[..., None])[..., 0]
        change = np.zeros((*turned.shape[:-1], 6, 6))
        # (w x m) x g, column by column of w
        change[..., 3:, 3:] = np.cross(np.cross(np.eye(3), turned[..., None, :]), self.gravity).swapaxes(-1, -2)
        return change

    def by_gravity(self, pose: Array) -> Array:
        """Return the (..., 6, 3) change of the wrench per change of gravity in base axes [m/s^2]."""
        turned = (pose[..., :3, :3] @ self.moment[..., None])[..., 0]
        change = np.zeros((*turned.shape[:-1], 6, 3))
        change[..., 3:, :] = np.cross(turned[..., None, :], np.eye(3)).swapaxes(-1, -2)
        return change

    def links(self, pose: Array) -> dict[str, Array]:
        """Return the (4, 4) pose of every link of a single branch, whose chain link is at a (4, 4) one."""
        poses = {}
        for link, turn, place in _hanging(self.robot, self.frame, self.positions):
            there = np.eye(4)
            there[:3, :3], there[:3, 3] = turn, place
            poses[link] = pose @ there
        return poses


def branches(robot: Robot, given: Mapping[str, ArrayLike]) -> tuple[Branch, ...]:
    """Return what branches weigh with some of their joints elsewhere than `Robot.locked` has them.

    Args:
        robot: The robot.
        given: Positions of moving joints off the chain that hang on it, (N,) each or numbers [rad or m]. What mimics
            one of them follows it.
    """
    at, count = robot.side_positions(given), max((np.size(values) for values in given.values()), default=1)
    single = all(np.ndim(values) == 0 for values in given.values())
    moved = {name: values if single else np.broadcast_to(values, count) for name, values in at.items()}
    stems = dict.fromkeys(robot.stem(name) for name in moved)
    every = ({name: at for name, at in moved.items() if robot.stem(name) == link} for link in stems)
    return tuple(
        _hung(robot, link, positions, robot.gravity) for link, positions in zip(stems, every, strict=True) if link
    )


def _hung(robot: Robot, link: str, positions: Mapping[str, Array], gravity: Array) -> Branch:
    """Return the branches of a link with their joints at some positions."""

    def whole(at: Mapping[str, Array]) -> Array:
        total = np.zeros(3)
        for name, turn, place in _hanging(robot, link, at):
            body = robot.urdf.links[name].inertial
            if body is not None:
                total = total + body.mass * (place + turn @ body.origin)
        return total

    moment = whole(positions) - whole({})
    return Branch(link, np.zeros(moment.shape), moment, "frame", robot=robot, positions=positions, gravity=gravity)


def _hanging(robot: Robot, link: str, positions: Mapping[str, Array]) -> Iterator[tuple[str, Array, Array]]:
    """Yield the links that hang on one of the chain beside it, with their (..., 3, 3) axes and (..., 3) places in it.

    Joints without a position are where `Robot.locked` has them.
    """
    on_chain, stack = {joint.name for joint in robot.chain}, [(link, np.eye(3), np.zeros(3))]
    while stack:
        name, turn, place = stack.pop()
        for joint in robot.urdf.children[name]:
            if joint.name in on_chain:
                continue
            at = np.asarray(positions.get(joint.name, robot.locked.get(joint.name, 0.0)))
            unique, back = np.unique(at, return_inverse=True)  # it mostly stands
            motions = [joint.motion(position) for position in unique.tolist()]
            shift = np.array([motion.translation for motion in motions])[back].reshape(*at.shape, 3)
            turned = np.array([motion.rotation for motion in motions])[back].reshape(*at.shape, 3, 3)
            there, axes = place + turn @ joint.origin, turn @ joint.rotation
            stack.append((joint.child, axes @ turned, there + (axes @ shift[..., None])[..., 0]))
            yield joint.child, *stack[-1][1:]
