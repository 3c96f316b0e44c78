"""A constant force from outside on the tool, in base axes."""

import numpy as np

from armflex.laws.effects.context import AXES
from armflex.laws.effects.effect import Amplitude, LoadLaw, Plausible, Words
from armflex.laws.effects.location import TOOL
from armflex.laws.effects.shapes import singly_and_together

TIP_FORCE = LoadLaw(
    name="tip_force",
    words=Words("tip force", "something pulls at the tip", "constant force"),
    instead="measure again with whatever pulls on the tool taken off",
    plausible=Plausible(0.35, 0.35, "what pulls as strongly as the arm weighs is known"),
    places=lambda records: singly_and_together((TOOL,), (0, 1, 2), axes=AXES[:3]),
    amplitudes=tuple(Amplitude(f"f{axis}", "N") for axis in "xyz"),
    pull=lambda here, pose, inner: np.broadcast_to(np.eye(3, 6), (*pose.shape[:-2], 3, 6)),
)
