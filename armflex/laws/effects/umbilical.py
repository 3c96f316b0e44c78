"""An umbilical: a spring from a point of a link to a fixed point, pulling once it is longer than at rest."""

import numpy as np

from armflex.conventions import Array
from armflex.laws.effects.context import Context
from armflex.laws.effects.effect import Amplitude, Effect, Inner, LoadLaw, Manipulator, Plausible, Search, Values, Words
from armflex.laws.effects.location import Here, Location
from armflex.laws.effects.shapes import coordinates, end_of, force_at

FAR = 2.0
"""Times the diagonal of where an arm was, beyond which no hose is anchored: what pulls from there is a force."""


def _pull(here: Here, pose: Array, inner: Values | Array) -> Array:
    """Return k (|d| - rest) along d, the way from the hook on the link to the anchor; slack pushes nothing."""
    inner = np.asarray(inner)
    lever = np.einsum("...ij,...j", pose[..., :3, :3], hook_of(here, inner))  # twice as quick as many small products
    way = inner[..., :3] - pose[..., :3, 3] - lever
    distance = np.sqrt(np.einsum("...i,...i", way, way))[..., None]
    stretched = np.maximum(distance - inner[..., 3:4], 0.0) / np.maximum(distance, 1e-9)
    return force_at(stretched * way, lever)


def hook_of(here: Here, inner: Values | Array) -> Array:
    """Return the (..., 3) point that it is hooked on at, in the link's frame."""
    inner = np.asarray(inner)
    return inner[..., 4:5] * end_of(here) + inner[..., 5:]


def _is_anchored(effect: Effect, context: Context, arm: Manipulator) -> bool:
    beyond = np.clip(effect.inner[:3], *context.box) - effect.inner[:3]
    return float(np.linalg.norm(beyond)) <= FAR * context.size


HOOK = Inner("hook", "1", lambda location, context: (1.0,), polished=False, usual=1.0, tried=(0.5, 0.0), default=1.0)
"""Where on the link it is hooked, as a part of the way to the link's end."""

ASIDE = tuple(
    Inner(f"aside_{a}", "m", lambda location, context: (0.0,), positive=False, polished=False, spread=0.2, default=0.0)
    for a in "xyz"
)
"""How far beside that point, in the link's frame: hoses are clamped to the outside of a link."""

REST = Inner("rest", "m", lambda location, context: (0.0, 0.25 * context.size), default=0.0)

UMBILICAL = LoadLaw(
    name="umbilical",
    words=Words("umbilical pull", "a spring pulls the link towards a fixed point", "k · (distance − rest)"),
    instead="measure again with the umbilical taken off",
    plausible=Plausible(0.35, 0.35, "what pulls as strongly as the arm weighs is known"),
    places=lambda records: [Location(link) for link in records.bodies],
    amplitudes=(Amplitude("k", "N/m", positive=True),),
    pull=_pull,
    inner=(*coordinates("anchor", 3), REST, HOOK, *ASIDE),
    possible=_is_anchored,
    search=Search.SPACE,
)
