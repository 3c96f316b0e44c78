"""Play in a pin: a bearing falls to the side on which it is loaded, (gap / 2) F / |F|.

Of a loop's pin and of a joint without a drive F is the force across the axis, of a cylinder that along it. Below a
force `seated` the pin is between its sides.
"""

from collections.abc import Iterable

import numpy as np

from armflex.conventions import Array
from armflex.laws.effects.context import Context, Records
from armflex.laws.effects.effect import Amplitude, DependsOn, Inner, Plausible, TwistLaw, Values, Watching, Words
from armflex.laws.effects.location import Here, Location, joint_named
from armflex.laws.law import embed
from armflex.laws.terms import NOTHING, Term, power
from armflex.robot import Robot


def _places(records: Records) -> list[Location]:
    linkage = records.robot.linkage
    hinges = [name for name in linkage.passive if joint_named(name, records.robot).kind != "prismatic"]  # pyright: ignore
    return [Location(name) for name in (*hinges, *(closure.name for closure in (*linkage.loops, *linkage.cylinders)))]


def across(name: str, robot: Robot) -> Array:
    """Return the (3, 3) projection on the directions in which a pin with play is held."""
    loop = next((closure for closure in robot.linkage.loops if closure.name == name), None)
    if loop is not None:
        return np.eye(3) - (loop.kind in ("revolute", "cylindrical")) * np.outer(loop.axis, loop.axis)
    joint = joint_named(name, robot)
    assert joint is not None
    along = np.outer(joint.axis, joint.axis)
    return along if joint.kind == "prismatic" else np.eye(3) - along


def _terms(here: Here, inner: Values) -> list[list[Term]]:
    """Return the force across over its length, that of `seated` beside it."""
    held = embed(across(here.location.site, here.robot))
    return [[Term(NOTHING, 0.5 * held, features=(power(held, -0.5, inner[0] ** 2),))]]


def _seated(location: Location, context: Context) -> Iterable[float]:
    force = np.linalg.norm(context.wrenches[location.site][:, :3] @ across(location.site, context.robot), axis=1)
    # Of the largest force, below which a pin is between its sides: to begin a search with.
    return float(force.max()) * np.array((0.01, 0.05, 0.2)) if force.max() > 0.0 else ()


PIN_PLAY = TwistLaw(
    name="pin_play",
    words=Words("play in a pin", "the pin falls to the side on which it is loaded", "(gap / 2) · F / |F|"),
    instead=Watching("reverse the load on the pin, and watch both of its links with a dial gauge"),
    plausible=Plausible(0.001, 0.002, "bushes are changed when a pin has a mm or two"),
    places=_places,
    amplitudes=(Amplitude("gap", "m", positive=True),),
    terms=_terms,
    inner=(Inner("seated", "N", _seated),),
    depends_on=DependsOn.COMPLIANCE,
)
