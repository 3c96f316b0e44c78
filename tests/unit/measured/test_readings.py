"""Rows without readings, and readings of kinds: what every kind says of itself, and that no one else need know."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
import pytest
from support.small_arms import ROBOTS

from armflex import Arm, Measurements, calibrate, load_arm
from armflex.arm import Prior, Setup
from armflex.errors import InputError
from armflex.estimate.block import factor_block
from armflex.estimate.robust import huber_weights, median_length, outlier_limit
from armflex.estimate.view import look
from armflex.laws import LinearLaw
from armflex.laws.law import anywhere
from armflex.readings import (
    SENSOR_KINDS,
    Acceleration,
    Camera,
    Direction,
    Distance,
    Encoder,
    Force,
    Frequency,
    Height,
    Inclination,
    Kind,
    Moment,
    Orientation,
    Pixels,
    Position,
    Postures,
    Readings,
    RelativePosition,
    Sockets,
    Torque,
    Touch,
    unread,
)
from armflex.readings.air import Air
from armflex.readings.board import Board
from armflex.readings.direction import PointDirection, Sight
from armflex.readings.encoder import Shaft
from armflex.readings.frequency import Swing
from armflex.readings.instrument import Instrument
from armflex.readings.kind import Ends
from armflex.readings.load import Drive
from armflex.readings.plane import Plane
from armflex.readings.sensor import Nuisance
from armflex.readings.touch import SocketDistance
from armflex.rows import Rows

COUNT, STEP = 24, 1e-6
SESSION = ("s",) * COUNT


@dataclass(frozen=True, eq=False)
class Ranging(Kind):
    """(N, 1) distance of the target from the instrument [m], as a laser distance meter reads it; no part of armflex."""

    dimension = 1
    unit = "m"

    @property
    def _position(self) -> Position:
        return Position.unread(len(self.values))

    def ideal(self, at: Postures) -> np.ndarray:
        return np.linalg.norm(self._position.ideal(at), axis=1, keepdims=True)

    def ends(self, at: Postures) -> Ends:
        return {"end": (at.end(""), self._along(at, self._position.ends(at)["end"][1]))}

    def by_frame(self, at: Postures) -> np.ndarray:
        return self._along(at, self._position.by_frame(at))

    def by_scale(self, at: Postures) -> np.ndarray:
        return self.ideal(at) / (1.0 + at.instrument.scale)

    def by_bend(self, at: Postures) -> np.ndarray:
        return self._along(at, self._position.by_bend(at))

    def _along(self, at: Postures, changes: np.ndarray) -> np.ndarray:
        points = self._position.ideal(at)
        return (points / np.linalg.norm(points, axis=1, keepdims=True))[:, None] @ changes


PICTURES = Camera(Board("points", 0.05 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.5], [2, 1, 0]], float)))

SENSORS = {
    "target": (Position, {}),
    "turned": (Orientation, {"link": "wrist_yaw"}),
    "wire": (Distance, {}),
    "bar": (Distance, {"link": "forearm", "seen_from": "shoulder"}),
    "camera": (RelativePosition, {"seen_from": "shoulder"}),
    "ruler": (Height, {"about": Plane(np.array([0.1, -0.2, 1.0]))}),
    "level": (Inclination, {"link": "forearm"}),
    "acc": (Acceleration, {"about": "specific_force"}),
    "encoder": (Encoder, {}),
    "block": (Touch, {"sockets": Sockets({"a": np.ones(3)}, 0.1, {"c": "plane", "d": "sphere"}, {"d": 0.1},
                                         own_point=True)}),
    "eye": (Pixels, {"about": PICTURES, "link": "base", "seen_from": "forearm"}),
    "webcam": (Pixels, {"about": PICTURES, "seen_from": "shoulder"}),
    "cell": (Force, {"about": "tool"}),
    "platform": (Moment, {"about": "base"}),
    "motor": (Torque, {"about": Drive("J3", np.array([0.0, 0.0, 0.0, 0.0, 1.0, 0.0]), -1e-2)}),
    "star": (Direction, {"about": Sight(-1.0, Plane(np.array([0.3, 0.1, 1.0])), Air(750.0, 5.0)), "link": "forearm"}),
    "laser": (Direction, {"about": Sight(1.0, Plane(np.array([0.0, 1.0, 0.0])))}),
    "theodolite": (PointDirection, {"about": Sight(-1.0), "link": "forearm"}),
    "hammer": (Frequency, {"about": Swing(None, np.array([0.0, 0.6, 0.8]))}),
}  # fmt: skip
"""Of every kind one at least, by name."""

TOUCHED = tuple("abcd"[row % 4] for row in range(COUNT))

CASES = [(Position, ""), (Orientation, ""), (Ranging, ""), *((kind, name) for name, (kind, _) in SENSORS.items())]


def to_be_read(kind: type[Kind], name: str) -> Kind:
    """Return readings of a kind that are still to be taken in the rows."""
    found = kind.unread(COUNT, name=name, about=SENSORS.get(name, (kind, {}))[1].get("about"))
    return replace(found, sockets=TOUCHED) if isinstance(found, Touch) else found


def test_every_kind_of_instrument_is_among_these() -> None:
    assert set(SENSOR_KINDS.values()) <= {kind for kind, _ in SENSORS.values()}


@pytest.fixture(scope="module")
def heavy() -> Arm:
    return load_arm(ROBOTS / "heavy_six" / "arm.toml")


@pytest.fixture(scope="module")
def rows(heavy: Arm) -> Rows:
    q = np.random.default_rng(4).uniform(-0.6, 0.6, (COUNT, len(heavy.joint_names)))
    return Rows.of(heavy.joint_names, q, ("p100",) * COUNT, {}, session="s", derived=("time",))


@pytest.fixture(scope="module")
def instrument() -> Instrument:
    pose = pin.SE3(pin.exp3(np.array([0.1, -0.2, 0.7])), np.array([1.0, -3.0, 0.5]))
    return Instrument(pose, {}, np.array([0.1, 0.02, -0.05]), 0.0, np.array([0.4, -1.2, 1.0]))


@pytest.fixture(scope="module")
def at(heavy: Arm, rows: Rows, instrument: Instrument) -> Postures:
    rng, sensors, links = np.random.default_rng(7), {}, heavy.link_names
    joint = heavy.robot.moving[2]
    for name, (kind, given) in SENSORS.items():
        size = sum(len(one.axes) for one in kind.nuisances)
        given = {key: links[len(links) // 2] if value == "forearm" else value for key, value in given.items()}
        given = {key: links[2] if value == "shoulder" else value for key, value in given.items()}
        given = {key: links[-2] if value == "wrist_yaw" else value for key, value in given.items()}
        if kind is Encoder:
            origin = np.eye(4)
            origin[:3, :3], origin[:3, 3] = joint.rotation, joint.origin
            given = {"link": joint.child, "about": Shaft(joint.name, joint.parent, False, joint.axis, origin)}
        declared = rng.normal(0.0, 0.05, size)
        if kind is Pixels:
            declared[:4] = 600.0, 620.0, 320.0, 240.0
        sensors[name] = kind.sensor(**{"name": name, "kind": kind, "link": heavy.robot.tip, "sigma": 1e-4,
                               "declared": declared, "std": np.full(size, 0.01), **given})  # fmt: skip
    view = look(Setup(replace(heavy, sensors=sensors), instrument), rows, np.arange(COUNT))
    return view.at


@pytest.mark.parametrize("scale", [0.0, 0.01])
@pytest.mark.parametrize(("kind", "name"), CASES)
def test_sensitivities_of_a_kind_are_those_of_its_residual(
    kind: type[Kind], name: str, scale: float, at: Postures
) -> None:
    """By every link that it sees, by frame, scale, target, mounting, gravity, its own nuisances; by no other."""
    instrument = replace(at.instrument, scale=scale)
    own, at = to_be_read(kind, name), replace(at, instrument=instrument)
    own = replace(own, values=own.predicted(at))  # near where they are read: rotation vectors far apart do not subtract
    target, turned = instrument.target, pin.exp3(instrument.mounting)

    def slope(change, size: int) -> np.ndarray:
        """Return (N, d, size) central differences of what is predicted."""
        ends = [[-own.residual(change(side * STEP * axis)) for side in (-1.0, 1.0)] for axis in np.eye(size)]
        each = [(two - one) / (2.0 * STEP) for one, two in ends]
        return np.stack(each, axis=2) if each else np.zeros((COUNT, own.dimension, 0))

    def by_instrument(change) -> Callable[[np.ndarray], Postures]:
        return lambda x: replace(at, instrument=replace(instrument, **change(x)))

    def moved(link: str | None) -> Callable[[np.ndarray], Postures]:
        """Return the arm with the origin of a link moved a little, base axes."""

        def after(x: np.ndarray) -> Postures:
            found = at.pose(link).copy()
            found[:, :3, 3] += x[:3]
            found[:, :3, :3] = pin.exp3(x[3:]) @ found[:, :3, :3]
            return replace(at, pose=lambda asked: found if asked == link else at.pose(asked))

        return after

    def by_sensor(key: str) -> Callable[[np.ndarray], Postures]:
        return lambda x: replace(at, sensors={name: replace(at.sensors[name], found={key: x})})

    cases = [
        (own.by_frame(at), by_instrument(lambda x: {"sessions": {"s": x}}), 6),
        (own.by_target(at), by_instrument(lambda x: {"target": target + x}), 3),
        (own.by_mounting(at), by_instrument(lambda x: {"mounting": pin.log3(pin.exp3(x) @ turned)}), 3),
        (own.by_scale(at)[:, :, None], by_instrument(lambda x: {"scale": scale + x[0]}), 1),
        (own.by_gravity(at), lambda x: replace(at, gravity=at.gravity + x), 3),
        (own.by_bend(at), lambda x: replace(at, bend=at.bend + x), 2),
    ]
    seen = own.jacobian(at)
    ends = {one for sensor in at.sensors.values() for one in (None, sensor.link, sensor.seen_from)}
    ends |= set(seen)
    cases += [(seen.get(link, np.zeros((COUNT, own.dimension, 6))), moved(link), 6) for link in ends]
    if name:
        keys = ("", *TOUCHED[:4]) if kind is Touch else ("",)
        cases += [(own.by_key(at, key), by_sensor(key), len(at.sensors[name].declared)) for key in keys]
        assert own.columns(name)[0].startswith(name)
        assert len(own.columns(name)) == (1 if kind in (Touch, Pixels) else kind.dimension)
        assert len(own.headers) == (1 if kind is Touch else own.dimension)
    rounding = max(1.0, 1e-2 * np.abs(own.values).max())  # loads are of tens of thousands
    for found, change, size in cases:
        np.testing.assert_allclose(found, slope(change, size), atol=2e-8 * np.abs(found).max(initial=rounding))


def test_a_known_distance_follows_the_numbers_of_its_sockets_alone(at: Postures) -> None:
    known = SocketDistance(np.ones((COUNT, 1)), np.ones((COUNT, 1)), "block", ("a", "b"))
    np.testing.assert_array_equal(known.by_own(at), np.zeros((COUNT, 1, 6)))


def test_a_kind_that_does_not_say_how_a_nuisance_changes_it_is_named(at: Postures) -> None:
    class Unsaid(Ranging):
        nuisances = (Nuisance("refraction", ("",), "1"),)

    with pytest.raises(NotImplementedError, match=r"Unsaid.others does not say how 'refraction' changes it"):
        Unsaid.unread(COUNT).by_own(at)


@pytest.mark.parametrize("name", list(SENSORS))
def test_a_sensor_sees_the_arm_give(heavy: Arm, at: Postures, rows: Rows, name: str) -> None:
    """What a reading changes by with a softer flexure, through the equilibrium, is what the arm then reads."""
    kind, softer, step = SENSORS[name][0], heavy.flexures[1], 1e-3
    arm, ends = replace(heavy, sensors=at.sensors), []
    unread = Readings(COUNT, (to_be_read(kind, name),))
    for side in (-1.0, 1.0):
        law = LinearLaw((1.0 + side * step) * softer.law.tangent(np.zeros(6), anywhere(heavy.robot)))
        flexures = (heavy.flexures[0], replace(softer, law=law), *heavy.flexures[2:])
        setup = Setup(replace(arm, flexures=flexures), at.instrument)
        view = look(setup, rows, np.arange(COUNT), readings=unread)
        ends.append(replace(view.readings.kinds[0], values=view.readings.kinds[0].predicted(view.at)).residual(at))
    view = look(Setup(arm, at.instrument), rows, np.arange(COUNT), readings=unread)
    free = factor_block(arm, {softer.name: softer.law.freed(anywhere(heavy.robot))}, 0.3)
    expected = free.jacobian(view).sum(axis=2)
    found = (ends[1] - ends[0]) / (2.0 * step)
    np.testing.assert_allclose(found, expected, atol=1e-4 * np.abs(expected).max() + 1e-12)
    assert np.abs(expected).max() > 1e-7


def test_rows_are_asked_about_without_any_reading(heavy: Arm, rows: Rows) -> None:
    view = look(Setup(heavy, Instrument()), rows, np.arange(COUNT))
    assert view.residual.shape == (COUNT, 0) and view.count == 0
    deflected = heavy.deflection(rows.q[3], "p100").pose.homogeneous
    np.testing.assert_allclose(view.line.tip[3], deflected, atol=1e-9)
    seen = look(Setup(heavy, Instrument()), rows, np.arange(COUNT), readings=unread(COUNT, Position, Orientation))
    assert seen.foremost == slice(0, 3) and seen.readings.slices[1] == slice(3, 6)
    np.testing.assert_allclose(seen.residual[:, seen.foremost], -view.line.tip[:, :3, 3], atol=1e-12)


def test_a_kind_that_nobody_else_knows_is_fitted_to_and_its_lost_beam_is_found(heavy: Arm, rows: Rows) -> None:
    """Coarse positions and fine distances: the target is known as well as the distances tell it."""
    truth, rng = np.array([0.004, -0.003, 0.006]), np.random.default_rng(9)
    arm = replace(heavy, prior=Prior(tool=0.05), measurement=replace(heavy.measurement, frame="base"), instrument=None)
    tip = look(Setup(arm, Instrument()), rows, np.arange(COUNT)).line.tip
    points = Instrument(target=truth).in_base(tip)
    coarse = Position(points + rng.normal(0.0, 1e-2, (COUNT, 3)), np.full((COUNT, 3), 1e-2))
    along = np.linalg.norm(points, axis=1, keepdims=True) + rng.normal(0.0, 1e-5, (COUNT, 1))
    fine = np.full((COUNT, 1), 1e-5)
    fine[::6] = np.inf
    along[5] += 5e-3
    alone = calibrate(arm, Measurements.of(rows, Readings(COUNT, (coarse,))))
    found = calibrate(arm, Measurements.of(rows, Readings(COUNT, (coarse, Ranging(along, fine)))))
    off = [np.linalg.norm(one.fit.setup.instrument.target - truth) for one in (alone, found)]
    assert off[1] < 1e-4 < off[0]
    assert found.fit.view.count == 4 * COUNT - 4
    weights = huber_weights(found.fit.view)
    assert weights[5].max() < 0.1 and np.sort(weights[:, 0])[1] > 0.5


def test_parts_of_a_campaign_are_replaced_and_taken_by_rows(rows: Rows) -> None:
    rng = np.random.default_rng(2)
    position, rotation, spread = rng.normal(size=(COUNT, 3)), rng.normal(size=(COUNT, 3)), np.full(COUNT, 1e-4)
    campaign = Measurements.of(rows, Readings(COUNT, (Position(position, np.ones((COUNT, 3))),)))
    turned = replace(campaign, rotation=rotation, sigma_r=spread)
    assert campaign.rotation is None and turned.readings.size == 6
    np.testing.assert_array_equal(turned.position, position)
    np.testing.assert_array_equal(replace(turned, position=2.0 * position).rotation, rotation)
    assert replace(turned, rotation=None, sigma_r=None).readings.size == 3
    some = turned.some([5, 2])
    np.testing.assert_array_equal(some.q, rows.q[[5, 2]])
    np.testing.assert_array_equal(some.rotation, rotation[[5, 2]])
    assert isinstance(some, Measurements) and some.pose == ("5", "2")
    with pytest.raises(InputError, match=r"no positions \(its readings: ranging\)"):
        _ = Measurements.of(rows, unread(COUNT, Ranging)).position
    with pytest.raises(InputError, match="sigma_r"):
        replace(campaign, rotation=rotation)


@pytest.mark.slow
@pytest.mark.parametrize("size", [1, 2, 3, 6])
def test_one_row_in_a_thousand_is_an_outlier_by_chance(size: int) -> None:
    length = np.linalg.norm(np.random.default_rng(size).normal(size=(400_000, size)), axis=1)
    assert (length > outlier_limit(size)).mean() == pytest.approx(1e-3, rel=0.25)
    assert np.median(length) == pytest.approx(median_length(size), rel=5e-3)
