"""armflex map: how far the tip moves, wherever it can be."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import numpy as np

from armflex.arm import Arm
from armflex.cli.options import (
    Choice,
    Command,
    OutputPath,
    PathArgument,
    arm_argument,
    covariates_option,
    json_option,
    progress,
    show_flags,
    was_interrupted,
    write_json,
)
from armflex.cli.tables import complain, console, number, print_table
from armflex.conventions import Array, parse_quantity
from armflex.errors import InputError
from armflex.mechanics.equilibrium import METHODS
from armflex.picture import SUFFIXES as PICTURES
from armflex.show.view.map_page import map_page
from armflex.tasks.workspace import WorkspaceMap, draw_map, map_workspace, write_map
from armflex.tasks.workspace.map_file import SUFFIXES
from armflex.tasks.workspace.workspace_map import CHUNK, VERDICTS

DRAWS = "Arms drawn from what is known of this one, asked as well: a voxel is ok only where all are."


@click.command(cls=Command)
@arm_argument
@click.option("-o", "--output", required=True, type=OutputPath(), help="MAP.safetensors with everything, or MAP.csv.")
@click.option("--rows", type=int, default=1 << 16, show_default=True, help="Configurations within the joint limits.")
@click.option("--payload", "payloads", default="none", show_default=True, metavar="A,B", help="Carried in turn.")
@click.option("--tolerance", metavar="5mm", help="Largest displacement of the tip, with unit, for the verdicts.")
@click.option("--voxel", metavar="200mm", help="Edge of a voxel, with unit; a round one is chosen otherwise.")
@click.option("--seed", type=int, default=0, show_default=True, help="Of the configurations.")
@click.option("--jobs", type=int, default=1, show_default=True, help="Processes; -1 for one on each core.")
@click.option("--store", type=PathArgument, metavar="DIR", help="Keep finished chunks: the same command goes on there.")
@click.option("--chunk", type=int, default=CHUNK, show_default=True, help="Configurations in a chunk, a power of two.")
@click.option("--picture", type=OutputPath(), metavar="MAP.png", help="Draw the map.")
@click.option("--page", type=OutputPath(), metavar="MAP.html", help="Write a page in which the map can be turned.")
@click.option("--method", type=Choice(METHODS), default="exact", show_default=True)
@click.option("--uncertainty/--no-uncertainty", default=True, show_default=True, help="Of the worst in every voxel.")
@click.option("--draws", type=int, default=0, show_default=True, help=DRAWS)
@click.option("--strict", is_flag=True, help="Refuse loads beyond those that a trained law has seen.")
@covariates_option
@json_option
def command(
    arm: Arm,
    output: Path,
    payloads: str,
    tolerance: str | None,
    voxel: str | None,
    store: Path | None,
    picture: Path | None,
    page: Path | None,
    covariates: dict[str, float],
    json_path: Path | None,
    **settings: Any,
) -> int:
    """The tip's largest displacement in every voxel of the workspace, its uncertainty, and the margin left.

    Configurations that have no equilibrium are counted by reason; with --tolerance they fail.
    """
    for path, endings in ((output, SUFFIXES), (picture, PICTURES), (page, (".html",))):
        _check_ending(path, endings)
    limit, edge = (None if text is None else parse_quantity(text, "length") for text in (tolerance, voxel))
    names = [name.strip() for name in payloads.split(",")]
    if limit is not None and limit <= 0.0:
        raise InputError(f"tolerance must be positive, got {tolerance}")
    if settings["jobs"] == 0:
        raise InputError("--jobs is 0: expected a number of processes, or -1")
    try:
        with progress("mapping") as tick:
            found = map_workspace(arm, names, voxel=edge, store=store, covariates=covariates, progress=tick, **settings)
    except BaseException as error:
        if store is not None and was_interrupted(error):
            complain(f"finished chunks are kept in {store}: the same command goes on from there")
        raise
    write_map(found, output, limit)
    if picture is not None:
        draw_map(arm, found, picture, limit)
    if page is not None:
        map_page(arm, found, page, limit, covariates)
    print_map(found, limit)
    show_flags(found.flags)
    write_json(json_path, as_json(found, limit))
    return 0 if limit is None or (found.verdicts(limit) == "ok").all() else 1


def _check_ending(path: Path | None, endings: tuple[str, ...]) -> None:
    """Raise `InputError` before hours of work where a file could not be written after them; inputs end otherwise."""
    if path is not None and path.suffix not in endings:
        raise InputError(f"{path}: expected a name that ends in {' or '.join(endings)}")


def print_map(found: WorkspaceMap, tolerance: float | None) -> None:
    """Print what was asked, what was refused, and where the tip moves most."""
    asked = f"{found.rows} configurations, payload {', '.join(found.payloads)}"
    asked += f", {found.draws} draws of the arm" if found.draws else ""
    console().print(f"base {found.base}, tip {found.tip}; {asked}; {len(found)} voxels of {found.voxel:g} m", "")
    counts = found.refused.sum(axis=0)
    for reason, count in zip(found.reasons, counts, strict=True):
        if count:
            console().print(f"{count} of {found.answered.sum() + counts.sum()} refused: {reason.replace('_', ' ')}")
    if tolerance is not None:
        title = f"Voxels against {tolerance * 1e3:g} mm"
        print_table(title, ["verdict", "voxels", "share"], _verdict_rows(found, tolerance))
    if found.answered.any():
        _print_worst(found, tolerance)


def _verdict_rows(found: WorkspaceMap, tolerance: float) -> list[list[str]]:
    verdicts = found.verdicts(tolerance)
    counts = [(name, int((verdicts == name).sum())) for name in VERDICTS]
    return [[name, str(count), f"{count / len(found):.1%}"] for name, count in counts]


def _print_worst(found: WorkspaceMap, tolerance: float | None) -> None:
    here = found.worst_voxel
    sigma = "" if found.sigma is None else f" ± {number(found.sigma[here] * 1e3, 2)}"
    left = "" if tolerance is None else f", {number((tolerance - found.worst[here]) * 1e3, 3)} mm to the tolerance"
    place = ", ".join(f"{x:.3g}" for x in found.centres[here])
    console().print(f"The tip moves most, {number(found.worst[here] * 1e3)}{sigma} mm{left}, about ({place}) m:")
    q = " ".join(f"{joint}={x:.4f}" for joint, x in zip(found.joints, found.worst_q[here], strict=True))
    console().print(f"  {q}, payload {found.payloads[found.worst_payload[here]]}")
    if found.worst_of_draws is not None:
        most = found.worst_of_draws[here]
        said = f"{number(most * 1e3)} mm" if np.isfinite(most) else "one has no answer"
        console().print(f"  the worst of {found.draws} draws there: {said}")


def as_json(found: WorkspaceMap, tolerance: float | None) -> dict[str, Any]:
    """Return the summary of a map for programs, SI."""
    some = bool(found.answered.any())
    summary = {
        "format": "armflex-map-1",
        "base": found.base,
        "tip": found.tip,
        "joint_names": list(found.joints),
        "payloads": list(found.payloads),
        "rows": found.rows,
        "seed": found.seed,
        "draws": found.draws,
        "voxel_m": found.voxel,
        "voxels": len(found),
        "answered": int(found.answered.sum()),
        "refused": dict(zip(found.reasons, found.refused.sum(axis=0).tolist(), strict=True)),
        "mean_m": float(np.nansum(found.mean * found.answered) / found.answered.sum()) if some else None,
        "worst": _worst_json(found) if some else None,
        "worst_of_draws_m": _finite(found.worst_of_draws),
        "flags": [str(flag) for flag in found.flags],
    }
    if tolerance is not None:
        verdicts = found.verdicts(tolerance)
        summary |= {"tolerance_m": tolerance, "verdicts": {name: int((verdicts == name).sum()) for name in VERDICTS}}
    return summary


def _worst_json(found: WorkspaceMap) -> dict[str, Any]:
    here = found.worst_voxel
    return {
        "displacement_m": float(found.worst[here]),
        "sigma_m": _finite(found.sigma, here),
        "centre": found.centres[here].tolist(),
        "q": found.worst_q[here].tolist(),
        "payload": found.payloads[found.worst_payload[here]],
        "worst_of_draws_m": _finite(found.worst_of_draws, here),
    }


def _finite(values: Array | None, here: int | slice = slice(None)) -> float | None:
    """Return the largest of some values; None where there is none, or no number that JSON has."""
    most = np.nan if values is None else values[here].max()
    return float(most) if np.isfinite(most) else None
