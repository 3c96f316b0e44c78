"""Rows that come some at a time: as all at once, in memory that does not grow with them, whole or not at all."""

import csv
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import armflex
from armflex.cli.main import main
from armflex.errors import ArmflexError, Place, TableError
from armflex.estimate.calibrate import calibrate
from armflex.measured.measurements import read_measurements, stream_inputs
from armflex.measured.table import Column, Table
from armflex.mechanics.response import respond
from armflex.robot import Corrections
from armflex.rows.rows import last_motion
from armflex.tasks import predict as task
from armflex.tasks.predict import predict, predict_file
from armflex.trajectory import Trajectory, read_trajectory
from tests.support.small_arms import ROBOTS

DECLARED = ROBOTS / "tarm_like" / "measured.toml"
ENVIRONMENT = os.environ | {"PYTHONPATH": str(Path(armflex.__file__).parents[1])}
JOINTS = ("M1", "A1", "A2", "A3", "A4", "A5", "A6")


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An arm.toml with what was fitted and its covariance."""
    arm = armflex.load_arm(DECLARED)
    campaign = read_measurements(DECLARED.with_name("campaign.csv"), arm)
    found = calibrate(arm, campaign.some(range(0, len(campaign), 6)), as_stated=True)
    return found.write(tmp_path_factory.mktemp("calibrated") / "arm.toml")


@pytest.fixture(scope="module")
def arm(calibrated: Path) -> armflex.Arm:
    return armflex.load_arm(calibrated)


def rows_of(
    folder: Path, count: int = 23, keep: tuple[str, ...] = ("time", "temperature", "hold"), **more: list
) -> Path:
    """Write inputs as of the bundled campaign, again and again; `more` are further columns, by cells in turn."""
    with (ROBOTS / "tarm_like" / "campaign.csv").open() as file:
        campaign = list(csv.DictReader(file))
    path = folder / "rows.csv"
    with path.open("w") as file:
        names = ["session", "payload", *keep, *(f"q_{joint}" for joint in JOINTS)]
        writer = csv.writer(file)
        writer.writerow([*names, *more])
        for i in range(count):
            own = [cells[i % len(cells)] for cells in more.values()]
            writer.writerow([*(campaign[i % len(campaign)][name] for name in names), *own])
    return path


CELL = st.one_of(
    st.floats(allow_nan=True).map(repr),
    st.sampled_from(
        ["", " ", "1_000", "nan", "-inf", "1e400", "１", "+.5", "5.", " 7 ", "\t8", "1 2", "0x1", "1e30", "2e30"]
    ),
    st.text("0123456789+-.eE _nif", max_size=6),
)


@given(st.lists(CELL, max_size=6), st.sampled_from([1.0, 1e-3]))
def test_a_column_at_once_is_as_cell_by_cell(cells: list[str], factor: float) -> None:
    table = Table(Path("t.csv"), {"x": Column("x_mm", "mm", factor, tuple(cells))}, tuple(range(2, 2 + len(cells))))
    found, careful = [], type("Careful", (Table,), {"plain": lambda *_: None})(table.path, table.columns, table.lines)
    for one in (table, careful):
        try:
            found.append(one.numbers("x").tolist())
        except TableError as error:
            found.append(str(error))
    assert found[0] == found[1]


@given(
    st.lists(st.lists(st.sampled_from([0.0, 1.0, 1.0 + 1e-12, 2.0]), min_size=2, max_size=2), min_size=2, max_size=9)
)
def test_the_last_motion_goes_on_from_the_row_before(rows: list[list[float]]) -> None:
    q = np.array(rows)
    whole = last_motion(q)
    parts, before = [], None
    for row in q:
        parts.append(last_motion(row[None], before)[0])
        before = row, parts[-1]
    np.testing.assert_array_equal(np.array(parts), whole)


@pytest.mark.parametrize("most", [1, 7, 1000])
def test_rows_in_pieces_are_those_at_once(tmp_path: Path, arm: armflex.Arm, most: int) -> None:
    mixed = {"shift": ["a", "b", "b", "2"], "gaps": ["1", "2", "3", "", "5"], "many": [f"t{i}" for i in range(20)]}
    mixed |= {"late": ["1"] * 20 + ["x"], "approach_A2": ["1", "-1", "0"], "humidity": ["40.5", "41"]}
    path = rows_of(tmp_path, 23, ("temperature",), **mixed)
    whole, pieces = read_measurements(path, arm, inputs_only=True), list(stream_inputs(path, arm, most))
    assert sum(map(len, pieces)) == len(whole) and len(pieces) == -(-23 // most)
    for name in ("pose", "session", "payload", "places"):
        assert sum((getattr(piece, name) for piece in pieces), ()) == getattr(whole, name)
    for name in ("time", "q", "approach", "measured"):
        np.testing.assert_array_equal(np.concatenate([getattr(piece, name) for piece in pieces]), getattr(whole, name))
    assert all(list(one.known) == list(whole.known) and one.derived == whole.derived for one in pieces)
    for name, values in whole.known.items():
        np.testing.assert_array_equal(np.concatenate([piece.known[name] for piece in pieces]), values)
    assert {"shift=a", "shift=2", "humidity"} < set(whole.known)
    assert not {"many=t1", "late=x", "late"} & set(whole.known)


@pytest.mark.parametrize(
    ("column", "cells"),
    [
        ("humidity", ["40", "nan"]),
        ("humidity", ["nan", "", "", "40"]),
        ("q_A1_deg", ["a"]),
        ("hold", ["1", "1e40"]),
        ("approach_A2", ["1", "0.5"]),
        ("payload", ["p300", "p600", "p301"]),
        ("q_A1", ["0.1", "0.2", "30", "40"]),
        ("hold", ["1", "2", "\x1b"]),
        ("x", ["1.0"]),
    ],
)
def test_bad_cells_are_told_as_of_a_whole_table(
    tmp_path: Path, arm: armflex.Arm, column: str, cells: list[str]
) -> None:
    path = rows_of(tmp_path, 12, ())
    header, *body = [line.split(",") for line in path.read_text().splitlines()]
    place = {name: i for i, name in enumerate(header)}.get(column.removesuffix("_deg"), len(header))
    for i, row in enumerate([header, *body]):
        row[place : place + 1] = [column if i == 0 else cells[(i - 1) % len(cells)]]
    path.write_text("\n".join(",".join(row) for row in (header, *body)))
    with pytest.raises(TableError) as whole:
        read_measurements(path, arm, inputs_only=True)
    for most in (1, 5):
        with pytest.raises(TableError) as pieces:
            list(stream_inputs(path, arm, most))
        assert str(pieces.value) == str(whole.value)


@pytest.mark.parametrize("together", [1, 7, 1000])
def test_predictions_in_pieces_are_those_at_once(
    tmp_path: Path, arm: armflex.Arm, monkeypatch: pytest.MonkeyPatch, together: int
) -> None:
    path = rows_of(tmp_path)
    whole = predict(arm, read_measurements(path, arm, inputs_only=True))
    monkeypatch.setattr(task, "TOGETHER", together)
    pieces, told = predict(arm, read_measurements(path, arm, inputs_only=True)), []
    for name in ("position", "rotation", "sigma", "displacement"):
        np.testing.assert_allclose(getattr(pieces, name), getattr(whole, name), rtol=1e-9, atol=1e-12)
    count, flags = predict_file(arm, path, tmp_path / "out.csv", lambda done, _: told.append(done))
    assert count == told[-1] == 23 and flags == pieces.flags == whole.flags and len(told) == -(-23 // together)
    with (tmp_path / "out.csv").open() as file:
        written = list(csv.DictReader(file))
    for name, values in (("x", whole.position[:, 0]), ("sigma_z", whole.sigma[:, 2]), ("rz", whole.displacement[:, 5])):
        np.testing.assert_allclose([float(row[name]) for row in written], values, rtol=1e-9, atol=1e-12)


def test_a_row_that_cannot_be_predicted_leaves_no_file(
    tmp_path: Path, arm: armflex.Arm, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = rows_of(tmp_path)
    lines = path.read_text().splitlines()
    q = lines[0].split(",").index("q_A1")
    lines[12] = ",".join("7" if i == q else cell for i, cell in enumerate(lines[12].split(",")))
    path.write_text("\n".join(lines))
    monkeypatch.setattr(task, "TOGETHER", 5)
    with pytest.raises(ArmflexError, match=f"{Place(path, 13)}: joint 'A1' at 7 is outside"):
        predict_file(arm, path, tmp_path / "out.csv")
    assert [one.name for one in tmp_path.iterdir()] == ["rows.csv"]


SCARCE = """
import resource, sys
import armflex
from armflex.errors import OutOfMemoryError
from armflex.tasks import predict as task
arm = armflex.load_arm(sys.argv[1])
task.predict_file(arm, sys.argv[2], "first.csv")  # what is compiled and loaded once
size = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (size + 300_000_000,) * 2)
task.predict_file(arm, sys.argv[3], "pieces.csv")
task.TOGETHER = 10**9
try:
    task.predict_file(arm, sys.argv[3], "whole.csv")
except OutOfMemoryError as error:
    print(error)
"""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="asks Linux how much memory there is")
def test_memory_does_not_grow_with_the_rows(tmp_path: Path, calibrated: Path) -> None:
    """What the same rows in one piece take is refused here, and leaves no file."""
    (tmp_path / "few").mkdir()
    few, many = rows_of(tmp_path / "few", 300), rows_of(tmp_path, 30_000)
    command = [sys.executable, "-c", SCARCE, str(calibrated), str(few), str(many)]
    found = subprocess.run(
        command, cwd=tmp_path, check=True, stdout=subprocess.PIPE, text=True, env=ENVIRONMENT, timeout=600
    )
    assert found.stdout == "rows from 0 on: there is not enough memory for them\n"
    assert len((tmp_path / "pieces.csv").read_text().splitlines()) == 30_001
    assert {one.name for one in tmp_path.iterdir()} == {"few", "rows.csv", "first.csv", "pieces.csv"}


KILLED = """
import os, signal, sys
import armflex
from armflex.tasks import predict as task
task.TOGETHER = 5
arm = armflex.load_arm(sys.argv[1])
task.predict_file(arm, sys.argv[2], "out.csv", lambda *_: os.kill(os.getpid(), signal.SIGKILL))
"""


@pytest.mark.slow
def test_a_process_that_is_killed_leaves_the_file_that_was_there(tmp_path: Path, calibrated: Path) -> None:
    (tmp_path / "out.csv").write_text("before")
    command = [sys.executable, "-c", KILLED, str(calibrated), str(rows_of(tmp_path))]
    assert subprocess.run(command, cwd=tmp_path, env=ENVIRONMENT, timeout=600).returncode == -9
    assert (tmp_path / "out.csv").read_text() == "before"


@pytest.fixture(scope="module")
def path() -> Trajectory:
    """The bundled path, which goes beyond a limit once, and carries less from then on."""
    found = read_trajectory(ROBOTS / "tarm_like" / "trajectory.csv", armflex.load_arm(DECLARED))
    q = found.q[10:40].copy()
    q[11, 1] = 3.9
    payload = ("p600",) * 20 + ("empty",) * 10
    return replace(found, time=found.time[10:40], q=q, via=found.via[10:40], payload=payload, places=())


@pytest.mark.parametrize("together", [1, 7, 1000])
def test_a_path_is_checked_in_pieces_as_at_once(
    arm: armflex.Arm, path: Trajectory, monkeypatch: pytest.MonkeyPatch, together: int
) -> None:
    whole = armflex.check(arm, path, 0.045, 0.01)
    monkeypatch.setattr("armflex.tasks.check.TOGETHER", together)
    pieces = armflex.check(arm, path, 0.045, 0.01)
    assert (pieces.ok, pieces.samples) == (whole.ok, whole.samples)
    assert {flag.code for flag in pieces.flags} == {flag.code for flag in whole.flags}
    for name in ("rows", "segments", "via_points", "path_worst"):
        one, other = getattr(pieces, name), getattr(whole, name)
        for mine, its in zip(*((x if isinstance(x, tuple) else (x,)) for x in (one, other)), strict=True):
            close = {key: pytest.approx(v, 1e-9, 1e-13) if isinstance(v, float) else v for key, v in vars(its).items()}
            assert vars(mine) == close
    assert "outside" in whole.rows[11].reason and {point.verdict for point in whole.rows} >= {"ok", "fail"}


def test_loads_on_the_drives_are_those_of_each_row(arm: armflex.Arm, path: Trajectory) -> None:
    q = np.delete(path.q, 11, axis=0)
    for motion in ({}, {"v": np.full_like(q, 0.1)}):
        found = arm.deflection(q, "p600", **motion)
        effort = np.array([joint.effort for joint in arm.robot.moving])
        shares = [found.row(i).drive_shares for i in range(len(q))]
        np.testing.assert_allclose(np.abs(found.drive_loads) / effort, shares, rtol=1e-9, atol=1e-12)


def test_the_response_has_the_change_with_the_joints_that_each_row_has(path: Trajectory) -> None:
    """Also where a law depends on the positions: the telescope's does."""
    tarm = armflex.load_arm(ROBOTS / "tarm_like" / "arm.toml")
    line = respond(tarm, path.q, path.payload)
    given = tarm.stack.change_with_position(line.flexure_wrenches.reshape(len(path), -1), line.row)
    found = line.joints + line.laws.reshape(len(path), 6, -1) @ given
    asked = {"enforce_limits": False}
    alone = [tarm.deflection(q, name, **asked).total_jacobian for q, name in zip(path.q, path.payload, strict=True)]
    np.testing.assert_allclose(found, alone, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("match", ["position", "pose"])
def test_a_path_is_compensated_in_pieces_as_row_by_row(
    path: Trajectory, monkeypatch: pytest.MonkeyPatch, match: str
) -> None:
    """Rows that are asked about together are found as one alone is, also where they start at limits."""
    tarm = armflex.load_arm(ROBOTS / "tarm_like" / "arm.toml")
    q = path.q.copy()
    q[11, 1], q[12, 1] = tarm.robot.upper[1] - 1e-4, tarm.robot.lower[1] + 1e-4
    inside, found = replace(path, q=q), []
    for together in (1000, 7, 1):
        monkeypatch.setattr("armflex.tasks.compensate.TOGETHER", together)
        found.append(armflex.compensate(tarm, inside, match, best_effort=True))
    for one in found[:2]:
        np.testing.assert_allclose(one.trajectory.q, found[2].trajectory.q, rtol=0.0, atol=1e-7)
        assert one.between_m == pytest.approx(found[2].between_m, 1e-6)
        for mine, its in zip(one.rows, found[2].rows, strict=True):
            assert all(getattr(mine, x) == getattr(its, x) for x in ("reached", "smallest", "reason", "via"))
            np.testing.assert_allclose(mine.before, its.before, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("command", ["check", "compensate", "calibrate", "trace"])
def test_no_command_ends_in_a_traceback_where_memory_runs_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture, command: str
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise MemoryError

    table = "trajectory.csv" if command in ("check", "compensate") else "campaign.csv"
    options = ["--tolerance", "5mm"] if command == "check" else ["-o", str(tmp_path / "out")]
    monkeypatch.setattr(f"armflex.cli.{command}_command.{command}", fail)
    monkeypatch.setattr(sys, "argv", ["armflex", command, str(DECLARED), str(DECLARED.with_name(table)), *options])
    with pytest.raises(SystemExit) as ended:
        main()
    rows = 143 if "trajectory" in table else 460
    assert ended.value.code == 1 and not (tmp_path / "out").exists()
    assert f"error: {rows} rows: there is not enough memory for them" in " ".join(capsys.readouterr().err.split())


@pytest.mark.slow
def test_what_follows_from_a_batch_is_what_follows_from_its_rows(arm: armflex.Arm, path: Trajectory) -> None:
    """Also of an arm whose geometry was corrected, and of a batch whose rows are asked one by one."""
    q = np.delete(path.q, 11, axis=0)
    unsure = tuple(replace(one, law=replace(one.law, relative_std=0.1)) for one in arm.flexures)
    off = replace(arm, flexures=unsure, corrections=Corrections(joint_offset={arm.joint_names[1]: 2e-3}))
    for motion in ({}, {"v": np.full_like(q, 0.1)}):
        found = off.deflection(q, "p600", **motion)
        rows = [found.row(i) for i in range(len(q))]
        for name in ("corrected", "remainder", "drive_shares"):
            alone = [getattr(row, name) for row in rows]
            np.testing.assert_allclose(getattr(found, name), alone, rtol=1e-8, atol=1e-11)
        np.testing.assert_allclose(found.shares(), [row.shares() for row in rows], rtol=1e-8, atol=1e-12)
        np.testing.assert_allclose(found.sigma(), [row.sigma() for row in rows], rtol=1e-7)
