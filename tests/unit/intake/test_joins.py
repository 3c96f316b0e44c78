"""`intake`: what is of one another in two files, and what is asked where that is not certain."""

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from armflex import load_arm
from armflex.errors import InputError, TableError
from armflex.intake import intake
from armflex.intake.names import paired_names
from armflex.robot.robot import Robot

COUNT = 12
TEXTS = sorted(range(1, COUNT + 1), key=str)
"""1 10 11 12 2 ..: as a program sorts that takes numbers for texts."""
MIXED = (7, 3, 12, 1, 9, 5, 2, 11, 8, 4, 10, 6)
"""As somebody measures who does not want to see a drift as a place."""


def log(path: Path, names: Sequence[str], header: str = "Pose") -> Path:
    """Write a log whose joint J1 is at as many degrees as the number of its row."""
    path.write_text(f"{header},J1 [deg],J2 [deg]\n" + "".join(f"{one},{i},-90\n" for i, one in enumerate(names, 1)))
    return path


def export(path: Path, names: Sequence[str], order: Sequence[int], more: str = "", cells: Sequence[str] = ()) -> Path:
    """Write points whose x is as many mm as the row that they are of."""
    rows = [f"{name},{i},0,5{cell}" for name, i, cell in zip(names, order, cells or [""] * len(names), strict=True)]
    path.write_text("\n".join([f"Name,X [mm],Y [mm],Z [mm]{more}", *rows]))
    return path


@pytest.mark.parametrize(
    ("of_rows", "of_points"),
    [
        ("P{:02d}", "P{}"),
        ("P{}", "p{}"),
        ("pose_{}", "Pt_{}"),
        ("{}", "P{:03d}"),
        ("{}", "{}.0"),
        ("P{}", "M{}"),
        ("P{}", "A::Main::P{}"),
        ("Pose {}", "2024-11-03/Station 1/POSE-{:04d}"),
    ],
)
@pytest.mark.parametrize("order", [TEXTS, range(COUNT, 0, -1)])
def test_names_that_differ_in_writing_alone_are_of_one_another(
    tmp_path: Path, of_rows: str, of_points: str, order: Sequence[int]
) -> None:
    rows = log(tmp_path / "log.csv", [of_rows.format(i) for i in range(1, COUNT + 1)])
    points = export(tmp_path / "export.csv", [of_points.format(i) for i in order], order)
    found = intake([rows, points], 5e-5)
    assert found.columns["x"] == pytest.approx(1e-3 * np.arange(1, COUNT + 1))
    assert found.joined.startswith("by ")


@pytest.mark.parametrize(
    ("of_rows", "of_points"),
    [
        ([f"P{i}" for i in range(6)], [f"M{i}" for i in range(1, 7)]),
        ([str(i) for i in range(6)], [str(i) for i in range(1, 7)]),
        ([f"L1_P{i}" for i in range(6)], [f"L2_P{i}" for i in range(6)]),
        ([f"A{i}" for i in range(6)], ["one", "two", "three", "four", "five", "six"]),
        (list("abcdef"), [f"P{i}" for i in range(6)]),
        ([f"P{i}" for i in (1, 2, 3, 4, 5, 7)], [f"M{i}" for i in (1, 2, 3, 4, 5, 6)]),
    ],
)
def test_names_that_do_not_match_are_no_order(tmp_path: Path, of_rows: list[str], of_points: list[str]) -> None:
    paths = [log(tmp_path / "log.csv", of_rows), export(tmp_path / "export.csv", of_points, range(1, 7))]
    with pytest.raises(TableError, match=r"which is of which is not certain.*--take 'Pose=unused'"):
        intake(paths, 5e-5)
    assert intake(paths, 5e-5, {"Pose": "unused"}).columns["x"] == pytest.approx(1e-3 * np.arange(1, 7))


@pytest.mark.parametrize("twice", ["export", "log"])
def test_a_name_that_one_file_repeats_is_of_no_certain_row(tmp_path: Path, twice: str) -> None:
    """The point was measured again, or the pose was driven to again: nothing says which counts."""
    once, again = ["P1", "P2", "P3", "P4"], ["P1", "P2", "P3", "P2", "P4"]
    of_row, of_point = (again, once) if twice == "log" else (once, again)
    rows = log(tmp_path / "log.csv", of_row)
    points = export(tmp_path / "export.csv", of_point, range(1, len(of_point) + 1))
    with pytest.raises(TableError, match=r"export.csv:\d: point 'P2' stands in .*lines.* of which row is not known"):
        intake([rows, points], 5e-5)


def test_a_name_that_both_files_repeat_is_taken_in_order(tmp_path: Path) -> None:
    names = ["P1", "P2", "P3", "P2", "P4"]
    points = export(tmp_path / "export.csv", names, range(1, 6))
    assert intake([log(tmp_path / "log.csv", names), points], 5e-5).columns["x"] == pytest.approx(
        1e-3 * np.arange(1, 6)
    )


def test_points_that_a_program_sorted_are_no_order(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("J1 [deg],J2 [deg]\n" + "".join(f"{i * i},-90\n" for i in range(1, COUNT + 1)))
    points = export(tmp_path / "export.csv", [f"P{i}" for i in TEXTS], TEXTS)
    with pytest.raises(TableError, match=r"called P1, P10, P11.*log.csv has no names.*--take 'Name=unused'"):
        intake([tmp_path / "log.csv", points], 5e-5)


@pytest.mark.parametrize(
    ("of_rows", "of_points", "unused"),
    [
        ([str(i) for i in range(COUNT)], [f"P{i}" for i in MIXED], "Name"),
        ([str(i) for i in range(1, COUNT + 1)], [str(10 * i) for i in MIXED], "Name"),
        ([f"P{i}" for i in TEXTS], None, "Pose"),
    ],
)
def test_numbers_that_do_not_ascend_are_no_order(
    tmp_path: Path, of_rows: list[str], of_points: list[str] | None, unused: str
) -> None:
    """A log that only counts its rows, or an export without names, says nothing against another order."""
    rows = log(tmp_path / "log.csv", of_rows, "Pose" if of_points is None else "Nr")
    points = export(tmp_path / "export.csv", of_points or of_rows, MIXED)
    if of_points is None:
        points.write_text("".join(line.partition(",")[2] for line in points.read_text().splitlines(keepends=True)))
    with pytest.raises(TableError, match=rf"which is of which is not certain.*--take '{unused}=unused'"):
        intake([rows, points], 5e-5)


def test_counts_that_went_through_a_spreadsheet(tmp_path: Path) -> None:
    rows = log(tmp_path / "log.csv", [str(i) for i in range(1, COUNT + 1)])
    points = export(tmp_path / "export.csv", [f"{i:.3e}" for i in MIXED], MIXED)
    assert intake([rows, points], 5e-5).columns["x"] == pytest.approx(1e-3 * np.arange(1, COUNT + 1))


def test_clocks_outweigh_the_order_of_rows(tmp_path: Path) -> None:
    rows = "".join(f"10:00:{3 * i:02d},{i},-90\n" for i in range(1, 7))
    (tmp_path / "log.csv").write_text(f"time,J1 [deg],J2 [deg]\n{rows}")
    order = (3, 1, 2, 6, 5, 4)
    text = "Zeit,X [mm],Y [mm],Z [mm]\n" + "".join(f"10:00:{3 * i:02d},{i},0,5\n" for i in order)
    (tmp_path / "export.csv").write_text(text)
    found = intake([tmp_path / "log.csv", tmp_path / "export.csv"], 5e-5)
    assert found.columns["x"] == pytest.approx(1e-3 * np.arange(1, 7))


UNEVEN = np.cumsum(np.random.default_rng(1).uniform(20.0, 60.0, COUNT))
EVEN = 60.0 * np.arange(COUNT)


def timed(folder: Path, at: np.ndarray, of: np.ndarray, order: Sequence[int]) -> list[Path]:
    """Write a log of poses at times [s], and points at others, of the rows in an order."""
    rows = "".join(f"{t:.2f},{i + 1},-90\n" for i, t in enumerate(at))
    (folder / "log.csv").write_text(f"time [s],J1 [deg],J2 [deg]\n{rows}")
    points = "".join(f"{of[i]:.2f},{i + 1},0,5\n" for i in order)
    (folder / "export.csv").write_text(f"time [s],X [mm],Y [mm],Z [mm]\n{points}")
    return [folder / "log.csv", folder / "export.csv"]


@pytest.mark.parametrize(
    "order",
    [[0, 1, *range(3, COUNT)], range(1, COUNT), range(COUNT - 1), range(COUNT - 1, -1, -1)],
    ids=["one lost", "first lost", "last lost", "reversed"],
)
@pytest.mark.parametrize(("at", "after"), [(UNEVEN, 2.0), (UNEVEN, 37.0), (UNEVEN, 3602.0), (EVEN, 2.0)])
def test_a_point_is_of_the_row_before_it_whatever_the_clock(
    tmp_path: Path, at: np.ndarray, after: float, order: Sequence[int]
) -> None:
    found = intake(timed(tmp_path, at, at + after, order), 5e-5)
    x = [float(cell) if cell != "" else None for cell in found.columns["x"]]
    assert x == [pytest.approx(1e-3 * (i + 1)) if i in order else None for i in range(COUNT)]


def test_even_rows_of_which_an_end_is_lost_are_of_no_certain_point(tmp_path: Path) -> None:
    with pytest.raises(TableError, match=r"clocks may be \+36.2 s or \+36.2 s apart, as rows are 60 s apart evenly"):
        intake(timed(tmp_path, EVEN, EVEN + 3602.0, range(1, COUNT)), 5e-5)


def test_a_second_point_of_a_row_is_said(tmp_path: Path) -> None:
    paths = timed(tmp_path, UNEVEN, UNEVEN + 2.0, range(COUNT))
    paths[1].write_text(paths[1].read_text() + f"{UNEVEN[3] + 3.0:.2f},4.1,0,5\n")
    found = intake(paths, 5e-5)
    assert found.columns["x"] == pytest.approx(1e-3 * np.arange(1, COUNT + 1))
    assert any("1 points of export.csv belong to no row (line 14)" in note for note in found.notes)


def test_keys_are_those_of_most_rows() -> None:
    found = paired_names(["P01", "P02", "P10"], ["P1", "P2", "P10"])
    assert found is not None and found.rows == found.points and not found.numbered
    assert paired_names(["A1", "B1"], ["1", "2"]) is None


TURNS = Rotation.from_rotvec(np.random.default_rng(3).uniform(-1.5, 1.5, (6, 3)))


@pytest.mark.parametrize(
    "header",
    ["qw,qx,qy,qz", "quat_w,quat_x,quat_y,quat_z", "Q0,Qx,Qy,Qz", "q_w,q_x,q_y,q_z", "RW,RX,RY,RZ", "e0,e1,e2,e3"],
)
def test_a_quaternion_is_known_by_its_length(tmp_path: Path, header: str) -> None:
    four = [",".join(["", *map(str, np.roll(one, 1).round(7))]) for one in TURNS.as_quat()]
    names = [f"P{i}" for i in range(1, 7)]
    points = export(tmp_path / "export.csv", names, range(1, 7), f",{header}", four)
    found = intake([log(tmp_path / "log.csv", names), points], 5e-5, sigma_r=5e-4).columns
    turned = Rotation.from_rotvec(np.array([found[name] for name in ("rx", "ry", "rz")]).T)
    assert (turned * TURNS.inv()).magnitude() == pytest.approx(np.zeros(6), abs=1e-6)
    assert [name for name in found if name.startswith("q_")] == ["q_J1", "q_J2"]


def test_an_orientation_that_is_asked_for_and_open_is_refused(tmp_path: Path) -> None:
    names = [f"P{i}" for i in range(1, 7)]
    rows, path = log(tmp_path / "log.csv", names), tmp_path / "export.csv"
    angles = [",".join(["", *map(str, one.round(5))]) for one in TURNS.as_euler("xyz", degrees=True)]
    paths = [rows, export(path, names, range(1, 7), ",Rx [deg],Ry [deg],Rz [deg]", angles)]
    with pytest.raises(InputError, match=r"no orientation is read \(other columns: 'Rx \[deg\]'.*roll_deg"):
        intake(paths, 5e-5, sigma_r=5e-4)
    taken = {"Rx [deg]": "roll_deg", "Ry [deg]": "pitch_deg", "Rz [deg]": "yaw_deg"}
    found = intake(paths, 5e-5, taken, sigma_r=5e-4).columns
    turned = Rotation.from_rotvec(np.array([found[name] for name in ("rx", "ry", "rz")]).T)
    assert (turned * TURNS.inv()).magnitude() == pytest.approx(np.zeros(6), abs=1e-6)
    export(path, names, range(1, 7), ",q1,q2,q3,q4", [",".join(["", *map(str, one)]) for one in TURNS.as_quat()])
    with pytest.raises(InputError, match=r"w first or last: --take 'q1=qw'"):
        intake(paths, 5e-5, sigma_r=5e-4)
    export(path, names, range(1, 7))
    with pytest.raises(InputError, match="--sigma-r, and no orientation is read"):
        intake(paths, 5e-5, sigma_r=5e-4)


def test_places_in_a_list_do_not_say_which_is_w(tmp_path: Path) -> None:
    turns = [",".join(["", *map(str, one.round(7))]) for one in TURNS.as_quat()]  # x y z w
    names = [f"P{i}" for i in range(1, 7)]
    points = export(tmp_path / "export.csv", names, range(1, 7), ",quat0,quat1,quat2,quat3", turns)
    with pytest.raises(InputError, match="'quat3' is of a quaternion, w first or last: --take 'quat3=qz'"):
        intake([log(tmp_path / "log.csv", names), points], 5e-5, sigma_r=1e-3)


UNITS_OF_HEADERS = {
    "J{} [gon]": 400.0,
    "J{} / mdeg": 3.6e5,
    "J{}, degrees": 360.0,
    "J{} [cdeg]": 3.6e4,
    "q_J{}_decideg": 3.6e3,
    "q_J{}_rev": 1.0,
    "q_J{} [turns]": 1.0,
    "J{} [radians]": 2.0 * np.pi,
    "J{} [counts]": None,
    "q_J{} [%]": None,
    "q_J{}_ticks": None,
    "J{} [0.01deg]": None,
    "J{} [grad]": None,
}
"""Header of a joint -> how many of its unit are a turn, None where nothing says it."""


@pytest.mark.parametrize("header", UNITS_OF_HEADERS)
def test_a_unit_that_a_header_states_is_converted_or_refused(tmp_path: Path, header: str) -> None:
    per = UNITS_OF_HEADERS[header]
    names = ",".join(f'"{header.format(i)}"' for i in (1, 2))
    rows = "".join(f"P{i},{0.05 * i * (per or 4096.0)!r},{-0.1 * (per or 4096.0)!r}\n" for i in range(1, 5))
    (tmp_path / "log.csv").write_text(f"Pose,{names}\n{rows}")
    points = export(tmp_path / "export.csv", ["P1", "P2", "P3", "P4"], range(1, 5))
    if per is None:
        with pytest.raises(InputError, match=r"which is not known \(rad, .*--take '.*=q_J1_UNIT'|how many are a turn"):
            intake([tmp_path / "log.csv", points], 5e-5)
        return
    found = intake([tmp_path / "log.csv", points], 5e-5)
    assert found.columns["q_J1"] == pytest.approx(0.1 * np.pi * np.arange(1, 5))


@pytest.mark.parametrize(
    ("header", "start"),
    [("J{} [deg]", 0), ("AIPos.A{}", 1), ("Axis {} Position [deg]", 1), ("theta{} [deg]", 1), ("q{} [deg]", 1),
     ("joint{}_angle [deg]", 1), ("Joint {} [deg]", 7)],
)  # fmt: skip
def test_joints_as_controllers_number_them(tmp_path: Path, header: str, start: int) -> None:
    """From 0 or from 1, or those of a second arm; beside them what was commanded and what is no position."""
    names = [header.format(i) for i in range(start, start + 5)]
    rows = "".join(f"P{i},{i},-90,0,10,20,{i}\n" for i in range(1, 5))
    (tmp_path / "log.csv").write_text(f"Pose,{','.join(names)},q_d[0] [A]\n{rows}")
    points = export(tmp_path / "export.csv", ["P1", "P2", "P3", "P4"], range(1, 5))
    columns = intake([tmp_path / "log.csv", points], 5e-5).columns
    joints = [name for name in columns if name.startswith("q_")]
    assert len(joints) == 5
    assert columns[joints[0]] == pytest.approx(np.radians(np.arange(1, 5)))


def test_four_numbered_columns_beside_a_place_are_no_joints(tmp_path: Path) -> None:
    cells = [",0.7,0.1,0.2,0.1"] * 4  # a quaternion that is not of length 1
    points = export(tmp_path / "export.csv", ["P1", "P2", "P3", "P4"], range(1, 5), ",q1,q2,q3,q4", cells)
    found = intake([log(tmp_path / "log.csv", ["P1", "P2", "P3", "P4"]), points], 5e-5)
    assert [name for name in found.columns if name.startswith("q_")] == ["q_J1", "q_J2"]


def test_another_quantity_of_a_joint_is_no_position(tmp_path: Path) -> None:
    text = "Pose,J1 [deg],J1 [Nm],J1 [A],J1 [°/s]\n" + "".join(f"P{i},{i},3.5,{i},0\n" for i in range(1, 5))
    (tmp_path / "log.csv").write_text(text)
    points = export(tmp_path / "export.csv", ["P1", "P2", "P3", "P4"], range(1, 5))
    found = intake([tmp_path / "log.csv", points], 5e-5)
    assert found.columns["q_J1"] == pytest.approx(np.radians(np.arange(1, 5)))
    assert found.columns["J1_Nm"] == [3.5] * 4


def test_a_column_of_names_that_is_empty_is_none(tmp_path: Path) -> None:
    """Else points in the order of a text would be joined row by row."""
    rows = log(tmp_path / "log.csv", ["", "", "", ""])
    with pytest.raises(InputError, match="which is of which is not certain"):
        intake([rows, export(tmp_path / "export.csv", ["P1", "P10", "P2", "P3"], range(1, 5))], 5e-5)
    assert len(intake([rows, export(tmp_path / "e.csv", ["P1", "P2", "P3", "P4"], range(1, 5))], 5e-5).lines) == 4


@pytest.mark.parametrize(
    ("head", "told"),
    [("Tool", "session_target"), ("SMR ID", "all are of one target"), ("Station", "all are of one frame")],
)
def test_places_of_several_targets_or_stations_are_asked_about(tmp_path: Path, head: str, told: str) -> None:
    """They were joined to one target; what is one for all, or another in every row, is none of these."""
    names = ["P1", "P2", "P3", "P4"]
    rows = log(tmp_path / "log.csv", names)

    def read(cells: str, taken: dict[str, str] | None = None) -> list[str]:
        points = export(tmp_path / "export.csv", names, range(1, 5), f",{head}", [f",{cell}" for cell in cells])
        return list(intake([rows, points], 5e-5, taken=taken).columns)

    with pytest.raises(InputError, match=rf"'{head}' says that places are of A, B: --take '{head}=session' .*{told}"):
        read("ABAB")
    assert "session" in read("ABAB", {head: "session"}) and head not in read("ABAB", {head: "unused"})
    assert read("AAAA") and read("ABCD")


@pytest.mark.parametrize(
    "head", ["J1_J2_deg", "J1J2 [deg]", "J12_deg", "J1_plus_J2", "J1.J2_deg", "J2_abs_deg", "axis_1_2"]
)
def test_a_joint_without_a_column_is_asked_of_one_that_has_its_name_in_its_own(tmp_path: Path, head: str) -> None:
    """Which then may be it, or the sum of two; what has another word or unit in it is not asked about."""
    points = export(tmp_path / "export.csv", ["P1", "P2", "P3", "P4"], range(1, 5))

    def read(heads: str, taken: dict[str, str] | None = None) -> list[str]:
        lines = [f"Pose,J1 [deg],J3 [deg],{heads}", *(f"P{i},{7 * i},{i * i},{3 * i},{i}" for i in range(1, 5))]
        (tmp_path / "log.csv").write_text("\n".join(lines))
        return [name for name in intake([tmp_path / "log.csv", points], 5e-5, taken=taken).columns if name[:2] == "q_"]

    with pytest.raises(InputError, match=r"joint J2 has no column, and .* may be it, or computed of it: --take"):
        read(f"{head},J2 [Nm]")
    assert read(f"{head},J2 [Nm]", {head: "q_J2_deg"}) == ["q_J1", "q_J3", "q_J2"]
    assert read("temp_J2,J2 [Nm]") == ["q_J1", "q_J3"]
    assert {"q_J1", "q_J2", "q_J3"} <= {*read(f"J2 [deg],{head}")}


@pytest.mark.parametrize(
    "head", ["J1+J2", "J2-J1 [deg]", "-J2_deg", "J2*2", "2·J2", "q_J1+q_J2", "sin(J2)", "Axis 1 / J2", "J1&J2", "J2'"]
)
def test_a_column_computed_of_joints_is_none(tmp_path: Path, head: str) -> None:
    """It was a covariate, and the arm had a joint less."""
    lines = [f"Pose,J1 [deg],{head}", *(f"P{i},{7 * i},{i * i}" for i in range(1, 5))]
    (tmp_path / "log.csv").write_text("\n".join(lines))
    points = export(tmp_path / "export.csv", ["P1", "P2", "P3", "P4"], range(1, 5))
    with pytest.raises(InputError, match=r"is computed of joints, expected a column of (J2|Axis_1) alone"):
        intake([tmp_path / "log.csv", points], 5e-5)
    beside = ["J2 [deg],Axis 1 [deg]", *(f"{i * i},{-3 * i}" for i in range(1, 5))]
    (tmp_path / "log.csv").write_text("\n".join(f"{line},{more}" for line, more in zip(lines, beside, strict=True)))
    assert "q_J2" in intake([tmp_path / "log.csv", points], 5e-5).columns


@pytest.mark.parametrize("name", ["arm/j{}", "arm-j{}", "r.j{}", "joint {}", "r::j{}", "j[{}]", "Gelenk_ä{}"])
def test_joints_are_called_as_a_robots_file_may_have_them(tmp_path: Path, name: str) -> None:
    names = [name.format(i) for i in (1, 2)]
    for header, unit in (("q_{}_deg", 180.0 / np.pi), ("position.{}", 1.0), ("/joint_states/{}/position", 1.0)):
        head = ",".join(header.format(one) for one in names)
        (tmp_path / "log.csv").write_text(f"pose,{head}\n" + "".join(f"P{i},{i},-{i}\n" for i in range(1, 7)))
        points = export(tmp_path / "export.csv", [f"P{i}" for i in range(1, 7)], range(1, 7))
        found = intake([tmp_path / "log.csv", points], 5e-5).columns
        assert found[f"q_{names[1]}"] == pytest.approx(-np.arange(1, 7) / unit)


def urdf(path: Path) -> Path:
    body = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    links = "".join(f'<link name="{one}">{body}</link>' for one in "abc")
    joints = "".join(
        f'<joint name="{name}" type="{kind}"><parent link="{a}"/><child link="{b}"/><origin xyz="0 0 1"/>'
        '<axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>'
        for name, kind, a, b in (("boom_swing", "revolute", "a", "b"), ("boom_reach", "prismatic", "b", "c"))
    )
    path.write_text(f'<robot name="boom">{links}{joints}</robot>')
    return path


def test_the_robots_own_names_are_known_in_a_log(tmp_path: Path) -> None:
    rows = "".join(f"P{i},{10 * i},{300 + i},7\n" for i in range(1, 7))
    paths = [urdf(tmp_path / "boom.urdf"), tmp_path / "log.csv"]
    points = export(tmp_path / "export.csv", [f"P{i}" for i in range(1, 7)], range(1, 7))
    for head in ("boom_swing [deg],boom_reach [mm]", "Boom_Swing_deg,actual boom_reach [mm]"):
        paths[1].write_text(f"Pose,{head},tau_boom_swing\n{rows}")
        found = intake([*paths, points], 5e-5).columns
        assert found["q_boom_swing"][0] == pytest.approx(np.radians(10.0))
        assert found["q_boom_reach"][0] == pytest.approx(0.301)
        assert found["tau_boom_swing"] == [7.0] * 6
    for head, text in {
        "boom_swing,boom_reach": r"the unit of column 'boom_reach'.*q_boom_reach_mm",
        "boom_swing [deg],boom_reach [deg]": "'boom_reach' of boom.urdf slides",
    }.items():
        paths[1].write_text(f"Pose,{head},tau_boom_swing\n{rows}")
        with pytest.raises(InputError, match=text):
            intake([*paths, points], 5e-5)


DH = "joint,theta [deg],d [mm],a [mm],alpha [deg]"
ROWS = ("1,0,500,100,-90", "2,-90,0,550,0")


@pytest.mark.parametrize(
    ("header", "rows"),
    [
        (DH, ("1,q1,500,100,-90", "2,q2-90,0,550,0")),
        (DH, ("1,θ1,500,100,-90°", "2,-90 + θ2,0,550,0")),
        ("i,theta,d [m],a [m],alpha", ("1,0,0.5,0.1,-pi/2", "2,-π/2,0,0.55,0")),
        ("joint,d [mm],a [mm],alpha [deg],offset [deg]", ("1,500,100,-90,0", "2,0,550,0,-90")),
        (f"{DH},offset [deg]", ("1,0,500,100,-90,0", "2,q2,0,550,0,-90")),
        (f"{DH},home [deg]", ("1,0,500,100,-90,0", "2,0,0,550,0,-90")),
        (f"{DH},flip,sigma", ("1,0,500,100,-90,0,0", "2,-90,0,550,0,0,R")),
        ("i,theta,d / mm,a / mm,alpha", ("1,0,500,100,-0.5*pi", "2,-np.pi/2,0,550,0")),
        (
            "i,θ(i) [gon],d(i) [in],a(i) [in],α(i) [gon]",
            (f"1,0,{500 / 25.4!r},{100 / 25.4!r},-100", f"2,-100,0,{550 / 25.4!r},0"),
        ),
        (f"{DH},Speed,Remarks", ("1,0,500,100,-90,3,base", "2,-90,0,550,0,4,arm")),
    ],
)
def test_dh_tables_with_symbols_and_offsets(tmp_path: Path, header: str, rows: tuple[str, ...]) -> None:
    (tmp_path / "dh.csv").write_text("\n".join([header, *rows]))
    found = intake([tmp_path / "dh.csv", log(tmp_path / "log.csv", ["P1", "P2", "P3"])], None, dh="standard")
    assert found.arm is not None
    assert "J1 = { theta_deg = 0.0, d_mm = 500.0, a_mm = 100.0, alpha_deg = -90.0 }" in found.arm
    assert "J2 = { theta_deg = -90.0, d_mm = 0.0, a_mm = 550.0, alpha_deg = 0.0 }" in found.arm


@pytest.mark.parametrize(
    "name", ["Theta-Offset [°]", "Offset theta [deg]", "θ offset [deg]", "θ₀ [deg]", "Theta-0 (°)", "*Nullwinkel [°]"]
)
def test_theta_is_read_under_its_names_or_as_the_caller_says_and_is_never_left_out(tmp_path: Path, name: str) -> None:
    path, rows = tmp_path / "dh.csv", log(tmp_path / "log.csv", ["P1", "P2", "P3"])
    path.write_text(f"Joint,{name},d [mm],a [mm],alpha [deg]\n" + "\n".join(ROWS), encoding="utf-8")
    unknown = name.startswith("*")
    if unknown:
        with pytest.raises(InputError, match=r"winkel .*--take '.*=theta' \(or d, a, alpha.*=unused' leaves it out"):
            intake([path, rows], None, dh="standard")
    arm = intake([path, rows], None, {name: "theta"} if unknown else {}, dh="standard").arm
    assert arm is not None and "J2 = { theta_deg = -90.0, d_mm = 0.0, a_mm = 550.0" in arm
    with pytest.raises(InputError, match=r"no column has theta, .*--take 'COLUMN=theta'"):
        intake([path, rows], None, {name: "unused"}, dh="standard")


def test_what_else_a_dh_table_says_is_read_or_refused(tmp_path: Path) -> None:
    path, rows = tmp_path / "dh.csv", log(tmp_path / "log.csv", ["P1", "P2", "P3"])
    for header, cells, text in (
        ("flip", ("0", "1"), r"dh.csv:3: 'flip' is '1'"),
        ("sign", ("+1", "-1"), r"dh.csv:3: 'sign' is '-1'"),
        ("home [deg]", ("0", "-90"), "both have angles"),
        ("theta0 [deg]", ("0", "-90"), "both have angles"),
        ("sigma", ("1", "0"), r"dh.csv:2: joint 'J1' slides, and column 'J1 \[deg\]' of the log is in deg"),
        ("type", ("P", "R"), "joint 'J1' slides"),
        ("type", ("?", "R"), r"dh.csv:2: 'type' is '\?'"),
        ("skew [deg]", ("0", "1"), "'skew .*--take 'skew"),
        ("mass", ("12", "8"), "'mass' has an open unit: write it as 'mass .kg.'"),
        ("mass [kg]", ("12", "8"), "said nowhere: add the columns 'com x .mm.'.*--take 'mass .kg.=unused'"),
        ("mass [kg]", ("12", "-8"), r"dh.csv:3: 'mass \[kg\]' is '-8', expected a mass"),
        ("CoM x [mm]", ("12", "8"), "'CoM x .mm.' is of a centre of mass, and no column has the masses"),
        ("Ixx", ("12", "8"), "'Ixx': a row has no moments of inertia.*'Ixx=unused'"),
        ("range", ("170", "±90°"), r"dh.csv:2: 'range' is '170', expected a joint's limits"),
        ("range", ("±2", "±1.5"), "'range' has an open unit: write it as 'range .deg.', or --take 'range=unused'"),
        ("min [deg]", ("-170", "-90"), r"dh.csv:2: its limits are -170 and nan, expected a lower and an upper one"),
        ("range [mm]", ("±170", "±90"), "'range .mm.' is in 'mm', and some of the joints turn"),
        ("theta range", ("±170°", "±90°"), "'theta range' is of theta, which has a constant beside the joint's posit"),
    ):
        path.write_text("\n".join([f"{DH},{header}", *(",".join(pair) for pair in zip(ROWS, cells, strict=True))]))
        with pytest.raises(InputError, match=text):
            intake([path, rows], None, dh="standard")
    # Words of a file's head that say nothing of a form.
    path.write_text(f"# Last modified: 2026-11-20\n# Standard configuration, J. Paul\n{DH}\n" + "\n".join(ROWS))
    for form in ("standard", "modified"):
        arm = intake([path, rows], None, dh=form).arm
        assert arm is not None and f'dh = "{form}"' in arm
    with pytest.raises(InputError, match="--dh"):
        intake([path, rows], None)
    for header, of_rows, text in (
        (DH, ("1,q2,500,100,-90", "2,q1,0,550,0"), "dh.csv:3: 'q1' is of another joint than that of its row"),
        (DH, ("2,0,500,100,-90", "1,0,0,550,0"), "'joint' is 2, 1: put the rows in their order"),
        (DH.replace("[mm]", "[thou]"), ROWS, r"'d \[thou\]' is in 'thou', which is not known"),
    ):
        path.write_text("\n".join([header, *of_rows]))
        with pytest.raises(InputError, match=text):
            intake([path, rows], None, dh="standard")
    path.write_text(f"{DH},beta [deg],type\n{ROWS[0]},0,R\n{ROWS[1]},0.5,P")
    (tmp_path / "log.csv").write_text("pose,q_arm/j1_deg,q_arm/j2_mm\n" + "".join(f"P{i},{i},{i}\n" for i in range(3)))
    found = intake([path, rows], None, dh="standard").arm
    assert found is not None
    assert '"arm/j2" = { theta_deg = -90.0, ' in found
    assert 'beta_deg = 0.5, kind = "prismatic" }' in found


@pytest.mark.parametrize(
    ("head", "first", "second"),
    [
        ("min [deg],max [deg]", "-170,170", "-90.5,45"),
        ("qmin,qmax", "-170,170", "-90.5,45"),
        ("lower_limit [rad],upper_limit [rad]", "-2.96705972839,2.96705972839", "-1.57952297305,0.785398163397"),
        ("lower,upper", "-17*pi/18,17*pi/18", "-90.5°,pi/4"),
        ("qlim [deg]", "[-170 170]", "-90.5 to 45"),
        ("Range", "±170°", "-90.5° .. 45°"),
    ],
)  # fmt: skip
def test_limits_of_a_dh_table_are_those_of_the_arm(tmp_path: Path, head: str, first: str, second: str) -> None:
    path, rows = tmp_path / "dh.csv", log(tmp_path / "log.csv", ["P1", "P2", "P3"])
    path.write_text(f"{DH},{head}\n{ROWS[0]},{first}\n{ROWS[1]},{second}\n")
    (tmp_path / "arm.toml").write_text(str(intake([path, rows], None, dh="standard").arm))
    robot = load_arm(tmp_path / "arm.toml").robot
    assert np.allclose(np.degrees(robot.lower), [-170.0, -90.5])
    assert np.allclose(np.degrees(robot.upper), [170.0, 45.0])


def test_limits_of_a_slide_are_in_the_unit_of_its_d(tmp_path: Path) -> None:
    (tmp_path / "dh.csv").write_text(f"{DH},type,min,max\n1,0,0,100,-90,P,-50,400\n{ROWS[1]},R,,\n")
    (tmp_path / "log.csv").write_text("pose,J1 [mm],J2 [deg]\n" + "".join(f"P{i},{i},{i}\n" for i in range(3)))
    (tmp_path / "arm.toml").write_text(
        str(intake([tmp_path / "dh.csv", tmp_path / "log.csv"], None, dh="standard").arm)
    )
    robot = load_arm(tmp_path / "arm.toml").robot
    assert np.allclose((robot.lower, robot.upper), ([-0.05, -np.inf], [0.4, np.inf]))


@pytest.mark.parametrize("empty", ["", "nan"])
def test_a_cell_of_another_topics_message_is_empty(tmp_path: Path, empty: str) -> None:
    """A table of all topics, a row for each message: an arm that stands at three places, and its target."""
    time = np.arange(0.0, 9.0, 0.02)
    at = np.interp(time, [0.0, 2.0, 3.0, 5.5, 6.5, 9.0], [0.0, 0.0, 0.5, 0.5, -0.4, -0.4])
    with (tmp_path / "all.csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["__time", "/joint_states/a/position", *(f"/tracker/pose/position/{axis}" for axis in "xyz")])
        for now, q in zip(time, at, strict=True):
            table.writerow([now, q, *[empty] * 3])
            table.writerow([now + 0.007, empty, 1.0 + q, 2.0, 3.0])
    found = intake([tmp_path / "all.csv"], 5e-5).columns
    assert found["q_a"] == pytest.approx([0.0, 0.5, -0.4], abs=1e-9)
    assert found["x"] == pytest.approx([1.0, 1.5, 0.6], abs=1e-9)


def test_what_an_export_has_beside_readings_is_kept_or_said(tmp_path: Path) -> None:
    names = [f"P{i}" for i in range(1, 7)]
    cells = [f",0.01,{50 * i},2024-03-12 10:0{i}:00" for i in range(6)]
    points = export(tmp_path / "export.csv", names, range(1, 7), ",RMS,Masse [kg],Zeit", cells)
    found = intake([log(tmp_path / "log.csv", names), points], 5e-5)
    assert found.columns["Masse_kg"] == [0.0, 50.0, 100.0, 150.0, 200.0, 250.0]
    assert found.columns["time"] == [f"2024-03-12T10:0{i}:00" for i in range(6)]
    assert "'RMS' of export.csv left out" in found.notes[-1]
    kept = intake([tmp_path / "log.csv", points], 5e-5, {"RMS": "RMS"})
    assert kept.columns["RMS"] == [0.01] * 6
    assert found.columns["q_J1"][0] == 0.017453292520  # no digits of a conversion


@pytest.mark.parametrize(
    ("head", "cell"),
    [("X [mm],Y [mm],Z [mm]", "'1,234.5',-0.5,2"), ("X [mm],Y [mm],Z [mm]", "1’234.5,−0.5,2"),
     ("X [mm],Y [mm],Z [mm]", "0.12345D+04,-5.D-01,2"), ("X,Y,Z", "1234.5 mm,-0.5 mm,2 mm"),
     ("X [mm],Y [mm],Z [mm]", "1\u00a0234.5,-0.5,2")],
)  # fmt: skip
def test_numbers_as_people_write_them(tmp_path: Path, head: str, cell: str) -> None:
    rows = log(tmp_path / "log.csv", [f"P{i}" for i in range(1, 5)])
    cell = cell.replace("'", '"')
    (tmp_path / "export.csv").write_text(
        "\n".join([f"Name,{head}", *(f"P{i},{cell}" for i in range(1, 5))]), encoding="utf-8"
    )
    found = intake([rows, tmp_path / "export.csv"], 5e-5)
    assert [found.columns[axis][0] for axis in "xyz"] == pytest.approx([1.2345, -0.0005, 0.002])


@pytest.mark.parametrize(
    "heads", ["Axe {} [°]", "軸{}(度)", "Achse {} in Grad", "Asse{} (gradi)", "Eje {} (grados)", "Ist A{} [°]",
              "J{} mesuré [deg]"],
)  # fmt: skip
def test_joints_are_called_in_other_languages(tmp_path: Path, heads: str) -> None:
    path = log(tmp_path / "log.csv", ["P1", "P2", "P3"])
    text = path.read_text().replace("J1 [deg],J2 [deg]", f"{heads.format(1)},{heads.format(2)}")
    path.write_text(text, encoding="utf-8")
    found = intake([path], None)
    q = [values for name, values in found.columns.items() if name.startswith("q_")]
    assert np.allclose(q, np.radians([[1, 2, 3], [-90, -90, -90]]))


@pytest.mark.parametrize("head", ["target_q_{0},actual_q[{0}]", "target_q{0},actual_q{0}"])
def test_where_the_joints_are_outweighs_where_they_were_to_be(tmp_path: Path, head: str) -> None:
    names = ",".join(head.format(i) for i in range(6))
    rows = [",".join(f"{0.1 * j + 0.2 * k + 1.0:.3f},{0.1 * j + 0.2 * k:.3f}" for j in range(6)) for k in range(3)]
    (tmp_path / "log.csv").write_text("\n".join([f"point,{names}", *(f"P{k},{row}" for k, row in enumerate(rows))]))
    found = intake([tmp_path / "log.csv"], None)
    assert found.columns["q_shoulder_pan_joint"] == pytest.approx([0.0, 0.2, 0.4])
    assert found.columns["q_wrist_3_joint"] == pytest.approx([0.5, 0.7, 0.9])


@pytest.mark.parametrize(
    ("head", "names", "said"),
    [("# Units: mm\n# Units: m\n", "X,Y,Z", "'X' is stated as mm, m: --take"),
     ("# Length unit: inches\n", "X [mm],Y [mm],Z [mm]", "head says inches: --take 'X .mm.=x_mm'")],
)  # fmt: skip
def test_units_that_contradict_are_asked_about(tmp_path: Path, head: str, names: str, said: str) -> None:
    rows, points = log(tmp_path / "log.csv", ["P1", "P2", "P3"]), tmp_path / "export.csv"
    points.write_text(head + f"Name,{names}\nP1,1.5,2,3\nP2,2.5,2,3\nP3,3.5,2,3\n")
    with pytest.raises(InputError, match=said):
        intake([rows, points], 5e-5)
    taken = {name: f"{axis}_mm" for name, axis in zip(names.split(","), "xyz", strict=True)}
    assert intake([rows, points], 5e-5, taken).columns["x"] == pytest.approx([0.0015, 0.0025, 0.0035])


def test_the_form_of_a_dh_table_is_what_it_says(tmp_path: Path) -> None:
    rows, path = log(tmp_path / "log.csv", ["P1", "P2", "P3"]), tmp_path / "dh.csv"
    before = "joint,alpha i-1 [deg],a i-1 [mm],d [mm],theta"
    for text in (f"# Modified DH (Craig)\n{DH}\n" + "\n".join(ROWS), f"{before}\n1,-90,100,500,q1\n2,0,550,0,q2-90°"):
        path.write_text(text, encoding="utf-8")
        arm = intake([path, rows], None).arm
        assert arm is not None
        assert 'dh = "modified"' in arm
        assert "J2 = { theta_deg = -90.0, d_mm = 0.0, a_mm = 550.0, alpha_deg = 0.0 }" in arm
        with pytest.raises(InputError, match="--dh standard, and the table is modified DH"):
            intake([path, rows], None, dh="standard")


def both(joints: np.ndarray, first: str, second: str, off: float, unit: str = "") -> str:
    """Return a log of (N, 3) joints, each beside itself and `off` [rad]."""
    factor = np.degrees(1.0) if "deg" in unit else 1.0
    head = ["Pose", *(form.format(i) + unit for i in (1, 2, 3) for form in (first, second))]
    rows = [",".join([f"P{n}", *(f"{factor * value:.6f}" for q in row for value in (q + off, q))])
            for n, row in enumerate(joints, 1)]  # fmt: skip
    return "\n".join([",".join(head), *rows])


MOVED = np.random.default_rng(5).uniform(-1.5, 1.5, (8, 3))


@pytest.mark.parametrize(
    ("first", "second", "unit", "name"),
    [
        ("q_cmd_{}", "q_act_{}", "", "q_1"),
        ("q_des_{}", "q_meas_{}", "_deg", "q_1"),
        ("q_d_{}", "q_{}", "", "q_1"),
        ("q_desired{}", "q_measured{}", " [deg]", "q_1"),
        ("q_ref_{}", "q_{}", " [rad]", "q_1"),
        ("q_J{}_cmd", "q_J{}", "", "q_J1"),
        ("target_q_{}", "actual_q_{}", " [deg]", "q_q_1"),  # counted from 1, so none of Universal Robots
    ],
)
def test_what_was_commanded_is_no_joint_beside_what_was_reached(
    tmp_path: Path, first: str, second: str, unit: str, name: str
) -> None:
    (tmp_path / "log.csv").write_text(both(MOVED, first, second, 0.01, unit))
    points = export(tmp_path / "export.csv", [f"P{i}" for i in range(1, 9)], range(1, 9))
    found = intake([tmp_path / "log.csv", points], 5e-5).columns
    joints = [column for column in found if column.startswith("q_")]
    assert len(joints) == 3 and joints[0] == name
    assert np.allclose(np.array([found[column] for column in joints]).T, MOVED, atol=1e-6)


@pytest.mark.parametrize(("first", "second"), [("q_motor_{}", "q_link_{}"), ("q_in_{}", "q_out_{}")])
def test_joints_that_stand_there_twice_are_asked_about(tmp_path: Path, first: str, second: str) -> None:
    (tmp_path / "log.csv").write_text(both(MOVED, first, second, 0.01))
    points = export(tmp_path / "export.csv", [f"P{i}" for i in range(1, 9)], range(1, 9))
    with pytest.raises(InputError, match=r"nearly the same in every row, and 2 more pairs are: .* --take 'q_\w+_1=unu"):
        intake([tmp_path / "log.csv", points], 5e-5)
    left = {first.format(i): "unused" for i in (1, 2, 3)}
    assert second.format(1) in intake([tmp_path / "log.csv", points], 5e-5, left).columns
    kept = {second.format(i): f"{second.format(i)}_rad" for i in (1, 2, 3)}
    assert sum(name.startswith("q_") for name in intake([tmp_path / "log.csv", points], 5e-5, kept).columns) == 6
    (tmp_path / "log.csv").write_text(both(MOVED[:, :1] + np.zeros(3), first, first + "b", 2.0))  # all move as one
    assert sum(name.startswith("q_") for name in intake([tmp_path / "log.csv", points], 5e-5).columns) == 6


@pytest.mark.parametrize("header", ["Target", "Label", "No.", "Station", "Bezeichnung", "Cible", "Messung", "#"])
@pytest.mark.parametrize("form", ["P{}", "{}"])
@pytest.mark.parametrize("where", ["log", "export", "both"])
def test_names_in_a_column_of_any_name_are_those_of_rows(tmp_path: Path, header: str, form: str, where: str) -> None:
    """They were left out, and the files joined row by row."""
    names = [form.format(i) for i in MIXED]
    if where == "export":
        rows = log(tmp_path / "log.csv", [f"P{i}" for i in range(1, COUNT + 1)])
        expected = 1e-3 * np.arange(1, COUNT + 1)
    else:
        rows = log(tmp_path / "log.csv", names, header)
        expected = 1e-3 * np.array(MIXED)
    order = MIXED if where == "export" else range(COUNT, 0, -1)
    points = export(tmp_path / "export.csv", [form.format(i) if where != "log" else f"P{i}" for i in order], order)
    points.write_text(points.read_text().replace("Name", "Name" if where == "log" else header))
    assert intake([rows, points], 5e-5).columns["x"] == pytest.approx(expected)


@pytest.mark.parametrize("form", ["{}", "P{}"])
def test_a_count_of_rows_in_an_order_of_its_own_is_asked_about(tmp_path: Path, form: str) -> None:
    rows = log(tmp_path / "log.csv", [form.format(i) for i in MIXED], "Run")
    points = tmp_path / "export.csv"
    points.write_text("X [mm],Y [mm],Z [mm]\n" + "".join(f"{i},0,5\n" for i in MIXED))
    with pytest.raises(TableError, match=r"has no names, and .*'Run=unused' joins them row by row"):
        intake([rows, points], 5e-5)
    assert intake([rows, points], 5e-5, {"Run": "unused"}).columns["x"] == pytest.approx(1e-3 * np.array(MIXED))
    warm = log(tmp_path / "log.csv", [str(i) for i in MIXED], "temperature")  # no count
    assert intake([warm, points], 5e-5).columns["temperature"] == list(map(float, MIXED))


def test_clocks_at_which_points_are_equally_late_count_before_those_as_they_are(tmp_path: Path) -> None:
    """The first pose was not measured, and the tracker's clock began with the second; a hand is not that punctual."""
    at = np.cumsum(20.0 + np.random.default_rng(3).uniform(0.0, 9.0, COUNT))
    rows = "".join(f"{time:.2f},{i},-90\n" for i, time in enumerate(at, 1))
    (tmp_path / "log.csv").write_text(f"time,J1 [deg],J2 [deg]\n{rows}")
    points = tmp_path / "export.csv"
    points.write_text(
        "time,X [mm],Y [mm],Z [mm]\n" + "".join(f"{at[i] - at[1]:.2f},{i + 1},0,5\n" for i in range(1, 12))
    )
    found = intake([tmp_path / "log.csv", points], 5e-5)
    assert [*found.columns["x"]] == ["", *(pytest.approx(1e-3 * i) for i in range(2, 13))]
    assert f"the clocks are {-at[1]:+.2f} s apart" in " ".join(found.notes)
    late = np.random.default_rng(4).uniform(0.0, 4.0, COUNT)
    points.write_text(
        "time,X [mm],Y [mm],Z [mm]\n" + "".join(f"{at[i] + late[i]:.2f},{i + 1},0,5\n" for i in range(1, 12))
    )
    assert [*intake([tmp_path / "log.csv", points], 5e-5).columns["x"]] == [*found.columns["x"]]


@pytest.mark.parametrize("word", ["Nominal", "Soll", "Reference"])
def test_places_that_were_to_be_are_none_that_were_measured(tmp_path: Path, word: str) -> None:
    rows = log(tmp_path / "log.csv", [f"P{i}" for i in range(1, 5)])
    points = export(tmp_path / "export.csv", [f"P{i}" for i in range(1, 5)], range(1, 5), ",Type",
                    [",Measured", f",{word}", ",Measured", ",Measured"])  # fmt: skip
    with pytest.raises(InputError, match=rf"export\.csv:3: 'Type' is '{word}' in 1 of 4 rows: export measured"):
        intake([rows, points], 5e-5)
    assert len(intake([rows, points], 5e-5, {"Type": "unused"}).columns["x"]) == 4


@pytest.mark.parametrize("column", ["Station", "WCS"])
def test_one_reading_from_another_station_is_asked_about(tmp_path: Path, column: str) -> None:
    rows = log(tmp_path / "log.csv", [f"P{i}" for i in range(1, 5)])
    points = export(tmp_path / "export.csv", [f"P{i}" for i in range(1, 5)], range(1, 5), f",{column}",
                    [",A", ",A", ",A", ",B"])  # fmt: skip
    with pytest.raises(InputError, match=f"'{column}' says that places are .*--take '{column}=session'"):
        intake([rows, points], 5e-5)


def test_r_and_d_of_khalils_tables_are_d_and_a(tmp_path: Path) -> None:
    """`d` is along x and `r` along z; elsewhere `r` is along x."""
    path, rows = tmp_path / "dh.csv", log(tmp_path / "log.csv", ["P1", "P2", "P3"])

    def described(head: str, of_rows: Sequence[str], form: str | None, title: str = "") -> str:
        path.write_text("\n".join([*filter(None, [title]), f"j,{head}", *of_rows]))
        return str(intake([path, rows], None, dh=form).arm)

    first = "J1 = { theta_deg = 10.0, d_mm = 500.0, a_mm = 100.0, alpha_deg = -90.0 }"
    khalil = "alpha [deg],d [mm],theta [deg],r [mm]", ("1,-90,100,10,500", "2,0,550,-90,0")
    for form in (None, "modified"):
        assert first in described(*khalil, form) and 'dh = "modified"' in described(*khalil, form)
    with pytest.raises(
        InputError, match=r"--dh standard, and the table is modified DH \(alpha, d, theta, r are Khalil"
    ):
        described(*khalil, "standard")
    other = "d [mm],theta [deg],r [mm],alpha [deg]", ("1,500,10,100,-90", "2,0,-90,550,0")
    assert first in described(*other, "standard")
    with pytest.raises(InputError, match=r"'r .mm.' is along x in some texts, and along z in Khalil's: name columns a"):
        described(*other, "modified")
    turned = "theta [deg],r [mm],d [mm],alpha [deg]", ("1,10,500,100,-90", "2,-90,0,550,0")
    assert first in described(*turned, None, "Parameters of Khalil and Kleinfinger")
    with pytest.raises(InputError, match=r"'alpha .rad.' is 90 rad, beyond a turn: write it as 'alpha .deg.'"):
        described(other[0].replace("alpha [deg]", "alpha [rad]"), other[1], "standard")


def test_exports_in_two_frames_are_no_campaign(tmp_path: Path) -> None:
    rows = log(tmp_path / "log.csv", [f"P{i}" for i in range(1, 5)])
    paths = [tmp_path / "first.txt", tmp_path / "second.txt"]

    def write(*frames: str) -> None:
        for path, frame, of_rows in zip(paths, frames, ((1, 2), (3, 4)), strict=True):
            path.write_text(f"// Units: mm\n// Frame: {frame}\n" + "".join(f"A::G::P{i}, {i}, 0, 5\n" for i in of_rows))

    write("A::WORLD", "A::world")
    assert intake([rows, *paths], 5e-5).columns["x"] == pytest.approx([1e-3, 2e-3, 3e-3, 4e-3])
    write("A::WORLD", "A::BASE")
    with pytest.raises(InputError, match=r"comments say .* 'A::WORLD' in first\.txt, 'A::BASE' in second\.txt: export"):
        intake([rows, *paths], 5e-5)


@pytest.mark.parametrize("said", ["Cylindrical", "coordinate system: polar"])
def test_points_on_cylinders_are_no_x_y_z(tmp_path: Path, said: str) -> None:
    rows = log(tmp_path / "log.csv", [f"P{i}" for i in range(1, 5)])
    (tmp_path / "points.txt").write_text(
        f"// Units: mm\n// {said}\n" + "".join(f"A::P{i}, {i}, 30, 5\n" for i in range(5))
    )
    with pytest.raises(InputError, match=r"points\.txt: '(Cyl|pol)\w*': export the points in Cartesian coordinates"):
        intake([rows, tmp_path / "points.txt"], 5e-5)


def test_names_of_which_few_are_shared_are_not_joined(tmp_path: Path) -> None:
    """P10 is the second row of the log, and the tenth point."""
    rows = log(tmp_path / "log.csv", [f"P{10 * i}" for i in range(COUNT)])
    points = export(tmp_path / "export.csv", [f"P{i}" for i in range(COUNT)], range(COUNT))
    with pytest.raises(
        TableError, match=r"only 2 of 12 rows of log\.csv have a point of their name, and 10 points have"
    ):
        intake([rows, points], 5e-5)


def test_rows_of_an_export_in_another_unit_are_named(tmp_path: Path) -> None:
    rows = log(tmp_path / "log.csv", [f"P{i}" for i in range(COUNT)])
    places = np.random.default_rng(3).uniform(500.0, 2500.0, (COUNT, 3))
    places[[4, 5, 9]] /= 1e3
    points = tmp_path / "export.csv"
    cells = [f"P{i},{x:.7f},{y:.7f},{z:.7f}" for i, (x, y, z) in enumerate(places)]
    points.write_text("\n".join(["Name,X [mm],Y [mm],Z [mm]", *cells]))
    with pytest.raises(TableError, match=r"export\.csv:6: x y z: 3 of 12 rows are about 1000 times .*lines 6, 7, 11"):
        intake([rows, points], 5e-5)


BODIES = "mass [g],com [m]", ("9000,[0.1 0.02 -0.03]", "4000,-0.2 0 0.05")


@pytest.mark.parametrize("form", ["standard", "modified"])
def test_masses_of_a_dh_table_hang_where_the_frames_of_its_rows_have_them(tmp_path: Path, form: str) -> None:
    """Their sag is that of the same rows by hand: frame n of the standard form is at the other end of the link."""
    path, rows = tmp_path / "dh.csv", log(tmp_path / "log.csv", ["P1", "P2", "P3"])
    header, cells = BODIES
    path.write_text("\n".join([f"{DH},{header}", *(",".join(pair) for pair in zip(ROWS, cells, strict=True))]))
    text = intake([path, rows], None, dh=form).arm
    assert text is not None
    (tmp_path / "arm.toml").write_text(text)
    robot = load_arm(tmp_path / "arm.toml").robot
    q, at, weights = np.array([0.3, -0.4]), np.eye(4), []
    for (theta, d, a, alpha), angle, (mass, *com) in zip(
        ((0.0, 0.5, 0.1, -np.pi / 2), (-np.pi / 2, 0.0, 0.55, 0.0)),
        q,
        ((9.0, 0.1, 0.02, -0.03), (4.0, -0.2, 0.0, 0.05)),
        strict=True,
    ):
        along, across = np.eye(4), np.eye(4)
        along[:3, :3], along[2, 3] = Rotation.from_euler("z", theta + angle).as_matrix(), d
        across[:3, :3], across[0, 3] = Rotation.from_euler("x", alpha).as_matrix(), a
        at = at @ (along @ across if form == "standard" else across @ along)
        weights.append((mass, (at @ [*com, 1.0])[:3]))
    for name, (mass, there) in zip(("link1", "link2"), weights, strict=True):
        body = robot.urdf.links[name].inertial
        assert body is not None and body.mass == pytest.approx(mass)
        np.testing.assert_allclose((link_pose(robot, name, q) @ [*body.origin, 1.0])[:3], there, atol=1e-9)


def link_pose(robot: Robot, name: str, q: np.ndarray) -> np.ndarray:
    """Return the (4, 4) pose of a link of a chain of turning joints, by its joints' origins alone."""
    pose, turned = np.eye(4), dict(zip((joint.name for joint in robot.moving), q, strict=True))
    for joint in robot.chain:
        step, motion = np.eye(4), np.eye(4)
        step[:3, :3], step[:3, 3] = joint.rotation, joint.origin
        motion[:3, :3] = Rotation.from_rotvec(joint.axis * turned.get(joint.name, 0.0)).as_matrix()
        pose = pose @ step @ motion
        if joint.child == name:
            return pose
    raise AssertionError(name)


SLIDING = {
    "dh.csv": f"{DH},type\n{ROWS[0]},R\n{ROWS[1]},P",
    "arm.urdf": """<robot name="r"><link name="a"/><link name="b"/><link name="c"/>
<joint name="swing" type="continuous"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/></joint>
<joint name="reach" type="prismatic"><parent link="b"/><child link="c"/><axis xyz="1 0 0"/>
<limit lower="0" upper="1" effort="1" velocity="1"/></joint></robot>""",
}


@pytest.mark.parametrize("name", SLIDING)
def test_a_slide_without_a_unit_is_asked_about_however_the_log_calls_it(tmp_path: Path, name: str) -> None:
    """Its column is no angle because the angles beside it are in degrees."""
    (tmp_path / name).write_text(SLIDING[name])
    (tmp_path / "log.csv").write_text("pose,J1,J2\n1,170,120\n2,-90,250\n3,20,400\n")
    files, form = [tmp_path / name, tmp_path / "log.csv"], "standard" if name == "dh.csv" else None
    with pytest.raises(InputError, match="unit of column 'J2' is stated nowhere: --take 'J2=q_J2_mm' or =q_J2_m"):
        intake(files, None, dh=form)
    joined = intake(files, None, dh=form, taken={"J2": "q_J2_mm"})
    lengths = next(values for column, values in joined.columns.items() if column in ("q_J2", "q_reach"))
    np.testing.assert_allclose(np.asarray(lengths, dtype=float), [0.12, 0.25, 0.4])
