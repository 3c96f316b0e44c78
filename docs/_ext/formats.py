"""Pages about files, from what the readers ask for: their accessors are listened to while they read examples."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from unittest.mock import patch

from keys import COLUMNS, KEYS, Key

import armflex.measured.table as tables
from armflex import load_arm, read_joint_data, read_measurements, read_trajectory
from armflex import trajectory as trajectories
from armflex.conventions import UNITS
from armflex.declaration import Declaration
from armflex.measured import joint_data, measurements, pictures
from armflex.measured.table import Table

HERE = Path(__file__).parents[1]
ROBOT = HERE.parent / "robots" / "tarm_like"
Asked = dict[str, dict[str, dict[str, str]]]
"""Table -> key -> type and default as the reader asks for them."""

TYPES = {
    "text": "text",
    "texts": "list of texts",
    "choice": "one of",
    "flag": "true or false",
    "number": "number",
    "std": "number, 0 or more",
    "quantity": "number, its unit as a suffix",
    "numbers": "numbers",
    "ragged": "rows of numbers",
    "sub": "table",
    "subs": "tables",
    "array_of": "list of tables",
    "raw": "",
    "has": "",
}
OPTIONAL = ("subs", "array_of", "flag", "quantity")


def header(declaration: Declaration) -> str:
    """Return a table's name, with NAME for what the user names."""
    words = [str(key) for key in declaration.keys if isinstance(key, str)]
    for place, first in enumerate(words[:-1]):
        if first in ("payload", "flexure", "preset", "instrument", "law", "spring") or words[: place + 1] == [
            "robot",
            "joint",
        ]:
            words[place + 1] = "NAME"
    return (
        ".".join(words).removeprefix("preset.NAME.") if words[:1] == ["preset"] and len(words) > 2 else ".".join(words)
    )


Note = Callable[[Declaration, str, str, tuple, Mapping], None]
"""(table, accessor, key, arguments, named arguments) of what a reader asks for."""


@contextmanager
def listening(note: Note) -> Iterator[None]:
    """Call `note` with every key that a reader asks for; what an accessor asks another for is not the reader's."""
    inside: list[str] = []

    def noting(name: str, method):
        @functools.wraps(method)
        def ask(self: Declaration, key: str, *given, **named):
            if not inside:
                note(self, name, key, given, named)
            inside.append(name)
            try:
                return method(self, key, *given, **named)
            finally:
                inside.pop()

        return ask

    with ExitStack() as stack:
        for name in TYPES:
            stack.enter_context(patch.object(Declaration, name, noting(name, getattr(Declaration, name))))
        yield


def _note(asked: Asked, self: Declaration, name: str, key: str, given: tuple, named: Mapping) -> None:
    """Note how a key is asked for, and with which default."""
    free = f"{header(self)}.NAME" in KEYS or set(KEYS.get(header(self), ())) == {"NAME"}
    if free and key not in KEYS.get(header(self), ()):  # a name of the user's, not a key
        if set(KEYS.get(header(self), ())) != {"NAME"}:
            return
        key_noted = "NAME"
    else:
        key_noted = key
    entry = asked.setdefault(header(self), {}).setdefault(key_noted, {})
    if name not in ("has", "raw"):
        kind = TYPES[name]
        if name == "choice":
            kind = "one of " + ", ".join(f"`{option}`" for option in given[0])
        if name == "numbers":
            kind = " or ".join(" x ".join(map(str, shape)) or "a number" for shape in given) + " numbers"
        entry.setdefault("type", kind)
        default = {"choice": given[1:], "text": given, "number": given, "std": given}.get(name, ())
        default = (*default, *([named["default"]] if "default" in named else []))
        if default and default[0] is not None:
            entry.setdefault("default", f"{default[0]:g}" if isinstance(default[0], float) else str(default[0]))
    if name in ("has", *OPTIONAL):
        entry["optional"] = "yes"


def arm_keys() -> Asked:
    """Return every key of an arm.toml that a reader asks for while the examples are read."""
    asked: Asked = {}
    with warnings.catch_warnings(), listening(functools.partial(_note, asked)):
        warnings.simplefilter("ignore")
        for file in sorted((HERE / "formats").glob("*.toml")):
            load_arm(file)
    return asked


class _Listened(dict):
    """Columns of a table that note which are asked for."""

    asked: set[str]

    def __contains__(self, name: object) -> bool:
        self.asked.add(str(name))
        return super().__contains__(name)

    def __getitem__(self, name: str):
        self.asked.add(name)
        return super().__getitem__(name)


def columns() -> dict[str, dict[str, str]]:
    """Return every column that the readers ask for, by file, with its kind of quantity."""
    arm = load_arm(HERE / "formats" / "arm.toml")
    rename = {joint: "JOINT" for joint in arm.joint_names}
    board = load_arm(HERE / "formats" / "instruments.toml").sensors["webcam"].about.board
    readers = {
        "measurements.csv": (measurements, lambda file: read_measurements(file, arm), ("x",)),
        "trajectory.csv": (trajectories, lambda file: read_trajectory(file, arm), ()),
        "joint_data.csv": (joint_data, read_joint_data, ()),
        "corners.csv": (pictures, lambda file: pictures.read_corners(file, board), ()),
    }
    found: dict[str, dict[str, str]] = {}
    for name, (module, reader, _) in readers.items():
        asked: set[str] = set()
        kinds: dict[str, str] = {}

        def listened(path, known, *rest, asked=asked, kinds=kinds, **more):
            kinds.update(known)
            table = tables.read_table(path, known, *rest, **more)
            columns = _Listened(table.columns)
            columns.asked = asked
            return Table(table.path, columns, table.lines)

        with warnings.catch_warnings(), patch.object(module, "read_table", listened):
            warnings.simplefilter("ignore")
            reader(HERE / "formats" / name)
        each = {}
        for column in (*COLUMNS[name], *sorted({*asked, *kinds})):
            stem, _, joint = column.partition("_")
            short = f"{stem}_{rename[joint]}" if joint in rename else column
            if column in asked or column in kinds or (short == column and "JOINT" in column):
                each.setdefault(short, kinds.get(column, ""))
        present = {c.partition("_")[0] + "_JOINT" if c.partition("_")[2] in rename else c for c in {*asked, *kinds}}
        found[name] = {column: kind for column, kind in each.items() if column in present}
    return found


def undescribed(asked: Asked, read: Mapping[str, Mapping[str, str]]) -> list[str]:
    """Return what the readers ask for that has no meaning in `keys`."""
    missing = [f"[{table}] {key}" for table, keys in asked.items() for key in keys if key not in KEYS.get(table, {})]
    covariates = {"temperature", "operator", "data_no"}
    return missing + [
        f"{file}: {column}"
        for file, found in read.items()
        for column in found
        if column not in {*COLUMNS[file], *covariates} and column.lower() not in COLUMNS[file]
    ]


def _row(key: str, about: Key | None, said: Mapping[str, str]) -> str:
    about = about or Key("*(no description yet)*")
    default = about.default or said.get("default", "") or ("" if "optional" in said else "**required**")
    default = {"-": "", "": "none"}.get(default, default)
    kind = said.get("type", "")
    return f"| `{key}` | {kind} | {about.unit} | {default} | {about.meaning} |"


def arm_page() -> str:
    """Return the tables of an arm.toml."""
    asked, lines = arm_keys(), []
    for table in (*(table for table in KEYS if table in asked), *(table for table in asked if table not in KEYS)):
        keys = asked[table]
        if set(keys) == {"NAME"}:
            continue
        array = table in ("effect", "flexure.NAME.subjoint", "flexure.NAME.beam")
        name = f"[[{table}]]" if array else f"[{table}]"
        lines += [f"### {'The file' if not table else f'`{name}`'}", ""]
        lines += ["| key | type | unit | default | meaning |", "|---|---|---|---|---|"]
        known = KEYS.get(table, {})
        lines += [
            _row(key, known.get(key), keys[key])
            for key in (*(k for k in known if k in keys), *(k for k in keys if k not in known))
        ]
        lines.append("")
    return "\n".join(lines)


def table_page(file: str, read: Mapping[str, Mapping[str, str]]) -> str:
    """Return the columns of a file."""
    lines = ["| column | unit | also as | default | meaning |", "|---|---|---|---|---|"]
    found = read[file]
    for column in (*(c for c in COLUMNS[file] if c in found), *(c for c in found if c not in COLUMNS[file])):
        about, kind = COLUMNS[file].get(column), found[column]
        if about is None:
            continue
        units = [f"`{column}_{unit}`" for unit in UNITS[kind]] if kind else []
        if column.endswith("_JOINT") and column[0] == "q":
            units = [f"`{column}_{unit}`" for unit in ("deg", "mrad", "mm")]
        also = ", ".join(units[1:4]) if not column.endswith("_JOINT") else ", ".join(units[:3])
        lines.append(f"| `{column}` | {about.unit} | {also} | {about.default or '**required**'} | {about.meaning} |")
    return "\n".join(lines) + "\n"
