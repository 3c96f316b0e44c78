"""Modes of vibration, drawn: the arm at rest and at both ends of its swing, seen from the side and from above."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from armflex.conventions import Array
from armflex.mechanics.deflection import Deflection
from armflex.mechanics.modes import Modes
from armflex.plotting import check_ending, picture

MOST = 4
"""Modes in a picture."""

SWUNG = 0.08
"""How far the tip is drawn from its place, as a share of the reach."""


def draw_modes(rest: Deflection, modes: Modes, path: str | Path) -> Path:
    """Write a picture of the slowest modes: a column for each, from the side (x, z) above, from above (x, y) below.

    Args:
        rest: Where the arm swings about.
        modes: Its modes there.
        path: Ends in .png, .pdf or .svg.

    Raises:
        InputError: The path ends otherwise.
        FileError: It cannot be written.
    """
    check_ending(path := Path(path))
    robot, count = rest.arm.robot, min(len(modes.frequencies), MOST)
    size = SWUNG * max(robot.reach, 0.1)

    def line(further: Array) -> Array:
        """Return the (k, 3) origins of the chain's links from base to tip, level [m]."""
        poses = rest.link_poses(1.0, further)
        return np.array([np.zeros(3), *(poses[joint.child][:3, 3] for joint in robot.chain)]) @ robot.mount.T

    sides = ((-1.0, "#e4572e"), (1.0, "#e4572e"), (0.0, "0.15"))
    drawn = [[(line(side * size * twists), color) for side, color in sides] for twists in modes.twists[:count]]
    every = np.concatenate([points for lines in drawn for points, _ in lines])
    low, high = every.min(axis=0) - size, every.max(axis=0) + size
    heights = [high[2] - low[2], high[1] - low[1]]
    with picture(path, 3.4 * count + 0.6, 1.6 + 2.6 * sum(heights) / (high[0] - low[0])) as figure:
        grid = {"height_ratios": heights}
        places = figure.subplots(2, count, squeeze=False, sharex=True, sharey="row", gridspec_kw=grid)
        for column, lines in enumerate(drawn):
            frequency = modes.frequencies[column]
            for axes, up in zip(places[:, column], (2, 1), strict=True):
                for points, color in lines:
                    axes.plot(points[:, 0], points[:, up], color=color, lw=1.2, marker="o", ms=2.5)
                axes.set(xlim=(low[0], high[0]), ylim=(low[up], high[up]), aspect="equal")
                axes.grid(alpha=0.3)
            places[1, column].set_xlabel("x [m]")
            stiffest = modes.names.flexures[int(modes.sensitivities[column].argmax())]
            places[0, column].set_title(f"{frequency:.3g} Hz, stiffen {stiffest}")
        for axes, name in zip(places[:, 0], "zy", strict=True):
            axes.set_ylabel(f"{name} [m]")
        payload = f" with {rest.payload.mass:g} kg" if rest.payload.mass else ""
        figure.suptitle(f"{robot.urdf.name}{payload}: modes with the drives holding, not to scale")
    return path
