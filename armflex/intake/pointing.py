"""Pointing runs of telescopes and antennas: TPOINT's input files, and records of the MMT's mount.

A row has where a star was and where the axes stood when it was centred. A file of TPOINT (Wallace, TPOINT: A Telescope
Pointing Analysis System, "Pointing data"; JCMT, "Pointing Data Format under TPOINT") has a caption, options that begin
with a colon, run parameters (latitude in degrees, minutes and seconds, date, temperature, pressure ..), a line for each
observation, and END; `!` and `;` begin comments. Observations are

    azimuth elevation, of the star and of the axes, in degrees, and the rotator's angle    (format 4)
    the same in degrees, minutes and seconds
    right ascension and declination, of the star (apparent place) and of the axes, and the sidereal time

An equatorial mount is one whose base looks at the pole: hour angle and declination are its azimuth and elevation.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from armflex.conventions import NUMBER, STANDARD_GRAVITY, Array
from armflex.errors import InputError, ManyErrors, Place, TableError, listing, shown
from armflex.intake.campaign import Intake
from armflex.measured.table import text_lines

COMMENT = re.compile(r"[!;]")
OPTION = re.compile(r"\s*:\s*([A-Z]\w*)\s*", re.IGNORECASE)
MOUNTS = {"ALTAZ": ("az", "el"), "EQUAT": ("ha", "dec")}
"""Option that names a kind of mount -> what its joints are called."""

RECORD = re.compile(r"([A-Z][A-Z_]*):\s*(.*)")
AXES_AT, STAR_AT = "RAA", "TAA"
"""Keys of the MMT's records: elevation and azimuth of the axes' encoders, and of the star [deg]."""

LOOKED_AT = 60
"""Lines by which a file is known."""

FIELDS = ("year", "month", "day", "temperature_C", "pressure_hPa", "height", "humidity", "wavelength_um")
"""Run parameters after the latitude."""

USUAL_OFFSET = 5e-3
"""Prior: standard deviation of the zero of an axis [rad], unless a run shows it to be further off."""

SIDEREAL = 0.99726957
"""Seconds in one of sidereal time."""

STAR, TURN, DAY = "star", 2.0 * np.pi, 86400.0


@dataclass(frozen=True, eq=False)
class Run:
    """A pointing run.

    Attributes:
        path: The file.
        joints: Names of its two axes.
        lines: (N,) line of each observation.
        axes: (N, 2) positions of the axes [rad].
        star: (N, 2) azimuth and elevation of the star, or hour angle and declination [rad].
        names: (N,) of the stars, or numbers of the observations.
        time: (N,) [s] from the first, None where no time is recorded.
        beside: Further columns by name, (N,) numbers or texts.
        latitude: [rad], None where none is stated.
        air: What of `FIELDS` is stated of the air, of a run whose places are without refraction.
        notes: What was left out, and what is to be known.
    """

    path: Path
    joints: tuple[str, str]
    lines: tuple[int, ...]
    axes: Array
    star: Array
    names: tuple[str, ...]
    time: Array | None = None
    beside: dict[str, Sequence[Any]] = field(default_factory=dict)
    latitude: float | None = None
    air: dict[str, float] | None = None
    notes: tuple[str, ...] = ()

    @property
    def columns(self) -> dict[str, Sequence[Any]]:
        """Of a campaign, by name."""
        columns: dict[str, Sequence[Any]] = {"pose": self.names}
        columns |= {} if self.time is None else {"time": self.time.tolist()}
        columns |= {f"q_{name}": positions.tolist() for name, positions in zip(self.joints, self.axes.T, strict=True)}
        columns |= dict(zip((f"{STAR}_azimuth", f"{STAR}_elevation"), self.star.T.tolist(), strict=True))
        return columns | self.beside


def is_pointing(path: Path) -> bool:
    """Return whether a file is a pointing run, by its first lines."""
    if path.is_dir() or path.suffix.lower() not in (".dat", ".pnt", ".txt", ".raw", ""):
        return False
    try:
        first = [line for line, _ in zip(text_lines(path), range(LOOKED_AT), strict=False)]
    except TableError:
        return False
    if any(line.startswith(f"{AXES_AT}:") for line in first):
        return True
    kept = [text for _, text in _kept(first)]
    if any(OPTION.fullmatch(text) for text in kept[1:8]):
        return True
    # Without options: a caption, the latitude, and observations that are long.
    return len(kept) > 2 and len(_latitude(kept[1])) >= 3 and len(_numbers(kept[2])) >= 12


def _kept(lines: Sequence[str]) -> Iterator[tuple[int, str]]:
    """Yield number and text of every line that is not empty without its comment; the caption may have any sign."""
    caption = False
    for number, line in enumerate(lines, 1):
        text = line.strip()
        if not caption and text and not COMMENT.match(text):
            caption = True
            yield number, text
        elif kept := COMMENT.split(text)[0].strip():
            yield number, kept


def _numbers(text: str) -> list[float]:
    """Return the numbers that a line begins with; colons between them are blanks."""
    numbers = []
    for cell in text.replace(":", " ").replace(",", " ").split():
        if not NUMBER.fullmatch(cell):
            break
        numbers.append(float(cell))
    return numbers


def _latitude(text: str) -> list[float]:
    """Return the numbers of a line that may be run parameters, none of another."""
    parts = _numbers(text)
    fine = len(parts) in (1, *range(3, 13)) and abs(parts[0]) <= 90.0
    return parts if fine and all(0.0 <= part < 60.0 for part in parts[1:3]) else []


def _read_tpoint(path: Path, lines: Sequence[str]) -> Run:
    kept = list(_kept(lines))
    ended = next((i for i, (_, text) in enumerate(kept) if text.upper() == "END"), len(kept))
    notes = [] if ended < len(kept) else [f"{path.name} has no END, and may have been cut"]
    kept = kept[1:ended]
    options = [match[1].upper() for _, text in kept if (match := OPTION.fullmatch(text))]
    rows = [(number, text) for number, text in kept if not OPTION.fullmatch(text)]
    mounts = [option for option in options if option in (*MOUNTS, "GIMBAL")]
    if "GIMBAL" in mounts or len(mounts) > 1:
        raise TableError(Place(path), f"is of mounts {listing(mounts)}, expected one of {listing(MOUNTS)}")
    other = [option for option in options if option not in (*MOUNTS, "NODA", "ALLSKY") and not option.startswith("ROT")]
    notes += [f"options {listing(other)} are not used"] if other else []
    if not rows or not (given := _latitude(rows[0][1])):
        place = Place(path, rows[0][0] if rows else 1)
        raise TableError(place, "expected the latitude, degrees minutes seconds, and what is known of date and air")
    latitude = np.radians(_sexagesimal(path, rows[0][0], rows[0][1], 0) if len(given) > 2 else given[0])
    stated = dict(zip(FIELDS, given[3:], strict=False))
    rows = rows[1:]
    if not rows:
        raise TableError(Place(path), "has no observations")
    counts = [len(_numbers(text)) for _, text in rows]
    form, width = _form(path, rows[0], counts[0], mounts)
    for (number, text), count in zip(rows, counts, strict=True):
        if count < width:
            raise TableError(Place(path, number), f"is {shown(text, 60)}, expected {width} numbers: {form}")
    joints = MOUNTS[mounts[0] if mounts else "EQUAT"]
    time = None
    if width == 4:
        values = np.radians([_numbers(text)[:4] for _, text in rows])
        star, axes = values[:, :2], values[:, 2:]
    elif width == 12:
        each = [[_sexagesimal(path, number, text, 3 * i) for i in range(4)] for number, text in rows]
        star, axes = np.radians(np.array(each)[:, :2]), np.radians(np.array(each)[:, 2:])
    else:
        star, axes, time = _from_hours(path, rows, np.float64(latitude), joints == MOUNTS["ALTAZ"])
        notes.append("places are apparent ones: what the air bends is in [instrument.star] refraction")
    air = {name: stated[name] for name in FIELDS[3:] if name in stated and name != "height"} if width == 14 else None
    names = tuple(str(i) for i in range(1, len(rows) + 1))
    beside = _beside(rows, width, any(option.startswith("ROT") for option in options))
    lines_of = tuple(number for number, _ in rows)
    return Run(path, joints, lines_of, axes, star, names, time, beside, float(latitude), air, tuple(notes))


def _form(path: Path, row: tuple[int, str], count: int, mounts: Sequence[str]) -> tuple[str, int]:
    """Return what a row has, in words, and how many numbers that are; raise for none, or an open kind of mount."""
    place, cells = Place(path, row[0]), row[1].split()
    equinox = next((cell for cell in cells[6:9] if re.fullmatch(r"[JB]?(?:1[89]|2[01])\d\d(?:\.\d*)?", cell)), None)
    if count >= 8 and equinox is not None:
        text = f"gives a place of the catalogue for equinox {equinox}: precession and aberration are not computed"
        raise TableError(place, f"{text}. Give apparent places, or azimuth and elevation as observed (format 4)")
    if count >= 14:
        return "right ascension and declination of the star and of the axes, and the sidereal time", 14
    altaz = list(mounts) == ["ALTAZ"]
    if count >= 12 and altaz:
        return "azimuth and elevation of the star and of the axes, degrees minutes seconds", 12
    if 4 <= count < 12 and altaz:
        return "azimuth and elevation of the star and of the axes [deg]", 4
    hint = "" if altaz else "; azimuth and elevation need the option : ALTAZ"
    raise TableError(place, f"is {shown(row[1], 60)}: {count} numbers are no observation of this mount{hint}")


def _sexagesimal(path: Path, line: int, text: str, first: int, most: float = 360.0) -> float:
    """Return the angle or time of three numbers of a line; its sign is that before the first, also of -0."""
    cells = text.replace(":", " ").replace(",", " ").split()[first : first + 3]
    whole, minutes, seconds = (abs(float(cell)) for cell in cells)
    if whole > most or minutes >= 60.0 or seconds >= 60.0 or any(cell.startswith("-") for cell in cells[1:]):
        raise TableError(Place(path, line), f"has {' '.join(cells)!r}, expected up to {most:g}, minutes and seconds")
    return (-1.0 if cells[0].startswith("-") else 1.0) * (whole + minutes / 60.0 + seconds / 3600.0)


def _from_hours(
    path: Path, rows: Sequence[tuple[int, str]], latitude: np.float64, altaz: bool
) -> tuple[Array, Array, Array]:
    """Return (N, 2) star and axes [rad], hour angle and declination or azimuth and elevation, and (N,) times [s]."""
    readings, sidereal = [], []
    for number, text in rows:
        hours = [_sexagesimal(path, number, text, i, 24.0) for i in (0, 6)]
        degrees = [_sexagesimal(path, number, text, i) for i in (3, 9)]
        clock = _numbers(text)[12:14]
        if not (0.0 <= clock[0] <= 24.0 and 0.0 <= clock[1] < 60.0):
            raise TableError(
                Place(path, number), f"has the sidereal time {clock[0]:g} {clock[1]:g}, expected h and min"
            )
        sidereal.append(3600.0 * clock[0] + 60.0 * clock[1])
        readings.append([15.0 * hours[0], degrees[0], 15.0 * hours[1], degrees[1]])
    places, clock = np.radians(readings), np.array(sidereal)
    angles = [np.column_stack([(TURN * clock / DAY - pair[:, 0] + np.pi) % TURN - np.pi, pair[:, 1]])
              for pair in (places[:, :2], places[:, 2:])]  # fmt: skip
    star, axes = (_level(pair, latitude) for pair in angles) if altaz else angles
    return star, axes, SIDEREAL * np.concatenate([[0.0], np.cumsum(np.diff(clock) % DAY)])


def _level(place: Array, latitude: np.float64) -> Array:
    """Return (N, 2) azimuth from north to east and elevation of (N, 2) hour angles and declinations [rad]."""
    (hour, declination), (s, c) = place.T, (np.sin(latitude), np.cos(latitude))
    north = np.sin(declination) * c - np.cos(declination) * np.cos(hour) * s
    up = np.sin(declination) * s + np.cos(declination) * np.cos(hour) * c
    return np.column_stack([np.arctan2(-np.cos(declination) * np.sin(hour), north), np.arcsin(np.clip(up, -1.0, 1.0))])


def _beside(rows: Sequence[tuple[int, str]], width: int, rotated: bool) -> dict[str, Sequence[Any]]:
    """Return what stands in every row after the observation: the rotator's angle [rad], and other columns."""
    cells = [text.replace(":", " ").replace(",", " ").split()[width:] for _, text in rows]
    columns: dict[str, Sequence[Any]] = {}
    for i in range(min(map(len, cells))):
        texts = [row[i] for row in cells]
        numeric = all(NUMBER.fullmatch(cell) for cell in texts)
        if i == 0 and rotated and numeric:
            columns["rotator"] = np.radians([float(cell) for cell in texts]).tolist()
        else:
            columns[f"aux{i + 1}"] = [float(cell) for cell in texts] if numeric else texts
    return columns


def _read_records(path: Path, lines: Sequence[str]) -> Run:
    """Read records of `KEY: values`, each of which begins with CAT, or where a key comes again."""
    records: list[tuple[int, dict[str, str]]] = []
    for number, line in enumerate(lines, 1):
        match = RECORD.fullmatch(line.strip())
        if match is None:
            if line.strip():
                raise TableError(Place(path, number), f"is {shown(line.strip(), 60)}, expected a record's KEY: values")
            continue
        if not records or match[1] == "CAT" or match[1] in records[-1][1]:
            records.append((number, {}))
        records[-1][1][match[1]] = match[2]
    whole = [record for record in records if AXES_AT in record[1] and STAR_AT in record[1]]
    cut = [str(number) for number, record in records if AXES_AT not in record or STAR_AT not in record]
    notes = [f"{len(cut)} records without {AXES_AT} or {STAR_AT} are left out (lines {listing(cut, 5)})"] if cut else []
    angles = np.empty((len(whole), 2, 2))
    for row, (number, record) in zip(angles, whole, strict=True):
        for place, key in zip(row, (AXES_AT, STAR_AT), strict=True):
            values = _numbers(record[key])
            if len(values) != 2 or len(record[key].split()) != 2:
                raise TableError(
                    Place(path, number), f"{key} is {shown(record[key], 40)}, expected elevation and azimuth"
                )
            place[:] = np.radians(values[::-1])
    if not len(angles):
        raise TableError(Place(path), f"has no record with {AXES_AT} and {STAR_AT}")
    names = tuple((record.get("CAT", "").split() or [str(i)])[0] for i, (_, record) in enumerate(whole, 1))
    twice = len(set(names)) < len(names)
    names = tuple(f"{name} {i}" for i, name in enumerate(names, 1)) if twice else names
    time = None
    if all("LST" in record for _, record in whole):
        clock = np.array([3600.0 * _sexagesimal(path, number, record["LST"], 0, 24.0) for number, record in whole])
        time = SIDEREAL * np.concatenate([[0.0], np.cumsum(np.diff(clock) % DAY)])
    lines_of = tuple(number for number, _ in whole)
    return Run(path, MOUNTS["ALTAZ"], lines_of, angles[:, 0], angles[:, 1], names, time, notes=tuple(notes))


def joined_runs(paths: Sequence[Path], taken: Mapping[str, str], sigma: float | None) -> Intake:
    """Return pointing runs as one campaign, each a session where they are several.

    Args:
        paths: The files, a run among them.
        taken, sigma: What is asked of other files.

    Raises:
        InputError: Not all are runs of one mount, or something is asked that runs say themselves.
        ManyErrors: With what is wrong in each.
    """
    runs, read, wrong = [path for path in paths if is_pointing(path)], list[Run](), list[str]()
    if others := [str(path) for path in paths if path not in runs]:
        raise InputError(f"{runs[0]} is a pointing run, a campaign by itself: {listing(others)} cannot be joined to it")
    if taken or sigma is not None:
        text = "its columns and units are known; how well a direction is known is `sigma` of [instrument.star]"
        raise InputError(f"{runs[0]} is a pointing run: leave out --{'take' if taken else 'sigma'}, {text}")
    for path in runs:
        try:
            texts = list(text_lines(path))
            recorded = any(text.startswith(f"{AXES_AT}:") for text in texts[:LOOKED_AT])
            read.append((_read_records if recorded else _read_tpoint)(path, texts))
        except TableError as error:
            wrong.append(str(error))
    if wrong:
        raise ManyErrors(wrong)
    if len({run.joints for run in read}) > 1:
        raise InputError(f"{listing(map(str, runs))} are of mounts with different axes: give those of one mount")
    every = [run.columns for run in read]
    shared = [name for name in every[0] if all(name in columns_of for columns_of in every)]
    columns: dict[str, Sequence[Any]] = {
        name: [cell for columns_of in every for cell in columns_of[name]] for name in shared
    }
    if len(read) > 1:
        columns["session"] = [run.path.stem for run in read for _ in run.lines]
        columns["pose"] = [f"{run.path.stem} {name}" for run in read for name in run.names]
    table = tuple(meaning for run in read for meaning in _meanings(run))
    notes, lines = tuple(note for run in read for note in run.notes), tuple(line for run in read for line in run.lines)
    how = "to nothing: a row has star and axes"
    return Intake(columns, table, how, _instrument_text(read[0]), notes, lines, read[0].path, _mount_text(read[0]))


def _instrument_text(run: Run) -> str:
    """Return the table of an arm file for what a run reads."""
    lines = [
        f"[instrument.{STAR}]",
        'kind = "direction"',
        'link = "flange"            # the tube, the dish: what points',
    ]
    lines += ["axis = [1.0, 0.0, 0.0]     # the axis that points, in the link's frame", 'azimuth = "north_to_east"']
    if run.air and "pressure_hPa" in run.air:
        air = ", ".join(f"{name} = {value:g}" for name, value in run.air.items())
        lines.append(f"refraction = {{ {air} }}")
    return "\n".join([*lines, "sigma = 5e-6               # rad on the sky, 1 arcsec"])


def _mount_text(run: Run) -> str:
    """Return an arm file of a mount with the two axes of a run; of an equatorial one the base's z is at the pole."""
    down = [0.0, 0.0, -STANDARD_GRAVITY]
    if run.joints == MOUNTS["EQUAT"]:
        if run.latitude is None:
            raise InputError(f"{run.path}: --arm needs the latitude of an equatorial mount")
        down = [-STANDARD_GRAVITY * float(part(run.latitude)) for part in (np.cos, np.sin)]
        down.insert(1, 0.0)
    first, second = run.joints
    lines = ["[robot]", 'dh = "modified"', f"gravity = [{', '.join(f'{component:.9g}' for component in down)}]"]
    lines += ["tool = { xyz = [1.0, 0.0, 0.0], rpy = [0.0, 0.0, 0.0] }   # the far end of what points", ""]
    lines += ["[robot.joint]", f"{first} = {{ alpha_deg = 180, mass = 10.0 }}"]
    lines += [
        f"{second} = {{ alpha_deg = -90, mass = 10.0, com = [0.5, 0.0, 0.0] }}   # weight of what points: yours",
        "",
    ]
    lines += ["[flexure.tube]", f'joint = "{second}"', "compliance = [0, 0, 0, 1e-6, 1e-6, 1e-6]   # rad/Nm: yours", ""]
    apart = (run.star - run.axes + np.pi) % TURN - np.pi  # axes and stars: the zeros of the axes are as far off
    lines += [
        _instrument_text(run),
        "",
        "[prior]",
        f"joint_offset = {max(USUAL_OFFSET, 2.0 * float(np.abs(np.median(apart, axis=0)).max())):.1g}",
        "geometry = 2e-3",
        "compliance = 2.0",
    ]
    return "\n".join(lines) + "\n"


def _meanings(run: Run) -> Iterator[tuple[str, str, str, str, str]]:
    """Yield file, column, what it is, unit and why, of what a run has."""
    name, (first, second) = run.path.name, run.joints
    title = "TPOINT's form" if run.latitude is not None else "the MMT's records"
    angles = ("azimuth", "elevation") if first == "az" else ("hour angle", "declination")
    for joint, angle in zip((first, second), angles, strict=True):
        yield name, f"{angle} of the axes", f"joint {joint}", "rad", title
    for column, angle in zip(("azimuth", "elevation"), angles, strict=True):
        yield name, f"{angle} of the star", f"{STAR}_{column}", "rad", title
    for column in (*(("time",) if run.time is not None else ()), *run.beside):
        yield name, column, "time" if column == "time" else "a covariate", "", title
