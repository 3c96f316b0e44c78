"""The linear problem with Gaussian noise and priors: closed forms, and exact arithmetic as the referee."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from armflex.errors import NotFiniteError, ShapeError
from armflex.linear_gaussian import MANY, LinearGaussian, most_probable, squared


def problem(seed: int, count: int, size: int, decades: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (n, P) regressors, (P,) prior precisions (some of them 0) and (n,) readings, units `decades` apart."""
    rng = np.random.default_rng(seed)
    unit = 10.0 ** rng.uniform(-decades / 2.0, decades / 2.0, size)
    precision = np.where(rng.random(size) < 0.5, 0.0, rng.uniform(0.1, 10.0, size)) * unit**2
    return rng.normal(size=(count, size)) * unit, precision, rng.normal(size=count)


def exact(jacobian: np.ndarray, precision: np.ndarray, readings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return values and covariance by Gauss and Jordan in fractions: no rounding, no scaling."""
    rows = [[Fraction(float(number)) for number in row] for row in jacobian]
    size = jacobian.shape[1]
    table = []
    for i in range(size):
        normal = [sum(row[i] * row[j] for row in rows) for j in range(size)]
        normal[i] += Fraction(float(precision[i]))
        score = sum(row[i] * Fraction(float(number)) for row, number in zip(rows, readings, strict=True))
        table.append([*normal, score, *(Fraction(int(i == j)) for j in range(size))])
    for i in range(size):
        table[i] = [number / table[i][i] for number in table[i]]
        for k in range(size):
            if k != i:
                table[k] = [a - table[k][i] * b for a, b in zip(table[k], table[i], strict=True)]
    solved = np.array([[float(number) for number in row[size:]] for row in table])
    return solved[:, 0], solved[:, 1:]


def close(found: np.ndarray, expected: np.ndarray, unit: np.ndarray, tolerance: float) -> None:
    """Compare in units of (P,) standard deviations, with all their products for a matrix."""
    scale = unit if found.ndim == 1 else np.outer(unit, unit)
    np.testing.assert_allclose(found / scale, expected / scale, rtol=0.0, atol=tolerance)


problems = given(st.integers(0, 10_000), st.integers(5, 9), st.integers(1, 5), st.sampled_from([0.0, 4.0, 16.0]))


@settings(max_examples=60)
@problems
def test_values_and_covariance_are_those_of_exact_arithmetic(seed: int, count: int, size: int, decades: float) -> None:
    jacobian, precision, readings = problem(seed, count, size, decades)
    values, covariance = exact(jacobian, precision, readings)
    known, std = LinearGaussian.of(jacobian, precision), np.sqrt(np.diag(covariance))
    # What rounding of the scaled matrix by 1e-16 may do to its inverse, by its condition.
    condition = np.linalg.cond(known.information * np.outer(known.scale, known.scale))
    close(known.solve(jacobian.T @ readings), values, std, 1e-14 * condition)
    close(most_probable(jacobian, precision, readings), values, std, 1e-14 * condition)
    close(known.covariance, covariance, std, 1e-14 * condition)
    np.testing.assert_allclose(known.std, std, rtol=1e-14 * condition)
    assert known.null_space.shape == (0, size)


@settings(max_examples=40)
@problems
def test_the_root_is_one_of_the_covariance(seed: int, count: int, size: int, decades: float) -> None:
    jacobian, precision, _ = problem(seed, count, size, decades)
    known = LinearGaussian.of(jacobian, precision)
    close(known.root @ known.root.T, known.covariance, known.std, 1e-12)
    condition = np.linalg.cond(known.information * np.outer(known.scale, known.scale))
    np.testing.assert_allclose(known.root.T @ known.information @ known.root, np.eye(size), atol=1e-14 * condition)


@settings(max_examples=40)
@problems
def test_rows_added_one_by_one_are_rows_solved_together(seed: int, count: int, size: int, decades: float) -> None:
    jacobian, precision, _ = problem(seed, count + size, size, decades)
    together = LinearGaussian.of(jacobian, precision)
    first = LinearGaussian.of(jacobian[:size], precision)
    for row in jacobian[size:]:
        first = first.with_rows(row)
    close(first.information, together.information, 1.0 / together.scale, 1e-13)
    half = LinearGaussian(np.diag(precision)).with_rows(jacobian.reshape(len(jacobian), 1, size))
    close(half.information, together.information, 1.0 / together.scale, 1e-13)


@settings(max_examples=40)
@problems
def test_a_projected_regressor_has_the_amplitude_of_the_whole_problem(
    seed: int, count: int, size: int, decades: float
) -> None:
    """Frisch, Waugh and Lovell, with priors: what is eliminated and what is fitted together agree."""
    jacobian, precision, readings = problem(seed, count + 2, size + 1, decades)
    own, new = jacobian[:, :size], jacobian[:, size:]
    known = LinearGaussian.of(own, precision[:size])
    residual = readings - own @ known.solve(own.T @ readings)
    seen = known.root.T @ (own.T @ new)
    last = LinearGaussian(new.T @ new - seen.T @ seen).with_precision(precision[size:])
    amplitude, gain = last.solve(new.T @ residual), (new.T @ residual) @ last.solve(new.T @ residual)
    values, covariance = exact(jacobian, precision, readings)
    whole = LinearGaussian.of(jacobian, precision)
    tolerance = 1e-13 * np.linalg.cond(whole.information * np.outer(whole.scale, whole.scale))
    close(amplitude, values[size:], np.sqrt(np.diag(covariance))[size:], tolerance)
    close(last.covariance, covariance[size:, size:], np.sqrt(np.diag(covariance))[size:], tolerance)

    def objective(columns: np.ndarray, prior: np.ndarray) -> float:
        best = exact(columns, prior, readings)[0]
        return float(((readings - columns @ best) ** 2).sum() + prior @ best**2)

    fall = objective(own, precision[:size]) - objective(jacobian, precision)
    assert gain == pytest.approx(fall, rel=1e-9, abs=tolerance)


@settings(max_examples=40)
@given(st.integers(0, 10_000), st.integers(1, 3), st.sampled_from([0.0, 4.0, 16.0]))
def test_the_null_space_is_found_in_any_units(seed: int, free: int, decades: float) -> None:
    """Columns that are mixtures of others: as many directions as mixtures, none of which a reading notices."""
    rng = np.random.default_rng(seed)
    independent = rng.normal(size=(12, 4))
    unit = 10.0 ** rng.uniform(-decades / 2.0, decades / 2.0, 4 + free)
    jacobian = np.hstack([independent, independent @ rng.normal(size=(4, free))]) * unit
    known = LinearGaussian.of(jacobian, np.zeros(4 + free))
    assert known.null_space.shape == (free, 4 + free) and known.root.shape == (4 + free, 4)
    assert np.abs(known.null_space / known.scale @ (jacobian * known.scale).T).max() < 1e-5  # parts below PART are cut
    assert np.isinf(known.std[4:]).all()
    # What readings do determine: themselves, and with the right variance.
    reduced = LinearGaussian.of(independent, np.zeros(4))
    seen = jacobian @ known.covariance @ jacobian.T
    np.testing.assert_allclose(seen, independent @ reduced.covariance @ independent.T, atol=1e-9)
    readings = rng.normal(size=12)
    best = independent @ reduced.solve(independent.T @ readings)
    np.testing.assert_allclose(jacobian @ known.solve(jacobian.T @ readings), best, atol=1e-9)
    # A prior on what is aliased settles it.
    held = known.with_precision(np.concatenate([np.zeros(4), unit[4:] ** 2]))
    assert not len(held.null_space) and np.isfinite(held.std).all()


def test_what_is_known_of_parameters_against_closed_forms() -> None:
    jacobian = np.array([[2.0, 1.0, 1.0, 0.0], [0.0, 3.0, 3.0, 0.0], [1.0, 0.0, 0.0, 0.0]])
    told = LinearGaussian.of(jacobian, np.array([4.0, 0.0, 0.0, 0.0]))
    normal = np.array([[5.0 + 4.0, 2.0], [2.0, 10.0]])  # of the first, and of the sum of the two that act alike
    np.testing.assert_allclose(told.std, [np.sqrt(np.linalg.inv(normal)[0, 0]), np.inf, np.inf, np.inf])
    both = np.array([0.0, 1.0, 1.0, 0.0])
    assert both @ told.covariance @ both == pytest.approx(np.linalg.inv(normal)[1, 1])
    assert told.null_space.shape == (2, 4) and np.abs(jacobian @ told.null_space.T).max() < 1e-12
    held = LinearGaussian.of(jacobian, np.array([4.0, 1.0, 1.0, 0.25]))
    assert not len(held.null_space) and held.std[3] == pytest.approx(2.0)
    exactly = np.linalg.inv(jacobian.T @ jacobian + np.diag([4.0, 1.0, 1.0, 0.25]))
    np.testing.assert_allclose(held.covariance, exactly, rtol=1e-10, atol=1e-14)


def test_one_reading_of_one_parameter_is_the_weighted_mean_with_its_prior() -> None:
    known = LinearGaussian.of(np.array([[3.0]]), np.array([4.0]))
    assert known.std[0] == pytest.approx(13.0**-0.5)
    assert known.solve(np.array([3.0 * 2.0]))[0] == pytest.approx(6.0 / 13.0)


def test_what_others_leave_uncertain_is_gone_when_they_are_known() -> None:
    jacobian, precision, _ = problem(4, 9, 4, 6.0)
    known, some = LinearGaussian.of(jacobian, precision), np.array([3, 1])
    alone = LinearGaussian.of(jacobian[:, some], precision[some])
    close(known.conditional(some).covariance, alone.covariance, alone.std, 1e-12)
    assert (known.conditional(some).std <= known.std[some]).all()


def test_the_smallest_information_there_is_counts() -> None:
    known = LinearGaussian(np.diag([1e-310, 1e300]))
    assert known.null_space.shape == (0, 2) and known.root.shape == (2, 2)
    np.testing.assert_allclose(known.solve(np.array([1e-310, 1e300])), 1.0, rtol=1e-9)


def test_nothing_known_at_all_is_a_null_space_and_no_value() -> None:
    known = LinearGaussian.of(np.zeros((3, 2)), np.zeros(2))
    assert known.null_space.shape == (2, 2) and np.isinf(known.std).all()
    np.testing.assert_array_equal(known.covariance, np.zeros((2, 2)))
    np.testing.assert_array_equal(known.solve(np.zeros(2)), np.zeros(2))
    assert LinearGaussian.of(np.zeros((3, 0)), np.zeros(0)).solve(np.zeros(0)).shape == (0,)


@pytest.mark.slow
def test_information_that_is_none_is_refused() -> None:
    with pytest.raises(NotFiniteError, match="not finite"):
        LinearGaussian.of(np.array([[1.0, np.nan]]), np.zeros(2))
    with pytest.raises(ShapeError, match=r"\(2, 3\), expected \(P, P\)"):
        LinearGaussian(np.zeros((2, 3)))


def test_what_lapacks_fast_driver_cannot_do_its_plain_one_does(monkeypatch: pytest.MonkeyPatch) -> None:
    known = LinearGaussian.of(np.random.default_rng(0).normal(size=(30, 6)), np.full(6, 0.1))
    expected = np.linalg.inv(known.information)

    def unsettled(matrix: np.ndarray) -> None:
        raise np.linalg.LinAlgError("Eigenvalues did not converge")

    monkeypatch.setattr(np.linalg, "eigh", unsettled)
    np.testing.assert_allclose(known.covariance, expected, rtol=1e-10)


@settings(max_examples=20)
@given(st.integers(0, 10_000), st.sampled_from([0.0, 4.0, 16.0]), st.booleans())
def test_what_moves_rows_of_its_own_is_eliminated_first_to_the_same_end(seed: int, decades: float, mixed: bool) -> None:
    """A twist for every pose beside a few parameters; where two of those are one, one direction is undetermined."""
    rng = np.random.default_rng(seed)
    poses, few = MANY + 20, 5
    unit = 10.0 ** rng.uniform(-decades / 2.0, decades / 2.0, few)
    shared = rng.normal(size=(3 * poses, few))
    shared[:, 1] = 2.0 * shared[:, 0] if mixed else shared[:, 1]
    own = np.zeros((3 * poses, poses))
    own[np.arange(3 * poses), np.repeat(np.arange(poses), 3)] = rng.normal(size=3 * poses)
    order = rng.permutation(few + poses)
    jacobian = np.hstack([shared * unit, own])[:, order]
    precision = np.concatenate([np.zeros(few), np.full(poses, 2.0)])[order]
    readings = rng.normal(size=3 * poses)
    np.testing.assert_allclose(squared(jacobian), jacobian.T @ jacobian, atol=1e-12 * unit.max() ** 2, rtol=1e-12)
    known = LinearGaussian.of(jacobian, precision)
    assert known.alone.sum() == poses and len(known.null_space) == mixed
    # Stacked least squares, of least norm in the same units.
    stacked = np.vstack([jacobian, np.diag(np.sqrt(precision))]) * known.scale
    values = known.scale * np.linalg.lstsq(stacked, np.concatenate([readings, 0.0 * precision]), rcond=1e-9)[0]
    np.testing.assert_allclose(jacobian @ known.solve(jacobian.T @ readings), jacobian @ values, atol=1e-9)
    hat = stacked @ np.linalg.pinv(stacked.T @ stacked, rcond=1e-9, hermitian=True) @ stacked.T
    for covariance in (known.covariance, known.root @ known.root.T):
        seen = jacobian @ covariance @ jacobian.T
        np.testing.assert_allclose(seen, hat[: len(seen), : len(seen)], atol=1e-9)
    assert np.isinf(known.std).sum() == 2 * mixed
    held = known.with_precision(known.scale**-2.0)
    units = np.outer(known.scale, known.scale)
    np.testing.assert_allclose((held.covariance / units) @ (held.information * units), np.eye(few + poses), atol=1e-9)


def test_of_no_parameters_nothing_is_said(capfd: pytest.CaptureFixture[str]) -> None:
    nothing = LinearGaussian(np.zeros((0, 0)))
    assert nothing.covariance.shape == (0, 0) and nothing.solve(np.zeros(0)).shape == (0,)
    assert capfd.readouterr() == ("", "")
