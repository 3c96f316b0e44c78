"""How much of an undeclared effect calibration hides: its share that no permitted change of the declaration makes."""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np

from support.campaigns import NUDGE, SIGMA, Drawn, read
from support.plant import Array, pose, turn

PRIOR = {"offset": 1e-3, "compliance": 0.2, "target": 5e-3, "shift": 5e-4, "turn": 5e-5}


@dataclass(frozen=True)
class Visible:
    """What the effects leave behind when calibration has done what it may.

    Attributes:
        rms: 3-D RMS [m] over the readings of train.csv, without noise.
        strain: Largest move of a calibrated parameter that the effects cause, in its prior standard deviations.
    """

    rms: float
    strain: float


def visible(drawn: Drawn) -> Visible:
    """Calibrate the effects' movement away as far as [prior] lets it, linearised about the true machine."""
    shown = drawn.rows.measured
    return _left((drawn.readings() - drawn.readings(()))[shown], *calibration_columns(drawn))


def visible_each(drawn: Drawn) -> list[Visible]:
    """Return the same for every effect by itself, which other sizes and constants of the others may take over, too."""
    shown, columns, spread = drawn.rows.measured, *calibration_columns(drawn)
    whole, found = drawn.readings(), []
    without = [tuple(other for other in drawn.effects if other is not one) for one in drawn.effects]
    moved = [(whole - drawn.readings(rest))[shown] for rest in without]
    bent = [
        [((drawn.readings((*rest, near)) - whole) / NUDGE)[shown] for near in one.nearby()]
        for one, rest in zip(drawn.effects, without, strict=True)
    ]
    for number, own in enumerate(moved):
        others = [other for i in range(len(moved)) if i != number for other in (moved[i], *bent[i])]
        free = np.append(spread, np.ones(len(others)))
        found.append(_left(own, np.concatenate([columns, np.stack(others, axis=-1)], axis=-1), free))
    return found


def _left(moved: Array, columns: Array, spread: Array) -> Visible:
    """Return what is left of a movement (readings, 3) when columns have taken what they may; see `Visible`."""
    scaled = columns.reshape(moved.size, -1) * spread
    prior = np.diag(np.where(spread < 1.0, 1.0, 1e-9))
    values, *_ = np.linalg.lstsq(
        np.vstack([scaled / SIGMA, prior]), np.concatenate([moved.ravel() / SIGMA, np.zeros(len(prior))]), rcond=None
    )
    left = (moved.ravel() - scaled @ values).reshape(-1, 3)
    return Visible(float(np.sqrt((left**2).sum(axis=1).mean())), float(np.abs(values[spread < 1.0]).max()))


def calibration_columns(drawn: Drawn) -> tuple[Array, Array]:
    """Columns (readings, 3, parameters) of everything that [prior] frees, and prior spreads; 1 stands for free."""
    plant, shown = drawn.plant, drawn.rows.measured
    calm = plant.relax(drawn.rows)
    start = read(plant, calm, drawn.station, drawn.shifts)
    columns: list[Array] = []

    def add(changed: Array, step: float) -> None:
        columns.append(((changed - start) / step)[shown])

    for joint in plant.joints:
        other = copy.deepcopy(plant)
        other.offset[joint.name] += 1e-6
        add(read(other, other.relax(drawn.rows, (), calm, 1e-12), drawn.station, drawn.shifts), 1e-6)
    for name in plant.compliance:
        for a in range(6):
            other = copy.deepcopy(plant)
            other.compliance[name][a, a] *= 1.0 + 1e-3
            add(read(other, other.relax(drawn.rows, (), calm, 1e-12), drawn.station, drawn.shifts), 1e-3)
    for a in range(3):
        other = copy.deepcopy(plant)
        other.target[a] += 1e-5
        add(read(other, calm, drawn.station, drawn.shifts), 1e-5)
    frames = [drawn.shifts.copy() for _ in range(6 * (len(drawn.shifts) + 1))]
    for n, shifts in enumerate(frames):
        session, a = divmod(n, 6)
        step = np.eye(6)[a] * 1e-6
        which = slice(None) if session == len(drawn.shifts) else session
        shifts[which] = pose(step[:3], turn(step[3:])) @ shifts[which]
        add(read(plant, calm, drawn.station, shifts), 1e-6)
    frame = [PRIOR["shift"]] * 3 + [PRIOR["turn"]] * 3
    spread = [PRIOR["offset"]] * len(plant.joints) + [PRIOR["compliance"]] * 6 * len(plant.compliance)
    spread += [PRIOR["target"]] * 3 + frame * len(drawn.shifts) + [1.0] * 6
    return np.stack(columns, axis=-1), np.array(spread)
