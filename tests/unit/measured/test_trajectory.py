"""Trajectories: what is written is read back bit for bit, units are converted once, bad files are refused by line."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.small_arms import ROBOTS

from armflex import Arm, InputError, Trajectory, load_arm, read_trajectory, write_trajectory
from armflex.cli.options import parse_positions
from armflex.errors import ArmflexWarning, ShapeError, TableError

JOINTS = ("M1", "A1", "A2", "A3", "A4", "A5", "A6")
HEADER = "time,q_M1,q_A1,q_A2,q_A3,q_A4,q_A5,q_A6,payload,via"
ROWS = ("0,2,0.1,0.2,0.3,0.4,0.5,0.6,p300,start", "1,2,0.1,0.2,0.3,0.4,0.5,0.7,p300,", "3,2,0,0.2,0,0,0,0,,end")


def table(folder: Path, *edits: tuple[str, str], rows: tuple[str, ...] = ROWS) -> Path:
    """Write the good table with texts replaced, each of which must be there."""
    text = "\n".join((HEADER, *rows)) + "\n"
    for old, new in edits:
        assert old in text, old
        text = text.replace(old, new, 1)
    path = folder / "t.csv"
    path.write_text(text)
    return path


def same(one: Trajectory, other: Trajectory) -> None:
    for name in ("time", "q", "v", "a"):
        here, there = getattr(one, name), getattr(other, name)
        assert here is there is None or np.array_equal(here, there), name
    assert (one.joint_names, one.payload, one.via) == (other.joint_names, other.payload, other.via)
    assert {n: v.tolist() for n, v in one.covariates.items()} == {n: v.tolist() for n, v in other.covariates.items()}


def awkward(count: int = 40) -> Trajectory:
    """Numbers that need all their digits, and names that need quoting."""
    rng = np.random.default_rng(5)
    q, v, a = rng.normal(size=(3, count, 7)) * 10.0 ** rng.integers(-12, 1, size=(3, count, 7))
    via = tuple(f'v, "{i}"' if i % 3 == 0 else "" for i in range(count))
    payload = tuple(("none", "p300", "empty")[i % 3] for i in range(count))
    covariates = {"temperature": rng.normal(20.0, 1.0, count), "hold": rng.uniform(size=count)}
    return Trajectory(JOINTS, np.cumsum(rng.uniform(1e-9, 1.0, count)), q, payload, via, v, a, covariates)


@pytest.mark.parametrize("moving", [True, False])
def test_round_trip_keeps_every_bit(tarm: Arm, tmp_path: Path, moving: bool) -> None:
    made = awkward() if moving else replace(awkward(), v=None, a=None, covariates={})
    same(read_trajectory(write_trajectory(made, tmp_path / "t.csv"), tarm), made)


def test_what_the_table_says(tarm: Arm, tmp_path: Path) -> None:
    found = read_trajectory(table(tmp_path), tarm)
    assert found.payload == ("p300", "p300", "none") and found.via == ("start", "", "end")
    np.testing.assert_array_equal(found.time, [0.0, 1.0, 3.0])
    np.testing.assert_array_equal(found.q[1], [2.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.7])
    assert found.v is None and found.a is None and not found.covariates


@pytest.mark.parametrize(
    ("old", "new", "take", "expected"),
    [
        ("q_A1", "q_A1_deg", lambda t: t.q[:, 1], np.deg2rad([0.1, 0.1, 0.0])),
        ("q_A1", "q_A1_mrad", lambda t: t.q[:, 1], [1e-4, 1e-4, 0.0]),
        ("q_A1", "q_A1_rad", lambda t: t.q[:, 1], [0.1, 0.1, 0.0]),
        ("q_M1", "q_M1_mm", lambda t: t.q[:, 0], [2e-3, 2e-3, 2e-3]),
        ("q_M1", "q_M1_cm", lambda t: t.q[:, 0], [2e-2, 2e-2, 2e-2]),
        ("time", "time_ms", lambda t: t.time, [0.0, 1e-3, 3e-3]),
        ("time", "time_min", lambda t: t.time, [0.0, 60.0, 180.0]),
    ],
)
def test_units_by_suffix(tarm: Arm, tmp_path: Path, old: str, new: str, take: object, expected: object) -> None:
    np.testing.assert_allclose(take(read_trajectory(table(tmp_path, (old, new)), tarm)), expected, rtol=1e-15)


def test_covariates_are_kept(tarm: Arm, tmp_path: Path) -> None:
    rows = tuple(f"{row},{value}" for row, value in zip(ROWS, (20.5, 21, -3e1), strict=True))
    found = read_trajectory(table(tmp_path, (HEADER, HEADER + ",oil_temperature"), rows=rows), tarm)
    assert list(found.covariates) == ["oil_temperature"]
    np.testing.assert_array_equal(found.covariates["oil_temperature"], [20.5, 21.0, -30.0])


def test_byte_order_mark_blank_lines_and_crlf(tarm: Arm, tmp_path: Path) -> None:
    plain = read_trajectory(table(tmp_path), tarm)
    path = tmp_path / "bom.csv"
    path.write_bytes(b"\xef\xbb\xbf" + "\r\n\r\n".join((HEADER, *ROWS)).encode() + b"\r\n")
    same(read_trajectory(path, tarm), plain)


def test_a_column_of_remarks_is_left_out_with_a_warning(tarm: Arm, tmp_path: Path) -> None:
    plain, path = read_trajectory(table(tmp_path), tarm), tmp_path / "remarks.csv"
    path.write_text(
        "\n".join(
            [HEADER + ",note", *(f"{row},{text}" for row, text in zip(ROWS, ("slowly", "", "port"), strict=True))]
        )
    )
    with pytest.warns(ArmflexWarning, match="no use for 'note'"):
        same(read_trajectory(path, tarm), plain)


BAD = {
    "missing joint": ([(",q_A3", ",x_A3")], 1, r"no column 'q_A3'.*found: time"),
    "missing joint names the nearest": ([(",q_A3", ",q_A33")], 1, r"did you mean 'q_A"),
    "joints called as in a spreadsheet": ([("q_A3", "A3 [deg]")], 1, r"'A3 \[deg\]' is to be called 'q_A3 \[deg\]'"),
    "a column computed of joints": ([("q_A3", "q_A2+q_A3")], 1, r"'q_A2\+q_A3' is computed of joints"),
    "missing time": ([("time,", "tme,")], 1, r"no column 'time', did you mean 'tme'"),
    "misspelt payload": ([("payload", "paylod")], 1, r"unknown column 'paylod', did you mean 'payload'"),
    "capital via": ([(",via", ",Via")], 1, r"unknown column 'Via', did you mean 'via'"),
    "duplicate": ([(",q_A3", ",q_A2")], 1, r"two columns mean 'q_A2'"),
    "duplicate by unit": ([(",via", ",q_A2_deg")], 1, r"two columns mean 'q_A2': 'q_A2' and 'q_A2_deg'"),
    "unit of length for an angle": ([("q_A3", "q_A3_mm")], 1, r"'mm' is no unit of angle"),
    "misspelt unit": ([("q_M1", "q_M1_mmm")], 1, r"'mmm' is no unit of length, did you mean 'mm'"),
    "unnamed column": ([(",via", ",")], 1, r"column 10 has no name"),
    "no header": ([(HEADER, "0,2,0.1,0.2,0.3,0.4,0.5,0.6,1,1")], 1, r"no header row"),
    "NaN": ([("0.7", "NaN")], 3, r"column 'q_A6' is 'NaN', not a finite number"),
    "infinite": ([("0.7", "1e999")], 3, r"column 'q_A6' is '1e999', not a finite number"),
    "decimal comma": ([("0.7", '"0,7"')], 3, r"column 'q_A6' is '0,7', not a finite number"),
    "underscore": ([("0.7", "1_0")], 3, r"column 'q_A6' is '1_0'"),
    "empty cell": ([("0.7", "")], 3, r"column 'q_A6' is empty"),
    "text": ([("\n1,2", "\n1,two")], 3, r"column 'q_M1' is 'two'"),
    "short row": ([("p300,\n", "p300\n")], 3, r"has 9 cells, the header has 10"),
    "time stands still": ([("\n3,", "\n1,")], 4, r"time does not increase"),
    "time runs back": ([("\n1,", "\n-1,")], 3, r"time does not increase"),
    "unknown payload": ([(",0,,end", ",0,p3000,end")], 4, r"no payload named 'p3000', did you mean 'p300'"),
}


@pytest.mark.parametrize(("edits", "line", "complaint"), BAD.values(), ids=BAD)
def test_bad_table_is_refused_by_line(tarm: Arm, tmp_path: Path, edits: list, line: int, complaint: str) -> None:
    path = table(tmp_path, *edits)
    with pytest.raises(TableError, match=complaint) as caught:
        read_trajectory(path, tarm)
    assert str(caught.value).startswith(f"{path}:{line}: ") and caught.value.place.line == line


@pytest.mark.parametrize("name", ["v_A9", "a_A7", "q_gripper", "times", "Payload_", "vias"])
def test_a_further_column_near_a_known_name_is_refused(tarm: Arm, tmp_path: Path, name: str) -> None:
    rows = tuple(row + ",0" for row in ROWS)
    with pytest.raises(TableError, match=f":1: unknown column '{name}'"):
        read_trajectory(table(tmp_path, (HEADER, f"{HEADER},{name}"), rows=rows), tarm)


@pytest.mark.parametrize("name", ["tolerence_mm", "tol_mm", "tolerances_mm", "tolerence", "tol", "tiem_s", "v_A1_mm"])
def test_a_misspelt_column_is_refused_with_its_unit(tarm: Arm, tmp_path: Path, name: str) -> None:
    rows = tuple(row + ",6" for row in ROWS)
    known = {"to": "tolerance", "ti": "time"}.get(name[:2], "")
    with pytest.raises(TableError, match=f":1: .*'{name}'.*{known}"):
        read_trajectory(table(tmp_path, (HEADER, f"{HEADER},{name}"), rows=rows), tarm)


def test_columns_that_nothing_depends_on_are_named_once(tarm: Arm, tmp_path: Path) -> None:
    names = "accuracy_mm,temperature,session,approach_A1,tool_m"
    path = table(tmp_path, (HEADER, f"{HEADER},{names}"), rows=tuple(row + ",6,20,1,1,2" for row in ROWS))
    with pytest.warns(ArmflexWarning) as said:
        found = read_trajectory(path, tarm)
    (text,) = [str(one.message) for one in said if "unused_column" in str(one.message)]
    assert "'accuracy_mm', 'temperature', 'session', 'tool_m'" in text and "approach" not in text
    assert list(found.covariates) == names.split(",")


def test_a_campaign_given_as_a_path_is_called_one(tarm: Arm, tmp_path: Path) -> None:
    rows = (ROWS[0] + ",,,", *(row + ",1,2,3" for row in ROWS[1:]))
    with pytest.raises(TableError, match=r":2: column 'x' is empty; a path has no readings x y z: is this a campaign"):
        read_trajectory(table(tmp_path, (HEADER, f"{HEADER},x,y,z"), rows=rows), tarm)


def test_velocities_come_for_every_joint_or_not_at_all(tarm: Arm, tmp_path: Path) -> None:
    rows = tuple(row + ",0" for row in ROWS)
    with pytest.raises(TableError, match="no column 'v_M1'"):
        read_trajectory(table(tmp_path, (HEADER, HEADER + ",v_A1"), rows=rows), tarm)


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (HEADER.replace(",", ";").encode() + b"\n0;2;0\n", ":2: has 3 cells, the header has 10"),
        (b"", "is empty"),
        (b"\n\n", "is empty"),
        (HEADER.encode(), "has a header but no rows"),
        (b"\xff\xfe" + HEADER.encode("utf-16-le"), "has a header but no rows"),
        (f'{HEADER}\n0,"2,0\n'.encode(), "is not CSV"),
        (None, "cannot be read: No such file"),
    ],
    ids=["semicolons", "empty", "blank", "no rows", "UTF-16", "open quote", "missing"],
)
def test_what_is_no_table(tarm: Arm, tmp_path: Path, content: bytes | None, complaint: str) -> None:
    path = tmp_path / "t.csv"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(TableError, match=complaint):
        read_trajectory(path, tarm)


def test_midpoints_keep_the_path() -> None:
    made = awkward(6)
    found = made.with_midpoints(np.array([True, False, False, True, True]))
    assert len(found) == 9
    kept = [0, 2, 3, 4, 6, 8]
    for name in ("time", "q", "v", "a"):
        np.testing.assert_array_equal(getattr(found, name)[kept], getattr(made, name))
        for new, left in ((1, 0), (5, 3), (7, 4)):
            middle = 0.5 * (getattr(made, name)[left] + getattr(made, name)[left + 1])
            np.testing.assert_allclose(getattr(found, name)[new], middle, rtol=1e-15)
    assert [found.via[i] for i in kept] == list(made.via) and [found.via[i] for i in (1, 5, 7)] == [""] * 3
    assert [found.payload[i] for i in (1, 5, 7)] == [made.payload[i] for i in (0, 3, 4)]
    assert len(found.covariates["hold"]) == 9
    assert found.covariates["hold"][1] == 0.5 * (made.covariates["hold"][0] + made.covariates["hold"][1])


def test_points_between_rows_lie_on_the_line() -> None:
    made = awkward(4)
    found = made.between(np.full(3, 2), np.array([0.0, 0.25, 1.0]))
    np.testing.assert_array_equal(found.q[0], made.q[2])
    np.testing.assert_allclose(found.q[1], 0.75 * made.q[2] + 0.25 * made.q[3], rtol=0, atol=1e-15)
    np.testing.assert_allclose(found.q[2], made.q[3], rtol=0, atol=1e-15)
    assert found.payload == [made.payload[2]] * 3


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        ({"q": np.zeros((3, 6))}, ShapeError),
        ({"payload": ("none",)}, ShapeError),
        ({"time": np.zeros(0), "q": np.zeros((0, 7)), "payload": (), "via": ()}, ShapeError),
        ({"time": np.array([0.0, 1.0, 1.0])}, InputError),
        ({"time": np.array([0.0, np.nan, 1.0])}, InputError),
    ],
)
def test_a_trajectory_in_memory_is_checked_too(changes: dict, error: type) -> None:
    made = Trajectory(JOINTS, np.arange(3.0), np.zeros((3, 7)), ("none",) * 3, ("",) * 3)
    with pytest.raises(error):
        replace(made, **changes)


@pytest.mark.parametrize("column", ["q_lean", "q_lean_deg"])
def test_the_position_of_a_joint_without_a_drive_is_refused_with_the_drives(tmp_path: Path, column: str) -> None:
    arm = load_arm(ROBOTS / "hybrid_lifter" / "arm.toml")
    passive = next(iter(arm.robot.linkage.passive))
    header = column.replace("lean", passive)
    (tmp_path / "t.csv").write_text(f"time,q_travel,q_slew,{header},q_left,q_right\n0,0,0,0.1,0.9,0.9\n")
    text = f"column '{header}': joint '{passive}' has no drive, and its position follows from those that have one: "
    with pytest.raises(TableError) as met:
        read_trajectory(tmp_path / "t.csv", arm)
    given = "leave it out and give q_lift, q_left, q_right (the length of the cylinder between its pins [m])"
    assert str(met.value).endswith(text + given)
    for ask in (lambda: arm.position(**{passive: 0.1}), lambda: parse_positions(f"{passive}=0.1", arm)):
        with pytest.raises(InputError, match=rf"joint '{passive}' has no drive.* give lift, left, right \(the length"):
            ask()
