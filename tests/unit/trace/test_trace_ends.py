"""Every trace ends with a result: states that lead to one another, what shows nothing, bounds, Ctrl-C."""

import os
import signal
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.command_line import fine, run_here, strict_json
from support.three_joint_plant import GAP, POSES, with_play

from armflex import Arm, Measurements, calibrate, load_arm, read_measurements, trace
from armflex.errors import InputError
from armflex.estimate.pose_block import PoseBlock
from armflex.laws.effects import Effect, Location, TwistLaw
from armflex.laws.effects.catalogue import EVERY
from armflex.laws.effects.effect import Amplitude, Words
from armflex.laws.effects.shapes import on_axis, twists
from armflex.laws.effects.thermal_growth import THERMAL_GROWTH
from armflex.laws.effects.unnamed import WAVE
from armflex.laws.terms import powers
from armflex.rows.rows import POSE
from armflex.trace import search as searching
from armflex.trace import state as states
from armflex.trace.account import conclude, so_far
from armflex.trace.findings import Trace
from armflex.trace.hypotheses import hypotheses, sought
from armflex.trace.search import entered, linear, refitted, search, standing
from armflex.trace.selection import Chosen
from armflex.trace.state import begin, with_random


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return with_play(tmp_path_factory.mktemp("play"))


@pytest.fixture(scope="module")
def campaign(folder: Path) -> tuple[Arm, Measurements]:
    arm = load_arm(folder / "arm.toml")
    return arm, read_measurements(folder / "rows.csv", arm)


@pytest.fixture(scope="module")
def begun(campaign: tuple[Arm, Measurements]) -> states.State:
    return begin(calibrate(*campaign, as_stated=True))


@pytest.fixture(scope="module")
def traced(campaign: tuple[Arm, Measurements]) -> Trace:
    return trace(*campaign)


# States that no search leaves.


def test_no_state_is_entered_twice(begun: states.State) -> None:
    first = standing(begun)
    fewer = replace(begun, rows=begun.rows[1:])
    assert entered(begun, first) is None
    second = entered(fewer, first)
    assert second is not None and entered(begun, second) is None and entered(fewer, second) is None


def test_rows_that_come_and_go_do_not_keep_a_search_going(begun: states.State, monkeypatch: pytest.MonkeyPatch) -> None:
    """One row is far off with an effect and in place without, so that each state leads to the other."""
    entries, real = list[tuple](), states.lost_of

    def lost(state: states.State, heed: bool) -> tuple[np.ndarray, np.ndarray]:
        found, gone = real(state, heed)
        found[3], gone[3] = (bool(state.known),) * 2
        return found, gone

    monkeypatch.setattr(states, "lost_of", lost)
    monkeypatch.setattr(searching, "_modelled", lambda here, more: () if here.model else _play(here))
    monkeypatch.setattr(searching, "PROPOSALS", (searching._more_probable,))
    here = search(standing(begun), lambda one: entries.append(one.state.identity))
    assert entries == [here.state.identity] and len(here.state.rows) == POSES - 1


def _play(here: searching.Standing) -> tuple:
    names = [group.hypothesis.one.name for group in here.screen.groups]
    return (Chosen(names.index("backlash J2 ry"), 3),)


def test_a_search_has_a_bound_and_says_where_it_met_it(
    campaign: tuple[Arm, Measurements], traced: Trace, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert traced.ended == ""
    monkeypatch.setattr(searching, "MOST_ROUNDS", 0)
    found = trace(*campaign)
    assert found.ended == "after 1 states, the most that a search enters" and not found.unfinished
    assert found.found == () and found.nothing is not None


def test_time_is_a_bound_too(campaign: tuple[Arm, Measurements]) -> None:
    found = trace(*campaign, minutes=1e-6)
    assert found.unfinished and found.ended.startswith("after 1e-06 min of CPU time")
    assert found.rms == pytest.approx(found.calibrated_rms) and np.isfinite(found.held_out).all()
    with pytest.raises(InputError, match="minutes is 0, expected more"):
        trace(*campaign, minutes=0.0)


# Ctrl-C and its like.


@pytest.mark.skipif(os.name != "posix", reason="sends signals")
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_ends_a_trace_with_what_it_has(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, how: signal.Signals
) -> None:
    """In a script's background, too, where a shell has SIGINT ignored."""
    account = sys.modules["armflex.trace.account"]  # whose package has a function of its name
    monkeypatch.setattr(account, "weighed", lambda *given: os.kill(os.getpid(), how))
    files = ["-o", "t.toml", "--json", "t.json", "--report", "t.html"]
    before = {which: signal.getsignal(which) for which in (signal.SIGINT, signal.SIGTERM)}
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        ended = fine(run_here(tmp_path, "trace", folder / "arm.toml", folder / "rows.csv", *files), 1)
    finally:
        for which, handler in before.items():
            signal.signal(which, handler)
    assert "Accepted so far, not compared: backlash at J2 (ry)." in ended.stdout
    assert "The search was ended by an interrupt: more effects may be missing." in ended.stdout
    with pytest.warns(UserWarning, match=r"t\.toml:\d+: written when `armflex trace` was interrupted"):
        arm = load_arm(tmp_path / "t.toml")
    (effect,) = arm.effects
    assert effect.name == "backlash J2 ry" and effect.values[0] == pytest.approx(GAP, rel=0.1)
    said = strict_json(tmp_path / "t.json")
    assert said["unfinished"] and said["ended"] == "by an interrupt"
    assert [(one["effect"], one["site"]) for one in said["effects"]] == [("backlash", "J2")]
    assert said["effects"][0]["parameters"]["gap"]["std"] < 0.1 * GAP
    assert "Unfinished: the search was ended by an interrupt" in (tmp_path / "t.html").read_text()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["t.html", "t.json", "t.toml"]


def test_resume_is_refused_with_what_to_write(folder: Path, tmp_path: Path) -> None:
    given = folder / "arm.toml", folder / "rows.csv", "-o", "t.toml", "--resume"
    assert "--resume is no more: leave it out; --minutes N" in fine(run_here(tmp_path, "trace", *given), 2).stderr


# What shows nothing.


def test_a_joint_that_never_moves_is_no_column_of_a_shape(tmp_path: Path) -> None:
    arm = load_arm(with_play(tmp_path, still=2) / "arm.toml")
    state = begin(calibrate(arm, read_measurements(tmp_path / "rows.csv", arm), as_stated=True))
    shapes = [one.one for one in hypotheses(state.context) if not one.one.law.physical]
    over = {name for one in shapes for name in one.location.covariates}
    assert {"q_J1", "q_J2"} <= over and "q_J3" not in over
    places = list(WAVE.places(state.context.records))
    assert places and list(sought(WAVE, places, state.context))


def test_rows_without_noise_are_traced_like_others(tmp_path: Path) -> None:
    """As a simulator writes them: however exact, they show the play and nothing beside it."""
    folder = with_play(tmp_path, noise=0.0)
    arm = load_arm(folder / "arm.toml")
    account = trace(arm, read_measurements(folder / "rows.csv", arm))
    (play,) = account.found
    assert (play.effect.law.name, play.effect.location.site) == ("backlash", "J2")
    assert abs(play.effect.named["gap"]) == pytest.approx(GAP, rel=1e-3)
    assert account.unexplained is None


def test_a_random_twist_that_is_set_aside_leaves_an_account(folder: Path, traced: Trace, tmp_path: Path) -> None:
    """Of an arm that was traced before: how certain its effects are is asked at the arm with the twist in it."""
    arm = load_arm(traced.write(tmp_path / "first.toml"))
    state = begin(calibrate(arm, read_measurements(folder / "rows.csv", arm), keep=True, as_stated=True))
    groups = state.context.column(POSE).astype(int)
    aside = with_random(state, PoseBlock("J3", "ry", 1e-4, groups))
    found = so_far(aside, linear(aside).places, "by hand")
    assert found.unexplained is not None and found.unexplained.site == "J3"
    assert conclude(standing(aside), found.places).arm.certainty is not None


def test_an_effect_that_shows_nothing_at_the_values_of_a_fit_is_no_finding(begun: states.State) -> None:
    here = standing(begun)
    idle = next(i for i, one in enumerate(here.screen.groups) if not one.scale.any())
    state = refitted(here, (Chosen(idle, 3),))
    assert state is not None and len(state.known) == 1
    after = standing(state)
    found = conclude(after, here.places)
    assert len(after.model) == 1 and [one.name for one in found.arm.effects] == ["backlash J2 ry"]


SPEED = TwistLaw(
    name="speed_lag",
    words=Words("speed lag", "the joint lags behind its command", "T v"),
    places=lambda records: [Location(one.name, "ry", (f"speed_{one.name}",)) for one in records.robot.moving],
    amplitudes=(Amplitude("T", "s"),),
    direction=on_axis,
    terms=lambda here, inner: twists(here.direction, powers(f"speed_{here.location.place}", 1)),
)


def test_an_effect_whose_column_a_campaign_lacks_is_not_tried(
    begun: states.State, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(EVERY, SPEED.name, SPEED)
    tried = {one.one.law.name for one in hypotheses(begun.context)}
    assert "backlash" in tried and SPEED.name not in tried


def test_a_lag_has_to_be_earned_and_is_shorter_than_the_campaign(tmp_path: Path) -> None:
    """What follows a temperature at once is as likely as all that lags, and no later command needs a time for it."""
    time = np.linspace(0.0, 6000.0, POSES)
    arm = load_arm(with_play(tmp_path, time=time, temperature=20.0 + 3.0 * np.sin(time / 900.0)) / "arm.toml")
    state = begin(calibrate(arm, read_measurements(tmp_path / "rows.csv", arm), as_stated=True))
    growth = [one for one in hypotheses(state.context) if one.one.law is THERMAL_GROWTH]
    place = growth[0].one.location
    priors = {one.one.inner: one.prior for one in growth if one.one.location == place}
    assert priors[20.0, 0.0] > max(priors[20.0, lag] for lag in (600.0, 1800.0, 5400.0)) + 2.9
    for lag, shown in ((0.0, True), (5400.0, True), (6600.0, False)):
        effect = Effect(THERMAL_GROWTH, place, (1e-5, 20.0, lag))
        assert THERMAL_GROWTH.possible(effect, state.context, arm) is shown


# How it is said.


def test_a_trace_names_what_it_found(traced: Trace) -> None:
    said = repr(traced)
    assert said.startswith("<Trace: backlash at J2 (ry); RMS 0.") and "held out" in said and "\n" not in said


def test_kinds_of_readings_show_no_numbers(campaign: tuple[Arm, Measurements]) -> None:
    assert len(repr(calibrate(*campaign).by_kind)) < 200
