"""Rows that decide between causes: the bound against brute force, what rows cannot tell, rows in an order."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm
from support.arms import bundled
from support.command_line import few_rows
from support.small_arms import ROBOTS

from armflex import load_arm, read_measurements, write_plan
from armflex.laws.effects import Effect, Location
from armflex.laws.effects.link_mass import LINK_MASS
from armflex.linear_gaussian import LinearGaussian
from armflex.measured.measurements import Measurements
from armflex.plan.asking import Cause, Question
from armflex.plan.design import Named, Truth
from armflex.plan.design_model import Before, known_before
from armflex.plan.effects_in_question import named_effect
from armflex.plan.next_measurement import misplaced_centres
from armflex.rows.rows import last_motion


@pytest.mark.parametrize("seed", range(5))
def test_the_bound_falls_by_what_a_row_gains(seed: int) -> None:
    rng = np.random.default_rng(seed)
    known = LinearGaussian.of(rng.normal(size=(20, 6)), np.ones(6))
    rows = 0.3 * rng.normal(size=(9, 3, 6))
    truths = (Truth(np.eye(6)[0], np.arange(1, 6)), Truth(np.array([0, 0, 1.0, -0.5, 0, 0]), np.array([0, 1, 4, 5])))
    now = np.array([one.chi_square(known, one.departure(known)) for one in truths])
    goal = Named(truths, np.array([0.3, 0.1]), now)
    assert goal.value(known) == pytest.approx(-0.4)
    rises = [goal.value(known.with_rows(row)) - goal.value(known) for row in rows]
    assert min(rises) > 1e-4
    np.testing.assert_allclose(goal.gains(known, rows), rises, rtol=1e-9)


@pytest.mark.parametrize("odds", [0.5, 0.8, 0.95])
@pytest.mark.parametrize("apart", [0.5, 2.0, 5.0])
def test_no_more_names_are_wrong_than_the_bound_says(odds: float, apart: float) -> None:
    """Two causes whose readings are so many standard deviations apart, and the more probable one named."""
    one = Truth(np.array([apart]), np.zeros(0, dtype=int))
    goal = Named((one,), np.sqrt([odds * (1.0 - odds)]), np.zeros(1))
    bound = -goal.value(LinearGaussian(np.eye(1)))
    cut = np.log(odds / (1.0 - odds)) / apart
    wrong = odds * norm.cdf(-0.5 * apart - cut) + (1.0 - odds) * norm.cdf(-0.5 * apart + cut)
    assert wrong <= bound <= 3.0 * np.sqrt(wrong)


@pytest.fixture(scope="module")
def before(tmp_path_factory: pytest.TempPathFactory) -> Before:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        arm = load_arm(ROBOTS / "tarm_like" / "measured.toml")
    path = few_rows(ROBOTS / "tarm_like" / "campaign.csv", tmp_path_factory.mktemp("asking") / "m.csv", 100)
    return known_before(arm, read_measurements(path, arm), as_stated=True)


def question(before: Before, *texts: str) -> Question:
    """Return the question which of two effects there is, as the arm might have either."""
    one, other = (Cause(named_effect(text, before.setup.arm, ()), 0.5) for text in texts)
    return Question.of(before, [(one, other)], {}, 64)


@pytest.mark.slow
def test_rows_that_are_asked_for_decide_and_can_be_driven(before: Before, tmp_path) -> None:
    """Backlash there is, and friction at the next joint reads otherwise where the first one comes from another side."""
    asked = question(before, "backlash:A2", "friction_windup:A3").rows(6, "ask")
    assert asked is not None and asked.before == pytest.approx(0.5) and asked.after < 0.05
    campaign = before.campaign
    assert isinstance(campaign, Measurements) and len(asked.rows) == 6
    came = last_motion(np.vstack([campaign.q[-1], asked.rows.q]))[1:]
    np.testing.assert_array_equal(asked.rows.approach, came)
    assert {pose.partition(" ")[0] for pose in asked.rows.pose} == {"ask"}
    path = write_plan(asked, tmp_path / "ask.csv")
    header, *lines = path.read_text().splitlines()
    assert len(lines) == 6 and header.startswith("pose,session,payload,q_M1,q_A1") and ",x,y,z,sigma" in header
    filled = path.with_name("filled.csv")
    filled.write_text("\n".join([header, *(line.replace(",,,,,", ",9e9,1.0,2.0,3.0,") for line in lines)]) + "\n")
    read = read_measurements(filled, before.setup.arm)
    np.testing.assert_allclose(read.q, asked.rows.q, atol=2e-6)
    assert read.payload == asked.rows.payload and np.nanmax(read.sigma) == pytest.approx(2e-4)


@pytest.mark.slow
def test_no_rows_are_planned_for_what_no_reading_tells(before: Before) -> None:
    """A dress pack on a compliance that does not change is an encoder's scale."""
    alike = question(before, "encoder_scale:A2", "dress_pack:A2")
    assert not alike.open.any() and alike.rows(6, "ask") is None


@pytest.mark.slow
def test_what_remembers_the_rows_before_is_asked_in_an_order(before: Before) -> None:
    """Play is taken up by the rows before: the order that was chosen decides more than most others."""
    arm = before.setup.arm
    play = named_effect("hysteresis:A2:ry", arm, ())
    play = replace(play, values=(2e-8, 3e3))
    one, other = Cause(named_effect("backlash:A2", arm, ()), 0.5), Cause(play, 0.5)
    found = Question.of(before, [(one, other)], {}, 64)
    assert found.depends_on_order
    asked = found.rows(6, "ask")
    assert asked is not None and asked.after < asked.before
    orders = [np.arange(6), *(np.random.default_rng(i).permutation(6) for i in range(8))]
    values = found._values(asked.rows, orders)
    assert -values[0] == pytest.approx(asked.after, rel=1e-6) and np.ptp(values) > 0.0
    assert values[0] >= np.median(values)


def test_masses_that_no_link_has_point_to_the_centres_of_mass() -> None:
    robot = bundled("heavy_six").robot

    def said(*masses: float) -> str:
        found = [Effect(LINK_MASS, Location("link:J3", terms=(0,)), (mass, 0.0, 0.0, 0.0)) for mass in masses]
        return " ".join(misplaced_centres(found, robot))

    assert said() == said(20.0) == ""
    assert "link2 by -81 kg of 240 kg" in said(-81.0) and "centres of mass" in said(-81.0)
