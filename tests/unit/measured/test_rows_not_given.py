"""What the rows of a table do not say is an error where an effect needs it, never a guess without a word."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.effect_arms import arm_with
from support.measurement_rows import campaign, written

from armflex import Arm, Measurements, calibrate, predict, read_measurements
from armflex.errors import InputError, MissingCovariateError
from armflex.laws.effects.in_arm import derived_directions

BACKLASH = 'name = "backlash"\nsite = "J2"\naxis = "ry"\nparameters = { gap = 3.6e-4 }'
TIMED = {
    "base_drift": 'site = "base"\naxis = "rz"\nparameters = { v_rz = 1e-9 }',
    "slip_step": 'site = "J2"\naxis = "ry"\nparameters = { size = 1e-4, at = 20.0 }',
    "tool_shift": 'site = "tool"\nparameters = { dx = 1e-4, since = 30.0 }',
}


def rows_of(folder: Path, arm: Arm, without: str = "", count: int = 8, **more: object) -> Measurements:
    """Return rows without one column; the position is asked for, or read."""
    rows = [{key: value for key, value in (row | more).items() if key != without} for row in campaign(count)]
    return read_measurements(written(folder, rows), arm)


def test_a_direction_that_nothing_before_tells_is_an_error(tmp_path: Path) -> None:
    arm = arm_with(tmp_path, BACKLASH)
    asked = r"rows.csv:2: effect 'backlash J2 ry' needs the covariate 'approach_J2', which is not given"
    for ask in (predict, calibrate):
        with pytest.raises(MissingCovariateError, match=asked):
            ask(arm, rows_of(tmp_path, arm))
    with pytest.raises(MissingCovariateError, match=r"given \(given: .*no row before moves that joint. Give"):
        predict(arm, rows_of(tmp_path, arm, where="approaching"))  # a level of a text column is no direction


def test_a_campaign_whose_readings_are_to_be_filled_in_is_named(heavy: Arm, tmp_path: Path) -> None:
    blank = dict.fromkeys("xyz", "")
    with pytest.raises(
        InputError, match=r"rows.csv: 0 measured rows, expected .* in any\. Are its readings to be filled in yet"
    ):
        calibrate(heavy, rows_of(tmp_path, heavy, **blank))


def test_only_rows_that_were_read_need_a_direction(tmp_path: Path) -> None:
    """A row that was only driven through tells the next one where it came from."""
    arm = arm_with(tmp_path, BACKLASH)
    driven = [row | ({"x": "", "y": "", "z": ""} if i == 0 else {}) for i, row in enumerate(campaign(8))]
    rows = read_measurements(written(tmp_path, driven), arm)
    read = np.flatnonzero(rows.measured)
    (flag,) = derived_directions(arm, rows, read)
    assert flag.code == "approach_derived" and "approach_J2" in flag.text
    with pytest.raises(MissingCovariateError, match=r"rows.csv:2: "):
        derived_directions(arm, rows, np.arange(8))


def test_what_is_given_is_not_called_derived(tmp_path: Path) -> None:
    arm = arm_with(tmp_path, BACKLASH)
    found = [predict(arm, rows_of(tmp_path, arm, approach_J2=side)) for side in (1, -1, 0)]
    assert not [flag for one in found for flag in one.flags if flag.code == "approach_derived"]
    up, down, middle = (one.position for one in found)
    np.testing.assert_allclose(0.5 * (up + down), middle, atol=1e-6)
    assert np.abs(up - down).max() > 1e-4


@pytest.mark.parametrize("name", TIMED)
def test_an_effect_of_time_in_rows_without_one_is_an_error(tmp_path: Path, name: str) -> None:
    arm = arm_with(tmp_path, f'name = "{name}"\n{TIMED[name]}')
    with pytest.raises(MissingCovariateError, match=rf"rows.csv:\d.*effect '{name}.*'time', which is not given"):
        predict(arm, rows_of(tmp_path, arm, "time", temperature=25.0))
    assert np.isfinite(predict(arm, rows_of(tmp_path, arm, temperature=25.0)).position).all()


def test_what_lags_or_creeps_begins_anew_in_rows_without_time(tmp_path: Path) -> None:
    lagging = 'name = "base_thermal"\nsite = "base"\naxis = "rx"\nparameters = { beta_rx = 1e-6, lag = 60.0 }'
    arm = arm_with(tmp_path, lagging, 'name = "creep"\nsite = "J2"\naxis = "ry"\nparameters = { c = 1e-9, t0 = 10.0 }')
    warm = 20.0 + np.arange(8.0)
    rows = rows_of(tmp_path, arm, "time", count=8)
    rows = replace(rows, covariates={**rows.covariates, "temperature": warm})
    found = predict(arm, rows)
    (flag,) = [one for one in found.flags if one.code == "begins_anew"]
    assert "base thermal at base (rx) without a column 'time': it has settled" in flag.text
    assert "creep at J2 (ry) without a column 'hold': its load has just been put on" in flag.text
    settled = [  # each row by itself
        arm.deflection(q, name, covariates={"temperature_lagged_60s": value, "hold": 0.0}).displacement
        for q, name, value in zip(rows.q, rows.payload, warm, strict=True)
    ]
    np.testing.assert_allclose(found.displacement, settled, atol=1e-12)
    timed = rows_of(tmp_path, arm, temperature=25.0, hold=0.0)
    assert not [one for one in predict(arm, timed).flags if one.code == "begins_anew"]


@pytest.mark.slow
def test_a_tool_that_was_always_elsewhere_needs_no_time(tmp_path: Path) -> None:
    arm = arm_with(tmp_path, 'name = "tool_shift"\nsite = "tool"\nparameters = { dx = 1e-4 }')
    assert np.isfinite(predict(arm, rows_of(tmp_path, arm, "time")).position).all()
