"""The laws of all flexures asked about many loads at once."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from armflex.conventions import Array
from armflex.laws import Law, Row
from armflex.laws.network import NetworkLaw
from armflex.statics.law_stack import LawStack, constant_compliance


class BatchLaws:
    """The laws of a stack at N rows, as a map from (n, 6, N) loads to (n, 6, N) twists: configurations last.

    What is affine at given positions and covariates is looked up once for all rows. `parts` are laws of the stack with
    the numbers of their flexures, all where not given.
    """

    def __init__(self, stack: LawStack, row: Row, parts: Iterable[tuple[int, Law]] | None = None) -> None:
        count = len(stack.laws)
        self._row = row
        self._constant = np.zeros((count, 6, 6))
        self._affine: list[tuple[int, Array, Array]] = []
        self._curved: list[tuple[int, Law]] = []
        self._compliances: dict[int, Array] = {}
        self._networks: list[tuple[int, NetworkLaw]] = []
        for i, law in stack.parts if parts is None else parts:
            compliance = constant_compliance(law)
            if compliance is not None:
                self._constant[i] += compliance
            elif isinstance(law, NetworkLaw):
                self._networks.append((i, law))
            else:
                self._take(i, law)

    def _take(self, i: int, law: Law) -> None:
        affine = law.affine(self._row)
        if affine is None:
            self._curved.append((i, law))
            return
        self._affine.append((i, *affine))
        self._compliances[id(law)] = affine[1]

    def __call__(self, loads: Array) -> Array:
        """Return the twists [m, rad] under loads [N, Nm]."""
        found = np.matmul(self._constant, loads)
        for i, law in self._networks:
            units, bias, gains, constant = law.neurons()
            values = units.T @ loads[i, : law.size]
            values += bias[:, None]
            np.tanh(values, out=values)
            found[i, : law.size] += gains.T @ values + constant[:, None]
        for i, twist, compliance in self._affine:
            found[i] += np.moveaxis(twist, 0, -1) if twist.ndim > 1 else twist[:, None]
            if compliance.any():
                found[i] += np.einsum("...ij,j...->i...", compliance, loads[i])
        for i, law in self._curved:
            found[i] += np.moveaxis(np.broadcast_to(law.twist(loads[i].T, self._row), loads[i].T.shape), 0, -1)
        return found

    def tangent(self, law: Law, loads: Array) -> Array:
        """Return the (N, 6, 6) tangent of one of the laws under (N, 6) loads."""
        known = self._compliances.get(id(law))
        return law.tangent(loads, self._row) if known is None else known

    @property
    def numbers(self) -> tuple[Array, ...] | None:
        """The laws as plain arrays, for compiled code; None where some bend in a way that arrays do not say.

        compliance, offset: (R, n, 6, 6) and (R, n, 6) of what is affine, R being 1 or N.
        neurons: (H, 13) units (6), bias and gains (6) of all networks, loads and twists in SI.
        starts: (n + 1,) first neuron of each flexure.
        """
        if self._curved:
            return None
        each = any(twist.ndim > 1 or compliance.ndim > 2 for _, twist, compliance in self._affine)
        total = np.repeat(self._constant[None], len(self._row.q) if each else 1, axis=0)
        offset = np.zeros(total.shape[:3])
        for i, twist, compliance in self._affine:
            offset[:, i] += twist
            total[:, i] += compliance
        for i, law in self._networks:
            offset[:, i, : law.size] += law.neurons()[3]
        return total, offset, *self._neurons()

    def _neurons(self) -> tuple[Array, np.ndarray]:
        """Return `neurons` and `starts`."""
        placed = sorted(self._networks, key=lambda pair: pair[0])
        rows, counts = [np.zeros((0, 13))], np.zeros(len(self._constant) + 1, dtype=np.int64)
        for i, law in placed:
            units, bias, gains, _ = law.neurons()
            own = np.zeros((len(bias), 13))
            own[:, : law.size], own[:, 6], own[:, 7 : 7 + law.size] = units.T, bias, gains
            rows.append(own)
            counts[i + 1] += len(bias)
        return np.concatenate(rows), np.cumsum(counts)
