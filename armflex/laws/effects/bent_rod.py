"""A bent rod: the distance from a loop's pin to the joint that carries its link differs from the drawing."""

from dataclasses import replace

import numpy as np

from armflex.conventions import Array
from armflex.laws.effects.context import Context, Records
from armflex.laws.effects.effect import (
    Act,
    Amplitude,
    ChangeableModel,
    DependsOn,
    Effect,
    ModelLaw,
    Plausible,
    Solved,
    Words,
)
from armflex.laws.effects.location import LINK, Here, Location
from armflex.laws.effects.shapes import ON_THE_LINK
from armflex.robot import Robot


def _lengthenings(robot: Robot) -> dict[str, Array]:
    """Return by pin the (6,) twist that makes its link longer [m], of links that hang on a joint without a drive."""
    hanging = {joint.child for joint in robot.places if joint.name in robot.linkage.passive}
    ends = [
        (name, link, at)
        for loop in robot.linkage.loops
        for name, link, at in ((loop.name, loop.link, loop.at), (f"{loop.name}:to", loop.to, loop.at_to))
    ]
    return {
        name: np.concatenate([at / np.linalg.norm(at), np.zeros(3)])
        for name, link, at in ends
        if link in hanging and any(at)
    }


def _places(records: Records) -> list[Location]:
    return [Location(LINK + name) for name in _lengthenings(records.robot)]


def _longer(here: Here, view: Solved, context: Context) -> Array:
    return np.broadcast_to(_lengthenings(here.robot)[here.location.place], (len(view.rows), 1, 6))


def _change(effect: Effect, model: ChangeableModel) -> ChangeableModel:
    name, geometry = effect.location.place, model.corrections.geometry
    twist = geometry.get(name, np.zeros(6)) + effect.amplitudes[0] * _lengthenings(model.robot)[name]
    return replace(model, corrections=replace(model.corrections, geometry={**geometry, name: twist}))


BENT_ROD = ModelLaw(
    name="bent_rod",
    words=Words("bent rod", "the link between a joint and a loop's pin is shorter or longer than drawn", "constant"),
    instead=ON_THE_LINK,
    plausible=Plausible(0.005, 0.01, "what is off its drawing by a cm is measured again"),
    places=_places,
    amplitudes=(Amplitude("length", "m"),),
    act=Act.TWIST,
    made=_longer,
    changed=_change,
    depends_on=DependsOn.NOTHING,
)
