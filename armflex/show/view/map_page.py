"""A map as a page in which it can be turned: the voxels by colour, and the arm where its tip moves most."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise, product
from pathlib import Path

import numpy as np
import pinocchio as pin

from armflex.arguments import checked_kinds
from armflex.arm import Arm
from armflex.conventions import number
from armflex.errors import InputError
from armflex.laws.effects.in_arm import settled_covariates
from armflex.rows.wrench import Wrench
from armflex.show.view.arm_scene import SCALE, VERDICTS, Motion, arm_scene
from armflex.show.view.scene_3d import LegendRow, Node, Shape, frame_camera
from armflex.storage.whole_file import write_whole
from armflex.tasks.workspace.workspace_map import WorkspaceMap

CORNERS = np.array(list(product((-0.5, 0.5), repeat=3)))
SIDES = ((1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4))
"""Corners of a cube's six sides, counted from 1, seen from outside against the clock."""


@checked_kinds
def map_page(
    arm: Arm,
    workspace: WorkspaceMap,
    path: str | Path,
    tolerance: float | None = None,
    covariates: Mapping[str, float] | None = None,
    wrenches: Sequence[Wrench] = (),
) -> Path:
    """Write one HTML page, like `armflex.view`, with a cube in every voxel.

    Args:
        arm: The arm of the map.
        workspace: The map.
        path: The file to write.
        tolerance: Colours the cubes by their verdict [m]; by their largest displacement when not given.
        covariates, wrenches: What the map was made with.

    Raises:
        InputError: The tolerance is no positive length, or every configuration was refused.
        FileError: The file cannot be written.
    """
    from armflex.show.view.meshcat_page import render_page  # meshcat takes a quarter of a second

    if not workspace.answered.any():
        raise InputError("every configuration was refused: there is no displacement to show")
    here = workspace.worst_voxel
    payload, settled = workspace.payloads[workspace.worst_payload[here]], settled_covariates(arm, covariates or {})
    shown = arm.deflection(workspace.worst_q[here], payload, covariates=settled, wrenches=wrenches)
    mount = pin.SE3(arm.robot.mount, np.zeros(3))
    centres = workspace.centres @ mount.rotation.T
    scene = arm_scene(arm, Motion(np.zeros(1), (shown,), 0), magnification=1.0)
    corners = (workspace.centres[:, None] + workspace.voxel * CORNERS).reshape(-1, 3) @ mount.rotation.T
    camera = frame_camera(corners)
    towards = (camera.position - camera.target)[:2]
    behind = (centres[:, :2] - camera.target[:2]) @ towards <= 0.0
    groups = _groups(workspace, tolerance)
    nodes = [
        Node(f"voxels/{text}", mount.homogeneous[None], (_cubes(workspace, mask & behind, color),))
        for color, text, mask in groups
        if (mask & behind).any()
    ]
    scene = replace(
        scene,
        subtitle=f"{workspace.rows:,} configurations, payload {', '.join(workspace.payloads)}, "
        f"voxels of {workspace.voxel:g} m",
        nodes=(*scene.nodes, *nodes),
        legend_title="Largest displacement of the tip, voxels",
        legend=tuple(LegendRow(color, text, str(mask.sum())) for color, text, mask in groups),
        notes=(
            f"Base {workspace.base}, tip {workspace.tip}. The arm stands where its tip moves most.",
            "Half of the voxels are not drawn, so that the arm is visible; the legend counts all.",
        ),
        camera=camera,
        floor_z=float(corners[:, 2].min()),
    )
    return write_whole(Path(path), render_page(scene).encode())


def _groups(workspace: WorkspaceMap, tolerance: float | None) -> list[tuple[str, str, np.ndarray]]:
    """Return colour, text and voxels of each verdict; of five equal steps of displacement where none is asked for."""
    if tolerance is not None:
        verdicts = workspace.verdicts(tolerance)
        return [(color, f"{name} at {tolerance * 1e3:g} mm", verdicts == name) for name, color in VERDICTS.items()]
    edges = np.linspace(0.0, np.nanmax(workspace.worst), len(SCALE) + 1)
    answered = workspace.answered > 0
    step = np.where(answered, np.searchsorted(edges[1:-1], workspace.worst), -1)
    texts = [f"{number(low * 1e3, 3)} to {number(high * 1e3, 3)} mm" for low, high in pairwise(edges)]
    groups = [(color, text, step == i) for i, (color, text) in enumerate(zip(SCALE, texts, strict=True))]
    return groups if answered.all() else [*groups, (VERDICTS["fail"], "refused", ~answered)]


def _cubes(workspace: WorkspaceMap, mask: np.ndarray, color: str) -> Shape:
    """Return a cube in each of some voxels, as one mesh in the text of a Wavefront OBJ."""
    # Edge of a cube as a share of its voxel's: one sees through between them.
    corners = (workspace.centres[mask][:, None] + 0.45 * workspace.voxel * CORNERS).reshape(-1, 3)
    sides = (8 * np.arange(mask.sum())[:, None, None] + np.array(SIDES)).reshape(-1, 4)
    lines = [f"v {x:.4f} {y:.4f} {z:.4f}" for x, y, z in corners.tolist()]
    lines += [f"f {a} {b} {c} {d}" for a, b, c, d in sides.tolist()]
    return Shape("mesh", np.ones(3), color=color, data="\n".join(lines).encode(), data_format="obj")
