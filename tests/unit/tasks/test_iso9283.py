"""ISO 9283 pose characteristics against cases worked out by hand, and of a machine that was put together."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi
from support.lost_campaign import write_arm, write_campaign

import armflex
from armflex.cli.main import armflex as program
from armflex.show.report import render_report
from armflex.tasks.iso9283 import instrument_repeatability, pose_accuracy, pose_repeatability

ROBOTS = Path(__file__).parents[3] / "robots"
EXACT = {"rel": 1e-12, "abs": 1e-12}


def test_characteristics_of_four_readings_are_those_worked_out_by_hand() -> None:
    # Barycentre (1.1, 0, 0): three metres of the standard's figures would do as well as millimetres.
    attained = np.array([[1.0, 0.1, 0.0], [1.2, 0.1, 0.0], [1.0, -0.1, 0.0], [1.2, -0.1, 0.0]])
    sigma = np.full((4, 3), 0.01)
    accuracy = pose_accuracy(np.array([0.8, 0.0, -0.4]), attained, sigma)
    assert accuracy.value == pytest.approx(0.5, **EXACT)  # of (0.3, 0, 0.4)
    # Along (0.6, 0, 0.8): variance of x is 0.04 / 3, of z none; of the mean a quarter.
    assert accuracy.std == pytest.approx(0.6 * np.sqrt(0.04 / 3.0 / 4.0), **EXACT)
    assert accuracy.instrument == pytest.approx(0.01 / 2.0, **EXACT)
    # Every reading is sqrt(0.02) from the barycentre: nothing to add for their scatter.
    assert pose_repeatability(attained, sigma).value == pytest.approx(np.sqrt(0.02), **EXACT)
    # Distances 1, 1, 2, 2 of (0, 0, 0): mean 1.5, standard deviation sqrt(1 / 3).
    cross = np.array([[1.0, 0, 0], [-1.0, 0, 0], [0, 2.0, 0], [0, -2.0, 0]])
    assert pose_repeatability(cross, sigma).value == pytest.approx(1.5 + 3.0 * np.sqrt(1.0 / 3.0), **EXACT)


@pytest.mark.parametrize(("axes", "spread"), [((1, 1, 1), chi(3)), ((1, 0, 1), chi(2)), ((1, 0, 0), chi(1))])
def test_what_noise_alone_shows_of_many_cycles_is_that_of_a_chi_distribution(
    axes: tuple[float, ...], spread: chi
) -> None:
    expected = 2e-5 * (spread.mean() + 3.0 * spread.std())
    assert instrument_repeatability((2e-5 * np.array(axes)) ** 2, 300) == pytest.approx(expected, rel=0.01)


def test_what_noise_alone_shows_of_two_cycles_is_half_their_distance() -> None:
    # Both are as far from their middle: a normal difference of variance 2 per axis, halved, and nothing to add.
    expected = 2e-5 / np.sqrt(2.0) * chi(3).mean()
    assert instrument_repeatability(np.full(3, 4e-10), 2) == pytest.approx(expected, rel=0.04)


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1), st.floats(1e-6, 1e-3))
def test_a_robot_without_error_shows_the_instrument_and_neither_turning_nor_shifting_changes_repeatability(
    seed: int, scale: float
) -> None:
    draw = np.random.default_rng(seed)
    points, shift = scale * draw.standard_normal((12, 3)), draw.standard_normal(3)
    turn = np.linalg.qr(draw.standard_normal((3, 3)))[0]
    sigma = np.full((12, 3), scale)
    one, other = (pose_repeatability(cloud, sigma) for cloud in (points, points @ turn.T + shift))
    assert other.value == pytest.approx(one.value, rel=1e-6)
    assert other.std == pytest.approx(one.std, rel=1e-4)
    assert other.instrument == one.instrument == pytest.approx(3.4 * scale, rel=0.03)


@pytest.mark.slow
def test_stated_uncertainties_are_those_of_campaigns_drawn_again() -> None:
    draw, size, n = np.random.default_rng(1), np.array([3e-5, 5e-5, 2e-5]), 30
    clouds = size * draw.standard_normal((400, n, 3)) + [1e-4, 0.0, -2e-4]
    found = [
        (pose_accuracy(np.zeros(3), c, np.tile(size, (n, 1))), pose_repeatability(c, np.tile(size, (n, 1))))
        for c in clouds
    ]
    for k in range(2):
        values, stds = np.array([(one[k].value, one[k].std) for one in found]).T
        assert np.sqrt((stds**2).mean()) == pytest.approx(values.std(), rel=0.12)
    values = np.array([one[1].value for one in found])
    assert found[0][1].instrument == pytest.approx(values.mean(), rel=0.02)


# Joint positions of five poses of the heavy six; every pose is attained from two directions, in two blocks.
SHIFT, NOISE, PLAY, DRIFT = np.array([3e-4, -4e-4, 0.0]), 1e-5, 2e-4, 1e-4


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> tuple[armflex.Arm, Path]:
    """A campaign in the base frame whose AP, vAP and drift are known: what was added to the rigid tip."""
    folder = tmp_path_factory.mktemp("iso")
    text = (ROBOTS / "heavy_six" / "arm.toml").read_text().partition("[measurement]")[0]
    text = text.replace('urdf = "', f'urdf = "{ROBOTS / "heavy_six"}/') + '[measurement]\nframe = "base"\n'
    (folder / "arm.toml").write_text(text)
    arm = armflex.load_arm(folder / "arm.toml")
    draw, names = np.random.default_rng(5), [f"q_{joint}" for joint in arm.joint_names]
    low, high = np.maximum(arm.robot.lower, -1.5), np.minimum(arm.robot.upper, 1.5)
    poses = low + (high - low) * draw.uniform(0.2, 0.8, (5, len(names)))
    rows = []
    for block in range(2):
        for cycle in range(6):
            side = 1 if cycle % 2 else -1
            for i, q in enumerate(poses):
                tip = np.asarray(arm.deflection(q).rigid_pose.translation)
                seen = tip + SHIFT + [0.0, 0.0, PLAY * side / 2] + np.array([0.6, -0.8, 0.0]) * DRIFT * block
                seen = seen + NOISE * draw.standard_normal(3)
                rows.append([f"P{i + 1}", 3600.0 * block + 60.0 * cycle + i, *q, *[side] * len(q), *seen, NOISE])
    head = ["pose", "time", *names, *(f"approach_{joint}" for joint in arm.joint_names), "x", "y", "z", "sigma"]
    with (folder / "campaign.csv").open("w", newline="") as file:
        csv.writer(file).writerows([head, *rows])
    return arm, folder / "campaign.csv"


def test_a_campaign_in_the_base_frame_gives_back_what_was_put_in(campaign: tuple[armflex.Arm, Path]) -> None:
    arm, path = campaign
    found = armflex.iso9283(arm, armflex.read_measurements(path, arm), block=1800.0)
    assert [(one.pose, one.cycles) for one in found.poses[:2]] == [("P1", 6), ("P1", 6)]
    assert len(found.poses) == 10 and len(found.directions) == 5 and len(found.drifts) == 10
    for one in found.poses:
        assert one.direction is not None and one.accuracy.std is not None
        side = one.direction[0]
        expected = SHIFT + np.array([0.3 * DRIFT, -0.4 * DRIFT, PLAY * side / 2])
        assert one.accuracy.value == pytest.approx(np.linalg.norm(expected), abs=4 * NOISE / np.sqrt(6))
        assert one.offset == pytest.approx(expected, abs=4 * NOISE / np.sqrt(6))
        assert one.rotation is None and one.predicted is None
    for one in found.directions:
        assert one.accuracy == pytest.approx(PLAY, abs=4 * NOISE * np.sqrt(2 / 6)) and one.number == 2
    for one in found.drifts:
        assert one.shift == pytest.approx(DRIFT, abs=5 * NOISE * np.sqrt(2 / 3))
        assert one.accuracy == pytest.approx(DRIFT, abs=5 * NOISE * np.sqrt(2 / 3) + 3e-6)  # along the deviation
    said = " ".join(found.remarks)
    assert "6 cycles of a pose, the standard asks for 30" in said and "rated load" in said
    assert "instrument's place" not in said and "Drift is not given" not in said


def test_a_cycle_without_an_approach_is_excluded_counted_and_named(
    campaign: tuple[armflex.Arm, Path], tmp_path: Path
) -> None:
    """Each cycle goes from the last pose to the first; only the very first comes from nobody knows where."""
    arm, path = campaign
    rows = list(csv.DictReader(path.open(newline="")))
    with (tmp_path / "m.csv").open("w", newline="") as file:
        names = [name for name in rows[0] if not name.startswith("approach_")]
        table = csv.DictWriter(file, names, extrasaction="ignore")
        table.writeheader()
        table.writerows(rows)
    found = armflex.iso9283(arm, armflex.read_measurements(tmp_path / "m.csv", arm))
    assert [(one.cycles, one.excluded) for one in found.poses] == [(11, 1)] + [(12, 0)] * 4
    assert found.excluded == (0,) and found.to_dict()["excluded_rows"] == [0] and found.table[0]["excluded"] == 1
    (said,) = (text for text in found.remarks if "are excluded" in text)
    assert said.startswith("1 of 60 cycles") and said.endswith("m.csv:2.")
    given = armflex.iso9283(arm, armflex.read_measurements(path, arm))
    assert given.excluded == () and not any("are excluded" in text for text in given.remarks)


def test_sessions_from_anywhere_show_the_same_repeatability(campaign: tuple[armflex.Arm, Path], tmp_path: Path) -> None:
    arm, path = campaign
    unknown = tmp_path / "arm.toml"
    unknown.write_text((path.parent / "arm.toml").read_text().replace('frame = "base"', 'frame = "unknown"'))
    here = armflex.read_measurements(path, arm)
    late = here.time > 1800.0
    turn, shift = pin.exp3(np.array([0.3, -0.2, 2.0])), np.array([5.0, -3.0, 0.4])
    session = tuple("second" if one else "first" for one in late)
    moved = np.where(late[:, None], here.position @ turn.T + shift, here.position)
    found = armflex.iso9283(armflex.load_arm(unknown), replace(here, session=session, position=moved))
    still = armflex.iso9283(arm, replace(here, session=session))
    assert len(found.poses) == len(still.poses) == 20 and "instrument's place" in found.remarks[0]
    for one, other in zip(found.poses, still.poses, strict=True):
        assert one.repeatability.value == pytest.approx(other.repeatability.value, rel=1e-9)
        assert one.accuracy is None and one.offset is None  # a frame fitted to them would have most of it
        assert other.accuracy is not None and other.accuracy.placing == 0.0
    assert [one.accuracy for one in found.directions] == pytest.approx([one.accuracy for one in still.directions])


@pytest.mark.slow
def test_the_page_and_the_command_say_the_same(campaign: tuple[armflex.Arm, Path], tmp_path: Path) -> None:
    arm, path = campaign
    given = ["report", str(path.parent / "arm.toml"), str(path), "--iso9283", "--block", "30min"]
    done = CliRunner().invoke(program, [*given, "-o", str(tmp_path / "r.html"), "--json", str(tmp_path / "r.json")])
    assert done.exit_code == 0, done.output
    found = armflex.iso9283(arm, armflex.read_measurements(path, arm), block=1800.0)
    content = json.loads((tmp_path / "r.json").read_text())
    assert [one["ap_m"]["value"] for one in content["poses"]] == [one.accuracy.value for one in found.poses]
    page = (tmp_path / "r.html").read_text()
    assert page == render_report(found) and "<svg" in page and "http" not in page.replace("http://www.w3.org", "")
    assert f"{max(one.accuracy.value for one in found.poses) * 1e3:.3f}"[:4] in page


def test_a_log_and_an_export_are_reported_as_the_campaign_that_they_make(
    campaign: tuple[armflex.Arm, Path], tmp_path: Path
) -> None:
    arm, path = campaign
    with path.open() as file:
        head, *rows = csv.reader(file)
    for name, kept in (("log.csv", head[: head.index("x")]), ("tracker.csv", ["pose", "x", "y", "z"])):
        named = [column if column not in "xyz" else f"{column} [m]" for column in kept]
        with (tmp_path / name).open("w", newline="") as file:
            csv.writer(file).writerows([named, *([row[head.index(column)] for column in kept] for row in rows)])
    files, given = (
        [str(tmp_path / "log.csv"), str(tmp_path / "tracker.csv")],
        [str(path.parent / "arm.toml"), "--iso9283"],
    )
    done = CliRunner().invoke(
        program, ["report", *given, *files, "--sigma", f"{NOISE}m", "--json", str(tmp_path / "r.json")]
    )
    assert done.exit_code == 0, done.output
    found = armflex.iso9283(arm, armflex.read_measurements(path, arm))
    poses = json.loads((tmp_path / "r.json").read_text())["poses"]
    assert [one["rp_m"]["value"] for one in poses] == pytest.approx([one.repeatability.value for one in found.poses])
    refused = CliRunner().invoke(program, ["report", *given, *files])
    assert "2 files: expected one campaign" in str(refused.exception)


@pytest.mark.slow
def test_without_repeats_or_a_standard_the_error_says_so(campaign: tuple[armflex.Arm, Path], tmp_path: Path) -> None:
    arm, path = campaign
    once = tmp_path / "once.csv"
    once.write_text("".join(path.read_text().splitlines(keepends=True)[:6]))
    with pytest.raises(armflex.InputError, match="no pose was measured twice"):
        armflex.iso9283(arm, armflex.read_measurements(once, arm))
    with pytest.raises(armflex.InputError, match=r"block = -1 s: expected a positive time"):
        armflex.iso9283(arm, armflex.read_measurements(path, arm), block=-1.0)


def test_the_place_of_a_fitted_instrument_is_in_the_uncertainty_of_accuracy(tmp_path: Path) -> None:
    """The zero of the upright first joint and the instrument's heading are one; RP knows nothing of either."""
    arm = armflex.load_arm(write_arm(tmp_path))
    path, wrong = write_campaign(tmp_path, 0)
    campaign = armflex.read_measurements(path, arm)
    calibrated = armflex.calibrate(arm, campaign).arm
    rows = np.setdiff1d(np.arange(len(campaign)), sorted(wrong))[:6]
    repeated = campaign.some(np.tile(rows, 3))
    found = armflex.iso9283(calibrated, repeated)
    assert "AP rests on" in found.remarks[0]
    for one in found.poses:
        reach = np.linalg.norm(one.commanded[:2])
        assert one.accuracy is not None and one.accuracy.std is not None and one.accuracy.placing is not None
        assert one.accuracy.std >= one.accuracy.placing and one.accuracy.placing < 4.0 * arm.prior.joint_offset * reach
    most = max(one.accuracy.placing or 0.0 for one in found.poses if one.accuracy)
    assert most > 0.5 * arm.prior.joint_offset * 0.5  # half a metre from the first axis, or more
    open_ = replace(arm, prior=replace(arm.prior, tool=0.3), measurement=replace(arm.measurement, frame="base"))
    for one in armflex.iso9283(open_, repeated).poses:
        assert one.accuracy is not None and one.accuracy.placing == pytest.approx(0.3)
