"""Times of rows: numbers in any unit, stamps, a clock's hours and minutes; a unit that is stated nowhere."""

import re
from collections.abc import Sequence
from datetime import UTC, datetime

import numpy as np

from armflex.conventions import Array
from armflex.errors import shown
from armflex.intake.meanings import BY_SIZE, DAYS, EITHER, TIME_UNITS, UNTIL
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

MONTHS = tuple(
    re.compile(stems, re.IGNORECASE)
    for stems in ("jan|ene|gen", "feb|f[eé]v", "mar|mär|mrz", "apr|avr|abr", "ma[iygj]|mei", "jun|juin|giu",
                  "jul|juil|lug", "aug|ao[uû]|ago", "sep|set", "o[ck]t|ott|out", "nov", "d[eéi][cz]")
)  # fmt: skip
"""How the months begin in English, German, French, Spanish, Italian and Portuguese."""

MONTH, YEAR = r"(?P<month>[^\W\d_]{3,})\.?", r"(?P<year>\d{4}|\d\d)"
NAMED_DAYS = tuple(
    re.compile(rf"(?:\D*\s)?{day}")
    for day in (
        rf"(?P<day>\d{{1,2}})[\s.-]*(?:de )?{MONTH}[\s,-]*(?:de )?{YEAR}(?![\d:])(?P<clock>.*)",
        rf"{MONTH}\s*(?P<day>\d{{1,2}}),?\s+{YEAR}(?![\d:])(?P<clock>.*)",
        rf"{MONTH}\s*(?P<day>\d{{1,2}})\s+(?P<clock>\d.*)\s{YEAR}",
    )
)
"""A day whose month is a word: 12-Mar-2024 10:00, Mar 12, 2024 10:00, Tue Mar 12 10:00:00 2024."""

STOPWATCH = re.compile(r"(\d+):(\d{1,2}[.,]\d+)")
"""Minutes and seconds."""

FIRST_DAY = 25569.0 * 86400.0
"""From the day that spreadsheets count from to 1970 [s]."""

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
        seconds = values * TIME_UNITS[meaning.unit or "s"] - (FIRST_DAY if meaning.why == DAYS else 0.0)
        if "fraction" in of_name:
            part, column = of_name["fraction"]
            seconds = seconds + numbers(column) * TIME_UNITS[part.unit or "s"]
        return seconds
    if not (orders := _orders(_texts(record))):
        return None
    seconds = min(orders, key=np.ptp)
    if seconds.max() < 86400.0:  # a clock without a day, past midnight
        seconds = seconds + 86400.0 * np.cumsum(np.diff(seconds, prepend=seconds[:1]) < -43200.0)
    return seconds


def _texts(record: Record) -> list[str]:
    """Return (N,) cells of a clock, the days beside them first."""
    of_name = {meaning.name: cells for meaning, cells in record.of("time")}
    days = of_name.get("date", [""] * len(of_name["time"]))
    return [f"{day} {cell}".strip() for day, cell in zip(days, of_name["time"], strict=True)]


def _orders(texts: Sequence[str]) -> list[Array]:
    """Return (N,) times [s] that texts say, with day before month and month before day, as far as all can be read.

    That of the country where clocks count to twelve is first where theirs does.
    """
    ways = (False, True) if any("/" in text for text in texts[:1]) else (False,)
    orders = [[_seconds(text, american) for text in texts] for american in ways]
    if any(text.rstrip().lower().endswith("m") for text in texts[:1]):
        orders.reverse()
    return [np.array(seconds, dtype=float) for seconds in orders if None not in seconds]


def unread(record: Record) -> str:
    """Return what is wrong with a column of times: a cell is none that is known, or is another day in America."""
    clock = next((meaning for meaning, _ in record.of("time") if meaning.name == "time"), None)
    if clock is None or np.isfinite(numbers(record.columns[record.header.index(clock.column)])).any():
        return ""
    texts = _texts(record)
    if not (orders := _orders(texts)):
        text = next((text for text in texts if _seconds(text, False) is None), texts[0])
        return f"{clock.column!r} has {shown(text, 30)}, which is no time that is known"
    spans = [float(np.ptp(seconds)) for seconds in orders]
    if len(orders) < 2 or spans[0] != spans[1] or orders[0][0] == orders[1][0] or texts[0].lower().endswith("m"):
        return ""
    day, other = (datetime.fromtimestamp(float(seconds[0]), UTC).date() for seconds in orders)
    return f"{shown(texts[0], 30)} is taken as {day}, and may be {other}: write days as 2024-12-31"


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
    """Return the row at which a clock is set back, None where (N,) times [s] run on, or down all the way.

    Of (N, d) values the first is read in all rows that count; other rows are of other topics.
    """
    rows = np.flatnonzero(np.isfinite(values[:, 0]))
    steps = np.diff(time[rows])
    back = np.flatnonzero(steps < -DENSE)
    return int(rows[back[0] + 1]) if len(back) and len(back) < 0.5 * len(steps) else None


def _seconds(text: str, american: bool) -> float | None:
    """Return the time that a text says [s], of a clock without a day since midnight; an American month is first."""
    try:
        date = datetime.fromisoformat(text)
        return (date if date.tzinfo else date.replace(tzinfo=UTC)).timestamp()
    except ValueError:
        match = CLOCK.fullmatch(text)
    if ran := STOPWATCH.fullmatch(text):
        return 60.0 * int(ran[1]) + float(ran[2].replace(",", "."))
    if named := next(filter(None, (pattern.fullmatch(text) for pattern in NAMED_DAYS)), None):
        month = next((n for n, stems in enumerate(MONTHS, 1) if stems.match(named["month"])), 0)
        match = CLOCK.fullmatch(f"{named['day']}.{month}.{named['year']} {named['clock']}")
    if match is None:
        return None
    first, mark, second, third, hours, minutes, seconds, half = match.groups()
    day = 0.0
    if first:
        year, month, date = int(third), int(second), int(first)
        if len(first) == 4:
            year, date = int(first), int(third)
        elif mark == "/" and american:
            month, date = date, month
        try:
            day = datetime(year + 2000 * (year < 100), month, date, tzinfo=UTC).timestamp()
        except ValueError:
            return None
    hour = int(hours) % 12 + 12 * (half.lower() == "pm") if half else int(hours)
    return day + 3600.0 * hour + 60.0 * int(minutes) + float(re.sub("[,:]", ".", seconds or "0"))
