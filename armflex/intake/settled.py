"""What is wrong or open in one file: units that nobody states, cells that are no numbers, what no arm reaches."""

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from armflex.conventions import LARGEST, NUMBER, Array
from armflex.errors import FEW, Place, TableError, listing
from armflex.intake.clock import counted, doubt, times
from armflex.intake.lost import without_lost
from armflex.intake.meanings import (
    ANGLE_UNITS,
    ANGLES,
    INTENDED,
    OUTER,
    STEPS,
    TIME_UNITS,
    TURN,
    VECTOR,
    Ask,
    Meaning,
    polar,
    stated,
)
from armflex.intake.record import Record
from armflex.intake.sources import NO_READING, PARTED, numbers, said
from armflex.intake.standing import filled
from armflex.intake.streams import TURNS, is_dense, spread
from armflex.measured.points import CURVED, LENGTHS, frame_of

MOST_TURNS = 10.0
"""No joint of an arm is turned further from its zero."""

MOST_METRES = 1e4
"""No place is further from where it is measured [m]: a total station reaches 3.5 km."""

MOST_MOTION = 200.0
"""No arm moves a target over more [m]: no structure of one is longer."""

TWIN = 0.1
"""Tolerance: joints that differ by less than this part of their way in every row are one joint, most likely."""

FRAMES = re.compile(
    r"(?:(?:coord\w*|ref(?:erence)?|work(?:ing)?)[ _]?)?(?:frame|system|c?sys|[uw]cs)(?:[ _]?(?:id|name))?|datum"
    r"|\w*(?:koordinaten|bezugs)system",
    re.IGNORECASE,
)
"""Header of a column that says in which frame a place is."""

SEVERAL = re.compile(
    r"(?:(?P<target>tool|target|smr|prism|reflector|ball|sphere|nest|probe)"
    r"|station|set[ _-]?up|instrument|tracker|scanner)(?:[ _]?(?:id|no|nr|number|name))?",
    re.IGNORECASE,
)
"""Headers of columns of an export that say of which target or from where a place was read."""

NOT_MEASURED = re.compile(rf"(?:{INTENDED})(?:[\W_].*)?", re.IGNORECASE)
"""What a cell says of a place that was to be."""

WORDS = {
    "joint": "joint {}",
    "coordinate": "measured {}",
    "turn": "measured orientation {}",
    "picture": "picture of {}",
    "name": "name of the row or point",
    "covariate": "a covariate",
    "unused": "not used",
}
KNOWN = {"joint": ANGLE_UNITS | LENGTHS, "coordinate": LENGTHS, "turn": ANGLE_UNITS, "time": TIME_UNITS}
"""Units in which a column of a kind may be."""


def in_words(meaning: Meaning) -> str:
    """Return what a column is."""
    return WORDS.get(meaning.kind, "{}").format(meaning.name)


def settled(record: Record, ask: Ask | None, slides: Sequence[str], placed: bool) -> tuple[Record, list[str]]:
    """Return a file with every open unit settled and lost targets left out, and what is wrong with it.

    `slides` are names of joints that are lengths, `placed` says whether its places count.
    """
    wrong, sampled = list[str](), False
    try:
        record = without_lost(record, record.meant, record.role != "log") if placed else record
    except TableError as error:
        wrong.append(str(error))
    record, about = _with_units(record, ask, slides)
    about += _twice(record)
    about += [] if about else [*_twins(record)]
    if not about and (record.has("joint") or record.has("coordinate")):
        values, unit = filled(record).moved
        record = counted(record, values, unit)
        about += filter(None, [doubt(record)])
        time = times(record) if not about else None
        sampled = time is not None and is_dense(spread(time), values, unit)  # a row may be of one topic among several
    wrong += [*about, *_no_numbers(record, sampled)]
    wrong += [*_curved(record), *_frames(record), *_several(record), *_intended(record)] if placed else ()
    return record, wrong


def _as(meaning: Meaning, unit: str) -> str:
    base = f"q_{meaning.name}" if meaning.kind == "joint" else meaning.name
    return f"{base}_{unit}"


def _with_units(record: Record, ask: Ask | None, slides: Sequence[str]) -> tuple[Record, list[str]]:
    """Return a file with the units that are stated nowhere as answered, and what is wrong with others."""
    meant, wrong, answers = [], list[str](), dict[tuple[str, tuple[str, ...]], str]()
    for meaning in record.meant:
        if meaning.kind in ("joint", "coordinate", "turn") and meaning.unit is None:
            length = meaning.kind == "coordinate" or (meaning.kind == "joint" and meaning.name in slides)
            choices = ("mm", "m", "inch") if length else ("mm", "deg") if meaning.why == OUTER else ("deg", "rad")
            kind = (meaning.kind, choices)
            if ask is not None and kind not in answers:
                answers[kind] = ask(
                    f"{record.path.name}: in which unit is {meaning.column!r}, and all like it?", choices
                )
            if kind in answers:
                meaning = replace(meaning, unit=answers[kind], why="as answered")
            else:
                several = listing(stated(record)) if meaning.kind == "coordinate" else ""
                text = f"is stated as {several}" if several else "is stated nowhere"
                text = f"{record.path}: the unit of column {meaning.column!r} {text}:"
                wrong.append(
                    f"{text} --take '{meaning.column}={_as(meaning, choices[0])}' or ={_as(meaning, choices[1])}"
                )
        elif unknown := _unknown_unit(record, meaning):
            wrong.append(unknown)
            meaning = replace(meaning, unit="")
        elif meaning.kind in ("coordinate", "joint") and meaning.why != "as asked":
            units = LENGTHS if meaning.kind == "coordinate" else ANGLE_UNITS
            others = stated(record, units) if meaning.unit in units else []
            if others and not any(np.isclose(units[meaning.unit or ""], units[other]) for other in others):
                text = f"{record.path}: {meaning.column!r} is in {meaning.unit}"
                text += f", and the file's head says {listing(others)}:"
                wrong.append(f"{text} --take '{meaning.column}={_as(meaning, meaning.unit or '')}' if it is")
        meant.append(meaning)
    return replace(record, meant=tuple(meant)), wrong


def _unknown_unit(record: Record, meaning: Meaning) -> str:
    """Return what is wrong with the unit that a header states, nothing where it is known."""
    known = KNOWN.get(meaning.kind, {})
    if not meaning.unit or not known or meaning.unit in known:
        return ""
    if meaning.kind == "time" and not np.isfinite(numbers(record.columns[record.header.index(meaning.column)])).any():
        return ""
    if meaning.kind == "joint" and STEPS.fullmatch(meaning.unit):
        text = f"column {meaning.column!r} is in {meaning.unit}, and how many are a turn, and which is 0, is in no file"
        return f"{record.path}: {text}: convert it to degrees, as the drive's manual says"
    text = f"column {meaning.column!r} is in {meaning.unit!r}, which is not known ({listing(known, 6)})"
    return f"{record.path}: {text}: convert it, or --take '{meaning.column}={_as(meaning, 'UNIT')}'"


def _twice(record: Record) -> list[str]:
    """Return which columns are called alike, or are all the same."""
    wrong = [f"{record.path}: two columns are called {name!r}: rename one"
             for name in dict.fromkeys(record.header) if record.header.count(name) > 1]  # fmt: skip
    for kind in ("joint", "coordinate", "turn", "name", "time"):
        named = [meaning for meaning in record.meant if meaning.kind == kind]
        for name in {meaning.name for meaning in named}:
            alike = [meaning for meaning in named if meaning.name == name]
            if len(alike) > 1:
                columns = listing(repr(meaning.column) for meaning in alike)
                wrong.append(f"{record.path}: columns {columns} are all {in_words(alike[0])}: --take one")
    return wrong


def _twins(record: Record) -> Iterator[str]:
    """Yield what is wrong where joints stand there twice, as of two encoders, or of where they were to be."""
    named = [meaning for meaning, _ in record.of("joint")]
    values = [*record.si("joint").values()]
    way = [float(np.ptp(read[np.isfinite(read)])) if np.isfinite(read).any() else 0.0 for read in values]
    moving = [i for i, size in enumerate(way) if size > TURNS]
    pairs = [(i, k) for n, i in enumerate(moving) for k in moving[n + 1 :]
             if np.nanmax(np.abs(values[i] - values[k]), initial=0.0) < TWIN * min(way[i], way[k])]  # fmt: skip
    asked, once = any(named[k].why == "as asked" for _, k in pairs), len({i for pair in pairs for i in pair})
    if 1 < len(pairs) == once / 2 and once > len(moving) / 2 and len(record.lines) > 2 and not asked:
        first, second = (named[i].column for i in pairs[0])
        text = f"{record.path}: {first!r} and {second!r} are nearly the same in every row, and {len(pairs) - 1} more"
        text += f" pairs are: are they joints that stand there twice? --take '{second}=unused' and so on leaves one of"
        yield f"{text} each out, '{second}={_as(named[pairs[0][1]], named[pairs[0][1]].unit or 'rad')}' keeps them"


def _no_numbers(record: Record, sampled: bool) -> list[str]:
    """Return what is wrong with cells of joints, places and times: no numbers, or such as no arm reaches."""
    wrong = list[str]()
    for one, cells in record.of("joint", "coordinate", "turn", "time"):
        values = numbers(cells)
        bad = np.abs(values) > LARGEST
        if one.kind != "time" and not isinstance(cells, np.ndarray):
            blank = one.kind in ("coordinate", "turn") or sampled
            bad |= [not (NUMBER.fullmatch(cell) or (blank and NO_READING.fullmatch(cell))) for cell in cells]
        if one.kind == "joint" and not (record.part or sampled):
            bad |= np.isnan(values)
        if bad.any():
            at = int(bad.argmax())
            place = Place(record.path, record.lines[at])
            text = f"{place}: {one.column!r} is {said(str(cells[at]))}, expected a number"
            parted = one.kind in ("joint", "turn") and PARTED.fullmatch(str(cells[at]))
            wrong.append(f"{text}; degrees, minutes and seconds need a header with [deg]" if parted else text)
        elif one.kind != "time" and one.unit:
            wrong += filter(None, [_implausible(record, one, values)])
        if one.kind == "joint" and one.column in record.doubts:
            wrong.append(f"{record.path}: {record.doubts[one.column]}")
    return wrong


def _implausible(record: Record, meaning: Meaning, values: Array) -> str:
    """Return what is wrong with (N,) numbers of a joint, a place or a turn that no arm reaches, by line and column."""
    turns = meaning.kind != "coordinate" and meaning.unit in ANGLE_UNITS
    factor = (LENGTHS if meaning.kind == "coordinate" else LENGTHS | ANGLE_UNITS)[meaning.unit or ""]
    size = np.abs(values) * factor
    most = TURN if meaning.kind == "turn" else 2.0 * np.pi * MOST_TURNS
    beyond = size > (most if turns else MOST_METRES)
    if not beyond.any():
        read = factor * values[np.isfinite(values)]
        moves = 0.0 if turns or not len(read) else float(np.diff(np.quantile(read, [0.1, 0.9]))[0])
        text = f"{meaning.column!r} in {meaning.unit} moves over {moves:.4g} m, and no arm does: is it in mm?"
        remedy = f"--take '{meaning.column}={_as(meaning, 'mm')}'" if not record.part else "convert it"
        return f"{record.path}: {text} {remedy}" if moves > MOST_MOTION else ""
    at, count = int(beyond.argmax()), np.count_nonzero(beyond)
    what = f"{size[at] / (2.0 * np.pi):.4g} turns" if turns else f"{1e-3 * size[at]:.4g} km"
    more = f", and {count - 1} rows more" if count > 1 else ""
    other = " or ".join(unit for unit in (("deg", "rad") if turns else ("mm", "m", "um")) if unit != meaning.unit)
    text = f"{meaning.column!r} is {values[at]:.10g} {meaning.unit}, {what}{more}: no arm is there"
    text = f"{Place(record.path, record.lines[at])}: {text}; empty it, or"
    return f"{text} --take '{meaning.column}={_as(meaning, 'UNIT')}' ({other})"


def _frames(record: Record) -> list[str]:
    """Return what is wrong with places that a column says to be in several frames."""
    wrong = list[str]()
    for meaning, cells in record.of("covariate"):
        if meaning.why == "as asked" or not FRAMES.fullmatch(meaning.column.strip()):
            continue
        frames = sorted({*map(str, cells)} - {""})
        if len(frames) > 1 and not all(map(NUMBER.fullmatch, frames)):
            text = f"{record.path}: {meaning.column!r} says that places are in {listing(map(said, frames), FEW)}:"
            text += f" export them in one frame, or --take '{meaning.column}=session' where the instrument was set up"
            wrong.append(f"{text} anew, '{meaning.column}=unused' where all are in one")
    return wrong


def _curved(record: Record) -> Iterator[str]:
    """Yield what is wrong where comments say that the three numbers of a place are no x, y and z."""
    if match := next((match for text in record.comments if (match := CURVED.search(text))), None):
        yield f"{record.path}: {match[0]!r}: export the points in Cartesian coordinates, x y z"


def _several(record: Record) -> Iterator[str]:
    """Yield what is wrong where a column says that places are of several targets or stations, most not of one each."""
    for meaning, cells in record.of("covariate", "unused") if not record.has("joint") else ():
        counts = Counter(map(str, cells))
        repeated = 1 < len(counts) <= len(cells) / 2 and "" not in counts
        if repeated and meaning.why != "as asked" and (match := SEVERAL.fullmatch(meaning.column.strip())):
            of = match["target"]
            rest, prior = ("the target", ", with session_target under [prior]") if of else ("the instrument", "")
            text = f"{record.path}: {meaning.column!r} says that places are of {listing(sorted(counts), 4)}: --take"
            text += f" '{meaning.column}=session' where {rest} is at another place in each{prior}, or"
            yield f"{text} '{meaning.column}=unused' where all are of one {'target' if of else 'frame'}"


def _intended(record: Record) -> Iterator[str]:
    """Yield what is wrong where a column says that rows are of places that were to be, and not of measured ones."""
    for meaning, cells in record.of("covariate", "unused"):
        rows = [i for i, cell in enumerate(cells) if NOT_MEASURED.fullmatch(str(cell))]
        if rows and meaning.why != "as asked" and not isinstance(cells, np.ndarray):
            text = f"{Place(record.path, record.lines[rows[0]])}: {meaning.column!r} is {said(str(cells[rows[0]]))} in"
            text += f" {len(rows)} of {len(cells)} rows: export measured places alone, or"
            yield f"{text} --take '{meaning.column}=unused' where all are"


def in_one_frame(records: Sequence[Record]) -> list[str]:
    """Return what is wrong where comments of exports say that their places are in several frames."""
    frames = {frame_of(text).lower(): (record, frame_of(text)) for record in records for text in record.comments}
    named = [f"{frame!r} in {record.path.name}" for key, (record, frame) in frames.items() if key]
    text = "export them in one, or take that line out where it is not so"
    return (
        [f"{records[0].path}: comments say that places are in {listing(named, FEW)}: {text}"] if len(named) > 1 else []
    )


def no_place(record: Record, joints: bool) -> str:
    """Return what is wrong with a file that has no places, nor `joints`; nothing where those are enough."""
    if columns := polar(record.header):
        named = ", ".join(f"{name} = {column!r}" for name, column in zip(("Hz", "V", "D"), columns, strict=True))
        text = "has angles and a distance and no x y z: have coordinates exported, or compute columns"
        text += " x = D sin V sin Hz, y = D sin V cos Hz, z = D cos V"
        return f"{record.path}: {text} ({named}; V from the zenith, Hz clockwise, as a total station counts)"
    text = f"{record.path}: neither joints nor x y z among its columns ({listing(record.header)})"
    return "" if joints else f"{text}: --take COLUMN=q_J1_deg"


def unturned(records: Sequence[Record]) -> list[str]:
    """Return why no file has the orientation that --sigma-r is of, nothing where one has it."""
    whole = ({"qw", "qx", "qy", "qz"}, {*VECTOR}, {*ANGLES})
    turned = [record for record in records for names in whole
              if {meaning.name for meaning, _ in record.of("turn")} >= names]  # fmt: skip
    wrong = list[str]()
    for record in turned:
        read = np.column_stack([numbers(cells) for _, cells in record.of("turn")])
        read = read[np.isfinite(read).all(axis=1) & (np.isfinite(record.places).all(axis=1))]
        if len(read) > 2 and not np.ptp(read, axis=0).any() and np.ptp(record.places, axis=0).any():
            columns = listing(repr(meaning.column) for meaning, _ in record.of("turn"))
            text = f"{record.path}: --sigma-r, and the orientation {columns} is {listing(f'{x:g}' for x in read[0])} in"
            wrong.append(f"{text} every row, to the last digit: it was not measured")
    if turned:
        return wrong
    for record in records:
        text = f"{record.path}: --sigma-r, and no orientation is read"
        quaternion = [meaning for meaning in record.meant if meaning.name == "turn"]
        wrong += [f"{text}: {meaning.column!r} is of {meaning.why}" for meaning in quaternion]
        others = listing(repr(meaning.column) for meaning, _ in record.of("covariate", "unused", "turn"))
        if not quaternion:
            text += f" (other columns: {others}): a quaternion is qw qx qy qz; --take 'COLUMN=rx_deg', ry_deg, rz_deg"
            wrong.append(f"{text} for a rotation vector, roll_deg, pitch_deg, yaw_deg for angles about fixed x, y, z")
    return wrong
