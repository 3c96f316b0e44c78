"""armflex modes: how a loaded arm swings at one configuration, its drives holding."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np

from armflex.arm import Arm
from armflex.cli import options
from armflex.cli.terminal import number, print_table, progress, say
from armflex.conventions import Array
from armflex.errors import InputError
from armflex.estimate.draw import drawn_frequencies
from armflex.measured.forces import Unnamed
from armflex.mechanics.modes import Modes
from armflex.plotting import check_ending
from armflex.result import record
from armflex.rows.wrench import Wrench
from armflex.show.view.mode_picture import draw_modes
from armflex.storage.whole_file import together
from armflex.tasks.settle import modes_along


@click.command(cls=options.Command)
@options.configuration
@click.option("--traj", "trajectory_path", type=options.InputPath, metavar="TRAJ.csv",
              help="The modes at each via-point of a path, at all rows where none is named; without --q.")  # fmt: skip
@click.option("--count", type=click.IntRange(min=1), default=6, show_default=True, help="Largest number of modes.")
@click.option("--picture", "drawing", type=options.OutputPath(), metavar="M.png", help="Draw the four slowest modes.")
def command(
    arm: Arm,
    q: Array,
    payload: str,
    wrenches: list[Wrench],
    covariates: dict[str, float],
    count: int,
    drawing: Path | None,
    trajectory_path: Path | None,
) -> None:
    """Natural frequencies and mode shapes at the deflected pose, while the drives hold it.

    The uncertainty is the scatter over 64 arms drawn from the posterior in [calibration] and from the relative_std of
    the flexures.
    """
    if trajectory_path is not None:
        given = [name for name in ("positions", "forces", "drawing") if click.get_current_context().params.get(name)]
        if given:
            text = "--traj brings its own positions and loads, and draws none"
            raise InputError(f"{text}: leave --q, --force, --picture out")
        _along(arm, trajectory_path, payload, covariates, count)
        return
    if drawing is not None:
        check_ending(drawing)
    modes = arm.modes(q, payload, covariates=covariates, wrenches=wrenches, count=count)
    drawn = drawn_frequencies(arm, q, payload, covariates=covariates, wrenches=wrenches, count=count)
    std = None
    if drawn is not None:  # a drawn arm may have fewer modes, where one is hardly slower than what counts as rigid
        std = [*drawn.std(axis=0, ddof=1).tolist(), *(None,) * len(modes.frequencies)][: len(modes.frequencies)]

    named = {"joint_names": "names.joints", "flexures": "names.flexures", "frequencies_hz": "frequencies"}
    named |= {"modal_masses": "masses", "flexure_shapes": "twists", "stiffness_sensitivities": "sensitivities"}

    def content() -> dict[str, Any]:
        return {"payload": payload, "q": q, "frequencies_std_hz": std} | record(modes, "damping_ratios shapes", **named)

    with together():
        if drawing is not None:
            draw_modes(arm.deflection(q, payload, covariates=covariates, wrenches=wrenches), modes, drawing)
        options.conclude(content, modes.flags, arm)
    print_modes(modes, std)


def _along(arm: Arm, path: Path, payload: str, covariates: dict[str, float], count: int) -> None:
    """Print and write the modes at the via-points of a path, under its loads and payloads."""
    with progress("computing modes"):
        along = modes_along(arm, options.read_path(path, arm, Unnamed(payload)), covariates, count)
    points = [record(point, "name time payload", frequencies_hz="frequencies", flexures="stiffest") for point in along]
    flags = {flag.kind: flag for point in along for flag in point.flags}
    options.conclude(lambda: {"via_points": points}, tuple(flags.values()), arm)
    most = max(len(point.frequencies) for point in along)
    rows = []
    for point in along:
        hertz = [number(float(frequency), 4) for frequency in point.frequencies]
        stiffest = point.stiffest[0] if point.stiffest else "none"
        rows.append([point.name, f"{point.time:g}", point.payload, *hertz, *[""] * (most - len(hertz)), stiffest])
    head = ["via-point", "time s", "payload", *(f"mode {i + 1} Hz" for i in range(most)), "first gained by"]
    print_table(f"Modes of vibration, drives holding (base {arm.robot.base}, tip {arm.robot.tip})", head, rows)


def print_modes(modes: Modes, std: Sequence[float | None] | None) -> None:
    """Print a line for every mode: how fast, which way the tip goes, and which flexures to stiffen.

    `std` is that of each frequency [Hz], None of one that not every drawn arm has; all None where none was drawn.
    """
    names, rows = modes.names, []

    def share(part: float) -> str:
        return f"{part:.0%}" if part < 10.0 else "> 1000%"  # near instability a little stiffness is everything

    for i, frequency in enumerate(modes.frequencies):
        order = np.argsort(-modes.sensitivities[i])[:3]
        stiffer = ", ".join(f"{names.flexures[j]} {share(modes.sensitivities[i, j])}" for j in order)
        shape = [f"{round(part, 2) + 0.0:.2f}" for part in modes.shapes[i, :3]]
        size = None if std is None else std[i]
        spread = "-" if size is None else number(size, 2)
        decay = number(float(modes.decays[i]), 2)
        rows.append([str(i + 1), number(float(frequency), 4), spread, decay, *shape, stiffer])
    print_table(
        f"Modes of vibration, drives holding (base {names.base}, tip {names.tip})",
        ["", "Hz", "± std", "decay s", "tip x", "tip y", "tip z", "gained by stiffness of"],
        rows,
    )
    say(
        "Decay is the time in which the swing falls to 37 %. Stiffness: change of the frequency per change of a "
        "flexure's stiffness."
    )
    if std is None:
        say("± is not known: the arm states no relative_std of its compliances, and has no calibration.")
    elif None in std:
        say(f"± is not known of {std.count(None)} modes: not every arm as likely as this one has them.")
