"""armflex trace: find the effect that explains what calibration leaves, and add it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from armflex.calibrate.effect_block import numbered
from armflex.calibrate.file import write_traced
from armflex.cli.options import (
    Command,
    OutputPath,
    PathArgument,
    declared_arm,
    json_option,
    keep_option,
    points_options,
    show_flags,
    write_json,
)
from armflex.cli.tables import complain, console, number, print_table
from armflex.effects.effect_file import names_of
from armflex.effects.law import Effect
from armflex.effects.remember import derived_directions
from armflex.effects.spot import LINK
from armflex.measured.measurements import read_measurements
from armflex.measured.point_export import PointExport
from armflex.trace import trace

if TYPE_CHECKING:
    from armflex.trace.result import Found, Smallest, Trace, Unexplained

MOST_LINES = 8
"""Values of one effect that are shown on the terminal; the file holds all."""

MOST_ADVICE = 3
"""Of what to measure next."""


@click.command(cls=Command)
@click.argument("arm_path", metavar="ARM", type=PathArgument)
@click.argument("measurements_path", metavar="MEAS.csv", type=PathArgument)
@click.option("-o", "--output", required=True, type=OutputPath(), help="Traced arm.toml to write.")
@click.option("--report", "report_path", type=OutputPath(), help="HTML page of what was found to write.")
@keep_option
@points_options
@json_option
def command(
    arm_path: Path,
    measurements_path: Path,
    output: Path,
    report_path: Path | None,
    keep: bool,
    points: PointExport | None,
    json_path: Path | None,
) -> None:
    """Calibrate, find what residual is left, trace it to an effect the arm lacks, add it, and say what it was worth."""
    arm = declared_arm(arm_path, "trace", keep)
    measurements = read_measurements(measurements_path, arm, points=points)
    found = trace(arm, measurements, report=_say(), keep=keep)
    print_trace(found)
    show_flags((*measurements.flags, *derived_directions(found.arm, measurements, found.rows)))
    write_json(json_path, as_json(found))
    write_traced(arm_path, found, output)
    if report_path is not None:
        from armflex.report import write_report  # imports a plotting library

        write_report(found, report_path)
    names = " and ".join(str(path) for path in (output, report_path) if path)
    console().print(f"Written to {names}.")


def _say() -> Callable[[str], None]:
    """Return the function that says on stderr what is being done, with the seconds that have passed."""
    begun = time.monotonic()
    return lambda text: complain(f"{time.monotonic() - begun:4.0f} s  {text}")


def print_trace(found: Trace) -> None:
    """Print the errors before and after, what was added, what else it may be, what is left, and what to measure."""
    out = console()
    figures = [
        ["declared, instrument placed", found.declared_rms, None],
        ["calibrated", found.calibrated_rms, found.held_out_before],
        ["with what was found", found.rms, found.held_out_after],
        ["stated noise", found.noise_rms, None],
    ]
    rows = [[name, *("-" if rms is None else number(rms * 1e3, 3) for rms in pair)] for name, *pair in figures]
    title = f"RMS of the 3-D position error over {len(found.rows)} rows"
    print_table(title, ["", "all rows mm", "poses held out mm"], rows)
    if found.found:
        columns = ["added", "site", "axis", "value ± standard uncertainty", "held out mm"]
        print_table("What the arm lacked", columns, [row for one in found.found for row in _lines(one)])
    for line in _remarks(found):
        out.print(line)


def _lines(found: Found) -> Iterator[list[str]]:
    """Yield one line for each value of an effect; the first one says which effect it is."""
    effect, proof = found.effect, found.proof
    held_out = f"{number(proof.before * 1e3, 3)} -> {number(proof.after * 1e3, 3)}"
    head = [" ".join(filter(None, names_of(effect.law))), effect.spot.place, effect.spot.axis or "-"]
    for value in _values(found)[:MOST_LINES]:
        yield [*head, value, held_out]
        head, held_out = ["", "", ""], ""


def _values(found: Found) -> list[str]:
    pairs = zip(found.effect.named.items(), found.effect.units, strict=True)
    return [
        f"{name} {value:.4g}" + (f" ± {found.std[name]:.2g}" if found.std.get(name) else "") + f" {unit}"
        for (name, value), unit in pairs
    ]


def _remarks(found: Trace) -> Iterator[str]:
    yield from _left_out(found)
    for one, which in zip(found.found, found.numbers, strict=True):
        title = f"{one.effect.title}{numbered(which)}"
        if one.witness:
            yield (
                f"{title} is believed because fitted parameters no longer strain against their priors; "
                "held-out rows are not predicted clearly better."
            )
        rivals = list(dict.fromkeys(effect.title for effect, _ in one.equivalent))
        if rivals:
            more = f", and {len(rivals) - 3} more" if len(rivals) > 3 else ""
            yield f"These data do not tell {title} from {', '.join(rivals[:3])}{more}."
    if found.unexplained is not None:
        yield _left(found.unexplained)
    elif not found.found:
        yield "Nothing is missing that these data could show."
    if found.smallest:
        yield _smallest(found.smallest)
    for advice in found.next_measurement[:MOST_ADVICE]:
        yield f"Next: {advice}"
    more = len(found.next_measurement) - MOST_ADVICE
    if more > 0:
        yield f"Next: {more} more in --report and --json."


def _left_out(found: Trace) -> Iterator[str]:
    """Yield how many rows are in no figure, and why."""
    if found.outliers:
        lost, less = found.told("lost beam"), found.told("counted less")
        yield f"In no figure: {lost} rows left out as lost beams, and {less} that the fit counts less as outliers."
    unknown = found.told("direction unknown")
    if unknown:
        yield f"{unknown} more rows are left out: nothing tells from where a joint came before it first moved."
    if found.told("unexplained"):
        yield f"{found.told('unexplained')} more rows, far off together, are left out: nothing explains them."


def _left(left: Unexplained) -> str:
    where = "without a place" if left.site is None else f"at {left.site.removeprefix(LINK)} {left.axis}"
    size = "" if left.std is None else f", {number(left.std, 2)} {left.unit} from pose to pose"
    others = ", ".join(f"{place.site.removeprefix(LINK)} {place.axis}" for place in left.equivalent[:3])
    also = f" (or {others})" if others else ""
    return f"Left unexplained: {number(left.rms * 1e3, 3)} mm RMS {where}{size}{also}; no column tells why."


def _smallest(smallest: tuple[Smallest, ...]) -> str:
    least = min(smallest, key=lambda one: one.least)
    median = float(np.median([one.least for one in smallest]))
    return (
        f"Effects would have shown from {number(median * 1e3, 2)} mm RMS at the target "
        f"(median over laws; {least.effect} from {number(least.least * 1e3, 2)} mm)."
    )


def as_json(found: Trace) -> dict[str, Any]:
    """Return a trace for programs: RMS in mm, parameters SI."""
    return {
        "format": "armflex-trace-1",
        "rows": len(found.rows),
        "noise_rms_mm": found.noise_rms * 1e3,
        "rms_mm": {
            "declared": found.declared_rms * 1e3,
            "calibrated": found.calibrated_rms * 1e3,
            "after": found.rms * 1e3,
        },
        "held_out_rms_mm": {"calibrated": found.held_out_before * 1e3, "after": found.held_out_after * 1e3},
        "effects": [_effect_json(one) for one in found.found],
        "unexplained": None if found.unexplained is None else _unexplained_json(found.unexplained),
        "not_identifiable": [
            {"effect": one.effect, "site": one.site, "reason": one.reason} for one in found.not_identifiable
        ],
        "next_measurement": list(found.next_measurement),
        "smallest_shown_mm": {one.effect: {"least": one.least * 1e3, "most": one.most * 1e3} for one in found.smallest},
        "noise_over_stated": found.noise,
        "outliers": [
            {"row": one.row, "place": str(one.place), "error_mm": one.error_m * 1e3, "kind": one.kind}
            for one in found.outliers
        ],
    }


def _effect_json(found: Found) -> dict[str, Any]:
    effect, proof = found.effect, found.proof
    pairs = zip(effect.named.items(), effect.units, strict=True)
    sessions = (proof.sessions_before, proof.sessions_after)
    return {
        **_place_json(effect),
        "parameters": {
            name: {"value": value, "std": _finite(found.std.get(name)), "unit": unit} for (name, value), unit in pairs
        },
        "held_out_rms_mm": {"before": proof.before * 1e3, "after": proof.after * 1e3},
        "equivalent": [_place_json(rival) for rival, _ in found.equivalent],
        "held_out_sessions_rms_mm": dict(
            zip(("before", "after"), (None if rms is None else rms * 1e3 for rms in sessions), strict=True)
        ),
        "evidence": found.evidence,
        "chance": proof.null,
        "believed": found.believed,
    }


def _finite(std: float | None) -> float | None:
    """Return a standard uncertainty, None where nothing determines the value."""
    return std if std is not None and np.isfinite(std) else None


def _place_json(effect: Effect) -> dict[str, Any]:
    """Return which law acts where; `shape` and `partner` only where there is one."""
    (name, shape), spot = names_of(effect.law), effect.spot
    place = {"effect": name, "site": spot.place, "axis": spot.axis, "covariates": list(spot.covariates)}
    return place | ({"shape": shape} if shape else {}) | ({"partner": spot.partner} if spot.partner else {})


def _unexplained_json(left: Unexplained) -> dict[str, Any]:
    return {
        "site": None if left.site is None else left.site.removeprefix(LINK),
        "axis": left.axis,
        "std": left.std,
        "unit": left.unit,
        "rms_mm": left.rms * 1e3,
        "covariates": [],
    }
