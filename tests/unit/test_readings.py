"""Rows without readings, and readings of kinds: what every kind says of itself, and that no one else need know."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
import pytest
from support.small_arms import ROBOTS

from armflex import Arm, Measurements, calibrate, load_arm
from armflex.errors import InputError
from armflex.estimate.robust import huber_weights
from armflex.estimate.view import look
from armflex.prior import Prior
from armflex.readings import Kind, Orientation, Position, Readings, unread
from armflex.readings.chance import median_length, outlier_limit
from armflex.readings.instrument import Instrument
from armflex.rows import Rows
from armflex.setup import Setup

COUNT, STEP = 24, 1e-6
SESSION = ("s",) * COUNT


@dataclass(frozen=True, eq=False)
class Distance(Kind):
    """(N, 1) distance of the target from the instrument [m], as a laser distance meter reads it; no part of armflex."""

    dimension = 1
    unit = "m"

    def residual(self, instrument: Instrument, tip: np.ndarray, sessions: Sequence[str]) -> np.ndarray:
        return self.values - np.linalg.norm(instrument.readings(tip, sessions), axis=1, keepdims=True)

    def jacobian(self, instrument: Instrument, tip: np.ndarray) -> np.ndarray:
        return self._along(instrument.points(tip), Position.unread(len(tip)).jacobian(instrument, tip))

    def by_frame(self, points: np.ndarray) -> np.ndarray:
        return self._along(points, Position.unread(len(points)).by_frame(points))

    def by_scale(self, instrument: Instrument, points: np.ndarray) -> np.ndarray:
        return np.linalg.norm(points, axis=1, keepdims=True) / (1.0 + instrument.scale)

    def by_target(self, instrument: Instrument, tip: np.ndarray) -> np.ndarray:
        return self._along(instrument.points(tip), instrument.axes(tip))

    def by_mounting(self, instrument: Instrument, tip: np.ndarray) -> np.ndarray:
        return np.zeros((len(tip), 1, 3))

    @staticmethod
    def _along(points: np.ndarray, changes: np.ndarray) -> np.ndarray:
        return (points / np.linalg.norm(points, axis=1, keepdims=True))[:, None] @ changes


KINDS = (Position, Orientation, Distance)


@pytest.fixture(scope="module")
def heavy() -> Arm:
    return load_arm(ROBOTS / "heavy_six" / "arm.toml")


@pytest.fixture(scope="module")
def rows(heavy: Arm) -> Rows:
    q = np.random.default_rng(4).uniform(-0.6, 0.6, (COUNT, len(heavy.joint_names)))
    return Rows.of(heavy.joint_names, q, ("none",) * COUNT, {}, session="s", derived=("time",))


@pytest.fixture(scope="module")
def instrument() -> Instrument:
    pose = pin.SE3(pin.exp3(np.array([0.1, -0.2, 0.7])), np.array([1.0, -3.0, 0.5]))
    return Instrument(pose, {}, np.array([0.1, 0.02, -0.05]), 0.0, np.array([0.4, -1.2, 1.0]))


@pytest.fixture(scope="module")
def tip(heavy: Arm, rows: Rows) -> np.ndarray:
    return look(Setup(heavy, Instrument()), rows, np.arange(COUNT)).line.tip


def moved(tip: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Return the tips after a small motion of their origins, base axes."""
    found = tip.copy()
    found[:, :3, 3] += step[:3]
    found[:, :3, :3] = pin.exp3(step[3:]) @ found[:, :3, :3]
    return found


@pytest.mark.parametrize("kind", KINDS)
def test_sensitivities_of_a_kind_are_those_of_its_residual(
    kind: type[Kind], instrument: Instrument, tip: np.ndarray
) -> None:
    read = Readings(COUNT, (kind(np.zeros((COUNT, kind.dimension)), np.ones((COUNT, kind.dimension))),))
    if kind is Orientation:  # near where they are read: rotation vectors far apart do not subtract
        seen = [pin.log3(turn) for turn in instrument.rotations(tip, SESSION)]
        read = Readings(COUNT, (Orientation(np.array(seen), np.ones((COUNT, 3))),))
    own, target, turned = read.kinds[0], instrument.target, pin.exp3(instrument.mounting)
    points = instrument.points(tip)

    def slope(change, size: int) -> np.ndarray:
        """Return (N, d, size) central differences of what is predicted."""
        ends = [[own.residual(*change(side * STEP * axis), SESSION) for side in (-1.0, 1.0)] for axis in np.eye(size)]
        return np.stack([(one - other) / (2.0 * STEP) for one, other in ends], axis=2)

    def mounted(x: np.ndarray) -> tuple[Instrument, np.ndarray]:
        return replace(instrument, mounting=pin.log3(pin.exp3(x) @ turned)), tip

    cases = (
        (own.jacobian(instrument, tip), lambda x: (instrument, moved(tip, x)), 6),
        (own.by_frame(points), lambda x: (replace(instrument, sessions={"s": x}), tip), 6),
        (own.by_target(instrument, tip), lambda x: (replace(instrument, target=target + x), tip), 3),
        (own.by_mounting(instrument, tip), mounted, 3),
        (own.by_scale(instrument, points)[:, :, None], lambda x: (replace(instrument, scale=x[0]), tip), 1),
    )  # fmt: skip
    for found, change, size in cases:
        np.testing.assert_allclose(found, slope(change, size), atol=2e-8)


def test_rows_are_asked_about_without_any_reading(heavy: Arm, rows: Rows) -> None:
    view = look(Setup(heavy, Instrument()), rows, np.arange(COUNT))
    assert view.residual.shape == (COUNT, 0) and view.count == 0
    deflected = heavy.deflection(rows.q[3]).pose.homogeneous
    np.testing.assert_allclose(view.line.tip[3], deflected, atol=1e-9)
    seen = look(Setup(heavy, Instrument()), rows, np.arange(COUNT), readings=unread(COUNT, Position, Orientation))
    assert seen.positions == slice(0, 3) and seen.readings.place(Orientation) == slice(3, 6)
    np.testing.assert_allclose(seen.residual[:, seen.positions], -view.points, atol=1e-12)


def test_a_kind_that_nobody_else_knows_is_fitted_to_and_its_lost_beam_is_found(heavy: Arm, rows: Rows) -> None:
    """Coarse positions and fine distances: the target is known as well as the distances tell it."""
    truth, rng = np.array([0.004, -0.003, 0.006]), np.random.default_rng(9)
    arm = replace(heavy, prior=Prior(tool=0.05), measurement=replace(heavy.measurement, frame="base"), instrument=None)
    tip = look(Setup(arm, Instrument()), rows, np.arange(COUNT)).line.tip
    points = Instrument(target=truth).readings(tip, SESSION)
    coarse = Position(points + rng.normal(0.0, 1e-2, (COUNT, 3)), np.full((COUNT, 3), 1e-2))
    along = np.linalg.norm(points, axis=1, keepdims=True) + rng.normal(0.0, 1e-5, (COUNT, 1))
    fine = np.full((COUNT, 1), 1e-5)
    fine[::6] = np.inf
    along[5] += 5e-3
    alone = calibrate(arm, Measurements.of(rows, Readings(COUNT, (coarse,))))
    found = calibrate(arm, Measurements.of(rows, Readings(COUNT, (coarse, Distance(along, fine)))))
    off = [np.linalg.norm(one.fit.setup.instrument.target - truth) for one in (alone, found)]
    assert off[1] < 1e-4 < off[0]
    assert found.fit.view.count == 4 * COUNT - 4
    weights = huber_weights(found.fit.view)
    assert weights[5] < 0.1 and np.sort(weights)[1] > 0.5


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
    with pytest.raises(InputError, match=r"no positions \(its readings: distance\)"):
        _ = Measurements.of(rows, unread(COUNT, Distance)).position
    with pytest.raises(InputError, match="sigma_r"):
        replace(campaign, rotation=rotation)


@pytest.mark.parametrize("size", [1, 2, 3, 6])
def test_one_row_in_a_thousand_is_an_outlier_by_chance(size: int) -> None:
    length = np.linalg.norm(np.random.default_rng(size).normal(size=(400_000, size)), axis=1)
    assert (length > outlier_limit(size)).mean() == pytest.approx(1e-3, rel=0.25)
    assert np.median(length) == pytest.approx(median_length(size), rel=5e-3)
