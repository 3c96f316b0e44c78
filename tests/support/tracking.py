"""A machine to be tracked: the boom as declared and the plant that stands there."""

import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from armflex import Arm, Reading, Tracker, load_arm, predict, read_measurements
from support.campaign_files import write_columns
from support.plant import Array, Plant, Rows
from support.small_arms import ROBOTS

LOADS = {"empty": 0.0, "p300": 300.0, "p600": 600.0}
SIGMA = 2e-4


IN_BASE = {'frame = "unknown"': 'frame = "base"', "session_translation = 5e-4": "", "session_rotation = 5e-5": ""}


@dataclass(frozen=True)
class Machine:
    """The boom as declared, measured in its base, and the one that stands there."""

    folder: Path
    arm: Arm
    plant: Plant

    def drive(self, seed: int, count: int) -> tuple[Array, list[str]]:
        """Joint positions and payloads."""
        rng = np.random.default_rng(seed)
        lower, upper = np.maximum(self.arm.robot.lower, -1.5), np.minimum(self.arm.robot.upper, 1.5)
        return rng.uniform(lower, upper, (count, len(lower))), rng.choice(list(LOADS), count).tolist()

    def readings(self, seed: int, count: int, softer: dict | None = None, moved: dict | None = None) -> list[Reading]:
        """Noisy readings, compliances times factors and joints moved by offsets."""
        q, payloads = self.drive(seed, count)
        rows = Rows.plain(q, np.array([LOADS[name] for name in payloads]), np.tile([0.2, 0.0, 0.0], (count, 1)))
        compliance = {name: c * (softer or {}).get(name, 1.0) for name, c in self.plant.compliance.items()}
        offset = {name: value + (moved or {}).get(name, 0.0) for name, value in self.plant.offset.items()}
        changed = replace(self.plant, compliance=compliance, offset=offset)
        points = changed.points(changed.relax(rows))
        points += np.random.default_rng(seed + 1).normal(0.0, SIGMA, points.shape)
        pairs = zip(q, points, payloads, strict=True)
        return [Reading(position, point, SIGMA, payload) for position, point, payload in pairs]


def in_base(folder: Path, extra: str = "") -> Arm:
    """Return measured.toml with its instrument in the base."""
    text = (ROBOTS / "tarm_like" / "measured.toml").read_text()
    for old, new in IN_BASE.items():
        assert old in text
        text = text.replace(old, new)
    shutil.copy(ROBOTS / "tarm_like" / "robot.urdf", folder)
    (folder / "arm.toml").write_text(text.replace("[flexure.A4]\n", f"[flexure.A4]\n{extra}"))
    return load_arm(folder / "arm.toml")


@pytest.fixture(scope="module")
def machine(tmp_path_factory) -> Machine:
    folder = tmp_path_factory.mktemp("machine")
    arm = in_base(folder)
    plant, rng = Plant.read(folder / "arm.toml"), np.random.default_rng(1)
    plant.compliance = {name: c * rng.uniform(0.9, 1.15) for name, c in plant.compliance.items()}
    plant.offset = {joint.name: rng.normal(0.0, 1e-3) for joint in plant.joints}
    plant.target = rng.normal(0.0, 3e-3, 3)
    return Machine(folder, arm, plant)


@pytest.fixture(scope="module")
def known(machine) -> Arm:
    """The arm after 300 readings."""
    return followed(Tracker(machine.arm), machine.readings(100, 300)).arm


def followed(tracker: Tracker, readings: list[Reading]) -> Tracker:
    for reading in readings:
        tracker.update(reading)
        if tracker.stale:
            tracker.relinearise()
    return tracker


def error(arm: Arm, machine: Machine, **changes: dict) -> float:
    """Return the RMS distance [m] of predicted from read positions that the arm has not seen."""
    readings = machine.readings(999, 40, **changes)
    rows = measured(machine, readings, "unseen.csv")
    return float(np.sqrt(((predict(arm, rows).position - rows.position) ** 2).sum(axis=1).mean()))


def measured(machine: Machine, readings: list[Reading], name: str):
    """Return readings as the campaign that a user would bring."""
    q, position = np.array([one.q for one in readings]), np.array([one.position for one in readings])
    columns = {f"q_{joint}": list(values) for joint, values in zip(machine.arm.joint_names, q.T, strict=True)}
    columns |= {axis: list(values) for axis, values in zip("xyz", position.T, strict=True)}
    columns |= {"sigma": [SIGMA] * len(q), "payload": [one.payload for one in readings]}
    columns = {
        column: [x if isinstance(x, str) else repr(float(x)) for x in cells] for column, cells in columns.items()
    }
    write_columns(machine.folder / name, columns)
    return read_measurements(machine.folder / name, machine.arm)


def shifted(readings: list[Reading], shifts: dict[int, list[float]]) -> list[Reading]:
    """Return readings of which some are off by so much [m]."""
    return [replace(one, position=one.position + np.array(shifts.get(i, 0.0))) for i, one in enumerate(readings)]
