"""The instrument that measures the tip: where it stands, how each session set it up, and what it looks at."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin

from armflex.conventions import RESOLUTION, Array


@dataclass(frozen=True)
class Instrument:
    """Frame and target of a measurement.

    Attributes:
        pose: T_instrument_base.
        sessions: (6,) shift [m] and rotation vector [rad] of the frame in each session: p is read as R p + shift, in
            which the instrument may stand anywhere; a session that is not named has none.
        target: (3,) measured point in the tip frame [m].
        scale: Share by which its distances are too long.
        mounting: (3,) rotation vector of the axes whose orientation is read, in the tip frame [rad].
        targets: (6,) shift [m] and rotation vector [rad] of a target that was mounted anew, in each session, in tip
            axes, beyond `target` and `mounting`; a session that is not named has none.
        campaigns: Names of campaigns that were fitted together, in each of which the instrument stood elsewhere and the
            target was mounted anew: each has a frame among `sessions`, the first one none but zero, and may have a
            target among `targets`. Frame and target of a session 'campaign/session' come after those.
    """

    pose: pin.SE3 = field(default_factory=pin.SE3.Identity)
    sessions: Mapping[str, Array] = field(default_factory=dict)
    target: Array = field(default_factory=lambda: np.zeros(3))
    scale: float = 0.0
    mounting: Array = field(default_factory=lambda: np.zeros(3))
    targets: Mapping[str, Array] = field(default_factory=dict)
    campaigns: tuple[str, ...] = ()

    def campaign(self, session: str) -> str:
        """Return the campaign that a session is of, '' where it is of none."""
        name = session.partition("/")[0]
        return name if name in self.campaigns else ""

    def within(self, session: str) -> tuple[str, ...]:
        """Return whose frames a session is read in, one after the other: its campaign's, if it has one, and its own."""
        campaign = self.campaign(session)
        return (session,) if campaign in ("", session) else (campaign, session)

    def reads_in(self, frame: str, sessions: Sequence[str]) -> np.ndarray:
        """Return (N,) whether each row's session is read in the frame of a session or campaign."""
        return _of_each(lambda name: np.array(frame in self.within(name)), sessions).astype(bool)

    def target_in(self, sessions: Sequence[str]) -> Array:
        """Return the (N, 3) measured point in the tip frame [m] of each row's session."""
        return self.target + _of_each(self._remounted, sessions)[:, :3]

    def mounting_in(self, sessions: Sequence[str]) -> Array:
        """Return the (N, 3) rotation vector of the target in the tip frame [rad] of each row's session."""
        turned = pin.exp3(self.mounting)
        anew = {session: self._remounted(session)[3:] for session in set(sessions)}
        mountings = {
            session: pin.log3(pin.exp3(turn) @ turned) if turn.any() else self.mounting
            for session, turn in anew.items()
        }
        return np.array([mountings[session] for session in sessions]).reshape(-1, 3)

    def _remounted(self, session: str) -> Array:
        """Return the (6,) shift [m] and rotation vector [rad] of the target in a session, beyond what all have."""
        step = np.zeros(6)
        for target in (self.targets[part] for part in self.within(session) if part in self.targets):
            step = remounted(step, target) if step.any() else target
        return step

    def in_base(self, tip: Array, sessions: Sequence[str] = ()) -> Array:
        """Return the (N, 3) target in the base frame [m] for (N, 4, 4) tip poses, in each row's session where given."""
        target = self.target_in(sessions) if len(sessions) else np.broadcast_to(self.target, (len(tip), 3))
        return tip[:, :3, 3] + np.einsum("nij,nj->ni", tip[:, :3, :3], target)

    def seen(self, points: Array) -> Array:
        """Return (N, 3) points of the base in the instrument frame [m], sessions left out."""
        return (1.0 + self.scale) * (points @ self.pose.rotation.T + self.pose.translation)

    def in_session(self, points: Array, sessions: Sequence[str]) -> Array:
        """Return (N, 3) points of the instrument frame as each session has it [m]."""
        shifts = _of_each(lambda name: self.session(name).translation, sessions)
        return np.einsum("nij,nj->ni", self.session_turns(sessions), points) + shifts

    def with_session(self, name: str, motion: Array) -> Instrument:
        """Return the instrument with a (6,) shift [m] and rotation vector [rad] after the frame that a session has.

        It is of the points as they are read in the session; a session that has no frame gets this.
        """
        return replace(self, sessions={**self.sessions, name: motion_of(frame_of(motion) * self.frame(name))})

    def session(self, name: str) -> pin.SE3:
        """Return the motion of points of the instrument frame to where a session has them [m]."""
        first, *then = [self.frame(part) for part in self.within(name)]
        return then[0] * first if then else first

    def frame(self, name: str) -> pin.SE3:
        """Return what a session's own frame is of that, or a campaign's."""
        return frame_of(self.sessions.get(name, np.zeros(6)))

    def readings(self, tip: Array, sessions: Sequence[str]) -> Array:
        """Return the (N, 3) positions of the target that the instrument would read [m], for (N, 4, 4) tip poses."""
        return self.in_session(self.seen(self.in_base(tip, sessions)), sessions)

    def rotations(self, tip: Array, sessions: Sequence[str]) -> Array:
        """Return the (N, 3, 3) orientations of the target that the instrument would read, dimensionless."""
        mounted = np.array([pin.exp3(vector) for vector in self.mounting_in(sessions)]).reshape(-1, 3, 3)
        return self.session_turns(sessions) @ self.axes(tip) @ mounted

    def axes(self, poses: Array) -> Array:
        """Return the (N, 3, 3) axes of (N, 4, 4) poses in the instrument frame, dimensionless, sessions left out."""
        return self.pose.rotation @ poses[:, :3, :3]

    def session_turns(self, sessions: Sequence[str]) -> Array:
        """Return the (N, 3, 3) rotations of each row's session, dimensionless."""
        return _of_each(lambda name: self.session(name).rotation, sessions).reshape(-1, 3, 3)


def _of_each(what: Callable[[str], Array], sessions: Sequence[str]) -> Array:
    """Return (N, ...) what each row's session has, asked once of each."""
    number = {name: i for i, name in enumerate(dict.fromkeys(sessions))}
    each = np.array([what(name) for name in number])
    return each[[number[name] for name in sessions]]


def frame_of(motion: Array) -> pin.SE3:
    """Return the frame whose shift [m] and rotation vector [rad] a (6,) motion has."""
    return pin.SE3(pin.exp3(motion[3:]), motion[:3])


def motion_of(frame: pin.SE3) -> Array:
    """Return the (6,) shift [m] and rotation vector [rad] of a frame."""
    return np.concatenate([frame.translation, pin.log3(frame.rotation)])


def remounted(target: Array, motion: Array) -> Array:
    """Return the (6,) shift [m] and rotation vector [rad] of a target that is shifted and turned once more."""
    turn = pin.log3(pin.exp3(motion[3:]) @ pin.exp3(target[3:]))
    return np.concatenate([target[:3] + motion[:3], turn])


def twist_per_value(motion: Array) -> Array:
    """Return the (6, 6) twist [m, rad] of points moved by a (6,) shift and rotation vector, per change of those.

    Points go from p to exp(w) p + t; the twist is of their space, about its origin. It is one where the motion is none.
    """
    turning = pin.Jexp3(-motion[3:])  # the left Jacobian of the exponential
    change = np.eye(6)
    change[:3, 3:], change[3:, 3:] = pin.skew(motion[:3]) @ turning, turning
    return change


SAME = 1e-4
"""Change of weights below which they are those of the round before."""

ROUNDS = 20
"""Of weights in a rigid fit: a lost beam then counts as little as it will."""


def fit_frame(points: Array, measured: Array) -> pin.SE3:
    """Return the T_instrument_base that takes (N, 3) points in the base to measured positions [m] best."""
    turn, shift, _ = rigid_fit(points, measured)
    return pin.SE3(turn, shift)


def rigid_fit(points: Array, measured: Array, counted: np.ndarray | None = None) -> tuple[Array, Array, Array]:
    """Return the (..., 3, 3) rotation, (..., 3) shift [m] and (...) weighted RMS [m] of the best rigid fit.

    Each round is Kabsch's (1976) with the weights of the one before: lost beams are weighed down, as beyond twice the
    median distance a point counts as one at that.

    Args:
        points: (..., N, 3) points [m], of as many fits as the other axes have.
        measured: (..., N, 3) where they were seen [m].
        counted: (..., N) whether a point is there at all, in fits that have fewer; where not given all are.
    """
    stacked = np.broadcast_shapes(points.shape, measured.shape)[:-1]
    there_at_all = np.ones(stacked) if counted is None else np.broadcast_to(counted, stacked).astype(float)
    weights = there_at_all
    for number in range(ROUNDS):
        share = weights / weights.sum(axis=-1, keepdims=True)
        middle, there = share[..., None, :] @ points, share[..., None, :] @ measured
        nominal, seen = points - middle, measured - there
        left, _, right = np.linalg.svd((seen * share[..., None]).swapaxes(-1, -2) @ nominal)
        left[..., 2] *= np.linalg.det(left @ right)[..., None]
        turn = left @ right
        length = np.linalg.norm(seen - nominal @ turn.swapaxes(-1, -2), axis=-1)
        before, limit = weights, 2.0 * np.maximum(middle_length(length, there_at_all), RESOLUTION)
        weights = there_at_all * np.minimum(1.0, limit[..., None] / np.maximum(length, RESOLUTION)) ** 2
        if number == ROUNDS - 1 or np.abs(weights - before).max(initial=0.0) < SAME:
            break
    shift = there - middle @ turn.swapaxes(-1, -2)
    return turn, shift[..., 0, :], np.sqrt((share * length**2).sum(axis=-1))


def middle_length(lengths: Array, counted: np.ndarray) -> Array:
    """Return the (...) medians of the (..., N) lengths that count; of so few, sooner than numpy's."""
    ordered, count = np.sort(np.where(counted > 0.0, lengths, np.inf), axis=-1), (counted > 0.0).sum(axis=-1)
    places = np.stack([(count - 1) // 2, count // 2], axis=-1)
    return np.take_along_axis(ordered, places, axis=-1).mean(axis=-1)


def fit_mounting(axes: Array, rotation: Array) -> Array:
    """Return the rotation vector of the target in the tip frame that fits best (chordal mean; Hartley 2013).

    Args:
        axes: (N, 3, 3) axes of the tip in the instrument frame.
        rotation: (N, 3) rotation vectors read [rad].
    """
    turns = [measured.T @ pin.exp3(vector) for measured, vector in zip(axes, rotation, strict=True)]
    left, _, right = np.linalg.svd(np.sum(turns, axis=0))
    return pin.log3(left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right)
