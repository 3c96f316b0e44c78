"""Campaigns in another convention than their arm's are named before anything is fitted, and clean ones are not."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.campaigns import draw
from support.command_line import Run, fine
from support.misread_campaigns import boom, exchanged_targets, faults, judged, silent, ur5, with_targets
from support.small_arms import ROBOTS, three_joints

from armflex import calibrate, load_arm, read_measurements
from armflex.arm import Arm, Measurement, Prior
from armflex.errors import ConventionError, SmallDisplacementError
from armflex.estimate.misreadings import misreadings
from armflex.laws.joint.linear import LinearLaw
from armflex.measured.measurements import Measurements
from armflex.readings import Position, Readings
from armflex.rows import Rows

SOME = 90
"""Rows of a campaign that are enough here."""


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> tuple[Arm, Measurements]:
    """A machine of the plant; faults of a boom and of a UR5 stand below."""
    truth = draw("none", seed=3, arm="six").write(tmp_path_factory.mktemp("six"))
    arm = load_arm(truth.arm)
    return arm, read_measurements(truth.train, arm).some(np.arange(SOME))


def test_a_campaign_as_it_was_written_is_not_accused(campaign: tuple[Arm, Measurements]) -> None:
    assert judged(*campaign) == ()


@pytest.mark.slow
def test_every_fault_is_named(campaign: tuple[Arm, Measurements]) -> None:
    said = {fault.named: judged(*fault.written(*campaign)) for fault in faults(campaign[0])}
    assert len(said) >= 11
    assert {named for named, names in said.items() if not any(named in name for name in names)} == set()
    rigid = {fault.named for fault in faults(replace(campaign[0], flexures=()))}
    assert said.keys() - rigid == {f"the compliance is a thousand times too {how}" for how in ("large", "small")}


def test_exchanged_payloads_are_named(campaign: tuple[Arm, Measurements]) -> None:
    arm, rows = campaign
    light, *_, heavy = sorted(set(rows.payload), key=lambda name: arm.payloads[name].mass)
    names = {light: heavy, heavy: light}
    wrong = replace(rows, payload=tuple(names.get(name, name) for name in rows.payload))
    one, other = sorted(names)
    assert judged(arm, wrong)[0] == f"the payloads {one!r} and {other!r} are exchanged"


def test_readings_in_another_frame_than_the_base_are_named(campaign: tuple[Arm, Measurements]) -> None:
    arm, rows = campaign
    in_base = replace(arm, measurement=replace(arm.measurement, frame="base"))
    assert judged(in_base, rows) == ("x, y, z are not in the arm's base frame",)


def test_a_left_handed_frame_is_named_where_a_far_target_hides_it(campaign: tuple[Arm, Measurements]) -> None:
    arm, rows = campaign
    arm = replace(arm, prior=replace(arm.prior, tool=1.0))
    tip, own = arm.deflection(rows.q, rows.payload).pose, arm.robot.reach * np.array([0.1, -0.05, 0.1])
    assert isinstance(tip, np.ndarray)
    position = tip[:, :3, 3] + tip[:, :3, :3] @ own
    assert judged(arm, replace(rows, position=position)) == ()
    wrong = replace(rows, position=position[:, [1, 0, 2]])
    with pytest.raises(ConventionError, match="left-handed frame's"):
        calibrate(arm, wrong)


def test_readings_of_other_poses_are_no_arms(campaign: tuple[Arm, Measurements]) -> None:
    arm, rows = campaign[0], campaign[1].some(np.unique(campaign[1].pose_number, return_index=True)[1])
    mixed = replace(rows, position=rows.position[np.random.default_rng(0).permutation(len(rows))])
    with pytest.raises(ConventionError, match="no defect of an arm is so large") as caught:
        calibrate(arm, mixed)
    assert caught.value.names == ()


@pytest.mark.slow
def test_what_is_meant_is_taken_as_it_is_written(campaign: tuple[Arm, Measurements]) -> None:
    arm, rows = campaign
    soft = next(fault for fault in faults(arm) if "too small" in fault.named).written(arm, rows)
    with pytest.raises(ConventionError, match=r"thousand times too small\? Then .* mm off: give it in rad/Nm"):
        calibrate(*soft)
    taken = calibrate(*soft, anyway=True)
    assert taken.rms > 0.0 and "thousand times too small" in next(f.text for f in taken.flags if f.code == "convention")


@pytest.mark.slow
def test_the_command_line_says_so_and_writes_nothing(armflex: Run, tmp_path: Path) -> None:
    lines = (ROBOTS / "tarm_like" / "campaign.csv").read_text().splitlines()
    head = lines[0].replace("q_A2", "q_?").replace("q_A3", "q_A2").replace("q_?", "q_A3")
    (tmp_path / "wrong.csv").write_text("\n".join([head, *lines[1:101]]) + "\n")
    for command in ("calibrate", "trace"):
        refused = fine(armflex(command, ROBOTS / "tarm_like" / "measured.toml", "wrong.csv", "-o", "out.toml"), 2)
        assert "columns q_A2 and q_A3 are exchanged" in refused.stderr.replace("\n", " ")
        assert "--anyway" in refused.stderr
        assert not (tmp_path / "out.toml").exists()


QUICK = ("tracker jumps 50 mm", "target moved 10 mm", "inches in x_mm, half of the rows", "orientation transposed",
         "Euler xyz as rotation vector", "frame = base, turned by 180")  # fmt: skip
SLOWER = ("gravity y", "payload empty in half of the rows", "sign of A4 in one session", "x and y in one session",
          "all joints mirrored", "mm as x y z", "radians under rx_deg")  # fmt: skip


@pytest.mark.parametrize("title", QUICK)
def test_a_fault_of_the_instrument_is_named(title: str) -> None:
    arm, rows = ur5()
    fault = next(one for one in silent(arm, rows) if one.title == title)
    assert fault.named in judged(*fault.written(arm, rows))[0]


@pytest.mark.slow
@pytest.mark.parametrize("title", SLOWER)
@pytest.mark.filterwarnings("ignore:Gimbal lock:UserWarning")
def test_a_fault_of_a_boom_is_named(title: str) -> None:
    arm, rows = boom()
    fault = next(one for one in silent(arm, rows) if one.title == title)
    assert fault.named in judged(*fault.written(arm, rows))[0]


@pytest.mark.slow
def test_two_targets_whose_columns_are_exchanged_are_named() -> None:
    arm, rows = with_targets(*ur5())
    (fault,) = exchanged_targets(arm, rows)
    assert judged(arm, rows) == ()
    assert fault.named in judged(*fault.written(arm, rows))[0]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["slip_step", "payload_mass"])
def test_an_effect_of_millimetres_is_no_convention(kind: str) -> None:
    assert judged(*boom(kind, 8)) == ()
    assert judged(*ur5(wave=4e-3)) == ()


@pytest.mark.slow
@pytest.mark.parametrize("seed", [999, 1000])
def test_an_instrument_set_up_again_is_no_wrong_payload(seed: int, tmp_path: Path) -> None:
    """Sessions are as free in the campaign as written as in a hypothesis about its loads."""
    truth = draw("session_frame", seed, "six").write(tmp_path)
    arm = load_arm(truth.arm)
    assert judged(arm, read_measurements(truth.train, arm)) == ()


def test_two_readings_in_each_others_row_are_called_exchanged() -> None:
    arm, rows = ur5()
    position = rows.position.copy()
    position[[30, 100]] = position[[100, 30]]
    found = calibrate(arm, replace(rows, position=position))
    assert {(one.row, one.kind) for one in found.outliers} == {(30, "exchanged"), (100, "exchanged")}
    fellows = {one.row: one.fellow for one in found.outliers}
    assert fellows == {row: f"line {rows.places[other].line}" for row, other in ((30, 100), (100, 30))}


def test_two_targets_exchanged_in_one_row_are_called_so() -> None:
    arm, rows = with_targets(*ur5())
    first, second = (next(one for one in rows.readings.kinds if one.name == name) for name in ("smr1", "smr2"))
    one, other = first.values.copy(), second.values.copy()
    one[40], other[40] = second.values[40], first.values[40]
    kinds = {"smr1": replace(first, values=one), "smr2": replace(second, values=other)}
    readings = replace(rows.readings, kinds=tuple(kinds.get(kind.name, kind) for kind in rows.readings.kinds))
    found = calibrate(arm, replace(rows, readings=readings))
    assert {(each.row, each.kind, each.instrument, each.fellow) for each in found.outliers} == {
        (40, "exchanged", "smr1", "smr2"),
        (40, "exchanged", "smr2", "smr1"),
    }


def test_nothing_is_written_where_readings_scatter_a_hundred_times_as_stated(armflex: Run, tmp_path: Path) -> None:
    lines = (ROBOTS / "tarm_like" / "campaign.csv").read_text().splitlines()[:101]
    place = lines[0].split(",").index("sigma")
    cells = [line.split(",") for line in lines[1:]]
    text = [",".join([*row[:place], "1e-6", *row[place + 1 :]]) for row in cells]
    (tmp_path / "rows.csv").write_text("\n".join([lines[0], *text]) + "\n")
    asked = ("calibrate", ROBOTS / "tarm_like" / "measured.toml", "rows.csv", "-o", "out.toml")
    refused = fine(armflex(*asked), 2).stderr.replace("\n", " ")
    assert "times as much" in refused and "--anyway" in refused and not (tmp_path / "out.toml").exists()
    fine(armflex(*asked, "--anyway"))
    assert (tmp_path / "out.toml").exists()


def levelled(folder: Path, softness: float, sigma: np.ndarray) -> tuple[Arm, Measurements]:
    """Return three joints whose compliances are a fifth off, and what was read of them in their base, within sigma."""
    laws = [LinearLaw(factor * np.diag([0.0, 0.0, 0.0, *[softness] * 3]), relative_std=0.2) for factor in (1.0, 1.2)]
    arm = three_joints(folder, [laws[0]] * 3)
    real = replace(arm, flexures=tuple(replace(one, law=laws[1]) for one in arm.flexures))
    arm = replace(arm, measurement=Measurement("base"), prior=Prior(joint_offset=1e-3, compliance=0.2))
    rng = np.random.default_rng(5)
    q = rng.uniform(-0.5, 0.5, (40, 3))
    tips = np.asarray(real.deflection(q + 1e-3, enforce_limits=False, allow_large=True).pose)[:, :3, 3]
    read = Position(tips + rng.normal(0.0, np.minimum(sigma, 1e-3), (40, 3)), np.broadcast_to(sigma, (40, 3)).copy())
    return arm, Measurements.of(Rows.of(arm.joint_names, q, ["none"] * 40, {}), Readings(40, (read,)))


def test_heights_by_a_fine_level_are_not_accused(tmp_path: Path) -> None:
    assert judged(*levelled(tmp_path, 1e-4, np.array([1e3, 1e3, 1e-5]))) == ()


def test_of_columns_that_nobody_read_no_convention_is_thought_of(tmp_path: Path) -> None:
    arm, rows = levelled(tmp_path, 1e-4, np.array([np.inf, 1e-5, np.inf]))
    every = list(misreadings(arm, rows))
    (remedy,) = (one.remedy for one in every if one.name == "y is in mm, read as m")
    assert remedy == "write the unit into the header: y_mm"
    said = " ".join(f"{one.name} {one.remedy}" for one in every if one.of == "points" and "q_" not in one.name)
    assert "alone" not in said and not re.search(r"\b[xz](?:\b|_)", said)


def test_an_arm_that_bends_further_than_a_compliance_describes_is_refused_by_that_name(tmp_path: Path) -> None:
    arm, rows = levelled(tmp_path, 2e-4, np.full(3, 2e-4))
    with pytest.raises(SmallDisplacementError, match=r"more than the 0\.1 rad"):
        calibrate(arm, rows)
