"""Track many simulated machines, some of which change at once, and count what is announced.

python tests/studies/tracked.py --runs 20 --quiet 20000
"""

import os

os.environ |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")

import argparse
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from support.plant import Plant
from support.tracking import Machine, followed, in_base

from armflex import Arm, Tracker

BEFORE, AFTER = 20, 30
"""Readings before and after a change."""

CHANGES = (("compliance", 1.2), ("compliance", 1.1), ("joint_offset", 1e-3), ("joint_offset", 3e-4))
SHOWS = 0.95e-3
"""RMS motion of the tip [m] from which a change is counted in the sum."""


@dataclass(frozen=True)
class Told:
    """What was announced of one kind of change in some runs; delays in readings from the change on."""

    name: str
    motion: float  # m, RMS of the tip
    delays: tuple[int, ...]
    right: int
    runs: int

    @property
    def line(self) -> str:
        """For the terminal."""
        middle, most = (np.median(self.delays), max(self.delays)) if self.delays else (np.nan, np.nan)
        early = sum(delay < 1 for delay in self.delays)
        counts = f"announced {len(self.delays):3d} of {self.runs}, right {self.right:3d}, too early {early}"
        return f"{self.name:24s} {self.motion * 1e3:6.2f} mm  {counts}, after {middle:4.1f} (at most {most:.0f})"


def told(machine: Machine, arm: Arm, kind: str, size: float, joint: str, runs: int) -> Told:
    """Return what is announced where a joint's compliance becomes `size` times, or it stands `size` elsewhere."""
    change = {"softer" if kind == "compliance" else "moved": {joint: size}}
    name, delays, right, motion = f"{kind} {joint}", [], 0, []
    for seed in range(300, 300 + 2 * runs, 2):
        calm, changed = machine.readings(seed, BEFORE + AFTER), machine.readings(seed, BEFORE + AFTER, **change)
        motion += [float(((a.position - b.position) ** 2).sum()) for a, b in zip(calm, changed, strict=True)]
        tracker = Tracker(arm)
        for number, reading in enumerate([*calm[:BEFORE], *changed[BEFORE:]]):
            found = tracker.update(reading).change
            if found is not None:
                delays.append(number - BEFORE + 1)
                right += found.name == name
                break
    return Told(f"{name} {size:g}", float(np.sqrt(np.mean(motion))), tuple(delays), right, runs)


def machine_in(folder: Path) -> Machine:
    """Return the boom, and one that stands there whose parameters are a little off."""
    arm, rng = in_base(folder), np.random.default_rng(1)
    plant = Plant.read(folder / "arm.toml")
    plant.compliance = {name: c * rng.uniform(0.9, 1.15) for name, c in plant.compliance.items()}
    plant.offset = {joint.name: rng.normal(0.0, 1e-3) for joint in plant.joints}
    return Machine(folder, arm, plant)


def quiet(machine: Machine, arm: Arm, count: int) -> tuple[int, int]:
    """Return false alarms, and readings that counted less, among `count` of a machine that stays as it is."""
    tracker = followed(Tracker(arm), machine.readings(5000, count))
    return len(tracker.changes), tracker.outliers


def main() -> None:
    """Print a line for every kind of change, and the sums."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=20, help="of every kind of change")
    parser.add_argument("--quiet", type=int, default=20_000, help="readings without a change")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        machine = machine_in(Path(folder))
        arm = followed(Tracker(machine.arm), machine.readings(100, 500)).arm
        every = []
        for kind, size in CHANGES:
            for joint in machine.arm.joint_names:
                every.append(told(machine, arm, kind, size, joint, asked.runs))
                print(every[-1].line, flush=True)
        shown = [one for one in every if one.motion >= SHOWS]
        delays = [delay for one in shown for delay in one.delays]
        runs, right = sum(one.runs for one in shown), sum(one.right for one in shown)
        print(f"that move the tip by {SHOWS * 1e3:g} mm or more: announced {len(delays)} of {runs}, right {right}")
        print(
            f"false alarms, readings counted less, in {asked.quiet} quiet readings: {quiet(machine, arm, asked.quiet)}"
        )


if __name__ == "__main__":
    main()
