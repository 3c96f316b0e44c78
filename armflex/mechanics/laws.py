"""The laws of all flexures as one map from loads to twists, and as the numbers that both engines work with."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from armflex.conventions import Array
from armflex.errors import Flag
from armflex.laws import Law, Row
from armflex.laws.law import NOTHING, NOWHERE, UNLOADED

Motion = Callable[[Array], Array]

TAME = 1e60
"""Largest compliance of laws whose twists need not be looked at [m/N, rad/(N m)]."""


@dataclass(frozen=True)
class LawStack:
    """The laws of all flexures as one map from (..., 6 n) wrenches to (..., 6 n) twists."""

    names: tuple[str, ...]
    laws: tuple[Law, ...]

    @cached_property
    def places(self) -> tuple[tuple[str, slice, Law], ...]:
        """Names, places among the twists and laws of the flexures."""
        named = enumerate(zip(self.names, self.laws, strict=True))
        return tuple((name, slice(6 * i, 6 * i + 6), law) for i, (name, law) in named)

    @cached_property
    def parts(self) -> tuple[tuple[int, Law], ...]:
        """Every flexure's laws that add up, each with the number of its flexure."""
        return tuple((i, part) for i, law in enumerate(self.laws) for part in law.parts)

    def twists(self, wrenches: Array, row: Row) -> Array:
        """Return the (..., 6 n) twists [m, rad] under (..., 6 n) wrenches [N, Nm]."""
        twists = np.empty_like(wrenches)
        for _, place, law in self.places:
            twists[..., place] = law.twist(wrenches[..., place], row)
        return twists

    def tangent(self, wrenches: Array, row: Row) -> Array:
        """Return the (..., 6 n, 6 n) block-diagonal derivative of the twists [m/N, rad/Nm]."""
        total = np.zeros((*wrenches.shape, wrenches.shape[-1]))
        for _, place, law in self.places:
            total[..., place, place] = law.tangent(wrenches[..., place], row)
        return total

    def change_with_position(self, wrenches: Array, row: Row) -> Array:
        """Return the (..., 6 n, nq) derivative of the twists [m, rad] by the joint positions at given loads."""
        change = np.zeros((*wrenches.shape, row.q.shape[-1]))
        if self.changing:
            for i, step in enumerate(1e-4 * np.eye(row.q.shape[-1])):
                ends = [self.twists(wrenches, replace(row, q=row.q + side * step)) for side in (1.0, -1.0)]
                change[..., i] = (ends[0] - ends[1]) / 2e-4
        return change

    def covariance(self, wrenches: Array, row: Row) -> Array | None:
        """Return the (6 n, 6 n) covariance of the twists [m, rad] at given loads, None when no law carries one."""
        total, known = np.zeros((len(wrenches),) * 2), False
        for _, place, law in self.places:
            part = law.covariance(wrenches[place], row)
            if part is not None:
                total[place, place], known = part, True
        return total if known else None

    @cached_property
    def trained(self) -> tuple[tuple[str, slice, Law], ...]:
        """`places` of the flexures whose law was trained."""
        return tuple(place for place in self.places if place[2].trained)

    def flags(self, wrenches: Array, row: Row) -> tuple[Flag, ...]:
        """Return where (6 n,) wrenches [N, Nm] are beyond what a law was trained on."""
        asked = [(name, law.flags(wrenches[place], row)) for name, place, law in self.trained]
        return tuple(replace(f, text=f"flexure {name!r}: {f.text}", about=name) for name, flags in asked for f in flags)

    @cached_property
    def changing(self) -> tuple[tuple[int, Law], ...]:
        """The parts that are neither a constant compliance nor a network."""
        return tuple((i, law) for i, law in self.parts if law.constant is None and law.neurons() is None)

    @cached_property
    def hardened(self) -> dict[int, Law]:
        """The law of every flexure that hardens, by its number; of several the first."""
        return {i: law for i, law in reversed(self.changing) if law.hardening() is not None}

    @cached_property
    def asked(self) -> tuple[tuple[int, Law], ...]:
        """The parts that must be asked in every row: those that `numbers` are not about."""
        return tuple((i, law) for i, law in self.changing if self.hardened.get(i) is not law)

    @cached_property
    def numbers(self) -> tuple[Array, Array, Array, np.ndarray, Array]:
        """(1, n, 6, 6), (1, n, 6), (H, 13), (n + 1,), (n, 7, 6) numbers, in SI units, of what is the same everywhere.

        Compliance and offset of the laws, `twist = compliance @ wrench + offset`; units (6), bias and gains (6) of all
        networks' neurons, loads and twists in SI; first neuron of each flexure; of the law that hardens there C, and r
        in the last row's first place, see `Law.hardening`.
        """
        n, neurons, starts = len(self.laws), [np.zeros((0, 13))], np.zeros(len(self.laws) + 1, dtype=np.int64)
        compliance, offset = np.zeros((1, n, 6, 6)), np.zeros((1, n, 6))
        for i, law in self.parts:
            if law.constant is not None:
                compliance[0, i] += law.constant
            elif (parts := law.neurons()) is not None:
                units, bias, gains, shift = parts
                own, size = np.zeros((len(bias), 13)), len(shift)
                own[:, :size], own[:, 6], own[:, 7 : 7 + size] = units.T, bias, gains
                offset[0, i, :size] += shift
                starts[i + 1 :] += len(bias)
                neurons.append(own)
        hardening = np.zeros((n, 7, 6))
        for i, law in self.hardened.items():
            own = law.hardening()
            assert own is not None
            hardening[i, :6], hardening[i, 6, 0] = own
        return compliance, offset, np.concatenate(neurons), starts, hardening


class RowLaws:
    """The laws of a stack at N rows, or at one, as numbers.

    What is affine at the rows' positions and covariates is looked up once for all of them, networks and what hardens
    stand as they are, and every other law as its affine expansion about some loads: see `expand`.

    Attributes:
        compliance, offset: (R, n, 6, 6) and (R, n, 6) of what is affine or expanded, R being 1 or N.
        neurons, starts, hardening: See `LawStack.numbers`.
        curved: Laws that must be expanded, with the numbers of their flexures.
        bent: Whether tangents depend on loads all the same.
    """

    def __init__(self, stack: LawStack, row: Row | None = None) -> None:
        self._stack, self._row = stack, NOWHERE if row is None else row  # laws that are the same everywhere need none
        compliance, offset, self.neurons, self.starts, self.hardening = stack.numbers
        self.bent = len(self.neurons) > 0 or bool(stack.hardened)
        self.compliance, self.offset = compliance.copy(), offset.copy()
        self.curved: list[tuple[int, Law]] = []
        self._known: dict[int, Array] = {}
        if row is not None and stack.asked:
            self.know(row)

    def know(self, row: Row) -> None:
        """Ask the laws in other rows; the arrays are filled anew, and are others only for another number of rows."""
        affine, self.curved, self._known = [], [], {}
        for i, law in self._stack.asked:
            found = law.affine(row)
            if found is None:
                self.curved.append((i, law))
            else:
                affine.append((i, *found))
                self._known[id(law)] = found[1]
        self._row, self._slopes, (compliance, offset, *_) = row, [], self._stack.numbers
        single = row.q.ndim == 1
        many = not single and (self.curved or any(part[1].ndim > 1 or part[2].ndim > 2 for part in affine))
        count = len(row.q) if many else 1
        if len(self.compliance) != count:
            self.compliance, self.offset = np.repeat(compliance, count, axis=0), np.repeat(offset, count, axis=0)
        else:
            np.copyto(self.compliance, compliance)
            np.copyto(self.offset, offset)
        for i, twist, softer in affine:
            if twist is not NOTHING:
                self.offset[:, i] += twist
            if softer is not UNLOADED:
                self.compliance[:, i] += softer
        self._affine = (self.compliance.copy(), self.offset.copy()) if self.curved and not single else None

    @property
    def numbers(self) -> tuple[Array, Array, Array, np.ndarray, Array]:
        """Compliance, offset, neurons, starts and hardening."""
        return self.compliance, self.offset, self.neurons, self.starts, self.hardening

    def expand(self, loads: Array, slopes: bool = True) -> Array:
        """Expand the curved laws about (N, n, 6) loads; return (N,) by how much their twists there were otherwise.

        Between two expansions the equilibrium is solved exactly, so that this is Newton's method on the laws alone;
        without `slopes` their tangents stay those of the last expansion (the chord method), which are dear to ask for.
        """
        before = np.einsum("nkij,nkj->nki", self.compliance, loads) + self.offset
        assert self._affine is not None  # in many rows; in one nothing is expanded
        np.copyto(self.offset, self._affine[1])
        if slopes:
            np.copyto(self.compliance, self._affine[0])
            self._slopes = [law.tangent(loads[:, i], self._row) for i, law in self.curved]
        for (i, law), tangent in zip(self.curved, self._slopes, strict=True):
            if slopes:
                self.compliance[:, i] += tangent
            self.offset[:, i] += law.twist(loads[:, i], self._row) - (tangent @ loads[:, i, :, None])[..., 0]
        after = np.einsum("nkij,nkj->nki", self.compliance, loads) + self.offset
        return np.sqrt(((after - before) ** 2).sum(axis=(1, 2)))

    def tangent(self, law: Law, loads: Array) -> Array:
        """Return the (N, 6, 6) tangent of one of the laws under (N, 6) loads."""
        known = self._known.get(id(law))
        return law.tangent(loads, self._row) if known is None else known

    def tangents(self, loads: Array) -> Array:
        """Return the (1 or N, n, 6, 6) tangents of all laws of a flexure together under (N, n, 6) loads.

        Where laws are curved they must have been expanded about these.
        """
        if not self.bent:
            return self.compliance
        total = np.broadcast_to(self.compliance, (len(loads), *self.compliance.shape[1:])).copy()
        for i in range(len(self.starts) - 1):
            own = self.neurons[self.starts[i] : self.starts[i + 1]]
            slopes = 1.0 - np.tanh(loads[:, i] @ own[:, :6].T + own[:, 6]) ** 2
            total[:, i] += (slopes @ (own[:, 7:, None] * own[:, None, :6]).reshape(len(own), 36)).reshape(-1, 6, 6)
        for i, law in self._stack.hardened.items():
            total[:, i] += law.tangent(loads[:, i], self._row)
        return total


class PlacedLaws:
    """The laws at one row as a map from Pinocchio's generalized torques to velocities: no gathering, no signs to turn.

        v = matrix tau + gains tanh(units tau + bias) + what hardens gives + offset + what is curved gives

    A torque is minus the load that deforms. Velocities of joints are zero, and torques on them do not count.

    Attributes:
        motion: (nv,) generalized torques to the (nv,) twists, among zeros, that the laws give at the row that is known.
        curved: Whether laws must be asked under every load.
        bent: Whether tangents depend on the load.
        tame: Whether no weight can give twists whose squares overflow, by what of them is the same everywhere.
    """

    def __init__(self, stack: LawStack, places: np.ndarray, size: int) -> None:
        (compliance, offset, neurons, starts, hardening), matrix = stack.numbers, np.zeros((size, size))
        units, gains = np.zeros((len(neurons), size)), np.zeros((size, len(neurons) + 1))
        for here, block in zip(places, compliance[0], strict=True):
            matrix[np.ix_(here, here)] = -block
        own = places[np.repeat(np.arange(len(places)), np.diff(starts))]
        np.put_along_axis(units, own, -neurons[:, :6], axis=1)
        np.put_along_axis(gains[:, :-1].T, own, neurons[:, 7:], axis=1)
        gains[places, -1] = offset[0]
        networks = _networks(units, neurons[:, 6].copy(), gains) if len(neurons) else None
        hardened, softest = _hardened(hardening, places, size) if stack.hardened else (None, 0.0)
        self._bent = [part for part in (networks, hardened) if part]
        self.motion = self._usual = _sum([_times(matrix)] * bool(matrix.any()) + self._bent)
        self._stack, self._size, self._same, self._matrix = stack, size, matrix, matrix.copy()
        self._places = [slice(int(here[0]), int(here[5]) + 1) for here in places]
        self._softer: list[slice] = []
        self._row = NOWHERE
        self._known: dict[int, Array] = {}
        self.changing, self.curved, self.bent = bool(stack.asked), False, bool(self._bent)
        self.tame = max(abs(matrix).max(initial=0.0), abs(gains).max(initial=0.0), softest) < TAME

    def know(self, row: Row) -> None:
        """Take in the row of the questions to come; needed where laws depend on more than the load."""
        offset, curved, self._row, self._known = np.zeros(self._size), [], row, {}
        for here in self._softer:
            self._matrix[here, here] = self._same[here, here]
        self._softer = []
        for i, law in self._stack.asked:
            here, found = self._places[i], law.affine(row)
            if found is None:
                curved.append((here, law))
                continue
            twist, compliance = found
            self._known[id(law)] = compliance
            if twist is not NOTHING:
                offset[here] += twist
            if compliance is not UNLOADED:
                self._matrix[here, here] -= compliance
                self._softer.append(here)
        self.curved, self.bent = bool(curved), bool(curved or self._bent)
        together = _sum([self._matrix.dot, *self._bent]) if self._softer else self._usual

        def motion(torque: Array) -> Array:
            found = together(torque)
            found += offset
            for here, law in curved:
                found[here] += law.twist(-torque[here], row)
            return found

        self.motion = motion

    def tangent(self, law: Law, load: Array) -> Array:
        """Return the (6, 6) tangent of one of the laws under a (6,) load, at the row that is known."""
        known = self._known.get(id(law))
        return law.tangent(load, self._row) if known is None else known


def _networks(units: Array, bias: Array, gains: Array) -> Motion:
    """Return the map of all networks' neurons together, (H, nv) units and (nv, H + 1) gains with the constant last."""
    hidden = np.ones(len(bias) + 1)
    inner, into, out, tanh = hidden[:-1], units.dot, gains.dot, np.tanh

    def networks(torque: Array) -> Array:
        into(torque, inner)
        np.add(inner, bias, inner)
        tanh(inner, inner)
        return out(hidden)

    return networks


def _hardened(hardening: Array, places: np.ndarray, size: int) -> tuple[Motion, float]:
    """Return the map of all laws that harden together, `LawStack.numbers`' (n, 7, 6), and the largest of their C."""
    matrix, rates, owner = np.zeros((size, size)), np.zeros((len(places), size)), np.zeros(size, dtype=np.intp)
    for i, here in enumerate(places):
        matrix[np.ix_(here, here)], rates[i, here], owner[here] = -hardening[i, :6], -hardening[i, 6, 0], i
    straight, energies = _times(matrix), rates.dot

    def hardened(torque: Array) -> Array:
        found = straight(torque)
        more = energies(torque * found)
        more += 1.0
        found /= np.sqrt(more, more)[owner]
        return found

    return hardened, float(abs(matrix).max())


def _times(matrix: Array) -> Motion:
    """Return the map that a matrix is; a diagonal one, as is usual, takes a third of the time."""
    diagonal = np.diag(matrix).copy()
    same = np.count_nonzero(matrix) == np.count_nonzero(diagonal)
    return partial(np.multiply, diagonal) if same else matrix.dot


def _sum(motions: Sequence[Motion]) -> Motion:
    """Return the map of the laws that need not be asked one by one."""
    if len(motions) < 2:
        return motions[0] if motions else np.zeros_like
    first, *others = motions

    def together(torque: Array) -> Array:
        found = first(torque)
        for one in others:
            found += one(torque)
        return found

    return together
