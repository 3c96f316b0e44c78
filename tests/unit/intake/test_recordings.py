"""`intake` of recordings: bags, motion captures, controllers' traces; the arm counts where it stands."""

import sys
from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.command_line import fine, run_here, strict_json
from support.recordings import NAMES, PAUSES, POSES, RECORDED, SEEN, SHIFT, TT, Q, T, bag, log, mcap_json, motive, tip

from armflex.errors import InputError, UnsupportedError
from armflex.intake import intake
from armflex.intake.streams import dwells, offset, paired


@pytest.mark.slow
@pytest.mark.parametrize("kind", RECORDED)
def test_recordings_become_a_row_for_each_pose(tmp_path: Path, kind: str) -> None:
    found = intake(RECORDED[kind](tmp_path), 5e-5)
    joints = [name for name in found.columns if name.startswith("q_")]
    assert joints == (["q_A1", "q_A2", "q_A3"] if "KUKA" in kind else [f"q_{name}" for name in NAMES])
    q = np.array([found.columns[name] for name in joints]).T
    xyz = np.array([found.columns[axis] for axis in "xyz"]).T
    assert np.allclose(q, POSES, atol=1e-6)
    assert np.allclose(xyz, tip(POSES), atol=4e-5)
    assert "the arm stands 9 times" in found.notes[0]
    shift = float(found.notes[1].split("is ")[1].split(" s")[0])
    assert shift == pytest.approx(0.0 if kind == "C3D" else SHIFT, abs=0.02)


@pytest.mark.parametrize("kind", ["Motive", "MCAP of JSON"])
def test_orientations_of_a_recording_are_read_where_their_noise_is_stated(tmp_path: Path, kind: str) -> None:
    paths = RECORDED[kind](tmp_path)
    without = intake(paths, 5e-5)
    assert "rx" not in without.columns
    assert any("--sigma-r" in note for note in without.notes)
    found = intake(paths, 5e-5, sigma_r=1e-3)
    read = Rotation.from_rotvec(np.array([found.columns[axis] for axis in ("rx", "ry", "rz")]).T)
    truth = Rotation.from_rotvec(np.column_stack([POSES[:, 1], 2.0 * POSES[:, 0], POSES[:, 2]]))
    assert (read.inv() * truth).magnitude().max() < 1e-3
    assert set(found.columns["sigma_r"]) == {1e-3}


def test_a_column_of_numbers_may_be_the_names_of_rows(tmp_path: Path) -> None:
    last = f"/joint_states/{NAMES[-1]}/position"
    found = intake([log(tmp_path)], None, {last: "pose"})
    assert list(map(float, found.columns["via"])) == pytest.approx(POSES[:, -1], abs=1e-6)


@pytest.mark.parametrize("clock", ["as it is", "40 s off"])
def test_points_of_a_tracker_fall_into_the_dwells_of_a_log(tmp_path: Path, clock: str) -> None:
    at = np.cumsum(1.2 + PAUSES) - 0.5 * PAUSES + (0.0 if clock == "as it is" else 40.0)
    export = tmp_path / "tracker.txt"
    kept = [i for i in range(9) if i != 4]  # one pose was forgotten
    rows = [f"P{i};{';'.join(map(str, 1e3 * tip(POSES[i : i + 1])[0]))};{at[i]:.2f}" for i in kept]
    export.write_text("Name;X [mm];Y [mm];Z [mm];Time\n" + "\n".join(rows))
    found = intake([log(tmp_path), export], 5e-5)
    xyz = np.array([[float(cell or "nan") for cell in found.columns[axis]] for axis in "xyz"]).T
    assert np.isnan(xyz[4]).all()
    assert np.allclose(np.delete(xyz, 4, axis=0), tip(POSES[kept]))
    assert any("apart" in note for note in found.notes) == (clock != "as it is")
    assert list(found.columns["pose"]) == ["5" if i == 4 else f"P{i}" for i in range(9)]
    assert [(name, line == found.lines[4]) for name, line in found.without_point] == [("5", True)]
    asked = ("--sigma", "0.05mm", "-o", "c.csv", "--json", "c.json")
    said = fine(run_here(tmp_path, "intake", "joints.csv", export.name, *asked))
    assert f"Rows without a point: 5 (line {found.lines[4]})." in said.stdout
    assert strict_json(tmp_path / "c.json")["without_point"] == [{"pose": "5", "line": found.lines[4]}]


def test_a_row_of_a_stand_is_at_its_middle_however_its_clock_is_written(tmp_path: Path) -> None:
    seconds, stamps = tmp_path / "seconds.csv", tmp_path / "stamps.csv"
    head, begins = "time," + ",".join(f"q_{name}" for name in NAMES), datetime(2026, 3, 12, 14, 5)
    for path, clock in ((seconds, str), (stamps, lambda time: (begins + timedelta(seconds=time)).isoformat())):
        rows = zip(T.tolist(), Q.tolist(), strict=True)
        path.write_text("\n".join([head, *(",".join([clock(time), *map(str, q)]) for time, q in rows)]))
    export = tmp_path / "tracker.txt"
    at = np.cumsum(1.2 + PAUSES) - 0.5 * PAUSES
    places = [f"{','.join(map(str, 1e3 * tip(POSES[i : i + 1])[0]))},{at[i]}" for i in range(9)]
    export.write_text("\n".join(["x_mm,y_mm,z_mm,time", *places]))
    times = list(map(float, intake([seconds, export], 5e-5).columns["time"]))
    dates = [datetime.fromisoformat(cell) for cell in intake([stamps, export], 5e-5).columns["time"]]
    assert np.diff(times[1:]) == pytest.approx(np.diff(at[1:]), abs=0.1)  # the arm stands before it drives to the first
    assert [(date - dates[0]).total_seconds() for date in dates] == pytest.approx(times, abs=0.01)
    assert (dates[1] - begins).total_seconds() == pytest.approx(at[1], abs=0.2)


@pytest.mark.parametrize(
    ("header", "cells"),
    [
        ("timestamp " + " ".join(f"actual_q_{i} target_q_{i}" for i in range(3)),
         lambda q: [v for x in q for v in (x, 9)]),
        ("%time," + ",".join(f"field.name{i}" for i in range(3)) + ","
         + ",".join(f"field.position{i}" for i in range(3)), lambda q: [*NAMES, *q]),
        ("Time,name,position", lambda q: [f"\"{[*NAMES]}\"", f"\"({', '.join(map(str, q))})\""]),
        ("Time," + ",".join(f"name_{i}" for i in range(3)) + ","
         + ",".join(f"position_{i}" for i in range(3)), lambda q: [*NAMES, *q]),
    ],
)  # fmt: skip
def test_logs_of_samples_as_tools_write_them(tmp_path: Path, header: str, cells: Callable) -> None:
    mark = "," if "," in header else " "
    scale = 1e9 if header.startswith("%time") else 1.0
    lines = [mark.join(map(str, [f"{scale * (1.7e9 + t):.3f}", *cells(q.tolist())])) for t, q in zip(T, Q, strict=True)]
    (tmp_path / "log.csv").write_text("\n".join([header, *lines]))
    rows = [f"P{i};{';'.join(map(str, 1e3 * place))}" for i, place in enumerate(tip(POSES))]
    (tmp_path / "points.txt").write_text("Name;X [mm];Y [mm];Z [mm]\n" + "\n".join(rows))
    found = intake([tmp_path / "log.csv", tmp_path / "points.txt"], 5e-5)
    joints = [name for name in found.columns if name.startswith("q_")]
    assert len(joints) == 3
    assert joints[0] == ("q_shoulder_pan_joint" if "actual" in header else "q_base_joint")
    assert np.allclose(np.array([found.columns[name] for name in joints]).T, POSES, atol=1e-9)
    assert np.allclose(np.array([found.columns[axis] for axis in "xyz"]).T, tip(POSES))
    assert found.columns["pose"] == [f"P{i}" for i in range(9)]


def test_of_several_bodies_one_is_chosen(tmp_path: Path) -> None:
    path = motive(tmp_path)
    path.write_text(path.read_text().replace("Rigid Body Marker", "Marker"))
    with pytest.raises(InputError, match="--target 'flange'"):
        intake([log(tmp_path), path], 5e-5)
    with pytest.raises(InputError, match="did you mean 'flange'"):
        intake([log(tmp_path), path], 5e-5, targets=["flang"])
    one = intake([log(tmp_path), path], 5e-5, targets=["flange"])
    both = intake([log(tmp_path), path], 5e-5, targets=["flange", "flange:Marker1"])
    assert one.columns["x"] == both.columns["x"]
    assert np.allclose(np.array(both.columns["target2_x"]) - both.columns["x"], 9e-3)


def test_an_extra_that_is_not_installed_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.mcap").write_bytes(b"")
    (tmp_path / "a.c3d").write_bytes(b"\2\x50")
    monkeypatch.setitem(sys.modules, "mcap.reader", None)
    monkeypatch.setattr("armflex.intake.bags.find_spec", lambda name: None)
    monkeypatch.setattr("armflex.intake.captures.find_spec", lambda name: None)
    for path, extra in (("a.mcap", "bags"), ("a.c3d", "mocap")):
        with pytest.raises(UnsupportedError, match=rf"armflex\[{extra}\]"):
            intake([tmp_path / path], 5e-5)


def test_an_arm_that_never_stands_is_no_campaign(tmp_path: Path) -> None:
    time = np.arange(0.0, 20.0, 0.01)
    with pytest.raises(InputError, match="nothing stands still"):
        intake([log(tmp_path, time, np.sin(np.outer(time, [1.0, 1.3, 0.7]))), motive(tmp_path)], 5e-5)


def test_another_motion_is_not_joined() -> None:
    other = np.random.default_rng(9).normal(0.0, 0.3, (len(TT), 3))
    with pytest.raises(InputError, match="do not move alike"):
        offset(T, Q, TT, other)


def test_dwells_begin_after_the_swing_and_end_before_the_next_motion() -> None:
    spans = dwells(T, Q, "rad")
    ends = np.cumsum(1.2 + PAUSES)
    assert (spans[1:, 0] > ends[1:] - PAUSES[1:]).all()
    assert (spans[:, 1] < ends).all()
    assert ((spans[:, 1] - spans[:, 0]) > 0.4 * PAUSES).all()


def test_even_times_are_not_moved() -> None:
    spans = 10.0 * np.arange(8)[:, None] + np.array([0.0, 2.0])
    assert paired(spans, 10.0 * np.arange(7) + 5.0)[1] == 0.0  # which of them was left out is open


@pytest.mark.parametrize("other", [False, True])
def test_motions_that_take_equally_long_are_distinguished_by_their_sizes(other: bool) -> None:
    """A program moves for 2 s and stands for 1.5 s, forty times: lags of 3.5 s look alike but for how far it goes."""
    rng = np.random.default_rng(3)
    poses = rng.uniform(-1.5, 1.5, (40, 3))
    at = np.repeat(3.5 * np.arange(40), 2) + np.tile([0.0, 1.5], 40)
    time = np.arange(0.0, at[-1], 0.02)
    q = np.column_stack([np.interp(time, at, np.repeat(own, 2)) for own in poses.T])
    if other:  # every motion as long as the others, too: nothing distinguishes them
        q = np.column_stack([np.interp(time, at, np.repeat(np.tile([0.0, 1.0], 20), 2))] * 3)
        with pytest.raises(InputError, match="several differences"):
            offset(time, q, time + 0.4, tip(q))
    else:
        assert offset(time, q, time + 0.4, tip(q))[0] == pytest.approx(0.4, abs=0.02)


@pytest.mark.parametrize("kind", ["PoseArray", "MarkerArray"])
def test_a_target_in_messages_of_another_type_is_said(tmp_path: Path, kind: str) -> None:
    """Joints alone are a path, and nobody said that the target was left out."""
    path = mcap_json(tmp_path, kind)
    found = intake([path], None)
    assert f"topics of others: /prism ({kind})" in " ".join(found.notes) and "x" not in found.columns
    with pytest.raises(InputError, match=r"--sigma, and .* has no place of a type that is read, but topics of others"):
        intake([path], 5e-5)


def test_an_orientation_that_nobody_set_is_not_measured(tmp_path: Path) -> None:
    path = bag(tmp_path, "MCAP")
    assert "rx" not in intake([path], 5e-5).columns
    with pytest.raises(InputError, match=r"--sigma-r, and the orientation .* is 0, 0, 0, 1 in every row, to the last"):
        intake([path], 5e-5, sigma_r=1e-3)


def test_a_target_that_hardly_moves_while_joints_turn_is_in_another_unit(tmp_path: Path) -> None:
    path = tmp_path / "tracker.csv"
    rows = "".join(f"{t:.3f},{x:.7f},{y:.7f},{z:.7f}\n" for t, (x, y, z) in zip(TT, SEEN, strict=True))
    path.write_text(f"time,x_mm,y_mm,z_mm\n{rows}")
    with pytest.raises(
        InputError, match=r"'x_mm' and the others in mm move over 1\.\d+ mm while 3 joints turn by more"
    ):
        intake([log(tmp_path), path], 5e-5)
    found = intake([log(tmp_path), path], 5e-5, {f"{axis}_mm": f"{axis}_m" for axis in "xyz"})
    assert np.allclose(np.array([found.columns[axis] for axis in "xyz"]).T, tip(POSES), atol=4e-5)
    kept = intake([log(tmp_path), path], 5e-5, {f"{axis}_mm": f"{axis}_mm" for axis in "xyz"})
    assert np.allclose(np.array([kept.columns[axis] for axis in "xyz"]).T, 1e-3 * tip(POSES), atol=4e-8)


def test_clocks_that_may_be_apart_in_several_ways_are_named(tmp_path: Path) -> None:
    """It drives to and fro, and each motion and each pause takes as long as all others."""
    q = np.tile(np.random.default_rng(8).uniform(-1.5, 1.5, (2, 3)), (4, 1))[:7]
    at = np.cumsum(np.tile([2.0, 1.0], 7)) - 2.0
    time = np.arange(0.0, at[-2] + 2.0, 0.02)
    values = np.column_stack([np.interp(time, at, column) for column in np.repeat(q, 2, axis=0).T])
    seen = zip(time[350:800], tip(values[350:800]), strict=True)
    rows = "".join(f"{t - 3.0:.3f},{x:.5f},{y:.5f},{z:.5f}\n" for t, (x, y, z) in seen)
    (tmp_path / "tracker.csv").write_text(f"time,x_m,y_m,z_m\n{rows}")
    paths = [log(tmp_path, time, values), tmp_path / "tracker.csv"]
    with pytest.raises(InputError, match=r"of their clocks, .*-3\.00 s.*: record uneven pauses, or put the times of"):
        intake(paths, 5e-5)


@pytest.mark.parametrize("cells", [("none", "p10"), ("0", "10")])
def test_a_load_that_changes_while_the_arm_stands_parts_the_stand(tmp_path: Path, cells: tuple[str, str]) -> None:
    """Its row had the first payload and the mean of both places."""
    name = "payload" if cells[0] == "none" else "payload_mass"
    ends = np.cumsum(1.2 + PAUSES)
    change = float(ends[3] - 0.5 * PAUSES[3])
    lines = log(tmp_path).read_text().splitlines()
    loaded = [
        f"{lines[0]},{name}",
        *(f"{line},{cells[int(t >= change)]}" for line, t in zip(lines[1:], T, strict=True)),
    ]
    (tmp_path / "joints.csv").write_text("\n".join(loaded))
    sagged = 1e3 * SEEN - np.where(change <= TT, 2.0, 0.0)[:, None] * [0.0, 0.0, 1.0]
    rows = [f"{t:.3f},{x:.4f},{y:.4f},{z:.4f}" for t, (x, y, z) in zip(TT, sagged, strict=True)]
    (tmp_path / "tracker.csv").write_text("\n".join(["time,x_mm,y_mm,z_mm", *rows]))
    found = intake([tmp_path / "joints.csv", tmp_path / "tracker.csv"], 5e-5)
    states = cells if cells[0] == "none" else (0.0, 10.0)
    assert [*found.columns[name]] == [states[int(i > 3)] for i in range(10)]
    expected = tip(np.insert(POSES, 3, POSES[3], axis=0))[:, 2] - np.where(np.arange(10) > 3, 2e-3, 0.0)
    assert np.allclose(found.columns["z"], expected, atol=5e-5)
    assert any(f"stands of joints.csv are parted where '{name}' changes" in note for note in found.notes)


@pytest.mark.parametrize(("clock", "per_second"), [("ts", 1.0), ("ts_ms", 1e3), ("t_ms", 1e3)])
def test_numbers_of_a_dense_log_are_kept_as_means_of_each_stand(tmp_path: Path, clock: str, per_second: float) -> None:
    ends = np.cumsum(1.2 + PAUSES)
    stand = np.searchsorted(ends, T)
    speed = np.gradient(Q[:, 0], T)
    gap = ["" if t < ends[1] else f"{t:.3f}" for t in T]  # of a topic that fell silent in two stands
    beside = {"I_J1": 2.0 + stand, "speed_J1": speed, "motor_temp_J1": 20.0 + 0.1 * stand, "fx": speed, "hours": gap}
    of_rows = zip(per_second * T, Q, *beside.values(), strict=True)
    rows = [
        f"{t:.6f},{','.join(map(str, q))},{','.join(map(str, cells))},RUN,{i % 7}.5"
        for i, (t, q, *cells) in enumerate(of_rows)
    ]
    head = f"{clock},{','.join(f'q_{name}' for name in NAMES)},{','.join(beside)},mode,count"
    (tmp_path / "joints.csv").write_text("\n".join([head, *rows]))
    seen = [f"{t:.3f},{x:.4f},{y:.4f},{z:.4f}" for t, (x, y, z) in zip(TT, 1e3 * SEEN, strict=True)]
    (tmp_path / "tracker.csv").write_text("\n".join(["time,x_mm,y_mm,z_mm", *seen]))
    found = intake([tmp_path / "joints.csv", tmp_path / "tracker.csv"], 5e-5)
    assert np.allclose(found.columns["I_J1"], 2.0 + np.arange(9))
    assert np.allclose(found.columns["motor_temp_J1"], 20.0 + 0.1 * np.arange(9))
    assert np.abs(found.columns["speed_J1"]).max() < 1e-3 < np.abs(speed).max()
    assert [cell == "" for cell in found.columns["hours"]] == [i in (0, 1) for i in range(9)]
    assert not {"fx", "mode", clock} & found.columns.keys() and len(found.columns["time"]) == 9
    why = {column: (kind, why) for _, column, kind, _, why in found.taken}
    assert why["I_J1"] == ("a covariate", "its mean while the arm stands") and why["fx"][0] == "not used"


def test_a_stamp_beside_a_time_is_none(tmp_path: Path) -> None:
    path = log(tmp_path)
    head, *rows = path.read_text().splitlines()
    path.write_text("\n".join([f"{head},ts", *(f"{row},{i}" for i, row in enumerate(rows))]))
    assert "ts" not in intake([path], None).columns
