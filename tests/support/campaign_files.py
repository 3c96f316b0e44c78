"""The files of a campaign: the declared arm, what was measured, and what was true."""

import csv
import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from support.plant import Array, Rows

ROBOTS = Path(__file__).parents[2] / "robots"
PRIOR = """[measurement]
frame = "unknown"
gravity_in = "base"

[prior]
joint_offset = 1e-3
compliance = 0.2
tool = 0.005
session_translation = 5e-4
session_rotation = 5e-5
"""


@dataclass(frozen=True)
class DeclaredArm:
    """Which robot, and name, mass [kg] and centre of mass [m] of its payloads."""

    robot: str
    payloads: tuple[tuple[str, float, tuple[float, float, float]], ...]


ARMS = {
    "boom": DeclaredArm(
        "tarm_like",
        (("empty", 0.0, (0.2, 0.0, 0.0)), ("p300", 300.0, (0.2, 0.0, 0.0)), ("p600", 600.0, (0.2, 0.0, 0.0))),
    ),
    "six": DeclaredArm(
        "heavy_six",
        (("empty", 0.0, (0.15, 0.0, 0.04)), ("p60", 60.0, (0.15, 0.0, 0.04)), ("p120", 120.0, (0.15, 0.0, 0.04))),
    ),
}
OUT = 3.0  # m, the mast's extension at which its compliance is frozen


def declared_text(arm: str) -> str:
    """Return arm.toml: the shipped arm with its flexures as diagonals, our payloads and priors."""
    folder = ROBOTS / ARMS[arm].robot
    shipped = tomllib.loads((folder / "arm.toml").read_text())
    robot = shipped["robot"]
    lines = ["[robot]", f'urdf = "{(folder / robot["urdf"]).resolve().as_posix()}"', f'tip = "{robot["tip"]}"']
    lines += [f'base = "{robot["base"]}"', f"gravity = {robot['gravity']}", ""]
    for name, mass, com in ARMS[arm].payloads:
        lines += [f"[payload.{name}]", f"mass = {mass}", f"com = {list(com)}", ""]
    for name, flexure in shipped["flexure"].items():
        lines += [f"[flexure.{name}]", f'joint = "{flexure["joint"]}"', 'model = "linear"']
        lines += [f"compliance = {[float(x) for x in diagonal(flexure)]}", ""]
    return "\n".join(lines) + "\n" + PRIOR


def diagonal(flexure: dict) -> Array:
    """Diagonal of a linear law; of one that depends on the position, at `OUT`."""
    terms = [
        np.array(flexure[key], float)
        for key in ("compliance", *(f"compliance_q{n}" for n in (1, 2, 3)))
        if key in flexure
    ]
    return sum(OUT**n * (np.diag(term) if term.ndim == 2 else term) for n, term in enumerate(terms))


def write_rows(
    path: Path, rows: Rows, joints: list[str], payloads: list[str], seen: Array, shown: Array, sigma: float
) -> None:
    """Write a campaign; positions only where `shown`."""
    columns: dict[str, list] = {
        "pose": [f"p{n}" for n in rows.pose],
        "session": [f"s{n}" for n in rows.session],
        "time": numbers(rows.time),
        "payload": [payloads[n] for n in rows.payload],
        "temperature": numbers(rows.temperature),
        "hold": numbers(rows.hold),
        "humidity": numbers(np.round(rows.humidity, 2)),
        **{f"q_{name}": numbers(rows.q[:, i]) for i, name in enumerate(joints)},
        **{f"approach_{name}": [int(x) for x in rows.approach[:, i]] for i, name in enumerate(joints)},
        **{
            a: [x if show else "" for x, show in zip(numbers(seen[:, i]), shown, strict=True)]
            for i, a in enumerate("xyz")
        },
        "sigma": [sigma] * len(rows.q),
    }
    write_columns(path, columns)


def write_clean(path: Path, rows: Rows, clean: Array) -> None:
    """Write where the instrument would have read the target without noise."""
    identity = {"pose": [f"p{n}" for n in rows.pose], "held_out": [int(x) for x in rows.held_out]}
    write_columns(path, {**identity, **{a: numbers(clean[:, i]) for i, a in enumerate("xyz")}})


def write_columns(path: Path, columns: dict[str, list]) -> None:
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))


def numbers(values: Array) -> list[str]:
    return [repr(float(x)) for x in values]
