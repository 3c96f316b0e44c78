"""A campaign that does not say from which side joints came: what a trace took from its rows' order is taken again."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.command_line import Run, fine, strict_json
from support.effect_arms import quietly
from support.plant import Array, Push, State
from support.three_joint_plant import SIGMA, declared, seen, write_campaign

from armflex import (
    Arm,
    Measurements,
    Reading,
    Tracker,
    Trajectory,
    calibrate,
    check,
    compensate,
    plan,
    predict,
    read_measurements,
    trace,
)
from armflex.errors import ArmFileError, MissingCovariateError
from armflex.trajectory import write_trajectory

pytestmark = pytest.mark.slow

GAP, COUNT, STILL = 1.4e-3, 90, 3
"""Play of J2 [rad], rows, and how many of the first ones are over before J2 moves."""


def play(state: State, push: Push) -> None:
    push.motion[:, 1, 4] += 0.5 * GAP * state.rows.approach[:, 1]


def driven(seed: int) -> tuple[Array, Array]:
    """Return the joint positions of a campaign, and from which side each joint came."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-1.0, 1.0, (COUNT, 3)) * [2.5, 1.9, 2.0]
    q[:STILL, 1] = q[0, 1]
    came = np.sign(np.diff(q, axis=0, prepend=q[:1]))
    came[:STILL, 1] = 1.0  # as it happened to be
    return q, came


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the arm and two campaigns, and the first one again with the direction that J2 came from."""
    folder = tmp_path_factory.mktemp("play")
    plant = declared(folder)
    for seed in (1, 2):
        q, came = driven(seed)
        read = seen(plant, q, play, came) + np.random.default_rng(seed + 10).normal(0.0, SIGMA, (COUNT, 3))
        write_campaign(folder / f"m{seed}.csv", q, read)
        write_campaign(folder / f"told{seed}.csv", q, read, approach_J2=came[:, 1])
    return folder


@pytest.fixture(scope="module")
def traced(folder: Path) -> Path:
    """Return the file that a trace of the campaign without directions wrote."""
    arm = quietly(folder / "arm.toml")
    found = trace(arm, read_measurements(folder / "m1.csv", arm))
    assert [(one.effect.name, one.effect.derived) for one in found.found] == [("backlash J2 ry", ("approach_J2",))]
    assert abs(found.found[0].effect.named["gap"] - GAP) < 4.0 * found.found[0].std["gap"]
    return found.write(folder / "traced.toml")


@pytest.fixture(scope="module")
def arm(traced: Path) -> Arm:
    return quietly(traced)


@pytest.fixture(scope="module")
def rows(arm: Arm, folder: Path) -> Measurements:
    return read_measurements(folder / "m1.csv", arm)


def errors(arm: Arm, rows: Measurements) -> Array:
    return np.linalg.norm(predict(arm, rows).position - rows.position, axis=1)


def test_the_file_says_that_the_direction_was_derived(traced: Path, arm: Arm) -> None:
    assert 'derived = ["approach_J2"]' in traced.read_text()
    assert [effect.derived for effect in arm.effects] == [("approach_J2",)]


def test_the_campaign_that_was_traced_is_predicted(armflex: Run, traced: Path, folder: Path, tmp_path: Path) -> None:
    said = fine(armflex("predict", traced, folder / "m1.csv", "-o", "p.csv", "--json", "p.json"))
    line = (
        "approach_J2 is not given: taken from how the rows before moved the joint; 3 rows do not determine it, and are"
    )
    assert f"{line} taken as halfway" in " ".join(said.stderr.split())
    assert any(line in flag for flag in strict_json(tmp_path / "p.json")["flags"])
    found, seen = (list(csv.DictReader(path.open())) for path in (tmp_path / "p.csv", folder / "m1.csv"))
    off = [[float(a[axis]) - float(b[axis]) for axis in "xyz"] for a, b in zip(found, seen, strict=True)]
    assert np.sqrt((np.array(off[STILL:]) ** 2).sum(axis=1).mean()) < 1.5 * np.sqrt(3.0) * SIGMA


def test_rows_that_tell_no_direction_are_as_uncertain_as_either(arm: Arm, rows: Measurements) -> None:
    found = predict(arm, rows)
    either = [predict(arm, replace(rows, approach=np.full_like(rows.approach, side))) for side in (-1.0, 1.0)]
    half = 0.5 * (either[1].position - either[0].position)[:STILL]
    np.testing.assert_allclose(found.position[:STILL] + half, either[1].position[:STILL], atol=0.5 * GAP**2)
    plain = predict(arm, rows, covariates={"approach_J2": 0.0}).sigma
    np.testing.assert_allclose(found.sigma[:STILL] ** 2, plain[:STILL] ** 2 + half**2, rtol=1e-3)
    assert np.linalg.norm(half, axis=1).min() > 5.0 * SIGMA > 2.0 * found.sigma[STILL:].max()


def test_a_column_has_precedence_over_the_order(arm: Arm, folder: Path) -> None:
    told = read_measurements(folder / "told1.csv", arm)
    assert errors(arm, told).max() < 5.0 * SIGMA  # from the first row on
    assert "approach_derived" not in [flag.code for flag in predict(arm, told).flags]
    turned = replace(told, approach=-told.approach)
    assert errors(arm, turned).min() > 5.0 * SIGMA


def test_an_effect_that_was_told_its_directions_does_not_guess(arm: Arm, folder: Path, rows: Measurements) -> None:
    declared = quietly(folder / "arm.toml")
    found = trace(declared, read_measurements(folder / "told1.csv", declared))
    path = found.write(folder / "told.toml")
    assert "derived" not in path.read_text()
    for ask in (predict, calibrate):
        with pytest.raises(MissingCovariateError, match=r"m1.csv:2: effect 'backlash J2 ry' needs .*'approach_J2'"):
            ask(quietly(path), rows)


def test_a_campaign_without_directions_calibrates_the_traced_arm(arm: Arm, traced: Path, folder: Path) -> None:
    later = read_measurements(folder / "m2.csv", arm)
    found = calibrate(arm, later, keep=True)
    assert found.fit.view.rows.tolist() == list(range(STILL, COUNT)) and found.rms < 1.5 * np.sqrt(3.0) * SIGMA
    flags = {flag.code: flag.text for flag in found.flags}
    assert "approach_J2 is not given" in flags["approach_derived"] and "3 rows" in flags["direction_unknown"]
    again = quietly(found.write(folder / "again.toml"))
    assert again.effects == arm.effects and errors(again, later)[STILL:].max() < 5.0 * SIGMA


def test_a_plan_after_a_campaign_without_directions(arm: Arm, rows: Measurements) -> None:
    found = plan(arm, 4, after=rows)
    assert {"approach_derived", "direction_unknown"} <= {flag.code for flag in found.flags}
    assert found.reach.approached == ("J2",) and found.std_after.max() < np.inf


def test_a_path_says_that_directions_are_its_own(armflex: Run, arm: Arm, traced: Path, tmp_path: Path) -> None:
    q = np.array([[0.1, 0.2, 0.3], [0.4, 0.4, 0.5], [0.2, 0.7, 0.4]])
    path = Trajectory(arm.joint_names, np.arange(3.0), q, ("none",) * 3, ("a", "b", "c"))
    told = replace(path, covariates={"approach_J2": np.array([1.0, 1.0, 1.0])})
    asks = (lambda one: check(arm, one, 0.05), lambda one: compensate(arm, one), lambda one: plan(arm, 3, along=one))
    for ask in asks:
        (flag,) = [flag for flag in ask(path).flags if flag.code == "approach_derived"]
        assert flag.text.startswith("approach_J2 is not given") and "1 row does not" in flag.text
        assert "approach_derived" not in [flag.code for flag in ask(told).flags]
    first, known = (next(p for p in check(arm, one, 0.05).via_points if p.name == "a") for one in (path, told))
    ends = [arm.deflection(q[0], covariates={"approach_J2": side}).displacement[:3] for side in (-1.0, 1.0)]
    along = ends[0] + ends[1]
    half = 0.5 * (ends[1] - ends[0]) @ along / np.linalg.norm(along)
    assert first.sigma_m == pytest.approx(np.hypot(half, known.sigma_m), rel=0.02) and abs(half) > 5.0 * known.sigma_m
    write_trajectory(path, tmp_path / "t.csv")
    asked = ("view", traced, "--traj", "t.csv", "-o", "v.html")
    said = [fine(armflex(*asked, *more)) for more in ((), ("--covariates", "approach_J2=1"))]
    assert ["approach_J2 is not given" in one.stderr for one in said] == [True, False]


def test_a_tracker_takes_directions_from_its_readings(arm: Arm, folder: Path) -> None:
    """What the first readings do not tell makes them less certain; a restored tracker goes on where it was."""
    later, q = read_measurements(folder / "m2.csv", arm), driven(2)[0]
    told = read_measurements(folder / "told2.csv", arm)
    bare, full = Tracker(arm), Tracker(arm)
    for row in range(COUNT):
        reading = Reading(q[row], later.position[row], SIGMA)
        bare.update(reading)
        full.update(Reading.of(told, row) if row >= STILL else reading)
        if row == 40:
            bare.save(folder / "state.safetensors")
            bare = Tracker.restore(folder / "state.safetensors", arm)
    np.testing.assert_array_equal(bare.values, full.values)
    assert bare.outliers == full.outliers < COUNT // 10
    recorded = replace(arm, effects=tuple(replace(effect, derived=()) for effect in arm.effects))
    with pytest.raises(MissingCovariateError, match="approach_J2"):
        Tracker(recorded).update(Reading(q[0], later.position[0], SIGMA))


@pytest.mark.parametrize(
    ("derived", "said"),
    [
        ('["approach_J3"]', r"no direction 'approach_J3' there.*approach_J2"),
        ('["time"]', "no direction 'time' there"),
        ('"approach_J2"', "expected texts in a list"),
    ],
)
def test_what_is_derived_must_be_a_direction_of_the_effect(traced: Path, derived: str, said: str) -> None:
    bad = traced.with_name("bad.toml")
    bad.write_text(traced.read_text().replace('derived = ["approach_J2"]', f"derived = {derived}"))
    with pytest.raises(ArmFileError, match=rf"bad.toml:\d+: .*{said}"):
        quietly(bad)
