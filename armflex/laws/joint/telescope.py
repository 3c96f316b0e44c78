"""A boom that gets longer: a uniform Euler-Bernoulli cantilever, as long as its joint is out.

    twist = [[L^3/3 P, L^2/2 X'], [L^2/2 X, L P]] w / EI + L ((b . f) b / EA, (b . m) b / GJ),    L = length0 + q

of a wrench w = (f, m) at the end of the boom along the unit vector b, in the frame that the joint moves
(Timoshenko, Strength of Materials I, ch. 5): P = 1 - b b', X = [b]x. It is a cubic in the joint's position, and read
as the position-dependent law with these coefficients.
"""

import numpy as np

from armflex.conventions import Array
from armflex.declaration import Declaration
from armflex.errors import did_you_mean
from armflex.laws.joint.linear import declared_std
from armflex.laws.joint.position_dependent import PositionDependentLaw
from armflex.laws.law import Ranges

EXAMPLE = """
model = "telescope"
EI = 2e7  # bending stiffness [N m^2]
GJ = 1e7
EA = 1e9
length0 = 4.0  # what is out at position 0 [m]
along = [1, 0, 0]
relative_std = 0.1
"""


def read_telescope(table: Declaration, joint: str, ranges: Ranges) -> PositionDependentLaw:
    """Return the law of a boom by `EI`, `GJ` and `EA` (stiff where absent), `length0`, `along`, `depends_on`."""
    along, length0 = table.numbers("along", (3,)), table.number("length0", 0.0)
    if not (size := float(np.linalg.norm(along))) > 0.0:
        raise table.fail("along", "expected the direction that the boom moves out in, got zeros")
    stiffness = {"EI": table.number("EI"), **{name: table.number(name, np.inf) for name in ("GJ", "EA")}}
    for name, value in stiffness.items():
        if not value > 0.0:
            raise table.fail(name, f"expected more than 0, got {value:g}")
    owner = table.text("depends_on", joint)
    if owner not in ranges:
        hint = did_you_mean(owner, ranges)
        raise table.fail("depends_on", f"{owner!r} is no moving joint of the chain{hint}")
    if (shortest := length0 + min(ranges[owner])) < 0.0:
        raise table.fail("length0", f"the boom would be {shortest:.3g} m long at the lower limit of {owner!r}")
    way = along / size
    by_length, straight = bending(way) / stiffness["EI"], np.outer(way, way)
    by_length[1, 3:, 3:] += straight / stiffness["GJ"]
    by_length[1, :3, :3] += straight / stiffness["EA"]
    coefficients = np.zeros((4, 6, 6))
    for power in (1, 2, 3):
        for k, part in enumerate((np.polynomial.Polynomial((length0, 1.0)) ** power).coef):
            coefficients[k] += part * by_length[power]
    return PositionDependentLaw(owner, coefficients, declared_std(table))


def bending(along: Array) -> Array:
    """Return the (4, 6, 6) compliance by the power of L, times EI, of a beam along a (3,) unit vector."""
    across, turned = np.eye(3) - np.outer(along, along), np.cross(np.eye(3), along)  # (n, k) -> (e_n x b)_k
    powers = np.zeros((4, 6, 6))
    powers[3, :3, :3], powers[1, 3:, 3:] = across / 3.0, across
    powers[2, 3:, :3], powers[2, :3, 3:] = 0.5 * turned, 0.5 * turned.T
    return powers
