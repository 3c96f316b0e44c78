"""Effects of time hold for the clock of their campaign; everything else means the arm as it was left at its end."""

import csv
import json
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from support import three_joint_plant
from support.campaign_files import numbers, write_columns
from support.command_line import run_here
from support.compiled_arm import COMPILER, compiled

from armflex import Arm, calibrate, load_arm, map_workspace, predict, read_measurements
from armflex.errors import ArmFileError, InputError
from armflex.laws.terms import Factor, Of
from armflex.measured.campaign_clock import as_in
from armflex.rows.period import Period

BEGAN = datetime(2026, 3, 1, 8)
SIZE, AT, LAST, WANDER = 3e-3, 500.0, 1990.0, 1e-6
SLIP = f'name = "slip_step"\nsite = "J2"\naxis = "ry"\nparameters = {{ size = {SIZE}, at = {AT} }}'
DRIFT = f'name = "base_drift"\nsite = "base"\naxis = "dx"\nparameters = {{ v_dx = {WANDER} }}'
SPLINE = """name = "unnamed"
shape = "spline"
site = "base"
axis = "dz"
covariates = ["time"]
seen = { time = [0.0, 1990.0] }

[effect.parameters]
low = 0.0
high = 1990.0
""" + "\n".join(f"a{i} = {1e-3 if i in (1, 2) else 0.0}" for i in range(8))
POSES = np.round(np.random.default_rng(3).uniform([-2.0, -0.9, -1.2], [2.0, 0.9, 1.2], (40, 3)), 6)
ASKED = np.round(np.random.default_rng(4).uniform([-2.0, -0.9, -1.2], [2.0, 0.9, 1.2], (8, 3)), 6)
TIMES = 10.0 * np.arange(200.0)[::5]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Arms that slipped, that drift, and that slip with a campaign's clock by seconds or by dates."""
    folder = tmp_path_factory.mktemp("clocks")
    three_joint_plant.declared(folder)
    for name, effects in {"slip": [SLIP], "drift": [DRIFT], "both": [SLIP, DRIFT], "dated": [SLIP, DRIFT]}.items():
        dates = name == "dated"
        (folder / f"{name}_true.toml").write_text(with_effects(effects))
        write_campaign(folder / f"{name}.csv", load_arm(folder / f"{name}_true.toml"), POSES, TIMES, dates)
        seen = f"\nseen = {{ time = [0.0, {LAST - 40.0}] }}"
        (folder / f"{name}_declared.toml").write_text(with_effects([f"{one}{seen}" for one in effects]))
        arm = load_arm(folder / f"{name}_declared.toml")
        calibrate(arm, folder / f"{name}.csv").write(folder / f"{name}.toml")
    return folder


def with_effects(effects: Sequence[str]) -> str:
    return three_joint_plant.ARM + "".join(f"\n[[effect]]\n{one}\n" for one in effects)


def tips(arm: Arm, q: np.ndarray, times: np.ndarray) -> np.ndarray:
    return np.array(
        [arm.deflection(one, covariates={"time": at}).pose.translation for one, at in zip(q, times, strict=True)]
    )


def write_campaign(path: Path, truth: Arm, q: np.ndarray, times: np.ndarray, dates: bool = False) -> Path:
    noise = np.random.default_rng(5).normal(0.0, three_joint_plant.SIGMA, (len(q), 3))
    read = three_joint_plant.apply(three_joint_plant.STATION, tips(truth, q, times)) + noise
    columns = {f"q_J{i + 1}": numbers(q[:, i]) for i in range(3)} | {
        x: numbers(read[:, i]) for i, x in enumerate("xyz")
    }
    write_columns(path, columns | {"sigma": [5e-5] * len(q), "time": time_cells(times, BEGAN if dates else None)})
    return path


def time_cells(times: np.ndarray, start: datetime | None) -> list[object]:
    return times.tolist() if start is None else [(start + timedelta(seconds=float(at))).isoformat() for at in times]


def write_rows(path: Path, q: np.ndarray, times: np.ndarray | None, start: datetime | None = None) -> Path:
    columns = {f"q_J{i + 1}": numbers(q[:, i]) for i in range(3)}
    write_columns(path, columns | ({} if times is None else {"time": time_cells(times, start)}))
    return path


def read(path: Path, names: str = "x y z") -> np.ndarray:
    with path.open() as file:
        return np.array([[float(row[name]) for name in names.split()] for row in csv.DictReader(file)])


def where(truth: Arm, q: np.ndarray, times: np.ndarray) -> np.ndarray:
    return three_joint_plant.apply(three_joint_plant.STATION, tips(truth, q, times))


def said(ran: subprocess.CompletedProcess[str], code: str) -> list[str]:
    return [line for line in ran.stderr.splitlines() if f"{code}:" in line]


CLOSE = 1.5e-4
"""What noise leaves of a position [m]; a slip moves the tip by 3 mm and more."""

EARLY, LATE = np.linspace(0.0, 400.0, 8), np.linspace(600.0, 1900.0, 8)


@pytest.mark.parametrize("times", [None, EARLY, LATE, EARLY + 1e5], ids=["none", "from 0", "late", "another day"])
def test_what_slipped_has_slipped_whatever_the_clock_of_the_rows(folder: Path, times: np.ndarray | None) -> None:
    write_rows(folder / "rows.csv", ASKED, times)
    ran = run_here(folder, "predict", "slip.toml", "rows.csv", "-o", "out.csv")
    assert ran.returncode == 0, ran.stderr
    truth = where(load_arm(folder / "slip_true.toml"), ASKED, np.full(8, 1e4))
    np.testing.assert_allclose(read(folder / "out.csv"), truth, atol=CLOSE)
    differs = times is None or bool((times < AT).any())  # only then is there another meaning
    lines = said(ran, "as_left")
    assert len(lines) == differs and all("slip step at J2 (ry) stays" in line and "--as-in" in line for line in lines)


def test_rows_of_the_campaigns_own_clock_are_as_it_was_then(folder: Path) -> None:
    times, truth = np.concatenate([EARLY[::2], LATE[::2]]), load_arm(folder / "both_true.toml")
    write_rows(folder / "rows.csv", ASKED, times)
    ran = run_here(folder, "predict", "both.toml", "rows.csv", "-o", "out.csv", "--as-in", "both.csv")
    assert ran.returncode == 0 and "as_left" not in ran.stderr
    np.testing.assert_allclose(read(folder / "out.csv"), where(truth, ASKED, times), atol=CLOSE)
    ran = run_here(folder, "predict", "both.toml", "both.csv", "-o", "out.csv")  # the campaign itself
    assert ran.returncode == 0 and "as_left" not in ran.stderr
    np.testing.assert_allclose(read(folder / "out.csv"), where(truth, POSES, TIMES), atol=CLOSE)
    arm = load_arm(folder / "both.toml")
    part = read_measurements(folder / "both.csv", arm).some(np.arange(0, 40, 3))
    assert not [flag for flag in predict(arm, part).flags if flag.code == "as_left"]


@pytest.mark.parametrize("start", [0.0, 1000.0, -1e5, 1e5, -300.0])
def test_dates_say_whose_clock_rows_are_on(folder: Path, start: float) -> None:
    """Before the campaign it had not slipped yet; beyond it the drift is its mean."""
    times = start + np.linspace(0.0, 900.0, 8)
    write_rows(folder / "rows.csv", ASKED, times - start, BEGAN + timedelta(seconds=start))
    ran = run_here(folder, "predict", "dated.toml", "rows.csv", "-o", "out.csv")
    assert ran.returncode == 0, ran.stderr
    inside = (times >= 0.0) & (times <= TIMES[-1])
    truth, arm = load_arm(folder / "dated_true.toml"), load_arm(folder / "dated.toml")
    slipped = replace(truth, effects=truth.effects[:1])
    wanted = where(truth, ASKED, times)
    wandered = three_joint_plant.STATION[:3, 0] * WANDER * 0.5 * (LAST - 40.0)
    wanted[~inside] = where(slipped, ASKED, times)[~inside] + wandered
    np.testing.assert_allclose(read(folder / "out.csv"), wanted, atol=CLOSE)
    lines = said(ran, "as_left")  # of the slip dates leave nothing open
    assert len(lines) == bool((~inside).any()) and all(
        "slip" not in line and "not carried on" in line for line in lines
    )
    whole = read(folder / "out.csv")
    python = predict(arm, folder / "rows.csv")
    np.testing.assert_allclose(python.position, whole, atol=1e-9)


def test_what_wandered_is_not_carried_on_and_widens_sigma(folder: Path) -> None:
    write_rows(folder / "rows.csv", ASKED, np.linspace(0.0, 7e5, 8))
    ran = run_here(folder, "predict", "drift.toml", "rows.csv", "-o", "out.csv")
    (line,) = said(ran, "as_left")
    assert "base drift at base (dx) is not carried on, which widens sigma" in line
    arm, middle = load_arm(folder / "drift.toml"), 0.5 * (LAST - 40.0)
    there = as_in(arm, folder / "drift.csv")
    held = predict(there, write_rows(folder / "then.csv", ASKED, np.full(8, middle)))
    np.testing.assert_allclose(read(folder / "out.csv"), held.position, atol=1e-7)
    scatter = WANDER * (LAST - 40.0) / np.sqrt(12.0) * np.abs(three_joint_plant.STATION[:3, 0])
    assert held.sigma is not None
    wider = np.sqrt(read(folder / "out.csv", "sigma_x sigma_y sigma_z") ** 2 - held.sigma**2)
    np.testing.assert_allclose(wider, np.broadcast_to(scatter, wider.shape), rtol=0.01, atol=2e-6)
    from armflex import total_covariance

    both = [total_covariance(one.deflection(ASKED[0], covariates={"time": middle})) for one in (arm, there)]
    assert both[0] is not None and both[1] is not None
    assert (both[0] - both[1])[0, 0] == pytest.approx((WANDER * (LAST - 40.0)) ** 2 / 12.0, rel=0.01)


def test_the_frame_of_a_session_is_not_carried_to_a_new_one(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "r.urdf").write_text(three_joint_plant.URDF)
    (tmp_path / "arm.toml").write_text(f"{three_joint_plant.ARM}session_translation = 1e-4\nsession_rotation = 1e-5\n")
    path = write_campaign(tmp_path / "a.csv", load_arm(tmp_path / "arm.toml"), POSES, TIMES)
    head, *lines = path.read_text().splitlines()
    path.write_text("\n".join([f"{head},session", *(f"{line},{'ab'[i % 2]}" for i, line in enumerate(lines))]))
    written = calibrate(load_arm(tmp_path / "arm.toml"), path).write(tmp_path / "found.toml").read_text()
    frame = 'name = "session_frame"\nsite = "base"\npartner = "b"\nparameters = { dx = 0.002, dy = 0.0, dz = 0.0 }'
    (tmp_path / "moved.toml").write_text(f"{written}\n[[effect]]\n{frame}\n")
    columns = {f"q_J{i + 1}": numbers(ASKED[:, i]) for i in range(3)}
    write_columns(tmp_path / "rows.csv", columns | {"session": ["c"] * 8})
    plain, moved = (predict(load_arm(tmp_path / name), tmp_path / "rows.csv") for name in ("found.toml", "moved.toml"))
    np.testing.assert_allclose(moved.position, plain.position, atol=1e-9)
    assert plain.sigma is not None and moved.sigma is not None
    np.testing.assert_allclose((moved.sigma**2 - plain.sigma**2)[:, 0], 0.5 * 0.002**2, rtol=1e-6)


def test_a_free_shape_over_time_is_its_mean_on_another_day(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "r.urdf").write_text(three_joint_plant.URDF)
    (tmp_path / "arm.toml").write_text(with_effects([SPLINE]))
    arm = replace(load_arm(tmp_path / "arm.toml"), clock=(Period("a.csv", "", 0.0, 1990.0),))
    left = arm.left().deflection(ASKED[0]).displacement - replace(arm, effects=()).deflection(ASKED[0]).displacement
    np.testing.assert_allclose(left[2], 1e-3 * 2.0 / 8.0, rtol=0.01)  # two hats of eight


def test_other_files_of_the_clock_are_refused_by_name(folder: Path) -> None:
    arm, rows = load_arm(folder / "slip.toml"), write_rows(folder / "rows.csv", ASKED, EARLY)
    for path, text in (
        (rows, r"rows.csv \(0 s to 400 s\) is none of .* that this arm was fitted to: slip.csv \(0 s to 1950 s\)"),
        (write_rows(folder / "bare.csv", ASKED, None), r"bare.csv has no column 'time'"),
    ):
        with pytest.raises(InputError, match=text):
            as_in(arm, path)
    dated = write_rows(folder / "rows.csv", ASKED, EARLY, BEGAN)
    with pytest.raises(InputError, match=r"rows.csv:2: column 'time' has dates, that of slip.csv has seconds"):
        predict(as_in(arm, folder / "slip.csv"), dated)
    text = dated.read_text().replace("2026-03-01T08:0", "2026-03-01T08:0").replace("\n", "+00:00\n")
    dated.write_text(text.replace("time+00:00", "time"))
    with pytest.raises(InputError, match="the rows' dates in column 'time' say how far they are from UTC"):
        predict(load_arm(folder / "dated.toml"), dated)
    (folder / "again").mkdir()
    again = folder / "again" / "slip.csv"  # the same campaign, written by another program
    again.write_text((folder / "slip.csv").read_text().replace("5e-05", "0.00005"))
    assert as_in(arm, again).effects[0].left is None
    with pytest.raises(InputError, match=r"other.csv .* is none of"):  # of another day, at the same pace
        as_in(arm, again.rename(folder / "other.csv"))


def write_path(folder: Path) -> None:
    columns = {f"q_J{i + 1}": numbers(ASKED[:3, i]) for i in range(3)}
    write_columns(folder / "path.csv", {"time": [0.0, 10.0, 20.0], **columns, "via": ["a", "b", "c"]})


SITUATIONS: Mapping[str, Sequence[str]] = {
    "check": ["path.csv", "--tolerance", "100mm"],
    "compensate": ["path.csv", "-o", "out.csv"],
    "export": ["--to", "jointtrajectory", "--traj", "path.csv", "--compensate", "-o", "out.yaml"],
}


@pytest.mark.parametrize("command", ["check", "compensate"])
def test_paths_mean_the_arm_as_it_was_left(folder: Path, command: str) -> None:
    write_path(folder)
    plain = load_arm(folder / "slip_true.toml")
    with_slip, without = (tips(plain, ASKED[:3], np.full(3, at)) for at in (1e4, 0.0))
    rigid = np.array([plain.rigid_pose(q).translation for q in ASKED[:3]])
    for more, tip in (([], with_slip), (["--as-in", "slip.csv"], without)):
        ran = run_here(folder, command, "slip.toml", *SITUATIONS[command], *more, "--json", "said.json")
        assert ran.returncode == 0, ran.stderr
        assert len(said(ran, "as_left")) == (not more)
        found = json.loads((folder / "said.json").read_text())
        if command == "check":
            sizes = {one["name"]: one["displacement_m"] for one in found["via_points"]}
            moved = [
                float(np.linalg.norm(sizes[name][:3])) if isinstance(sizes[name], list) else sizes[name]
                for name in "abc"
            ]
        else:
            moved = [float(np.linalg.norm(one["before"][:3])) for one in found["rows"]]
        np.testing.assert_allclose(moved, np.linalg.norm(tip - rigid, axis=1), atol=CLOSE)


def test_maps_programs_and_c_mean_the_arm_as_it_was_left(folder: Path) -> None:
    arm, truth = load_arm(folder / "slip.toml"), load_arm(folder / "slip_true.toml")
    found = map_workspace(arm, rows=64, uncertainty=False)
    (flag,) = [one for one in found.flags if one.code == "as_left"]
    here = found.worst_voxel
    tip, rigid = tips(truth, found.worst_q[here][None], np.array([1e4]))[0], truth.rigid_pose(found.worst_q[here])
    assert found.worst[here] == pytest.approx(float(np.linalg.norm(tip - rigid.translation)), abs=CLOSE)
    then = map_workspace(as_in(arm, folder / "slip.csv"), rows=64, uncertainty=False, covariates={"time": 0.0})
    assert then.worst.max() < found.worst.max() and flag not in then.flags
    for more, columns in (([], []), (["--as-in", "slip.csv"], ["time"])):
        ran = run_here(folder, "export", "slip.toml", "--to", "c", "-o", "arm.c", "--json", "said.json", *more)
        assert ran.returncode == 0 and len(said(ran, "as_left")) == (not more), ran.stderr
        assert json.loads((folder / "said.json").read_text())["covariates"] == columns
    for command in ("deflect", "modes"):
        for more in ([], ["--as-in", "slip.csv", "--covariates", "time=0"]):
            ran = run_here(folder, command, "slip.toml", *more)
            assert ran.returncode == 0 and len(said(ran, "as_left")) == (not more), ran.stderr
    write_path(folder)
    ran = run_here(folder, "export", "slip.toml", *SITUATIONS["export"])
    assert ran.returncode == 0 and len(said(ran, "as_left")) == 1, ran.stderr


def test_in_another_campaign_an_arm_is_as_an_earlier_one_left_it(folder: Path, tmp_path: Path) -> None:
    truth, arm = load_arm(folder / "slip_true.toml"), load_arm(folder / "slip.toml")
    slipped = replace(truth, effects=tuple(replace(one, values=(SIZE, -1.0)) for one in truth.effects))
    later = write_campaign(tmp_path / "later.csv", slipped, POSES[::-1], TIMES)
    found = calibrate(arm, later, keep=True)
    assert found.rms < 2.0 * three_joint_plant.SIGMA * np.sqrt(3.0)
    again = load_arm(found.write(tmp_path / "later.toml"))
    assert "earlier = true" in (tmp_path / "later.toml").read_text()
    assert [one.campaign for one in again.clock] == ["later.csv"] and again.effects[0].earlier
    rows = write_rows(tmp_path / "rows.csv", ASKED, EARLY)
    for one in (again, as_in(again, later)):
        np.testing.assert_allclose(predict(one, rows).position, where(slipped, ASKED, EARLY), atol=CLOSE)
    assert calibrate(arm, folder / "slip.csv", keep=True).rms < 2.0 * three_joint_plant.SIGMA * np.sqrt(3.0)


def test_campaigns_that_were_fitted_together_have_one_clock(folder: Path, tmp_path: Path) -> None:
    """The second begins anew at 0; what was found is on a clock that goes on."""
    truth = load_arm(folder / "slip_true.toml")
    slipped = replace(truth, effects=tuple(replace(one, values=(SIZE, -1.0)) for one in truth.effects))
    second = write_campaign(tmp_path / "second.csv", slipped, POSES[::-1], TIMES)
    found = calibrate(load_arm(folder / "slip_declared.toml"), [folder / "slip.csv", second])
    assert found.rms < 2.0 * three_joint_plant.SIGMA * np.sqrt(3.0)
    (tmp_path / "r.urdf").write_text(three_joint_plant.URDF)
    arm = load_arm(found.write(tmp_path / "both.toml"))
    assert [(one.campaign, one.later) for one in arm.clock] == [("slip.csv", 0.0), ("second.csv", TIMES[-1])]
    rows = write_rows(tmp_path / "rows.csv", ASKED, EARLY)
    for there, machine in ((arm, slipped), (as_in(arm, second), slipped), (as_in(arm, folder / "slip.csv"), truth)):
        np.testing.assert_allclose(predict(there, rows).position, where(machine, ASKED, EARLY), atol=CLOSE)
    again = predict(arm, second)
    np.testing.assert_allclose(again.position, where(slipped, POSES[::-1], TIMES), atol=CLOSE)


@pytest.mark.slow
def test_a_traced_slip_says_what_becomes_of_it(folder: Path) -> None:
    ran = run_here(folder, "trace", "arm.toml", "slip.csv", "-o", "traced.toml")
    assert ran.returncode == 0, ran.stderr
    assert "On another day, of slip at J2 (ry): it stays as it was at the end." in " ".join(ran.stdout.split())
    arm, truth = load_arm(folder / "traced.toml"), load_arm(folder / "slip_true.toml")
    assert arm.effects[0].span == (0.0, TIMES[-1]) and arm.clock[0].campaign == "slip.csv"
    rows = write_rows(folder / "rows.csv", ASKED, None)
    np.testing.assert_allclose(predict(arm, rows).position, where(truth, ASKED, np.full(8, 1e4)), atol=CLOSE)


@pytest.mark.skipif(COMPILER is None, reason="needs a C compiler")
def test_a_controller_has_the_arm_as_it_was_left(folder: Path) -> None:
    arm, payload = load_arm(folder / "both.toml"), np.zeros(8, dtype=int)
    code = compiled(arm, folder)
    assert code.covariates == []
    codes, poses = code.tips(ASKED, payload)
    assert not codes.any()
    np.testing.assert_allclose(poses[:, :, 3], tips(arm, ASKED, np.zeros(8)), atol=1e-9)
    there = as_in(arm, folder / "both.csv").on_clock(later=100.0)  # ahead of what the controller sets
    code = compiled(there, folder)
    for time in (0.0, 450.0):
        code.know({"time": time})
        own = tips(there, ASKED, np.full(8, time))
        np.testing.assert_allclose(code.tips(ASKED, payload)[1][:, :, 3], own, atol=1e-9)


FACTORS = [
    Factor(Of.POWER, "time", (3.0, 2.0, 2.0)),
    Factor(Of.SINE, "time", (0.7,)),
    Factor(Of.COSINE, "time", (0.7,)),
    Factor(Of.STEP, "time", (4.0,)),
    Factor(Of.BUMP, "time", (4.0, 2.0)),
    Factor(Of.TENT, "time", (0.0, 8.0, 2.0, 2.0)),
    Factor(Of.OVERLAP, "time", (1.0, 3.0)),
    Factor(Of.CHEBYSHEV, "time", (4.0, 5.0, 3.0)),
]


@pytest.mark.parametrize("factor", FACTORS, ids=lambda one: one.kind.name)
def test_a_factor_on_a_clock_that_is_ahead(factor: Factor) -> None:
    x = np.linspace(-3.0, 9.0, 25)
    shifted = sum(share * other.of(x) for share, other in factor.later(2.25))
    np.testing.assert_allclose(shifted, factor.of(x + 2.25), atol=1e-12)


def test_a_file_that_does_not_say_when_its_campaign_was_is_on_the_clock_of_rows(folder: Path) -> None:
    text = (folder / "slip.toml").read_text().partition("[[calibration.clock]]")[0]  # its last table
    (folder / "old.toml").write_text(text.replace(f"seen = {{ time = [0.0, {LAST - 40.0}] }}\n", ""))
    truth = load_arm(folder / "slip_true.toml")
    for times in (EARLY, LATE):
        write_rows(folder / "rows.csv", ASKED, times)
        ran = run_here(folder, "predict", "old.toml", "rows.csv", "-o", "out.csv")
        assert ran.returncode == 0, ran.stderr
        (line,) = said(ran, "clock_unknown")
        assert "does not say when slip step at J2 (ry) was found: 'time' of the rows counts as its clock" in line
        np.testing.assert_allclose(read(folder / "out.csv"), where(truth, ASKED, times), atol=CLOSE)


def edits() -> Iterator[tuple[str, str, str]]:
    yield "last = 1950.0", "last = -5.0", "expected the 0 s of 'first' or later, got -5 s"
    yield "last = 1950.0", 'last = 1950.0\nbegins = "noon"', r"expected a date \(ISO 8601\), got 'noon'"
    yield "last = 1950.0", "last = 1950.0\nlate = 2.0", "unknown key"
    yield "seen = { time = [0.0, 1950.0] }", "earlier = true", "must have its first and last moment"


@pytest.mark.parametrize(("old", "new", "text"), [*edits()])
def test_a_clock_that_is_none_is_named(folder: Path, tmp_path: Path, old: str, new: str, text: str) -> None:
    (tmp_path / "r.urdf").write_text(three_joint_plant.URDF)
    written = (folder / "slip.toml").read_text()
    assert old in written
    (tmp_path / "arm.toml").write_text(written.replace(old, new))
    with pytest.raises(ArmFileError, match=text):
        load_arm(tmp_path / "arm.toml")
