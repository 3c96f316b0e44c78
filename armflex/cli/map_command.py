"""armflex map: how far the tip moves, wherever it can be."""

from pathlib import Path
from typing import Any

import click
import numpy as np

from armflex.arm import Arm
from armflex.cli import options
from armflex.cli.terminal import number, print_table, progress, say, say_written
from armflex.conventions import parse_quantity
from armflex.errors import InputError
from armflex.mechanics.equilibrium import METHODS
from armflex.plotting import SUFFIXES as PICTURES
from armflex.show.view.map_page import map_page
from armflex.storage.whole_file import together
from armflex.tasks.workspace import WorkspaceMap, draw_map, map_workspace, write_map
from armflex.tasks.workspace.workspace_map import SUFFIXES, VERDICTS

DRAWS = "Number of arms drawn from the uncertainty of this one: a voxel is ok only where it is ok for all of them."
Output = options.OutputPath


@click.command(cls=options.Command)
@options.arm
@options.as_in_campaign
@click.option("-o", "--output", required=True, type=Output(), help="MAP.safetensors (everything) or MAP.csv.")
@click.option("--rows", type=int, default=1 << 16, show_default=True, help="Number of configurations, within limits.")
@click.option("--payload", "payloads", default="none", show_default=True, metavar="A,B", help="Each in turn.")
@click.option("--force", metavar="fx=0,fz=-500N", help=f"External load everywhere: {options.FORCE_HELP}.")
@click.option("--tolerance", metavar="5mm", help="Largest displacement of the tip, with unit, for the verdicts.")
@click.option("--voxel", metavar="200mm", help="Edge of a voxel, with unit; a round one is chosen otherwise.")
@click.option("--seed", type=int, default=0, show_default=True, help="Seed of the configurations.")
@click.option("--jobs", type=int, default=1, show_default=True, help="Processes; -1 for one on each core.")
@click.option("--picture", type=Output(), metavar="MAP.png", help="Draw the map.")
@click.option("--page", type=Output(), metavar="MAP.html", help="Write a page in which the map can be turned.")
@click.option("--method", type=options.Choice(METHODS), default="exact", show_default=True)
@click.option("--uncertainty/--no-uncertainty", default=True, show_default=True, help="Of largest displacements.")
@click.option("--frequency", is_flag=True, help="Also the first natural frequency, where a voxel's tip moves most.")
@click.option("--draws", type=int, default=0, show_default=True, help=DRAWS)
@click.option("--strict", is_flag=True, help="Refuse loads beyond those that a law was trained on.")
@options.covariates
def command(
    arm: Arm,
    output: Path,
    payloads: str,
    force: str | None,
    tolerance: str | None,
    voxel: str | None,
    picture: Path | None,
    page: Path | None,
    **settings: Any,
) -> int:
    """The tip's largest displacement in every voxel of the workspace, its uncertainty, and the margin left.

    Configurations that have no equilibrium are counted by reason; with --tolerance they fail.
    """
    # Before hours of work: a file that could not be written after them. Inputs end otherwise.
    for path, endings in ((output, SUFFIXES), (picture, PICTURES), (page, (".html",))):
        if path is not None and path.suffix not in endings:
            raise InputError(f"{path}: expected a file name that ends in {' or '.join(endings)}")
    limit, edge = (None if text is None else parse_quantity(text, "length") for text in (tolerance, voxel))
    names = [name.strip() for name in payloads.split(",")]
    if limit is not None and limit <= 0.0:
        raise InputError(f"tolerance must be positive, got {tolerance}")
    settings["wrenches"] = () if force is None else (options.parse_force(force, arm),)
    if settings["jobs"] == 0:
        raise InputError("--jobs is 0: expected a number of processes, or -1")
    kinds = [name for name in ("uncertainty", "frequency") if settings[name]]
    then = f", then the {' and the '.join(kinds)} in each voxel" if kinds else ""
    carried = f" under {len(names)} payloads" if len(names) > 1 else ""
    drawn = f" of the arm and of {settings['draws']} drawn" if settings["draws"] else ""
    with progress(f"mapping {settings['rows']} configurations{carried}{drawn}{then}: steps") as tick:
        workspace = map_workspace(arm, names, voxel=edge, progress=tick, **settings)
    with together():
        write_map(workspace, output, limit)
        if picture is not None:
            draw_map(arm, workspace, picture, limit)
        if page is not None:
            map_page(arm, workspace, page, limit, settings["covariates"], settings["wrenches"])
        judged = {} if limit is None else {"tolerance_m": limit, "verdicts": _verdicts(workspace, limit)}
        options.conclude(lambda: workspace.content() | judged, workspace.flags, arm)
    print_map(workspace, limit)
    say_written(output, picture, page)
    return 0 if limit is None or (workspace.verdicts(limit) == "ok").all() else 1


def print_map(workspace: WorkspaceMap, tolerance: float | None) -> None:
    """Print what was asked, what was refused, and where the tip moves most."""
    asked = f"{workspace.rows} configurations, payload {', '.join(workspace.payloads)}"
    asked += f", {workspace.draws} draws of the arm" if workspace.draws else ""
    say(f"base {workspace.base}, tip {workspace.tip}; {asked}; {len(workspace)} voxels of {workspace.voxel:g} m", "")
    counts = workspace.refused.sum(axis=0)
    for reason, count in zip(workspace.reasons, counts, strict=True):
        if count:
            say(f"{count} of {workspace.answered.sum() + counts.sum()} refused: {reason.replace('_', ' ')}")
    if tolerance is not None:
        shares = [
            [name, str(count), f"{count / len(workspace):.1%}"]
            for name, count in _verdicts(workspace, tolerance).items()
        ]
        print_table(f"Voxels against {tolerance * 1e3:g} mm", ["verdict", "voxels", "share"], shares)
    if not workspace.answered.any():
        return
    here = workspace.worst_voxel
    sigma = "" if workspace.sigma is None else f" ± {number(workspace.sigma[here] * 1e3, 2)}"
    left = "" if tolerance is None else f", {number((tolerance - workspace.worst[here]) * 1e3, 3)} mm to the tolerance"
    place = ", ".join(f"{x:.3g}" for x in workspace.centres[here])
    say(f"Largest displacement of the tip, {number(workspace.worst[here] * 1e3)}{sigma} mm{left}, about ({place}) m:")
    q = " ".join(f"{joint}={x:.4f}" for joint, x in zip(workspace.joints, workspace.worst_q[here], strict=True))
    say(f"  {q}, payload {workspace.payloads[workspace.worst_payload[here]]}")
    if workspace.frequency is not None and np.isfinite(workspace.frequency).any():
        slow = int(np.nanargmin(workspace.frequency))
        place = ", ".join(f"{x:.3g}" for x in workspace.centres[slow])
        say(f"Lowest first natural frequency, {number(workspace.frequency[slow])} Hz, about ({place}) m.")
    if workspace.worst_of_draws is not None:
        most = workspace.worst_of_draws[here]
        most_said = f"{number(most * 1e3)} mm" if np.isfinite(most) else "one has no answer"
        say(f"  the worst of {workspace.draws} draws there: {most_said}")


def _verdicts(workspace: WorkspaceMap, tolerance: float) -> dict[str, int]:
    """Return how many voxels have each verdict."""
    verdicts = workspace.verdicts(tolerance)
    return {name: int((verdicts == name).sum()) for name in VERDICTS}
