"""What no recorded column explains: a random twist of known size and unknown value, one for every pose."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from armflex.arm import Setup
from armflex.conventions import TWIST_NAMES, Array
from armflex.estimate.block import Block
from armflex.estimate.robust import EVEN
from armflex.estimate.view import View
from armflex.laws.effects.effect import Amplitude, Effect, TwistLaw, Words
from armflex.laws.effects.location import Location
from armflex.laws.effects.shapes import twists
from armflex.laws.terms import Factor, Of
from armflex.linear_gaussian import LinearGaussian
from armflex.parameters import ArmParameter, Group, ParameterKind
from armflex.rows.rows import POSE

RANDOM = "unexplained"
"""Name of the effect while a fit lasts."""


@dataclass(frozen=True, eq=False)
class PoseBlock(Block):
    """A random twist at one site and axis, of known size and unknown value: one for every pose.

    Attributes:
        site, axis: Where.
        std: Standard deviation of the twists [m or rad].
        groups: (N,) pose number of every row of the campaign.
        alike: Other places that explain as much.
    """

    site: str
    axis: str
    std: float
    groups: np.ndarray
    alike: tuple[Any, ...] = ()

    @cached_property
    def parameters(self) -> tuple[ArmParameter, ...]:
        """One per pose."""
        group = Group(ParameterKind.UNEXPLAINED, f"{self.site} {self.axis}")
        unit = "m" if self.axis.startswith("d") else "rad"
        return tuple(ArmParameter(group, f"pose {i}", unit) for i in range(int(self.groups.max()) + 1))

    @property
    def prior(self) -> Array:
        """(k,) the size."""
        return np.full(len(self.parameters), self.std)

    def resized(self, places: np.ndarray, values: Array, known: LinearGaussian) -> PoseBlock:
        """Return the block with the size that the twists of a fit have, itself where that is its own."""
        std = float(np.sqrt((values[places] ** 2 + np.diag(known.covariance)[places]).mean()))
        return self if abs(np.log(std / self.std)) <= EVEN else replace(self, std=std)

    def jacobian(self, view: View) -> Array:
        """Return `columns`: what loads and frequencies change by with so small a twist is beyond what is read."""
        return self.columns(view)

    def columns(self, view: View) -> Array:
        """Return (M, d, k): every pose moves its own rows."""
        answer = view.to_twist(self.site)[:, :, TWIST_NAMES.index(self.axis)]
        own = self.groups[view.rows][:, None] == np.arange(len(self.parameters))
        return answer[:, :, None] * own[:, None, :]

    def apply(self, setup: Setup, values: Array) -> Setup:
        """Return the setup with every pose's twist, which is taken out again before the arm is used."""
        count = len(values)
        own = [(Factor(Of.TENT, POSE, (0.0, count - 1.0, 1.0, float(i))),) for i in range(count)]
        law = TwistLaw(
            name=RANDOM,
            words=Words(RANDOM, "", ""),
            places=lambda records: (),
            amplitudes=tuple(Amplitude(f"pose {i}", "{m}") for i in range(count)),
            terms=lambda here, inner: twists(here.direction, *own),
            physical=False,
        )
        location = Location(self.site, self.axis, (POSE,), tuple(range(count)))
        return setup.with_effect(Effect(law, location, tuple(values.tolist())))
