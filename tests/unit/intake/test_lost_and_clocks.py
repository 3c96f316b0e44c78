"""`intake` of lost targets and coarse clocks, of the joints of bags, and of files that were cut."""

import json
import re
import shutil
import struct
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from support.recordings import NAMES, POSES, SEEN, TT, TURNED, XYZ, Q, T, bag, c3d, log, motive, tip

from armflex.errors import InputError, ManyErrors, TableError
from armflex.intake import intake
from armflex.intake.campaign import Intake
from armflex.intake.streams import offset
from armflex.measured.lost_places import lost

MM = 1e3 * SEEN


def fits(found: Intake, most: float = 4e-5) -> None:
    """Compare all rows with the nine poses and their places."""
    q = np.array([found.columns[name] for name in found.columns if name.startswith("q_")]).T
    xyz = np.array([found.columns[axis] for axis in "xyz"], dtype=float).T
    assert q.shape == POSES.shape
    assert np.allclose(q, POSES, atol=1e-6)
    assert np.allclose(xyz, tip(POSES), atol=most)


def export(folder: Path, rows: Iterable[str], head: str = "time,x_mm,y_mm,z_mm") -> Path:
    (folder / "export.csv").write_text("\n".join([head, *rows]) + "\n")
    return folder / "export.csv"


@pytest.mark.parametrize("empty", ["-3.697314E28," * 3, "0,0,0.000,", "-9999.99," * 3, "9999,12,13,", "nan,nan,NaN,",
                                   "-1,-1,-1,", ",,,", "---,---,---,", "1.7e308,2,3,", "####,####,####,",
                                   "Beam broken,,,", "nicht gemessen,,,"])  # fmt: skip
def test_a_lost_target_is_in_no_mean(tmp_path: Path, empty: str) -> None:
    rows = [f"{t:.3f},{empty[:-1] if i % 7 == 0 else '{:.4f},{:.4f},{:.4f}'.format(*at)}"
            for i, (t, at) in enumerate(zip(TT, MM, strict=True))]  # fmt: skip
    found = intake([log(tmp_path), export(tmp_path, rows)], 5e-5)
    fits(found)
    assert any("have no reading" in note for note in found.notes) == (empty != ",,,")


@pytest.mark.parametrize(
    ("header", "gone", "there"),
    [("Valid", "0", "1"), ("is_tracked", "no", "yes"), ("tracking_state", "0", "2"), ("confidence", "0.0", "0.97"),
     ("NumMarkers", "0", "4"), ("occluded", "1", "0"), ("Lost", "True", "False"), ("status", "out of view", "ok"),
     ("flags", "invalid", ""), ("Lock", "-1", "1"), ("Error code", "17", "0"), ("beam", "broken", "locked"),
     ("Ergebnis", "n.i.O.", "i.O."), ("Measured", "FALSE", "TRUE"), ("Gültig", "nein", "ja"), ("Valide", "non", "oui"),
     ("Outlier", "1", "0"), ("Active", "No", "Yes"), ("Target present", "0", "1")],
)  # fmt: skip
def test_a_column_that_says_lost_is_believed(tmp_path: Path, header: str, gone: str, there: str) -> None:
    places = [MM[0] + 500.0 if i % 7 == 0 else place for i, place in enumerate(MM)]
    rows = [f"{t:.3f},{x:.4f},{y:.4f},{z:.4f},{gone if i % 7 == 0 else there}"
            for i, (t, (x, y, z)) in enumerate(zip(TT, places, strict=True))]  # fmt: skip
    fits(intake([log(tmp_path), export(tmp_path, rows, f"time,x_mm,y_mm,z_mm,{header}")], 5e-5))


@pytest.mark.parametrize(
    ("header", "gone", "there", "meant"),
    [
        ("Status", "4", "0", "error"),
        ("state", "0", "2", "valid"),
        ("Flag", "X", "", ""),
        ("Solution", "B", "A", ""),
        ("Status", "BeamLost", "OK", "valid"),
        ("Status", "Wobbly", "Steady", "valid"),
        ("Blah", "0", "1", "valid"),
        ("Kriterium", "ja", "nein", "error"),
    ],
)
def test_states_that_nobody_explains_are_asked_about(
    tmp_path: Path, header: str, gone: str, there: str, meant: str
) -> None:
    places = [MM[0] + 500.0 if i % 7 == 0 else place for i, place in enumerate(MM)]
    rows = [f"{t:.3f},{x:.4f},{y:.4f},{z:.4f},{gone if i % 7 == 0 else there}"
            for i, (t, (x, y, z)) in enumerate(zip(TT, places, strict=True))]  # fmt: skip
    files = [log(tmp_path), export(tmp_path, rows, f"time,x_mm,y_mm,z_mm,{header}")]
    with pytest.raises(ManyErrors, match=rf"export\.csv:\d+: '{header}' is .* is that a reading"):
        intake(files, 5e-5)
    if meant:
        fits(intake(files, 5e-5, {header: meant}))


def beside(folder: Path, joints: np.ndarray, places: np.ndarray) -> Path:
    """A file of poses without a clock, with the place that was read at each."""
    head = [*(f"J{k + 1} [rad]" for k in range(joints.shape[1])), *(f"{axis} [m]" for axis in "xyz")]
    rows = [",".join(map(repr, row)) for row in np.column_stack([joints, places]).tolist()]
    (folder / "poses.csv").write_text("\n".join([",".join(head), *rows]) + "\n")
    return folder / "poses.csv"


def test_a_place_that_is_held_while_joints_move_is_no_reading_without_a_clock(tmp_path: Path) -> None:
    """A lost beam leaves the last value in the table; a pose that is driven to again is read there again."""
    joints = POSES.copy()
    joints[6] = joints[5]
    places = tip(joints)
    for i in (2, 3, 8):
        places[i] = places[i - 1]
    found = intake([beside(tmp_path, joints, places)], 5e-5)
    assert [i for i in range(9) if found.columns["x"][i] == ""] == [2, 3, 8]
    assert [found.columns["x"][i] for i in (0, 1, 4, 5, 6, 7)] == pytest.approx(tip(joints)[[0, 1, 4, 5, 6, 7], 0])
    assert any("3 of 9 rows" in note and "before, though joints moved, as in line 4" in note for note in found.notes)


def test_a_place_that_is_held_stays_none_at_a_pose_that_is_read_twice(tmp_path: Path) -> None:
    joints = POSES.copy()
    joints[3], joints[7] = joints[2], joints[6]
    places = tip(joints)
    places[2] = places[3] = places[5] = places[1]
    places[4] = np.nan
    found = intake([beside(tmp_path, joints, places)], 5e-5)
    assert [i for i in range(9) if found.columns["x"][i] == ""] == [2, 3, 4, 5]


def test_few_places_that_are_touched_again_and_again_are_readings(tmp_path: Path) -> None:
    places = np.repeat(tip(POSES)[:3], 3, axis=0)
    found = intake([beside(tmp_path, POSES, places)], 5e-5)
    assert np.allclose(np.array([found.columns[axis] for axis in "xyz"], dtype=float).T, places)


def test_a_clock_whose_unit_is_stated_nowhere_is_asked_for_by_its_column(tmp_path: Path) -> None:
    rows = [f"{100 * t:.0f},{','.join(f'{at:.6f}' for at in q)}" for t, q in zip(T, Q, strict=True)]
    (tmp_path / "log.csv").write_text("\n".join(["t,J1 [rad],J2 [rad],J3 [rad]", *rows]) + "\n")
    with pytest.raises(InputError, match="'t' counts seconds, or hundredths of one: --take 't=time_s' or 't=time_cs'"):
        intake([tmp_path / "log.csv"], None)
    stands = intake([tmp_path / "log.csv"], None, {"t": "time_cs"})
    assert np.allclose(np.column_stack([stands.columns[f"q_J{k}"] for k in (1, 2, 3)]), POSES, atol=1e-5)


def test_a_place_that_is_held_is_no_reading(tmp_path: Path) -> None:
    """An instrument repeats its last place where it reads none; one without noise does not hold it."""
    places = MM.copy()
    for i in range(1, len(MM)):
        if i % 100 < 40:
            places[i] = places[i - 1]
    rows = [f"{t:.3f},{x:.4f},{y:.4f},{z:.4f}" for t, (x, y, z) in zip(TT, places, strict=True)]
    found = intake([log(tmp_path), export(tmp_path, rows)], 5e-5)
    fits(found)
    assert any("is exactly where it was before" in note for note in found.notes)
    rows = [f"{t:.3f},{x:.2f},{y:.2f},{z:.2f}" for t, (x, y, z) in zip(TT, 1e3 * XYZ, strict=True)]
    found = intake([log(tmp_path), export(tmp_path, rows)], 5e-5)
    fits(found)
    assert not any("where it was before" in note for note in found.notes)
    rows[300:700] = [",".join([f"{t:.3f}", *rows[299].split(",")[1:]]) for t in TT[300:700]]
    kept = intake([log(tmp_path), export(tmp_path, rows)], 5e-5).columns["x"]
    assert 0 < list(kept).count("") < 4
    assert all(x in ("", pytest.approx(whole, abs=2e-5)) for x, whole in zip(kept, found.columns["x"], strict=True))
    rows[300:700] = [f"{t:.3f},0,0,0" for t in TT[300:700]]
    found = intake([log(tmp_path), export(tmp_path, rows)], 5e-5)
    assert 0 < list(found.columns["x"]).count("") < 4


def test_rows_of_several_targets_are_of_each(tmp_path: Path) -> None:
    rows = [f"{t:.3f},{name},{x + off:.4f},{y:.4f},{z:.4f}" for t, (x, y, z) in zip(TT, MM, strict=True)
            for name, off in (("m1", 0.0), ("m2", 30.0))]  # fmt: skip
    paths = [log(tmp_path), export(tmp_path, rows, "time,marker,x_mm,y_mm,z_mm")]
    with pytest.raises(InputError, match="several could be the target: m1, m2: --target 'm1'"):
        intake(paths, 5e-5)
    fits(intake(paths, 5e-5, targets=["m1"]))


def test_a_first_row_with_a_text_is_no_header(tmp_path: Path) -> None:
    rows = [f"{t:.3f},{x:.4f},{y:.4f},{z:.4f}" for t, (x, y, z) in zip(TT, MM, strict=True)]
    rows[0] = "0.000,OOV,OOV,OOV"
    with pytest.raises(InputError, match=r"export.csv:2: 'x_mm' is 'OOV', expected a number"):
        intake([log(tmp_path), export(tmp_path, rows)], 5e-5)


def test_places_that_are_round_are_not_lost() -> None:
    places = [[500.0, 500.0, 500.0], [0.0, 0.0, 12.0], [999.0, 1.0, 2.0], [-1000.0, 0.0, 0.0]]
    assert not lost(np.array(places)).any()
    assert lost(np.array([[0.0, 0.0, 0.0], *places])).tolist() == [True, False, False, False, False]


@pytest.mark.parametrize(
    ("head", "form"),
    [
        ("time", lambda t: f"{t:.1f}"),
        ("time", lambda t: f"{int(t)}"),
        ("time", lambda t: f"2026-11-20T10:00:{int(t):02d}"),
        ("time", lambda t: f"{1e3 * t:.0f}"),
        ("Zeit / ms", lambda t: f"{1e3 * t:.0f}"),
        ("time [h]", lambda t: f"{t / 3600:.9f}"),
        ("time", lambda t: f"10:00:{int(t):02d}:{int(1e3 * (t % 1)):03d}"),
        ("Timestamp", lambda t: f"{1e6 * t:.0f}"),
        ("t", lambda t: f"{1e9 * (t + 9e4):.0f}"),
        ("header.stamp.sec,header.stamp.nanosec", lambda t: f"{1_700_000_000 + int(t)},{1e9 * (t % 1):.0f}"),
        ("stamp_secs,stamp_nsecs", lambda t: f"{int(t)},{1e9 * (t % 1):.0f}"),
        ("time_us", lambda t: f"{1e6 * t:.0f}"),
    ],
)
def test_rows_of_a_recording_are_dwells_whatever_its_clock_counts(tmp_path: Path, head: str, form: Callable) -> None:
    lines = [",".join([head, *(f"q_J{i}_rad" for i in (1, 2, 3))])]
    lines += [",".join([form(t), *(f"{one:.9f}" for one in q)]) for t, q in zip(T, Q, strict=True) if t < 60.0]
    (tmp_path / "log.csv").write_text("\n".join(lines))
    rows = [f"{t:.3f},{x:.4f},{y:.4f},{z:.4f}" for t, (x, y, z) in zip(TT, MM, strict=True)]
    fits(intake([tmp_path / "log.csv", export(tmp_path, rows)], 5e-5))


@pytest.mark.parametrize(
    ("form", "text"),
    [
        (lambda t: f"{t if t < T[len(T) // 2] else t - T[len(T) // 2]:.3f}", r"log.csv:\d+: its clock goes back"),
        (lambda t: f"{1e7 * (t + 63e9):.0f}", "'time' is 6.3e.17, no time since 1970"),
        (lambda t: f"{46000 + t / 86400:.10f}", "'time' has steps of .*e-0[78] s"),
    ],
)
def test_a_clock_that_no_unit_explains_is_refused(tmp_path: Path, form: Callable, text: str) -> None:
    """Set again amid the recording, and .NET's and spreadsheets' times, in 100 ns and in days."""
    rows = log(tmp_path).read_text().splitlines()
    cells = [f"{form(t)},{row.partition(',')[2]}" for t, row in zip(T, rows[1:], strict=True)]
    (tmp_path / "log.csv").write_text("\n".join([f"time,{rows[0].partition(',')[2]}", *cells]) + "\n")
    with pytest.raises(InputError, match=text):
        intake([tmp_path / "log.csv"], None)


def test_poses_that_are_minutes_apart_stay_rows(tmp_path: Path) -> None:
    """Each pose was measured three times: steps of 20 are seconds here."""
    poses = np.repeat(POSES, 3, axis=0)
    lines = ["time,q_J1_rad,q_J2_rad,q_J3_rad,x_mm,y_mm,z_mm"]
    lines += [
        ",".join(map(str, (20 * i, *q, *xyz))) for i, (q, xyz) in enumerate(zip(poses, 1e3 * tip(poses), strict=True))
    ]
    (tmp_path / "both.csv").write_text("\n".join(lines))
    assert len(intake([tmp_path / "both.csv"], 5e-5).lines) == 27


def test_samples_without_a_clock_are_no_rows(tmp_path: Path) -> None:
    lines = ["q_J1_rad,q_J2_rad,q_J3_rad", *(",".join(f"{one:.6f}" for one in q) for q in Q[::5])]
    (tmp_path / "log.csv").write_text("\n".join(lines))
    with pytest.raises(InputError, match="samples of a recording, and no clock"):
        intake([tmp_path / "log.csv"], None)


@pytest.mark.parametrize(("row", "cell", "text"), [(3, 1, "375.4 turns"), (5, 4, "507.1 km")])
def test_a_value_that_no_arm_has_is_named_by_line_and_column(tmp_path: Path, row: int, cell: int, text: str) -> None:
    cells = [[f"P{i}", *np.degrees(q), *(1e3 * at)] for i, (q, at) in enumerate(zip(POSES, tip(POSES), strict=True))]
    cells[row][cell] = 135139.0 if cell == 1 else 507123456.0
    head = "Point,J1 [deg],J2 [deg],J3 [deg],X [mm],Y [mm],Z [mm]"
    path = export(tmp_path, [",".join(map(str, one)) for one in cells], head)
    name = head.split(",")[cell]
    with pytest.raises(InputError, match=rf"export.csv:{row + 2}: '{name[:1]}.*{text}: no arm is there"):
        intake([path], 5e-5)


def vicon(folder: Path) -> Path:
    turns = TURNED.as_quat()
    lines = ["Objects", "100", ",,Global Angle (Quaternion) tool:tool,,,,,,", "Frame,Sub Frame,RX,RY,RZ,RW,TX,TY,TZ",
             ",,,,,,mm,mm,mm"]  # fmt: skip
    lines += [",".join([str(i), "0", *(f"{one:.5f}" for one in (*turns[i], *MM[i]))]) if i % 9 else f"{i}" + ",0" * 8
              for i in range(1, len(MM))]  # fmt: skip
    (folder / "export.csv").write_text(
        "\n".join([*lines, "", "Devices", "1000", ",,Force", "Frame,Sub Frame,Fx", ",,N"])
    )
    return folder / "export.csv"


def qualisys(folder: Path, header: bool) -> Path:
    lines = [f"NO_OF_FRAMES\t{len(MM)}", "FREQUENCY\t100", "DATA_INCLUDED\t3D", "MARKER_NAMES\tball"]
    lines += ["Frame\tTime\tball X\tball Y\tball Z"] if header else []
    for i, at in enumerate(MM):
        place = "\t".join(f"{one:.3f}" for one in (at if i % 9 else 0.0 * at))
        lines.append(f"{i + 1}\t{TT[i]:.5f}\t{place}" if header else place)
    (folder / "export.tsv").write_text("\n".join(lines) + "\n")
    return folder / "export.tsv"


def trc(folder: Path) -> Path:
    lines = ["PathFileType\t4\t(X/Y/Z)\tx.trc", "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits",
             f"100\t100\t{len(MM)}\t1\tmm", "Frame#\tTime\tball\t\t", "\t\tX1\tY1\tZ1", ""]  # fmt: skip
    lines += [f"{i + 1}\t{t:.5f}\t" + ("\t".join(f"{one:.3f}" for one in at) if i % 9 else "\t\t")
              for i, (t, at) in enumerate(zip(TT, MM, strict=True))]  # fmt: skip
    (folder / "export.trc").write_text("\n".join(lines) + "\n")
    return folder / "export.trc"


def ndi(folder: Path) -> Path:
    lines = ["Tools,Port 0x01: ball,Frame,Time [sec],Face,State,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error,Markers,State,Tx,Ty,Tz"]
    for i, (at, turn) in enumerate(zip(MM, TURNED.as_quat(), strict=True)):
        cells = ["OK", *(f"{one:.4f}" for one in (turn[3], *turn[:3], *at)), "0.2"]
        cells = cells if i % 9 else ["Too Few Markers", *["-3.697314E28"] * 7, "0.0"]
        lines.append(",".join(["1", "Port 0x01: ball", str(i), f"{TT[i]:.3f}", "1", *cells, "1,OK,1.0,2.0,-1000.0"]))
    (folder / "export.csv").write_text("\n".join(lines))
    return folder / "export.csv"


def columns(folder: Path) -> Path:
    rows = [f"{t:.3f}," + ",".join(f"{one:.3f}" for one in (*at, *(at + 9.0))) for t, at in zip(TT, MM, strict=True)]
    return export(folder, rows, "Time [sec],m1 X [mm],m1 Y [mm],m1 Z [mm],m2 X [mm],m2 Y [mm],m2 Z [mm]")


@pytest.mark.parametrize(
    ("write", "targets"),
    [(vicon, ()), (lambda folder: qualisys(folder, True), ()), (lambda folder: qualisys(folder, False), ()), (ndi, ()),
     (trc, ()), (columns, ("m1",))],
)  # fmt: skip
def test_exports_of_motion_captures(tmp_path: Path, write: Callable, targets: tuple[str, ...]) -> None:
    fits(intake([log(tmp_path), write(tmp_path)], 5e-5, targets=targets))


@pytest.mark.parametrize(
    ("write", "spoil", "problem"),
    [
        (vicon, lambda row: row.replace(",0,", ",0,0.5,"), "has 10 cells where its header has 9 columns"),
        (vicon, lambda row: row[: row.rindex(",")], "ends after 8 cells, expected 9: was it cut"),
        (lambda folder: qualisys(folder, True), lambda row: row[: row.rindex("\t")], "ends after 4 cells, expected 5"),
        (lambda folder: qualisys(folder, False), lambda row: f"1.0\t{row}", "has 4 cells where its header has 3"),
        (trc, lambda row: row[: row.rindex("\t")], "ends after 4 cells, expected 5"),
        (trc, lambda row: f"{row}\t7.0", "has 6 cells where its header has 5 columns"),
    ],
)
def test_a_row_of_another_width_is_of_no_frame(
    tmp_path: Path, write: Callable, spoil: Callable[[str], str], problem: str
) -> None:
    path = write(tmp_path)
    rows = path.read_text().splitlines()
    rows[299] = spoil(rows[299])
    path.write_text("\n".join(rows))
    with pytest.raises(InputError, match=rf"{path.name}:300: {problem}"):
        intake([log(tmp_path), path], 5e-5)


def test_two_targets_of_one_name_are_not_one(tmp_path: Path) -> None:
    """The later was taken; what stands twice as it is is one."""
    path = columns(tmp_path)
    path.write_text(path.read_text().replace("m2", "m1"))
    with pytest.raises(InputError, match=r"export\.csv: 2 parts are called 'm1', and they differ"):
        intake([log(tmp_path), path], 5e-5)
    objects = vicon(tmp_path).read_text()
    path.write_text(f"{objects}\n\n{objects}")
    fits(intake([log(tmp_path), path], 5e-5))


def test_frames_without_a_clock_are_refused(tmp_path: Path) -> None:
    rows = [f"tool,{i},Port:1,0,OK,1,0,0,0,{x},{y},{z},0.2,3" for i, (x, y, z) in enumerate(MM)]
    head = "ToolInfo,Frame#,PortHandle,Face#,TransformStatus,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error,#Markers"
    with pytest.raises(InputError, match="counts frames and has no time: export it from NDI ToolBox with"):
        intake([log(tmp_path), export(tmp_path, rows, head)], 5e-5)


def recorded(
    folder: Path,
    joints: Iterable[tuple[str, float, Sequence[str], Sequence[float]]],
    cut: float = 1.0,
    stamps: Sequence[float] = (),
    frames: Sequence[str] = (),
    seen: Sequence[float] = (),
    kept: tuple[float, float] = (0.0, np.inf),
) -> Path:
    """An MCAP file of joint states (topic, time, names, positions) and of the target, in one frame after another.

    Joints have `stamps` in their headers where they are given, the target `seen` beside a frame; it is `kept` between
    two times.
    """
    from mcap.writer import CompressionType, Writer

    messages = [(t, topic, {"name": list(names), "position": list(q)}) for topic, t, names, q in joints]
    for (_, _, content), stamp in zip(messages, stamps, strict=False):
        content["header"] = {"stamp": {"sec": int(stamp), "nanosec": int(1e9 * (stamp % 1))}}
    for i, (t, at) in enumerate(zip(TT, SEEN, strict=True)):
        content: dict = {"position": dict(zip("xyz", at.tolist(), strict=True))}
        if frames:
            content = {"pose": content, "header": {"frame_id": frames[len(frames) * i // len(TT)]}}
        if seen:
            content["header"]["stamp"] = {"sec": int(seen[i]), "nanosec": int(1e9 * (seen[i] % 1))}
        messages += [(t, "/prism", content)] if kept[0] <= t < kept[1] else []
    path = folder / "one.mcap"
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=1 << 16, compression=CompressionType.ZSTD)
        writer.start()
        channels = dict[str, int]()
        for t, topic, content in sorted(messages, key=lambda one: one[0]):
            if topic not in channels:
                place = "PoseStamped" if frames else "Pose"
                kind = "sensor_msgs/" + (place if topic == "/prism" else "JointState")
                channels[topic] = writer.register_channel(
                    topic, "json", writer.register_schema(kind, "jsonschema", b"{}")
                )
            writer.add_message(channels[topic], int(1e9 * t), json.dumps(content).encode(), int(1e9 * t))
        writer.finish()
    path.write_bytes(path.read_bytes()[: int(cut * path.stat().st_size)])
    return path


ARM = [("/joint_states", t, list(NAMES), q) for t, q in zip(T.tolist(), Q.tolist(), strict=True)]
HALVES = [(topic, t, list(NAMES)[some], q[some]) for topic, t, _, q in ARM for some in (slice(0, 1), slice(1, 3))]


@pytest.mark.parametrize(
    "joints",
    [
        [*ARM, *(("/joint_states", t + 2e-3, ["finger"], [0.01]) for t in np.arange(0.0, T[-1], 4e-3).tolist())],
        [*ARM, *(("/joint_states", t, ["wheel"], []) for t in T.tolist())],
        HALVES,
        [(f"/{len(names)}", t, names, q) for _, t, names, q in HALVES],
        [(topic, t, names[::-1], q[::-1]) if t % 1 < 0.5 else (topic, t, names, q) for topic, t, names, q in ARM],
    ],
    ids=["a faster gripper", "velocities alone", "halves", "halves on two topics", "changing order"],
)
def test_joints_of_a_bag_are_joined_by_name(tmp_path: Path, joints: list) -> None:
    found = intake([recorded(tmp_path, joints)], 5e-5)
    q = np.array([found.columns[f"q_{name}"] for name in NAMES]).T
    assert np.allclose(q, POSES, atol=1e-6)


def test_stamps_that_go_back_are_of_no_clock(tmp_path: Path) -> None:
    """A simulated time that began anew, at a billion seconds from the other: receipt counts."""
    stamps = [t + 1.7e9 if t < T[-1] / 2 else t for t in T.tolist()]
    found = intake([recorded(tmp_path, ARM, stamps=stamps)], 5e-5)
    fits(found)
    assert any("their receipt counts" in note for note in found.notes)


def test_stamps_of_a_target_that_go_back_are_of_no_clock(tmp_path: Path) -> None:
    stamps = [t if t < TT[-1] / 2 else t - TT[-1] / 2 for t in TT.tolist()]
    found = intake([recorded(tmp_path, ARM, frames=("tracker",), seen=stamps)], 5e-5)
    fits(found)
    assert any("stamps of /prism in one.mcap go back: their receipt counts" in note for note in found.notes)


def test_a_recording_in_several_files_is_whole(tmp_path: Path) -> None:
    """Only the last file was used."""
    half = float(T[-1]) / 2.0
    folders = [tmp_path / name for name in "ba"]
    for folder, kept in zip(folders, ((0.0, half), (half, np.inf)), strict=True):
        folder.mkdir()
        recorded(folder, [row for row in ARM if kept[0] <= row[1] < kept[1]], kept=kept)
    fits(intake([folder / "one.mcap" for folder in reversed(folders)], 5e-5))
    recorded(folders[1], ARM)
    with pytest.raises(InputError, match=r"2 parts are called '/joint_states', .*: .* a campaign of each"):
        intake([folder / "one.mcap" for folder in folders], 5e-5)


def test_a_joint_that_comes_late_is_said(tmp_path: Path) -> None:
    late = [row if row[1] > 12.0 else (*row[:2], row[2][:2], row[3][:2]) for row in ARM]
    found = intake([recorded(tmp_path, late)], 5e-5)
    assert len(found.lines) < len(POSES)
    said = next(note for note in found.notes if "lacks a joint in its first" in note)
    assert re.search(r"one\.mcap /joint_states lacks a joint in its first 12\.?\d* s and its last 0 s: no row", said)


def test_joints_that_jump_by_a_turn_are_on_their_branch(tmp_path: Path) -> None:
    """One stands where its count begins anew, and noise takes it from one end to the other."""
    noisy = Q + np.random.default_rng(4).normal(0.0, 1e-4, Q.shape)
    turned = np.mod(noisy - POSES[4] + 2.0 * np.pi, 2.0 * np.pi) - np.pi  # pose 4 at the end of the range
    arm = [("/joint_states", t, list(NAMES), q) for t, q in zip(T.tolist(), turned.tolist(), strict=True)]
    for path in (recorded(tmp_path, arm), log(tmp_path, q=turned)):
        columns = intake([path], 5e-5).columns
        q = np.array([columns[f"q_{name}"] for name in NAMES]).T
        left = np.mod(q - (POSES - POSES[4] + np.pi) + np.pi, 2.0 * np.pi) - np.pi
        assert np.abs(left).max() < 1e-4
        assert np.abs(q).max() < np.pi + 1e-3


def test_noughts_before_a_driver_knows_its_joints_are_left_out(tmp_path: Path) -> None:
    q = np.where(T[:, None] < 0.4, 0.0, Q)
    found = intake([log(tmp_path, q=q), motive(tmp_path)], 5e-5)
    fits(found)
    assert any("have all joints at 0, and jump" in note for note in found.notes)
    mixed = np.where((np.arange(len(T)) % 10 == 3)[:, None], 0.7, Q)
    with pytest.raises(TableError, match=r"joints.csv:\d+: .* apart, to and fro: two programs or instruments wrote"):
        intake([log(tmp_path, q=mixed), motive(tmp_path)], 5e-5)


def test_a_target_in_two_frames_is_two(tmp_path: Path) -> None:
    path = recorded(tmp_path, ARM, frames=("tracker", "room"))
    with pytest.raises(InputError, match="several could be the target: /prism in tracker, /prism in room"):
        intake([path], 5e-5)


def test_places_that_no_arm_reaches_are_in_another_unit(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"'x \[m\]' in m moves over .* m, and no arm does: is it in mm"):
        intake([log(tmp_path), export(tmp_path, [f"{t},{x},{y},{z}" for t, (x, y, z) in zip(TT, MM, strict=True)],
                                      "time,x [m],y [m],z [m]")], 5e-5)  # fmt: skip


@pytest.mark.parametrize(
    ("apart", "every", "refused"), [(2.0, 2, True), (60.0, 2, True), (2.0, 5, True), (0.0, 2, False), (0.05, 2, False)]
)
@pytest.mark.parametrize("digits", [1, 4])
def test_two_sources_of_a_place_are_an_error(
    tmp_path: Path, apart: float, every: int, refused: bool, digits: int
) -> None:
    """Their mean is of neither; what flickers between neighbouring numbers is of one."""
    places = MM + apart * (np.arange(len(MM)) % every == 0)[:, None] * [0.6, 0.0, 0.8]
    rows = [f"{t:.3f},{x:.{digits}f},{y:.{digits}f},{z:.{digits}f}" for t, (x, y, z) in zip(TT, places, strict=True)]
    paths = [log(tmp_path), export(tmp_path, rows)]
    if not refused:
        fits(intake(paths, 5e-5), 1.2e-4)
        return
    with pytest.raises(InputError, match=r"is at .* m at .* s here and .* at .* s, .* mm apart, to and fro"):
        intake(paths, 5e-5)


@pytest.mark.parametrize("places", [[[0, 0, 0], [2, 0, 0], [0, 3, 0]], [[0, 0, 0], [0, 0, 5], [0, 0, -5], [4, 0, 0]]])
def test_three_sources_of_a_place_and_more_are_an_error(tmp_path: Path, places: list[list[float]]) -> None:
    shifted = MM + np.array(places)[np.random.default_rng(1).integers(len(places), size=len(MM))]
    rows = [f"{t:.3f},{x:.4f},{y:.4f},{z:.4f}" for t, (x, y, z) in zip(TT, shifted, strict=True)]
    with pytest.raises(InputError, match=r"is at .* m at .* s here and .* at .* s, .* mm apart, to and fro"):
        intake([log(tmp_path), export(tmp_path, rows)], 5e-5)


def equally_long(seed: int, poses: int, unlike: int = 99) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times, joints and places of an arm of which each motion and each stand takes as long as all others."""
    rng, step, sizes = np.random.default_rng(seed), 0.02, [1.8, 0.9, 0.9, 1.8, 1.2, 1.8]
    q = (rng.uniform(-1.0, 1.0, (poses, 6)) * sizes)[np.arange(poses) % unlike]
    rows = [np.tile(q[0], (60, 1))]
    for before, after in pairwise(q):
        part = np.linspace(0.0, 1.0, 50)[:, None]
        rows += [before + part**2 * (3.0 - 2.0 * part) * (after - before), np.tile(after, (60, 1))]
    joints = np.concatenate(rows)
    a, b, c, d, e, f = joints.T
    reach = 0.6 * np.cos(b) + 0.5 * np.cos(b + c) + 0.15 * np.cos(b + c + e)
    height = 0.6 * np.sin(b) + 0.5 * np.sin(b + c) + 0.15 * np.sin(b + c + e)
    side = 0.1 * np.sin(e) * np.sin(d) + 0.05 * np.sin(f)
    places = np.column_stack([reach * np.cos(a) - side * np.sin(a), reach * np.sin(a) + side * np.cos(a), height])
    return step * np.arange(len(joints)), joints, places


@pytest.mark.parametrize(("seed", "poses"), [(3, 14), (36, 10), (1, 9), (9, 9)])
def test_clocks_that_agree_as_they_are_are_evidence_beside_motions_that_take_equally_long(
    seed: int, poses: int
) -> None:
    """Motions are so few that six joints explain many of them at a wrong lag, too."""
    time, joints, places = equally_long(seed, poses)
    assert offset(time, joints, time + 0.03, places)[0] == pytest.approx(0.03, abs=0.03)


def test_a_clock_is_as_far_off_as_its_uncertainty_says() -> None:
    rng, misses = np.random.default_rng(0), []
    for seed in range(24):
        time, joints, places = equally_long(seed, 20)
        seen = np.arange(0.0, time[-1], 0.033) + rng.uniform(0.0, 0.033)
        read = np.column_stack([np.interp(seen, time, x) for x in places.T]) + rng.normal(0.0, 1e-4, (len(seen), 3))
        shift, std = offset(time, joints, seen + 0.05, read)
        assert 1e-4 < std < 0.05
        misses.append((shift - 0.05) / std)
    assert 0.6 < np.sqrt(np.mean(np.square(misses))) < 1.4


@pytest.mark.parametrize(("seed", "poses", "begins"), [(1, 9, 0), (0, 9, 110), (4, 9, 110), (0, 12, 110), (2, 24, 220)])
def test_clocks_that_are_whole_cycles_apart_are_told_by_how_far_places_are_from_one_another(
    seed: int, poses: int, begins: int
) -> None:
    """A motion and a stand take 2.2 s, and the tracker begins where it begins."""
    time, joints, places = equally_long(seed, poses)
    assert offset(time, joints, time[begins:] - 2.2, places[begins:])[0] == pytest.approx(-2.2, abs=0.03)


@pytest.mark.parametrize(("seed", "poses", "cut"), [(15, 6, (100, 220)), (24, 6, (170, 170)), (20, 7, (150, 330))])
def test_a_part_of_equally_long_motions_is_at_no_difference_for_certain(
    seed: int, poses: int, cut: tuple[int, int]
) -> None:
    """The best correlation is a whole cycle off, and the right one a fifth below it."""
    time, joints, places = equally_long(seed, poses)
    part = slice(cut[0], len(time) - cut[1])
    with pytest.raises(InputError, match="move alike at several differences of their clocks"):
        offset(time, joints, time[part], places[part])


def test_a_remark_that_a_target_was_lost_is_asked_about(tmp_path: Path) -> None:
    head = "Name,X [mm],Y [mm],Z [mm],Comment"
    rows = [f"P{i},{100.123 * i},{50.5 * i},{7.25 * i},{'beam broken' if i == 3 else ''}" for i in range(1, 9)]
    paths = [tmp_path / "rows.csv", tmp_path / "export.csv"]
    paths[0].write_text("Pose,J1 [deg],J2 [deg]\n" + "".join(f"P{i},{i},{i * i}\n" for i in range(1, 9)))
    paths[1].write_text("\n".join([head, *rows]))
    with pytest.raises(InputError, match=r"'Comment' is 'beam broken' here .* --take 'Comment=valid'"):
        intake(paths, 5e-5)
    read = intake(paths, 5e-5, taken={"Comment": "valid"}).columns["x"]
    assert [i for i, x in enumerate(read) if x in ("", None) or np.isnan(x)] == [2]
    paths[1].write_text("\n".join([head, *(row.replace("beam broken", "repeated") for row in rows)]))
    assert len(intake(paths, 5e-5).lines) == 8


@pytest.mark.parametrize(("cell", "gone"), [(-999.25, True), (999.125, False)])
def test_three_equal_numbers_of_fewer_decimals_are_no_place(cell: float, gone: bool) -> None:
    places = np.random.default_rng(3).uniform(-900.0, 900.0, (20, 3)).round(4)
    places[5] = cell
    assert lost(places).tolist() == [i == 5 and gone for i in range(20)]


@pytest.mark.parametrize("step", [0.008, 0.1])
def test_two_publishers_of_a_joint_are_an_error(tmp_path: Path, step: float) -> None:
    zeros = [("/joint_states", t + 3e-3, list(NAMES), [0.0] * 3) for t in np.arange(0.0, T[-1], step).tolist()]
    with pytest.raises(InputError, match=r"/joint_states has joint .* at .* ms later, at .*, and back, from .* s on"):
        intake([recorded(tmp_path, [*ARM, *zeros])], 5e-5)


def test_of_two_topics_with_the_same_joints_one_is_chosen(tmp_path: Path) -> None:
    path = recorded(tmp_path, [*ARM, *(("/commanded", t, names, q) for _, t, names, q in ARM)])
    with pytest.raises(InputError, match=r"have the same joints .*: --joints /"):
        intake([path], 5e-5)
    with pytest.raises(InputError, match="did you mean '/joint_states'"):
        intake([path], 5e-5, joints=["/joint_state"])
    fits(intake([path], 5e-5, joints=["/joint_states"]))


def test_a_recording_that_was_not_closed_is_read_to_where_it_ends(tmp_path: Path) -> None:
    found = intake([recorded(tmp_path, ARM, 0.8)], 5e-5)
    assert 4 < len(found.lines) < 9
    assert any("was not closed" in note and "mcap recover" in note for note in found.notes)
    with pytest.raises(InputError, match="none of its messages can be read; `mcap recover` may mend it"):
        intake([recorded(tmp_path, ARM, 1e-3)], 5e-5)


@pytest.mark.parametrize("plugin", ["MCAP", "SQLITE3"])
def test_a_bag_without_its_metadata_or_its_end(tmp_path: Path, plugin: str) -> None:
    folder = bag(tmp_path, plugin)
    (folder / "metadata.yaml").unlink()
    fits(intake([folder], 5e-5))
    path = next(folder.iterdir())
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 7 // 10])
    found = intake([folder], 5e-5)
    assert len(found.lines) == 9  # the joints were written first
    assert 0 < list(found.columns["x"]).count("") < 9
    assert any("was not closed" in note for note in found.notes)


def test_a_bag_whose_part_is_absent_is_refused(tmp_path: Path) -> None:
    folder = bag(tmp_path, "MCAP")
    shutil.move(next(folder.glob("*.mcap")), folder / "other.mcap")
    with pytest.raises((InputError, TableError), match="which is not there: copy the whole folder"):
        intake([folder], 5e-5)
    with pytest.raises(InputError, match=rf"is a folder with 1 bags, {folder}: give one of them"):
        intake([tmp_path], 5e-5)
    (tmp_path / "none").mkdir()
    with pytest.raises(InputError, match="is a folder without a recording"):
        intake([tmp_path / "none"], 5e-5)


def test_captures_that_were_cut_are_refused(tmp_path: Path) -> None:
    path = c3d(tmp_path)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 5])
    with pytest.raises(InputError, match=rf"ends after \d+ of its {len(SEEN)} frames: it was cut"):
        intake([log(tmp_path), path], 5e-5)
    path = motive(tmp_path)
    text = path.read_text().replace("Rotation Type", f"Total Exported Frames,{len(TT)},Rotation Type")
    path.write_text("\n".join(text.splitlines()[:900]))
    with pytest.raises(InputError, match="frames that its header states: copy or export it again"):
        intake([log(tmp_path), path], 5e-5)


@pytest.mark.parametrize(
    ("head", "form", "empty"),
    [
        ("time", lambda t: f"{1e3 * t:.0f}", ""),
        ("time", lambda t: f"{1e6 * t:.0f}", "nan(ind)"),
        ("stamp", lambda t: f"2026-11-20T10:{int(t) // 60:02d}:{t % 60:06.3f}+02:00", ""),
    ],
)
def test_topics_have_rows_of_their_own_whatever_the_clock_counts(
    tmp_path: Path, head: str, form: Callable, empty: str
) -> None:
    lines = [f"{head},q_J1_rad,q_J2_rad,q_J3_rad"]
    for i, (t, q) in enumerate(zip(T, Q, strict=True)):
        cells = [f"{angle:.9f}" if k == i % 3 else empty for k, angle in enumerate(q)]
        lines.append(",".join([form(t), *cells]))
    (tmp_path / "log.csv").write_text("\n".join(lines))
    rows = [f"{t:.3f},{x:.4f},{y:.4f},{z:.4f}" for t, (x, y, z) in zip(TT, MM, strict=True)]
    fits(intake([tmp_path / "log.csv", export(tmp_path, rows)], 5e-5))


@pytest.mark.parametrize("empty", ["-3.697314E28", "-9999", "0"])
def test_an_orientation_is_known_where_its_target_was_lost_at_times(tmp_path: Path, empty: str) -> None:
    rows = []
    for i, (t, at) in enumerate(zip(TT, MM, strict=True)):
        sign = (-1) ** (i // 50)
        cells = [empty] * 7 if i % 7 == 0 else [*(f"{mm:.4f}" for mm in at), *(f"{sign * x}" for x in (0.6, 0, 0, 0.8))]
        rows.append(",".join([f"{t:.3f}", *cells]))
    exported = export(tmp_path, rows, "time,x_mm,y_mm,z_mm,q_w,q_x,q_y,q_z")
    found = intake([log(tmp_path), exported], 5e-5, sigma_r=5e-4)
    fits(found)
    assert np.allclose(np.array(found.columns["rz"], dtype=float), 2.0 * np.arccos(0.6))


def test_a_row_without_a_time_takes_the_times_of_none(tmp_path: Path) -> None:
    lines = ["time,q_J1_rad,x_mm,y_mm,z_mm", "10,0.1,1,2,3", ",0.2,4,5,6", "30,0.3,7,8,9"]
    (tmp_path / "both.csv").write_text("\n".join(lines))
    found = intake([tmp_path / "both.csv"], 5e-5)
    assert "time" not in found.columns
    assert any("line 3 of both.csv" in note for note in found.notes)


@pytest.mark.parametrize("value", [-1.0, -32768.0, 2147483647.0])
def test_one_place_of_three_equal_whole_numbers_is_none(value: float) -> None:
    places = MM[:20].copy()
    places[3] = value
    assert np.flatnonzero(lost(places)).tolist() == [3]
    assert not lost(np.round(places[[0, 3, 5]])).any()  # a whole number among whole ones, once


@pytest.mark.parametrize("shift", [50.0, 800.0])
def test_a_target_that_jumps_while_the_arm_stands_is_in_no_mean(tmp_path: Path, shift: float) -> None:
    still = np.flatnonzero(np.linalg.norm(MM - MM[0], axis=1) < 0.2)
    places = MM.copy()
    places[still[5 : len(still) // 3]] += shift
    rows = [f"{t:.3f},{x:.4f},{y:.4f},{z:.4f}" for t, (x, y, z) in zip(TT, places, strict=True)]
    found = intake([log(tmp_path), export(tmp_path, rows)], 5e-5)
    fits(found)
    assert any("moves or jumps while the arm stands" in note for note in found.notes)


@pytest.mark.parametrize("form", [lambda t: f"{int(t // 60):02d}:{t % 60:06.3f}",
                                  lambda t: f"0:{int(t // 60)}:{t % 60:.3f}"])  # fmt: skip
def test_clocks_as_a_stopwatch_has_them(tmp_path: Path, form: Callable[[float], str]) -> None:
    rows = [f"{form(t)},{x:.4f},{y:.4f},{z:.4f}" for t, (x, y, z) in zip(TT, MM, strict=True)]
    fits(intake([log(tmp_path), export(tmp_path, rows)], 5e-5))


def test_frames_of_a_second_are_not_hundredths(tmp_path: Path) -> None:
    """A timecode counts frames after its third colon, and says nowhere how many are a second."""
    rows = [f"10:00:{int(t % 60):02d}:{int(t * 25) % 25:02d},{x:.4f},{y:.4f},{z:.4f}"
            for t, (x, y, z) in zip(TT, MM, strict=True)]  # fmt: skip
    with pytest.raises(InputError, match=r"'time' has '10:00:.*' *, which is no time"):
        intake([log(tmp_path), export(tmp_path, rows)], 5e-5)


@pytest.mark.parametrize(("seed", "poses", "unlike", "begins", "ends"), [(4, 10, 5, 0, 140), (4, 10, 5, 110, 70)])
def test_poses_again_and_again_are_no_evidence_of_clocks(
    seed: int, poses: int, unlike: int, begins: int, ends: int
) -> None:
    """Five poses are as many numbers however often they are visited: six joints explain them at a wrong lag, too."""
    time, joints, places = equally_long(seed, poses, unlike)
    seen = slice(begins, len(places) - ends)
    try:
        assert offset(time, joints, time[seen] - 2.2, places[seen])[0] == pytest.approx(-2.2, abs=0.03)
    except InputError as error:
        assert "move alike at several differences" in str(error)


def test_a_capture_with_more_frames_than_it_states_is_refused(tmp_path: Path) -> None:
    path = c3d(tmp_path)
    data = bytearray(path.read_bytes())
    first, last = struct.unpack("<2H", data[6:10])
    frames = (last - first + 1) // 2
    data[8:10] = struct.pack("<H", first + frames - 1)
    at = data.index(b"FRAMES") + len("FRAMES") + 2  # then a type of words of 2 bytes, and no dimension or one
    at += 3 if data[at + 1] else 2
    data[at : at + 2] = struct.pack("<H", frames)
    path.write_bytes(data)
    with pytest.raises(InputError, match=rf"take.c3d: has the numbers of \d+ frames or more, and states {frames}"):
        intake([log(tmp_path), path], 5e-5)
