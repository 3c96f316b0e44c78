"""Which row of an export each row of a log has: by name, by time, or by their order; refused where none is certain."""

import re
from collections import Counter
from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Self

import numpy as np

from armflex.conventions import NUMBER
from armflex.errors import FEW, InputError, Place, TableError, listing
from armflex.intake.clock import times
from armflex.intake.meanings import CIRCUMSTANCE, COUNTS, Meaning
from armflex.intake.names import Pairing, is_resorted, paired_names
from armflex.intake.record import Record
from armflex.intake.sources import Cells, numbers
from armflex.intake.streams import nearest, paired

TARGET = re.compile(
    r"(.+?)(?:(?:(?<=\d)|[ _\-.:])T|[ _\-.:]*(?:SMR|TGT|TARGET|PRISM|REFL\w*))[ _\-]?(\d)", re.IGNORECASE
)
"""How the name of a point ends that is of one target among several; not that of `Punkt_1`."""


@dataclass(frozen=True, eq=False)
class Match:
    """Which row of an export each row of a log has.

    Attributes:
        row_of: By target, (N,) row of the export, -1 for none.
        names: (N,) what rows are called.
        how: What says so, in words.
        notes: What belongs to nothing.
    """

    row_of: dict[str, np.ndarray]
    names: list[str]
    how: str
    notes: tuple[str, ...] = ()


def matched(log: Record, names: list[str], export: Record) -> Match:
    """Return which row of an export each row of a log has.

    By name where the files share any; by time where both have a clock and one is a recording, or their order is in
    doubt; else row by row where they are as long, else by time.

    Raises:
        TableError: Nothing says which rows are of one another: names that differ are no order.
    """
    sides = _Sides.of(log, names, export)
    if (pairing := sides.pairing) is not None:
        return sides.by_name(pairing)
    if log.spans is not None and export.spans is log.spans:
        empty = sum(not line for line in export.lines)
        notes = (f"{empty} of them have no reading of {export.title}",) if empty else ()
        return Match({"": np.arange(len(names))}, names, "by time", notes)
    if sides.timed and (match := sides.by_time()) is not None:
        return match
    return sides.by_order()


@dataclass(frozen=True, eq=False)
class _Sides:
    """A log of N rows and an export of M points or pictures that belong together, and what their rows are called.

    Attributes:
        wanted, given: (N,) and (M,) names of rows and points as written, None where a side has none.
        split: (M,) names of points without groups, and which target of several each is of.
        rows_of: Rows of each target, '' where there is one.
        counted: Whether names of rows only count them.
        equal: Whether each target has as many points as there are rows.
    """

    log: Record
    export: Record
    names: list[str]
    what: str
    wanted: list[str] | None
    given: list[str] | None
    split: list[tuple[str, str]]
    rows_of: dict[str, np.ndarray]
    counted: bool
    equal: bool

    @classmethod
    def of(cls, log: Record, names: list[str], export: Record) -> Self:
        wanted, given = (
            None if (cells := side.cells("name")) is None else [*map(str, cells)] for side in (log, export)
        )
        what = "picture" if export.has("picture") else "point"
        if what == "picture":
            pictured, given = log.cells("picture"), given or []
            wanted = names if pictured is None else [Path(str(picture)).stem for picture in pictured]
        labels = [""] * len(export.lines) if given is None else [*map(_bare, given)]
        split = [(match[1], match[2]) if (match := TARGET.fullmatch(label)) else (label, "") for label in labels]
        if what == "picture" or not all(len(set(parts)) > 1 for parts in zip(*split, strict=True)):
            split = [(label, "") for label in labels]
        targets = sorted({target for _, target in split}) or [""]
        rows_of = {target: np.array([i for i, (_, of) in enumerate(split) if of == target]) for target in targets}
        counted = what == "point" and any(one.kind == "name" and one.why == COUNTS for one in log.meant)
        equal = all(len(rows) == len(names) for rows in rows_of.values())
        return cls(log, export, names, what, wanted, given, split, rows_of, counted, equal)

    @property
    def several(self) -> str:
        return f", targets {listing(self.rows_of)}" if len(self.rows_of) > 1 else ""

    @cached_property
    def pairing(self) -> Pairing | None:
        """What names of both are of one another by, None where they share none for certain."""
        if self.wanted is None or self.given is None:
            return None
        pairing = paired_names(self.wanted, [base for base, _ in self.split])
        certain = pairing is not None and (not self.counted or pairing.shared >= set(pairing.points))
        return pairing if certain else None

    @cached_property
    def unlike(self) -> bool:
        """Whether both have names, and they are not the same."""
        named = all(cells is not None and len(set(cells)) > 1 for cells in (self.wanted, self.given))
        return self.what == "point" and not self.counted and named

    @cached_property
    def called(self) -> list[str]:
        """(N,) names of the first target's points."""
        return [self.split[i][0] for i in next(iter(self.rows_of.values()))]

    @cached_property
    def resorted(self) -> bool:
        """Whether the names that one of both has say that it stands in another order."""
        unnamed = self.wanted is None or self.counted
        if self.what == "picture" or (self.given is None) == unnamed:
            return False
        return is_resorted(self.called if unnamed else self.names)

    @cached_property
    def timed(self) -> bool:
        """Whether both have a clock, and it says more than names and order do."""
        at, of = times(self.log), times(self.export)
        if at is None or of is None or np.isnan(at).any() or np.isnan(of).any():
            return False
        if self.log.spans is not None or self.export.spans is not None or not self.equal:
            return True
        orders = [np.argsort(time, kind="stable") for time in (at, of)]
        return self.unlike or self.resorted or (len(self.rows_of) == 1 and bool((orders[0] != orders[1]).any()))

    def by_name(self, pairing: Pairing) -> Match:
        row_of, spare, repeated = {}, list[int](), Counter(pairing.rows)
        for target, rows in self.rows_of.items():
            left: dict[Hashable, list[int]] = {}
            for i in rows.tolist():
                left.setdefault(pairing.points[i], []).append(i)
            for key, places in left.items():
                if key in repeated and len(places) != repeated[key]:
                    here = in_lines([self.export.lines[i] for i in places])
                    there = in_lines([self.log.lines[i] for i, name in enumerate(pairing.rows) if name == key])
                    text = f"{self.what} {self.split[places[0]][0]!r} stands in {here} here and in {there} of"
                    text += f" {self.log.path.name}: which is of which row is not known; leave out what does not"
                    place = Place(self.export.path, self.export.lines[places[-1]])
                    raise TableError(place, f"{text} count, or give each a name of its own")
            row_of[target] = np.array([left[key].pop(0) if left.get(key) else -1 for key in pairing.rows])
            spare += [self.export.lines[i] for lines in left.values() for i in lines]
        notes, count = list[str](), len(self.names)
        alone = sum(all(row[i] < 0 for row in row_of.values()) for i in range(count))
        if 2 * alone > count and 2 * len(spare) > len(self.export.lines):
            text = f"only {count - alone} of {count} rows of {self.log.path.name} have a {self.what} of their name, and"
            text += f" {len(spare)} {self.what}s have no row: are they of one another? Give both the same names"
            raise TableError(Place(self.export.path), text)
        if spare:
            at = listing(map(str, sorted(spare)), 5)
            notes.append(f"{len(spare)} {self.what}s of {self.export.path.name} belong to no row (lines {at})")
        if empty := [self.names[i] for i in range(count) if all(row[i] < 0 for row in row_of.values())]:
            notes.append(f"{listing(empty, 5)} without a {self.what}: {len(empty)} of {count} rows stay empty")
        pairs = ((self.names[i], self.split[row[i]][0]) for row in row_of.values() for i in range(count) if row[i] >= 0)
        if (pair := next((pair for pair in pairs if pair[0] != pair[1]), None)) and self.what == "point":
            notes.append(f"names are written in two ways: {pair[0]!r} of the log is point {pair[1]!r}")
        how = f"by {'the number in their names' if pairing.numbered else 'name'}{self.several}"
        return Match(row_of, self.names, how, tuple(notes))

    def by_time(self) -> Match | None:
        """Return which row is of which by their clocks, None where no time is near another."""
        at, of, count = np.asarray(times(self.log)), np.asarray(times(self.export)), len(self.names)
        row_of, shifts, apart, spare = {}, list[float](), list[float](), list[int]()
        for target, rows in self.rows_of.items():
            base, seconds = (self.log.spans, of[rows]) if self.export.spans is None else (self.export.spans, at)
            try:
                places, shift = nearest(at, seconds) if base is None else paired(base, seconds)
            except InputError as error:
                raise TableError(Place(self.export.path), f"{error}") from None
            shifts.append(shift)
            if self.export.spans is not None:
                row_of[target] = places
                continue
            row_of[target] = row = np.full(count, -1)
            for i, place in zip(rows, places, strict=True):
                if place >= 0 and row[place] < 0:
                    row[place] = i
                else:
                    spare.append(self.export.lines[i])
            apart += np.abs(of[row[row >= 0]] - shift - at[row >= 0]).tolist()
        empty = sum(all(row[i] < 0 for row in row_of.values()) for i in range(count))
        if empty == count:
            return None
        off, what = max(shifts, key=abs), self.what
        notes = [f"the clocks are {off:+.2f} s apart, as most {what}s then fall on a row"] if off else []
        notes += [f"{empty} rows have no {what} at their time"] if empty else []
        if spare:
            notes.append(f"{len(spare)} {what}s of {self.export.path.name} belong to no row ({in_lines(spare)})")
        how = f"by time{self.several}" + (f", {float(np.median(apart)):.3g} s apart" if apart else "")
        names, about = self.by_points(row_of)
        return Match(row_of, names, how, (*notes, *about))

    def by_points(self, row_of: dict[str, np.ndarray]) -> tuple[list[str], list[str]]:
        """Return what rows are called, by their points where a log has no names of its own, and what is left out."""
        if self.wanted is not None or self.given is None or self.what == "picture":
            return self.names, []
        at = [next((row[i] for row in row_of.values() if row[i] >= 0), -1) for i in range(len(self.names))]
        called = [self.split[k][0] for k in at if k >= 0]
        if (twice := next((name for name in called if called.count(name) > 1 or not name), None)) is not None:
            return self.names, [f"rows are not called as points are: several of those are called {twice!r}"]
        others = [f"row {name}" if name in called else name for name in self.names]
        return [self.split[k][0] if k >= 0 else other for k, other in zip(at, others, strict=True)], []

    def by_order(self) -> Match:
        log, export, given = self.log.path.name, self.export.path.name, self.given
        header = [
            next((one.column for one in side.meant if one.kind == "name"), "") for side in (self.log, self.export)
        ]
        if self.equal and (self.unlike or self.resorted):
            points = f"points are called {listing(dict.fromkeys(map(_bare, given or ())), 3)}"
            rows = f"the rows of {log} are called {listing(dict.fromkeys(self.names), 3)}"
            text = points if given is not None else f"{export} has no names"
            text += f", and {rows if self.wanted is not None and not self.counted else f'{log} has no names'}: which is"
            text += " of which is not certain. Give both the same names, or --take"
            column = header[0] if self.unlike or given is None else header[1]
            raise TableError(Place(self.export.path), f"{text} '{column}=unused' joins them row by row")
        if self.equal:
            named = given is not None and self.wanted is None and self.what == "point"
            how = f"row by row: no name is in both files{self.several}"
            return Match(self.rows_of, self.called if named else self.names, how)
        per = listing(map(str, {len(rows) for rows in self.rows_of.values()}))
        text = f"{len(self.names)} rows of {log} and {per} {self.what}s of {export} share no name and no time: add a"
        text += (
            " column 'point' to the log, or the same names to both, or say with --take 'COLUMN=time' which column of"
        )
        raise TableError(Place(self.export.path), f"{text} each is its clock")


def _bare(name: str) -> str:
    """Return the name of a point without the groups that it is in, `A::Main::P1`."""
    return name.split("::")[-1].strip()


def in_lines(lines: Sequence[int]) -> str:
    """Return lines of a file in words."""
    return f"line{'s' if len(lines) > 1 else ''} {listing(map(str, lines), 5)}"


def named_alike(record: Record, others: Sequence[Record]) -> Record:
    """Return a record without names with those of a column without a meaning, where it has one that names its rows.

    Such are most names of the rows of others, or of their columns of texts where they have no names either; and what
    counts rows in an order of its own.
    """
    if record.part or any(meaning.kind == "name" and meaning.why != COUNTS for meaning in record.meant):
        return record
    labels = list[str]()
    for other in others:
        cells = [cells for meaning, cells in other.of("name") if meaning.why != COUNTS]
        cells = cells or [cells for _, cells in _naming(other) if not any(map(NUMBER.fullmatch, cells))]
        labels += [_bare(str(label)) for several in cells for label in several]
    labels += [match[1] for label in labels if (match := TARGET.fullmatch(label))]
    for meaning, cells in _naming(record):
        counts = _counts_anew(cells)
        pairing = paired_names(list(map(str, cells)), labels, by_number=counts) if labels else None
        if counts or (pairing is not None and 2 * len(pairing.shared) > len(cells)):
            why = "the points' names" if pairing is not None else "counts in another order"
            record = record.where(lambda one: one.kind == "name", kind="unused")
            return record.where([meaning].__contains__, kind="name", name="pose", unit="", why=why)
    return record


def _naming(record: Record) -> Iterator[tuple[Meaning, Cells]]:
    """Yield the columns without a meaning that may name rows: texts and whole numbers."""
    for meaning, cells in record.of("covariate", "unused"):
        plain = meaning.why not in (COUNTS, "as asked") and not CIRCUMSTANCE.fullmatch(meaning.name)
        if plain and not isinstance(cells, np.ndarray) and not (numbers(cells) % 1.0 > 0.0).any():
            yield meaning, cells


def _counts_anew(cells: Cells) -> bool:
    """Return whether cells count rows from 0 or 1, or texts with a number do, and not upwards."""
    values = np.sort(numbers(cells))
    every = bool(np.isfinite(values).all() and values[0] in (0.0, 1.0) and (np.diff(values) == 1.0).all())
    return len(cells) >= FEW and (every or bool(np.isnan(values).all())) and is_resorted(list(map(str, cells)))
