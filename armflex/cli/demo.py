"""armflex demo: the whole of it on the bundled arm, in the order one would do it."""

from __future__ import annotations

import warnings
from pathlib import Path

import click
import numpy as np

from armflex.arm import Arm
from armflex.bench.training import train
from armflex.bundled import bundled_robot
from armflex.cli.check import print_check
from armflex.cli.compensate import print_compensation
from armflex.cli.deflect import print_deflection
from armflex.cli.options import Command, PathArgument, json_option, progress, same_file, show_flags, write_json
from armflex.cli.tables import console, heading, number, print_table
from armflex.cli.trace import print_trace
from armflex.cli.train import print_training
from armflex.errors import FileError, InputError, Place
from armflex.files.arm_file import load_arm
from armflex.laws.law_file import save_law
from armflex.measured.joint_data import read_joint_data
from armflex.measured.measurements import read_measurements
from armflex.mechanics.deflection import Deflection
from armflex.mechanics.equilibrium import MAX_ROTATION
from armflex.show.report import write_report
from armflex.show.view.view import view
from armflex.storage.whole_file import write_whole
from armflex.tasks.check import check
from armflex.tasks.compensate import Compensation, compensate
from armflex.trace import trace
from armflex.trace.result import Trace, write_traced
from armflex.trajectory import Trajectory, read_trajectory, write_trajectory

TOLERANCE = 0.1
PAYLOAD = "p600"
WRITTEN = ("compensated.csv", "tarm_like.html", "traced.toml", "trace.html")
"""Beside the robot's folder."""

PRESETS = {
    None: "assumed A4 (the arm's own)",
    "paper_A4_um": "Table I read as um/kN",
    "paper_A4_literal": "Table I as printed, mm/kN",
    "paper_A4_composed": "two such bearings (um/kN), condensed",
}


@click.command(cls=Command)
@click.option("-o", "--output", type=PathArgument, default="armflex_demo", show_default=True, help="Folder to write.")
@json_option
def command(output: Path, json_path: Path | None) -> None:
    """Load the TARM-like boom, see it sag, check a path, compensate it, put the paper's joint in, trace a campaign."""
    folder = output / "tarm_like"
    _check_apart(json_path, output)
    _copy_robot(folder)
    arm = load_arm(folder / "arm.toml")
    trajectory = read_trajectory(folder / "trajectory.csv", arm)
    _sag(arm)
    found = _path(arm, trajectory, output)
    _remaining(arm, trajectory, found)
    presets = _paper_joint(folder)
    traced = _close_the_loop(folder, output)
    page = str(output / "tarm_like.html")
    said = {"format": "armflex-demo-1", "page": page, "compensated": found.ok, "tip_moves_m": presets}
    write_json(json_path, said | {"traced": [one.effect.title for one in traced.found]})
    pages = f"{output / 'tarm_like.html'} and {output / 'trace.html'}"
    console().print("", f"Open {pages} in a browser; everything written is in {output}.")


def _check_apart(json_path: Path | None, output: Path) -> None:
    """Raise `InputError` where the result for programs would replace a file that is kept or written on the way."""
    kept = [*(output / name for name in WRITTEN), *(output / "tarm_like").glob("*")]
    kept += [output / "tarm_like" / file.name for file in bundled_robot("tarm_like").iterdir()]
    if json_path is not None and any(same_file(json_path, file) for file in kept):
        raise InputError(f"{json_path} is a file of the demonstration; name another one with --json")


def _copy_robot(folder: Path) -> None:
    """Copy the robot's files, leaving those that are there: an edited arm.toml is what the next run is about."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for file in bundled_robot("tarm_like").iterdir():
            if not (folder / file.name).exists():
                write_whole(folder / file.name, file.read_bytes())
    except OSError as error:
        raise FileError(Place(folder), f"cannot be written: {error.strerror or error}") from None


def _sag(arm: Arm) -> None:
    heading(f"1. Straight out, carrying {PAYLOAD}: armflex deflect robots/tarm_like/arm.toml --payload {PAYLOAD}")
    found = _straight(arm)
    print_deflection(arm, found, found.covariance)
    show_flags(found.flags)


def _straight(arm: Arm, allow_large: bool = False) -> Deflection:
    return arm.deflection(np.zeros(len(arm.joint_names)), PAYLOAD, allow_large=allow_large)


def _path(arm: Arm, trajectory: Trajectory, output: Path) -> Compensation:
    heading(f"2. Through the port and around the corner: armflex check ... --tolerance {TOLERANCE * 1e3:g}mm")
    with progress("checking") as tick:
        report = check(arm, trajectory, TOLERANCE, progress=tick)
    print_check(report)
    heading("3. Cancel the sag: armflex compensate ...")
    with progress("compensating") as tick:
        found = compensate(arm, trajectory, progress=tick)
    print_compensation(found)
    show_flags(found.flags)
    write_trajectory(found.trajectory, output / "compensated.csv")
    view(arm, trajectory=trajectory, report=report, path=output / "tarm_like.html")
    return found


def _remaining(arm: Arm, trajectory: Trajectory, found: Compensation) -> None:
    """Ask the compensated path again with the other solver."""
    worst = 0.0
    for q, commanded, payload in zip(found.trajectory.q, trajectory.q, trajectory.payload, strict=True):
        pose = arm.deflection(q, payload, method="fixed_point").pose
        worst = max(worst, float(np.linalg.norm(pose.translation - arm.rigid_pose(commanded).translation)))
    console().print(f"Asked again by fixed-point iteration instead of Newton: {worst:.1e} m remain at most.", "")


def _close_the_loop(folder: Path, output: Path) -> Trace:
    """Find what a measured boom has that its declaration does not mention; return the account."""
    heading("5. Measured, and not where it should be: armflex trace robots/tarm_like/measured.toml campaign.csv ...")
    arm = load_arm(folder / "measured.toml")
    with progress("tracing") as tick:
        found = trace(arm, read_measurements(folder / "campaign.csv", arm), report=lambda text: tick(0, 1))
    print_trace(found)
    write_traced(folder / "measured.toml", found, output / "traced.toml")
    write_report(found, output / "trace.html")
    return found


def _paper_joint(folder: Path) -> dict[str, float]:
    """Train the paper's joint, put it in, and return how far the tip moves with each A4 [m]."""
    heading("4. A4 as in Table I of the source paper, in two readings of its unit")
    for unit in ("mm", "um"):
        result = train(read_joint_data(folder / "a4_table_1.csv", {"mm": unit}), "linear")
        if unit == "mm":
            print_training(result)
        save_law(result.trained, folder / f"paper_A4_{unit}.safetensors")
    found = [_with_preset(folder, preset) for preset in PRESETS]
    rows = [_preset_row(one, text) for one, text in zip(found, PRESETS.values(), strict=True)]
    columns = ["A4", "A4 gives mm", "A4 turns mrad", "tip moves mm", "verdict"]
    print_table(f"What each does to the tip, straight out with {PAYLOAD}", columns, rows)
    for text in dict.fromkeys(flag.text for one in found for flag in one.flags if flag.code == "extrapolating"):
        console().print(text)
    console().print(
        "As printed, A4 alone gives way by most of a metre: at 1 kN a steel member of its size would be strained far "
        "past yield.",
        "Read as um/kN it is an ordinary steel hinge. The arm's own A4 does not come from the table.",
    )
    shifts = (float(np.linalg.norm(one.displacement[:3])) for one in found)
    return dict(zip((preset or "assumed" for preset in PRESETS), shifts, strict=True))


def _with_preset(folder: Path, preset: str | None) -> Deflection:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the doubts are what this table is about
        arm = load_arm(folder / "arm.toml", preset=preset)
    return _straight(arm, allow_large=True)


def _preset_row(found: Deflection, text: str) -> list[str]:
    own = [i for i, name in enumerate(found.names.flexures) if name.startswith("A4")]
    gives, turns = (np.linalg.norm(found.twists[own][:, part], axis=1).max() for part in (slice(0, 3), slice(3, 6)))
    moves = np.linalg.norm(found.displacement[:3])
    verdict = "a machine"
    if any(flag.code == "large_sag" for flag in found.flags):
        verdict = "no machine: sag over 10 % of reach"
    if turns > MAX_ROTATION:
        verdict = "no machine: turns too far"
    return [text, number(gives * 1e3), number(turns * 1e3), number(moves * 1e3), verdict]
