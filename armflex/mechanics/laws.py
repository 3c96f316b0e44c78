"""The laws of all flexures as one map from loads to twists, and the same where Pinocchio has its numbers."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from armflex.conventions import Array
from armflex.errors import Flag
from armflex.laws import Law, Row


@dataclass(frozen=True)
class LawStack:
    """The laws of all flexures as one map from (..., 6 n) wrenches to (..., 6 n) twists.

    Constant linear laws are one block-diagonal matrix, so that asking costs one product.
    """

    names: tuple[str, ...]
    laws: tuple[Law, ...]

    @cached_property
    def constant(self) -> Array:
        """(6 n, 6 n) block-diagonal compliance of the constant laws, zero elsewhere."""
        total = np.zeros((6 * len(self.laws),) * 2)
        for i, law in enumerate(self.laws):
            if law.constant is not None:
                total[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] = law.constant
        return total

    @cached_property
    def others(self) -> tuple[tuple[slice, Law], ...]:
        """Places and laws that must be asked one by one."""
        return tuple((slice(6 * i, 6 * i + 6), law) for i, law in enumerate(self.laws) if law.constant is None)

    def twists(self, wrenches: Array, row: Row) -> Array:
        """Return the (..., 6 n) twists."""
        twists = wrenches @ self.constant.T
        for place, law in self.others:
            twists[..., place] = law.twist(wrenches[..., place], row)
        return twists

    def tangent(self, wrenches: Array, row: Row) -> Array:
        """Return the (..., 6 n, 6 n) block-diagonal derivative of the twists."""
        if not self.others and wrenches.ndim == 1:
            return self.constant
        total = np.broadcast_to(self.constant, (*wrenches.shape[:-1], *self.constant.shape)).copy()
        for place, law in self.others:
            total[..., place, place] = law.tangent(wrenches[..., place], row)
        return total

    def change_with_position(self, wrenches: Array, row: Row) -> Array:
        """Return the (6 n, nq) derivative of the twists with respect to the joint positions at given loads."""
        change = np.zeros((len(wrenches), len(row.q)))
        if self.others:
            for i, step in enumerate(1e-4 * np.eye(len(row.q))):
                ends = [self.twists(wrenches, replace(row, q=row.q + side * step)) for side in (1.0, -1.0)]
                change[:, i] = (ends[0] - ends[1]) / 2e-4
        return change

    def covariance(self, wrenches: Array, row: Row) -> Array | None:
        """Return the (6 n, 6 n) covariance of the twists at given loads, None when no law carries one."""
        parts = [law.covariance(wrenches[6 * i : 6 * i + 6], row) for i, law in enumerate(self.laws)]
        if all(part is None for part in parts):
            return None
        total = np.zeros((len(wrenches),) * 2)
        for i, part in enumerate(parts):
            if part is not None:
                total[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] = part
        return total

    @cached_property
    def trained(self) -> tuple[tuple[str, slice, Law], ...]:
        """Names, places and laws of the flexures whose law was trained."""
        named = enumerate(zip(self.names, self.laws, strict=True))
        return tuple((name, slice(6 * i, 6 * i + 6), law) for i, (name, law) in named if law.trained)

    def doubts(self, wrenches: Array, row: Row) -> tuple[Flag, ...]:
        """Return where (6 n,) wrenches are beyond what a law was trained on."""
        asked = [(name, law.doubts(wrenches[place], row)) for name, place, law in self.trained]
        return tuple(replace(f, text=f"flexure {name!r}: {f.text}", about=name) for name, flags in asked for f in flags)

    @cached_property
    def parts(self) -> tuple[tuple[int, Law], ...]:
        """Every flexure's laws that add up, each with the number of its flexure."""
        return tuple((i, part) for i, law in enumerate(self.laws) for part in law.parts)


class RowLaws:
    """The laws of a stack at N rows as numbers, for compiled code.

    What is affine at the rows' positions and covariates is looked up once for all of them, networks stand as they are,
    and every other law as its affine expansion about some loads: see `expand`. `parts` are laws of the stack with the
    numbers of their flexures, all where not given.

    Attributes:
        compliance, offset: (R, n, 6, 6) and (R, n, 6) of what is affine or expanded, R being 1 or N.
        neurons: (H, 13) units (6), bias and gains (6) of all networks, loads and twists in SI.
        starts: (n + 1,) first neuron of each flexure.
        curved: Laws that must be expanded, with the numbers of their flexures.
    """

    def __init__(self, stack: LawStack, row: Row, parts: Iterable[tuple[int, Law]] | None = None) -> None:
        affine: list[tuple[int, Array, Array]] = []
        networks: list[tuple[int, Law]] = []
        self.curved: list[tuple[int, Law]] = []
        self._row, self._known, self._slopes = row, {}, []
        for i, law in stack.parts if parts is None else parts:
            if law.neurons() is not None:
                networks.append((i, law))
                continue
            found = law.affine(row)
            if found is None:
                self.curved.append((i, law))
            else:
                affine.append((i, *found))
                self._known[id(law)] = found[1]
        each = bool(self.curved) or any(twist.ndim > 1 or compliance.ndim > 2 for _, twist, compliance in affine)
        self.compliance = np.zeros((len(row.q) if each else 1, len(stack.laws), 6, 6))
        self.offset = np.zeros(self.compliance.shape[:3])
        for i, twist, compliance in affine:
            self.offset[:, i] += twist
            self.compliance[:, i] += compliance
        self.neurons = np.zeros((sum(len(law.neurons()[1]) for _, law in networks), 13))
        self.starts = np.zeros(len(stack.laws) + 1, dtype=np.int64)
        at = 0
        for i, law in sorted(networks, key=lambda pair: pair[0]):
            units, bias, gains, constant = law.neurons()
            own, at = self.neurons[at : at + len(bias)], at + len(bias)
            size = len(constant)
            own[:, :size], own[:, 6], own[:, 7 : 7 + size] = units.T, bias, gains
            self.offset[:, i, :size] += constant
            self.starts[i + 1 :] += len(bias)
        self._affine = (self.compliance.copy(), self.offset.copy()) if self.curved else None

    @property
    def numbers(self) -> tuple[Array, Array, Array, np.ndarray]:
        """Compliance, offset, neurons and starts."""
        return self.compliance, self.offset, self.neurons, self.starts

    def expand(self, loads: Array, slopes: bool = True) -> Array:
        """Expand the curved laws about (N, n, 6) loads; return (N,) by how much their twists there were otherwise.

        Between two expansions the equilibrium is solved exactly, so that this is Newton's method on the laws alone;
        without `slopes` their tangents stay those of the last expansion (the chord method), which are dear to ask for.
        """
        before = np.einsum("nkij,nkj->nki", self.compliance, loads) + self.offset
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
        if not len(self.neurons):
            return self.compliance
        total = np.broadcast_to(self.compliance, (len(loads), *self.compliance.shape[1:])).copy()
        for i in range(len(self.starts) - 1):
            own = self.neurons[self.starts[i] : self.starts[i + 1]]
            slopes = 1.0 - np.tanh(loads[:, i] @ own[:, :6].T + own[:, 6]) ** 2
            total[:, i] += (slopes @ (own[:, 7:, None] * own[:, None, :6]).reshape(len(own), 36)).reshape(-1, 6, 6)
        return total


MOST_NEURONS = 64
"""Networks with more (those of a posterior) are asked by themselves: side by side they would be mostly zeros."""


@dataclass(frozen=True, eq=False)
class PlacedLaws:
    """The laws as a map from Pinocchio's generalized torques to velocities: no gathering, no signs to turn.

        v = matrix tau + gains tanh(units tau + bias)  +  the others'

    A torque is minus the load that deforms. Velocities of joints are zero, and torques on them do not count.

    Attributes:
        matrix: (nv, nv) of the laws that are the same everywhere and proportional to the load.
        units: (H, nv) of all networks' neurons together; bias: (H,).
        gains: (nv, H + 1) with the constant last.
        others: Laws that depend on more than the load, or bend in another way, with the number and the six places of
            their flexures.
    """

    matrix: Array
    units: Array
    bias: Array
    gains: Array
    others: tuple[tuple[int, slice, Law], ...]


def place_laws(stack: LawStack, places: Sequence[np.ndarray], size: int) -> PlacedLaws:
    """Return the laws of a stack whose flexures' twists are at some (6,) places of `size` generalized velocities."""
    matrix, others = np.zeros((size, size)), []
    networks: list[tuple[np.ndarray, Law]] = []
    for number, part in stack.parts:
        here, compliance, neurons = places[number], part.constant, part.neurons()
        if compliance is not None:
            matrix[np.ix_(here, here)] -= compliance
        elif neurons is not None and len(neurons[1]) <= MOST_NEURONS:
            networks.append((here, part))
        else:
            others.append((number, slice(int(here[0]), int(here[-1]) + 1), part))
    return PlacedLaws(matrix, *_stacked(networks, size), tuple(others))


def _stacked(networks: Sequence[tuple[np.ndarray, Law]], size: int) -> tuple[Array, Array, Array]:
    """Return `units`, `bias` and `gains` of networks at their places."""
    total = sum(len(law.neurons()[1]) for _, law in networks)
    units, bias, gains = np.zeros((total, size)), np.zeros(total), np.zeros((size, total + 1))
    start = 0
    for here, law in networks:
        into, offset, out, constant = law.neurons()
        own, acting = slice(start, start + len(offset)), here[: len(constant)]
        units[own, acting], bias[own] = -into.T, offset
        gains[acting, own] = out.T
        gains[acting, -1] += constant
        start = own.stop
    return units, bias, gains
