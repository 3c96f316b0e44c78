"""Everything that the page shows, as text and tables; figures come as finished SVG."""

from collections.abc import Callable, Iterator
from functools import partial
from types import SimpleNamespace

import numpy as np

from armflex.estimate.identify import parameters
from armflex.files.dh_table import in_dh_words
from armflex.parameters import ParameterKind
from armflex.readings import Position
from armflex.show.report import cover, effect_figures, figures, summary
from armflex.show.report.accuracy import Accuracy, accuracy, scatter_rms
from armflex.show.report.swing import swing
from armflex.show.report.words import called, labelled, measure, millimetres, short, site_words, units_of, words
from armflex.trace.findings import HELD_OUT_IS_OF, Trace
from armflex.trace.halves import counted
from armflex.trace.projection import project
from armflex.trace.unrecorded import localise
from armflex.version import __version__

Table = tuple[tuple[str, ...], ...]


def account(trace: Trace) -> SimpleNamespace:
    """Return what the template shows of a trace: plain texts, which it escapes, tables of them, and figures as SVG."""
    accurate = accuracy(trace)
    placed, view = bool(trace.state.fit.view.readings.of(Position)), trace.state.fit.view
    left_over = view.residual[trace.judged_rows][:, view.foremost]
    used = f"{len(trace.rows)} of {len(trace.state.measurements)} rows driven"
    if trace.outliers:
        less = trace.outlier_count("counted less")
        out = len(trace.outliers) - less
        used += f"; outliers: {out} excluded from the fit, {less} counted less; the errors on this page are "
        used += "without them"
    left = localise(trace.state.fit, trace.state.context, project(trace.state.fit), trace.state.groups)
    return SimpleNamespace(
        title=f"{trace.arm.robot.urdf.name}: calibration and effects identified",
        headline=summary.headline(trace),
        lead=summary.accuracy_sentence(accurate, trace),
        at_target=view.at_target(accurate.after.rms),
        errors=_errors(trace, accurate),
        error_title=cover.error_title(view.readings),
        found=tuple(
            row for index, effect in enumerate(trace.found) if effect.is_named for row in _values(trace, index)
        )[: cover.ON_COVER],
        found_title="Effects identified",
        points=cover.points(trace.state.measurements, trace.rows, accurate.after, accurate.before, left_over)
        if placed
        else [],
        point_head=cover.POINT_HEAD,
        further=[*summary.further(trace), *(() if trace.compared is None else (HELD_OUT_IS_OF,))],
        cards=_cards(trace, accurate),
        campaign=cover.facts(trace.arm, trace.state.measurements, used),
        families=_families(trace),
        numbers=_numbers(trace, accurate),
        halves=[half.cells for half in counted(trace.halves or ())],
        halves_head=summary.HALVES_HEAD,
        size=_errors_of(trace)[1],
        workspace=figures.workspace(trace) if trace.state.measurements.positioned.any() else "",
        instruments=figures.by_instrument(trace),
        sessions=figures.by_session_and_pose(accurate, bool(trace.found), view.readings.shown_in),
        effects=[_effect(trace, index) for index in range(len(trace.found))],
        heat=figures.heat(trace, left),
        left=summary.left(trace.unexplained, view.readings) if trace.unexplained else "",
        parameters=_parameters(trace),
        zeros=cover.zero_rows(trace.arm),
        hidden=_hidden(trace),
        detectable=figures.detectable(trace.smallest, accurate.stated, view.readings) if trace.smallest else "",
        outliers=tuple(_outliers(trace)),
        swing=swing(trace.arm, trace.state.measurements, trace.rows),
        flags=[flag.text for flag in (*trace.arm.flags, *trace.state.measurements.flags)],
        next_measurement=trace.next_measurement,
        unfinished=trace.unfinished,
        ended=trace.ended,
        version=__version__,
    )


def _outliers(trace: Trace) -> Iterator[tuple[str, ...]]:
    """Yield where the first outliers are, how far off, and what they are."""
    measurements = trace.state.measurements
    # Rows of a list of outliers or parameters
    for outlier in trace.outliers[:20]:
        place = measurements.places[outlier.row].short if measurements.places else f"row {outlier.row}"
        kind = f"{outlier.kind} with {outlier.fellow}" if outlier.fellow else outlier.kind
        yield place, measurements.pose[outlier.row], millimetres(outlier.error_m, unit=outlier.shown_in), kind


def _parameters(trace: Trace) -> SimpleNamespace:
    """Return what became of declared parameters whose prior says how far they may move."""
    shown_elsewhere = (ParameterKind.EFFECT, ParameterKind.UNEXPLAINED)
    before, after = (
        [
            parameter
            for parameter in parameters(fit)
            if np.isfinite(parameter.prior) and parameter.kind not in shown_elsewhere
        ]
        for fit in (trace.before, trace.state.fit)
    )
    called_in = in_dh_words(trace.arm.robot)
    return SimpleNamespace(
        all=cover.parameter_rows(trace.arm, parameters(trace.state.fit)),
        pulls=figures.pulls(before, after, bool(trace.found), called_in) if after else "",
        moved=tuple(
            (
                *cover.changed(parameter, called_in),
                f"{100.0 * parameter.prior:.3g} %"
                if parameter.kind is ParameterKind.COMPLIANCE
                else measure(parameter.prior, None, parameter.unit),
                f"{abs(parameter.pull):.1f}",
            )
            for parameter in after
            if parameter.surprising
        ),
        undetermined=cover.reasons(trace.arm, [parameter for parameter in after if not parameter.determined]),
    )


def _cards(trace: Trace, accurate: Accuracy) -> Table:
    said, size = _errors_of(trace)
    before, after = (said(errors.rms, errors.std) for errors in (accurate.before, accurate.after))
    cards = [("Error before", before, f"{size}, calibrated arm, poses held out")]
    cards.append(("Error now", after, "the same poses, effects added"))
    if not trace.found:
        cards = [("Error", after, f"{size}, calibrated arm, poses held out")]
    cards.append(("Noise as stated", said(accurate.stated), cover.floor(accurate.stated, accurate.after.rms)))
    if accurate.again is not None:
        size, std = scatter_rms(accurate.again)
        sets = f"{accurate.again.groups} sets; what changed meanwhile included"
        cards.append(("Scatter of repeats", millimetres(size, std), sets))
    return tuple(cards)


def _errors_of(trace: Trace) -> tuple[Callable[..., str], str]:
    """Return how errors of the foremost readings are said, each as `millimetres` says a length, and what they are."""
    readings = trace.state.fit.view.readings
    return partial(millimetres, unit=readings.shown_in), cover.size_title(readings)


def _errors(trace: Trace, accurate: Accuracy) -> Table:
    """Return RMS, 95 % and largest error: as declared, calibrated, and with what was found."""
    placed = trace.calibration.placed
    groups = trace.state.measurements.pose_number[placed.rows]
    judged = np.zeros(placed.residual.shape, dtype=bool)
    judged[np.isin(placed.rows, trace.rows)] = trace.state.judged[trace.judged_rows]
    declared = cover.errors_of(placed, groups, judged).of(np.asarray(judged.any(axis=1)))
    unit = placed.readings.shown_in
    rows = [cover.spread(f"as declared, the {trace.calibration.placing}", declared, unit)]
    rows.append(cover.spread("calibrated, poses held out", accurate.before, unit))
    if trace.found or trace.common:
        rows.append(cover.spread("with the effects identified, poses held out", accurate.after, unit))
    return (*rows, ("noise as stated", millimetres(accurate.stated, unit=unit), "", ""))


def _values(trace: Trace, index: int) -> Table:
    """Return an effect's values, a row each, the first with its name: signed, and waves by amplitude and phase."""
    effect = trace.found[index]
    units, heading = units_of(effect.effect), called(effect.effect, effect.number)
    wave = effect_figures.wave(trace, index)
    named = effect.effect.named.items()
    rows = wave or [f"{name} = {cover.signed(value, effect.std.get(name), units[name])}" for name, value in named]
    return tuple((heading if i == 0 else "", row) for i, row in enumerate(rows[:4]))


def _numbers(trace: Trace, accurate: Accuracy) -> Table:
    """Return name, before and after of every error there is; where nothing was found, name and value."""
    effects, said = trace.found, _errors_of(trace)[0]
    sessions = trace.held_out_sessions or (None, None)
    again = (None, None) if trace.compared is None else (trace.compared.before, trace.compared.after)
    rows = [
        ("Poses held out", *(said(errors.rms, errors.std) for errors in (accurate.before, accurate.after))),
        ("Poses held out, effects chosen without them", *(said(errors) for errors in again)),
        ("Whole sessions held out", *(said(errors) for errors in sessions)),
        ("Readings that were fitted", *(said(errors) for errors in accurate.fitted)),
        (f"As declared, only the {trace.calibration.placing} ", said(trace.declared_rms), ""),
        ("Noise as stated", "", said(accurate.stated)),
        ("Noise, if the final residual is nothing else", "", said(trace.noise * accurate.stated)),
    ]
    if accurate.again is not None:
        rows.append(("Scatter of repeats", "", millimetres(*scatter_rms(accurate.again))))
    kept = [row for row in rows if row[1:] != ("–", "–")]
    return tuple(kept) if effects else tuple((row[0], row[2] or row[1]) for row in kept)


def _families(trace: Trace) -> Table:
    """Return kind, size, evidence, error on held-out poses without it and with all, and where it does most."""
    kinds, said = trace.families, _errors_of(trace)[0]
    if kinds is None:
        return ()
    # Places of a kind of effect that are listed
    return tuple(
        (
            family.name,
            said(family.rms),
            f"{family.evidence:.0f}",
            f"{said(family.held_out_without)} → {said(kinds.held_out[1])}",
            ", ".join(f"{place.site} {place.axis} {said(place.rms)}" for place in family.places[:3]),
        )
        for family in kinds.found
    )


def _effect(trace: Trace, index: int) -> SimpleNamespace:
    effect, say = trace.found[index], _errors_of(trace)[0]
    heading, proof, units = called(effect.effect, effect.number), effect.proof, units_of(effect.effect)
    std = {name: sigma for name, sigma in effect.std.items() if np.isfinite(sigma)}
    said = {name: "" if name in std else "not determined" for name in effect.std}
    held_out = [("Poses held out", say(proof.before), say(proof.after))]
    if proof.sessions_before is not None:
        sessions = (say(proof.sessions_before), say(proof.sessions_after))
        held_out.append(("Whole sessions held out", *sessions))
    heading = heading if effect.is_named else f"not settled: {heading}"
    return SimpleNamespace(
        heading=heading[0].upper() + heading[1:],
        name=labelled(effect.effect, effect.number),
        words=words(effect.effect.law.name),
        values=(
            *(
                (text.partition(" = ")[0], text.partition(" = ")[2], "of both")
                for text in effect_figures.wave(trace, index)
            ),
            *(
                (name, cover.signed(value, std.get(name), units[name]), said.get(name, "chosen, not fitted"))
                for name, value in effect.effect.named.items()
            ),
        ),
        sure=summary.sure(effect),
        proof=tuple(held_out),
        equivalent=tuple((called(effect), labelled(effect), short(less)) for effect, less in effect.equivalent),
        against=effect_figures.against_suspect(trace, index),
        ranking=effect_figures.ranking(effect, index + 1),
        posterior=effect_figures.posterior(trace, index),
    )


def _hidden(trace: Trace) -> Table:
    """Return laws that were not identifiable: where fitted parameters hide them, and where they move nothing."""
    added = {(effect.effect.law.name, effect.effect.location.place) for effect in trace.found}
    rows: dict[str, tuple[list[str], list[str]]] = {}
    called_in = in_dh_words(trace.arm.robot)
    for hidden in trace.not_identifiable:
        if (hidden.effect, hidden.site) in added:
            continue  # hidden by itself
        place = site_words(hidden.site)
        partner = "" if hidden.partner is None else hidden.partner.label
        named = f"{place} ({called_in.get(partner, (partner,))[0]})" if partner else place
        rows.setdefault(hidden.effect, ([], []))[hidden.partner is None].append(named)
    return tuple((words(law).title, "; ".join(taken), ", ".join(still)) for law, (taken, still) in rows.items())
