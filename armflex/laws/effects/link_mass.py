"""A link that is heavier than declared (at its declared centre of mass), or whose centre of mass is elsewhere."""

from dataclasses import replace

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
from armflex.laws.effects.location import Here, Location, link_of
from armflex.laws.effects.shapes import middle_of


def _places(records: Records) -> list[Location]:
    """Return every link with extra mass or a moved centre, along an axis or anyhow."""
    return [Location(link, terms=terms) for link in records.bodies for terms in ((0,), (1,), (2,), (3,), (1, 2, 3))]


def _weight(here: Here, view: Solved, context: Context) -> Array:
    """Return (M, 4, 6) wrenches of gravity per mass, and per shift of the centre in the link's frame."""
    robot, name = view.arm.robot, link_of(here.location.site, view.arm.robot)
    link, rotation = robot.urdf.links[name], view.pose_of(name)[:, :3, :3]
    mass = link.inertial.mass if link.inertial else 0.0
    levers = np.vstack([middle_of(here), mass * np.eye(3)])
    gravity = view.gravity(robot.gravity[None])
    moments = np.cross(np.einsum("nij,kj->nki", rotation, levers), gravity)
    forces = np.array([1.0, 0.0, 0.0, 0.0])[:, None] * gravity
    return np.concatenate([forces, moments], axis=2)


def _change(effect: Effect, model: ChangeableModel) -> ChangeableModel:
    bodies, link = model.corrections.bodies, link_of(effect.location.site, model.robot)
    change = bodies.get(link, np.zeros(4)) + np.array(effect.amplitudes)
    return replace(model, corrections=replace(model.corrections, bodies={**bodies, link: change}))


def _weighs(effect: Effect, context: Context, arm: Manipulator) -> bool:
    """Return whether a link keeps a mass, and not more than all of the arm."""
    link = arm.robot.urdf.links[link_of(effect.location.site, arm.robot)]
    mass = link.inertial.mass if link.inertial else 0.0
    mass += float(arm.corrections.bodies.get(link.name, np.zeros(4))[0])
    return -mass <= effect.amplitudes[0] <= arm.weight / np.linalg.norm(arm.robot.gravity)


LINK_MASS = ModelLaw(
    name="link_mass",
    words=Words("link mass correction", "the mass of the link differs from the declared one", "m, centre of mass"),
    instead="weigh the link",
    plausible=Plausible(0.35, 0.35, "hoses and what is bolted on weigh a tenth of an arm"),
    places=_places,
    amplitudes=(Amplitude("mass", "kg"), *(Amplitude(f"com_{a}", "m", most=1.0, usual=0.1) for a in "xyz")),
    possible=_weighs,
    act=Act.LOAD,
    made=_weight,
    changed=_change,
)
