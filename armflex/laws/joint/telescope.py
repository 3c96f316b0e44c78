"""A boom that gets longer: a uniform Euler-Bernoulli cantilever, as long as its joint is out.

    twist = [[L^3/3 P, L^2/2 X'], [L^2/2 X, L P]] w / EI + L ((b . f) b / EA, (b . m) b / GJ),    L = length0 + q

of a wrench w = (f, m) at the end of the boom along the unit vector b, in the frame that the joint moves
(Timoshenko, Strength of Materials I, ch. 5): P = 1 - b b', X = [b]x. It is a cubic in the joint's position.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from armflex.conventions import Array
from armflex.declaration import Declaration
from armflex.laws.joint.linear import declared_std
from armflex.laws.joint.log_compliance import LOOSE
from armflex.laws.joint.position_dependent import PositionDependentLaw, by_driver
from armflex.laws.law import Compliance, Parameter, Ranges, Row, Transform, Travel, block_diagonal, driven_by, driver_of
from armflex.laws.terms import Terms

EXAMPLE = """
model = "telescope"
EI = 2e7  # bending stiffness [N m^2]
GJ = 1e7
EA = 1e9
length0 = 4.0  # what is out at position 0 [m]
along = [1, 0, 0]
relative_std = 0.1
"""

SAME_WAY = 0.02
"""Length of the difference of two unit vectors below which they are one direction, as of rounded numbers."""


@dataclass(frozen=True)
class Telescope(Compliance):
    """A boom that gets longer. Its values are logarithms of what it gives, one for every stiffness that is stated.

    Attributes:
        joint: The driven joint whose position counts.
        along: (3,) unit vector that the boom moves out along.
        length0, factor: L is the first plus the second times the joint's position [m, m per its unit].
        stiffness: Those stated, `EI` first: their values [N m^2; EA in N].
        relative_std: Relative standard uncertainty of each; 0 for none.
    """

    joint: str
    along: Array
    length0: float
    factor: float
    stiffness: Mapping[str, float]
    relative_std: float = 0.0

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """What every stiffness gives, 1/EI."""
        return tuple(Parameter(f"1/{name}", "1", self.relative_std, Transform.LOG) for name in self.stiffness)

    @property
    def values(self) -> Array:
        return -np.log(list(self.stiffness.values()))

    def at(self, values: Array) -> Telescope:
        return replace(self, stiffness=dict(zip(self.stiffness, np.exp(-values).tolist(), strict=True)))

    @cached_property
    def projections(self) -> Mapping[int, Array]:
        """Of what the boom bears along and about itself, and of the rest; by an axis near its length, or across it."""
        straight = np.outer(self.along, self.along)
        across, *_, nearest = np.argsort(np.abs(self.along), kind="stable").tolist()
        parts = {"GJ": (3 + nearest, block_diagonal(np.zeros((3, 3)), straight))}
        parts["EA"] = nearest, block_diagonal(straight, np.zeros((3, 3)))
        stated = [parts[name] for name in self.stiffness if name != "EI"]
        return {3 + across: np.eye(6) - sum(part for _, part in stated), **dict(stated)}

    @cached_property
    def _whole(self) -> PositionDependentLaw:
        by_length, straight = bending(self.along) / self.stiffness["EI"], np.outer(self.along, self.along)
        by_length[1, 3:, 3:] += straight / self.stiffness.get("GJ", np.inf)
        by_length[1, :3, :3] += straight / self.stiffness.get("EA", np.inf)
        return PositionDependentLaw(self.joint, by_driver(by_length, self.factor, self.length0))

    def compliance(self, row: Row) -> Array:
        return self._whole.compliance(row)

    def terms(self) -> Terms:
        return self._whole.terms()

    def by_values(self, wrench: Array, row: Row) -> Array:
        """Return what each stiffness gives of the twist."""
        return self.by_factors(tuple(self.projections), wrench, self.twist(wrench, row), self.tangent(wrench, row))

    def compliance_bound(self, ranges: Ranges) -> Array | None:
        return self._whole.compliance_bound(ranges)

    def gives(self, row: Row) -> tuple[int, ...]:
        """Return the axes that give where anything is out."""
        return self._whole.gives(row)

    def learned(self, travel: Ranges) -> Telescope:
        """Return the law, every stiffness as uncertain as declared."""
        return replace(self, relative_std=self.relative_std or LOOSE)

    def scaled(self, factor: Array) -> Telescope:
        """Return the boom whose stiffness is less by the squares of factors on the axes that name them."""
        return self.at(self.values + 2.0 * np.log(factor[list(self.projections)]))


def read_telescope(table: Declaration, joint: str, ranges: Ranges) -> Telescope:
    """Return the law of a boom by `EI`, `GJ` and `EA` (stiff where absent), `length0`, `along`, `depends_on`."""
    along, length0 = table.numbers("along", (3,)), table.number("length0", 0.0)
    if not (size := float(np.linalg.norm(along))) > 0.0:
        raise table.fail("along", "expected the direction that the boom moves out in, got zeros")
    slides = ranges.slides if isinstance(ranges, Travel) and table.text("depends_on", joint) == joint else {}
    if (axis := slides.get(joint)) is not None and np.linalg.norm(along / size - axis) > SAME_WAY:
        given, out = (np.round(vector, 6).tolist() for vector in (along, axis + 0.0))
        text = f"{given} is not the way joint {joint!r} moves out, its axis {out} in the frame that it moves"
        raise table.fail("along", f"{text}: write along = {out}")
    stiffness = {name: table.number(name) for name in ("EI", "GJ", "EA") if name == "EI" or table.has(name)}
    for name, value in stiffness.items():
        if not value > 0.0:
            raise table.fail(name, f"expected more than 0, got {value:g}")
    driver, factor, offset = driver_of(table, joint, ranges)
    own, times, more = driven_by(joint, ranges)
    if own == driver and (times, more) != (factor, offset):
        named, out = table.text("depends_on", joint), f"{times:g} {driver}{f' {more:+g} m' if more else ''}"
        text = f"the boom is as long as its own joint {joint!r} is out, {out}, and {named!r} is "
        raise table.fail("depends_on", f"{text}elsewhere: leave depends_on out, or declare a position_dependent law")
    length, ends = length0 + offset, ranges[driver]
    if (shortest := length + min(factor * end for end in ends)) < 0.0:
        limit = "lower" if factor > 0.0 else "upper"
        raise table.fail("length0", f"the boom would be {shortest:.3g} m long at the {limit} limit of {driver!r}")
    return Telescope(driver, along / size, length, factor, stiffness, declared_std(table))


def bending(along: Array) -> Array:
    """Return the (4, 6, 6) compliance by the power of L, times EI, of a beam along a (3,) unit vector."""
    across, turned = np.eye(3) - np.outer(along, along), np.cross(np.eye(3), along)  # (n, k) -> (e_n x b)_k
    powers = np.zeros((4, 6, 6))
    powers[3, :3, :3], powers[1, 3:, 3:] = across / 3.0, across
    powers[2, 3:, :3], powers[2, :3, 3:] = 0.5 * turned, 0.5 * turned.T
    return powers
