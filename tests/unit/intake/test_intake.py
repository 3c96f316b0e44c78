"""`intake`: exports of trackers and logs of controllers, as their programs write them, joined to one campaign."""

import csv
import json
import tomllib
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
from support.command_line import fine, run_here
from support.exports import EXPORTS, LOGS, NAMES, XYZ, Q, comma, written

from armflex.errors import InputError, TableError
from armflex.intake import intake
from armflex.measured.table import write_table


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
@pytest.mark.parametrize("export", EXPORTS)
@pytest.mark.parametrize("log", LOGS)
def test_logs_and_exports_are_joined(tmp_path: Path, log: str, export: str, encoding: str) -> None:
    if log == "ur" and export == "leica":
        pytest.skip("neither names nor times nor an order are shared")
    found = intake(written(tmp_path, LOGS[log], EXPORTS[export], encoding), 5e-5)
    joints = [name for name in found.columns if name.startswith("q_")]
    assert np.allclose(np.array([found.columns[name] for name in joints]).T, np.radians(Q), atol=1e-6)
    assert np.allclose(np.array([found.columns[axis] for axis in "xyz"]).T, 1e-3 * XYZ, atol=1e-9)
    assert found.joined.startswith("row by row" if log == "ur" else "by name")


def test_an_open_unit_is_asked_for_or_refused_with_everything_else(tmp_path: Path) -> None:
    small = "Point,J1,J2\n" + "\n".join(f"{name},0.1,0.{i}" for i, name in enumerate(NAMES))
    bare = "Name;X;Y;Z\n" + "\n".join(f"{n};{';'.join(map(comma, p))}" for n, p in zip(NAMES, XYZ, strict=True))
    paths = written(tmp_path, small, bare)
    with pytest.raises(InputError) as caught:
        intake(paths, 5e-5)
    lines = str(caught.value).splitlines()
    assert len(lines) == 5
    assert all("--take" in line for line in lines)
    answered = intake(paths, 5e-5, ask=lambda question, choices: choices[0])
    assert answered.columns["q_J1"][0] == pytest.approx(np.radians(0.1))
    taken = {"J1": "q_J1_rad", "J2": "q_J2_rad", "X": "x_mm", "Y": "y_mm", "Z": "z_mm"}
    assert intake(paths, 5e-5, taken).columns["q_J1"][0] == pytest.approx(0.1)


def test_a_campaign_as_it_is_needs_no_intake(tmp_path: Path) -> None:
    path = tmp_path / "campaign.csv"
    path.write_text("q_J1,x,y,z,sigma\n" + "\n".join(f"0.{i},1,2,3,1e-4" for i in range(5)))
    with pytest.raises(InputError, match="has x y z and sigma, as a campaign: calibrate and trace read one as"):
        intake([path], 5e-5)
    path.write_text("q_J1_deg,x_mm,y_mm,z_mm,sigma_mm\n" + "\n".join(f"0.{i},1,2,3,0.1" for i in range(5)))
    with pytest.raises(InputError, match="as a campaign: calibrate and trace read one as"):
        intake([path], 5e-5)
    assert "sigma_mm" not in intake([path], 5e-5, {"sigma_mm": "unused"}).columns
    path.write_text(path.read_text().replace("q_J1_deg", "J1 [deg]"))
    with pytest.raises(InputError, match="'sigma_mm' says how well a coordinate is measured, as --sigma does: --take"):
        intake([path], 5e-5)
    log, export = tmp_path / "log.csv", tmp_path / "points.csv"
    log.write_text("point,q_J1_deg\n" + "\n".join(f"P{i},{i}.5" for i in range(5)))
    export.write_text("point,x_mm,y_mm,z_mm,sigma_mm\n" + "\n".join(f"P{i},{i}01.5,20{i}.5,3,0.1" for i in range(5)))
    with pytest.raises(InputError, match="'sigma_mm' says how well a coordinate is measured, as --sigma does: --take"):
        intake([log, export], 5e-5)
    assert "sigma_mm" not in intake([log, export], 5e-5, {"sigma_mm": "unused"}).columns


def test_columns_are_listed_in_the_order_of_the_files(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("J3,J1,J2,J6,J5,J4\n" + "\n".join(f"{i}.5,0.{i},1,2,3,4" for i in range(5)))
    with pytest.raises(InputError, match=r"--take Q: no file has this column \(columns: J3, J1, J2, J6, J5, J4\)"):
        intake([path], None, {"Q": "q_J1"})


def test_two_targets_are_two_instruments(tmp_path: Path) -> None:
    both = "Name;X [mm];Y [mm];Z [mm]\n" + "\n".join(
        f"{n}_T{t};{';'.join(map(comma, p + 100 * t))}" for n, p in zip(NAMES, XYZ, strict=True) for t in (1, 2)
    )
    found = intake(written(tmp_path, LOGS["degrees"], both), 5e-5)
    assert np.allclose(found.columns["x"], 1e-3 * (XYZ[:, 0] + 100))
    assert np.allclose(found.columns["target2_x"], 1e-3 * (XYZ[:, 0] + 200))
    assert "[instrument.target2]" in found.declare


def test_an_export_in_two_files_is_one(tmp_path: Path) -> None:
    """The second was a further target, at half of the rows; one that is read again is neither."""
    log, export = spelt(tmp_path, [f"J{i}" for i in range(1, 7)])
    head, *rows = export.read_text().splitlines()
    for name, kept in (("a", rows[:3]), ("b", rows[3:]), ("all", rows)):
        (tmp_path / f"{name}.csv").write_text("\n".join([head, *kept]) + "\n")
    for second in ("b", "all"):
        found = intake([log, tmp_path / "a.csv", tmp_path / f"{second}.csv"], 5e-5)
        assert np.allclose(np.array([found.columns[axis] for axis in "xyz"]).T, 1e-3 * XYZ, atol=1e-9)
        assert "target2_x" not in found.columns
        assert f"{second}.csv goes on with the target of the export before it" in found.notes
    name, x, *others = rows[2].split(",")
    (tmp_path / "b.csv").write_text("\n".join([head, ",".join([name, str(float(x) + 0.1), *others]), *rows[3:]]) + "\n")
    with pytest.raises(InputError, match=rf"b\.csv: has '{name}', which another export has 0\.1 mm from there"):
        intake([log, tmp_path / "a.csv", tmp_path / "b.csv"], 5e-5)


def test_rows_without_a_point_stay_and_are_said(tmp_path: Path) -> None:
    fewer = "\n".join(EXPORTS["spatialanalyzer"].splitlines()[:-1])
    found = intake(written(tmp_path, LOGS["degrees"], fewer), 5e-5)
    assert list(found.columns["x"])[-1] == ""
    assert "P006" in found.notes[0]


def test_points_between_thousands_are_none_of_decimals(tmp_path: Path) -> None:
    german = "Name;X [mm];Y [mm];Z [mm]\n" + "\n".join(f"{name};1.234,5;-2.000.001,25;3,0" for name in NAMES)
    found = intake(written(tmp_path, LOGS["degrees"], german), 5e-5)
    assert found.columns["x"][0] == pytest.approx(1.2345)
    assert found.columns["y"][0] == pytest.approx(-2000.00125)


def test_what_the_controller_logs_of_its_tool_is_not_measured(tmp_path: Path) -> None:
    lines = LOGS["degrees"].splitlines()
    log = "\n".join([f"{lines[0]},X,Y,Z,A,B,C", *(f"{line},1.0,2.0,3.0,4.0,5.0,6.0" for line in lines[1:])])
    found = intake(written(tmp_path, log, EXPORTS["leica"]), 5e-5)
    assert np.allclose(np.array([found.columns[axis] for axis in "xyz"]).T, 1e-3 * XYZ, atol=1e-9)
    assert set(found.columns) == {"pose", *(f"q_J{i}" for i in range(1, 7)), "x", "y", "z", "sigma"}


def test_clocks_join_where_there_is_nothing_else(tmp_path: Path) -> None:
    log = "time," + ",".join(f"J{i} [deg]" for i in range(1, 7)) + "\n"
    log += "\n".join(f"10:00:{10 * i:02d},{','.join(map(str, Q[i]))}" for i in range(5))
    export = "Zeit;X [mm];Y [mm];Z [mm]\n"
    export += "\n".join(f"10:00:{10 * i + 1:02d};{';'.join(map(comma, XYZ[i]))}" for i in range(6) if i != 5)
    export += "\n10:02:00;1,000;2,000;3,000"
    found = intake(written(tmp_path, log, export), 5e-5)
    assert found.joined == "by time, 1 s apart"
    assert np.allclose(np.array([found.columns[axis] for axis in "xyz"]).T, 1e-3 * XYZ[:5])


@pytest.mark.parametrize(
    ("log", "export", "said"),
    [
        ("", "", "holds no rows of numbers"),
        (LOGS["degrees"], "a;b;c\n1;2;3\n4;5;6\n", "neither joints nor x y z"),
        (LOGS["degrees"], LOGS["bare"], "2 files have joints and 0 have x y z"),
        (LOGS["degrees"].replace("J2", "J1"), EXPORTS["leica"], "two columns are called"),
    ],
)
def test_what_does_not_fit_is_said(tmp_path: Path, log: str, export: str, said: str) -> None:
    with pytest.raises((InputError, TableError), match=said):
        intake(written(tmp_path, log, export), 5e-5)


def test_the_command_writes_a_campaign_and_says_what_it_took(tmp_path: Path) -> None:
    paths = written(tmp_path, LOGS["kuka"], EXPORTS["polyworks"])
    out = fine(run_here(tmp_path, "intake", *paths, "--sigma", "0.05mm", "-o", tmp_path / "campaign.csv")).stdout
    assert "joint A1" in out
    assert "by name" in out
    rows = list(csv.DictReader((tmp_path / "campaign.csv").open()))
    assert [float(row["x"]) for row in rows] == pytest.approx((1e-3 * XYZ[:, 0]).tolist())
    again = write_table(tmp_path / "same.csv", {name: [row[name] for row in rows] for name in rows[0]})
    assert again.exists()


ROWS = ((0, 290, 0, -90), (-90, 0, 270, 0), (0, 0, 70, -90), (0, 302, 0, 90), (0, 0, 0, -90), (180, 72, 0, 0))
"""theta, d, a and alpha of each joint of a small arm, in degrees and mm."""


@pytest.mark.slow
def test_three_files_of_metrology_come_to_a_sheet(tmp_path: Path) -> None:
    """A DH table, a log in degrees, an export of two targets: a pair exchanged, one reading 35 mm off."""
    rng = np.random.default_rng(7)
    off, more = np.radians(rng.normal(0.0, 0.15, 6)), rng.normal(0.0, 0.4, (6, 2))
    q = rng.uniform([-120, -60, -60, -120, -80, -150], [120, 80, 60, 120, 80, 150], (80, 6)).round(3)
    log, points = ["Pose;" + ";".join(f"J{i} [deg]" for i in range(1, 7))], list[np.ndarray]()
    for i, row in enumerate(q):
        turn, place = np.eye(3), np.zeros(3)
        for value, zero, (theta, d, a, alpha), (dd, da) in zip(np.radians(row), off, ROWS, more, strict=True):
            (s, v), (c, w) = (one([value + zero + np.radians(theta), np.radians(alpha)]) for one in (np.sin, np.cos))
            place = place + turn @ [(a + da) * c, (a + da) * s, d + dd]
            turn = turn @ [[c, -s * w, s * v], [s, c * w, -c * v], [0.0, v, w]]
        points += [place + turn @ target + rng.normal(0.0, 0.03, 3) for target in ([60, 10, 80], [-55, -20, 70])]
        log.append(f"M{i};" + ";".join(map(comma, row)))
    points[80], points[82] = points[82], points[80]
    points[40] = points[40] + [0.0, 35.0, 0.0]
    export = ["Report", "Name;X [mm];Y [mm];Z [mm]"]
    export += [f"M{i // 2}_T{i % 2 + 1};{';'.join(map(comma, point))}" for i, point in enumerate(points)]
    written(tmp_path, "\n".join(log), "\n".join(export))
    table = [
        "Axis;theta [deg];d [mm];a [mm];alpha [deg]",
        *(f"{i};{';'.join(map(str, r))}" for i, r in enumerate(ROWS)),
    ]
    (tmp_path / "dh.csv").write_text("\n".join(table))
    asked = ("intake", "dh.csv", "log.txt", "export.txt", "--sigma", "0.05mm", "-o", "rows.csv", "--arm", "arm.toml")
    assert "--dh standard or --dh modified" in run_here(tmp_path, *asked).stderr
    assert not (tmp_path / "rows.csv").exists()
    fine(run_here(tmp_path, *asked, "--dh", "standard"))
    out = fine(run_here(tmp_path, "calibrate", "arm.toml", "rows.csv", "-o", "fit.toml"))
    named = " ".join((out.stdout + out.stderr).split())
    assert all(f"rows.csv:{line}" in named for line in (22, 42, 43))
    assert "exchanged with the reading of line 43" in named
    fine(run_here(tmp_path, "export", "fit.toml", "--to", "sheet", "-o", "sheet.csv"))
    sheet = {
        (row["section"], row["of"], row["quantity"]): row for row in csv.DictReader((tmp_path / "sheet.csv").open())
    }
    direct = fine(
        run_here(tmp_path, "calibrate", "arm.toml", "log.txt", "export.txt", "--sigma", "0.05mm", "-o", "f.toml")
    )
    assert "log.txt:22" in direct.stdout  # a row is named by its line in the log
    assert "by name, targets 1, 2" in direct.stdout
    fine(run_here(tmp_path, "intake", "log.txt", "-o", "path.csv"))
    fine(run_here(tmp_path, "export", "fit.toml", "--to", "krl", "--traj", "path.csv", "-o", "path.src"))
    assert (tmp_path / "path.src").read_text().count("PTP {E6AXIS") == 80
    # Where the target is on the flange, and the instrument, are nothing to what the campaign says of the rest.
    fine(run_here(tmp_path, "compensate", "fit.toml", "path.csv", "--best-effort", "-o", "c.csv", "--json", "c.json"))
    run_here(tmp_path, "check", "fit.toml", "path.csv", "--tolerance", "5mm", "--json", "k.json")
    made, checked = (json.loads((tmp_path / name).read_text()) for name in ("c.json", "k.json"))
    assert made["sigma_m"] > 1e-3
    assert max(made["relative_sigma_m"], checked["relative_sigma_m"]) < 1e-4
    for i in range(1, 5):  # zero and theta are one number, which is known far better than either
        zero = sheet["joint_offset", f"J{i + 1}", "offset"]
        assert float(zero["std"]) < 2e-4
        assert float(zero["value"]) == pytest.approx(off[i], abs=4.0 * float(zero["std"]))
    found = float(sheet["dh_standard", "J2", "a"]["value"])
    assert found == pytest.approx(1e-3 * (270.0 + more[1, 1]), abs=1e-4)


@pytest.mark.parametrize(
    ("header", "form", "asked"),
    [
        ("theta_i;d_i [mm];a_(i-1);alpha_(i-1)", "modified", None),
        ("Joint;alpha (deg);a (mm);d (mm);theta (deg)", "standard", "standard"),
        ("θ;d;a;α", "standard", "standard"),
    ],
)
def test_dh_tables_as_data_sheets_have_them(tmp_path: Path, header: str, form: str, asked: str | None) -> None:
    spelt = [cell.replace("θ", "theta").replace("α", "alpha") for cell in header.split(";")]
    first = [next((name for name in ("theta", "alpha", "d", "a") if cell.startswith(name)), "") for cell in spelt]
    order = [name for name in first if name]
    keys = ("theta", "d", "a", "alpha")
    rows = [";".join(["1"] * header.startswith("Joint") + [str(row[keys.index(key)]) for key in order]) for row in ROWS]
    (tmp_path / "dh.csv").write_text("\n".join([header, *rows]))
    found = intake([tmp_path / "dh.csv", *written(tmp_path, LOGS["degrees"], EXPORTS["leica"])], 5e-5, dh=asked)
    assert found.arm is not None
    assert f'dh = "{form}"' in found.arm
    names = ("elbow", "shoulder_lift", "shoulder_pan", "wrist_1", "wrist_2", "wrist_3")  # as ROS sorts them
    rows = "\n".join(",".join([name, *map(str, np.radians(q))]) for name, q in zip(NAMES, Q, strict=True))
    (tmp_path / "log.txt").write_text("name," + ",".join(f"position.{one}_joint" for one in names) + f"\n{rows}")
    sorted_ = intake([tmp_path / name for name in ("dh.csv", "log.txt", "export.txt")], 5e-5, dh=asked).arm
    assert sorted_ is not None
    assert sorted_.index("shoulder_pan_joint =") < sorted_.index("shoulder_lift_joint = { theta_deg = -90.0")
    assert "J2 = { theta_deg = -90.0, d_mm = 0.0, a_mm = 270.0, alpha_deg = 0.0 }" in found.arm


def test_a_log_alone_is_a_path(tmp_path: Path) -> None:
    found = intake(written(tmp_path, LOGS["kuka"], EXPORTS["leica"])[:1], np.nan)
    assert found.columns["via"] == NAMES
    assert found.columns["time"] == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    assert "x" not in found.columns


def test_whatever_else_a_log_has_is_kept(tmp_path: Path) -> None:
    """Sockets by name and heights that were read in some rows only: an instrument that the arm file declares."""
    rows = "12;30,5;a;101,2\n20;-3,25;;\n55;1;b;99,5\n"
    (tmp_path / "log.csv").write_text(f"J1 [deg];J2 [deg];block;ruler_mm\n{rows}")
    found = intake([tmp_path / "log.csv"], None).columns
    assert found["block"] == ["a", "", "b"] and found["ruler_mm"] == ["101.2", "", "99.5"]


@pytest.mark.parametrize("title", ["Einheiten;mm;;", "Bericht 7, alles in mm", "Units (length): mm", "# unit = mm"])
def test_a_title_may_state_the_unit(tmp_path: Path, title: str) -> None:
    bare = EXPORTS["leica"].replace("_mm", "").replace("\t", ";")
    found = intake(written(tmp_path, LOGS["degrees"], f"{title}\n{bare}"), 5e-5)
    assert np.allclose(found.columns["x"], 1e-3 * XYZ[:, 0])


@pytest.mark.parametrize(
    ("title", "unit", "factor", "head"),
    [
        ("# joint angles in gon", "gon", 200.0 / np.pi, ""),
        ("# Units: mm, rad", "rad", 1.0, ""),
        ("# all in mrad", "mrad", 1e3, ""),
        ("# joint speeds in rad/s", "deg", 180.0 / np.pi, ""),
        ("# tool's orientation in rad", "deg", 180.0 / np.pi, " [deg]"),
        ("# joint angles in rad", None, 1.0, " [deg]"),
        ("# joint angles in rad", None, 180.0 / np.pi, ""),
    ],
)
def test_a_comment_may_state_the_unit_of_joints(
    tmp_path: Path, title: str, unit: str | None, factor: float, head: str
) -> None:
    """The guess was degrees, whatever the comment said."""
    paths = spelt(tmp_path, [f"J{i}" for i in range(1, 7)])
    angles = np.linspace(-2.0, 2.0, 6 * len(NAMES)).reshape(-1, 6)
    rows = [",".join(map(str, [name, *row])) for name, row in zip(NAMES, factor * angles, strict=True)]
    heads = ",".join(f"J{i}{head}" for i in range(1, 7))
    paths[0].write_text("\n".join([title, f"pose,{heads}", *rows]) + "\n")
    if unit is None:
        with pytest.raises(InputError, match="is in deg, and the file's head says rad: --take 'J1"):
            intake(paths, 5e-5)
        return
    found = intake(paths, 5e-5)
    assert {taken[3] for taken in found.taken if taken[2].startswith("joint")} == {unit}
    assert np.allclose(np.array([found.columns[f"q_J{i}"] for i in range(1, 7)]).T, angles, atol=1e-9)


def test_days_beside_clocks_and_stamps_in_wide_exports(tmp_path: Path) -> None:
    """A log has day and time in two columns, and an export more texts than numbers; an open unit is asked for once."""
    days = ["12.03.2024"] * 4 + ["13.03.2024"] * 2
    clocks = [f"23:5{5 + i}:00" for i in range(4)] + ["00:00:30", "00:02:00"]
    log = "Nr;Datum;Uhrzeit;A1 [deg];A2 [deg]\n" + "\n".join(
        f"{i + 1};{days[i]};{clocks[i]};{comma(Q[i, 0])};{comma(Q[i, 1])}" for i in range(6)
    )
    wide = "// Units: Millimeters\nCollection;Group;Point;X;Y;Z;Timestamp\n" + "\n".join(
        f"A;Robot;{i};{';'.join(map(comma, XYZ[i]))};{days[i]} {clocks[i]}" for i in range(6) if i != 2
    )
    found = intake(written(tmp_path, log, wide), 5e-5)
    day = "2024-03-1"
    assert found.columns["time"][:4] == [f"{day}2T23:5{5 + i}:00" for i in range(4)]
    assert found.columns["time"][4:] == [f"{day}3T00:00:30", f"{day}3T00:02:00"]
    assert found.joined.startswith("by time")
    assert found.columns["x"][2] == ""
    assert found.columns["y"][5] == pytest.approx(1e-3 * XYZ[5, 1])
    assert "Nr" not in found.columns


@pytest.mark.parametrize(
    ("head", "stamps", "begins", "lasts"),
    [("Timestamp", "03/12/2024 23:50:00|03/13/2024 00:10:00", "2024-03-12T23:50", 1200.0),
     ("Timestamp", "30/01/2024 23:50:00|01/02/2024 00:10:00", "2024-01-30T23:50", 87600.0),
     ("Zeit", "12. März 2024 10:00|13. März 2024 10:00", "2024-03-12T10:00", 86400.0),
     ("Time", "Tue Mar 12 10:00:00 2024|Tue Mar 12 10:00:05 2024", "2024-03-12T10:00", 5.0),
     ("Fecha", "12-ago-2024 10:00:00|12-ago-2024 10:00:05", "2024-08-12T10:00", 5.0),
     ("Date", "45363.5|45363.75", "2024-03-12T12:00", 21600.0)],
)  # fmt: skip
def test_days_are_written_as_people_write_them(
    tmp_path: Path, head: str, stamps: str, begins: str, lasts: float
) -> None:
    """Of a day whose month may come first all of a file are of one kind: that which makes it short."""
    first, last = stamps.split("|")
    rows = [f"{name},{first if i < 3 else last},{10 * i},{20 * i}" for i, name in enumerate(NAMES)]
    path = tmp_path / "log.csv"
    path.write_text("\n".join([f"Point,{head},J1 [deg],J2 [deg]", *rows]))
    export = written(tmp_path, "", EXPORTS["spatialanalyzer"])[1]
    time = intake([path, export], 5e-5).columns["time"]
    assert str(time[0]).startswith(begins)
    between = datetime.fromisoformat(time[-1]) - datetime.fromisoformat(time[0])
    assert between.total_seconds() == pytest.approx(lasts)


def test_a_day_that_may_be_another_one_is_said(tmp_path: Path) -> None:
    paths = spelt(tmp_path, [f"J{i}" for i in range(1, 7)])
    lines = paths[0].read_text().splitlines()
    paths[0].write_text(
        "\n".join([f"Zeit,{lines[0]}", *(f"03/12/2024 10:0{i}:00,{line}" for i, line in enumerate(lines[1:]))])
    )
    assert any("is taken as 2024-12-03, and may be 2024-03-12" in note for note in intake(paths, 5e-5).notes)


def test_lines_may_end_as_on_old_macs(tmp_path: Path) -> None:
    paths = spelt(tmp_path, [f"J{i}" for i in range(1, 7)], "name,X misurata [mm],Y misurata [mm],Z misurata [mm]")
    for path in paths:
        path.write_bytes(path.read_bytes().replace(b"\n", b"\r"))
    found = intake(paths, 5e-5)
    assert np.allclose(np.array([found.columns[axis] for axis in "xyz"]).T, 1e-3 * XYZ, atol=1e-9)


def test_what_is_taken_outweighs_what_is_guessed(tmp_path: Path) -> None:
    log = "Time,Timestamp,J1 [deg]\n" + "\n".join(f"{i},{100 + 2 * i},{10 * i}" for i in range(6))
    paths = written(tmp_path, log, EXPORTS["leica"])[:1]
    with pytest.raises(InputError, match="are all time: --take one"):
        intake(paths, None)
    assert intake(paths, None, {"Timestamp": "time"}).columns["time"][-1] == 10.0


def picture_folder(folder: Path, names: list[str]) -> Path:
    (folder / "shots").mkdir()
    for name in names:
        (folder / "shots" / name).write_bytes(b"")
    return folder / "shots"


@pytest.mark.parametrize(
    ("names", "how", "missing"),
    [
        ([f"{name}.png" for name in NAMES[1:]], "by name", 0),
        ([f"shot_{i + 1}.jpg" for i in range(6) if i != 3], "by the number in their names", 3),
        ([f"IMG_4{i:03d}.png" for i in range(6)], "row by row", None),
        ([f"IMG_20240312_1000{10 * i:02d}.jpg" for i in range(6) if i != 1], "by time", 1),
    ],
)
def test_pictures_are_joined_to_a_log(tmp_path: Path, names: list[str], how: str, missing: int | None) -> None:
    named = how == "by name"
    log = ("Pose" if named else "Time") + ",J1 [deg],J2 [deg]\n"
    log += "\n".join(f"{NAMES[i] if named else f'10:00:{10 * i:02d}'},{Q[i, 0]},{Q[i, 1]}" for i in range(6))
    (tmp_path / "log.csv").write_text(log)
    found = intake([tmp_path / "log.csv", picture_folder(tmp_path, names)], None)
    assert found.joined.startswith(f"pictures {how}")
    expected = [f"shots/{name}" for name in names]
    if missing is not None:
        expected.insert(missing, "")
    assert found.columns["cam"] == expected
    assert "x" not in found.columns


def test_a_board_in_one_option_and_a_urdf_are_an_arm_file(tmp_path: Path) -> None:
    """Pictures of a ChArUco board, a log whose joints are numbers, a URDF: the campaign and the arm file for it."""
    cv2 = pytest.importorskip("cv2")
    from support import servo_arm as servo

    from armflex import load_arm, read_measurements

    markers = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    drawn = cv2.aruco.CharucoBoard((8, 6), 0.03, 0.022, markers).generateImage((640, 480), marginSize=20)
    folder = picture_folder(tmp_path, [])
    for i in range(3):
        cv2.imwrite(str(folder / f"{i}.png"), drawn if i else drawn[:40])
    (tmp_path / "servo.urdf").write_text(servo.urdf())
    rows = "\n".join(f"{i};{';'.join(map(str, 5.0 * np.arange(5) + i))}" for i in range(3))
    (tmp_path / "log.csv").write_text("shot;" + ";".join(f"J{i} [deg]" for i in range(1, 6)) + "\n" + rows)
    asked = ("intake", "servo.urdf", "log.csv", "shots", "-o", "rows.csv", "--arm", "arm.toml", "--board")
    for spoilt, said in {
        "charuco,8x6,30mm": "expected charuco,columnsxrows",
        "charuko,8x6,30mm,22mm": "is no board",
        "charuco,11x7,30mm,22mm,5X5_50": "no picture shows this board",
    }.items():
        assert said in run_here(tmp_path, *asked, spoilt).stderr
    assert not (tmp_path / "rows.csv").exists()
    out = fine(run_here(tmp_path, *asked, "charuco,8x6,30mm,22mm")).stdout
    assert "2 of 3 pictures show the board, 35 corners" in out
    arm = load_arm(tmp_path / "arm.toml")
    read = read_measurements(tmp_path / "rows.csv", arm).readings.kinds[0]
    assert list(np.isfinite(read.sigma).sum(axis=1)) == [0, 70, 70]
    assert arm.sensors["cam"].about.image.tolist() == [640, 480]
    corners = "picture,corner,u,v\n" + "\n".join(f"{i}.png,{j},{j}.5,2.0" for i in (0, 2) for j in range(4))
    (tmp_path / "corners.csv").write_text(corners)
    found = intake([tmp_path / "log.csv", tmp_path / "corners.csv"], None, board="board = {}", on_arm=True)
    assert found.columns["cam"] == ["0.png", "", "2.png"]
    assert 'corners = "corners.csv"' in found.declare


def test_workbooks_as_an_office_has_them(tmp_path: Path) -> None:
    """Titles, units in brackets below the names, decimal commas as text, a coordinate a line, points that end in a
    letter of a target.
    """
    openpyxl = pytest.importorskip("openpyxl")
    log, export = openpyxl.Workbook(), openpyxl.Workbook()
    for row in (["Roboter", None, "Datum:"], [None], ["Nr", "Station", "Achse 1", "Achse 2", "Temperatur", "Bemerkung"],
                [None, None, "[°]", "[°]", "[°C]", None]):  # fmt: skip
        log.active.append(row)
    for row in (["Bericht"], ["Einheit: mm"], ["Name", "Kontrolle", "Nominal", "Gemessen", "Tol"]):
        export.active.append(row)
    for i in range(6):
        log.active.append(
            [i, f"Punkt_{i}", comma(Q[i, 0]), comma(Q[i, 1]), comma(20.0 + i * i), "ok" if i == 3 else None]
        )
        for k, axis in enumerate("XYZ") if i != 2 else ():
            export.active.append([None if k else f"Punkt_{i}", axis, XYZ[i, k] + 1.0, XYZ[i, k], "±0,1"])
    log.save(tmp_path / "log.xlsx")
    export.save(tmp_path / "export.xlsx")
    found = intake([tmp_path / "log.xlsx", tmp_path / "export.xlsx"], 5e-5)
    assert found.joined == "by name"
    assert found.columns["x"][2] == ""
    assert found.columns["z"][5] == pytest.approx(1e-3 * XYZ[5, 2])
    assert found.columns["q_Achse_2"][0] == pytest.approx(np.radians(Q[0, 1]), abs=1e-5)
    assert found.columns["Temperatur_C"][2] == 24.0
    assert found.columns["pose"][1] == "Punkt_1"


def spelt(folder: Path, heads: Sequence[str], places: str = "name,X [mm],Y [mm],Z [mm]") -> list[Path]:
    """A log in degrees whose joints are called so, and an export with the places of the same points."""
    rows = [[name, *row] for name, row in zip(NAMES, np.round(DEGREES, 6).tolist(), strict=True)]
    measured = [[name, *row] for name, row in zip(NAMES, XYZ.tolist(), strict=True)]
    for file, table in (("log.csv", [["point", *heads], *rows]), ("export.csv", [places.split(","), *measured])):
        (folder / file).write_text("\n".join(",".join(map(str, row)) for row in table) + "\n")
    return [folder / "log.csv", folder / "export.csv"]


DEGREES = np.random.default_rng(3).uniform(-150.0, 150.0, (len(NAMES), 6))


@pytest.mark.parametrize(
    ("heads", "first"),
    [("S L U R B T", "S"), ("S-axis L-axis U-axis R-axis B-axis T-axis", "S"),
     (" ".join(f"robax.rax_{i}" for i in range(1, 7)), "rax_1"), (" ".join(f"jHere.j{i}" for i in range(1, 7)), "j1"),
     (" ".join(f"panda_joint{i}" for i in range(1, 7)), "panda_joint1"), ("JT1 JT2 JT3 JT4 JT5 JT6", "JT1"),
     (" ".join(f"posj[{i}]" for i in range(6)), "0"), ("th1 th2 th3 th4 th5 th6", "th1"),
     ("Base Shoulder Elbow Wrist_1 Wrist_2 Wrist_3", "shoulder_pan_joint"), ("joint_a1 joint_a2 joint_a3 joint_a4 "
     "joint_a5 joint_a6", "joint_a1"), (" ".join(f"Istwinkel_A{i}" for i in range(1, 7)), "A1"),
     (" ".join(f"Achswinkel_{i}" for i in range(1, 7)), "Achswinkel_1"),
     (" ".join(f"articulation_{i}" for i in range(1, 7)), "articulation_1")],
)  # fmt: skip
def test_joints_are_called_as_controllers_call_them(tmp_path: Path, heads: str, first: str) -> None:
    found = intake(spelt(tmp_path, heads.split()), 5e-5)
    joints = [name for name in found.columns if name.startswith("q_")]
    assert joints[0] == f"q_{first}"
    assert np.allclose(np.array([found.columns[name] for name in joints]).T, np.radians(DEGREES), atol=1e-6)


def test_torques_and_temperatures_of_joints_are_no_positions(tmp_path: Path) -> None:
    heads = ["panda_joint1", "panda_joint2", "tau_joint1", "temp_joint2", "target.j1", "motor_current_joint2"]
    found = intake(spelt(tmp_path, heads), 5e-5)
    assert [name for name in found.columns if name.startswith("q_")] == ["q_panda_joint1", "q_panda_joint2"]
    assert np.allclose(found.columns["temp_joint2"], DEGREES[:, 3], atol=1e-6)


def test_a_joint_that_may_slide_makes_no_degrees_of_the_others(tmp_path: Path) -> None:
    """Two joints in rad and a slide in mm have one number that is beyond a turn."""
    rows = [f"{name},{0.2 * i},{-0.1 * i},{40.0 * i}" for i, name in enumerate(NAMES)]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["Point,J1,J2,J3", *rows]))
    paths = [path, written(tmp_path, "", EXPORTS["spatialanalyzer"])[1]]
    with pytest.raises(InputError, match="the unit of column 'J1' is stated nowhere"):
        intake(paths, 5e-5)
    found = intake(paths, 5e-5, {"J1": "q_J1_rad", "J2": "q_J2_rad", "J3": "q_J3_mm"})
    assert found.columns["q_J3"][-1] == pytest.approx(0.2)


@pytest.mark.parametrize(("head", "between"), [("q_deg", ", "), ("robot.joints [deg]", ","), ("JPos (°)", " ")])
def test_a_cell_may_hold_all_joints(tmp_path: Path, head: str, between: str) -> None:
    paths = spelt(tmp_path, [f"J{i}" for i in range(1, 7)])
    rows = [f"{name}\t[{between.join(map(str, row))}]" for name, row in zip(NAMES, DEGREES.round(6), strict=True)]
    paths[0].write_text("\n".join([f"point\t{head}", *rows]))
    found = intake(paths, 5e-5)
    joints = [name for name in found.columns if name.startswith("q_")]
    assert np.allclose(np.array([found.columns[name] for name in joints]).T, np.radians(DEGREES), atol=1e-6)


def test_counts_without_a_unit_are_no_degrees(tmp_path: Path) -> None:
    paths = spelt(tmp_path, [f"J{i}" for i in range(1, 7)])
    ticks = np.round(2048.0 + DEGREES / 360.0 * 4096.0)
    rows = [",".join([name, *map(str, row)]) for name, row in zip(NAMES, ticks.tolist(), strict=True)]
    paths[0].write_text("\n".join(["point,J1,J2,J3,J4,J5,J6", *rows]) + "\n")
    with pytest.raises(InputError, match="the unit of column 'J1' is stated nowhere"):
        intake(paths, 5e-5)


@pytest.mark.parametrize(
    "head", ["Point,Easting [mm],Northing [mm],Elevation [mm]", "Punkt,Rechtswert [mm],Hochwert [mm],Höhe [mm]"]
)
def test_east_north_and_up_are_x_y_and_z(tmp_path: Path, head: str) -> None:
    found = intake(spelt(tmp_path, [f"J{i}" for i in range(1, 7)], head), 5e-5)
    assert np.allclose(np.array([found.columns[axis] for axis in "xyz"]).T, 1e-3 * XYZ, atol=1e-9)


@pytest.mark.parametrize(
    ("head", "cells"),
    [(r"\theta_i,d_i [mm],a_{i-1} [mm],\alpha_{i-1}", ("90°", "-45°")), ("θᵢ,dᵢ [mm],aᵢ₋₁ [mm],αᵢ₋₁", ("½π", "−¼π")),
     ("theta [deg],d [mm],a_{i-1} [mm],alpha_{i-1}", ("90°", "-pi/4")),
     ("theta,d [mm],a_(i-1) [mm],alpha_(i-1)", ("pi/2", "-45 deg")),
     ("θ,d [mm],a_(i-1) [mm],alpha_(i-1) [Grad]", ("q1 + 90°", "-45"))],
)  # fmt: skip
def test_cells_of_a_dh_table_say_their_unit(tmp_path: Path, head: str, cells: tuple[str, str]) -> None:
    """A degree sign beside a pi is that of its cell alone."""
    rows = [f"{cells[0] if i == 0 else 0},{100 * i},50,{cells[1] if i == 1 else 0}" for i in range(6)]
    (tmp_path / "dh.csv").write_text("\n".join([head, *rows]) + "\n")
    found = intake([*spelt(tmp_path, [f"J{i}" for i in range(1, 7)]), tmp_path / "dh.csv"], 5e-5)
    joints = tomllib.loads(found.arm or "")["robot"]
    assert joints["dh"] == "modified"
    assert joints["joint"]["J1"]["theta_deg"] == pytest.approx(90.0)
    assert joints["joint"]["J2"]["alpha_deg"] == pytest.approx(-45.0)
    assert joints["joint"]["J3"]["d_mm"] == pytest.approx(200.0)


@pytest.mark.parametrize(
    ("head", "row", "open_"),
    [("theta,d [mm],a [mm],alpha [deg]", "1.5,400,50,90", "'theta'"),
     ("theta [deg],d [mm],a,alpha [deg]", "90,400,0.5,90", "'a'")],
)  # fmt: skip
def test_a_column_of_a_dh_table_has_its_unit_not_from_one_that_states_another(
    tmp_path: Path, head: str, row: str, open_: str
) -> None:
    """1.5 beside 90 degrees may be rad, and 0.5 beside 400 mm may be m."""
    (tmp_path / "dh.csv").write_text("\n".join([head, *[row] * 6]) + "\n")
    with pytest.raises(InputError, match=f"the unit of {open_} is open"):
        intake([*spelt(tmp_path, [f"J{i}" for i in range(1, 7)]), tmp_path / "dh.csv"], 5e-5, dh="standard")


def test_an_external_axis_is_asked_whether_it_slides(tmp_path: Path) -> None:
    """KUKA's E1 to E6 are in mm or degrees as the builder chose; those that are not there are logged as 0."""
    heads = [*(f"$AXIS_ACT.A{i}" for i in range(1, 7)), "$AXIS_ACT.E1", "$AXIS_ACT.E2"]
    paths = spelt(tmp_path, heads[:6])
    rows = [[name, *row, 250.0 * i, 0.0] for i, (name, row) in enumerate(zip(NAMES, DEGREES.tolist(), strict=True))]
    paths[0].write_text("\n".join(",".join(map(str, row)) for row in [["point", *heads], *rows]) + "\n")
    with pytest.raises(InputError, match=r"'\$AXIS_ACT.E1' is stated nowhere: --take '.*=q_E1_mm' or =q_E1_deg"):
        intake(paths, 5e-5)
    found = intake(paths, 5e-5, {"$AXIS_ACT.E1": "q_E1_mm"})
    assert found.columns["q_E1"][3] == pytest.approx(0.75)
    assert "q_E2" not in found.columns
    assert found.columns["q_A1"][3] == pytest.approx(np.radians(DEGREES[3, 0]))


@pytest.mark.parametrize("head", ["Point,Hz,V,D", "Point,Hz [gon],V [gon],Slope distance [m]", "Point,HA,VA,SD"])
def test_angles_and_a_distance_are_refused_with_what_they_are(tmp_path: Path, head: str) -> None:
    paths = spelt(tmp_path, [f"J{i}" for i in range(1, 7)], head)
    with pytest.raises(InputError, match=r"x = D sin V sin Hz, y = D sin V cos Hz, z = D cos V \(Hz = 'H"):
        intake(paths, 5e-5)
    both = [",".join([*a.split(","), *b.split(",")[1:]]) for a, b in
            zip(*(path.read_text().splitlines() for path in paths), strict=True)]  # fmt: skip
    paths[0].write_text("\n".join(both) + "\n")
    with pytest.raises(InputError, match="has angles and a distance and no x y z"):
        intake(paths[:1], None)


def test_pulses_are_of_a_drive_that_no_file_describes(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"'J1 \[pulses\]' is in pulses, and how many are a turn, and which"):
        intake(spelt(tmp_path, ["J1 [pulses]", *"abcde"]), 5e-5)


def test_a_column_t_is_asked_whether_it_is_a_temperature(tmp_path: Path) -> None:
    paths = spelt(tmp_path, ["J1", "J2", "T", "J3", "J4", "J5"])
    with pytest.raises(InputError, match="'T' is a time or a temperature: --take 'T=time_s' or 'T=temperature'"):
        intake(paths, 5e-5)
    found = intake(paths, 5e-5, {"T": "temperature"})
    assert np.allclose(found.columns["temperature"], DEGREES[:, 2], atol=1e-6)
    assert "time" not in found.columns
    for head in ("T [°C]", "T (K)"):
        assert "time" not in intake(spelt(tmp_path, ["J1", "J2", head, "J3", "J4", "J5"]), 5e-5).columns


def test_a_header_of_another_width_is_none(tmp_path: Path) -> None:
    """Columns without a header are taken by their places, which a header says otherwise."""
    with pytest.raises(InputError, match=r"log\.csv:1: has 3 names of columns where most rows have 7 cells"):
        intake(spelt(tmp_path, ["J1", "J2"]), 5e-5)


@pytest.mark.parametrize("row", ['{{"t":0,"q":[{}]}}', "- joints: [{}]", "PTP {{A1 {}}}", "movej([{}], a=1.4)"])
def test_numbers_of_a_program_are_no_table(tmp_path: Path, row: str) -> None:
    numbers = [",".join(map(str, row)) for row in DEGREES.tolist()]
    (tmp_path / "program.txt").write_text("\n".join(row.format(text) for text in numbers) + "\n")
    paths = spelt(tmp_path, [f"J{i}" for i in range(1, 7)])
    with pytest.raises(InputError, match=r"program\.txt:1: is no row of a table, with .*: log the joints"):
        intake([tmp_path / "program.txt", paths[1]], 5e-5)


@pytest.mark.parametrize("base", ["dX", "Nominal X", "Soll-X", "residual X", "std_X", "ref X"])
def test_deviations_and_nominal_places_are_no_readings(tmp_path: Path, base: str) -> None:
    triple = ",".join(f"{base.replace('X', axis)} [mm]" for axis in "XYZ")
    paths = spelt(tmp_path, [f"J{i}" for i in range(1, 7)], f"name,{triple}")
    with pytest.raises(InputError, match="neither joints nor x y z among its columns"):
        intake(paths, 5e-5)
    rows = [[name, *place, *(place + 1.0)] for name, place in zip(NAMES, XYZ, strict=True)]
    both = [f"name,Actual X [mm],Actual Y [mm],Actual Z [mm],{triple}", *(",".join(map(str, row)) for row in rows)]
    paths[1].write_text("\n".join(both) + "\n")
    found = intake(paths, 5e-5)
    assert np.allclose(np.array([found.columns[axis] for axis in "xyz"]).T, 1e-3 * XYZ, atol=1e-9)


@pytest.mark.parametrize(
    ("heads", "cells", "problem"),
    [
        ("roll_rad,pitch_rad,yaw_rad", "0.1,57.3,0.2", r":2: 'pitch_rad' is 57\.3 rad, 9\.12 turns"),
        ("qx,qy,qz,qw", "0,0,0,one", r":2: 'qw' is 'one', expected a number"),
        ("nom_qx,nom_qy,nom_qz,nom_qw", "0,0,0.6,0.8", ": --sigma-r, and no orientation is read"),
    ],
)
def test_turns_that_are_none_are_refused(tmp_path: Path, heads: str, cells: str, problem: str) -> None:
    paths = spelt(tmp_path, [f"J{i}" for i in range(1, 7)])
    rows = [
        [name, *place, "0,0,0.6,0.8" if heads[0] != "r" else "0,0,0.1"] for name, place in zip(NAMES, XYZ, strict=True)
    ]
    rows[0][-1] = cells
    text = [f"name,X [mm],Y [mm],Z [mm],{heads}", *(",".join(map(str, row)) for row in rows)]
    paths[1].write_text("\n".join(text) + "\n")
    with pytest.raises(InputError, match=rf"{paths[1].name}{problem}"):
        intake(paths, 5e-5, sigma_r=5e-4)


def test_places_in_two_frames_are_no_campaign(tmp_path: Path) -> None:
    paths = spelt(tmp_path, [f"J{i}" for i in range(1, 7)])
    frames = ["base" if i < 3 else "tracker" for i in range(len(NAMES))]
    rows = [[name, frame, *place] for name, frame, place in zip(NAMES, frames, XYZ, strict=True)]
    text = ["name,Frame,X [mm],Y [mm],Z [mm]", *(",".join(map(str, row)) for row in rows)]
    paths[1].write_text("\n".join(text) + "\n")
    with pytest.raises(InputError, match="'Frame' says that places are in 'base', 'tracker': export them in one frame"):
        intake(paths, 5e-5)
    assert list(intake(paths, 5e-5, {"Frame": "session"}).columns["session"]) == frames


def test_a_comma_that_may_part_thousands_is_asked_about(tmp_path: Path) -> None:
    paths = spelt(tmp_path, [f"J{i}" for i in range(1, 7)])
    rows = [f"{name};1,{594 + i};{place[1]};{place[2]}" for i, (name, place) in enumerate(zip(NAMES, XYZ, strict=True))]
    paths[1].write_text("\n".join(["name;X [mm];Y [mm];Z [mm]", *rows]) + "\n")
    with pytest.raises(InputError, match=r"export\.csv:2: '1,594' is 1\.594 or 1594, beside '.*' with a point"):
        intake(paths, 5e-5)


def test_places_beside_joints_with_angles_of_the_tool_may_be_the_controllers_own(tmp_path: Path) -> None:
    rows = [[name, *row, *place, 1.0, 2.0, 3.0] for name, row, place in zip(NAMES, DEGREES, XYZ, strict=True)]
    head = [
        "name",
        *(f"J{i} [deg]" for i in range(1, 7)),
        "X [mm]",
        "Y [mm]",
        "Z [mm]",
        "A [deg]",
        "B [deg]",
        "C [deg]",
    ]
    (tmp_path / "log.csv").write_text("\n".join(",".join(map(str, row)) for row in [head, *rows]) + "\n")
    found = intake([tmp_path / "log.csv"], 5e-5)
    assert any("these compute them from the joints; are they measured?" in note for note in found.notes)


def test_rows_of_a_dh_table_are_joints_in_the_order_of_the_log_where_two_series_are_counted(tmp_path: Path) -> None:
    heads = [*(f"A{i} [deg]" for i in range(1, 6)), "E1 [deg]"]
    paths = spelt(tmp_path, heads)
    rows = [f"0,{100 * i},50,90" for i in range(6)]
    (tmp_path / "dh.csv").write_text("\n".join(["theta [deg],d [mm],a [mm],alpha [deg]", *rows]) + "\n")
    found = intake([*paths, tmp_path / "dh.csv"], 5e-5, {"E1 [deg]": "q_E1_deg"}, dh="standard")
    joints = tomllib.loads(found.arm or "")["robot"]["joint"]
    assert list(joints) == [*(f"A{i}" for i in range(1, 6)), "E1"]
    assert any("the rows of dh.csv are A1, A2" in note for note in found.notes)


@pytest.mark.parametrize(
    ("form", "head"),
    [
        ("{s}{d}°{m:02d}'{x:06.3f}\"", ""),
        ("{s}{d}° {m}′ {x:.3f}″", " [deg]"),
        ("{s}{d}d{m:02d}m{x:.3f}s", ""),
        ("{s}{d} {m:02d} {x:06.3f}", " [deg]"),
        ("{s}{d}:{m:02d}:{x:06.3f}", "_deg"),
        ("{s}{d} {m:02d} {x:06.3f}", " [dms]"),
        ("{s}{d}°{y:.6f}'", ""),
    ],
)
def test_angles_may_have_minutes_and_seconds(tmp_path: Path, form: str, head: str) -> None:
    def cell(angle: float) -> str:
        size = abs(float(angle))
        minutes = 60.0 * (size - int(size))
        parts = {"d": int(size), "m": int(minutes), "x": 60.0 * (minutes - int(minutes)), "y": minutes}
        return form.format(s="-" if angle < 0.0 else "", **parts)

    lines = [f"Point;{';'.join(f'J{i}{head}' for i in range(1, 7))}"]
    lines += [f"{name};{';'.join(map(cell, row))}" for name, row in zip(NAMES, Q, strict=True)]
    found = intake(written(tmp_path, "\n".join(lines), EXPORTS["leica"]), 5e-5).columns
    assert np.allclose(np.array([found[f"q_J{i}"] for i in range(1, 7)]).T, np.radians(Q), atol=1e-7)


def test_minutes_and_seconds_need_a_header_that_says_so(tmp_path: Path) -> None:
    log = "Point;J1 [deg];J2\n" + "\n".join(f"{name};1.5;12 34 {i:02d}" for i, name in enumerate(NAMES))
    with pytest.raises(InputError, match=r"'J2' is '12 34 00', expected a number; degrees, minutes and seconds need a"):
        intake(written(tmp_path, log, EXPORTS["leica"]), 5e-5, {"J2": "q_J2_deg"})
    packed = log.replace("J2", "J2 [dms]").replace("12 34 ", "12.34")
    with pytest.raises(InputError, match=r"'J2 \[dms\]' is in 'dms', which is not known"):
        intake(written(tmp_path, packed, EXPORTS["leica"]), 5e-5)


def test_a_column_may_state_the_unit(tmp_path: Path) -> None:
    lines = EXPORTS["leica"].replace("_mm", "").replace("\t", ";").splitlines()

    def read(units: Sequence[str], head: str = lines[0]) -> Sequence[float]:
        rows = [f"{line};{unit}" for line, unit in zip(lines[1:], units, strict=True)]
        paths = written(tmp_path, LOGS["degrees"], "\n".join([f"{head};Units", *rows]))
        return intake(paths, 5e-5).columns["x"]

    assert np.allclose(read(["mm"] * 6), 1e-3 * XYZ[:, 0])
    with pytest.raises(InputError, match=r"export\.txt:4: 'Units' is 'inch' here and 'mm' before: export one unit"):
        read(["mm", "mm", "inch", "mm", "mm", "mm"])
    marked = ";".join(f"{name} [mm]" if name.strip() in "XYZ" else name for name in lines[0].split(";"))
    with pytest.raises(InputError, match=r"is in mm, and the file's head says m: --take"):
        read(["m"] * 6, marked)
