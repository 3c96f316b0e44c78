"""What a missing effect is: a law in the catalogue, at a location, with values.

A law is linear in its amplitudes and may have inner parameters that it is not linear in. What it does per amplitude are
its features, and `act` says what those are: a small twist at a site, a load on a link, a tension of a spring, another
direction of gravity, or an instrument that stands elsewhere or reads too far. `TwistLaw` and `LoadLaw` are at work in
an arm as they are; a `ModelLaw` changes the model itself (masses, gravity, springs, the instrument). How readings
answer is the fit's to say.

Everything that is said about a law is a member of it: a new one is a file and a line of `catalogue`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

import numpy as np

from armflex.conventions import Array, cached_property
from armflex.errors import PluginError
from armflex.laws import Row
from armflex.laws.effects.location import Here, Location, link_of
from armflex.laws.terms import LEAST, Terms, twists_of
from armflex.readings.instrument import Instrument
from armflex.robot import Corrections, Robot
from armflex.rows.rows import APPROACH, HOLD, TIME

if TYPE_CHECKING:
    from armflex.laws.declared import Flexure
    from armflex.laws.effects.context import Context, Records

Values = tuple[float, ...]


@dataclass(frozen=True)
class Amplitude:
    """A parameter that the law is linear in; in its unit, {m} stands for the motion's unit and {w} for the load's,
    {across} for that of the partner's load, {over} for a position's or a force's.

    With `positive` it makes no sense below zero, and beyond `most` in size it is implausible. `usual` is what
    machines have without anybody knowing, where the twist or the force that it makes does not show it.
    """

    name: str
    unit: str
    positive: bool = False
    most: float = float("inf")
    usual: float = float("inf")


@dataclass(frozen=True)
class Inner:
    """A parameter that the law is not linear in.

    Attributes:
        name, unit: As for an amplitude.
        grid: Starting values for the search at a location of a context.
        positive: Whether only values above zero make sense; such are refined on a logarithmic scale.
        polished: Whether it is refined after the grid.
        smooth: Whether the law changes smoothly with it, so that a fit may move it.
        usual: What it is without evidence to the contrary, for one that is chosen rather than refined.
        tried: Further values that only the best candidates are tried with.
        spread: Standard deviation about its default of one that no search looks for, only a fit of what was found.
        default: What it is where a file leaves it out, None where a file must not.
    """

    name: str
    unit: str
    grid: Callable[[Location, Context], Iterable[float]]
    positive: bool = True
    polished: bool = True
    smooth: bool = True
    usual: float | None = None
    tried: Values = ()
    spread: float | None = None
    default: float | None = None

    @property
    def may_be_zero(self) -> bool:
        """Whether zero is one of its values, although below it there is none."""
        return self.default == 0.0 or 0.0 in self.tried

    def moved(self, value: float, by: float) -> float:
        """Return a value moved: by a factor's logarithm where only positive ones make sense, else by a difference."""
        return value * float(np.exp(np.clip(by, -50.0, 50.0))) if self.positive else value + by


@dataclass(frozen=True)
class Words:
    """What a law is called, what it means, its formula, and what the signs in it mean where that is a question."""

    title: str
    meaning: str
    formula: str
    signs: str = ""


@dataclass(frozen=True)
class Plausible:
    """How large the effects of a law are on machines that work: one standard deviation of their RMS over some rows.

    A twist, or another frame of the instrument, has a part that shifts [m] and one that turns [rad]. A load has forces
    as a share of the weight of all that moves, and moments of that weight on a lever [m]. Gravity turns; an
    instrument's distances are wrong by a share, which stands for a shift.

    Attributes:
        shift, turn: The standard deviations.
        why: What says so.
    """

    shift: float
    turn: float
    why: str


LEAST_WEIGHT = 100.0
"""Weight of an arm [N] below which loads from outside are no smaller: people lean on it."""


class Act(Enum):
    """What the features of a law are, and so by what the readings answer to them."""

    TWIST = "a small twist at a site [m, rad], local axes"
    LOAD = "a wrench at the origin of a link [N, Nm], base axes"
    TENSION = "a tension between the ends of a spring [N]"
    GRAVITY = "a change of gravity [m/s^2], base axes"
    FRAME = "a shift and a rotation vector of the instrument's frame [m, rad]"
    SCALE = "the share by which the instrument's distances are too long"
    SIGHT = "how lines of sight bend: by their length squared [1/m], and by the tangent of the zenith distance [rad]"


class Afterwards(Enum):
    """What becomes of an effect of time beyond the campaign that showed it: its clock is that campaign's."""

    STAYS = "it stays as it was at the end"
    WANDERS = "it is not carried on: its mean over the campaign stands in for it, and sigma has its scatter"
    ANEW = "it begins anew, by the clock of the rows"
    OVER = "no row still to be measured depends on it"


class DependsOn(Enum):
    """What a twist depends on."""

    NOTHING = "nothing: it is a constant, and nothing is plainer"
    COLUMNS = "columns and positions alone"
    LOAD = "the load, whichever way it goes"
    COMPLIANCE = "the load, whose way it follows as a compliance does"


class Search(Enum):
    """Where a law is looked for."""

    PLACES = "at each of its places"
    RESIDUAL = "at those of its places that the residual points to"
    SPACE = "at places in space, with which it bends like a free shape"
    NOWHERE = "it is at every place at once or at none, see `armflex.trace.families`"


class Watching(str):
    """Advice to watch what moves, which does not distinguish two causes of one motion."""


INSTANTS = 24
"""Moments of a campaign that what wandered is averaged over."""


class Manipulator(Protocol):
    """What effects know of the arm that they are in; `armflex.Arm` is one.

    Attributes:
        robot: The robot.
        flexures, modelled: Where it gives and how, without effects and with them.
        effects: What it does beyond them.
        clock: When the campaigns were that it was fitted to.
        corrections: Of geometry and masses that were found.
        springs: Between points of its links; see `armflex.mechanics.spring`.
        weight: Of everything that moves [N].
    """

    @property
    def robot(self) -> Robot: ...
    @property
    def flexures(self) -> Sequence[Flexure]: ...
    @property
    def modelled(self) -> Sequence[Flexure]: ...
    @property
    def effects(self) -> Sequence[Effect]: ...
    @property
    def clock(self) -> Sequence[object]: ...
    @property
    def corrections(self) -> Corrections: ...
    @property
    def springs(self) -> Sequence[Any]: ...
    @property
    def weight(self) -> float: ...

    def payload(self, payload: str) -> Any:
        """Return the mass [kg] and the centre of mass `com` [m] of a payload."""
        ...


class Solved(Protocol):
    """M rows of a campaign at one state of the arm: what laws are asked about; a linearised campaign is one.

    Attributes:
        rows: (M,) their numbers among all rows of the campaign.
        arm: The arm in that state.
    """

    @property
    def rows(self) -> np.ndarray: ...
    @property
    def arm(self) -> Manipulator: ...

    def load_at(self, site: str) -> Array:
        """Return the (M, 6) wrench on the structure at a site, local axes [N, Nm]."""
        ...

    def pose_of(self, link: str) -> Array:
        """Return the (M, 4, 4) pose of a link in the base."""
        ...

    def length_of(self, spring: Any) -> Array:
        """Return the (M,) distance of a spring's ends [m]."""
        ...

    def gravity(self, vectors: Array) -> Array:
        """Return (M, k, 3) what (k, 3) gravities of the arm are in the base axes of each row [m/s^2]."""
        ...


@dataclass(frozen=True)
class ChangeableModel:
    """What a `ModelLaw` may change: parts of an arm, and the instrument that looks at it."""

    robot: Robot
    corrections: Corrections
    payloads: Mapping[str, Any]
    springs: tuple[Any, ...]
    instrument: Instrument


@dataclass(frozen=True, kw_only=True, eq=False)
class EffectLaw(ABC):
    """An entry of the catalogue.

    Attributes:
        act: What its features are.
        name: As files name it; 'unnamed_' and more where `shape` is their name for it.
        words: For people.
        instead: What shows it by other means than more rows of the same kind; '' where none is known.
        level: What is said in its stead where gravity turns with the joint: what a level shows of it.
        plausible: How large it is on machines that work.
        places: Where it makes sense.
        amplitudes: Linear parameters.
        inner: Nonlinear parameters.
        direction: (here, inner) -> the (6,) twist of which every twist is a multiple, None where there is no such.
        depends_on: What a twist depends on; that it is proportional to the load is said by its terms.
        memory: State it needs, if any.
        possible: Whether it is plausible of a context and an arm with its values, beyond the bounds of its amplitudes.
        afterwards: Of one that depends on time, for which clock it holds.
        search: Where it is looked for.
        physical: Whether it is physics rather than a free shape, whether or not the catalogue names it.
        symmetric: Whether axis and partner of its locations may change places.
        stands_for: Blocks of declared parameters whose errors look like it.
        shape: What files call an unnamed shape, '' for all others.
        columns: How many columns of any name such a shape depends on.
    """

    act: Act
    name: str
    words: Words
    instead: str = ""
    level: str = ""
    plausible: Plausible = Plausible(0.015, 0.01, "what moves further is seen with the naked eye")
    places: Callable[[Records], Iterable[Location]]
    amplitudes: tuple[Amplitude, ...]
    inner: tuple[Inner, ...] = ()
    direction: Callable[[Here, Values], Array | None] = lambda here, inner: None
    depends_on: DependsOn = DependsOn.COLUMNS
    memory: Memory | None = None
    possible: Callable[[Effect, Context, Manipulator], bool] = lambda effect, context, arm: True
    afterwards: Afterwards = Afterwards.WANDERS
    search: Search = Search.PLACES
    physical: bool = True
    symmetric: bool = False
    stands_for: tuple[str, ...] = ()
    shape: str = ""
    columns: int = 1

    def __reduce__(self) -> tuple:
        """Return the name: a law is found in the catalogue again where it is sent."""
        return _named, (self.name,)

    def digested(self) -> str:
        """Return the name, for `digest`: it stands for the entry of the catalogue."""
        return self.name

    @property
    def plain(self) -> bool:
        """Whether it has neither a free shape nor a place in space to be searched."""
        return self.physical and self.search is not Search.SPACE

    @property
    def loaded(self) -> bool:
        """Whether a twist depends on the load."""
        return self.depends_on in (DependsOn.LOAD, DependsOn.COMPLIANCE)

    def features(self, location: Location, inner: Values, view: Solved, context: Context) -> Array:
        """Return (M, k, n) what it does in some rows per amplitude of `location.terms`; `act` says what that is."""
        return self.of_each(location, [inner], view, context)[0][:, list(location.terms)]

    @abstractmethod
    def of_each(self, location: Location, inners: Sequence[Values], view: Solved, context: Context) -> Sequence[Array]:
        """Return for each of some inner values (M, k, n) what it does in some rows per amplitude, all of them."""

    def size(self, done: Array, arm: Manipulator) -> float:
        """Return how large (M, n) features, amplitudes in them, are over what is plausible: RMS, dimensionless.

        What depends on a column and no load is taken about its mean: where a column is zero is a convention, and a
        constant is the calibration's.
        """
        linear, angular = self.plausible.shift, self.plausible.turn
        if self.act in (Act.LOAD, Act.TENSION):
            weight = max(arm.weight, LEAST_WEIGHT)
            linear, angular = weight * linear, weight * angular
        elif self.act is Act.GRAVITY:
            linear = max(float(np.linalg.norm(arm.robot.gravity)), 1e-9) * angular
        elif self.act is Act.TWIST and self.depends_on is DependsOn.COLUMNS:
            done = done - done.mean(axis=0)
        squares = (done**2).mean(axis=0)
        return float(np.sqrt(max(squares[:3].sum() / linear**2, squares[3:].sum() / angular**2)))

    changes_model: ClassVar[bool] = False
    """Whether it is in the model that it changed, and not at work in the arm as a twist or a load."""

    def change(self, effect: Effect, model: ChangeableModel) -> ChangeableModel:
        """Return the model with the effect in it; what is at work in the arm changes nothing else."""
        return model

    def shapes(self, location: Location, inner: Values, view: Solved, context: Context) -> Array:
        """Return the (k, M) multiples of `direction`, one per amplitude."""
        raise NotImplementedError(f"the twists of {self.name} have no one direction")

    def of_load(self, location: Location) -> bool:
        """Return whether what it does depends on the load, now or before, and not on its location's columns alone."""
        return self.loaded or self.remembers_load(location)

    def remembers_load(self, location: Location) -> bool:
        """Return whether its memory is of the load rather than of a column."""
        return self.memory is not None and not location.covariates


@dataclass(frozen=True)
class Effect:
    """An effect with its values.

    Attributes:
        law: What it does.
        location: Where.
        values: All amplitudes (zero where the location leaves one out), then the inner parameters.
        derived: Those of the location's covariates that the order of the rows stood in for where it was found:
            directions `approach_<joint>`. Where the rows asked about do not give one it is derived in the same way, and
            before a joint has moved it is either: halfway on average, and as uncertain as both are apart.
        seen: Columns and joints' positions ('q_J') with the smallest and largest value that they had in the rows where
            it was found; beyond those it is an extrapolation. Of time they are the campaign's first and last moment.
        left: Moment of its campaign's clock [s] as it was after which it is in all rows, infinity for the end; None
            where it is as it was at the time of each row.
        later: By how much its campaign's clock is ahead of that of rows [s], where it is at their time.
        earlier: Whether its campaign was before that which the arm was fitted to last: it is left for good.
    """

    law: EffectLaw
    location: Location
    values: Values
    derived: tuple[str, ...] = ()
    seen: tuple[tuple[str, float, float], ...] = ()
    left: float | None = None
    later: float = 0.0
    earlier: bool = False

    def seen_in(self, context: Context, rows: np.ndarray) -> Effect:
        """Return the effect as found in (M,) rows of a campaign; a direction has no range."""
        names = [name for name in self.location.covariates if not name.startswith(APPROACH)]
        ranges = {name: context.column(name) if name == TIME else context.column(name)[rows] for name in names}
        return replace(self, seen=tuple((name, float(x.min()), float(x.max())) for name, x in ranges.items()))

    @property
    def of_time(self) -> bool:
        """Whether it holds for its campaign's clock."""
        return TIME in self.location.covariates and self.law.afterwards is not Afterwards.ANEW

    @property
    def another_day(self) -> str:
        """What becomes of it on another day in words, '' where it does not depend on time."""
        lags = self.remembers and not self.law.remembers_load(self.location)
        return self.law.afterwards.value if self.of_time or lags or HOLD in self.location.covariates else ""

    @property
    def span(self) -> tuple[float, float] | None:
        """First and last moment of its campaign [s], None where it holds for no clock, or nobody says for which."""
        return next(((low, high) for name, low, high in self.seen if name == TIME), None) if self.of_time else None

    @cached_property
    def moments(self) -> Values:
        """Moments of its campaign's clock [s] that it is the mean over in every row, none where rows have their own."""
        if self.left is None or self.span is None:
            return ()
        low, high = self.span
        if self.law.afterwards is Afterwards.STAYS:
            return (min(max(self.left, low - 1.0), high),)
        return tuple((low + (high - low) * (np.arange(INSTANTS) + 0.5) / INSTANTS).tolist())

    @property
    def columns(self) -> tuple[str, ...]:
        """The covariates that it takes from rows."""
        return tuple(name for name in self.location.covariates if not (self.moments and name == TIME))

    @property
    def ranges(self) -> tuple[tuple[str, float, float], ...]:
        """Those of `seen` beyond which it is an extrapolation in rows."""
        stays = self.moments or self.law.afterwards is Afterwards.STAYS
        return tuple(seen_range for seen_range in self.seen if not (stays and seen_range[0] == TIME))

    def clocks(self, context: Context) -> list[Context]:
        """Return the context on the clock that it is on, at each of its `moments`."""
        return [context.at_time(moment) for moment in self.moments] or [context.later(self.later)]

    def each(self, view: Solved, context: Context) -> list[Array]:
        """Return (M, k, n) what its law does in some rows per acting amplitude, at each of its `moments`."""
        return [self.law.features(self.location, self.inner, view, clock) for clock in self.clocks(context)]

    @property
    def amplitudes(self) -> Values:
        """Values of the linear parameters."""
        return self.values[: len(self.law.amplitudes)]

    @property
    def acting(self) -> Array:
        """(k,) values of those of them that act, in their units."""
        return np.array([self.values[i] for i in self.location.terms])

    @property
    def inner(self) -> Values:
        """Values of the nonlinear parameters."""
        return self.values[len(self.law.amplitudes) :]

    @property
    def name(self) -> str:
        """Law, site and axis."""
        return " ".join(
            part for part in (self.law.name, self.location.site, self.location.axis, self.location.partner) if part
        )

    @property
    def title(self) -> str:
        """Law and place as one says them: 'backlash at A2 (ry)'."""
        axis = " to ".join(part for part in (self.location.axis, self.location.partner) if part)
        return f"{self.law.name.replace('_', ' ')} at {self.location.place}{f' ({axis})' if axis else ''}"

    @property
    def named(self) -> dict[str, float]:
        """Values by name; amplitudes that do not act are left out, and a beginning before all time."""
        return {part.name: value for part, value in self._acting}

    @property
    def units(self) -> tuple[str, ...]:
        """Units of `named`."""
        motion, load = ("rad", "Nm") if self.location.turns else ("m", "N")
        across = "Nm" if self.location.partner.startswith("r") else "N"
        over = "rad" if self.location.covariates else "N"
        return tuple(part.unit.format(m=motion, w=load, across=across, over=over) for part, _ in self._acting)

    @property
    def _acting(self) -> list[tuple[Amplitude | Inner, float]]:
        amplitudes = [(self.law.amplitudes[i], self.amplitudes[i]) for i in self.location.terms]
        return [*amplitudes, *(pair for pair in zip(self.law.inner, self.inner, strict=True) if pair[1] != -np.inf)]

    @property
    def state(self) -> str | None:
        """Name of the derived covariate that says what it remembers, None where it has no memory."""
        return self.law.memory.name(self.location, self.inner) if self.law.memory else None

    @property
    def remembers(self) -> bool:
        """Whether what it does depends on the rows before, not on its own row alone."""
        memory = self.law.memory
        return memory is not None and (memory.lag is None or self.named[memory.lag] > 0.0)


Basis = Callable[[Here, Array, Row, Values], Array]
"""(here, (..., 6) wrench at the site, row, inner) -> (..., k, 6) twist per amplitude, local axes."""

Remember = Callable[[Here, Array, Row, Values], Array]
"""(here, (N, 6) wrench at the site, N rows in the order driven, inner) -> (N,) state."""


@dataclass(frozen=True)
class Memory:
    """A state that depends on the rows before: `name` of the derived covariate, and how it follows.

    It follows the location's first column where there is one, else the load. Where the inner parameter named `lag` is
    zero it follows at once, and nothing is remembered.
    """

    name: Callable[[Location, Values], str]
    remember: Remember
    unit: str
    lag: str | None = None

    def over(self, pieces: Sequence[np.ndarray], here: Here, wrench: Array, row: Row, inner: Values) -> Array:
        """Return the (N,) state in all rows, in each piece of them as if nothing had gone before.

        Args:
            pieces: Numbers of the rows of each; without any all rows are one.
            here: The location.
            wrench: (N, 6) load there, local axes [N, Nm].
            row: What is known of the rows.
            inner: Of the law.
        """
        if len(pieces) < 2:
            return self.remember(here, wrench, row, inner)
        remembered = np.zeros(len(row.q))
        for piece in pieces:
            remembered[piece] = self.remember(here, wrench[piece], row.some(piece), inner)
        return remembered


TermsBy = Callable[[Here, Values], Sequence[Terms]]
"""(here, inner) -> the terms that each amplitude multiplies; see `laws.terms`."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TwistLaw(EffectLaw):
    """A law that adds a twist at a site.

    Attributes:
        terms: What each amplitude multiplies, in the form that both engines and exported C know.
        basis: The twists themselves, of a law that follows that of the flexure, which may be no sum of terms.
        joined: Of a law of many amplitudes, the terms of all of them with their values, where those are fewer.
    """

    act: Act = Act.TWIST
    terms: TermsBy
    basis: Basis | None = None
    joined: Callable[[Here, Values, Values], Terms] | None = None

    def twists(self, here: Here, wrench: Array, row: Row, inner: Values) -> Array:
        """Return the (..., k, 6) twist per amplitude under a (..., 6) wrench at the site, local axes."""
        if self.basis:
            return self.basis(here, wrench, row, inner)
        return np.moveaxis(twists_of(self.terms_of(here, inner), wrench, row), 0, -2)

    def terms_of(self, here: Here, inner: Values) -> Sequence[Terms]:
        """Return the terms of each amplitude; raise `PluginError` where these are more or fewer."""
        terms = self.terms(here, inner)
        if len(terms) != len(self.amplitudes):
            text = f"`terms` gives {len(terms)} lists for {len(self.amplitudes)} amplitudes: one list for each"
            raise PluginError(f"the effect {self.name!r}: {text}")
        return terms

    def of_each(self, location: Location, inners: Sequence[Values], view: Solved, context: Context) -> Sequence[Array]:
        return [self.twists(*self._asked(location, inner, view, context)) for inner in inners]

    def shapes(self, location: Location, inner: Values, view: Solved, context: Context) -> Array:
        here, load, row, _ = self._asked(location, inner, view, context)
        way = self.direction(here, inner)
        assert way is not None
        return twists_of(self.terms_of(here, inner), load, row, way[None] / max(float(way @ way), LEAST))[..., 0]

    def _asked(
        self, location: Location, inner: Values, view: Solved, context: Context
    ) -> tuple[Here, Array, Row, Values]:
        """Return what the basis is asked about some rows."""
        here, row = context.here(location, view.arm), context.row_at(view)
        if self.memory:
            state = context.remembered(self.memory, location, inner, view)[view.rows]
            row = Row(row.q, row.joint_index, {**row.covariates, self.memory.name(location, inner): state})
        return here, view.load_at(location.site), row, inner


Pull = Callable[[Here, Array, Values | Array], Array]
"""(here, (..., 4, 4) pose of the link, (..., i) inner) -> (..., k, 6) wrench per amplitude at its origin, base axes."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LoadLaw(EffectLaw):
    """A law that adds a load on a link: the wrench per amplitude is its `pull`."""

    act: Act = Act.LOAD
    pull: Pull

    def of_each(self, location: Location, inners: Sequence[Values], view: Solved, context: Context) -> Sequence[Array]:
        pose = view.pose_of(link_of(location.site, context.robot))
        each = self.pull(context.here(location, view.arm), pose, np.array(inners)[:, None])
        return list(np.broadcast_to(each, (len(inners), *each.shape[-3:])))


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelLaw(EffectLaw):
    """A law that changes the model itself.

    Attributes:
        made: (here, rows, context) -> (M, k, n) features, one per amplitude.
        changed: The model with an effect in it.
    """

    made: Callable[[Here, Solved, Context], Array]
    changed: Callable[[Effect, ChangeableModel], ChangeableModel]
    changes_model: ClassVar[bool] = True

    def of_each(self, location: Location, inners: Sequence[Values], view: Solved, context: Context) -> Sequence[Array]:
        return [self.made(context.here(location, view.arm), view, context)] * len(inners)

    def change(self, effect: Effect, model: ChangeableModel) -> ChangeableModel:
        return self.changed(effect, model)


@dataclass(frozen=True, kw_only=True, eq=False)
class SightLaw(EffectLaw):
    """A law of how lines of sight bend, beside the arm; see `Postures.bend`.

    Attributes:
        weights: (location, row) -> of each amplitude what it is multiplied by. Amplitudes with an even number bend by
            the length squared [1/m], the others by the tangent of the zenith distance [rad].
    """

    act: Act = Act.SIGHT
    weights: Callable[[Location, Row], Sequence[Array | float]]

    def of_each(self, location: Location, inners: Sequence[Values], view: Solved, context: Context) -> Sequence[Array]:
        features = np.zeros((len(view.rows), len(self.amplitudes), 2))
        for number, weight in enumerate(self.weights(location, context.row_at(view))):
            features[:, number, number % 2] = weight
        return [features] * len(inners)

    def bend(self, effect: Effect, row: Row) -> Array:
        """Return the (..., 2) bending in rows, or in one [1/m, rad]."""
        weights = self.weights(effect.location, row)
        each = [value * np.asarray(weight) for value, weight in zip(effect.amplitudes, weights, strict=True)]
        return np.stack(np.broadcast_arrays(sum(each[::2]), sum(each[1::2])), axis=-1)

    def size(self, done: Array, arm: Manipulator) -> float:
        """Return how large (M, 2) bending is over what is plausible: RMS, dimensionless."""
        share = done / (self.plausible.shift, self.plausible.turn)
        return float(np.sqrt((share**2).mean(axis=0).max()))


def _named(name: str) -> EffectLaw:
    from armflex.laws.effects.catalogue import EVERY  # which imports this module

    return EVERY[name]


def full(amplitudes: Array, location: Location, count: int) -> Values:
    """Return all `count` amplitudes from those of the location's terms."""
    values = np.zeros(count)
    values[list(location.terms)] = amplitudes
    return tuple(values.tolist())
