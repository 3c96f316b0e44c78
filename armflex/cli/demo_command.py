"""armflex demo: the whole of it on the bundled arm, in the order one would do it."""

import warnings
from pathlib import Path

import click
import numpy as np

from armflex.arm import Arm
from armflex.bench.training import train
from armflex.bundled import bundled_robot
from armflex.cli import options
from armflex.cli.check_command import print_check
from armflex.cli.compensate_command import print_compensation
from armflex.cli.deflect_command import print_deflection
from armflex.cli.terminal import doing, heading, number, print_table, progress, say, show_flags
from armflex.cli.trace_command import print_trace
from armflex.cli.train_command import print_training
from armflex.errors import FileError, InputError, Place
from armflex.files.arm_file import load_arm
from armflex.laws.law_file import save_law
from armflex.measured.joint_data import read_joint_data
from armflex.measured.measurements import read_measurements
from armflex.mechanics.deflection import Deflection
from armflex.mechanics.equilibrium import MAX_ROTATION
from armflex.show.report import write_report
from armflex.show.view.arm_scene import view
from armflex.storage.whole_file import together, write_whole
from armflex.tasks.check import check
from armflex.tasks.compensate import compensate
from armflex.trace import trace
from armflex.trajectory import read_trajectory, write_trajectory

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


@click.command(cls=options.Command)
@click.option("-o", "--output", type=options.InputPath, default="armflex_demo", show_default=True,
              help="Folder to write.")  # fmt: skip
def command(output: Path) -> None:
    """Load the TARM-like boom, show its sag, check and compensate a path, use the paper's joint, trace a campaign."""
    folder, page = output / "tarm_like", output / "tarm_like.html"
    _copy_robot(folder)
    arm = load_arm(folder / "learned.toml")  # whose joints were learned from finite elements
    compensated = _sag_and_path(arm, folder, output)
    presets = _paper_joint(folder)

    command = "armflex trace robots/tarm_like/measured.toml robots/tarm_like/campaign.csv ..."
    heading(f"5. Measured, and not where it should be: {command}")
    measured = load_arm(folder / "measured.toml")
    with progress("tracing"):
        traced = trace(measured, read_measurements(folder / "campaign.csv", measured), progress=doing)
    said = {"format": "armflex-demo-1", "page": str(page), "compensated": compensated, "tip_moves_m": presets}
    with together():
        traced.write(output / "traced.toml")
        write_report(traced, output / "trace.html")
        options.write_json(said | {"traced": [effect.effect.title for effect in traced.found]})
    print_trace(traced)
    say("", f"Open {page} and {output / 'trace.html'} in a browser; everything written is in {output}.")


def _copy_robot(folder: Path) -> None:
    """Copy the robot's files, leaving those that are there: an edited arm.toml is what the next run is about."""
    files, json_path = list(bundled_robot("tarm_like").iterdir()), options.json_path()
    kept = [*(folder.parent / name for name in WRITTEN), *folder.glob("*"), *(folder / file.name for file in files)]
    if json_path is not None and any(options.same_file(json_path, file) for file in kept):
        raise InputError(f"{json_path} is a file of the demonstration; name another one with --json")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for file in files:
            if not (folder / file.name).exists():
                write_whole(folder / file.name, file.read_bytes())
    except OSError as error:
        raise FileError(Place(folder), f"cannot be written: {error.strerror or error}") from None


def _sag_and_path(arm: Arm, folder: Path, output: Path) -> bool:
    """Show the sag, check a path, compensate it; return whether every row of it can be reached."""
    trajectory = read_trajectory(folder / "trajectory.csv", arm)
    heading(f"1. Straight out, carrying {PAYLOAD}: armflex deflect robots/tarm_like/learned.toml --payload {PAYLOAD}")
    straight = _straight(arm)
    print_deflection(arm, straight, straight.covariance)
    show_flags(straight.flags)
    heading(f"2. Through the port and around the corner: armflex check ... --tolerance {TOLERANCE * 1e3:g}mm")
    with progress("checking") as tick:
        report = check(arm, trajectory, TOLERANCE, progress=tick)
    view(arm, trajectory=trajectory, report=report, path=output / "tarm_like.html")
    print_check(report)
    heading("3. Cancel the sag: armflex compensate ...")
    with progress("compensating") as tick:
        compensation = compensate(arm, trajectory, progress=tick)
    write_trajectory(compensation.trajectory, output / "compensated.csv")
    print_compensation(compensation)
    show_flags(compensation.flags)
    worst = 0.0
    for q, commanded, payload in zip(compensation.trajectory.q, trajectory.q, trajectory.payload, strict=True):
        pose = arm.deflection(q, payload, method="newton").pose
        worst = max(worst, float(np.linalg.norm(pose.translation - arm.rigid_pose(commanded).translation)))
    say(f"Checked by Newton's method instead of the engine: {worst:.1e} m remain at most.", "")
    return compensation.ok


def _straight(arm: Arm, allow_large: bool = False) -> Deflection:
    return arm.deflection(np.zeros(len(arm.joint_names)), PAYLOAD, allow_large=allow_large)


def _paper_joint(folder: Path) -> dict[str, float]:
    """Train the paper's joint, put it in, and return how far the tip moves with each A4 [m]."""
    heading("4. A4 as in Table I of the source paper, in two readings of its unit")
    for unit in ("mm", "um"):
        result = train(read_joint_data(folder / "a4_table_1.csv", {"mm": unit}), "linear")
        save_law(result.trained, folder / f"paper_A4_{unit}.safetensors")
        if unit == "mm":
            print_training(result)
    rows, shifts, extrapolating = [], {}, []
    for preset, text in PRESETS.items():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the flags are what this table is about
            arm = load_arm(folder / "arm.toml", preset=preset)
        deflection = _straight(arm, allow_large=True)
        wrist = [i for i, name in enumerate(deflection.names.flexures) if name.startswith("A4")]
        gives, turns = (np.linalg.norm(deflection.twists[wrist][:, at], axis=1).max() for at in (slice(3), slice(3, 6)))
        moves = shifts[preset or "assumed"] = float(np.linalg.norm(deflection.displacement[:3]))
        verdict = "a machine"
        if any(flag.code == "large_sag" for flag in deflection.flags):
            verdict = "no machine: sag over 10 % of reach"
        if turns > MAX_ROTATION:
            verdict = "no machine: turns too far"
        rows.append([text, number(gives * 1e3), number(turns * 1e3), number(moves * 1e3), verdict])
        extrapolating += [flag.text for flag in deflection.flags if flag.code == "extrapolating"]
    columns = ["A4", "A4 moves mm", "A4 turns mrad", "tip moves mm", "verdict"]
    print_table(f"What each does to the tip, straight out with {PAYLOAD}", columns, rows)
    say(
        *dict.fromkeys(extrapolating),
        "As printed, A4 alone deflects by most of a metre: at 1 kN a steel member of its size would be strained far "
        "past yield.",
        "Read as um/kN it is an ordinary steel hinge. The arm's own A4 does not come from the table.",
    )
    return shifts
