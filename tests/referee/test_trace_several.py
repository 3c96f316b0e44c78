"""Several causes at once: all are named, what was set aside is withdrawn, and sizes are those that machines have."""

from pathlib import Path

import numpy as np
import pytest
from support.campaigns import draw
from support.scoring import score

from armflex import load_arm, read_measurements
from armflex.estimate.calibrate import calibrate
from armflex.laws.effects import CATALOGUE
from armflex.laws.effects.candidate import Candidate
from armflex.laws.effects.possible import unusual
from armflex.trace.account import weighed
from armflex.trace.search import refitted, standing
from armflex.trace.selection import Chosen, rivals
from armflex.trace.state import State, begin


@pytest.mark.slow
@pytest.mark.parametrize(
    ("count", "seed", "arm"),
    [
        (3, 0, "six"),  # a link that bends on one axis, where two explain a little more and neither stands
        (4, 0, "boom"),
        (5, 1, "boom"),
        (3, 9504, "six"),  # a joint that is softer, which only the priors show
        (4, 9401, "six"),  # lengths that grew from another temperature stand for the instrument's scale
        pytest.param(  # a hose that pulls almost evenly
            *(3, 9600, "six"),
            marks=pytest.mark.xfail(strict=True, reason="a hose at the next link is as probable as a hose and a mass"),
        ),
        (4, 103002, "boom"),  # a constant force, which a hose of another anchor imitates
        (5, 9504, "six"),  # a hose beside the link's line, which on the neighbouring link fits almost as well
    ],
)
def test_every_cause_that_shows_is_named(count, seed, arm):
    found = score(f"{count} effects", seed, arm, 1.0)
    assert set(found.named) <= {"exact", "hidden"} and found.named.count("exact") >= 2, found
    assert found.false == 0 and found.after < 1.1 * found.floor, found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "seed", "arm"),
    [
        ("stiffening", 1002, "six"),  # hardens by more than what calibration leaves of the joint's compliance
        ("stiffening", 1003, "boom"),  # its slope turns around before its twist does
        ("tracker_scale", 1002, "boom"),  # 0.4 mm in a metre
    ],
)
def test_what_machines_may_have_is_possible(kind, seed, arm):
    found = score(kind, seed, arm, 1.0)
    assert found.verdict == "exact" and found.after < 1.06 * found.floor, found


@pytest.mark.slow
def test_what_no_hose_pulls_is_no_rival_of_an_encoder_scale():
    """As a dress pack it would pull 17 kN/m."""
    found = score("encoder_scale", 2, "boom", 0.25)
    assert found.verdict == "exact" and found.stated[0][0] > 0.8, found
    assert all(name != "dress_pack" for name, *_ in found.equivalents[0]), found


@pytest.mark.slow
def test_something_is_missing_where_a_change_is_left_unexplained():
    found = score("random_pose", 6000, "six", 1.0)
    assert found.verdict == "exact" and found.stated == [(0.0, False)], found


@pytest.mark.slow
def test_a_product_of_columns_that_change_at_a_pose_is_found_first():
    """From pose to pose a random twist explains little of it; several effects that imitate parts of it explain more."""
    found = score("product", 31002, "boom", 1.0)
    assert found.verdict == "exact" and found.after < 1.1 * found.floor, found


@pytest.mark.slow
def test_an_effect_in_whose_place_nothing_is_credible_is_at_even_odds_at_most():
    found = score("creep", 51001, "six", 0.25)
    assert found.first and all(right or probability < 0.75 for probability, right in found.stated), found


@pytest.mark.slow
def test_a_hose_at_the_end_of_a_link_may_be_one_at_the_next_link():
    found = score("2 effects", 71000, "boom", 1.0)
    assert found.verdict == "exact", found
    assert [(name, site) for name, site, *_ in found.equivalents[0]] == [("umbilical", "A4")], found


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
