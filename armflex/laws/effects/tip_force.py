"""A constant force from outside on the tool, in base axes."""

import numpy as np

from armflex.laws.effects.context import AXES, Records
from armflex.laws.effects.effect import Amplitude, LoadLaw, Plausible, Words
from armflex.laws.effects.location import TOOL, Location
from armflex.laws.effects.shapes import singly_and_together


def _places(records: Records) -> list[Location]:
    """Return the axes alone and together, without one along gravity alone: a force that is always down is a mass."""
    down = records.robot.gravity / max(float(np.linalg.norm(records.robot.gravity)), 1e-9)
    places = singly_and_together((TOOL,), (0, 1, 2), axes=AXES[:3])
    # Cosine to gravity from which an axis is along it: two degrees, less than anybody knows of a pull.
    return [location for location in places if location.axis is None or abs(down[AXES.index(location.axis)]) < 0.999]


TIP_FORCE = LoadLaw(
    name="tip_force",
    words=Words("tip force", "something pulls at the tip", "constant force"),
    instead="measure again with whatever pulls on the tool taken off",
    plausible=Plausible(0.35, 0.35, "what pulls as strongly as the arm weighs is known"),
    places=_places,
    amplitudes=tuple(Amplitude(f"f{axis}", "N") for axis in "xyz"),
    pull=lambda here, pose, inner: np.broadcast_to(np.eye(3, 6), (*pose.shape[:-2], 3, 6)),
)
