"""A cause that nobody recorded: a random twist per pose at one site and axis, of known size and unknown value."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from armflex.conventions import TWIST_NAMES, Array
from armflex.estimate.block import Block
from armflex.estimate.view import View
from armflex.laws import Row
from armflex.laws.effects.effect import Amplitude, Effect, TwistLaw, Values, Words
from armflex.laws.effects.location import Here, Location
from armflex.parameters import ArmParameter, Group, Kind
from armflex.rows.rows import POSE
from armflex.setup import Setup
from armflex.trace.localise import RandomTwist

RANDOM = "unexplained"
"""Name of the effect while a fit lasts."""


@dataclass(frozen=True, eq=False)
class PoseBlock(Block):
    """One twist for every pose.

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
    alike: tuple[RandomTwist, ...] = ()

    @cached_property
    def parameters(self) -> tuple[ArmParameter, ...]:
        """One per pose."""
        group, unit = Group(Kind.UNEXPLAINED, f"{self.site} {self.axis}"), "m" if self.axis.startswith("d") else "rad"
        return tuple(ArmParameter(group, f"pose {i}", unit) for i in range(int(self.groups.max()) + 1))

    @property
    def prior(self) -> Array:
        """(k,) the size."""
        return np.full(len(self.parameters), self.std)

    def columns(self, view: View) -> Array:
        """Return (M, d, k): every pose moves its own rows."""
        answer = view.to_twist(self.site)[:, :, TWIST_NAMES.index(self.axis)]
        own = self.groups[view.rows][:, None] == np.arange(len(self.parameters))
        return answer[:, :, None] * own[:, None, :]

    def apply(self, setup: Setup, values: Array) -> Setup:
        """Return the setup with every pose's twist, which is taken out again before the arm is used."""
        terms = tuple(range(len(values)))
        location = Location(self.site, self.axis, (POSE,), terms)
        return setup.with_effect(Effect(_one_per_pose(len(values)), location, tuple(values.tolist())))


def _one_per_pose(count: int) -> TwistLaw:
    def basis(here: Here, wrench: Array, row: Row, inner: Values) -> Array:
        own = np.asarray(row.covariate(POSE))[..., None] == np.arange(count)
        return own[..., None] * here.direction

    return TwistLaw(
        name=RANDOM,
        words=Words(RANDOM, "", ""),
        places=lambda records: (),
        amplitudes=(Amplitude("twist", "{m}"),) * count,
        basis=basis,
        physical=False,
    )
