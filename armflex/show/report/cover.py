"""What the pages of a calibrated and of a traced arm share: the cover sheet, points, parameters, and what all rests on.

The cover is one printed sheet: what was found, how large the error is, from which campaign by which instrument.
"""

from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np

from armflex.arm import Arm
from armflex.conventions import TWIST_NAMES, Array, Shown
from armflex.estimate import Calibration
from armflex.estimate.held_out import held_out, pose_folds
from armflex.estimate.identify import FittedParameter
from armflex.estimate.view import View
from armflex.export.sheet import joint_zeros
from armflex.files.dh_table import in_dh_words
from armflex.measured.measurements import Measurements
from armflex.parameters import FRAMES, ParameterKind
from armflex.readings import Position, Readings
from armflex.show.report.accuracy import Errors, scatter_rms
from armflex.show.report.swing import swing
from armflex.show.report.words import MADE_WITH, measure, millimetres, short, with_std

Table = tuple[tuple[str, ...], ...]


MARKED = 0.95
"""Share of the points up to which an error is not marked."""

ON_COVER = 12
"""Rows of a table on the cover that leave it one sheet."""

STIFF = {"d": "N/m", "r": "Nm/rad"}
LARGER = ((1e9, "G"), (1e6, "M"), (1e3, "k"), (1.0, ""))


class MarkedPoint(NamedTuple):
    """A row of the table of points: its cells, and whether it is among the worst."""

    cells: tuple[str, ...]
    worst: bool


def spread(name: str, errors: Errors, unit: str | Shown = "m") -> tuple[str, ...]:
    """Return a row: name, RMS with its standard uncertainty, what 95 % are below, and the largest error."""
    if not len(errors.squares):
        return (name, "–", "–", "–")
    sizes = np.sqrt(errors.squares)
    return (
        name,
        millimetres(errors.rms, errors.std, unit),
        millimetres(float(np.quantile(sizes, MARKED)), unit=unit),
        millimetres(float(sizes.max()), unit=unit),
    )


def errors_of(view: View, groups: np.ndarray, judged: np.ndarray) -> Errors:
    """Return the errors of a view's rows in the foremost of (M, d) numbers [m], from the (M,) pose of each."""
    return Errors(view.readings.where(judged).row_squares(view.residual), groups)


def size_title(readings: Readings) -> str:
    """Return what errors are sizes of, for a card: in 3-D, or of which instruments."""
    title = readings.error_title
    return "RMS in 3-D" if readings.of(Position) else f"RMS of a reading ({title.partition('error of ')[2]})"


def error_title(readings: Readings) -> str:
    """Return the heading over a page's table of errors."""
    return "Error in 3-D" if readings.of(Position) else "Error of a reading"


def facts(arm: Arm, measurements: Measurements, readings: str) -> Table:
    """Return what a result rests on: arm, campaign, date, instrument, versions."""
    file = measurements.places[0].file.name if measurements.places else "not from a file"
    columns = (measurements.pose_number.tolist(), measurements.payload, measurements.session)
    counts = ", ".join(
        f"{len(set(column))} {name}" for column, name in zip(columns, ("poses", "payloads", "sessions"), strict=True)
    )
    return (
        ("Arm", f"{arm.robot.urdf.name}, {arm.robot.base} to {arm.robot.tip}"),
        ("Campaign", f"{file}; {counts}"),
        ("Date of the campaign", dates(measurements)),
        ("Instruments", "; ".join(instruments(measurements)) or "none"),
        ("Readings used", readings),
        ("SHA-256 of the campaign", measurements.sha256 or "–"),
        ("Made with", MADE_WITH),
    )


def dates(measurements: Measurements) -> str:
    """Return the first and last day that the times or a text column of the campaign name, ISO 8601."""
    days = [date[:10] for date in measurements.dates] or sorted(
        cell[:10]
        for values in measurements.covariates.values()
        if not isinstance(values, np.ndarray)
        for cell in values
        if len(cell) >= 10 and cell[:4].isdigit() and cell[4] == cell[7] == "-"
    )
    if not days:
        return "not recorded (a column time or date, as 2026-03-09, says it)"
    return days[0] if days[0] == days[-1] else f"{days[0]} to {days[-1]}"


def instruments(measurements: Measurements) -> list[str]:
    """Return every kind of reading: its title, in how many rows, and its stated standard deviation."""
    said = []
    for kind in measurements.readings.kinds:
        read = np.isfinite(kind.sigma).any(axis=1) & measurements.measured
        if read.any():
            name, factor = kind.shown_in
            size = float(np.median(kind.sigma[np.isfinite(kind.sigma)])) * factor
            said.append(f"{kind.title}, {int(read.sum())} rows, stated σ {short(size)} {name}".replace(" 1,", ","))
    return said


def points(measurements: Measurements, rows: np.ndarray, now: Errors, before: Errors, left: Array) -> list[MarkedPoint]:
    """Return the points, worst first, by the columns of `POINT_HEAD`.

    Args:
        measurements: The campaign.
        rows: (M,) numbers of its rows.
        now, before: Their errors, held out.
        left: (M, 3) fitted residual [m].
    """
    sizes, old = np.sqrt(now.squares), np.sqrt(before.squares)
    if not len(sizes):
        return []
    limit, largest = float(np.quantile(sizes, MARKED)), []
    # Points that a page has room for
    for i in np.argsort(-sizes, kind="stable")[:2000].tolist():
        row = int(rows[i])
        place = measurements.places[row].short if measurements.places else f"row {row}"
        named = (measurements.pose[row], measurements.session[row], measurements.payload[row])
        lengths = (
            millimetres(length).removesuffix(" mm") for length in (float(old[i]), float(sizes[i]), *left[i].tolist())
        )
        largest.append(MarkedPoint((place, *named, *lengths), bool(sizes[i] > limit)))
    return largest


POINT_HEAD = ("row", "pose", "session", "payload", "before mm", "now mm", "Δx", "Δy", "Δz")


def signed(value: float, std: float | None, unit: str) -> str:
    """Return a `measure` with its sign, also where that is a plus."""
    text = measure(value, std, unit)
    if value <= 0.0 or text.startswith("0 "):
        return text
    return f"(+{text[1:]}" if text[0] == "(" else f"+{text}"


def parameter_rows(arm: Arm, fitted: Sequence[FittedParameter]) -> Table:
    """Return what was fitted of the arm itself: name, change against the declared value, and what it is now.

    A compliance changes by a factor; what it is now is said as a stiffness, of the axis by itself.
    """
    rows, words = [], in_dh_words(arm.robot)
    for parameter in fitted:
        if parameter.kind in (*FRAMES, ParameterKind.LAW, ParameterKind.EFFECT, ParameterKind.UNEXPLAINED):
            continue
        name, change = changed(parameter, words)
        if not parameter.determined:
            rows.append((name, "not determined by these readings", ""))
        else:
            rows.append((name, change, stiffness(arm, parameter) if parameter.kind is ParameterKind.COMPLIANCE else ""))
    return tuple(rows)


def changed(parameter: FittedParameter, words: Mapping[str, tuple[str, float]]) -> tuple[str, str]:
    """Return a parameter's name, see `in_dh_words`, and its change: '×1.50 ± 0.03' of a compliance, else a length or
    an angle with its sign.
    """
    name, sign = words.get(parameter.name, (parameter.name, 1.0))
    if parameter.kind is not ParameterKind.COMPLIANCE:
        return name, signed(sign * parameter.value, parameter.std, parameter.unit)
    factor = float(np.exp(parameter.value))
    return name, f"×{with_std(factor, factor * parameter.std)}"


def reasons(arm: Arm, fitted: Sequence[FittedParameter]) -> Table:
    """Return the names of parameters, and why the readings do not determine them."""
    called = {name: word for name, (word, _) in in_dh_words(arm.robot).items()}
    return tuple((called.get(parameter.name, parameter.name), parameter.reason(called)) for parameter in fitted)


def stiffness(arm: Arm, parameter: FittedParameter) -> str:
    """Return a fitted compliance as a stiffness people know, '' where the flexure's law has no one number for it."""
    axis = parameter.label.rpartition(" ")[2]
    law = next((flexure.law for flexure in arm.flexures if flexure.name == parameter.which.group.of), None)
    compliance = getattr(law, "compliance", None)
    if axis not in TWIST_NAMES or not isinstance(compliance, np.ndarray) or compliance.shape != (6, 6):
        return ""
    place = TWIST_NAMES.index(axis)
    value = float(compliance[place, place])
    if value <= 0.0:
        return "rigid"
    factor, prefix = next(((size, prefix) for size, prefix in LARGER if 1.0 / value >= size), (1.0, ""))
    std = parameter.std / value / factor
    return f"{with_std(1.0 / value / factor, std)} {prefix}{STIFF[axis[0]]}"


def zero_rows(arm: Arm) -> Table:
    """Return joint, and what is added to the controller's reading, where offsets or frames of joints were fitted."""
    kinds = {group.kind for group in arm.certainty.groups} if arm.certainty is not None else set[ParameterKind]()
    if kinds.isdisjoint((ParameterKind.OFFSET, ParameterKind.GEOMETRY)):
        return ()
    return tuple(
        (joint, signed(value, std, unit) if np.isfinite(std) else "not determined")
        for joint, (value, std, unit) in joint_zeros(arm).items()
    )


def account(calibration: Calibration) -> SimpleNamespace:
    """Return what the page of a calibrated arm shows."""
    fit, measurements = calibration.fit, calibration.measurements
    view, judged = fit.view, calibration.judged
    used = view.readings.where(judged).foremost_count > 0
    groups, rows = measurements.pose_number[view.rows], view.rows[used]
    before = errors_of(calibration.placed, groups, judged).of(used)
    several = len(np.unique(groups)) > 1
    now = (
        Errors(held_out(fit, pose_folds(groups), judged=judged).squares, groups).of(used)
        if several
        else errors_of(view, groups, judged).of(used)
    )
    placed = bool(view.readings.of(Position))
    left = view.residual[:, view.foremost][used] if placed else np.zeros((len(rows), 0))
    moved = sorted(calibration.findings, key=lambda finding: -abs(finding.pull))
    judgeable = [found for found in calibration.parameters if found.determined and np.isfinite(found.prior)]
    determined = [found for found in judgeable if found.kind not in FRAMES]
    most = moved or sorted(determined, key=lambda parameter: -abs(parameter.pull))[: ON_COVER - 4]
    rms = (millimetres(errors.rms, unit=view.readings.shown_in) for errors in (before, now))
    title = view.readings.error_title
    what = "poses held out" if several else "the poses fitted"
    return SimpleNamespace(
        title=f"{calibration.arm.robot.urdf.name}: calibration",
        headline=f"{title[0].upper()}{title[1:]}: {next(rms)} as declared, {next(rms)} calibrated (RMS, {what}).",
        error_title=error_title(view.readings),
        lead=f"{len(moved)} parameters were further from their declared values than their priors allow."
        if moved
        else "No parameter ended further from its declared value than its prior allows.",
        at_target=view.at_target(now.rms),
        cards=_cards(before, now, calibration),
        errors=(
            spread(f"as declared, the {calibration.placing}", before, view.readings.shown_in),
            spread(f"calibrated, {what}", now, view.readings.shown_in),
            ("noise as stated", millimetres(calibration.noise_rms, unit=view.readings.shown_in), "", ""),
        ),
        found=parameter_rows(calibration.arm, most)[:ON_COVER],
        found_title="Moved beyond their priors" if moved else "Moved most, against their priors",
        parameters=parameter_rows(calibration.arm, calibration.parameters),
        zeros=zero_rows(calibration.arm),
        points=points(measurements, rows, now, before, left) if placed else [],
        point_head=POINT_HEAD,
        undetermined=reasons(calibration.arm, calibration.undetermined),
        by_kind=tuple(
            (kind.title, *(f"{short(size * kind.shown_in[1])} {kind.shown_in[0]}" for size in sizes))
            for kind, *sizes in calibration.by_kind
        ),
        swing=swing(calibration.arm, measurements, rows),
        campaign=facts(calibration.arm, measurements, f"{len(rows)} of {len(measurements)} rows"),
        flags=[flag.text for flag in (*calibration.arm.flags, *measurements.flags, *calibration.flags)],
    )


def floor(stated: float, error: float) -> str:
    """Return what the stated noise is to an error, for a card."""
    return "more than the readings scatter" if error < stated else "what no model can get below"


def _cards(before: Errors, now: Errors, calibration: Calibration) -> Table:
    from armflex.measured.repeats import repeats

    unit, size = calibration.fit.view.readings.shown_in, size_title(calibration.fit.view.readings)
    cards = [
        ("Error as declared", millimetres(before.rms, before.std, unit), f"{size}, the {calibration.placing}"),
        ("Error calibrated", millimetres(now.rms, now.std, unit), "the same readings, poses held out"),
        ("Noise as stated", millimetres(calibration.noise_rms, unit=unit), floor(calibration.noise_rms, now.rms)),
    ]
    if calibration.fit.view.readings.of(Position) and (again := repeats(calibration.measurements)) is not None:
        scatter = again.same_approach or again.same_session
        cards.append(("Scatter of repeats", millimetres(*scatter_rms(scatter)), f"{scatter.groups} sets"))
    return tuple(cards)
