"""A payload whose centre of mass is elsewhere than declared, in the tip frame: one of them, or all."""

from dataclasses import replace

import numpy as np

from armflex.conventions import Array
from armflex.laws.effects.context import Context, Records
from armflex.laws.effects.effect import Act, Amplitude, ChangeableModel, Effect, ModelLaw, Plausible, Solved, Words
from armflex.laws.effects.location import TOOL, Here, Location, all_and_each


def _places(records: Records) -> list[Location]:
    choices = (("dx", (0,)), ("dy", (1,)), ("dz", (2,)), (None, (0, 1, 2)))
    return [Location(TOOL, axis, (), terms, name) for name in all_and_each(records.payloads) for axis, terms in choices]


def _weight(here: Here, view: Solved, context: Context) -> Array:
    """Return (M, 3, 6) wrenches of gravity at the tip per shift of the centre."""
    partner = here.location.partner
    masses = {name: view.arm.payload(name).mass * (partner in ("", name)) for name in set(context.payloads)}
    mass = np.array([masses[context.payloads[row]] for row in view.rows.tolist()])
    rotation = view.pose_of(view.arm.robot.tip)[:, :3, :3].transpose(0, 2, 1)
    moments = np.cross(rotation, view.gravity(view.arm.robot.gravity[None])) * mass[:, None, None]
    return np.concatenate([np.zeros_like(moments), moments], axis=2)


def _change(effect: Effect, model: ChangeableModel) -> ChangeableModel:
    shift, partner = np.array(effect.amplitudes), effect.location.partner
    changed = {
        name: replace(payload, com=payload.com + shift) if partner in ("", name) else payload
        for name, payload in model.payloads.items()
    }
    return replace(model, payloads=changed)


PAYLOAD_COM = ModelLaw(
    name="payload_com",
    words=Words(
        "payload centre-of-mass correction", "the centre of mass of the payload differs from the declared one", "Δcom"
    ),
    instead="carry the same mass at another place of the tool",
    plausible=Plausible(0.35, 0.35, "of a payload that weighs half of what carries it, half a metre"),
    places=_places,
    amplitudes=tuple(Amplitude(axis, "m", most=1.0, usual=0.1) for axis in ("dx", "dy", "dz")),
    act=Act.LOAD,
    made=_weight,
    changed=_change,
)
