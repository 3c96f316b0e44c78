"""armflex deflect: one configuration, everything about it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np

from armflex.arm import Arm
from armflex.cli.options import (
    Choice,
    Command,
    arm_argument,
    covariates_option,
    json_option,
    parse_force,
    parse_positions,
    show_flags,
    write_json,
)
from armflex.cli.tables import console, number, print_table
from armflex.errors import Flag
from armflex.estimate.tip_uncertainty import total_covariance
from armflex.laws.effects.remember import settled
from armflex.mechanics.deflection import Deflection
from armflex.mechanics.equilibrium import METHODS
from armflex.mechanics.loads import Wrench
from armflex.tasks.check import overload
from armflex.trajectory import check_approaches


@click.command(cls=Command)
@arm_argument
@click.option(
    "--q",
    "positions",
    default="",
    metavar="A1=0.3,A4=-10deg",
    help="Joint positions; others are 0, or in the middle of limits that 0 is outside of.",
)
@click.option("--payload", default="none", show_default=True, help="Name of a payload in ARM.")
@click.option("--force", "forces", multiple=True, metavar="LINK=FX,FY,FZ", help="Dead load in base axes, with unit.")
@click.option("--method", type=Choice(METHODS), default="exact", show_default=True)
@click.option("--strict", is_flag=True, help="Refuse loads beyond those that a trained law has seen.")
@click.option("--allow-large", is_flag=True, help="Go on where a flexure turns by more than 0.1 rad.")
@covariates_option
@json_option
def command(
    arm: Arm,
    positions: str,
    payload: str,
    forces: tuple[str, ...],
    method: str,
    allow_large: bool,
    strict: bool,
    covariates: dict[str, float],
    json_path: Path | None,
) -> None:
    """Loads at every joint, local deflections, and the end-effector's displacement.

    A temperature that an effect of the arm lags behind is taken as settled.
    """
    check_approaches(covariates, arm.joint_names)
    wrenches = [Wrench(link, force, np.zeros(3)) for link, force in map(parse_force, forces)]
    q = parse_positions(positions, arm)
    known = settled(arm, covariates)
    found = arm.deflection(
        q, payload, covariates=known, wrenches=wrenches, method=method, allow_large=allow_large, strict=strict
    )
    covariance, doubts = total_covariance(found)
    print_deflection(arm, found, covariance)
    flags = (*found.flags, *overload(arm, found), *doubts)
    show_flags(flags)
    write_json(json_path, {"format": "armflex-deflect-1", "payload": payload, **as_json(found, covariance, flags)})


def print_deflection(arm: Arm, found: Deflection, covariance: np.ndarray | None) -> None:
    """Print the loads, the local deflections and the tip's displacement with its (6, 6) covariance."""
    names = found.names
    console().print(f"base {names.base}, tip {names.tip}, payload {found.payload.mass:g} kg, {found.method}", "")
    print_table(
        "Load at every joint, on the structure, in its child frame",
        ["joint", "q", "fx kN", "fy kN", "fz kN", "mx kNm", "my kNm", "mz kNm", "drive / limit"],
        [
            [joint.name, number(q), *(number(x / 1e3) for x in load), "-" if np.isinf(joint.effort) else f"{share:.0%}"]
            for joint, q, load, share in zip(
                arm.robot.moving, found.q, found.joint_loads, arm.drive_shares(found), strict=True
            )
        ],
    )
    if not names.flexures:
        console().print("No flexure is declared: the arm is rigid and its tip does not move.")
        return
    _print_flexures(found)
    _print_tip(found, covariance)


def _print_flexures(found: Deflection) -> None:
    rows = [
        [name, *(number(x * 1e3) for x in twist), number(share * 1e3)]
        for name, twist, share in zip(found.names.flexures, found.twists, found.shares(), strict=True)
    ]
    if found.corrected.any():
        along = found.displacement[:3] / (np.linalg.norm(found.displacement[:3]) or 1.0)
        rows.append(["calibrated geometry", *["-"] * 6, number(float(found.corrected[:3] @ along) * 1e3)])
    print_table(
        "Local deflection of every flexure, and its share of the tip's displacement",
        ["flexure", "dx mm", "dy mm", "dz mm", "rx mrad", "ry mrad", "rz mrad", "share mm"],
        rows,
    )


def _print_tip(found: Deflection, covariance: np.ndarray | None) -> None:
    deviations = None if covariance is None else np.sqrt(np.diag(covariance))
    rows = []
    for index, (name, unit) in enumerate([(n, "mm") for n in "xyz"] + [(f"r{n}", "mrad") for n in "xyz"]):
        sigma = "none" if deviations is None else number(deviations[index] * 1e3, 2)
        rows.append([name, number(found.displacement[index] * 1e3, 6), sigma, unit])
    print_table("Tip: flexed minus rigid, base axes", ["", "displacement", "std. uncertainty", "unit"], rows)
    shift, left = np.linalg.norm(found.displacement[:3]), np.linalg.norm(found.remainder[:3])
    console().print(
        f"The tip moves {number(shift * 1e3)} mm; the shares are first order and miss {number(left * 1e3, 2)} mm of it."
    )


def as_json(found: Deflection, covariance: np.ndarray | None, flags: Sequence[Flag]) -> dict[str, Any]:
    """Return a deflection for programs, SI."""
    names = found.names
    return {
        "base": names.base,
        "tip": names.tip,
        "method": found.method,
        "joint_names": list(names.joints),
        "flexure_names": list(names.flexures),
        "q": found.q.tolist(),
        "joint_loads": found.joint_loads.tolist(),
        "wrenches": found.wrenches.tolist(),
        "twists": found.twists.tolist(),
        "contributions": found.contributions.tolist(),
        "corrected": found.corrected.tolist(),
        "remainder": found.remainder.tolist(),
        "displacement": found.displacement.tolist(),
        "covariance": None if covariance is None else covariance.tolist(),
        "compliance": found.compliance.tolist(),
        "pose": found.pose.homogeneous.tolist(),
        "rigid_pose": found.rigid_pose.homogeneous.tolist(),
        "flags": [str(flag) for flag in flags],
    }
