"""Points that an instrument's program exported, joined with the rows of a campaign."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from support.measurement_rows import campaign, codes, written

from armflex import Arm, Measurements, read_measurements
from armflex.errors import TableError
from armflex.measured.points import read_points

HEAD = "// SpatialAnalyzer 2023.1\n// Units: mm\n// Frame: A::WORLD\n"
ROWS = campaign(6)
XYZ = [[row[axis] for axis in "xyz"] for row in ROWS]
BARE = [{key: value for key, value in row.items() if key not in ("x", "y", "z")} for row in ROWS]


def line(i: int, name: str, separator: str, scale: float = 1e3) -> str:
    return separator.join([name, *(f"{scale * value:.6f}" for value in XYZ[i])])


def export(folder: Path, body: str, head: str = HEAD) -> Path:
    path = folder / "export.txt"
    path.write_text(f"{head}{body}\n")
    return path


def joined(arm: Arm, folder: Path, body: str, rows: list[dict] = BARE, head: str = HEAD, **stated: str) -> Measurements:
    points = read_points(export(folder, body, head), **stated) if stated else export(folder, body, head)
    return read_measurements(written(folder, rows), arm, points=points)


LAYOUTS = {
    "collection group point": ("A Main p{i}", " "),
    "blanks": ("  A   Main  p{i}", "    "),
    "commas": ("A, Main, p{i}", ", "),
    "tabs": ("Main\tp{i}", "\t"),
    "joined": ("Main::p{i}", ", "),
    "all joined": ("A::Main::p{i}", " "),
    "point only": ("p{i}", " "),
    "quoted": ('"My group" p{i}', " "),
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_layouts_are_read_in_any_order_of_points(heavy: Arm, tmp_path: Path, layout: str) -> None:
    name, separator = LAYOUTS[layout]
    body = "\n".join(line(i, name.format(i=i), separator) for i in reversed(range(6)))
    found = joined(heavy, tmp_path, body)
    np.testing.assert_allclose(found.position, XYZ, atol=1e-9)
    assert found.measured.all() and found.frame == "A::WORLD" and not found.flags


def test_a_header_tells_names_that_are_numbers_and_names_further_columns(heavy: Arm, tmp_path: Path) -> None:
    rows = [row | {"pose": str(i)} for i, row in enumerate(BARE)]
    body = "\n".join(f"Main,{i},{1000 + i},2000,3000,{0.01 * i:.2f}" for i in range(6))
    with pytest.raises(TableError, match="names cannot be distinguished from numbers: add a header"):
        joined(heavy, tmp_path, body, rows)
    for header in ("// Group, Point, X [mm], Y [mm], Z [mm], RMS\n", "Group,Point,X_mm,Y_mm,Z_mm,RMS\n"):
        found = joined(heavy, tmp_path, header + body, rows, "// Frame: World\n")
        np.testing.assert_allclose(found.position[:, 0], 1.0 + 1e-3 * np.arange(6))
        np.testing.assert_allclose(found.covariates["export_RMS"], 0.01 * np.arange(6))


def test_numbered_points_with_decimal_coordinates_need_no_header(heavy: Arm, tmp_path: Path) -> None:
    rows = [row | {"pose": str(i)} for i, row in enumerate(BARE)]
    body = "\n".join(line(i, f"Main {i}", " ") + " 0.0 0.0" for i in range(6))
    np.testing.assert_allclose(joined(heavy, tmp_path, body, rows).position, XYZ, atol=1e-9)


@pytest.mark.parametrize(
    ("head", "scale"),
    [("Units: Meters, Degrees", 1.0), ("Length units = inches", 1 / 0.0254), ("Units: degrees, microns", 1e6)],
)
def test_units_are_those_that_are_stated(heavy: Arm, tmp_path: Path, head: str, scale: float) -> None:
    body = "\n".join(line(i, f"p{i}", " ", scale) for i in range(6))
    found = joined(heavy, tmp_path, body, head=f"# {head}\n# Angular units: deg\n# Coordinate Frame: World\n")
    np.testing.assert_allclose(found.position, XYZ, atol=1e-6)


def test_a_joined_name_is_whole(heavy: Arm, tmp_path: Path) -> None:
    body = "\n".join(f"Main::p{i} {1000 + i} 2000 3000 7" for i in range(6))
    np.testing.assert_allclose(joined(heavy, tmp_path, body).position[:, 2], 3.0)


BODY = "\n".join(line(i, f"Main p{i}", " ") for i in range(6))
REFUSED = {
    "one coordinate is whole": (
        "A,tip,p2,101.5,201.25,125",
        HEAD,
        {},
        "export.txt:4: names cannot be distinguished from num",
    ),
    "no unit": (BODY, "// Frame: World\n", {}, "states no unit: add .*// Unit: mm"),
    "no frame": (BODY, "// Units: mm\n", {}, "states no frame: add .*// Frame: World"),
    "unknown unit": (BODY, "// Units: milimeters\n", {}, "export.txt:1: unit 'milimeters'.*did you mean 'millimeters'"),
    "two units": (BODY, "// Units: mm\n// Units: m\n", {}, "export.txt:2: unit 'm', but 'mm' on line 1"),
    "two frames": (BODY, HEAD + "// Frame: Robot\n", {}, "export.txt:4: frame 'Robot', but 'A::WORLD' on line 3"),
    "another unit asked": (BODY, HEAD, {"unit": "m"}, "export.txt:2: unit 'mm', but 'm' was asked for"),
    "another frame asked": (BODY, HEAD, {"frame": "Base"}, "export.txt:3: frame 'A::WORLD', but 'Base' was asked"),
    "cylindrical": (BODY, HEAD + "// Cylindrical coordinates\n", {}, "export.txt:4: 'Cylindrical': export.*Cartesian"),
    "a cell is text": (BODY + "\nMain p9 1.0 2.0 lost", HEAD, {}, "export.txt:10: expected .*'lost'"),
    "no names": ("1.0 2.0 3.0", HEAD, {}, "export.txt:4: expected a name"),
    "decimal commas": ("Main p1 1,0 2,0 3,0", HEAD, {}, "export.txt:4: expected a name"),
    "nothing": ("", HEAD, {}, "holds no points"),
    "foreign names": (BODY.replace("p", "q"), HEAD, {}, r"no row's name.*rows: p0, p1.*points: Main::q0"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_an_export_that_leaves_a_question_is_refused(heavy: Arm, tmp_path: Path, name: str) -> None:
    body, head, stated, match = REFUSED[name]
    with pytest.raises(TableError, match=match):
        joined(heavy, tmp_path, body, head=head, **stated)


def test_unit_and_frame_may_be_stated_by_the_caller(heavy: Arm, tmp_path: Path) -> None:
    found = joined(heavy, tmp_path, BODY, head="", unit="mm", frame="World")
    np.testing.assert_allclose(found.position, XYZ, atol=1e-9)
    assert found.frame == "World"


def test_rows_without_a_point_are_masked_and_points_without_a_row_are_named(heavy: Arm, tmp_path: Path) -> None:
    body = "\n".join([*(line(i, f"Main p{i}", " ") for i in (0, 1, 3, 5)), "Refs F1 1.0 2.0 3.0"])
    found = joined(heavy, tmp_path, body)
    assert found.measured.tolist() == [True, True, False, True, False, True] and len(found) == 6
    assert codes(found) == ["unmeasured_rows", "surplus_points"]
    assert "2 of 6 rows" in found.flags[0].text and "p2 (line 4), p4 (line 6)" in found.flags[0].text
    assert "1 points" in found.flags[1].text and "Refs::F1 (line 8)" in found.flags[1].text


def test_repeats_are_taken_in_order_and_a_missing_one_is_not_guessed(heavy: Arm, tmp_path: Path) -> None:
    rows = [*BARE, BARE[2] | {"time": 99.0}]
    body = "\n".join(line(i, f"p{min(i, 5)}", " ") for i in range(6))
    found = joined(heavy, tmp_path, body + "\np2 1.0 2.0 3.0", rows)
    np.testing.assert_allclose(found.position[[2, 6]], [XYZ[2], [1e-3, 2e-3, 3e-3]], atol=1e-9)
    with pytest.raises(TableError, match=r"export.txt:6: 'p2': 1 points \(lines 6\) for 2 rows .*lines 4, 8.*'point'"):
        joined(heavy, tmp_path, body, rows)


def test_a_column_point_names_what_was_read(heavy: Arm, tmp_path: Path) -> None:
    names = ["Main::a", "A::Main::b", "c", "", "d", "e"]
    rows = [row | {"point": name} for row, name in zip(BARE, names, strict=True)]
    body = "\n".join(line(i, f"A Main {name}", " ") for i, name in zip((0, 1, 2, 4, 5), "abcde", strict=True))
    found = joined(heavy, tmp_path, body, rows)
    assert found.measured.tolist() == [True, True, True, False, True, True] and "point" not in found.covariates
    np.testing.assert_allclose(found.position[found.measured], np.delete(XYZ, 3, axis=0), atol=1e-9)


def test_groups_that_share_names_are_told_by_the_session(heavy: Arm, tmp_path: Path) -> None:
    rows = [row | {"pose": f"p{i % 3}", "session": f"s{i // 3}"} for i, row in enumerate(BARE)]
    body = "\n".join(line(i, f"s{i // 3} p{i % 3}", " ") for i in (3, 4, 5, 0, 1, 2))
    np.testing.assert_allclose(joined(heavy, tmp_path, body, rows).position, XYZ, atol=1e-9)
    with pytest.raises(TableError, match=r"'p0': 2 points .* in groups 'g1', 'g0' for 2 rows"):
        joined(heavy, tmp_path, body.replace("s", "g"), rows)


def test_time_stamps_become_the_time(heavy: Arm, tmp_path: Path) -> None:
    rows = [{key: value for key, value in row.items() if key != "time"} for row in BARE]
    stamped = "\n".join(line(i, f"p{i}", " ") + f" 2024-03-01 10:0{i}:30" for i in range(6))
    found = joined(heavy, tmp_path, stamped, rows)
    np.testing.assert_allclose(found.time, 60.0 * np.arange(6))
    assert not found.covariates
    kept = joined(heavy, tmp_path, stamped)
    np.testing.assert_allclose(kept.time, 10.0 * np.arange(6))
    assert kept.covariates["export_1"][1] == "2024-03-01T10:01:30"


def test_positions_given_twice_are_refused(heavy: Arm, tmp_path: Path) -> None:
    with pytest.raises(TableError, match=r"rows.csv:1: has a column 'x', and points come from"):
        joined(heavy, tmp_path, BODY, ROWS)


def test_a_frame_that_is_not_the_base_is_flagged(heavy: Arm, tmp_path: Path) -> None:
    arm = dataclasses.replace(heavy, measurement=dataclasses.replace(heavy.measurement, frame="base"))
    assert codes(joined(arm, tmp_path, BODY)) == ["points_frame"]
    assert not codes(joined(arm, tmp_path, BODY, head=f"// Units: mm\n// Frame: A::{arm.robot.base}\n"))


@pytest.mark.slow
def test_the_unit_check_holds_for_points_as_well(heavy: Arm, tmp_path: Path) -> None:
    body = "\n".join(line(i, f"p{i}", " ", 1e6 if i in (1, 4) else 1e3) for i in range(6))
    with pytest.raises(TableError, match=r"rows.csv:3.*lines 3, 6.*mm among m"):
        joined(heavy, tmp_path, body)
