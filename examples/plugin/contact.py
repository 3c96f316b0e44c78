"""A joint on rollers: its contacts stiffen with the load, as Hertz found.

twist = C w (1 + w' C w / (2 energy))^(-1/6)
"""

from dataclasses import dataclass, replace

import numpy as np

from armflex.conventions import TWIST_NAMES, Array
from armflex.declaration import Declaration
from armflex.laws import Law, LawModel
from armflex.laws.joint.linear import declared_std, read_compliance
from armflex.laws.law import Parameter, Ranges, Transform
from armflex.laws.terms import Term, Terms, power

EXAMPLE = """
model = "contact"
compliance = [1e-8, 2e-8, 1e-8, 1e-6, 2e-6, 1e-6]  # under a small load
energy = 0.5  # w' C w / 2 [J] at which it has fallen to 2^(-1/6)
relative_std = 0.05
"""


@dataclass(frozen=True)
class ContactLaw(Law):
    """Its values are the logarithms of the compliance along each axis, and of the energy."""

    compliance: Array
    energy: float
    relative_std: float = 0.0

    @property
    def _axes(self) -> list[int]:
        return np.flatnonzero(np.diag(self.compliance) > 0.0).tolist()

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        names = [*(TWIST_NAMES[axis] for axis in self._axes), "energy"]
        return tuple(Parameter(name, "1", self.relative_std, Transform.LOG) for name in names)

    @property
    def values(self) -> Array:
        return np.log([*np.diag(self.compliance)[self._axes], self.energy])

    def at(self, values: Array) -> "ContactLaw":
        root = np.ones(6)
        root[self._axes] = np.exp(0.5 * (values - self.values)[:-1])
        scaled = self.compliance * np.outer(root, root)
        return replace(self, compliance=scaled, energy=float(np.exp(values[-1])))

    def terms(self) -> Terms:
        falls = power(self.compliance / (2.0 * self.energy), -1.0 / 6.0, 1.0)
        return (Term(np.zeros(6), self.compliance, features=(falls,)),)

    def scaled(self, factor: Array) -> "ContactLaw":
        return replace(self, compliance=self.compliance * np.outer(factor, factor))


def read_contact(table: Declaration, joint: str, ranges: Ranges) -> ContactLaw:
    compliance, energy = read_compliance(table), table.number("energy")
    if energy <= 0.0:
        raise table.fail("energy", f"expected more than 0 J, got {energy:g}")
    return ContactLaw(compliance, energy, declared_std(table))


CONTACT = LawModel(read_contact, EXAMPLE)
