"""What each column of a file is: a joint, a coordinate, a name, a time, or something else that is kept."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from armflex.conventions import UNITS
from armflex.intake.sources import Cells, Source, numbers
from armflex.measured.points import LENGTHS

Ask = Callable[[str, Sequence[str]], str]
"""Asks a question with its possible answers, where somebody is there to answer."""

TURN = 2.2 * np.pi
"""Tolerance: position [rad] of a joint beyond which it is none: controllers count one turn either way at most."""

UR = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")

JOINTS: tuple[tuple[str, str], ...] = (
    (r"q_(?P<name>\w+)", "rad"),
    (r"(?:actual|target)_q_(?P<ur>[0-5])", "rad"),
    (r"\$?axis_act(?:_meas)?[._ ]?(?P<name>[ae][1-6])", "deg"),
    (r"(?:/?joint_states?[./])?position[._\[](?P<name>\w+?)\]?", "rad"),
    (r"(?:.*/)?joint_states?/(?P<name>\w+)/position", "rad"),
    (r"axispos_(?:act|cmd)_?(?P<kuka>[1-6])", ""),
    (r"(?P<name>rax_[1-6])", "deg"),
    (r"(?P<name>(?:j|a|axis|joint|achse|gelenk)[ _.]?[1-9])(?:[ _.](?:act|actual|pos|ist))?", ""),
)
"""Patterns of a joint's column, and the unit that their controller writes; '' where people write either."""

COMMANDED = re.compile(r"target|command|cmd|set ?point|soll|desired", re.IGNORECASE)
"""In the name of a column beside one of the same joint that says where it is."""

NAMES = (
    r"(?:(?:point|punkt|target|object|feature|element)?[ _-]?(?:name|id)"
    r"|(?:point|(?:mess)?punkt)[ _-]?(?:no|nr|number|nummer)"
    r"|point|(?:mess)?punkt(?:name)?|pose|pt|feature|merkmal|element)"
)
TIMES = (
    r"(?:_*time(?:[ _]?stamp)?|(?:_*time[ _]?)?stamp|elapsed(?:[ _]?time)?|zeit(?:stempel)?|uhrzeit"
    r"|date(?: ?time)?|datum|heure|t)"
)
TIME_UNITS = {
    **UNITS["time"],
    **dict.fromkeys(("sec", "secs", "second", "seconds"), 1.0),
    **dict.fromkeys(("msec", "msecs", "millisecond", "milliseconds"), 1e-3),
    **dict.fromkeys(("us", "µs", "μs", "usec", "usecs", "microsecond", "microseconds"), 1e-6),
    **dict.fromkeys(("ns", "nsec", "nsecs", "nanosec", "nanosecs", "nanosecond", "nanoseconds"), 1e-9),
}
PART = re.compile(r"(?P<base>(?:.*[._/ \[]|tv_?)?)(?P<unit>[a-zµμ]+)\]?", re.IGNORECASE)
"""Seconds, and what is beyond them in a column of its own: `header.stamp.sec` and `header.stamp.nanosec`."""

COORDINATE = (
    r"(?:(?:pos(?:ition)?|actual|meas(?:ured)?|ist|mess\w*|mesur\w*)[ _.-])?(?P<axis>[xyz])"
    r"(?:[ _.-]?(?:coord\w*|act\w*|meas\w*|mess\w*|mesur\w*|ist|wert))?"
)
OF_MESSAGE = r".*(?:position|translation|point)[./](?P<axis>[xyz])"
"""Coordinate in a column of a tool for bags: messages of ROS are in m."""

STAMPS = ((1e17, "ns"), (1e14, "us"), (1e11, "ms"))
"""Times beyond these are since 1970, in this unit."""
BY_SIZE = "its size"
DAY = re.compile(r"\d{1,4}[./-]\d{1,2}[./-]\d{1,4}$")
KEPT = ("payload", "session")
PICTURE = r"(?:picture|image|photo|foto|bild)(?:[ _]?(?:file|name|path))?"
TURN_OF = r"(?:(?:.*(?:orientation|rotation)[./])|q(?:uat\w*)?[ _]?)(?P<axis>[xyzw])"
"""Part of a quaternion."""

BRACKETS = re.compile(r"(.*?)\s*[\[(]\s*([^\])]*?)\s*[\])]\s*")


COUNTS = "counts the rows"


@dataclass(frozen=True)
class Meaning:
    """What one column is.

    Attributes:
        column: Its name in the file.
        kind: "joint", "coordinate", "turn", "picture", "name", "time", "kept", "covariate" or "unused".
        name: Of the joint or the axis, or the column of a campaign.
        unit: As in a header's suffix; '' for texts and clocks, None where it is open.
        why: Where that is known from.
    """

    column: str
    kind: str
    name: str
    unit: str | None
    why: str


def meanings(source: Source, taken: Mapping[str, str]) -> tuple[Meaning, ...]:
    """Return what every column of a file is.

    Args:
        source: The file.
        taken: What the caller says columns are, by their name: `q_J1_deg`, `x_mm`, `pose`, `time`.
    """
    comment = next(filter(None, (_unit_of_comment(one) for one in source.comments)), None)
    found, parts = [], _parts_of_time(source)
    for header, cells in zip(source.header, source.columns, strict=True):
        own = taken.get(header)
        found.append(parts.get(header) if own is None else None)
        found[-1] = found[-1] or _meaning(own or header, header, cells, comment, own is not None)
    if any((one.kind, one.name) == ("time", "time") and one.column not in parts for one in found):
        found = [replace(one, kind="unused", why="another is the time") if one.column in parts else one
                 for one in found]  # fmt: skip
    asked = {(one.kind, one.name) for one in found if one.column in taken}
    found = [
        replace(one, kind="unused", why="another is, as asked")
        if (one.kind, one.name) in asked and one.column not in taken
        else one
        for one in found
    ]
    clocks = [i for i, one in enumerate(found) if one.kind == "time" and ":" in str(source.columns[i][0])]
    if len(clocks) == 1:  # a day in a column of its own
        found = [
            replace(one, name="date")
            if one.kind == "time" and i not in clocks and DAY.match(str(source.columns[i][0]))
            else one
            for i, one in enumerate(found)
        ]
    for i, one in enumerate(found):
        values = numbers(source.columns[i]) if one.kind == "covariate" else np.zeros(0)
        if len(values) > 2 and (np.diff(values) == 1.0).all():
            kinds = {other.kind for other in found}  # of a log without names
            own = {"kind": "name", "name": "pose"} if "joint" in kinds and "name" not in kinds else {"kind": "unused"}
            found[i] = replace(one, **own, unit="", why=COUNTS)
    axes = {one.name for one in found if one.kind == "coordinate"}
    if axes != {"x", "y", "z"}:  # an X of something else
        found = [Meaning(one.column, "covariate", one.column, "", "a number") if one.kind == "coordinate" else one
                 for one in found]  # fmt: skip
    for i, one in enumerate(found):  # where a joint is, beside where it was to be
        twin = [other for other in found if (other.kind, other.name) == ("joint", one.name) and other is not one]
        if one.kind == "joint" and COMMANDED.search(one.column) and any(not COMMANDED.search(o.column) for o in twin):
            found[i] = replace(one, kind="unused", unit="", why="commanded, and the position is there as well")
    # One joint beyond a turn shows the unit of all.
    sizes = [
        float(np.nanmax(np.abs(values)))
        for one, cells in zip(found, source.columns, strict=True)
        if one.kind == "joint" and one.unit is None and np.isfinite(values := numbers(cells)).any()
    ]
    if sizes and max(sizes) > TURN:
        why = f"a value of {max(sizes):.4g} is no angle in rad"
        found = [
            Meaning(one.column, one.kind, one.name, "deg", why) if one.kind == "joint" and one.unit is None else one
            for one in found
        ]
    return tuple(found)


def _parts_of_time(source: Source) -> dict[str, Meaning]:
    """Return what columns are that have whole seconds and the rest of them: the first such pair."""
    matches = {name: match for name in source.header if (match := PART.fullmatch(name.strip()))}
    sizes = {name: TIME_UNITS.get(match["unit"].lower(), 0.0) for name, match in matches.items()}
    cells = dict(zip(source.header, source.columns, strict=True))
    for whole in (name for name, size in sizes.items() if size == 1.0):
        base = matches[whole]["base"]
        for rest in (name for name, size in sizes.items() if 0.0 < size < 1.0 and matches[name]["base"] == base):
            seconds, beyond = numbers(cells[whole]), numbers(cells[rest]) * sizes[rest]
            if (seconds == np.round(seconds)).all() and ((beyond >= 0.0) & (beyond <= 1.0)).all():
                why = f"{whole} and {rest} are one clock"
                return {
                    whole: Meaning(whole, "time", "time", "s", why),
                    rest: Meaning(rest, "time", "fraction", matches[rest]["unit"].lower(), why),
                }
    return {}


def _meaning(text: str, header: str, cells: Cells, comment: str | None, asked: bool) -> Meaning:
    text, unit = text.strip(), None
    if match := BRACKETS.fullmatch(text):
        text, unit = match[1], match[2].lower().replace("°", "deg")
    elif "_" in text and text.rpartition("_")[2].lower() in {*LENGTHS, *UNITS["angle"], *TIME_UNITS}:
        base, _, last = text.rpartition("_")
        text, unit = (base, last.lower()) if len(base) > 0 else (text, None)
    word, why = text.strip().lower(), "as asked" if asked else "its name"
    in_header = "as asked" if asked else "its header"
    for pattern, usual in JOINTS:
        if match := re.fullmatch(pattern, word):
            parts = match.groupdict()
            if parts.get("ur"):
                name = f"{UR[int(parts['ur'])]}_joint"
            else:
                name = f"A{parts['kuka']}" if parts.get("kuka") else text[match.start("name") : match.end("name")]
            if unit in {"degree", "degrees", "grad"}:
                unit = "deg"
            given = unit in UNITS["angle"] or unit in LENGTHS
            known = unit if given else usual or None
            reason = in_header if given else "as this controller writes it" if usual else why
            return Meaning(header, "joint", name.replace(" ", "_").replace(".", "_"), known, reason)
    if match := re.fullmatch(COORDINATE, word):
        known = unit if unit in LENGTHS else comment
        return Meaning(header, "coordinate", match["axis"], known, in_header if unit in LENGTHS else "a comment")
    if match := re.fullmatch(OF_MESSAGE, word):
        return Meaning(header, "coordinate", match["axis"], "m", "as ROS has it")
    if re.fullmatch(PICTURE, header.strip().lower()) and not isinstance(cells, np.ndarray) and "." in str(cells[0]):
        return Meaning(header, "picture", text if asked else "cam", "", why)
    if match := re.fullmatch(TURN_OF, word):
        return Meaning(header, "turn", f"q{match['axis']}", "", why)
    if re.fullmatch(NAMES, word):
        return Meaning(header, "name", "pose", "", why)
    if re.fullmatch(TIMES, word):
        largest = np.nanmax(values) if np.isfinite(values := numbers(cells)).any() else 0.0
        stamp = next((name for least, name in STAMPS if largest > least), "")
        known = unit if unit in TIME_UNITS else stamp
        return Meaning(header, "time", "time", known, in_header if unit else BY_SIZE if stamp else why)
    if word in KEPT:
        return Meaning(header, "kept", word, "", why)
    return Meaning(header, "covariate", re.sub(r"\W+", "_", header).strip("_") or "column", "", "nothing else")


def _unit_of_comment(text: str) -> str | None:
    """Return the length unit that a comment or a title states: 'Units: Millimeters', 'Einheiten;mm', 'all in mm'."""
    words = r"(?:units?|einheit(?:en)?|unit[eé]s?)\b(?:[^:=]*[:=])?|\blength\b[^:=]*[:=]|\bin(?= (?:mm|met|mill))"
    found = (match[1].lower() for match in re.finditer(rf"(?:{words})\W*([^\W\d_]+)", text, re.IGNORECASE))
    return next((unit for unit in found if unit in LENGTHS), None)
