"""What programs recorded while an arm moved: bags, motion captures, traces of controllers.

A recording comes as one part for each of its topics, bodies or markers, with times [s] and numbers; which of them
counts is chosen later. rosbags, mcap and ezc3d are used only here.
"""

from __future__ import annotations

import csv
import io
import json
import re
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from contextlib import ExitStack
from importlib.util import find_spec
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from armflex.conventions import Array
from armflex.errors import ArmflexError, Place, TableError, UnsupportedError, listing, shown
from armflex.intake.picture_files import is_pictures, of_corners, read_folder
from armflex.intake.sources import Cells, Source, read_table_source
from armflex.measured.table import text_lines
from armflex.storage.read_file import check_file, read_file

BAGS = (".bag", ".db3", ".mcap")
MOST_BYTES = 20_000_000_000
"""Of a recording: that of an hour with pictures has less."""

JOINTS = "JointState"
POINTS = {
    "PoseStamped": "pose",
    "PoseWithCovarianceStamped": "pose.pose",
    "Odometry": "pose.pose",
    "PointStamped": "point",
    "TransformStamped": "transform",
    "Pose": "",
    "Point": "",
}
"""Types of messages with a position [m], and where in them it is."""


def read_sources(path: str | Path) -> list[Source]:
    """Read a file as it is: a table, or every part of a recording.

    Raises:
        UnsupportedError: The package that reads it is not installed.
        TableError: The file cannot be read, or has no joints and no positions.
    """
    path = Path(path)
    if is_pictures(path):
        return [read_folder(path)]
    if path.suffix.lower() in (*BAGS, ".c3d") and not path.is_dir():
        try:
            check_file(path, MOST_BYTES)
        except OSError as error:
            raise TableError(Place(path), f"cannot be read: {error.strerror}") from None
    if path.is_dir() or path.suffix.lower() in BAGS:
        return _bag(path)
    if path.suffix.lower() == ".c3d":
        return _c3d(path)
    try:
        if path.suffix.lower() in (".csv", ".dat") and (first := next(iter(text_lines(path)), "")):
            if first.startswith("Format Version"):
                return _motive(path)
            if first.startswith("#BEGIN") or "DIAEXTENDED" in first.upper() or "DIADEM" in first.upper():
                return [_trace(path)]
        return [of_corners(read_table_source(path))]
    except csv.Error as error:
        raise TableError(Place(path), f"is not CSV: {error}") from None


def _recorded(path: Path, part: str, columns: dict[str, Array]) -> Source:
    size = len(next(iter(columns.values())))
    return Source(path, tuple(columns), tuple(range(1, size + 1)), tuple(columns.values()), part=part)


def _bag(path: Path) -> list[Source]:
    """Return joint states, and the positions of every topic and frame, of a ROS 1 bag, a rosbag2 or an MCAP file."""
    joints: dict[str, dict[str, list[tuple[float, float]]]] = defaultdict(lambda: defaultdict(list))
    places: dict[str, list[tuple[float, ...]]] = defaultdict(list)
    types = set[str]()
    try:
        for topic, kind, received, message in _messages(path):
            types.add(kind)
            stamp = _stamp(message, received)
            if kind == JOINTS:
                for name, at in zip(message.name, message.position, strict=True):
                    joints[topic][str(name)].append((stamp, float(at)))
            elif kind == "TFMessage":
                for one in message.transforms:
                    named = f"{one.header.frame_id}->{one.child_frame_id}"
                    places[f"{topic} {named}"].append((_stamp(one, received), *_placed(one.transform)))
            elif kind in POINTS:
                for key in filter(None, POINTS[kind].split(".")):
                    message = getattr(message, key)
                places[topic].append((stamp, *_placed(message)))
    except ArmflexError:
        raise
    except Exception as error:  # of a damaged file, from whatever depth
        problem = " ".join(str(error).split()) or type(error).__name__
        raise TableError(Place(path), f"cannot be read as a bag: {problem}") from None
    found = []
    for topic, own in joints.items():
        longest = max(own.values(), key=len)
        same = {name: np.array(values) for name, values in own.items() if len(values) == len(longest)}
        columns = {"time": np.array(longest)[:, 0]} | {f"position.{name}": one[:, 1] for name, one in same.items()}
        found.append(_recorded(path, topic, columns))
    for topic, rows in places.items():
        values = np.array([row[: min(map(len, rows))] for row in rows])
        if np.ptp(values[:, 1:4], axis=0).max() > 0.0:  # a frame that is fixed to another is no target
            head = ("time", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")[: values.shape[1]]
            found.append(_recorded(path, topic, dict(zip(head, _one_sided(values.T), strict=True))))
    if not found:
        raise TableError(Place(path), f"has no {JOINTS} and no position among its types: {listing(sorted(types))}")
    return found


def _placed(message: Any) -> tuple[float, ...]:
    """Return x, y, z [m] of a message and, where it has them, the quaternion x, y, z, w."""
    place = getattr(message, "position", None) or getattr(message, "translation", None) or message
    turn = getattr(message, "orientation", None) or getattr(message, "rotation", None)
    return place.x, place.y, place.z, *(() if turn is None else (turn.x, turn.y, turn.z, turn.w))


def _one_sided(columns: Array) -> Array:
    """Return columns whose last four are a quaternion with each beside the one before, so that means of them exist."""
    four = columns[4:8]
    side = np.cumprod(np.where((four[:, 1:] * four[:, :-1]).sum(axis=0) < 0.0, -1.0, 1.0))
    columns[4:8, 1:] *= side
    return columns


def _messages(path: Path) -> Iterator[tuple[str, str, float, Any]]:
    """Yield topic, type, time of receipt [s] and message of all that may have joints or positions."""
    wanted = {JOINTS, "TFMessage", *POINTS}
    text = f"{path} is a recording of ROS: pip install 'armflex[bags]'"
    if path.suffix.lower() == ".mcap":
        try:
            from mcap.reader import make_reader
            from rosbags.typesys import Stores, get_types_from_msg, get_typestore
        except ImportError:
            raise UnsupportedError(text) from None
        store = get_typestore(Stores.EMPTY)
        with path.open("rb") as file:
            for schema, channel, message in make_reader(file).iter_messages():
                kind = "" if schema is None else re.split(r"[/.]", schema.name)[-1]
                if kind not in wanted or schema is None:
                    continue
                if channel.message_encoding == "json":
                    content = json.loads(message.data, object_hook=lambda own: _Named(**own))
                elif channel.message_encoding == "cdr" and schema.encoding == "ros2msg":
                    if schema.name not in store.fielddefs:
                        store.register(get_types_from_msg(schema.data.decode(), schema.name))
                    content = store.deserialize_cdr(message.data, schema.name)
                else:
                    how = f"{channel.topic} is in {channel.message_encoding} ({schema.encoding or 'no'} schema)"
                    raise TableError(Place(path), f"{how}: expected cdr with ros2msg, or json")
                yield channel.topic, kind, 1e-9 * message.log_time, content
        return
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise UnsupportedError(text) from None
    with ExitStack() as stack:
        reader = stack.enter_context(AnyReader([path], default_typestore=get_typestore(Stores.LATEST)))
        some = [one for one in reader.connections if one.msgtype.split("/")[-1] in wanted]
        for connection, stamp, data in reader.messages(connections=some) if some else ():
            message = reader.deserialize(data, connection.msgtype)
            yield connection.topic, connection.msgtype.split("/")[-1], 1e-9 * stamp, message


class _Named:
    """A JSON object, its members as attributes."""

    def __init__(self, **members: Any) -> None:
        self.__dict__ |= members


def _stamp(message: Any, received: float) -> float:
    """Return the time of a message's header [s], that of its receipt where it has none."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    if stamp is None:
        return received
    parts = getattr(stamp, "nanosec", None)
    seconds = stamp.sec + 1e-9 * (getattr(stamp, "nsec", 0) if parts is None else parts)
    return seconds or received


def _motive(path: Path) -> list[Source]:
    """Return every rigid body and marker of a Motive export (1.20 .. 1.24): its header says the length unit.

    Source: OptiTrack's documentation, "Data Export: CSV".
    """
    rows = [[cell.strip() for cell in row] for row in csv.reader(text_lines(path))]
    head = dict(zip(rows[0][::2], rows[0][1::2], strict=False))
    unit = {"meters": "m", "centimeters": "cm", "millimeters": "mm"}.get(head.get("Length Units", "").lower())
    if unit is None:
        said = head.get("Length Units", "nothing")
        raise TableError(Place(path, 1), f"Length Units is {said!r}: export with Meters or Millimeters")
    last = next((i for i, row in enumerate(rows[:12]) if row[:1] == ["Frame"]), None)
    if last is None or last < 4:
        raise TableError(Place(path), "has no line that begins with Frame: export it with its header information")
    names = next((row for row in rows[1:last] if row[1:2] == ["Name"]), rows[last - 3])
    kinds = next((row for row in rows[1:last] if row[1:2] == ["Type"]), [])
    body = [(i, row) for i, row in enumerate(rows[last + 1 :], last + 2) if any(row)]
    width = len(rows[last])
    if short := next((i for i, row in body if len(row) != width), None):
        raise TableError(Place(path, short), f"has another number of cells than the {width} of the header")
    found = []
    for i in range(2, width - 2):
        what = [rows[last - 1][j] if j < len(rows[last - 1]) else "" for j in range(i, i + 3)]
        if what != ["Position"] * 3 or [one.upper() for one in rows[last][i : i + 3]] != ["X", "Y", "Z"]:
            continue
        name, kind = (row[i] if i < len(row) else "" for row in (names, kinds))
        if "Marker" in kind and kind != "Marker":  # a marker of a body, which has a place of its own
            continue
        turned = rows[last - 1][i - 4 : i] == ["Rotation"] * 4 and [one.upper() for one in rows[last][i - 4 : i]] == [
            *"XYZW"
        ]
        cells = [[row[j] for _, row in body] for j in (1, i, i + 1, i + 2, *(range(i - 4, i) if turned else ()))]
        try:
            values = np.array([[float(cell or "nan") for cell in one] for one in cells])
        except ValueError as error:
            raise TableError(Place(path), f"{name}: {error}") from None
        seen = np.isfinite(values).all(axis=0)
        if seen.any():
            header = ("time", *(f"{axis}_{unit}" for axis in "xyz"), *(("qx", "qy", "qz", "qw") if turned else ()))
            lines = tuple(line for (line, _), one in zip(body, np.atleast_1d(seen), strict=True) if one)
            columns: tuple[Cells, ...] = tuple(_one_sided(values[:, seen]))
            found.append(Source(path, header, lines, columns, part=name))
    if not found:
        raise TableError(Place(path), "has no position of a rigid body or a marker")
    return found


READS_C3D = """
import sys, ezc3d, numpy
found = ezc3d.c3d(sys.argv[1])
about = found["parameters"]["POINT"]
labels = [str(one) for key in about if key.strip("0123456789") == "LABELS" for one in about[key]["value"]]
unit = [str(one) for one in about.get("UNITS", {}).get("value", [])]
numpy.savez(sys.stdout.buffer, points=found["data"]["points"][:3], labels=numpy.array(labels, dtype=str),
            unit=numpy.array((unit or [""])[:1], dtype=str), rate=float(about["RATE"]["value"][0]),
            first=int(found["header"]["points"]["first_frame"]))
"""
"""Run in a process of its own: a damaged file ends it."""


def _c3d(path: Path) -> list[Source]:
    """Return every point of a C3D file that was seen; its parameters say unit and rate (c3d.org, POINT group)."""
    if find_spec("ezc3d") is None:
        raise UnsupportedError(f"{path} is a C3D file: pip install 'armflex[mocap]'")
    try:
        run = subprocess.run([sys.executable, "-c", READS_C3D, path], capture_output=True, timeout=600)
    except subprocess.TimeoutExpired:
        raise TableError(Place(path), "cannot be read as C3D: it takes more than 600 s") from None
    if run.returncode:
        last = (run.stderr.decode(errors="replace").strip().splitlines() or [f"it ends ezc3d ({run.returncode})"])[-1]
        raise TableError(Place(path), f"cannot be read as C3D: {shown(last)}")
    with np.load(io.BytesIO(run.stdout), allow_pickle=False) as content:
        points, labels, rate = content["points"], content["labels"].tolist(), float(content["rate"])
        unit, first = str(content["unit"][0]).strip(), int(content["first"])
    if not rate > 0.0:
        raise TableError(Place(path), f"POINT:RATE is {rate:g}, expected frames per second")
    found, times = [], (first + np.arange(points.shape[2])) / rate
    names = labels + [f"point {i}" for i in range(len(labels) + 1, points.shape[1] + 1)]
    for name, place in zip(names, points.transpose(1, 0, 2), strict=False):
        seen = np.isfinite(place).all(axis=0)
        if seen.any():
            header = [f"{axis}_{unit}" if unit else axis for axis in "xyz"]
            found.append(_recorded(path, name, {"time": times[seen], **dict(zip(header, place[:, seen], strict=True))}))
    if not found:
        raise TableError(Place(path), "has no points")
    return found


CHANNEL = re.compile(r"#BEGINCHANNELHEADER(.*?)#ENDCHANNELHEADER", re.DOTALL)


def _trace(path: Path) -> Source:
    """Return a trace of a KUKA controller: a DIAdem header (.dat) whose channels lie side by side in a .r64 beside it.

    Of each channel, 200 is the name, 202 the unit, 210 IMPLICIT for a time that is only counted, 211 the file, 213
    BLOCK or CHANNEL, 214 the type, 220 the number of values, 221 the place of the first, 240 and 241 offset and factor
    (National Instruments, "DAT header format").
    """
    channels = [
        {key.strip(): value.strip() for key, _, value in (line.partition(",") for line in match[1].splitlines())}
        for match in CHANNEL.finditer("".join(text_lines(path)))
    ]
    stored = [one for one in channels if one.get("210", "EXPLICIT").upper().startswith("EXP")]
    try:
        columns: dict[str, Array] = {}
        for number, one in zip(count(), channels, strict=False):
            name, size = one.get("200") or f"channel {number + 1}", int(one["220"])
            offset, factor = float(one.get("240") or 0.0), float(one.get("241") or 1.0)
            if size <= 0:
                raise TableError(Place(path), f"channel {name!r} has {size} values")
            if one in stored:
                if one.get("214", "REAL64").upper() != "REAL64":
                    raise TableError(Place(path), f"channel {name!r} is of type {one['214']}, expected REAL64")
                data = np.frombuffer(read_file(path.parent / one["211"], MOST_BYTES), dtype="<f8")
                block, place = one.get("213", "BLOCK").upper() == "BLOCK", int(one.get("221") or 1) - 1
                others = sum(other.get("211") == one["211"] for other in stored)
                values = data[place:][: size * others : others] if block else data[place : place + size]
            else:
                values = np.arange(size, dtype=float)
            unit = one.get("202", "").replace("°", "deg").strip("[]")
            columns[f"{name} [{unit}]" if unit else name] = offset + factor * values
    except (KeyError, ValueError) as error:
        raise TableError(Place(path), f"a channel's header lacks or spoils {error}") from None
    except OSError as error:
        raise TableError(Place(path), f"its values cannot be read: {error.strerror}: {error.filename}") from None
    if not columns or len({len(one) for one in columns.values()}) != 1:
        raise TableError(Place(path), "has no channels, or channels of different length")
    return _recorded(path, "", columns)
