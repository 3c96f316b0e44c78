"""What a missing effect is: a law in the catalogue, at a spot, with values.

A law is linear in its amplitudes and may have inner parameters that it is not linear in. `TwistLaw` adds a small twist
at a site, `LoadLaw` a load on a link; `ModelLaw` changes the model itself (masses, gravity, the instrument).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from armflex.conventions import Array
from armflex.laws import Row
from armflex.laws.effects.spot import Here, Spot, link_of

if TYPE_CHECKING:
    from armflex.estimate.view import Setup, View
    from armflex.laws.effects.scene import Scene

Values = tuple[float, ...]


@dataclass(frozen=True)
class Amplitude:
    """A parameter that the law is linear in; in its unit, {m} stands for the motion's unit and {w} for the load's.

    With `positive` it makes no sense below zero, and beyond `most` in size it is not believed.
    """

    name: str
    unit: str
    positive: bool = False
    most: float = float("inf")


@dataclass(frozen=True)
class Inner:
    """A parameter that the law is not linear in.

    Attributes:
        name, unit: As for an amplitude.
        grid: Starting values for the search at a spot of a scene.
        positive: Whether only values above zero make sense; such are refined on a logarithmic scale.
        polished: Whether it is refined after the grid.
        smooth: Whether the law changes smoothly with it, so that a fit may move it.
        usual: What it is without evidence to the contrary, for one that is chosen rather than refined.
        tried: Further values that only the best candidates are tried with.
    """

    name: str
    unit: str
    grid: Callable[[Spot, Scene], Iterable[float]]
    positive: bool = True
    polished: bool = True
    smooth: bool = True
    usual: float | None = None
    tried: Values = ()

    def moved(self, value: float, by: float) -> float:
        """Return a value moved: by a factor's logarithm where only positive ones make sense, else by a difference."""
        return value * float(np.exp(np.clip(by, -50.0, 50.0))) if self.positive else value + by


class EffectLaw(Protocol):
    """An entry of the catalogue."""

    @property
    def name(self) -> str:
        """As files name it."""
        ...

    @property
    def amplitudes(self) -> tuple[Amplitude, ...]:
        """Linear parameters."""
        ...

    @property
    def inner(self) -> tuple[Inner, ...]:
        """Nonlinear parameters."""
        ...

    def spots(self, scene: Scene) -> Iterable[Spot]:
        """Return where the effect makes sense in a campaign."""
        ...

    def columns(self, spot: Spot, inner: Values, view: View, scene: Scene) -> Array:
        """Return (M, d, k) changes of the readings per amplitude of `spot.terms`."""
        ...

    def apply(self, effect: Effect, setup: Setup) -> Setup:
        """Return a setup with the effect in it."""
        ...


@dataclass(frozen=True)
class Effect:
    """An effect with its values.

    Attributes:
        law: What it does.
        spot: Where.
        values: All amplitudes (zero where the spot leaves one out), then the inner parameters.
        derived: Those of the spot's covariates that the order of the rows stood in for where it was found: directions
            `approach_<joint>`. Where the rows asked about do not give one it is derived in the same way, and before a
            joint has moved it is either: halfway on average, and as uncertain as both are apart.
    """

    law: EffectLaw
    spot: Spot
    values: Values
    derived: tuple[str, ...] = ()

    @property
    def amplitudes(self) -> Values:
        """Values of the linear parameters."""
        return self.values[: len(self.law.amplitudes)]

    @property
    def inner(self) -> Values:
        """Values of the nonlinear parameters."""
        return self.values[len(self.law.amplitudes) :]

    @property
    def name(self) -> str:
        """Law, site and axis."""
        return " ".join(part for part in (self.law.name, self.spot.site, self.spot.axis, self.spot.partner) if part)

    @property
    def title(self) -> str:
        """Law and place as one says them: 'backlash at A2 (ry)'."""
        axis = " to ".join(part for part in (self.spot.axis, self.spot.partner) if part)
        return f"{self.law.name.replace('_', ' ')} at {self.spot.place}{f' ({axis})' if axis else ''}"

    @property
    def named(self) -> dict[str, float]:
        """Values by name; amplitudes that do not act are left out, and a beginning before all time."""
        return {part.name: value for part, value in self._acting}

    @property
    def units(self) -> tuple[str, ...]:
        """Units of `named`."""
        motion, load = ("rad", "Nm") if self.spot.turns else ("m", "N")
        across = "Nm" if self.spot.partner.startswith("r") else "N"
        return tuple(part.unit.format(m=motion, w=load, across=across) for part, _ in self._acting)

    @property
    def _acting(self) -> list[tuple[Amplitude | Inner, float]]:
        amplitudes = [(self.law.amplitudes[i], self.amplitudes[i]) for i in self.spot.terms]
        return [*amplitudes, *(pair for pair in zip(self.law.inner, self.inner, strict=True) if pair[1] != -np.inf)]


Basis = Callable[[Here, Array, Row, Values], Array]
"""(here, (..., 6) wrench at the site, row, inner) -> (..., k, 6) twist per amplitude, local axes."""

Shapes = Callable[[Here, Array, Row, Values], Sequence[Array]]
"""(here, (..., 6) wrench at the site, row, inner) -> one (...,) number per amplitude."""


@dataclass(frozen=True)
class Along:
    """A basis whose twists all have one direction, whatever the row: numbers times a constant twist.

    Attributes:
        shapes: The numbers.
        direction: (6,) twist in the site's frame, by place and inner parameters.
    """

    shapes: Shapes
    direction: Callable[[Here, Values], Array]

    def __call__(self, here: Here, wrench: Array, row: Row, inner: Values) -> Array:
        """Return the (..., k, 6) twist per amplitude."""
        shapes = self.shapes(here, wrench, row, inner)
        if len(shapes) == 1:  # the usual case, and numpy takes its time to stack
            return np.asarray(shapes[0])[..., None, None] * self.direction(here, inner)
        return np.stack(np.broadcast_arrays(*shapes), axis=-1)[..., None] * self.direction(here, inner)


Remember = Callable[[Here, Array, Row, Values], Array]
"""(here, (N, 6) wrench at the site, N rows in the order driven, inner) -> (N,) state."""


@dataclass(frozen=True)
class Memory:
    """A state that depends on the rows before: `name` of the derived covariate, and how it follows.

    It follows the spot's first column where there is one, else the load.
    """

    name: Callable[[Spot, Values], str]
    remember: Remember
    unit: str


@dataclass(frozen=True)
class TwistLaw:
    """A law that adds a twist at a site.

    Attributes:
        name: As files name it.
        places: Where it makes sense.
        amplitudes: Linear parameters.
        basis: The twist per amplitude.
        inner: Nonlinear parameters.
        loaded: Whether the twist depends on the wrench.
        linear: Whether it is proportional to it, at given positions and covariates, where the flexure's own law is.
        memory: State it needs, if any.
    """

    name: str
    places: Callable[[Scene], Iterable[Spot]]
    amplitudes: tuple[Amplitude, ...]
    basis: Basis
    inner: tuple[Inner, ...] = ()
    loaded: bool = False
    memory: Memory | None = None
    linear: bool = False

    def __reduce__(self) -> tuple:
        """Return the name: a law is found in the catalogue again where it is sent."""
        return _named, (self.name,)

    def digested(self) -> str:
        """Return the name, for `digest`: it stands for the entry of the catalogue."""
        return self.name

    def spots(self, scene: Scene) -> Iterable[Spot]:
        """Return where the effect makes sense in a campaign."""
        return self.places(scene)

    def columns(self, spot: Spot, inner: Values, view: View, scene: Scene) -> Array:
        """Return (M, d, k) changes of the readings per acting amplitude."""
        features = self.features(spot, inner, view, scene)
        return self.answer(spot, view) @ features.transpose(0, 2, 1)

    def answer(self, spot: Spot, view: View) -> Array:
        """Return (M, d, 6) changes of the readings per twist at a spot's site."""
        return view.to_twist(spot.site)

    def features(self, spot: Spot, inner: Values, view: View, scene: Scene) -> Array:
        """Return (M, k, 6) twists per acting amplitude in the measured rows."""
        return self.basis(*self._asked(spot, inner, view, scene))[:, list(spot.terms)]

    def of_load(self, spot: Spot) -> bool:
        """Return whether a twist depends on the load, now or before, and not on the columns of its spot alone."""
        return self.loaded or (self.memory is not None and not spot.covariates)

    def shapes(self, spot: Spot, inner: Values, view: View, scene: Scene) -> Array:
        """Return the (k, M) numbers, one per amplitude, of a law whose basis is `Along` one direction."""
        assert isinstance(self.basis, Along)
        return np.array(self.basis.shapes(*self._asked(spot, inner, view, scene)))

    def _asked(self, spot: Spot, inner: Values, view: View, scene: Scene) -> tuple[Here, Array, Row, Values]:
        """Return what the basis is asked about the measured rows."""
        here, row = scene.here(spot, view.setup.arm), scene.row_at(view)
        if self.memory:
            state = scene.remembered(self.memory, spot, inner, view)[view.rows]
            row = Row(row.q, row.joint_index, {**row.covariates, self.memory.name(spot, inner): state})
        return here, view.line.load_at(spot.site), row, inner

    def apply(self, effect: Effect, setup: Setup) -> Setup:
        """Return the setup with the effect among those of its arm."""
        return setup.with_effect(effect)


Pull = Callable[[Here, Array, Values], Array]
"""(here, (..., 4, 4) pose of the link, inner) -> (..., k, 6) wrench per amplitude at its origin, base axes."""


@dataclass(frozen=True)
class LoadLaw:
    """A law that adds a load on a link."""

    name: str
    places: Callable[[Scene], Iterable[Spot]]
    amplitudes: tuple[Amplitude, ...]
    pull: Pull
    inner: tuple[Inner, ...] = ()

    def __reduce__(self) -> tuple:
        """Return the name: a law is found in the catalogue again where it is sent."""
        return _named, (self.name,)

    def digested(self) -> str:
        """Return the name, for `digest`: it stands for the entry of the catalogue."""
        return self.name

    def spots(self, scene: Scene) -> Iterable[Spot]:
        """Return where the effect makes sense in a campaign."""
        return self.places(scene)

    def columns(self, spot: Spot, inner: Values, view: View, scene: Scene) -> Array:
        """Return (M, d, k) changes of the readings per acting amplitude."""
        features = self.features(spot, inner, view, scene)
        return self.answer(spot, view) @ features.transpose(0, 2, 1)

    def answer(self, spot: Spot, view: View) -> Array:
        """Return (M, d, 6) changes of the readings per wrench at the origin of a spot's link, base axes."""
        return view.to_load(link_of(spot.site, view.setup.arm.robot))

    def features(self, spot: Spot, inner: Values, view: View, scene: Scene) -> Array:
        """Return (M, k, 6) wrenches per acting amplitude in the measured rows."""
        here, index = scene.here(spot, view.setup.arm), view.line.link_names.index(scene.link(spot.site))
        return self.pull(here, view.line.links[:, index], inner)[:, list(spot.terms)]

    def apply(self, effect: Effect, setup: Setup) -> Setup:
        """Return the setup with the effect among those of its arm."""
        return setup.with_effect(effect)


def _named(name: str) -> EffectLaw:
    from armflex.laws.effects.catalogue import EVERY  # which imports this module

    return EVERY[name]


def full(amplitudes: Array, spot: Spot, count: int) -> Values:
    """Return all `count` amplitudes from those of the spot's terms."""
    values = np.zeros(count)
    values[list(spot.terms)] = amplitudes
    return tuple(values.tolist())
