"""Rows that are exchanged or far off are found before the rest is asked to settle."""

from pathlib import Path

import pytest
from support.lost_campaign import FAR, SIGMA, write_arm, write_campaign

from armflex import calibrate, load_arm, read_measurements


@pytest.mark.parametrize("seed", [57, 5])
def test_a_calibration_settles_without_the_rows_that_are_wrong(tmp_path: Path, seed: int) -> None:
    """With them, of the first it found no step that was right for long, and of the second not that they are a pair."""
    arm = load_arm(write_arm(tmp_path))
    path, wrong = write_campaign(tmp_path, seed)
    found = calibrate(arm, read_measurements(path, arm))
    assert {one.row for one in found.outliers} == wrong and found.left_out == len(wrong)
    pair = [one for one in found.outliers if one.kind == "exchanged"]
    assert len(pair) == 2 and all(one.fellow for one in pair)
    alone = next(one for one in found.outliers if one not in pair)
    assert abs(alone.error_m - FAR) < 10.0 * SIGMA
    assert found.rms < 1.2 * found.noise_rms  # nothing of them is in what was fitted
