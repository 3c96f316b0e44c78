"""Composed joint: sub-joints and beams assembled by matrix structural analysis, condensed onto the tip node.

The paper's eqs (1) to (6), with `K23^4` in the lower block of (4) where `K22^4` is printed. A sub-joint stands
between ground and a node and may follow any law. With linear laws the condensed compliance is that of
`K = K22 - K21 K11^-1 K12`; with others the condensation is a small equilibrium of its own, solved by Newton:

    K u + A^T s = F            beams and sub-joints carry the load at the tip
    A u - law(s) = 0           each sub-joint gives as its law says

with node twists u and the loads s on the sub-joints. Taking the sub-joints by their compliance lets a direction be
rigid. The arm's mission is equilibrium, so this solver is our own rather than a structural package's.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from armflex.conventions import Array
from armflex.errors import ConvergenceError, Flag, LawError, UnknownNameError
from armflex.laws.joint.beam import Beam, MeshedBeam, Section, stiffness
from armflex.laws.joint.carried import ScaledLaw
from armflex.laws.joint.linear import LinearFit, LinearLaw, check_compliance
from armflex.laws.joint.log_compliance import LOOSE
from armflex.laws.law import Composed, Law, Parameter, Ranges, Row, SteppedLaw, check_ordered, sole_axis, unturned
from armflex.storage.schema import Numbers

EXAMPLE = """
model = "structural"
tip = "tip"
nodes = { near = [0.0, 0.0, 0.0], far = [0.3, 0.0, 0.0], tip = [0.4, 0.05, 0.0] }
subjoint = [
    { at = "near", compliance = [1e-8, 2e-8, 1e-8, 1e-6, 2e-6, 1e-6], relative_std = 0.05 },
    { at = "far", holds = ["dy", "dz"], compliance = [0.0, 1e-7, 2e-7, 0.0, 0.0, 0.0], relative_std = 0.05 },
]
beam = [
    { between = ["near", "far"], E = 2.1e11, G = 8e10, A = 1e-3, Iy = 2e-7, Iz = 3e-7, J = 4e-7 },
    { between = ["far", "tip"], E = 2.1e11, G = 8e10, A = 1e-3, Iy = 2e-7, Iz = 3e-7, J = 4e-7 },
]
"""

TOLERANCE = 1e-12

MOST = 1000
"""Nodes, sub-joints and beams at most."""

ARRAYS = {
    "nodes": Numbers(("nodes", 3)),
    "tip": Numbers((2,), least=0.0),
    "noise": Numbers((6,), least=0.0),
    "at": Numbers(("subjoints",), least=0.0),
    "holds": Numbers(("subjoints", 6), least=0.0, most=1.0),
    "compliance": Numbers(("subjoints", 6, 6)),
    "row_covariance": Numbers(("subjoints", 6, 6, 6), covariance=True),
    "loads": Numbers(("subjoints", 2, 6)),
    "beams": Numbers(("beams", 11)),
}
SIZES = {"nodes": range(1, MOST + 1), "subjoints": range(MOST + 1), "beams": range(MOST + 1)}
"""Arrays of a fitted law's file: sub-joints linear, nodes by number."""


@dataclass(frozen=True)
class SubJoint:
    """A law between ground and a node, in axes parallel to the structure's.

    Attributes:
        node: The node it holds.
        law: Its deformation model.
        holds: The components (0 to 5) it carries load in; the node is free in the others. A spherical bearing holds
            0, 1, 2, a drive about z holds 5.
    """

    node: str
    law: Law
    holds: tuple[int, ...] = (0, 1, 2, 3, 4, 5)


@dataclass(frozen=True)
class StructuralLaw(Composed):
    """Sub-joints and beams seen from the tip node.

    Attributes:
        nodes: (3,) position of each node in the flexure's frame [m].
        tip: The node that the next link hangs on.
        subjoints: What stands between ground and nodes.
        beams: What joins nodes.
        components: 6, or 3 for nodes that only translate, as in the paper.
        noise: (6,) scatter of the tip node about the law it was fitted to [m, rad], None where it was declared.
    """

    nodes: Mapping[str, Array]
    tip: str
    subjoints: tuple[SubJoint, ...]
    beams: tuple[Beam | MeshedBeam, ...]
    components: int = 6
    noise: Array | None = None

    def __post_init__(self) -> None:
        for name in (self.tip, *(s.node for s in self.subjoints), *(e for b in self.beams for e in (b.start, b.end))):
            if name not in self.nodes:
                raise UnknownNameError("node", name, self.nodes)
        # As if sub-joints were as stiff as beams: whether it holds is a question of geometry.
        system = self._system([np.eye(6) / self.scale] * len(self.subjoints))
        if np.linalg.matrix_rank(system, tol=1e-10) < len(system):
            raise LawError("the structure is a mechanism: some node can move with nothing giving")

    @cached_property
    def beam_stiffness(self) -> Array:
        """(k n, k n) stiffness of all beams over all nodes, in structure axes."""
        size = self.components
        total = np.zeros((size * len(self.nodes),) * 2)
        for beam in self.beams:
            places = np.concatenate([self._dofs(beam.start), self._dofs(beam.end)])
            total[np.ix_(places, places)] += stiffness(beam, self.nodes[beam.start], self.nodes[beam.end], size)
        return total

    @cached_property
    def scale(self) -> float:
        """A typical stiffness [N/m], so that the system mixes numbers of one size."""
        return float(np.abs(self.beam_stiffness).max()) or 1e8

    @cached_property
    def held(self) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
        """For each sub-joint its places among the node dofs and the components of its law that it holds."""
        axes = [np.array([i for i in sub.holds if i < self.components], dtype=int) for sub in self.subjoints]
        return tuple((self._dofs(sub.node)[i], i) for sub, i in zip(self.subjoints, axes, strict=True))

    @property
    def laws(self) -> tuple[Law, ...]:
        return tuple(sub.law for sub in self.subjoints)

    def with_laws(self, laws: Sequence[Law]) -> StructuralLaw:
        pairs = zip(self.subjoints, laws, strict=True)
        return replace(self, subjoints=tuple(replace(sub, law=law) for sub, law in pairs))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Those of all sub-joints, after the number and the node of each, and sized with it."""
        return tuple(
            replace(parameter, name=f"{number}@{sub.node}:{parameter.name}", group=f"sub-joint {number}")
            for number, sub in enumerate(self.subjoints, 1)
            for parameter in sub.law.parameters
        )

    @cached_property
    def constant(self) -> Array | None:
        """(6, 6) condensed compliance when every sub-joint's is constant, else None."""
        constants = self._constants
        return self._condense(self._system(constants)) if len(constants) == len(self.subjoints) else None

    @property
    def _constants(self) -> list[Array]:
        return [sub.law.constant for sub in self.subjoints if sub.law.constant is not None]

    @cached_property
    def _straight(self) -> tuple[list[Array], list[Array]]:
        """The gains of a structure of constant compliances, and the (6, 6) load on each sub-joint per load."""
        system = self._system(self._constants)
        return self._gains(system), self._by_subjoint(self._states_per_load(system)[self._size :])

    def twist(self, wrench: Array, row: Row) -> Array:
        """Return the twist of the tip node, carried to the flexure's origin.

        Raises:
            ConvergenceError: The small equilibrium of a nonlinear structure was not found.
        """
        if self.constant is not None:
            return wrench @ self.constant.T
        if wrench.ndim > 1:
            return self._each(self.twist, wrench, row)
        return self._solve(wrench, row)[0]

    def tangent(self, wrench: Array, row: Row) -> Array:
        if self.constant is not None:
            return np.broadcast_to(self.constant, (*wrench.shape, 6))
        if wrench.ndim > 1:
            return self._each(self.tangent, wrench, row)
        return self._condense(self._system(self._solve(wrench, row)[1]))

    @staticmethod
    def _each(ask: Callable[[Array, Row], Array], wrenches: Array, row: Row) -> Array:
        """Return what is asked at every load: each has an inner equilibrium of its own."""
        rows = row.repeated(len(wrenches))
        return np.stack([ask(wrench, rows.some(i)) for i, wrench in enumerate(wrenches)])

    def own_scatter(self, wrench: Array, row: Row) -> Array | None:
        return None if self.noise is None else np.diag(self.noise**2)

    def shares(self, wrench: Array, row: Row) -> list[tuple[Array, Array]]:
        if self.constant is not None:
            return [(gain, wrench @ load.T) for gain, load in zip(*self._straight, strict=True)]
        if wrench.ndim > 1:
            rows, flat = row.repeated(len(wrench)), wrench.reshape(-1, 6)
            each = [self.shares(load, rows.some(i)) for i, load in enumerate(flat)]
            return [
                (np.array([gain for gain, _ in pairs]), np.array([load for _, load in pairs]))
                for pairs in zip(*each, strict=True)
            ]
        _, tangents, loads = self._solve(wrench, row)
        return list(zip(self._gains(self._system(tangents)), loads, strict=True))

    def learned(self, travel: Ranges) -> StructuralLaw | None:
        """Return the structure with a factor on every axis that a sub-joint gives and holds, where all are linear."""
        if self.constant is None:
            return None
        laws = []
        for sub, compliance, (_, held) in zip(self.subjoints, self._constants, self.held, strict=True):
            axes, sole = tuple(int(axis) for axis in held if compliance[axis, axis] > 0.0), sole_axis(compliance)
            axes = axes if sole is None or not axes else (sole,)
            laws.append(ScaledLaw(sub.law, np.zeros(6), axes, sub.law.relative_std or LOOSE))
        return self.with_laws(laws)

    def moved(self, step: Array) -> Law:
        """Return the structure a step away to first order: what sub-joints do against each other cancels in that."""
        return SteppedLaw(self, step)

    def flags(self, wrench: Array, row: Row) -> tuple[Flag, ...]:
        """Return the flags about the loads on the sub-joints, and about a moment where nodes only translate."""
        if not self.trained:
            return ()
        asked = zip(self.subjoints, self._solve(wrench, row)[2], strict=True)
        flags = [(sub.node, flag) for sub, load in asked for flag in sub.law.flags(load, row)]
        inside = tuple(Flag(flag.code, f"sub-joint at {node!r}: {flag.text}") for node, flag in flags)
        return (*inside, *unturned(self.components, wrench))

    def _dofs(self, node: str) -> np.ndarray:
        return self.components * list(self.nodes).index(node) + np.arange(self.components)

    @property
    def _size(self) -> int:
        return self.components * len(self.nodes)

    def _by_subjoint(self, held: Array) -> list[Array]:
        """Return (m, ...) numbers, one for every component that is held, as (6, ...) of each sub-joint."""
        held_by = [np.zeros((6, *held.shape[1:])) for _ in self.held]
        for whole, (places, axes) in zip(held_by, self._held_places, strict=True):
            whole[axes] = held[places - self._size]
        return held_by

    @cached_property
    def _held_places(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """For each sub-joint the places of its loads among all unknowns, and the components that they are."""
        ends = self._size + np.cumsum([len(axes) for _, axes in self.held])
        return [(np.arange(end - len(axes), end), axes) for end, (_, axes) in zip(ends, self.held, strict=True)]

    @cached_property
    def _seen(self) -> Array:
        """(6, k n) map from node dofs to the tip node's twist at the flexure's origin (small displacements)."""
        seen = np.zeros((6, self._size))
        dofs = self._dofs(self.tip)
        seen[: self.components, dofs] = np.eye(self.components)
        x, y, z = self.nodes[self.tip]
        seen[:3] += np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) @ seen[3:]
        return seen

    def _system(self, compliances: Sequence[Array]) -> Array:
        """Return the scaled (kn + m, kn + m) matrix of the two equations above; loads are in units of `scale`."""
        total = self._size + sum(len(axes) for _, axes in self.held)
        matrix = np.zeros((total, total))
        matrix[: self._size, : self._size] = self.beam_stiffness / self.scale
        for (places, axes), (loads, _), compliance in zip(self.held, self._held_places, compliances, strict=True):
            matrix[places, loads] = matrix[loads, places] = 1.0
            matrix[np.ix_(loads, loads)] = -self.scale * compliance[np.ix_(axes, axes)]
        return matrix

    @cached_property
    def _rigid(self) -> Array:
        """The system of sub-joints that do not give."""
        return self._system([np.zeros((6, 6))] * len(self.subjoints))

    def _states_per_load(self, system: Array) -> Array:
        """Return (kn + m, 6) what all nodes do and sub-joints carry [1] per load at the tip."""
        states = _solved(system, np.vstack([self._seen.T, np.zeros((len(system) - self._size, 6))]) / self.scale)
        states[self._size :] *= self.scale
        return states

    def _condense(self, system: Array) -> Array:
        """Return the (6, 6) compliance at the tip."""
        return self._seen @ self._states_per_load(system)[: self._size]

    def _gains(self, system: Array) -> list[Array]:
        """Return for each sub-joint the (6, 6) twist of the tip per twist that it gives more.

        By reciprocity that is its load per load at the tip, transposed, where the compliances are.
        """
        return [gain.T for gain in self._by_subjoint(self._states_per_load(system.T)[self._size :])]

    def _solve(self, wrench: Array, row: Row) -> tuple[Array, list[Array], list[Array]]:
        """Return the tip twist, the sub-joints' tangents and the loads on them."""
        state = np.zeros(len(self._rigid))
        history: list[float] = []
        for _ in range(50):
            loads = self._by_subjoint(self.scale * state[self._size :])
            asked = list(zip(self.subjoints, loads, strict=True))
            tangents = [sub.law.tangent(load, row) for sub, load in asked]
            residual = self._rigid @ state
            residual[: self._size] -= self._seen.T @ wrench / self.scale
            for (sub, load), (places, axes) in zip(asked, self._held_places, strict=True):
                residual[places] -= sub.law.twist(load, row)[axes]
            history.append(float(np.abs(residual).max()))
            if history[-1] <= TOLERANCE * (np.abs(state).max() + np.abs(wrench).max() / self.scale):
                return self._seen @ state[: self._size], tangents, loads
            state = state - _solved(self._system(tangents), residual)
        raise ConvergenceError("the structure's inner equilibrium did not converge", history)


def _solved(system: Array, right: Array) -> Array:
    """Return the solution of a structure's equations; raise `LawError` where they have none."""
    try:
        return np.asarray(np.linalg.solve(system, right), float)
    except np.linalg.LinAlgError:
        text = "two rigid sub-joints hold one node the same way, or one is too soft beside the rest for doubles"
        raise LawError(f"the structure's equations are singular: {text}") from None


def to_tensors(law: StructuralLaw) -> dict[str, Array]:
    """Return a fitted law's arrays."""
    number, subjoints = {name: float(i) for i, name in enumerate(law.nodes)}, law.subjoints
    linear: list[Any] = [sub.law for sub in subjoints]  # as they are where a structure was fitted
    bars: list[Any] = [*law.beams]
    beams = [(number[bar.start], number[bar.end], *vars(bar.section).values(), *bar.up) for bar in bars]
    return {
        "nodes": np.array(list(law.nodes.values()), dtype=float),
        "tip": np.array([number[law.tip], float(law.components)]),
        "noise": np.zeros(6) if law.noise is None else law.noise,
        "at": np.array([number[sub.node] for sub in subjoints]),
        "holds": np.array([[float(axis in sub.holds) for axis in range(6)] for sub in subjoints]),
        "compliance": np.array([law.compliance for law in linear]),
        "row_covariance": np.array([law.fit.row_covariance for law in linear]),
        "loads": np.array([law.fit.loads for law in linear]),
        "beams": np.array(beams).reshape(-1, 11),
    }


def from_tensors(tensors: Mapping[str, Array]) -> StructuralLaw:
    """Return the law of arrays as declared; raise `LawError` where their numbers are not those of one."""
    tip, components = (int(value) for value in tensors["tip"])
    if components not in (3, 6):
        raise LawError(f"{components} components, expected 3 or 6")
    nodes = {str(i): place for i, place in enumerate(tensors["nodes"], 1)}

    def name(number: float) -> str:
        if not 0 <= number < len(nodes) or number != int(number):
            raise LawError(f"node {number:g} of {len(nodes)}")
        return str(int(number) + 1)

    tip_name, subjoints = name(tip), []
    of_each = (tensors[key] for key in ("at", "holds", "compliance", "row_covariance", "loads"))
    for at, holds, compliance, covariance, loads in zip(*of_each, strict=True):
        check_compliance(0.5 * (compliance + compliance.T))
        check_ordered(loads)
        law = LinearLaw(compliance, fit=LinearFit(covariance, np.zeros(6), loads))
        subjoints.append(SubJoint(name(float(at)), law, tuple(np.flatnonzero(holds > 0.5).tolist())))
    beams = tuple(Beam(name(row[0]), name(row[1]), Section(*row[2:8].tolist()), row[8:]) for row in tensors["beams"])
    return StructuralLaw(nodes, tip_name, tuple(subjoints), beams, components, tensors["noise"])
