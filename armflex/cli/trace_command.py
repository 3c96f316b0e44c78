"""armflex trace: find the effect that explains what calibration leaves, and add it."""

import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np

from armflex.arm import Arm
from armflex.cli import options
from armflex.cli.calibrate_command import print_campaigns
from armflex.cli.terminal import doing, number, print_table, say, say_written, show_flags, show_stage
from armflex.conventions import SHOWN
from armflex.errors import InputError, enough_memory, listing
from armflex.estimate.held_out import campaigns_json
from armflex.estimate.outliers import outlier_json
from armflex.files.effect_file import names_of, place_json
from armflex.laws.effects.effect import Effect
from armflex.laws.effects.in_arm import derived_directions
from armflex.laws.effects.location import LINK
from armflex.measured.measurements import Measurements
from armflex.parameters import numbered
from armflex.plan import MOST_ASKED
from armflex.plan.drive import write_plan
from armflex.progress import MOST_MINUTES
from armflex.result import plain, record, scaled
from armflex.show.report import write_report
from armflex.show.report.summary import HALVES_HEAD, HALVES_TITLE, further, headline
from armflex.show.report.words import measure, units_of
from armflex.storage.whole_file import together
from armflex.trace import trace
from armflex.trace.families import Families, FamilyFound
from armflex.trace.findings import HELD_OUT_IS_OF, Found, Replicated, Trace
from armflex.trace.halves import counted

MOST_KINDS = 3
"""Kinds of effect, and places of each, that are shown on the terminal; the files hold all."""


def _print_families(traced: Trace, unit: str, factor: float) -> None:
    """Print which kinds of effect there are: in a line where names explain them."""
    kinds = traced.families
    if kinds is None or not kinds.found:
        return
    if traced.accepted and not traced.state.background.names:
        every = (f"{family.name} {number(family.rms * factor, 3)} {unit}" for family in kinds.found)
        say(f"Kinds of effect it lacked: {listing(every, MOST_KINDS)}.")
        return
    columns = ["kind of effect", f"RMS {unit}", "evidence", f"held out {unit}", "where most"]
    rows = [
        [
            family.name,
            number(family.rms * factor, 3),
            f"{family.evidence:.0f}",
            f"{number(family.held_out_without * factor, 3)} -> {number(kinds.held_out[1] * factor, 3)}",
            listing(dict.fromkeys(place.site for place in family.places), MOST_KINDS),
        ]
        for family in kinds.found
    ]
    print_table("Kinds of effect that have no single place", columns, rows)


MOST_ADVICE = 3
"""Of what to measure next."""


@click.command(cls=options.Command)
@click.option("-o", "--output", required=True, type=options.OutputPath(), help="Traced arm.toml to write.")
@click.option("--ask", type=click.IntRange(1, MOST_ASKED), metavar="12",
              help="Write so many rows that decide what is in question to ask.csv beside the output, ask_2.csv the "
                   "second time.")  # fmt: skip
@options.settable
@click.option("--minutes", type=click.FloatRange(0.0, min_open=True), default=MOST_MINUTES,
              metavar=f"{MOST_MINUTES:g}", show_default=True,
              help="CPU time that the search may take; then it ends with what it has, and says so.")  # fmt: skip
@click.option("--halves", type=click.IntRange(1), metavar="5",
              help="Trace so many random halves of the campaign, too, and as many by parts of joint space: how "
                   "often the other half gives the same names.")  # fmt: skip
@click.option("--report", "report_path", type=options.OutputPath(), help="HTML page of what was found to write.")
@options.campaign
def command(
    arm_path: Path,
    output: Path,
    report_path: Path | None,
    ask: int | None,
    covariates: dict[str, list[float]],
    minutes: float,
    halves: int | None,
    keep: bool,
    anyway: bool,
    measured: Callable[[Arm], Measurements],
    lax: bool,
) -> int:
    """Calibrate, find the effects that explain the residual, add them, and report the errors before and after.

    Effects are selected by their posterior probability, and each is listed with its own and with what else it may be.
    Several campaigns of one machine are traced together: what they have in common is named once, and what is of one of
    them depends on the column `campaign`. An effect has a name where it is likelier than all else that it may be;
    where it is not, what it may be is listed.

    Ctrl-C, or SIGTERM, ends the search with what it has accepted: the files are written, marked unfinished, and the
    exit code is 1.
    """
    if covariates and ask is None:
        raise InputError("--covariates are values for the rows of --ask")
    outputs = Outputs(output, report_path, options.json_path())
    arm = options.declared_arm(arm_path, "trace", keep, lax)
    measurements = measured(arm)
    with enough_memory(f"{len(measurements)} rows"), _interruptible():
        traced = trace(
            arm, measurements, None, show_stage, keep, doing, anyway, ask or 0, covariates, minutes, halves or 0
        )
        show_stage("writing")
        try:
            outputs.write(traced)
        finally:  # also where it could not be written
            print_trace(traced)
            derived = derived_directions(traced.arm, measurements, traced.rows)
            show_flags((*measurements.flags, *derived, *traced.flags))
    if ask and not traced.asked:
        say("No rows are asked for: none would decide what is in question.")
    say_written(*([outputs.rows(traced)] if traced.asked else []), output, report_path)
    return int(traced.unfinished)


@contextmanager
def _interruptible() -> Iterator[None]:
    """Have SIGTERM raise `KeyboardInterrupt`, too, and SIGINT where a script's shell ignores it in the background."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {which: signal.signal(which, signal.default_int_handler) for which in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for which, handler in before.items():
            signal.signal(which, handler)


@dataclass(frozen=True)
class Outputs:
    """The files that the command writes."""

    arm: Path
    report: Path | None
    json: Path | None

    def rows(self, traced: Trace) -> Path | None:
        """Return where the rows go that were asked for, None where none were."""
        return None if traced.asked is None else self.arm.parent / f"{traced.asked.stem}.csv"

    def write(self, traced: Trace) -> None:
        """Write all of them or none.

        Raises:
            FileError: One cannot be written.
        """
        writers: list[tuple[Path | None, Callable[[Path], object]]] = [
            (self.arm, traced.write),
            (self.json, lambda path: options.write_json(as_json(traced), path)),
            (self.report, lambda path: write_report(traced, path)),
        ]
        if traced.asked is not None:
            asked = traced.asked
            writers.append((self.rows(traced), lambda path: write_plan(asked, path)))
        with together():
            for path, write in writers:
                if path is not None:
                    write(path)


def print_trace(traced: Trace) -> None:
    """Print the errors before and after, what was added, what else it may be, what is left, and what to measure."""
    held_out = traced.held_out
    figures = [
        [f"declared, {traced.calibration.placing}", traced.declared_rms, None],
        ["calibrated", traced.calibrated_rms, held_out[0]],
        ["with what was found", traced.rms, held_out[1]],
        ["stated noise", traced.noise_rms, None],
    ]
    readings = traced.state.measurements.readings
    unit, factor = SHOWN[readings.unit]
    rows = [[name, *("-" if rms is None else number(rms * factor, 3) for rms in pair)] for name, *pair in figures]
    title = f"RMS of the {readings.error_title} over {len(traced.rows)} rows"
    print_table(title, ["", f"all rows {unit}", f"poses held out {unit}"], rows)
    if at_target := traced.state.fit.view.at_target(traced.rms):
        say(at_target)
    print_campaigns(traced.campaigns, ("calibrated", "with what was found"), readings.unit)
    _print_families(traced, unit, factor)
    columns = ["added", "site", "axis", "depends on", "value ± standard uncertainty", f"held out {unit}"]
    unsettled = [effect for effect in traced.found if not effect.is_named]
    for title, effects in (("Effects identified", traced.named), ("In the arm, but not settled", unsettled)):
        if effects:
            print_table(title, columns, [row for effect in effects for row in _lines(effect, factor)])
    if traced.halves is not None:
        print_table(HALVES_TITLE, HALVES_HEAD, [half.cells for half in counted(traced.halves)])
    say(*_remarks(traced))


def _lines(effect_found: Found, factor: float) -> Iterator[list[str]]:
    """Yield one line for each value of an effect; the first one says which effect it is.

    `factor` is that of errors in the unit that they are shown in.
    """
    effect, proof = effect_found.effect, effect_found.proof
    held_out = f"{number(proof.before * factor, 3)} -> {number(proof.after * factor, 3)}"
    depends = ", ".join(effect.location.covariates) or "-"
    head = [" ".join(filter(None, names_of(effect.law))), effect.location.place, effect.location.axis or "-", depends]
    values = list(zip(effect.named.items(), units_of(effect).values(), strict=True))
    # Values of one effect that are shown on the terminal; the file holds all
    for (name, value), unit in values[:8]:
        yield [*head, f"{name} {measure(value, effect_found.std.get(name), unit)}", held_out]
        head, held_out = ["", "", "", ""], ""


def _remarks(traced: Trace) -> Iterator[str]:
    """Yield the result in sentences, as a page has it, what became of doubtful rows, and what to measure next."""
    yield headline(traced)
    signs = {effect.effect.law.words.title: effect.effect.law.words.signs for effect in traced.named}
    yield from (f"Signs of {title}: {text}." for title, text in signs.items() if text)
    for effect in traced.found:
        others = "".join(f", {share:.0%} {effect.title}" for effect, share in effect.credible[:3])
        yield f"Probability: {effect.probability:.0%} {effect.title}{numbered(effect.number)}{others}."
    if traced.outliers:
        lost, less = traced.outlier_count("lost beam"), traced.outlier_count("counted less")
        yield f"Outliers, in none of the figures: {lost} readings excluded as lost beams, {less} rows down-weighted."
    if pairs := [outlier for outlier in traced.outliers if outlier.fellow]:
        said = listing(f"{outlier.place or outlier.row} and {outlier.fellow}" for outlier in pairs[::2])
        yield f"Exchanged readings, excluded: {said}."
    if unknown := len(traced.unjudged):
        yield f"{unknown} of the rows are not in the fit: the direction of a joint is not known before it first moves."
    yield from further(traced)
    more = len(traced.next_measurement) - MOST_ADVICE
    shown = traced.next_measurement[:MOST_ADVICE] if more > 1 else traced.next_measurement
    for advice in shown:
        yield f"Next: {advice}"
    if more > 1:
        yield f"{more} further measurements are proposed in the files of --report and --json."


def as_json(traced: Trace) -> dict[str, Any]:
    """Return a trace for programs: RMS in mm, parameters SI.

    Where no length was read, what is called mm is thousandths of the unit that was, and beside it stands what is in it.
    """
    left, unit, undecided = traced.unexplained, traced.state.measurements.readings.unit, traced.undecided
    kinds = traced.families
    stages = ("calibrated", "after")
    errors = {
        "noise_rms": traced.noise_rms,
        "rms": dict(zip(("declared", *stages), (traced.declared_rms, traced.calibrated_rms, traced.rms), strict=True)),
        "held_out_rms": dict(zip(stages, traced.held_out, strict=True))
        | ({} if kinds is None else {"families": kinds.held_out[1]}),
    }
    said = {
        "format": "armflex-trace-1",
        **({} if traced.nothing is None else record(traced, "nothing")),
        **({"unfinished": True} if traced.unfinished else {}),
        **({"ended": traced.ended} if traced.ended else {}),
        "rows": len(traced.rows),
        **campaigns_json(traced.campaigns, stages),
        **{f"{name}_mm": scaled(value, 1e3) for name, value in errors.items()},
        **({} if unit == "m" else errors | {"unit": unit}),
        "effects": [_effect_json(effect) for effect in traced.found]
        or [
            place_json(accepted.law, accepted.location) | {"parameters": _values_json(accepted, std)}
            for accepted, std in traced.accepted
        ],
        "unexplained": left
        and record(left, "axis std unit")
        | {"site": left.site and left.site.removeprefix(LINK), "rms_mm": left.rms * 1e3, "covariates": []},
        "not_identifiable": [record(hidden, "effect site reason") for hidden in traced.not_identifiable],
        **record(traced, "next_measurement", noise_over_stated="noise"),
        "smallest_shown_mm": {
            smallest.effect: scaled(record(smallest, "least most"), 1e3) for smallest in traced.smallest
        },
        "outliers": [
            outlier_json(outlier)
            | {"error_mm": outlier.error_m * 1e3, "kind": outlier.kind}
            | ({} if unit == "m" else {"error": outlier.error_m, "unit": unit})
            for outlier in traced.outliers
        ],
        "flags": traced.flags,
        "held_out_chosen_again_rms_mm": traced.compared and _before_after(traced.compared, stages),
        "held_out_is_of": HELD_OUT_IS_OF if traced.compared is not None else "nothing was chosen",
        "families": [] if kinds is None else [_family_json(family, kinds) for family in kinds.found],
        "undecided": undecided
        and record(undecided, "poses likeliest") | {"rms_mm": undecided.rms * 1e3, "stated_mm": undecided.stated * 1e3},
        "nuisances": [] if kinds is None else list(_nuisances_json(kinds)),
        "suspects": _credible_json(traced.suspects),
        **({} if traced.halves is None else {"halves": [_half_json(half) for half in traced.halves]}),
        "resampled": traced.resampled and record(traced.resampled, "by mismatch"),
    }
    return plain(said)


def _nuisances_json(kinds: Families) -> Iterator[dict[str, Any]]:
    """Yield what wanders in time: it has a size and no cause, and nobody can predict it."""
    for family in kinds.found:
        if family.name.startswith("wandering"):
            chance = 1.0 / (1.0 + np.exp(-family.evidence))
            for place in family.places:
                said = record(place, "site axis", rms_m="rms") | {"session": None, "probability": chance}
                yield {"kind": "drift", "size": {"value": place.rms, "std": None, "unit": "m"}} | said


def _half_json(half: Replicated) -> dict[str, Any]:
    said = record(half, "split half probability probability_there in_other_half numbers_agree")
    return place_json(half.effect.law, half.effect.location) | said


def _family_json(family: FamilyFound, kinds: Families) -> dict[str, Any]:
    return {
        "family": family.name,
        **record(family, "evidence", rms_m="rms"),
        "held_out_rms_mm": scaled({"before": family.held_out_without, "after": kinds.held_out[1]}, 1e3),
        "places": [record(place, "site axis", rms_m="rms") for place in family.places],
    }


def _effect_json(named: Found) -> dict[str, Any]:
    effect, proof = named.effect, named.proof
    credible = ((effect, named.probability), *named.credible)
    return {
        **place_json(effect.law, effect.location),
        "parameters": _values_json(effect, named.std),
        "held_out_rms_mm": _before_after(proof),
        "equivalent": [place_json(alike.law, alike.location) for alike, _ in named.equivalent],
        "held_out_sessions_rms_mm": scaled(record(proof, before="sessions_before", after="sessions_after"), 1e3),
        "credible": _credible_json(credible),
        **record(named, "probability evidence determined", named="is_named"),
    }


def _credible_json(effects: Iterable[tuple[Effect, float]]) -> list[dict[str, Any]]:
    return [place_json(effect.law, effect.location) | {"probability": chance} for effect, chance in effects]


def _before_after(proof: Any, names: tuple[str, str] = ("before", "after")) -> dict[str, float]:
    return {name: 1e3 * rms for name, rms in zip(names, (proof.before, proof.after), strict=True)}


def _values_json(effect: Effect, stds: Mapping[str, float]) -> dict[str, Any]:
    """Return every value with its standard uncertainty, infinite where nothing determines it."""
    return {
        name: {"value": value, "std": stds.get(name), "unit": unit}
        for (name, value), unit in zip(effect.named.items(), units_of(effect).values(), strict=True)
    }
