"""Campaigns written in another convention than their arm's: what is done to them, and what should be said of it."""

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from armflex import calibrate, load_arm, read_measurements
from armflex.arm import Arm, Prior
from armflex.errors import ConventionError
from armflex.estimate.misread import check_conventions
from armflex.laws.joint.carried import scaled
from armflex.measured.measurements import Measurements
from armflex.readings import Position, Readings
from armflex.readings.sensor import Sensor
from support import six_axes
from support.campaigns import draw
from support.plant import Array, turn

SIGMA_R = 2e-4  # rad
BESIDE, OTHER = np.array([0.0, 0.25, 0.1]), np.array([0.2, -0.2, 0.05])  # m, two more targets on the tool

Written = tuple[Arm, Measurements]


@dataclass(frozen=True)
class Fault:
    """A fault: how an arm and its campaign are written with it, and a part of what should be said of it."""

    named: str
    written: Callable[[Arm, Measurements], Written]
    title: str = ""


@cache
def boom(kind: str = "none", seed: int = 3, arm: str = "boom") -> Written:
    """Return a machine of the plant, with one undeclared effect or none, and its campaign with orientations."""
    with tempfile.TemporaryDirectory() as folder:
        drawn = draw(kind, seed=seed, arm=arm)
        truth = drawn.write(Path(folder))
        loaded = load_arm(truth.arm)
        rows = read_measurements(truth.train, loaded)
    vectors, read = drawn.orientations(SIGMA_R)
    sigma = np.where(read & rows.measured, SIGMA_R, np.inf)
    return loaded, replace(rows, rotation=np.where(read[:, None], vectors, 0.0), sigma_r=sigma)


@cache
def ur5(seed: int = 0, wave: float = 0.0, count: int = 180) -> Written:
    """Return a simulated UR5 as declared and a campaign of three sessions, with orientations.

    `wave` is a hidden error of the second joint, once a turn [rad].
    """
    arm, rows = six_axes.campaign(count, seed)
    rng = np.random.default_rng([seed, 1])
    session = tuple(f"s{3 * i // count}" for i in range(count))
    q = rows.q + wave * np.sin(rows.q[:, [1]] + 0.3) * np.eye(6)[1]
    tip = np.asarray(six_axes.true_arm().deflection(q).pose)
    mounting = turn(rng.normal(0.0, 1.0, 3))
    position = six_axes.INSTRUMENT.readings(tip, session) + rng.normal(0.0, six_axes.SIGMA, (count, 3))
    axes = turn(rng.normal(0.0, SIGMA_R, (count, 3))) @ six_axes.INSTRUMENT.axes(tip) @ mounting
    vectors = Rotation.from_matrix(axes).as_rotvec()
    return arm, replace(rows, session=session, position=position, rotation=vectors, sigma_r=np.full(count, SIGMA_R))


def with_targets(arm: Arm, rows: Measurements, tracker: bool = False) -> Written:
    """Return an arm with two more targets on its tool, and what a tracker would read of them."""
    truth = calibrate(arm, rows, anyway=True)
    instrument, tip = truth.fit.setup.instrument, truth.fit.view.line.tip
    used, sessions = truth.fit.view.rows, truth.fit.view.sessions
    kinds, sensors, rng = list(rows.readings.kinds) if tracker else [], {}, np.random.default_rng(7)
    for name, point in (("smr1", BESIDE), ("smr2", OTHER)):
        sensors[name] = Sensor(name, Position, arm.robot.tip, 1e-4, point, np.full(3, 1e-3))
        values, sigma = np.zeros((len(rows), 3)), np.full((len(rows), 3), np.inf)
        here = tip[:, :3, 3] + tip[:, :3, :3] @ point
        values[used] = instrument.in_session(instrument.seen(here), sessions) + rng.normal(0.0, 1e-4, (len(used), 3))
        sigma[used] = 1e-4
        kinds.append(Position(values, sigma, name))
    return replace(arm, sensors=sensors), Measurements.of(rows, Readings(len(rows), tuple(kinds)))


def faults(arm: Arm) -> Iterator[Fault]:
    """Yield faults at joints two and three of an arm, which bend it under its own weight, and of tables and files."""
    joints = [joint.name for joint in arm.robot.moving if joint.kind != "prismatic"]
    one, other = joints[1], joints[2]
    i, j = (arm.joint_names.index(name) for name in (one, other))
    turning = [arm.joint_names.index(name) for name in joints]

    def swapped(q: Array) -> Array:
        return q[:, [j if k == i else i if k == j else k for k in range(q.shape[1])]]

    def factors(places: list[int], factor: float) -> Array:
        return np.where(np.isin(np.arange(len(arm.joint_names)), places), factor, 1.0)

    def of_joints(change: Callable[[Array], Array]) -> Callable[[Arm, Measurements], Written]:
        return lambda arm, rows: (arm, replace(rows, q=change(rows.q)))

    quarter = np.where(np.arange(len(arm.joint_names)) == i, np.pi / 2.0, 0.0)
    yield Fault(f"the columns q_{one} and q_{other} are exchanged", of_joints(swapped))
    yield Fault(f"the sign of q_{one} is turned", of_joints(lambda q: q * factors([i], -1.0)))
    yield Fault(f"the home position of {one} is -90 degrees", of_joints(lambda q: q + quarter))
    yield Fault(f"q_{other} is in radians", of_joints(lambda q: q * factors([j], np.pi / 180.0)))
    yield Fault("the turning joints are in degrees", of_joints(lambda q: q * factors(turning, 180.0 / np.pi)))
    yield Fault("the turning joints are in radians", of_joints(lambda q: q * factors(turning, np.pi / 180.0)))
    yield Fault("x, y, z are those of the row before", lambda arm, rows: (arm, late(rows)))
    yield Fault("sigma is in mm", lambda arm, rows: (arm, replace(rows, sigma=1e3 * rows.sigma)))
    masses = [payload.mass for payload in arm.payloads.values()]
    if max(masses, default=0.0) > 0.0:
        yield Fault("payload masses are in grams", lambda arm, rows: (heavier(arm, 1e3), rows))
    if max(masses, default=0.0) > 200.0:  # lighter ones hardly bend a stiff arm
        yield Fault("payload masses are in tonnes", lambda arm, rows: (heavier(arm, 1e-3), rows))
    if arm.flexures:  # a rigid arm is written with none
        yield Fault("the compliance is a thousand times too large", lambda arm, rows: (softer(arm, 1e3), rows))
        yield Fault("the compliance is a thousand times too small", lambda arm, rows: (softer(arm, 1e-3), rows))
    yield Fault("[prior] frees nothing", lambda arm, rows: (replace(arm, prior=Prior()), rows))


def silent(arm: Arm, rows: Measurements) -> Iterator[Fault]:
    """Yield faults of instruments, frames, sessions and payloads, and of orientations."""
    sessions = tuple(dict.fromkeys(rows.session))
    own = np.array([name == sessions[len(sessions) // 2] for name in rows.session])
    measured = np.flatnonzero(rows.measured)
    half = np.arange(len(rows)) >= measured[len(measured) // 2]
    within = own & (np.arange(len(rows)) >= np.median(np.flatnonzero(own)))
    joint = [one.name for one in arm.robot.moving if one.kind != "prismatic"][3]
    place = arm.joint_names.index(joint)
    turns = turn(rows.rotation) if rows.rotation is not None else None

    def position(
        change: Callable[[Array], Array], some: slice | Array = slice(None)
    ) -> Callable[[Arm, Measurements], Written]:
        def written(arm: Arm, rows: Measurements) -> Written:
            values = rows.position.copy()
            values[some] = change(values[some])
            return arm, replace(rows, position=values)

        return written

    def rotation(vectors: Array) -> Callable[[Arm, Measurements], Written]:
        return lambda arm, rows: (arm, replace(rows, rotation=np.where(rows.measured[:, None], vectors, 0.0)))

    if arm.flexures:
        for axis, size in (("y", (0.0, -1.0, 0.0)), ("y up", (0.0, 1.0, 0.0)), ("z up", (0.0, 0.0, 1.0))):
            yield Fault("gravity points along -z", lambda arm, rows, g=size: (along(arm, g), rows), f"gravity {axis}")
    jump = np.array([0.03, -0.03, 0.026])
    yield Fault("the instrument was moved", position(lambda p: p + jump, within), "tracker jumps 50 mm")
    if turns is not None:
        shift = turns @ np.array([6.0e-3, -6.0e-3, 5.3e-3])
        yield Fault(
            "the target was moved",
            lambda arm, rows: (arm, replace(rows, position=rows.position + half[:, None] * shift)),
            "target moved 10 mm",
        )
    masses = {name: one.mass for name, one in arm.payloads.items()}
    heaviest = max(masses, key=masses.__getitem__, default="none")
    if masses.get(heaviest):
        empty = next((name for name, one in arm.payloads.items() if not one.mass and name != "none"), "none")
        for name in dict.fromkeys((empty, "none")):

            def forgotten(arm: Arm, rows: Measurements, name: str = name) -> Written:
                named = (name if late else one for one, late in zip(rows.payload, half, strict=True))
                return arm, replace(rows, payload=tuple(named))

            yield Fault("payload", forgotten, f"payload {name} in half of the rows")
    flipped = np.where(np.arange(rows.q.shape[1]) == place, -1.0, 1.0)
    yield Fault(
        f"the sign of q_{joint} is turned",
        lambda arm, rows: (arm, replace(rows, q=np.where(own[:, None], rows.q * flipped, rows.q))),
        f"sign of {joint} in one session",
    )
    yield Fault("x, y, z are a left-handed", position(lambda p: p * [1.0, -1.0, 1.0]), "base mirrored in y")
    yield Fault("x, y, z are a left-handed", position(lambda p: p * [-1.0, 1.0, 1.0]), "base mirrored in x")
    every = np.array([1.0 if one.kind == "prismatic" else -1.0 for one in arm.robot.moving])
    yield Fault(
        "the signs of all turning joints",
        lambda arm, rows: (arm, replace(rows, q=rows.q * every)),
        "all joints mirrored",
    )

    def in_base(arm: Arm, rows: Measurements) -> Written:
        return replace(arm, measurement=replace(arm.measurement, frame="base")), rows

    def half_turn(arm: Arm, rows: Measurements) -> Written:
        placed = calibrate(arm, rows, anyway=True).fit.setup.instrument.pose
        points = (rows.position - placed.translation) @ placed.rotation * [-1.0, -1.0, 1.0]
        return in_base(arm, replace(rows, position=points))

    yield Fault("x, y, z are not in the arm's base frame", in_base, "frame = base, elsewhere")
    yield Fault("x, y, z are not in the arm's base frame", half_turn, "frame = base, turned by 180")
    yield Fault("in mm", lambda arm, rows: (arm, replace(rows, position=1e3 * rows.position)), "mm as x y z")
    yield Fault(
        "in mm",
        lambda arm, rows: (arm, replace(rows, position=1e3 * rows.position, sigma=1e3 * rows.sigma)),
        "mm as x y z and sigma",
    )
    yield Fault("in inches", position(lambda p: p / 0.0254), "inches as x y z")
    yield Fault("in inches", position(lambda p: p / 25.4), "inches in x_mm")
    yield Fault("in inches", position(lambda p: p / 25.4, own), "inches in x_mm, one session")
    yield Fault("in inches", position(lambda p: p / 25.4, half), "inches in x_mm, half of the rows")
    yield Fault("in mm", position(lambda p: p * [1.0, 1.0, 1e3]), "mm as z alone")
    yield Fault("x and y are exchanged", position(lambda p: p[:, [1, 0, 2]], own), "x and y in one session")
    if turns is None:
        return
    angles = Rotation.from_matrix(turns)
    yield Fault("Euler angles", rotation(angles.as_euler("xyz")), "Euler xyz as rotation vector")
    yield Fault("Euler angles", rotation(angles.as_euler("ZYX")[:, ::-1]), "Euler ZYX, by axis")
    yield Fault("Euler angles", rotation(angles.as_euler("XYZ")), "Euler order XYZ")
    yield Fault("Euler angles", rotation(angles.as_euler("ZYX")), "Euler ZYX as written (A, B, C)")
    yield Fault("Euler angles", rotation(angles.as_euler("ZYZ")), "Euler ZYZ (O, A, T)")
    yield Fault("the other way about", rotation(angles.inv().as_rotvec()), "orientation transposed")
    yield Fault("quaternion", rotation(canonical(angles)), "quaternion's x y z")
    yield Fault("in degrees", rotation(np.degrees(angles.as_rotvec())), "degrees as radians")
    yield Fault("in radians", rotation(np.radians(angles.as_rotvec())), "radians under rx_deg")
    yield Fault("Euler angles", rotation(np.degrees(angles.as_euler("xyz"))), "Euler xyz, degrees as radians")


def canonical(angles: Rotation) -> Array:
    """Return the (N, 3) vector parts of unit quaternions whose scalar part is not negative."""
    quaternions = angles.as_quat()
    return quaternions[:, :3] * np.where(quaternions[:, 3:] < 0.0, -1.0, 1.0)


def exchanged_targets(arm: Arm, rows: Measurements) -> Iterator[Fault]:
    """Yield the fault of two targets whose columns are exchanged, of an arm with two."""

    def written(arm: Arm, rows: Measurements) -> Written:
        names = {"smr1": "smr2", "smr2": "smr1"}
        own = {kind.name: kind for kind in rows.readings.kinds}
        kinds = tuple(replace(own[names.get(kind.name, kind.name)], name=kind.name) for kind in rows.readings.kinds)
        return arm, Measurements.of(rows, Readings(len(rows), kinds))

    yield Fault("columns of smr1 and those of smr2 are exchanged", written, "smr1 and smr2 exchanged")


def along(arm: Arm, direction: tuple[float, float, float]) -> Arm:
    """Return an arm with gravity along a direction."""
    return replace(arm, robot=replace(arm.robot, gravity=9.81 * np.array(direction)))


def late(rows: Measurements) -> Measurements:
    """Return readings each in the row after the one that they were taken in."""
    position, measured = np.array(rows.position), np.flatnonzero(rows.measured)
    position[measured] = np.roll(position[measured], 1, axis=0)
    return replace(rows, position=position)


def heavier(arm: Arm, factor: float) -> Arm:
    """Return an arm whose payloads are written with other masses."""
    return replace(arm, payloads={name: replace(one, mass=factor * one.mass) for name, one in arm.payloads.items()})


def softer(arm: Arm, factor: float) -> Arm:
    """Return an arm whose compliances are written with a factor."""
    each = np.full(6, np.sqrt(factor))
    return replace(arm, flexures=tuple(replace(one, law=scaled(one.law, each)) for one in arm.flexures))


def judged(arm: Arm, rows: Measurements) -> tuple[str, ...]:
    """Return what a campaign is said to have been misread as; '' where it is refused without a name."""
    try:
        check_conventions(arm, rows, np.flatnonzero(rows.measured))
    except ConventionError as error:
        return error.names or ("",)
    return ()
