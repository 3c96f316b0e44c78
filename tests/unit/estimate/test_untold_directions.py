"""By how much readings are off where nothing tells from which side a joint came."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from support.effect_arms import plain

from armflex.arm import Setup
from armflex.estimate.view import unclear_shifts
from armflex.laws.effects import CATALOGUE, Effect, Location
from armflex.readings import Orientation, Position, unread
from armflex.readings.instrument import Instrument
from armflex.rows import Rows

GAP = 2e-3
Q = np.array([[0.3, -0.4, 0.5, 0.2, 0.6, -0.1]])


@pytest.mark.slow
@pytest.mark.parametrize("turned", [0.0, 3.0, np.pi])
def test_an_orientation_is_off_by_the_turn_between_both_sides_whichever_way_it_stands(turned: float) -> None:
    """Two rotation vectors of nearly half a turn may be far apart, or differ by more than the turn between them."""
    effect = Effect(CATALOGUE["backlash"], Location("J2", "ry", ("approach_J2",)), (GAP,), ("approach_J2",))
    arm = replace(plain(), effects=(effect,))
    ends = [arm.deflection(Q[0], covariates={"approach_J2": side}).pose for side in (-1.0, 1.0)]
    half = 0.5 * pin.log3(ends[1].rotation @ ends[0].rotation.T)
    assert np.linalg.norm(half) == pytest.approx(0.5 * GAP, rel=0.01)
    level = arm.deflection(Q[0], covariates={"approach_J2": 0.0}).pose.rotation
    stands = pin.exp3(turned * np.array([0.6, 0.0, 0.8])) @ level.T  # the target is seen turned by so much
    instrument = Instrument(pin.SE3(stands, np.array([1.0, 2.0, 0.5])))
    rows = Rows.of(arm.joint_names, Q, ("none",), {"time": 0.0}, derived=("approach_J2",))
    ((shift,),) = unclear_shifts(Setup(arm, instrument), rows, unread(1, Position, Orientation))
    np.testing.assert_allclose(shift[3:], stands @ half, atol=1e-4 * GAP)
    moved = 0.5 * (ends[1].translation - ends[0].translation)
    np.testing.assert_allclose(shift[:3], stands @ moved, atol=1e-4 * GAP)
