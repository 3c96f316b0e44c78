"""The laws of all flexures asked about many loads at once, configurations last."""

from __future__ import annotations

import numpy as np

from armflex.conventions import Array
from armflex.laws import Law, Row
from armflex.laws.network import NetworkLaw
from armflex.statics.law_stack import LawStack, constant_compliance


class BatchLaws:
    """The laws of a stack at N rows, as a map from (n, 6, N) loads to (n, 6, N) twists.

    What is affine at given positions and covariates is looked up once for all rows.
    """

    def __init__(self, stack: LawStack, row: Row) -> None:
        count = len(stack.laws)
        self._row = row
        self._constant = np.zeros((count, 6, 6))
        self._affine: list[tuple[int, Array, Array]] = []
        self._curved: list[tuple[int, Law]] = []
        self._compliances: dict[int, Array] = {}
        self._networks: list[tuple[int, Array, Array, Array, Array]] = []
        for i, law in stack.parts:
            compliance = constant_compliance(law)
            if compliance is not None:
                self._constant[i] += compliance
            elif isinstance(law, NetworkLaw):
                units, bias, gains, constant = law.neurons()
                self._networks.append((i, units.T, bias[:, None], gains.T, constant[:, None]))
            else:
                self._take(i, law)

    def _take(self, i: int, law: Law) -> None:
        affine = law.affine(self._row)
        if affine is None:
            self._curved.append((i, law))
            return
        twist, compliance = affine
        last = (np.moveaxis(twist, 0, -1) if twist.ndim > 1 else twist[:, None], compliance)
        self._affine.append((i, *last))
        self._compliances[id(law)] = compliance

    def __call__(self, loads: Array) -> Array:
        """Return the twists [m, rad] under loads [N, Nm]."""
        found = np.matmul(self._constant, loads)
        for i, units, bias, gains, constant in self._networks:
            values = units @ loads[i, : len(gains)]
            values += bias
            np.tanh(values, out=values)
            found[i, : len(gains)] += gains @ values + constant
        for i, twist, compliance in self._affine:
            found[i] += twist
            if compliance.any():
                found[i] += np.einsum("...ij,j...->i...", compliance, loads[i])
        for i, law in self._curved:
            found[i] += np.moveaxis(np.broadcast_to(law.twist(loads[i].T, self._row), loads[i].T.shape), 0, -1)
        return found

    def tangent(self, law: Law, loads: Array) -> Array:
        """Return the (N, 6, 6) tangent of one of the laws under (N, 6) loads."""
        known = self._compliances.get(id(law))
        return law.tangent(loads, self._row) if known is None else known
