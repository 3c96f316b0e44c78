"""Loads from outside along a path: columns, options and tables of them, in every command that takes rows."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from support.command_line import Run, few_rows, fine, strict_json
from support.small_arms import ROBOTS

from armflex import Arm, InputError, Wrench, check, compensate, load_arm
from armflex.cli.main import COMMANDS
from armflex.cli.options import FILES
from armflex.errors import TableError
from armflex.estimate.posterior import without_declared_uncertainty
from armflex.estimate.tip_uncertainty import flagged_covariance
from armflex.measured.forces import read_force_table
from armflex.measured.measurements import read_measurements
from armflex.parameters import Certainty
from armflex.trajectory import read_trajectory, write_trajectory

HEAVY = ROBOTS / "heavy_six"
COLUMNS = {"force_fx": "0", "force_fz_kN": "-0.5", "force_my": "20", "force_frame": "", "force_axes": ""}


def with_columns(path: Path, columns: dict[str, list[str]]) -> Path:
    head, *rows = path.read_text().splitlines()
    cells = zip(*columns.values(), strict=True)
    lines = [",".join([head, *columns]), *(",".join([row, *own]) for row, own in zip(rows, cells, strict=True))]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture
def pushed(tmp_path: Path) -> Path:
    """Ten rows, of which the fourth is pushed at another link, in its axes, and the last by nothing."""
    path = few_rows(HEAVY / "trajectory.csv", tmp_path / "t.csv", 10)
    cells = {name: [value] * 9 + [""] for name, value in COLUMNS.items()}
    cells["force_frame"][3], cells["force_axes"][3] = "link4", "link"
    return with_columns(path, cells)


def test_columns_are_what_deflection_is_asked(heavy: Arm, pushed: Path) -> None:
    path = read_trajectory(pushed, heavy)
    tip = Wrench(heavy.robot.tip, [0.0, 0.0, -500.0], [0.0, 20.0, 0.0])
    link = Wrench("link4", tip.force, tip.moment, "frame")
    report, found = check(heavy, path, 0.1), compensate(heavy, path)
    for i, (q, payload) in enumerate(zip(path.q, path.payload, strict=True)):
        loads = [] if i == 9 else [link if i == 3 else tip]
        alone = heavy.deflection(q, payload, wrenches=loads)
        assert report.rows[i].displacement_m == pytest.approx(np.linalg.norm(alone.displacement[:3]), rel=1e-9)
        moved = heavy.deflection(found.trajectory.q[i], payload, wrenches=loads, enforce_limits=False)
        assert np.abs(moved.pose.translation - heavy.rigid_pose(q).translation).max() < 1e-9
        np.testing.assert_allclose(found.rows[i].before[:3], alone.displacement[:3], atol=1e-12)
    # Between rows loads are linear: halfway from the eighth to the ninth it is as at both, to the last it is half.
    middle = path.between(np.array([7, 8]), np.array([0.5, 0.5]))
    own = [one for one in middle.wrenches if one.dead]
    np.testing.assert_allclose(sum(one.force for one in own), [[0, 0, -500.0], [0, 0, -250.0]])


@pytest.mark.filterwarnings("ignore:tolerance:armflex.ArmflexWarning")
def test_a_compensated_path_keeps_its_loads(heavy: Arm, pushed: Path, tmp_path: Path) -> None:
    """Also in rows that are inserted, unless loads at two links meet there: a table has columns for one."""
    path = read_trajectory(pushed, heavy)
    written = read_trajectory(write_trajectory(compensate(heavy, path).trajectory, tmp_path / "o.csv"), heavy)
    assert max(point.displacement_m for point in check(heavy, written, 1.0, against=path).rows) < 1e-9
    at_tip = replace(path, wrenches=path.wrenches[:1])
    found = compensate(heavy, at_tip, between=1e-6)
    written = read_trajectory(write_trajectory(found.trajectory, tmp_path / "o.csv"), heavy)
    commanded = np.array([q - row.change for q, row in zip(written.q, found.rows, strict=True)])
    assert len(written) > len(path)
    assert (
        max(point.displacement_m for point in check(heavy, written, 1.0, against=replace(written, q=commanded)).rows)
        < 1e-9
    )
    with pytest.raises(InputError, match="row 3 has two loads from outside"):
        write_trajectory(compensate(heavy, path, between=1e-6).trajectory, tmp_path / "p.csv")


def test_two_loads_in_a_row_have_no_columns(heavy: Arm, pushed: Path, tmp_path: Path) -> None:
    path = read_trajectory(pushed, heavy)
    more = (*path.wrenches, Wrench("link2", [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]))
    with pytest.raises(
        InputError, match="row 0 has two loads from outside, at 'tool' in axes of the base and at 'link2'"
    ):
        write_trajectory(replace(path, wrenches=more), tmp_path / "o.csv")
    assert not (tmp_path / "o.csv").exists()


@pytest.mark.parametrize("command", ["check", "compensate", "predict"])
def test_options_are_for_rows_that_name_none(armflex: Run, tmp_path: Path, command: str) -> None:
    """As with the same in columns, which hold where they are given: a force of zero is one."""
    rest = ["--tolerance", "1m"] if command == "check" else ["-o", "o.csv"]
    bare = few_rows(HEAVY / "trajectory.csv", tmp_path / "bare.csv", 10)
    text = bare.read_text().replace(",empty,", ",,")
    bare.write_text(text)
    full = tmp_path / "full.csv"
    full.write_text(text.replace(",,", ",p100,"))
    blank = {name: [""] * 10 for name in ("force_fz", "force_mx_Nm")}
    blank["force_fz"][2], blank["force_mx_Nm"][2] = "0", "0"
    with_columns(bare, blank)
    given = {"force_fz": ["-300"] * 10, "force_mx": ["0"] * 10, "force_axes": ["link"] * 10}
    given["force_fz"][2] = "0"
    with_columns(full, given)
    told = []
    for path, options in ((bare, ["--payload", "p100", "--force", "fz=-0.3kN,axes=link"]), (full, [])):
        fine(armflex(command, HEAVY / "arm.toml", path, *rest, *options, "--json", "c.json"))
        written = [] if command == "check" else (tmp_path / "o.csv").read_text().splitlines()
        told.append((strict_json(tmp_path / "c.json"), written))
    assert told[0] == told[1]
    if command == "predict":
        plain = fine(armflex(command, HEAVY / "arm.toml", full, "-o", "p.csv"))
        assert plain.returncode == 0


def test_map_and_view_take_a_force(armflex: Run, tmp_path: Path, heavy: Arm) -> None:
    command = ["map", HEAVY / "arm.toml", "-o", "m.csv", "--rows", "64", "--voxel", "2m"]
    worst = []
    for options in ([], ["--force", "fz=-1kN"]):
        fine(armflex(*command, *options, "--json", "m.json"))
        worst.append(strict_json(tmp_path / "m.json")["worst"])
    load = Wrench(heavy.robot.tip, [0.0, 0.0, -1000.0], [0.0] * 3)
    alone = heavy.deflection(worst[1]["q"], wrenches=[load])
    assert worst[1]["displacement_m"] == pytest.approx(np.linalg.norm(alone.displacement[:3]), rel=1e-9)
    assert worst[1]["displacement_m"] > 1.3 * worst[0]["displacement_m"]
    fine(
        armflex("view", HEAVY / "arm.toml", "-o", "v.html", "--q", "J2=0.3", "--payload", "p100", "--force", "fz=-1kN")
    )
    both = heavy.deflection(heavy.position(J2=0.3), "p100", wrenches=[load])
    assert f"{np.linalg.norm(both.displacement[:3]) * 1e3:.4g}" in (tmp_path / "v.html").read_text()


BAD_FORCES = {
    "no number": ("fz=", "'fz='"),
    "no unit": ("fz=-500,mx=3", None),
    "wrong unit": ("fz=5mm", "'mm' is no unit of force"),
    "no component": ("fz=5N,fw=3N", "no component 'fw', did you mean 'fz'"),
    "twice": ("fz=5N,fz=3N", "'fz=3N' is given twice"),
    "no link": ("fz=5N,frame=tol", "no link named 'tol', did you mean 'tool'?"),
    "no axes": ("fz=5N,axes=tip", "axes is 'tip', expected base or link"),
    "neither": ("500N", "such as tool=0,0,-500N, or fx=0,fz=-500N"),
}


@pytest.mark.parametrize("name", BAD_FORCES)
def test_a_force_that_cannot_be_read(armflex: Run, tmp_path: Path, name: str) -> None:
    text, complaint = BAD_FORCES[name]
    few_rows(HEAVY / "trajectory.csv", tmp_path / "t.csv", 3)
    result = armflex("compensate", HEAVY / "arm.toml", "t.csv", "-o", "o.csv", "--force", text)
    fine(result, 2)
    assert (complaint or "expected a force with its unit") in result.stderr and not (tmp_path / "o.csv").exists()


def test_a_table_goes_by_the_length_of_path(heavy: Arm, tmp_path: Path) -> None:
    """Against lengths of ten thousand chords, linear between the table's rows."""
    path = read_trajectory(few_rows(HEAVY / "trajectory.csv", tmp_path / "t.csv", 30), heavy)
    fractions = np.linspace(0.0, 1.0, 400)
    tips = [heavy.rigid_pose(path.q[0]).translation]
    gone = [0.0]
    for i in range(len(path) - 1):
        q = path.between(np.full(400, i), fractions).q
        tips = np.array([heavy.rigid_pose(row).translation for row in q])
        gone.append(gone[-1] + np.linalg.norm(np.diff(tips, axis=0), axis=1).sum())
    np.testing.assert_allclose(path.lengths(heavy), gone, atol=1e-7)
    end = gone[-1]
    file = tmp_path / "f.csv"
    file.write_text(f"s_mm,force_fx_kN,force_axes\n0,0,link\n{1e3 * end},2,link\n")
    under, flags = path.under(read_force_table(file, heavy), heavy)
    assert not flags and [one.axes for one in under.wrenches] == ["frame"]
    np.testing.assert_allclose(under.wrenches[0].force[:, 0], 2e3 * np.array(gone) / end, atol=1e-3)
    found = compensate(heavy, under)
    assert max(np.abs(row.after[:3]).max() for row in found.rows) < 1e-9
    # A corner between two rows is left out, and said.
    longest = int(np.argmax(np.diff(gone)))
    at = 0.5 * (gone[longest] + gone[longest + 1])
    file.write_text(f"s,force_fz\n0,0\n{at - 1e-4},0\n{at},-800\n{at + 1e-4},0\n{end},0\n")
    _, flags = path.under(read_force_table(file, heavy), heavy)
    assert [flag.code for flag in flags] == ["force_table"] and "up to 800 N" in flags[0].text


BAD_TABLES = {
    "too short": ("s,force_fz\n0,1\n0.01,1\n", r"f.csv: the table of forces goes from 0 to 0.01 m, row 2 is at"),
    "no s": ("x,force_fz\n0,1\n", "has no column 's'"),
    "no force": ("s,force_frame\n0,tool\n", "has none of force_fx .. force_mz"),
    "misspelt": ("s,force_fz,force_axis\n0,1,base\n", "unknown column 'force_axis', did you mean 'force_axes'"),
    "falls": ("s,force_fz\n0,1\n1,1\n1,2\n", "f.csv:4: s does not increase"),
    "empty": ("s,force_fz\n", "has a header but no rows"),
    "no number": ("s,force_fz\n0,a\n", "f.csv:2: column 'force_fz' is 'a', not a finite number"),
}


@pytest.mark.parametrize("name", BAD_TABLES)
def test_a_table_that_cannot_be_used(armflex: Run, tmp_path: Path, name: str) -> None:
    text, complaint = BAD_TABLES[name]
    few_rows(HEAVY / "trajectory.csv", tmp_path / "t.csv", 6)
    (tmp_path / "f.csv").write_text(text)
    result = fine(armflex("compensate", HEAVY / "arm.toml", "t.csv", "-o", "o.csv", "--force-table", "f.csv"), 2)
    assert complaint in result.stderr and not (tmp_path / "o.csv").exists()


def test_a_table_of_forces_in_other_commands(armflex: Run, heavy: Arm, tmp_path: Path) -> None:
    """What predict and a compensated program do under a table is what they do under the rows' own forces."""
    file, own = few_rows(HEAVY / "trajectory.csv", tmp_path / "t.csv", 12), tmp_path / "own.csv"
    (tmp_path / "f.csv").write_text("s,force_fz_kN\n0,0\n9,-6\n")
    path, _ = read_trajectory(file, heavy).under(read_force_table(tmp_path / "f.csv", heavy), heavy)
    write_trajectory(path, own)
    arm, table = HEAVY / "arm.toml", ("--force-table", "f.csv")
    fine(armflex("predict", arm, file, "-o", "a.csv", *table))
    fine(armflex("predict", arm, own, "-o", "b.csv"))
    assert (tmp_path / "a.csv").read_text() == (tmp_path / "b.csv").read_text()
    fine(armflex("predict", arm, file, "-o", "c.csv"))
    assert (tmp_path / "c.csv").read_text() != (tmp_path / "b.csv").read_text()
    command = ("export", arm, "--to", "urscript", "--compensate", "-o")
    programs = []
    for some in ((file, *table), (own,)):  # a program is named as its file
        fine(armflex(*command, "path.script", "--traj", *some))
        programs.append((tmp_path / "path.script").read_text())
    assert programs[0] == programs[1]
    assert "loads from outside up to" in programs[0]
    result = fine(armflex("export", arm, "--to", "krl", "-o", "c.src", "--traj", file, *table), 2)
    assert "--force-table need --compensate" in result.stderr


def test_a_table_whose_unit_is_doubtful(heavy: Arm, tmp_path: Path) -> None:
    """Of millimetres read as metres a path uses next to nothing; a constant one says the same anywhere."""
    path, file = read_trajectory(few_rows(HEAVY / "trajectory.csv", tmp_path / "t.csv", 30), heavy), tmp_path / "f.csv"
    end = float(path.lengths(heavy)[-1])
    file.write_text(f"s,force_fz\n0,0\n{1e3 * end},-800\n")
    _, flags = path.under(read_force_table(file, heavy), heavy)
    assert [flag.code for flag in flags] == ["force_table"] and "is its s in mm?" in flags[0].text
    for table in (f"s,force_fz\n0,-800\n{1e3 * end},-800\n", f"s,force_fz\n0,0\n{2.0 * end},-800\n"):
        file.write_text(table)
        assert not path.under(read_force_table(file, heavy), heavy)[1]
    file.write_text(f"s_mm,force_fz\n0,0\n{end},-800\n")
    with pytest.raises(InputError, match="of the path: is the unit of s right"):
        path.under(read_force_table(file, heavy), heavy)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_says_what_the_files_are_and_where_forces_go(armflex: Run, command: str) -> None:
    """What a newcomer needs is found from --help alone."""
    text = " ".join(fine(armflex(command, "--help")).stdout.split())
    for name in ("ARM", "TRAJ.csv", "ROWS.csv", "MEAS.csv", "JOINT.csv"):
        assert (name in text.partition("Options:")[0].split()) <= (f"{name} {FILES[name][:20]}" in text)
    loaded = command not in ("plan", "rehearse", "intake", "train", "fem", "demo", "prior", "history", "schema")
    assert loaded == ("--force" in text) and command in " ".join(fine(armflex("--help")).stdout.split())


def test_forces_that_exclude_each_other(armflex: Run, tmp_path: Path, pushed: Path) -> None:
    (tmp_path / "f.csv").write_text("s,force_fz\n0,1\n9,1\n")
    command = ["check", HEAVY / "arm.toml", pushed, "--tolerance", "1m", "--force-table", "f.csv"]
    assert "rows name forces already" in fine(armflex(*command), 2).stderr
    assert "exclude each other" in fine(armflex(*command, "--force", "fz=1N"), 2).stderr


def test_what_was_fitted_is_as_uncertain_as_under_the_load(heavy: Arm) -> None:
    """A compliance known to a tenth: the load doubles what it does, and so what is not known of it."""
    exact = tuple(replace(one, law=replace(one.law, relative_std=0.0)) for one in heavy.flexures)
    labels = ("compliance J2 ry",)
    fitted = replace(heavy, flexures=exact, certainty=Certainty(heavy.named(labels), np.array([[0.01]])))
    q = np.array([[0.2, 0.3, -0.4, 0.1, 0.5, 0.0]])
    loads = [Wrench(heavy.robot.tip, [0.0, 0.0, -float(force)], [0.0] * 3) for force in (0, 4000, 8000)]
    found = [flagged_covariance(fitted.deflection(q, wrenches=[load])) for load in loads]
    sizes = np.array([np.sqrt(np.trace(covariance[0, :3, :3])) for covariance, _ in found])
    assert np.diff(sizes, n=2)[0] == pytest.approx(0.0, abs=0.05 * sizes[2]) and sizes[2] > 2.0 * sizes[0]
    assert not any(flags for _, flags in found) and without_declared_uncertainty(fitted) is not None


@pytest.mark.parametrize(
    ("column", "meant"),
    [("fx", "force_fx"), ("Fz_kN", "force_fz"), ("F_y [N]", "force_fy"), ("force_x", "force_fx"), ("mz", "force_mz"),
     ("M_x_Nm", "force_mx"), ("moment_y", "force_my"), ("forse_fz", "force_fz"), ("forces_fx_kN", "force_fx"),
     ("froce_my", "force_my")],
)  # fmt: skip
def test_a_column_called_as_a_load_is_no_covariate(heavy: Arm, tmp_path: Path, column: str, meant: str) -> None:
    path = with_columns(few_rows(HEAVY / "trajectory.csv", tmp_path / "t.csv", 3), {column: ["-500"] * 3})
    for read in (read_trajectory, partial(read_measurements, inputs_only=True)):
        with pytest.raises(TableError, match=f"called as a load .* a load from outside is '{meant}'"):
            read(path, heavy)


def test_what_an_effect_depends_on_may_be_called_as_a_load(heavy: Arm, tmp_path: Path) -> None:
    path = with_columns(few_rows(HEAVY / "trajectory.csv", tmp_path / "t.csv", 3), {"fx": ["1"] * 3, "flow": ["2"] * 3})
    effect = '[[effect]]\nname = "unnamed"\nshape = "line"\nsite = "J2"\naxis = "rx"\ncovariates = ["fx"]\n'
    text = (HEAVY / "arm.toml").read_text().replace('"robot.urdf"', f'"{HEAVY.as_posix()}/robot.urdf"')
    (tmp_path / "arm.toml").write_text(text + effect + "parameters = { slope = 1e-5, middle = 0 }\n")
    assert list(read_trajectory(path, load_arm(tmp_path / "arm.toml")).covariates) == ["fx", "flow"]


def test_the_nearest_name_is_no_column_that_is_used_already(heavy: Arm, tmp_path: Path) -> None:
    path = few_rows(HEAVY / "trajectory.csv", tmp_path / "t.csv", 3)
    text = path.read_text()
    path.write_text(text.replace("q_J5", "w", 1))
    with pytest.raises(TableError, match="no column 'q_J5' ") as caught:
        read_trajectory(path, heavy)
    assert "did you mean" not in str(caught.value)
