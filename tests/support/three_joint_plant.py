"""An arm of three joints, what stands there instead, and campaigns of it read from one place."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from support.campaign_files import numbers, write_columns
from support.plant import Array, Plant, Push, Rows, State, apply, pose, turn
from support.small_arms import joint, link, robot

URDF = robot(
    link("base"),
    joint("J1", "base", "one", (0, 0, 0.4), axis=(0, 0, 1)),
    link("one", 20.0, (0, 0, 0.2)),
    joint("J2", "one", "two", (0.1, 0, 0.3)),
    link("two", 10.0, (0.4, 0, 0)),
    joint("J3", "two", "three", (0.9, 0, 0)),
    link("three", 4.0, (0.3, 0, 0)),
    joint("flange", "three", "tip", (0.6, 0, 0.1), kind="fixed"),
    link("tip"),
)
ARM = """[robot]
urdf = "r.urdf"
tip = "tip"
gravity = [0.0, 0.0, -9.81]

[flexure.J2]
joint = "J2"
model = "linear"
compliance = [0.0, 0.0, 0.0, 1e-6, 4e-6, 1e-6]

[measurement]
frame = "unknown"

[prior]
joint_offset = 1e-3
compliance = 0.2
"""
SIGMA = 5e-5
GAP, POSES = 8e-4, 30
"""Play of the second joint [rad], and in how many poses it is read by default."""
STATION = pose(np.array([2.0, -1.0, 0.3]), turn(np.array([0.0, 0.0, 0.7])))


def declared(folder: Path) -> Plant:
    """Write the arm, and return the plant that is what it says."""
    (folder / "r.urdf").write_text(URDF)
    (folder / "arm.toml").write_text(ARM)
    return Plant.read(folder / "arm.toml")


def seen(plant: Plant, q: Array, act: Callable[[State, Push], None], approach: Array | None = None) -> Array:
    """Return where the instrument reads the plant's target without noise, (N, 3), with an effect at work."""
    rows = Rows.plain(q, np.zeros(len(q)), np.zeros((len(q), 3)))
    if approach is not None:
        rows.approach = approach
    return apply(STATION, plant.points(plant.relax(rows, [act])))


def write_campaign(path: Path, q: Array, read: Array, **more: Array) -> Path:
    """Write joint positions, readings with their `SIGMA`, and further columns."""
    columns = {f"q_J{i + 1}": q[:, i] for i in range(3)} | {axis: read[:, i] for i, axis in enumerate("xyz")} | more
    write_columns(path, {name: numbers(values) for name, values in columns.items()} | {"sigma": [SIGMA] * len(q)})
    return path


def with_play(folder: Path, still: int | None = None, poses: int = POSES, noise: float = SIGMA, **more: Array) -> Path:
    """Write a campaign of which the second joint has play, and one joint may never move, and further columns."""
    plant, rng = declared(folder), np.random.default_rng(0)
    q, sides = rng.uniform(-1.0, 1.0, (poses, 3)), rng.choice([-1.0, 1.0], (poses, 3))
    if still is not None:
        q[:, still] = 0.4

    def play(state: State, push: Push) -> None:
        push.motion[:, 1] += 0.5 * GAP * state.rows.approach[:, 1, None] * plant.joints[1].drive

    read = seen(plant, q, play, sides) + rng.normal(0.0, noise, (poses, 3))
    approach: dict[str, Array] = {f"approach_J{i + 1}": sides[:, i] for i in range(3)}
    write_campaign(folder / "rows.csv", q, read, **approach, **more)
    return folder
