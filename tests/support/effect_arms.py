"""heavy_six with [[effect]] tables of a test's own."""

from __future__ import annotations

import functools
import warnings
from pathlib import Path

import numpy as np

from armflex import Arm, load_arm
from armflex.laws import Row
from armflex.laws.effects import CATALOGUE, EffectLaw
from armflex.laws.effects.location import Location
from armflex.laws.effects.scene import Scene
from support.small_arms import ROBOTS

HEAVY = ROBOTS / "heavy_six"
TEXT = (HEAVY / "arm.toml").read_text().replace('"robot.urdf"', f'"{(HEAVY / "robot.urdf").as_posix()}"')


def quietly(path: Path) -> Arm:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return load_arm(path)


def arm_and(folder: Path, text: str) -> Arm:
    """Load heavy_six with further text at its end."""
    path = folder / "arm.toml"
    path.write_text(TEXT + text)
    return quietly(path)


def arm_with(folder: Path, *tables: str) -> Arm:
    """Load heavy_six with [[effect]] tables at its end."""
    return arm_and(folder, "".join(f"\n[[effect]]\n{table}\n" for table in tables))


@functools.cache
def plain() -> Arm:
    return quietly(HEAVY / "arm.toml")


@functools.cache
def scene() -> Scene:
    """Everything that a law may ask for was recorded: payloads, sessions, time, hold, temperatures."""
    arm, payloads = plain(), (*plain().payloads, "none", "none")
    count = len(payloads)
    columns = {name: np.arange(float(count)) for name in ("time", "hold", "temperature", "oil_temp")}
    mass = np.array([arm.payload(name).mass for name in payloads])
    row = Row(np.zeros((count, 6)), {}, {**columns, "payload_mass": mass})
    sessions = ("a", *("b",) * (count - 1))
    return Scene(arm.robot, row, tuple(columns), payloads, sessions, {}, np.zeros((2, 3)))


@functools.cache
def locations(law: EffectLaw) -> list[Location]:
    if law.name not in CATALOGUE:
        columns = ("q_J2", "humidity")[: 2 if law.name.endswith("product") else 1]
        return [Location("J3", "rz", columns, tuple(range(len(law.amplitudes)))), Location("base", "dx", columns, (0,))]
    return list(law.places(scene().records))


BACKLASH = 'name = "backlash"\nsite = "J2"\naxis = "ry"\nparameters = { gap = 3.6e-4 }'
