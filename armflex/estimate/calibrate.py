"""`calibrate`: everything that [prior] frees, fitted to a campaign through the deflected arm."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from armflex.arguments import checked_kinds
from armflex.arm import Arm, Setup
from armflex.conventions import RESOLUTION, TWIST_NAMES, Shown, row_numbers, said_of
from armflex.errors import ArmflexError, ConventionError, Flag, InputError, UnsupportedError, listing, naming
from armflex.estimate.block import Block, law_block, parameters_of
from armflex.estimate.blocks import declared_blocks, sensor_start
from armflex.estimate.coupled_axes import coupled_axes
from armflex.estimate.fit import Fit, WeighedReadings, fit, realise
from armflex.estimate.held_out import (
    POSE_FOLDS,
    OfCampaign,
    by_campaign,
    campaigns_json,
    held_out,
    judged_by,
    near,
    pose_folds,
)
from armflex.estimate.identify import UNDETERMINED, FittedParameter, below_zero, parameters
from armflex.estimate.learn import fit_learning, with_posteriors
from armflex.estimate.misread import check_conventions, check_scatter, wrong_sigma
from armflex.estimate.misreadings import USUAL_PRIOR
from armflex.estimate.outliers import DOUBTED, Outlier, fit_without_lost, outlier_json, outliers_of
from armflex.estimate.placement import FEWEST_ROWS, check_enough, first_guess
from armflex.estimate.pose_block import PoseBlock
from armflex.estimate.posterior import certainty_of
from armflex.estimate.robust import ROWS_AT_ONCE, instrument_weights
from armflex.estimate.view import View, foremost_rms, look
from armflex.files.arm_file import write_arm
from armflex.files.calibration_table import Campaign
from armflex.laws.declared import soft
from armflex.laws.effects.catalogue import CATALOGUE
from armflex.laws.effects.effect import Act
from armflex.laws.effects.in_arm import about_time, derived_directions, without_direction
from armflex.laws.law import anywhere
from armflex.laws.learned import Seen
from armflex.measured.campaign_clock import on_its_clock
from armflex.measured.data_flags import check_joint_units
from armflex.measured.joined import as_campaign
from armflex.measured.measurements import Measurements
from armflex.measured.table import Tabular
from armflex.parameters import FRAMES, OF_SESSION, ArmParameter, ParameterGroup, ParameterKind, beyond_priors
from armflex.progress import Progress
from armflex.readings import Kind
from armflex.readings.instrument import ROUNDS
from armflex.result import Result, record, scaled
from armflex.robot.urdf import drive_of


@dataclass(frozen=True, repr=False, eq=False)
class Calibration(Result):
    """A calibrated arm and an account of it.

    Attributes:
        arm: The arm with its fitted compliances and corrections, and the instrument that saw it.
        fit: The fit itself: values, covariance, residuals.
        placed: The rows as the declared arm explains them, only the instrument's frame fitted (of several campaigns, in
            each), and where the target is on the tool if [prior] frees that.
        measurements: The campaign.
        flags: Flags: directions that the order of the rows stood in for, a search for learned laws that did not
            settle, an arm that predicts worse than the declared one.
        held_out: RMS of the 3-D error on held-out poses, of the declared arm so `placed` and of the calibrated one [m];
            None where there are too few poses.
        scattered: The fit in which each joint stands off at random in every pose, None where none does.
    """

    ROWS = "fitted"

    arm: Arm
    fit: Fit
    placed: View
    measurements: Measurements
    flags: tuple[Flag, ...] = ()
    held_out: tuple[float, float] | None = None
    scattered: Fit | None = None

    def content(self) -> dict[str, Any]:
        """Return the calibration with RMS in mm, like that of a trace.

        Where no length was read these are null, and beside them stands what is in the unit that was.
        """
        unit, stages = self.fit.view.readings.unit, ("declared", "calibrated")
        errors = {"noise_rms": self.noise_rms, "rms": dict(zip(stages, (self.declared_rms, self.rms), strict=True))}
        errors["held_out_rms"] = self.held_out and dict(zip(stages, self.held_out, strict=True))
        instruments = [
            record(kind, "name unit")
            | {"kind": type(kind).__name__.lower(), "rows": np.isfinite(kind.sigma).any(axis=1).sum()}
            | {"rms": dict(zip(stages, sizes, strict=True)), "noise_rms": noise}
            for kind, *sizes, noise in self.by_kind
        ]
        return {
            "format": "armflex-calibrate-1",
            "rows": len(self.fit.view.rows),
            "noise_over_stated": self.scatter,
            **{f"{name}_mm": scaled(value, 1e3) if unit == "m" else None for name, value in errors.items()},
            **({} if unit == "m" else errors | {"unit": unit}),
            **campaigns_json(self.campaigns, stages),
            **({"instruments": instruments} if self.arm.sensors else {}),
            "parameters": [
                record(p, "name value std unit prior determined")
                | {"only_combined_with": p.trades_against if p.combined else None}
                for p in self.parameters
            ],
            "findings": [p.name for p in self.findings],
            "not_identifiable": [record(p, "trades_against", parameter="name") for p in self.undetermined],
            "flags": self.flags,
            "outliers": [
                outlier_json(o)
                | ({"error_mm": o.error_m * 1e3} if o.unit == "m" else record(o, "unit", error="error_m"))
                for o in self.outliers
            ],
        }

    @property
    def fitted(self) -> list[dict[str, Any]]:
        """What was fitted, a row each: deviation from the declared value, standard uncertainty, prior.

        A joint's zero and the turn of its frame about the joint's own axis are one number: the readings depend on their
        sum alone, which is the zero's row.
        """
        named = ("name", "value", "std", "unit", "prior", "determined")
        rows = {parameter.which: {name: getattr(parameter, name) for name in named} for parameter in self.parameters}
        for joint in self.arm.robot.moving:
            drive, unit = drive_of(joint), "m" if joint.kind == "prismatic" else "rad"
            axis = int(np.abs(drive).argmax())
            zero = ArmParameter(ParameterGroup(ParameterKind.OFFSET, joint.name), unit=unit)
            turn = ArmParameter(ParameterGroup(ParameterKind.GEOMETRY, joint.name), TWIST_NAMES[axis], unit)
            covariance = self.arm.certainty and self.arm.certainty.among((zero, turn))
            if covariance is None or abs(drive[axis]) < 1.0 - RESOLUTION or not {zero, turn} <= rows.keys():
                continue
            both = np.array([1.0, drive[axis]])
            std, row, other = float(np.sqrt(both @ covariance @ both)), rows[zero], rows.pop(turn)
            prior = float(np.hypot(row["prior"], other["prior"]))
            row |= {"value": row["value"] + float(drive[axis]) * other["value"], "std": std, "prior": prior}
            row["determined"] = std < UNDETERMINED * prior
        return list(rows.values())

    @cached_property
    def judged(self) -> np.ndarray:
        """(M, d) readings that every error is over: those that the arm as declared or as calibrated comes near."""
        return near(self.placed, self.fit.view, (self.scattered or self.fit).view)

    @cached_property
    def campaigns(self) -> tuple[OfCampaign, ...]:
        """Errors of each of several campaigns, of the declared arm, placed, and of the calibrated one."""
        return by_campaign(self.placed, self.fit, self.judged)

    @property
    def left_out(self) -> int:
        """How many rows hold a reading that is in no figure, as it is far off."""
        return int((np.isfinite(self.fit.view.sigma) & ~self.judged).any(axis=1).sum())

    @property
    def declared_rms(self) -> float:
        """RMS of the 3-D position error of the declared arm, `placed` [m]."""
        return foremost_rms(self.placed.readings.where(self.judged), self.placed.residual)

    @property
    def placing(self) -> str:
        """What of the declared arm was fitted for `declared_rms`, in words."""
        target = any(block.kind is ParameterKind.TOOL for block in self.fit.blocks)
        return "instrument and target placed" if target else "instrument placed"

    @property
    def noise_rms(self) -> float:
        """What the stated standard deviations alone would give [m]."""
        return foremost_rms(self.placed.readings.where(self.judged), self.placed.sigma)

    @property
    def rms(self) -> float:
        """RMS of the 3-D position error after calibration [m]."""
        return foremost_rms(self.fit.view.readings.where(self.judged), self.fit.view.residual)

    @property
    def by_kind(self) -> tuple[tuple[Kind, float, float, float], ...]:
        """Every kind of readings with its RMS in its unit: as declared, calibrated, and what the stated noise gives."""
        view, placed = self.fit.view, self.placed
        now, before = view.readings.where(self.judged), placed.readings.where(self.judged)
        parts = before.by_kind(placed.residual), now.by_kind(view.residual), now.by_kind(self.fit.stated)
        return tuple((kind[0], kind[1], two[1], three[1]) for kind, two, three in zip(*parts, strict=True))

    @property
    def weighed(self) -> float:
        """Largest factor on an instrument's stated noise in the fit: 1, more where its readings scatter more."""
        return max(self.fit.factors, default=1.0)

    @property
    def scatter(self) -> float:
        """Standard deviation of the readings over the stated one, if what is left of them is nothing else.

        Of several instruments it is the RMS of their own.
        """
        if len(self.fit.scatters) == 1:
            return self.fit.scatters[0]
        squares, freedom = np.square(self.fit.scatters), [freedom for _, freedom in self.fit.noises]
        return float(np.sqrt(np.average(squares, weights=freedom)))

    @cached_property
    def parameters(self) -> tuple[FittedParameter, ...]:
        """Every fitted parameter, as uncertain as the arm has it; readings may be worth less than in the fit."""
        covariance = self.arm.certainty and self.arm.certainty.among(self.fit.parameters)
        stds = np.zeros(len(self.fit.values)) if covariance is None else np.sqrt(np.diag(covariance))
        pairs = zip(parameters(self.fit), stds.tolist(), strict=True)
        return tuple(replace(parameter, std=max(parameter.std, std)) for parameter, std in pairs)

    @property
    def findings(self) -> tuple[FittedParameter, ...]:
        """Parameters that moved by more than their prior allows."""
        return tuple(parameter for parameter in self.parameters if parameter.surprising)

    @property
    def undetermined(self) -> tuple[FittedParameter, ...]:
        """Parameters that these data say nothing about."""
        return tuple(parameter for parameter in self.parameters if not parameter.determined)

    @property
    def outliers(self) -> tuple[Outlier, ...]:
        """Readings with little weight, the worst of every instrument first."""
        view = (self.scattered or self.fit).view
        return tuple(outliers_of(view, instrument_weights(view) < DOUBTED, self.measurements, "counted less"))

    @checked_kinds
    def write(self, path: str | Path) -> Path:
        """Write the declared arm.toml with its comments, and a [calibration] table that `load_arm` applies.

        Args:
            path: The arm.toml to write; files named in it are named relative to its folder.

        Raises:
            UnsupportedError: No arm.toml declares the arm, or it was changed in Python after it was read.
            FileError: It cannot be written.
        """
        campaign = Campaign(self.measurements.sha256, len(self.fit.view.rows), self.rms, self.measurements.clock)
        return write_arm(self.arm, campaign, Path(path))


@checked_kinds
def calibrate(
    arm: Arm,
    measurements: Measurements | Tabular | Sequence[Measurements | Tabular],
    rows: np.ndarray | None = None,
    progress: Progress | None = None,
    keep: bool = False,
    as_stated: bool = False,
    seen: Mapping[str, Seen] | None = None,
    anyway: bool = False,
) -> Calibration:
    """Return the arm with everything that its [prior] frees fitted to a campaign.

    Readings that scatter more than they state, because the arm lacks something, are weighed by their scatter: else what
    is free would be driven far beyond its prior to make up for it. An arm that was calibrated before is fitted about
    what it was calibrated to. Rows that do not show a direction which an effect derives from their order are left out.

    Args:
        arm: The arm as declared; its prior says what may move and how far.
        measurements: Where the tip was seen. A list of several campaigns of this machine is fitted together, the
            instrument and its target anew in each; see `joined`.
        rows: (M,) numbers of the rows to use, of several campaigns among all; every measured row when not given.
        progress: Called with (steps done, steps at most).
        keep: Keep what an earlier campaign was fitted to: only the instrument's and the sessions' frames, and how the
            target is turned on the tool, are fitted. The covariance of what is kept stays as it was, and the frames
            are as uncertain as it makes them; see `certainty_of`.
        as_stated: Weigh readings by their stated noise alone, as a search for what the arm lacks must.
        seen: Loads that learned laws are made for, by flexure; those of the rows when not given.
        anyway: Take the campaign as it is, also where it is plausible only in another convention.

    Raises:
        ConventionError: The campaign is implausible for this arm, and plausible in another convention; or readings
            scatter a hundred times as far as they state.
        InputError: Too few rows were measured, or they do not determine where the instrument stands.
        MissingCovariateError: An effect of the arm depends on what the campaign does not give.
        UnsupportedError: The arm has effects that change how the instrument stands or reads.
        ConvergenceError: The fit did not settle.
    """
    calibrated = fit_campaign(arm, measurements, rows, progress, keep, as_stated, seen, anyway)
    if not (anyway or as_stated):
        check_scatter(calibrated.fit, [flag for flag in calibrated.flags if flag.code == "coupled_axes"])
    return calibrated


def fit_campaign(
    arm: Arm,
    measurements: Measurements | Tabular | Sequence[Measurements | Tabular],
    rows: np.ndarray | None = None,
    progress: Progress | None = None,
    keep: bool = False,
    as_stated: bool = False,
    seen: Mapping[str, Seen] | None = None,
    anyway: bool = False,
) -> Calibration:
    """Return what `calibrate` does, also where readings scatter a hundred times as far as they state; see there."""
    measurements = as_campaign(measurements, arm)
    used, _ = _usable(arm, measurements, rows)
    about: tuple[Flag, ...] = ()
    if anyway:
        check_joint_units(measurements.q, arm, measurements.places, units=measurements.units)
    for name, places in measurements.pieces.items():
        part = replace(measurements.some(places), campaign=())
        try:
            flags = check_conventions(arm, part, np.flatnonzero(np.isin(places, used)), keep, searched=as_stated)
        except ConventionError as error:
            if not anyway:
                raise
            flags = (Flag("convention", error.problem),)
        about += tuple(replace(flag, text=f"{name}: {flag.text}") if name else flag for flag in flags)
    return fitted_to(arm, measurements, rows, progress, keep, as_stated, seen, about)


def fitted_to(
    arm: Arm,
    measurements: Measurements,
    rows: np.ndarray | None = None,
    progress: Progress | None = None,
    keep: bool = False,
    as_stated: bool = False,
    seen: Mapping[str, Seen] | None = None,
    about: tuple[Flag, ...] = (),
) -> Calibration:
    """Return what `calibrate` does of a campaign that is taken as it is written.

    Args:
        arm, measurements, rows, progress, keep, as_stated, seen: See there.
        about: Flags on conventions and instruments that are implausible.
    """
    arm = on_its_clock(arm, measurements)
    used, derived = _usable(arm, measurements, rows)
    declared, placed = _placed(arm if keep else replace(arm, certainty=None), measurements, used, keep)
    blocks = [block for block in declared_blocks(declared, measurements) if not keep or block.kind in FRAMES]
    laws = None if keep else law_block(declared, placed.view, seen)

    looks = any(kind.apart for kind in measurements.readings.kinds)
    if looks and as_stated:  # while the arm lacks something the corners of a picture repeat each other
        measurements = replace(measurements, readings=measurements.readings.as_looks)
    begun, rounds = WeighedReadings(measurements), ROUNDS if looks or not as_stated else 0
    if looks:
        # What the arm lacks all numbers of a look share: weighed as stated they would drive what is free far beyond
        # its prior before their scatter is known.
        begun = begun.again(placed)
    scattered: Fit | None = None
    if laws is None:
        fitted, flags = _fit(declared, blocks, begun, used, rounds, progress, placed), ()
        if looks and as_stated:
            fitted = fit(declared, blocks, measurements, used, fitted.values, progress)
        elif looks and fitted.factors:
            scattered = _with_play(fitted, measurements, rounds, progress, placed)
            values = scattered.values[: len(fitted.values)]
            view = look(
                realise(declared, blocks, values), WeighedReadings(measurements, fitted.factors).measurements, used
            )
            fitted = replace(fitted, values=values, view=view)
    else:
        fitted, flags = fit_learning(declared, blocks, laws, begun, used, not as_stated, progress)
    certainty = certainty_of(scattered or fitted)
    calibrated = replace(with_posteriors(fitted.setup.arm, fitted, certainty), instrument=fitted.setup.instrument)
    errors = _held_out(placed, fitted, measurements, scattered or fitted)
    judgement = tuple(wrong_sigma(fitted, about, as_stated))
    timed = None if "time" in measurements.derived else measurements.time
    # Of an instrument that was moved, or is not what it is said to be, that is said already.
    # Nor is an arm worse than declared of which only the instrument was placed.
    excused = about or judgement or scattered or keep
    flags = (
        *derived,
        *about_time(declared.arm, measurements.known, timed),
        *about,
        *(_apart(declared) if declared.arm.measurement.frame != "base" else ()),
        *flags,
        *judgement,
        *far_from_declared(fitted, fitted.parameters, calibrated),
        *_against_load(fitted),
        *(() if as_stated else coupled_axes(fitted)),
        *soft(calibrated.flexures, anywhere(arm.robot), arm.flags),
        *(() if as_stated or keep or not certainty.misfit else _held(arm)),
        *(() if excused else worse_than_declared(errors, fitted.view.readings.shown_in)),
        *(() if scattered is None else _standing_off(certainty.unexplained)),
    )
    return Calibration(calibrated.left(), fitted, placed.view, measurements, flags, errors, scattered)


def _held(arm: Arm) -> Iterator[Flag]:
    """Yield the flag about compliances that are uncertain as declared, and that [prior] leaves as they are."""
    row, declared = anywhere(arm.robot), [flexure for flexure in arm.flexures if flexure.learn is None]
    held = {each.name: each.law.relative_std for each in declared if each.law.relative_std and each.law.freed(row)}
    if held and not arm.prior.compliance:
        most = max(held.values())
        text = (
            f"the compliance of {listing(held)} is held although it is known to {most:.0%} as declared, and readings "
        )
        yield Flag("held", f"{text}scatter by more than they state: compliance = {most:g} under [prior] frees it")


def _against_load(fitted: Fit) -> Iterator[Flag]:
    """Yield a flag for each compliance that the readings would have below zero."""
    for which, size, std in below_zero(fitted):
        text = f"{which.label}: the readings want {size:.2g} ± {std:.1g} times what was declared, the opposite sign, "
        text += "which a compliance cannot have: something moves against its load, such as a counterweight, a spring "
        text += "or a wrong centre of mass; `trace` has effects of either sign"
        yield Flag("opposite_sign", text, about=which.label)


def far_from_declared(fitted: Fit, parameters: Sequence[ArmParameter], arm: Arm) -> Iterator[Flag]:
    """Yield a flag where the first parameters of a fit are absurdly far from what was declared; `arm` came of it."""
    open_ = () if arm.certainty is None else arm.certainty.undetermined
    sizes = np.where(np.isfinite(fitted.prior), np.abs(fitted.values) / fitted.prior, 0.0).tolist()
    sized = [
        (parameter, size)
        for parameter, size in zip(parameters, sizes, strict=False)
        if parameter.group.kind is not ParameterKind.LAW
    ]
    yield from beyond_priors({parameter.label: size for parameter, size in sized if parameter.label not in open_})


def _fit(
    declared: Setup,
    blocks: Sequence[Block],
    weighed: WeighedReadings,
    used: np.ndarray,
    rounds: int,
    progress: Progress | None,
    begun: Fit,
) -> Fit:
    """Return a fit to readings that scatter as they are weighed, `begun` with the instrument placed.

    Of many rows `FEWEST_ROWS` for each parameter lead almost to where all do, in a fraction of the time.
    """
    start, enough = None, FEWEST_ROWS * len(parameters_of(blocks))
    if len(used) > ROWS_AT_ONCE > enough:
        fewer = np.sort(np.random.default_rng(0).choice(used, enough, replace=False))
        with contextlib.suppress(ArmflexError):  # they may be too few
            first = _fit(declared, blocks, weighed, fewer, rounds, progress, begun)
            start, weighed = first.values, replace(weighed, factors=first.factors)
    else:
        values = dict(zip(begun.parameters, begun.values.tolist(), strict=True))
        values = {
            parameter: value for parameter, value in values.items() if parameter.group.kind is ParameterKind.SENSOR
        }
        start = np.array([values.get(parameter, 0.0) for parameter in parameters_of(blocks)])
    near = begun.view.some(np.flatnonzero(np.isin(begun.view.rows, used)))
    fitted = fit_without_lost(declared, blocks, weighed.measurements, start, near, progress)
    for _ in range(rounds):
        better = weighed.again(fitted)
        sized = [block.resized(fitted.places(block), fitted.values, fitted.posterior) for block in blocks]
        if better.close_to(weighed) and sized == list(blocks):
            break
        weighed, blocks = better, sized
        fitted = fit_without_lost(declared, blocks, better.measurements, fitted.values, fitted.view, progress)
    return replace(fitted, factors=weighed.factors)


def _with_play(fitted: Fit, measurements: Measurements, rounds: int, progress: Progress | None, begun: Fit) -> Fit:
    """Return a fit in which each joint may stand off at random in every pose, by as much as the readings show.

    All corners of a picture share what the arm lacks. As errors of their own they would outweigh what is known before.
    """
    twists, poses = [], measurements.pose_number
    for joint in (joint for joint in fitted.setup.arm.robot.moving if drive_of(joint).any()):
        axis = TWIST_NAMES[int(np.abs(drive_of(joint)).argmax())]
        twists.append(PoseBlock(joint.name, axis, USUAL_PRIOR.joint_offset, poses))
    return _fit(
        fitted.declared,
        [*fitted.blocks, *twists],
        WeighedReadings(measurements),
        fitted.view.rows,
        rounds,
        progress,
        begun,
    )


def _standing_off(twists: Iterable[tuple[str, str, float]]) -> Iterator[Flag]:
    """Yield the flag about joints that stand off at random, by site, axis and standard deviation [m or rad]."""
    sizes = listing(f"{site} {1e3 * std:.2g} {'mm' if axis.startswith('d') else 'mrad'}" for site, axis, std in twists)
    text = f"joints stand off at random in each picture, by one standard deviation of {sizes}: errors in px are of that"
    yield Flag("standing_off", f"{text}, and sigma has it in it; `trace` looks for its cause, such as play")


def loads_seen(arm: Arm, measurements: Measurements) -> dict[str, Seen]:
    """Return the loads that a campaign puts on each flexure that learns, as the declared arm has them.

    Raises:
        As `calibrate`, before its fit.
    """
    used = _usable(arm, measurements, None)[0]
    declared, placed = _placed(replace(arm, certainty=None), measurements, used)
    laws = law_block(declared, placed.view)
    return {} if laws is None else {name: law.seen for name, law in zip(laws.flexures, laws.laws, strict=True)}


def _placed(arm: Arm, measurements: Measurements, used: np.ndarray, keep: bool = False) -> tuple[Setup, Fit]:
    """Return the first guess, and the rows with only the instrument's frame and, unless kept, the target fitted."""
    declared, line = first_guess(arm, measurements, used)
    seen = measurements.positioned[used]
    if arm.measurement.frame != "base" and seen.any():
        points = declared.instrument.seen(declared.instrument.in_base(line.tip))
        for name, places in measurements.some(used).pieces.items():
            places = places[seen[places]]
            with naming(name) if name else contextlib.nullcontext():
                if len(places):
                    check_enough(points[places], measurements.sigma[used[places]])
    placing = (ParameterKind.INSTRUMENT, ParameterKind.SENSOR, *(() if keep else (ParameterKind.TOOL,)))
    placing += OF_SESSION if declared.instrument.campaigns else ()
    frame = [block for block in declared_blocks(declared, measurements) if block.kind in placing]
    view = look(declared, measurements, used, line=line)
    if frame:
        begun = sensor_start(view)
        start = np.array([begun.get(parameter, 0.0) for parameter in parameters_of(frame)])
        return declared, fit_without_lost(declared, frame, measurements, start, view)
    return declared, Fit(declared, (), np.zeros(0), view)


def _held_out(placed: Fit, fitted: Fit, measurements: Measurements, closest: Fit) -> tuple[float, float] | None:
    """Return the RMS of the 3-D error on held-out poses, of the declared arm and of the calibrated one [m].

    Over readings that one of them or `closest` comes near.
    """
    poses = measurements.pose_number[fitted.view.rows]
    if len(np.unique(poses)) < POSE_FOLDS:
        return None
    folds, judged = pose_folds(poses), judged_by(placed, fitted, closest)
    declared, calibrated = (held_out(model, folds, judged=judged).rms for model in (placed, fitted))
    return declared, calibrated


def worse_than_declared(errors: tuple[float, float] | None, unit: str | Shown) -> Iterator[Flag]:
    """Yield the flag about an arm that predicts poses it was not fitted to worse than it did before."""
    if errors is not None and errors[1] > errors[0]:
        declared, calibrated = (said_of(error, unit) for error in errors)
        text = f"poses held out are predicted to {calibrated} RMS, by the arm as declared to {declared}"
        hint = "there are too few poses for what [prior] frees, or it frees too much: use the arm as declared"
        yield Flag("worse_than_declared", f"{text}: {hint}")


def _usable(arm: Arm, measurements: Measurements, rows: np.ndarray | None) -> tuple[np.ndarray, tuple[Flag, ...]]:
    """Return the rows that an arm can be fitted to, and flags about them; raise where it cannot, see `calibrate`."""
    asked = np.flatnonzero(measurements.measured) if rows is None else row_numbers(rows, len(measurements))
    unclear = without_direction([effect for effect in arm.effects if effect.derived], measurements)[asked]
    used = asked[~unclear]
    if len(used) < FEWEST_ROWS:
        file = f"{measurements.places[0].file}: " if measurements.places else ""
        hint = "" if measurements.measured.any() else ": nothing was read in any. Are its readings to be filled in yet?"
        raise InputError(f"{file}{len(used)} measured rows, expected {FEWEST_ROWS} or more{hint}")
    placing = [Act.FRAME, Act.SCALE, *([Act.GRAVITY] if arm.measurement.gravity_in == "measurement" else [])]
    fixed = [effect.name for effect in arm.effects if effect.law.act in placing]
    if fixed:
        text = f"effects that change how the instrument stands or reads cannot be fitted about: {listing(fixed)}"
        others = listing(name for name, law in CATALOGUE.items() if law.act in placing)
        raise UnsupportedError(
            f"{text} (such are {others}); leave them out of the arm, and calibrate that without them first"
        )
    flags = derived_directions(arm, measurements, used)
    if unclear.any():
        text = f"{unclear.sum()} rows are excluded: the direction of a joint is not known before it first moves"
        flags = (*flags, Flag("direction_unknown", text))
    return used, flags


def _apart(declared: Setup) -> Iterator[Flag]:
    """Yield flags about sessions in which the instrument stood elsewhere."""
    prior = declared.arm.prior
    apart = {
        name: frame for name, frame in declared.instrument.sessions.items() if name not in declared.instrument.campaigns
    }
    for name, frame in apart.items():
        there = f"{np.linalg.norm(frame[:3]):.3g} m and {np.linalg.norm(frame[3:]):.3g} rad"
        stated = f"[prior] has {prior.session_translation:g} m and {prior.session_rotation:g} rad"
        text = (
            f"the instrument stood elsewhere in session {name!r}, its frame {there} from that of most rows ({stated})"
        )
        yield Flag("session_apart", f"{text}: that frame is fitted as if nothing were known of it")
