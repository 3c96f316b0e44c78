"""Where a loaded arm comes to rest in many rows: the engine, and an outer iteration for what the engine does not know.

The engine settles arms exactly whose laws are affine in the load, harden or are networks, under wrenches that are dead
or follow their links. Any other curved law is replaced by its tangent at the present load, and any other load that
depends on its link's pose by its present wrench. Both are renewed until they stop changing, in two to four rounds.
Every law and every load is asked once a round for all rows.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.errors import UnsupportedError, naming
from armflex.laws import Row
from armflex.laws.row import MASS
from armflex.mechanics.certificate import SHARE, StabilityBound
from armflex.mechanics.engine.binding import NO_LINKS, NO_WRENCHES, Engine, OneRow
from armflex.mechanics.engine.tables import NO_CHANGES, Frames, Laws, State, Tree
from armflex.mechanics.laws import LawStack, RowLaws
from armflex.mechanics.loaded import LoadedArm, Payload, Structure
from armflex.mechanics.mechanism import Rest
from armflex.mechanics.pinocchio_model import build_model
from armflex.parallel import in_pieces
from armflex.rows.wrench import Wrench, check_rows, same_objects

AT_ONCE = 8192
"""Rows that are asked about together: their arrays stay near the processor, and memory does not grow with N."""

ROUNDS = 16
"""A row whose curved laws or posed loads are not settled after so many is left to the reference."""

SETTLED = 3e-14
"""Change between two rounds: of all flexures' twists [m, rad], and of a wrench by its size."""

UNMOVED = np.eye(4)

Pushed = tuple[np.ndarray, Array, Array]
"""Links, (1 or N, L, 9) wrenches and (0 or N, L, 6, 6) changes of them; see `Pushes`."""

NOT_PUSHED: Pushed = (NO_LINKS, NO_WRENCHES, NO_CHANGES)


class Solution(NamedTuple):
    """Where an arm rests in N rows; fields are those of `Rest`, and `load_factor` (N,) as of `Equilibrium`.

    Loads of no rows are not asked for: they follow from the twists.
    """

    displacement: Array
    loads: Array
    twists: Array
    load_factor: Array
    closed: Array
    flexed: Array
    forces: Array

    @classmethod
    def empty(cls, tree: Tree, count: int, loads: bool = True) -> Solution:
        """Return room for the solution in some rows."""
        n, p, m = len(tree.flexures), tree.passive, len(tree.rows)
        shapes = (count, 6), (count if loads else 0, n, 6), (count, n, 6), (count,), (count, p), (count, p), (count, m)
        found = cls(*map(np.empty, shapes))
        found.load_factor[:] = np.inf
        return found

    def some(self, rows: slice | np.ndarray) -> Solution:
        """Return some of the rows, as views where they are a slice."""
        return Solution(*(part[rows] if len(part) else part for part in self))

    def row(self, i: int) -> Rest:
        """Return a copy of one of the rows."""
        displacement, loads, twists, _, closed, flexed, forces = self
        here = displacement[i].copy(), twists[i].copy(), loads[i].copy()  # one by one: a control loop waits for it
        return Rest(*here, True, closed[i].copy(), flexed[i].copy(), forces[i].copy())

    def put(self, i: int, rest: Rest) -> None:
        """Fill one of the rows."""
        self.displacement[i], self.twists[i], self.closed[i] = rest.displacement, rest.twists, rest.closed
        self.flexed[i], self.forces[i] = rest.flexed, rest.forces
        if len(self.loads):
            self.loads[i] = rest.loads


class Pushes:
    """Wrenches on a loaded arm, and what its effects put on its links, in numbers for the engine.

    Attributes:
        links: (L, 3) element of a chain that each link is fixed to, how many flexures move it, and whether its wrench
            follows it: is in the element's axes.
        posed: Numbers of the loads that depend on their links' poses otherwise.
        same: (1 or N, L, 9) `wrenches` of the others.
        rows: How many rows they are for, None where each is the same in any.
    """

    def __init__(
        self,
        loaded: LoadedArm,
        wrenches: Sequence[Wrench] = (),
        before: Pushes | None = None,
    ) -> None:
        self._wrenches, self._loads = wrenches, (*wrenches, *loaded.arm.pulls)
        self.rows, loads = next((one.rows for one in wrenches if one.rows is not None), None), self._loads
        self._acting = [(load.frame, load.follows, load.dead or load.follows) for load in loads]
        if before is not None and before._acting == self._acting:  # at the same links in the same axes
            self._tree, self._frames = before._tree, before._frames
            self.links, self.posed = before.links, before.posed
        else:
            self._tree, frames = loaded.tree, loaded.link_frames
            self._frames = frames.some([frames.names.index(load.frame) for load in loads])
            elements = self._frames.places[0]
            inboard = [self._tree.flexures_inboard(int(element)) for element in elements]
            following = [follows for _, follows, _ in self._acting]
            self.links = np.array([elements, inboard, following], dtype=np.int64).reshape(3, -1).T.copy()
            self.posed = [j for j, (_, _, same) in enumerate(self._acting) if not same]
        same = [(j, load.at(UNMOVED)) for j, load in enumerate(loads) if j not in self.posed]
        each = max((len(load) for _, load in same if load.ndim == 2), default=1)
        self.same = np.zeros((each, len(loads), 9))
        self.same[:, :, :3] = self._frames.numbers[:, 9:]
        for j, load in same:
            if self._acting[j][1]:
                load = load @ np.kron(np.eye(2), self._frames.numbers[j, :9].reshape(3, 3).T)
            self.same[:, j, 3:] = load

    def some(self, rows: np.ndarray) -> Pushes:
        """Return the loads in (M,) of the rows that they are for."""
        if self.rows is None:
            return self
        found, count = copy(self), len(self._wrenches)
        found._wrenches = [one if one.rows is None else one.some(rows) for one in self._wrenches]
        found._loads, found.rows = (*found._wrenches, *self._loads[count:]), len(rows)
        found.same = self.same if len(self.same) == 1 else self.same[rows]
        return found

    def wrenches(self, q: Array, twists: Array | None = None, state: State | None = None) -> Array:
        """Return (1 or N, L, 9) where on its element each acts [m], and the wrench [N, Nm] in base or element axes.

        Args:
            q: (N, nq) joint positions [rad or m].
            twists: (N, n, 6) of the flexures, zero where not given.
            state: Of an arm with loops; see `responded`.

        Raises:
            ShapeError: The loads are for other rows.
        """
        check_rows(self._wrenches, len(q))
        if not self.posed:
            return self.same
        poses = self._poses(q, twists, state)
        found = np.broadcast_to(self.same, (len(q), *self.same.shape[1:])).copy()
        for j in self.posed:
            found[:, j, 3:] = self._loads[j].at(poses[:, j])
        return found

    def changes(self, q: Array, twists: Array, state: State | None = None) -> Array:
        """Return the (N, L, 6, 6) change of posed wrenches with their links' motion; no rows where there are none."""
        if not self.posed:
            return NO_CHANGES
        poses, found = self._poses(q, twists, state), np.zeros((len(q), len(self._loads), 6, 6))
        for j in self.posed:
            found[:, j] = self._loads[j].change(poses[:, j])
        return found

    def _poses(self, q: Array, twists: Array | None, state: State | None) -> Array:
        at = np.zeros((len(q), len(self._tree.flexures), 6)) if twists is None else twists
        return responded(self._tree, ("poses",), q, at, bodies=self._frames, state=state)["poses"]

    def at(self, q: Array, twists: Array, state: State | None = None) -> Pushed:
        """Return links, wrenches and their changes where the arm is."""
        return self.links, self.wrenches(q, twists, state), self.changes(q, twists, state)


def turned(before: Array, after: Array) -> Array:
    """Return the (N,) greatest change of a (1 or N, L, 9) wrench, by its size."""
    size = np.maximum(np.linalg.norm(after[..., 3:], axis=-1), 1e-300)
    return (np.linalg.norm(after[..., 3:] - before[..., 3:], axis=-1) / size).max(axis=-1, initial=0.0)


def responded(
    tree: Tree,
    what: Collection[str],
    q: Array,
    twists: Array,
    laws: Laws | None = None,
    pushed: Pushed = NOT_PUSHED,
    **where: Any,
) -> dict[str, Array]:
    """Return what is asked about an arm that is flexed in N rows, all of it in one pass.

    Args:
        tree: The arm.
        what, q, twists, where: As of `Engine.respond`.
        laws: Of its flexures; none are needed for poses and loads.
        pushed: What pulls at its links.
    """
    engine = Engine.of(tree)
    engine.set_loads(*pushed, len(q))
    if laws is not None:
        engine.set_laws(laws, len(q))
    found = engine.respond(what, q, twists, **where)
    engine.forget()
    return found


@dataclass(frozen=True, eq=False)
class ManyRows:
    """Some rows of one payload, linearised where they rest.

    Attributes:
        loaded: The arm with the payload.
        rows: (M,) their numbers.
        pushed: What pulls at its links.
        laws: Of its flexures there, those that are not known by terms expanded about their loads.
        state: See `responded`.
    """

    loaded: LoadedArm
    rows: np.ndarray
    pushed: Pushed
    laws: Laws
    state: State | None = None

    def among(self, number: np.ndarray) -> ManyRows:
        """Return those of its rows that have a (N,) number, under these numbers; -1 is none."""
        own = np.flatnonzero(number[self.rows] >= 0)

        def of(array: Array) -> Array:
            return array[own] if len(array) > 1 or not len(self.rows) else array

        links, wrenches, changes = self.pushed
        laws, state = self.laws.some(own, len(self.rows)), self.state
        at_rest = None if state is None else (of(state[0]), of(state[1]), of(state[2]))
        return ManyRows(self.loaded, number[self.rows[own]], (links, of(wrenches), of(changes)), laws, at_rest)

    @cached_property
    def place(self) -> slice | np.ndarray:
        """Where its rows are among all, as a slice where they follow each other: that is not copied."""
        return next(chunks(self.rows, len(self.rows) + 1), slice(0, 0))

    def asked(
        self, what: Collection[str], end: str | None, q: Array, twists: Array, into: Mapping[str, Array] | None = None
    ) -> dict[str, Array]:
        """Return what is asked about the rows; see `responded`, of whose bodies these are the links.

        Args:
            what: As there.
            end: The link that is meant, None for the tip.
            q, twists: (M, nq) and (M, n, 6) of joints and flexures.
            into: As there.
        """
        loaded, linkage = self.loaded, self.loaded.arm.robot.linkage
        links, behind = loaded.link_frames, len(linkage.closures) + len(linkage.pins)
        at = None if end is None else links.some([links.names.index(end)])
        frames = {"sites": loaded.sites, "bodies": links, "end": at, "behind": behind, "into": into}
        return responded(loaded.tree, what, q, twists, **frames, **self._acting)

    def by_gravity(self, end: str | None, q: Array, twists: Array) -> Array:
        """Return the (M, 6, 3) motion of an end per change of gravity, which acts on the centres of all masses."""
        elements, links = self.loaded.tree.elements[:-1], self.loaded.link_frames
        at = None if end is None else links.some([links.names.index(end)])
        turns, places = np.tile(np.eye(3).ravel(), (len(elements), 1)), np.arange(len(elements))
        centres = Frames((), np.array([places, places]), np.concatenate([turns, elements[:, 16:19]], axis=1))
        found = responded(self.loaded.tree, ("motions",), q, twists, bodies=centres, end=at, **self._acting)["motions"]
        return np.einsum("nfba,f->nba", found[..., :3], elements[:, 15])

    @property
    def _acting(self) -> dict[str, Any]:
        return {"laws": self.laws, "pushed": self.pushed, "state": self.state}


class RowSolver:
    """Solves one arm with one payload under its weight and some loads, in rows of some thousand at a time.

    Attributes:
        limits: (2, nq) positions between which the bound holds.
    """

    def __init__(self, loaded: LoadedArm, wrenches: Sequence[Wrench] = (), before: Pushes | None = None) -> None:
        if loaded.tied:
            raise UnsupportedError("the fixed point knows no springs and no loops: see `loop_rows`")
        self._loaded, self._chain, self._nominal = loaded, loaded.tree, loaded.nominal
        self.pushes, self._wrenches = Pushes(loaded, wrenches, before), wrenches
        self.limits = np.array(loaded.arm.bounds)

    def rest(self, row: Row, into: Solution) -> np.ndarray:
        """Put into `into` where the arm rests in some rows; return (N,) whether it is proven that it stays there."""
        laws = RowLaws(self._loaded.arm.stack, row)
        plain = not (laws.curved or laws.bent or self.pushes.posed) and bool(self.bound and self.bound.proven)
        if not (plain or len(into.loads)):  # to solve the rows, or to prove that the arm stays
            into = into._replace(loads=np.empty_like(into.twists))
        return self.proven(row, laws, into, self.bound, self.solve(row, laws, into))

    @cached_property
    def bound(self) -> StabilityBound | None:
        """How far the loads can soften the arm with its own laws; None where nobody can say beforehand."""
        return self._loaded.stability_bound and self._loaded.stability_bound.under(self._wrenches)

    def solve(self, row: Row, laws: RowLaws, into: Solution, motion: Array | None = None) -> np.ndarray:
        """Put into `into` where the arm rests in some rows; return (N,) whether it converged.

        Args:
            row: Positions and covariates.
            laws: Of the arm at these rows, or others: what follows is then about those.
            into: To be filled.
            motion: (N, 2, nq) speeds and accelerations of the joints, None where the arm stands.
        """
        q = np.ascontiguousarray(row.q)
        if laws.curved or self.pushes.posed:
            fine = self._in_rounds(q, laws, into, motion)
        else:
            fine = self._run(q, laws, self.pushes.wrenches(q), into, motion)
        if self._nominal is not None:
            true, nominal = tips_of(self._chain, q), tips_of(self._nominal, q)
            into.displacement[:] = displaced_from(into.displacement, true, nominal)
        return fine

    def _in_rounds(self, q: Array, laws: RowLaws, into: Solution, motion: Array | None) -> np.ndarray:
        pushed = self.pushes.wrenches(q)
        self._run(q, laws, pushed, into, motion, exact=False)  # for the loads on the rigid arm
        if laws.curved:
            laws.expand(into.loads)
        fine, converged = self._run(q, laws, pushed, into, motion), np.zeros(len(q), dtype=bool)
        for _ in range(ROUNDS):
            # What is too large is left alone: here it would only make numbers that overflow.
            twists, wrenches = (np.where(fine[:, None, None], part, 0.0) for part in (into.twists, into.loads))
            before, pushed = pushed, self.pushes.wrenches(q, twists)
            moved = laws.expand(wrenches, slopes=False) if laws.curved else 0.0
            converged |= (moved <= SETTLED) & (turned(before, pushed) <= SETTLED)
            if (converged | ~fine).all():
                break
            fine &= self._run(q, laws, pushed, into, motion)
        return fine & converged

    def _run(
        self, q: Array, laws: RowLaws, pushed: Array, into: Solution, motion: Array | None, exact: bool = True
    ) -> np.ndarray:
        fine, engine = np.empty(len(q), dtype=bool), Engine.of(self._chain)
        engine.set_laws(laws.numbers, len(q))
        engine.set_loads(self.pushes.links, pushed, NO_CHANGES, len(q))
        engine.set_motion(motion, len(q))
        loads = into.loads if len(into.loads) or not len(q) else None
        engine.rest_chain(q, exact, into.displacement, loads, into.twists, fine)
        engine.forget()
        return fine

    def proven(
        self, row: Row, laws: RowLaws, found: Solution, bound: StabilityBound | None, fine: np.ndarray
    ) -> np.ndarray:
        """Return (N,) which of the rows that are `fine` are stable, by the bound or the tangent, and not near buckling.

        Args:
            row, laws, found: As of `solve`.
            bound: Of these laws; it holds where joints are within their limits.
            fine: (N,) what `solve` returned.
        """
        proven = np.zeros(len(row.q), dtype=bool)
        if bound is not None:
            proven = fine & within(row.q, *self.limits)
            if not bound.proven:
                proven &= bound.stays(found.loads.reshape(len(proven), -1), laws.tangent)
        rest = np.flatnonzero(fine & ~proven)
        if len(rest):
            if laws.curved:
                laws.expand(np.where(fine[:, None, None], found.loads, 0.0))
            q, twists, numbers = row.q[rest], found.twists[rest], laws.numbers.some(rest, len(row.q))
            pushed = self.pushes.some(rest).at(q, twists)
            answers = responded(self._chain, ("distance",), q, twists, laws=numbers, pushed=pushed)
            proven[rest] = answers["distance"] <= SHARE
        return proven


class OneChain:
    """One thread's engine of a chain, asked about one configuration at a time.

    Laws of terms under loads that are dead or follow their links are one call; others are a row of `RowSolver`'s.

    Attributes:
        quick: `OneRow.quick` where a bound proves that it stays, None where more is asked.
        names: Of covariates that it must know.
    """

    def __init__(self, loaded: LoadedArm) -> None:
        arm, self._loaded, self._wrenches = loaded.arm, loaded, ()
        self._laws, self._rows, columns = RowLaws(arm.stack), RowSolver(loaded), len(arm.joint_names)
        places = {f"q_{name}": place for name, place in arm.joint_index.items()}
        factors = arm.stack.factors(places | {MASS: columns})
        self.names, self._known = (), np.array([loaded.payload.mass])
        self._solve: OneRow | None = None
        if factors is not None:
            self.names, self._known = factors.names, np.append(self._known, np.zeros(len(factors.names)))
            self._solve = OneRow(loaded.tree, arm.stack.numbers, np.array(arm.bounds), factors, self._known)
        self._moved = loaded.nominal and _from_nominal(loaded)
        self._push()

    def under(self, wrenches: tuple[Wrench, ...]) -> OneChain:
        """Return it under loads from outside."""
        if not same_objects(self._wrenches, wrenches):
            self._wrenches, self._rows = wrenches, RowSolver(self._loaded, wrenches, self._rows.pushes)
            self._push()
        return self

    def _push(self) -> None:
        pushes = self._rows.pushes
        self._one = None if pushes.posed else self._solve
        self.quick = self._one.quick if self._one and self._by_bound(None) and not self._moved else None
        if self._one is not None:
            self._one.set_loads(pushes.links, pushes.same)

    def __call__(self, q: Array, covariates: Mapping[str, Array], motion: Array | None = None) -> Rest | None:
        """Return where it rests at (nq,) positions; None beyond its limits, and where the fixed point is none.

        `motion` is (2, nq) speeds and accelerations, None where it stands.
        """
        if self._one is None:
            return self._in_rounds(q, covariates, motion)
        found = self._one(q, motion) if self.knows(covariates) else None
        if found is None:
            return None
        displacement, twists, loads = found
        proven = self._by_bound(motion)
        if motion is None and not proven:
            row, rest = self._loaded.row(q[None], covariates), Solution.empty(self._loaded.tree, 1)
            rest.twists[0], rest.loads[0] = twists, loads
            if self._loaded.arm.stack.rows_differ:
                self._laws.know(row)
            proven = bool(self._rows.proven(row, self._laws, rest, self._rows.bound, np.ones(1, dtype=bool))[0])
        if self._moved:
            self._moved(q, displacement)
        return Rest(displacement, twists, loads, proven)

    def knows(self, covariates: Mapping[str, Array]) -> bool:
        """Take covariates over; return whether all are given."""
        for place, name in enumerate(self.names, 1):
            if name not in covariates:
                return False  # the reference says which effect asks for it
            self._known[place] = covariates[name]
        return True

    def _by_bound(self, motion: Array | None) -> bool:
        return bool(self._rows.bound and self._rows.bound.proven_while(motion))

    @np.errstate(over="ignore", invalid="ignore")
    def _in_rounds(self, q: Array, covariates: Mapping[str, Array], motion: Array | None) -> Rest | None:
        row, arm, rows = self._loaded.row(q[None], covariates), self._loaded.arm, self._rows
        laws, found = RowLaws(arm.stack, row), Solution.empty(self._loaded.tree, 1)
        fine = rows.solve(row, laws, found, None if motion is None else motion[None])
        if not (fine[0] and arm.within_limits(q.tolist())):
            return None
        stays = self._by_bound(motion) or (motion is None and rows.proven(row, laws, found, rows.bound, fine)[0])
        return found.row(0)._replace(proven=bool(stays))


def _from_nominal(loaded: LoadedArm) -> Callable[[Array, Array], None]:
    """Return what makes a displacement one from where the controller has the rigid arm, not from where it is."""
    true, nominal = build_model(loaded.arm.robot, corrections=loaded.arm.corrections), loaded.rigid
    datas = (true.model.createData(), nominal.model.createData())
    here, there = datas[0].oMf[true.tip], datas[1].oMf[nominal.tip]
    origin, turn, nominal_origin, back = here.translation, here.rotation, there.translation, there.rotation.T

    def moved(q: Array, displacement: Array) -> None:
        pin.framesForwardKinematics(true.model, datas[0], q)
        pin.framesForwardKinematics(nominal.model, datas[1], q)
        displacement[:3] += origin - nominal_origin
        displacement[3:] = pin.log3(pin.exp3(displacement[3:]).dot(turn).dot(back))

    return moved


def within(q: Array, lower: Array, upper: Array) -> np.ndarray:
    """Return (N,) which (N, nq) positions are not beyond (nq,) limits, joint by joint: that is quicker than by row."""
    by_joint = np.ascontiguousarray(q.T)
    return np.all((by_joint >= lower[:, None]) & (by_joint <= upper[:, None]), axis=0)


def by_payload(
    arm: Structure, payloads: Sequence[str | Payload | None], count: int
) -> Iterator[tuple[LoadedArm, np.ndarray]]:
    """Yield the arm with each payload of N rows, one for all or one for each, and the rows in which it is carried."""
    if len(payloads) == 1:
        yield arm.loaded(payloads[0]), np.arange(count)
        return
    numbers: dict[str | int, list[int]] = {}
    for i, payload in enumerate(payloads):  # to look up a name costs less than to ask the arm
        numbers.setdefault(payload if isinstance(payload, str) else id(payload), []).append(i)
    found: dict[int, tuple[LoadedArm, list[int]]] = {}
    for own in numbers.values():
        loaded = arm.loaded(payloads[own[0]])
        found.setdefault(id(loaded), (loaded, []))[1].extend(own)
    for loaded, rows in found.values():
        yield loaded, np.sort(rows)


def chunks(rows: np.ndarray, size: int) -> Iterator[slice | np.ndarray]:
    """Yield rows `size` at a time, as slices where they follow each other: those are not copied."""
    together = len(rows) > 0 and bool((np.diff(rows) == 1).all())
    for some in in_pieces(rows, size):
        yield slice(int(some[0]), int(some[-1]) + 1) if together else some


def tips_of(chain: Tree, q: Array) -> Array:
    """Return the (N, 4, 4) poses of the tip of a rigid chain at (N, nq) joint positions."""
    found = np.empty((len(q), 4, 4))
    Engine.of(chain).tips(np.ascontiguousarray(q), found)
    return found


def displaced_from(displacements: Array, before: Array, after: Array) -> Array:
    """Return the (N, 6) displacements from (N, 4, 4) poses `after` of what was displaced from poses `before`."""
    found = np.empty_like(displacements)
    found[:, :3] = displacements[:, :3] + before[:, :3, 3] - after[:, :3, 3]
    turned = rotations(displacements[:, 3:]) @ before[:, :3, :3] @ np.swapaxes(after[:, :3, :3], 1, 2)
    skew = turned - np.swapaxes(turned, 1, 2)
    axes = 0.5 * np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)
    sine = np.linalg.norm(axes, axis=1)
    angle = np.arctan2(sine, 0.5 * (np.trace(turned, axis1=1, axis2=2) - 1.0))
    found[:, 3:] = axes * np.where(sine < 1e-8, 1.0, angle / np.where(sine < 1e-8, 1.0, sine))[:, None]
    return found


def rotations(vectors: Array) -> Array:
    """Return the (N, 3, 3) rotations of (N, 3) rotation vectors."""
    angle = np.linalg.norm(vectors, axis=1)[:, None, None]
    skew = np.cross(vectors[:, None], np.eye(3)).swapaxes(1, 2)
    half = np.sinc(0.5 * angle / np.pi)
    return np.eye(3) + np.sinc(angle / np.pi) * skew + 0.5 * half * half * (skew @ skew)


def drawn_displacements(
    arm: Structure,
    rows: Array,
    payload: str | Payload | None,
    known: dict[str, Array],
    draws: int,
    seed: int,
) -> Array:
    """Return the (draws, N, 6) displacements of the tip [m, rad] of the same arm with laws drawn by `Law.draw`.

    Args:
        arm: The arm, at whose links nothing pulls.
        rows: (N, nq) joint positions [rad or m], within their limits.
        payload: Name or object.
        known: What the arm's effects depend on: numbers, or (N,) of them.
        draws: How many.
        seed: Of the random numbers.

    Raises:
        UnsupportedError: A draw has no equilibrium that is proven stable.
    """
    rng = np.random.default_rng(seed)
    stacks = [LawStack(arm.stack.names, tuple(law.draw(rng) for law in arm.stack.laws)) for _ in range(draws)]
    loaded = arm.loaded(payload)
    bounds = [None if loaded.stability_bound is None else loaded.stability_bound.with_laws(stack) for stack in stacks]
    solver, found = RowSolver(loaded), np.empty((draws, len(rows), 6))
    for some in chunks(np.arange(len(rows)), AT_ONCE):
        given = {name: values[some] if values.ndim else values for name, values in known.items()}
        row = loaded.row(rows[some], given)
        into = Solution.empty(loaded.tree, len(row.q))
        for number, stack in enumerate(stacks):
            laws = RowLaws(stack, row)
            fine = solver.solve(row, laws, into)
            if not solver.proven(row, laws, into, bounds[number], fine).all():
                with naming(f"draw {number}"):
                    raise UnsupportedError("the arm so drawn is too soft: it turns too far, or may not stay")
            found[number, some] = into.displacement
    return found
