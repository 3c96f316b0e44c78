"""Gravity of a base that was moved between campaigns: what rows, readings, effects and columns make of it."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from support.small_arms import ROBOTS

from armflex import Payload, load_arm
from armflex.arm import Measurement, Setup
from armflex.estimate.blocks import frame_block, remounted_block, session_block
from armflex.estimate.view import View, look
from armflex.laws.effects.catalogue import CATALOGUE
from armflex.laws.effects.effect import Effect, full
from armflex.laws.effects.location import BASE, TOOL, Location
from armflex.readings import Acceleration, Inclination, Orientation, Position, Readings
from armflex.readings.instrument import Instrument
from armflex.readings.sensor import Sensor
from armflex.rows import Rows

COUNT, STEP = 12, 1e-5
SESSIONS = ("flat",) * 4 + ("slope/1",) * 4 + ("slope/2",) * 4


def turned(*vector: float, at: tuple[float, ...] = (0.0, 0.0, 0.0)) -> np.ndarray:
    return np.array([*at, *vector])


@pytest.fixture(scope="module")
def setup() -> Setup:
    """Return an arm that bends, on two sites, with a level instrument, an accelerometer and a level on it."""
    arm = load_arm(ROBOTS / "heavy_six" / "arm.toml")
    sensors = {}
    for name, kind in (("level", Inclination), ("acc", Acceleration)):
        size = sum(len(one.axes) for one in kind.nuisances)
        sensors[name] = Sensor(name, kind, arm.robot.tip, 1e-4, np.zeros(size), np.full(size, 0.01))
    payloads = {"bag": Payload(30.0, np.array([0.1, 0.05, 0.2]))}
    level = Measurement("unknown", "measurement")
    arm = replace(arm, sensors=sensors, payloads=payloads, measurement=level)
    frames = {
        "flat": np.zeros(6),
        "slope": turned(0.08, -0.05, 0.4, at=(1.0, 0.2, 0.1)),
        "slope/2": turned(1e-3, 2e-3, -1e-3, at=(2e-3, 0.0, -1e-3)),
    }
    pose = pin.SE3(pin.exp3(np.array([0.02, -0.01, 0.7])), np.array([1.0, -3.0, 0.5]))
    target = np.array([0.1, 0.02, -0.05])
    targets = {"slope": turned(0.2, 0.1, -0.3, at=(0.01, 0.0, 0.02))}
    declared = Setup(arm, Instrument(target=target, sessions=frames, targets=targets, campaigns=("flat", "slope")))
    return declared.placed(pose)


def seen(setup: Setup, readings: Readings | None = None) -> View:
    arm, kinds = setup.arm, (Position, Orientation)
    q = np.random.default_rng(3).uniform(-0.5, 0.5, (COUNT, len(arm.joint_names)))
    rows = Rows.of(arm.joint_names, q, ("bag",) * COUNT, {}, derived=("time",))
    rows = replace(rows, session=SESSIONS)
    named = [arm.sensors[name].kind.unread(COUNT, name=name) for name in arm.sensors]
    readings = readings or Readings(COUNT, (*(kind.unread(COUNT) for kind in kinds), *named))
    return look(setup, rows, readings=readings)


def slopes(setup: Setup, moved, size: int) -> np.ndarray:
    """Return (M, d, size) central differences of what is predicted; rotation vectors far apart do not subtract."""
    view = seen(setup)
    near = Readings(COUNT, tuple(replace(one, values=one.predicted(view.at)) for one in view.readings.kinds))
    ends = [[-seen(moved(side * STEP * axis), near).residual for side in (-1.0, 1.0)] for axis in np.eye(size)]
    return np.stack([(two - one) / (2.0 * STEP) for one, two in ends], axis=2)


def test_gravity_is_another_one_in_every_base(setup: Setup) -> None:
    view = seen(setup)
    here = setup.instrument
    down = np.array([(here.pose.rotation @ setup.arm.robot.gravity)] * COUNT)
    found = view.gravity(setup.arm.robot.gravity[None])[:, 0]
    frames = [here.frame(name).rotation @ here.pose.rotation for name in ("flat", "slope", "slope")]
    expected = [frame.T @ one for frame, one in zip(np.repeat(frames, 4, axis=0), down, strict=True)]
    np.testing.assert_allclose(found, expected, atol=1e-12)
    arm = setup.arm
    for rows in (slice(0, 4), slice(4, 12)):
        own = replace(arm, robot=replace(arm.robot, gravity=found[rows][0]))
        alone = own.deflection(view.driven.q[rows], "bag", enforce_limits=False)
        np.testing.assert_allclose(view.line.tip[rows], alone.pose, atol=1e-9)
    flat = arm.deflection(view.driven.q[4:], "bag", enforce_limits=False)
    assert np.abs(view.line.tip[4:] - flat.pose).max() > 1e-5


def test_one_campaign_costs_nothing(setup: Setup) -> None:
    view = seen(replace(setup, instrument=replace(setup.instrument, campaigns=())))
    assert view.falls is None and len(view.line._parts) == 1


@pytest.mark.parametrize("level", [True, False])
def test_columns_of_frames_and_targets_are_differences(setup: Setup, level: bool) -> None:
    if not level:
        setup = replace(setup, arm=replace(setup.arm, measurement=Measurement()))
    blocks = (
        (frame_block(setup), 0.0),
        (session_block(setup, ("slope", "slope/1", "slope/2"), 1e-3, 1e-4), 1e-2),
        (remounted_block(setup, ("slope",), 0.01, turned=True), 0.0),
    )
    for block, size in blocks:
        steps = np.random.default_rng(1).normal(0.0, size, len(block.parameters))
        there = block.apply(setup, steps)
        found = block.jacobian(seen(there))
        expected = slopes(there, lambda x, b=block, s=steps: b.apply(setup, s + x), len(steps))
        np.testing.assert_allclose(found, expected, atol=2e-7 * np.abs(expected).max())


@pytest.mark.parametrize(
    ("name", "location"),
    [
        ("gravity_tilt", Location(BASE, None, (), (0, 1))),
        ("payload_mass", Location(TOOL)),
        ("payload_com", Location(TOOL, None, (), (0, 1, 2))),
        ("link_mass", Location("link:joint_4", terms=(0, 1, 2, 3))),
    ],
)
def test_columns_of_what_weighs_are_differences(setup: Setup, name: str, location: Location) -> None:
    if location.site.startswith("link:"):
        location = replace(location, site=f"link:{setup.arm.joint_names[3]}")
    view, law = seen(setup), CATALOGUE[name]
    count = len(location.terms) or 1
    found = view.jacobian(law, location, (), view.context)
    sizes = np.array([10.0, 0.1, 0.1, 0.1]) if name == "link_mass" else np.full(count, 10.0 if "mass" in name else 0.01)

    def moved(x: np.ndarray) -> Setup:
        return setup.with_effect(Effect(law, location, full(x * sizes, location, len(law.amplitudes))))

    expected = slopes(setup, moved, found.shape[2]) / sizes
    np.testing.assert_allclose(found, expected, atol=2e-5 * np.abs(expected).max())
    assert np.abs(expected[4:]).max() > 1e-9
