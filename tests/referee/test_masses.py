"""Frequencies tell masses from stiffnesses: on a machine that MuJoCo simulates."""

import numpy as np
import pytest
from support.sprung_campaign import declared, machine

from armflex import calibrate


@pytest.mark.slow
def test_ten_frequencies_halve_what_is_unknown_of_the_masses() -> None:
    """Standard deviations over all links, in the root mean square; see the study of twenty machines."""
    arm = declared()
    alone, both, truth = machine(arm, 102)
    stds = []
    for campaign in (alone, both):
        found = [one for one in calibrate(arm, campaign, anyway=True).parameters if one.name in truth]
        assert len(found) == 6
        assert all(abs(one.value - truth[one.name]) < 3.0 * one.std for one in found)
        stds.append(np.sqrt(np.mean([one.std**2 for one in found])))
    assert stds[1] < 0.5 * stds[0]
