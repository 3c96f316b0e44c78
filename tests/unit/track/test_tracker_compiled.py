"""A tracker in a control loop: nothing is compiled while readings come in, and an update is quick."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from armflex import Tracker
from armflex.track.estimate import Seen, estimate_of, take

pytestmark = pytest.mark.slow

TESTS = Path(__file__).parents[2]

FRESH = """
import sys
from pathlib import Path
from studies.tracked import machine_in
from armflex import Tracker
from armflex.mechanics.many_rows import kernel
machine = machine_in(Path(sys.argv[1]))
tracker = Tracker(machine.arm)
functions = [getattr(kernel(), name) for name in ("solve_many", "respond_rows")]
ready = [len(function.signatures) for function in functions]
for reading in machine.readings(100, 10):
    tracker.update(reading)
assert ready == [len(function.signatures) for function in functions] == [1, 1], ready
"""


def test_readings_compile_nothing(tmp_path):
    """In a process of its own: what a reading needs was compiled, or read where it is kept, with the tracker."""
    done = subprocess.run(
        [sys.executable, "-c", FRESH, tmp_path], cwd=TESTS, capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 0, done.stderr


def test_an_update_is_quick(known, machine):
    """The quickest of many takes some tenths of a millisecond of the processor's time; five of them here."""
    tracker, readings = Tracker(known), machine.readings(3, 40)
    tracker.update(readings[0])
    taken = []
    for reading in readings[1:]:
        start = time.thread_time()
        tracker.update(reading)
        taken.append(time.thread_time() - start)
    assert min(taken) < 5e-3


@pytest.mark.parametrize("size", [3, 6])
@pytest.mark.parametrize("count", [1, 11, 101])
def test_what_an_estimate_becomes(size, count):
    """Against the normal equations of the same reading."""
    rng = np.random.default_rng(count)
    root = rng.normal(size=(count, count))
    before, columns = estimate_of(root @ root.T), rng.normal(size=(size, count))
    seen = Seen(0.1 * rng.normal(size=size), columns)
    after, weight, _ = take(before, seen)
    covariance = before.covariance
    gain = covariance @ columns.T @ np.linalg.inv(columns @ covariance @ columns.T + np.eye(size))
    assert weight == 1.0
    np.testing.assert_allclose(after.values, gain @ seen.residual, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(after.covariance, covariance - gain @ columns @ covariance, rtol=1e-7, atol=1e-8)
