"""`intake` of recordings: bags, motion captures, controllers' traces; the arm counts where it stands."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from armflex.errors import ArmflexError, InputError, UnsupportedError
from armflex.intake import intake
from armflex.intake.streams import dwells, offset, paired

NAMES = ("base_joint", "elbow_joint", "wrist_joint")
RNG = np.random.default_rng(5)
POSES = RNG.uniform(-1.5, 1.5, (9, 3))
PAUSES = RNG.uniform(1.0, 2.5, 9)
SHIFT = 3.7
"""The tracker's clock is ahead by this [s]."""


def tip(q: np.ndarray) -> np.ndarray:
    """A place [m] that depends on all joints."""
    return np.column_stack([np.cos(q[:, 0]) + q[:, 2] / 5, np.sin(q[:, 0]) * np.cos(q[:, 1]), np.sin(q[:, 1]) + 0.5])


def motion(rate: float) -> tuple[np.ndarray, np.ndarray]:
    """Times [s] and joint positions of an arm that drives from pose to pose and stands at each."""
    keys, at, now = [POSES[0]], [0.0], 0.0
    for pose, pause in zip(POSES, PAUSES, strict=True):
        keys += [pose, pose]
        at += [now + 1.2, now + 1.2 + pause]
        now = at[-1]
    time = np.arange(0.0, now, 1.0 / rate)
    smooth = np.column_stack([np.interp(time, at, column) for column in np.array(keys).T])
    return time, smooth


T, Q = motion(125.0)
TT, QQ = motion(100.0)
XYZ = tip(QQ)
rng = np.random.default_rng(6)
TURNED = Rotation.from_rotvec(np.column_stack([QQ[:, 1], 2.0 * QQ[:, 0], QQ[:, 2]]))
"""Orientations of the target, whose quaternions change sign on the way."""
SEEN = XYZ + rng.normal(0.0, 5e-5, XYZ.shape)


def bag(folder: Path, plugin: str) -> Path:
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    time_of, header_of = types["builtin_interfaces/msg/Time"], types["std_msgs/msg/Header"]
    state, tf = types["sensor_msgs/msg/JointState"], types["tf2_msgs/msg/TFMessage"]
    stamped, transform = types["geometry_msgs/msg/TransformStamped"], types["geometry_msgs/msg/Transform"]
    vector, turn = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]

    def header(time: float, frame: str):
        return header_of(time_of(1_700_000_000 + int(time), int(1e9 * (time % 1))), frame)

    path = folder / f"bag_{plugin.lower()}"
    with Writer(path, version=9, storage_plugin=StoragePlugin[plugin]) as writer:
        joints = writer.add_connection("/joint_states", state.__msgtype__, typestore=store)
        places = writer.add_connection("/tf", tf.__msgtype__, typestore=store)
        for time, q in zip(T, Q, strict=True):
            message = state(header(time, ""), list(NAMES), q, np.zeros(0), np.zeros(0))
            writer.write(joints, int(1e9 * (1.7e9 + time)), store.serialize_cdr(message, state.__msgtype__))
        for time, place in zip(TT, SEEN, strict=True):
            moved = transform(vector(*place), turn(0.0, 0.0, 0.0, 1.0))
            fixed = transform(vector(1.0, 0.0, 0.0), turn(0.0, 0.0, 0.0, 1.0))
            head = header(time + SHIFT, "world")
            message = tf([stamped(head, "prism", moved), stamped(head, "post", fixed)])
            writer.write(places, int(1e9 * (1.7e9 + time)), store.serialize_cdr(message, tf.__msgtype__))
    return path


def mcap_json(folder: Path) -> Path:
    from mcap.writer import Writer

    path = folder / "recording.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schemas = [writer.register_schema(f"sensor_msgs/{one}", "jsonschema", b"{}") for one in ("JointState", "Pose")]
        topics = ("/joints", "/prism")
        channels = [
            writer.register_channel(topic, "json", schema) for topic, schema in zip(topics, schemas, strict=True)
        ]
        for time, q in zip(T, Q, strict=True):
            data = json.dumps({"name": list(NAMES), "position": q.tolist()}).encode()
            writer.add_message(channels[0], int(1e9 * time), data, int(1e9 * time))
        for time, place, turn in zip(TT + SHIFT, SEEN, TURNED.as_quat(), strict=True):
            message = {"position": dict(zip("xyz", place.tolist(), strict=True))}
            message["orientation"] = dict(zip("xyzw", turn.tolist(), strict=True))
            data = json.dumps(message).encode()
            writer.add_message(channels[1], int(1e9 * time), data, int(1e9 * time))
        writer.finish()
    return path


def log(folder: Path, time: np.ndarray = T, q: np.ndarray = Q) -> Path:
    """A log of joint states as PlotJuggler writes it."""
    header = "__time," + ",".join(f"/joint_states/{name}/position" for name in NAMES)
    path = folder / "joints.csv"
    np.savetxt(path, np.column_stack([time, q]), delimiter=",", header=header, comments="", fmt="%.9f")
    return path


def motive(folder: Path) -> Path:
    """As Motive 1.23 exports a take: a rigid body and one of its markers, a frame in which neither was seen."""
    path = folder / "Take 2026-03-12.csv"
    head = "Format Version,1.23,Take Name,Take,Capture Frame Rate,100.000000,Export Frame Rate,100.000000,"
    lines = [
        f"{head}Rotation Type,Quaternion,Length Units,Millimeters,Coordinate Space,Global",
        "",
        ",Type" + ",Rigid Body" * 8 + ",Rigid Body Marker" * 4,
        ",Name" + ",flange" * 8 + ",flange:Marker1" * 4,
        ",ID" + ',"1"' * 8 + ',"2"' * 4,
        ",,Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Mean Marker Error"
        + ",Position" * 3
        + ",Quality",
        "Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,,X,Y,Z,",
    ]
    for i, (time, place) in enumerate(zip(TT + SHIFT, 1e3 * SEEN, strict=True)):
        x, y, z = place
        turn = ",".join(f"{one:.9f}" for one in TURNED[i].as_quat())
        seen = f"{turn},{x:.4f},{y:.4f},{z:.4f},0.1,{x + 9:.4f},{y:.4f},{z:.4f},1" if i != 40 else "," * 11
        lines.append(f"{i},{time:.6f},{seen}")
    path.write_text("\n".join(lines) + "\n")
    return path


def c3d(folder: Path) -> Path:
    import ezc3d

    one = ezc3d.c3d()
    one["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    one["parameters"]["POINT"]["RATE"]["value"] = [100.0]
    one["parameters"]["POINT"]["LABELS"]["value"] = ["flange"]
    points = np.ones((4, 1, len(SEEN)))
    points[:3, 0] = 1e3 * SEEN.T
    one["data"]["points"] = points
    one.write(str(folder / "take.c3d"))
    return folder / "take.c3d"


def trace(folder: Path) -> Path:
    """A KUKA trace: the header of DIAdem, and channels side by side in a file of doubles."""
    (folder / "job_KRCIpo.r64").write_bytes(np.degrees(Q).astype("<f8").tobytes())
    lines = ["DIAEXTENDED {@:ENGLISH", "#BEGINGLOBALHEADER", "2,KUKA", "#ENDGLOBALHEADER", ""]
    channels = [("Zeit", "s", "IMPLICIT", "0", "0.008")]
    channels += [(f"AxisPos_Act{i}", "°", "EXPLICIT", "0", "1") for i in (1, 2, 3)]
    for number, (name, unit, kind, start, step) in enumerate(channels):
        lines += ["#BEGINCHANNELHEADER", f"200,{name}", "201,KUKA", f"202,{unit}", f"210,{kind}"]
        lines += ["211,job_KRCIpo.r64", "213,BLOCK", "214,REAL64"] if number else ["213,BLOCK", "214,REAL64"]
        lines += [f"220,{len(T)}", *([f"221,{number}"] if number else []), f"240,{start}", f"241,{step}"]
        lines += ["#ENDCHANNELHEADER", ""]
    (folder / "job_KRCIpo.dat").write_text("\n".join(lines), encoding="cp1252")
    return folder / "job_KRCIpo.dat"


RECORDED: dict[str, Callable[[Path], list[Path]]] = {
    "rosbag2": lambda folder: [bag(folder, "SQLITE3")],
    "rosbag2 in MCAP": lambda folder: [bag(folder, "MCAP")],
    "one MCAP file of CDR": lambda folder: [next(bag(folder, "MCAP").glob("*.mcap"))],
    "MCAP of JSON": lambda folder: [mcap_json(folder)],
    "Motive": lambda folder: [log(folder), motive(folder)],
    "C3D": lambda folder: [log(folder), c3d(folder)],
    "KUKA and Motive": lambda folder: [trace(folder), motive(folder)],
}


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
    monkeypatch.setattr("armflex.intake.recordings.find_spec", lambda name: None)
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


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:encoding")
@settings(max_examples=40, deadline=None)
@given(st.data())
def test_spoilt_recordings_are_refused_or_read_never_a_traceback(tmp_path_factory, data) -> None:
    folder = tmp_path_factory.mktemp("spoilt")
    kind = data.draw(st.sampled_from(["motive", "c3d", "trace", "mcap"]))
    path = {"motive": motive, "c3d": c3d, "trace": trace, "mcap": mcap_json}[kind](folder)
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, min(len(content) - 1, 3000)))
        content[at : at + data.draw(st.integers(0, 3))] = data.draw(st.binary(max_size=3))
    path.write_bytes(content[: data.draw(st.sampled_from([len(content), len(content) // 2]))])
    try:
        found = intake([*([] if kind in ("mcap", "trace") else [log(folder)]), path], 5e-5)
    except ArmflexError:
        return
    assert len({len(column) for column in found.columns.values()}) == 1
