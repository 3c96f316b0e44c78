"""A tracker in a control loop: an update is quick."""

from __future__ import annotations

import time

import numpy as np
import pytest

from armflex import Tracker
from armflex.track.estimate import Seen, estimate_of, take

pytestmark = pytest.mark.slow


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
