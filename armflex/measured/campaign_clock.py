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
from armflex.rows.period import TICK, Period


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
    period = rows.clock[0]
    same = [fitted for fitted in arm.clock if fitted.is_that_of(period)]
    same += [fitted for fitted in arm.clock if _like(fitted, period)]  # without the points that were read apart from it
    if not same:
        campaigns = listing(
            f"{fitted.campaign or 'a campaign'} ({fitted.at(fitted.first)} to {fitted.at(fitted.last)})"
            for fitted in arm.clock
        )
        here = f"{place} ({period.at(period.first)} to {period.at(period.last)})"
        raise InputError(f"{here} is none of the campaigns that this arm was fitted to: {campaigns}")
    return replace(arm, clock=same[:1]).on_clock(same[0].later)


def _like(period: Period, other: Period) -> bool:
    """Return whether two are of one campaign whose file was written anew: by its moments, and its dates or its name."""
    ends = abs(period.first - other.first), abs(period.last - other.last)
    named = period.begins or (period.campaign and period.campaign == other.campaign)
    return max(ends) < TICK and period.begins == other.begins and bool(named)


def on_its_clock(arm: Arm, campaign: Measurements) -> Arm:
    """Return the arm as a campaign finds it that it is fitted to, with the clock of that.

    In a campaign that it was fitted to before it is as it was then. In another one it is as it was left, and what its
    effects of time say is for good of an earlier campaign.
    """
    if _same(arm.clock, campaign.clock):
        return replace(arm, clock=campaign.clock).on_clock()
    effects = tuple(replace(effect, earlier=bool(effect.moments)) for effect in arm.left().effects)
    return replace(arm, clock=campaign.clock, effects=effects)


def _same(clock: Sequence[Period], other: Sequence[Period]) -> bool:
    """Return whether campaigns are among those of a clock, on the same seconds."""
    fitted = {(period.sha256, period.later) for period in clock}
    return bool(other) and all((period.sha256, period.later) in fitted for period in other)


def runs_by_clock(arm: Arm, rows: Measurements) -> Iterator[tuple[float | None, float, Measurements]]:
    """Yield rows in their order as far as the arm is the same in them.

    With each go the moment of the arm's clock after which it is as it was left, None where rows are on that clock, and
    then by how much it is ahead of theirs [s].

    Raises:
        InputError: Rows have dates, and the campaign that they are to be on the clock of has none.
    """
    clock, moving = rows.clock, [effect for effect in arm.effects if effect.of_time and not effect.earlier]
    left = any(effect.left is not None for effect in moving)
    if len(clock) > 1 and moving:  # joined
        yield (None if not left or _same(arm.clock, clock) else np.inf), 0.0, rows
        return
    if not (arm.clock and moving and clock):
        yield (np.inf if left else None), (0.0 if left or not arm.clock else arm.clock[0].later), rows
        return
    dated = [(period, since) for period in arm.clock if (since := period.since(clock[0].begins)) is not None]
    same = [period.later for period in arm.clock if period.is_that_of(clock[0])]
    if same or not left:
        if clock[0].begins and not same and not dated:
            place = f"{rows.places[0]}: " if rows.places else ""
            text = f"{place}column 'time' has dates, that of {arm.clock[0].campaign or 'the campaign'} has seconds"
            raise InputError(f"{text}: give the seconds of its clock")
        yield None, same[0] if same else arm.clock[0].later + (dated[0][1] if dated else 0.0), rows
        return
    if not dated:
        yield np.inf, 0.0, rows
        return
    ends = sorted((period.last - since, period.last + period.later) for period, since in dated)
    moments = np.array([-np.inf, *(moment for _, moment in ends[:-1]), np.inf])
    after = moments[np.searchsorted([end for end, _ in ends], rows.time)]
    later = np.full(len(rows), np.nan)
    for period, since in dated:
        inside = (rows.time + since > period.first - TICK) & (rows.time + since < period.last + TICK)
        later[inside & np.isnan(later)] = period.later + since
    inside, key = np.isfinite(later), np.where(np.isfinite(later), later, after)
    cuts = np.flatnonzero((inside[1:] != inside[:-1]) | (key[1:] != key[:-1])) + 1
    for piece in np.split(np.arange(len(rows)), cuts):
        here, part = float(key[piece[0]]), rows.some(piece)
        yield (None, here, part) if inside[piece[0]] else (here, 0.0, part)
