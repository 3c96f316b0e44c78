"""Whose clock rows are on: that of the campaigns that an arm was fitted to, or one of another day.

Effects of time hold for the clock of their campaign. Rows are on it where they are the campaign's, by digest or by
date, or where somebody says so (`as_in`); all others mean the arm as it was left.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from armflex.arguments import checked_kinds
from armflex.arm import Arm
from armflex.errors import InputError, listing
from armflex.measured.measurements import Measurements, as_measurements
from armflex.measured.table import Tabular
from armflex.rows.clock import TICK, Period


@checked_kinds
def as_in(arm: Arm, campaign: Measurements | Tabular) -> Arm:
    """Return the arm as it was in one of the campaigns that it was fitted to, for rows on that campaign's own clock.

    Args:
        arm: As fitted.
        campaign: The campaign; what was read in it does not count.

    Raises:
        InputError: The arm was fitted to others, or the campaign has no column `time`.
    """
    rows = as_measurements(campaign, arm, inputs_only=True)
    if not arm.clock:
        return arm
    place = rows.places[0].file if rows.places else "the campaign"
    if not rows.clock:
        raise InputError(f"{place} has no column 'time': no row can be on its clock")
    own = rows.clock[0]
    same = [one for one in arm.clock if one.is_that_of(own)]
    same += [one for one in arm.clock if _like(one, own)]  # without the points that were read apart from it
    if not same:
        known = listing(
            f"{one.campaign or 'a campaign'} ({one.at(one.first)} to {one.at(one.last)})" for one in arm.clock
        )
        here = f"{place} ({own.at(own.first)} to {own.at(own.last)})"
        raise InputError(f"{here} is none of the campaigns that this arm was fitted to: {known}")
    return replace(arm, clock=same[:1]).on_clock(same[0].later)


def _like(one: Period, other: Period) -> bool:
    """Return whether two are of one campaign whose file was written anew: by its moments, and its dates or its name."""
    ends = abs(one.first - other.first), abs(one.last - other.last)
    named = one.begins or (one.campaign and one.campaign == other.campaign)
    return max(ends) < TICK and one.begins == other.begins and bool(named)


def on_its_clock(arm: Arm, campaign: Measurements) -> Arm:
    """Return the arm as a campaign finds it that it is fitted to, with the clock of that.

    In a campaign that it was fitted to before it is as it was then. In another one it is as it was left, and what its
    effects of time say is for good of an earlier campaign.
    """
    if _same(arm.clock, campaign.clock):
        return replace(arm, clock=campaign.clock).on_clock()
    effects = tuple(replace(one, earlier=bool(one.moments)) for one in arm.left().effects)
    return replace(arm, clock=campaign.clock, effects=effects)


def _same(clock: Sequence[Period], other: Sequence[Period]) -> bool:
    """Return whether campaigns are among those of a clock, on the same seconds."""
    known = {(one.sha256, one.later) for one in clock}
    return bool(other) and all((one.sha256, one.later) in known for one in other)


def runs_by_clock(arm: Arm, rows: Measurements) -> Iterator[tuple[float | None, float, Measurements]]:
    """Yield rows in their order as far as the arm is the same in them.

    With each go the moment of the arm's clock after which it is as it was left, None where rows are on that clock, and
    then by how much it is ahead of theirs [s].

    Raises:
        InputError: Rows have dates, and the campaign that they are to be on the clock of has none.
    """
    own, moving = rows.clock, [one for one in arm.effects if one.of_time and not one.earlier]
    left = any(one.left is not None for one in moving)
    if len(own) > 1 and moving:  # joined
        yield (None if not left or _same(arm.clock, own) else np.inf), 0.0, rows
        return
    if not (arm.clock and moving and own):
        yield (np.inf if left else None), (0.0 if left or not arm.clock else arm.clock[0].later), rows
        return
    dated = [(one, since) for one in arm.clock if (since := one.since(own[0].begins)) is not None]
    same = [one.later for one in arm.clock if one.is_that_of(own[0])]
    if same or not left:
        if own[0].begins and not same and not dated:
            place = f"{rows.places[0]}: " if rows.places else ""
            text = f"{place}column 'time' has dates, that of {arm.clock[0].campaign or 'the campaign'} has seconds"
            raise InputError(f"{text}: give the seconds of its clock")
        yield None, same[0] if same else arm.clock[0].later + (dated[0][1] if dated else 0.0), rows
        return
    if not dated:
        yield np.inf, 0.0, rows
        return
    ends = sorted((one.last - since, one.last + one.later) for one, since in dated)
    moments = np.array([-np.inf, *(moment for _, moment in ends[:-1]), np.inf])
    after = moments[np.searchsorted([end for end, _ in ends], rows.time)]
    later = np.full(len(rows), np.nan)
    for one, since in dated:
        inside = (rows.time + since > one.first - TICK) & (rows.time + since < one.last + TICK)
        later[inside & np.isnan(later)] = one.later + since
    inside, key = np.isfinite(later), np.where(np.isfinite(later), later, after)
    cuts = np.flatnonzero((inside[1:] != inside[:-1]) | (key[1:] != key[:-1])) + 1
    for some in np.split(np.arange(len(rows)), cuts):
        here, part = float(key[some[0]]), rows.some(some)
        yield (None, here, part) if inside[some[0]] else (here, 0.0, part)
