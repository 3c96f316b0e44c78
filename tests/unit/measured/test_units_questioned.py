"""Degrees that look like radians and the reverse are questioned before anything is computed with them."""

import re
import warnings
from pathlib import Path

import numpy as np
import pytest
from support.campaign_files import write_columns
from support.command_line import fine, run_here, strict_json
from support.small_arms import ROBOTS, write
from support.two_links import GOOD, declared

from armflex import Arm, load_arm, read_measurements, read_trajectory
from armflex.errors import ArmflexWarning, JointLimitError, MissingCovariateError, TableError
from armflex.laws import Row
from armflex.measured.measurements import stream_inputs

HEAVY = ROBOTS / "heavy_six" / "arm.toml"


def rows(folder: Path, arm: Arm, written: np.ndarray, unit: str = "") -> Path:
    """Write (N, nq) joint positions as they are, under headers with a unit."""
    columns = {"time": list(range(len(written)))}
    columns |= {f"q_{name}{unit}": written[:, i].tolist() for i, name in enumerate(arm.joint_names)}
    write_columns(folder / "rows.csv", columns)
    return folder / "rows.csv"


def moving(arm: Arm, size: float) -> np.ndarray:
    """Return (9, nq) positions through the limits' middle, as far as a size on either side."""
    return np.linspace(-size, size, 9)[:, None] * np.linspace(0.4, 1.0, len(arm.joint_names))


@pytest.mark.parametrize("size", [40.0, 10.0])
@pytest.mark.parametrize("command", ["check", "compensate", "predict"])
def test_degrees_for_radians_are_an_error_of_every_command(
    heavy: Arm, tmp_path: Path, command: str, size: float
) -> None:
    """40 rad are far beyond any limit, 10 rad are beyond it: both are asked about."""
    path = rows(tmp_path, heavy, moving(heavy, size))
    options = {"check": ["--tolerance", "1mm"]}.get(command, ["-o", "out.csv"])
    failed = 1 if command == "check" and size == 10.0 else 2  # what is outside the limits fails a check
    found = fine(run_here(tmp_path, command, HEAVY, path, *options), failed)
    assert re.search(r"(rows\.csv:2|row 0|at 0 s).*limits.*deg\?", found.stderr.replace("\n", " ")), found.stderr
    assert "_deg" in found.stderr and not (tmp_path / "out.csv").exists()


def test_one_position_in_degrees_is_asked_about(heavy: Arm) -> None:
    with pytest.raises(JointLimitError, match=r"joint 'J2' at 45 .*: deg\? Then say so, 45deg or a column q_J2_deg"):
        heavy.deflection(np.array([0.0, 45.0, 0, 0, 0, 0]))
    with pytest.raises(
        JointLimitError, match=r"outside its limits \[[^]]*\] rad \((.*) outside \[(.*)\] deg\)$"
    ) as told:
        heavy.deflection(np.array([0.0, 5.0, 0, 0, 0, 0]))
    limits = np.degrees([heavy.robot.lower[1], heavy.robot.upper[1]])
    assert f"({np.degrees(5.0):.6g} outside [{limits[0]:.6g}, {limits[1]:.6g}] deg)" in str(told.value)


def test_radians_for_degrees_are_asked_about(heavy: Arm, tmp_path: Path) -> None:
    path = rows(tmp_path, heavy, moving(heavy, 1.2), "_deg")
    with pytest.warns(ArmflexWarning, match=r"rows\.csv:1: no joint is beyond 1\.2 deg.*: radians\? .*q_J1 \.\. q_J6"):
        read_trajectory(path, heavy)
    assert [flag.code for flag in read_measurements(path, heavy, inputs_only=True).flags] == ["radians"]
    shown = fine(run_here(tmp_path, "predict", HEAVY, path, "-o", "out.csv"))
    assert "radians?" in shown.stderr


@pytest.mark.parametrize(("size", "unit"), [(1.0, ""), (35.0, "_deg"), (0.1, "_deg")])
def test_what_can_be_meant_is_not_asked_about(heavy: Arm, tmp_path: Path, size: float, unit: str) -> None:
    path = rows(tmp_path, heavy, moving(heavy, size), unit)
    with warnings.catch_warnings():
        warnings.simplefilter("error", ArmflexWarning)
        read_trajectory(path, heavy)
    assert read_measurements(path, heavy, inputs_only=True).flags == ()


@pytest.mark.parametrize(("said", "asked"), [("J2=1.57deg", True), ("J2=-0.785deg", True), ("J2=1.5deg", False),
                                             ("J2=30deg", False), ("J2=1.05", False)])  # fmt: skip
def test_parts_of_pi_in_degrees_are_asked_about(tmp_path: Path, said: str, asked: bool) -> None:
    shown = fine(run_here(tmp_path, "deflect", HEAVY, "--q", said))
    assert ("of pi as a number: radians?" in shown.stderr) == asked


@pytest.mark.parametrize("command", ["deflect", "view", "map", "export", "plan"])
def test_a_joint_that_cannot_be_at_zero_is_taken_in_the_middle_and_that_is_said(tmp_path: Path, command: str) -> None:
    path = declared(tmp_path)
    write(tmp_path, GOOD.replace('lower="-2" upper="2.1"', 'lower="0.5" upper="2.1"'))
    options = {
        "deflect": [],
        "view": ["-o", "page.html"],
        "map": ["-o", "map.csv", "--rows", "64", "--voxel", "500mm"],
        "export": ["--to", "sheet", "-o", "s.csv"],
        "plan": ["--rows", "8", "-o", "poses.csv"],
    }[command]
    shown = fine(run_here(tmp_path, command, path, *options, *(["--json", "o.json"] if command == "deflect" else [])))
    if command in ("deflect", "view"):
        assert "joint 'elbow': 0 is outside its limits [0.5, 2.1]; it is taken at 1.3" in shown.stderr
    if command == "deflect":
        assert strict_json(tmp_path / "o.json")["q"] == [0.0, 1.3]


def test_millimetres_for_metres_on_a_slide(tmp_path: Path) -> None:
    arm = load_arm(ROBOTS / "tarm_like" / "arm.toml")
    with pytest.raises(JointLimitError, match=r"joint 'M1' at 900 is .*: mm\? Then say so, 900mm or a column q_M1_mm"):
        arm.check_position([900.0, *[0.0] * 6])


def test_a_trajectory_far_beyond_its_limits_names_its_line(heavy: Arm, tmp_path: Path) -> None:
    with pytest.raises(TableError, match=r"rows\.csv:2: q_J\d is -?\d+.* deg\? Then name the column q_J\d_deg"):
        read_trajectory(rows(tmp_path, heavy, moving(heavy, 90.0)), heavy)


@pytest.mark.parametrize("first", ["time", "pose"])
def test_a_number_far_beyond_its_limits_is_named_as_written_and_in_its_own_unit(
    heavy: Arm, tmp_path: Path, first: str
) -> None:
    """The unit that a header states is not offered once more, wherever the rows are read."""
    header = ",".join([first, *(f"q_{name}_deg" for name in heavy.joint_names)])
    path = tmp_path / "rows.csv"
    path.write_text(f"{header}\n0,2000,1500,900,0,0,0\n1,2100,1500,900,0,0,0\n")
    with pytest.raises(
        TableError, match=r"q_J1 is 2000 deg \(limits -175 to 175; 2 rows\): in .*Then convert it to deg"
    ):
        if first == "time":
            read_trajectory(path, heavy)
        else:
            list(stream_inputs(path, heavy, 1))


def test_what_every_row_has_is_not_called_given() -> None:
    row = Row(np.zeros(1), {"J1": 0}, {"oil": np.zeros(()), "payload_mass": np.zeros(()), "approach_J1": np.zeros(())})
    with pytest.raises(MissingCovariateError, match=r"\(given: oil\)"):
        row.covariate("temperature")
