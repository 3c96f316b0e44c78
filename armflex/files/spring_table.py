"""[spring.NAME]: a spring between points of two links, linear or of gas."""

import numpy as np

from armflex.conventions import Array
from armflex.declaration import Declaration
from armflex.mechanics.pinocchio_model import build_model
from armflex.mechanics.spring import CoilSpring, GasSpring, Spring, TensionLaw
from armflex.robot import Robot
from armflex.robot.robot import MILLIMETRES


def read_spring(name: str, table: Declaration, robot: Robot) -> Spring:
    """Return a spring of a robot.

    Args:
        name: The spring.
        table: Its ends and its tension as a function of its length.
        robot: The robot, with every link that the arm.toml makes.

    Raises:
        ArmFileError: There is no such link, no joint moves the ends against each other, an end is `MILLIMETRES`
            times the reach away, or the numbers are no spring's.
    """
    rigid, ends = build_model(robot), read_ends(table, robot)
    carriers = {rigid.model.frames[rigid.frame(link)].parentJoint for link, _ in ends}
    if len(carriers) == 1:
        raise table.fail("to", f"no joint moves {ends[1][0]!r} against {ends[0][0]!r}: the spring does nothing")
    law = _read_gas(table) if table.has("pressure") else _read_coil(table)
    table.finish()
    return Spring(name, *ends[0], *ends[1], law)


def read_ends(table: Declaration, robot: Robot) -> tuple[tuple[str, Array], tuple[str, Array]]:
    """Return the two links that something joins, each with the (3,) point of it in its frame [m].

    A point that is `MILLIMETRES` times the reach away is refused.
    """
    ends = []
    for key, where in (("link", "at"), ("to", "at_to")):
        point = table.numbers(where, (3,))
        link = table.choice(key, robot.urdf.below(robot.base), problem="no link {!r} at or beyond the base")
        if robot.times_reach(apart := float(np.linalg.norm(point))) > MILLIMETRES:
            text = f"is {apart:g} m from the origin of {link!r}, and the arm reaches {robot.reach:.3g} m"
            raise table.fail(where, f"{text}: in millimetres? It is in m")
        ends.append((link, point))
    first, second = ends
    if first[0] == second[0]:
        raise table.fail("to", f"both ends are on link {first[0]!r}: it joins a link to itself")
    return first, second


def _read_coil(table: Declaration) -> TensionLaw:
    rate = positive(table, "rate", "N/m")
    if not table.has("preload"):
        return CoilSpring(rate, positive(table, "free_length", "m"))
    if table.has("free_length"):
        raise table.fail("preload", "stands beside 'free_length': give one of them")
    return CoilSpring(rate, positive(table, "length0", "m"), table.number("preload"))


def _read_gas(table: Declaration) -> TensionLaw:
    if table.has("rate"):
        raise table.fail("pressure", "is of a gas spring, 'rate' of a linear one: give one of them")
    pressure, area = positive(table, "pressure", "Pa"), positive(table, "area", "m^2")
    length, exponent = positive(table, "length0", "m"), table.number("exponent", 1.0)
    if not 1.0 <= exponent <= 2.0:
        raise table.fail("exponent", f"is {exponent:g}, expected 1 (constant temperature) to 2")
    return GasSpring(pressure, area, length, exponent)


def positive(table: Declaration, key: str, unit: str) -> float:
    """Return a number above zero."""
    value = table.number(key)
    if value <= 0.0:
        raise table.fail(key, f"expected more than 0 {unit}, got {value:g}")
    return value
