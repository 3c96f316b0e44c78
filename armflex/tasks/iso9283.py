"""Pose accuracy and repeatability of a campaign with repeats, as ISO 9283:1998 defines them.

Attained positions of one commanded pose, payload and direction of approach have a barycentre. Pose accuracy AP is how
far that is from the commanded position, pose repeatability RP the radius about it that holds nearly all: the mean
distance and three of its standard deviations. Multi-directional variation vAP is the largest distance between
barycentres of one pose approached from different directions, drift dAP and dRP the largest change of AP and RP from the
first block of cycles to a later one. Rotations are taken component by component of their rotation vectors from the
commanded orientation, in base axes, which for small angles are the standard's a, b and c.

Uncertainties follow JCGM 100: that of AP from the scatter of the barycentre along the deviation and from how well it
is known where the base and the target stand before the instrument, that of RP by the jackknife, because it is no mean.
What the instrument has in them is separated by its stated noise. AP is not stated where nothing says where they stand.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, Literal

import numpy as np
import pinocchio as pin

from armflex.arguments import checked_kinds
from armflex.arm import Arm, Setup
from armflex.conventions import Array
from armflex.errors import InputError, listing
from armflex.estimate.placement import placed_rigidly
from armflex.estimate.posterior import placing_variance
from armflex.measured.data_flags import check_joint_units
from armflex.measured.measurements import Measurements, as_measurements
from armflex.measured.repeats import REPEATED, repeats
from armflex.measured.table import Tabular
from armflex.mechanics.loop_rows import rigid_tips
from armflex.readings.instrument import Instrument
from armflex.result import Result, record
from armflex.rows.rows import numbered, same_positions
from armflex.tasks.predict import predict

CYCLES, POSES = 30, 5
"""Cycles of each pose, and poses, that the standard asks for."""

DRAWS = 1000
"""Campaigns drawn to estimate what an instrument shows of a robot without error."""


@dataclass(frozen=True)
class Characteristic:
    """A figure of the standard.

    Attributes:
        value: [m] or [rad].
        std: Its standard uncertainty, the instrument's noise included; None where there are too few cycles.
        instrument: Of `std`, for an accuracy, what the stated noise of the instrument makes; for a repeatability what
            the instrument would show of a robot that repeats without error.
        placing: Of `std`, for an accuracy, what is not known of where base and target stand makes; None of others.
    """

    value: float
    std: float | None
    instrument: float | None
    placing: float | None = None


@dataclass(frozen=True, eq=False)
class AttainedPose:
    """What the standard says of one commanded pose under one payload, in one session, from one direction.

    Attributes:
        pose, payload, session: As the campaign names them; the pose by its first row.
        direction: (nq,) sign of each joint's last motion; None where no direction was repeated, and all are mixed.
        rows: Numbers of the campaign's rows.
        commanded: (3,) where the controller believes the target [m], base axes: rigid, without payload.
        attained: (n, 3) where it was [m], base axes.
        offset: (3,) barycentre less commanded position [m]: AP_x, AP_y, AP_z; None where it is not stated.
        accuracy: AP_P [m]; None where nothing says where base and target stand, so that it is that of a frame as well.
        repeatability: RP_l [m].
        rotation: (3,) mean of the rotation vectors from commanded to attained orientation [rad]: AP_a, AP_b, AP_c;
            None where orientations were not read.
        rotation_repeatability: (3,) three standard deviations of them [rad]: RP_a, RP_b, RP_c.
        predicted: Distance of the barycentre from where the arm's own model has it [m]: what AP_P becomes where the
            controller compensates by that model. None of an arm that was not calibrated.
        excluded: Cycles of this pose, payload and session that are in no figure; see `PosePerformance.excluded`.
    """

    pose: str
    payload: str
    session: str
    direction: tuple[int, ...] | None
    rows: np.ndarray
    commanded: Array
    attained: Array
    offset: Array | None
    accuracy: Characteristic | None
    repeatability: Characteristic
    rotation: Array | None
    rotation_repeatability: Array | None
    predicted: float | None
    excluded: int = 0

    @property
    def cycles(self) -> int:
        """How often it was attained."""
        return len(self.rows)


@dataclass(frozen=True, eq=False)
class Variation:
    """How far barycentres of one pose are apart.

    Attributes:
        pose, payload, session: As of `AttainedPose`.
        of: What they differ by.
        number: How many directions, or blocks in time, there are.
        accuracy: vAP_P, or the drift dAP_P [m].
        repeatability: The drift dRP_l [m]; None of directions.
        shift: Largest distance between the first block's barycentre and a later one's [m]: what a drift across the
            deviation changes, dAP_P does not show; of directions it is vAP_P.
    """

    pose: str
    payload: str
    session: str
    of: Literal["directions", "blocks"]
    number: int
    accuracy: float
    repeatability: float | None
    shift: float


@dataclass(frozen=True, repr=False, eq=False)
class PosePerformance(Result):
    """ISO 9283 pose characteristics of a campaign.

    Attributes:
        arm, measurements: What they are of.
        poses: One for each pose, payload, session and direction that was repeated.
        directions: vAP of each pose that was repeated from several directions.
        drifts: dAP and dRP of each pose with several blocks of cycles.
        remarks: What the standard asks for and the campaign does not give, one sentence each.
        excluded: Numbers of the campaign's rows that are cycles of a repeated pose and in no figure: the pose was
            attained but once from there, or, as in a campaign's first row, nothing says from where.
    """

    arm: Arm
    measurements: Measurements
    poses: tuple[AttainedPose, ...]
    directions: tuple[Variation, ...]
    drifts: tuple[Variation, ...]
    remarks: tuple[str, ...]
    excluded: tuple[int, ...] = ()

    ROWS = "table"

    def content(self) -> dict[str, Any]:
        """Return the pose characteristics under the standard's names, SI."""
        named = "pose payload session"
        accuracy = {"ap_m": "accuracy", "ap_xyz_m": "offset", "rp_m": "repeatability", "ap_with_model_m": "predicted"}
        accuracy |= {"ap_abc_rad": "rotation", "rp_abc_rad": "rotation_repeatability"}
        drift = {"dap_m": "accuracy", "drp_m": "repeatability", "shift_m": "shift"}
        return {
            "standard": "ISO 9283:1998",
            "poses": [record(pose, f"{named} direction cycles excluded rows", **accuracy) for pose in self.poses],
            "directions": [record(direction, f"{named} number", vap_m="accuracy") for direction in self.directions],
            "drifts": [record(variation, f"{named} number", **drift) for variation in self.drifts],
            **record(self, "remarks", excluded_rows="excluded"),
        }

    @property
    def table(self) -> list[dict[str, Any]]:
        """A row for each of `poses`: its cycles, AP_P and RP_l with their standard uncertainties [m]."""
        return [
            {
                **{name: getattr(pose, name) for name in ("pose", "payload", "session", "cycles", "excluded")},
                **{"AP": pose.accuracy and pose.accuracy.value, "AP_std": pose.accuracy and pose.accuracy.std},
                **{"RP": pose.repeatability.value, "RP_std": pose.repeatability.std},
            }
            for pose in self.poses
        ]


def pose_accuracy(commanded: Array, attained: Array, sigma: Array) -> Characteristic:
    """Return AP_P = |mean of attained - commanded| (ISO 9283:1998, 7.2.1) of (3,) and (n, 3) positions [m].

    The standard deviations of the readings are (n, 3) [m], same axes.
    """
    offset, n = attained.mean(axis=0) - commanded, len(attained)
    value = float(np.linalg.norm(offset))
    # Along the deviation; where there is none any direction is as good, and the widest is taken.
    share = offset / value if value > 0.0 else None
    read = np.sqrt((sigma**2).sum(axis=0)) / n
    instrument = float(read.max() if share is None else np.sqrt(((read * share) ** 2).sum()))
    if n < 2:
        return Characteristic(value, None, instrument)
    scatter = np.cov(attained.T) / n
    std = np.sqrt(np.linalg.eigvalsh(scatter)[-1] if share is None else share @ scatter @ share)
    return Characteristic(value, float(std), instrument)


def pose_repeatability(attained: Array, sigma: Array) -> Characteristic:
    """Return RP_l = mean distance from the barycentre + 3 standard deviations of it (7.2.2) of (n, 3) positions [m].

    The standard deviations of the readings are (n, 3) [m].
    """
    n = len(attained)
    std = None
    if n > 2:  # one left out each time; Efron and Tibshirani 1993, eq. (11.5)
        left = _repeatability(np.array([np.delete(attained, i, axis=0) for i in range(n)]))
        std = float(np.sqrt((n - 1) * ((left - left.mean()) ** 2).mean()))
    return Characteristic(float(_repeatability(attained)), std, instrument_repeatability((sigma**2).mean(axis=0), n))


def instrument_repeatability(variance: Array, cycles: int) -> float:
    """Return the RP_l [m] that readings with (3,) variances [m^2] show, in the mean, of a robot without error.

    By Monte Carlo (JCGM 101): of few cycles it is far from its limit of many, 3.616 standard deviations of an axis
    where all are alike. Draws are the same each time, and determine it to 0.5 %.
    """
    size = np.sqrt(np.asarray(variance, dtype=float))
    clouds = size * np.random.default_rng(0).standard_normal((DRAWS, cycles, 3))
    return float(_repeatability(clouds).mean())


def _repeatability(attained: Array) -> Array:
    """Return the (...) repeatability of (..., n, 3) positions."""
    distance = np.linalg.norm(attained - attained.mean(axis=-2, keepdims=True), axis=-1)
    return distance.mean(axis=-1) + 3.0 * distance.std(axis=-1, ddof=1)


@checked_kinds
def iso9283(arm: Arm, measurements: Measurements | Tabular, block: float | None = None) -> PosePerformance:
    """Return the pose characteristics that the repeats of a campaign give.

    The commanded pose is where the controller believes the tip: the arm's rigid kinematics as declared, without what
    was fitted. Readings are brought into the base by the arm's instrument where it is known (calibrated, or
    `frame = "base"`), else by the best rigid fit to commanded positions: AP is then not stated. All readings count,
    outliers as well.

    Args:
        arm: The arm, calibrated or not.
        measurements: Rows share a commanded pose when their joint positions, payload and session do.
        block: Cycles nearer in time than this to the first of a block are one block [s], for drift; no drift without.

    Raises:
        InputError: No pose was measured twice within a session, or `block` is not positive.
        ArmflexError: As `predict`, of a calibrated arm.
    """
    measurements = as_measurements(measurements, arm)
    check_joint_units(measurements.q, arm, measurements.places, units=measurements.units)
    if block is not None and not block > 0.0:
        raise InputError(f"block = {block:g} s: expected a positive time, that of the cycles of one block")
    rows = np.flatnonzero(measurements.measured)
    keys = zip(same_positions(measurements.q, REPEATED)[rows].tolist(), (measurements.payload[i] for i in rows),
               (measurements.session[i] for i in rows), strict=True)  # fmt: skip
    labels = numbered(keys)
    sets = [alike for alike in (rows[labels == i] for i in range(labels.max(initial=-1) + 1)) if len(alike) > 1]
    if not sets:
        raise InputError("no pose was measured twice under one payload in one session: ISO 9283 needs repeats")
    cycles = _cycles(arm, measurements, np.concatenate(sets))
    excluded: list[int] = []
    poses: list[AttainedPose] = []
    directions: list[Variation] = []
    drifts: list[Variation] = []
    for at_pose in sets:
        sides: dict[tuple[int, ...], list[int]] = {}
        for row in at_pose.tolist():
            sides.setdefault(tuple(measurements.approach[row].astype(int).tolist()), []).append(row)
        several = [cycles.pose(np.array(from_side), side) for side, from_side in sides.items() if len(from_side) > 1]
        apart = [row for from_side in sides.values() if several and len(from_side) == 1 for row in from_side]
        excluded += apart
        several = [replace(pose, excluded=len(apart)) for pose in several]
        poses += several or [cycles.pose(at_pose, None)]
        if len(several) > 1:
            pairs = combinations([pose.attained.mean(axis=0) for pose in several], 2)
            most = max(float(np.linalg.norm(mean - other)) for mean, other in pairs)
            name = (several[0].pose, several[0].payload, several[0].session)
            directions.append(Variation(*name, "directions", len(several), most, None, most))
        if block is not None:
            drifts += [drift for pose in several for drift in _drift(pose, measurements.time[pose.rows], block)]
    remarks = (
        *_about_accuracy(poses, cycles.placed),
        *_remarks(measurements, poses, directions, drifts, block, excluded),
    )
    return PosePerformance(
        arm, measurements, tuple(poses), tuple(directions), tuple(drifts), remarks, tuple(sorted(excluded))
    )


@dataclass(frozen=True, eq=False)
class _Cycles:
    """N rows in which a pose was attained again.

    Attributes:
        arm, measurements: They.
        rows: (N,) numbers of the rows.
        instrument: Where it stands, and `placed` whether a fit to these rows says so.
        axes: (N, 3, 3) the axes of readings by those of the base.
        commanded, attained: (N, 3) target in the base [m].
        sigma: (N, 3) standard deviations of the readings along base axes [m].
        turned: (N, 3) how far the target is turned from where it is commanded [rad], NaN unread; None without any.
        model: (N, 3) what the calibrated arm leaves of the readings, base axes [m]; None of one that is not.
    """

    arm: Arm
    measurements: Measurements
    rows: np.ndarray
    instrument: Instrument
    placed: bool
    axes: Array
    commanded: Array
    attained: Array
    sigma: Array
    turned: Array | None
    model: Array | None

    def pose(self, rows: np.ndarray, direction: tuple[int, ...] | None) -> AttainedPose:
        """Return the characteristics of a pose that was attained in some rows, from one direction or from any."""
        at, measurements = np.flatnonzero(np.isin(self.rows, rows)), self.measurements
        target, points, first = self.commanded[at[0]], self.attained[at], int(rows[0])
        angles = None if self.turned is None or np.isnan(self.turned[at]).any() else self.turned[at]
        offset = points.mean(axis=0) - target
        accuracy = None if self.placed else pose_accuracy(target, points, self.sigma[at])
        if accuracy is not None and accuracy.value > 0.0:
            along = np.einsum("nij,j->ni", self.axes[at], offset / accuracy.value) / (1.0 + self.instrument.scale)
            placing = float(np.sqrt(placing_variance(self.arm, measurements, rows, along)))
            std = None if accuracy.std is None else float(np.hypot(accuracy.std, placing))
            accuracy = replace(accuracy, std=std, placing=placing) if np.isfinite(placing) else None
        return AttainedPose(
            measurements.pose[first],
            measurements.payload[first],
            measurements.session[first],
            direction,
            rows,
            target,
            points,
            None if accuracy is None else offset,
            accuracy,
            pose_repeatability(points, self.sigma[at]),
            None if angles is None else angles.mean(axis=0),
            None if angles is None else 3.0 * angles.std(axis=0, ddof=1),
            None if self.model is None else float(np.linalg.norm(self.model[at].mean(axis=0))),
        )


def _cycles(arm: Arm, measurements: Measurements, used: np.ndarray) -> _Cycles:
    """Return (N,) rows as seen in the base."""
    tips, sessions = rigid_tips(arm.loaded(None), measurements.q[used]), [measurements.session[i] for i in used]
    setup, placed = Setup(arm, arm.instrument or Instrument()), False
    if arm.instrument is None and arm.measurement.frame != "base":
        setup, placed = placed_rigidly(setup, setup.instrument.in_base(tips), measurements, used), True
    instrument = setup.instrument
    # What was read in a session's axes, along those of the base.
    axes = instrument.session_turns(sessions) @ instrument.pose.rotation
    commanded = instrument.in_base(tips, sessions)
    apart = (measurements.position[used] - instrument.readings(tips, sessions)) / (1.0 + instrument.scale)
    attained = commanded + np.einsum("nij,ni->nj", axes, apart)
    sigma = np.sqrt(np.einsum("nij,ni->nj", axes**2, measurements.sigma[used] ** 2))
    turned = None
    if measurements.rotation is not None and measurements.sigma_r is not None:
        expected, read = instrument.rotations(tips, sessions), np.isfinite(measurements.sigma_r[used])
        turned = np.full((len(used), 3), np.nan)
        for i in np.flatnonzero(read):
            away = pin.exp3(measurements.rotation[used[i]]) @ expected[i].T
            turned[i] = axes[i].T @ pin.log3(away)
    model = None
    if arm.certainty is not None:
        left = (measurements.position - predict(arm, measurements).position)[used] / (1.0 + instrument.scale)
        model = np.einsum("nij,ni->nj", axes, left)
    return _Cycles(arm, measurements, used, instrument, placed, axes, commanded, attained, sigma, turned, model)


def _drift(pose: AttainedPose, time: Array, block: float) -> Iterator[Variation]:
    """Yield dAP and dRP of a pose attained at (n,) times [s], nothing where its cycles are one block."""
    blocks: list[list[int]] = []
    for i in np.argsort(time, kind="stable").tolist():
        if not blocks or time[i] - time[blocks[-1][0]] >= block:
            blocks.append([])
        blocks[-1].append(i)
    clouds = [pose.attained[in_block] for in_block in blocks if len(in_block) > 1]
    if len(clouds) > 1:
        middle = np.array([cloud.mean(axis=0) for cloud in clouds])
        accuracy = np.linalg.norm(middle - pose.commanded, axis=1)
        repeatability = np.array([_repeatability(cloud) for cloud in clouds])
        changed, wider = (float(np.abs(values - values[0]).max()) for values in (accuracy, repeatability))
        shift = float(np.linalg.norm(middle - middle[0], axis=1).max())
        yield Variation(pose.pose, pose.payload, pose.session, "blocks", len(clouds), changed, wider, shift)


def _places(measurements: Measurements, rows: Sequence[int]) -> str:
    """Return what rows are called in their file, the first five of them."""
    return listing([str(measurements.places[row]) if measurements.places else f"row {row}" for row in rows], 5)


def _about_accuracy(poses: Sequence[AttainedPose], placed: bool) -> Iterator[str]:
    """Yield what AP rests on, or why it is not stated."""
    if placed:
        yield (
            "The instrument's place is not known, so AP is not stated: a frame fitted to these poses would have part "
            "of it. Measure in the base frame, found by marks on the base."
        )
    elif any(pose.accuracy is None for pose in poses):
        yield (
            "Neither a campaign nor a prior determines where base and target stand before the instrument: AP is not "
            "stated where it depends on that."
        )
    elif most := max(pose.accuracy.placing or 0.0 for pose in poses if pose.accuracy is not None):
        yield (
            f"AP rests on where base and target stand before the instrument, which is up to {1e3 * most:.3g} mm of its "
            "standard uncertainty. A frame that was fitted with the arm is exchangeable with the zero of a vertical "
            "first joint and with all that shifts the whole arm: marks on the base and a measured target determine it."
        )


def _remarks(
    measurements: Measurements,
    poses: Sequence[AttainedPose],
    directions: Sequence[Variation],
    drifts: Sequence[Variation],
    block: float | None,
    excluded: Sequence[int],
) -> Iterator[str]:
    """Yield what the standard asks for and these cycles do not give."""
    cycles, places = [pose.cycles for pose in poses], {pose.pose for pose in poses}
    least, most, mixed = min(cycles), max(cycles), [pose.pose for pose in poses if pose.direction is None]
    first = [row for row in excluded if not measurements.approach[row].any()]
    once = [row for row in excluded if row not in first]
    causes = [f"no row before it and no column approach_*: {_places(measurements, first)}"] * bool(first)
    causes += [f"the pose was attained only once from this direction: {_places(measurements, once)}"] * bool(once)
    derived = any(name.startswith("approach_") for name in measurements.derived)
    repeated = repeats(measurements)
    lost = () if repeated is None else repeated.same_session.lost
    for holds, text in (
        (least < CYCLES,
         f"{least if least == most else f'{least} to {most}'} cycles of a pose, the standard asks for {CYCLES}."),
        (len(places) < POSES,
         f"{len(places)} poses, the standard asks for {POSES}, in the largest cube of the working space."),
        (all(pose.payload == "none" for pose in poses),
         "Measured without payload: the standard asks for all of the rated load, and for a tenth of it besides."),
        (excluded,
         f"{len(excluded)} of {sum(cycles) + len(excluded)} cycles are excluded: {'; '.join(causes)}."),
        (mixed, f"From no direction attained twice, so all directions are one: {listing(mixed)}."),
        (not directions,
         "No pose was repeated from two directions: vAP cannot be given (the standard: three, 30 cycles each)."),
        (derived and len(mixed) < len(poses),
         "Directions are derived from the row before: the file has no columns approach_*."),
        (block is None, "Drift is not given: it needs the time that a block of cycles takes (--block)."),
        (block is not None and not drifts,
         f"No pose has cycles in two blocks of {block or 0.0:g} s: drift cannot be given."),
        (any(pose.rotation is None for pose in poses),
         "Orientations were not read in every cycle: AP and RP of a, b and c are not given for all."),
        (lost, f"Outliers beyond the noise, included in the figures: {_places(measurements, lost)}."),
        (True,
         "A campaign at rest does not give distance accuracy by pairs, stabilisation time, overshoot, exchangeability, "
         "compliance under the standard's forces, and anything of paths and velocities."),
    ):  # fmt: skip
        if holds:
            yield text
