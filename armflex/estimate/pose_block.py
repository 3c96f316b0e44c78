"""What no recorded column explains: a random twist at a site, from pose to pose or wandering in time."""

from __future__ import annotations

from collections.abc import Sequence
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
from armflex.laws.terms import Factor, Of, table
from armflex.linear_gaussian import LinearGaussian
from armflex.parameters import ArmParameter, ParameterGroup, ParameterKind
from armflex.rows.rows import POSE, ROW

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
        group = ParameterGroup(ParameterKind.UNEXPLAINED, f"{self.site} {self.axis}")
        unit = "m" if self.axis.startswith("d") else "rad"
        return tuple(ArmParameter(group, f"pose {i}", unit) for i in range(int(self.groups.max()) + 1))

    @property
    def prior(self) -> Array:
        """(k,) the size."""
        return np.full(len(self.parameters), self.std)

    def resized(self, places: np.ndarray, values: Array, posterior: LinearGaussian) -> PoseBlock:
        """Return the block with the size that the twists of a fit have, itself where that is its own."""
        std = float(np.sqrt((values[places] ** 2 + np.diag(posterior.covariance)[places]).mean()))
        return self if abs(np.log(std / self.std)) <= EVEN else replace(self, std=std)

    def jacobian(self, view: View) -> Array:
        """Return `columns`: what loads and frequencies change by with so small a twist is beyond what is read."""
        return self.columns(view)

    def columns(self, view: View) -> Array:
        """Return (M, d, k): every pose moves its own rows."""
        answer = view.to_twist(self.site)[:, :, TWIST_NAMES.index(self.axis)]
        member = self.groups[view.rows][:, None] == np.arange(len(self.parameters))
        return answer[:, :, None] * member[:, None, :]

    def apply(self, setup: Setup, values: Array) -> Setup:
        """Return the setup with every pose's twist, which is taken out again before the arm is used."""
        count = len(values)
        each = [Factor(Of.TENT, POSE, (0.0, count - 1.0, 1.0, float(i))) for i in range(count)]
        return setup.with_effect(_unexplained(self.site, self.axis, each, values))


@dataclass(frozen=True, eq=False)
class Walk(Block):
    """A twist that a campaign had in some of its rows, as a sum of terms: fitted, never predicted.

    That is a random walk in time, by the terms of its Karhunen-Loeve expansion, or what an instrument was behind.

    Attributes:
        site, axis: Where.
        std: (k,) standard deviation of each term's amplitude, in units of which `waves` make m or rad.
        waves: (N, k) what each term is in every row of the campaign.
        session: Which it is of, '' of a walk through all.
        words: What distinguishes it from others there.
    """

    site: str
    axis: str
    std: Array
    waves: Array
    session: str = ""
    words: str = "in time"

    @cached_property
    def parameters(self) -> tuple[ArmParameter, ...]:
        """One per term."""
        of = " ".join(part for part in (self.site, self.axis, self.words, self.session) if part)
        unit = "m" if self.axis.startswith("d") else "rad"
        group = ParameterGroup(ParameterKind.UNEXPLAINED, of)
        return tuple(ArmParameter(group, f"term {i}", unit) for i in range(self.waves.shape[1]))

    @property
    def prior(self) -> Array:
        """(k,) the sizes."""
        return self.std

    @property
    def size(self) -> float:
        """Standard deviation of the twist over the rows [m or rad]."""
        return float(np.sqrt((self.waves**2 @ self.std**2).mean()))

    def jacobian(self, view: View) -> Array:
        """Return `columns`, as of a `PoseBlock`."""
        return self.columns(view)

    def columns(self, view: View) -> Array:
        """Return (M, d, k): every term moves all rows."""
        answer = view.to_twist(self.site)[:, :, TWIST_NAMES.index(self.axis)]
        return answer[:, :, None] * self.waves[view.rows][:, None, :]

    def apply(self, setup: Setup, values: Array) -> Setup:
        """Return the setup with the walk, which is taken out again before the arm is used."""
        along = np.append(self.waves @ values, 0.0)  # of one row, too, a table has two knots
        each = [table(ROW, 0.0, 1.0, along.tolist())]
        return setup.with_effect(_unexplained(self.site, self.axis, each, np.ones(1)))


def _unexplained(site: str, axis: str, each: Sequence[Factor], values: Array) -> Effect:
    """Return the effect of a twist along an axis: (k,) values times each of some factors of the same column."""
    law = TwistLaw(
        name=RANDOM,
        words=Words(RANDOM, "", ""),
        places=lambda records: (),
        amplitudes=tuple(Amplitude(f"{each[0].column} {i}", "{m}") for i in range(len(each))),
        terms=lambda here, inner: twists(here.direction, *([factor] for factor in each)),
        physical=False,
    )
    return Effect(law, Location(site, axis, (each[0].column,), tuple(range(len(each)))), tuple(values.tolist()))
