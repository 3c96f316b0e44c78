"""[instrument.NAME] in an arm.toml: an instrument beside the one at the tip."""

from __future__ import annotations

import numpy as np

from armflex.conventions import SMALLEST_STD
from armflex.declaration import Declaration
from armflex.errors import ArmFileError, shown
from armflex.readings import SENSOR_KINDS, SlideEncoder, Sockets
from armflex.readings.sensor import LONGEST, Sensor, Shaft
from armflex.robot import Robot

FURTHEST = 50.0
"""Distance from the base [m], beyond the arm's reach, that no anchor of a wire has."""

UNKNOWN = ", where the wire begins [m]; of one that nobody measured write [0, 0, 0] and anchor_std = 2.0"
"""What is said where a wire's anchor is left out: it is found from as far away as its standard deviation says."""

SHAPES = ("point", "plane", "sphere")
"""Of what a point is put into, or onto."""

SEEN_FROM = {"distance": "anchor_link", "relative_position": "seen_from", "pixels": "camera_link"}
"""Key of the link that the other end is on."""


def read_sensors(tables: dict[str, Declaration], robot: Robot) -> dict[str, Sensor]:
    """Return the instruments of an arm file by name, in the order in which their readings stand in a row.

    Raises:
        ArmFileError: A kind, a link or a joint is not known, or a number is none of its kind.
    """
    found = [_read(name, table, robot) for name, table in tables.items()]
    units = list(LONGEST)
    return {sensor.name: sensor for sensor in sorted(found, key=lambda one: units.index(one.kind.unit))}


def _read(name: str, table: Declaration, robot: Robot) -> Sensor:
    what = table.choice("kind", tuple(SENSOR_KINDS))
    kind, shaft = SENSOR_KINDS[what], None

    def link(key: str) -> str:
        return table.choice(key, robot.urdf.below(robot.base), problem="the arm has no link {!r}")

    on, about = kind.declared(table, robot) or (None, None)
    sockets, touching = _sockets(table) if what == "touch" else None, what == "touch"
    if what == "encoder":
        joints = {joint.name: joint for joint in robot.moving}
        joint = table.choice("joint", tuple(joints))
        declared = joints[joint]
        straight = declared.kind == "prismatic"
        kind = SlideEncoder if straight else kind
        origin = np.eye(4)
        origin[:3, :3], origin[:3, 3] = declared.rotation, declared.origin
        shaft, on = Shaft(joint, declared.parent, straight, np.asarray(declared.axis), origin), declared.child
    elif touching and not table.has("link"):
        on = robot.tip
    elif what == "pixels":
        on = link("board_link") if table.has("board_link") else robot.base
    elif on is None:
        on = link("link")
    seen_from = robot.base if what == "pixels" else None
    if what in SEEN_FROM and (what == "relative_position" or table.has(SEEN_FROM[what])):
        seen_from = link(SEEN_FROM[what])
    if seen_from == on:
        raise table.fail(SEEN_FROM[what], f"{on!r} is the link itself: nothing moves between the two")
    sign = 1.0
    if what == "acceleration":
        sign = {"gravity": 1.0, "specific_force": -1.0}[table.choice("reads", ("gravity", "specific_force"), "gravity")]
    declared, std = [], []
    for one in kind.nuisances:
        if touching and (one.name == "place" or not table.has("link")):
            declared.append(np.zeros(3))
            std.append(np.zeros(3))
            continue
        if one.name == "anchor" and what == "distance":
            try:
                value = table.numbers("anchor", (3,))
            except ArmFileError as error:
                raise error if table.has("anchor") else ArmFileError(error.place, f"{error.problem}{UNKNOWN}") from None
            if np.linalg.norm(value) > robot.reach + FURTHEST:
                away = f"{np.linalg.norm(value):.3g} m from the base, and the arm reaches {robot.reach:.3g} m"
                raise table.fail("anchor", f"is {away}: millimetres?")
        elif len(one.axes) == 1:
            value = np.array([table.number(one.name, 0.0)])
        else:
            fewer = ((4,),) if one.name == "distortion" else ()  # k3 is often left out
            value = table.numbers(one.name, (len(one.axes),), *fewer) if table.has(one.name) else np.zeros(0)
            value = np.append(value, np.zeros(len(one.axes) - len(value)))
        key = f"{one.name}_std"
        size = table.std(key, LONGEST[one.unit] if one.anywhere and not table.has(one.name) else 0.0)
        if 0.0 < size < SMALLEST_STD or size > LONGEST[one.unit]:
            raise table.fail(
                key, f"expected a standard deviation [{one.unit}] up to {LONGEST[one.unit]:g}, got {size:g}"
            )
        declared.append(value)
        std.append(np.full(len(one.axes), size))
    sigma = table.std("sigma")
    if not SMALLEST_STD <= sigma <= LONGEST[kind.unit]:
        raise table.fail("sigma", f"expected one standard deviation of a reading [{kind.unit}], got {sigma:g}")
    table.finish()
    return Sensor(
        name,
        kind,
        on,
        sigma,
        np.concatenate([np.zeros(0), *declared]),
        np.concatenate([np.zeros(0), *std]),
        {},
        seen_from,
        sign,
        shaft,
        sockets,
        about,
    )


def _sockets(table: Declaration) -> Sockets:
    """Return what an instrument that touches knows of what it is put into."""
    shapes, normal = table.part("shape"), table.part("normal").by_name(3)
    of_shape = {name: shapes.choice(name, SHAPES) for name in shapes.table}
    radius = {name: float(value) for name, value in table.part("radius").by_name().items()}
    for name, shape in of_shape.items():
        if shape == "sphere" and not radius.get(name, 0.0) > 0.0:
            raise table.fail("shape", f"{name!r} is a sphere: give radius = {{ {name} = .. }} [m], above 0")
    for name, value in normal.items():
        if np.linalg.norm(value) < SMALLEST_STD:
            raise table.fail("normal", f"that of {name!r} has no direction")
    pairs: list[tuple[str, str, float]] = []
    for one in table.raw("distances") if table.has("distances") else ():
        match one:
            case [str(first), str(second), int() | float() as length] if first != second and 0.0 < length < FURTHEST:
                pairs.append((first, second, float(length)))
            case _:
                raise table.fail("distances", f'expected [["one", "other", length in m], ..], got {shown(one)}')
    surfaces = [end for one, other, _ in pairs for end in (one, other) if of_shape.get(end, "point") == "plane"]
    if surfaces:
        raise table.fail("distances", f"{surfaces[0]!r} is a plane: a distance is between points")
    sizes = [table.std(key, default) for key, default in (("place_std", 1e-3), ("distance_sigma", 1e-4))]
    for key, size in zip(("place_std", "distance_sigma"), sizes, strict=True):
        if not SMALLEST_STD <= size <= LONGEST["m"]:
            raise table.fail(key, f"expected one standard deviation [m], got {size:g}")
    own_point = table.has("link")
    if not own_point and (table.has("point") or table.has("point_std")):
        raise table.fail("point", "needs `link`; without a link the target of [prior] tool touches")
    places = table.part("place").by_name(3)
    return Sockets(places, sizes[0], of_shape, radius, normal, tuple(pairs), sizes[1], own_point=own_point)
