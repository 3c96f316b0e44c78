"""What is recorded beside readings: columns of joints with long names, dates, rows beyond a limit."""

from pathlib import Path

import numpy as np
import pytest
from support.small_arms import arm_of, joint, link, random_compliance

from armflex import Arm
from armflex.errors import TableError
from armflex.measured.joined import joined
from armflex.measured.measurements import read_measurements, stream_inputs
from armflex.show.report.cover import dates
from armflex.tasks.predict import predict, predict_file
from armflex.trajectory import read_trajectory

LONG = ("shoulder_pan_joint", "shoulder_lift_joint")


@pytest.fixture
def long(tmp_path: Path) -> Arm:
    """An arm whose joints have long names, and limits of 3 rad."""
    parts = [
        link("base"),
        joint(LONG[0], "base", "upper", axis=(0, 0, 1)),
        link("upper", 2.0, (0.2, 0, 0)),
        joint(LONG[1], "upper", "tool", (0.5, 0, 0)),
        link("tool", 1.0, (0.3, 0, 0)),
    ]
    return arm_of(tmp_path, parts, "tool", {name: random_compliance(i) for i, name in enumerate(LONG)})


def campaign(path: Path, names: str = "", cells: str = "", times: tuple[object, ...] = (0, 1, 2)) -> Path:
    head = f"time,q_{LONG[0]},q_{LONG[1]},x,y,z,sigma{names}"
    path.write_text("\n".join([head, *(f"{time},0.{i},0.{i + 1},1,2,3,1e-4{cells}" for i, time in enumerate(times))]))
    return path


def path_of(path: Path, name: str) -> Path:
    head = f"time,q_{LONG[0]},q_{LONG[1]},{name}"
    path.write_text("\n".join([head, *(f"{i},0.{i},0.{i + 1},7" for i in range(3))]))
    return path


@pytest.mark.parametrize("word", ["speed", "tau", "temp", "current", "qd", "vel", "sigma", "load_side"])
def test_every_column_of_a_joint_is_a_possible_cause(long: Arm, tmp_path: Path, word: str) -> None:
    for name in (f"{word}_{LONG[0]}", f"{word}_{LONG[0]}_filtered"):
        found = read_measurements(campaign(tmp_path / "rows.csv", f",{name}", ",7"), long)
        assert found.covariates[name].tolist() == [7.0] * 3
        assert name in read_trajectory(path_of(tmp_path / "path.csv", name), long).covariates


@pytest.mark.parametrize(
    "name",
    [
        "q_shoulder_pan_jiont",
        "q_shoulder_pan_joint_dge",
        "Q_shoulder_pan_joint",
        "q-shoulder_pan_joint",
        "target_shoulder_pan_jiont",
        "traget_shoulder_lift_joint",
        "paylod",
    ],
)
def test_a_column_that_is_misspelt_is_still_refused(long: Arm, tmp_path: Path, name: str) -> None:
    with pytest.raises(TableError, match=f"rows.csv:1: .*'{name}"):
        read_measurements(campaign(tmp_path / "rows.csv", f",{name}", ",7"), long)
    with pytest.raises(TableError, match=f"path.csv:1: .*'{name}"):
        read_trajectory(path_of(tmp_path / "path.csv", name), long)
    for other in ("aproach_shoulder_pan_joint", "approach_shoulder_pan_jiont"):
        with pytest.raises(TableError, match=f"rows.csv:1: .*'{other}"):
            read_measurements(campaign(tmp_path / "rows.csv", f",{other}", ",1"), long)


def test_joints_of_a_gripper_in_the_log_are_left_out(long: Arm, tmp_path: Path) -> None:
    """A bag has them; of a path they are refused, as the arm cannot drive there."""
    found = read_measurements(campaign(tmp_path / "rows.csv", ",q_finger_l", ",7"), long)
    assert not found.covariates
    (flag,) = (flag for flag in found.flags if flag.code == "other_joint")
    assert "q_finger_l is of no joint of this arm, and left out" in flag.text
    with pytest.raises(TableError, match=r"'q_finger_l': the arm's joints are shoulder_pan_joint"):
        read_trajectory(path_of(tmp_path / "path.csv", "q_finger_l"), long)


def test_time_may_be_a_date(long: Arm, tmp_path: Path) -> None:
    days = ("2026-03-09 23:59:50", "2026-03-09T23:59:40", "2026-03-10T00:00:00.5")
    found = read_measurements(campaign(tmp_path / "rows.csv", times=days), long)
    assert found.time.tolist() == [10.0, 0.0, 20.5]
    assert dates(found) == "2026-03-09 to 2026-03-10"
    later = read_measurements(campaign(tmp_path / "later.csv", times=("2026-05-01", "2026-05-02", "2026-05-03")), long)
    assert later.time.tolist() == [0.0, 86400.0, 172800.0]
    assert dates(joined([found, later], long)) == "2026-03-09 to 2026-05-03"
    pieces = list(stream_inputs(tmp_path / "rows.csv", long, 1))
    assert np.concatenate([one.time for one in pieces]).tolist() == [10.0, 0.0, 20.5]
    east = ("2026-03-09T01:00:00+01:00", "2026-03-09T00:00:30Z", "2026-03-09T00:01:00+00:00")
    assert read_measurements(campaign(tmp_path / "rows.csv", times=east), long).time.tolist() == [0.0, 30.0, 60.0]
    plain = read_measurements(campaign(tmp_path / "rows.csv"), long)
    assert plain.dates == () and dates(plain).startswith("not recorded")


@pytest.mark.parametrize(
    ("times", "text"),
    [
        (("2026-03-09", "2026-03-32", "2026-03-10"), "rows.csv:3: column 'time' is '2026-03-32', expected a date"),
        (("2026-03-09", "5", "6"), "rows.csv:3: column 'time' is '5', expected a date"),
        (("5", "2026-03-09", "6"), "rows.csv:3: column 'time' is '2026-03-09', not a finite number"),
        (("2026-03-09T10:00", "2026-03-09T10:00Z", "2026-03-10"), "rows.csv:3: .*only some rows say how far"),
    ],
)
def test_a_time_that_is_no_date_is_refused(long: Arm, tmp_path: Path, times: tuple[str, ...], text: str) -> None:
    with pytest.raises(TableError, match=text):
        read_measurements(campaign(tmp_path / "rows.csv", times=times), long)


def test_units_may_be_mixed_where_headers_say_so(long: Arm, tmp_path: Path) -> None:
    plain = read_measurements(campaign(tmp_path / "rows.csv"), long)
    text = (tmp_path / "rows.csv").read_text().replace("x,y,z", "x_mm,y,z_mm").replace(",1,2,3,", ",1000,2,3000,")
    (tmp_path / "mixed.csv").write_text(text)
    assert read_measurements(tmp_path / "mixed.csv", long).position.tolist() == plain.position.tolist()


def test_a_row_that_was_measured_beyond_a_limit_is_predicted(long: Arm, tmp_path: Path) -> None:
    path = tmp_path / "rows.csv"
    path.write_text(f"q_{LONG[0]},q_{LONG[1]}\n3.01,0.1\n3.09,0.1\n0,-3.01\n")
    found = predict(long, path)
    assert np.isfinite(found.position).all() and len(found.position) == 3
    flag = next(flag for flag in found.flags if flag.code == "outside_limits")
    assert flag.text.startswith(f"{path}:3: joint 'shoulder_pan_joint' at 3.09 is outside its limits [-3, 3]")
    assert flag.text.endswith("(the worst of 3 rows)")
    rows, flags = predict_file(long, path, tmp_path / "out.csv")
    assert rows == 3 and flag in flags
