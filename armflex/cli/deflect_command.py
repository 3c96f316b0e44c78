"""armflex deflect: one configuration, everything about it."""

from typing import Any

import click
import numpy as np

from armflex.arm import Arm
from armflex.cli import options
from armflex.cli.terminal import number, print_table, say
from armflex.conventions import Array
from armflex.estimate.tip_uncertainty import flagged_covariance
from armflex.laws.effects.in_arm import SumOfLaws
from armflex.mechanics.certificate import NEAR
from armflex.mechanics.deflection import Deflection
from armflex.mechanics.equilibrium import METHODS
from armflex.result import record

KEYS = (
    "method q joint_loads wrenches twists contributions corrected remainder displacement compliance load_factor "
    "passive loop_loads cylinder_states spring_states"
)
"""What of a result programs get under its own name."""


@click.command(cls=options.Command)
@options.configuration
@click.option("--method", type=options.Choice(METHODS), default="exact", show_default=True)
@click.option("--strict", is_flag=True, help="Refuse loads beyond those that a law was trained on.")
@click.option("--allow-large", is_flag=True, help="Go on where a flexure turns by more than 0.1 rad.")
def command(arm: Arm, q: Array, payload: str, **how: Any) -> None:
    """Loads at every joint, local deflections, and the end-effector's displacement.

    A temperature on which an effect of the arm depends with a lag counts as settled.
    """
    deflection = arm.deflection(q, payload, **how)
    covariance, flags = flagged_covariance(deflection)
    named = {"joint_names": "names.joints", "flexure_names": "names.flexures"}
    named |= {"pose": "pose.homogeneous", "rigid_pose": "rigid_pose.homogeneous"}

    def content() -> dict[str, Any]:
        return {"payload": payload, "covariance": covariance, **record(deflection, KEYS, **named)}

    options.conclude(content, (*deflection.flags, *deflection.overload, *flags), arm)
    print_deflection(arm, deflection, covariance)


def print_deflection(arm: Arm, deflection: Deflection, covariance: Array | None) -> None:
    """Print the loads, the local deflections and the tip's displacement with its (6, 6) covariance."""
    names = deflection.names
    say(f"base {names.base}, tip {names.tip}, payload {deflection.payload.mass:g} kg", "")
    joints = zip(arm.robot.moving, deflection.q, deflection.joint_loads, deflection.drive_shares, strict=True)
    print_table(
        "Load at every joint, on the structure, in its child frame",
        ["joint", "q", "fx kN", "fy kN", "fz kN", "mx kNm", "my kNm", "mz kNm", "drive / limit"],
        [
            [joint.name, number(q), *(number(x / 1e3) for x in load), "-" if np.isinf(joint.effort) else f"{share:.0%}"]
            for joint, q, load, share in joints
        ],
    )
    print_ties(arm, deflection)
    if not names.flexures:
        say("No flexure is declared: the arm is rigid and its tip does not move.")
        return
    shift, left = (float(np.linalg.norm(motion[:3])) for motion in (deflection.displacement, deflection.remainder))
    along, rows = deflection.displacement[:3] / (shift or 1.0), list[list[str]]()
    for name, twist, columns in places_of_deflection(arm, deflection):
        share = float(along @ (columns @ twist)[:3])
        rows.append([name, *(number(x * 1e3) for x in twist), number(share * 1e3)])
    if deflection.corrected.any():
        rows.append(["calibrated geometry", *["-"] * 6, number(float(deflection.corrected[:3] @ along) * 1e3)])
    print_table(
        "Local deflection of every flexure, and its share of the tip's displacement",
        ["flexure", "dx mm", "dy mm", "dz mm", "rx mrad", "ry mrad", "rz mrad", "share mm"],
        rows,
    )
    sigmas = ["none"] * 6 if covariance is None else [number(x * 1e3, 2) for x in np.sqrt(np.diag(covariance))]
    components = zip(("x", "y", "z", "rx", "ry", "rz"), deflection.displacement, sigmas, strict=True)
    print_table(
        "Tip: flexed minus rigid, base axes",
        ["", "displacement", "std. uncertainty", "unit"],
        [[name, number(x * 1e3, 6), sigma, "mrad" if "r" in name else "mm"] for name, x, sigma in components],
    )
    say(
        f"The tip moves {number(shift * 1e3)} mm; the shares are first order and miss {number(left * 1e3, 2)} mm of it."
    )
    total, relative = _size(covariance), _size(flagged_covariance(deflection, relative=True)[0])
    if arm.certainty is not None and 2.0 * relative < total:
        say(
            f"Of ± {number(total * 1e3, 2)} mm in all, {number(relative * 1e3, 2)} mm are of how the arm moves the "
            "campaign's target before its instrument. The rest is where base, zero of the first joint and target stand,"
            " the same for all poses, which the campaign does not determine."
        )
    if deflection.load_factor < NEAR:
        say(f"It would buckle under {number(deflection.load_factor)} times these loads.", "")


def places_of_deflection(arm: Arm, deflection: Deflection) -> list[tuple[str, Array, Array]]:
    """Return (name, (6,) local twist [m, rad], (6, 6) motion of the tip per twist): flexures, effects apart."""
    row = arm.loaded(deflection.payload).row(deflection.q, deflection.case.covariates)
    parts = list[tuple[str, Array, Array]]()
    columns = np.split(deflection.flexure_jacobian, len(deflection.twists), axis=1)
    loads = zip(deflection.names.flexures, arm.stack.laws, deflection.wrenches, deflection.twists, columns, strict=True)
    for name, law, wrench, twist, moved in loads:
        site, added = law.by_effects(wrench, row) if isinstance(law, SumOfLaws) else ("", np.zeros(6))
        parts.append((name, twist - added, moved))
        parts += [(f"effects at {site}", added, moved)] if site else []
    return parts


def _size(covariance: Array | None) -> float:
    """Return the standard uncertainty of the tip's place [m] of a (6, 6) covariance, 0 where there is none."""
    return 0.0 if covariance is None else float(np.sqrt(max(np.trace(covariance[:3, :3]), 0.0)))


def print_ties(arm: Arm, deflection: Deflection) -> None:
    """Print what is not of the chain: joints without a drive, pins of loops, cylinders and springs."""
    if deflection.passive:
        rows = [[name, number(position)] for name, position in deflection.passive.items()]
        print_table("Joints without a drive", ["joint", "rad or m"], rows)
    if deflection.loop_loads:
        loads = [[name, *(number(x / 1e3) for x in load)] for name, load in deflection.loop_loads.items()]
        title = "Load at the pin of every loop, on its `link`, in that link's axes"
        print_table(title, ["loop", "fx kN", "fy kN", "fz kN", "mx kNm", "my kNm", "mz kNm"], loads)
    states = {spring.name: state for spring, state in zip(arm.springs, deflection.spring_states, strict=True)}
    states = deflection.cylinder_states | states
    if states:
        rows = [[name, number(length), number(tension / 1e3)] for name, (length, tension) in states.items()]
        print_table("Cylinders and springs", ["name", "length m", "tension kN"], rows)
