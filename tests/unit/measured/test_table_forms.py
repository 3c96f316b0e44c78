"""Tables as programs of all countries write them, and as ours are read by theirs."""

import csv
import io
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from support.command_line import fine, run_here
from support.small_arms import ROBOTS

from armflex import Arm, Trajectory, read_trajectory, write_trajectory
from armflex.errors import ArmflexWarning, TableError
from armflex.measured.table import read_table, write_table

HEADER = "time,q_M1,q_A1,q_A2,q_A3,q_A4,q_A5,q_A6,payload,via\n"
TEXT = f"{HEADER}0,2,0.1,-0.2,3e-1,0.4,0.5,0.6,p300,Säge\n1,2,0.1,0,0,0,0,.7,,\n"
SEMICOLONS = TEXT.replace(",", ";")
COMMAS = SEMICOLONS.replace(".", ",")


FORMS = {
    "UTF-8 with a mark": TEXT.encode("utf-8-sig"),
    "UTF-16": TEXT.encode("utf-16"),
    "UTF-16 the other way": b"\xfe\xff" + TEXT.encode("utf-16-be"),
    "Unicode text of Excel": TEXT.replace(",", "\t").replace("\n", "\r\n").encode("utf-16"),
    "lines of Windows": TEXT.replace("\n", "\r\n").encode(),
    "semicolons": SEMICOLONS.encode(),
    "semicolons after blank lines": f"\n\n{SEMICOLONS}".encode(),
    "decimal commas": COMMAS.encode(),
    "decimal commas and tabs": COMMAS.replace(";", "\t").encode(),
    "what Excel says to itself": f"sep=;\n{COMMAS}".encode(),
    "Windows-1252": TEXT.encode("cp1252"),
}


@pytest.mark.parametrize("name", FORMS)
def test_a_table_is_read_as_it_comes(tarm: Arm, tmp_path: Path, name: str) -> None:
    (tmp_path / "plain.csv").write_text(TEXT, encoding="utf-8")
    (tmp_path / "rows.csv").write_bytes(FORMS[name])
    plain = read_trajectory(tmp_path / "plain.csv", tarm)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        found = read_trajectory(tmp_path / "rows.csv", tarm)
    np.testing.assert_array_equal(found.q, plain.q)
    assert (found.via, found.payload) == (plain.via, plain.payload) and found.via[0] == "Säge"
    windows = [str(one.message) for one in said if "Windows-1252" in str(one.message)]
    assert len(windows) == (name == "Windows-1252")


@pytest.mark.parametrize("name", ["q_left;upper;first", "q_left;1,5;x"])
def test_a_name_may_have_another_separator_in_it(tmp_path: Path, name: str) -> None:
    write_table(tmp_path / "rows.csv", {name: [0.5, 1.5], "x": [1.0, 2.0]})
    table = read_table(tmp_path / "rows.csv", {})
    assert [column.header for column in table.columns.values()] == [name, "x"]


@pytest.mark.parametrize(
    ("content", "match"),
    [
        (TEXT.encode() + b"\xff", "rows.csv: is UTF-8 text in part only"),
        (b"\x1f\x8b\x08\x00" + b"1,2\n" * 20, "rows.csv: is packed with gzip"),
        (b"PK\x03\x04" + b"1,2\n" * 20, "rows.csv: is a ZIP archive or a workbook"),
        (TEXT.encode("utf-16-le"), r"rows.csv:1: holds the character \\x00"),
        (b"\xff\xfe" + TEXT.encode("utf-16-le")[:-1], "rows.csv: is not UTF-8 text, nor UTF-16 or Windows-1252"),
        (TEXT.encode("cp1252") + b"\x81", "rows.csv: is not UTF-8 text, nor UTF-16 or Windows-1252"),
        (COMMAS.replace("0,5", "0.5", 1).encode(), "rows.csv:2: holds '0.5' with a decimal point where .* a comma"),
        (SEMICOLONS.replace(".7", ",7").encode(), "rows.csv:3: holds ',7' with a decimal comma where .* a point"),
        (TEXT.replace("0.5", '"0,5"').encode(), "rows.csv:2: column 'q_A5' is '0,5', .*: a decimal comma"),
        (f"\n{SEMICOLONS}1;2\n".encode(), "rows.csv:5: has 2 cells, the header has 10"),
    ],
)
@pytest.mark.filterwarnings("ignore:encoding:armflex.ArmflexWarning")
def test_what_can_be_meant_in_two_ways_is_refused(tarm: Arm, tmp_path: Path, content: bytes, match: str) -> None:
    (tmp_path / "rows.csv").write_bytes(content)
    with pytest.raises(TableError, match=match):
        read_trajectory(tmp_path / "rows.csv", tarm)


@pytest.mark.parametrize("unit", ["mn", "MM", "Mm", "m m", "mm "])
def test_a_unit_in_odd_letters(tarm: Arm, tmp_path: Path, unit: str) -> None:
    (tmp_path / "rows.csv").write_text(TEXT.replace("q_M1", f"q_M1_{unit}"), encoding="utf-8")
    if unit.strip() != "mm":
        with pytest.raises(TableError, match=rf"'{unit}' is no unit of length, did you mean 'mm'\?"):
            read_trajectory(tmp_path / "rows.csv", tarm)
    else:
        assert read_trajectory(tmp_path / "rows.csv", tarm).q[0, 0] == 2e-3


RUNS = ("=1+1", "=cmd|' /C calc'!A0", "+1+2", "-1+2", "-", "@sum", "\tx", "\rx", "'=x", "''=x", "'-5", "'+", "'@")
PLAIN = ("-5", "+1.5", "-1e-3", "'quoted'", "'", "plain", "a=b", "", " x")


def test_no_text_is_run_by_a_spreadsheet_and_all_are_read_again(tmp_path: Path) -> None:
    texts = (*RUNS, *PLAIN)
    write_table(tmp_path / "t.csv", {"=name": texts, "number": [-1.5] * len(texts)})
    cells = list(csv.reader(io.StringIO((tmp_path / "t.csv").read_bytes().decode(), newline="")))
    assert cells[0] == ["'=name", "number"]
    assert [row[0] for row in cells[1:]] == [*(f"'{text}" for text in RUNS), *PLAIN]
    assert {row[1] for row in cells[1:]} == {"-1.5"}
    assert read_table(tmp_path / "t.csv", {}).columns["=name"].cells == texts


def test_names_go_through_a_path_and_a_sheet_as_they_are(tarm: Arm, tmp_path: Path) -> None:
    q = np.tile(tarm.position(), (2, 1))
    path = Trajectory(tarm.joint_names, np.arange(2.0), q, ("none", "none"), ("=1+1", "-"))
    write_trajectory(path, tmp_path / "path.csv")
    assert (
        "'=1+1" in (tmp_path / "path.csv").read_text() and read_trajectory(tmp_path / "path.csv", tarm).via == path.via
    )
    arm = (ROBOTS / "heavy_six" / "arm.toml").read_text().replace("[flexure.J2]", '[flexure."=J2"]')
    assert '"=J2"' in arm
    (tmp_path / "robot.urdf").write_bytes((ROBOTS / "heavy_six" / "robot.urdf").read_bytes())
    (tmp_path / "arm.toml").write_text(arm)
    fine(run_here(tmp_path, "export", "arm.toml", "--to", "sheet", "-o", "s.csv"))
    assert ",'=J2," in (tmp_path / "s.csv").read_text() and ",=J2" not in (tmp_path / "s.csv").read_text()


def workbook(path: Path, *sheets: list[list[object]]) -> Path:
    from openpyxl import Workbook

    book = Workbook()
    for i, rows in enumerate(sheets):
        sheet = book.worksheets[0] if i == 0 else book.create_sheet()
        for row in rows:
            sheet.append(row)
    book.save(path)
    return path


def cells() -> list[list[object]]:
    """Return the table as Excel keeps it: numbers, texts and empty cells."""
    header, *rows = csv.reader(io.StringIO(TEXT))
    return [header, *([*map(float, row[:8]), *(text or None for text in row[8:])] for row in rows)]


def test_a_workbook_of_excel_is_a_table(tarm: Arm, tmp_path: Path) -> None:
    pytest.importorskip("openpyxl")
    (tmp_path / "plain.csv").write_text(TEXT, encoding="utf-8")
    plain = read_trajectory(tmp_path / "plain.csv", tarm)
    found = read_trajectory(workbook(tmp_path / "rows.xlsx", cells(), [[None, ""]]), tarm)
    np.testing.assert_array_equal(found.q, plain.q)
    assert (found.via, found.payload) == (plain.via, plain.payload)
    with pytest.warns(ArmflexWarning, match=r"rows\.xlsx:1: not read, a title before the header: 'Path of a day'"):
        titled = read_trajectory(workbook(tmp_path / "rows.xlsx", [["Path of a day"], [""], *cells()]), tarm)
    np.testing.assert_array_equal(titled.q, plain.q)
    odd = {
        r"has 2 sheets that hold something \(Sheet, Sheet1\)": (cells(), [[1]]),
        "rows.xlsx:2: formula =1[+]1 has no value": ([cells()[0], ["=1+1", *cells()[1][1:]]],),
        "rows.xlsx:3: column 'time' is 'x'": ([*cells()[:2], ["x", *cells()[2][1:]]],),
        "rows.xlsx:4: has 11 cells, the header has 10": ([*cells(), [*cells()[2][:9], "", "more"]],),
        "rows.xlsx: has 0 sheets": ([],),
    }
    for match, sheets in odd.items():
        with pytest.raises(TableError, match=match):
            read_trajectory(workbook(tmp_path / "rows.xlsx", *sheets), tarm)
    whole = (tmp_path / "rows.xlsx").read_bytes()
    for spoilt in (b"", b"PK", whole[: len(whole) // 2], whole.replace(b"PK", b"QK")):
        (tmp_path / "rows.xlsx").write_bytes(spoilt)
        with pytest.raises(TableError, match=r"rows\.xlsx: cannot be read as an Excel workbook"):
            read_trajectory(tmp_path / "rows.xlsx", tarm)


def test_without_openpyxl_a_workbook_says_what_to_do(
    tarm: Arm, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "openpyxl", None)
    (tmp_path / "rows.xlsx").write_bytes(b"PK")
    with pytest.raises(TableError, match=r"pip install 'armflex\[excel\]'; or save it as CSV UTF-8"):
        read_trajectory(tmp_path / "rows.xlsx", tarm)


def test_files_that_are_exchanged_are_named(tmp_path: Path) -> None:
    arm, path = ROBOTS / "heavy_six" / "arm.toml", ROBOTS / "heavy_six" / "trajectory.csv"
    said = fine(run_here(tmp_path, "check", path, arm, "--tolerance", "5mm"), 2).stderr
    assert "trajectory.csv is no arm (ARM)" in said and "arm.toml is no table (TRAJ.csv): are they exchanged?" in said
    said = fine(run_here(tmp_path, "view", arm, "--traj", arm, "-o", "o.html"), 2).stderr
    assert "arm.toml is no table (TRAJ.csv): is another file meant?" in said and "exchanged" not in said
    assert "trajectory.csv is no arm" in fine(run_here(tmp_path, "deflect", path), 2).stderr
