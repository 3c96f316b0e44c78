"""Several campaigns of one machine as one: its rows one after the other, and nothing known between their instruments.

Each campaign has the name of its file. Its sessions are called 'campaign/session', or as the campaign where there
is only one; its poses likewise, but for those that several campaigns were driven to by one name.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from armflex.arm import Arm
from armflex.conventions import Array
from armflex.errors import Flag, InputError, MissingCovariateError, UnsupportedError, listing, naming
from armflex.measured.measurements import Measurements, as_measurements
from armflex.measured.table import Tabular
from armflex.readings import Kind, Readings, Touch
from armflex.rows.branch import Branch
from armflex.rows.period import Period
from armflex.rows.rows import LEVEL_OF
from armflex.rows.wrench import Wrench

CAMPAIGN = "campaign"
"""Column of a joined campaign with the name of each row's, a text: what is of one of them alone depends on it."""

COMMANDED = 0.02
"""Joint positions nearer than this [rad or m] are one commanded pose where campaigns call them by one name: the
controller of a machine that was moved reports them otherwise, and a split for validation must not part them."""


def as_campaign(campaigns: Measurements | Tabular | Sequence[Measurements | Tabular], arm: Arm) -> Measurements:
    """Return one campaign as it is or as `as_measurements` reads it, and several `joined`."""
    if isinstance(campaigns, list | tuple):
        return joined([as_measurements(campaign, arm) for campaign in campaigns], arm)
    return as_measurements(campaigns, arm)  # pyright: ignore[reportArgumentType] - no other sequence is one


def joined(campaigns: Sequence[Measurements], arm: Arm) -> Measurements:
    """Return campaigns of one machine as one.

    A column that one of them lacks is left out, with a flag. Times go on where a campaign begins before the one before
    it ended.

    Args:
        campaigns: In the order in which they were taken; the frame of the first is that of the result.
        arm: The machine.

    Raises:
        InputError: There is none, or one is given twice.
        UnsupportedError: Several of them touch sockets.
        MissingCovariateError: An effect of the arm depends on a column that one of them lacks.
    """
    if not campaigns:
        raise InputError("no campaign is given, expected one or more")
    if len(campaigns) == 1:
        return campaigns[0]
    given = _named(campaigns)

    def whole(part: Callable[[Measurements], Any]) -> Array:
        return np.concatenate([part(campaign) for campaign in campaigns])

    def texts(part: Callable[[str, Measurements], Sequence[str]]) -> tuple[str, ...]:
        return tuple(cell for name, campaign in given.items() for cell in part(name, campaign))

    def sessions(name: str, campaign: Measurements) -> list[str]:
        return [name if len(set(campaign.session)) == 1 else f"{name}/{session}" for session in campaign.session]

    timed, first = not any("time" in campaign.derived for campaign in campaigns), campaigns[0]
    times, periods = _going_on(campaigns)
    covariates, flags = _columns(given, arm)
    said = [replace(flag, text=f"{name}: {flag.text}") for name, rows in given.items() for flag in rows.flags]
    places = tuple(place for campaign in campaigns for place in campaign.places)
    without_hold = [name for name, campaign in given.items() if campaign.hold is None]
    if 0 < len(without_hold) < len(given):
        flags.append(_lacking("hold", without_hold))
    return Measurements(
        joint_names=first.joint_names,
        pose=_poses(given),
        session=texts(sessions),
        payload=texts(lambda _, rows: rows.payload),
        time=np.concatenate(times) if timed else np.arange(sum(map(len, campaigns)), dtype=float),
        q=whole(lambda rows: rows.q),
        approach=whole(lambda rows: rows.approach),
        measured=whole(lambda rows: rows.measured),
        hold=None if without_hold else whole(lambda rows: rows.hold),
        covariates=covariates,
        places=places if all(campaign.places for campaign in campaigns) else (),
        derived=tuple(dict.fromkeys(name for campaign in campaigns for name in campaign.derived)),
        wrenches=_loads(campaigns),
        campaign=texts(lambda name, rows: [name] * len(rows)),
        readings=_readings(campaigns),
        sha256=hashlib.sha256("".join(campaign.sha256 for campaign in campaigns).encode()).hexdigest(),
        flags=(*said, *flags),
        frame=first.frame if all(campaign.frame == first.frame for campaign in campaigns) else "",
        periods=tuple(periods) if timed else (),
        units={
            name: unit
            for name, unit in first.units.items()
            if all(campaign.units.get(name) == unit for campaign in campaigns)
        },
    )


def _named(campaigns: Sequence[Measurements]) -> dict[str, Measurements]:
    """Return campaigns by file name, a further one with its number; refuse one given twice, or several with sockets."""
    given: dict[str, Measurements] = {}
    for number, campaign in enumerate(campaigns, 1):
        file = campaign.places[0].file if campaign.places else None
        name = file.stem if isinstance(file, Path) else f"campaign {number}"
        given[f"{name} {number}" if name in given else name] = campaign
    for (name, campaign), (again, other) in combinations(given.items(), 2):
        if campaign.sha256 == other.sha256 and set(campaign.places) & set(other.places):
            raise InputError(f"campaigns {name!r} and {again!r} have the same rows: each counts once")
    if sum(any(isinstance(kind, Touch) for kind in campaign.readings.kinds) for campaign in campaigns) > 1:
        text = "several campaigns touch sockets, which cannot be fitted together: the machine may have been moved"
        raise UnsupportedError(f"{text}; calibrate with one of them")
    return given


def _going_on(campaigns: Sequence[Measurements]) -> tuple[list[Array], list[Period]]:
    """Return times and periods of campaigns, none of them earlier than any of the campaign before."""
    times, periods = [campaigns[0].time], list(campaigns[0].clock)
    for campaign in campaigns[1:]:
        later = max(float(times[-1].max() - campaign.time.min()), 0.0)
        times.append(campaign.time + later)
        periods += [replace(period, later=later) for period in campaign.clock]
    return times, periods


def _poses(given: Mapping[str, Measurements]) -> tuple[str, ...]:
    """Return the name of each row's pose among those of all campaigns; see `COMMANDED`."""
    poses: list[str] = []
    first: dict[str, Array] = {}
    for name, campaign in given.items():
        for pose, q in zip(campaign.pose, campaign.q, strict=True):
            same = np.abs(first.setdefault(pose, q) - q).max() < COMMANDED
            poses.append(pose if same else f"{name}/{pose}")
    return tuple(poses)


def _columns(given: Mapping[str, Measurements], arm: Arm) -> tuple[dict[str, Array | tuple[str, ...]], list[Flag]]:
    """Return the columns that all campaigns have, and flags about the others; a text among numbers makes them texts."""
    asked = ((name, effect) for effect in arm.effects for name in effect.location.covariates)
    needed = {name.partition(LEVEL_OF)[0]: effect.name for name, effect in asked}
    columns: dict[str, Array | tuple[str, ...]] = {}
    flags: list[Flag] = []
    for column in dict.fromkeys(name for campaign in given.values() for name in campaign.covariates):
        without = [name for name, campaign in given.items() if column not in campaign.covariates]
        if without:
            if column in needed:
                campaign = given[without[0]]
                with naming(campaign.places[0].file if campaign.places else without[0]):
                    raise MissingCovariateError(column, campaign.covariates, needed[column])
            flags.append(_lacking(column, without))
            continue
        parts = [campaign.covariates[column] for campaign in given.values()]
        if all(isinstance(part, np.ndarray) for part in parts):
            columns[column] = np.concatenate(parts)
        else:
            columns[column] = tuple(cell if isinstance(cell, str) else f"{cell:g}" for part in parts for cell in part)
    if CAMPAIGN not in columns:
        columns[CAMPAIGN] = tuple(name for name, campaign in given.items() for _ in range(len(campaign)))
    return columns, flags


def _lacking(column: str, without: Sequence[str]) -> Flag:
    return Flag("column_left_out", f"column {column!r} is left out: {listing(without)} has none", about=column)


def _pieces(campaigns: Sequence[Measurements]) -> Iterator[tuple[Measurements, slice]]:
    """Yield each campaign with the place of its rows among all."""
    start = 0
    for campaign in campaigns:
        yield campaign, slice(start, start + len(campaign))
        start += len(campaign)


def _readings(campaigns: Sequence[Measurements]) -> Readings:
    """Return what was read in all rows: what a campaign has no column of was not read there."""
    count, kinds = sum(map(len, campaigns)), dict[tuple[type[Kind], str], Kind]()
    for campaign, place in _pieces(campaigns):
        for kind in campaign.readings.kinds:
            key, shape = (type(kind), kind.name), (count, *kind.values.shape[1:])
            unread = replace(kind, values=np.zeros(shape), sigma=np.full(shape, np.inf))
            whole = kinds.setdefault(key, unread)
            whole.values[place], whole.sigma[place] = kind.values, kind.sigma
    # Those of the tip stand first; see `Readings.foremost`.
    return Readings(count, tuple(sorted(kinds.values(), key=lambda kind: bool(kind.name))))


def _loads(campaigns: Sequence[Measurements]) -> tuple[Wrench, ...]:
    """Return the loads from outside on all rows, those of other campaigns zero: one for each link and axes."""
    count = sum(map(len, campaigns))
    forces: dict[tuple[str, str], Array] = {}
    hung: list[Wrench] = []
    for campaign, place in _pieces(campaigns):
        for load in campaign.wrenches:
            if isinstance(load, Branch):
                moment = np.zeros((count, 3))
                moment[place] = load.moment
                held = {name: np.full(count, load.robot.locked.get(name, 0.0)) for name in load.positions}
                for name, at in load.positions.items():
                    held[name][place] = at
                hung.append(replace(load, force=np.zeros((count, 3)), moment=moment, positions=held))
                continue
            both = forces.setdefault((load.frame, load.axes), np.zeros((count, 6)))
            both[place] += np.hstack([load.force, load.moment])
    return (*(Wrench(frame, load[:, :3], load[:, 3:], axes) for (frame, axes), load in forces.items()), *hung)
