"""The evidence of sets of hypotheses: closed forms by quadrature, probabilities that hold, and whole searches."""

from itertools import product

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm
from studies.reliability import log_score
from support.linear_problems import of_readings, problem

from armflex.laws.effects.candidate import Candidate
from armflex.laws.effects.gravity_tilt import GRAVITY_TILT
from armflex.laws.effects.location import Location
from armflex.trace.hypotheses import Hypothesis, of_family
from armflex.trace.probabilities import bagged
from armflex.trace.screen import Dense
from armflex.trace.selection import SCALES, Chosen, Group, climbed, prior_of, rivals, without

ROWS = 40
ONCE = np.ones((50, ROWS))  # every reading counts once in every resample


def drawn(seed: int, count: int = 2) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    columns = rng.normal(size=(ROWS, count))
    columns[:, 1:] += 0.7 * columns[:, :1]
    readings = columns @ rng.normal(0.0, 0.4, count) + rng.normal(size=ROWS)
    return columns, readings * np.sqrt(0.9 * ROWS / (readings @ readings))  # noise as stated explains them, too


def likelihood(columns: np.ndarray, readings: np.ndarray, *amplitudes: float) -> float:
    """Return the likelihood over that without any amplitude, at noise as stated."""
    left = readings - columns @ np.array(amplitudes)
    return float(np.exp(-0.5 * (left @ left - readings @ readings)))


@pytest.mark.parametrize("scale", [1, 2, 3])
def test_the_odds_of_one_hypothesis_are_its_evidence_by_quadrature(scale: int) -> None:
    columns, readings = drawn(3, 1)
    evidence = problem(columns, readings)
    whole, _ = quad(
        lambda b: likelihood(columns, readings, b) * norm.pdf(b, 0.0, SCALES[scale]), -8.0, 8.0, points=(0.0, 0.5)
    )
    odds = evidence.beside(()).odds[0, scale] - np.log(0.1) + np.log(len(SCALES))
    assert odds == pytest.approx(np.log(whole), abs=1e-6)


def test_a_sign_that_is_known_makes_the_prior_half_normal() -> None:
    columns, readings = drawn(5, 1)
    for sign in (1.0, -1.0):
        evidence = problem(sign * columns, readings, signed=0)
        whole, _ = quad(
            lambda b, sign=sign: 2.0 * likelihood(sign * columns, readings, b) * norm.pdf(b), 0.0, 8.0, points=(0.3,)
        )
        odds = evidence.beside(()).odds[0, 2] - np.log(0.1) + np.log(len(SCALES))
        assert odds == pytest.approx(np.log(whole), abs=1e-6)


def test_the_evidence_of_two_hypotheses_is_that_of_quadrature() -> None:
    columns, readings = drawn(11)
    evidence = problem(columns, readings)

    a, b = np.linspace(-6.0, 6.0, 2401)[:, None], np.linspace(-2.0, 2.0, 801)[None, :]
    g, pull = columns.T @ columns, columns.T @ readings
    squares = g[0, 0] * a**2 + 2.0 * g[0, 1] * a * b + g[1, 1] * b**2 - 2.0 * (pull[0] * a + pull[1] * b)
    density = np.exp(-0.5 * squares) * norm.pdf(a, 0.0, 1.0) * norm.pdf(b, 0.0, 0.3)
    whole = float(density.sum() * (a[1, 0] - a[0, 0]) * (b[0, 1] - b[0, 0]))
    model = (Chosen(0, 2), Chosen(1, 1))
    found = evidence.log_posterior(model) - evidence.log_posterior(())
    assert found - 2.0 * (np.log(0.1) - np.log(len(SCALES))) == pytest.approx(np.log(whole), abs=1e-4)
    # One after the other gives the same.
    first = evidence.beside(()).odds[0, 2]
    assert first + evidence.beside(model[:1]).odds[1, 1] == pytest.approx(found, abs=1e-9)


def test_a_climb_finds_what_is_there_among_many_and_nothing_in_noise() -> None:
    rng = np.random.default_rng(0)
    columns = rng.normal(size=(200, 300))
    columns[:, 100:] += 2.0 * columns[:, :200]  # every hypothesis has one that is much like it
    priors = np.full(300, np.log(2.0 / 300.0))
    noise = rng.normal(size=200)
    assert climbed(problem(columns, noise, priors)) == ()
    readings = noise + columns[:, [7, 150, 210]] @ np.array([1.0, -0.8, 0.6])
    model = climbed(problem(columns, readings, priors))
    assert {one.number for one in model} == {7, 150, 210}


@pytest.mark.parametrize("size", [1, 3])
def test_a_scan_without_one_hypothesis_by_that_of_the_whole_is_that_of_its_own(size: int) -> None:
    """Of hypotheses of one column and of several, of which one is all but like another in the model."""
    rng = np.random.default_rng(0)
    columns = rng.normal(size=(200, 60))
    columns[:, 30:] += 2.0 * columns[:, :30]
    columns[:, 33] = columns[:, 3] + 1e-4 * columns[:, 33]
    readings = 3.0 * rng.normal(size=200)
    evidence, other = problem(columns, readings, size=size), problem(columns, readings, size=size)
    model = tuple(Chosen(number // size, number % 4) for number in (3, 40, 33, 12))
    for i in range(len(model)):
        alone, part = other.beside(without(model, i)), evidence.beside(model).without(i)
        np.testing.assert_allclose(part.odds, alone.odds, rtol=1e-7, atol=1e-7)
        assert part.log_posterior == alone.log_posterior


def test_what_is_drawn_predicts_on_average_what_all_models_do() -> None:
    """Every set of three hypotheses at every scale, weighed by its posterior probability."""
    columns, readings = drawn(4, 3)
    evidence = problem(columns, readings)
    each = [[None, *(Chosen(number, scale) for scale in range(len(SCALES)))] for number in range(3)]
    models = [tuple(one for one in some if one is not None) for some in product(*each)]
    weights = np.exp([evidence.log_posterior(model) - evidence.log_posterior(()) for model in models])
    predicted = [columns[:, [one.number for one in model]] @ evidence.beside(model).values for model in models]
    whole = weights @ np.array(predicted) / weights.sum()

    found = bagged(evidence, climbed(evidence), np.ones((3000, ROWS))).drawn
    average = np.mean([columns[:, [c.number for c in one.model]] @ np.ravel(one.amplitudes) for one in found], axis=0)
    scatter = np.linalg.norm(np.array(predicted) - whole, axis=1)
    assert np.linalg.norm(average - whole) < 0.1 * np.sqrt(weights @ scatter**2 / weights.sum())


GOLDEN_LOG_SCORE = -0.361
"""Mean logarithm of the probability that was given to what is true, in the problems below; a change may raise it."""


@pytest.mark.slow
def test_stated_probabilities_are_right_as_often_as_they_say() -> None:
    """Over problems that are drawn from the prior itself, of hypotheses that imitate one another."""
    rng, stated, right = np.random.default_rng(1), [], []
    for _ in range(250):
        columns = rng.normal(size=(ROWS, 8))
        columns[:, 4:] = columns[:, :4] + 0.25 * rng.normal(size=(ROWS, 4))
        present = rng.random(8) < 0.15
        amplitudes = rng.normal(0.0, rng.choice(SCALES[:4], 8))
        readings = columns @ np.where(present, amplitudes, 0.0) + rng.normal(size=ROWS)
        evidence = problem(columns, 0.97 * readings, np.full(8, np.log(0.15 / 0.85)))
        model = climbed(evidence)
        for one, credible in zip(model, bagged(evidence, model, ONCE).credible, strict=False):
            stated.append(credible.probability)
            right.append(bool(present[one.number]))
    stated_, right_ = np.array(stated), np.array(right)
    sure = stated_ > 0.9
    assert sure.sum() > 40 and right_[sure].mean() > 0.9
    assert right_[~sure].mean() == pytest.approx(stated_[~sure].mean(), abs=0.12)
    assert log_score(np.column_stack([stated_, right_])) > GOLDEN_LOG_SCORE - 0.005


@pytest.mark.parametrize(("true", "stays"), [("the name", True), ("the family", False)])
def test_a_name_must_beat_the_family_that_does_what_it_does(true: str, stays: bool) -> None:
    rng = np.random.default_rng(4)
    columns = rng.normal(size=(ROWS, 4))
    name = columns.sum(axis=1, keepdims=True) / 2.0 + 0.5 * rng.normal(size=(ROWS, 1))
    readings = 0.9 * (2.0 * name[:, 0] if stays else columns.sum(axis=1)) + 0.3 * rng.normal(size=ROWS)
    evidence, own = problem(name, readings), (Chosen(0, 2),)
    family = of_family("family", 10)
    whole = evidence.extended([family], [columns], evidence.projection)
    (alone, _), (beside, _) = (bagged(evidence, own, ONCE, families=some).credible for some in (None, (whole, own)))
    assert alone.probability > 0.9
    assert (beside.probability > 0.9) == stays and (beside.nothing > 0.9) != stays


def test_a_law_about_one_axis_and_about_all_at_a_place_is_one_name() -> None:
    def tilt(axis: str | None, *terms: int) -> Hypothesis:
        return Hypothesis(Candidate(GRAVITY_TILT, Location("base", axis, (), terms), ()), 0.0)

    about_x, about_y, about_both = tilt("rx", 0), tilt("ry", 1), tilt(None, 0, 1)
    assert about_x.alike(about_both) and about_both.alike(about_y) and not about_x.alike(about_y)
    rng = np.random.default_rng(0)
    columns = rng.normal(size=(ROWS, 1))
    twins = np.hstack([columns, columns + 1e-9 * rng.normal(size=(ROWS, 1))])
    readings = 3.0 * columns[:, 0] + rng.normal(size=ROWS)
    groups = [Group(one, i, np.ones(1)) for i, one in enumerate((about_x, about_both))]
    evidence = Dense(groups, twins, of_readings(readings), prior_of(groups))
    found = bagged(evidence, climbed(evidence), ONCE).credible
    assert found[0].probability > 0.99 and not found[0].others


def test_rivals_are_ranked_one_of_each_place() -> None:
    columns, readings = drawn(3)
    readings = 3.0 * columns[:, 0] + readings
    evidence = problem(columns, readings)
    found = rivals(evidence.beside(()))
    assert found[0].chosen.number == 0 and len({one.chosen.number for one in found}) == len(found)


def independent() -> np.ndarray:
    return 30.0 * np.linalg.qr(np.random.default_rng(0).normal(size=(ROWS, 4)))[0]


def test_a_climb_goes_on_to_its_end_where_the_linear_problem_is_exact() -> None:
    """Beside a hypothesis that explains thousands of nats, what is worth tens of them is found, too."""
    columns = independent()
    readings = 4.0 * columns[:, 0] + 0.3 * columns[:, 1] + np.random.default_rng(1).normal(size=ROWS)
    evidence = problem(columns, readings)
    gained = evidence.log_posterior((Chosen(0, 3), Chosen(1, 1))) - evidence.log_posterior((Chosen(0, 3),))
    whole = evidence.log_posterior((Chosen(0, 3),)) - evidence.log_posterior(())
    assert {one.number for one in climbed(evidence)} == {0, 1} and gained > 10.0
    evidence.error = 2.0 * gained / whole
    assert {one.number for one in climbed(evidence)} == {0}
