"""Where an arm with loops or springs rests in many rows, or in one: compiled code, with `Mechanism` beside it.

A chain with springs is a mechanism without closures.

Rows follow each other, since each closes its loops from where the one before did. What compiled code does not answer
`Mechanism` is asked in its turn.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from armflex.conventions import Array
from armflex.errors import ClosureError
from armflex.laws import Row
from armflex.mechanics.chain import chain_of
from armflex.mechanics.laws import RowLaws
from armflex.mechanics.loaded import LoadedArm
from armflex.mechanics.many_rows import NOT_PUSHED, Pushes, displaced_from, loop_kernel
from armflex.mechanics.mechanism import Closing, Mechanism
from armflex.mechanics.pinocchio_model import FlexModel, LoadCase
from armflex.mechanics.spring import CoilSpring, GasSpring
from armflex.mechanics.ties import Pin, Ties
from armflex.robot import Corrections
from armflex.rows.wrench import Wrench, same_objects


class Rested(NamedTuple):
    """Arrays of N rows; see `loop_kernel.rest_rows`. `fine` is (N,) of those that were answered and proven to stay."""

    closed: Array
    tips: Array
    flexed: Array
    twists: Array
    loads: Array
    forces: Array
    displacement: Array
    distance: Array
    idle: Array
    model: Array
    fine: np.ndarray


def tree_of(flex: FlexModel, ties: Ties, closing: Closing) -> Any:
    """Return a mechanism as `loop_kernel.Tree`; flexures at closures have no element."""
    compiled, model = loop_kernel(), flex.model
    carriers = {joint.idx_v: joint.id for joint in list(model.joints)[1:] if joint.nv == 6}
    starts = flex.flexure_v[::6].tolist()
    chain = chain_of(flex, [carriers[start] for start in starts if start < model.nv])
    kinds, in_tree = chain.kinds.copy(), [i for i, start in enumerate(starts) if start < model.nv]
    flexures = np.array([-1 - (start - model.nv) // 6 for start in starts], dtype=np.int64)
    for i in in_tree:
        flexures[i] = carriers[starts[i]]
        kinds[1, flexures[i]] = i
    # Cylinders are drives, too, and stand before passive joints among the positions.
    driven, cylinders = len(flex.q_index), len(ties.cylinders)
    kinds[1, (kinds[0] & 3 > 0) & (kinds[1] >= driven)] += cylinders
    everything, rows, at = (*ties.loops, *ties.cylinders), [], 0
    count = len(ties.names) + len(ties.springs)
    numbers, joins, carried = (
        np.zeros((count, 48)),
        np.zeros((count, 6), dtype=np.int64),
        np.zeros((count, model.njoints)),
    )
    ends = {**dict(enumerate(everything)), **dict(enumerate(ties.sprung_rods, len(ties.names)))}
    for t, one in ends.items():
        for side, end in zip((-1.0, 1.0), one.ends, strict=True):
            second = side > 0.0
            numbers[t, 3 * second : 3 * second + 3] = end.point
            numbers[t, 30 + 9 * second : 39 + 9 * second] = end.axes.ravel()
            carried[t, list(model.supports[end.joint])] += side
        joins[t, 1:3] = [end.joint for end in one.ends]
    for t, one in enumerate(everything):
        if isinstance(one, Pin):
            joins[t, 0] = compiled.FIXED if one.fixed else compiled.AXIS
            numbers[t, 6:9], numbers[t, 9:27] = one.axis, np.concatenate([turn.ravel() for turn in one.turns])
            rows.append(one.rows)
        else:
            joins[t, 0], joins[t, 5] = compiled.ROD, driven + t - len(ties.loops)
            numbers[t, 27] = closing.offsets[t - len(ties.loops)]
            rows.append(np.eye(6)[:1])
    carrier = {joint.idx_q: joint.id for joint in list(model.joints)[1:]}
    for t, (own, master, factor, offset) in enumerate(ties.gears, len(everything)):
        joins[t, :3], numbers[t, 27:29] = (compiled.GEAR, carrier[own], carrier[master]), (factor, offset)
        rows.append(np.eye(6)[:1])
    for t, part in enumerate(rows):
        joins[t, 3:5] = at, at + len(part)
        at += len(part)
    for t, spring in enumerate(ties.springs, len(ties.names)):
        law = spring.law
        if isinstance(law, CoilSpring):
            joins[t, 0], numbers[t, 27:30] = compiled.COIL, law.numbers
        else:
            assert isinstance(law, GasSpring)
            joins[t, 0], numbers[t, 27:30] = compiled.GAS, law.numbers
    parents = np.array([list(supports)[-2:][0] for supports in model.supports], dtype=np.int64)
    closes = np.concatenate([*rows, np.zeros((0, 6))])
    element_v = [-1] * model.njoints
    for joint in list(model.joints)[1:]:
        element_v[joint.id] = joint.idx_v if joint.nv == 1 else -1
    places = np.concatenate([flex.q_index, flex.free_q, flex.free_v, starts, element_v]).astype(np.int64)
    return compiled.Tree(
        chain.elements, kinds, parents, carried, numbers, joins, closes, flexures, flex.neutral.copy(), places
    )


def trees(loaded: LoadedArm) -> tuple[Any, Any, Any]:
    """Return the mechanism, as the controller knows it where that is another, and with its tool as an element."""
    mechanics, corrections, flex = loaded.mechanics, loaded.arm.corrections, loaded.with_tool
    if mechanics.trees is None:
        true, controlled = closings(loaded)
        nominal = controlled if corrections.move else None
        ties = Ties(flex.model, flex.model.createData(), mechanics.linkage, loaded.arm.springs, corrections.geometry)
        mechanics.trees = (
            tree_of(mechanics.flex, true.ties, true),
            nominal and tree_of(loaded.rigid, nominal.ties, nominal),
            tree_of(flex, ties, true),
        )
    return mechanics.trees


def closings(loaded: LoadedArm) -> tuple[Closing, Closing]:
    """Return where joints without a drive are, in the arm as it is and as its controller has it."""
    mechanics, robot, rigid = loaded.mechanics, loaded.arm.robot, loaded.rigid
    if isinstance(mechanics, Mechanism):
        return mechanics.true, mechanics.nominal
    ties = Ties(rigid.model, rigid.model.createData(), robot.linkage)
    assert mechanics.ties is not None
    return Closing(robot, mechanics.flex, mechanics.ties, Corrections()), Closing(robot, rigid, ties, Corrections())


class LoopSolver:
    """One thread's compiled mechanism under some loads."""

    def __init__(self, loaded: LoadedArm, wrenches: Sequence[Wrench] = ()) -> None:
        mechanics = loaded.mechanics
        true, self._controlled = closings(loaded)
        self._closing = true if loaded.arm.corrections.move else self._controlled
        self._mechanics, self._pushes, self._laws = mechanics, Pushes(loaded, wrenches), RowLaws(loaded.arm.stack)
        self._tree, self._nominal = trees(loaded)[:2]
        m, nq, size = len(self._tree.rows), len(mechanics.flex.neutral), mechanics.flex.size
        self.parts = nq, nq + size, nq + 2 * size  # ends of what is in `Rested.model`
        self._idle, self._ask = np.zeros((m, m)), loop_kernel().rest_rows
        self._sizes = len(mechanics.flex.free_v), len(self._tree.flexures), m
        self._differs = loaded.arm.stack.rows_differ
        self._one, self._free = self._room(1, alone=True), np.empty(self._sizes[0])
        alike = self._pushes.rows is None and not self._pushes.posed
        self._simple = alike and self._nominal is None and not self._laws.bent
        self._loads = self._pushes.wrenches(loaded.arm.robot.home[None]) if self._simple else NOT_PUSHED[1]

    def one(self, row: Row) -> tuple[Array, Array, Array] | None:
        """Return where the mechanism rests in one row, None as of `rest`.

        These are `Rested.model`, (6,) displacement, and (n, 6) twists, which the next one overwrites.
        """
        laws, closing, q = self._laws, self._closing, row.q[None]
        displacement, model = np.empty((1, 6)), np.empty((1, self.parts[2]))
        if closing.last is not None and self._simple:
            if self._differs:
                laws.know(row)
            if laws.curved:
                return None
            self._free[:] = closing.last[1]
            known = laws.compliance, laws.offset, self._pushes.links, self._loads, q, True, 0, self._free, self._idle
            closed, _, _, twists, *_ = before = self._one[0][:6]
            if self._ask(self._tree, *known, *before, displacement, *self._one[0][7:9], model):
                closing.last = row.q.copy(), closed[0].copy()
                return model[0], displacement[0], twists[0]
        found = self._one[0]._replace(displacement=displacement, model=model)
        self.rest(q, row, into=(found, self._one[1]))
        return (model[0], displacement[0], found.twists[0]) if found.fine[0] else None

    def rest(
        self, q: Array, row: Row, alone: Callable[[int], None] | None = None, into: tuple[Rested, ...] = ()
    ) -> Rested:
        """Return where the mechanism rests in some rows.

        Args:
            q: (N, nq) positions of the drives.
            row: What its laws may know there.
            alone: Asked about each row that is not answered, in its turn; where it is not given no row after it is.
            into: Arrays for that, and for where the controller has it.
        """
        laws, pushes, mechanics = self._laws, self._pushes, self._mechanics
        if self._differs:
            laws.know(row)
        plain = self.answers
        loads = pushes.wrenches(q) if plain else NOT_PUSHED[1]
        known = (laws.compliance, laws.offset, pushes.links, loads, q)
        found, nominal = into or self._room(len(q))
        found.fine[:] = nominal.fine[:] = False

        def by_itself(i: int) -> None:
            if alone is not None:
                if nominal.fine[i : i + 1].any():
                    self._controlled.last = q[i].copy(), nominal.closed[i].copy()
                alone(i)

        def nominally(i: int) -> None:
            with suppress(ClosureError):  # the row will say so, asked by itself
                nominal.tips[i] = mechanics.rigid_tip_pose(q[i]).homogeneous
                nominal.closed[i], nominal.fine[i] = self._controlled.closed(q[i]), True

        if self._nominal is not None:
            self._follow(self._nominal, self._controlled, (*known, False), nominal, True, nominally)
        self._follow(self._tree, self._closing, (*known, True), found, plain, by_itself, alone is None)
        if self._nominal is not None:
            found.fine[:] &= nominal.fine
            found.displacement[:] = displaced_from(found.displacement, found.tips, nominal.tips)
        return found

    def _room(self, count: int, alone: bool = False) -> tuple[Rested, Rested]:
        """Return room for so many rows, and for where the controller has them, where that is elsewhere."""
        nominal = 0 if self._nominal is None else count
        return self._rested(count, *self._sizes, alone), self._rested(nominal, self._sizes[0], 0, 0, alone)

    def _rested(self, count: int, p: int, n: int, m: int, alone: bool) -> Rested:
        shapes = ((p,), (4, 4), (p,), (n, 6), (n, 6), (m,), (6,), ())
        arrays = [np.empty((count, *shape)) for shape in shapes]
        arrays += [np.empty((0 if alone else count, m, m)), np.empty((count if alone else 0, self.parts[2]))]
        return Rested(*arrays, fine=np.zeros(count, dtype=bool))

    @property
    def answers(self) -> bool:
        """Whether compiled code knows these laws and loads."""
        return not (self._laws.curved or self._laws.bent or self._pushes.posed)

    def fill(self, into: Rested, i: int, rigid: Array, motion: Array, torque: Array | None, idle: Array) -> None:
        """Put where `Mechanism` has row i at rest, and what is idle there, into the arrays."""
        mechanics, flex = self._mechanics, self._mechanics.flex
        assert torque is not None
        into.closed[i] = rigid[flex.free_q]
        into.flexed[i] = mechanics.flexed(rigid, motion)[flex.free_q]
        into.twists[i], into.loads[i] = motion[flex.flexure_v].reshape(-1, 6), -torque[flex.flexure_v].reshape(-1, 6)
        assert mechanics.ties is not None
        into.forces[i], into.idle[i] = -mechanics.ties.rows @ torque[mechanics.model.nv :], idle @ idle.T

    def _follow(
        self,
        tree: Any,
        closing: Closing,
        known: tuple,
        into: Rested,
        plain: bool,
        ask: Callable[[int], None],
        ends: bool = False,
    ) -> None:
        """Go through the rows, each from where the one before it closed; `ask` about those that are not answered."""
        q, at, free, asked = known[4], 0, np.empty(self._sizes[0]), -1
        while at < len(q):
            done = at
            if closing.last is None:
                with suppress(ClosureError):
                    closing.closed(q[at])
            if plain and closing.last is not None:
                free[:] = closing.last[1]
                done = self._ask(tree, *known, at, free, self._idle, *into[:-1])
            if done > at:
                into.fine[at:done] = True
                closing.last = q[done - 1].copy(), into.closed[done - 1].copy()
            if plain and done < len(q) and asked < done:
                asked = done
                with suppress(ClosureError):  # a row far from the one before it is closed in smaller steps
                    closing.closed(q[done])
                at = done
                continue
            if done < len(q):
                ask(done)
                if ends:
                    break
            at = done + 1


@dataclass(frozen=True, eq=False)
class LoopRows:
    """Some rows of one payload of an arm with loops, where compiled code has them: see `few_rows.FewRows`.

    Attributes:
        loaded: The arm with the payload.
        tree, links: See `loop_kernel.Tree` and `Pushes`; the tool is an element of its own.
        rows: (M,) their numbers.
        wrenches, tangents: (1 or M, L, 9) and (1 or M, n, 6, 6) of links and laws.
        flexed, forces, idle: (M, p) passive joints, (M, m) in the closures, (M, m, m) what nothing answers to.
    """

    loaded: LoadedArm
    tree: Any
    links: np.ndarray
    rows: np.ndarray
    wrenches: Array
    tangents: Array
    flexed: Array
    forces: Array
    idle: Array

    def among(self, number: np.ndarray) -> LoopRows:
        """See `FewRows`."""
        own = np.flatnonzero(number[self.rows] >= 0)
        arrays = self.wrenches, self.tangents, self.flexed, self.forces, self.idle
        some = (one[own] if len(one) > 1 or not len(self.rows) else one for one in arrays)
        return LoopRows(self.loaded, self.tree, self.links, number[self.rows[own]], *some)

    def by_law(self, end: str | None, q: Array, twists: Array) -> Array:
        """See `FewRows`."""
        return self.asked("laws", end, q, twists)

    def asked(self, what: str, end: str | None, q: Array, twists: Array, by_load: Array | None = None) -> Array:
        """See `FewRows`; "laws" are (M, 6, n, 6)."""
        loaded, count, linkage = self.loaded, len(self.rows), self.loaded.arm.robot.linkage
        links, tip = loaded.link_frames, loaded.tip_frame
        at = tip if end is None else links.some([links.names.index(end)])
        frames = {"tip": tip, "links": links, "motions": links}.get(what, loaded.sites)
        f, sites = len(frames.numbers), len(frames.numbers) + len(linkage.closures) + len(linkage.pins)
        shapes: dict[str, tuple[int, ...]] = {"laws": (6, *twists.shape[1:]), "joints": (6, q.shape[1])}
        shapes |= {"sites": (6, sites, 6), "motions": (f, 6, 6), "gravity": (6, 3)}
        shapes |= {"poses": (f, 4, 4), "loads": (sites, 6)}
        kind = "poses" if what in ("tip", "links") else what
        found = {name: np.empty((count if name == kind else 0, *shape)) for name, shape in shapes.items()}
        there = np.append(float(at.places[0, 0]), at.numbers[0]), frames.places, frames.numbers
        state = (self.flexed, np.ascontiguousarray(twists), self.forces, self.idle)
        given = (self.tree, self.tangents, self.links, self.wrenches, np.ascontiguousarray(q), *state)
        loop_kernel().respond_rows(*given, *there, *found.values())
        return found[kind]


def responding(loaded: LoadedArm, rows: np.ndarray, case: LoadCase, rested: Rested, tangents: Array) -> LoopRows:
    """Return rows that rest as compiled code found, or as `LoopSolver.fill` has them."""
    pushes, state = Pushes(loaded, case.wrenches, sited=True), (rested.flexed, rested.forces, rested.idle)
    return LoopRows(loaded, trees(loaded)[2], pushes.links, rows, pushes.wrenches(case.q), tangents, *state)


def solver_of(loaded: LoadedArm, wrenches: tuple[Wrench, ...]) -> LoopSolver:
    """Return this thread's solver under some loads; that of those that were asked about last is kept."""
    mechanics = loaded.mechanics
    if mechanics.solver is None or not same_objects(mechanics.solver[0], wrenches):
        mechanics.solver = wrenches, LoopSolver(loaded, wrenches)
    return mechanics.solver[1]
