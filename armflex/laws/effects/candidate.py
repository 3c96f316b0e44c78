"""Candidates: what an arm may lack in a campaign, every law at every location with values inside it."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import product

from armflex.conventions import Array
from armflex.laws.effects.context import Context
from armflex.laws.effects.effect import Effect, EffectLaw, Values, full
from armflex.laws.effects.location import Location


@dataclass(frozen=True)
class Candidate:
    """A law at a location with values of its inner parameters."""

    law: EffectLaw
    location: Location
    inner: Values

    @property
    def name(self) -> str:
        """Law, site and axis."""
        return Effect(self.law, self.location, ()).name

    @property
    def title(self) -> str:
        """The same in words."""
        return Effect(self.law, self.location, ()).title

    @property
    def law_and_place(self) -> tuple:
        """Law and place, whatever is inside the law and whichever of its terms act."""
        place = self.location
        return (self.law.name, place.site, place.axis, place.covariates, place.partner)

    @property
    def searched(self) -> tuple[int, ...]:
        """Inner parameters that are searched; a positive one at zero is switched off."""
        pairs = enumerate(zip(self.law.inner, self.inner, strict=True))
        return tuple(i for i, (inner, value) in pairs if inner.polished and (value > 0.0 or not inner.positive))

    @cached_property
    def fitted(self) -> tuple[int, ...]:
        """Inner parameters that a fit moves: those that the law is smooth in, and those that only a prior holds."""
        loose = [i for i, inner in enumerate(self.law.inner) if inner.spread is not None]
        return tuple(sorted([*(i for i in self.searched if self.law.inner[i].smooth), *loose]))

    def effect(self, amplitudes: Array) -> Effect:
        """Return the effect with amplitudes of the acting terms."""
        return Effect(self.law, self.location, full(amplitudes, self.location, len(self.law.amplitudes)) + self.inner)


def places_of(law: EffectLaw, context: Context) -> list[Location]:
    """Return where a law may act in a campaign: every place whose columns the campaign has."""
    return [location for location in law.places(context.records) if all(map(context.row.has, location.covariates))]


def grid(law: EffectLaw, location: Location, context: Context) -> Iterator[Values]:
    """Yield starting values of a law's inner parameters."""
    yield from product(*(tuple(float(v) for v in inner.grid(location, context)) for inner in law.inner))


def candidates_of(laws: Iterable[EffectLaw], context: Context) -> Iterator[Candidate]:
    """Yield every candidate of some laws in a campaign."""
    for law in laws:
        for location in places_of(law, context):
            for inner in grid(law, location, context) if law.inner else ((),):
                yield Candidate(law, location, inner)
