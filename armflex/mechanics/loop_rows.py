"""Where an arm with loops or springs rests in many rows, or in one: the engine, with `Mechanism` beside it.

A chain with springs is a mechanism without closures.

Rows follow each other, since each closes its loops from where the one before did. What the engine does not answer
`Mechanism` is asked in its turn.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from armflex.conventions import Array
from armflex.errors import ClosureError
from armflex.laws import Row
from armflex.mechanics.engine.binding import Engine, OneRest
from armflex.mechanics.engine.tables import GEAR, NO_CHANGES, ROD, SLIDES, TURNS, Tree
from armflex.mechanics.laws import RowLaws
from armflex.mechanics.loaded import LoadedArm
from armflex.mechanics.many_rows import NOT_PUSHED, Pushes, Solution, displaced_from, tips_of
from armflex.mechanics.mechanism import Closing, Rest
from armflex.mechanics.pinocchio_model import LoadCase
from armflex.rows.wrench import Wrench, same_objects


class Rested(NamedTuple):
    """Arrays of N rows; see `Engine.rest`. `fine` is (N,) of those that were answered and proven to stay."""

    closed: Array
    tips: Array
    flexed: Array
    twists: Array
    loads: Array
    forces: Array
    displacement: Array
    distance: Array
    idle: Array
    fine: np.ndarray

    @classmethod
    def empty(cls, tree: Tree, count: int, into: Solution | None = None) -> Rested:
        """Return room for N rows, that of a solution where there is one."""
        p, n, m = tree.passive, len(tree.flexures), len(tree.rows)
        shapes = {"closed": (p,), "tips": (4, 4), "flexed": (p,), "twists": (n, 6), "loads": (n, 6), "forces": (m,)}
        shapes |= {"displacement": (6,), "distance": (), "idle": (m, m)}
        given = {} if into is None else into._asdict()
        arrays = [given[name] if name in given else np.empty((count, *shape)) for name, shape in shapes.items()]
        return cls(*arrays, fine=np.zeros(count, dtype=bool))


class LoopSolver:
    """One thread's compiled mechanism under some loads; see `Quick`. `pushes` are those."""

    def __init__(self, loaded: LoadedArm, wrenches: Sequence[Wrench] = ()) -> None:
        stack = loaded.arm.stack
        self._loaded, self._mechanics, self.pushes = loaded, loaded.mechanics, Pushes(loaded, wrenches)
        self._laws, self._differs = RowLaws(stack), stack.rows_differ
        self._tree, self._nominal, self._idle = loaded.tree, loaded.nominal, np.zeros((len(loaded.tree.rows),) * 2)
        self._plain: bool | None = None
        self._engine, self._rigid = Engine(self._tree), self._nominal and Engine(self._nominal)
        self._single = Solution.empty(self._tree, 1)
        self._room = Rested.empty(self._tree, 1, self._single)
        self._one = OneRest(self._tree, self._room)

    def __call__(self, q: Array, covariates: Mapping[str, Array], motion: Array | None = None) -> Rest | None:
        """Return where it rests at (nq,) positions; None beyond its limits, and where the engine does not answer."""
        if motion is not None or not self._loaded.arm.within_limits(q.tolist()):
            return None
        closing, found, row = self._mechanics.closing, self._single, self._loaded.row(q, covariates)
        last = closing.last if self._nominal is None else None
        if last is not None and self._knows_one(row) and self._one(q, last[1]):
            closing.last = q.copy(), found.closed[0].copy()
        elif not self.rest(q[None], row, found).fine[0]:
            return None
        return found.row(0)

    def _knows_one(self, row: Row) -> bool:
        """Return whether the engine knows laws and loads in a row, which are given to it where they are others."""
        if self._differs or self._plain is None:
            known, self._plain = self._known(row.q[None], row)
            if self._plain:
                self._one.know(*known[:3])
        return self._plain

    def _known(self, q: Array, row: Row) -> tuple[tuple, bool]:
        """Return laws, loads and positions for the engine, and whether it knows them."""
        laws, pushes = self._laws, self.pushes
        if self._differs:
            laws.know(row)
        plain = not (laws.curved or laws.bent or pushes.posed)
        loads = pushes.wrenches(q) if plain else NOT_PUSHED[1]
        return (laws.numbers, pushes.links, loads, q), plain

    def _ask(self, engine: Engine, known: tuple, settled: bool, first: int, free: Array, into: Rested) -> int:
        laws, links, wrenches, q = known
        if settled:
            engine.set_laws(laws, len(q))
            engine.set_loads(links, wrenches, NO_CHANGES, len(q))
        answered = engine.rest(q, settled, first, free, self._idle, into)
        engine.forget()  # the next question is about other rows
        return answered

    def rest(self, q: Array, row: Row, into: Solution, alone: Callable[[int], Rest] | None = None) -> Rested:
        """Put into `into` where the mechanism rests in some rows; return that, and what nothing answers to.

        Args:
            q: (N, nq) positions of the drives.
            row: What its laws may know there.
            into: To be filled.
            alone: Asked about each row that is not answered, in its turn; where it is not given no row after it is.
        """
        (known, plain), nominal, others = self._known(q, row), None, dict[int, Rest]()

        def by_itself(into: Rested, i: int) -> bool:
            if alone is not None:
                if nominal is not None and nominal.fine[i]:
                    self._mechanics.nominal.last = q[i].copy(), nominal.closed[i].copy()
                others[i] = alone(i)
            return alone is not None

        def nominally(into: Rested, i: int) -> bool:
            with suppress(ClosureError):  # the row will say so, asked by itself
                self._place_rigid(into, i, q)
            return True

        if self._nominal is not None:
            room = Rested.empty(self._nominal, len(q))
            assert self._rigid is not None
            nominal = self._follow(self._rigid, self._mechanics.nominal, known, False, True, nominally, room)
        found = self._room if into is self._single else Rested.empty(self._tree, len(q), into)
        self._follow(self._engine, self._mechanics.closing, known, True, plain, by_itself, found)
        if nominal is not None:
            found.fine[:] &= nominal.fine
            found.displacement[:] = displaced_from(found.displacement, found.tips, nominal.tips)
        for i, rest in others.items():
            idle = self._mechanics.idle(LoadCase(q[i]), row.some(i))
            into.put(i, rest)
            found.idle[i], found.fine[i] = idle @ idle.T, True
        return found

    def rigid_tips(self, q: Array) -> Array:
        """Return the (N, 4, 4) tips of the rigid mechanism, as the controller knows it, at (N, nq) positions.

        Raises:
            ClosureError: A row's loops do not close.
        """

        def alone(into: Rested, i: int) -> bool:
            self._place_rigid(into, i, q)
            return True

        engine, known = self._rigid or self._engine, (None, None, None, np.ascontiguousarray(q))
        room = Rested.empty(engine.tree, len(q))
        return self._follow(engine, self._mechanics.nominal, known, False, True, alone, room).tips

    def _place_rigid(self, into: Rested, i: int, q: Array) -> None:
        into.tips[i] = self._mechanics.rigid_tip_pose(q[i]).homogeneous
        into.closed[i], into.fine[i] = self._mechanics.nominal.closed(q[i]), True

    def _follow(
        self,
        engine: Engine,
        closing: Closing,
        known: tuple,
        settled: bool,
        plain: bool,
        ask: Callable[[Rested, int], bool],
        into: Rested,
    ) -> Rested:
        """Go through the rows, each from where the one before it closed; `ask` about those that are not answered."""
        q, at, asked = known[3], 0, -1
        into.fine[:] = False
        while at < len(q):
            done = at
            if closing.last is None:
                with suppress(ClosureError):
                    closing.closed(q[at])
            if plain and closing.last is not None:
                done = self._ask(engine, known, settled, at, closing.last[1].copy(), into)
            if done > at:
                into.fine[at:done] = True
                closing.last = q[done - 1].copy(), into.closed[done - 1].copy()
            if plain and done < len(q) and asked < done:
                asked = done
                with suppress(ClosureError):  # a row far from the one before it is closed in smaller steps
                    closing.closed(q[done])
                at = done
            elif done < len(q) and not ask(into, done):
                break
            else:
                at = done + 1
        return into


def solver_of(loaded: LoadedArm, wrenches: tuple[Wrench, ...]) -> LoopSolver:
    """Return this thread's solver under some loads; that of those that were asked about last is kept."""
    kept = getattr(loaded.kept, "solver", None)
    if kept is None or not same_objects(kept[0], wrenches):
        kept = loaded.kept.solver = wrenches, LoopSolver(loaded, wrenches)
    return kept[1]


def closing_drives(loaded: LoadedArm) -> np.ndarray:
    """Return (nq,) which drives move what closes its loops: all others may be anywhere, and they stay closed."""
    tree = loaded.tree
    kinds, joins, places = tree.kinds, tree.joins, np.zeros(tree.driven + tree.passive, dtype=bool)
    gears = joins[joins[:, 0] == GEAR, 1:3].ravel()
    moving = np.flatnonzero(np.isin(kinds[0] & 3, (TURNS, SLIDES)) & (tree.carried != 0.0).any(axis=0))
    places[kinds[1, np.concatenate([moving, gears])]] = True
    places[joins[joins[:, 0] == ROD, 5]] = True
    return places[: tree.driven]


def rigid_tips(loaded: LoadedArm, q: Array) -> Array:
    """Return the (N, 4, 4) poses of the tip of the rigid arm, where the controller knows it, at (N, nq) positions.

    Raises:
        ClosureError: A row's loops do not close.
    """
    if loaded.arm.robot.linkage:
        return solver_of(loaded, ()).rigid_tips(q)
    return tips_of(loaded.nominal or loaded.tree, q)
