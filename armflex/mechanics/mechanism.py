"""Pinocchio's arm with its payload: a tree of links with loops, passive joints, cylinders, gears, and flexures in it.

It is the reference: one configuration at a time, with motion, and whatever is asked about where it rests.

    mechanics.rest(case, row)   where it is; `find_equilibrium` makes an `Equilibrium` of it
    mechanics.closed(q)         positions of the joints without a drive, nothing giving
    mechanics.linear(...)       how it answers to laws, loads, lengths and positions, see `Linear`

With t the flexures' twists, p the positions of joints without a drive and f the forces in what closes, it rests where

    t = law(load),   no torque at p,   gap(t, p) = law of the pin or cylinder (f),

the torque being that of the tree and its springs and A'f, A the gaps' change per body motion. Newton's method solves
all of it together, with G the change of that torque, geometric stiffness of loads, springs and f included:

    | 1 + C G_tt E   C G_tp   C A_t' |
    | G_pt E         G_pp     A_p'   |      C the flexures' tangent, D the closures', E the derivative of exp6
    | A_t E          A_p      -D     |

Its inverse is the closed mechanism's linear response. Closures that nothing can answer to, as the second of two
rotations across its plane that a plane linkage has, are left as they are: see `idle`.
Vectors are those of Pinocchio's velocities with six slots for each closure behind them: of a motion what the pin gives,
of a torque minus the force in it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.errors import ClosureError, ConvergenceError
from armflex.laws import Row
from armflex.mechanics.laws import LawStack
from armflex.mechanics.pinocchio_model import BASE_AXES, FlexModel, Load, LoadCase, frame_jacobian
from armflex.mechanics.spring import Spring
from armflex.mechanics.ties import Ties
from armflex.robot import Corrections, Robot

NONE = np.zeros(0)
CLOSED = 1e-13
"""Largest last step of passive joints [m, rad] to where the loops close."""
ROUNDED = 1e-9
"""Step [m, rad] that is rounding where it does not shrink any more."""
TOLERANCE = 1e-12
"""Largest residual of an equilibrium, of any flexure or gap [m, rad]; of torques as a share of the largest."""
LONGEST = 0.5
"""Step of a passive joint [m, rad] beyond which a position is approached in smaller steps of the drives."""
FINEST = 1.0 / 256.0
"""Share of the way of the drives that is the smallest step."""
ASSEMBLED = 2e-3
"""Gap [m, rad] of rigid links that flexures may be bent to close."""
ALIGNED = 1e-4
"""Misalignment [m, rad] that counts as rounding where nothing can answer to it."""
SINGULAR = 1e-7
"""Least singular value of the closures over the largest, below which passive joints are not held."""
NOTHING = 1e-14
"""Share of the largest compliance that is none."""
NEARLY = 1e-3
"""The same where a loop was not followed to."""
MOST = 50
"""Newton steps."""
DIFFERENCE = 1e-5
"""Largest motion of a joint [m, rad] in a difference quotient."""
EXACT = 1e-14
"""Residual of a chain [m, rad] after which no more step is made."""
HALVINGS = 8
"""Of a Newton step after which the residual does not shrink."""
ROUNDING = 1e-11
"""Residual below which it need not."""
POLISHED = 1e-9
"""Largest last step of an equilibrium [m, rad]: the next would be its square."""


class Closing:
    """A mechanism whose flexures do not give: where its joints without a drive are.

    They are followed from where they were asked last; at first, and where that is no way, from `q0`, or from home where
    none is given.
    """

    def __init__(self, robot: Robot, flex: FlexModel, ties: Ties, corrections: Corrections) -> None:
        self._robot, self._flex, self.ties, self._linkage = robot, flex, ties, robot.linkage
        self._driven, first = len(flex.q_index), sum(len(one.rows) for one in ties.loops)
        self.lengths = slice(first, first + len(ties.cylinders))
        self.offsets = np.array([corrections.joint_offset.get(one.name, 0.0) for one in self._linkage.cylinders])
        self.last: tuple[Array, Array] | None = None if self._linkage else (robot.home, np.zeros(0))

    def configuration(self, q: Array, free: Array) -> Array:
        """Return the model's configuration with drives at (nq,) and the others at (p,) positions."""
        found = self._flex.neutral.copy()
        found[self._flex.q_index], found[self._flex.free_q] = q[: self._driven], free
        return found

    def gaps(self, q: Array, configuration: Array) -> tuple[Array, Array]:
        """Return (m,) gaps and (m, nv) their change per body motion."""
        if not self._linkage:
            return NONE, np.zeros((0, self.ties.model.nv))
        gaps, ways = self.ties.place(configuration)
        gaps[self.lengths] -= q[self._driven :] + self.offsets
        return gaps, ways

    def closed(self, q: Array) -> Array:
        """Return (p,) positions of the joints without a drive [rad or m].

        Raises:
            ClosureError: A loop does not close, or the joints could be anywhere.
        """
        if self.last is not None and (not self._linkage or np.array_equal(self.last[0], q)):
            return self.last[1]
        free, share = (np.zeros(0), 0.0) if self.last is None else self._followed(*self.last, q)
        if share < 1.0:  # rows in no order: the straight way to one may leave what the loops allow
            free = self._first(q)
        if (wrong := self._wrong(q, free, SINGULAR)) is not None:
            raise wrong
        self.last = q.copy(), free
        return free

    def _first(self, q: Array) -> Array:
        """Return where they are at the first row: of what drives lead to from home, and `q0` itself, the nearer.

        Raises:
            ClosureError: The loops do not close there, or neither is a way.
        """
        start, home, settled = self.beginning()
        led, share = (start, 0.0) if settled is None else self._followed(home, settled, q)
        found = [led] if share == 1.0 else []
        if self.given or settled is None:
            straight = self._newton(q, start, jumps=True)
            found += [] if straight is None else [straight]
        if not found:
            raise self._open(q, led, None if settled is None else home + share * (q - home))
        return min(found, key=lambda free: float(np.abs(free - start).max(initial=0.0)))

    @property
    def given(self) -> bool:
        """Whether a joint without a drive has a `q0`."""
        return any(at is not None for at in self._linkage.free.values())

    def beginning(self) -> tuple[Array, Array, Array | None]:
        """Return (p,) `q0` of the joints without a drive, (nq,) drives at home, and (p,) where the loops close there.

        The last is None where they do not.
        """
        start = np.array([at or 0.0 for at in self._linkage.free.values()])
        home = self._robot.home.copy()
        lengths = self.ties.place(self.configuration(home, start))[0][self.lengths]
        home[self._driven :] = lengths - self.offsets
        return start, home, self._newton(home, start, jumps=True)

    def _followed(self, here: Array, free: Array, q: Array) -> tuple[Array, float]:
        """Return where they are when the drives go straight from (nq,) positions to others, and the share of the way.

        That is 1 where the loops close all along, else where they are when the loops close no further.
        """
        done, size = 0.0, 1.0
        while done < 1.0:
            size = min(size, 1.0 - done)
            found = self._newton(here + (done + size) * (q - here), free)
            if found is not None:
                free, done, size = found, min(done + size, 1.0), 2.0 * size
            elif size < FINEST:
                break
            else:
                size *= 0.5
        return free, done

    def _newton(self, q: Array, free: Array, jumps: bool = False) -> Array | None:
        """Return where the gaps are least, None where steps are long or do not shrink, unless it may jump."""
        before = 2.0 * LONGEST
        for _ in range(MOST):
            gaps, ways = self.gaps(q, self.configuration(q, free))
            step = _solved(ways[:, self._flex.free_v], gaps)
            size = float(np.abs(step).max(initial=0.0))
            shrinks = size <= 0.5 * before
            if size <= CLOSED or (size <= ROUNDED and not shrinks):
                return free - step
            if not np.isfinite(size) or not (shrinks or jumps):
                return None
            free, before = free - step * min(1.0, LONGEST / size), size
        return None

    def nearest(self, q: Array, free: Array) -> Array:
        """Return where gaps are least near (p,) positions of the joints without a drive [rad or m]."""
        from scipy.optimize import least_squares  # only where a file with loops is read, or one does not close

        def gaps(at: Array) -> Array:
            return self.gaps(q, self.configuration(q, at))[0]

        return least_squares(gaps, free, xtol=1e-14, ftol=1e-14, gtol=1e-14).x

    def _open(self, q: Array, free: Array, reached: Array | None) -> ClosureError:
        """Return what is said of drives that the loops do not let come so far.

        Args:
            q: (nq,) where the drives should be.
            free: (p,) where the others are when the drives have come as far as the loops close.
            reached: (nq,) how far that is; None where the loops do not close at home.
        """
        misfit = ASSEMBLED
        if reached is not None:
            misfit = ROUNDED + float(np.abs(self.gaps(reached, self.configuration(reached, free))[0]).max(initial=0.0))
        free = self.nearest(q, free)
        if (wrong := self._wrong(q, free, NEARLY, misfit)) is not None:
            return wrong
        name = self.ties.apart(int(np.abs(self.gaps(q, self.configuration(q, free))[0]).argmax()))[0]
        text = f"loop {name!r} closes here, but the way here leads through a singular pose, where its branches meet"
        return ClosureError(f"{text}: give q0 of its passive joints near the first row", name, 0.0)

    def _wrong(self, q: Array, free: Array, least: float, misfit: float = ASSEMBLED) -> ClosureError | None:
        """Return what is said of a gap, or of a joint that the least singular value says is not held.

        The drives are beyond what a loop allows where it gaps by more than its misfit and is singular: where it gaps
        least no joint without a drive can close it further.
        """
        gaps, ways = self.gaps(q, self.configuration(q, free))
        held, largest = ways[:, self._flex.free_v], float(np.abs(gaps).max(initial=0.0))
        sizes, motions = np.linalg.svd(held)[1:]
        holds = held.shape[1] <= len(sizes) and not sizes[-1:] < least * sizes[:1]
        if largest > (ASSEMBLED if holds else misfit):
            return self.unclosed(q, gaps)
        if holds:
            return None
        joint = int(np.abs(motions[-1]).argmax())
        name, _ = self.ties.apart(int(np.abs(held[:, joint]).argmax()))
        text = f"loop {name!r} is singular here: it does not hold passive joint {list(self._linkage.free)[joint]!r}"
        return ClosureError(f"{text}, which could be anywhere", name, largest)

    def unclosed(self, q: Array, gaps: Array) -> ClosureError:
        """Return the error about drives at (nq,) positions where the loops gap by (m,) at least."""
        places = ", ".join(f"{name}={at:.6g}" for name, at in zip(self._robot.joint_names, q, strict=True))
        return gaping(self.ties, gaps, f"cannot close here, at {places}")


def gaping(ties: Ties, gaps: Array, what: str) -> ClosureError:
    """Return the error about the largest of (m,) gaps."""
    row = int(np.abs(gaps).argmax())
    name, angle = ties.apart(row)
    size = float(np.linalg.norm([gap for i, gap in enumerate(gaps) if ties.apart(i) == (name, angle)]))
    shown = f"{1e3 * size:.4g} {'mrad' if angle else 'mm'}"
    return ClosureError(f"loop {name!r} {what}: where it is nearest it gaps by {shown}", name, size)


def _range(matrix: Array) -> Array:
    """Return an orthonormal basis of the motions that a compliance has."""
    left, sizes, _ = np.linalg.svd(matrix)
    return left[:, sizes > NOTHING * sizes[:1].max(initial=0.0)]


def _solved(matrix: Array, values: Array) -> Array:
    """Return the least solution of a small, perhaps overdetermined system."""
    if matrix.shape[0] == matrix.shape[1]:
        with suppress(np.linalg.LinAlgError):
            return np.array(np.linalg.solve(matrix, values), dtype=float)
    return np.asarray(np.linalg.lstsq(matrix, values, rcond=SINGULAR)[0], dtype=float)


@dataclass(frozen=True, eq=False)
class Linear:
    """How a mechanism at rest answers, all of it in body motions of Pinocchio's velocities.

    Attributes:
        by_law: (nv, 6 n) per change of the flexures' laws.
        by_load: (nv, nv) per load on everything.
        by_gap: (nv, m) per length of what closes.
        ways: (m, nv) change of the gaps per body motion.
        turned: (nv, nv) change of the torques per body motion.
        bodily: (6 t, 6 t) body motion of the tree's flexures per change of their twists.
        rows: (m, 6 K) what is closed of the closures' slots.
        lengths: Rows of the cylinders.
    """

    by_law: Array
    by_load: Array
    by_gap: Array
    ways: Array
    turned: Array
    bodily: Array
    rows: Array
    lengths: slice

    @cached_property
    def by_motion(self) -> Array:
        """(nv, nv) per body motion of anything, loads redistributing."""
        return np.eye(len(self.turned)) - self.by_load @ self.turned - self.by_gap @ self.ways


class Rest(NamedTuple):
    """One configuration at rest.

    Attributes:
        displacement: (6,) of the tip [m, rad].
        twists, loads: (n, 6) of the flexures [m, rad] and [N, Nm].
        proven: Whether the arm is proven to stay, and not near buckling.
        closed, flexed: (p,) positions of joints without a drive, nothing giving, and at rest.
        forces: (m,) in what closes.
    """

    displacement: Array
    twists: Array
    loads: Array
    proven: bool = True
    closed: Array = NONE
    flexed: Array = NONE
    forces: Array = NONE


class Placed(NamedTuple):
    """Where an arm rests in Pinocchio's order; see the head of this file.

    Attributes:
        case, row: What acts, and what its laws may know.
        rigid: (nq_model,) configuration [m, rad] with the loops closed and no flexure giving.
        motion: (size,) from there: of flexures exponential coordinates [m, rad].
        torque: (size,) minus the loads on the flexures and in what closes [N, Nm]; joints of the tree have none.
        configuration: (nq_model,) where it is [m, rad].
    """

    case: LoadCase
    row: Row
    rigid: Array
    motion: Array
    torque: Array
    configuration: Array


class _Residual(NamedTuple):
    """What is left of the equations at a motion from the rigid configuration; see `Mechanism.rest`."""

    configuration: Array
    motion: Array
    torque: Array
    ways: Array
    unclosed: Array
    left: Array
    largest: float


class Mechanism:
    """One thread's Pinocchio of an arm with its payload, rigid and flexible; never to be shared between threads."""

    def __init__(
        self,
        rigid: FlexModel,
        flex: FlexModel,
        stack: LawStack,
        pulls: Sequence[Load],
        springs: Sequence[Spring],
        robot: Robot,
        corrections: Corrections,
    ) -> None:
        self.rigid, self.flex, self.stack, self.pulls, self.linkage = rigid, flex, stack, tuple(pulls), robot.linkage
        self.model, self.data, self._rigid_data = flex.model, flex.model.createData(), rigid.model.createData()
        self.tied = Ties(self.model, self.data, robot.linkage, springs, corrections.geometry)
        nominal = Ties(rigid.model, self._rigid_data, robot.linkage)
        self.nominal = Closing(robot, rigid, nominal, Corrections())
        self.true = Closing(robot, flex, self.tied, corrections)
        self.closing = self.true if corrections.move else self.nominal
        places, nq = flex.flexure_v, len(flex.neutral)
        self._of_tree_places = np.flatnonzero(places < self.model.nv)
        self.given = places[self._of_tree_places]
        self._frames = {link: flex.frame(link) for link in flex.links}
        self._same: Array | None = None
        self._yielding: tuple[Array, Array] | None = None
        # Where everything that the engine finds stands in a configuration, a motion and a torque, one behind the other.
        self._ends = nq, nq + flex.size
        self._blank = np.concatenate([flex.neutral, np.zeros(2 * flex.size)])
        placed = flex.q_index, flex.free_q, nq + flex.free_v, nq + places, nq + flex.size + places
        self._placed, self._slots = np.concatenate(placed), -self.tied.rows.T

    def placed(self, case: LoadCase, row: Row, rest: Rest) -> Placed:
        """Return where an arm rests in Pinocchio's order."""
        whole = self._blank.copy()
        closed, driven = rest.closed, case.q[: len(self.flex.q_index)]
        parts = driven, closed, rest.flexed - closed, rest.twists.ravel(), -rest.loads.ravel()
        whole[self._placed] = np.concatenate(parts)
        rigid, motion, torque = np.split(whole, self._ends)
        if len(rest.forces):
            torque[self.model.nv :] = self._slots @ rest.forces
        return Placed(case, row, rigid, motion, torque, self.flexed(rigid, motion))

    def closed(self, q: Array) -> Array:
        """Return (p,) positions of the joints without a drive, the arm as calibrated, nothing giving [rad or m]."""
        return self.closing.closed(q)

    def rigid_configuration(self, q: Array) -> Array:
        """Return the flexible model's configuration at (nq,) positions, the loops closed and every flexure at zero."""
        return self.true.configuration(q, self.closed(q))

    def flexed(self, rigid: Array, motion: Array) -> Array:
        """Return the configuration with flexures at exp6 of the twists in a motion, other joints moved by it."""
        return pin.integrate(self.model, rigid, motion[: self.model.nv])

    def load(self, case: LoadCase) -> Callable[[Array], Array]:
        """Return the map from configurations to (nv,) generalized torques that hold the tree and its springs [N, Nm].

        They are what parents exert on children: minus the loads that deform.
        """
        (v, a), loads = self._velocities(case), (*case.wrenches, *self.pulls)

        def held(configuration: Array) -> Array:
            forces = self._forces(configuration, loads)
            torque = np.array(pin.rnea(self.model, self.data, configuration, v, a, forces))
            if self.tied.springs:
                pin.computeJointJacobians(self.model, self.data, configuration)
                torque += self.tied.sprung()[1]
            return torque

        return held

    def spring_states(self, configuration: Array) -> Array:
        """Return (n_springs, 2) of lengths [m] and tensions [N]."""
        pin.computeJointJacobians(self.model, self.data, configuration)
        return self.tied.sprung()[0]

    def rest(self, case: LoadCase, row: Row, under: str = "") -> tuple[Rest, tuple[float, ...]]:
        """Return where the arm comes to rest, by Newton's method with damped steps on all of it together.

        Beside it stands the largest residual before each step.

        Args:
            case: Where the drives are and what acts.
            row: What its laws may know.
            under: What is said of the loads where it does not come to rest.

        Raises:
            ClosureError: A loop cannot be closed.
            ConvergenceError: No equilibrium was found.
        """
        rigid, load = self.rigid_configuration(case.q), self.load(case)
        idle, t, p = self.idle(case, row, rigid), len(self.given), len(self.flex.free_v)
        motion, forces = np.zeros(self.flex.size), np.zeros(len(self.tied.rows))
        here, last, history = self._residual(case, row, load, rigid, motion, forces, idle), np.inf, list[float]()
        for _ in range(MOST):
            history.append(here.largest)
            if not np.isfinite(here.largest):
                break
            exact = not self.linkage and here.largest <= EXACT
            if here.largest <= TOLERANCE and (last <= POLISHED or exact):
                if np.abs(here.unclosed).max(initial=0.0) > ALIGNED:
                    raise self.true.unclosed(case.q, here.unclosed)
                places, free, ends = self.flex.flexure_v, self.flex.free_q, (rigid, here.configuration)
                twists, loads = here.motion[places].reshape(-1, 6), -here.torque[places].reshape(-1, 6)
                displacement = self.displacement(here.configuration, case.q)
                closed, flexed = (end[free] for end in ends)
                return Rest(displacement, twists, loads, True, closed, flexed, forces), tuple(history)
            bodily = self.exponential_jacobian(here.motion)
            matrix, _, scale, _ = self._matrix(here.configuration, bodily, here.torque, here.ways, case, row, idle)
            left = here.left.copy()
            left[t : t + p] /= scale
            try:
                step = np.linalg.solve(matrix, left)
            except np.linalg.LinAlgError:
                raise ConvergenceError("the tangent is singular: the arm is about to buckle", history) from None
            # Of a chain a step is halved until the residual shrinks or is given up; that of a loop that closes nowhere
            # does not. exp6 wraps around at a turn of pi, and a step must not get there.
            before, start, share = here, here.motion, 1.0
            share = min(1.0, LONGEST / max(float(np.abs(step[: t + p]).max(initial=0.0)), 1e-300))
            for _ in range(HALVINGS):
                motion, pushed = start.copy(), forces - share * scale * step[t + p :]
                motion[self.given] -= share * step[:t]
                motion[self.flex.free_v] -= share * step[t : t + p]
                here = self._residual(case, row, load, rigid, motion, pushed, idle)
                if self.linkage or here.largest < before.largest or before.largest < ROUNDING:
                    break
                share *= 0.5
            forces, last = pushed, share * float(np.abs(step[: t + p]).max(initial=0.0))
        raise ConvergenceError(f"the equilibrium did not converge{under}", history)

    def _residual(
        self,
        case: LoadCase,
        row: Row,
        load: Callable[[Array], Array],
        rigid: Array,
        motion: Array,
        forces: Array,
        idle: Array,
    ) -> _Residual:
        """Return what is left of the equations of the head of this file; pins move as their laws say."""
        nv, places, rows = self.model.nv, self.flex.flexure_v, self.tied.rows
        t, p = len(self.given), len(self.flex.free_v)
        configuration = self.flexed(rigid, motion)
        tree = load(configuration)
        gaps, ways = self.true.gaps(case.q, configuration)
        torque, law = np.concatenate([tree + ways.T @ forces, -rows.T @ forces]), np.zeros(self.flex.size)
        law[places] = self.stack.twists(-torque[places], row)
        unclosed, motion = gaps - rows @ law[nv:], np.append(motion[:nv], law[nv:])
        spare = unclosed - idle @ (idle.T @ forces)
        left = np.concatenate([motion[self.given] - law[self.given], torque[self.flex.free_v], spare])
        sizes = np.abs(left)
        sizes[t : t + p] /= max(1.0, float(np.abs(tree).max(initial=0.0)))
        largest = float(sizes.max(initial=0.0))
        return _Residual(
            configuration, motion, torque, ways, unclosed, left, largest if np.isfinite(largest) else np.inf
        )

    def _compliance(self, torque: Array, row: Row) -> Array:
        """Return the (6 n, 6 n) tangent of the laws."""
        if not self.stack.constant:
            return self.stack.tangent(-torque[self.flex.flexure_v], row)
        if self._same is None:
            self._same = self.stack.tangent(np.zeros(len(self.flex.flexure_v)), row)
        return self._same

    def _matrix(
        self, configuration: Array, bodily: Array, torque: Array, ways: Array, case: LoadCase, row: Row, idle: Array
    ) -> tuple[Array, Array, float, Array]:
        """Return the tangent, the same without loads, the force [N] that one is in both, and `Linear.turned`."""
        given, free, nv = self.given, self.flex.free_v, self.model.nv
        tangent, turned = self._compliance(torque, row), self.stiffness(configuration, case, -torque[nv:])
        t, p, m = len(given), len(free), len(ways)
        if not self.linkage:
            return np.eye(t) + tangent @ turned[np.ix_(given, given)] @ bodily, np.eye(t), 1.0, turned
        own = self._of_tree_places
        compliance, closing = tangent[np.ix_(own, own)], self._closing(tangent)
        scale = 1.0 / max(float(np.abs(tangent).max(initial=0.0)), 1e-9)
        base, loads = np.zeros((t + p + m,) * 2), np.zeros((t + p + m,) * 2)
        base[:t, :t] = np.eye(t)
        base[:t, t + p :] = scale * compliance @ ways[:, given].T
        base[t : t + p, t + p :] = ways[:, free].T
        base[t + p :, :t], base[t + p :, t : t + p] = ways[:, given] @ bodily, ways[:, free]
        base[t + p :, t + p :] = -scale * (closing + idle @ idle.T)
        loads[:t, :t] = compliance @ turned[np.ix_(given, given)] @ bodily
        loads[:t, t : t + p] = compliance @ turned[np.ix_(given, free)]
        loads[t : t + p, :t] = turned[np.ix_(free, given)] @ bodily / scale
        loads[t : t + p, t : t + p] = turned[np.ix_(free, free)] / scale
        return base + loads, base, scale, turned

    def _closing(self, tangent: Array) -> Array:
        """Return the (m, m) change of the gaps per force in them, of pins and cylinders that give."""
        nv, places = self.model.nv, self.flex.flexure_v
        closed = np.flatnonzero(places >= nv)
        rows = self.tied.rows[:, places[closed] - nv]
        return rows @ tangent[np.ix_(closed, closed)] @ rows.T

    def idle(self, case: LoadCase, row: Row, rigid: Array | None = None) -> Array:
        """Return (m, k) directions of the gaps that no passive joint, flexure or pin answers to where it is rigid."""
        if not self.linkage:
            return np.zeros((0, 0))
        gaps, ways = self.true.gaps(case.q, self.rigid_configuration(case.q) if rigid is None else rigid)
        yields, soft = self._ways_to_give(row)
        reached = np.concatenate([ways[:, self.flex.free_v], ways[:, self.given].dot(yields), soft], axis=1)
        sizes, left = np.linalg.eigh(reached.dot(reached.T))  # squares of the singular values, the least first
        idle = left[:, sizes <= ALIGNED * ALIGNED * sizes[-1:]]
        if idle.shape[1] and (np.abs(idle.T @ gaps) > ALIGNED).any():
            raise self.true.unclosed(case.q, idle @ (idle.T @ gaps))
        return idle

    def _ways_to_give(self, row: Row) -> tuple[Array, Array]:
        """Return bases of the motions that flexures in the tree have, and of the gaps that pins and cylinders have."""
        if self._yielding is None or not self.stack.constant:
            tangent, own = self._compliance(np.zeros(self.flex.size), row), self._of_tree_places
            self._yielding = _range(tangent[np.ix_(own, own)]), _range(self._closing(tangent))
        return self._yielding

    def linear(self, at: Placed, idle: Array | None = None) -> Linear:
        """Return how the mechanism answers about where it rests; `idle` as of `idle`, where that is known."""
        given, free, nv, places = self.given, self.flex.free_v, self.model.nv, self.flex.flexure_v
        matrix, _, scale, turned, ways, bodily = self._about(at, idle)
        t, p = len(given), len(free)
        inverse = np.linalg.inv(matrix)[: t + p]
        inverse[:t] = bodily @ inverse[:t]
        inverse[:, t : t + p] /= scale
        own, moved = self._of_tree_places, np.concatenate([given, free])
        by_gap, by_load, by_law = np.zeros((nv, len(ways))), np.zeros((nv, nv)), np.zeros((nv, len(places)))
        by_gap[moved] = inverse[:, t + p :]
        by_load[np.ix_(moved, given)] = inverse[:, :t] @ self._compliance(at.torque, at.row)[np.ix_(own, own)]
        by_load[np.ix_(moved, free)] = inverse[:, t : t + p]
        by_law[np.ix_(moved, own)] = inverse[:, :t]
        closed = np.flatnonzero(places >= nv)
        by_law[:, closed] = by_gap @ self.tied.rows[:, places[closed] - nv]
        return Linear(by_law, by_load, by_gap, ways, turned, bodily, self.tied.rows, self.true.lengths)

    def tangent(self, at: Placed) -> Array:
        """Return what its loads make of the mechanism without them, of eigenvalues above zero where it stays.

        Of a chain it is (6 n, 6 n) `I + C dτ/dtwist`.
        """
        matrix, base, *_ = self._about(at)
        return np.array(np.linalg.solve(base, matrix), dtype=float) if self.linkage else matrix

    def _about(self, at: Placed, idle: Array | None = None) -> tuple[Array, Array, float, Array, Array, Array]:
        """Return what `_matrix` does where the mechanism rests, and `Linear.ways` and `bodily`."""
        idle = self.idle(at.case, at.row) if idle is None else idle
        ways, bodily = self.true.gaps(at.case.q, at.configuration)[1], self.exponential_jacobian(at.motion)
        return *self._matrix(at.configuration, bodily, at.torque, ways, at.case, at.row, idle), ways, bodily

    def held(self, at: Placed) -> Array:
        """Return the (nv,) torque with which drives hold it, forces in closures included."""
        tree = self.load(at.case)(at.configuration)
        return tree - self.tied.place(at.configuration)[1].T @ (self.tied.rows @ at.torque[self.model.nv :])

    def lengths(self, configuration: Array) -> Array:
        """Return (n_cylinders,) lengths between the pins [m]."""
        return self.tied.place(configuration)[0][self.true.lengths]

    def stiffness(self, configuration: Array, case: LoadCase, forces: Array | None = None) -> Array:
        """Return the (nv, nv) change of the torque per body motion of joints and flexures: the geometric stiffness.

        Args:
            configuration: Of the flexible model.
            case: What acts.
            forces: (6 K,) in the closures' slots; None for none.
        """
        model, data, loads, (v, a) = self.model, self.data, (*case.wrenches, *self.pulls), self._velocities(case)
        pushed = self._forces(configuration, loads)
        total = np.array(pin.computeRNEADerivatives(model, data, configuration, v, a, pushed)[0])
        for load in loads:
            # What the load adds by changing in its link's axes when the link moves.
            frame = self._frames[load.frame]
            jacobian = frame_jacobian(model, data, configuration, frame, pin.LOCAL)
            pose = self.frame_pose(configuration, frame)
            local, turn = _in_axes_of(pose, load), np.kron(np.eye(2), pose.rotation)
            change = turn.T @ load.change(pose.homogeneous) @ turn
            change[:, 3:] += np.vstack([pin.skew(local.linear), pin.skew(local.angular)])
            total -= jacobian.T @ change @ jacobian
        if self.tied:
            self.tied.place(configuration)
            self.tied.sprung()
            total += self.tied.stiffness(np.zeros(6 * len(self.tied.names)) if forces is None else forces)
        return total

    def exponential_jacobian(self, motion: Array) -> Array:
        """Return the (6 t, 6 t) right Jacobian of exp6 at the tree's twists: body motion per change of coordinates."""
        whole = pin.dIntegrate(self.model, self.flex.neutral, motion[: self.model.nv], pin.ArgumentPosition.ARG1)
        return whole[np.ix_(self.given, self.given)]

    def tip_jacobian(self, configuration: Array) -> Array:
        """Return the (6, nv) motion of the tip origin in base axes per body motion of joints and flexures."""
        return frame_jacobian(self.model, self.data, configuration, self.flex.tip, BASE_AXES)

    def displacement(self, configuration: Array, q: Array) -> Array:
        """Return the (6,) displacement of the tip from where the rigid arm has it at (nq,) positions [m, rad]."""
        here, there = self.frame_pose(configuration, self.flex.tip), self.rigid_tip_pose(q)
        turned = pin.log3(here.rotation @ there.rotation.T)
        return np.concatenate([here.translation - there.translation, turned])

    def frame_pose(self, configuration: Array, frame: int) -> pin.SE3:
        """Return a frame's pose in the base."""
        pin.forwardKinematics(self.model, self.data, configuration)
        return pin.updateFramePlacement(self.model, self.data, frame).copy()

    def rigid_tip_pose(self, q: Array) -> pin.SE3:
        """Return the tip's pose of the rigid arm at joint positions (nq,), as the controller knows it."""
        pin.forwardKinematics(self.rigid.model, self._rigid_data, self.nominal.configuration(q, self.nominal.closed(q)))
        return pin.updateFramePlacement(self.rigid.model, self._rigid_data, self.rigid.tip).copy()

    def link_poses(self, configuration: Array) -> dict[str, Array]:
        """Return the (4, 4) pose of every link at and beyond the base."""
        pin.framesForwardKinematics(self.model, self.data, configuration)
        return {link: self.data.oMf[frame].homogeneous for link, frame in self._frames.items()}

    def _velocities(self, case: LoadCase) -> Array:
        """Return (2, nv) velocities and accelerations; joints without a drive keep the loops closed, nothing giving."""
        full = np.zeros((2, self.model.nv))
        rates = [np.zeros(len(case.q)) if given is None else np.asarray(given) for given in (case.v, case.a)]
        for into, own in zip(full, rates, strict=True):
            into[self.flex.v_index] = own[: len(self.flex.v_index)]
        if not (self.linkage and case.moves):
            return full
        rigid, free = self.rigid_configuration(case.q), self.flex.free_v
        ways, moved = self.true.gaps(case.q, rigid)[1], np.zeros(len(self.tied.rows))
        for into, own in zip(full, rates, strict=True):
            opened = ways @ into + moved
            opened[self.true.lengths] -= own[len(self.flex.v_index) :]
            into[free] = -_solved(ways[:, free], opened)
            if case.v is not None:  # what the gaps' change with velocity adds to that with acceleration
                size = DIFFERENCE / max(float(np.abs(full[0]).max()), 1e-300)
                sides = (pin.integrate(self.model, rigid, side * size * full[0]) for side in (1.0, -1.0))
                ahead, back = (self.tied.place(side)[1] for side in sides)
                moved = (ahead - back) @ full[0] / (2.0 * size)
        return full

    def _forces(self, configuration: Array, loads: Sequence[Load]) -> pin.StdVec_Force:
        """Return the external force on every Pinocchio joint, in its local frame."""
        forces = pin.StdVec_Force()
        forces.extend([pin.Force.Zero()] * self.model.njoints)
        if loads:
            pin.forwardKinematics(self.model, self.data, configuration)
        for load in loads:
            frame = self._frames[load.frame]
            owner = self.model.frames[frame]
            local = _in_axes_of(pin.updateFramePlacement(self.model, self.data, frame), load)
            forces[owner.parentJoint] = forces[owner.parentJoint] + owner.placement.act(local)
        return forces

    def joint_loads(self, at: Placed) -> Array:
        """Return the (nq, 6) wrench on the structure at every joint, in its child frame [N, Nm]; see `Deflection`."""
        (v, a), case, configuration, torque = self._velocities(at.case), at.case, at.configuration, at.torque
        forces, slots = self._forces(configuration, (*case.wrenches, *self.pulls)), -torque[self.model.nv :]
        if self.tied:
            self.tied.place(configuration)
            self.tied.sprung()
            self.tied.push(slots, forces)
        pin.rnea(self.model, self.data, configuration, v, a, forces)
        joints = {joint.idx_v: joint.id for joint in self.model.joints if joint.nv}
        found = [-self.data.f[joints[at]].vector for at in self.flex.v_index.tolist()]
        first = len(self.linkage.loops)
        pulled = [np.array([slots[6 * (first + k)], 0, 0, 0, 0, 0.0]) for k in range(len(self.linkage.cylinders))]
        return np.array([*found, *pulled]).reshape(-1, 6)


def _in_axes_of(pose: pin.SE3, load: Load) -> pin.Force:
    """Return a load in the axes of its link."""
    wrench = load.at(pose.homogeneous)
    return pin.Force(pose.rotation.T @ wrench[:3], pose.rotation.T @ wrench[3:])
