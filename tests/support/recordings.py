"""Recordings of one arm that drives from pose to pose: bags, motion captures, traces, as each program writes them."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

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


def mcap_json(folder: Path, kind: str = "Pose") -> Path:
    from mcap.writer import Writer

    path = folder / "recording.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schemas = [writer.register_schema(f"sensor_msgs/{one}", "jsonschema", b"{}") for one in ("JointState", kind)]
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
