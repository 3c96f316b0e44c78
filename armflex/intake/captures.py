"""Motion captures as their programs export them: Motive, Vicon, Qualisys, NDI, TRC and C3D.

Each becomes a part for every body or marker, with a row for each frame. Where a target was lost its places are left as
they are written, for `lost` to judge; where the program says so itself, they are not numbers.
"""

from __future__ import annotations

import csv
import io
import re
import struct
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from armflex.conventions import NUMBER, Array
from armflex.errors import Place, TableError, UnsupportedError, listing, shown
from armflex.intake.dh import is_dh
from armflex.intake.meanings import INTENDED, Meaning, meanings
from armflex.intake.sources import NO_READING, SourceTable
from armflex.intake.streams import FEWEST
from armflex.measured.lost_places import lost
from armflex.measured.points import LENGTHS
from armflex.measured.table import text_lines

TURN = ("qx", "qy", "qz", "qw")


def _body(
    path: Path, part: str, lines: Sequence[int], time: Array | None, place: Array, unit: str, turn: Array | None = None
) -> list[SourceTable]:
    """Return a body or a marker, none where it was lost in every frame.

    Of (N,) frames it has (N, 3) places in a unit, '' where that is stated nowhere, and (N, 4) quaternions x y z w.
    """
    if lost(place).all():
        return []
    columns = {"time": time} if time is not None else {}
    columns |= dict(zip([f"{axis}_{unit}" if unit else axis for axis in "xyz"], place.T, strict=True))
    columns |= dict(zip(TURN, turn.T, strict=True)) if turn is not None else {}
    return [SourceTable(path, tuple(columns), tuple(lines), tuple(columns.values()), part=part)]


def _values(path: Path, lines: Sequence[int], rows: Sequence[Sequence[str]], at: Sequence[int]) -> Array:
    """Return (N, k) numbers of some columns, nan where nothing was read; raise where a cell is neither, or missing."""
    values = np.full((len(rows), len(at)), np.nan)
    for i, cells in enumerate(rows):
        if min(at) < len(cells) <= max(at):
            text = f"ends after {len(cells)} cells, expected {max(at) + 1}: was it cut?"
            raise TableError(Place(path, lines[i]), text)
        for k, j in enumerate(at):
            cell = cells[j] if j < len(cells) else ""
            if NUMBER.fullmatch(cell):
                values[i, k] = float(cell)
            elif not NO_READING.fullmatch(cell):
                raise TableError(Place(path, lines[i]), f"has {shown(cell, 40)} in cell {j + 1}, expected a number")
    return values


def _rows(path: Path) -> list[list[str]]:
    """Return the stripped cells of every line, parted by tabs where there are any, else by semicolons or commas."""
    texts = list(text_lines(path))
    top = "".join(texts[:12])
    mark = max("\t;,", key=top.count)
    rows = [[cell.strip() for cell in row] or [""] for row in csv.reader(texts, delimiter=mark)]
    if mark != ",":
        rows = [[cell.replace(",", ".") if re.fullmatch(r"[-+]?\d+,\d+", cell) else cell for cell in row]
                for row in rows]  # fmt: skip
    return rows


def _whole(path: Path, lines: Sequence[int], rows: Sequence[Sequence[str]], width: int, stated: str = "") -> None:
    """Raise where a file has fewer frames than its header states, or a row more cells than that has columns."""
    if stated.isdigit() and len(rows) < int(stated):
        text = f"has {len(rows)} of the {stated} frames that its header states: copy or export it again"
        raise TableError(Place(path), text)
    for line, cells in zip(lines, rows, strict=True):
        if any(cells[width:]):
            raise TableError(Place(path, line), f"has {len(cells)} cells where its header has {width} columns")


def read_motive(path: Path) -> list[SourceTable]:
    """Return every rigid body and marker of a Motive export (1.20 .. 1.24): its header says the length unit.

    Source: OptiTrack's documentation, "Data Export: CSV".
    """
    rows = _rows(path)
    head = dict(zip(rows[0][::2], rows[0][1::2], strict=False))
    unit = {"meters": "m", "centimeters": "cm", "millimeters": "mm"}.get(head.get("Length Units", "").lower())
    if unit is None:
        stated = head.get("Length Units", "nothing")
        raise TableError(Place(path, 1), f"Length Units is {stated!r}: export with Meters or Millimeters")
    last = next((i for i, row in enumerate(rows[:12]) if row[:1] == ["Frame"]), None)
    if last is None or last < 4:
        raise TableError(Place(path), "has no line that begins with Frame: export it with its header information")
    names = next((row for row in rows[1:last] if row[1:2] == ["Name"]), rows[last - 3])
    kinds = next((row for row in rows[1:last] if row[1:2] == ["Type"]), [])
    lines = [i for i, row in enumerate(rows[last + 1 :], last + 2) if any(row)]
    body, width = [rows[i - 1] for i in lines], len(rows[last])
    if short := next((i for i in lines if len(rows[i - 1]) != width), None):
        raise TableError(Place(path, short), f"has another number of cells than the {width} of the header")
    _whole(path, lines, body, width, head.get("Total Exported Frames", ""))
    time, sources = _values(path, lines, body, [1])[:, 0], list[SourceTable]()
    above, axes = rows[last - 1] + [""] * width, [cell.upper() for cell in rows[last]]
    for i in range(2, width - 2):
        if above[i : i + 3] != ["Position"] * 3 or axes[i : i + 3] != [*"XYZ"]:
            continue
        name, kind = (row[i] if i < len(row) else "" for row in (names, kinds))
        if "Marker" in kind and kind != "Marker":  # a marker of a body, which has a place of its own
            continue
        turned = above[i - 4 : i] == ["Rotation"] * 4 and axes[i - 4 : i] == [*"XYZW"]
        turn = _values(path, lines, body, range(i - 4, i)) if turned else None
        sources += _body(path, name, lines, time, _values(path, lines, body, range(i, i + 3)), unit, turn)
    if not sources:
        raise TableError(Place(path), "has no position of a rigid body or a marker")
    return sources


def read_vicon(path: Path) -> list[SourceTable]:
    """Return every object, segment and marker of a CSV of Vicon's Nexus, Tracker or Shogun.

    A section has its kind, its rate [Hz], the names, the columns and the units in a line each, then the frames up to an
    empty line (Vicon Nexus User Guide, "Export data to an ASCII file").
    """
    rows, sources, i = _rows(path), list[SourceTable](), 0
    while i < len(rows):
        if not any(rows[i]):
            i += 1
            continue
        end = next((k for k in range(i + 5, len(rows)) if not any(rows[k])), len(rows))
        top = rows[i : i + 5]
        rate = float(top[1][0]) if len(top) == 5 and NUMBER.fullmatch(top[1][0]) else 0.0
        if rate <= 0.0 or top[3][:1] != ["Frame"]:
            text = "expected a section: its kind, its rate [Hz], names, columns from 'Frame', and units"
            raise TableError(Place(path, i + 1), f"{text}; export it from Vicon as CSV with its headers")
        if re.match(r"(?:model outputs|devices|joints|events)", top[0][0], re.IGNORECASE):
            i = end + 1
            continue
        lines, body = range(i + 6, end + 1), rows[i + 5 : end]
        axes, units = [cell.upper() for cell in top[3]], top[4] + [""] * len(top[3])
        _whole(path, lines, body, len(axes))
        time = _values(path, lines, body, [0])[:, 0] / rate
        for at in range(2, len(axes) - 2):
            shift = axes[at : at + 3] == ["TX", "TY", "TZ"]
            if not shift and axes[at : at + 3] != [*"XYZ"]:
                continue
            name = next((cell for cell in reversed(top[2][: at + 1]) if cell), "")
            if (unit := units[at].lower()) not in LENGTHS:
                raise TableError(Place(path, i + 5), f"{name!r} is in {units[at]!r}, expected a unit of length")
            turned = shift and axes[at - 4 : at] == ["RX", "RY", "RZ", "RW"]
            turn = _values(path, lines, body, range(at - 4, at)) if turned else None
            part = re.sub(r"^.*\([^)]*\)\s*", "", name)
            sources += _body(path, part, lines, time, _values(path, lines, body, range(at, at + 3)), unit, turn)
        i = end + 1
    if not sources:
        raise TableError(Place(path), "has no place of an object, a segment or a marker: export those from Vicon")
    return sources


def read_qualisys(path: Path) -> list[SourceTable]:
    """Return every marker (3D) or body (6D) of a TSV of Qualisys' QTM, whose lengths are in mm.

    Source: Qualisys Track Manager User Manual, "TSV file formats".
    """
    rows = _rows(path)
    first = next((i for i, row in enumerate(rows) if row[:1] != [""] and all(map(NUMBER.fullmatch, filter(None, row)))),
                 len(rows))  # fmt: skip
    head = {row[0]: row[1:] for row in rows[:first] if row and row[0]}
    lines = [i for i, row in enumerate(rows[first:], first + 1) if any(row)]
    body, names = [rows[i - 1] for i in lines], head.get("MARKER_NAMES") or head.get("BODY_NAMES") or []
    names = [name for name in names if name]
    titles = rows[first - 1] if first and re.fullmatch(r"(?:frame|time|.*\bx)", rows[first - 1][0].lower()) else []
    places = [i for i in range(len(titles) - 2) if all(titles[i + k].lower().endswith("xyz"[k]) for k in range(3))]
    if not titles and body:
        width = len(body[0]) - (not body[0][-1])
        ahead = width - 3 * len(names)
        if head.get("DATA_INCLUDED", ["3D"])[0] != "3D" or ahead not in (0, 2):
            text = f"has {width} columns for {len(names)} markers: export 3D data with the column header"
            raise TableError(Place(path, first + 1), text)
        titles = [*["frame", "time"][:ahead], *[""] * (width - ahead)]
        places = [ahead + 3 * i for i in range(len(names))]
    _whole(path, lines, body, len(titles), "".join(head.get("NO_OF_FRAMES", [])[:1]))
    if len(names) != len(places):
        names = [re.sub(r"\W*x$", "", titles[i], flags=re.IGNORECASE) for i in places]
    rate = "".join(head.get("FREQUENCY", [])[:1])
    clock = next((i for i, title in enumerate(titles) if title.lower() == "time"), None)
    if clock is None and not (NUMBER.fullmatch(rate) and float(rate) > 0.0):
        raise TableError(Place(path), "states no FREQUENCY and has no column Time: export it with its header")
    time = np.arange(len(body)) / float(rate) if clock is None else _values(path, lines, body, [clock])[:, 0]
    sources = list[SourceTable]()
    for name, at in zip(names, places, strict=True):
        sources += _body(path, name, lines, time, _values(path, lines, body, range(at, at + 3)), "mm")
    if not sources:
        raise TableError(Place(path), "has no place of a marker or a body: export 3D or 6D data from QTM")
    return sources


def read_trc(path: Path) -> list[SourceTable]:
    """Return every marker of a TRC file, as OpenSim, Motive and Cortex write it.

    Source: OpenSim documentation, "Marker (.trc) Files".
    """
    rows = [[cell.strip() for cell in row] for row in csv.reader(text_lines(path), delimiter="\t")]
    head = dict(zip(*rows[1:3], strict=False)) if len(rows) > 3 else {}
    if (unit := head.get("Units", "").lower()) not in LENGTHS or rows[3][:2] != ["Frame#", "Time"]:
        text = "expected Units in its second line, and Frame# and Time in its fourth: export it again"
        raise TableError(Place(path, 1), f"{text} (unit {unit!r})")
    lines = [i for i, row in enumerate(rows, 1) if i > 4 and NUMBER.fullmatch(row[0] if row else "")]
    body, sources = [rows[i - 1] for i in lines], list[SourceTable]()
    _whole(path, lines, body, 3 + max(at for at, name in enumerate(rows[3]) if name), head.get("NumFrames", ""))
    time = _values(path, lines, body, [1])[:, 0]
    for at, name in enumerate(rows[3]):
        if at > 1 and name:
            sources += _body(path, name, lines, time, _values(path, lines, body, range(at, at + 3)), unit)
    if not sources:
        raise TableError(Place(path, 4), "names no marker that was read")
    return sources


def read_ndi(path: Path) -> list[SourceTable]:
    """Return every tool of a CSV of NDI's ToolBox or of its Combined API's sample program, whose lengths are in mm.

    A tool that is not OK has no reading, whatever its numbers are.
    """
    rows = _rows(path)
    head, lines = rows[0], [i for i, row in enumerate(rows[1:], 2) if any(row)]
    body, sources = [rows[i - 1] for i in lines], list[SourceTable]()
    starts = [i for i, name in enumerate(head) if name.startswith("Port ")] or [0]
    for start, end in zip(starts, [*starts[1:], len(head)], strict=True):
        words = [name.lower() for name in head[start:end]]
        at = {name: start + words.index(name) for name in ("tx", "ty", "tz", "q0", "qx", "qy", "qz") if name in words}
        if not {"tx", "ty", "tz"} <= at.keys():
            raise TableError(Place(path, 1), f"has no Tx, Ty, Tz of {head[start]!r}")
        if short := next((i for i, row in zip(lines, body, strict=True) if len(row) <= at["tz"]
                          or (len(starts) > 1 and len(row) != len(head))), None):  # fmt: skip
            raise TableError(Place(path, short), f"has fewer or more cells than the {len(head)} of the header")
        state = next((start + i for i, name in enumerate(words) if "state" in name or "status" in name), None)
        clock = next((start + i for i, name in enumerate(words) if name.startswith("time")), None)
        frame = next((start + i for i, name in enumerate(words) if name.startswith("frame")), None)
        which = start if len(starts) > 1 or head[start].startswith("Port ") or "toolinfo" in words[0] else None
        tools = [row[which] if which is not None else "" for row in body]
        for tool in dict.fromkeys(tools):
            kept = [i for i, name in enumerate(tools) if name == tool]
            cells, of = [body[i] for i in kept], [lines[i] for i in kept]
            time = _values(path, of, cells, [clock])[:, 0] if clock is not None else None
            if time is None and frame is not None and len(of) > 1:
                steps = np.diff(_values(path, of, cells, [frame])[:, 0])
                if np.median(steps) <= 10.0:  # samples, and not points
                    text = "counts frames and has no time: export it from NDI ToolBox with 'Time [sec]',"
                    raise TableError(Place(path, 1), f"{text} or add a column 'Time [sec]', frame over rate")
            ok = np.array([state is None or row[state].upper() in ("OK", "VALID", "ENABLED") for row in cells])
            place = np.where(ok[:, None], _values(path, of, cells, [at[k] for k in ("tx", "ty", "tz")]), np.nan)
            turn = None
            if {"q0", "qx", "qy", "qz"} <= at.keys():
                turn = _values(path, of, cells, [at[k] for k in ("qx", "qy", "qz", "q0")])
                turn = np.where(ok[:, None], turn, np.nan)
            sources += _body(path, tool or "tool", of, time, place, "mm", turn)
    if not sources:
        raise TableError(Place(path), "has no tool that was read in any frame")
    return sources


VICON = r"(?:Trajectories|Objects|Segments|Markers|Joints|Devices|Model Outputs)\W*$"
FORMATS = (
    (re.compile("Format Version"), read_motive),
    (re.compile(VICON), read_vicon),
    (re.compile(r"NO_OF_FRAMES\b"), read_qualisys),
    (re.compile(r"PathFileType\b"), read_trc),
    (re.compile(r"(?:Tools|ToolInfo)\b.*\bTx\b", re.IGNORECASE), read_ndi),
)
"""How the first line of an export begins, and who reads it."""

NAMED_AXIS = re.compile(r"(.*?[^\s._:/-])[\s._:/-]*([xyz])(\s*[\[(].*[\])]|_[a-zµ]+)?", re.IGNORECASE)
NO_PLACE = re.compile(
    r".*(?:rot|orient|quat|angle|euler|vel|acc|speed|force|moment|torque|gyro|mag)\w*"
    rf"|(?:.*[\W_])?(?:[rqdsuv]|{INTENDED}"
    r"|dev(?:iations?)?|abw\w*|delta|diff(?:erence)?|err(?:or)?|res(?:iduals?)?|std(?:dev|ev)?|sd|sigma|unc\w*|rms"
    r"|tol(?:erance)?|min|max|range|scale|size|offset)\W*",
    re.IGNORECASE,
)
"""What stands before X, Y and Z that are no place: turns, forces, where a point was to be, and how far it is off."""


WHICH = re.compile(
    r"(?:id|name|(?:marker|body|rigid[ _]?body|tool|tracker|sensor|handle|port|prism|target|object|subject)s?"
    r"(?:[ _-]?(?:id|name|no|nr|number|index))?)",
    re.IGNORECASE,
)
"""Header of a column that says which of several things a row is of."""


def _of_each(source: SourceTable, meant: Sequence[Meaning]) -> list[SourceTable]:
    """Return a recording with rows of several things at the same times, `time, id, x, y, z`, as a part for each."""
    clock = next((i for i, meaning in enumerate(meant) if (meaning.kind, meaning.name) == ("time", "time")), None)
    at = next((i for i, name in enumerate(source.header) if WHICH.fullmatch(name.strip())), None)
    if clock is None or at is None or len(source.lines) < FEWEST:
        return [source]
    names, times = (list(map(str, source.columns[i])) for i in (at, clock))
    several = dict.fromkeys(names)
    if not 1 < len(several) <= len(names) / FEWEST or len(set(times)) > 0.9 * len(times):
        return [source]
    kept = [i for i in range(len(source.header)) if i != at]
    parts = list[SourceTable]()
    for name in several:
        rows = [row for row, other in enumerate(names) if other == name]
        columns = tuple(tuple(source.columns[i][row] for row in rows) for i in kept)
        header = tuple(source.header[i] for i in kept)
        lines = tuple(source.lines[row] for row in rows)
        parts.append(replace(source, header=header, columns=columns, lines=lines, part=name))
    return parts


def markers(source: SourceTable) -> list[SourceTable]:
    """Return a table with places of several things (`m1 X, m1 Y, m1 Z, m2 X ..`, or a row each) as a part for each.

    Other tables are returned as they are.
    """
    meant = meanings(source, {})
    kinds = {meaning.kind for meaning in meant}
    if is_dh(source, {}):
        return [source]
    if kinds & {"joint", "coordinate"}:
        return [source] if "joint" in kinds else _of_each(source, meant)
    matches = [NAMED_AXIS.fullmatch(name) for name in source.header]
    sources = []
    for i in range(len(matches) - 2):
        triple = [match for match in matches[i : i + 3] if match is not None]
        if [match[2].lower() for match in triple] != [*"xyz"] or len({match[1] for match in triple}) > 1:
            continue
        if NO_PLACE.fullmatch(base := triple[0][1]):
            continue
        places = range(i, i + 3)
        header = [
            f"{matches[k][2].lower()}{matches[k][3] or ''}" if k in places and matches[k] else name  # type: ignore
            for k, name in enumerate(source.header)
        ]
        kept = [k for k, meaning in enumerate(meant) if k in places or meaning.kind in ("time", "name")]
        sources.append(
            replace(
                source, header=tuple(header[k] for k in kept), columns=tuple(source.columns[k] for k in kept), part=base
            )
        )
    return sources or [source]


READS_C3D = """
import sys, ezc3d, numpy
found = ezc3d.c3d(sys.argv[1])
about = found["parameters"]["POINT"]
labels = [str(one) for key in about if key.strip("0123456789") == "LABELS" for one in about[key]["value"]]
unit = [str(one) for one in about.get("UNITS", {}).get("value", [])]
points, analogs = found["data"]["points"][:3], found["data"]["analogs"]
residuals = found["data"]["meta_points"]["residuals"]
points = numpy.where(residuals < 0.0, numpy.nan, points) if residuals.shape[1:] == points.shape[1:] else points
trial = found["parameters"].get("TRIAL", {})
ends = [sum(int(one) % 65536 << 16 * i for i, one in enumerate(trial[key]["value"][:2])) if key in trial else 0
        for key in ("ACTUAL_START_FIELD", "ACTUAL_END_FIELD")]
numpy.savez(sys.stdout.buffer, points=points, labels=numpy.array(labels, dtype=str),
            unit=numpy.array((unit or [""])[:1], dtype=str), rate=float(about["RATE"]["value"][0]),
            scale=float(about["SCALE"]["value"][0]) if "SCALE" in about else -1.0,
            trial=ends[1] - ends[0] + 1 if min(ends) > 0 else 0,
            first=int(found["header"]["points"]["first_frame"]), analogs=analogs.shape[1] * analogs.shape[2])
"""
"""Run in a process of its own: a damaged file ends it."""


def read_c3d(path: Path) -> list[SourceTable]:
    """Return every point of a C3D file that was read; its parameters say unit and rate (c3d.org, POINT group).

    Raises:
        UnsupportedError: ezc3d is not installed.
        TableError: It cannot be read, ends before its last frame, or has no points.
    """
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
        stated, analogs = int(content["trial"]), int(content["analogs"])
        size = 2 if float(content["scale"]) > 0.0 else 4
    if not rate > 0.0:
        raise TableError(Place(path), f"POINT:RATE is {rate:g}, expected frames per second")
    if unit and unit.lower() not in LENGTHS:
        raise TableError(Place(path), f"POINT:UNITS is {shown(unit)}, expected a unit of length")
    start, in_header, behind = _c3d_header(path)
    frames = points.shape[2]
    stated = max(stated, in_header, frames)
    per = size * (4 * points.shape[1] + analogs // max(frames, 1))
    if (there := min(frames, max(path.stat().st_size - start, 0) // max(per, 1))) < stated:
        text = f"ends after {there} of its {stated} frames: it was cut, copy or export it again"
        raise TableError(Place(path), text)
    # Whole blocks are written, and the parameters may stand behind the frames.
    if (more := (path.stat().st_size - start - BLOCK) // max(per, 1)) > stated and not behind:
        text = f"has the numbers of {more} frames or more, and states {stated}: export it again"
        raise TableError(Place(path), f"{text}, in parts where they are more than 65535")
    sources, times = list[SourceTable](), (first + np.arange(frames)) / rate
    names = labels + [f"point {i}" for i in range(len(labels) + 1, points.shape[1] + 1)]
    for name, place in zip(names, points.transpose(1, 2, 0), strict=False):
        sources += _body(path, name, range(1, frames + 1), times, place, unit)
    if not sources:
        raise TableError(Place(path), "has no points" if not names else f"has no reading of {listing(names)}")
    return sources


BLOCK = 512
"""Bytes of a block of a C3D file."""


def _c3d_header(path: Path) -> tuple[int, int, bool]:
    """Return the byte at which a C3D file's frames begin, their number, and whether its parameters are behind them.

    The number is 0 where it is too large for a word. Words 9, 4 and 5 of its header, as its processor writes them
    (c3d.org, "The C3D file header").
    """
    with path.open("rb") as file:
        head = file.read(BLOCK)
        file.seek(BLOCK * (head[0] - 1) + 3)
        order = ">" if file.read(1) == b"\x56" else "<"  # 84 Intel, 85 DEC, 86 MIPS
    first, last = struct.unpack(f"{order}2H", head[6:10])
    start = struct.unpack(f"{order}H", head[16:18])[0]
    return BLOCK * (start - 1), last - first + 1 if first <= last < 65535 else 0, head[0] > start
