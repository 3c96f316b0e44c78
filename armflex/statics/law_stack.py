"""The laws of all flexures as one map from loads to twists, and the same where Pinocchio has its numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from armflex.conventions import Array
from armflex.errors import Flag
from armflex.laws import Law, LinearLaw, Row, StructuralLaw
from armflex.laws.learned import LearnedLaw
from armflex.laws.network import NetworkLaw

MOST_NEURONS = 64
"""Networks with more (those of a posterior) are asked by themselves: side by side they would be mostly zeros."""


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
            compliance = constant_compliance(law)
            if compliance is not None:
                total[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] = compliance
        return total

    @cached_property
    def others(self) -> tuple[tuple[slice, Law], ...]:
        """Places and laws that must be asked one by one."""
        return tuple(
            (slice(6 * i, 6 * i + 6), law) for i, law in enumerate(self.laws) if constant_compliance(law) is None
        )

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


def constant_compliance(law: Law) -> Array | None:
    """Return the (6, 6) compliance of a law that is proportional to the load, the same everywhere; None of others."""
    if isinstance(law, LinearLaw):
        return law.compliance
    if isinstance(law, LearnedLaw):
        return law.constant
    return law.linear_compliance if isinstance(law, StructuralLaw) else None


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
    networks: list[tuple[np.ndarray, NetworkLaw]] = []
    for number, part in stack.parts:
        here, compliance = places[number], constant_compliance(part)
        if compliance is not None:
            matrix[np.ix_(here, here)] -= compliance
        elif isinstance(part, NetworkLaw) and len(part.neurons()[1]) <= MOST_NEURONS:
            networks.append((here, part))
        else:
            others.append((number, slice(int(here[0]), int(here[-1]) + 1), part))
    return PlacedLaws(matrix, *_stacked(networks, size), tuple(others))


def _stacked(networks: Sequence[tuple[np.ndarray, NetworkLaw]], size: int) -> tuple[Array, Array, Array]:
    """Return `units`, `bias` and `gains` of networks at their places."""
    total = sum(len(law.neurons()[1]) for _, law in networks)
    units, bias, gains = np.zeros((total, size)), np.zeros(total), np.zeros((size, total + 1))
    start = 0
    for here, law in networks:
        into, offset, out, constant = law.neurons()
        own, acting = slice(start, start + len(offset)), here[: law.size]
        units[own, acting], bias[own] = -into.T, offset
        gains[acting, own] = out.T
        gains[acting, -1] += constant
        start = own.stop
    return units, bias, gains
