"""A table of Denavit-Hartenberg parameters, as data sheets and programs have it, as an arm file."""

import json
import re
import unicodedata
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.errors import ManyErrors, Place, TableError, listing
from armflex.intake.meanings import ANGLE_UNITS, BEHIND, BRACKETS, Ask, named_unit
from armflex.intake.sources import SourceTable
from armflex.measured.points import LENGTHS

PARAMETERS = {
    "theta": r"(?:theta|θ|th|ϑ)(?:_?\(?i\)?)?",
    "d": r"d(?:_?\(?i\)?)?",
    "a": r"(?:a|r)(?:[_ ]?\(?i(?: ?- ?1)?\)?)?",
    "alpha": r"(?:alpha|α|al)(?:[_ ]?\(?i(?: ?- ?1)?\)?)?",
    "beta": r"(?:beta|β)(?:_?\(?i(?: ?- ?1)?\)?)?",
    "offset": r"(?:(?:theta|θ|th|ϑ|q|joint)?[ _-]?off(?:set)?(?:_?i)?"
    r"|off(?:set)?[ _-]?(?:of )?(?:theta|θ|th|ϑ|q|joint))",
    "home": r"(?:(?:theta|θ|th|ϑ|q)[ _-]?(?:0|home|zero|null)|home|zero)(?: ?(?:position|angle))?",
}
"""Names of columns with numbers; an offset is added to theta, as is a home where theta is none."""

WORDS = {
    "kind": r"sigma|σ|(?:joint[ _]?)?(?:type|kind|typ|art)",
    "sign": r"flip(?:ped)?|sign|sense|dir(?:ection)?|invert(?:ed)?|reversed?|mirror(?:ed)?",
}
"""Names of columns that say how a joint moves."""

SLIDES = re.compile(r"1(?:\.0*)?|p(?:rism\w*)?|t(?:rans\w*)?|l(?:inear)?|slid\w*|schub\w*", re.IGNORECASE)
TURNS = re.compile(r"0?(?:\.0*)?|r(?:ev\w*|ot\w*)?|dreh\w*|turn\w*|hinge", re.IGNORECASE)
SAME_WAY = re.compile(r"\+?[01](?:\.0*)?|\+|no|false|n", re.IGNORECASE)
"""What cells say of a joint that slides, that turns, and that counts as its axis does."""

BESIDE = re.compile(
    r"#|i|j|n|(?:joint|axis|achse|gelenk|link|row|zeile|frame|kinematics)?[ _]?(?:nr|no|number|index|id|name)?\.?"
    r"|comments?|remarks?|notes?|bemerkung|description|(?:max )?(?:speed|velocity)",
    re.IGNORECASE,
)
"""Columns beside those of the geometry, which is the same without them."""

WEIGHS = re.compile(
    r"(?P<mass>mass|masse|m|weight)|(?P<inertia>inertia.*|i[xyz]{2})"
    r"|(?:(?:(?:center|centre) of (?:mass|gravity))|com|cog|schwerpunkt)(?:[ _]?(?P<axis>[xyz]))?",
    re.IGNORECASE,
)
"""Columns of what links weigh."""

MASSES = {"kg": 1.0, "g": 1e-3, "t": 1e3, "lb": 0.45359237}
"""Units of a mass, in kg."""

LIMITED = {
    name: re.compile(rf"(?P<of>q|theta|θ|joint)?[ _]?(?:limit[ _]?)?(?:{words})(?:[ _]?limit)?", re.IGNORECASE)
    for name, words in (
        ("lower", "min(?:imum)?|lower"),
        ("upper", "max(?:imum)?|upper"),
        ("range", "limits?|range|qlim"),
    )
}
"""Columns of where a joint may be: an end each, or both in a cell."""

ENDS = re.compile(r"\s*(?:\.\.+|…|[/;,:~]|\bto\b|\bbis\b)\s*|\s+")
"""Between both ends in a cell."""

NO_END = re.compile(r"|[-–—]+|[-+]?(?:inf\w*|∞)|none|n/?a|nan", re.IGNORECASE)

FACTOR = r"(?:\d+\.?\d*(?:e[+-]?\d+)?|\.\d+|pi)"
CONSTANT = rf"(?P<constant>[+-]?{FACTOR}(?:[*/]?{FACTOR})*)"
INDEX = re.compile(
    r"#|i|j|n|(?:joint|axis|achse|gelenk|link|row|zeile|frame)[ _]?(?:nr|no|number|index|id|name)?\.?", re.IGNORECASE
)
COUNT = re.compile(r"[^\W\d_]*[ _]?(\d+)(?:\.0*)?", re.IGNORECASE)
"""Columns that count the rows, and their cells: 1, J1, Joint 1."""

VARIABLE = r"(?P<variable>(?:(?:q|theta|θ|ϑ|th)_?(?P<turning>\d*)\*?|d_?(?P<sliding>\d*)\*))"
CELLS = [re.compile(form) for form in (CONSTANT, rf"{VARIABLE}(?:(?=[+-]){CONSTANT})?", rf"{CONSTANT}\+{VARIABLE}")]
"""A number, also of pi; a joint's variable; and both: q2-90, -pi/2."""

BEFORE = re.compile(r"(?:alpha|α|a)[_ ]?\(?i ?- ?1\)?")
"""How a column is called of a row in Craig's, the modified form: it belongs to the link before."""

FORMS = {
    "modified": re.compile(r"\b(?:(?:modified|proximal)[ -]+(?:dh|denavit)\w*|craig|khalil\w*|mdh)\b", re.IGNORECASE),
    "standard": re.compile(r"\b(?:(?:standard|distal|classic(?:al)?)[ -]+(?:dh|denavit)\w*|sdh)\b", re.IGNORECASE),
}
"""What a title or a comment says of the form of a table."""

UPRIGHT = "gravity = [0.0, 0.0, -9.81]     # m/s^2: the base stands upright"

BARE = re.compile(r"[A-Za-z0-9_-]+")
"""A key of TOML that needs no quotes."""

DEGREES = re.compile(r"°|deg(?:rees?)?", re.IGNORECASE)

RIGHT = 2.0 * np.pi
"""No angle of a row is beyond this [rad]: numbers beyond it are degrees."""


@dataclass(frozen=True, eq=False)
class DhTable:
    """Rows of an arm, base to tip.

    Attributes:
        rows: (n, 5) theta [rad], d [m], a [m], alpha [rad] and beta [rad].
        slides: (n,) whether d, and not theta, is the joint's.
        limits: (n, 2) between which positions the joint may be [rad or m], not a number where nobody says.
        bodies: (n, 4) mass of the link [kg] and its centre [m] in the row's frame, 0 where nobody says.
        form: "standard" or "modified".
        taken: (column, what it is, unit, why) of each column that counts.
    """

    rows: Array
    slides: tuple[bool, ...]
    limits: Array
    bodies: Array
    form: str
    taken: tuple[tuple[str, str, str, str], ...]

    def lines(self, joints: Sequence[str]) -> list[str]:
        """Return [robot] of an arm file, its joints named as in the log."""
        lines = [
            "[robot]",
            f'dh = "{self.form}"',
            UPRIGHT,
            "",
        ]
        lines.append("[robot.joint]")
        rows = zip(joints, self.rows, self.slides, self.limits, self.bodies, strict=True)
        for name, (theta, d, a, alpha, beta), slides, ends, (mass, *com) in rows:
            across = pin.exp3(np.array([alpha, 0.0, 0.0])) @ pin.exp3(np.array([0.0, beta, 0.0]))
            moved = across @ com + [a, 0.0, 0.0] if self.form == "standard" else np.array(com)
            angles = (float(np.round(np.degrees(angle), 9)) + 0.0 for angle in (theta, alpha, beta))
            lengths = (float(np.round(1e3 * size, 9)) + 0.0 for size in (d, a))
            (theta, alpha, beta), (d, a) = angles, lengths
            key = name if BARE.fullmatch(name) else json.dumps(name, ensure_ascii=False)
            more = (f", beta_deg = {beta!r}" if beta else "") + (', kind = "prismatic"' if slides else "")
            if np.isfinite(ends).all():
                unit, factor = ("mm", 1e3) if slides else ("deg", np.degrees(1.0))
                lower, upper = (float(np.round(factor * end, 9)) + 0.0 for end in ends)
                more += f", lower_{unit} = {lower!r}, upper_{unit} = {upper!r}"
            if mass:
                more += f", mass = {float(mass)!r}, com = {(np.round(moved, 9) + 0.0).tolist()}"
            lines.append(
                f"{key} = {{ theta_deg = {theta!r}, d_mm = {d!r}, a_mm = {a!r}, alpha_deg = {alpha!r}{more} }}"
            )
        return lines


def is_dh(source: SourceTable, asked: Mapping[str, str]) -> bool:
    """Return whether a table has a, alpha and d or theta among its columns, as named or `asked`."""
    columns = set(_columns(source, asked))
    return {"a", "alpha"} <= columns and bool(columns & {"d", "theta"})


def read_dh(source: SourceTable, form: str | None, ask: Ask | None, asked: Mapping[str, str]) -> DhTable:
    """Return the rows of a table of DH parameters.

    Args:
        source: The table.
        form: "standard" or "modified", None where its columns have to say it.
        ask: Asks where it is open.
        asked: What the caller says columns are, by their name: a parameter, as `theta_deg`, or `unused`.

    Raises:
        TableError: A cell is no number, or a column says of a joint what a row cannot.
        ManyErrors: A unit, a column or the form are open, or nothing says what theta is.
    """
    unused, columns = [name for name, meaning in asked.items() if meaning == "unused"], _columns(source, asked)
    for name, (at, unit) in columns.items():
        text = " ".join(map(str, source.columns[at]))
        if not unit and DEGREES.search(text) and not re.search("pi|π|rad", text, re.IGNORECASE):
            columns[name] = at, "deg"
    if khalil := _is_khalil(source, columns):
        columns |= {"a": columns["d"], "d": columns["a"]}
    cells, wrong = {name: list(map(str, source.columns[at])) for name, (at, _) in columns.items()}, list[str]()
    parts, taken = dict[str, _Numbers](), list[tuple[str, str, str, str]]()
    header, path, count = {name: source.header[at] for name, (at, _) in columns.items()}, source.path, len(source.lines)
    for name in (name for name in cells if name not in WORDS):
        parts[name] = _numbers(source, name, header[name], columns[name][1], cells[name])
        wrong += _of_other_rows(source, cells[name], parts[name].index)
    values = {name: part.values for name, part in parts.items()}
    for name in parts:
        unit, why = _unit_of(path, name, header[name], columns, parts, values, ask)
        if not why:
            wrong.append(unit)
            continue
        values[name] = values[name] * (LENGTHS if name in "da" else ANGLE_UNITS)[unit]
        taken.append((header[name], f"DH {name}", unit, why))
    slides = np.array([number is not None for number in parts["d"].index]) if "d" in parts else np.zeros(count, bool)
    for name in (name for name in cells if name in WORDS):
        for i, cell in enumerate(cells[name]):
            if name == "kind":
                slides[i] |= bool(SLIDES.fullmatch(cell))
            if not (TURNS.fullmatch(cell) or slides[i] if name == "kind" else _same_way(header[name], cell)):
                text = "expected R or P" if name == "kind" else "a row has no sign: turn the joint's column in the log"
                wrong.append(f"{Place(path, source.lines[i])}: {header[name]!r} is {cell!r}: {text}")
        taken.append((header[name], "kind of joint" if name == "kind" else "sense of joint", "", "its header"))
    none = np.zeros(count)
    theta, home, offset = (values.get(name, none) for name in ("theta", "home", "offset"))
    if theta.any() and home.any():
        text = f"{header['theta']!r} and {header['home']!r} both have angles: leave one out, or add them"
        wrong.append(f"{path}: {text}")
    for i in np.flatnonzero(slides & ((offset != 0.0) | (home != 0.0)))[:1]:
        name = header["offset" if offset[i] else "home"]
        wrong.append(f"{Place(path, source.lines[i])}: the joint slides, and {name!r} is an angle: add it to d")
    lengths = next((unit for title, what, unit, _ in taken if what == "DH d"), "")
    limits, ends, of_limits = _limits(source, slides, bool((theta + home + offset).any()), lengths, unused)
    bodies, weighing, of_bodies = _bodies(source, ask, unused)
    beside, about = _beside(source, {i for i, _ in columns.values()}, {name for name, *_ in (*ends, *weighing)}, unused)
    form, why, open_ = _form(source, form, ask, khalil)
    if columns.keys().isdisjoint(("theta", "offset", "home")):
        text = "no column has theta, the angle of each row where its joint is at 0: --take 'COLUMN=theta' says which it"
        open_.append(f"{path}: {text} is, and a column 'theta [deg]' with 0 in each row that there is none")
    if form == "modified" and not khalil and _bare(header["a"])[0].startswith("r"):
        open_.append(f"{path}: {header['a']!r} is along x in some texts, and along z in Khalil's: name columns a and d")
    if wrong := wrong + of_limits + of_bodies + about + open_:
        raise ManyErrors(wrong)
    rows = np.column_stack([theta + offset + home, *(values.get(name, none) for name in ("d", "a", "alpha", "beta"))])
    taken = (*taken, *ends, *weighing, *beside, ("(rows)", f"{form} DH", "", why))
    return DhTable(rows, tuple(slides.tolist()), limits, bodies, form, taken)


class _Numbers(NamedTuple):
    """Numbers of a column.

    Attributes:
        values: (n,) of its cells.
        in_rad: Whether a cell says that it is in rad.
        index: (n,) number of the joint's variable in a cell, '' where it has none, None where no variable stands there.
    """

    values: Array
    in_rad: bool
    index: list[str | None]


def _numbers(source: SourceTable, name: str, header: str, unit: str, cells: Sequence[str]) -> _Numbers:
    said = DEGREES if unit.startswith("deg") else None  # once more in its cells
    read = list[tuple[float, bool, str | None]]()
    for line, cell in zip(source.lines, cells, strict=True):
        number = _number(said.sub("", cell) if said else cell)
        if number is None or (number[2] is not None and name not in ("theta", "d")):
            raise TableError(Place(source.path, line), f"{header!r} is {cell!r}, expected a number")
        read.append(number)
    values, in_rad, index = zip(*read, strict=True)
    return _Numbers(np.array(values), any(in_rad), list(index))


def _of_other_rows(source: SourceTable, cells: Sequence[str], index: Sequence[str | None]) -> Iterator[str]:
    """Yield what is wrong with variables that do not count as their rows do."""
    counted = [(i, int(number)) for i, number in enumerate(index) if number]
    for i, number in counted:
        if number - i != counted[0][1] - counted[0][0]:
            text = f"{cells[i]!r} is of another joint than that of its row: put the rows in their order"
            yield f"{Place(source.path, source.lines[i])}: {text}"


def _unit_of(
    path: Path,
    name: str,
    header: str,
    columns: Mapping[str, tuple[int, str]],
    parts: Mapping[str, _Numbers],
    values: Mapping[str, Array],
    ask: Ask | None,
) -> tuple[str, str]:
    """Return the unit of a column and where that is known from; what is wrong, and '', where it is open.

    `values` are in SI of columns whose unit is known.
    """
    unit, length, why = columns[name][1], name in "da", "its header"
    units, alike = (LENGTHS if length else ANGLE_UNITS), [part for part in parts if (part in "da") == length]
    open_ = [part for part in alike if part == name or not columns[part][1]]  # the others say theirs
    largest = max(float(np.abs(values[part]).max()) for part in open_)
    if parts[name].in_rad or (not unit and any(parts[part].in_rad for part in open_)):
        if unit not in ("", "rad") or (not unit and largest > RIGHT):
            return f"{path}: {header!r} is among angles with pi, and others are in degrees", ""
        unit, why = "rad", why if unit else "its cells"
    if unit == "rad" and largest > RIGHT:
        return f"{path}: {header!r} is {largest:g} rad, beyond a turn: write it as {f'{name} [deg]'!r}", ""
    if unit in units:
        return unit, why
    if unit:
        return f"{path}: {header!r} is in {unit!r}, which is not known ({listing(units, 6)})", ""
    if not length and largest > RIGHT:
        return "deg", f"a value of {largest:g} is no angle in rad"
    if length and largest > 20.0:
        return "mm", f"a value of {largest:g} is no length of an arm in m"
    if not values[name].any():
        return "m" if length else "rad", "all are 0"
    if ask is not None:
        choices = ("mm", "m") if length else ("deg", "rad")
        return ask(f"{path.name}: in which unit is {header!r}?", choices), "as answered"
    example = f"{name} [{'mm' if length else 'deg'}]"
    return f"{path}: the unit of {header!r} is open: write it as {example!r}", ""


def _limits(
    source: SourceTable, slides: np.ndarray, turned: bool, lengths: str, unused: Collection[str]
) -> tuple[Array, list[tuple[str, str, str, str]], list[str]]:
    """Return (n, 2) limits [rad or m], what their columns are, and what is wrong with them.

    Theta may have a constant beside the joint's position, so that it is `turned`. What slides has limits in the unit of
    d, `lengths`, where theirs is not stated.
    """
    limits, taken, wrong = np.full((len(slides), 2), np.nan), list[tuple[str, str, str, str]](), list[str]()
    marked = np.zeros(len(slides), dtype=bool)
    for header, column in zip(source.header, source.columns, strict=True):
        word, stated = _bare(header)
        kind = next((name for name, pattern in LIMITED.items() if header not in unused and pattern.fullmatch(word)), "")
        for i, cell in enumerate(map(str, column) if kind else ()):
            both = re.fullmatch(r"(?:±|\+/?-)\s*(.*)", cell)
            parts = [both[1]] * 2 if both else ENDS.split(cell.strip("[]() ")) if kind == "range" else [cell]
            if NO_END.fullmatch(cell):
                continue
            ends = [_number(part) for part in parts]
            if None in ends or any(end and end[2] is not None for end in ends) or len(ends) != 1 + (kind == "range"):
                wrong.append(
                    f"{Place(source.path, source.lines[i])}: {header!r} is {cell!r}, expected a joint's limits"
                )
                continue
            of_cell = [(end[0], end[1]) for end in ends if end]
            at = {"lower": [0], "upper": [1]}.get(kind, [0, 1])
            limits[i, at] = np.array([value for value, _ in of_cell]) * ([-1.0, 1.0] if both else 1.0)
            marked[i] |= any(in_rad for _, in_rad in of_cell)
        if kind:
            taken.append((header, "limits of a joint", stated, "its header" if stated else ""))
    if not taken:
        return limits, [], wrong
    header, _, unit, _ = taken[0]
    if turned and any((match := form.fullmatch(_bare(taken[0][0])[0])) and match["of"] in ("theta", "θ")
                      for form in LIMITED.values()):  # fmt: skip
        text = "is of theta, which has a constant beside the joint's position: which of both it limits is not known"
        wrong.append(f"{source.path}: {header!r} {text}: name it 'min' and 'max', or --take '{header}=unused'")
    whole = np.isfinite(limits)
    for i in np.flatnonzero(whole.any(axis=1) & ~(limits[:, 0] < limits[:, 1]))[:1].tolist():
        text = f"its limits are {limits[i, 0]:g} and {limits[i, 1]:g}, expected a lower and an upper one"
        wrong.append(f"{Place(source.path, source.lines[i])}: {text}")
    for kind, rows in (("turn", ~slides), ("slide", slides)):
        read = rows & whole.any(axis=1) & ~(marked & ~slides)
        units, of = (LENGTHS, unit or lengths) if kind == "slide" else (ANGLE_UNITS, unit)
        largest = float(np.abs(limits[read][whole[read]]).max(initial=0.0))
        if not of and kind == "turn" and largest > RIGHT:
            of = "deg"
        if read.any() and of not in units:
            text = f"is in {of!r}, and some of the joints {kind}" if of else "has an open unit"
            example = f"{header} [{'mm' if kind == 'slide' else 'deg'}]"
            wrong.append(f"{source.path}: {header!r} {text}: write it as {example!r}, or --take '{header}=unused'")
        elif read.any():
            limits[read] *= units[of]
            taken = [(name, what, stated or of, why or f"a value of {largest:g}") for name, what, stated, why in taken]
    return limits, taken, wrong


def _bodies(
    source: SourceTable, ask: Ask | None, unused: Collection[str]
) -> tuple[Array, list[tuple[str, str, str, str]], list[str]]:
    """Return (n, 4) masses [kg] and their centres [m] in the rows' frames, their columns, and what is wrong."""
    bodies, taken, wrong = np.zeros((len(source.lines), 4)), list[tuple[str, str, str, str]](), list[str]()
    given, masses = set[int](), ""
    for header, column in zip(source.header, source.columns, strict=True):
        word, unit = _bare(header)
        match = None if header in unused else WEIGHS.fullmatch(word)
        if match is None:
            continue
        taken.append(
            (header, "mass of the link" if match["mass"] else "its centre, in the row's frame", unit, "its header")
        )
        if match["inertia"]:
            wrong.append(f"{source.path}: {header!r}: a row has no moments of inertia, which no sag depends on: --take "
                         f"'{header}=unused' leaves them out, and a URDF has them")  # fmt: skip
            continue
        units, example = (MASSES, "mass [kg]") if match["mass"] else (LENGTHS, f"{word} [mm]")
        if not unit and ask is not None:
            unit = ask(f"{source.path.name}: in which unit is {header!r}?", tuple(units)[:2])
            taken[-1] = (*taken[-1][:2], unit, "as answered")
        if unit not in units:
            text = f"is in {unit!r}, which is not known" if unit else "has an open unit"
            wrong.append(f"{source.path}: {header!r} {text}: write it as {example!r}")
            continue
        at = [0] if match["mass"] else [1 + "xyz".index(match["axis"].lower())] if match["axis"] else [1, 2, 3]
        masses = header if match["mass"] else masses
        given |= {*at}
        for i, cell in enumerate(map(str, column)):
            numbers = [_number(part) for part in re.split(r"[\s;,]+", cell.strip("[]() "))]
            size = [number[0] for number in numbers if number and number[2] is None]
            if len(size) != len(at) or len(numbers) != len(at) or (match["mass"] and size[0] < 0.0):
                expected = "a mass" if match["mass"] else "a length" if match["axis"] else "three lengths"
                wrong.append(f"{Place(source.path, source.lines[i])}: {header!r} is {cell!r}, expected {expected}")
                continue
            bodies[i, at] = units[unit] * np.array(size)
    if masses and not wrong and given != {0, 1, 2, 3}:
        text = (
            f"{masses!r} has masses, and where their centres are is said nowhere: add the columns 'com x [mm]', 'com y"
        )
        text += f" [mm]' and 'com z [mm]', in the frame of each row, or --take '{masses}=unused' leaves the masses out"
        wrong.append(f"{source.path}: {text}")
    elif given and not masses and not wrong:
        text = f"{taken[0][0]!r} is of a centre of mass, and no column has the masses: add 'mass [kg]', or --take"
        wrong.append(f"{source.path}: {text} '{taken[0][0]}=unused'")
    return bodies, taken, wrong


def _beside(
    source: SourceTable, columns: Collection[int], limits: Collection[str], unused: Collection[str]
) -> tuple[list[tuple[str, str, str, str]], list[str]]:
    """Return what columns beside those of the geometry are, and what is wrong with them."""
    taken, wrong = list[tuple[str, str, str, str]](), list[str]()
    for i, name in enumerate(source.header):
        if (i in columns and name not in unused) or name in limits:
            continue
        counts = [int(match[1]) for cell in source.columns[i] if (match := COUNT.fullmatch(str(cell)))]
        every = name not in unused and len({*counts}) == len(source.lines)
        if every and (np.diff(counts) != 1).any() and INDEX.fullmatch(name):
            text = f"{name!r} is {listing(map(str, counts), 8)}: put the rows in their order, base to tip"
            wrong.append(f"{source.path}: {text}")
        elif name in unused or BESIDE.fullmatch(_bare(name)[0]):
            taken.append((name, "not used", "", "as asked" if name in unused else "no part of the geometry"))
        else:
            others = listing([*PARAMETERS][1:])
            text = f"{name!r} beside DH parameters is not known: --take '{name}=theta' (or {others}) says what it is"
            wrong.append(f"{source.path}: {text}, '{name}=unused' leaves it out")
    return taken, wrong


def _is_khalil(source: SourceTable, columns: Mapping[str, tuple[int, str]]) -> bool:
    """Return whether a table is Khalil's, alpha d theta r, where d is along x and r along z."""
    if "d" not in columns or not _bare(source.header[columns["a"][0]])[0].startswith("r"):
        return False
    order = sorted((name for name in columns if name in PARAMETERS), key=lambda name: columns[name][0])
    words = any(re.search(r"\bkhalil", text, re.IGNORECASE) for text in source.comments)
    return words or [name for name in order if name in ("alpha", "d", "a")] == ["alpha", "d", "a"]


def _form(source: SourceTable, form: str | None, ask: Ask | None, khalil: bool) -> tuple[str, str, list[str]]:
    """Return the form of a table, where that is known from, and what is wrong with it."""
    path, why, wrong = source.path, "asked for", list[str]()
    stated = {"modified": "a and alpha are of the link before"}
    if not any(BEFORE.fullmatch(_bare(name)[0]) for name in source.header):
        stated = {of: "its title" for of, words in FORMS.items() if any(map(words.search, source.comments))}
    stated |= {"modified": "alpha, d, theta, r are Khalil's"} if khalil else {}
    (other, reason), *more = [*stated.items()] or [("", "")]
    if other and not more and form is None:
        form, why = other, reason
    elif other and not more and form != other:
        text = f"--dh {form}, and the table is {other} DH ({reason}): leave --dh out, or mend the table"
        wrong.append(f"{path}: {text}")
    if form is None and ask is not None:
        choices = ("standard", "modified")
        form, why = ask(f"{path.name}: standard (distal) or modified (Craig) DH?", choices), "as answered"
    if form is None:
        wrong.append(f"{path}: standard (distal) or modified (Craig) DH is open: --dh standard or --dh modified")
    return form or "", why, wrong


def _same_way(header: str, cell: str) -> bool:
    """Return whether a cell says that a joint counts as its axis does: 1 where a sign is meant, 0 of a flip."""
    flips = not re.match(r"sign|sense|dir", header.strip(), re.IGNORECASE)
    return bool(SAME_WAY.fullmatch(cell)) and ("1" not in cell if flips else "0" not in cell)


def _number(cell: str) -> tuple[float, bool, str | None] | None:
    """Return a cell's number, whether it says that it is in rad, and the number of a joint's variable in it.

    It says so with pi, or with its unit; degrees with theirs are converted. A variable may have no number: ''. None
    instead of that where no variable stands there, and instead of all where the cell is no number.
    """
    text = re.sub(r"[\s()]|(?:np|numpy|math)\.", "", cell.lower()).replace("−", "-").replace("∗", "*")
    text = re.sub("(?<![0-9])[½¼¾]", lambda part: str(unicodedata.numeric(part[0])), text.replace("π", "pi"))
    text, degrees = DEGREES.subn("", text)
    text, radians = re.subn("rad", "", text)
    match = next((match for pattern in CELLS if (match := pattern.fullmatch(text))), None)
    if match is None:
        return None
    parts, size = match.groupdict(), 0.0
    if constant := parts["constant"]:
        size = -1.0 if constant.startswith("-") else 1.0
        for sign, factor in re.findall(rf"([*/]?)({FACTOR})", constant):
            value = np.pi if factor == "pi" else float(factor)
            if sign == "/" and value == 0.0:
                return None
            size = size / value if sign == "/" else size * value
    number = (parts["turning"] or parts["sliding"] or "") if parts.get("variable") else None
    return (np.radians(size) if degrees else size), bool(degrees or radians or "pi" in (constant or "")), number


def arm_text(robot: Sequence[str], tip: str, declare: str, tracked: bool) -> str:
    """Return an arm file: what a first calibration frees, and the instruments beside the first target.

    Args:
        robot: Lines of [robot].
        tip: Its last link.
        declare: Tables of instruments, "TIP" for the link that they are on.
        tracked: Whether the first target is read. Arms that only a camera reads are printed, or hobby servos.
    """
    offset, geometry = ("0.01", "1e-3") if tracked else ("0.05", "2e-3")
    lines = [
        *(*robot, "", "[prior]                          # one standard deviation of what calibration may move"),
        *(f"joint_offset = {offset}              # rad", f"geometry = {geometry}                  # m and rad"),
        *(["tool = 0.3                       # m, the target's place in the tip frame"] if tracked else []),
    ]
    return "\n".join([*lines, *(["", declare.replace("TIP", tip)] if declare else [])]) + "\n"


def _bare(header: str) -> tuple[str, str]:
    """Return a column's name and its unit, '' where the header has none."""
    text, unit = unicodedata.normalize("NFKC", re.sub(r"[\\${}]", "", header)).strip().replace("−", "-"), ""
    match = BRACKETS.fullmatch(text)
    if match and not re.fullmatch(r"i(?: ?- ?1)?", match[2].strip()):
        text, unit = match[1], match[2]
    elif not match and (match := BEHIND.fullmatch(text)):
        text, unit = match["base"], match["short"] or match["unit"]
    return text.strip().lower(), named_unit(unit).lower()


def _columns(source: SourceTable, asked: Mapping[str, str]) -> dict[str, tuple[int, str]]:
    """Return where each parameter's column is, and its unit: those that are `asked` before those that are named so."""
    columns: dict[str, tuple[int, str]] = {}
    for i, header in sorted(enumerate(source.header), key=lambda column: column[1] not in asked):
        word, unit = _bare(header)
        if header in asked:
            word, said = _bare(asked[header])
            unit = said or unit
        for name, pattern in (PARAMETERS | WORDS).items():
            if re.fullmatch(pattern, word) and name not in columns:
                columns[name] = i, unit
    return columns
