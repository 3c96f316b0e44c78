"""A quarter of a campaign in which a joint has backlash, calibrated: where a trace begins."""

import numpy as np
import pytest

from armflex import calibrate, load_arm, read_measurements
from armflex.trace.state import State, begin
from support.campaigns import draw
from support.stage import few


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    """A quarter of a campaign in which J4 has backlash, calibrated."""
    truth = draw("backlash", 101, "six").write(tmp_path_factory.mktemp("campaign"))
    arm = load_arm(truth.arm)
    rows = read_measurements(truth.train, arm)
    some = np.flatnonzero(rows.measured)[::2]
    return truth, arm, few(rows, some)


@pytest.fixture(scope="module")
def before(campaign) -> State:
    return begin(calibrate(campaign[1], campaign[2], as_stated=True))
