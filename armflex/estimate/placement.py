"""Where the instrument stands, the one thing without a prior: whether readings tell it, and a rigid fit of them.

Before anything is fitted measured positions must have the axes and the unit of the arm they were taken on. An
instrument may stand anywhere, but no place makes a left-handed frame right-handed: points that fit far better when
mirrored have two axes swapped or one reversed. Planar points fit equally well both ways, sag moves both fits alike, and
a lost beam is weighed down in both, so none of them is taken for swapped axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import permutations, product

import numpy as np
import pinocchio as pin

from armflex.arm import Arm, Setup
from armflex.conventions import RESOLUTION, TWIST_NAMES, Array, in_mm
from armflex.errors import AxesError, IdentifiabilityError, Place, UnitError
from armflex.measured.measurements import Measurements
from armflex.readings.instrument import ROUNDS, SAME, Instrument, fit_frame, rigid_fit
from armflex.readings.kind import rigid_motion

FEWEST_POINTS = 6
"""Below this many points chance alone lets a mirror fit ten times better."""

NARROWEST = 0.01
"""Spread of the nominal points [m] below which noise says more about their size and hand than they do."""

DROP = 10.0
"""Fall of the residual under a change of axes that is no accident."""

ALIGNED = np.cos(np.radians(15.0))
"""How near a frame's axis must be to the vertical to be called vertical."""

THOUSANDFOLD = (200.0, 5000.0)
"""Ratio of sizes that is a mistaken mm or m rather than a wrong arm."""

NEGLIGIBLE = 1e-5
"""Residual [m] below which points fit, whatever fits better."""


def check_axes(
    points: Array, measured: Array, places: Sequence[Place] = (), pose: pin.SE3 | None = None, up: Array | None = None
) -> None:
    """Raise where measured points are those of the nominal ones in swapped axes or in another unit.

    Args:
        points: (N, 3) nominal target points in the base frame [m].
        measured: (N, 3) where they were measured [m].
        places: File and line of each, for the message.
        pose: T_instrument_base where it is known; otherwise the instrument may stand anywhere.
        up: (3,) vertical in the base frame, z when not given; names the axes of an instrument that stands level.

    Raises:
        AxesError: The points fit over `DROP` times better in changed axes; which ones is said.
        UnitError: The measured points are spread a thousand times as wide or narrow as the nominal ones.
    """
    if len(np.unique(np.round(points, 6), axis=0)) < FEWEST_POINTS or _spread(points) < NARROWEST:
        return
    where = f"{places[0]}: " if places else ""
    ratio = _spread(measured) / max(_spread(points), 1e-12)
    low, high = THOUSANDFOLD
    if low < ratio < high or low < 1.0 / max(ratio, 1e-12) < high:
        text = f"measured positions are spread {ratio:.3g} times as wide as the arm's: mm and m confused?"
        raise UnitError(f"{where}{text} (write the unit into the header: x_mm, y_mm, z_mm)")
    if pose is None:
        straight = rigid_fit(points, measured)[2]
        turn, _, best = rigid_fit(points, measured, -1.0)
        up = np.array([0.0, 0.0, 1.0]) if up is None else up
        found = f"fit {straight / max(best, 1e-12):.0f} times better mirrored ({in_mm(best)} against {in_mm(straight)})"
        swapped = _swapped(turn @ up / np.linalg.norm(up))
        text = f"{found}: {swapped}? Or gravity, or a joint's positions, have the wrong sign"
    else:
        # Readings in a known frame are compared with those in every other order and sign of the axes.
        expected = points @ pose.rotation.T + pose.translation
        tries = [
            (float(np.median(np.linalg.norm(measured[:, list(order)] * signs - expected, axis=1))), order, signs)
            for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3))
        ]
        straight, (best, order, signs) = tries[0][0], min(tries, key=lambda entry: entry[0])
        said = ", ".join(f"{'-' if sign < 0 else ''}{'xyz'[i]}" for i, sign in zip(order, signs, strict=True))
        text = f"are off by {in_mm(straight)}, but by {in_mm(best)} when x, y, z are read as {said}: swapped axes?"
    if straight > NEGLIGIBLE and best * DROP < straight:
        raise AxesError(f"{where}measured positions {text}")


def _spread(points: Array) -> float:
    return float(np.median(np.linalg.norm(points - np.median(points, axis=0), axis=1)))


def _swapped(vertical: Array) -> str:
    """Return which axes a level instrument has likely swapped, from where the vertical stands in its frame."""
    axis = int(np.abs(vertical).argmax())
    if abs(vertical[axis]) < ALIGNED:
        return "two axes swapped, or one reversed (a left-handed frame)"
    if axis == 2:
        return "x and y swapped, or one of them reversed" if vertical[2] > 0.0 else "z reversed"
    return f"{'xy'[axis]} and z swapped (the vertical is along {'xy'[axis]})"


COARSEST = 0.05
"""Standard uncertainty of the instrument's orientation [rad] beyond which the data do not determine it."""


def check_readings(arm: Arm, points: Array, measurements: Measurements, rows: np.ndarray) -> None:
    """Raise where readings cannot be those of an arm, or cannot tell where the instrument stands.

    Args:
        arm: The arm as declared.
        points: (M, 3) its nominal target in the base frame [m] at each of the rows.
        measurements: The campaign.
        rows: (M,) numbers of the rows used.

    Raises:
        AxesError: Axes of the measured positions are swapped or reversed.
        UnitError: All positions are in another unit.
        IdentifiabilityError: The instrument's frame is unknown, and poses are alike or on one line.
    """
    unknown = arm.measurement.frame != "base"
    pose = None if unknown else (arm.instrument or Instrument()).pose
    places = [measurements.places[row] for row in rows] if measurements.places else ()
    up = -arm.robot.gravity if np.any(arm.robot.gravity) else None
    check_axes(points, measurements.position[rows], places, pose, up)
    if unknown:
        frame = fit_frame(points, measurements.position[rows])
        seen = points @ frame.rotation.T + frame.translation
        check_enough(seen, measurements.sigma[rows])


APART, FEWEST, FLAT = 0.015, 4, 0.05
"""How far its points move [m] where an instrument was not set up again at its marks, as `session_frame` has it, but
stood elsewhere; points that tell where, and how far they are off one line at least, as a part of its length."""

FAR = 3.0
"""Times what a rigid fit leaves by which two of them differ for a reason."""


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
    if axes is not None and setup.arm.prior.tool:
        names = list(dict.fromkeys(sessions.tolist()))
        groups = [own for own in (np.flatnonzero(sessions == name) for name in names) if len(own) >= FEWEST]
        points = points + axes @ _target_off(points, axes, seen, groups, setup.arm.prior.tool)
    fits: dict[str, tuple[pin.SE3, float]] = {}
    for name in dict.fromkeys(sessions.tolist()):
        own = points[sessions == name]
        size = np.linalg.svd(own - own.mean(axis=0), compute_uv=False) if len(own) >= FEWEST else np.zeros(3)
        if size[1] > FLAT * size[0]:
            turn, shift, rms = rigid_fit(own, seen[sessions == name])
            fits[name] = pin.SE3(turn, shift), rms
    near = np.ones(len(rows), bool)
    if len(fits) > 1:
        first = max(fits, key=lambda name: int((sessions == name).sum()))
        for name, (pose, rms) in fits.items():
            off = _moved(points[sessions == name], pose) - _moved(points[sessions == name], fits[first][0])
            limit = max(FAR * max(rms, fits[first][1], setup.arm.prior.session_target), APART)
            near &= (sessions != name) | (float(np.sqrt((off**2).sum(axis=1).mean())) <= limit)
    placed = setup.placed(fit_frame(points[near], seen[near]))
    instrument = replace(placed.instrument, sessions={})
    for name in dict.fromkeys(sessions[~near].tolist()):
        there = fits[name][0] * instrument.pose.inverse()
        instrument = instrument.with_session(name, np.concatenate([there.translation, pin.log3(there.rotation)]))
    return replace(placed, instrument=instrument)


def _target_off(points: Array, axes: Array, seen: Array, groups: Sequence[np.ndarray], std: float) -> Array:
    """Return (3,) how far the target is from where points have it, in tip axes [m], frames of all sessions free.

    Zero unless that is most of what frames leave, by a factor of `FAR`: little of it does not mislead them. Gauss and
    Newton's steps, the frames projected out of them (Golub and Pereyra 1973), lost beams weighed down.

    Args:
        points, axes: (M, 3) the target [m] and (M, 3, 3) the tip's axes, in the base.
        seen: (M, 3) where it was seen [m].
        groups: Numbers of each session's points.
        std: One standard deviation of it, each axis [m].
    """
    target, first = np.zeros(3), np.inf
    for number in range(ROUNDS):
        information, gradient, squares, count = np.zeros((3, 3)), np.zeros(3), 0.0, 0.0
        for own in groups:
            here = points[own] + axes[own] @ target
            turn, shift, _ = rigid_fit(here, seen[own])
            there = here @ turn.T
            left = seen[own] - there - shift
            length = np.linalg.norm(left, axis=1)
            limit = 2.0 * max(float(np.median(length)), RESOLUTION)
            weights = np.repeat(np.minimum(1.0, limit / np.maximum(length, RESOLUTION)), 3)
            frame = np.linalg.qr(weights[:, None] * rigid_motion(there).reshape(-1, 6))[0]
            column, error = weights[:, None] * (turn @ axes[own]).reshape(-1, 3), weights * left.ravel()
            column = column - frame @ (frame.T @ column)
            information, gradient = information + column.T @ column, gradient + column.T @ error
            squares, count = squares + error @ error, count + len(error)
        noise = max(squares / max(count, 1.0), RESOLUTION**2) / std**2
        first = squares if number == 0 else first
        step = np.linalg.solve(information + noise * np.eye(3), gradient - noise * target)
        target = target + step
        if np.linalg.norm(step) < SAME * std:
            break
    return target if FAR**2 * squares < first else np.zeros(3)


def _moved(points: Array, pose: pin.SE3) -> Array:
    return points @ pose.rotation.T + pose.translation


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
    jacobian = rigid_motion(points - points.mean(axis=0)) / sigma[:, :, None]
    # About their centre points always tell a shift; a turn must be known to better than COARSEST.
    turns = np.linalg.svd(COARSEST * jacobian.reshape(-1, 6)[:, 3:], full_matrices=False)
    known = turns.S >= 1.0
    if not known.all():
        free = (turns.Vh[~known] ** 2).sum(axis=0) > 0.1
        names = [f"instrument {TWIST_NAMES[3 + axis]}" for axis in np.flatnonzero(free)]
        alike = "are all alike" if not known.any() else "lie on one line"
        condition = float(np.linalg.cond(jacobian.reshape(-1, 6)))
        text = f"{len(points)} measured points {alike}: they do not determine the place of the instrument"
        raise IdentifiabilityError(text, 3 + int(known.sum()), condition, names)
