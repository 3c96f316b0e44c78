"""Composed joints that several tests ask: as text of a file, and as a law."""

from dataclasses import dataclass

import numpy as np

from armflex.laws import Beam, LinearLaw, Section, StructuralLaw, SubJoint
from armflex.laws.law import WithoutParameters
from support.small_arms import random_compliance

BEAM = """[[beam]]
between = ["{}", "3"]
E = 210e9
G = 81e9
A = 0.024
Iy = 1.28e-5
Iz = 1.8e-4
J = 4.26e-5
"""
ASSEMBLY = """tip = "3"
[nodes]
1 = [0.0, 0.0, 0.25]
2 = [0.0, 0.0, -0.25]
3 = [0.3, 0.0, 0.0]
[[subjoint]]
at = "1"
compliance = [4e-9, 4e-9, 4e-9, 0, 0, 0]
holds = ["dx", "dy", "dz"]
[[subjoint]]
at = "2"
compliance = [4e-9, 4e-9, 4e-9, 0, 0, 0]
holds = ["dx", "dy", "dz"]
[[subjoint]]
at = "2"
compliance = [0, 0, 0, 0, 0, 2e-7]
holds = ["rz"]
"""
STEEL = Section(E=210e9, G=81e9, A=3.3e-3, Iy=2.6e-6, Iz=1.7e-6, J=3.9e-6)
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Stiffening(WithoutParameters):
    """w = K x + B x^3 component by component, so the twist is the real root of a cubic."""

    stiffness: np.ndarray
    cubic: np.ndarray

    def twist(self, wrench, row):
        if wrench.ndim > 1:
            return np.array([self.twist(one, row) for one in wrench])
        roots = [np.roots([b, 0, k, -w]) for k, b, w in zip(self.stiffness, self.cubic, wrench, strict=True)]
        return np.array([found[np.abs(found.imag).argmin()].real for found in roots])

    def tangent(self, wrench, row):
        return np.diag(1 / (self.stiffness + 3 * self.cubic * self.twist(wrench, row) ** 2))

    def scatter(self, wrench, row):
        return np.eye(6) * (0.1 * self.twist(wrench, row)[..., None]) ** 2


SPRING = Stiffening(np.array([2e7, 3e7, 4e7, 1e6, 2e6, 3e6]), np.array([1e13, 2e13, 3e13, 1e13, 2e13, 3e13]))


def nonlinear() -> StructuralLaw:
    """A stiffening joint and a linear one, each with a beam to the tip."""
    nodes = {"a": np.zeros(3), "b": np.array([0, 0.5, 0]), "t": np.array([0.8, 0.2, 0.1])}
    subs = (SubJoint("a", SPRING), SubJoint("b", LinearLaw(random_compliance(7))))
    return StructuralLaw(nodes, "t", subs, (Beam("a", "t", STEEL, UP), Beam("b", "t", STEEL, UP)))
