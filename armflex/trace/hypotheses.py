"""What an arm may lack, and how probable each of it is before anything was read.

A machine is expected to lack `EFFECTS` effects. Each law of the catalogue is as likely as another but for `PLAINER`;
its places share its probability, at a place the choices of acting terms share that, and values inside the law that are
not linear share what is left: to have chosen among many costs what it should. Unnamed shapes have `NAMELESS` of all,
families `FAMILIAL`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import log

import numpy as np

from armflex.laws.effects.candidate import Candidate, candidates_of, grid, places_of
from armflex.laws.effects.catalogue import EVERY
from armflex.laws.effects.context import Context
from armflex.laws.effects.deadband import DEADBAND
from armflex.laws.effects.effect import EffectLaw, Search, Values
from armflex.laws.effects.hysteresis import HYSTERESIS
from armflex.laws.effects.location import LINK, Location, drive_axis
from armflex.laws.effects.shapes import ABOVE
from armflex.laws.effects.slip_step import SLIP_STEP
from armflex.laws.effects.unnamed import LINE

EFFECTS = 2.0
"""Prior: effects that an arm is expected to lack."""

NAMELESS = 0.05
"""Prior: share of them that are unnamed shapes."""

FAMILIAL = 0.1
"""Prior: share of them that all drives have in common."""

PLAINER = 0.01
"""Prior: a law is less likely than the one before it in the catalogue by this share, and a link by it than a joint."""

RARE_VALUE = 0.05
"""Prior: share of machines on which a value inside a law is not the usual one: parts are made to fit at 20 degC, and
what follows a temperature follows it at once, as far as readings show: a lag has to be earned."""

ODD_PLACE = 0.3
"""Prior: how much rarer an effect is at an odd place: lost motion in translation across a drive, as bearings are
preloaded, a slip along any other axis than the drive's, and a shape over a joint's position that does not act at that
joint."""

LOST_MOTION = (DEADBAND, HYSTERESIS)
"""Laws of it that act on any axis of a joint."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A law at a place that an arm may lack.

    Attributes:
        one: Which.
        prior: Log of the number of such effects that is expected of a machine.
        odd: What of that is because it is at an odd place, 0 where it is not.
    """

    one: Candidate
    prior: float
    odd: float = 0.0

    @property
    def title(self) -> str:
        """What it is in words."""
        return self.one.title

    def with_terms(self, acting: np.ndarray) -> Hypothesis:
        """Return it with (k,) of its acting terms alone."""
        terms = tuple(self.one.location.terms[i] for i in acting.tolist())
        if terms == self.one.location.terms:
            return self
        return replace(self, one=replace(self.one, location=replace(self.one.location, terms=terms)))

    @cached_property
    def spot(self) -> tuple[str, Location]:
        """Law and place, whatever is inside the law."""
        return self.one.law.name, self.one.location

    def alike(self, other: Hypothesis) -> bool:
        """Whether it is of the same law and place as another, about the same axis or one of them about all.

        That is whatever is inside the law and whichever of its terms act.
        """
        (own, place), (others, elsewhere) = self.spot, other.spot
        axes = {place.axis, elsewhere.axis} - {None}
        same = replace(place, axis=None, terms=()) == replace(elsewhere, axis=None, terms=())
        return own == others and same and len(axes) < 2

    @cached_property
    def positive(self) -> bool:
        """Whether its only amplitude must be positive."""
        terms = self.one.location.terms
        return len(terms) == 1 and self.one.law.amplitudes[terms[0]].positive


def of_family(name: str, count: int) -> Hypothesis:
    """Return one of so many families as a hypothesis: whatever it does at all of its places."""
    anywhere = Candidate(replace(LINE, name=name), Location(""), ())
    return Hypothesis(anywhere, log(EFFECTS * FAMILIAL / count))


def searched() -> list[EffectLaw]:
    """Return the laws that a campaign is searched for: those that may be at one place alone."""
    return [law for law in EVERY.values() if law.search is not Search.NOWHERE]


def hypotheses(context: Context) -> list[Hypothesis]:
    """Return every law at every place of a campaign, and every free shape that is not only sought where it may be."""
    known = list(candidates_of((law for law in searched() if law.search is not Search.RESIDUAL), context))
    spots = [one.law_and_place for one in known]
    places, terms, values = Counter(name for name, *_ in set(spots)), dict[tuple, set](), dict[tuple, list[Values]]()
    for one, spot in zip(known, spots, strict=True):
        terms.setdefault(spot, set()).add(one.location.terms)
        values.setdefault((spot, one.location.terms), []).append(one.inner)
    laws = {law.name: _of_law(law) for law in searched()}
    drives = {joint.name: drive_axis(joint) for joint in context.robot.moving}
    found = []
    for one, spot in zip(known, spots, strict=True):
        beside = values[spot, one.location.terms]
        prior = laws[one.law.name] - log(places[one.law.name]) - PLAINER * one.location.site.startswith(LINK)
        prior += log(RARE_VALUE) * _rare(one, beside, context)
        odd, across = oddness(one), one.location.axis != drives.get(one.location.site)
        if across and (one.law is SLIP_STEP or (one.law in LOST_MOTION and not one.location.turns)):
            odd += log(ODD_PLACE)
        found.append(Hypothesis(one, prior + odd - log(len(terms[spot]) * len(beside)), odd))
    return found


def oddness(one: Candidate) -> float:
    """Return the log of how much rarer a shape is for being at another joint than the one whose position it is over."""
    joints = [name for name in one.location.covariates if name.startswith("q_")]
    return log(ODD_PLACE) * (not one.law.physical and bool(joints) and f"q_{one.location.site}" not in joints)


def _rare(one: Candidate, beside: Sequence[Values], context: Context) -> int:
    """Return how many values inside a candidate's law are not the usual ones although candidates have those.

    A column that never reads 20 degC may be a difference, or have another unit: no reference is rare in it.
    """
    count = 0
    for i, inner in enumerate(one.law.inner):
        if inner.usual is None or one.inner[i] == inner.usual or all(other[i] != inner.usual for other in beside):
            continue
        if inner is ABOVE:
            column = context.column(one.location.covariates[0])
            count += bool(column.min() <= inner.usual <= column.max())
        else:
            count += 1
    return count


def _of_law(law: EffectLaw) -> float:
    """Return the log of how many effects of a law are expected."""
    alike = [one for one in searched() if one.physical == law.physical]
    share = (1.0 - NAMELESS - FAMILIAL) if law.physical else NAMELESS
    return log(EFFECTS * share / len(alike)) - PLAINER * alike.index(law)


def sought(law: EffectLaw, locations: Iterable[Location], context: Context) -> Iterator[Hypothesis]:
    """Yield a shape at some places, with every value inside it, as probable as if it had been tried at all."""
    places = len(places_of(law, context))
    for location in locations:
        inners, acting = list(grid(law, location, context)), replace(location, terms=tuple(range(len(law.amplitudes))))
        for inner in inners:
            one = Candidate(law, acting, inner)
            odd = oddness(one)
            yield Hypothesis(one, _of_law(law) + odd - log(places * len(inners)), odd)
