"""heavy_six with [[effect]] tables of a test's own."""

import dataclasses
import functools
import warnings
from pathlib import Path

import numpy as np

from armflex import Arm, load_arm
from armflex.laws import Row
from armflex.laws.effects import CATALOGUE, Effect, EffectLaw
from armflex.laws.effects.catalogue import SHAPES
from armflex.laws.effects.context import Context
from armflex.laws.effects.location import Location
from support.small_arms import ROBOTS

MOST_TERMS = 17
"""Amplitudes that act at once: together more of them would move the target far."""

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
def context() -> Context:
    """Everything that a law may ask for was recorded: payloads, sessions, time, hold, temperatures."""
    arm, payloads = plain(), (*plain().payloads, "none", "none")
    count = len(payloads)
    columns = {name: np.arange(float(count)) for name in ("time", "hold", "temperature", "oil_temp")}
    mass = np.array([arm.payload(name).mass for name in payloads])
    q = np.outer(np.arange(float(count)), np.full(6, 0.1))
    row = Row(q, arm.joint_index, {**columns, "payload_mass": mass})
    sessions = ("a", *("b",) * (count - 1))
    return Context(arm.robot, row, tuple(columns), payloads, sessions, {}, np.zeros((2, 3)))


@functools.cache
def locations(law: EffectLaw) -> list[Location]:
    if law.name not in CATALOGUE:
        columns = ("q_J2", "humidity")[: 2 if law.name.endswith("product") else 1]
        return [Location("J3", "rz", columns, tuple(range(len(law.amplitudes)))), Location("base", "dx", columns, (0,))]
    return [dataclasses.replace(one, terms=one.terms[:MOST_TERMS]) for one in law.places(context().records)]


BACKLASH = 'name = "backlash"\nsite = "J2"\naxis = "ry"\nparameters = { gap = 3.6e-4 }'


Q = np.array([0.3, -0.4, 0.5, 0.2, 0.6, -0.1])
KNOWN = {"time": 30.0, "hold": 40.0, "temperature": 27.0, "oil_temp": 27.0, "humidity": 0.4}
KNOWN |= {f"approach_J{i}": 1.0 for i in range(1, 7)}
INNER = {
    "k": 5.0,
    "tau0": 300.0,
    "largest": 900.0,
    "t0": 20.0,
    "radius": 100.0,
    "at": 10.0,
    "since": -1.0,
    "start": -0.5,
    "end": 100.0,
    "lag": 0.0,
    "reference": 20.0,
}
INNER |= {"along": 1.0, "rest": 0.2, "reach": 0.3, "low": -2.0, "high": 2.0, "middle": 0.0, "centre": 0.2, "width": 0.5}
INNER |= {"spare": 0.2, "out": 1.0, "hook": 0.7, "aside_x": 0.1, "aside_y": -0.1, "aside_z": 0.05}
INNER |= {f"{name}_{axis}": value for name in ("anchor", "point") for axis, value in zip("xyz", (1, 2, 3), strict=True)}
MECHANICAL = ("pin_play", "cylinder_leak", "weak_spring", "bent_rod")
"""Effects of loops, cylinders and springs."""

OTHERS = (*MECHANICAL, "telescope", "refraction")
LAWS = {name: law for name, law in {**CATALOGUE, **SHAPES}.items() if not law.changes_model and name not in OTHERS}
"""Those that a chain on which nothing slides can have."""


def millimetre(name: str) -> Arm:
    """Return heavy_six with a law at work, scaled so that it moves the tip by about a millimetre."""
    law = LAWS[name]
    location = next((one for one in locations(law) if one.place in ("J2", "J3")), locations(law)[0])
    inner = tuple(INNER[one.name] for one in law.inner)

    def arm(size: float) -> Arm:
        values = [size if i in location.terms else 0.0 for i in range(len(law.amplitudes))]
        return dataclasses.replace(plain(), effects=(Effect(law, location, (*values, *inner)),))

    asked = {
        "payload": "p200",
        "covariates": KNOWN | {"play_J2_dx_100": 500.0, "play_J2_ry_100": 500.0},
        "allow_large": True,
    }
    there, size = plain().deflection(Q, "p200").displacement[:3], 1e-9
    for _ in range(4):
        moved = np.linalg.norm(arm(size).deflection(Q, **asked).displacement[:3] - there)
        size *= 1e-3 / max(moved, 1e-12)
    return arm(size)
