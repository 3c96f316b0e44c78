"""A payload that is heavier than declared: one of them, each by the same mass, or all by the same share.

By the same share, the kilograms are those of the heaviest. The mass is at the declared centre of mass.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from armflex.conventions import Array
from armflex.laws.effects.context import Context, Records
from armflex.laws.effects.effect import (
    Act,
    Amplitude,
    ChangeableModel,
    Effect,
    Manipulator,
    ModelLaw,
    Plausible,
    Solved,
    Words,
)
from armflex.laws.effects.location import TOOL, Here, Location, all_and_each

EACH = "each"
"""Partner of a location whose mass is added to every payload that weighs."""


def _places(records: Records) -> list[Location]:
    """Return all payloads together and, where there are several, each by itself."""
    names = all_and_each(records.payloads)
    return [Location(TOOL, partner=name) for name in ((*names, EACH) if len(names) > 1 else names)]


def _weight(here: Here, view: Solved, context: Context) -> Array:
    """Return the (M, 1, 6) wrenches of gravity at the tip per mass."""
    arm, gravity = view.arm, view.gravity(view.arm.robot.gravity[None])[:, 0]
    names = [context.payloads[row] for row in view.rows]
    shares = _shares(here.location, {name: arm.payload(name).mass for name in set(context.payloads)})
    share = np.array([shares.get(name, 0.0) for name in names])
    centres = {name: arm.payload(name).com for name in set(names)}
    lever = np.array([centres[name] for name in names])
    moment = np.cross(np.einsum("nij,nj->ni", view.pose_of(arm.robot.tip)[:, :3, :3], lever), gravity)
    return (np.concatenate([gravity, moment], axis=1) * share[:, None])[:, None]


def _change(effect: Effect, model: ChangeableModel) -> ChangeableModel:
    masses = {name: max(mass, 0.0) for name, mass in masses_with(effect, model.payloads).items()}
    changed = {name: replace(payload, mass=masses[name]) for name, payload in model.payloads.items()}
    return replace(model, payloads=changed)


def masses_with(effect: Effect, payloads: Mapping[str, Any]) -> dict[str, float]:
    """Return what each payload weighs with an effect in it [kg]; below nothing where that takes more than there is."""
    masses = {name: payload.mass for name, payload in payloads.items()}
    shares = _shares(effect.location, masses)
    return {name: mass + shares.get(name, 0.0) * effect.values[0] for name, mass in masses.items()}


def _weighs(effect: Effect, context: Context, arm: Manipulator) -> bool:
    """Return whether no payload would weigh less than nothing."""
    return min(masses_with(effect, {name: arm.payload(name) for name in set(context.payloads)}).values()) >= 0.0


def _shares(location: Location, masses: dict[str, float]) -> dict[str, float]:
    """Return what part of the extra mass each payload has."""
    if location.partner == EACH:
        return {name: 1.0 for name, mass in masses.items() if mass > 0.0}
    if location.partner:
        return {location.partner: 1.0}
    heaviest = max(masses.values(), default=0.0) or 1.0
    return {name: mass / heaviest for name, mass in masses.items()}


PAYLOAD_MASS = ModelLaw(
    name="payload_mass",
    words=Words("payload mass correction", "the mass of the payload differs from the declared one", "Δm"),
    instead="weigh the payload",
    plausible=Plausible(0.35, 0.35, "a payload is weighed to a tenth"),
    places=_places,
    amplitudes=(Amplitude("mass", "kg"),),
    possible=_weighs,
    act=Act.LOAD,
    made=_weight,
    changed=_change,
)
