"""What a loaded arm does in many rows: where it rests, and how its tip responds to whatever may be otherwise.

Everything an arm does beyond its model is a small twist at a place or a load on a link. Both change the loads on the
flexures as well, so their effect on the tip goes through the equilibrium. With J the tip's Jacobian, C the laws'
tangent, G the geometric stiffness and M = I + C G J_exp the equilibrium's tangent,

    tip per law change   B = J_F M^-1
    tip per body twist   A = J - B C G        (joints and every site, loads redistributing)
    tip per load change  B C                  (change of the flexures' wrenches)

Only B and C are kept of each row, some kilobytes; see the head of engine.c for how everything else follows from them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from armflex.conventions import Array
from armflex.laws import Row
from armflex.mechanics.equilibrium import MAX_ROTATION, Equilibrium, check_small, find_equilibrium
from armflex.mechanics.laws import RowLaws
from armflex.mechanics.loaded import LoadedArm, Payload, Structure
from armflex.mechanics.loop_rows import solver_of
from armflex.mechanics.many_rows import (
    ManyRows,
    RowSolver,
    Solution,
    by_payload,
    within,
)
from armflex.mechanics.mechanism import Rest
from armflex.mechanics.pinocchio_model import LoadCase
from armflex.parallel import in_pieces, in_threads
from armflex.rows.wrench import Wrench, check_rows

AT_ONCE = 1024
"""Rows whose tip's response to all loads is held at once."""


MEMBERS = {
    "laws": "laws",
    "per_load": "per_load",
    "joints": "joints",
    "twists": "at_sites",
    "link_loads": "motions",
    "wrenches": "loads",
    "links": "poses",
}
"""What may be asked of a `Response`, as the engine calls it; see `responded`."""

STATES = ("links", "wrenches")
"""Those that are the same whatever end is meant."""


@dataclass(frozen=True, eq=False)
class Response:
    """An arm solved at N rows; all motions of its tip are at the tip's origin in base axes [m, rad].

    What was not asked for beforehand is found when it is looked at, and kept.

    Attributes:
        row: What was known in the rows: joint positions and covariates.
        flexure_wrenches: (N, n, 6) load on the structure at the flexures, local axes [N, Nm].
        flexure_twists: (N, 6 n) what the flexures do under them [m, rad].
        link_names: Links at and beyond the base.
        sites: Names of the sites in order: 'base', 'link:A2' (before A2's motion), 'A2' (after it), ..., 'tool'.
        case: Joint positions and all that acted, in every row.
        end: The link whose origin is meant wherever a motion is of the tip, None where it is the tip; see `of`.
    """

    row: Row
    flexure_wrenches: Array
    flexure_twists: Array
    link_names: tuple[str, ...]
    sites: tuple[str, ...]
    _parts: tuple[ManyRows, ...]
    case: LoadCase
    _kept: dict[str, Array]
    end: str | None = None

    def of(self, link: str | None) -> Response:
        """Return the same rows with the motions of another link's origin in place of the tip's; None is the tip."""
        if link == self.end:
            return self
        if link not in self._ends:
            same = {name: self._kept[name] for name in STATES if name in self._kept}
            self._ends[link] = replace(self, _kept=same, end=link)
        return self._ends[link]

    @cached_property
    def _ends(self) -> dict[str | None, Response]:
        return {}

    def some(self, rows: np.ndarray) -> Response:
        """Return the response in (M,) rows, none of them twice."""
        number = np.full(len(self.row.q), -1)
        number[rows] = np.arange(len(rows))
        every = [whole.among(number) for whole in self._parts]
        parts = tuple(part for part in every if len(part.rows)) or (every[0],)
        arrays = self.flexure_wrenches[rows], self.flexure_twists[rows]
        names, case = (self.link_names, self.sites), self.case.some(rows)
        found = Response(self.row.some(rows), *arrays, *names, parts, case, _some(self._kept, rows), self.end)
        for link, one in self._ends.items():
            found._ends[link] = replace(found, _kept=_some(one._kept, rows), end=link)
        return found

    @property
    def tip(self) -> Array:
        """(N, 4, 4) tip pose in the base."""
        return self.links[:, self.link_names.index(self.end or self._parts[0].loaded.robot.tip)]

    @property
    def links(self) -> Array:
        """(N, l, 4, 4) pose of every link."""
        return self._asked("links")

    @property
    def laws(self) -> Array:
        """(N, 6, n, 6) motion of the tip per change of a flexure's twist law."""
        return self._asked("laws")

    @property
    def per_load(self) -> Array:
        """(N, 6, n, 6) motion of the tip per change of a flexure's wrench."""
        return self._asked("per_load")

    @property
    def joints(self) -> Array:
        """(N, 6, nq) motion of the tip per joint, loads redistributing."""
        return self._asked("joints")

    @property
    def twists(self) -> Array:
        """(N, 6, s, 6) motion of the tip per body twist at a site, loads redistributing."""
        return self._asked("twists")

    @property
    def wrenches(self) -> Array:
        """(N, s, 6) load on the structure at every site, local axes [N, Nm]."""
        return self._asked("wrenches")

    @property
    def link_loads(self) -> Array:
        """(N, l, 6, 6) motion of the tip per wrench at a link's origin, base axes."""
        return self._asked("link_loads")

    @cached_property
    def gravity(self) -> Array:
        """(N, 6, 3) motion of the tip per change of gravity in base axes [per m/s^2]."""
        found = np.empty((len(self.row.q), 6, 3))
        for part in self._parts:
            found[part.place] = part.by_gravity(self.end, self.row.q[part.place], self._twists[part.place])
        for one in (one for one in self.case.wrenches if one.hangs):  # beside the chain, not in the model
            place = self.link_names.index(one.frame)
            found += self.link_loads[:, place] @ one.by_gravity(self.links[:, place])
        return found

    def equilibrium(self, row: int) -> Equilibrium:
        """Return how the arm rests in one row, as one that is asked by itself."""
        part = next(one for one in self._parts if row in one.rows)
        case = self.case.some(row)
        case = case._replace(wrenches=tuple(one.under(part.loaded.robot.gravity) for one in case.wrenches))
        if part.loaded.arm.robot.linkage:
            return find_equilibrium(part.loaded, case, allow_large=True)
        rest = Rest(np.zeros(6), self._twists[row], self.flexure_wrenches[row])
        return Equilibrium(part.loaded, case, rest, "exact")

    def site(self, name: str) -> Array:
        """Return the (N, 6, 6) motion of the tip per body twist at a site."""
        return self.twists[:, :, self.sites.index(name), :]

    def load_at(self, name: str) -> Array:
        """Return the (N, 6) wrench at a site, local axes [N, Nm]."""
        return self.wrenches[:, self.sites.index(name)]

    @property
    def _twists(self) -> Array:
        return self.flexure_twists.reshape(self.flexure_wrenches.shape)

    def _asked(self, name: str) -> Array:
        if name not in self._kept:
            into, twists = _room(self._parts[0].loaded, (name,), len(self.row.q)), self._twists
            for part in self._parts:
                _answer(part, self.end, self.row.q[part.place], twists[part.place], into)
            self._kept.update(into)
        return self._kept[name]


def _room(loaded: LoadedArm, names: Sequence[str], count: int) -> dict[str, Array]:
    """Return arrays for members of the response of an arm in some rows."""
    shapes = loaded.tree.answers(len(loaded.site_names), len(loaded.links))
    return {name: np.empty((count, *shapes[MEMBERS[name]])) for name in names}


def _answer(
    part: ManyRows, end: str | None, q: Array, twists: Array, into: dict[str, Array], proof: bool = False
) -> Array:
    """Fill members of a response in a part of its rows; return (M,) what is below 1 where it is proven to stay."""
    place = part.place
    views = {MEMBERS[name]: values[place] for name, values in into.items() if isinstance(place, slice)}
    names = [*(MEMBERS[name] for name in into), *["distance"] * proof]
    found = part.asked(names, end, q, twists, views)
    for name in () if views else into:
        into[name][place] = found[MEMBERS[name]]
    return found["distance"] if proof else np.zeros(len(q))


def _some(kept: Mapping[str, Array], rows: np.ndarray) -> dict[str, Array]:
    return {name: values[rows] for name, values in kept.items()}


def respond(
    arm: Structure,
    q: Array,
    payloads: Sequence[str | Payload],
    covariates: Mapping[str, Array] | None = None,
    allow_large: bool = False,
    wrenches: Sequence[Wrench] = (),
    gravity: Array | None = None,
    ask: Sequence[str] = (),
) -> Response:
    """Return what the arm does at (N, nq) joint positions with a payload each.

    Args:
        arm: The arm.
        q: Joint positions [rad or m]; limits are not looked at.
        payloads: (N) names or objects.
        covariates: (N,) each or numbers, by name.
        allow_large: Whether flexures may turn by more than 0.1 rad.
        wrenches: Loads from outside at named links, the same in all rows or one for each.
        gravity: (N, 3) in base axes [m/s^2] where it is not that of the arm in all rows.
        ask: Members of the response that are found at once, see `MEMBERS`: together they take less time than each.

    Raises:
        UnknownNameError, MissingCovariateError: No such payload; an effect depends on what is not given.
        ConvergenceError, UnstableEquilibriumError, SmallDisplacementError: As `find_equilibrium`, for some row.
    """
    known = {name: np.asarray(values) for name, values in (covariates or {}).items()}
    q, n = np.ascontiguousarray(q), len(arm.sites)
    case = LoadCase(q, wrenches=tuple(wrenches), covariates=known)
    loads, twists = np.empty((len(q), n, 6)), np.empty((len(q), n, 6))

    def solved(asked: tuple[LoadedArm, np.ndarray]) -> ManyRows:
        loaded, rows = asked
        own = case.some(rows)
        own = own._replace(wrenches=tuple(one.under(loaded.robot.gravity) for one in own.wrenches))
        part, found = _settled(loaded, rows, own, into, allow_large)
        loads[rows], twists[rows] = found.loads, found.twists
        return part

    check_rows(wrenches, len(q))
    groups = list(by_payload(arm, payloads if len(q) else (None,), len(q)))
    if gravity is not None and len(q):
        each, number = np.unique(gravity, axis=0, return_inverse=True)
        groups = [
            (loaded.under(one), some)
            for loaded, own in groups
            for i, one in enumerate(each)
            if len(some := own[number.ravel()[own] == i])
        ]
    # No rows are a part, too.
    pieces = [(loaded, some) for loaded, own in groups for some in in_pieces(own, AT_ONCE) or [own]]
    into = _room(pieces[0][0], ("laws", *ask), len(q))
    parts = tuple(in_threads(solved, pieces))
    named = (parts[0].loaded.links, parts[0].loaded.site_names)
    return Response(Row(q, arm.joint_index, known), loads, twists.reshape(len(q), 6 * n), *named, parts, case, into)


def _settled(
    loaded: LoadedArm, rows: np.ndarray, case: LoadCase, into: dict[str, Array], allow_large: bool
) -> tuple[ManyRows, Solution]:
    """Return some rows of one payload at rest, and put what is asked about them into their rows of `into`."""
    q, names, state = np.ascontiguousarray(case.q), loaded.arm.stack.names, None
    row, found = loaded.row(q, case.covariates), Solution.empty(loaded.tree, len(q))
    laws, left = RowLaws(loaded.arm.stack, row), np.zeros(0, dtype=int)
    if loaded.tied:

        def alone(i: int) -> Rest:
            return find_equilibrium(loaded, case.some(i), "exact", allow_large).rest

        solver, judged = solver_of(loaded, case.wrenches), np.ones(len(q), dtype=bool)
        state = found.flexed, found.forces, solver.rest(q, row, found, alone).idle
    else:
        solver = RowSolver(loaded, case.wrenches)
        left = np.flatnonzero(~solver.solve(row, laws, found))
        judged = within(q, *solver.limits) & bool(solver.bound and solver.bound.proven)
    while True:  # what is not proven here is the reference's, which judges it itself
        for i in left.tolist():
            found.put(i, find_equilibrium(loaded, case.some(i), "newton", allow_large).rest)
        judged[left] = True
        if laws.curved:
            laws.expand(found.loads)
        part = ManyRows(loaded, rows, solver.pushes.at(q, found.twists, state), laws.numbers, state)
        distance = _answer(part, None, q, found.twists, into, not judged.all())
        left = np.flatnonzero(~(judged | (distance < 1.0)))
        if not len(left):
            break
    turns = found.twists[:, :, 3:]
    large = ~(np.einsum("nia,nia->ni", turns, turns) <= MAX_ROTATION**2)
    for i in () if allow_large else np.flatnonzero(large.any(axis=1)):
        check_small(found.twists[i], names)
    return part, found
