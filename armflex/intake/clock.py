"""Times of rows: numbers in any unit, stamps, a clock's hours and minutes; a unit that is stated nowhere."""

import re
from datetime import UTC, datetime

import numpy as np

from armflex.conventions import Array
from armflex.errors import shown
from armflex.intake.meanings import BY_SIZE, EITHER, TIME_UNITS, UNTIL
from armflex.intake.record import Record
from armflex.intake.sources import numbers
from armflex.intake.streams import DENSE, SLOWEST, is_sampled, spread

CLOCK = re.compile(
    r"(?:(\d{1,4})([./-])(\d{1,2})[./-](\d{2,4}))?[ T,]*(\d{1,2}):(\d{1,2})(?::(\d{1,2}(?:[.,]\d+|:\d{3,})?))?"
    r"\s*([ap]m)?\D*",
    re.IGNORECASE,
)
"""A clock's time, after a day or without one; two digits after a third colon are frames, and not said is how many are a
second."""

STOPWATCH = re.compile(r"(\d+):(\d{1,2}[.,]\d+)")
"""Minutes and seconds."""

LONGEST = 7.0 * 86400.0
"""Tolerance: no recording lasts longer [s]."""

FASTEST = 1e-4
"""Tolerance: no controller logs its joints more often [s]."""

COUNTED = ("ms", "us", "ns")
"""Units that a clock may count without saying so, each where the next larger one would be beyond `DENSE`."""


def times(record: Record) -> Array | None:
    """Return (N,) times [s]: numbers, stamps, or a clock's with the day beside it; None where none can be read."""
    of_name = {meaning.name: (meaning, cells) for meaning, cells in record.of("time")}
    if "time" not in of_name:
        return None
    meaning, cells = of_name["time"]
    if np.isfinite(values := numbers(cells)).any():
        seconds = values * TIME_UNITS[meaning.unit or "s"]
        if "fraction" in of_name:
            part, column = of_name["fraction"]
            seconds = seconds + numbers(column) * TIME_UNITS[part.unit or "s"]
        return seconds
    days = of_name["date"][1] if "date" in of_name else [""] * len(cells)
    read = [_seconds(f"{day} {cell}".strip()) for day, cell in zip(days, cells, strict=True)]
    if None in read:
        return None
    seconds = np.array(read, dtype=float)
    if seconds.max() < 86400.0:  # a clock without a day, past midnight
        seconds += 86400.0 * np.cumsum(np.diff(seconds, prepend=seconds[:1]) < -43200.0)
    return seconds


def unread(record: Record) -> str:
    """Return which column of times has what is none that is known, and such a cell; '' where there is none."""
    of_name = {meaning.name: (meaning, cells) for meaning, cells in record.of("time")}
    if "time" not in of_name or times(record) is not None:
        return ""
    meaning, cells = of_name["time"]
    cell = next((str(cell) for cell in cells if _seconds(str(cell)) is None), str(cells[0]))
    return f"{meaning.column!r} has {shown(cell, 30)}, which is no time that is known"


def counted(record: Record, moved: Array, unit: str) -> Record:
    """Return a file with the unit in which its clock counts, where that is stated nowhere.

    Steps of 20 are 20 s between poses, or 20 ms between samples of a motion: in the latter the arm stands for many
    rows, and moves over several.

    Args:
        record: The file.
        moved: (N, d) what moves in it, in `unit`.
        unit: "rad" or "m".
    """
    clock, cells = next(((one, cells) for one, cells in record.of("time") if one.name == "time"), (None, ()))
    written = numbers(cells)
    if clock is None or (clock.unit and clock.why != BY_SIZE) or not np.isfinite(written).any():
        return record
    raw = spread(written)
    steps = np.abs(np.diff(raw[np.isfinite(raw)]))
    step = float(np.median(steps)) if len(steps) else 0.0
    if step * TIME_UNITS[clock.unit or "s"] <= DENSE:
        return record
    for name in COUNTED:
        if np.nanmax(raw) * TIME_UNITS[name] > UNTIL:
            continue
        if DENSE < step <= DENSE / TIME_UNITS[name] and is_sampled(raw * TIME_UNITS[name], moved, unit):
            return record.where(lambda one: one is clock, unit=name, why=f"steps of {step:.4g}: samples of a motion")
    whole = np.array_equal(written, np.round(written))  # it counts
    if whole and step * TIME_UNITS["cs"] <= DENSE and is_sampled(raw * TIME_UNITS["cs"], moved, unit):
        return record.where(lambda one: one is clock, unit=None)
    return record


def doubt(record: Record) -> str:
    """Return why the times of a file are of no clock that is known, as its unit is stated nowhere."""
    clock, time = next((one for one, _ in record.of("time") if one.name == "time"), None), times(record)
    if clock is None or time is None or not (read := np.isfinite(time)).any():
        return ""
    if clock.why == EITHER:
        text = f"is {EITHER}: --take '{clock.column}=time_s' or '{clock.column}=temperature'"
        return f"{record.path}: {clock.column!r} {text}"
    if clock.unit is None:
        text = f"counts seconds, or hundredths of one: --take '{clock.column}=time_s' or '{clock.column}=time_cs'"
        return f"{record.path}: {clock.column!r} {text}"
    steps = np.diff(np.unique(time[read]))
    step, last = float(np.median(steps)) if len(steps) else 1.0, float(time[read].max())
    if step <= SLOWEST and (lasts := float(np.ptp(time[read]))) > LONGEST:
        text = f"goes over {lasts / 86400.0:.4g} days in steps of {step:.3g} s"
        return f"{record.path}: {clock.column!r} {text}: are all of one clock?"
    if clock.unit or (last <= UNTIL and step >= FASTEST):
        return ""
    text = f"is {last:.6g}, no time since 1970 in any unit" if last > UNTIL else f"has steps of {step:.3g} s"
    return f"{record.path}: {clock.column!r} {text}: convert it to s, or --take '{clock.column}=time_ms' says its unit"


def goes_back(time: Array, values: Array) -> int | None:
    """Return the row at which a clock is set back, None where it runs on, or down all the way.

    Args:
        time: (N,) [s], as written.
        values: (N, d) of which the first is read in all rows that count; other rows are of other topics.
    """
    rows = np.flatnonzero(np.isfinite(values[:, 0]))
    steps = np.diff(time[rows])
    back = np.flatnonzero(steps < -DENSE)
    return int(rows[back[0] + 1]) if len(back) and len(back) < 0.5 * len(steps) else None


def _seconds(text: str) -> float | None:
    """Return the time that a text says [s]; of a clock without a day since midnight."""
    try:
        date = datetime.fromisoformat(text)
        return (date if date.tzinfo else date.replace(tzinfo=UTC)).timestamp()
    except ValueError:
        match = CLOCK.fullmatch(text)
    if ran := STOPWATCH.fullmatch(text):
        return 60.0 * int(ran[1]) + float(ran[2].replace(",", "."))
    if match is None:
        return None
    first, mark, second, third, hours, minutes, seconds, half = match.groups()
    day = 0.0
    if first:
        year, month, date = int(third), int(second), int(first)
        if len(first) == 4:
            year, date = int(first), int(third)
        elif mark == "/" and (half or month > 12):  # as in America
            month, date = date, month
        try:
            day = datetime(year + 2000 * (year < 100), month, date, tzinfo=UTC).timestamp()
        except ValueError:
            return None
    hour = int(hours) % 12 + 12 * (half.lower() == "pm") if half else int(hours)
    return day + 3600.0 * hour + 60.0 * int(minutes) + float(re.sub("[,:]", ".", seconds or "0"))
