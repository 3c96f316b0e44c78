"""`view`: one self-contained page of an arm, at one configuration or along a trajectory."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from armflex.arm import Arm
from armflex.errors import InputError
from armflex.laws.effects.remember import settled
from armflex.mechanics.deflection import Deflection
from armflex.mechanics.loads import Payload
from armflex.show.view.arm_scene import MAX_FRAMES, Motion, arm_scene
from armflex.storage.whole_file import write_whole
from armflex.tasks.check import CheckReport
from armflex.trajectory import Trajectory

LARGEST_MAGNIFICATION = 1e6


def view(
    arm: Arm,
    q: ArrayLike | None = None,
    payload: str | Payload | None = None,
    *,
    trajectory: Trajectory | None = None,
    report: CheckReport | None = None,
    magnification: float | None = None,
    meshes: bool = False,
    covariates: Mapping[str, float] | None = None,
    path: str | Path,
) -> Path:
    """Write a page of the arm that opens in any browser, without a network, a server or a display.

    Args:
        arm: The arm.
        q: (nq,) joint positions; zero, or the nearest limit, when neither q nor a trajectory is given.
        payload: What it carries at q.
        trajectory: Shown as an animation instead of one configuration.
        report: Result of `check` on the trajectory; colours the via-points.
        magnification: Factor on the deflections shown; a round one is chosen, and stated, when not given.
        meshes: Draw the URDF's meshes where they lie beside it.
        covariates: What the arm's effects depend on, at q or the same in every row of the trajectory.
        path: The HTML file to write.

    Raises:
        InputError: Both q and a trajectory are given, one cannot be used, or no effect depends on a covariate.
    """
    from armflex.show.view.meshcat_page import render_page  # meshcat is imported only when something is drawn

    if q is not None and trajectory is not None:
        raise InputError("view takes q or a trajectory, not both")
    if magnification is not None and not 0.0 < magnification <= LARGEST_MAGNIFICATION:
        raise InputError(f"magnification must be positive and at most {LARGEST_MAGNIFICATION:g}, got {magnification}")
    known = covariates or {}
    if trajectory is None:
        here = arm.position() if q is None else arm.checked(q, "q")
        motion = Motion(np.zeros(1), (arm.deflection(here, payload, covariates=settled(arm, known)),), 0, 1)
    else:
        trajectory = trajectory.with_constants(arm, known).prepared(arm)
        motion = motion_along(arm, trajectory)
    page = render_page(arm_scene(arm, motion, trajectory, report, magnification, meshes))
    return write_whole(Path(path), page.encode())


def motion_along(arm: Arm, trajectory: Trajectory) -> Motion:
    """Return every row, or every second, third ... of a long trajectory, its via-points and worst row kept."""

    def frame(i: int) -> Deflection:  # asked twice rather than kept: thousands of rows are many megabytes
        return arm.deflection(trajectory.q[i], trajectory.payload[i], **trajectory.asked(i))

    rows = range(len(trajectory))
    worst = int(np.argmax([float(np.linalg.norm(frame(i).displacement[:3])) for i in rows]))
    stride = -(-len(rows) // MAX_FRAMES)
    kept = [i for i in rows if i % stride == 0 or trajectory.via[i] or i in (worst, len(rows) - 1)]
    return Motion(trajectory.time[kept], tuple(frame(i) for i in kept), kept.index(worst), len(rows))
