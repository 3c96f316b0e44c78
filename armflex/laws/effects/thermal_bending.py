"""A link that bends as it warms: beta (T - Tref), a rotation of its end about a point of it.

An even bend turns its end about its middle. No reading distinguishes a bend at the root from one at the end of the link
before, if the joint between them turns about the same axis.
"""

import numpy as np

from armflex.conventions import Array
from armflex.laws.effects.context import AXES_TURN, Context
from armflex.laws.effects.effect import Afterwards, Amplitude, Inner, Plausible, TwistLaw, Values, Words
from armflex.laws.effects.location import LINK, Here, Location, joint_named, path_to
from armflex.laws.effects.shapes import LAGGED, ON_THE_LINK, WARM, shows_lag, twists, warm


def _direction(here: Here, inner: Values) -> Array:
    (x, y, z), (u, v, w) = here.direction[3:].tolist(), ((1.0 - inner[0]) * here.length).tolist()
    return np.array([y * w - z * v, z * u - x * w, x * v - y * u, x, y, z])  # numpy takes its time to cross two vectors


def _along(location: Location, context: Context) -> Values:
    """Return where on the link a bend may be; at its root only where no other link's end has the same columns."""
    robot, joint = context.records.robot, joint_named(location.site.removeprefix(LINK), context.records.robot)
    if joint is None:  # the tool's link
        return 1.0, 0.5
    turned = np.eye(3)[AXES_TURN.index(location.axis or AXES_TURN[0])]
    for inboard in reversed(path_to(joint, robot)):
        if inboard is not joint and inboard in robot.jointed:
            # Cosine above which two axes are one
            same = inboard.kind != "prismatic" and abs(turned @ inboard.axis) > 1.0 - 1e-9
            return (1.0, 0.5) if same else (1.0, 0.5, 0.0)
        turned = inboard.rotation @ turned
    return 1.0, 0.5


THERMAL_BENDING = TwistLaw(
    name="thermal_bending",
    words=Words("thermal bending", "the link bends as it warms", "β (T − T₀)"),
    instead=f"{ON_THE_LINK} at two temperatures",
    plausible=Plausible(0.003, 0.005, "one side warmer by 10 K bends a metre of steel by 1 mrad"),
    places=lambda records: [
        Location(link, axis, (name,)) for name in records.temperatures for link in records.links for axis in AXES_TURN
    ],
    amplitudes=(Amplitude("beta", "rad/K"),),
    terms=lambda here, inner: twists(_direction(here, inner), warm(here, *inner[1:])),
    direction=_direction,
    inner=(Inner("along", "1", _along, polished=False, default=1.0), *WARM),
    memory=LAGGED,
    afterwards=Afterwards.ANEW,
    possible=shows_lag,
)
