"""Resamples of a campaign: by the parts that differ most, and the certainty that is left."""

import numpy as np
import pytest
from support.linear_problems import of_readings, problem

from armflex.estimate.held_out import pose_folds
from armflex.trace.probabilities import Credible, bagged
from armflex.trace.resampling import POSES, RESAMPLES, Resampled, resampled
from armflex.trace.screen import Dense
from armflex.trace.selection import Model, climbed, prior_of
from armflex.trace.validate import Folds

POSE_COUNT, BLOCKS = 320, 16
EVERY = {POSES: np.arange(POSE_COUNT), "parts of time": np.arange(POSE_COUNT) * BLOCKS // POSE_COUNT}


def campaign(seed: int, shared: float, count: int = 12) -> tuple[Dense, np.ndarray]:
    """Return hypotheses that are alike in a block of rows, and readings of one of them with a share of noise by block.

    Their variance is 1 whatever the share.
    """
    rng = np.random.default_rng(seed)
    block = EVERY["parts of time"]
    columns = rng.normal(size=(BLOCKS, count))[block] + 0.3 * rng.normal(size=(POSE_COUNT, count))
    noise = np.sqrt(1.0 - shared) * rng.normal(size=POSE_COUNT) + np.sqrt(shared) * rng.normal(size=BLOCKS)[block]
    return problem(columns, noise, np.full(count, np.log(0.1))), columns


def drawn_of(evidence: Dense, model: Model) -> Resampled:
    return resampled(evidence, model, EVERY, Folds(evidence, pose_folds(EVERY[POSES])))


def test_readings_that_scatter_independently_are_drawn_by_poses() -> None:
    """In 95 % of campaigns or more."""
    drawn = [drawn_of(evidence, climbed(evidence)) for evidence, _ in map(campaign, range(40), [0.0] * 40)]
    assert np.mean([each.by == POSES and each.mismatch == 1.0 for each in drawn]) >= 0.9
    assert all(np.allclose(each.times.sum(axis=1), POSE_COUNT) for each in drawn)
    twice = [each.times for each in drawn if each.mismatch == 1.0]  # as many, each of which counts half
    assert np.var(twice) == pytest.approx(0.5 * 0.9, rel=0.05)
    assert all(np.allclose(times.reshape(5, 10, -1).mean(axis=1), 1.0) for times in twice)


def test_an_error_that_neighbours_share_is_seen_by_the_parts_that_share_it() -> None:
    found = [drawn_of(evidence, climbed(evidence)) for evidence, _ in map(campaign, range(10), [0.3] * 10)]
    seen = [one for one in found if one.by == "parts of time" and one.mismatch > 1.5]
    assert len(seen) >= 9
    for one in seen:
        assert one.times.shape == (RESAMPLES, POSE_COUNT)
        blocks = one.times.reshape(RESAMPLES, BLOCKS, -1)
        np.testing.assert_array_equal(blocks, blocks[:, :, :1] * np.ones(blocks.shape))  # of a part all or none
        np.testing.assert_allclose(one.times.mean(axis=1), 1.0, atol=1e-9)
        assert blocks[:, :, 0].var() == pytest.approx(1.0 - 1.0 / BLOCKS, rel=0.3)  # of so many draws


def names_of_nothing(shared: float, bag: bool) -> int:
    """Return how many names are stated over campaigns in which nothing is missing."""
    count = 0
    for seed in range(6):
        evidence, _ = campaign(seed, shared)
        model = climbed(evidence)
        times = drawn_of(evidence, model).times if bag else np.ones((RESAMPLES, POSE_COUNT))
        count += sum(one.probability > 0.9 for one in bagged(evidence, model, times).credible[:-1])
    return count


@pytest.mark.slow
def test_what_imitates_a_shared_error_is_stated_with_less_certainty() -> None:
    alone, averaged = (names_of_nothing(0.3, bag) for bag in (False, True))
    assert alone > 6 and averaged < 0.2 * alone


@pytest.mark.slow
def test_what_is_there_keeps_its_name_beside_a_shared_error() -> None:
    kept = []
    for seed in range(5):
        evidence, columns = campaign(seed, 0.3)
        readings = evidence.projection.data + 3.0 * columns[:, 4]
        evidence = Dense(evidence.groups, columns, of_readings(readings), prior_of(evidence.groups))
        model = climbed(evidence)
        found = bagged(evidence, model, drawn_of(evidence, model).times).credible
        kept.append(next((seen.probability for one, seen in zip(model, found, strict=False) if one.number == 4), 0.0))
    assert min(kept) > 0.95


def test_a_reading_that_counts_twice_is_one_read_twice() -> None:
    evidence, columns = campaign(0, 0.0)
    rows = np.repeat(np.arange(POSE_COUNT), 2)
    twice = problem(columns[rows], evidence.projection.data[rows], np.full(12, np.log(0.1)))
    counted = evidence.of_rows(np.full(POSE_COUNT, 2.0))
    np.testing.assert_allclose(counted.beside(()).odds, twice.beside(()).odds, rtol=1e-12)
    half = evidence.of_rows((np.arange(POSE_COUNT) % 2).astype(float))
    other = problem(columns[1::2], evidence.projection.data[1::2], np.full(12, np.log(0.1)))
    np.testing.assert_allclose(half.beside(()).odds, other.beside(()).odds, rtol=1e-12)


def test_a_credible_set_ends_where_nothing_else_is_credible() -> None:
    evidence, _ = campaign(0, 0.0)
    others = tuple((group.hypothesis, chance) for group, chance in zip(evidence.groups, (0.2, 0.1, 0.03), strict=False))
    seen = Credible(0.66, 0.0, others, ())
    assert [chance for _, chance in seen.others] == [0.2, 0.1] and not seen.is_doubtful and not seen.is_gone
    assert Credible(0.1, 0.0, others, ()).is_doubtful and not Credible(0.1, 0.3, others, ()).is_doubtful
    assert Credible(0.3, 0.51, (), ()).is_gone and Credible(0.04, 0.1, others, ()).is_gone
