"""States that depend on the rows before: lagged temperatures and play, against closed forms and brute force."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from support import six_axes

from armflex import Payload
from armflex.laws.effects import CATALOGUE, Location
from armflex.laws.effects.candidate import Candidate
from armflex.laws.effects.hysteresis import play
from armflex.laws.effects.shapes import follow

LAG = 1800.0
loads = arrays(float, st.integers(1, 40), elements=st.floats(-100.0, 100.0, width=32))
radii = st.floats(0.015625, 50.0, width=32)


@pytest.fixture(scope="module", autouse=True)
def compiled():
    """Compiling takes longer than one example may."""
    follow(np.arange(2.0), np.zeros(2), LAG)
    play(np.zeros(1), 1.0)


def clock(seed: int, count: int = 300) -> np.ndarray:
    return np.cumsum(np.random.default_rng(seed).exponential(60.0, count))


def test_lag_of_a_ramp():
    time = clock(0) - clock(0)[0]
    lagging = 5.0 + 2e-3 * (time - LAG * (1.0 - np.exp(-time / LAG)))
    np.testing.assert_allclose(follow(time, 5.0 + 2e-3 * time, LAG), lagging, rtol=1e-12)


def test_lag_of_a_step():
    """A step between two rows a millisecond apart: the rest is the exponential."""
    time = np.concatenate([[0.0, 1e-3], np.linspace(10.0, 3.0 * LAG, 50)])
    felt = follow(time, np.concatenate([[0.0], np.full(51, 10.0)]), LAG)
    np.testing.assert_allclose(felt[1:], 10.0 * (1.0 - np.exp(-time[1:] / LAG)), atol=1e-5)


def test_lag_of_a_sine_loses_size_and_gains_phase():
    turning = 2.0 * np.pi / 7200.0
    time = np.arange(0.0, 20.0 * LAG, 5.0)
    felt = follow(time, np.sin(turning * time), LAG)[-1000:]
    size, phase = 1.0 / np.hypot(1.0, turning * LAG), np.arctan(turning * LAG)
    np.testing.assert_allclose(felt, size * np.sin(turning * time[-1000:] - phase), atol=2e-5)


def test_lag_against_small_steps():
    """Rows at random times are the same as many small steps of Euler in between."""
    time, values = clock(1, 30), np.random.default_rng(2).normal(20.0, 4.0, 30)
    fine = np.linspace(time[0], time[-1], 200_001)
    step, x = fine[1] - fine[0], np.interp(fine, time, values)
    y, state = np.empty_like(fine), values[0]
    for i in range(len(fine)):
        y[i] = state
        state += step / LAG * (x[i] - state)
    np.testing.assert_allclose(follow(time, values, LAG), np.interp(time, fine, y), atol=1e-3)


@given(st.floats(-50.0, 50.0), st.floats(1.0, 1e6), st.lists(st.floats(0.0, 1e5), min_size=1, max_size=30))
def test_lag_of_a_constant_is_the_constant(value, lag, times):
    time = np.array(times)
    np.testing.assert_allclose(follow(time, np.full(len(time), value), lag), value, rtol=1e-12, atol=1e-12)


@given(arrays(float, 20, elements=st.floats(-50.0, 50.0)), st.floats(10.0, 1e5))
def test_a_lagged_temperature_stays_within_what_was_felt(values, lag):
    felt = follow(clock(3, 20), values, lag)
    assert values.min() - 1e-9 <= felt.min() and felt.max() <= values.max() + 1e-9


@given(arrays(float, 12, elements=st.floats(-50.0, 50.0)), st.permutations(range(12)))
def test_rows_are_taken_in_the_order_of_time(values, order):
    time = clock(4, 12)
    shuffled = list(order)
    np.testing.assert_array_equal(follow(time[shuffled], values[shuffled], LAG), follow(time, values, LAG)[shuffled])


@given(arrays(float, 15, elements=st.floats(-50.0, 50.0)), arrays(float, 15, elements=st.floats(-50.0, 50.0)))
def test_lag_is_linear(one, other):
    time = clock(5, 15)
    together = follow(time, 2.0 * one - other, LAG)
    np.testing.assert_allclose(together, 2.0 * follow(time, one, LAG) - follow(time, other, LAG), atol=1e-10)


def row_by_row(time: np.ndarray, values: np.ndarray, lag: float) -> np.ndarray:
    """The recursion as it is written down, a row at a time."""
    order = np.argsort(time, kind="stable")
    state, y, before = np.empty(len(values)), values[order[0]], order[0]
    for i in order:
        step = time[i] - time[before]
        if step > 0.0:
            slope, decay = (values[i] - values[before]) / step, np.exp(-step / lag)
            y = values[i] - slope * lag + (y - values[before] + slope * lag) * decay
        state[i], before = y, i
    return state


@given(st.lists(st.integers(0, 10**5), min_size=1, max_size=40), st.floats(1.0, 1e6), st.integers(0, 99))
def test_lag_is_the_recursion_row_by_row(times, lag, seed):
    """To the last bit, also where rows share a time or are not in its order."""
    time = np.repeat(np.array(times, dtype=float), np.random.default_rng(seed).integers(1, 3, len(times)))
    values = np.random.default_rng(seed).normal(20.0, 4.0, len(time))
    np.testing.assert_array_equal(follow(time, values, lag), row_by_row(time, values, lag))


def test_a_short_lag_is_no_lag_and_a_long_one_stays():
    time, values = clock(6), np.random.default_rng(7).normal(size=300)
    np.testing.assert_allclose(follow(time, values, 1e-6), values, atol=1e-3)
    np.testing.assert_allclose(follow(time, values, 1e9), values[0], atol=1e-4)


def slider(load: np.ndarray, radius: float) -> np.ndarray:
    """A block that a rod pushes, with slack on either side: moved by hand, in small steps of the rod."""
    block, rod, found = 0.0, 0.0, []
    for value in load:
        for position in np.linspace(rod, value, 400):
            block += max(position - radius - block, 0.0) - max(block - position - radius, 0.0)
        rod = value
        found.append(block)
    return np.array(found)


@pytest.mark.slow
@given(loads, radii)
def test_play_is_a_block_with_slack(load, radius):
    np.testing.assert_allclose(play(load, radius), slider(load, radius), atol=1e-10)


@pytest.mark.slow
@given(loads, radii)
def test_play_keeps_within_its_radius(load, radius):
    assert np.abs(play(load, radius) - load).max() <= radius * (1.0 + 1e-12)


@given(loads, radii, st.integers(2, 5))
def test_play_does_not_care_how_fast(load, radius, times):
    """Rows in between, on the way from one load to the next, change nothing."""
    driven = [0.0, *load]
    ways = [np.linspace(one, other, times + 1)[1:] for one, other in itertools.pairwise(driven)]
    np.testing.assert_allclose(play(np.concatenate(ways), radius)[times - 1 :: times], play(load, radius), atol=1e-10)


@given(loads, radii)
def test_play_goes_either_way_alike(load, radius):
    np.testing.assert_allclose(play(-load, radius), -play(load, radius), atol=1e-12)


@given(loads, loads, radii)
def test_play_never_turns_a_larger_load_into_a_smaller_state(one, other, radius):
    count = min(len(one), len(other))
    low, high = np.minimum(one[:count], other[:count]), np.maximum(one[:count], other[:count])
    assert (play(low, radius) <= play(high, radius) + 1e-12).all()


@given(loads)
def test_no_slack_is_no_play(load):
    np.testing.assert_array_equal(play(load, 0.0), load)


@pytest.mark.slow
@pytest.mark.parametrize("radius", [5.0, 5.5])
def test_a_load_within_the_slack_is_not_felt(radius):
    np.testing.assert_array_equal(play(np.array([3.0, -5.0, 5.0, 0.0]), radius), np.zeros(4))


def test_where_nothing_went_before_a_load_was_put_on_once():
    """The joint turns by gain (load - radius), and rows of a batch know nothing of each other."""
    joint, gain, radius = "shoulder_lift_joint", 2e-4, 5.0
    place = Location(joint, "ry", terms=(0,))
    arm, held = six_axes.declared(), Payload(8.0, np.zeros(3))
    remembers = replace(arm, effects=(Candidate(CATALOGUE["hysteresis"], place, (radius,)).effect(np.array([gain])),))
    q = np.array([six_axes.LOWER, six_axes.UPPER])
    for position in q:
        deflection = remembers.deflection(position, held)
        load = arm.deflection(position, held).joint_loads[arm.joint_names.index(joint), 4]
        assert abs(load) > 2.0 * radius
        assert deflection.twists[0, 4] == pytest.approx(gain * (load - np.sign(load) * radius), rel=5e-3)
        assert [flag.code for flag in deflection.flags] == ["no_history"]
    batch = remembers.deflection(q[::-1], held)
    alone = [remembers.deflection(position, held).displacement for position in q[::-1]]
    np.testing.assert_allclose(batch.displacement, alone, atol=1e-12)
    given = remembers.deflection(q[0], held, covariates={remembers.effects[0].state: 0.0})
    assert not given.flags and np.abs(given.twists).max() < 1e-15
    prepared = remembers.prepared(held)
    np.testing.assert_allclose([prepared(position) for position in q[::-1]], alone, atol=1e-12)


def test_what_follows_a_temperature_at_once_remembers_nothing_and_what_lags_has_settled():
    place = Location("link:shoulder_lift_joint", None, ("temperature",), (0,))
    arms = [
        replace(
            six_axes.declared(), effects=(Candidate(CATALOGUE["thermal_growth"], place, (20.0, lag)).effect([1e-5]),)
        )
        for lag in (0.0, 300.0)
    ]
    at_once, lagging = [arm.deflection(six_axes.LOWER, covariates={"temperature": 25.0}) for arm in arms]
    assert not at_once.flags and [flag.code for flag in lagging.flags] == ["no_history"]
    np.testing.assert_allclose(lagging.displacement, at_once.displacement, rtol=1e-12)
    assert np.abs(at_once.displacement).max() > 1e-6
