"""Whether measured positions have the axes and the unit of the arm they were taken on, before anything is fitted.

An instrument may stand anywhere, but no place makes a left-handed frame right-handed: points that fit far better when
mirrored have two axes swapped or one reversed. Planar points fit equally well both ways, sag moves both fits alike, and
a lost beam is weighed down in both, so none of them is taken for swapped axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations, product

import numpy as np
import pinocchio as pin

from armflex.conventions import Array, in_mm
from armflex.errors import AxesError, Place, UnitError
from armflex.readings.instrument import rigid_fit

FEWEST_POINTS = 6
"""Below this many points chance alone lets a mirror fit ten times better."""

NARROWEST = 0.01
"""Spread of the nominal points [m] below which noise says more about their size and hand than they do."""

DROP = 10.0
"""Fall of the residual under a change of axes that is no accident."""

ALIGNED = np.cos(np.radians(15.0))
"""How near a frame's axis must be to the vertical to be called vertical."""

THOUSANDFOLD = (200.0, 5000.0)
"""Ratio of sizes that is a mistaken mm or m rather than a wrong arm."""

NEGLIGIBLE = 1e-5
"""Residual [m] below which points fit, whatever fits better."""


def check_axes(
    points: Array, measured: Array, places: Sequence[Place] = (), pose: pin.SE3 | None = None, up: Array | None = None
) -> None:
    """Raise where measured points are those of the nominal ones in swapped axes or in another unit.

    Args:
        points: (N, 3) nominal target points in the base frame [m].
        measured: (N, 3) where they were measured [m].
        places: File and line of each, for the message.
        pose: T_instrument_base where it is known; otherwise the instrument may stand anywhere.
        up: (3,) vertical in the base frame, z when not given; names the axes of an instrument that stands level.

    Raises:
        AxesError: The points fit over `DROP` times better in changed axes; which ones is said.
        UnitError: The measured points are spread a thousand times as wide or narrow as the nominal ones.
    """
    if len(np.unique(np.round(points, 6), axis=0)) < FEWEST_POINTS or _spread(points) < NARROWEST:
        return
    where = f"{places[0]}: " if places else ""
    ratio = _spread(measured) / max(_spread(points), 1e-12)
    low, high = THOUSANDFOLD
    if low < ratio < high or low < 1.0 / max(ratio, 1e-12) < high:
        text = f"measured positions are spread {ratio:.3g} times as wide as the arm's: mm taken for m, or m for mm?"
        raise UnitError(f"{where}{text} (write the unit into the header: x_mm, y_mm, z_mm)")
    if pose is None:
        straight = rigid_fit(points, measured)[2]
        turn, _, best = rigid_fit(points, measured, -1.0)
        up = np.array([0.0, 0.0, 1.0]) if up is None else up
        found = f"fit {straight / max(best, 1e-12):.0f} times better mirrored ({in_mm(best)} against {in_mm(straight)})"
        swapped = _swapped(turn @ up / np.linalg.norm(up))
        text = f"{found}: {swapped}? Or gravity, or a joint's positions, have the wrong sign"
    else:
        # Readings in a known frame are compared with those in every other order and sign of the axes.
        expected = points @ pose.rotation.T + pose.translation
        tries = [
            (float(np.median(np.linalg.norm(measured[:, list(order)] * signs - expected, axis=1))), order, signs)
            for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3))
        ]
        straight, (best, order, signs) = tries[0][0], min(tries, key=lambda entry: entry[0])
        said = ", ".join(f"{'-' if sign < 0 else ''}{'xyz'[i]}" for i, sign in zip(order, signs, strict=True))
        text = f"are off by {in_mm(straight)}, but by {in_mm(best)} when x, y, z are read as {said}: swapped axes?"
    if straight > NEGLIGIBLE and best * DROP < straight:
        raise AxesError(f"{where}measured positions {text}")


def _spread(points: Array) -> float:
    return float(np.median(np.linalg.norm(points - np.median(points, axis=0), axis=1)))


def _swapped(vertical: Array) -> str:
    """Return which axes a level instrument has likely swapped, from where the vertical stands in its frame."""
    axis = int(np.abs(vertical).argmax())
    if abs(vertical[axis]) < ALIGNED:
        return "two axes swapped, or one reversed (a left-handed frame)"
    if axis == 2:
        return "x and y swapped, or one of them reversed" if vertical[2] > 0.0 else "z reversed"
    return f"{'xy'[axis]} and z swapped (the vertical is along {'xy'[axis]})"
