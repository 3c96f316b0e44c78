"""What numba compiles of the tracker against the same by numpy and LAPACK."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_tracker import elsewhere, followed, in_base, known, machine, measured  # noqa: F401 - fixtures

from armflex import Arm, Reading, Tracker, calibrate
from armflex.readings.instrument import Instrument
from armflex.tracking import estimate, quick
from armflex.tracking.estimate import Seen, estimate_of, take
from armflex.tracking.model import model_of
from armflex.tracking.sight import Sight

pytest.importorskip("numba")

TESTS = Path(__file__).parent


@pytest.fixture
def plainly(monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable], object]:
    """A call as it is without numba."""

    def call(asked: Callable) -> object:
        with monkeypatch.context() as patch:
            patch.setattr(estimate, "compiled", lambda: None)
            patch.setattr(quick, "compiled", lambda: None)
            return asked()

    return call


FRESH = """
import sys
from pathlib import Path
from tracked import machine_in
from armflex import Tracker
from armflex.tracking.compiled import see, take
machine = machine_in(Path(sys.argv[1]))
tracker = Tracker(machine.arm)
ready = len(see.signatures), len(take.signatures)
for reading in machine.readings(100, 10):
    tracker.update(reading)
assert ready == (len(see.signatures), len(take.signatures)) == (1, 1), ready
"""


def test_readings_compile_nothing(tmp_path):
    """In a process of its own: what a reading needs was compiled, or read where it is kept, with the tracker."""
    done = subprocess.run([sys.executable, "-c", FRESH, tmp_path], cwd=TESTS, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def seen_by(arm: Arm, readings: list[Reading]) -> list[Seen]:
    model = model_of(arm)
    sight = Sight(model.declared, model.blocks, None, 1e-4)
    return [sight(reading) for reading in readings]


def assert_same(arm: Arm, readings: list[Reading], plainly: Callable) -> None:
    for one, other in zip(seen_by(arm, readings), plainly(lambda: seen_by(arm, readings)), strict=True):
        assert np.abs(one.residual - other.residual).max() < 1e-12 * max(np.abs(other.residual).max(), 1e3)
        assert np.abs(one.columns - other.columns).max() < 1e-12 * np.abs(other.columns).max()


def test_what_is_seen(known, machine, plainly):  # noqa: F811
    readings = machine.readings(4, 12)
    readings[3] = replace(readings[3], sigma=np.array([1e-4, 2e-4, 5e-4]))
    assert_same(known, readings, plainly)


def test_what_is_seen_from_elsewhere_where_a_law_depends_on_position(tarm, plainly):
    assert_same(*elsewhere(tarm), plainly)


def test_what_is_seen_of_a_learned_law(machine, tmp_path, plainly):  # noqa: F811
    arm = in_base(tmp_path, "learn = true\n")
    learned = calibrate(arm, measured(machine, machine.readings(800, 120), "learned.csv")).arm
    stretched = replace(learned, instrument=replace(learned.instrument or Instrument(), scale=1e-3))
    assert_same(stretched, machine.readings(4, 12), plainly)


@pytest.mark.parametrize("size", [3, 6])
@pytest.mark.parametrize("count", [1, 11, 101])
def test_what_an_estimate_becomes(size, count, plainly):
    rng = np.random.default_rng(count)
    root = rng.normal(size=(count, count))
    before, columns = estimate_of(root @ root.T), rng.normal(size=(size, count))
    for away in (0.1, 1.0, 100.0, 1e4):
        seen = Seen(away * rng.normal(size=size), columns)
        one, other = take(before, seen), plainly(lambda seen=seen: take(before, seen))
        assert one[1] == pytest.approx(other[1], rel=1e-9) and one[2] == pytest.approx(other[2], rel=1e-9)
        assert one[0].values == pytest.approx(other[0].values, rel=1e-8, abs=1e-8)
        assert one[0].covariance == pytest.approx(other[0].covariance, rel=1e-8, abs=1e-8)


def test_a_whole_course(machine, plainly):  # noqa: F811
    """From the declared arm, linearised anew on the way, with a gross reading and a change."""
    readings = [*machine.readings(5, 60), *machine.readings(6, 20, softer={"A4": 1.2})]
    readings[2] = replace(readings[2], position=readings[2].position + np.array([0.0, 0.0, 0.05]))
    one, other = followed(Tracker(machine.arm), readings), plainly(lambda: followed(Tracker(machine.arm), readings))
    assert [change.name for change in one.changes] == [change.name for change in other.changes] == ["compliance A4"]
    assert np.abs((one.values - other.values) / one.std).max() < 1e-6
    assert one.std == pytest.approx(other.std, rel=1e-6) and one.outliers == other.outliers
