"""Names that compete: the less likely is exchanged, the broken promise counts, and sizes are those of machines."""

from pathlib import Path

import numpy as np
import pytest
from support.campaigns import draw

from armflex import load_arm, read_measurements
from armflex.estimate.calibrate import calibrate
from armflex.laws.effects import CATALOGUE
from armflex.laws.effects.candidate import Candidate
from armflex.laws.effects.possible import unusual
from armflex.trace.account import weighed
from armflex.trace.search import refitted, standing
from armflex.trace.selection import Chosen, rivals
from armflex.trace.state import State, begin


def calibrated(kind: str, folder: Path) -> State:
    truth = draw(kind, 1000, "boom").write(folder)
    arm = load_arm(truth.arm)
    return begin(calibrate(arm, read_measurements(truth.train, arm), as_stated=True))


@pytest.fixture(scope="module")
def missing(tmp_path_factory) -> State:
    """A machine with one joint's play, calibrated."""
    return calibrated("backlash", tmp_path_factory.mktemp("several"))


@pytest.mark.slow
def test_a_name_that_is_less_likely_than_another_is_exchanged_for_it(missing):
    """The arm was fitted with what the readings speak for less: another joint's law is all that it was given."""
    here = standing(missing)
    names = [group.hypothesis.spot for group in here.screen.groups]
    own = next(i for i, name in enumerate(names) if name[0] == "friction_windup" and name[1].site == "A4")
    state = refitted(here, (Chosen(own, 2),))
    assert state is not None and [effect.title for effect in state.fitted] == ["friction windup at A4 (rz)"]
    known = weighed(standing(state))
    assert [(one.law.name, one.location.site) for one in known.here.state.fitted] == [("backlash", "A3")]
    found, *_ = known.credible
    assert found.probability > 0.9 > max((chance for _, chance in found.others), default=0.0)


def test_what_came_out_below_its_promise_is_as_unlikely_as_that(missing):
    """A law's odds beside others are those of the linear problem until the arm was fitted with it."""
    screen = standing(missing).screen
    best = rivals(screen.beside(()))[0]
    screen.fall_short(screen.groups[best.chosen.number].hypothesis.spot, best.odds + 3.0)
    assert screen.log_posterior((best.chosen,)) == pytest.approx(screen.log_posterior(()) - 3.0, abs=0.2)
    assert all(one.chosen.number != best.chosen.number or one.odds < 0.0 for one in rivals(screen.beside(())))


def test_a_joint_that_turns_by_more_than_joints_do_is_unlikely(missing):
    law = CATALOGUE["backlash"]
    candidate = Candidate(law, next(one for one in law.places(missing.context.records) if one.site == "A3"), ())
    play, broken = (
        unusual(candidate.effect(np.array([gap])), missing.fit.view, missing.context) for gap in (1e-3, 0.3)
    )
    assert play < 1.0 and broken > 100.0
