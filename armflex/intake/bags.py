"""Bags of ROS: joints by their names over all messages of a topic, and the places of every topic and frame.

MCAP and SQLite files are read from their start on, without their index: so is a recording that was never closed.
rosbags is used only here.
"""

from __future__ import annotations

import json
import re
import sqlite3
import struct
import zlib
from collections import defaultdict
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, closing
from dataclasses import replace
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from armflex.conventions import Array
from armflex.errors import FEW, ArmflexError, Place, TableError, UnsupportedError, listing
from armflex.intake.sources import SourceTable, recorded
from armflex.intake.streams import DENSE, aligned, spread, two_sources

BAGS = (".bag", ".active", ".db3", ".mcap")
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

WANTED = {JOINTS, "TFMessage", *POINTS}
ALWAYS = {"Log", "ParameterEvent", "Clock", "DiagnosticArray", "String"}
"""Types in every recording, of which nobody misses what is left out."""

MENDS = {".mcap": "`mcap recover`", ".db3": "`ros2 bag reindex`", ".bag": "`rosbag reindex`"}

DELAY = 0.05
"""Stamps of joints that differ by more [s] from one another, as their receipt says, are of different clocks."""


class _Cut(Exception):
    """A file ends within a message: its recording was not closed."""


def read_bag(path: Path) -> list[SourceTable]:
    """Return joint states, and the positions of every topic and frame, of a ROS 1 bag, a rosbag2 or an MCAP file.

    Joints that a topic has in messages of their own are joined over time. Stamps are those of the headers; of receipt
    where there are none, and where the headers' are not of one clock.

    Raises:
        UnsupportedError: The package that reads it is not installed.
        TableError: It cannot be read, or has neither joints nor positions.
    """
    joints: dict[str, dict[str, list[tuple[float, float, float]]]] = defaultdict(lambda: defaultdict(list))
    places: dict[tuple[str, str, str], list[tuple[float, ...]]] = defaultdict(list)
    types, notes, unread = set[str](), list[str](), dict[str, str]()
    try:
        for topic, kind, received, message in _messages(path, notes):
            types.add(kind)
            if message is None:
                unread |= {topic: kind} if kind not in WANTED else {}
                continue
            stamp = _stamp(message, received)
            if kind == JOINTS:
                names, at = list(message.name), list(message.position)
                if at and len(at) != len(names):
                    text = f"{topic} has {len(at)} positions of {len(names)} joints at {stamp:.3f} s"
                    raise TableError(Place(path), text)
                if at and "" in names:
                    text = f"{topic} leaves the name of a joint empty, number {names.index('') + 1} of {len(names)}"
                    raise TableError(Place(path), f"{text}, at {stamp:.3f} s")
                for name, value in zip(names, at, strict=False):  # no positions: velocities alone
                    if np.isfinite(value := float(value)):
                        joints[topic][str(name)].append((stamp, received, value))
            elif kind == "TFMessage":
                for transform in message.transforms:
                    named = f"{transform.header.frame_id}->{transform.child_frame_id}"
                    stamp = _stamp(transform, received)
                    places[topic, named, ""].append((stamp, received, *_placed(transform.transform)))
            elif kind in POINTS:
                child = str(getattr(message, "child_frame_id", ""))
                frame = str(getattr(getattr(message, "header", None), "frame_id", ""))
                for key in filter(None, POINTS[kind].split(".")):
                    message = getattr(message, key)
                places[topic, child, frame].append((stamp, received, *_placed(message)))
    except ArmflexError:
        raise
    except Exception as error:  # of a damaged file, from whatever depth
        problem = " ".join(str(error).split()) or type(error).__name__
        mends = f"; {MENDS['.bag']} mends one that was not closed" if "index" in problem else ""
        if path.suffix == ".active":
            problem, mends = "its recording was not closed", f": call it .bag, then {MENDS['.bag']} mends it"
        raise TableError(Place(path), f"cannot be read as a bag: {problem}{mends}") from None
    others = [f"{topic} ({kind})" for topic, kind in unread.items() if kind not in ALWAYS]
    if others and places:
        notes.append(f"topics of {path.name} of types that are not read: {listing(others, 8)}")
    sources = _of_joints(path, joints, tuple(notes))
    bodies, frames = defaultdict[str, set[str]](set), defaultdict[tuple[str, str], set[str]](set)
    for topic, child, frame in places:
        bodies[topic].add(child)
        frames[topic, child].add(frame)
    for (topic, child, frame), rows in places.items():
        values = np.array([row[: min(map(len, rows))] for row in rows])
        values = values[np.argsort(values[:, 1], kind="stable")]
        about = notes[:]
        if (np.diff(values[:, 0]) < -DENSE).any():
            about.append(f"stamps of {topic} in {path.name} go back: their receipt counts")
            values[:, 0] = values[:, 1]
        values = np.delete(values[np.argsort(values[:, 0], kind="stable")], 1, axis=1)
        points = values[np.isfinite(values[:, 1:4]).all(axis=1), 1:4]
        if len(points) and np.ptp(points, axis=0).max() > 0.0:  # a frame that is fixed to another is no target
            head = ("time", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")[: values.shape[1]]
            part = f"{topic} {child}" if "->" in child or len(bodies[topic]) > 1 else topic
            part += f" in {frame or 'no frame'}" if len(frames[topic, child]) > 1 else ""
            sources.append(recorded(path, part, dict(zip(head, values.T, strict=True)), tuple(about)))
    if unread and all(not source.header[1].startswith("x_") for source in sources):
        left = listing((f"{topic} ({kind})" for topic, kind in unread.items()), 8)
        about = f"{path} has no place of a type that is read, but topics of others: {left}"
        sources = [replace(source, notes=(*source.notes, about), unread=about) for source in sources]
    if not sources:
        cut = f"; {notes[0]}" if notes else ""
        text = f"has no {JOINTS} with positions and no place that moves among its types: {listing(sorted(types))}"
        raise TableError(Place(path), text + cut)
    return sources


def _of_joints(
    path: Path, joints: Mapping[str, Mapping[str, list[tuple[float, float, float]]]], notes: tuple[str, ...]
) -> list[SourceTable]:
    """Return each topic's joints (stamp, receipt and position of each by name) on all its times."""
    arrays = {(topic, name): np.array(rows) for topic, by_name in joints.items() for name, rows in by_name.items()}
    delays = [float(np.median(rows[:, 1] - rows[:, 0])) for rows in arrays.values()]
    again = any((np.diff(rows[np.argsort(rows[:, 1], kind="stable"), 0]) < -DENSE).any() for rows in arrays.values())
    column = int(bool(delays) and (again or max(delays) - min(delays) > DELAY))
    if column:
        notes = (*notes, f"stamps of joints in {path.name} are of different clocks: their receipt counts")
    sources = []
    for topic, by_name in joints.items():
        series, doubts = dict[str, tuple[Array, Array]](), dict[str, str]()
        for name in by_name:
            rows = arrays[topic, name]
            time, values = spread(rows[:, column]), rows[:, 2]
            order = np.argsort(time, kind="stable")
            time, values = time[order], values[order]
            if (pair := two_sources(time, values[:, None], "rad")) is not None:
                at, after = pair
                text = f"{topic} has joint {name} at {values[at]:.4g} and, {1e3 * (time[after] - time[at]):.0f} ms"
                text += f" later, at {values[after]:.4g}, and back, from {time[after] - time[0]:.3f} s on"
                doubts[f"position.{name}"] = f"{text}: two programs publish it, record one of them"
            series[f"position.{name}"] = time, values
        time, columns = aligned(series)
        sources.append(replace(recorded(path, topic, {"time": time} | columns, notes), doubts=doubts))
    return sources


def together(sources: list[SourceTable]) -> SourceTable:
    """Return several topics' joints as one recording; their columns but for the time have different names."""
    series = dict[str, tuple[Array, Array]]()
    for source in sources:
        time, *columns = (np.asarray(column, dtype=float) for column in source.columns)
        for name, values in zip(source.header[1:], columns, strict=True):
            series[name] = time[np.isfinite(values)], values[np.isfinite(values)]
    time, aligned_columns = aligned(series)
    notes = tuple(dict.fromkeys(note for source in sources for note in source.notes))
    part = " + ".join(source.part for source in sources)
    doubts = {name: text for source in sources for name, text in source.doubts.items()}
    return replace(recorded(sources[0].path, part, {"time": time} | aligned_columns, notes), doubts=doubts)


def _placed(message: Any) -> tuple[float, ...]:
    """Return x, y, z [m] of a message and, where it has them, the quaternion x, y, z, w."""
    place = getattr(message, "position", None) or getattr(message, "translation", None) or message
    turn = getattr(message, "orientation", None) or getattr(message, "rotation", None)
    return place.x, place.y, place.z, *(() if turn is None else (turn.x, turn.y, turn.z, turn.w))


def _stamp(message: Any, received: float) -> float:
    """Return the time of a message's header [s], that of its receipt where it has none."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    if stamp is None:
        return received
    parts = getattr(stamp, "nanosec", None)
    seconds = stamp.sec + 1e-9 * (getattr(stamp, "nsec", 0) if parts is None else parts)
    return seconds or received


class _Named:
    """A JSON object, its members as attributes."""

    def __init__(self, **members: Any) -> None:
        self.__dict__ |= members


def _messages(path: Path, notes: list[str]) -> Iterator[tuple[str, str, float, Any]]:
    """Yield topic, type, time of receipt [s] and message of all that may have joints or positions; None for others'.

    `notes` gains which files end before their recording was closed.
    """
    metadata = path / "metadata.yaml"
    listed = metadata.read_text("utf-8", "replace") if metadata.is_file() else ""
    files = [path] if path.is_file() else sorted(path.glob("*.mcap")) + sorted(path.glob("*.db3"))
    files.sort(key=lambda file: [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", file.name)])
    if absent := {*re.findall(r"[^\s'\"\[\],/]+\.(?:mcap|db3)(?![.\w])", listed)} - {file.name for file in files}:
        raise TableError(Place(metadata), f"lists {listing(sorted(absent))}, which is not there: copy the whole folder")
    if path.is_dir() and not files and not listed:
        every = [*sorted(path.glob("*")), *sorted(path.glob("*/*"))]
        bags = dict.fromkeys(item if item.parent == path else item.parent for item in every if item.suffix in BAGS)
        text = f"is a folder with {len(bags)} bags, {listing(map(str, bags), FEW)}: give one of them" if bags else ""
        raise TableError(Place(path), text or f"is a folder without a recording ({', '.join(BAGS)}): give the files")
    packed = re.search(r"compression_mode: *['\"]?(?:file|message)", listed, re.IGNORECASE)
    if packed or not files or files[0].suffix not in (".mcap", ".db3"):
        yield from _other(path)
        return
    if find_spec("rosbags") is None:
        raise _not_installed(path)
    for file in files:
        read = 0
        try:
            for message in _mcap(file) if file.suffix == ".mcap" else _sqlite(file):
                read += 1
                yield message
        except _Cut as cut:
            mends = MENDS[file.suffix]
            if path.is_dir() and not listed and file.suffix == ".mcap":
                mends += f", then {MENDS['.db3']} for its metadata.yaml,"
            problem = f"the recording {file.name} was not closed ({cut})"
            if not read:
                text = f"{problem}, and none of its messages can be read; {mends} may mend it"
                raise TableError(Place(file), text) from None
            notes.append(f"{problem}: what was written before is used; {mends} mends it")


def _not_installed(path: Path) -> UnsupportedError:
    return UnsupportedError(f"{path} is a recording of ROS: pip install 'armflex[bags]'")


def _other(path: Path) -> Iterator[tuple[str, str, float, Any]]:
    """Yield the messages of a ROS 1 bag, or of a rosbag2 that is compressed."""
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise _not_installed(path) from None
    with ExitStack() as stack:
        reader = stack.enter_context(AnyReader([path], default_typestore=get_typestore(Stores.LATEST)))
        for connection in reader.connections:
            yield connection.topic, connection.msgtype.split("/")[-1], 0.0, None
        wanted = [connection for connection in reader.connections if connection.msgtype.split("/")[-1] in WANTED]
        for connection, stamp, data in reader.messages(connections=wanted) if wanted else ():
            message = reader.deserialize(data, connection.msgtype)
            yield connection.topic, connection.msgtype.split("/")[-1], 1e-9 * stamp, message


class _Types:
    """Definitions of messages: those of the file, else those of ROS."""

    def __init__(self) -> None:
        from rosbags.typesys import Stores, get_typestore

        self.own, self.usual = get_typestore(Stores.EMPTY), get_typestore(Stores.LATEST)

    def define(self, name: str, form: str, text: str) -> None:
        from rosbags.typesys import get_types_from_idl, get_types_from_msg

        if text and name not in self.own.fielddefs and form in ("ros2msg", "ros2idl"):
            self.own.register(get_types_from_msg(text, name) if form == "ros2msg" else get_types_from_idl(text))

    def read(self, name: str, data: bytes) -> Any:
        return (self.own if name in self.own.fielddefs else self.usual).deserialize_cdr(data, name)


def _mcap(path: Path) -> Iterator[tuple[str, str, float, Any]]:
    """Yield the messages of an MCAP file as they were written; `_Cut` where it ends before its footer."""
    try:
        from mcap.data_stream import ReadDataStream
        from mcap.opcode import Opcode
        from mcap.records import Channel, Message, Schema
    except ImportError:
        raise _not_installed(path) from None
    types, schemas, channels = _Types(), dict[int, Any](), dict[int, Any]()
    for opcode, data in _records(path):
        stream = ReadDataStream(BytesIO(data))
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(stream)
            schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(stream)
            channels[channel.id] = channel
        elif opcode == Opcode.MESSAGE:
            message = Message.read(stream, len(data))
            channel = channels[message.channel_id]
            schema = schemas.get(channel.schema_id)
            kind = "" if schema is None else re.split(r"[/.]", schema.name)[-1]
            if kind not in WANTED or schema is None:
                content = None
            elif channel.message_encoding == "json":
                content = json.loads(message.data, object_hook=lambda members: _Named(**members))
            elif channel.message_encoding == "cdr" and schema.encoding in ("ros2msg", "ros2idl", ""):
                types.define(schema.name, schema.encoding, schema.data.decode())
                content = types.read(schema.name, message.data)
            else:
                how = f"{channel.topic} is in {channel.message_encoding} ({schema.encoding or 'no'} schema)"
                raise TableError(Place(path), f"{how}: expected cdr with ros2msg, or json")
            yield channel.topic, kind, 1e-9 * message.log_time, content


def _records(path: Path) -> Iterator[tuple[int, bytes]]:
    """Yield opcode and content of each record of an MCAP file, those of chunks in their place; `_Cut` without a footer.

    Source: the MCAP format specification, "Records" and "Chunk".
    """
    with path.open("rb") as file:
        size = path.stat().st_size
        if not (magic := file.read(8)).startswith(b"\x89MCAP"):
            if not magic or not b"\x89MCAP0\r\n".startswith(magic):
                raise TableError(Place(path), "is no MCAP file: its first bytes are others")
            raise _Cut(f"it has {size} bytes")
        while True:
            head = file.read(9)
            opcode, length = struct.unpack("<BQ", head) if len(head) == 9 else (0, 0)
            if opcode == 2:  # the footer
                return
            left = size - file.tell()
            if opcode == 6:
                data = file.read(min(length, left))
                yield from _of_chunk(path, data, whole=length <= left)
            elif opcode > 0 and length <= left:
                yield opcode, file.read(length)
            if opcode == 0 or length > left:  # noughts where a disk was not written any more
                raise _Cut(f"it ends within a record, after {size} bytes")


def _of_chunk(path: Path, data: bytes, *, whole: bool) -> Iterator[tuple[int, bytes]]:
    """Yield opcode and content of the records of a chunk, of one that was cut those before."""
    if len(data) < 32:
        return
    crc, named = struct.unpack("<II", data[24:32])
    how, content = data[32 : 32 + named].decode("ascii", "replace"), data[32 + named + 8 :]
    if how == "zstd":
        import zstandard

        content = zstandard.ZstdDecompressor().decompressobj().decompress(content)
    elif how == "lz4":
        from lz4.frame import LZ4FrameDecompressor

        content = LZ4FrameDecompressor().decompress(content)
    elif how:
        raise TableError(Place(path), f"is compressed by {how!r}: expected zstd or lz4")
    if whole and crc and zlib.crc32(content) != crc:
        raise TableError(Place(path), "is damaged: a chunk's checksum differs from the one beside it")
    at = 0
    while at + 9 <= len(content):
        opcode, length = struct.unpack("<BQ", content[at : at + 9])
        if at + 9 + length > len(content):
            break
        yield opcode, content[at + 9 : at + 9 + length]
        at += 9 + length


def _opened(path: Path) -> tuple[sqlite3.Connection, bool]:
    """Return a file of SQLite, of one that was cut its whole pages, and whether it was cut (sqlite.org, "File Format").

    Nothing is written, but beside a log that was never taken in, which only then is read.
    """
    with path.open("rb") as file:
        head = file.read(100)
    size, pages = struct.unpack(">H", head[16:18])[0] if len(head) == 100 else 0, int.from_bytes(head[28:32], "big")
    size = 65536 if size == 1 else size
    if head.startswith(b"SQLite format 3") and size and path.stat().st_size < size * pages:
        data = bytearray(path.read_bytes())
        whole = len(data) // size
        data[28:32] = whole.to_bytes(4, "big")
        base = sqlite3.connect(":memory:")
        base.deserialize(bytes(data[: whole * size]))
        return base, True
    log = path.with_name(f"{path.name}-wal")
    mode = "mode=ro" if log.is_file() and log.stat().st_size else "immutable=1"
    return sqlite3.connect(f"file:{quote(str(path.absolute()))}?{mode}", uri=True), False


def _sqlite(path: Path) -> Iterator[tuple[str, str, float, Any]]:
    """Yield the messages of a rosbag2 in SQLite as they were written; `_Cut` where a page is missing."""
    types, (base, short) = _Types(), _opened(path)
    with closing(base):
        try:
            tables = {name for (name,) in base.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
            if not {"messages", "topics"} <= tables:
                raise TableError(Place(path), "is no bag: it has no tables topics and messages")
            if "message_definitions" in tables:
                texts = base.execute("SELECT topic_type, encoding, encoded_message_definition FROM message_definitions")
                for name, form, text in texts:
                    types.define(name, form, text)
            rows = list(base.execute("SELECT id, name, type, serialization_format FROM topics"))
            odd = [(topic, form) for _, topic, kind, form in rows if form != "cdr" and kind.split("/")[-1] in WANTED]
            if odd:
                raise TableError(Place(path), f"{odd[0][0]} is in {odd[0][1]}: expected cdr")
            topics = {number: (topic, kind) for number, topic, kind, _ in rows}
            for number, stamp, data in base.execute("SELECT topic_id, timestamp, data FROM messages"):
                topic, kind = topics[number]
                name = kind.split("/")[-1]
                yield topic, name, 1e-9 * stamp, types.read(kind, data) if name in WANTED else None
        except sqlite3.DatabaseError as error:
            if "malformed" not in str(error):
                raise
            raise _Cut(str(error)) from None
    if short:
        raise _Cut("it is shorter than its header states")
    if (journal := path.with_name(f"{path.name}-journal")).is_file() and journal.stat().st_size:
        raise _Cut(f"{journal.name} is beside it")
