"""Polynomial laws: closed forms, derivatives, files, and loads that do not determine them."""

import itertools
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from support.bench import made
from support.small_arms import ROBOTS

from armflex import read_joint_data
from armflex.bench.cross_validation import hold_out
from armflex.bench.fit_linear import fit_compliance, fit_polynomial
from armflex.bench.fitted import NOWHERE, predicted
from armflex.bench.learners import Options, learner
from armflex.errors import IdentifiabilityError, LawError, UnknownNameError
from armflex.laws.joint.carried import AtNode
from armflex.laws.joint.polynomial import FEATURES, PolynomialLaw, feature_values, features_of, from_tensors, to_tensors

TABLE = ROBOTS / "tarm_like" / "a4_table_1.csv"
PLAIN = ("linear+radial", "linear+radial+magnitude", "quadratic")
EVERYTHING = "radial+magnitude+absolute+quadratic+odd"
LOADS = arrays(np.float64, 6, elements=st.floats(-1e4, 1e4).map(lambda x: x if abs(x) > 1e-3 else 0.0))


def bench(size: int, rows: int, noise: float = 0.0, seed: int = 1) -> tuple[np.ndarray, np.ndarray, PolynomialLaw]:
    """Return (N, k) loads and deflections of a made law; `noise` is absolute."""
    rng = np.random.default_rng(seed)
    law = made(size, "radial+magnitude+squares", seed)
    loads = rng.normal(size=(rows, size))
    return loads, predicted(law, loads) + noise * rng.normal(size=(rows, size)), law


@pytest.mark.parametrize(
    ("features", "in_sample", "held_out"),
    [
        ("linear", [0.142, 0.099, 0.341], [0.172, 0.121, 0.415]),
        ("linear+radial", [0.073, 0.095, 0.172], [0.098, 0.133, 0.232]),
        ("linear+radial+magnitude", [0.064, 0.094, 0.099], [0.086, 0.145, 0.153]),
        (("radial", "magnitude"), [0.064, 0.094, 0.099], [0.086, 0.145, 0.153]),
    ],
)
def test_published_table(features: str, in_sample: list, held_out: list) -> None:
    data = read_joint_data(TABLE)
    residual = data.deflections - predicted(fit_polynomial(data.loads, data.deflections, features), data.loads)
    np.testing.assert_array_equal(np.round(1e3 * np.sqrt((residual**2).mean(axis=0)), 3), in_sample)
    found = hold_out(learner("polynomial", Options(features=features)), data, np.arange(20))
    np.testing.assert_array_equal(np.round(1e3 * found.rms, 3), held_out)


def test_features_by_hand() -> None:
    wrench = np.array([3.0, -4.0, 12.0, -1.0, 2.0, -2.0])
    found = dict(zip(FEATURES, feature_values(wrench), strict=True))
    assert found["fy"] == -4.0 and found["|fy|"] == 4.0 and found["fx*fy"] == -12.0 and found["mz*mz"] == 4.0
    assert found["radial_force"] == 5.0 and found["magnitude_force"] == 13.0
    assert found["fy|fy|"] == -16.0 and found["mx^3"] == -1.0
    assert found["radial_moment"] == np.sqrt(5.0) and found["magnitude_moment"] == 3.0
    assert len(FEATURES) == len(set(FEATURES)) == 49


def test_names_of_features() -> None:
    assert features_of("linear", 3) == ("fx", "fy", "fz") == features_of((), 3)
    assert features_of("linear+radial", 3) == ("fx", "fy", "fz", "radial_force")
    assert features_of(("magnitude", "|fx|", "magnitude"), 6)[6:] == ("magnitude_force", "magnitude_moment", "|fx|")
    assert features_of("squares", 3)[3:] == ("fx*fx", "fy*fy", "fz*fz")
    assert len(features_of("quadratic", 3)) == 9 and len(features_of("quadratic", 6)) == 27
    assert features_of(EVERYTHING, 6)[:6] == FEATURES[:6] and set(features_of(EVERYTHING, 6)) == set(FEATURES)
    with pytest.raises(UnknownNameError, match="no feature of a load named 'radia', did you mean 'radial'"):
        features_of("linear+radia", 3)
    with pytest.raises(UnknownNameError, match="no feature of a load named 'radial_moment'"):
        features_of(["radial_moment"], 3)


@pytest.mark.parametrize("size", [3, 6])
def test_linear_features_are_a_compliance(size: int) -> None:
    rng = np.random.default_rng(2)
    loads, noise = rng.normal(size=(25, size)) * 1e3, rng.normal(size=(25, size)) * 1e-5
    deflections = loads @ rng.normal(size=(size, size)) * 1e-6 + noise
    law, closed = fit_polynomial(loads, deflections, "linear"), fit_compliance(loads, deflections)
    np.testing.assert_allclose(law.coefficients.T, closed.compliance, rtol=1e-9)
    np.testing.assert_allclose(law.row_covariance, closed.row_covariance, rtol=1e-7)
    wrench, linear = rng.normal(size=6), closed.law(loads)
    np.testing.assert_allclose(law.twist(wrench, NOWHERE), linear.twist(wrench, NOWHERE), rtol=1e-9)
    np.testing.assert_allclose(law.tangent(wrench, NOWHERE), linear.tangent(wrench, NOWHERE), rtol=1e-9)
    np.testing.assert_allclose(law.covariance(wrench, NOWHERE), linear.covariance(wrench, NOWHERE), rtol=1e-7)
    assert [flag.text for flag in law.flags(9.0 * loads[0], NOWHERE)] == [
        flag.text for flag in linear.flags(9.0 * loads[0], NOWHERE)
    ]


@pytest.mark.parametrize("size", [3, 6])
def test_known_law_is_recovered(size: int) -> None:
    loads, deflections, truth = bench(size, 60)
    law = fit_polynomial(loads, deflections, "radial+magnitude+squares")
    np.testing.assert_allclose(law.coefficients, truth.coefficients, atol=1e-10)
    np.testing.assert_array_equal(law.loads, [loads.min(axis=0), loads.max(axis=0)])
    assert law.trained and not law.twist(np.zeros(6), NOWHERE).any()
    assert not law.twist(np.ones(6), NOWHERE)[size:].any() and not law.covariance(np.ones(6), NOWHERE)[size:].any()


def test_prediction_variance_covers_new_readings() -> None:
    inside, coefficients = [], []
    for seed in range(60):
        loads, deflections, truth = bench(3, 40, 0.3, seed)
        law = fit_polynomial(loads[:24], deflections[:24], "radial+magnitude+squares")
        score = (law.coefficients - truth.coefficients) / np.sqrt(law.row_covariance.diagonal(axis1=1, axis2=2)).T
        coefficients.append(score)
        wrenches = np.pad(loads[24:], [(0, 0), (0, 3)])
        std = np.sqrt(law.covariance(wrenches, NOWHERE).diagonal(axis1=1, axis2=2)[:, :3])
        inside.append(np.abs(deflections[24:] - predicted(law, loads[24:])) < 1.96 * std)
    # Student's t of 16 degrees of freedom lies within 1.96 in 93.2 of 100 cases and has a variance of 16 / 14.
    assert 0.92 < np.mean(inside) < 0.945
    assert 0.95 < np.sqrt(np.mean(np.square(coefficients)) * 14 / 16) < 1.05


@settings(max_examples=60)
@given(
    LOADS,
    st.sampled_from([3, 6]),
    st.sampled_from(["linear+radial", "linear+radial+magnitude", "quadratic", "absolute", EVERYTHING]),
)
def test_tangent_is_the_derivative(wrench: np.ndarray, size: int, features: str) -> None:
    """Against central differences in the directions in which the law is smooth."""
    law = made(size, features)
    tangent = law.tangent(wrench, NOWHERE)
    assert np.isfinite(tangent).all() and not tangent[size:].any() and not tangent[:, size:].any()
    for i in np.flatnonzero(wrench):
        step = 1e-4 * abs(wrench[i]) * np.eye(6)[i]
        slope = (law.twist(wrench + step, NOWHERE) - law.twist(wrench - step, NOWHERE)) / (2.0 * step[i])
        scale = 1.0 + np.abs(law.twist(wrench, NOWHERE)).max() / abs(wrench[i])
        np.testing.assert_allclose(tangent[:, i], slope, rtol=1e-6, atol=1e-6 * scale)


@settings(max_examples=40)
@given(LOADS, st.floats(0.01, 100.0))
def test_even_and_odd_parts(wrench: np.ndarray, factor: float) -> None:
    """Roots are homogeneous of degree one and even; products of degree two and even; components and powers odd."""
    law, parts, degrees = made(6, EVERYTHING), {}, {"odd": 1, "roots": 1, "products": 2, "odd squares": 2, "cubes": 3}
    ends = (0, 6, 16, 37, 43, 49)
    for kind, (start, end) in zip(degrees, pairwise(ends), strict=True):
        names = FEATURES[start:end]
        keep = np.array([name in names for name in law.features])
        part = replace(law, coefficients=law.coefficients * keep[:, None])
        parts[kind] = [part.twist(w, NOWHERE) for w in (wrench, -wrench, factor * wrench)]
    for kind, (plus, minus, more) in parts.items():
        np.testing.assert_allclose(minus, plus if kind in ("roots", "products") else -plus, rtol=1e-12)
        np.testing.assert_allclose(more, factor ** degrees[kind] * plus, rtol=1e-9, atol=1e-9)
    whole = law.twist(wrench, NOWHERE)
    np.testing.assert_allclose(sum(each[0] for each in parts.values()), whole, rtol=1e-9, atol=1e-6)


@pytest.mark.parametrize("size", [3, 6])
def test_no_load(size: int) -> None:
    """No deflection, only the scatter, and a tangent of the linear part alone."""
    law, nothing = made(size, EVERYTHING), np.zeros(6)
    assert not law.twist(nothing, NOWHERE).any()
    np.testing.assert_array_equal(law.tangent(nothing, NOWHERE)[:size, :size], law.coefficients[:size].T)
    np.testing.assert_array_equal(np.diag(law.covariance(nothing, NOWHERE))[:size], law.residual_std**2)


@pytest.mark.parametrize("size", [3, 6])
def test_many_loads_at_once(size: int) -> None:
    law = made(size, EVERYTHING)
    many = np.random.default_rng(4).normal(size=(4, 5, 6))
    many[1, 2] = 0.0
    for name in ("twist", "tangent", "covariance"):
        answer = getattr(law, name)
        together = answer(many, NOWHERE)
        for place in itertools.product(range(4), range(5)):
            np.testing.assert_allclose(together[place], answer(many[place], NOWHERE), rtol=1e-10, atol=1e-13)


def test_at_a_node() -> None:
    """The adjoint carries a polynomial law like any other."""
    law = AtNode(made(6, EVERYTHING), np.array([0.1, -0.2, 0.3]))
    wrench = np.array([3.0, -4.0, 12.0, -1.0, 2.0, -2.0])
    step = 1e-6
    slope = [
        (law.twist(wrench + step * axis, NOWHERE) - law.twist(wrench - step * axis, NOWHERE)) / (2.0 * step)
        for axis in np.eye(6)
    ]
    np.testing.assert_allclose(law.tangent(wrench, NOWHERE), np.transpose(slope), rtol=1e-6, atol=1e-6)


def test_loads_beyond_those_trained_on() -> None:
    loads, deflections, _ = bench(3, 40, 0.1)
    law = fit_polynomial(loads, deflections, "linear+radial")
    inside, outside = (np.concatenate([factor * loads.max(axis=0), np.zeros(3)]) for factor in (0.9, 3.0))
    assert law.flags(inside, NOWHERE) == ()
    flags = law.flags(outside, NOWHERE)
    assert [flag.code for flag in flags] == ["extrapolating"] * 3 and "it was trained on" in flags[0].text
    variance = [np.diag(law.covariance(wrench, NOWHERE))[:3] for wrench in (inside, outside)]
    assert (variance[1] > variance[0]).all()


@pytest.mark.parametrize("size", [3, 6])
def test_arrays_hold_the_law(size: int) -> None:
    law = made(size, EVERYTHING)
    tensors = to_tensors(law)
    assert all(array.dtype == np.float64 and array.flags.c_contiguous for array in tensors.values())
    read = from_tensors(tensors)
    assert read.features == law.features
    wrench = np.random.default_rng(5).normal(size=6)
    for name in ("twist", "tangent", "covariance"):
        np.testing.assert_array_equal(getattr(read, name)(wrench, NOWHERE), getattr(law, name)(wrench, NOWHERE))


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"features": np.array([0.0, 1.0, 2.5, 12.0])}, "expected whole numbers from 0 to 48"),
        ({"features": np.array([0.0, 1.0, 2.0, 49.0])}, r"'features'\[3\] is 49, expected 0 to 48"),
        ({"features": np.array([0.0, 1.0, 2.0, -1.0])}, r"'features'\[3\] is -1, expected 0 to 48"),
        ({"features": np.array([0.0, 1.0, 2.0, np.nan])}, r"'features'\[3\] is nan, expected 0 to 48"),
        ({"features": np.array([[0.0, 1.0, 2.0, 12.0]])}, r"'features' is f8 \(1, 4\), expected f8 \(features\)"),
        ({"features": np.zeros(0)}, r"'features' has shape \(0,\)"),
        ({"features": np.array([0.0, 1.0, 2.0, 2.0])}, "a feature is there twice"),
        ({"features": np.array([0.0, 1.0, 2.0, 3.0])}, "'mx' is no feature of a load of 3 components"),
        ({"features": np.array([0.0, 1.0, 2.0])}, r"'coefficients' has shape \(4, 3\), expected \(3, k\)"),
        ({"coefficients": np.zeros((3, 4))}, r"'coefficients' has shape \(3, 4\), expected \(4, k\)"),
        ({"row_covariance": np.zeros((4, 4))}, r"'row_covariance' is f8 \(4, 4\), expected f8 \(3, 4, 4\)"),
        ({"row_covariance": np.stack([np.eye(4) - 2.0 * np.eye(4, k=1)] * 3)}, "'row_covariance' is no covariance"),
        ({"row_covariance": np.stack([1.0 - 2.0 * np.eye(4)] * 3)}, "'row_covariance' is no covariance"),
        ({"residual_std": np.zeros(4)}, r"'residual_std' has shape \(4,\), expected \(3\)"),
        ({"residual_std": -np.ones(3)}, r"'residual_std'\[0\] is -1, expected 0 or more"),
        ({"loads": np.zeros((3, 2))}, "'loads' has shape"),
        ({"loads": np.array([np.ones(3), np.zeros(3)])}, "the smallest loads are not below the largest"),
        ({"loads": None}, "'loads' is missing"),
        ({"more": np.zeros(3)}, "'more' is not expected"),
    ],
)
def test_arrays_that_are_no_law(change: dict, complaint: str) -> None:
    tensors = to_tensors(made(3, "linear+radial")) | change
    with pytest.raises(LawError, match=complaint):
        from_tensors({name: array for name, array in tensors.items() if array is not None})


def test_loads_that_do_not_determine_the_features() -> None:
    loads, deflections, _ = bench(3, 12)
    with pytest.raises(IdentifiabilityError, match="9 rows of loads do not determine 9 features"):
        fit_polynomial(loads[:9], deflections[:9], "quadratic")
    one_sided = np.abs(loads)
    with pytest.raises(IdentifiabilityError, match="do not distinguish the features of a polynomial") as caught:
        fit_polynomial(one_sided, deflections, ["|fx|", "radial"])
    assert caught.value.names == ("fx", "|fx|") and caught.value.rank == 4
    with pytest.raises(IdentifiabilityError) as caught:
        fit_polynomial(loads * [1.0, 0.0, 1.0], deflections, "linear")
    assert caught.value.names == ("fy",)


def test_units_do_not_matter_to_what_is_determined() -> None:
    loads, deflections, _ = bench(6, 60, 0.1)
    factor = np.array([1e6, 1e6, 1e6, 1e-3, 1e-3, 1e-3])
    plain, scaled = (fit_polynomial(loads * by, deflections, "quadratic") for by in (1.0, factor))
    np.testing.assert_allclose(predicted(scaled, loads * factor), predicted(plain, loads), atol=1e-9)


def test_what_a_learner_says() -> None:
    loads, deflections, _ = bench(3, 20, 0.1)
    fitted = learner("polynomial", Options(features="linear+radial"))(loads, deflections, 0)
    assert fitted.parameters["features"] == ["fx", "fy", "fz", "radial_force"]
    assert fitted.parameters["coefficients"]["fy"] == fitted.law.coefficients[1].tolist()
    assert fitted.diagnostics.rhat_max is None
