"""armflex calibrate: fit what [prior] frees to a campaign."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import click
import numpy as np

from armflex.arm import Arm
from armflex.cli import options
from armflex.cli.terminal import number, print_table, progress, say, say_written, show_flags
from armflex.conventions import RESOLUTION, Shown, shown_in
from armflex.errors import InputError, enough_memory
from armflex.estimate import Calibration, calibrate
from armflex.estimate.block import learned_laws
from armflex.estimate.held_out import OfCampaign
from armflex.estimate.identify import FittedParameter, about_zeros
from armflex.estimate.learn import LearnedAxis, learned_axes
from armflex.estimate.sample import LawSamples, sample_laws
from armflex.files.dh_table import in_dh_words
from armflex.measured.measurements import Measurements
from armflex.parameters import MISSING, ParameterKind
from armflex.readings import Position
from armflex.sampling.diagnostics import FEWEST_DRAWS
from armflex.storage.whole_file import together


@click.command(cls=options.Command)
@click.option("-o", "--output", required=True, type=options.OutputPath(), help="Calibrated arm.toml to write.")
@click.option("--sample", type=click.IntRange(FEWEST_DRAWS),
              help="Draws per chain: learned laws by NUTS as well (minutes).")  # fmt: skip
@click.option("--all", "show_all", is_flag=True, help="List every parameter, also the unremarkable.")
@click.option("--report", "report_path", type=options.OutputPath(), help="HTML page of the calibration to write.")
@options.campaign
def command(
    arm_path: Path,
    output: Path,
    report_path: Path | None,
    sample: int | None,
    show_all: bool,
    keep: bool,
    anyway: bool,
    measured: Callable[[Arm], Measurements],
    lax: bool,
) -> None:
    """Fit what [prior] frees, on the deflected arm, and report what the data do not determine.

    Several campaigns of one machine are fitted together, instrument and target anew in each.
    """
    arm = options.declared_arm(arm_path, "calibrate", keep, lax)
    if sample and keep:
        text = "--sample draws laws that are learned, and --keep keeps them as they are"
        raise InputError(f"{text}: leave out one of the two")
    if sample and not any(flexure.learn for flexure in arm.flexures):
        raise InputError(f"{arm_path}: no flexure has learn = true: there is no law for --sample")
    measurements = measured(arm)
    with enough_memory(f"{len(measurements)} rows"), progress("calibrating: steps of the fit") as tick:
        calibration = calibrate(arm, measurements, progress=lambda done, _: tick(done, None), keep=keep, anyway=anyway)
    samples = None
    if sample:
        with progress("sampling") as tick:
            samples = sample_laws(calibration.fit, sample, progress=tick)
    axes: tuple[LearnedAxis, ...] = ()
    # Else they stay as an earlier campaign taught them.
    if any(parameter.kind is ParameterKind.LAW for parameter in calibration.parameters):
        fitted = {name: law for name, law in learned_laws(calibration.arm).items() if law.posterior is not None}
        axes = learned_axes(calibration.fit, fitted, samples) if fitted else ()
    with together():
        options.write_json(calibration.content() | {"laws": [{**vars(axis), "told": axis.determined} for axis in axes]})
        calibration.write(output)
        if report_path is not None:
            from armflex.show.report import write_report  # draws

            write_report(calibration, report_path)
    print_calibration(calibration, show_all)
    if axes:
        print_laws(axes, samples)
    show_flags((*measurements.flags, *calibration.flags))
    say_written(output, report_path)


def print_calibration(calibration: Calibration, show_all: bool = False) -> None:
    """Print the error before and after, what was found, and what the data do not determine."""
    held_out, (unit, factor) = calibration.held_out or (None, None), calibration.fit.view.readings.shown_in
    figures = [
        [f"declared, {calibration.placing}", calibration.declared_rms, held_out[0]],
        ["calibrated", calibration.rms, held_out[1]],
        ["stated noise", calibration.noise_rms, None],
    ]
    cells = [[name, *("-" if rms is None else number(rms * factor) for rms in pair)] for name, *pair in figures]
    what = calibration.fit.view.readings.error_title
    title = f"{what[0].upper()}{what[1:]} over {len(calibration.fit.view.rows)} rows"
    print_table(title, ["", f"RMS {unit}", f"poses held out {unit}"], cells)
    if at_target := calibration.fit.view.at_target(calibration.rms):
        say(at_target)
    print_campaigns(calibration.campaigns, ("declared", "calibrated"), calibration.fit.view.readings.shown_in)
    if len(calibration.by_kind) > 1 or not calibration.fit.view.readings.of(Position):
        rows = []
        for kind, *sizes in calibration.by_kind:
            unit, factor = kind.shown_in
            count = int(np.isfinite(kind.sigma).any(axis=1).sum())
            rows.append([kind.title, str(count), *(number(size * factor) for size in sizes), unit])
        print_table("By instrument, RMS", ["", "rows", "declared", "calibrated", "stated noise", "unit"], rows)
    shown = [p for p in calibration.parameters if np.isfinite(p.prior) and p.kind is not ParameterKind.LAW]
    words = in_dh_words(calibration.arm.robot)
    chosen = calibration.parameters if show_all else sorted(shown, key=lambda parameter: -abs(parameter.pull))[:8]
    if chosen:
        columns = ["parameter", "value", "± std", "unit", "prior deviations", "determined"]
        title = "Parameters" if show_all else "Parameters that moved most, relative to their priors"
        print_table(title, columns, [_cells(parameter, words) for parameter in chosen])
        say(*about_zeros(calibration.fit.parameters))
    blind = [p for p in calibration.undetermined if p.kind is not ParameterKind.LAW]
    if blind:
        called = {name: word for name, (word, _) in words.items()}
        blind = sorted(blind, key=lambda parameter: not parameter.absorbing)
        cells = [[called.get(p.name, p.name), p.reason(called)] for p in blind[:12]]
        more = f" (12 of {len(blind)})" if len(blind) > 12 else ""
        print_table(f"What these data cannot determine{more}", ["not determined", "reason"], cells)
    say(*_remarks(calibration))


def _remarks(calibration: Calibration) -> Iterator[str]:
    """Yield what is said of the readings: how they scatter, and which were left out."""
    if not calibration.fit.blocks:
        yield "Nothing was fitted: [prior] frees nothing."
    scatters = calibration.fit.scatters
    names = dict.fromkeys(kind.name or "the tracker" for kind in calibration.fit.view.readings.kinds)
    for name, scatter in zip(names, scatters, strict=True):
        if scatter > MISSING:
            whose = f"The readings of {name}" if len(scatters) > 1 else "The readings"
            text = f"{whose} scatter {scatter:.2g} times as much as stated, and were weighted by that: an effect is "
            yield f"{text}missing, which the fitted parameters may absorb in part. `armflex trace` searches for it."
    if count := calibration.left_out:
        yield f"Excluded as outliers by the robust fit: readings of {count} rows, which no figure includes."
    for outlier in calibration.outliers[:5]:
        unit, factor = outlier.shown_in
        by = f" by {outlier.instrument}" if outlier.instrument else ""
        other = f": exchanged with the reading of {outlier.fellow}" if outlier.fellow else ""
        pose = calibration.measurements.pose[outlier.row]
        yield f"outlier: {outlier.place} (pose {pose}), {number(outlier.error_m * factor, 3)} {unit} off{by}{other}"


def print_campaigns(campaigns: Sequence[OfCampaign], stages: tuple[str, str], unit: str | Shown) -> None:
    """Print the errors of each of several campaigns."""
    if campaigns:
        rows, (unit, factor) = [], shown_in(unit)
        for campaign in campaigns:
            sizes = (
                "-" if rms is None else number(rms * factor)
                for rms in (campaign.before, campaign.after, campaign.from_others)
            )
            rows.append([campaign.name, str(campaign.rows), *sizes])
        columns = ["", "rows", stages[0], stages[1], f"from the others {unit}"]
        print_table("By campaign, RMS; from the others: of the arm fitted without it, placed in it", columns, rows)


def _cells(parameter: FittedParameter, words: Mapping[str, tuple[str, float]]) -> list[str]:
    """Return a parameter's line, a DH row's number by its name there (`in_dh_words`), a compliance by its factor."""
    name, sign = words.get(parameter.name, (parameter.name, 1.0))
    pull = number(sign * parameter.pull, 2) if np.isfinite(parameter.prior) else "-"
    says = "wrong as declared" if parameter.surprising else "yes" if parameter.determined else "no"
    says = "no: absorbs a misfit" if parameter.absorbing else says
    if parameter.combined:
        others = (words.get(other, (other,))[0] for other in parameter.trades_against[:2])
        says = f"only with {', '.join(others) or 'others'}"
    if parameter.kind is ParameterKind.COMPLIANCE:
        return [name, f"×{np.exp(parameter.value):.4g}", f"{number(100.0 * parameter.std, 2)} %", "", pull, says]
    least = RESOLUTION if parameter.unit in ("m", "rad") else 0.0
    value, std = number(sign * parameter.value, 4, least), number(parameter.std, 2, least)
    return [name, value, std, parameter.unit, pull, says]


def print_laws(axes: Sequence[LearnedAxis], samples: LawSamples | None) -> None:
    """Print a line for every axis that the readings inform on, and name the others."""
    rows = []
    for axis in axes:
        if axis.determined:
            unit, factor = ("µm", 1e6) if axis.axis.startswith("d") else ("mrad", 1e3)
            sizes = [number(size * factor, 3) for size in (axis.declared, axis.learned, axis.correction, axis.std)]
            sampled = [] if axis.sampled is None else [number(axis.sampled * factor, 3)]
            rows.append([axis.flexure, axis.axis, *sizes, unit, *sampled])
    columns = ["flexure", "axis", "declared", "learned", "nonlinear", "± std", "unit"]
    print_table("Laws learned: RMS over the observed loads", columns + ["sampled"] * bool(samples), rows)
    left = ", ".join(f"{axis.flexure} {axis.axis}" for axis in axes if not axis.determined)
    if left:
        say(f"Hardly observable in these readings, kept near the declared values: {left}.")
    if samples is not None:
        judged = samples.diagnostics
        say(f"Sampled: R-hat {judged.rhat_max:.3f}, {judged.ess_min:.0f} effective draws or more.")
