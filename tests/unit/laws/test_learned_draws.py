"""Draws of learned laws: straight in their values, as their covariance means them."""

from dataclasses import replace

import numpy as np
import pytest
from support.learned_laws import DECLARED, ROW, SIZE, moved
from support.small_arms import central_difference


@pytest.mark.parametrize("name", DECLARED)
def test_a_step_of_the_values_is_one_of_the_twist(name):
    law, rng = moved(name), np.random.default_rng(3)
    step, wrenches = 0.02 * rng.normal(size=len(law.values)), SIZE * rng.uniform(-1.0, 1.0, size=(5, 6))
    there, row = law.moved(step), ROW.some(0)
    expected = law.twist(wrenches, row) + law.by_values(wrenches, row) @ step
    np.testing.assert_allclose(there.twist(wrenches, row), expected, rtol=1e-8, atol=1e-9 * np.abs(expected).max())
    for wrench in wrenches:
        slope = central_difference(lambda load: there.twist(load * SIZE, row), wrench / SIZE, 1e-4)
        tangent = there.tangent(wrench, row) * SIZE
        np.testing.assert_allclose(tangent, slope, rtol=1e-4, atol=1e-6 * np.abs(slope).max())


def test_a_step_too_far_leaves_a_compliance():
    law = moved("linear")
    step = -3.0 * np.ones(len(law.values))
    there = law.moved(step).tangent(SIZE, ROW.some(0))
    gives = np.flatnonzero(np.diag(there))  # a rigid axis has no eigenvalue but rounding
    some = there[np.ix_(gives, gives)]
    assert np.linalg.eigvalsh(0.5 * (some + some.T)).min() > 0.0 and np.abs(there - there.T).max() < 1e-20


@pytest.mark.slow
@pytest.mark.parametrize("name", ["linear", "polynomial", "neural"])
def test_draws_spread_as_the_covariance_says(name):
    law, rng = moved(name), np.random.default_rng(7)
    root = 0.05 * rng.normal(size=(len(law.values),) * 2) / np.sqrt(len(law.values))
    law, wrench, row = replace(law, posterior=root @ root.T), 0.7 * SIZE, ROW.some(0)
    drawn = np.array([law.draw(rng).twist(wrench, row) for _ in range(1000)])
    expected = np.sqrt(np.diag(replace(law, reach=None).covariance(wrench, row)))
    # A standard deviation from 1000 draws is right to a root of 2000, at 4 of them.
    np.testing.assert_allclose(drawn.std(axis=0), expected, rtol=4.0 / np.sqrt(2000))
    assert law.draw(rng).parts[0].constant is not None
