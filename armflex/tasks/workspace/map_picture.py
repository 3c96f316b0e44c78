"""A map as a picture: from the side and from above, with the arm where its tip moves most."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from armflex.arguments import checked_kinds
from armflex.arm import Arm
from armflex.conventions import Array
from armflex.plotting import picture
from armflex.tasks.workspace.workspace_map import WorkspaceMap

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Normalize
    from matplotlib.image import AxesImage

VIEWS: dict[str, tuple[str, str, Callable[[Array], Array]]] = {
    "all around": (
        "distance from the base's z axis [m]",
        "z [m]",
        lambda p: np.stack([np.hypot(*p[:, :2].T), p[:, 2]]),
    ),
    "from above": ("x [m]", "y [m]", lambda p: p[:, :2].T),
}
"""Title -> names of the axes, and (2, N) where (N, 3) points are seen. Most arms turn about an upright axis: seen from
one side, the rim of the workspace would hide all that is within."""


@checked_kinds
def draw_map(arm: Arm, workspace: WorkspaceMap, path: str | Path, tolerance: float | None = None) -> Path:
    """Write a picture of the largest displacement in the voxels that are seen at one place.

    Args:
        arm: The arm of the map, drawn where its tip moves most.
        workspace: The map.
        path: Ends in .png, .pdf or .svg.
        tolerance: Where the colours change from blue to red [m].

    Raises:
        InputError: The path ends otherwise, or the tolerance is no positive length.
        FileError: It cannot be written.
    """
    path = Path(path)
    with picture(path, 13.0, 6.0) as figure:
        colours, norm = _colours(workspace, tolerance)
        places = figure.subplots(1, len(VIEWS) + (workspace.frequency is not None))
        # A rigid arm needs no covariates.
        pose = Arm(arm.robot).deflection(workspace.worst_q[workspace.worst_voxel]).link_poses()
        skeleton = np.array([np.zeros(3), *(pose[joint.child][:3, 3] for joint in arm.robot.chain)])
        first, images = next(iter(VIEWS)), []
        drawn: list[tuple[str, Array, str, Normalize | None]] = [
            (name, workspace.worst * 1e3, colours, norm) for name in VIEWS
        ]
        if workspace.frequency is not None:  # the lowest is drawn, as the largest displacement is
            drawn.append((first, -workspace.frequency, "viridis_r", None))
        for axes, (title, values, scale, limits) in zip(places, drawn, strict=True):
            right, up, view = VIEWS[title]
            images.append(_draw(axes, workspace, view, values, scale, limits))
            axes.plot(*view(skeleton), color="0.1", lw=1.5, marker="o", ms=3)
            axes.set(title=title, xlabel=right, ylabel=up, aspect="equal")
        bar = figure.colorbar(images[0], ax=places[: len(VIEWS)], label=f"largest displacement of {workspace.tip} [mm]")
        if workspace.frequency is not None:
            label, inverse = "lowest first natural frequency [Hz]", lambda value, _: f"{-value:g}"
            figure.colorbar(images[-1], ax=places[-1], label=label, format=inverse)
        if tolerance is not None:
            bar.ax.axhline(tolerance * 1e3, color="0.1", lw=2)
        carried = ", ".join(workspace.payloads)
        title = f"{workspace.rows:,} configurations, payload {carried}, voxels of {workspace.voxel:g} m"
        title += f", base {workspace.base}"
        title += f", {workspace.draws} draws" if workspace.draws else ""
        figure.suptitle(title if tolerance is None else f"{title}, tolerance {tolerance * 1e3:g} mm")
    return path


def _colours(workspace: WorkspaceMap, tolerance: float | None) -> tuple[str, Normalize]:
    """Return the name of a scale of colours, and where it begins and ends [mm]."""
    from matplotlib.colors import Normalize, TwoSlopeNorm

    most = float(np.nanmax(workspace.worst, initial=1e-6)) * 1e3
    if tolerance is None:
        return "viridis", Normalize(0.0, most)
    workspace.margin(tolerance)  # is it one?
    limit = tolerance * 1e3
    return "RdYlBu_r", TwoSlopeNorm(limit, 0.0, max(most, 1.001 * limit))


def _draw(
    axes: Axes,
    workspace: WorkspaceMap,
    seen: Callable[[Array], Array],
    values: Array,
    colours: str,
    norm: Normalize | None,
) -> AxesImage:
    """Draw the largest of (V,) values at every place; a cross stands where a configuration was refused."""
    place = np.floor(seen(workspace.centres) / workspace.voxel).astype(int)
    low, high = place.min(axis=1), place.max(axis=1) + 1
    most = np.full(tuple((high - low)[::-1]), -np.inf)
    np.maximum.at(most, tuple((place - low[:, None])[::-1]), np.nan_to_num(values, nan=-np.inf))
    (left, bottom), (right, top) = (low * workspace.voxel).tolist(), (high * workspace.voxel).tolist()
    extent = (left, right, bottom, top)
    image = axes.imshow(np.ma.masked_invalid(most), extent=extent, origin="lower", cmap=colours, norm=norm)
    axes.plot(*seen(workspace.centres[workspace.refused.any(axis=1)]), "x", color="0.3", ms=3)
    return image
