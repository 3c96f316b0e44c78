"""How much of an undeclared effect calibration hides: its share that no permitted change of the declaration makes."""

import copy
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from support.campaign_files import declared_text
from support.campaigns import NUDGE, SIGMA, Drawn, read
from support.plant import Array, Plant, pose, turn

PRIOR = {"offset": 1e-3, "compliance": 0.2, "target": 5e-3, "shift": 5e-4, "turn": 5e-5}

ROUNDS = 6


@dataclass(frozen=True)
class Visible:
    """What the effects leave behind when calibration has done what it may.

    Attributes:
        rms: 3-D RMS [m] over the readings of train.csv, without noise.
        strain: Largest move of a calibrated parameter that the effects cause, in its prior standard deviations.
        evidence: Fall of the information criterion by an effect and all its constants in these readings, their errors
            and the machine's own deviations from the declaration as drawn; nan where it was not asked.
    """

    rms: float
    strain: float
    evidence: float = np.nan


def visible(drawn: Drawn) -> Visible:
    """Calibrate the effects' movement away as far as [prior] lets it, linearised about the true machine."""
    shown = drawn.rows.measured
    left, taken, _ = _absorbed((drawn.readings() - drawn.readings(()))[shown], *calibration_columns(drawn))
    return Visible(_rms(left), float(np.abs(taken).max()))


def visible_each(drawn: Drawn) -> list[Visible]:
    """Return the same for every effect by itself, which other sizes and constants of the others may take over, too.

    Both what is left and the moves that the priors speak against are evidence of it, and every number that it takes
    counts against it: size and constants.
    """
    shown, columns, spread = drawn.rows.measured, *calibration_columns(drawn)
    whole, found, errors = drawn.readings(), [], drawn.errors[shown].ravel() / SIGMA
    without = [tuple(other for other in drawn.effects if other is not one) for one in drawn.effects]
    moved = [(whole - drawn.readings(rest))[shown] for rest in without]
    bent = [
        [((drawn.readings((*rest, near)) - whole) / NUDGE)[shown] for near in one.nearby()]
        for one, rest in zip(drawn.effects, without, strict=True)
    ]
    for number, own in enumerate(moved):
        others = [other for i in range(len(moved)) if i != number for other in (moved[i], *bent[i])]
        free = np.append(spread, np.ones(len(others)))
        left, taken, deviations = _absorbed(
            own, np.concatenate([columns, *(one[..., None] for one in others)], axis=-1), free, true_deviations(drawn)
        )
        gain = float((left**2).sum()) / SIGMA**2 + float((taken**2).sum())
        seen = gain + float(left.ravel() @ errors) / SIGMA + float(taken @ deviations)
        constants = np.stack([one.ravel() / max(np.linalg.norm(one), SIGMA) for one in (own, *bent[number])])
        count = np.linalg.matrix_rank(constants, 1e-6)
        evidence = max(seen, 0.0) ** 2 / gain - count * np.log(own.size)
        found.append(Visible(_rms(left), float(np.abs(taken).max()), float(evidence)))
    return found


def _absorbed(
    moved: Array, columns: Array, spread: Array, deviations: Array | None = None
) -> tuple[Array, Array, Array]:
    """Return what is left of a movement (readings, 3) when columns have taken what they may, and what priors have held.

    That is how far what they hold was moved, in standard deviations, and where it was on the true machine.
    """
    scaled, held, by_factor = columns.reshape(moved.size, -1) * spread, spread < 1.0, spread == PRIOR["compliance"]
    prior = np.diag(np.where(held, 1.0, 1e-9))
    values, left = np.zeros(len(spread)), moved.ravel()
    for _ in range(ROUNDS):  # a prior of a factor is one of its logarithm
        slopes = scaled * np.where(by_factor, np.exp(spread * values), 1.0)
        wanted = np.concatenate([(left + slopes @ values) / SIGMA, np.zeros(len(prior))])
        values = np.linalg.lstsq(np.vstack([slopes / SIGMA, prior]), wanted, rcond=None)[0]
        left = moved.ravel() - scaled @ np.where(by_factor, np.expm1(spread * values) / spread, values)
    left = left.reshape(moved.shape)
    return left, values[held], np.zeros(held.sum()) if deviations is None else deviations


def _rms(left: Array) -> float:
    return float(np.sqrt((left**2).sum(axis=1).mean()))


def true_deviations(drawn: Drawn) -> Array:
    """Return how far the true machine and its sessions are from the declaration, in the order of the prior spreads."""
    plant, declared = drawn.plant, Plant.read_text(declared_text(drawn.arm))
    softer = [np.log(np.diag(c) / np.diag(declared.compliance[name])) for name, c in plant.compliance.items()]
    frames = [
        np.concatenate([one[:3, 3] / PRIOR["shift"], Rotation.from_matrix(one[:3, :3]).as_rotvec() / PRIOR["turn"]])
        for one in drawn.shifts
    ]
    offsets, target = np.array([plant.offset[joint.name] for joint in plant.joints]), plant.target / PRIOR["target"]
    return np.concatenate([offsets / PRIOR["offset"], np.concatenate(softer) / PRIOR["compliance"], target, *frames])


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
