"""Where the instrument stands, the one thing without a prior: a rigid fit of it, and whether readings determine it."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin

from armflex.arm import Arm, Setup
from armflex.conventions import RESOLUTION, TWIST_NAMES, Array
from armflex.errors import ConventionError, IdentifiabilityError
from armflex.estimate.robust import outlier_limit
from armflex.estimate.seen_rows import place_target
from armflex.estimate.view import postures, solved
from armflex.measured.measurements import Measurements
from armflex.mechanics.response import Response
from armflex.readings import Position, Touch, sockets_of
from armflex.readings.end import rigid_motion
from armflex.readings.instrument import (
    ROUNDS,
    Instrument,
    fit_frame,
    fit_mounting,
    motion_of,
    rigid_fit,
)

COARSEST_TURN = 0.05
"""Tolerance: standard uncertainty of the instrument's orientation [rad] beyond which the data do not determine it."""

FEWEST_ROWS = 4
"""Tolerance: readings that determine where an instrument stood, and below which nothing is fitted."""

SCALE_KNOWN = 2e-3
"""Prior: share by which [prior] may leave the scale of an arm open before touches alone make it up."""

STOOD_ELSEWHERE = 0.015
"""Prior: how far its points move [m] where an instrument was not set up again at its marks, as `session_frame` has it,
but stood elsewhere."""


def first_guess(
    arm: Arm,
    measurements: Measurements,
    rows: np.ndarray,
    line: Response | None = None,
    instrument: Instrument | None = None,
    allow_large: bool = False,
) -> tuple[Setup, Response]:
    """Return the arm with its instrument placed by a best rigid fit where its frame is unknown, and its response.

    Gravity that is known in the instrument's frame turns with that, and bends the arm otherwise: it is placed again. In
    several campaigns it is placed in each by itself; see `Instrument.campaigns`.

    Args:
        arm: The arm as declared.
        measurements: The campaign.
        rows: (M,) numbers of the rows.
        line: The linearised arm at those rows, where it is known.
        instrument: Where it stands, near enough; it is placed where not given.
        allow_large: Whether flexures may turn by more than 0.1 rad.
    """
    chosen = measurements.some(rows)
    pieces, stands = chosen.pieces, instrument or arm.instrument or Instrument()
    several = len(pieces) > 1
    if instrument is None:  # what an arm knows of campaigns before is not of these
        stands = replace(stands, campaigns=tuple(pieces) if several else ())
        stands = replace(stands, sessions=dict.fromkeys(pieces, np.zeros(6))) if several else stands
    setup = Setup(arm, stands)

    line = solved(setup, measurements, rows, allow_large) if line is None else line
    turns, open_ = arm.measurement.gravity_in == "measurement", arm.measurement.frame != "base" and instrument is None
    for _ in range(ROUNDS if open_ else 0):
        before = setup.instrument.pose
        if several:
            alone = replace(setup, instrument=replace(setup.instrument, sessions={}, campaigns=()))
            each = {name: _stood(alone, line.some(place), measurements, rows[place]) for name, place in pieces.items()}
            setup = _together(each)
        else:
            setup = _stood(setup, line, measurements, rows)
        if not turns:
            break
        line = solved(setup, measurements, rows, allow_large)
        if np.linalg.norm(pin.log3(before.rotation.T @ setup.instrument.pose.rotation)) < COARSEST_TURN:
            break  # about one that was nearly right
    return replace(setup, instrument=_mounted(setup, line.tip, measurements, rows)), line


def _stood(setup: Setup, line: Response, measurements: Measurements, rows: np.ndarray) -> Setup:
    """Return the setup with its instrument placed by a best rigid fit to (M,) rows in which it was not moved."""
    chosen, seen = measurements.some(rows), measurements.positioned[rows]
    targets = [kind for kind in chosen.readings.kinds if kind.name and isinstance(kind, Position)]
    if seen.any():
        points = setup.instrument.in_base(line.tip, chosen.session)[seen]
        return placed_rigidly(setup, points, measurements, rows[seen], line.tip[seen, :3, :3])
    if not targets:
        return setup
    # Further ones are all there is to see where it stands.
    at = postures(setup, line, measurements, rows)
    read = [np.isfinite(kind.sigma).all(axis=1) for kind in targets]
    points = np.concatenate([kind.predicted(at)[mask] for kind, mask in zip(targets, read, strict=True)])
    there = np.concatenate([kind.values[mask] for kind, mask in zip(targets, read, strict=True)])
    return setup.placed(fit_frame(points, there) * setup.instrument.pose)


def _together(each: Mapping[str, Setup]) -> Setup:
    """Return the setup of the first of several campaigns, which knows where the instrument stood in all of them."""
    setup, frames = next(iter(each.values())), dict[str, Array]()
    for name, placed in each.items():
        frames[name] = motion_of(placed.instrument.pose * setup.instrument.pose.inverse())
        frames |= placed.instrument.sessions
    return replace(setup, instrument=replace(setup.instrument, sessions=frames, campaigns=tuple(each)))


def _mounted(setup: Setup, tip: Array, measurements: Measurements, rows: np.ndarray) -> Instrument:
    """Return the instrument with its target turned on the tool as read orientations have it, in each session anew
    where it was mounted anew.
    """
    instrument = setup.instrument
    if measurements.rotation is None or measurements.sigma_r is None:
        return instrument
    read = np.isfinite(measurements.sigma_r[rows])
    if not read.any():
        return instrument
    sessions, turned = np.array([measurements.session[row] for row in rows[read]]), measurements.rotation[rows[read]]
    axes = instrument.session_turns(sessions.tolist()) @ instrument.axes(tip[read])
    several = bool(instrument.campaigns) and not setup.arm.prior.session_target
    names = [instrument.campaign(name) if several else name for name in sessions.tolist()]
    of_name = {name: np.array(names) == name for name in dict.fromkeys(names)}
    here = next(iter(of_name.values())) if several else np.ones(len(names), dtype=bool)  # about the first of them
    mounted = replace(instrument, mounting=fit_mounting(axes[here], turned[here]))
    if not several and not setup.arm.prior.session_target:
        return mounted
    back = pin.exp3(mounted.mounting).T
    each = {name: pin.exp3(fit_mounting(axes[place], turned[place])) @ back for name, place in of_name.items()}
    return replace(mounted, targets={name: np.array([0.0, 0.0, 0.0, *pin.log3(turn)]) for name, turn in each.items()})


def placed_rigidly(
    setup: Setup, points: Array, measurements: Measurements, rows: np.ndarray, axes: Array | None = None
) -> Setup:
    """Return the setup with its instrument where points in the base are seen best, every session by itself.

    Where it stood elsewhere in a session, that is the first guess of the session's frame; all others have none. A
    target that may be far from where it is declared is moved with the frames, so that they do not make up for it.

    Args:
        setup: Arm and instrument, which may be anywhere.
        points: (M, 3) the target in the base frame [m] at each of the rows.
        measurements: The campaign.
        rows: (M,) numbers of the rows.
        axes: (M, 3, 3) the tip's axes in the base there; without them the target is where it is declared.
    """
    seen, sessions = measurements.position[rows], np.array([measurements.session[row] for row in rows])
    names = list(dict.fromkeys(sessions.tolist()))
    groups = [np.flatnonzero(sessions == name) for name in names]
    groups = {name: group for name, group in zip(names, groups, strict=True) if len(group) >= FEWEST_ROWS}
    if axes is not None and setup.arm.prior.tool and groups:
        counted = np.arange(max(map(len, groups.values()))) < np.array([[len(group)] for group in groups.values()])
        places = np.zeros(counted.shape, dtype=int)
        places[counted] = np.concatenate(list(groups.values()))
        every = points[None, places], axes[None, places], seen[None, places]
        target = place_target(*every, setup.arm.prior.tool, counted, rounds=ROUNDS)
        points = points + axes @ (target.target[0] * target.moved[0])
    fits: dict[str, tuple[pin.SE3, float]] = {}
    for name, group in groups.items():
        turn, shift, rms = rigid_fit(points[group], seen[group])
        if (_turns(points[group], max(rms, RESOLUTION)).S > 1.0).all():
            fits[name] = pin.SE3(turn, shift), float(rms)
    near = np.ones(len(rows), bool)
    if len(fits) > 1:
        first = max(fits, key=lambda name: int((sessions == name).sum()))
        for name, (pose, rms) in fits.items():
            off = _moved(points[sessions == name], pose) - _moved(points[sessions == name], fits[first][0])
            limit = max(outlier_limit(1) * max(rms, fits[first][1], setup.arm.prior.session_target), STOOD_ELSEWHERE)
            near &= (sessions != name) | (float(np.sqrt((off**2).sum(axis=1).mean())) <= limit)
    placed = setup.placed(fit_frame(points[near], seen[near]))
    instrument = replace(placed.instrument, sessions={})
    for name in dict.fromkeys(sessions[~near].tolist()):
        instrument = instrument.with_session(name, motion_of(fits[name][0] * instrument.pose.inverse()))
    return replace(placed, instrument=instrument)


def _moved(points: Array, pose: pin.SE3) -> Array:
    return points @ pose.rotation.T + pose.translation


def _turns(points: Array, sigma: Array | float) -> Any:
    """Return the singular values and vectors of how (N, 3) points [m] show turns by `COARSEST_TURN`.

    By their standard deviation. About their centre they always determine a shift.
    """
    jacobian = rigid_motion(points - points.mean(axis=0)) / sigma
    return np.linalg.svd(COARSEST_TURN * jacobian.reshape(-1, 6)[:, 3:], full_matrices=False)


def check_length(arm: Arm, measurements: Measurements) -> None:
    """Raise where nothing carries a length: an arm that shrinks with all its sockets then fits touches ever better.

    Raises:
        ConventionError: All that was read are touches of sockets of unknown place and distance, and [prior] leaves the
            arm's scale open by more than `SCALE_KNOWN`.
    """
    touches = [kind for kind in measurements.readings.kinds if isinstance(kind, Touch)]
    if not touches or any(kind.unit == "m" for kind in measurements.readings.kinds if not isinstance(kind, Touch)):
        return
    for kind in touches:
        stated, sockets = sockets_of(arm.sensors[kind.name]), set(kind.sockets)
        if sockets & ({*stated.place} | {*stated.radius}):
            return
    lengths = float(np.linalg.norm([joint.origin for joint in arm.robot.chain]))
    open_by = arm.prior.geometry / max(lengths, RESOLUTION)
    if open_by <= SCALE_KNOWN:
        return
    name = touches[0].name
    ends = [socket for socket in dict.fromkeys(touches[0].sockets) if socket][:2]
    pair = f'[["{ends[0]}", "{ends[-1]}", 0.05]]' if len(ends) > 1 else '[["one", "other", 0.05]]'
    text = f"nothing in this campaign carries a length: [instrument.{name}] touches sockets whose places and distances "
    text += f"are unknown, and [prior] geometry leaves the arm's scale open by {100.0 * open_by:.2g} %, so that an arm "
    text += f"that shrinks with its sockets fits better and better. Measure one length: distances = {pair} [m] under "
    text += f"[instrument.{name}], or place = {{ {ends[0] if ends else 'socket'} = [x, y, z] }}; or trust the links: "
    raise ConventionError(f"{text}geometry = {SCALE_KNOWN * lengths:.1g} at most under [prior]", ["no length"])


def check_enough(points: Array, sigma: Array) -> None:
    """Raise where poses all alike, or on one line, leave the instrument's orientation open.

    Everything else that a calibration frees has a prior; what data say nothing about stays there and is named.
    Orientations that were read do not count: how the target is turned on the tool is not known either.

    Args:
        points: (N, 3) nominal target in instrument axes [m].
        sigma: (N, 3) standard deviations of the readings [m].

    Raises:
        IdentifiabilityError: With rank, condition and names of what is left free.
    """
    turns = _turns(points, sigma[:, :, None])
    determined = turns.S >= 1.0
    if not determined.all():
        free = (turns.Vh[~determined] ** 2).sum(axis=0) > 0.1
        names = [f"instrument {TWIST_NAMES[3 + axis]}" for axis in np.flatnonzero(free)]
        alike = "are all alike" if not determined.any() else "lie on one line"
        jacobian = rigid_motion(points - points.mean(axis=0)) / sigma[:, :, None]
        condition = float(np.linalg.cond(jacobian.reshape(-1, 6)))
        text = f"{len(points)} measured points {alike}: they do not determine how the instrument stands"
        raise IdentifiabilityError(text, 3 + int(determined.sum()), condition, names)
