"""What programs recorded while an arm moved: which reader a file needs, and traces of KUKA controllers.

A recording comes as one part for each of its topics, bodies or markers, with times [s] and numbers; which of them
counts is chosen later.
"""

import csv
import re
from itertools import count
from pathlib import Path

import numpy as np

from armflex.conventions import Array
from armflex.errors import Place, TableError
from armflex.intake.bags import BAGS, read_bag
from armflex.intake.captures import FORMATS, markers, read_c3d
from armflex.intake.picture_files import is_pictures, of_corners, read_folder
from armflex.intake.sources import SourceTable, read_table_source, recorded
from armflex.measured.spreadsheet import SUFFIXES
from armflex.measured.table import text_lines
from armflex.storage.read_file import check_file, read_file

MOST_BYTES = 20_000_000_000
"""Of a recording: that of an hour with pictures has less."""


def read_sources(path: str | Path) -> list[SourceTable]:
    """Read a file as it is, a table or every part of a recording; raise where it has no joints and no positions."""
    path = Path(path)
    if is_pictures(path):
        return [read_folder(path)]
    if path.suffix.lower() in (*BAGS, ".c3d") and not path.is_dir():
        try:
            check_file(path, MOST_BYTES)
        except OSError as error:
            raise TableError(Place(path), f"cannot be read: {error.strerror}") from None
    if path.is_dir() or path.suffix.lower() in BAGS:
        return read_bag(path)
    if path.suffix.lower() == ".c3d":
        return read_c3d(path)
    try:
        if path.suffix.lower() not in SUFFIXES and (first := next(iter(text_lines(path)), "").lstrip("\ufeff").strip()):
            for form, read in FORMATS:
                if form.match(first):
                    return read(path)
            if first.startswith("#BEGIN") or "DIAEXTENDED" in first.upper() or "DIADEM" in first.upper():
                return [_trace(path)]
        return markers(of_corners(read_table_source(path)))
    except csv.Error as error:
        raise TableError(Place(path), f"is not CSV: {error}") from None


CHANNEL = re.compile(r"#BEGINCHANNELHEADER(.*?)#ENDCHANNELHEADER", re.DOTALL)


def _trace(path: Path) -> SourceTable:
    """Return a trace of a KUKA controller: a DIAdem header (.dat) whose channels lie side by side in a .r64 beside it.

    Of each channel, 200 is the name, 202 the unit, 210 IMPLICIT for a time that is only counted, 211 the file, 213
    BLOCK or CHANNEL, 214 the type, 220 the number of values, 221 the place of the first, 240 and 241 offset and factor
    (National Instruments, "DAT header format").
    """
    channels = [
        {key.strip(): value.strip() for key, _, value in (line.partition(",") for line in match[1].splitlines())}
        for match in CHANNEL.finditer("".join(text_lines(path)))
    ]
    stored = [channel for channel in channels if channel.get("210", "EXPLICIT").upper().startswith("EXP")]
    try:
        columns: dict[str, Array] = {}
        for number, channel in zip(count(), channels, strict=False):
            name, size = channel.get("200") or f"channel {number + 1}", int(channel["220"])
            offset, factor = float(channel.get("240") or 0.0), float(channel.get("241") or 1.0)
            if size <= 0:
                raise TableError(Place(path), f"channel {name!r} has {size} values")
            if channel in stored:
                if channel.get("214", "REAL64").upper() != "REAL64":
                    raise TableError(Place(path), f"channel {name!r} is of type {channel['214']}, expected REAL64")
                data = np.frombuffer(read_file(path.parent / channel["211"], MOST_BYTES), dtype="<f8")
                block, place = channel.get("213", "BLOCK").upper() == "BLOCK", int(channel.get("221") or 1) - 1
                others = sum(other.get("211") == channel["211"] for other in stored)
                values = data[place:][: size * others : others] if block else data[place : place + size]
            else:
                values = np.arange(size, dtype=float)
            unit = channel.get("202", "").replace("°", "deg").strip("[]")
            columns[f"{name} [{unit}]" if unit else name] = offset + factor * values
    except (KeyError, ValueError) as error:
        raise TableError(Place(path), f"a channel's header lacks or spoils {error}") from None
    except OSError as error:
        raise TableError(Place(path), f"its values cannot be read: {error.strerror}: {error.filename}") from None
    if not columns or len({len(values) for values in columns.values()}) != 1:
        raise TableError(Place(path), "has no channels, or channels of different length")
    return recorded(path, "", columns)
