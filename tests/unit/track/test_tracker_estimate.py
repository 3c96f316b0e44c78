"""What an update of a tracker makes of its estimate."""

import numpy as np
import pytest

from armflex.track.estimate import LinearisedReading, estimate_of, take

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("size", [3, 6])
@pytest.mark.parametrize("count", [1, 11, 101])
def test_what_an_estimate_becomes(size, count):
    """Against the normal equations of the same reading."""
    rng = np.random.default_rng(count)
    root = rng.normal(size=(count, count))
    before, columns = estimate_of(root @ root.T), rng.normal(size=(size, count))
    seen = LinearisedReading(0.1 * rng.normal(size=size), columns)
    after, weight, _ = take(before, seen)
    covariance = before.covariance
    gain = covariance @ columns.T @ np.linalg.inv(columns @ covariance @ columns.T + np.eye(size))
    assert weight == 1.0
    np.testing.assert_allclose(after.values, gain @ seen.residual, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(after.covariance, covariance - gain @ columns @ covariance, rtol=1e-7, atol=1e-8)
