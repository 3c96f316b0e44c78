"""Lost beams and effects: what is far off by itself is left out, what is far off in company is traced, all is told."""

import tomllib
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.campaigns import draw
from support.stage import few

from armflex import calibrate, load_arm, predict, read_measurements
from armflex.arm import Arm
from armflex.cli.trace_command import as_json, print_trace
from armflex.estimate.held_out import held_out, judged_by, pose_folds
from armflex.estimate.outliers import MOST_LOST, lost_readings
from armflex.laws.effects import CATALOGUE, Effect, Location
from armflex.laws.effects.catalogue import EVERY
from armflex.measured.measurements import Measurements
from armflex.plan.design import instead
from armflex.readings import Position, Readings
from armflex.rows.rows import pose_groups
from armflex.show.report import render_report
from armflex.trace import trace
from armflex.trace.findings import Trace
from armflex.trace.state import begin

pytestmark = pytest.mark.slow

SIGMA, SLIP, LATE, LOST = 2e-5, 1.5e-3, 12, (20, 70)


@pytest.fixture(scope="module")
def slipped(tmp_path_factory):
    """A joint slips before the last rows of a campaign, by far more than forty standard deviations; two beams break."""
    truth = draw("none", 3, "six").write(tmp_path_factory.mktemp("slipped"))
    arm = load_arm(truth.arm)
    rows = read_measurements(truth.train, arm)
    rows = few(rows, np.flatnonzero(rows.measured)[::2])
    position = predict(with_slip(arm, rows), rows).position
    position = position + np.random.default_rng(0).normal(0.0, SIGMA, position.shape)
    position[list(LOST)] += (0.03, -0.02, 0.04)
    return arm, replace(rows, position=position, sigma=np.full(position.shape, SIGMA))


def with_slip(arm: Arm, rows: Measurements) -> Arm:
    """Return the arm whose joint slips."""
    at = float(rows.time[-LATE - 1 : -LATE + 1].mean())
    slip = Effect(CATALOGUE["slip_step"], Location("J2", "ry", ("time",)), (SLIP, at))
    return replace(arm, effects=(slip,))


@pytest.fixture(scope="module")
def found(slipped) -> Trace:
    return trace(*slipped)


def test_a_step_before_the_last_rows_is_no_row_of_lost_beams(found, slipped):
    (one,) = found.found
    late = slipped[1].time[-LATE]
    assert one.effect.name == "slip_step J2 ry"
    assert abs(one.effect.named["size"] - SLIP) < 4.0 * one.std["size"] < 0.02 * SLIP
    assert slipped[1].time[-LATE - 1] < one.effect.named["at"] <= late
    assert one.proof.errors_apart > 2.0
    assert set(found.rows) == set(range(len(slipped[1]))) - set(LOST)


def test_every_figure_is_over_the_same_rows_and_the_others_are_told(found, slipped, capsys, tmp_path):
    told, count = as_json(found), len(slipped[1])
    assert told["rows"] + len(told["outliers"]) == count and told["rows"] == count - len(LOST)
    assert {one["row"] for one in told["outliers"]} == set(LOST) and {one["kind"] for one in told["outliers"]} == {
        "lost beam"
    }
    assert all(one["error_mm"] == pytest.approx(1e3 * np.sqrt(29e-4), rel=0.02) for one in told["outliers"])
    written = found.write(tmp_path / "traced.toml")
    table = tomllib.loads(written.read_text())["calibration"]
    assert (table["rows"], table["rms_m"]) == (told["rows"], found.rms)
    here = slipped[1].position[found.rows]
    lacking = predict(replace(found.before.setup.arm, instrument=found.before.setup.instrument), slipped[1])
    expected = np.sqrt(((lacking.position[found.rows] - here) ** 2).sum(axis=1).mean())
    assert told["rms_mm"]["calibrated"] == pytest.approx(1e3 * expected, rel=1e-3)
    assert told["held_out_rms_mm"]["calibrated"] > told["rms_mm"]["calibrated"] > 5.0 * told["rms_mm"]["after"]
    left = held_out(found.before, pose_folds(found.state.groups)).squares[found.judged_rows]
    assert told["held_out_rms_mm"]["calibrated"] == pytest.approx(1e3 * np.sqrt(left.mean()))
    print_trace(found)
    said = capsys.readouterr().out
    assert f"over {count - 2} rows" in said and "2 readings excluded as lost beams" in said
    assert "outliers: 2 excluded from the fit" in render_report(found)


def test_rows_far_off_together_that_nothing_explains_are_left_out_at_last_and_said(slipped):
    arm, rows = slipped
    position = rows.position - predict(with_slip(arm, rows), rows).position + predict(arm, rows).position
    together = [40, 41, 42]
    position[together] += np.random.default_rng(4).normal(0.0, 0.3, (3, 3))
    told = trace(arm, replace(rows, position=position))
    assert not told.found and told.outlier_count("unexplained") == 3 and told.outlier_count("lost beam") == len(LOST)
    assert set(told.rows) == set(range(len(rows))) - {*together, *LOST}
    assert told.unexplained.site is None and told.unexplained.rms > 0.02
    assert told.rms < 1.1 * SIGMA * np.sqrt(3.0)


# What stands alone.


def seen(length: np.ndarray) -> SimpleNamespace:
    """Return what the question needs of a view: residuals of so many standard deviations."""
    whitened = np.outer(length, [1.0, 0.0, 0.0])
    readings = Readings(len(length), (Position(np.zeros((len(length), 3)), np.ones((len(length), 3))),))
    return SimpleNamespace(whitened=whitened, residual=whitened, sigma=np.ones_like(whitened), readings=readings)


COUNT = 200
order = np.arange(COUNT)


def lost_of(far: np.ndarray, sessions=("s",) * COUNT, poses=order) -> list[int]:
    return np.flatnonzero(lost_readings(seen(np.where(far, 300.0, 1.0)), sessions, poses)).tolist()


@given(start=st.integers(0, COUNT - 3), length=st.integers(3, 40), alone=st.integers(0, COUNT - 1))
def test_a_run_stays_and_what_stands_alone_goes(start, length, alone):
    run = (order >= start) & (order < start + length)
    apart = alone < start - 1 or alone > start + length
    assert lost_of(run | (order == alone)) == ([alone] if apart else [])


def test_neighbours_are_of_one_session():
    sessions = ["a"] * 100 + ["b"] * 100
    assert lost_of(abs(order - 99.5) < 2.0, sessions) == [98, 99, 100, 101]
    assert lost_of(abs(order - 99.5) < 2.0) == []


def test_a_pose_that_is_far_whenever_it_is_taken_stays():
    poses = order % 40
    assert lost_of(poses == 7, poses=poses) == []
    assert lost_of((poses == 7) & (order < 80), poses=poses) == [7, 47]  # twice of five times: the others were near


def test_where_many_stand_alone_the_model_is_wrong():
    step = int(1.0 / MOST_LOST) - 1
    assert lost_of(order % (step + 2) == 3) and not lost_of(order % step == 3)


@given(near=st.floats(0.1, 30.0))
def test_what_is_not_very_far_is_never_lost(near):
    assert not lost_readings(seen(np.where(order == 5, near, 1.0)), ("s",) * COUNT, order).any()


def test_a_row_is_believed_that_one_fit_comes_near():
    lengths = np.ones(COUNT), np.ones(COUNT)
    lengths[0][:2] = 50.0
    lengths[1][1:3] = 50.0
    fits = [SimpleNamespace(view=seen(length)) for length in lengths]
    assert np.flatnonzero(~judged_by(*fits).any(axis=1)).tolist() == [1]
    # A fit that is wrong everywhere is no judge of how far is far.
    wide = SimpleNamespace(view=seen(np.where(order == 9, 50.0, 20.0)))
    right = SimpleNamespace(view=seen(np.where(order == 9, 50.0, 1.0)))
    assert np.flatnonzero(~judged_by(wide, right).any(axis=1)).tolist() == [9]


# Poses without names, chance, and advice.


def test_poses_are_where_the_joints_stand(slipped):
    arm, rows = slipped
    nameless = replace(rows, pose=tuple(f"row {i}" for i in range(len(rows))))
    state = begin(calibrate(arm, nameless, as_stated=True))
    groups = pose_groups(nameless)[state.rows]
    assert len(set(groups)) < 0.6 * len(groups)
    same = state.groups[:, None] == state.groups
    np.testing.assert_array_equal(same, groups[:, None] == groups)
    folds = pose_folds(state.groups)
    assert all(len(set(folds[groups == group])) == 1 for group in set(groups))
    np.testing.assert_array_equal(state.context.column("pose_number"), pose_groups(nameless))


def effect(name: str, *place: str) -> Effect:
    law = EVERY[name]
    return Effect(law, Location(*place), (0.0,) * (len(law.amplitudes) + len(law.inner)))


def test_there_is_advice_on_every_law_and_it_is_one_sentence():
    assert all(law.instead for law in CATALOGUE.values())
    for name in EVERY:
        said = instead(effect(name, "J2", "ry"), effect("encoder_scale", "J2", "ry"))
        assert said[0].islower() and not set(said) & set(".;:")
    assert instead(*[effect(name, "J2", "ry") for name in ("backlash", "friction_windup")]).count("push the joint") == 1
    softer = effect("compliance", "J2", "ry"), effect("link_flexure", "link:J2", "ry")
    assert "target" not in instead(*softer)  # nothing is between a joint and the end of its link


@pytest.mark.parametrize(
    ("axes", "unit"), [("dx rx", "m/Nm"), ("rx ry", "rad/Nm"), ("dx dz", "m/N"), ("rz dx", "rad/N")]
)
def test_a_coupling_has_the_unit_of_its_axes(axes, unit):
    axis, partner = axes.split()
    assert Effect(CATALOGUE["cross_coupling"], Location("J2", axis, partner=partner), (1e-9,)).units == (unit,)
