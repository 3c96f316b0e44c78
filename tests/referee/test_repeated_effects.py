"""Several effects of one law at one place of an arm: every parameter keeps its own name, value and certainty."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import three_joint_plant
from support.effect_arms import quietly
from support.measurement_rows import written
from support.plant import Push, State
from support.three_joint_plant import ARM, SIGMA

from armflex import Arm, Reading, Tracker, calibrate, plan, predict, read_measurements, trace
from armflex.errors import InputError
from armflex.estimate.draw import draw_arms
from armflex.files.effect_file import effect_table
from armflex.parameters import Certainty
from armflex.readings.instrument import Instrument
from armflex.show.report import write_report
from armflex.trace.findings import Trace

pytestmark = pytest.mark.slow

HARMONICS = {3.2: (6e-4, -3e-4), 7.9: (-4e-4, 4e-4), 14.6: (2e-4, 4.5e-4)}
ECCENTRIC = (9e-4, -1.1e-3)
"""k -> A and B [rad] of what J2's gear does, and A and B of what its encoder's disc does."""


def gear(state: State, push: Push) -> None:
    """Turn the second joint by what its gear and its encoder do."""
    q = state.rows.q[:, 1]
    told = [(k, *pair) for k, pair in (*HARMONICS.items(), (1.0, ECCENTRIC))]
    push.motion[:, 1, 4] += sum(a * np.sin(k * q) + b * np.cos(k * q) for k, a, b in told)


def measured(folder: Path, seed: int, count: int) -> Path:
    """Write a campaign of the machine that has all four, as read from one place; return its table."""
    rng, plant = np.random.default_rng(seed), three_joint_plant.declared(folder)
    plant.offset = {"J2": 4e-4, "J3": -7e-4}
    q = rng.uniform(-1.0, 1.0, (count, 3)) * [2.5, 2.4, 2.0]
    read = three_joint_plant.seen(plant, q, gear) + rng.normal(0.0, SIGMA, (count, 3))
    return three_joint_plant.write_campaign(folder / f"m{seed}.csv", q, read)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("gear")


@pytest.fixture(scope="module")
def rows(folder: Path) -> Path:
    return measured(folder, 1, 150)


@pytest.fixture(scope="module")
def found(folder: Path, rows: Path) -> Trace:
    arm = quietly(folder / "arm.toml")
    return trace(arm, read_measurements(rows, arm))


@pytest.fixture(scope="module")
def again(folder: Path, found: Trace) -> Arm:
    """Return what was found, written and read."""
    return quietly(found.write(folder / "traced.toml"))


def harmonics(arm: Arm) -> list[float]:
    """Return the wave numbers of the arm's harmonics, in its order."""
    return [effect.named["k"] for effect in arm.effects if effect.law.name == "gear_harmonic"]


def alone(arm: Arm, label: str, std: float) -> Arm:
    """Return the arm with everything known but one parameter."""
    known = np.array([std**2 * (one == label) for one in arm.certainty.labels])
    assert known.any()
    return replace(arm, certainty=Certainty(arm.certainty.parameters, np.diag(known)))


def test_every_harmonic_is_found_under_its_own_name(found: Trace) -> None:
    planted = {("gear_harmonic", k): pair for k, pair in HARMONICS.items()} | {("encoder_eccentricity", 1.0): ECCENTRIC}
    assert len(found.found) == len(planted)
    for one in found.found:
        k = one.effect.named.get("k", 1.0)
        name, nearest = min(planted, key=lambda key: (key[0] != one.effect.law.name, abs(key[1] - k)))
        pair = planted.pop((name, nearest))
        assert (one.effect.law.name, one.effect.location.place, one.effect.location.axis) == (name, "J2", "ry")
        assert abs(k - nearest) <= 4.0 * one.std.get("k", 0.0) * k + 1e-9 or abs(k - nearest) < 0.03
        for label, value in zip("AB", pair, strict=True):
            assert abs(one.effect.named[label] - value) < 4.0 * one.std[label]
    assert not planted
    assert found.held_out_after < 1.5 * SIGMA * np.sqrt(3.0) < found.held_out_before / 5.0
    ends = [label.removeprefix("effect gear_harmonic J2 ry") for label in found.arm.certainty.labels if "gear" in label]
    assert ends == [" A", " B", " k", " #2 A", " #2 B", " #2 k", " #3 A", " #3 B", " #3 k"]


def test_what_is_written_is_read_as_it_was(again: Arm, found: Trace, rows: Path) -> None:
    assert again.effects == found.arm.effects and again.certainty.labels == found.arm.certainty.labels
    known = found.arm.certainty.covariance
    size = np.sqrt(np.diag(known))
    np.testing.assert_allclose((again.certainty.covariance - known) / np.outer(size, size), 0.0, atol=1e-9)
    asked = read_measurements(rows, again)
    told, before = predict(again, asked), predict(found.arm, asked)
    np.testing.assert_allclose(told.position, before.position, atol=1e-9)
    np.testing.assert_allclose(told.sigma, before.sigma, atol=1e-10)  # frames are uncertain by 1 mm, in eleven digits
    assert not told.flags and (told.sigma > 0.0).all() and (told.sigma < 5.0 * SIGMA).all()
    off = np.linalg.norm(told.position - asked.position, axis=1)
    assert np.sqrt((off**2).mean()) == pytest.approx(found.rms, rel=1e-3)


@pytest.mark.parametrize("number", [0, 1, 2])
def test_a_parameter_is_uncertain_where_its_own_harmonic_moves_the_tip(again: Arm, rows: Path, number: int) -> None:
    name, std = f"effect gear_harmonic J2 ry{('', ' #2', ' #3')[number]} A", 1e-5
    arm, asked = alone(again, name, std), read_measurements(rows, again)
    moved, k = predict(arm, asked).sigma, harmonics(arm)[number]
    waves = np.abs(np.sin(k * asked.q[:, 1]))
    lever = np.linalg.norm(moved, axis=1) / np.maximum(std * waves, 1e-12)
    assert (lever[waves > 0.05] > 0.5).all() and (lever[waves > 0.05] < 1.7).all()  # of J2 to the tip, never another's
    drawn = draw_arms(arm, 3)
    for one in drawn:
        changed = [a != b for a, b in zip(one.effects, arm.effects, strict=True)]
        assert sum(changed) == 1
        assert one.effects[changed.index(True)].named["k"] == k


def test_a_traced_arm_is_calibrated_again(again: Arm, folder: Path) -> None:
    later = read_measurements(measured(folder, 2, 40), again)
    for keep in (True, False):
        found = calibrate(again, later, keep=keep)
        path = found.write(folder / f"again{keep}.toml")
        read = quietly(path)
        assert read.effects == again.effects and read.certainty.labels == found.arm.certainty.labels
        assert ("effect gear_harmonic J2 ry #3 k" in read.certainty.labels) == keep
        told = predict(read, later)
        assert "no_certainty" not in [flag.code for flag in told.flags] and (told.sigma > 0.0).all()
        assert np.sqrt(((told.position - later.position) ** 2).sum(axis=1).mean()) < 1.5 * SIGMA * np.sqrt(3.0)


def test_a_harmonic_beside_declared_ones_is_numbered_after_them(folder: Path, found: Trace, rows: Path) -> None:
    known = [one for one in found.found if one.effect.named.get("k", 0.0) < 10.0]
    tables = [effect_table(one.effect) for one in known]
    text = "".join(
        f'\n[[effect]]\nname = "{one["name"]}"\nsite = "J2"\naxis = "ry"\nparameters = {inline(one)}\n'
        for one in tables
    )
    path = folder / "two.toml"
    path.write_text(ARM + text)
    arm = quietly(path)
    third = trace(arm, read_measurements(rows, arm))
    assert [one.effect.name for one in third.found] == ["gear_harmonic J2 ry"]
    read = quietly(third.write(folder / "three.toml"))
    named = [label for label in read.certainty.labels if label.startswith("effect ")]
    assert named == [f"effect gear_harmonic J2 ry #3 {label}" for label in ("A", "B", "k")]
    sigma = predict(alone(read, named[0], 1e-5), read_measurements(rows, read)).sigma
    waves = np.abs(np.sin(harmonics(read)[-1] * read_measurements(rows, read).q[:, 1]))
    assert np.corrcoef(np.linalg.norm(sigma, axis=1), waves)[0, 1] > 0.9


def inline(table: dict) -> str:
    return "{ " + ", ".join(f"{name} = {value!r}" for name, value in table["parameters"].items()) + " }"


def test_a_plan_knows_the_harmonics_apart(again: Arm) -> None:
    planned = plan(again, 6)
    names = planned.model.names
    assert len(set(names)) == len(names) and "effect gear_harmonic J2 ry #2 B" in names
    told = plan(again, 6, between=("gear_harmonic:J2:ry", "gear_harmonic:J2:ry#3"))
    third = told.hypotheses[1]
    assert [one.name for one in told.hypotheses] == ["gear_harmonic:J2:ry", "gear_harmonic:J2:ry#3"]
    assert [one.candidate.effect.named["k"] for one in told.hypotheses] == [harmonics(again)[0], harmonics(again)[2]]
    np.testing.assert_array_equal(third.size[:2], third.candidate.effect.amplitudes)
    assert len(set(told.model.names)) == len(told.model.names) == len(names)
    with pytest.raises(InputError, match="gear_harmonic:J2:ry or gear_harmonic:J2:ry#2 or gear_harmonic:J2:ry#3: say"):
        plan(again, 6, between=("gear_harmonic:J2", "encoder_offset:J3"))
    with pytest.raises(InputError, match="distinguished from itself"):
        plan(again, 6, between=("gear_harmonic:J2:ry#2", "gear_harmonic:J2:ry#2"))


def test_a_tracker_leaves_the_harmonics_as_they_are(again: Arm, rows: Path) -> None:
    tracker, read = Tracker(again), read_measurements(rows, again)
    for row in range(5):
        tracker.update(Reading.of(read, row))
    known, before = tracker.arm.certainty, again.certainty
    own = [i for i, label in enumerate(before.labels) if label.startswith("effect ")]
    labels = [before.labels[i] for i in own]
    there = [i for i, label in enumerate(known.labels) if label.startswith("effect ")]
    assert [known.labels[i] for i in there] == labels and len(labels) == 11
    np.testing.assert_array_equal(known.part(there).covariance, before.part(own).covariance)
    assert "no_certainty" not in [flag.code for flag in predict(tracker.arm, read).flags]


def test_the_report_numbers_them(found: Trace, folder: Path) -> None:
    page = write_report(found, folder / "report.html").read_text()
    for number in ("", " #2", " #3"):
        assert f"Gear harmonic at J2 (ry){number}<" in page


def test_a_file_that_named_disjoint_terms_alike_is_still_read(folder: Path) -> None:
    """Before effects of one name were numbered, their labels differed by the amplitudes alone."""
    moves = [
        f'name = "tool_shift"\nsite = "tool"\nparameters = {{ d{x} = 1e-4, since = {t} }}' for x, t in ("x2", "y5")
    ]
    path = folder / "moved.toml"
    path.write_text(ARM + "".join(f"\n[[effect]]\n{one}\n" for one in moves))
    arm = quietly(path)
    labels = ("effect tool_shift tool dx", "effect tool_shift tool dy")
    known = replace(arm, certainty=Certainty(arm.named(labels), np.diag([1e-10, 4e-10])), instrument=Instrument())
    rows = read_measurements(written(folder, [{"q_J1": 0.1, "q_J2": 0.2, "q_J3": 0.3, "time": 9.0}]), arm, True)
    sigma = predict(known, rows).sigma
    assert np.linalg.norm(sigma) == pytest.approx(np.sqrt(5e-10), rel=1e-6)
