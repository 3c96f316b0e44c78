"""Modes of vibration, drawn: the arm at rest and at both ends of its swing, seen from the side and from above."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from armflex.conventions import Array
from armflex.mechanics.deflection import Deflection
from armflex.mechanics.modes import Modes
from armflex.plotting import picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST = 4
"""Modes in a picture."""

RED, INK = "#e4572e", "0.15"


def draw_modes(rest: Deflection, modes: Modes, path: str | Path) -> Path:
    """Write a picture of the slowest modes and return its path; see `swing_on`.

    Raises:
        InputError: The path does not end in .png, .pdf or .svg.
        FileError: It cannot be written.
    """
    with picture(path := Path(path), 1.0, 1.0) as figure:
        swing_on(figure, rest, modes)
        robot, mass = rest.arm.robot, rest.payload.mass
        payload = f" with {mass:g} kg" if mass else ""
        figure.suptitle(f"{robot.urdf.name}{payload}: modes with the drives holding, not to scale")
    return path


def swing_on(figure: Figure, rest: Deflection, modes: Modes, swung: str = RED, still: str = INK) -> None:
    """Draw the slowest modes: a column for each, from the side (x, z) above, from above (x, y) below.

    Args:
        figure: Empty; it gets the size that the arm needs.
        rest: Where the arm swings about.
        modes: Its modes there.
        swung, still: Colours of the ends of the swing and of the rest.
    """
    robot, count = rest.arm.robot, min(len(modes.frequencies), MOST)
    size = 0.08 * max(robot.reach, 0.1)  # how far the tip is drawn from its place, as a share of the reach

    def line(further: Array) -> Array:
        """Return the (k, 3) origins of the chain's links from base to tip, level [m]."""
        poses = rest.link_poses(1.0, further)
        return np.array([np.zeros(3), *(poses[joint.child][:3, 3] for joint in robot.chain)]) @ robot.mount.T

    sides = ((-1.0, swung), (1.0, swung), (0.0, still))
    drawn = [[(line(side * size * twists), color) for side, color in sides] for twists in modes.twists[:count]]
    every = np.concatenate([points for lines in drawn for points, _ in lines])
    low, high = every.min(axis=0) - size, every.max(axis=0) + size
    heights = [high[2] - low[2], high[1] - low[1]]
    figure.set_size_inches(3.4 * count + 0.6, 1.6 + 2.6 * sum(heights) / (high[0] - low[0]))
    places = figure.subplots(2, count, squeeze=False, sharex=True, sharey="row", gridspec_kw={"height_ratios": heights})
    for column, lines in enumerate(drawn):
        for axes, up in zip(places[:, column], (2, 1), strict=True):
            for points, color in lines:
                axes.plot(points[:, 0], points[:, up], color=color, lw=1.2, marker="o", ms=2.5)
            axes.set(xlim=(low[0], high[0]), ylim=(low[up], high[up]), aspect="equal")
            axes.grid(alpha=0.3)
        places[1, column].set_xlabel("x [m]")
        stiffest = modes.names.flexures[int(modes.sensitivities[column].argmax())]
        places[0, column].set_title(f"{modes.frequencies[column]:.3g} Hz, stiffen {stiffest}")
    for axes, name in zip(places[:, 0], "zy", strict=True):
        axes.set_ylabel(f"{name} [m]")
