"""What goes into a controller: joint offsets, Denavit-Hartenberg parameters, tool and stiffness, and how well known.

With all frames turned so that joints move along z, the constant pose between two joints is, read from base to tip,

    Rz(g) Tz(c) . Tx(a) Rx(alpha) Ry(beta) . Tz(b) Rz(f)

whose outer parts commute with the joints' own motions. What stands between the middle parts of two neighbours is
therefore theta and d of the joint between them, in the standard (distal) and the modified (proximal, Craig) form alike;
the two differ only in the joint whose row the middle part is written in. Denavit and Hartenberg have beta = 0. Between
nearly parallel axes that puts the common normal far away, so Hayati and Mirmirani (1985) have c = 0 instead.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from armflex.arm import Arm, Setup
from armflex.conventions import RESOLUTION, TWIST_NAMES, Array, number, printable
from armflex.errors import MissingCovariateError, listing
from armflex.estimate.posterior import OTHER_PARAMETERS, blocks_of
from armflex.export import Exported
from armflex.export.rigid import (
    configurations,
    holds_at,
    joint_frames,
    left_out,
    needs_columns,
    positions,
    tips,
    with_constants,
)
from armflex.files.dh_table import first_row
from armflex.laws import Row
from armflex.laws.effects.effect import Act, Effect
from armflex.laws.effects.in_arm import BoundTwist
from armflex.laws.effects.location import BASE, LINK, resolve
from armflex.measured.measurements import read_measurements
from armflex.measured.table import csv_text
from armflex.parameters import ParameterKind, fitted_group
from armflex.readings.instrument import Instrument
from armflex.robot import Corrections
from armflex.robot.urdf import drive_of

NEARLY_PARALLEL = 0.1
"""Sine of the angle between axes below which the row is Hayati's: without it an error of an axis' place or direction is
in theta and d more than ten times as large."""

AS_BEFORE = 0.9
"""Share of its prior standard uncertainty from which a number is no better known than before the campaign."""

LINEAR = 0.1
"""Standard uncertainty of an angle [rad] up to which sines are as good as straight."""

FINEST = 1e-9
"""Standard uncertainty [m, rad] below which it is what is left of others that cancel, and not stated."""

NOTES = {
    "joint_offset": "is added to the controller's reading",
    "dh_standard": "Rz(theta) Tz(d) Tx(a) Rx(alpha) Ry(beta); the position, offset added, adds to theta or to d",
    "dh_modified": "Tx(a) Rx(alpha) Ry(beta) Rz(theta) Tz(d); the position, offset added, adds to theta or to d",
    "base": "pose of the first row's frame in the base",
    "tool": "pose of the tip in the last row's frame",
    "target": "the measured point in the tip's frame",
    "holds_at": "the column at which all of these hold; what follows it is left out elsewhere",
    "stiffness": "load per deflection along or about one axis, no other load; deflections of several at a joint add",
}
"""Sections of a sheet in their order, and what their numbers are. Turning joints add to theta, sliding ones to d."""


class Key(NamedTuple):
    """Which number it is: section, joint or flexure ('' where there is only one), quantity, unit."""

    section: str
    of: str
    quantity: str
    unit: str


class Split(NamedTuple):
    """How a pose between two joints is taken apart: with Hayati's beta or not, and which of two ways x points."""

    hayati: bool
    flipped: bool


def export(arm: Arm, over: Path | None = None) -> Exported:
    """Return an arm's sheet, as CSV for a file and as a page for a screen.

    Standard uncertainties are those of the posterior covariance of the fit, propagated by derivatives: linear in the
    parameters. A number that depends on what neither campaign nor prior determined has an infinite one; one that
    depends on nothing that was fitted has none, but for declared compliances, which have that of their laws.

    Args:
        arm: The arm.
        over: Rows over which what a sheet leaves out is stated; the joints' limits when None.

    Raises:
        TableError, MissingCovariateError: The rows cannot be used.
    """
    whole = with_constants(arm)
    rows = None if over is None else read_measurements(over, arm, inputs_only=True)
    splits = _splits(arm)
    values = numbers(Setup(arm, arm.instrument or Instrument()), splits)
    std, warnings = uncertainties(arm, splits, values)
    if plays := _unstated(arm):
        text = f"No stiffness is stated where {listing(effect.title for effect in plays)} gives: that is no constant."
        warnings = (*warnings, text)
    if vague := [key for key in values if key.section == "stiffness" and std.get(key, 0.0) > values[key]]:
        text = "is more uncertain than it is large, and not stated"
        warnings = (*warnings, *(f"The stiffness of {key.of} {key.quantity} {text}." for key in vague))
        values = {key: value for key, value in values.items() if key not in vague}
    values |= {Key("holds_at", column, "temperature", "degC"): at for column, at in holds_at(whole).items()}
    notes, lost = left_out(whole, rows)
    chain = [joint.name for joint in arm.robot.swept]
    parallel = [chain[i : i + 2] for i, split in enumerate(splits) if split.hayati]
    if parallel and (most := without_beta(whole, splits)) > RESOLUTION:
        pairs = listing(" and ".join(pair) for pair in parallel)
        text = f"{pairs}: axes are nearly parallel, so their rows have Hayati's beta and common normals that fit it"
        notes += (f"{text}; a controller without beta is off by up to {most * 1e3:.3g} mm at the tip",)
        lost |= {"without_beta_m": most}
    return Exported(_table(values, std), (*warnings, *notes), lost, page=_page(arm, values, std))


def joint_zeros(arm: Arm) -> dict[str, tuple[float, float, str]]:
    """Return by joint what is added to the controller's reading, its standard uncertainty, and their unit, m or rad.

    It is the whole error of a joint's zero: that of its offset, and of frames that are turned about its axis.
    """
    splits = _splits(arm)
    values = numbers(Setup(arm, arm.instrument or Instrument()), splits)
    std, _ = uncertainties(arm, splits, values)
    zeros = [key for key in values if key.section == "joint_offset"]
    return {key.of: (values[key], std.get(key, 0.0), key.unit) for key in zeros}


def _splits(arm: Arm) -> list[Split]:
    """Return how the arm that the controller knows is taken apart, so that its rows can be compared with these."""
    return [choose(frame) for frame in joint_frames(replace(arm, corrections=Corrections()), zeros=False)[1:-1]]


def numbers(setup: Setup, splits: Sequence[Split]) -> dict[Key, float]:
    """Return every number of the sheet [m, rad, N, Nm] of an arm as it is, with its poses taken apart in given ways.

    A joint's offset and the theta (or d) of its row are one number, as only their sum is in a pose: theta (or d) is
    that of the declared arm and the offset has the whole error. Of the d of two joints with parallel axes, that of the
    first is as declared and that of the second has the error of both.
    """
    arm = replace(setup.arm, corrections=Corrections(), effects=())  # nor effects that change its kinematics
    declared = _taken(replace(setup, arm=arm), splits)
    taken = _taken(setup, splits, declared)
    for joint in setup.arm.robot.swept:
        if joint not in setup.arm.robot.moving:
            continue  # it stands where the loops put it, and has no reading
        sliding = joint.kind == "prismatic"
        for section in ("dh_standard", "dh_modified"):
            position = Key(section, joint.name, "d", "m") if sliding else Key(section, joint.name, "theta", "rad")
            error = taken[position] - declared[position]
            taken[position] = declared[position]
            if section == "dh_standard":
                zero = Key("joint_offset", joint.name, "offset", position.unit)
                taken[zero] += error if sliding else float(np.arctan2(np.sin(error), np.cos(error)))
    return taken


def _taken(setup: Setup, splits: Sequence[Split], like: Mapping[Key, float] | None = None) -> dict[Key, float]:
    """Return `numbers` as the poses between joints are taken apart; d of the first of parallel axes as in `like`."""
    arm = with_constants(setup.arm)
    values: dict[Key, float] = {}
    for joint in arm.robot.moving:
        offset = arm.corrections.joint_offset.get(joint.name, 0.0)
        values[Key("joint_offset", joint.name, "offset", "m" if joint.kind == "prismatic" else "rad")] = offset
    frames = joint_frames(arm, zeros=False)
    frames[0], *first = _based(arm, frames[0])
    ends = [np.array([0.0, 0.0, 0.0, 0.0, 0.0, *first])]
    for joint, frame, split in zip(arm.robot.swept, frames[1:-1], splits, strict=False):
        held = like is not None and split.hayati and joint.kind != "prismatic"
        ahead = like[Key("dh_standard", joint.name, "d", "m")] - ends[-1][5] if held and like else 0.0
        ends.append(taken_apart(pin.SE3(np.eye(3), np.array([0.0, 0.0, -ahead])) * frame, split))
        ends[-1][1] += ahead
    ends.append(np.zeros(7))
    for section in ("dh_standard", "dh_modified"):
        for i, name in enumerate(joint.name for joint in arm.robot.swept):
            (*_, b, f), (g, c, *_) = ends[i], ends[i + 1]
            a, alpha, beta = ends[i + 1 if section == "dh_standard" else i][2:5]
            row = {"theta": f + g, "d": b + c, "a": a, "alpha": alpha, "beta": beta}
            for quantity, value in row.items():
                angle = quantity not in ("d", "a")
                turned = float(np.arctan2(np.sin(value), np.cos(value))) if angle else float(value)
                values[Key(section, name, quantity, "rad" if angle else "m")] = turned + 0.0
    for section, frame in (("base", frames[0]), ("tool", frames[-1])):
        values |= {Key(section, "", axis, "m"): float(x) for axis, x in zip("xyz", frame.translation, strict=True)}
        angles = zip(("roll", "pitch", "yaw"), pin.rpy.matrixToRpy(frame.rotation), strict=True)
        values |= {Key(section, "", name, "rad"): float(x) for name, x in angles}
    if setup.arm.instrument is not None:
        values |= {
            Key("target", "", axis, "m"): float(x) for axis, x in zip("xyz", setup.instrument.target, strict=True)
        }
    return values | {key: 1.0 / compliance for key, (compliance, *_) in _compliances(arm).items()}


def _based(arm: Arm, pose: pin.SE3) -> tuple[pin.SE3, float, float]:
    """Return the base's pose, and d [m] and theta [rad] of the first row, of the pose of the first joint.

    Only their sum is in a pose. Of an arm by rows, the base is turned and shifted about the first axis as declared, and
    the row has the whole error, as the rows are named elsewhere (`in_dh_words`). Else the base's pose is all of it.
    """
    joint = arm.robot.swept[0]
    declared = first_row(arm.robot.urdf, joint)
    if declared is None:
        return pose, 0.0, 0.0
    theta, d = declared
    off = pin.SE3(joint.rotation, joint.origin).inverse() * pose
    d, theta = d + float(off.translation[2]), theta + float(np.arctan2(off.rotation[1, 0], off.rotation[0, 0]))
    z = np.array([0.0, 0.0, 1.0])
    return pose * pin.SE3(pin.exp3(theta * z), d * z).inverse(), d, theta


def choose(pose: pin.SE3) -> Split:
    """Return how the pose between two joints is best taken apart."""
    across = pose.rotation[:2, 2]
    hayati = float(np.hypot(*across)) < NEARLY_PARALLEL
    split = Split(hayati, False)
    # Of the two ways that x may point, the one that turns the first joint's zero the less.
    return Split(hayati, bool(abs(taken_apart(pose, split)[0]) > 0.5 * np.pi + RESOLUTION))


def taken_apart(pose: pin.SE3, split: Split) -> Array:
    """Return (7,) g c a alpha beta b f of the pose between two joints; their order is that of the module's formula."""
    axis, place = pose.rotation[:, 2], pose.translation
    b, c = (float(place[2] / axis[2]), 0.0) if split.hayati else (0.0, 0.0)
    # Hayati's x points to where the second axis meets the first one's plane, Denavit's along the common normal.
    ahead = (place - b * axis)[:2] if split.hayati else np.array([-axis[1], axis[0]])
    g = float(np.arctan2(ahead[1], ahead[0])) if np.hypot(*ahead) > RESOLUTION else 0.0
    g += np.pi * np.sign(-g or 1.0) if split.flipped else 0.0
    back = pin.exp3(np.array([0.0, 0.0, -g]))
    (x, y, z), (a, across, along) = back @ axis, back @ place
    alpha, beta = np.arctan2(-y, z), np.arcsin(np.clip(x, -1.0, 1.0)) if split.hayati else 0.0
    if split.hayati:
        a -= b * x
    else:
        b = across / y
        c = along - b * z
    tilted = pin.exp3(np.array([alpha, 0.0, 0.0])) @ pin.exp3(np.array([0.0, beta, 0.0]))
    rest = tilted.T @ back @ pose.rotation
    return np.array([g, c, a, alpha, beta, b, np.arctan2(rest[1, 0], rest[0, 0])])


def without_beta(arm: Arm, splits: Sequence[Split]) -> float:
    """Return the most that the tip moves [m] over configurations within the limits where every beta is left out."""
    frames, q = joint_frames(arm, zeros=False), positions(arm, configurations(arm))
    straight = []
    for frame, split in zip(frames[1:-1], splits, strict=True):
        g, c, a, alpha, _, b, f = taken_apart(frame, split)
        x, z = np.eye(3)[0], np.eye(3)[2]
        parts = ((z, g, c), (x, alpha, a), (z, f, b))
        first, middle, last = (pin.SE3(pin.exp3(turn * axis), way * axis) for axis, turn, way in parts)
        straight.append(first * middle * last)
    moved = tips(arm, frames, q) - tips(arm, [frames[0], *straight, frames[-1]], q)
    return float(np.linalg.norm(moved[:, :3, 3], axis=1).max())


def uncertainties(
    arm: Arm, splits: Sequence[Split], values: Mapping[Key, float]
) -> tuple[dict[Key, float], tuple[str, ...]]:
    """Return the standard uncertainty of each number that has one, and warnings about them."""
    fitted_groups, stds = arm.certainty.groups if arm.certainty else (), {}
    row = Row(arm.robot.home, arm.joint_index)
    declared = {flexure.name: flexure.law for flexure in arm.flexures if fitted_group(flexure) not in fitted_groups}
    for key, (compliance, axis) in _compliances(with_constants(arm)).items():
        law = declared.get(key.of)
        covariance = None if law is None else law.covariance(axis, row)
        if law is not None and covariance is not None:
            if (scatter := law.scatter(axis, row)) is not None:  # by which a reading of a bench is off, not the law
                covariance = covariance - np.square(law.widening(axis, row)) * scatter
            stds[key] = float(np.sqrt(max(axis @ covariance @ axis, 0.0))) / compliance**2
    if arm.certainty is None:
        return stds, ("Nothing was fitted to this arm: only declared uncertainties are given.",)
    certainty, setup = arm.certainty, Setup(arm, arm.instrument or Instrument())
    blocks = blocks_of(certainty.parameters, setup)
    if blocks is None:
        return stds, (f"{OTHER_PARAMETERS}",)
    columns, size, place = [], np.sqrt(np.diag(certainty.covariance)), 0
    for block in blocks:
        for i, parameter in enumerate(block.parameters):
            column = np.zeros(len(values))
            if parameter.group.moves or parameter.group.kind is ParameterKind.TOOL:
                step = np.zeros(len(block.parameters))
                step[i] = min(1e-2 * size[place], 1e-3) or 1e-6
                ends = [numbers(block.stepped(setup, side * step), splits) for side in (1.0, -1.0)]
                column = np.array([ends[0][key] - ends[1][key] for key in values])
                angle = np.array([key.unit == "rad" for key in values])
                column = np.where(angle, np.arctan2(np.sin(column), np.cos(column)), column) / (2.0 * step[i])
            columns.append(column)
            place += 1
    jacobian = np.array(columns).T
    variance = np.einsum("dp,pq,dq->d", jacobian, certainty.covariance, jacobian, optimize=True)
    std = np.where(certainty.leaves_open(jacobian[:, None])[:, 0], np.inf, np.sqrt(np.maximum(variance, 0.0)))
    # What no parameter has a part in is as declared, which is not to say that it is sure.
    fitted = {k: float(x) for k, x in zip(values, std, strict=True) if x > (FINEST if k.unit in ("m", "rad") else 0)}
    stds |= fitted
    warnings = []
    prior = np.array(
        [arm.prior.of(parameter)[1] if parameter.group.moves else np.inf for parameter in certainty.parameters]
    )
    before = np.sqrt(np.einsum("dp,p,dp->d", jacobian, np.where(np.isfinite(prior), prior, 0.0) ** 2, jacobian))
    of_arm = [k.section not in ("target", "stiffness") for k in values]
    same = [
        k
        for k, x, y, of_this_arm in zip(values, std, before, of_arm, strict=True)
        if of_this_arm and x > AS_BEFORE * y > RESOLUTION
    ]
    if same:
        names = (" ".join(filter(None, key[:3])) for key in same if key.section != "dh_modified")
        text = "they only say where base, tracker or target stand, or no row shows them"
        warnings.append(f"As uncertain as before the campaign, because {text}: {listing(names)}.")
    if certainty.undetermined:
        warnings.append(f"Neither campaign nor prior determines {listing(certainty.undetermined)}.")
    if wide := [key for key, x in stds.items() if key.unit == "rad" and key.section.startswith("dh") and x > LINEAR]:
        names = listing(dict.fromkeys(f"{key.quantity} of {key.of}" for key in wide))
        text = "are known to no better than 0.1 rad, where the linear uncertainty is not valid"
        warnings.append(f"{names} {text}; what they do against each other cancels, so the arm is known better.")
    return stds, tuple(warnings)


def _compliances(arm: Arm) -> dict[Key, tuple[float, Array]]:
    """Return the small-load compliance along each compliant axis (6,), and the axis, with the joints at home.

    Effects that are compliances themselves, whatever else is known of a row, have their part in it. Where one turns
    that has none at no load, play or hysteresis, a number of the others would be far too stiff: see `_unstated`.
    About a drive's axis a link that ends at the joint and the joint itself give as one.
    """
    twists = [effect for effect in arm.effects if effect.law.act is Act.TWIST and not effect.law.changes_model]
    linear = [each for each in twists if BoundTwist(each, resolve(each.location, arm.robot, arm.flexures)).proportional]
    usable = tuple(effect for effect in linear if not needs_columns(arm, effect))
    joints = {joint.name: joint for joint in arm.robot.moving}
    compliances: dict[Key, tuple[float, Array]] = {}
    unstated = [effect.location for effect in _unstated(arm)]
    modelled = sorted(replace(arm, effects=usable).modelled, key=lambda flexure: flexure.before)
    driven = {flexure.joint: flexure.name for flexure in modelled if flexure.joint in joints and not flexure.before}
    for flexure in modelled:
        tangent = flexure.law.tangent(np.zeros(6), Row(arm.robot.home, arm.joint_index))
        axes, joint = dict(zip(TWIST_NAMES, np.eye(6), strict=True)), flexure.joint or BASE
        if joint in driven:
            drive = drive_of(joints[joint])
            others = {name: axis for name, axis in axes.items() if not np.array_equal(axis, np.abs(drive))}
            axes = {"drive": drive, **others}
        for name, axis in axes.items():
            series = name == "drive"  # what gives about the drive's axis before and behind it is one stiffness
            sites = (LINK + joint, joint) if series else (f"{LINK * flexure.before}{joint}",)
            there = (place.axis for place in unstated if place.site in sites)
            compliance = float(axis @ tangent @ axis)
            if compliance > 0.0 and not any(at is None or axis[TWIST_NAMES.index(at)] for at in there):
                unit = "Nm/rad" if axis[3:].any() else "N/m"
                key = Key("stiffness", driven[joint] if series else flexure.name, name, unit)
                compliances[key] = compliance + compliances.get(key, (0.0, axis))[0], axis
    return compliances


def _unstated(arm: Arm) -> list[Effect]:
    """Return the effects with a name by which something gives under a load, but has no compliance at no load."""
    plays, at_home = list[Effect](), Row(arm.robot.home, arm.joint_index)
    for effect in arm.effects:
        law = effect.law
        if law.act is not Act.TWIST or not law.physical or law.changes_model or not law.of_load(effect.location):
            continue
        bound = BoundTwist(effect, resolve(effect.location, arm.robot, arm.flexures))
        with suppress(MissingCovariateError):  # what depends on more is left out and said by itself
            if law.remembers_load(effect.location) or not bound.tangent(np.zeros(6), at_home).any():
                plays.append(effect)
    return plays


def _table(values: Mapping[Key, float], std: Mapping[Key, float]) -> str:
    """Return the sheet as CSV; a cell of what is not known is empty."""
    rows: list[tuple[str, ...]] = [(*Key._fields[:3], "value", "std", "unit", "value_deg", "std_deg", "note")]
    for key, value in values.items():
        cells = [repr(value if abs(value) > RESOLUTION else 0.0), repr(std[key]) if key in std else ""]
        degrees = [repr(float(np.degrees(float(cell)))) if cell and key.unit == "rad" else "" for cell in cells]
        rows.append((*key[:3], *cells, key.unit, *degrees, NOTES[key.section]))
    return csv_text(rows)


def _page(arm: Arm, values: Mapping[Key, float], std: Mapping[Key, float]) -> str:
    """Return the sheet for a screen or a printer: a table for each section, angles in degrees and lengths in mm."""
    lines = [f"{arm.robot.urdf.name}: base {arm.robot.base}, tip {arm.robot.tip}"]
    for section, note in NOTES.items():
        keys = [key for key in values if key.section == section]
        columns = list(dict.fromkeys(key.quantity for key in keys))
        columns.sort(key=lambda name: TWIST_NAMES.index(name) if name in TWIST_NAMES else -1)
        rows = [["", *columns, *(["the same"] if section == "joint_offset" else [])]]
        for of in dict.fromkeys(key.of for key in keys):
            cells = {key.quantity: key for key in keys if key.of == of}
            rows.append([of, *(_cell(values, std, cells.get(name), True) for name in columns)])
            if section == "joint_offset":
                rows[-1].append(_cell(values, std, cells[columns[0]], False))
        if keys:
            widths = [max(len(printable(row[i])) for row in rows) for i in range(len(rows[0]))]
            lines += ["", f"{section.replace('_', ' ')}: {note}"]
            lines += ["  ".join(printable(cell).ljust(w) for cell, w in zip(row, widths, strict=True)) for row in rows]
    return "\n".join(printable(line).rstrip() for line in lines) + "\n"


def _cell(values: Mapping[Key, float], std: Mapping[Key, float], key: Key | None, usual: bool) -> str:
    """Return a number with its uncertainty and its unit, a usual one rather than that of SI."""
    if key is None:
        return "-"
    scale, unit = {"rad": (180.0 / np.pi, "deg"), "m": (1e3, "mm")}.get(key.unit, (1.0, key.unit))
    scale, unit = (scale, unit) if usual else (1.0, key.unit)
    value = (
        number(values[key] * scale, 4, 0.0)
        if key.section == "stiffness"
        else f"{round(values[key] * scale, 5) + 0.0:.5f}"
    )
    if key not in std:
        return f"{value} {unit}"
    interval = f"± {number(std[key] * scale, 2, 0.0)}" if np.isfinite(std[key]) else "undetermined"
    return f"{value} {interval} {unit}"
