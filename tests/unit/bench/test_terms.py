"""Terms of a joint found one at a time: the published table, planted terms, nothing where there is nothing."""

import numpy as np
import pytest
from support.small_arms import ROBOTS

from armflex import InputError, read_joint_data, train
from armflex.bench.fit_linear import COUPLING, fit_terms
from armflex.bench.learners import FOUND, Options

TABLE = ROBOTS / "tarm_like" / "a4_table_1.csv"


def loads_of(seed: int, rows: int, size: int = 3) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(rows, size)) * np.repeat([2e3, 5e2], 3)[:size]


def test_the_published_rows_lack_coupling_first_and_then_something_even() -> None:
    result = train(read_joint_data(TABLE), "polynomial", options=Options(features=(FOUND,)))
    assert [term["name"] for term in result.parameters["terms"]] == [COUPLING, "radial_force", "magnitude_force"]
    np.testing.assert_array_less(result.held_out_rms, [0.105, 0.145, 0.20])
    diagonal = train(read_joint_data(TABLE), "linear", "diagonal").held_out_rms
    assert (result.held_out_rms < [0.1 * diagonal[0], 0.25 * diagonal[1], 0.27 * diagonal[2]]).all()
    assert result.held_out == "leave-one-out"


def test_chance_is_believed_about_once_in_twenty() -> None:
    believed = 0
    for seed in range(40):
        loads = loads_of(seed, 40)
        noise = 1e-6 * np.random.default_rng(100 + seed).normal(size=loads.shape)
        believed += bool(fit_terms(loads, loads * 1e-8 + noise, 0).parameters["terms"])
    assert believed <= 5


@pytest.mark.parametrize("feature", ["radial_force", "|fy|", "fx*fz", "fz*fz"])
def test_a_planted_term_is_found_by_name_and_size(feature: str) -> None:
    loads = loads_of(3, 60)
    x, y, z = loads.T
    shape = {"radial_force": np.hypot(x, y), "|fy|": np.abs(y), "fx*fz": x * z, "fz*fz": z * z}[feature]
    size = 4e-6 / shape.std()
    noise = 1e-6 * np.random.default_rng(5).normal(size=loads.shape)
    found = fit_terms(loads, loads * 1e-8 + np.outer(shape, [size, 0.0, -size]) + noise, 0)
    assert [term["name"] for term in found.parameters["terms"]] == [feature]
    law = found.law
    place = law.features.index(feature)
    np.testing.assert_allclose(law.coefficients[place, [0, 2]], [size, -size], rtol=0.15)
    assert law.coefficients[place, 1] == pytest.approx(0.0, abs=0.2 * size)


def test_six_components() -> None:
    loads = loads_of(1, 80, 6)
    deflections = loads * np.repeat([1e-8, 1e-7], 3)
    deflections[:, 4] += 3e-8 * np.hypot(loads[:, 3], loads[:, 4])
    deflections += np.repeat([1e-6, 2e-6], 3) * np.random.default_rng(2).normal(size=loads.shape)
    found = fit_terms(loads, deflections, 0)
    assert [term["name"] for term in found.parameters["terms"]] == ["radial_moment"]


@pytest.mark.slow
def test_too_few_rows() -> None:
    with pytest.raises(InputError, match="6 rows are too few"):
        fit_terms(loads_of(0, 6), loads_of(1, 6), 0)
