"""Recordings reduced to where the arm stood: a row for each stand, with the means of what was recorded in it."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np

from armflex.conventions import Array, in_mm
from armflex.errors import InputError, Place, TableError, listing
from armflex.intake import streams
from armflex.intake.clock import goes_back, times, unread
from armflex.intake.lost import emptied
from armflex.intake.meanings import ANGLE_UNITS
from armflex.intake.record import Record, ranked
from armflex.intake.sources import numbers
from armflex.measured.forces import called_as_load
from armflex.measured.points import LENGTHS

SLOW = re.compile("temp|humid|feucht|press|druck", re.IGNORECASE)
"""In names of what changes by itself: a mean over a stand is as good."""

SAMPLES = 100
"""So many rows that stand and move are samples, whatever their clock is."""


@dataclass(frozen=True, eq=False)
class Recording:
    """A record whose rows are samples.

    Attributes:
        record: Its joints without full turns by which they jump, and filled in, see `filled`.
        time: (N,) of each row [s], stamps that repeat spread between them.
        written: The record as read.
        notes: What was found of its clock.
    """

    record: Record
    time: Array
    written: Record
    notes: tuple[str, ...] = ()

    def steady(self, log: Self, spans: Array, shift: float) -> Self:
        """Return a target's recording without places that are held or left in (K, 2) spans [s] in which the arm stands.

        Its clock is ahead of that of the log by `shift` [s].
        """
        record, (places, _) = self.record, self.record.moved
        joints, _ = log.record.moved
        order, gone = np.argsort(self.time, kind="stable"), np.zeros(len(places), dtype=bool)
        of_log = [streams.between(self.time[order] - shift, log.time, column) for column in joints.T]
        gone[order] = streams.held(places[order], self.time[order], spans + shift, np.column_stack(of_log))
        if gone.any():
            record = emptied(record, record.meant, gone, "is exactly where it was before")
        gone = streams.unsteady(self.time, np.where(gone[:, None], np.nan, places), spans + shift)
        if gone.any():
            record = emptied(record, record.meant, gone, "moves or jumps while the arm stands")
        return replace(self, record=record)

    def rows(self, spans: Array, shift: float) -> Record:
        """Return a row for each stand, with joints on the branch that they are written on, and means of numbers.

        Of a log these are what may be a cause of the arm's errors, such as a motor's current: what of it is in words or
        called as a load is left out, and so is what is recorded beside a target.
        """
        record = streams.reduced(self.record.on_one_side(), self.time, spans, shift)
        columns = list(record.columns)
        for i, meaning in enumerate(record.meant):
            if meaning.kind == "joint" and meaning.unit in ANGLE_UNITS:
                read = numbers(self.written.columns[self.written.header.index(meaning.column)])
                full, means = 2.0 * np.pi / ANGLE_UNITS[meaning.unit], numbers(columns[i])
                middle = 0.5 * (np.nanmin(read) + np.nanmax(read))
                columns[i] = means - full * np.round((means - middle) / full)
        record = replace(record, columns=tuple(columns))
        of_log = [pair for pair in record.of("covariate") if pair[0].is_signal() and record.role == "log"]
        kept = {meaning for meaning, cells in of_log if isinstance(cells, np.ndarray)}
        kept = {meaning for meaning in kept if not called_as_load(meaning.name)}
        record = record.where(
            lambda one: one.is_signal() and one not in kept, kind="unused", why="a signal of a recording"
        )
        return record.where(kept.__contains__, why="its mean while the arm stands")


def standing(records: Sequence[Record]) -> tuple[list[Record], list[str]]:
    """Return records with recordings reduced to where the arm stood, all at once, and what was found of their clocks.

    Raises:
        InputError: The arm never stands, or two recordings do not match.
        TableError: Two programs wrote a recording, or its clock goes back.
    """
    reduced_to, recordings = [filled(record) for record in records], dict[int, Recording]()
    for i in map(list(records).index, ranked(records)):
        if (recording := _recording(reduced_to[i], records[i])) is not None:
            recordings[i] = recording
    if not recordings:
        return reduced_to, []
    first = next(iter(recordings.values()))
    spans, (stands, *notes) = _stands(first)
    notes, shifts = [stands, *(note for one in recordings.values() for note in one.notes), *notes], dict[Path, float]()
    for i, recording in recordings.items():
        shift, path = 0.0, recording.record.path
        if recording is not first and first.record.role == "log":
            if path not in shifts:
                moved = first.record.moved[0], recording.record.moved[0]
                shifts[path], std = streams.offset(first.time, moved[0], recording.time, moved[1])
                about = f"{shifts[path]:+.3f} s" + (f" ± {std:.2g} s" if np.isfinite(std) else "")
                notes.append(f"the clock of {recording.record.title} is {about} off, as the motions say")
            shift = shifts[path]
            recording = recording.steady(first, spans, shift)
        reduced_to[i] = recording.rows(spans, shift)
    return reduced_to, notes


def filled(record: Record) -> Record:
    """Return a log with the joints that are empty in rows of other topics' messages there, see `between`."""
    values = {i: numbers(record.columns[i]) for i, meaning in enumerate(record.meant) if meaning.kind == "joint"}
    gaps = {i: read for i, cells in values.items() if (read := np.isfinite(cells)).any() and not read.all()}
    if record.part or not gaps or (time := times(record)) is None or not np.isfinite(time).all():
        return record
    time, columns = streams.spread(time), list(record.columns)
    for i, read in gaps.items():
        columns[i] = streams.between(time, time[read], values[i][read])
    return replace(record, columns=tuple(columns))


def _recording(record: Record, written: Record) -> Recording | None:
    """Return a record as a recording, None where each row is of a pose."""
    time, (values, unit) = times(record), record.moved
    if time is None or not streams.is_dense(even := streams.spread(time), values, unit):
        if len(values) >= SAMPLES and streams.is_sampled(
            streams.STEP * np.arange(len(values), dtype=float), values, unit
        ):
            text = f"has {len(values)} rows of what stands and moves, samples of a recording, and no clock of one: "
            of_none = unread(record) or "--take COLUMN=time_s says which column it is"
            raise InputError(f"{record.title}: {text}{of_none if time is None else f'its rows are {_step(time)}'}")
        return None
    if (row := goes_back(time, written.moved[0])) is not None:
        text = f"its clock goes back {time[row - 1] - time[row]:.4g} s here: it was set again, or counts over"
        raise TableError(Place(record.path, record.lines[row]), f"{text}: part the file there")
    notes = ()
    if not np.array_equal(time, even):
        stamps = f"{len(np.unique(time))} stamps for {len(time)} rows"
        notes = (f"the clock of {record.title} repeats itself ({stamps}): rows are spread between them",)
    record = _continuous(record, even) if unit == "rad" else record
    places, _ = record.moved
    if (pair := streams.two_sources(even, places, unit)) is not None:
        apart = float(np.linalg.norm(np.nan_to_num(places[pair[1]] - places[pair[0]])))
        here, there = (f"{listing(f'{value:.6g}' for value in places[at])}" for at in pair)
        text = f"{record.part} is at {here} {unit} at {even[pair[0]]:.3f} s here and {there} at {even[pair[1]]:.3f} s,"
        text += f" {in_mm(apart) if unit == 'm' else f'{apart:.4g} {unit}'} apart, to and fro:"
        text += " two programs or instruments wrote it, keep one of them"
        raise TableError(Place(record.path, record.lines[pair[0]]), text.strip())
    return Recording(record, even, written, notes)


def _stands(recording: Recording) -> tuple[Array, list[str]]:
    """Return (K, 2) first and last time [s] of each stand of a recording, and what was found of them."""
    time, (values, unit), title = recording.time, recording.record.moved, recording.record.title
    notes, read = list[str](), time[np.isfinite(values).all(axis=1)]
    before, after = (read.min() - time.min(), time.max() - read.max()) if len(read) else (0.0, 0.0)
    if max(before, after) > streams.STANDS:
        text = f"{title} lacks a joint in its first {before:.4g} s and its last {after:.4g} s"
        notes.append(f"{text}: no row is of then")
    notes += _gaps(title, time, values, unit)
    spans, parted = _parted(recording.record, time, streams.dwells(time, values, unit))
    notes += [f"stands of {title} are parted where {listing(parted)} changes"] if parted else []
    within = [(time >= start) & (time <= end) for start, end in spans]
    there = np.array([np.isfinite(values[rows]).any(axis=0).all() for rows in within], dtype=bool)
    if not there.all() and there.any():
        text = f"{len(spans) - np.count_nonzero(there)} more stands, the first at {spans[there.argmin(), 0]:.4g} s,"
        notes.append(f"{text} are left out: some joint has no position there")
    if not there.any():
        text = f"nothing stands still for {streams.STANDS:g} s in it, whose rows are {_step(time)}"
        raise InputError(f"{recording.record.path}: {text}: a campaign stops for a second at each pose")
    return spans[there], [f"the arm stands {np.count_nonzero(there)} times in {title}", *notes]


def _gaps(title: str, time: Array, values: Array, unit: str) -> list[str]:
    """Return what is said where a recording has no rows for a while, and is elsewhere after it."""
    order = np.argsort(time, kind="stable")
    order = order[np.isfinite(values[order]).all(axis=1)]
    moved = np.abs(np.diff(values[order], axis=0)).max(axis=1, initial=0.0) > streams.STILL[unit]
    lasts = np.diff(time[order])
    gaps = np.flatnonzero(moved & (lasts > 2.0 * streams.STANDS))
    if not len(gaps):
        return []
    longest, begins = float(lasts[gaps].max()), float(time[order[gaps[0]]] - time.min())
    text = f"{title} has no rows for up to {longest:.4g} s, {len(gaps)} times, the first {begins:.4g} s after its start"
    return [f"{text}, and moves meanwhile: no row is of then"]


def _parted(record: Record, time: Array, spans: Array) -> tuple[Array, list[str]]:
    """Return (K, 2) spans [s] in which what the rows are beside their numbers, such as the payload, is the same.

    And the columns that change within one. What changes more often than the arm stands is measured, and no state.
    """
    order, changed = np.argsort(time, kind="stable"), list[str]()
    for meaning, cells in record.of("kept", "covariate"):
        if meaning.is_signal() or SLOW.search(meaning.name):
            continue
        states = np.array(list(map(str, cells)))[order]
        times = time[order][1:][states[1:] != states[:-1]]
        inside = [at for at in times.tolist() if ((spans[:, 0] < at) & (at < spans[:, 1])).any()]
        if not inside or len(times) > len(spans):
            continue
        changed.append(repr(meaning.column))
        for at in inside:
            k = int(np.flatnonzero((spans[:, 0] < at) & (at < spans[:, 1]))[0])
            parts = [(spans[k, 0], np.nextafter(at, -np.inf)), (at + streams.SETTLES, spans[k, 1])]
            parts = [(start, end) for start, end in parts if end - start > streams.SETTLES]
            spans = np.concatenate([spans[:k], np.array(parts).reshape(-1, 2), spans[k + 1 :]])
    return spans, changed


def _continuous(record: Record, time: Array) -> Record:
    """Return a recording of joints without the full turns by which they jump, and empty where they never were."""
    order, columns, notes = np.argsort(time, kind="stable"), list(record.columns), record.notes
    values, _ = record.moved
    gone = np.zeros(len(time), dtype=bool)
    gone[order] = streams.never_there(time[order], values[order])
    if gone.any():
        text = f"{np.count_nonzero(gone)} rows of {record.title} have all joints at 0, and jump from or to there"
        notes = (*notes, f"{text}, as in line {record.lines[int(gone.argmax())]}: they are left out")
    joints = [(i, meaning) for i, meaning in enumerate(record.meant) if meaning.kind == "joint"]
    for (i, meaning), column in zip(joints, np.where(gone[:, None], np.nan, values)[order].T, strict=True):
        rows, turning = order[read := np.isfinite(column)], meaning.unit in ANGLE_UNITS
        there = streams.unwrapped(column[read]) if turning else column[read]
        if gone.any() or (there != column[read]).any():
            cells = np.full(len(time), np.nan)
            cells[rows] = there / (LENGTHS | ANGLE_UNITS)[meaning.unit or ""]
            columns[i] = cells
    return replace(record, columns=tuple(columns), notes=notes)


def _step(time: Array) -> str:
    apart = f"{float(np.median(np.diff(np.sort(time)))):.3g} s apart"
    return apart if np.isfinite(time).all() else "without a time in some lines"
