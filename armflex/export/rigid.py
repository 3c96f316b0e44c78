"""The calibrated arm without compliance: the frames of its joints, and what a file with only those leaves out."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin

from armflex.arm import Arm, ManyRows
from armflex.configurations import Configurations, drawn_range
from armflex.conventions import LARGEST_POSITION, Array
from armflex.errors import NO_ANSWER, ClosureError, MissingCovariateError, Place, UnsupportedError, listing, naming
from armflex.laws import Row
from armflex.laws.effects.effect import Act, DependsOn, Effect
from armflex.laws.effects.in_arm import BoundTwist
from armflex.laws.effects.location import resolve, site_of
from armflex.laws.effects.shapes import ABOVE
from armflex.measured.measurements import Measurements
from armflex.mechanics.history import known_rows
from armflex.mechanics.mechanism import Mechanism
from armflex.readings.sensor import POINT
from armflex.robot.urdf import MOVING, drive_of
from armflex.rows.wrench import Wrench, wrenches_in

POSES = 128
"""Configurations within the limits over which what a file leaves out is stated."""

HOLDS_AT = "Lengths, angles and zeros are those at"
"""Begins a line that says at which temperature they hold."""


def with_constants(arm: Arm) -> Arm:
    """Return the same arm whose effects that depend on nothing are among its corrections, where those can hold them.

    A zero that `trace` found as `encoder_offset` is a joint's zero as one that `calibrate` found, and so is a link's
    geometry. A twist beyond the last joint is no joint's: it stays an effect.
    """
    joints = {joint.name: joint for joint in arm.robot.places}
    offset, geometry = dict(arm.corrections.joint_offset), dict(arm.corrections.geometry)
    before: dict[str, Array] = {}
    kept = []
    for effect in arm.effects:
        site = site_of(effect.location.site, arm.robot)
        joint = joints.get(site.joint or "")
        if effect.law.depends_on is not DependsOn.NOTHING or effect.law.act is not Act.TWIST or joint is None:
            kept.append(effect)
            continue
        row = Row(arm.robot.home, arm.joint_index)
        twist = BoundTwist(effect, resolve(effect.location, arm.robot, ())).twist(np.zeros(6), row)
        drive = drive_of(joint)
        along = float(drive @ twist)
        if site.before or joint.kind not in MOVING:
            before[joint.name] = before.get(joint.name, np.zeros(6)) + twist
        elif np.array_equal(twist, along * drive):
            offset[joint.name] = offset.get(joint.name, 0.0) + along
        else:
            kept.append(effect)
    for name, twist in before.items():  # twists of one site add up before they are a pose
        pose = arm.corrections.frame(joints[name]) * pin.exp6(pin.Motion(twist))
        geometry[name] = pin.log6(pose).vector
    corrections = replace(arm.corrections, joint_offset=offset, geometry=geometry)
    return replace(arm, corrections=corrections, effects=tuple(kept))


def joint_frames(arm: Arm, zeros: bool) -> list[pin.SE3]:
    """Return the n + 1 constant poses between an arm's n motions: base to first joint, joint to joint, last to tip.

    Every joint turns about, or slides along, the z axis of its frames: those of a joint about another axis are turned
    by the smallest rotation. With `zeros` the joints' offsets are in the poses, which then belong to what the
    controller reports; without, with positions to which the offsets have been added.
    """
    frames, here = [], pin.SE3.Identity()
    for joint in arm.robot.chain:
        here = here * pin.SE3(joint.rotation, joint.origin) * arm.corrections.frame(joint)
        if joint.kind not in MOVING:
            continue
        across = np.cross([0.0, 0.0, 1.0], joint.axis)
        size = float(np.linalg.norm(across))
        way = across / size if size else np.array([1.0, 0.0, 0.0])
        turned = pin.SE3(pin.exp3(float(np.arctan2(size, joint.axis[2])) * way), np.zeros(3))
        frames.append(here * (arm.corrections.zero(joint) if zeros else pin.SE3.Identity()) * turned)
        here = turned.inverse()
    return [*frames, here]


def require_six_turning(arm: Arm, format_name: str) -> None:
    """Raise `UnsupportedError` where an arm has other than the six turning joints that a format is for."""
    sliding = [joint.name for joint in arm.robot.moving if joint.kind == "prismatic"]
    if sliding or len(arm.joint_names) != 6:
        slides = f", {listing(sliding)} sliding" if sliding else ""
        has = f"this arm has {len(arm.joint_names)}{slides}: {listing(arm.joint_names)}"
        raise UnsupportedError(f"{format_name} takes six turning joints; {has}")


def tips(arm: Arm, frames: Sequence[pin.SE3], q: Array) -> Array:
    """Return the (N, 4, 4) poses of the tip at (N, k) `positions` in the sense of `frames`; see `joint_frames`."""
    pose = np.broadcast_to(frames[0].homogeneous, (len(q), 4, 4))
    for i, joint in enumerate(arm.robot.swept):
        move = np.tile(np.eye(4), (len(q), 1, 1))
        if joint.kind == "prismatic":
            move[:, 2, 3] = q[:, i]
        else:
            move[:, 0, 0] = move[:, 1, 1] = np.cos(q[:, i])
            move[:, 1, 0] = np.sin(q[:, i])
            move[:, 0, 1] = -move[:, 1, 0]
        pose = pose @ move @ frames[i + 1].homogeneous
    return pose


def positions(arm: Arm, q: Array) -> Array:
    """Return (N, k) positions of the chain's joints at (N, nq) of the drives; NaN where rigid loops do not close."""
    if not arm.robot.linkage:
        return q
    mechanics, linkage = replace(arm, flexures=(), effects=()).loaded(None).mechanics, arm.robot.linkage
    assert isinstance(mechanics, Mechanism)
    rows = np.full((len(q), len(arm.robot.swept)), np.nan)
    for row, here in zip(rows, q, strict=True):
        with suppress(ClosureError):
            position_of = dict(zip(arm.joint_names, here, strict=True))
            position_of |= dict(zip(linkage.free, mechanics.closed(here), strict=True))
            row[:] = [position_of[joint.name] for joint in arm.robot.swept]
    return rows


def configurations(arm: Arm) -> Array:
    """Return (N, nq) positions that fill an arm's limits evenly and close its loops, the same ones every time."""
    lower, upper = (np.clip(limit, -LARGEST_POSITION, LARGEST_POSITION) for limit in drawn_range(arm)[:2])
    (drawn,) = Configurations(lower, upper, POSES, 0, POSES).chunks()
    return drawn[np.isfinite(positions(arm, drawn)).all(axis=1)]


def needs_columns(arm: Arm, effect: Effect) -> bool:
    """Return whether an effect of an arm depends on more than positions and loads."""
    try:
        replace(arm, effects=(effect,)).deflection(arm.robot.home)
    except MissingCovariateError:
        return True
    except tuple(NO_ANSWER.values()):
        return False  # it was asked, and the arm does not stand there
    return False


def holds_at(arm: Arm) -> dict[str, float]:
    """Return the temperature [degC] at which what follows a column has no part, by column: lengths hold there.

    Where effects that follow one column have none at different temperatures, it is by column and effect.
    """
    followed: dict[str, list[tuple[str, float]]] = {}
    for effect in arm.effects:
        if ABOVE in effect.law.inner:
            column = effect.location.covariates[0]
            followed.setdefault(column, []).append((effect.name, effect.named[ABOVE.name]))
    return {
        column if len({at for _, at in pairs}) == 1 else f"{column} ({name})": at
        for column, pairs in followed.items()
        for name, at in pairs
    }


def said_holds(arm: Arm) -> tuple[str, ...]:
    """Return the same in words, a line where there is any."""
    held = [f"{column} = {value:.5g} °C" for column, value in holds_at(arm).items()]
    return (f"{HOLDS_AT} {listing(held)}.",) if held else ()


@dataclass(frozen=True)
class Lost:
    """How far the arm's tip is from where a rigid file has it, over some rows of one payload.

    Attributes:
        payload: What is carried.
        rows: How many had an answer.
        unanswered: How many had none: the arm would buckle there, or give beyond what its laws mean.
        rms, most: Of the tip's distance [m].
        effects: The most that the arm's effects have in it [m].
    """

    payload: str
    rows: int
    unanswered: int
    rms: float
    most: float
    effects: float


def measured_points(arm: Arm) -> dict[str, tuple[str, Array]]:
    """Return the link and the place in its frame, (3,) [m], of every point of the arm that a campaign found.

    They are what was measured: the target of the tip, and the balls and targets of instruments beside it. The tip is
    where it was declared, whatever was found of them.
    """
    points: dict[str, tuple[str, Array]] = {}
    if arm.instrument is not None and np.any(arm.instrument.target):
        points["target"] = arm.robot.tip, arm.instrument.target
    for name, sensor in arm.sensors.items():
        place = sensor.of(POINT.name, [""])[0]
        if len(place) and sensor.found and np.any(place):
            points[f"{name}_{POINT.name}"] = sensor.link, place
    return points


def said_points(points: Mapping[str, tuple[str, Array]], carried: bool) -> tuple[str, ...]:
    """Return what a file says of points that were measured, a line where there are any."""
    sizes = listing(
        f"{name} {1e3 * float(np.linalg.norm(place)):.3g} mm from the origin of {link!r}"
        for name, (link, place) in points.items()
    )
    if not points:
        return ()
    if carried:
        return (f"What was measured are links of the file: {sizes}; the tip is as declared.",)
    text = "Poses are of the tip as declared; the points that were measured are not in this file"
    return (f"{text}: {sizes}. A tool there has to be given to what reads it.",)


def left_out(arm: Arm, over: Measurements | None, points: bool = False) -> tuple[tuple[str, ...], dict[str, Any]]:
    """Return what a file with an arm's calibrated geometry leaves out, in words and for programs.

    Args:
        arm: As `with_constants` returns it.
        points: Whether the file has the points that were measured.
        over: Rows to judge it by, with their payloads and columns; configurations within the limits, each with every
            payload, when None. Effects that need columns have no part then, which is said.

    Raises:
        MissingCovariateError: An effect needs a column that the rows do not have.
    """
    unknown: tuple[str, ...] = ()
    if arm.certainty is not None and arm.certainty.misfit:
        size = f"{np.sqrt(3.0) * arm.certainty.misfit * 1e3:.3g} mm (RMS)"
        unknown = (f"The arm lacks something that moved the tip by {size} when it was measured: see `trace`.",)
    drawn = configurations(arm) if over is None else over.q
    loops, opened = _loops_left_out(arm, drawn)
    measured = measured_points(arm)
    unknown = (*loops, *said_points(measured, points), *said_holds(arm), *unknown)
    opened |= {
        "holds_at": holds_at(arm),
        "points": {name: {"link": link, "xyz_m": place} for name, (link, place) in measured.items()},
    }
    if not arm.flexures and not arm.effects:
        notes = ("No flexure and no effect is declared: no deflection is left out.", *unknown)
        return notes, {"left_out": [], "without": [], **opened}
    aside: list[Effect] = []
    if over is None:
        aside = [effect for effect in arm.effects if needs_columns(arm, effect)]
        whole = replace(arm, effects=tuple(effect for effect in arm.effects if effect not in aside))
        groups = [(name, drawn, {}, ()) for name in dict.fromkeys(("none", *arm.payloads))]
        where = f"{len(drawn)} configurations within the joints' limits"
    else:
        whole, groups = arm, []
        with naming(Place(over.places[0].file, 1) if over.places else "rows"):
            columns = known_rows(arm, over)
        for name in dict.fromkeys(over.payload):
            mine = np.array([payload == name for payload in over.payload])
            pulled = wrenches_in(over.wrenches, np.flatnonzero(mine))
            groups.append((name, over.q[mine], {key: values[mine] for key, values in columns.items()}, pulled))
        where = f"the {len(over)} rows given"
    lost = [_lost(whole, *group) for group in groups]
    at_work = [effect.title for effect in whole.effects if not effect.law.changes_model]
    lines = [f"What this file leaves out (compliance, effects, loads) moves the tip, over {where}, by"]
    for group in lost:
        buckled = f"; {group.unanswered} have no answer" if group.unanswered else ""
        effects = f", {group.effects * 1e3:.3g} mm at most by effects" if at_work else ""
        size = f"RMS {group.rms * 1e3:.3g} mm, at most {group.most * 1e3:.3g} mm{effects}"
        lines.append(f"  payload {group.payload!r}: {size if group.rows else 'unknown'} ({group.rows} rows{buckled})")
    if at_work:
        lines.append(f"  effects that are left out: {listing(at_work)}")
    if aside:
        names = listing(effect.title for effect in aside)
        lines.append(f"  not in these numbers, as they need recorded columns: {names}; --over ROWS.csv has them")
    numbers = {"left_out": [vars(group) for group in lost], "without": [effect.name for effect in aside], **opened}
    return (*lines, *unknown), numbers


def _loops_left_out(arm: Arm, q: Array) -> tuple[tuple[str, ...], dict[str, Any]]:
    """Return what a tree says of a mechanism over (N, nq) positions of its drives, in words and [m]."""
    linkage, ties = arm.robot.linkage, [*arm.robot.linkage.closures, *(spring.name for spring in arm.springs)]
    gone = (f"Loops, cylinders and springs are left out: {listing(ties)}.",) if ties else ()
    zeros = [(cylinder.name, arm.corrections.joint_offset.get(cylinder.name, 0.0)) for cylinder in linkage.cylinders]
    if longer := [f"{name} by {1e3 * zero:.3g} mm" for name, zero in zeros if zero]:
        gone += (f"Cylinders are longer than their columns say: {listing(longer)}. No joint of the tree has that.",)
    free = [i for i, joint in enumerate(arm.robot.swept) if joint.name in linkage.free]
    if not free:
        return gone, {}
    frames, closed = joint_frames(arm, zeros=True), positions(arm, q)
    closed = closed[np.isfinite(closed).all(axis=1)]
    opened = closed.copy()
    opened[:, free] = 0.0
    away = np.linalg.norm((tips(arm, frames, opened) - tips(arm, frames, closed))[:, :3, 3], axis=1)
    most, names = float(away.max(initial=0.0)), listing(arm.robot.swept[i].name for i in free)
    text = f"Joints without a drive stay joints ({names}). The figures are for where the loops close; with these joints"
    return (*gone, f"{text} at zero the tip is up to {most * 1e3:.3g} mm away."), {"loops_open_m": most}


def _lost(arm: Arm, payload: str, q: Array, columns: dict[str, Array], pulled: tuple[Wrench, ...]) -> Lost:
    """Return how far the arm is from its rigid self in (N, nq) rows of a payload with their (N,) columns and forces."""
    rigid = tips(arm, joint_frames(arm, zeros=True), positions(arm, q))[:, :3, 3]
    tip = _answers(arm, payload, q, columns, pulled)
    plain = _answers(replace(arm, effects=()), payload, q, columns, pulled) if arm.effects else tip
    answered = np.isfinite(tip).all(axis=1) & np.isfinite(rigid).all(axis=1)
    away = np.linalg.norm(tip - rigid, axis=1)[answered]
    share = np.linalg.norm(tip - plain, axis=1)[answered & np.isfinite(plain).all(axis=1)]
    rms = float(np.sqrt(np.mean(np.square(away)))) if len(away) else 0.0
    return Lost(
        payload, len(away), len(q) - len(away), rms, float(away.max(initial=0.0)), float(share.max(initial=0.0))
    )


def _answers(arm: Arm, payload: str, q: Array, columns: dict[str, Array], pulled: tuple[Wrench, ...]) -> Array:
    """Return the (N, 3) place of the tip, NaN in rows that have no answer."""
    loaded: dict[str, Any] = {"payload": payload, "enforce_limits": False}
    try:
        rows: ManyRows = q
        return arm.deflection(rows, covariates=columns, wrenches=pulled, **loaded).pose[:, :3, 3]
    except tuple(NO_ANSWER.values()):
        tips = np.full((len(q), 3), np.nan)
    for i in range(len(q)):
        with suppress(*NO_ANSWER.values()):
            given = {name: values[i] for name, values in columns.items()}
            wrenches = wrenches_in(pulled, i)
            tips[i] = arm.deflection(q[i], covariates=given, wrenches=wrenches, **loaded).pose.translation
    return tips
