"""Many rows are worked on in pieces and threads: what comes out is what all of them together give."""

import importlib
from pathlib import Path

import numpy as np
import pytest

from armflex import Arm, load_arm
from armflex.estimate import robust
from armflex.estimate.blocks import declared_blocks
from armflex.estimate.calibrate import calibrate
from armflex.estimate.held_out import known_of_others
from armflex.estimate.placement import first_guess
from armflex.estimate.view import View, look
from armflex.linear_gaussian import LinearGaussian
from armflex.measured.measurements import Measurements, read_measurements
from armflex.mechanics import response
from armflex.parallel import in_threads

calibrating = importlib.import_module("armflex.estimate.calibrate")  # its function goes by the same name

BOOM = Path(__file__).parents[3] / "robots" / "tarm_like"


@pytest.fixture(scope="module")
def arm() -> Arm:
    return load_arm(BOOM / "measured.toml")


@pytest.fixture(scope="module")
def campaign(arm: Arm) -> Measurements:
    return read_measurements(BOOM / "campaign.csv", arm)


@pytest.fixture(scope="module")
def view(arm: Arm, campaign: Measurements) -> View:
    rows = np.flatnonzero(campaign.measured)
    return look(first_guess(arm, campaign, rows)[0], campaign, rows)


def test_threads_give_results_in_order_and_the_first_error() -> None:
    assert list(in_threads(lambda number: number**2, range(100))) == [number**2 for number in range(100)]

    def failing(number: int) -> int:
        if number == 50:
            raise ValueError("fifty")
        return number

    with pytest.raises(ValueError, match="fifty"):
        list(in_threads(failing, range(100)))


def test_some_rows_of_a_view_are_those_of_all(view: View) -> None:
    some = np.random.default_rng(0).permutation(len(view.rows))[:37]
    part = view.some(some)
    for name in ("tip", "joints", "twists", "wrenches", "link_loads", "gravity", "per_load"):
        assert np.array_equal(getattr(part.line, name), getattr(view.line, name)[some])
    assert np.array_equal(part.whitened, view.whitened[some])


def test_an_arm_solved_in_threads_is_as_solved_in_one(
    view: View, campaign: Measurements, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(response, "AT_ONCE", 16)
    again = look(view.setup, campaign, view.rows)
    assert np.array_equal(again.residual, view.residual)
    assert np.array_equal(again.line.laws, view.line.laws)


def test_columns_in_pieces_are_those_of_all_rows(
    view: View, campaign: Measurements, monkeypatch: pytest.MonkeyPatch
) -> None:
    blocks, weights = declared_blocks(view.setup, campaign), robust.huber_weights(view)
    whole = robust.whitened_regressors(blocks, view, weights)
    monkeypatch.setattr(robust, "ROWS_AT_ONCE", 16)
    assert np.allclose(robust.whitened_regressors(blocks, view, weights), whole, rtol=1e-12, atol=1e-9)


@pytest.mark.slow
def test_what_all_other_folds_tell_is_what_a_fit_without_a_fold_knows(arm: Arm, campaign: Measurements) -> None:
    fit = calibrate(arm, campaign).fit
    folds = np.arange(len(fit.view.rows)) % 3
    for number, told in enumerate(known_of_others(fit, folds)):
        others = np.repeat(folds != number, 3)
        expected = LinearGaussian.of(fit.regressors[others], fit.precision)
        assert np.allclose(told.information, expected.information, rtol=1e-9, atol=1e-6)


@pytest.mark.slow
def test_a_fit_that_some_rows_led_to_is_that_of_all(
    arm: Arm, campaign: Measurements, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It begins where it almost ends, and ends at the same values, within what the last step leaves."""
    alone = calibrate(arm, campaign)
    monkeypatch.setattr(calibrating, "ROWS_AT_ONCE", 200)
    monkeypatch.setattr(calibrating, "FEWEST_ROWS", 2)
    led = calibrate(arm, campaign)
    apart = (led.fit.values - alone.fit.values) / alone.fit.posterior.std
    assert np.abs(apart).max() < 0.1
    risen = [fit.history[0] / fit.history[-1] - 1.0 for fit in (led.fit, alone.fit)]
    assert risen[0] < 0.01 < risen[1]
