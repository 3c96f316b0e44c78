"""Calls of the engine: one for each question, with arrays that this file has looked at.

A call lets go of the interpreter's lock, so threads run side by side, each with an `Engine` of its own.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from ctypes import CDLL, addressof, c_int, c_int64, c_void_p
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from armflex.conventions import Array
from armflex.errors import ArmflexError, ShapeError
from armflex.mechanics.engine import build
from armflex.mechanics.engine.tables import (
    NO_CHANGES,
    NO_FRAMES,
    REAL,
    RESTED,
    WHOLE,
    ArmArraysError,
    AskedStruct,
    Factors,
    Frames,
    Laws,
    OneStruct,
    RestStruct,
    State,
    Tables,
    Tree,
    _within,
    address,
    addresses,
    checked,
)

NO_LINKS, NO_WRENCHES = np.zeros((0, 3), dtype=WHOLE), np.zeros((1, 0, 9))

_POINTER, _WHOLE = c_void_p, c_int64
_CALLS: dict[str, tuple[type | None, list[type]]] = {
    "engine_size": (_WHOLE, []),
    "engine_level": (c_int, []),
    "engine_room": (_WHOLE, [_POINTER]),
    "engine_rest_room": (_WHOLE, [_POINTER, _WHOLE]),
    "engine_ready": (None, [_POINTER] * 2),
    "engine_one": (c_int, [_POINTER] * 2),
    "engine_chain": (_WHOLE, [_POINTER, _WHOLE, _POINTER, _WHOLE, *[_POINTER] * 5]),
    "engine_rest": (_WHOLE, [_POINTER, _WHOLE, _POINTER, _WHOLE, _WHOLE, *[_POINTER] * 4]),
    "engine_respond": (None, [_POINTER, _WHOLE, *[_POINTER] * 7]),
    "engine_tips": (None, [_POINTER, _WHOLE, *[_POINTER] * 3]),
}


class EngineError(ArmflexError):
    """There is no compiled engine of this text; the message says what to run."""


@cache
def library() -> CDLL:
    """Return the compiled engine, the fastest that the processor can run.

    Raises:
        EngineError: It was never compiled, or from another text than the one that is here.
    """
    found = _loaded(build.LEVELS[0])
    level = found.engine_level() if build.on_x86_64() else 0
    return _loaded(build.LEVELS[level]) if level else found


def _loaded(level: str) -> CDLL:
    name, beside = build.library_name(level), find_spec(build.BESIDE)
    folders = [build.FOLDER, *map(Path, (beside and beside.submodule_search_locations) or ())]
    path = next((folder / name for folder in folders if (folder / name).exists()), None)
    if path is None:
        older = any(folder.glob(f"engine-*-{level}{build.SUFFIX}") for folder in folders)
        why = "engine.c was edited since it was compiled" if older else "the engine is not compiled"
        run = "run `python -m armflex.mechanics.engine.build`, or `pip install --editable .` once more"
        raise EngineError(f"{why}: {run}")
    found = CDLL(str(path))
    for call, (result, arguments) in _CALLS.items():
        function = getattr(found, call)
        function.restype, function.argtypes = result, arguments
    return found


class Engine(Tables):
    """The engine with one arm: its tables, and room to work in. Of one thread at a time; see engine.h for the calls."""

    def __init__(self, tree: Tree) -> None:
        super().__init__(tree)
        self._library, self._room, self._arm = library(), np.zeros(0), addressof(self.struct)
        self._into, self._rested = (), RestStruct()
        self._places: tuple[np.ndarray, ...] = ()
        self.set_loads(NO_LINKS, NO_WRENCHES, NO_CHANGES, 1)
        assert self._library.engine_size() == len(bytes(self.struct))

    @classmethod
    def of(cls, tree: Tree) -> Engine:
        """Return this thread's engine with an arm, for one question; its tables stay checked."""
        engine = getattr(tree.kept, "engine", None)
        if engine is None:
            engine = tree.kept.engine = cls(tree)
        engine.forget()
        return engine

    def rest_chain(
        self, q: Array, exact: bool, displacement: Array, loads: Array | None, twists: Array, fine: np.ndarray
    ) -> None:
        """Fill where a chain rests in N rows, by the fixed point.

        Args:
            q: (N, d) positions of the drives.
            exact: Whether it comes to rest; else what the loads of the rigid arm give.
            displacement: (N, 6) of the tip [m, rad].
            loads: (N, n, 6) on the flexures, None where they are not asked for [N, Nm].
            twists: (N, n, 6) of the flexures [m, rad].
            fine: (N,) 1 where that is so, else 0.
        """
        rows, n = len(q), len(self.tree.flexures)
        self._check_chain()
        self._check_rows(q)
        checked(displacement, "displacement", REAL, rows, 6)
        checked(twists, "twists", REAL, rows, n, 6)
        checked(fine, "fine", np.dtype(np.bool_), rows)
        if loads is not None:
            checked(loads, "loads", REAL, rows, n, 6)
        given = addresses((displacement, loads, twists, fine, self._work()))
        self._library.engine_chain(self._arm, rows, address(q), exact, *given)

    def rest(self, q: Array, settled: bool, first: int, free: Array, idle: Array, into: Sequence[np.ndarray]) -> int:
        """Fill where a mechanism rests in rows from `first` on, each closed from where the one before it was.

        Args:
            q: (N, d) positions of the drives.
            settled: Whether it comes to rest; else it is only closed.
            first: The first row.
            free: (p,) joints without a drive from which the first is closed; overwritten.
            idle: (m, m) projector on gaps that nothing answers to, of the row before; zero where it is not known.
            into: closed (N, p), tips (N, 4, 4), flexed (N, p), twists (N, n, 6), loads (N, n, 6), forces (N, m),
                displacement (N, 6), distance (N,), idles (N, m, m), first of more: see `loop_rows.Rested`. The same are
                looked at once.

        Returns:
            The number of the row that is not answered, N where there is none.
        """
        tree, rows = self.tree, len(q)
        self._check_rows(q)
        if into is not self._into:
            self._look_at(into)
        checked(free, "free", REAL, tree.passive)
        checked(idle, "idle", REAL, len(tree.rows), len(tree.rows))
        if (settled and self._laws is None) or first < 0 or len(into[0]) != rows:
            raise ShapeError("expected laws, a first row from 0 on, and room for all")
        given = address(free), address(idle), addressof(self._rested), address(self._work())
        return int(self._library.engine_rest(self._arm, rows, address(q), settled, first, *given))

    def _look_at(self, into: Sequence[np.ndarray]) -> None:
        """Point to arrays that `rest` fills."""
        tree = self.tree
        p, n, m = tree.passive, len(tree.flexures), len(tree.rows)
        shapes = ((p,), (4, 4), (p,), (n, 6), (n, 6), (m,), (6,), (), (m, m))
        for name, array, shape in zip(RESTED, into, shapes, strict=False):
            checked(array, name, REAL, len(into[0]), *shape)
        self._into, self._rested = into, RestStruct(*addresses(into[: len(RESTED)]))

    def respond(
        self,
        what: Collection[str],
        q: Array,
        twists: Array,
        *,
        sites: Frames = NO_FRAMES,
        bodies: Frames = NO_FRAMES,
        state: State | None = None,
        end: Frames | None = None,
        behind: int = 0,
        into: Mapping[str, Array] | None = None,
    ) -> dict[str, Array]:
        """Return what is asked about an arm that rests in N rows, all of it in one pass.

        Args:
            what: "poses" (N, b, 4, 4) of bodies; "loads" (N, s, 6) on all that a twist at a site moves, its axes;
                "distance" (N,), below 1 a proof that the arm stays; or motions of the tip: "laws" and "per_load"
                (N, 6, n, 6) by a flexure's twist and the load on it, "joints" (N, 6, d), "at_sites" (N, 6, s, 6) by
                twists there, "motions" (N, b, 6, 6) by wrenches at the origins of bodies.
            q, twists: (N, d) and (N, n, 6) of drives and flexures.
            sites, bodies: Frames of the arm.
            state: None of a chain.
            end: The one frame that is meant by the tip, where it is another.
            behind: How many closures and pins there are behind the sites in s.
            into: Arrays to be filled, by name; what is not there is made.
        """
        tree, rows, s, given = self.tree, len(q), len(sites.numbers) + behind, into or {}
        shapes, m = tree.answers(s, len(bodies.numbers)), len(tree.rows)
        found = {name: given[name] if name in given else np.empty((rows, *shapes[name])) for name in what}
        flexed, forces, idle = state or (np.zeros((rows, 0)), np.zeros((rows, 0)), np.zeros((rows, 0, 0)))
        at = tree.elements[-1, :16]
        if end is not None:
            at = np.concatenate([end.numbers[0], np.zeros(3), end.places[0, :1]])
        q, twists = np.ascontiguousarray(q), np.ascontiguousarray(twists)
        self._check_rows(q)
        parts = {"flexed": (flexed, (tree.passive,)), "twists": (twists, (len(tree.flexures), 6))}
        parts |= {"forces": (forces, (m,)), "idle": (idle, (m, m))}
        for name, (array, shape) in (parts | {name: (found[name], shapes[name]) for name in found}).items():
            checked(array, name, REAL, rows, *shape)
        for frames in (sites, bodies):
            checked(frames.numbers, "numbers", REAL, frames.places.shape[1], 12)
            if not any(frames.places is one for one in self._places):
                checked(frames.places, "places", WHOLE, 2, len(frames.numbers))
                _within(frames.places.ravel(), "places", 0, len(tree.parents))
        self._places = sites.places, bodies.places
        if not 0.0 <= at[15] < len(tree.parents):
            raise ArmArraysError(f"end: expected an element of {len(tree.parents)}, got {at[15]}")
        if self._laws is None and not (found.keys() <= {"poses", "loads"}):
            raise ShapeError("expected laws")
        self._check_behind(found, behind)
        asked = AskedStruct(
            end=address(at), frames=s - behind, places=address(sites.places), numbers=address(sites.numbers), sites=s,
            bodies=len(bodies.numbers), body_places=address(bodies.places), body_numbers=address(bodies.numbers),
            **{name: address(array) for name, array in found.items()},
        )  # fmt: skip
        where = *addresses((q, flexed, twists, forces, idle)), addressof(asked), address(self._work())
        self._library.engine_respond(self._arm, rows, *where)
        return found

    def tips(self, q: Array, poses: Array) -> None:
        """Fill the (N, 4, 4) poses of a chain's tip where nothing gives, at (N, d) positions of its drives."""
        self._check_rows(q)
        if self.tree.passive:
            raise ShapeError("an arm with joints without a drive has no pose of its drives alone")
        checked(poses, "poses", REAL, len(q), 4, 4)
        self._library.engine_tips(self._arm, len(q), *addresses((q, poses, self._work())))

    def room(self, rank: int) -> int:
        """Return how many numbers a controller works with, where laws have so many coordinates at most."""
        return int(self._library.engine_rest_room(self._arm, rank))

    def _check_rows(self, q: Array) -> None:
        checked(q, "q", REAL, len(q), self.tree.driven)
        for name in ("law_rows", "weight_rows", "wrench_rows", "change_rows"):
            if getattr(self.struct, name) not in (0, 1, len(q)) and len(q):
                raise ShapeError(f"{name}: expected 1 or {len(q)} rows, got {getattr(self.struct, name)}")

    def _check_chain(self) -> None:
        tree, n = self.tree, len(self.tree.flexures)
        order = tree.kinds[2, :n]
        follow = np.array_equal(np.sort(order), np.arange(n))
        if len(tree.joins) or tree.passive or not follow or self._laws is None:
            raise ShapeError("expected a chain, whose flexures follow each other, with laws")

    def _check_behind(self, into: Collection[str], behind: int) -> None:
        """Raise where there is not room for the closures and pins that C fills in behind the sites."""
        ties = self.tree.joins[:, 0]
        if not len(ties):
            return
        closures = int((ties < 6).sum())
        pins = 2 * int((ties < 5).sum())
        loads = len(ties) if "loads" in into and len(self.tree.rows) else 0
        needed = max(closures + pins if "at_sites" in into else 0, loads)
        if behind < needed:
            raise ShapeError(f"expected {needed} places behind the sites, got {behind}")

    def _work(self) -> Array:
        size = int(self._library.engine_room(self._arm))
        if size > len(self._room):
            self._room = np.empty(size)
        return self._room


class OneRow:
    """The engine with one chain in a control loop: positions in, where it rests out, in memory of its own.

    Attributes:
        quick: The call, its first argument, and what copies the displacement (6) that it filled. The second argument is
            the bytes of (d,) positions that were looked at. It returns 0 where there is no fixed point.
    """

    def __init__(self, tree: Tree, laws: Laws, bounds: Array, factors: Factors | None, known: Array) -> None:
        engine, n = Engine(tree), len(tree.flexures)
        self._engine = engine
        engine.set_laws(laws, 1)
        engine._check_chain()
        if factors is not None:
            engine.set_factors(factors, known)
        engine.set_bounds(bounds)
        self._memory = np.zeros(6 + 12 * n)
        self._links, self._wrenches = NO_LINKS, NO_WRENCHES
        self._motion, self._moves = np.zeros((1, 2, tree.driven)), False
        self._short, self._whole = OneStruct(), OneStruct()
        self._ask = engine._library["engine_one"]  # of its own, without types to look at in every call
        self._where, short = c_void_p(addressof(self._whole)), c_void_p(addressof(self._short))
        self.quick = self._ask, short, self._memory[:6].copy
        self._point()

    def set_loads(self, links: np.ndarray, wrenches: Array) -> None:
        """Give the (1, L, 9) loads on links, which are looked at once."""
        if links is self._links:
            self._wrenches[:] = wrenches
            return
        self._links, self._wrenches = links, wrenches.copy()
        self._engine.set_loads(links, self._wrenches, NO_CHANGES, 1)
        self._point()

    def _point(self) -> None:
        engine, self._held = self._engine, self._engine._work()
        displacement, twists, loads = addresses(parts_of(self._memory))
        room = address(self._held)
        for asked in (self._short, self._whole):  # in place: `quick` has the address of one
            asked.arm, asked.displacement, asked.room = engine._arm, displacement, room
        self._whole.twists, self._whole.loads = twists, loads
        engine._library.engine_ready(engine._arm, room)

    def __call__(self, q: Array, motion: Array | None = None) -> tuple[Array, Array, Array] | None:
        """Return displacement, twists and loads at (d,) positions, None where there is no fixed point.

        Args:
            q: (d,) positions.
            motion: (2, d) speeds and accelerations, None where it stands.
        """
        checked(q, "q", REAL, self._engine.tree.driven)
        if self._moves is not (motion is not None):
            self._moves = motion is not None
            self._engine.set_motion(self._motion if self._moves else None, 1)
            self._point()
        if motion is not None:
            self._motion[0] = motion
        return parts_of(self._memory.copy()) if self._ask(self._where, q.tobytes()) else None


def parts_of(found: Array) -> tuple[Array, Array, Array]:
    """Return (6,) displacement, (n, 6) twists and loads of an answer of `OneRow`, as views."""
    twists, loads = found[6:].reshape(2, len(found) // 12, 6)
    return found[:6], twists, loads


class OneRest:
    """The engine with one mechanism in a control loop: all that C reads and fills is where it was the last time."""

    def __init__(self, tree: Tree, into: Sequence[np.ndarray]) -> None:
        engine = self._engine = Engine(tree)
        engine._look_at(into)
        rows = len(tree.rows)
        self._q, self._free, self._idle = np.zeros(tree.driven), np.zeros(tree.passive), np.zeros((rows, rows))
        self._ask, self._where = engine._library.engine_rest, ()

    def know(self, laws: Laws, links: np.ndarray, wrenches: Array) -> None:
        """Give the laws of the flexures and the loads on links, arrays that may be changed in their place."""
        engine = self._engine
        engine.set_laws(laws, 1)
        engine.set_loads(links, wrenches, NO_CHANGES, 1)
        self._held = engine._work()
        given = address(self._free), address(self._idle), addressof(engine._rested), address(self._held)
        self._where = (engine._arm, 1, address(self._q), True, 0, *given)

    def __call__(self, q: Array, free: Array) -> bool:
        """Return whether it rests at (d,) positions of the drives, closed from (p,) passive joints; fill `into`."""
        self._q[:], self._free[:] = q, free
        return self._ask(*self._where) == 1
