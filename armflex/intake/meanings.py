"""What each column of a file is: a joint, a coordinate, a name, a time, or something else that is kept."""

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from armflex.conventions import NUMBER, UNITS
from armflex.intake.sources import Cells, SourceTable, numbers
from armflex.measured.lost_places import lost
from armflex.measured.orientation_names import QUATERNIONS, ROUNDED, by_stem, ends
from armflex.measured.points import LENGTHS

Ask = Callable[[str, Sequence[str]], str]
"""Asks a question with its possible answers, where somebody is there to answer."""

TURN = 2.2 * np.pi
"""Tolerance: position [rad] of a joint beyond which it is none: controllers count one turn either way at most."""

UR = tuple(f"{name}_joint" for name in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"))

SETS = tuple(
    (tuple(words.split()), names)
    for words, names in (
        ("S L E U R B T", tuple("SLEURBT")),
        ("S L U R B T", tuple("SLURBT")),
        ("base shoulder elbow wrist1 wrist2 wrist3", UR),
        ("E N U", tuple("xyz")),
        ("rechtswert hochwert höhe", tuple("xyz")),
        *((f"east{s} north{s} {up}", tuple("xyz")) for s in ("", "ing") for up in ("up", "elevation", "height")),
    )
)
"""Words -> what they are called where all of a set stand, as alone they may be anything: T is a temperature, or a time.

Joints of Yaskawa and Universal Robots, base to tip, and places to the east, north and up.
"""

ANOTHER = (
    r"(?:tau|torques?|efforts?|moments?|loads?|forces?|currents?|amps?|voltages?|power|pwm|temp\w*|speeds?"
    r"|vel\w*|d?q?d|acc\w*|err\w*|dev\w*|delta|diff|lag|limits?|lower|upper|min|max|state|status|mode|brakes?|cmd"
    r"|command\w*|targets?|set\w*|desired|soll|ref\w*)"
)
"""What is no position of a joint in the name of a column: a torque, a temperature, a command."""

OF_ANOTHER = rf"(?!(?:\w*[\W_])?{ANOTHER}[\W_])"
"""What does not stand before the name of a joint in the column of its position."""

WHERE = r"(?:winkel|position|stellung|wert)"
SHORT = (
    rf"(?:jt?|a|q|ax|axis|axe|joint|achs(?:e|{WHERE})|gelenk{WHERE}?|articula\w*|eje|junta|asse|giunto|軸|轴|关节|関節"
    r"|theta|th|θ)"
)
"""How joints are called that are only numbered."""

PLACED_WORD = (
    rf"(?:act(?:ual)?|ist[ -]?{WHERE}?|pos(?:ition)?|angle|angolo|[áa]ngulo|{WHERE}|meas(?:ured)?|mess{WHERE}?"
    r"|mes(?:ur[ée]e?)?|misurat[ao]|medid[ao]|gemessen|gemeten|r[ée]el(?:le)?)"
)
UR_COLUMN = r"(?:actual|target)_q_?\[?(?P<ur>[0-5])\]?"
"""Of Universal Robots' RTDE, which counts from 0."""

JOINTS: tuple[tuple[str, str], ...] = (
    (r"q_(?P<name>.*\S)", "rad"),
    (UR_COLUMN, "rad"),
    (r"\$?(?:axis_act(?:_meas)?|aipos)[._ ]?(?P<short>a[1-6])", "deg"),
    (r"\$?(?:axis_act(?:_meas)?|aipos)[._ ]?(?P<outer>e[1-6])", ""),
    (r"(?:/?joint_states?[./])?position(?:[._](?P<name>.*\S)|\[(?P<listed>[^\[\]]+)\])", "rad"),
    (r"(?:.*/)?joint_states?/(?P<name>.+)/position", "rad"),
    (r"axispos_(?:act|cmd)_?(?P<kuka>[1-6])", ""),
    (rf"(?:{OF_ANOTHER}\w+\.)*(?P<short>rax_[1-6])", "deg"),
    (r"(?:q|posj|jpos|joints?)\[(?P<listed>\d+)\]", ""),
    (
        rf"(?:{OF_ANOTHER}(?!{SHORT}[ _]?\d+\.)\w+\.)?(?:{PLACED_WORD}[ _.-])?"
        rf"(?P<short>{SHORT}[ _.]?\d{{1,2}})(?:[ _.]{PLACED_WORD})?",
        "",
    ),
    (rf"{OF_ANOTHER}(?P<name>(?:[^\W\d]\w*_)?joint_?[a-z]?\d{{1,2}})(?:[ _.]{PLACED_WORD})?", ""),
)
"""Patterns of a joint's column, and the unit that their controller writes; '' where people write either.

`name` and `listed` are the joint's as a robot's file may have it, `short` as a controller numbers it, `outer` one
beside the arm's own: a rail or a table, in mm or degrees as its builder chose.
"""

PLACED = rf"(?:{PLACED_WORD}[ _])?"
"""What may stand beside a joint's own name in the column of its position."""

PART_OF_TURN = re.compile(r"q[ .]?\d", re.IGNORECASE)

WITHIN = r"\bin(?= (?:mm|met|mill|deg|rad|mrad|gon)\w*\b(?!\s*/))"
OF_SPEED = re.compile(r"/\s*s|veloc|speed|accel|orient|\btool|\btcp|rotation", re.IGNORECASE)
"""In a comment whose unit is of something else than places and joints."""

RECORDED = "position."
"""Before a joint's name in a column of a recording."""

COMMANDED = re.compile(
    r"(?:target|command(?:ed)?|cmd|set(?:[ _]?p(?:oint|os(?:ition)?))?|soll|des(?:ired)?|d|consigne|demand(?:ed)?|goal"
    r"|ref(?:erence)?|nom(?:inal)?|planned|request(?:ed)?)",
    re.IGNORECASE,
)
"""A word in the name of a column beside one of the same joint that says where it is."""

WORDS = re.compile(r"[^\W\d_]+|\d+")
"""Words and numbers of a name."""

NAMES = (
    r"(?:(?:point|punkt|target|object|feature|element)?[ _-]?(?:name|id)"
    r"|(?:point|(?:mess)?punkt)[ _-]?(?:no|nr|number|nummer)"
    r"|point|(?:mess)?punkt(?:name)?|pose|pt|feature|merkmal|element)"
)
TIMES = (
    r"(?:_*time(?:[ _]?stamp)?|(?:_*time[ _]?)?stamp|elapsed(?:[ _]?time)?|zeit(?:stempel)?|uhrzeit|clock"
    r"|heure|hora|ora|ts?)"
)
DATES = r"(?:date|datum|fecha|data)(?: ?(?:time|(?:et|y|e|und|[/,&])? ?(?:heure|hora|ora|(?:uhr)?zeit)))?"
OUTER = "an external axis"
EITHER = "a time or a temperature"
"""What a column `T` may be that is the only clock."""

TIME_UNITS = {
    **UNITS["time"],
    **dict.fromkeys(("minute", "minutes"), 60.0),
    **dict.fromkeys(("h", "hr", "hrs", "hour", "hours"), 3600.0),
    **dict.fromkeys(("d", "day", "days"), 86400.0),
    **dict.fromkeys(("sec", "secs", "second", "seconds"), 1.0),
    **dict.fromkeys(("cs", "centiseconds", "hundredths"), 1e-2),
    **dict.fromkeys(("msec", "msecs", "millisecond", "milliseconds"), 1e-3),
    **dict.fromkeys(("us", "µs", "μs", "usec", "usecs", "microsecond", "microseconds"), 1e-6),
    **dict.fromkeys(("ns", "nsec", "nsecs", "nanosec", "nanosecs", "nanosecond", "nanoseconds"), 1e-9),
}
ANGLE_UNITS = {
    **UNITS["angle"],
    **dict.fromkeys(("radian", "radians"), 1.0),
    **dict.fromkeys(("degree", "degrees", "degré", "degrés", "grados", "gradi", "度"), np.pi / 180.0),
    **dict.fromkeys(("ddeg", "decideg", "decidegrees"), np.pi / 1.8e3),
    **dict.fromkeys(("cdeg", "centideg", "centidegrees"), np.pi / 1.8e4),
    **dict.fromkeys(("mdeg", "millideg", "millidegrees"), np.pi / 1.8e5),
    **dict.fromkeys(("arcmin", "arcminutes"), np.pi / 10800.0),
    **dict.fromkeys(("arcsec", "arcseconds"), np.pi / 648000.0),
    **dict.fromkeys(("gon", "gradian", "gradians"), np.pi / 200.0),
    **dict.fromkeys(("rev", "revs", "revolution", "revolutions", "turn", "turns"), 2.0 * np.pi),
}
"""Names of units of angles as programs write them -> factor to rad; not `grad`, which some take for degrees."""

STEPS = re.compile(r"counts?|cts|ticks?|puls(?:es?)?|pls|incr?|increments?", re.IGNORECASE)
"""What encoders count: how many are a turn is stated nowhere."""

POLAR = (
    re.compile(r"hz(?:[ _.-]?(?:angle|winkel|kreis))?|hor(?:izontal|iz)?\.?[ _.-]?(?:angle|winkel|circle|direction)|ha"
               r"|horizontal\w*|az(?:i|imuth(?:al)?)?(?:[ _.-]?angle)?", re.IGNORECASE),
    re.compile(r"v|vz|va|v[ _.-]?(?:angle|winkel|kreis)|(?:ver(?:tical|t)?|zenith?)\.?(?:[ _.-]?(?:angle|winkel|circle"
               r"|distance))?|vertikal\w*|za|el(?:ev(?:ation)?)?(?:[ _.-]?angle)?", re.IGNORECASE),
    re.compile(r"d|sd|s|r|(?:slope|slant|schr[äa]g)[ _.-]?(?:dist(?:an[cz]e?)?\.?|strecke|range)|dist(?:an[cz]e?)?"
               r"|schrägstrecke|strecke|range|radius", re.IGNORECASE),
)  # fmt: skip
"""Headers of what total stations and trackers read themselves: two angles and a distance."""

OTHERS = {
    *(unit for kind in ("force", "moment", "acceleration", "frequency") for unit in UNITS[kind]),
    *("A", "mA", "V", "mV", "W", "C", "degC", "K", "rpm", "RPM", "1/min", "1/s", "kg", "bar", "Pa", "px"),
    *(f"{unit}/{time}" for unit in (*UNITS["angle"], *UNITS["length"]) for time in ("s", "s^2", "s2", "s²", "min")),
}
"""Units of what is no position and no time."""

REMARK = re.compile(
    r"(?:act|meas|ist\b|mess|pos\b|position|value|wert|abs|rel|world|welt|base|basis|tool|robot|axis|joint|filtered|mean"
    r"|utc|gmt|local|lokal|c?es?t\b|[hdmy]+[:./-]).*",
    re.IGNORECASE,
)
"""What stands in brackets behind a name and is no unit."""

PART = re.compile(r"(?P<base>(?:.*[._/ \[]|tv_?)?)(?P<unit>[a-zµμ]+)\]?", re.IGNORECASE)
"""Seconds, and what is beyond them in a column of its own: `header.stamp.sec` and `header.stamp.nanosec`."""

COORDINATE = (
    rf"(?:(?:coord\w*\.?|koord\w*|{PLACED_WORD})[ _.-]+)?(?P<axis>[xyz])(?:[ _.-]*(?:[ck]oord\w*|{PLACED_WORD}))?"
)
OF_MESSAGE = r".*(?:position|translation|point)[./](?P<axis>[xyz])"
"""Coordinate in a column of a tool for bags: messages of ROS are in m."""

SINCE_1970, UNTIL = 9e8, 4e9
"""Times [s] between these have a date, from 1998 to 2096: no other clock runs for 28 years."""
STAMPS = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""Units of what counts since 1970, known by its size."""
BY_SIZE = "its size"
DAY = re.compile(r"(?=\D*\d)(?:[^\W\d]{3,}|\d{1,4})(?:[\s.,/-]+(?:[^\W\d]{3,}|\d{1,4})\.?){2}$")
SPREADSHEET = (2e4, 8e4)
"""Days between these are from 1954 to 2119, counted from the end of 1899."""
DAYS = "days since 1900, as spreadsheets count"
KEPT = ("payload", "session")
PICTURE = r"(?:picture|image|photo|foto|bild)(?:[ _]?(?:file|name|path))?"
INTENDED = r"nom(?:inal|iell)?|soll\w*|theo(?:r\w*)?|cad|expected|desired|cmd|command(?:ed)?|ref(?:erence)?"
"""What stands beside the name of what was to be, and is not measured."""
OF_INTENDED = re.compile(rf"(?:.*[\W_])?(?:{INTENDED})(?:[\W_].*)?")
PARAMETERS = re.compile(r"[qe][ _.]?")
"""Before 0123 where they are w x y z: those of another name are places in a list."""

VECTOR, ANGLES = ("rx", "ry", "rz"), ("roll", "pitch", "yaw")
"""A rotation vector, which a header alone does not say; and angles about the fixed axes x, then y, then z."""

OPERATORS = re.compile(r"[-+*/^|()±×·−–&~'′]+|\s(?:plus|minus|mal|times|moins)\s", re.IGNORECASE)
FUNCTIONS = ("abs", "cos", "minus", "neg", "rad2deg", "deg2rad", "sin", "sum", "tan")
APPLIED = re.compile(rf"(?:{'|'.join(FUNCTIONS)})\s*\(.*\)", re.IGNORECASE)
"""How a column is written that is computed of joints: `A2+A3`, `J1*2`, `sin(J1)`."""

AMID = re.compile(rf"(?:.*[\W_])?{ANOTHER}(?:[\W_].*)?", re.IGNORECASE)
"""What is no position, wherever the word stands in a name."""

COUNTED = re.compile(r"\d+")
"""What stands in brackets at the end of a name that is counted so, `j[1]`, and is no unit."""

BRACKETS = re.compile(r"(.*?)\s*[\[(]\s*([^\])]*?)\s*[\])]\s*")

_SHORT, _LONG = ("|".join(sorted(map(re.escape, words), key=len, reverse=True))
                 for words in ({*LENGTHS, *ANGLE_UNITS, *TIME_UNITS} - {"h", "d"},
                               {*LENGTHS, *ANGLE_UNITS, *TIME_UNITS, "°", "grad"}))  # fmt: skip
BEHIND = re.compile(
    rf"(?P<base>.+?)(?:_(?P<short>{_SHORT})|(?:\s*[,/]\s*|\s+(?:in\s+)?)(?P<unit>{_LONG}))", re.IGNORECASE
)
"""A header with its unit behind it: `q_J1_deg`, `X / mm`, `Time, s`, `Z in mm`."""

COUNTS = "counts the rows"

CIRCUMSTANCE = re.compile(
    r".*(?:temp|mass|gewicht|weight|humid|feucht|press|druck|operator|bediener).*"
    r"|(?:.*[\W_])?(?:(?:pay)?load|\w*last)(?:[\W_].*)?",
    re.IGNORECASE,
)
"""Names of what an instrument's program, or a recording, has beside readings and may be a cause of the arm's errors."""


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

    def is_signal(self) -> bool:
        """Return whether it stands beside readings and is no cause of the arm's errors: by its name, if not asked."""
        return self.kind == "covariate" and self.why != "as asked" and not CIRCUMSTANCE.fullmatch(self.name)


def meanings(
    source: SourceTable,
    taken: Mapping[str, str],
    joints: Sequence[str] = (),
    slides_among: Callable[[Sequence[str]], Sequence[str] | None] = lambda _: None,
) -> tuple[Meaning, ...]:
    """Return what every column of a file is.

    Args:
        source: The file.
        taken: What the caller says columns are, by their name: `q_J1_deg`, `x_mm`, `pose`, `time`; `unused`.
        joints: Names of the robot's, where its file is there.
        slides_among: Returns those of the file's joints, by name, that are lengths; None where no file says it.
    """
    comments = stated(source)
    comment = comments[0] if len(comments) == 1 else None
    meant, parts, of_set = list[Meaning](), _parts_of_time(source), _of_set(source.header)
    cells_of = dict(zip(source.header, source.columns, strict=False))
    for header, cells in zip(source.header, source.columns, strict=True):
        given = taken.get(header)
        meaning = parts.get(header) if given is None else None
        if source.part and given is None and header.startswith(RECORDED):  # a message has names, and no units in them
            meaning = Meaning(header, "joint", header.removeprefix(RECORDED), "rad", "as ROS has it")
        text, called = of_set.get(header, (header, ()))
        meant.append(meaning or _meaning(given or text, header, cells, comment, given is not None, (*joints, *called)))
    meant = _one_clock(meant, parts)
    asked = {(meaning.kind, meaning.name) for meaning in meant if meaning.column in taken}
    twice = [
        meaning.column for meaning in meant if (meaning.kind, meaning.name) in asked and meaning.column not in taken
    ]
    meant = changed(meant, lambda meaning: meaning.column in twice, kind="unused", why="another is, as asked")
    clocks = [meaning for meaning in meant if meaning.kind == "time" and ":" in str(cells_of[meaning.column][0])]
    days = [meaning for meaning in meant if meaning.kind == "time" and DAY.match(str(cells_of[meaning.column][0]))]
    if len(clocks) == 1:  # a day in a column of its own
        meant = changed(meant, lambda meaning: meaning in days and meaning not in clocks, name="date")
    for i, meaning in enumerate(meant):
        values = numbers(source.columns[i]) if meaning.kind == "covariate" else np.zeros(0)
        about = not (CIRCUMSTANCE.fullmatch(meaning.name) or _with_unit(meaning.column)[1])
        if len(values) > 2 and about and (np.diff(values) == 1.0).all():
            kinds = {other.kind for other in meant}  # of a log without names
            role = {"kind": "name", "name": "pose"} if "joint" in kinds and "name" not in kinds else {"kind": "unused"}
            meant[i] = replace(meaning, **role, unit="", why=COUNTS)
    if {meaning.name for meaning in meant if meaning.kind == "coordinate"} != {"x", "y", "z"}:  # an X of something else
        meant = [_beside(meaning) if meaning.kind == "turn" else meaning for meaning in meant]
        for i, meaning in enumerate(meant):
            if meaning.kind == "coordinate":
                meant[i] = Meaning(meaning.column, "covariate", meaning.column, "", "a number")
    else:
        of_turn = [meaning for meaning in meant if meaning.kind == "joint" and PART_OF_TURN.fullmatch(meaning.column)]
        if len(of_turn) <= 4:  # beside a place q1 .. q4 are a quaternion, whatever its length
            meant = [_beside(meaning) if meaning in of_turn else meaning for meaning in meant]
        meant = _turned(source, meant)
    meant = _as_they_were(meant, joints)
    slides = slides_among([meaning.name for meaning in meant if meaning.kind == "joint"])
    return tuple(_with_angles(source, meant, joints, slides))


def changed(meant: Iterable[Meaning], which: Callable[[Meaning], bool], **changes: Any) -> list[Meaning]:
    """Return what columns are, with changes of those that `which` chooses."""
    return [replace(meaning, **changes) if which(meaning) else meaning for meaning in meant]


def _as_they_were(meant: Sequence[Meaning], joints: Sequence[str]) -> list[Meaning]:
    """Return what columns are where a joint's position stands beside where it was to be: `q_act_1`, `q_cmd_1`.

    What was commanded is not used, and the joint is called as without a word for what was measured.
    """
    placed, settled = re.compile(PLACED_WORD, re.IGNORECASE), list(meant)
    twins: dict[tuple[str, ...], dict[bool, list[int]]] = {}
    for i, meaning in enumerate(meant):
        if meaning.kind == "joint" and meaning.why != "as asked":
            words = WORDS.findall(meaning.column.lower() if meaning.why != "as ROS has it" else meaning.name.lower())
            commanded = meaning.name not in joints and any(map(COMMANDED.fullmatch, words))
            of_joint = [word for word in WORDS.findall(meaning.name.lower()) if not COMMANDED.fullmatch(word)]
            key = tuple(word for word in of_joint if not placed.fullmatch(word))
            twins.setdefault(key, {}).setdefault(commanded, []).append(i)
    for of in (of for key, of in twins.items() if key and len(of) == 2):
        for i in of[True]:
            settled[i] = replace(meant[i], kind="unused", unit="", why="commanded, and the position is there as well")
        for i in of[False] if len(of[False]) == 1 and meant[of[False][0]].name not in joints else ():
            name = re.sub(rf"^{PLACED_WORD}(?:[ _.-]|(?=\d))|[ _.-]{PLACED_WORD}$", "", meant[i].name, flags=re.I)
            settled[i] = replace(meant[i], name=name)
    return settled


def _beside(meaning: Meaning) -> Meaning:
    return replace(meaning, kind="covariate", name=_plain(meaning.column), unit="")


def _one_clock(meant: list[Meaning], parts: Mapping[str, Meaning]) -> list[Meaning]:
    """Return what columns are where several may be the time: not one in parts, nor a `T` or `ts`, beside another."""
    if any((meaning.kind, meaning.name) == ("time", "time") and meaning.column not in parts for meaning in meant):
        meant = changed(meant, lambda meaning: meaning.column in parts, kind="unused", why="another is the time")
    if sum((meaning.kind, meaning.name) == ("time", "time") for meaning in meant) > 1:
        meant = [
            replace(_beside(meaning), why="another is the time") if meaning.why == EITHER else meaning
            for meaning in meant
        ]
    times = [meaning for meaning in meant if (meaning.kind, meaning.name) == ("time", "time")]
    stamps = [meaning for meaning in times if _with_unit(meaning.column.strip())[0].lower() == "ts"]
    if 0 < len(stamps) < len(times):
        meant = changed(meant, stamps.__contains__, kind="unused", why="another is the time")
    return meant


def _with_angles(
    source: SourceTable, meant: list[Meaning], joints: Sequence[str], sliding: Sequence[str] | None
) -> list[Meaning]:
    """Return what columns are with units of external axes, and those of angles that a comment or a size shows."""
    slides = sliding or ()
    for i, meaning in enumerate(meant):
        if meaning.why == OUTER and meaning.unit is None and meaning.name in joints:
            meant[i] = replace(
                meaning, unit="mm" if meaning.name in slides else "deg", why="as this controller writes it"
            )
        elif meaning.why == OUTER and (numbers(source.columns[i]) == 0.0).all():
            meant[i] = replace(meaning, kind="unused", unit="", why="0 in every row: no axis is there")

    def is_open(meaning: Meaning) -> bool:
        return meaning.unit is None and meaning.name not in slides and meaning.why != OUTER

    # One joint beyond a turn shows the unit of all; where it may slide, all that move have to be.
    of_joints = [numbers(cells) for meaning, cells in zip(meant, source.columns, strict=True)
                 if meaning.kind == "joint" and is_open(meaning)]  # fmt: skip
    of_joints = [read for values in of_joints if len(read := values[np.isfinite(values)])]
    sizes = [float(np.abs(read).max()) for read in of_joints]
    angles = stated(source, ANGLE_UNITS)
    if len(angles) == 1 and max(sizes, default=0.0) * ANGLE_UNITS[angles[0]] <= TURN:
        return changed(
            meant,
            lambda meaning: meaning.kind in ("joint", "turn") and is_open(meaning),
            unit=angles[0],
            why="a comment",
        )
    if any(
        meaning.kind == "joint" and meaning.unit in ANGLE_UNITS and meaning.why == "its header" for meaning in meant
    ):
        return meant  # where others state an angle, one that states nothing may be a slide
    moving = [size for size, read in zip(sizes, of_joints, strict=True) if np.ptp(read) > 0.0]
    alike = sliding is not None or min(moving, default=np.inf) > TURN
    if sizes and TURN < max(sizes) <= np.degrees(TURN) and alike:  # beyond a turn in degrees it is neither
        why = f"a value of {max(sizes):.4g} is no angle in rad"
        return changed(meant, lambda meaning: meaning.kind == "joint" and is_open(meaning), unit="deg", why=why)
    return meant


def combined(
    source: SourceTable, meant: Sequence[Meaning], taken: Mapping[str, str], joints: Sequence[str]
) -> list[str]:
    """Return what is wrong with columns that are computed of joints, `A2+A3`, where one of them has no other column.

    What is `taken` is as for `meanings`; the joints are the robot's, where its file is there.
    """
    computed = dict[str, list[str]]()
    for meaning in meant:
        text = meaning.column.strip()
        text = text if APPLIED.fullmatch(text) else _with_unit(text)[0]
        parts = [_with_unit(part.strip().removeprefix("q_"))[0] for part in OPERATORS.split(text)]
        parts = [part for part in parts if part and not NUMBER.fullmatch(part) and part.lower() not in FUNCTIONS]
        named = [part for part in (_meaning(part, part, ("0",), None, False, joints) for part in parts)]
        asked = meaning.column in taken or meaning.column.startswith(RECORDED) or meaning.name in joints
        if OPERATORS.search(text) and named and all(part.kind == "joint" for part in named) and not asked:
            computed[meaning.column] = [part.name for part in named]
    there, wrong = (
        {meaning.name for meaning in meant if meaning.kind == "joint" and meaning.column not in computed},
        list[str](),
    )
    for column, names in computed.items() if not source.part else ():
        if missing := [name for name in names if name not in there]:
            text = f"{source.path}: column {column!r} is computed of joints, expected a column of {missing[0]} alone:"
            wrong.append(f"{text} compute that, or --take '{column}=unused' where no such joint is")
    rest = [meaning for meaning in meant if meaning.column not in (*computed, *taken)] if not source.part else []
    return wrong + [text for name, known in _missing(there, joints) for text in _stand_ins(source, rest, name, known)]


def _missing(there: Collection[str], joints: Sequence[str]) -> Iterator[tuple[str, Collection[str]]]:
    """Yield each joint that is not among some of an arm's, and the names of all of these: the robot's, or numbered."""
    if not set(joints).isdisjoint(there):
        yield from ((joint, joints) for joint in joints if joint not in there)
        return
    matches = [match for match in (re.fullmatch(r"(\D*)(\d{1,2})", name) for name in there) if match]
    for stem in dict.fromkeys(match[1] for match in matches):
        counted = {int(match[2]) for match in matches if match[1] == stem}
        series = [f"{stem}{n}" for n in range(len(counted) + 2)]
        yield from ((series[n], series) for n in range(1, len(series) - 1) if n not in counted and n + 1 in counted)


def _stand_ins(source: SourceTable, rest: Sequence[Meaning], name: str, known: Collection[str]) -> Iterator[str]:
    """Yield what is wrong with columns that have the name of a joint in theirs which has no column: `J2_J3_deg`."""
    stem, number = re.fullmatch(r"(.*?)(\d*)", name).groups()  # pyright: ignore[reportOptionalMemberAccess]
    numbered = rf"(?:{re.escape(stem)}|{SHORT})[ _.]?(?:\d[ _.]?)*{number}(?!\d)"
    inside = re.compile(rf"(?<![^\W\d_])(?:{numbered if number else re.escape(name)})", re.IGNORECASE)
    for meaning in rest:
        text, unit = _with_unit(meaning.column.strip())
        placed = unit is None or unit.lower() in ANGLE_UNITS | LENGTHS
        other = meaning.kind == "covariate" or (meaning.kind == "joint" and meaning.name not in known)
        if other and placed and inside.search(text) and not AMID.fullmatch(text):
            text = f"{source.path}: joint {name} has no column, and {meaning.column!r} may be it, or computed of it"
            remedy = f"--take '{meaning.column}=q_{name}_UNIT', or '{meaning.column}=unused' where no such joint is"
            yield f"{text}: {remedy}"


def polar(header: Sequence[str]) -> tuple[str, ...]:
    """Return which columns are two angles and a distance, as an instrument reads them; none where one is missing."""
    bare = {name: _with_unit(name.strip())[0].strip() for name in header}
    matches = [next((name for name, text in bare.items() if form.fullmatch(text)), "") for form in POLAR]
    return tuple(matches) if all(matches) and len(set(matches)) == len(POLAR) else ()


def _of_set(header: Sequence[str]) -> dict[str, tuple[str, tuple[str, ...]]]:
    """Return columns of whole sets of `SETS`, as those name them, and the name where it is a joint's."""
    bare = {name: _with_unit(name.strip())[0] for name in header}
    short = {name: re.sub(r"[ _.-]+(?:axis|achse)$|[ _.-]", "", text) for name, text in bare.items()}
    column = {text if len(text) == 1 else text.lower(): name for name, text in short.items()}
    called = dict[str, tuple[str, tuple[str, ...]]]()
    numbered = {name: match for name, text in bare.items() if (match := re.fullmatch(UR_COLUMN, text, re.I))}
    if all(match["ur"] != "0" for match in numbered.values()):  # of another program, which counts from 1
        called |= {name: (name.replace("_q", " q", 1), ()) for name in numbered}
    for words, names in SETS:
        if column.keys() >= {*words} and not called.keys() & {column[word] for word in words}:
            for at, name in zip((column[word] for word in words), names, strict=True):
                called[at] = at.replace(bare[at], name, 1), () if len(names) == 3 else (name,)
    return called


def _parts_of_time(source: SourceTable) -> dict[str, Meaning]:
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


def _with_unit(text: str) -> tuple[str, str | None]:
    """Return a header without its unit, and that: `J1 [deg]`, `X / mm`, `Time, s`, `Z in mm`, `q_J1_deg`.

    In brackets it may be none that is known.
    """
    if (match := BRACKETS.fullmatch(text)) and not COUNTED.fullmatch(match[2]):
        return match[1], None if REMARK.fullmatch(match[2]) else named_unit(match[2])
    if match := BEHIND.fullmatch(text):
        return match["base"], named_unit(match["short"] or match["unit"])
    return text, None


def named_unit(text: str) -> str:
    """Return a unit of a header as `ANGLE_UNITS` calls it: `Grad` are degrees, and `grad` may be gradians."""
    return "deg" if text == "Grad" else text.replace("°", "deg")


def _meaning(text: str, header: str, cells: Cells, comment: str | None, asked: bool, joints: Sequence[str]) -> Meaning:
    taken_as, (text, unit) = text, _with_unit(text.strip())
    other, unit = unit in OTHERS, unit and unit.lower()
    word, why = text.strip().lower(), "as asked" if asked else "its name"
    in_header = "as asked" if asked else "its header"
    if asked and word == "unused":
        return Meaning(header, "unused", "", "", why)
    named = [(rf"{PLACED}(?P<name>{re.escape(name)})(?:[ _]{PLACED_WORD})?", "") for name in joints]
    for pattern, usual in (*named, *JOINTS) if not other else ():
        if match := re.fullmatch(pattern, text.strip(), re.IGNORECASE):
            parts = match.groupdict()
            if parts.get("ur"):
                name = UR[int(parts["ur"])]
            elif short := parts.get("short") or parts.get("outer"):
                name = re.sub(r"[ .]", "_", short)
            else:
                name = f"A{parts['kuka']}" if parts.get("kuka") else str(parts.get("name") or parts.get("listed"))
            name = next((joint for joint in joints if joint.lower() == name.lower()), name)
            if unit is None and STEPS.fullmatch(name.rpartition("_")[2]) and "_" in name:
                name, _, unit = name.rpartition("_")
            reason = (
                in_header if unit else "as this controller writes it" if usual else OUTER if parts.get("outer") else why
            )
            return Meaning(header, "joint", name, unit or usual or None, reason)
    if match := re.fullmatch(COORDINATE, word) if not other else None:
        return Meaning(header, "coordinate", match["axis"], unit or comment, in_header if unit else "a comment")
    if match := re.fullmatch(OF_MESSAGE, word):
        return Meaning(header, "coordinate", match["axis"], "m", "as ROS has it")
    if re.fullmatch(PICTURE, header.strip().lower()) and not isinstance(cells, np.ndarray) and "." in str(cells[0]):
        return Meaning(header, "picture", text if asked else "cam", "", why)
    if word in ANGLES or (asked and word in VECTOR):
        return Meaning(header, "turn", word, unit, in_header)
    if asked and re.fullmatch("q[wxyz]", word):
        return Meaning(header, "turn", word, "", why)
    if re.fullmatch(NAMES, word):
        named = isinstance(cells, np.ndarray) or any(str(cell).strip() for cell in cells)
        return Meaning(header, "name", "pose", "", why) if named else Meaning(header, "unused", "", "", "it is empty")
    dated = re.fullmatch(DATES, word) and not unit
    if (dated or re.fullmatch(TIMES, word)) and not other:
        if text.strip() == "T" and not unit and not asked and np.isfinite(numbers(cells)).any():
            return Meaning(header, "time", "time", None, EITHER)
        largest = np.nanmax(values) if np.isfinite(values := numbers(cells)).any() else 0.0
        if dated and SPREADSHEET[0] < largest < SPREADSHEET[1]:
            return Meaning(header, "time", "time", "d", DAYS)
        stamp = next((name for name, size in STAMPS.items() if SINCE_1970 < size * largest < UNTIL), "")
        return Meaning(header, "time", "time", unit or stamp, in_header if unit else BY_SIZE if stamp else why)
    if word in KEPT:
        return Meaning(header, "kept", word, "", why)
    if asked:  # called as the caller says
        return Meaning(header, "covariate", _plain(taken_as), "", why)
    return Meaning(header, "covariate", _plain(header), "", "nothing else")


def _plain(header: str) -> str:
    """Return what a column without a meaning is called in a campaign."""
    return re.sub(r"^q_", "q", re.sub(r"\W+", "_", header).strip("_")) or "column"


def _turned(source: SourceTable, meant: Sequence[Meaning]) -> list[Meaning]:
    """Return what columns are where some of them are quaternions: beside x y z, and of length 1."""
    index = {meaning.column: i for i, meaning in enumerate(meant) if meaning.kind in ("covariate", "joint")}
    groups = by_stem(index)
    settled, places = (
        list(meant),
        [source.columns[i] for i, meaning in enumerate(meant) if meaning.kind == "coordinate"],
    )
    gone = lost(np.column_stack([numbers(cells) for cells in places]))
    for stem, group in groups.items() if not any(meaning.kind == "turn" for meaning in meant) else ():
        axes = ends(group)
        if axes not in (*QUATERNIONS, "1234") or OF_INTENDED.fullmatch(stem):
            continue
        names = QUATERNIONS.get(axes, "    ") if axes != "0123" or PARAMETERS.fullmatch(stem) else "    "
        sizes = np.sqrt(sum(numbers(source.columns[index[name]]) ** 2 for name in group.values()))
        given = np.isfinite(sizes) & (sizes > 0.1) & ~gone  # noughts where nothing was set
        if not given.any() or (np.abs(sizes[given] - 1.0) > ROUNDED).any():
            continue
        why = "four columns of length 1"
        for number, (axis, name) in enumerate(zip(axes, names, strict=True)):
            at = index[group[axis]]
            if name != " ":
                settled[at] = replace(settled[at], kind="turn", name=f"q{name}", unit="", why=why)
            else:
                open_ = f"a quaternion, w first or last: --take '{group[axis]}=q{'wxyz'[number]}'"
                settled[at] = replace(settled[at], kind="unused", name="turn", unit="", why=open_)
    return settled


def stated(source: SourceTable, known: Mapping[str, float] = LENGTHS) -> list[str]:
    """Return the known units that comments and titles of a file state, each once: one, or they contradict."""
    units: dict[float, str] = {}
    for unit in filter(None, (_unit_of_comment(text, known) for text in source.comments)):
        units.setdefault(known[unit], unit)
    return list(units.values())


def _unit_of_comment(text: str, known: Mapping[str, float]) -> str | None:
    """Return the unit that a comment or a title states: 'Units: Millimeters', 'Einheiten;mm', 'all in mm'."""
    words = rf"(?:units?|einheit(?:en)?|unit[eé]s?)\b(?:[^:=]*[:=])?|\b(?:length|angles?)\b[^:=]*[:=]|{WITHIN}"
    listed = (match[1].lower() for match in re.finditer(rf"(?:{words})\W*([^\W\d_]+(?:[,; ]+[^\W\d_]+)?)", text, re.I))
    units = (unit for several in listed for unit in re.split(r"[,; ]+", several)) if not OF_SPEED.search(text) else ()
    return next((unit for unit in units if unit in known), None)
