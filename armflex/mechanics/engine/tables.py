"""One description of an arm as arrays: what C reads of it, every size and every index checked before.

engine.h has the same fields in the same order.
"""

from __future__ import annotations

from collections.abc import Sequence
from ctypes import Structure, c_int64, c_void_p
from dataclasses import dataclass
from functools import cached_property
from threading import local
from typing import NamedTuple

import numpy as np

from armflex.conventions import Array
from armflex.errors import InputError, ShapeError

FLEXURE, TURNS, SLIDES, RIGID, ROTATED = 0, 1, 2, 3, 4
"""Kinds of elements; `ROTATED` is added where one is rotated against the one before."""

ROD, GEAR, COIL, GAS = range(4, 8)
"""Kinds of ties: cylinders, followers, and springs by their law; pins are 0 to 3, by how many axes they hold."""

SHAPES, FACTORS = 6, 11
"""How many kinds of features and of factors there are; see `Kind` and `Of` in `laws.terms`."""

POWER, CHEBYSHEV, TABLE = 1, 9, 10
MOST_POWER = 1000

WHOLE = np.dtype(np.int64)
REAL = np.dtype(np.float64)
NO_CHANGES = np.zeros((0, 0, 6, 6))


State = tuple[Array, Array, Array]
"""(N, p) passive joints, (N, m) forces in closures and (N, m, m) what nothing answers to."""


class ArmArraysError(InputError):
    """Arrays that describe no arm; C never sees them."""


NUMBERS = (
    "count flexures driven passive ties rows pushes terms factors changing law_rows weight_rows wrench_rows change_rows"
)
ARRAYS = (
    "elements kinds parents carried tie joins row way flexure compliance offset neurons starts bent shapes spans "
    "pieces weights factor knots change weighing varies known bounds links wrenches changes pulls windowed windows "
    "inertias motion"
)


BY_ROW = ("compliance", "offset", "weights", "wrenches", "changes", "motion")
"""Arrays that have a row of their own for each row that is asked about."""


class ArmStruct(Structure):
    """`arm` of engine.h."""

    _fields_ = [(name, c_int64) for name in NUMBERS.split()] + [(name, c_void_p) for name in ARRAYS.split()]


RESTED = ("closed", "tips", "flexed", "twists", "loads", "forces", "displacement", "distance", "idles")
ASKED = ("laws", "per_load", "joints", "at_sites", "loads", "motions", "poses", "distance")


class RestStruct(Structure):
    """`rested` of engine.h."""

    _fields_ = [(name, c_void_p) for name in (*RESTED, "ends")]


class AskedStruct(Structure):
    """`asked` of engine.h."""

    _fields_ = [
        ("end", c_void_p), ("frames", c_int64), ("places", c_void_p), ("numbers", c_void_p), ("sites", c_int64),
        ("bodies", c_int64), ("body_places", c_void_p), ("body_numbers", c_void_p),
        *((name, c_void_p) for name in ASKED),
    ]  # fmt: skip


class OneStruct(Structure):
    """`asked_one` of engine.h."""

    _fields_ = [(name, c_void_p) for name in ("arm", "displacement", "twists", "loads", "room")]


def address(array: np.ndarray) -> int:
    """Return where an array's numbers are; whoever gives that to C keeps the array."""
    return array.__array_interface__["data"][0]


def checked(array: np.ndarray, name: str, kind: np.dtype, *shape: int | tuple[int, ...]) -> np.ndarray:
    """Return an array that C can read; raise where its type, shape or order is another.

    Args:
        array: To be looked at.
        name: What it is called.
        kind: Of its numbers.
        shape: Its lengths; several of which any will do as a tuple.
    """
    if array.shape == shape and array.dtype == kind and array.flags.c_contiguous:  # as nearly always
        return array
    fits = array.ndim == len(shape) and all(
        size in allowed if isinstance(allowed, tuple) else size == allowed
        for size, allowed in zip(array.shape, shape, strict=True)
    )
    if array.dtype != kind or not fits or not array.flags.c_contiguous:
        raise ShapeError(f"{name}: expected {kind} {shape} row by row, got {array.dtype} {array.shape}")
    return array


def _within(values: np.ndarray, name: str, low: int, high: int) -> None:
    """Raise where a number is not at least `low` and less than `high`."""
    if len(values) and not (low <= values.min() and values.max() < high):
        raise ArmArraysError(f"{name}: expected numbers from {low} to {high - 1}, got {values.min()} to {values.max()}")


def _climbing(starts: np.ndarray, name: str, last: int) -> None:
    """Raise where places do not climb from 0 to `last`."""
    if starts[0] != 0 or starts[-1] != last or (np.diff(starts) < 0).any():
        raise ArmArraysError(f"{name}: expected places that climb from 0 to {last}, got {starts.tolist()}")


@dataclass(frozen=True, eq=False)
class Frames:
    """Frames that are fixed to elements of an arm.

    Attributes:
        names: Of the frames.
        places: (2, f) the element that each is fixed to, and the first that moves where a twist is inserted at it.
        numbers: (f, 12) rotation (9) row by row and origin (3) [m] in its element.
    """

    names: tuple[str, ...]
    places: np.ndarray
    numbers: Array

    def some(self, index: Sequence[int]) -> Frames:
        """Return some of the frames."""
        places = np.ascontiguousarray(self.places[:, index])  # the engine is compiled for one order
        return Frames(tuple(self.names[i] for i in index), places, self.numbers[index])


NO_FRAMES = Frames((), np.zeros((2, 0), dtype=WHOLE), np.zeros((0, 12)))


@dataclass(frozen=True, eq=False)
class Tree:
    """An arm with a payload; side branches hang on the elements that carry them.

    Element k is Pinocchio's joint k: a joint, a flexure, or nothing that moves. Element 0 is the root, which stands.
    The first of T ties close m rows, the others are springs; a chain has neither.

    Attributes:
        elements: (k + 1, 20) of each element: rotation (9) row by row and origin (3) [m] in the one before, axis (3),
            mass [kg] and centre (3) [m] of what is fixed to it. The last row is the tip's frame, with gravity [m/s^2]
            for an axis and, for a mass, the number of the element that it is fixed to. Column 19 is of a chain's
            flexures by number: the mass outboard [kg].
        kinds: (3, k) kind; number of the joint in q, passive ones after the drives with cylinders among them, or of the
            flexure; numbers of the flexures from base to tip, filled up with -1.
        parents: (k,) the element before each, which has a lower number.
        carried: (T, k) 1 where an element moves the second end alone, -1 the first alone.
        ties: (T, 45) points on both ends (6), axes of a pin on both ends (18) and axes of both links (18), and at 24:
            offset of a length; factor and offset of a gear; stiffness, length and preload; thrust, length and exponent.
        joins: (T, 6) kind, elements of both ends (of a gear the joints), rows from and to, number of the length in q.
        rows, ways: (m, 6) what each row closes of its closure's slots, and that in axes of its first element.
        flexures: (n,) element of each, or minus 1 and minus the number of its closure.
        inertias: (k, 6) xx yy zz xy xz yz of what is fixed to each element about its centre, its axes [kg m^2].
        driven, passive: How many positions have a drive, cylinders among them, and how many joints have none.
    """

    elements: Array
    kinds: np.ndarray
    parents: np.ndarray
    carried: Array
    ties: Array
    joins: np.ndarray
    rows: Array
    ways: Array
    flexures: np.ndarray
    inertias: Array
    driven: int
    passive: int

    @property
    def order(self) -> np.ndarray:
        """(n,) numbers of a chain's flexures from base to tip."""
        return self.kinds[2, : len(self.flexures)]

    def flexures_inboard(self, element: int) -> int:
        """Return how many flexures of a chain move an element."""
        return int((self.flexures <= element).sum())

    def answers(self, sites: int, bodies: int) -> dict[str, tuple[int, ...]]:
        """Return the shapes of a row of all that `Engine.respond` answers, closures and pins among the sites."""
        n = len(self.flexures)
        of_sites = {"at_sites": (6, sites, 6), "loads": (sites, 6)}
        of_bodies = {"motions": (bodies, 6, 6), "poses": (bodies, 4, 4)}
        whole = {"laws": (6, n, 6), "per_load": (6, n, 6), "joints": (6, self.driven), "distance": ()}
        return whole | of_sites | of_bodies

    @cached_property
    def kept(self) -> local:
        """What each thread keeps of it; see `Engine.of`."""
        return local()

    @cached_property
    def struct(self) -> ArmStruct:
        """What C reads of it, checked; laws and loads are not in it yet."""
        k, n, t, m = len(self.parents), len(self.flexures), len(self.joins), len(self.rows)
        checked(self.elements, "elements", REAL, k + 1, 20)
        checked(self.kinds, "kinds", WHOLE, 3, k)
        checked(self.parents, "parents", WHOLE, k)
        checked(self.carried, "carried", REAL, t, k)
        checked(self.ties, "ties", REAL, t, 45)
        checked(self.joins, "joins", WHOLE, t, 6)
        checked(self.rows, "rows", REAL, m, 6)
        checked(self.ways, "ways", REAL, m, 6)
        checked(self.flexures, "flexures", WHOLE, n)
        checked(self.inertias, "inertias", REAL, k, 6)
        self._check_elements()
        self._check_ties()
        numbers = {"count": k, "flexures": n, "driven": self.driven, "passive": self.passive, "ties": t, "rows": m}
        return ArmStruct(**numbers, **{name: address(array) for name, array in self.arrays.items()})

    @cached_property
    def arrays(self) -> dict[str, np.ndarray]:
        """Its arrays by the names that `arm` of engine.h has for them."""
        nothing = np.zeros(len(self.flexures) + 1, dtype=WHOLE)  # until there are laws
        return {
            "elements": self.elements, "kinds": self.kinds, "parents": self.parents, "carried": self.carried,
            "tie": self.ties, "joins": self.joins, "row": self.rows, "way": self.ways, "flexure": self.flexures,
            "inertias": self.inertias, **dict.fromkeys(("starts", "spans", "pieces", "varies"), nothing),
        }  # fmt: skip

    def _check_elements(self) -> None:
        k, n, joints = len(self.parents), len(self.flexures), self.driven + self.passive
        if not k or self.driven < 0 or self.passive < 0:
            raise ArmArraysError("an arm has a root, and no number of joints below 0")
        if (self.parents[1:] >= np.arange(1, k)).any() or (self.parents < 0).any():
            raise ArmArraysError("parents: expected the number of an element before each")
        _within(self.kinds[0], "kinds", 0, 8)
        kind, number = self.kinds[0] & 3, self.kinds[1]
        if kind[0] != RIGID:
            raise ArmArraysError("kinds: the root stands")
        moving = (kind == TURNS) | (kind == SLIDES)
        _within(number[moving], "joints", 0, joints)
        _within(number[kind == FLEXURE], "flexures", 0, n)
        if len(np.unique(number[moving])) != moving.sum():
            raise ArmArraysError("kinds: a joint moves two elements")
        if set(range(self.driven, joints)) - set(number[moving].tolist()):
            raise ArmArraysError("kinds: a joint without a drive moves no element")
        inner = self.flexures[self.flexures >= 0]
        _within(inner, "flexures", 1, k)
        if not np.array_equal(np.sort(inner), np.flatnonzero(kind == FLEXURE)):
            raise ArmArraysError("flexures: expected the elements that give, each once")
        if (number[inner] != np.flatnonzero(self.flexures >= 0)).any():
            raise ArmArraysError("kinds: a flexure has another number than its element")
        _within(closures := -1 - self.flexures[self.flexures < 0], "closures of flexures", 0, len(self.joins))
        if (self.joins[closures, 0] > ROD).any():
            raise ArmArraysError("flexures: a gear or a spring has none")
        if not 0.0 <= self.elements[-1, 15] < k or self.elements[-1, 15] % 1.0:
            raise ArmArraysError(f"elements: the tip is on element {self.elements[-1, 15]} of {k}")

    def _check_ties(self) -> None:
        k, m, kind = len(self.parents), len(self.rows), self.joins[:, 0]
        _within(kind, "ties", 0, GAS + 1)
        _within(self.joins[:, 1:3].ravel(), "ends of ties", 0, k)
        if not np.isin(self.carried, (-1.0, 0.0, 1.0)).all():
            raise ArmArraysError("carried: expected -1, 0 or 1")
        springs, gears, rods = kind >= COIL, kind == GEAR, kind == ROD
        if (np.diff(springs.astype(int)) < 0).any():
            raise ArmArraysError("ties: springs stand behind closures")
        start, end = self.joins[:, 3], self.joins[:, 4]
        _within(start[springs], "rows of springs", m, m + len(kind))
        if (end < start).any() or (end[springs] != start[springs]).any() or (end[~springs] > m).any():
            raise ArmArraysError("joins: rows of a tie end before they start, or are none")
        if (start < 0).any() or ((end - start)[rods | gears] != 1).any() or (start[~springs] > m).any():
            raise ArmArraysError("joins: rows of a tie end before they start, or are none")
        if (end - start)[~springs].sum() != m or not np.array_equal(start[~springs], np.append(0, end[~springs])[:-1]):
            raise ArmArraysError("joins: expected rows that follow each other")
        if (np.diff(gears[~springs].astype(int)) < 0).any():
            raise ArmArraysError("ties: gears stand behind other closures")
        _within(self.joins[rods, 5], "lengths", 0, self.driven)
        followers, masters = self.joins[gears, 1], self.joins[gears, 2]
        if not np.isin(self.kinds[0, self.joins[gears, 1:3].ravel()] & 3, (TURNS, SLIDES)).all():
            raise ArmArraysError("ties: a gear is between joints")
        _within(self.kinds[1, followers], "followers", self.driven, self.driven + self.passive)
        _within(self.kinds[1, masters], "masters", 0, self.driven + self.passive)


class Laws(NamedTuple):
    """The laws of n flexures in numbers, in SI units; R is 1 or the number of rows.

    Attributes:
        compliance, offset: (R, n, 6, 6) and (R, n, 6): what is affine in the load.
        neurons, starts: (H, 13, 4) units (6), bias and gains (6) of blocks of four neurons each, some of which may be
            nothing, and (n + 1,) the first block of each flexure.
        bent: (T, 43) of every curved term: matrix (36), along (6), and 1 where there is a matrix.
        shapes: (S, 45) of every feature: kind, bias, exponent, u (6) and form (36); see `laws.terms`.
        spans, pieces: (n + 1,) the first term of each flexure, and (T + 1,) the first feature of each term.
        weights: (R, T) product of every term's factors.
    """

    compliance: Array
    offset: Array
    neurons: Array
    starts: np.ndarray
    bent: Array
    shapes: Array
    spans: np.ndarray
    pieces: np.ndarray
    weights: Array

    def some(self, rows: np.ndarray, count: int) -> Laws:
        """Return the laws in (M,) of N rows, whose number is given."""
        by_row = {"compliance": self.compliance, "offset": self.offset, "weights": self.weights}
        return self._replace(**{name: one[rows] for name, one in by_row.items() if len(one) > 1 or not count})


@dataclass(frozen=True, eq=False)
class Factors:
    """Factors of columns that the engine asks itself, row by row; see `laws.terms.Factor`.

    Attributes:
        factor: (F, 6) kind, column, a, b, c, d; the first is 1. Of a table: a, b, its first knot, and how many, below 0
            where it closes. Columns are joints, the payload's mass, and covariates.
        knots: Values of tables.
        change: (C, 45) parts of laws that are affine in the load: flexure, two factors, offset (6), compliance (36).
        weighing: (T, 2) factors of curved terms.
        varies: (n,) 1 where a flexure has such a part.
        names: Of the covariates.
    """

    factor: Array
    knots: Array
    change: Array
    weighing: np.ndarray
    varies: np.ndarray
    names: tuple[str, ...]


class Tables:
    """An arm as C reads it: the struct, and the arrays that it points to. One thread's at a time.

    Attributes:
        tree: The arm.
        struct: For C in this process.
        arrays: What it points to, by the names of engine.h: exported C has the same.
    """

    def __init__(self, tree: Tree) -> None:
        self.tree, self.struct, self.arrays = tree, ArmStruct.from_buffer_copy(tree.struct), dict(tree.arrays)
        self._laws: Laws | None = None

    def set_laws(self, laws: Laws, rows: int) -> None:
        """Point to the laws of so many rows."""
        if laws is self._laws and self.struct.law_rows == self.struct.weight_rows == 1:
            return
        n, struct, allowed = len(self.tree.flexures), self.struct, (1, rows)
        neurons, terms, features = len(laws.neurons), len(laws.bent), len(laws.shapes)
        if laws.neurons is not self.arrays.get("neurons") or laws.bent is not self.arrays.get("bent"):
            self._point("neurons", checked(laws.neurons, "neurons", REAL, neurons, 13, 4))
            self._point("starts", checked(laws.starts, "starts", WHOLE, n + 1))
            self._point("bent", checked(laws.bent, "bent", REAL, terms, 43))
            self._point("shapes", checked(laws.shapes, "shapes", REAL, features, 45))
            self._point("spans", checked(laws.spans, "spans", WHOLE, n + 1))
            self._point("pieces", checked(laws.pieces, "pieces", WHOLE, terms + 1))
            _climbing(laws.starts, "starts", neurons)
            _climbing(laws.spans, "spans", terms)
            _climbing(laws.pieces, "pieces", features)
            if not np.isin(laws.shapes[:, 0], range(SHAPES)).all():
                raise ArmArraysError(f"shapes: expected kinds from 0 to {SHAPES - 1}")
        by_row = {"compliance": (laws.compliance, (n, 6, 6)), "offset": (laws.offset, (n, 6))}
        for name, (array, shape) in (by_row | {"weights": (laws.weights, (terms,))}).items():
            if array is not self.arrays.get(name) or len(array) > 1:
                self._point(name, checked(array, name, REAL, allowed, *shape))
        if len(laws.offset) != len(laws.compliance):
            raise ShapeError(f"offset: expected {len(laws.compliance)} rows, got {len(laws.offset)}")
        struct.terms, struct.law_rows, struct.weight_rows = terms, len(laws.compliance), len(laws.weights)
        self._laws = laws

    def set_loads(self, links: np.ndarray, wrenches: Array, changes: Array, rows: int) -> None:
        """Point to the loads on links in so many rows; see `rest.Pushes`."""
        kept, count, struct = self.arrays, len(links), self.struct
        if links is not kept.get("links"):
            self._point("links", checked(links, "links", WHOLE, count, 3))
            _within(links[:, 0], "links", 0, len(self.tree.parents))
            _within(links[:, 1], "flexures inboard of links", 0, len(self.tree.flexures) + 1)
            struct.pushes = count
        if wrenches is not kept.get("wrenches") or len(wrenches) != struct.wrench_rows or len(wrenches) > 1:
            self._point("wrenches", checked(wrenches, "wrenches", REAL, (1, rows), count, 9))
            struct.wrench_rows = len(wrenches)
        if changes is not kept.get("changes") or len(changes) != struct.change_rows or len(changes) > 1:
            if len(changes):
                checked(changes, "changes", REAL, (1, rows), count, 6, 6)
            self._point("changes", changes)
            struct.change_rows = len(changes)

    def set_factors(self, factors: Factors, known: Array) -> None:
        """Point to factors that are asked in each row, and to (1 + c,) the payload's mass and covariates."""
        struct, count, n = self.struct, len(factors.factor), len(self.tree.flexures)
        checked(factors.factor, "factors", REAL, count, 6)
        checked(factors.change, "changing parts", REAL, len(factors.change), 45)
        checked(factors.weighing, "factors of terms", WHOLE, struct.terms, 2)
        checked(factors.varies, "varies", WHOLE, n)
        checked(factors.knots, "knots", REAL, len(factors.knots))
        checked(known, "known", REAL, 1 + len(factors.names))
        columns = self.tree.driven + len(known)
        _within(factors.factor[:, 1], "columns", 0, columns)
        _within(factors.factor[:, 0], "kinds of factors", 0, FACTORS)
        _within(factors.change[:, 0], "flexures", 0, n)
        _within(factors.change[:, 1:3].ravel(), "factors", 0, count)
        _within(factors.weighing.ravel(), "factors", 0, count)
        if (factors.factor[:, :2] % 1.0).any() or (factors.change[:, :3] % 1.0).any() or factors.factor[0, 0]:
            raise ArmArraysError("factors: expected whole numbers, and 1 first")
        for kind, _, _, _, first, size in factors.factor.tolist():
            if kind == TABLE and not (
                abs(size) >= (2 if size > 0 else 3) and 0 <= first <= len(factors.knots) - abs(size)
            ):
                raise ArmArraysError(f"factors: a table of {size:g} knots from {first:g} of {len(factors.knots)}")
            if kind in (POWER, CHEBYSHEV) and not 0 <= first <= MOST_POWER:
                raise ArmArraysError(f"factors: a power of {first:g}")
        for name in ("factor", "knots", "change", "weighing", "varies"):
            self._point(name, getattr(factors, name))
        self._point("known", known)
        struct.factors, struct.changing = count, len(factors.change)

    def set_motion(self, motion: Array | None, rows: int) -> None:
        """Point to (N, 2, d) speeds and accelerations of a chain's joints, None where it stands."""
        if motion is None:
            self.struct.motion = None
            return
        self._point("motion", checked(motion, "motion", REAL, rows, 2, self.tree.driven))

    def set_pulls(self, pulls: Array) -> None:
        """Point to (L, 6) kind, anchor, size and reach of what pulls at links."""
        self._point("pulls", checked(pulls, "pulls", REAL, self.struct.pushes, 6))

    def set_windows(self, windowed: np.ndarray, windows: Array) -> None:
        """Point to (T,) the window of each term, -1 for none, and (W, 79) what they are of."""
        self._point("windowed", checked(windowed, "windowed", WHOLE, self.struct.terms))
        self._point("windows", checked(windows, "windows", REAL, len(windows), 79))
        _within(windowed, "windows", -1, len(windows))

    def set_bounds(self, bounds: Array) -> None:
        """Point to (2, d) least and largest positions."""
        self._point("bounds", checked(bounds, "bounds", REAL, 2, self.tree.driven))

    def forget(self) -> None:
        """Forget for how many rows laws and loads are, and let go of what is by row."""
        struct, kept, self._laws = self.struct, self.arrays, None
        for name in BY_ROW:
            if len(kept.get(name, ())) > 1:
                del kept[name]
        struct.law_rows = struct.weight_rows = struct.wrench_rows = struct.change_rows = 0
        struct.motion = None

    def _point(self, name: str, array: np.ndarray) -> None:
        self.arrays[name] = array
        setattr(self.struct, name, address(array))


def addresses(arrays: Sequence[np.ndarray | None]) -> list[int | None]:
    """Return where arrays' numbers are, None of those that are not there."""
    return [None if array is None else address(array) for array in arrays]
