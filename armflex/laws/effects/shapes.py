"""What the laws of the catalogue have in common: shapes along an axis, lagged columns, and where a law makes sense."""

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from armflex.conventions import Array
from armflex.laws import Row
from armflex.laws.effects.context import AXES, AXES_TURN, Context, Records
from armflex.laws.effects.effect import Effect, Inner, Manipulator, Memory, Values, Watching
from armflex.laws.effects.location import TOOL, Here, Location, drive_axis
from armflex.laws.terms import UNITS, Factor, Term, powers, straight
from armflex.rows.rows import TIME

REFERENCE = 20.0
"""Temperature at which machines are made [deg C]."""

ROUNDING = 1e-9
"""Share of a joint's largest load below which a load along another of its axes is rounding."""

BY_HAND = "push the joint to and fro with its brake on, because play gives without force and wind-up springs back"
SECOND_ENCODER = Watching("compare the joint's encoder with a second one over the joint's range")
OVER_ITS_RANGE = "compare the joint's encoder with a second one or an inclinometer on its link over the joint's range"
ON_THE_LINK = Watching("measure a second target on the link")
IN_THE_BASE = Watching("measure the joint's link in the base frame, by marks on both or a wire from a known anchor")
ON_THE_FLOOR = "measure fixed targets on the floor in every session"


def on_axis(here: Here, inner: Values) -> Array:
    """Return the (6,) direction of twists along the location's axis."""
    return here.direction


def on_drive(here: Here, inner: Values) -> Array:
    """Return the (6,) direction of twists along the joint's own motion."""
    return here.drive


def twists(way: Array, *each: Sequence[Factor]) -> list[list[Term]]:
    """Return the terms of amplitudes that each give a (6,) twist times factors, whatever the load."""
    return [[Term(way, factors=tuple(factors))] for factors in each]


def compliances(way: Array, *each: Sequence[Factor]) -> list[list[Term]]:
    """Return the terms of amplitudes that are each a compliance along a (6,) axis times factors."""
    return [[straight(np.outer(way, way), *factors)] for factors in each]


def each_axis(first: int = 0) -> list[list[Term]]:
    """Return the terms of amplitudes that are each a compliance along an axis of their own, from one of six on."""
    return [part for unit in UNITS[first:] for part in compliances(unit, ())]


def own_column(here: Here) -> str:
    """Return the column of the position of the site's joint."""
    return f"q_{here.location.place}"


def side(here: Here) -> tuple[Factor, ...]:
    """Return the factor of the direction from which the site's joint came."""
    return powers(f"approach_{here.location.place}", 1)


def warm(here: Here, reference: float, lag: float) -> tuple[Factor, ...]:
    """Return the factor of the temperature above the reference [K], lagged where there is a lag."""
    return powers(lagged_name(here.location, (lag,)) if lag > 0.0 else here.location.covariates[0], 1, reference)


def shares_of_load(location: Location, context: Context, shares: tuple[float, ...]) -> Iterable[float]:
    """Return shares of the largest load along a location's axes, none where it is rounding beside the joint's others.

    A law that saturates makes a column of any load, so rounding would become a candidate.
    """
    wrench = np.abs(context.wrenches[location.site]).max(axis=0)  # of forces and moments alike: as if at 1 m
    load = float(wrench[[AXES.index(location.axis)] if location.axis else [2 + term for term in location.terms]].max())
    return () if load <= ROUNDING * wrench.max() else load * np.array(shares)


def lagged_name(location: Location, inner: Values) -> str:
    """Return the name of the derived covariate of a column behind a lag of `inner[-1]` seconds."""
    return f"{location.covariates[0]}_lagged_{inner[-1]:.4g}s"


def lagged(here: Here, wrench: Array, row: Row, inner: Values) -> Array:
    """Return (N,) the location's column behind a first-order lag, `inner[-1]` seconds; at rest at the first row.

    Rows without time are each at rest.
    """
    values, lag = row.column(here.location.covariates[0]), inner[-1]
    return follow(row.covariate(TIME), values, lag) if lag > 0.0 and row.has(TIME) else values


def follow(time: Array, values: Array, lag: float) -> Array:
    """Return (N,) y of y' = (x - y) / lag, x straight between the rows, y = x at the earliest."""
    order = np.argsort(time, kind="stable")
    step, ordered = np.diff(time[order]), values[order]
    moves = step > 0.0
    ahead = np.diff(ordered) / np.where(moves, step, 1.0) * lag
    state = np.empty(len(values))
    state[order] = lag_behind(ordered, ahead, np.where(moves, np.exp(-step / lag), np.nan))
    return state


LAG = "lag"
LAGGED = Memory(lagged_name, lagged, "K", LAG)


def of_column(
    grid: Callable[[Array], Iterable[float]], place: int = 0
) -> Callable[[Location, Context], Iterable[float]]:
    """Return the values to begin a search with that one of the location's columns gives."""
    return lambda location, context: grid(context.column(location.covariates[place]))


def lag_grid(location: Location, context: Context) -> Iterable[float]:
    """Return no lag, and lags that the campaign is long enough to show; none of them where it has no time."""
    if not context.timed:
        return (0.0,)
    span = float(np.ptp(context.column("time")))
    # Time constants to begin a search with [s]: hours for links of a tonne.
    return (0.0, *(lag for lag in (600.0, 1800.0, 5400.0, 10800.0) if lag < span))


def shows_lag(effect: Effect, context: Context, arm: Manipulator) -> bool:
    """Return whether a campaign is longer than a lag: one as long follows the sum of the temperatures, by any lag."""
    lag = effect.named[LAG]
    return lag <= 0.0 or (context.timed and lag < float(np.ptp(context.column("time"))))


LEVELS, SLICES, SEEN = 8, 4, 2.0
"""Distinct values, to a hundredth of their range, that a wave of three numbers beside a mean needs to be distinguished
from other shapes; slices of a period, and how many of them must be seen for every period within the range."""


def free_of_aliases(values: Array, number: float) -> bool:
    """Return whether (N,) values distinguish a wave of a wave number [1/unit of them] from those of other numbers.

    Values that lie anyhow resolve faster waves than even ones do (Landau 1967): what counts is on how many places of
    its periods a wave was sampled. Where most periods were sampled at one place or not at all, a slow wave, or a load
    that varies with the column, gives the same numbers.
    """
    span = float(np.ptp(values))
    if span <= 0.0 or len(np.unique(np.round((values - values.min()) / (0.01 * span)))) < LEVELS:
        return False
    periods = number * span / (2.0 * np.pi)
    return len(np.unique(np.floor((values - values.min()) / span * SLICES * periods))) >= SEEN * periods


_MEANS = of_column(lambda kelvin: (REFERENCE, float(kelvin.mean())))
ABOVE = Inner("reference", "degC", _MEANS, positive=False, polished=False, usual=REFERENCE, default=REFERENCE)
"""The temperature above which a law counts: that of manufacture, or the campaign's mean."""

WARM = (ABOVE, Inner(LAG, "s", lag_grid, usual=0.0, default=0.0))


def at_drives(records: Records, *covariates: str) -> list[Location]:
    """Return every moving joint's own axis; a covariate may name the joint as {joint}."""
    return [
        Location(joint.name, drive_axis(joint), tuple(name.format(joint=joint.name) for name in covariates))
        for joint in records.robot.moving
    ]


def at_joints(records: Records, covariate: str | None = None) -> list[Location]:
    """Return every joint with each axis."""
    covariates = () if covariate is None else (covariate,)
    return [Location(joint, axis, covariates) for joint in records.joints for axis in records.axes(joint)]


PAIRS = ((0, 1), (0, 2), (1, 2))
CROSSED = tuple(f"C_{AXES_TURN[i]}_{AXES_TURN[j]}" for i, j in PAIRS)
"""Names of what couples two turning axes."""


def crossed_terms() -> list[list[Term]]:
    """Return the terms of `CROSSED`."""
    turns = UNITS[3:]
    return [[straight(np.outer(turns[i], turns[j]) + np.outer(turns[j], turns[i]))] for i, j in PAIRS]


def turning_terms(first: int, coupled: int) -> tuple[tuple[int, ...], ...]:
    """Return the terms of a symmetric compliance about several axes, with and without what couples them.

    Args:
        first: Amplitude of the first turning axis.
        coupled: Amplitude of the first of `CROSSED`.
    """
    together = ((0, 1), (0, 2), (1, 2), (0, 1, 2))
    alone = tuple(tuple(first + i for i in members) for members in together)
    with_pairs = (
        (*single, *(coupled + k for k, pair in enumerate(PAIRS) if set(pair) <= set(members)))
        for single, members in zip(alone, together, strict=True)
    )
    return (*alone, *with_pairs)


def about_several(records: Records, first: int) -> list[Location]:
    """Return every joint with several of its turning axes, whose amplitudes are the law's from `first` on."""
    turns = turning_terms(first, first + 3)[:4]
    return [Location(joint, terms=terms) for joint in records.joints if records.axes(joint) == AXES for terms in turns]


def singly_and_together(
    sites: Iterable[str], *together: tuple[int, ...], axes: Sequence[str] = AXES, covariates: tuple[str, ...] = ()
) -> list[Location]:
    """Return every site with each axis, which has an amplitude of its own, and then with several amplitudes at once."""
    single = [Location(site, axis, covariates, (i,)) for site in sites for i, axis in enumerate(axes)]
    return single + [Location(site, None, covariates, terms) for site in sites for terms in together]


def with_temperature(make: Callable[..., list[Location]], records: Records) -> list[Location]:
    """Return the locations of `make(temperature)` for every recorded temperature."""
    return [location for name in records.temperatures for location in make(name)]


def lag_behind(values: Array, ahead: Array, decay: Array) -> Array:
    """Return (N,) what lags behind (N,) values in the order of time, in equilibrium at the first.

    Args:
        values: (N,) values, straight between rows.
        ahead: (N - 1,) their rise within the lag, from each row to the next.
        decay: (N - 1,) what is left over that time of being off; NaN where no time passes.
    """
    lagged = values[:1].tolist()
    rows = zip(values.tolist(), values[1:].tolist(), ahead.tolist(), decay.tolist(), strict=False)
    for before, value, rise, left in rows:  # numbers of Python: an array's take three times as long one by one
        state = lagged[-1]
        lagged.append(state if left != left else value - rise + (state - before + rise) * left)
    return np.array(lagged)


def play_in(load: Array, radius: float) -> Array:
    """Return the (N,) play operator of a (N,) load: what it drags along once it is a radius away."""
    loads, state = [], 0.0
    for x in load.tolist():
        state = min(max(state, x - radius), x + radius)
        loads.append(state)
    return np.array(loads)


def coordinates(name: str, count: int) -> tuple[Inner, ...]:
    """Return the three coordinates of a point in base axes, searched from `count` values each."""

    def grid(axis: int) -> Inner:
        def values(location: Location, context: Context) -> Iterable[float]:
            low, high = context.box[:, axis]
            return np.linspace(low - 0.2 * (high - low), high + 0.2 * (high - low), count)

        return Inner(f"{name}_{'xyz'[axis]}", "m", values, positive=False)

    return tuple(grid(axis) for axis in range(3))


def end_of(here: Here) -> Array:
    """Return the (3,) end of the location's link in the link's frame: its end joint's origin, the tip for the last."""
    if here.location.site == TOOL or here.joint is None:
        return np.zeros(3)
    return here.joint.origin


def middle_of(here: Here) -> Array:
    """Return the (3,) centre of mass of the location's link in its frame; the tip for the last."""
    if here.location.site == TOOL or here.joint is None:
        return np.zeros(3)
    inertial = here.robot.urdf.links[here.joint.parent].inertial
    return np.zeros(3) if inertial is None else inertial.origin


def force_at(force: Array, lever: Array) -> Array:
    """Return the (..., 1, 6) wrench at a link's origin of a force that acts at a lever from it, base axes."""
    return np.concatenate([force, cross(lever, force)], axis=-1)[..., None, :]


def cross(vector: Array, other: Array) -> Array:
    """Return (..., 3) cross products; for single vectors a quarter of numpy's time."""
    (a, b, c), (x, y, z) = ([part[..., i] for i in range(3)] for part in (vector, other))
    first = np.asarray(b * z - c * y)
    product = np.empty((*first.shape, 3))
    product[..., 0], product[..., 1], product[..., 2] = first, c * x - a * z, a * y - b * x
    return product
