"""A link that is heavier than declared, or whose centre of mass is elsewhere."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from armflex.conventions import Array
from armflex.laws.effects.law import Amplitude, Effect, Inner, Values
from armflex.laws.effects.points import middle_of
from armflex.laws.effects.scene import Scene
from armflex.laws.effects.spot import Spot, link_of

if TYPE_CHECKING:
    from armflex.estimate.view import Setup, View


@dataclass(frozen=True)
class LinkMass:
    """Extra mass at the declared centre of mass, and a shift of that centre in the link's frame."""

    name: str = "link_mass"
    amplitudes: tuple[Amplitude, ...] = (
        Amplitude("mass", "kg"),
        *(Amplitude(f"com_{a}", "m", most=1.0) for a in "xyz"),
    )
    inner: tuple[Inner, ...] = ()

    def spots(self, scene: Scene) -> Iterable[Spot]:
        """Return every link with extra mass or a moved centre, along an axis or anyhow."""
        return [Spot(link, terms=terms) for link in scene.links for terms in ((0,), (1,), (2,), (3,), (1, 2, 3))]

    def columns(self, spot: Spot, inner: Values, view: View, scene: Scene) -> Array:
        """Return (M, d, k) changes of the readings."""
        arm = view.setup.arm
        index, link = view.line.link_names.index(scene.link(spot.site)), arm.robot.urdf.links[scene.link(spot.site)]
        rotation, gravity = view.line.links[:, index, :3, :3], arm.robot.gravity
        mass = link.inertial.mass if link.inertial else 0.0
        levers = np.vstack([middle_of(scene.here(spot, arm)), mass * np.eye(3)])
        moments = np.cross(np.einsum("nij,kj->nki", rotation, levers), gravity)
        forces = np.broadcast_to(np.outer([1.0, 0.0, 0.0, 0.0], gravity), moments.shape)
        wrenches = np.concatenate([forces, moments], axis=2)[:, list(spot.terms)]
        return view.answer(view.line.link_loads[:, index] @ wrenches.transpose(0, 2, 1))

    def apply(self, effect: Effect, setup: Setup) -> Setup:
        """Return the setup with the link's body corrected."""
        corrections = setup.arm.corrections
        link = link_of(effect.spot.site, setup.arm.robot)
        change = corrections.bodies.get(link, np.zeros(4)) + np.array(effect.amplitudes)
        changed = replace(corrections, bodies={**corrections.bodies, link: change})
        return replace(setup, arm=replace(setup.arm, corrections=changed)).with_effect(effect)


LINK_MASS = LinkMass()
